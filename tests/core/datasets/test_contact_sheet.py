"""The contact sheet: every category from what is seen to what is touched, in a file that others can read."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from contact_sheet import GAP, make_tile_row, make_view_images
from PIL import Image

from hnf_core.datasets.pair_generation import PairSizes, list_tile_requests, make_tile
from hnf_core.datasets.tactile_pairs import TRAIN

ROOT = Path(__file__).resolve().parents[3]


def test_a_row_shows_look_depth_height_and_two_sensors() -> None:
    pairs = make_tile(list_tile_requests(TRAIN, PairSizes(train=1), 0)[0])
    look, depth, height, gelsight, digit = make_view_images(pairs, 2)
    assert np.array_equal(look, pairs.rgb[2])
    assert make_tile_row(pairs).shape == (64, 10 * 64 + 9 * GAP, 3)
    for picture in (depth, height):
        assert np.array_equal(picture[..., 0], picture[..., 2])
    # What stands nearer is lighter, in depth as in height.
    near = np.unravel_index(np.argmin(pairs.depth[2]), (64, 64))
    assert depth[near][0] == depth.max()
    high = np.unravel_index(np.argmax(pairs.height[2]), (64, 64))
    assert height[high][0] == height.max()
    assert not np.array_equal(gelsight, digit)


@pytest.mark.timeout(60)
def test_the_tool_draws_every_category(tmp_path: Path) -> None:
    sheet = tmp_path / "sheet.png"
    command = [sys.executable, str(ROOT / "tools" / "make_tactile_pairs.py"), "--only-sheet", "--sheet", str(sheet)]
    subprocess.run([*command, "--out", str(tmp_path / "pairs")], check=True, capture_output=True, timeout=60)
    pixels = np.asarray(Image.open(sheet))
    assert pixels.shape == (13 * 64 + 12 * GAP, 10 * 64 + 9 * GAP, 3)
    assert not (tmp_path / "pairs").exists()
