"""Draw a tactile map for people: contrast stretched, with a scale bar and a description."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ...tactile.tactile_map import TactileMap
from ...units import linear_to_srgb, m_to_mm
from .figure import INK, MUTED, wrap_lines, write_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SIZE_PX = (640, 800)
MAX_TEXT_ROWS = 7
"""Most rows of text below the map, down to the lower edge."""
CONTRAST_TARGET = 0.2
"""Distance from the mean that the strongest percent of pixels is stretched to; the contrast of a gel is much smaller.
"""
MAX_BAR_SHARE = 0.4
"""Largest length of the scale bar, as a fraction of the map's width."""


def compute_contrast_gain(tactile: TactileMap) -> float:
    """Return the factor by which the contrast is raised; 1 if it is strong enough."""
    covered = np.asarray(tactile.image, dtype=np.float64)[tactile.mask]
    spread = float(np.percentile(np.abs(covered - covered.mean(axis=0)), 99)) if len(covered) else 0.0
    return max(1.0, CONTRAST_TARGET / max(spread, 1e-3))


def stretch_contrast(tactile: TactileMap) -> NDArray[np.float64]:
    """Return the map with its contrast raised, (H, W, 3) linear; pixels outside the mask are the mean."""
    image = np.asarray(tactile.image, dtype=np.float64)
    covered = image[tactile.mask]
    mean = covered.mean(axis=0) if len(covered) else image.mean(axis=(0, 1))
    return np.where(tactile.mask[..., None], mean + (image - mean) * compute_contrast_gain(tactile), mean)


def write_tactile_map_figure(path: Path, tactile: TactileMap, title: str, facts: Sequence[str] = ()) -> None:
    """Draw a tactile map into a PNG of 640 × 800 pixels, atomically: enlarged, with a scale bar [mm] and text below.

    Parameters
    ----------
    path : Path
        File to write.
    tactile : TactileMap
        The map; sensor, light and contrast gain are described below it.
    title : str
        Title; long ones are cut.
    facts : sequence of str
        More paragraphs. Text beyond `MAX_TEXT_ROWS` rows is cut, with a mark.

    Raises
    ------
    FileError
        If matplotlib is missing or the file cannot be written.

    Notes
    -----
    Equal input gives equal bytes with one version of matplotlib.
    """

    def draw(figure: Figure) -> None:
        figure.text(
            0.05, 0.965, textwrap.shorten(title, 52, placeholder=" …"), fontsize=14, fontweight="bold", va="top"
        )
        _draw_map(figure, tactile)
        paragraphs = [("", text) for text in (_describe_map(tactile), *facts)]
        for number, (_, row) in enumerate(wrap_lines(paragraphs, 82, MAX_TEXT_ROWS)):
            figure.text(0.05, 0.165 - 0.024 * number, row, fontsize=9.5, color=MUTED, va="top")

    write_figure(path, SIZE_PX, draw)


def choose_bar_length_mm(width_mm: float) -> float:
    """Return the longest of 1, 2, 5 times a power of ten that is at most `MAX_BAR_SHARE` of `width_mm`."""
    decade = 10.0 ** np.floor(np.log10(MAX_BAR_SHARE * width_mm))
    return float(max(step * decade for step in (1.0, 2.0, 5.0) if step * decade <= MAX_BAR_SHARE * width_mm))


def _draw_map(figure: Figure, tactile: TactileMap) -> None:
    from matplotlib.patches import Rectangle

    height, width = tactile.image.shape[:2]
    axes = figure.add_axes((0.05, 0.2, 0.9, 0.72))
    axes.imshow(linear_to_srgb(stretch_contrast(tactile)), extent=(0, width, height, 0), interpolation="nearest")
    axes.set(xticks=[], yticks=[])
    axes.grid(False)
    millimetres = choose_bar_length_mm(m_to_mm(width * tactile.metres_per_pixel))
    length, left, bottom = millimetres / m_to_mm(tactile.metres_per_pixel), 0.04 * width, 0.95 * height
    background = Rectangle((left - 0.015 * width, bottom - 0.055 * height), length + 0.03 * width, 0.08 * height)
    background.set(fc="white", ec="none", alpha=0.85)
    axes.add_patch(background)
    axes.add_patch(Rectangle((left, bottom), length, 0.012 * height, fc=INK, ec="none"))
    axes.text(left + length / 2, bottom - 0.008 * height, f"{millimetres:g} mm", ha="center", va="bottom", color=INK)


def _describe_map(tactile: TactileMap) -> str:
    gain, width_mm = compute_contrast_gain(tactile), m_to_mm(tactile.image.shape[1] * tactile.metres_per_pixel)
    raised = f"; contrast raised {gain:.2g}-fold" if gain > 1.0 else ""
    return (
        f"What a {tactile.sensor} touch sensor would see of the surface: relief lit from the sides, "
        f"{width_mm:.3g} mm wide, {tactile.route.value}{raised}."
    )
