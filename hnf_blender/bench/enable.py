"""What switching the add-on on costs: CPU time and memory beside those of `import numpy`, and what it loads."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from hnf_core.bench.frame import BenchOptions, Row, Spread
from hnf_core.errors import HnfError

from .needs import require_bpy

ENABLE_NAME = "enable"
ROOT = Path(__file__).resolve().parents[2]
MAX_ENABLE_S = 60.0
HEAVY_PACKAGES = frozenset({"torch", "scipy", "matplotlib", "OpenEXR", "embreex", "safetensors", "PIL"})
"""What must not be loaded by it."""
# Blender has bpy and numpy in memory before any add-on; numpy is loaded first, so that its cost is its own.
ENABLE_CODE = """
import json, os, sys, time, tracemalloc
start = time.process_time()
import numpy
numpy_s = time.process_time() - start
import bpy, addon_utils
before = set(sys.modules)
if "memory" in sys.argv:
    tracemalloc.start()
start = time.process_time()
import hnf_blender
hnf_blender.register()
addon_s = time.process_time() - start
peak = tracemalloc.get_traced_memory()[1]
hnf_blender.unregister()
print("RESULT", json.dumps([numpy_s, addon_s, peak / 1e6, sorted(set(sys.modules) - before)]))
sys.stdout.flush()
os._exit(0)
"""


@dataclass(frozen=True)
class EnableRun:
    """One fresh process. numpy_s, addon_s: CPU seconds. peak_mb: of Python's memory, 0 where it was not traced.
    modules: loaded by the add-on."""

    numpy_s: float
    addon_s: float
    peak_mb: float
    modules: tuple[str, ...]

    @property
    def heavy_packages(self) -> tuple[str, ...]:
        """The heavy packages among the modules."""
        return tuple(sorted({name.partition(".")[0] for name in self.modules} & HEAVY_PACKAGES))


def measure_enable(options: BenchOptions) -> list[Row]:
    """Both costs in the same processes, after one that compiles and one that counts memory, which is slow. Raises
    HnfError without bpy."""
    require_bpy(ENABLE_NAME)
    options.watch(f"{ENABLE_NAME}: compiling")
    enable_in_process()
    peak_mb = enable_in_process("memory").peak_mb
    runs = []
    for k in range(options.repeats):
        options.watch(f"{ENABLE_NAME}: process {k + 1} of {options.repeats}")
        runs.append(enable_in_process())
    heavy = ", ".join(runs[-1].heavy_packages) or "none"
    return [
        Row(ENABLE_NAME, "import numpy", cpu=Spread.from_values([run.numpy_s for run in runs])),
        Row(
            ENABLE_NAME,
            "switch the add-on on",
            cpu=Spread.from_values([run.addon_s for run in runs]),
            ratio=Spread.from_values([run.addon_s / run.numpy_s for run in runs]),
            ratio_to="import numpy",
            peak_mb=peak_mb,
            note=f"{len(runs[-1].modules)} modules; heavy ones: {heavy}",
        ),
    ]


def enable_in_process(*arguments: str) -> EnableRun:
    """In a fresh process; "memory" traces its peak. Raises HnfError where that fails."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    environment["PYTHONPATH"] = str(ROOT)
    try:
        done = subprocess.run(
            [sys.executable, "-c", ENABLE_CODE, *arguments], cwd=ROOT, env=environment, timeout=MAX_ENABLE_S,
            stdin=subprocess.DEVNULL, capture_output=True, text=True, check=True,
        )  # fmt: skip
    except subprocess.TimeoutExpired as error:
        raise HnfError(f"the add-on was not switched on within {MAX_ENABLE_S:g} s in a fresh process.") from error
    except subprocess.CalledProcessError as error:
        said = str(error.stderr).strip()[-1500:]
        raise HnfError(f"the add-on could not be switched on in a fresh process:\n{said}") from error
    line = next(line for line in done.stdout.splitlines() if line.startswith("RESULT "))
    numpy_s, addon_s, peak, modules = json.loads(line.removeprefix("RESULT "))
    return EnableRun(float(numpy_s), float(addon_s), float(peak), tuple(modules))
