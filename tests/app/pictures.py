"""Take the documentation's pictures of the real thing from the last run of the windowed tests.

    make test-app && .venv/bin/python tests/app/pictures.py [NAME…]

Each picture of docs/images/ui is a cut of one screen that a scenario photographed; look at it before committing it.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
TAKEN = ROOT / "build" / "app"
SHOWN = ROOT / "docs" / "images" / "ui"
LARGEST_BYTES = 200_000
EXACT_BYTES = 100_000
"""Above this a picture gets a palette, which may take rare colours from it."""
COLOURS = 255


@dataclass(frozen=True)
class Cut:
    """source: SCENARIO/PICTURE below build/app. box: left, top, right, bottom [pixels]; None: the whole screen."""

    source: str
    box: tuple[int, int, int, int] | None = None


CHOSEN: dict[str, Cut] = {
    "first-install": Cut("dropping/zip-dropped", (130, 310, 590, 500)),
    "first-new-file": Cut("tutorial/new-file", (300, 55, 1116, 840)),
    "first-choose": Cut("tutorial/choose", (600, 55, 1236, 750)),
    "first-drawing": Cut("tutorial/drawing", (0, 55, 1116, 900)),
    "first-baking": Cut("tutorial/baking", (830, 80, 1090, 200)),
    "first-preview": Cut("tutorial/heard", (830, 86, 1090, 412)),
    "first-harder": Cut("tutorial/harder", (0, 55, 1116, 1465)),
    "first-compared": Cut("tutorial/harder-alone", (1075, 84, 1332, 412)),
    "first-sequencer": Cut("tutorial/sequencer", (0, 915, 1116, 1465)),
    "panel-bake-preview": Cut("panels/scrubbed-2", (385, 168, 990, 884)),
    "panel-materials": Cut("panels/used-1", (718, 936, 1021, 1232)),
    "panel-strokes": Cut("panels/used-1", (718, 446, 1021, 932)),
    "panel-export": Cut("panels/used-2", (718, 905, 1021, 1421)),
    "panel-actuator": Cut("actuator/playing", (766, 774, 1020, 1268)),
    "assets": Cut("extension/asset-browser", (250, 55, 922, 188)),
    "learn": Cut("learning/dialog-filled", (500, 488, 960, 700)),
    "preferences": Cut("learning/python-found", (176, 310, 1046, 606)),
    "tool-settings": Cut("tutorial/drawing", (0, 55, 1116, 82)),
}
"""Name in docs/images/ui → where it comes from."""


def cut(name: str) -> Path:
    """Write docs/images/ui/NAME.png. Raises FileNotFoundError before the scenario was played, ValueError if too big."""
    chosen = CHOSEN[name]
    with Image.open(TAKEN / f"{chosen.source}.png") as screen:
        picture = screen.convert("RGB").crop(chosen.box or (0, 0, *screen.size))
    SHOWN.mkdir(parents=True, exist_ok=True)
    path = SHOWN / f"{name}.png"
    picture.save(path, optimize=True)
    if path.stat().st_size > EXACT_BYTES:
        # A user interface has few colours: a palette without dithering keeps letters sharp at a third of the size.
        picture.quantize(COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)
    if path.stat().st_size > LARGEST_BYTES:
        raise ValueError(f"{path} has {path.stat().st_size} bytes, more than {LARGEST_BYTES}. Cut it smaller.")
    return path


def main(names: list[str]) -> int:
    """Cut the pictures of these names, or all; 2 for a name that is none."""
    unknown = [name for name in names if name not in CHOSEN]
    if unknown:
        print(f"No picture is called {', '.join(unknown)}. There are: {', '.join(CHOSEN)}.", file=sys.stderr)
        return 2
    for name in names or CHOSEN:
        path = cut(name)
        print(f"{path.relative_to(ROOT)}  {path.stat().st_size // 1000} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
