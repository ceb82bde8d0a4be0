"""Train the shipped weights hnf_core/data/field.safetensors from nothing but this project's own simulator.

Usage: python tools/train_default_field.py [--seed N] [--out FILE] [--workers N]    needs the extra "train".
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from hnf_core.field.field import FieldConfig  # noqa: E402
from hnf_core.field.weights import DEFAULT_WEIGHTS, save_field  # noqa: E402
from hnf_core.training.recipe import Plan, train  # noqa: E402


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=DEFAULT_WEIGHTS)
    parser.add_argument("--library", type=Path, default=ROOT / "hnf_core" / "data" / "library.json")
    parser.add_argument("--workers", type=int, default=2, help="processes that simulate; does not change the result")
    arguments = parser.parse_args()
    field = train(arguments.library, Plan(), FieldConfig(), arguments.seed, arguments.workers)
    save_field(arguments.out, field)
    print(f"{arguments.out}: {arguments.out.stat().st_size / 1e6:.2f} MB", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
