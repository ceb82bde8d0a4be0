"""A tactile map for people to look at: its contrast raised, with a scale bar and what it shows."""

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
"""Of text below the map: down to the lower edge."""
CONTRAST_TARGET = 0.2
"""How far the strongest percent of a map's pixels is drawn from its mean: its own contrast is that of a gel."""
MAX_BAR_SHARE = 0.4
"""Of the map's width, that the scale bar does not exceed."""


def compute_contrast_gain(tactile: TactileMap) -> float:
    """By how much the contrast is raised; 1 where it is strong enough."""
    seen = np.asarray(tactile.image, dtype=np.float64)[tactile.mask]
    spread = float(np.percentile(np.abs(seen - seen.mean(axis=0)), 99)) if len(seen) else 0.0
    return max(1.0, CONTRAST_TARGET / max(spread, 1e-3))


def stretch_contrast(tactile: TactileMap) -> NDArray[np.float64]:
    """(H, W, 3) linear, gain_of as far from its mean; what is not seen is the mean."""
    image = np.asarray(tactile.image, dtype=np.float64)
    seen = image[tactile.mask]
    mean = seen.mean(axis=0) if len(seen) else image.mean(axis=(0, 1))
    return np.where(tactile.mask[..., None], mean + (image - mean) * compute_contrast_gain(tactile), mean)


def write_tactile_map_figure(path: Path, tactile: TactileMap, title: str, facts: Sequence[str] = ()) -> None:
    """Draw a tactile map into a PNG of 640 × 800 pixels, atomically: enlarged, with a scale bar [mm], and below it what
    sensor and light it is, how far its contrast is raised, and facts, a paragraph each, fewer than MOST_ROWS. What has
    no room is cut short, with a mark.

    Equal input gives equal bytes with one version of matplotlib. Raises FileError where matplotlib is missing or the
    file cannot be written.
    """

    def draw(figure: Figure) -> None:
        figure.text(
            0.05, 0.965, textwrap.shorten(title, 52, placeholder=" …"), fontsize=14, fontweight="bold", va="top"
        )
        _draw_map(figure, tactile)
        said = [("", text) for text in (_describe_map(tactile), *facts)]
        for number, (_, row) in enumerate(wrap_lines(said, 82, MAX_TEXT_ROWS)):
            figure.text(0.05, 0.165 - 0.024 * number, row, fontsize=9.5, color=MUTED, va="top")

    write_figure(path, SIZE_PX, draw)


def choose_bar_length_mm(width_mm: float) -> float:
    """The longest of 1, 2, 5 times a power of ten that is BAR_SHARE of width_mm at most."""
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
    long, left, low = millimetres / m_to_mm(tactile.metres_per_pixel), 0.04 * width, 0.95 * height
    back = Rectangle((left - 0.015 * width, low - 0.055 * height), long + 0.03 * width, 0.08 * height)
    back.set(fc="white", ec="none", alpha=0.85)
    axes.add_patch(back)
    axes.add_patch(Rectangle((left, low), long, 0.012 * height, fc=INK, ec="none"))
    axes.text(left + long / 2, low - 0.008 * height, f"{millimetres:g} mm", ha="center", va="bottom", color=INK)


def _describe_map(tactile: TactileMap) -> str:
    gain, wide = compute_contrast_gain(tactile), m_to_mm(tactile.image.shape[1] * tactile.metres_per_pixel)
    raised = f"; contrast raised {gain:.2g}-fold" if gain > 1.0 else ""
    return (
        f"What a {tactile.sensor} touch sensor would see of the surface: relief lit from the sides, "
        f"{wide:.3g} mm wide, {tactile.route.value}{raised}."
    )
