"""Image of a stroke for the panel: waveform, spectrogram, force and speed over one time axis.

A signal and its action (direction, speed and force over time) go in, a (512, 512, 4) RGBA array comes out; a 5 × 7 dot
font labels the axes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.action import Action
from hnf_core.export.plots.figure import compute_spectrogram
from hnf_core.signal import Signal
from hnf_core.units import m_to_mm, power_to_db

GLYPH_HEIGHT, GLYPH_ADVANCE = 7, 6
"""Height and advance of a glyph [dots]."""

_GLYPH_COLUMNS = {
    "0": "3E5149453E", "1": "00427F4000", "2": "4261514946", "3": "2141454B31", "4": "1814127F10", "5": "2745454539",
    "6": "3C4A494930", "7": "0171090503", "8": "3649494936", "9": "064949291E", ".": "0060600000", "-": "0808080808",
    "+": "08083E0808", "/": "2010080402", "m": "7C04180478", "s": "4854545424", "N": "7F0408107F", "H": "7F0808087F",
    "z": "4464544C44", "k": "007F102844", "d": "384444487F", "B": "7F49494936", "A": "7C1211127C", "²": "00090D0A00",
    "±": "44445F4444", "l": "00417F4000", "i": "00447D4000", "t": "043F444020", "e": "3854545418", "r": "7C08040408",
    "o": "3844444438", "c": "3844444420", "p": "7C14141408", "a": "2054545478", "n": "7C08040478", "g": "0C5252523E",
    "u": "3C4040207C", "f": "087E090102", "h": "7F08040478", "v": "1C2040201C", "w": "3C4030403C", "b": "7F48444438",
    "y": "0C5050503C", "x": "4428102844", "%": "2313086462", " ": "0000000000",
}  # fmt: skip
"""Five bytes per glyph, one per column; bit 0 is the top row."""


def rasterise_text(text: str) -> NDArray[np.bool_]:
    """Return a mask (7, 6 · len) of a text in a 5 × 7 dot font, True for ink, the top row first.

    Raises KeyError for a character without a glyph.
    """
    columns = [bytes.fromhex(_GLYPH_COLUMNS[character]) + b"\0" for character in text]
    lines = np.frombuffer(b"".join(columns), np.uint8)
    return np.asarray((lines[None, :] >> np.arange(GLYPH_HEIGHT)[:, None]) & 1, dtype=bool)


Rgba = NDArray[np.float32]
Colour = tuple[float, float, float]

SIZE_PX = 512
"""Width and height of the image [px]."""
RANGE_DB = 50.0
"""Dynamic range of the spectrogram [dB]."""
HIGHEST_HZ = 1000.0
"""Upper end of the spectrogram's frequency axis [Hz]."""
LOWEST_HZ = 20.0
"""Lower end of its logarithmic frequency axis [Hz]."""
WAVE_ROWS, SPECTROGRAM_ROWS, ACTION_ROWS = (8, 172), (184, 388), (400, 504)
"""Rows of the three tracks from the top [px]."""
GLYPH_SCALE = 3
"""Pixels per dot; legible at 0.4 of the size, as in a sidebar of usual width."""


@dataclass(frozen=True)
class Theme:
    """Colors of the image, 0 to 1 each; force and speed have the hues of plots by `hnf_core.export.plots.figure`."""

    back: Colour
    ink: Colour
    faint: Colour
    wave: Colour
    limit: Colour
    force: Colour
    speed: Colour


DARK = Theme((0.11, 0.11, 0.12), (0.92, 0.92, 0.92), (0.30, 0.30, 0.32), (0.36, 0.72, 1.0), (1.0, 0.36, 0.30),
             (1.0, 0.66, 0.25), (0.36, 0.85, 0.72))  # fmt: skip
LIGHT = Theme((0.96, 0.96, 0.96), (0.10, 0.10, 0.10), (0.74, 0.74, 0.76), (0.08, 0.38, 0.74), (0.80, 0.10, 0.06),
              (0.66, 0.31, 0.0), (0.0, 0.46, 0.335))  # fmt: skip


@dataclass(frozen=True)
class ImageStyle:
    """Style of the image of a stroke.

    Attributes
    ----------
    theme : Theme
        Colors.
    limit_m_s2 : float or None
        Largest acceleration of the actuator, drawn as two dashed lines [m/s²].
    logarithmic : bool
        Frequency axis from 20 Hz to 1 kHz by octaves instead of linear from 0 to 1 kHz.
    """

    theme: Theme = DARK
    limit_m_s2: float | None = None
    logarithmic: bool = False


def draw_stroke_image(signal: Signal, action: Action, style: ImageStyle) -> Rgba:
    """Draw a signal and its action (force and speed); return (512, 512, 4) float32 RGBA in 0–1, bottom row first."""
    theme = style.theme
    canvas = np.empty((SIZE_PX, SIZE_PX, 4), dtype=np.float32)
    canvas[..., :3], canvas[..., 3] = theme.back, 1.0
    draw_wave(canvas[slice(*WAVE_ROWS)], signal, theme, style.limit_m_s2)
    draw_spectrogram(canvas[slice(*SPECTROGRAM_ROWS)], signal, theme, style.logarithmic)
    draw_action(canvas[slice(*ACTION_ROWS)], action, theme)
    return np.ascontiguousarray(canvas[::-1])


def compute_column_extrema(
    samples: NDArray[np.float32], columns: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the minimum and maximum of the samples in each of `columns` equal intervals, (columns,) each.

    No peak is lost, whatever the width.
    """
    if len(samples) == 0:
        return np.zeros(columns), np.zeros(columns)
    edges = np.linspace(0, len(samples), columns + 1)
    starts = np.minimum(edges[:-1].astype(int), len(samples) - 1)
    low, high = np.minimum.reduceat(samples, starts), np.maximum.reduceat(samples, starts)
    return low.astype(np.float64), high.astype(np.float64)


def round_up_nicely(value: float) -> float:
    """Round up to 1, 2 or 5 times a power of ten."""
    if not value > 0.0:
        return 1.0
    decade = 10.0 ** np.floor(np.log10(value))
    return float(next(step * decade for step in (1.0, 2.0, 5.0, 10.0, 20.0) if step * decade >= value * (1.0 - 1e-9)))


def draw_wave(area: Rgba, signal: Signal, theme: Theme, limit_m_s2: float | None) -> None:
    """Draw the acceleration [m/s²] over time, scaled to a round number above its peak."""
    rows, width = area.shape[:2]
    peak = float(np.abs(signal.samples).max(initial=0.0))
    scale = round_up_nicely(peak)

    def to_row(value: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray((rows - 1) * (0.5 - 0.5 * np.clip(value / scale, -1.0, 1.0)))

    low, high = compute_column_extrema(signal.samples, width)
    y = np.arange(rows)[:, None]
    area[rows // 2, :, :3] = theme.faint
    ink = (y >= np.floor(to_row(high))[None]) & (y <= np.ceil(to_row(low))[None])
    area[ink, :3] = theme.wave
    if limit_m_s2 is not None and limit_m_s2 <= scale:
        for side in (limit_m_s2, -limit_m_s2):
            row = int(to_row(np.array(side)))
            area[row : row + 2, np.arange(width) % 12 < 8, :3] = theme.limit
    draw_text(area, f"±{_format_value(scale)} m/s²", 4, 4, theme.ink, theme.back)
    if limit_m_s2 is not None:
        draw_text(area, f"limit {_format_value(limit_m_s2)}", width - 4, 4, theme.limit, theme.back, right=True)


def draw_spectrogram(area: Rgba, signal: Signal, theme: Theme, logarithmic: bool = False) -> None:
    """Draw the power density over RANGE_DB [dB], with faint lines at 200 Hz intervals or at 50, 100, 200 and 500 Hz."""
    rows, width = area.shape[:2]
    spectrogram = compute_spectrogram(signal)
    level = power_to_db(np.maximum(spectrogram.power, 1e-30))
    shade = np.clip(1.0 + (level - level.max()) / RANGE_DB, 0.0, 1.0) if signal.rms > 0.0 else np.zeros_like(level)
    height = 1.0 - np.arange(rows) / (rows - 1)
    frequency = LOWEST_HZ * (HIGHEST_HZ / LOWEST_HZ) ** height if logarithmic else HIGHEST_HZ * height
    row = np.clip(np.rint(frequency / spectrogram.frequency[1]).astype(int), 0, len(spectrogram.frequency) - 1)
    time = (np.arange(width) + 0.5) / width * max(signal.duration_s, 1e-6)
    hop = spectrogram.time[1] - spectrogram.time[0] if len(spectrogram.time) > 1 else 1.0
    column = np.clip(np.rint((time - spectrogram.time[0]) / hop).astype(int), 0, len(spectrogram.time) - 1)
    area[..., :3] = map_heat_colours(shade[row][:, column], theme)
    for mark in (50.0, 100.0, 200.0, 500.0) if logarithmic else (200.0, 400.0, 600.0, 800.0):
        line_row = int(np.argmin(np.abs(frequency - mark)))
        area[line_row, ::4, :3] = theme.faint
        if mark in ((500.0,) if logarithmic else (400.0, 800.0)):
            continue  # No room for its label.
        draw_text(
            area, f"{mark:g}", width - 4, line_row - GLYPH_HEIGHT * GLYPH_SCALE // 2, theme.ink, theme.back, right=True
        )
    draw_text(area, "1 kHz", width - 4, 4, theme.ink, theme.back, right=True)
    draw_text(area, f"dB 0 to -{RANGE_DB:g}", 4, 4, theme.ink, theme.back)


def draw_action(area: Rgba, action: Action, theme: Theme) -> None:
    """Draw force [N] and speed [mm/s] over time, each from 0 to a round number of its own."""
    rows, width = area.shape[:2]
    area[rows - 1, :, :3] = theme.faint
    texts = []
    for values, unit, colour in ((m_to_mm(1.0) * action.speed, "mm/s", theme.speed), (action.force, "N", theme.force)):
        scale = round_up_nicely(float(values.max(initial=0.0)))
        curve = np.interp(np.linspace(0.0, len(values) - 1.0, width), np.arange(len(values)), values) / scale
        curve_row = np.rint((rows - 3) * (1.0 - np.clip(curve, 0.0, 1.0))).astype(int)
        previous_row = np.concatenate([curve_row[:1], curve_row[:-1]])
        y = np.arange(rows)[:, None]
        area[(y >= np.minimum(curve_row, previous_row)) & (y <= np.maximum(curve_row, previous_row) + 1), :3] = colour
        texts.append((f"{_format_value(scale)} {unit}", colour))
    draw_text(area, texts[1][0], 4, 4, texts[1][1], theme.back)
    draw_text(area, texts[0][0], width - 4, 4, texts[0][1], theme.back, right=True)


def map_heat_colours(shade: NDArray[np.float64], theme: Theme) -> NDArray[np.float32]:
    """Map 0–1 to colors (…, 3): from the background through blue and orange to the ink."""
    stops = np.array([theme.back, theme.wave, theme.force, theme.ink])
    positions = np.array([0.0, 0.45, 0.8, 1.0])
    return np.stack([np.interp(shade, positions, stops[:, k]) for k in range(3)], axis=-1).astype(np.float32)


def draw_text(area: Rgba, text: str, left: int, top: int, colour: Colour, back: Colour, *, right: bool = False) -> None:
    """Draw text at (left, top) [px] on a painted background, or right-aligned at `left`."""
    ink = np.kron(rasterise_text(text), np.ones((GLYPH_SCALE, GLYPH_SCALE), dtype=bool))
    rows, columns = ink.shape
    if right:
        left -= GLYPH_ADVANCE * GLYPH_SCALE * len(text)
    top, left = max(top, 0), max(left, 0)
    region = area[top : top + rows, left : left + columns]
    region[..., :3] = back
    region[ink[: region.shape[0], : region.shape[1]], :3] = colour


def _format_value(value: float) -> str:
    return f"{value:.3g}" if value < 1000.0 else f"{value:.0f}"
