"""Five by seven dots: the few characters that the preview's pictures need.

What a stroke feels like, drawn for a panel: waveform, spectrogram, force and speed over one time axis.
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


def rasterise_text(text: str) -> NDArray[np.bool_]:
    """(7, 6 · len) True where there is ink, the top row first. Raises KeyError for a character without a shape."""
    columns = [bytes.fromhex(_GLYPH_COLUMNS[character]) + b"\0" for character in text]
    lines = np.frombuffer(b"".join(columns), np.uint8)
    return np.asarray((lines[None, :] >> np.arange(GLYPH_HEIGHT)[:, None]) & 1, dtype=bool)


Rgba = NDArray[np.float32]
Colour = tuple[float, float, float]

SIZE_PX = 512
RANGE_DB = 50.0
HIGHEST_HZ = 1000.0
LOWEST_HZ = 20.0
WAVE_ROWS, SPECTROGRAM_ROWS, ACTION_ROWS = (8, 172), (184, 388), (400, 504)
"""Rows of the three tracks from the top."""
GLYPH_SCALE = 2
"""Pixels to a dot: read at half the size, as in a narrow sidebar."""


@dataclass(frozen=True)
class Theme:
    """Colours, 0–1. force, speed: of the hue that they have in a stroke's picture, hnf_core.export.plots.figure."""

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
    """How a picture is drawn. limit_m_s2: the actuator's largest acceleration, two dashed lines; None draws none.
    logarithmic: frequency from 20 Hz to 1 kHz by octaves instead of 0–1 kHz evenly."""

    theme: Theme = DARK
    limit_m_s2: float | None = None
    logarithmic: bool = False


def draw_stroke_image(signal: Signal, action: Action, style: ImageStyle) -> Rgba:
    """(512, 512, 4) float32 RGBA 0–1, the bottom row first, as Blender's images are."""
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
    """Least and greatest sample in each of columns equal stretches, (columns,) each: no peak is lost, whatever the
    width."""
    if len(samples) == 0:
        return np.zeros(columns), np.zeros(columns)
    edges = np.linspace(0, len(samples), columns + 1)
    starts = np.minimum(edges[:-1].astype(int), len(samples) - 1)
    low, high = np.minimum.reduceat(samples, starts), np.maximum.reduceat(samples, starts)
    return low.astype(np.float64), high.astype(np.float64)


def round_up_nicely(value: float) -> float:
    """The next of 1, 2, 5 times a power of ten."""
    if not value > 0.0:
        return 1.0
    decade = 10.0 ** np.floor(np.log10(value))
    return float(next(step * decade for step in (1.0, 2.0, 5.0, 10.0, 20.0) if step * decade >= value * (1.0 - 1e-9)))


def draw_wave(area: Rgba, signal: Signal, theme: Theme, limit_m_s2: float | None) -> None:
    """Acceleration in m/s²; the scale is a round number above its peak."""
    rows, width = area.shape[:2]
    peak = float(np.abs(signal.samples).max(initial=0.0))
    scale = round_up_nicely(peak)

    def row_of(value: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray((rows - 1) * (0.5 - 0.5 * np.clip(value / scale, -1.0, 1.0)))

    low, high = compute_column_extrema(signal.samples, width)
    y = np.arange(rows)[:, None]
    area[rows // 2, :, :3] = theme.faint
    ink = (y >= np.floor(row_of(high))[None]) & (y <= np.ceil(row_of(low))[None])
    area[ink, :3] = theme.wave
    if limit_m_s2 is not None and limit_m_s2 <= scale:
        for side in (limit_m_s2, -limit_m_s2):
            at = int(row_of(np.array(side)))
            area[at : at + 2, np.arange(width) % 12 < 8, :3] = theme.limit
    draw_text(area, f"±{_format_value(scale)} m/s²", 4, 4, theme.ink, theme.back)
    if limit_m_s2 is not None:
        draw_text(area, f"limit {_format_value(limit_m_s2)}", width - 4, 4, theme.limit, theme.back, right=True)


def draw_spectrogram(area: Rgba, signal: Signal, theme: Theme, logarithmic: bool = False) -> None:
    """Power density in dB, RANGE_DB below the loudest; faint lines every 200 Hz, or at 50, 100, 200 and 500 Hz."""
    rows, width = area.shape[:2]
    found = compute_spectrogram(signal)
    level = power_to_db(np.maximum(found.power, 1e-30))
    shade = np.clip(1.0 + (level - level.max()) / RANGE_DB, 0.0, 1.0) if signal.rms > 0.0 else np.zeros_like(level)
    up = 1.0 - np.arange(rows) / (rows - 1)
    place = LOWEST_HZ * (HIGHEST_HZ / LOWEST_HZ) ** up if logarithmic else HIGHEST_HZ * up
    row = np.clip(np.rint(place / found.frequency[1]).astype(int), 0, len(found.frequency) - 1)
    time = (np.arange(width) + 0.5) / width * max(signal.duration_s, 1e-6)
    hop = found.time[1] - found.time[0] if len(found.time) > 1 else 1.0
    column = np.clip(np.rint((time - found.time[0]) / hop).astype(int), 0, len(found.time) - 1)
    area[..., :3] = map_heat_colours(shade[row][:, column], theme)
    for mark in (50.0, 100.0, 200.0, 500.0) if logarithmic else (200.0, 400.0, 600.0, 800.0):
        at = int(np.argmin(np.abs(place - mark)))
        area[at, ::4, :3] = theme.faint
        if not logarithmic and mark in (400.0, 800.0):
            continue
        draw_text(area, f"{mark:g}", width - 4, at - GLYPH_HEIGHT * GLYPH_SCALE // 2, theme.ink, theme.back, right=True)
    draw_text(area, "1 kHz", width - 4, 4, theme.ink, theme.back, right=True)
    draw_text(area, f"dB 0 to -{RANGE_DB:g}", 4, 4, theme.ink, theme.back)


def draw_action(area: Rgba, action: Action, theme: Theme) -> None:
    """Force in N and speed in mm/s, each on its own round scale from 0."""
    rows, width = area.shape[:2]
    area[rows - 1, :, :3] = theme.faint
    texts = []
    for values, unit, colour in ((m_to_mm(1.0) * action.speed, "mm/s", theme.speed), (action.force, "N", theme.force)):
        scale = round_up_nicely(float(values.max(initial=0.0)))
        place = np.interp(np.linspace(0.0, len(values) - 1.0, width), np.arange(len(values)), values) / scale
        at = np.rint((rows - 3) * (1.0 - np.clip(place, 0.0, 1.0))).astype(int)
        before = np.concatenate([at[:1], at[:-1]])
        y = np.arange(rows)[:, None]
        area[(y >= np.minimum(at, before)) & (y <= np.maximum(at, before) + 1), :3] = colour
        texts.append((f"{_format_value(scale)} {unit}", colour))
    draw_text(area, texts[1][0], 4, 4, texts[1][1], theme.back)
    draw_text(area, texts[0][0], width - 4, 4, texts[0][1], theme.back, right=True)


def map_heat_colours(shade: NDArray[np.float64], theme: Theme) -> NDArray[np.float32]:
    """0–1 → (…, 3): from the background through blue and orange to the brightest (or darkest) ink."""
    stops = np.array([theme.back, theme.wave, theme.force, theme.ink])
    at = np.array([0.0, 0.45, 0.8, 1.0])
    return np.stack([np.interp(shade, at, stops[:, k]) for k in range(3)], axis=-1).astype(np.float32)


def draw_text(area: Rgba, text: str, left: int, top: int, colour: Colour, back: Colour, *, right: bool = False) -> None:
    """Letters at (left, top) in pixels, or ending at left; back: painted behind them."""
    ink = np.kron(rasterise_text(text), np.ones((GLYPH_SCALE, GLYPH_SCALE), dtype=bool))
    rows, columns = ink.shape
    if right:
        left -= GLYPH_ADVANCE * GLYPH_SCALE * len(text)
    top, left = max(top, 0), max(left, 0)
    part = area[top : top + rows, left : left + columns]
    part[..., :3] = back
    part[ink[: part.shape[0], : part.shape[1]], :3] = colour


def _format_value(value: float) -> str:
    return f"{value:.3g}" if value < 1000.0 else f"{value:.0f}"
