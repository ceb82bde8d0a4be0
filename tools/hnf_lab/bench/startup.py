"""Bench of command start-up: wall time, processor time, memory and loaded modules of fresh processes.

Each run of a command is paired with a run of a process that only imports numpy.
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
"""Packages whose loading is reported."""
# Written by atexit, so that it works for every kind of exit: argparse ends --help by SystemExit.
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
    """Measurements of one process.

    Attributes
    ----------
    wall_s, cpu_s
        Time from start to end, including the interpreter's own [s].
    peak_mb
        Peak memory of the process [MB].
    modules
        Names of all loaded modules.
    output
        Standard output.
    """

    wall_s: float
    cpu_s: float
    peak_mb: float
    modules: tuple[str, ...]
    output: str = ""

    @property
    def heavy_packages(self) -> tuple[str, ...]:
        """Names of the loaded packages that are in HEAVY_PACKAGES."""
        return tuple(name for name in HEAVY_PACKAGES if name in self.modules)


def run_process(code: str, *arguments: str) -> ProcessRun:
    """Run code from the source tree with sys.argv[1:] = arguments.

    Raises
    ------
    HnfError
        If it fails, or if the system does not report the resources of a process (Windows).
    """
    if not hasattr(os, "wait4"):
        raise HnfError("this system does not tell what a process took.", remedy="Run this bench on Linux or macOS.")
    with tempfile.TemporaryDirectory() as folder:
        report, out = Path(folder) / "told", Path(folder) / "out"
        environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
        environment |= {"PYTHONPATH": CHILD_PATH, "HNF_BENCH_TOLD": str(report)}
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
        output = out.read_text(encoding="utf-8", errors="replace")
        if child.returncode != 0 or not report.is_file():
            raise HnfError(f"a process to be measured ended with code {child.returncode}:\n{output.strip()[-1500:]}")
        modules, peak = json.loads(report.read_text(encoding="utf-8"))
    # On Linux ru_maxrss of a child includes memory of the parent, so the child reports its own peak there.
    return ProcessRun(wall_s, usage.ru_utime + usage.ru_stime, (peak or usage.ru_maxrss) / 1e6, tuple(modules), output)


STARTUP_NAME = "startup"
NUMPY_CODE = "import numpy"
HNF_CODE = "from hnf_core.cli.main import main; sys.exit(main(sys.argv[1:], lambda arguments: 1))"
MATERIAL_NAME = "oak-wood"
SECONDS, QUICK_SECONDS = 10.0, 0.5
STEP_S = 0.01
"""Sample interval of the action [s]."""


def measure_startup(options: BenchOptions) -> list[Row]:
    """Measure one row per command, each process after one of NUMPY_CODE.

    All commands run once beforehand, so that no bytecode is compiled in the measurement. Raises HnfError if a command
    fails.
    """
    seconds = QUICK_SECONDS if options.quick else SECONDS
    with tempfile.TemporaryDirectory() as folder:
        action, material_path, out = (Path(folder) / name for name in ("action.csv", "own.hnf", "out.wav"))
        write_text(action, make_action_csv(seconds))
        write_hnf(material_path, from_library(get_material(MATERIAL_NAME)))
        stroke = ("--action", str(action), "--out", str(out))
        commands = {
            "hnf --help": ("--help",),
            "hnf --version": ("--version",),
            "hnf materials --json": ("materials", "--json"),
            f"hnf synth, {seconds:g} s, {MATERIAL_NAME}": ("synth", "--material", MATERIAL_NAME, *stroke),
            f"hnf synth, {seconds:g} s, own .hnf": ("synth", "--material", str(material_path), *stroke),
        }
        options.watch(f"{STARTUP_NAME}: warming up")
        for command_line in commands.values():
            run_process(HNF_CODE, *command_line)
        return measure_pairs(
            options, NUMPY_CODE, NUMPY_CODE, {name: (HNF_CODE, command_line) for name, command_line in commands.items()}
        )


def measure_pairs(
    options: BenchOptions,
    base: str,
    base_code: str,
    others: Mapping[str, tuple[str, Sequence[str]]],
    bench: str = STARTUP_NAME,
) -> list[Row]:
    """Return rows of a base and of others (name → code, arguments); each run of the others follows one of the base."""
    bases: list[ProcessRun] = []
    rows = []
    for name, (code, command_line) in others.items():
        pairs = []
        for repeat in range(options.repeats):
            options.watch(f"{bench}: {name}, {repeat + 1} of {options.repeats}")
            pairs.append((run_process(base_code), run_process(code, *command_line)))
        bases += [base_run for base_run, _ in pairs]
        difference = Spread.from_values([run.wall_s - base_run.wall_s for base_run, run in pairs])
        ratio = Spread.from_values([run.cpu_s / base_run.cpu_s for base_run, run in pairs])
        note = f"{difference.median:+.2f} s ({difference.lowest:+.2f} to {difference.highest:+.2f})"
        rows.append(make_row(bench, name, [run for _, run in pairs], ratio, base, note))
    return [make_row(bench, base, bases), *rows]


def make_row(
    bench: str, name: str, runs: Sequence[ProcessRun], ratio: Spread | None = None, ratio_to: str = "", note: str = ""
) -> Row:
    """Make a row from equal processes. The peak is that of the complete process."""
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
    """Return an action as CSV for `hnf synth --action`, with direction, speed and force always changing."""
    time = np.arange(0.0, seconds + STEP_S / 2.0, STEP_S)
    columns = (time, 0.3 * np.sin(time), 0.1 + 0.05 * np.sin(2.0 * time), 1.0 + 0.3 * np.sin(3.0 * time))
    lines = [",".join(f"{value:.6g}" for value in row) for row in np.stack(columns, axis=1).tolist()]
    return "\n".join([",".join(CSV_COLUMNS), *lines]) + "\n"
