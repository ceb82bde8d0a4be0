"""Python code in a process of its own: its time on the wall and on the processor, its memory, what it loads.

What a command costs from nothing: fresh processes, in turn with one that does no more than `import numpy`.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hnf_core.action.action import CSV_COLUMNS
from hnf_core.errors import HnfError
from hnf_core.files import write_text
from hnf_core.material.hnf_file import from_library, write_hnf
from hnf_core.material.library import get_material
from hnf_lab import CHILD_PATH

from .harness import BenchOptions, Row, Spread

HEAVY_PACKAGES = ("numpy", "scipy", "torch", "matplotlib", "bpy")
"""Packages whose loading is told."""
# Written at the very end, whatever way the code takes out: argparse ends --help by SystemExit.
REPORT_CODE = """
import atexit, json, os, sys
def tell():
    told = sorted(sys.modules)
    status = open("/proc/self/status").read().split() if os.path.exists("/proc/self/status") else []
    peak = 1024 * int(status[status.index("VmHWM:") + 1]) if status else 0
    open(os.environ["HNF_BENCH_TOLD"], "w").write(json.dumps([told, peak]))
atexit.register(tell)
"""


@dataclass(frozen=True)
class ProcessRun:
    """One run. wall_s, cpu_s: from start to end, the interpreter's own included. peak_mb: of the whole process.
    modules: names of all that was loaded. said: its standard output."""

    wall_s: float
    cpu_s: float
    peak_mb: float
    modules: tuple[str, ...]
    output: str = ""

    @property
    def heavy_packages(self) -> tuple[str, ...]:
        """Which of HEAVY it loaded."""
        return tuple(name for name in HEAVY_PACKAGES if name in self.modules)


def run_process(code: str, *arguments: str) -> ProcessRun:
    """Run code with sys.argv[1:] = words, from the source. Raises HnfError where it fails, and where this system does
    not tell what a process took (Windows)."""
    if not hasattr(os, "wait4"):
        raise HnfError("this system does not tell what a process took.", remedy="Run this bench on Linux or macOS.")
    with tempfile.TemporaryDirectory() as folder:
        told, out = Path(folder) / "told", Path(folder) / "out"
        environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
        environment |= {"PYTHONPATH": CHILD_PATH, "HNF_BENCH_TOLD": str(told)}
        with out.open("wb") as stream:
            started = time.perf_counter()
            child = subprocess.Popen(
                [sys.executable, "-c", REPORT_CODE + code, *arguments], env=environment, stdin=subprocess.DEVNULL,
                stdout=stream,
                stderr=subprocess.STDOUT,
            )  # fmt: skip
            _, status, usage = os.wait4(child.pid, 0)
            wall_s = time.perf_counter() - started
            child.returncode = os.waitstatus_to_exitcode(status)
        said = out.read_text(encoding="utf-8", errors="replace")
        if child.returncode != 0 or not told.is_file():
            raise HnfError(f"a process to be measured ended with code {child.returncode}:\n{said.strip()[-1500:]}")
        modules, peak = json.loads(told.read_text(encoding="utf-8"))
    # Linux counts what the parent held into ru_maxrss of a child, so there the child itself tells.
    return ProcessRun(wall_s, usage.ru_utime + usage.ru_stime, (peak or usage.ru_maxrss) / 1e6, tuple(modules), said)


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
