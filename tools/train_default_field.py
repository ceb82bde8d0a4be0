"""Train the shipped weights hnf_core/data/field.safetensors from nothing but this project's own simulator.

Usage: python tools/train_default_field.py [--held-out] [--encoder NAME|FILE …] [--seed N] [--out FILE]
       [--workers N] [--cache DIR]
Needs the extra "train". Simulated strokes stay in the cache for tools/hnf_lab/experiments/shared_field.py.
--held-out trains hnf_core/data/field-held-out.safetensors instead, without the last class of every category: the field
that `hnf eval` uses for unseen classes.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from hnf_core.field.weights import DEFAULT_WEIGHTS, HELD_OUT_WEIGHTS, save_field
from hnf_lab.shared_field.train_shared import HELD_OUT, SHARED_CONFIG, TrainingPlan, train_shared_field

CACHE = ROOT / "build" / "shared-field"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="default: where the shipped weights are")
    parser.add_argument("--held-out", action="store_true", help="leave a class of every category out")
    parser.add_argument("--encoder", nargs="*", default=[], metavar="NAME|FILE", help="further makes of E to learn")
    parser.add_argument("--library", type=Path, default=ROOT / "hnf_core" / "data" / "library.json")
    parser.add_argument("--workers", type=int, default=2, help="processes that simulate; does not change the result")
    parser.add_argument("--cache", type=Path, default=CACHE, help="folder for simulated strokes")
    arguments = parser.parse_args()
    arguments.cache.mkdir(parents=True, exist_ok=True)
    left_out, default_path = (HELD_OUT, HELD_OUT_WEIGHTS) if arguments.held_out else ((), DEFAULT_WEIGHTS)
    plan = TrainingPlan(encoders=tuple(arguments.encoder))
    field = train_shared_field(
        arguments.library, plan, SHARED_CONFIG, arguments.seed, arguments.cache, arguments.workers, left_out
    )
    out = arguments.out or default_path
    save_field(out, field)
    print(f"{out}: {out.stat().st_size / 1e6:.2f} MB", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
