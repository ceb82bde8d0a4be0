"""What a command costs from nothing: fresh processes, in turn with one that does no more than `import numpy`."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ..action.table import CSV_COLUMNS
from ..files import write_text
from ..material.hnf_file import from_library, write_hnf
from ..material.library import get_material
from .frame import BenchOptions, Row, Spread
from .process import ProcessRun, run_process

STARTUP_NAME = "startup"
NUMPY_CODE = "import numpy"
HNF_CODE = "from hnf_core.cli.main import main; sys.exit(main(sys.argv[1:], lambda arguments: 1))"
MATERIAL_NAME = "oak-wood"
SECONDS, QUICK_SECONDS = 10.0, 0.5
STEP_S = 0.01


def measure_startup(options: BenchOptions) -> list[Row]:
    """One row a command, each process after one of NUMPY; all of them once before, so that nothing is compiled. Raises
    HnfError where a command fails."""
    seconds = QUICK_SECONDS if options.quick else SECONDS
    with tempfile.TemporaryDirectory() as folder:
        action, kept, out = (Path(folder) / name for name in ("action.csv", "own.hnf", "out.wav"))
        write_text(action, make_action_csv(seconds))
        write_hnf(kept, from_library(get_material(MATERIAL_NAME)))
        stroke = ("--action", str(action), "--out", str(out))
        commands = {
            "hnf --help": ("--help",),
            "hnf --version": ("--version",),
            "hnf materials --json": ("materials", "--json"),
            f"hnf synth, {seconds:g} s, {MATERIAL_NAME}": ("synth", "--material", MATERIAL_NAME, *stroke),
            f"hnf synth, {seconds:g} s, own .hnf": ("synth", "--material", str(kept), *stroke),
        }
        options.watch(f"{STARTUP_NAME}: warming up")
        for words in commands.values():
            run_process(HNF_CODE, *words)
        return measure_pairs(
            options, NUMPY_CODE, NUMPY_CODE, {name: (HNF_CODE, words) for name, words in commands.items()}
        )


def measure_pairs(
    options: BenchOptions,
    base: str,
    base_code: str,
    others: Mapping[str, tuple[str, Sequence[str]]],
    bench: str = STARTUP_NAME,
) -> list[Row]:
    """Rows of a base and of others (name → code, words), each run of which follows one of the base."""
    bases: list[ProcessRun] = []
    found = []
    for name, (code, words) in others.items():
        pairs = []
        for k in range(options.repeats):
            options.watch(f"{bench}: {name}, {k + 1} of {options.repeats}")
            pairs.append((run_process(base_code), run_process(code, *words)))
        bases += [one for one, _ in pairs]
        more = Spread.from_values([other.wall_s - one.wall_s for one, other in pairs])
        ratio = Spread.from_values([other.cpu_s / one.cpu_s for one, other in pairs])
        note = f"{more.median:+.2f} s ({more.lowest:+.2f} to {more.highest:+.2f})"
        found.append(make_row(bench, name, [other for _, other in pairs], ratio, base, note))
    return [make_row(bench, base, bases), *found]


def make_row(
    bench: str, name: str, runs: Sequence[ProcessRun], ratio: Spread | None = None, ratio_to: str = "", note: str = ""
) -> Row:
    """Of processes that did the same. The peak is that of the whole process."""
    loaded = f"{len(runs[-1].modules)} modules; {', '.join(runs[-1].heavy_packages) or 'none of the heavy ones'}"
    return Row(
        bench,
        name,
        Spread.from_values([run.wall_s for run in runs]),
        Spread.from_values([run.cpu_s for run in runs]),
        ratio=ratio,
        ratio_to=ratio_to,
        peak_mb=max(run.peak_mb for run in runs),
        note=f"{note}; {loaded}" if note else loaded,
    )


def make_action_csv(seconds: float) -> str:
    """A hand that turns, hastens and presses all the time, as `hnf synth --action` reads it."""
    time = np.arange(0.0, seconds + STEP_S / 2.0, STEP_S)
    columns = (time, 0.3 * np.sin(time), 0.1 + 0.05 * np.sin(2.0 * time), 1.0 + 0.3 * np.sin(3.0 * time))
    lines = [",".join(f"{value:.6g}" for value in row) for row in np.stack(columns, axis=1).tolist()]
    return "\n".join([",".join(CSV_COLUMNS), *lines]) + "\n"
