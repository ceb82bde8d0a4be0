"""Python code in a process of its own: its time on the wall and on the processor, its memory, what it loads."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from ..errors import HnfError

ROOT = Path(__file__).resolve().parents[2]
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
        environment |= {"PYTHONPATH": str(ROOT), "HNF_BENCH_TOLD": str(told)}
        with out.open("wb") as stream:
            started = time.perf_counter()
            child = subprocess.Popen(
                [sys.executable, "-c", REPORT_CODE + code, *arguments], env=environment, stdin=subprocess.DEVNULL, stdout=stream,
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
