"""Make paired views to learn touch from sight: look and macro depth → height and membrane (hnf_core.datasets).

Usage: python tools/make_tactile_pairs.py [--out DIR] [--seed N] [--workers N] [--tiles N] [--sheet FILE] [--only-sheet]
Shards that are there already are kept: a stopped run goes on where it was. Afterwards a contact sheet is drawn.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
os.environ.setdefault("OMP_NUM_THREADS", "1")

from contact_sheet import make_contact_sheet
from PIL import Image

from hnf_core.datasets.pair_generation import (
    PairSizes,
    write_pairs,
)


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "tactile-pairs", help="folder of the shards")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes")
    parser.add_argument("--tiles", type=int, default=PairSizes().train, help="training tiles, four views each")
    parser.add_argument("--sheet", type=Path, help="picture to draw; default: contact-sheet.png in the folder")
    parser.add_argument("--only-sheet", action="store_true", help="draw the contact sheet, write no shards")
    arguments = parser.parse_args()
    if not arguments.only_sheet:
        started = time.monotonic()

        def report_progress(done: int, total: int) -> None:
            print(f"{time.monotonic() - started:6.0f} s  {done}/{total} shards", file=sys.stderr, flush=True)

        write_pairs(arguments.out, PairSizes(train=arguments.tiles), arguments.seed, arguments.workers, report_progress)
    sheet = arguments.sheet or arguments.out / "contact-sheet.png"
    sheet.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(make_contact_sheet(arguments.seed)).save(sheet)
    print(sheet)
    return 0


if __name__ == "__main__":
    sys.exit(main())
