"""What switching the add-on on costs: milliseconds of CPU beyond `import numpy`, and the modules it loads.

    .venv/bin/python tools/enabling_cost.py [--runs 5] [--modules]

Each run is a fresh process. The first, which compiles, does not count; of the others the quickest does: what the rest
took longer is the machine's other work. Exit code 1 over the limit.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LIMIT_MS = 50.0
HEAVY = ("torch", "scipy", "matplotlib", "OpenEXR", "embreex", "safetensors", "PIL")
"""What must not be loaded by switching the add-on on."""
# bpy and numpy first: Blender has them in memory before any add-on.
CODE = """
import json, os, sys, time
import bpy, numpy, addon_utils
before, start = set(sys.modules), time.process_time()
import hnf_blender
hnf_blender.register()
took = time.process_time() - start
hnf_blender.unregister()
print("RESULT", json.dumps([1e3 * took, sorted(set(sys.modules) - before)]))
sys.stdout.flush()
os._exit(0)
"""


@dataclass(frozen=True)
class Cost:
    """milliseconds: of CPU, the quickest run. modules: loaded by it."""

    milliseconds: float
    modules: tuple[str, ...]

    @property
    def heavy(self) -> tuple[str, ...]:
        """The heavy packages among the modules."""
        return tuple(sorted({name.partition(".")[0] for name in self.modules} & set(HEAVY)))


def measure(runs: int = 5, python: str = sys.executable) -> Cost:
    """Switch the add-on on in runs fresh processes, after one that compiles. Raises CalledProcessError."""
    results = [_run(python) for _ in range(runs + 1)][1:]
    return Cost(min(took for took, _ in results), tuple(results[-1][1]))


def _run(python: str) -> tuple[float, list[str]]:
    done = subprocess.run(
        [python, "-c", CODE], cwd=ROOT, env=os.environ | {"PYTHONPATH": str(ROOT)}, stdin=subprocess.DEVNULL,
        capture_output=True, text=True, timeout=60, check=True,
    )  # fmt: skip
    line = next(line for line in done.stdout.splitlines() if line.startswith("RESULT "))
    took, modules = json.loads(line.removeprefix("RESULT "))
    return float(took), list(modules)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="What switching the add-on on costs.")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--modules", action="store_true", help="list the modules too")
    chosen = parser.parse_args(arguments)
    cost = measure(chosen.runs)
    if chosen.modules:
        print("\n".join(cost.modules))
    heavy = ", ".join(cost.heavy) or "none"
    print(f"{cost.milliseconds:.1f} ms beyond numpy (limit {LIMIT_MS:g}), {len(cost.modules)} modules; heavy: {heavy}")
    return 1 if cost.milliseconds > LIMIT_MS or cost.heavy else 0


if __name__ == "__main__":
    sys.exit(main())
