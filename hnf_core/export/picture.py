"""One picture of a stroke: where the hand went, what it did, and what was felt."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from ..action.action import Action
from ..signal import Signal
from ..tactile.tactile_map import TactileMap
from .figure import write_figure
from .map_picture import stretch_contrast
from .path_on_view import StrokeView, draw_path
from .rows import wrap_lines
from .srgb import linear_to_srgb
from .tracks import MUTED, TRACKS_BOTTOM, draw_spectrum, draw_tracks

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SIZE_PX = (1600, 1000)
LEFT_MARGIN = 0.025
MAX_FACT_ROWS = 13
"""Of facts, under a view of 16 to 9: down to the lower edge of the tracks."""
MAP_WIDTH = 0.1
"""Of a tactile map, as a share of the picture's width."""


def write_stroke_figure(
    path: Path,
    *,
    title: str,
    action: Action,
    signal: Signal,
    view: StrokeView | None = None,
    tactile: TactileMap | None = None,
    facts: Mapping[str, str] | None = None,
    frequency_scale: Literal["linear", "log"] = "linear",
    highest_hz: float = 1000.0,
) -> None:
    """Draw a stroke into a PNG of 1600 × 1000 pixels, atomically: the view with the stroke coloured by force, and on
    one time axis force [N], speed [mm/s], acceleration [m/s²] and its spectrogram [dB re 1 (m/s²)²/Hz].

    facts: label → text lines below the view (material, routes, confidence, …); seed, duration and RMS are added.
    tactile: what a touch sensor sees of the surface, shown beside them with its route and its contrast raised.
    Equal input gives equal bytes with one version of matplotlib. No display and no global figure is used.
    Raises FileError where matplotlib is missing or the file cannot be written.
    """

    def draw(figure: Figure) -> None:
        figure.text(LEFT_MARGIN, 0.955, _truncate(title, 90), fontsize=19, fontweight="bold", va="center")
        end = _draw_view(figure, view, tactile, _list_facts(signal, facts or {}))
        if end - TRACKS_BOTTOM > 0.14:
            draw_spectrum(
                figure, signal, (LEFT_MARGIN + 0.035, TRACKS_BOTTOM, 0.44, min(end - TRACKS_BOTTOM - 0.035, 0.3))
            )
        draw_tracks(figure, action, signal, frequency_scale, highest_hz)

    write_figure(path, SIZE_PX, draw)


def _list_facts(signal: Signal, facts: Mapping[str, str]) -> list[tuple[str, str]]:
    own = {
        "Strength": f"{signal.rms:.3g} m/s² RMS, peak {np.abs(signal.samples).max(initial=0.0):.3g} m/s²",
        "Signal": f"{signal.duration_s:.2f} s at {signal.sample_rate:g} Hz, seed {signal.seed}",
    }
    return [(label, text) for label, text in {**facts, **own}.items()]


def _truncate(text: str, max_length: int) -> str:
    text = " ".join(text.split())
    return text if len(text) <= max_length else text[: max_length - 1] + "…"


def _draw_view(
    figure: Figure, view: StrokeView | None, tactile: TactileMap | None, lines: list[tuple[str, str]]
) -> float:
    """The view as large as fits in the left column, its colour bar, and the facts and tactile map below. Returns where
    they end."""
    left, top, width, line = LEFT_MARGIN, 0.915, 0.475, 0.025
    letters = 82 if tactile is None else 56
    rows = wrap_lines(lines, letters, MAX_FACT_ROWS)
    below = max(line * len(rows), 0.0 if tactile is None else MAP_WIDTH * SIZE_PX[0] / SIZE_PX[1] + 2 * line)
    bottom = top
    if view is not None:
        height, columns = view.rgb.shape[:2]
        room = top - 0.1 - below - 0.05
        tallest = width * SIZE_PX[0] * height / columns / SIZE_PX[1]
        share = min(1.0, room / tallest)
        bottom = top - tallest * share
        axes = figure.add_axes((left + width * (1 - share) / 2, bottom, width * share, tallest * share))
        axes.imshow(linear_to_srgb(view.rgb), extent=(0, columns, height, 0), interpolation="antialiased")
        axes.set(xlim=(0, columns), ylim=(height, 0), xticks=[], yticks=[])
        axes.grid(False)
        draw_path(figure, axes, view, (left, bottom - 0.028, width, 0.014))
        bottom -= 0.085
    for number, (label, row) in enumerate(rows):
        y = bottom - 0.02 - line * number
        if number == 0 or label != rows[number - 1][0]:
            figure.text(left, y, _truncate(label, 14), color=MUTED)
        figure.text(left + 0.085, y, row)
    if tactile is not None:
        _draw_map(figure, tactile, left + width - MAP_WIDTH, bottom)
    return bottom - below


def _draw_map(figure: Figure, tactile: TactileMap, left: float, top: float) -> None:
    """A square with its upper edge at top, and below it where the map comes from and how wide it is."""
    tall = MAP_WIDTH * SIZE_PX[0] / SIZE_PX[1]
    axes = figure.add_axes((left, top - tall, MAP_WIDTH, tall))
    axes.imshow(linear_to_srgb(stretch_contrast(tactile)), interpolation="antialiased")
    axes.set(xticks=[], yticks=[])
    axes.grid(False)
    wide = tactile.image.shape[1] * tactile.metres_per_pixel * 1e3
    said = f"{tactile.route.value} relief, {wide:.3g} mm"
    figure.text(left + MAP_WIDTH / 2, top - tall - 0.02, said, color=MUTED, ha="center", fontsize=9)
