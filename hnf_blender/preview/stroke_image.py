"""Image of a stroke for the panel: waveform, spectrogram, force and speed over one time axis.

A signal and its action (direction, speed and force over time) go in, a (340, 340, 4) RGBA array comes out; a 5 × 7 dot
font labels the axes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.action import Action
from hnf_core.export.figure import compute_spectrogram
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

SIZE_PX = 340
"""Width and height of the image: twice those on the screen at interface scale 1 [px]."""
RANGE_DB = 50.0
"""Dynamic range of the spectrogram [dB]."""
HIGHEST_HZ = 1000.0
"""Upper end of the spectrogram's frequency axis [Hz]."""
LOWEST_HZ = 20.0
"""Lower end of its logarithmic frequency axis [Hz]."""
WAVE_ROWS, SPECTROGRAM_ROWS, ACTION_ROWS = (24, 116), (122, 252), (276, 334)
"""Rows of the three tracks from the top [px]."""
LABEL_ROWS = 18
"""Rows above wave and action for their labels, so that these hide no curve [px]."""
GLYPH_SCALE = 2
"""Pixels per dot; where text begins at even rows and columns, dots stay sharp at half the size."""
FRAME_PX, PLAYHEAD_PX = 4, 2
"""Width of the frame around the image, by which a click finds it on the screen, and of the playhead's line [px]."""


@dataclass(frozen=True)
class Theme:
    """Colors of the image, 0 to 1 each; force and speed have the hues of plots by `hnf_core.export.figure`."""

    back: Colour
    ink: Colour
    faint: Colour
    wave: Colour
    limit: Colour
    force: Colour
    speed: Colour

    @property
    def ghost(self) -> Colour:
        """Color of a signal that is drawn behind another."""
        return self._fade(self.wave)

    @property
    def ghost_force(self) -> Colour:
        """Color of the force of a stroke that is drawn behind another."""
        return self._fade(self.force)

    def _fade(self, colour: Colour) -> Colour:
        red, green, blue = (0.55 * back + 0.45 * own for back, own in zip(self.back, colour, strict=True))
        return red, green, blue


DARK = Theme((0.11, 0.11, 0.12), (0.92, 0.92, 0.92), (0.30, 0.30, 0.32), (0.36, 0.72, 1.0), (1.0, 0.36, 0.30),
             (1.0, 0.66, 0.25), (0.36, 0.85, 0.72))  # fmt: skip
LIGHT = Theme((0.96, 0.96, 0.96), (0.10, 0.10, 0.10), (0.74, 0.74, 0.76), (0.08, 0.38, 0.74), (0.80, 0.10, 0.06),
              (0.66, 0.31, 0.0), (0.0, 0.46, 0.335))  # fmt: skip


@dataclass(frozen=True, eq=False)
class Ghost:
    """Signal and action that are drawn faintly behind others: the A of a comparison. Compared by identity."""

    signal: Signal
    action: Action


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
    ghost : Ghost or None
        What the signal is compared with.
    """

    theme: Theme = DARK
    limit_m_s2: float | None = None
    logarithmic: bool = False
    ghost: Ghost | None = None


def draw_stroke_image(signal: Signal, action: Action, style: ImageStyle) -> Rgba:
    """Draw a signal and its action (force and speed); return (340, 340, 4) float32 RGBA in 0–1, bottom row first."""
    theme = style.theme
    canvas = np.empty((SIZE_PX, SIZE_PX, 4), dtype=np.float32)
    canvas[..., :3], canvas[..., 3] = theme.back, 1.0
    inner = canvas[:, FRAME_PX:-FRAME_PX]
    draw_wave(inner[WAVE_ROWS[0] - LABEL_ROWS : WAVE_ROWS[1]], signal, theme, style.limit_m_s2, style.ghost)
    draw_spectrogram(inner[slice(*SPECTROGRAM_ROWS)], signal, theme, style.logarithmic)
    draw_action(inner[ACTION_ROWS[0] - LABEL_ROWS : ACTION_ROWS[1]], action, theme, style.ghost)
    for edge in (slice(FRAME_PX), slice(-FRAME_PX, None)):
        canvas[edge, :, :3] = canvas[:, edge, :3] = theme.faint
    return np.ascontiguousarray(canvas[::-1])


def draw_playhead(pixels: NDArray[np.uint8], fraction: float | None, theme: Theme) -> NDArray[np.uint8]:
    """Return pixels (340, 340, 4) with a vertical line at a fraction of the stroke's time; None draws no line."""
    if fraction is None:
        return pixels
    marked, left = pixels.copy(), find_column(min(max(fraction, 0.0), 1.0)) & ~1  # Even, to be sharp at half the size.
    marked[FRAME_PX:-FRAME_PX, left : left + PLAYHEAD_PX, :3] = np.rint(255.0 * np.array(theme.ink))
    return marked


def find_column(fraction: float) -> int:
    """Return the column [px] of a fraction of the stroke's time."""
    return FRAME_PX + round(fraction * (SIZE_PX - 2 * FRAME_PX - 1))


def find_on_screen(
    pixels: NDArray[np.uint8], x: int, y: int, theme: Theme, tolerance: int = 3
) -> tuple[int, int] | None:
    """Find the image around a pixel of a screen by its frame.

    Blender tells no script where it draws what a panel asks for.

    Parameters
    ----------
    pixels : ndarray of uint8, shape (h, w, ≥3)
        The screen, or a region of it.
    x, y : int
        Column and row that are to lie within the image.
    theme : Theme
        The image's colors.
    tolerance : int
        Largest difference of a color, 0 to 255.

    Returns
    -------
    tuple of int, or None
        First and last column within the frame [px]; None if there is no image there.
    """
    if not (0 <= y < pixels.shape[0] and 0 <= x < pixels.shape[1]):
        return None
    colour = np.rint(255.0 * np.array(theme.faint)).astype(np.int16)
    is_frame = (np.abs(pixels[..., :3].astype(np.int16) - colour) <= tolerance).all(axis=-1)

    def reaches(column: int) -> tuple[int, int]:
        """First and last row of the line of the frame's color in a column, around row y."""
        others = np.flatnonzero(~is_frame[:, column])
        split = int(np.searchsorted(others, y))
        below = int(others[split - 1]) if split else -1
        above = int(others[split]) if split < len(others) else len(is_frame)
        return below + 1, above - 1

    columns = np.flatnonzero(is_frame[y])
    for left in columns[columns <= x][::-1]:
        first, last = reaches(int(left))
        for right in columns[columns > max(x, left)]:
            other_first, other_last = reaches(int(right))
            size = right - left
            is_square = max(abs(last - first - size), abs(other_last - other_first - size)) <= 0.05 * size + 2
            if is_square and size >= MIN_SIZE_PX:
                return int(left) + 1, int(right) - 1
    return None


MIN_SIZE_PX = 60
"""Smallest size at which an image is drawn [px]."""


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


def draw_wave(area: Rgba, signal: Signal, theme: Theme, limit_m_s2: float | None, ghost: Ghost | None = None) -> None:
    """Draw the acceleration [m/s²] over time, scaled to a round number above its peak, and a ghost behind it."""
    labels, area = area[:LABEL_ROWS], area[LABEL_ROWS:]
    rows, width = area.shape[:2]
    waves = [(signal.samples, theme.wave)]
    if ghost is not None:
        shown = np.zeros(round(signal.duration_s * ghost.signal.sample_rate), dtype=np.float32)
        samples = ghost.signal.samples[: len(shown)]  # The time axis is the signal's.
        shown[: len(samples)] = samples
        waves.insert(0, (shown, theme.ghost))
    scale = round_up_nicely(max(float(np.abs(samples).max(initial=0.0)) for samples, _ in waves))

    def to_row(value: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray((rows - 1) * (0.5 - 0.5 * np.clip(value / scale, -1.0, 1.0)))

    y = np.arange(rows)[:, None]
    area[rows // 2, :, :3] = theme.faint
    for samples, colour in waves:
        low, high = compute_column_extrema(samples, width)
        ink = (y >= np.floor(to_row(high))[None]) & (y <= np.ceil(to_row(low))[None])
        area[ink, :3] = colour
    if limit_m_s2 is not None and limit_m_s2 <= scale:
        for side in (limit_m_s2, -limit_m_s2):
            row = int(to_row(np.array(side)))
            area[row : row + 2, np.arange(width) % 12 < 8, :3] = theme.limit
    draw_text(labels, f"±{_format_value(scale)} m/s²", 4, 2, theme.ink, theme.back)
    if limit_m_s2 is not None:
        draw_text(labels, f"limit {_format_value(limit_m_s2)}", width - 4, 2, theme.limit, theme.back, right=True)


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
            area,
            f"{mark:g}",
            width - 4,
            (line_row - GLYPH_HEIGHT * GLYPH_SCALE // 2) & ~1,
            theme.ink,
            theme.back,
            right=True,
        )
    draw_text(area, "1 kHz", width - 4, 4, theme.ink, theme.back, right=True)
    draw_text(area, f"dB 0 to -{RANGE_DB:g}", 4, 4, theme.ink, theme.back)


def draw_action(area: Rgba, action: Action, theme: Theme, ghost: Ghost | None = None) -> None:
    """Draw force [N] and speed [mm/s] over time, each from 0 to a round number of its own, and a ghost's force."""
    labels, area = area[:LABEL_ROWS], area[LABEL_ROWS:]
    rows, width = area.shape[:2]
    area[rows - 1, :, :3] = theme.faint
    texts = []
    position = np.linspace(0.0, max(len(action.force) - 1.0, 0.0), width)

    def draw_curve(values: NDArray[np.float64], scale: float, colour: Colour) -> None:
        curve = np.interp(position, np.arange(len(values)), values) / scale
        curve_row = np.rint((rows - 3) * (1.0 - np.clip(curve, 0.0, 1.0))).astype(int)
        previous_row = np.concatenate([curve_row[:1], curve_row[:-1]])
        y = np.arange(rows)[:, None]
        area[(y >= np.minimum(curve_row, previous_row)) & (y <= np.maximum(curve_row, previous_row) + 1), :3] = colour

    force_scale = round_up_nicely(
        max(float(each.force.max(initial=0.0)) for each in (action, *([ghost.action] if ghost else [])))
    )
    if ghost is not None and len(ghost.action.force):
        draw_curve(ghost.action.force, force_scale, theme.ghost_force)
    speed = m_to_mm(1.0) * action.speed
    speed_scale = round_up_nicely(float(speed.max(initial=0.0)))
    for values, scale, unit, colour in (
        (speed, speed_scale, "mm/s", theme.speed),
        (action.force, force_scale, "N", theme.force),
    ):
        draw_curve(values, scale, colour)
        texts.append((f"{_format_value(scale)} {unit}", colour))
    draw_text(labels, texts[1][0], 4, 2, texts[1][1], theme.back)
    draw_text(labels, texts[0][0], width - 4, 2, texts[0][1], theme.back, right=True)


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
    area[max(top - GLYPH_SCALE, 0) : top + rows, max(left - GLYPH_SCALE, 0) : left + columns, :3] = back
    region = area[top : top + rows, left : left + columns]
    region[ink[: region.shape[0], : region.shape[1]], :3] = colour


def _format_value(value: float) -> str:
    return f"{value:.3g}" if value < 1000.0 else f"{value:.0f}"
