"""A tactile map's picture: its contrast can be seen, its size is told, and any map gives one."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hnf_core.export import figure as module
from hnf_core.export.figure import (
    INK,
    choose_bar_length_mm,
    compute_contrast_gain,
    stretch_contrast,
    write_tactile_map_figure,
)
from hnf_core.tactile.tactile_map import Route, TactileMap

image = pytest.importorskip("matplotlib.image", reason="pictures need matplotlib")

PITCH_M = 20e-3 / 128
MAP = (slice(64, 640), slice(32, 608))
"""Rows and columns of the map in the picture."""


def grooves(contrast: float, mask: np.ndarray | None = None) -> TactileMap:
    """Eight pixels a groove, lit from either side."""
    side = np.where(np.arange(128) // 4 % 2 == 0, contrast, -contrast)
    lit = 0.5 + np.broadcast_to(side[None, :, None] * np.array([1.0, -1.0, 0.0]), (128, 128, 3))
    seen = np.ones((128, 128), bool) if mask is None else mask
    return TactileMap(lit.astype(np.float32), None, seen, PITCH_M, "gelsight", 2 * PITCH_M, Route.MEASURED)


def drawn(path: Path, tactile: TactileMap, title: str = "Probe A", facts: tuple[str, ...] = ()) -> np.ndarray:
    write_tactile_map_figure(path, tactile, title, facts)
    pixels = image.imread(io.BytesIO(path.read_bytes()), format="png")[..., :3]
    assert pixels.shape == (800, 640, 3)
    return pixels


@pytest.mark.parametrize("contrast", [0.004, 0.02, 0.4])
def test_a_faint_relief_is_seen_as_well_as_a_strong_one(tmp_path: Path, contrast: float) -> None:
    pixels = drawn(tmp_path / "a.png", grooves(contrast))[MAP]
    assert np.ptp(np.percentile(pixels[..., 0], [10, 90])) > 0.25
    assert compute_contrast_gain(grooves(contrast)) == pytest.approx(max(1.0, 0.2 / contrast), rel=1e-4)


def test_the_bar_is_as_long_as_it_says(tmp_path: Path) -> None:
    """20 mm are 576 pixels wide: 5 mm are 144."""
    flat = drawn(tmp_path / "a.png", grooves(0.0))[MAP]
    ink = np.array([int(INK[at : at + 2], 16) for at in (1, 3, 5)]) / 255.0
    longest = (np.abs(flat - ink).max(axis=2) < 0.05).sum(axis=1).max()
    assert longest == pytest.approx(144, abs=3)


@pytest.mark.parametrize("wide_mm", [0.3, 1.0, 4.9, 5.0, 20.0, 49.0, 700.0])
def test_a_bar_is_a_round_number_that_fits(wide_mm: float) -> None:
    assert 0.15 * wide_mm <= choose_bar_length_mm(wide_mm) <= 0.4 * wide_mm
    assert f"{choose_bar_length_mm(wide_mm):.0e}"[0] in "125"


def test_what_is_not_seen_is_even() -> None:
    mask = np.zeros((128, 128), bool)
    mask[:, :64] = True
    assert np.ptp(stretch_contrast(grooves(0.02, mask))[~mask], axis=0).max() == 0.0
    assert np.ptp(stretch_contrast(grooves(0.02, mask))[mask], axis=0).max() > 0.3


def test_names_are_no_markup_and_any_mask_gives_a_picture(tmp_path: Path) -> None:
    nothing = grooves(0.02, np.zeros((128, 128), bool))
    drawn(tmp_path / "a.png", nothing, title="$\\frac{" + "x" * 200, facts=("y " * 400, "$^$"))


def words_of(monkeypatch: pytest.MonkeyPatch, *facts: str) -> list[str]:
    """The rows below the map."""
    from matplotlib.figure import Figure

    said: list[str] = []

    def drawn(path: Path, size_px: tuple[int, int], draw: Callable[[Figure], None]) -> None:
        figure = Figure(figsize=(size_px[0] / 100, size_px[1] / 100), dpi=100)
        draw(figure)
        said.extend(text.get_text() for text in figure.texts[1:])

    monkeypatch.setattr(module, "write_figure", drawn)
    write_tactile_map_figure(Path("a.png"), grooves(0.02), "Probe A", facts)
    return said


def test_what_is_cut_is_marked_and_every_paragraph_is_there(monkeypatch: pytest.MonkeyPatch) -> None:
    source, material = "Relief from: " + " and ".join(f"word{number}" for number in range(80)), "Bark → oak; 3 µm RMS."
    rows = words_of(monkeypatch, source, material)
    assert len(rows) == 7
    assert [row.endswith(" …") for row in rows] == [False] * 5 + [True, False]
    assert rows[-1] == material
    assert source.startswith(" ".join(rows[2:-1]).removesuffix(" …"))
    short = words_of(monkeypatch, source[:200], material)
    assert " ".join(short).endswith(f"{source[:200]} {material}")


def test_equal_maps_give_equal_bytes(tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        drawn(tmp_path / name, grooves(0.02), facts=("Relief from: a bump.",))
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
