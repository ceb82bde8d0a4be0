"""Evaluation, benchmarks, baselines and experiments of Haptic Neural Fields, for a source checkout only.

The package imports the product (`hnf_core`, `hnf_blender`); the product never imports it. Its commands are in `cli/`.
"""

import os
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
"""Root folder of the checkout."""
CHILD_PATH = os.pathsep.join(str(folder) for folder in (ROOT, ROOT / "tools", ROOT / "tests"))
"""PYTHONPATH of child processes that import this package."""

# The reference implementations that fast paths are compared with, and the test data generators, are in tests/.
if str(ROOT / "tests") not in sys.path:
    sys.path.append(str(ROOT / "tests"))
