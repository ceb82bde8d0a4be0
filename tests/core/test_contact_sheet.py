"""The contact sheet: every category from what is seen to what is touched, in a file that others can read."""

from __future__ import annotations

import struct
import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest
from contact_sheet import GAP, make_tile_row, make_view_images

from hnf_core.datasets.pair_generation import PairSizes, list_tile_requests, make_tile
from hnf_core.datasets.tactile_pairs import TRAIN
from hnf_core.export.png import encode_colour_png

ROOT = Path(__file__).resolve().parents[2]


def pixels_of(data: bytes) -> np.ndarray:
    """(H, W, 3) of a PNG as colour_png writes it."""
    width, height, depth, kind = struct.unpack(">IIBB", data[16:26])
    assert (depth, kind) == (8, 2)
    start = data.index(b"IDAT")
    size = struct.unpack(">I", data[start - 4 : start])[0]
    rows = np.frombuffer(zlib.decompress(data[start + 4 : start + 4 + size]), np.uint8).reshape(height, 1 + 3 * width)
    assert not rows[:, 0].any()
    return rows[:, 1:].reshape(height, width, 3)


def test_a_colour_png_holds_its_pixels() -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (5, 7, 3), dtype=np.uint8)
    assert np.array_equal(pixels_of(encode_colour_png(pixels)), pixels)


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
    pixels = pixels_of(sheet.read_bytes())
    assert pixels.shape == (13 * 64 + 12 * GAP, 10 * 64 + 9 * GAP, 3)
    assert not (tmp_path / "pairs").exists()
