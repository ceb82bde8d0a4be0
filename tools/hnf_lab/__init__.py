"""The laboratory of Haptic Neural Fields: evaluation, benchmarks, rivals and experiments, of a source checkout alone.

It imports the product (`hnf_core`, `hnf_blender`); the product never imports it. `cli/` holds its commands.
"""

import os
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
"""The checkout."""
CHILD_PATH = os.pathsep.join(str(folder) for folder in (ROOT, ROOT / "tools", ROOT / "tests"))
"""PYTHONPATH of child processes that import the laboratory."""

# The plain references that fast paths are measured against, and makers of test data, lie with the tests.
if str(ROOT / "tests") not in sys.path:
    sys.path.append(str(ROOT / "tests"))
