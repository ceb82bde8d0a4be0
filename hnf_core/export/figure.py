"""Shared parts of all figures: style and saving, spectrogram, time tracks of a stroke, and force color scale.

Figures are drawn without a display and without matplotlib's global state. The force colors are absolute, so that a
color means the same force in every figure and viewport. `write_tactile_map_figure` shows a tactile map to people:
contrast stretched, with a scale bar and a description.
"""

from __future__ import annotations

import gc
import io
import textwrap
import warnings
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from .. import __version__
from ..action.action import Action
from ..errors import FileError
from ..files import write_bytes
from ..signal import Signal
from ..tactile.tactile_map import TactileMap
from ..units import linear_to_srgb, m_to_mm, power_to_db

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

Float = NDArray[np.float64]
SPECTROGRAM_WINDOW_S = 0.064
"""Window length [s]: separates tones 30 Hz apart, and resolves a gesture of 20 Hz."""


@dataclass(frozen=True)
class Spectrogram:
    """Spectrogram of a signal.

    Attributes
    ----------
    power : (f, t) float64
        One-sided power spectral density [(m/s²)²/Hz].
    frequency : (f,) float64
        Frequencies [Hz].
    time : (t,) float64
        Centers of the windows [s].
    """

    power: Float
    frequency: Float
    time: Float

    def mean(self) -> Float:
        """Return Welch's estimate of the whole signal's density, (f,)."""
        return np.asarray(self.power.mean(axis=1))


SPECTROGRAM_OVERLAP = 0.75
"""Overlap of successive windows of a spectrogram, as a fraction of their length."""
HIGHEST_SHOWN_HZ = 1000.0
"""Upper end of the frequency axis of a spectrogram [Hz]; the skin feels little above it."""


def compute_spectrogram(signal: Signal, window_s: float = SPECTROGRAM_WINDOW_S) -> Spectrogram:
    """Compute short-time periodograms under Hann windows that overlap by SPECTROGRAM_OVERLAP.

    Parameters
    ----------
    signal : Signal
        Signal in m/s²; padded with silence if shorter than the window.
    window_s : float
        Window length [s].

    Returns
    -------
    Spectrogram
        Density over frequency and time.

    Notes
    -----
    Welch (1967), scaled so that the mean density of a stationary signal, integrated over frequency, is its mean square.
    """
    n = max(8, round(window_s * signal.sample_rate))
    hop = max(1, round(n * (1.0 - SPECTROGRAM_OVERLAP)))
    samples = np.asarray(signal.samples, dtype=np.float64)
    frames = max(1, -(-(len(samples) - n) // hop) + 1)
    padded = np.zeros((frames - 1) * hop + n)
    padded[: len(samples)] = samples
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(n) / n)
    pieces = np.lib.stride_tricks.sliding_window_view(padded, n)[::hop] * window
    power = np.abs(np.fft.rfft(pieces, axis=1)) ** 2 / (signal.sample_rate * np.sum(window**2))
    power[:, 1 : (n + 1) // 2] *= 2.0
    frequency = np.fft.rfftfreq(n, 1.0 / signal.sample_rate)
    return Spectrogram(power.T, frequency, (np.arange(frames) * hop + n / 2) / signal.sample_rate)


# Okabe & Ito's palette and matplotlib's cividis remain distinguishable under all common color vision deficiencies.
# The add-on's Preview also draws force in orange and speed in green.
INK, MUTED, FORCE_COLOUR, SPEED_COLOUR = "#1c2430", "#5c6672", "#d55e00", "#009e73"
POWER_COLOUR_MAP = "cividis"
DISPLAY_RANGE_DB = 70.0
TRACKS_BOTTOM = 0.075
SILENCE_DB = -120.0
"""Density [dB re 1 (m/s²)²/Hz] below which a signal is labeled silent; far below the threshold of the skin."""


Side = Literal["bottom", "left", "right"]
"""Side of axes at which a scale is drawn."""


def draw_scale(
    axes: Axes, side: Side, values: Sequence[float], labels: Sequence[str] = (), title: str = "", *, grid: bool = True
) -> None:
    """Draw ticks, their labels, a title and grid lines of axes whose own are hidden, in a third of matplotlib's time.

    Parameters
    ----------
    axes : Axes
        Axes to draw in.
    side : {"bottom", "left", "right"}
        Side of the scale.
    values : sequence of float
        Positions of the ticks, in the data's unit.
    labels : sequence of str
        Their labels; without any only the ticks are drawn.
    title : str
        Quantity and unit.
    grid : bool
        Draw a line at each tick.
    """
    from matplotlib.collections import LineCollection
    from matplotlib.lines import Line2D
    from matplotlib.transforms import ScaledTranslation

    figure, is_row, edge = axes.get_figure(root=True), side == "bottom", float(side == "right")
    assert figure is not None
    (axes.xaxis if is_row else axes.yaxis).set_visible(False)
    marker, label_pt, title_pt, ha, va = _SCALES[side]
    transform = axes.get_xaxis_transform() if is_row else axes.get_yaxis_transform()

    def place(along: Any, across: Any) -> tuple[Any, Any]:
        return (along, across) if is_row else (across, along)

    def shift(points: float) -> ScaledTranslation:
        return ScaledTranslation(*place(0.0, points / 72.0), figure.dpi_scale_trans)

    if grid:
        lines = [(place(value, 0.0), place(value, 1.0)) for value in values]
        style: dict[str, Any] = {"colors": "#e8eaed", "linewidths": 0.8, "zorder": 0.5}
        axes.add_collection(LineCollection(lines, transform=transform, **style), autolim=False)
    ticks = Line2D(*place(values, np.full(len(values), edge)), ls="", marker=marker, ms=3.5, mew=0.8, color=MUTED)
    ticks.set(transform=transform, clip_on=False, zorder=2.01)
    axes.add_artist(ticks)
    for value, label in zip(values, labels, strict=False):
        axes.text(*place(value, edge), label, transform=transform + shift(label_pt), ha=ha, va=va, color=MUTED)
    if title:
        rotation, beside = 0 if is_row else 90, axes.transAxes + shift(title_pt)
        axes.text(
            *place(0.5, edge), title, transform=beside, rotation=rotation, ha="center", va=va if is_row else "center"
        )


_SCALES: dict[Side, tuple[int, float, float, str, str]] = {
    "bottom": (3, -7.0, -22.0, "center", "top"),
    "left": (0, -7.0, -44.0, "right", "center_baseline"),
    "right": (1, 7.0, 38.0, "left", "center_baseline"),
}
"""Side → matplotlib's marker for its ticks, distance of labels and of the title from the axes [pt], and alignments."""


def choose_ticks(low: float, high: float, most: int) -> tuple[list[float], list[str]]:
    """Choose at most about `most` round values between two limits, and format them with the digits that they need."""
    from matplotlib.ticker import MaxNLocator

    margin = 1e-9 * (high - low)
    values = np.asarray(MaxNLocator(most, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high), dtype=np.float64)
    values = values[(values >= low - margin) & (values <= high + margin)]
    tolerance = 1e-3 * (high - low) / most
    digits = next((count for count in range(12) if (abs(values - np.round(values, count)) < tolerance).all()), 12)
    return values.tolist(), [f"{value:.{digits}f}".replace("-", "−") for value in values + 0.0]


def draw_tracks(figure: Figure, action: Action, signal: Signal, frequency_scale: Literal["linear", "log"]) -> None:
    """Draw force, speed, acceleration and spectrogram over time in the right half of a figure."""
    left, width = 0.575, 0.345
    end = max(action.duration_s, signal.duration_s, 1e-3)
    rows = {"force": (0.785, 0.13), "speed": (0.62, 0.13), "wave": (0.425, 0.16), "power": (TRACKS_BOTTOM, 0.315)}
    axes = {name: figure.add_axes((left, bottom, width, height)) for name, (bottom, height) in rows.items()}
    _draw_action(axes["force"], action, action.force, "force", "N", FORCE_COLOUR)
    _draw_action(axes["speed"], action, m_to_mm(1.0) * action.speed, "speed", "mm/s", SPEED_COLOUR)
    _draw_wave(axes["wave"], signal)
    _draw_power(figure, axes["power"], signal, (left + width + 0.012, TRACKS_BOTTOM, 0.010, 0.315), frequency_scale)
    times, labels = choose_ticks(0.0, end, 9)
    for name, panel in axes.items():
        panel.set_xlim(0.0, end)
        is_last = name == "power"
        draw_scale(panel, "bottom", times, labels if is_last else (), "time [s]" if is_last else "", grid=not is_last)


def draw_spectrum(figure: Figure, signal: Signal, bounds: tuple[float, float, float, float]) -> None:
    """Draw the mean power density of a signal over 10 Hz … 1 kHz on logarithmic axes."""
    axes = figure.add_axes(bounds)
    spectrogram = compute_spectrogram(signal, window_s=0.128)
    decibels = power_to_db(spectrogram.mean())
    band = (spectrogram.frequency >= 4.0) & (spectrogram.frequency <= 1000.0)
    axes.set_xscale("log")
    axes.set_xlim(10.0, 1000.0)
    top = float(decibels[band].max(initial=-np.inf))
    if top >= SILENCE_DB:
        low = max(float(decibels[band].min()) - 3.0, top - DISPLAY_RANGE_DB)
        axes.fill_between(spectrogram.frequency[band], low, decibels[band], color=INK, alpha=0.1, lw=0)
        axes.plot(spectrogram.frequency[band], decibels[band], color=INK, lw=1.6)
        axes.set_ylim(low, top + 4.0)
    marks = (10, 20, 50, 100, 200, 500, 1000)
    draw_scale(axes, "bottom", marks, [str(mark) for mark in marks], "frequency [Hz]")
    draw_scale(axes, "left", *choose_ticks(*axes.get_ylim(), 7), "mean density [dB]")


def _draw_action(axes: Axes, action: Action, values: NDArray[np.float64], name: str, unit: str, colour: str) -> None:
    axes.fill_between(action.time, values, color=colour, alpha=0.16, lw=0)
    axes.plot(action.time, values, color=colour, lw=2.0)
    axes.set_ylim(0.0, 1.12 * max(float(np.max(values, initial=0.0)), 1e-3))
    draw_scale(axes, "left", *choose_ticks(*axes.get_ylim(), 5), f"{name} [{unit}]")
    lifted = ~action.contact
    if (lifted[:-1] & lifted[1:]).any():  # a single instant has no width to hatch
        low, high = axes.get_ylim()
        axes.fill_between(
            action.time, low, high, where=lifted.tolist(), facecolor="none", edgecolor="#c3c8ce", hatch="///", lw=0
        )
        if name == "force":
            axes.set_title("hatched: no contact", loc="right", fontsize=9, color=MUTED, pad=3)


def _draw_wave(axes: Axes, signal: Signal) -> None:
    samples = np.nan_to_num(signal.samples.astype(np.float64))
    time, low, high = _compute_column_ranges(samples, signal.sample_rate)
    axes.fill_between(time, low, high, color=INK, lw=0.4)
    limit = 1.1 * max(float(np.abs(samples).max(initial=0.0)), 1e-6)
    axes.set_ylim(-limit, limit)
    draw_scale(axes, "left", *choose_ticks(-limit, limit, 6), "acceleration [m/s²]")


def _compute_column_ranges(
    samples: NDArray[np.float64], rate: float, columns: int = 1100
) -> tuple[NDArray[np.float64], ...]:
    """Return time, lowest and highest sample per drawn pixel column, so that no peak is lost between pixels.

    Each column begins with the last sample of the one before, so the drawn line has no gaps.
    """
    if len(samples) == 0:
        return np.zeros(1), np.zeros(1), np.zeros(1)
    starts = np.unique(np.linspace(0, len(samples), min(columns, len(samples)), endpoint=False).astype(int))
    low, high = np.minimum.reduceat(samples, starts), np.maximum.reduceat(samples, starts)
    before = samples[np.maximum(starts - 1, 0)]
    return starts / rate, np.minimum(low, before), np.maximum(high, before)


def _draw_power(
    figure: Figure,
    axes: Axes,
    signal: Signal,
    bar: tuple[float, float, float, float],
    frequency_scale: Literal["linear", "log"],
) -> None:
    spectrogram = compute_spectrogram(signal)
    decibels = np.maximum(power_to_db(spectrogram.power), -300.0)
    top = float(decibels.max())
    axes.grid(False)
    lowest = float(spectrogram.frequency[1])
    highest = min(HIGHEST_SHOWN_HZ, float(spectrogram.frequency[-1]))
    is_log = frequency_scale == "log"
    axes.set_yscale(frequency_scale)
    axes.set_ylim(lowest if is_log else 0.0, highest)
    marks = [10.0**decade for decade in range(6) if lowest <= 10.0**decade <= highest]
    ticks = (marks, [f"{mark:g}" for mark in marks]) if is_log else choose_ticks(0.0, highest, 9)
    draw_scale(axes, "left", *ticks, "frequency [Hz]", grid=False)
    if top < SILENCE_DB:
        axes.text(0.5, 0.5, "silent", transform=axes.transAxes, ha="center", va="center", color=MUTED, fontsize=16)
        return
    # Rows above the axis limit would cost drawing time. One more row is kept because colors interpolate between rows.
    rows = slice(int(is_log), int(np.searchsorted(spectrogram.frequency, highest)) + 1)
    shown, time, frequency = decibels[rows], spectrogram.time, spectrogram.frequency[rows]
    style: dict[str, Any] = {"cmap": POWER_COLOUR_MAP, "vmin": top - DISPLAY_RANGE_DB, "vmax": top}
    if is_log or len(time) == 1:
        shading: Literal["gouraud", "nearest"] = "gouraud" if len(time) > 1 else "nearest"
        axes.pcolormesh(time, frequency, shown, shading=shading, rasterized=True, **style)
    else:  # the same, as its grid is even, in a fifth of the time
        half_s, half_hz = (time[1] - time[0]) / 2.0, (frequency[1] - frequency[0]) / 2.0
        extent = (time[0] - half_s, time[-1] + half_s, frequency[0] - half_hz, frequency[-1] + half_hz)
        axes.imshow(shown, extent=extent, origin="lower", aspect="auto", interpolation="bilinear", **style)
        axes.set_ylim(0.0, highest)
    axes.set_facecolor("#00224e")
    scale = figure.add_axes(bar)
    scale.imshow(
        np.linspace(0.0, 1.0, 256)[:, None],
        extent=(0.0, 1.0, style["vmin"], top),
        origin="lower",
        aspect="auto",
        cmap=POWER_COLOUR_MAP,
    )
    scale.spines[:].set_visible(False)
    scale.xaxis.set_visible(False)
    draw_scale(scale, "right", *choose_ticks(style["vmin"], top, 8), "power density [dB re 1 (m/s²)²/Hz]", grid=False)


Colour = tuple[float, float, float, float]

FORCE_COLOUR_STOPS: tuple[tuple[float, Colour], ...] = (
    (0.0, (0.62, 0.66, 0.72, 1.0)),
    (0.05, (0.20, 0.62, 1.00, 1.0)),
    (0.5, (0.10, 0.82, 0.95, 1.0)),
    (1.0, (0.30, 0.90, 0.35, 1.0)),
    (2.0, (1.00, 0.85, 0.10, 1.0)),
    (4.0, (1.00, 0.35, 0.10, 1.0)),
    (8.0, (1.00, 0.15, 0.45, 1.0)),
)
"""Force [N] → RGBA: gray is no contact, blue light, green 1 N, yellow firm, red hard."""


def force_to_colour(newtons: float) -> Colour:
    """Return the RGBA color (0–1 each) of a normal force [N]; linear between the stops, constant beyond them."""
    after = bisect_right([force for force, _ in FORCE_COLOUR_STOPS], newtons)
    if after == 0:
        return FORCE_COLOUR_STOPS[0][1]
    if after == len(FORCE_COLOUR_STOPS):
        return FORCE_COLOUR_STOPS[-1][1]
    (low, a), (high, b) = FORCE_COLOUR_STOPS[after - 1], FORCE_COLOUR_STOPS[after]
    fraction = (newtons - low) / (high - low)
    return (
        a[0] + fraction * (b[0] - a[0]),
        a[1] + fraction * (b[1] - a[1]),
        a[2] + fraction * (b[2] - a[2]),
        a[3] + fraction * (b[3] - a[3]),
    )


BACKGROUND = "#fbfbf9"
PNG_OPTIONS = {"compress_level": 4, "compress_type": 3}
"""Settings of zlib (Z_RLE): 0.6 of the time of its usual strategy, for fewer bytes on these figures."""
STYLE: dict[str, Any] = {
    "font.family": ["DejaVu Sans"],
    "font.size": 10.5,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": "#b9c0c8",
    "axes.facecolor": "#ffffff",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e8eaed",
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "figure.facecolor": BACKGROUND,
    "text.parse_math": False,
    "svg.hashsalt": "hnf",
}


def write_figure(path: Path, size_px: tuple[int, int], draw: Callable[[Figure], None]) -> None:
    """Create an empty figure, let `draw` fill it, and save it atomically: as SVG by the suffix of `path`, else as PNG.

    Parameters
    ----------
    path : Path
        File to write.
    size_px : (int, int)
        Width and height [pixels].
    draw : callable
        Draws into the figure.

    Raises
    ------
    FileError
        If matplotlib is missing or the file cannot be written.

    Notes
    -----
    Equal input gives equal bytes with one version of matplotlib.
    """
    try:
        import matplotlib.style
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise FileError(
            f"pictures need matplotlib ({error}).", where=str(path), remedy="Install it, or go without pictures."
        ) from error
    with matplotlib.style.context(["default", STYLE]), warnings.catch_warnings(), _pause_collection():
        # Characters that the font lacks are drawn as boxes, which needs no warning on the terminal.
        warnings.filterwarnings("ignore", message="Glyph .* missing")
        figure = Figure(figsize=(size_px[0] / 100, size_px[1] / 100), dpi=100)
        canvas = FigureCanvasAgg(figure)
        draw(figure)
        buffer = io.BytesIO()
        software = f"Haptic Neural Fields {__version__}"
        if Path(path).suffix.lower() == ".svg":
            figure.savefig(buffer, format="svg", metadata={"Creator": software, "Date": None})
        else:
            _save_png(canvas, buffer, software)
    write_bytes(Path(path), buffer.getvalue())


@contextmanager
def _pause_collection() -> Iterator[None]:
    """Switch Python's garbage collector off: it would search the many parts of a figure again and again for cycles."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


def _save_png(canvas: FigureCanvasAgg, buffer: io.BytesIO, software: str) -> None:
    """Draw a figure and save it as PNG without an alpha channel, as all of it is opaque."""
    from PIL import Image, PngImagePlugin

    canvas.draw()
    information = PngImagePlugin.PngInfo()
    information.add_text("Software", software)
    image = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    image.save(buffer, format="png", dpi=(100, 100), pnginfo=information, **PNG_OPTIONS)


def wrap_lines(lines: list[tuple[str, str]], width: int, max_rows: int) -> list[tuple[str, str]]:
    """Wrap labeled lines to (label, row) pairs; cut the longest, with a mark, if there are more than `max_rows`."""
    for rows_per_line in range(max_rows, 0, -1):
        rows = [
            (label, row)
            for label, text in lines
            for row in textwrap.wrap(text, width, max_lines=rows_per_line, placeholder=" …") or [""]
        ]
        if len(rows) <= max_rows:
            break
    return rows


TRAINING_CURVE_SIZE_PX = (900, 520)


def write_training_curve(path: Path, title: str, history: NDArray[np.float64]) -> None:
    """Draw training and validation loss over epochs and mark the best epoch.

    `history` is (epochs, 3): number, training loss, validation loss. Raises FileError as `write_figure` does.
    """
    best = int(np.argmin(history[:, 2]))

    def draw(figure: Figure) -> None:
        axes = figure.add_axes((0.1, 0.13, 0.86, 0.73))
        axes.plot(history[:, 0], history[:, 1], color="#8a94a0", label="training")
        axes.plot(history[:, 0], history[:, 2], color="#2a6f97", label="validation")
        axes.plot(history[best, 0], history[best, 2], "o", color="#d1495b", label=f"kept: epoch {best + 1}")
        axes.set(xlabel="epoch", ylabel="negative log-likelihood per bin")
        axes.legend(frameon=False)
        figure.text(0.1, 0.92, title, fontsize=14, fontweight="bold")

    write_figure(path, TRAINING_CURVE_SIZE_PX, draw)


SIZE_PX = (640, 800)
MAX_TEXT_ROWS = 7
"""Most rows of text below the map, down to the lower edge."""
CONTRAST_TARGET = 0.2
"""Distance from the mean to which the strongest percent of pixels of a tactile map is stretched; the contrast of a gel
sensor's image is much smaller."""
MAX_BAR_SHARE = 0.4
"""Largest length of the scale bar, as a fraction of the map's width."""


def compute_contrast_gain(tactile: TactileMap) -> float:
    """Return the factor by which a tactile map's contrast is raised for display; 1 if it is strong enough."""
    covered = np.asarray(tactile.image, dtype=np.float64)[tactile.mask]
    spread = float(np.percentile(np.abs(covered - covered.mean(axis=0)), 99)) if len(covered) else 0.0
    return max(1.0, CONTRAST_TARGET / max(spread, 1e-3))


def stretch_contrast(tactile: TactileMap) -> NDArray[np.float64]:
    """Return a tactile map (H, W, 3), linear, with its contrast raised for display.

    Pixels outside the map's mask are set to its mean.
    """
    image = np.asarray(tactile.image, dtype=np.float64)
    covered = image[tactile.mask]
    mean = covered.mean(axis=0) if len(covered) else image.mean(axis=(0, 1))
    return np.where(tactile.mask[..., None], mean + (image - mean) * compute_contrast_gain(tactile), mean)


THUMBNAIL_PX = 160
"""Least side of a thumbnail [pixels], the size at which a stroke's figure draws it."""


@dataclass(frozen=True)
class MapThumbnail:
    """Small image of a tactile map for people.

    Attributes
    ----------
    rgb : (H, W, 3) uint8
        sRGB, with its contrast stretched.
    caption : str
        How the map was obtained, and its width.
    """

    rgb: NDArray[np.uint8]
    caption: str


def make_thumbnail(tactile: TactileMap) -> MapThumbnail:
    """Shrink a tactile map to a thumbnail by means over squares of pixels."""
    side = choose_thumbnail_step(tactile.mask)
    covered = average_squares(tactile.mask, side)
    image = average_squares(tactile.image * tactile.mask[..., None], side) / np.maximum(covered, 1e-9)[..., None]
    small = replace(tactile, image=image.astype(np.float32), height=None, mask=covered > 0.0)
    rgb = np.round(255.0 * linear_to_srgb(stretch_contrast(small))).astype(np.uint8)
    width_mm = m_to_mm(tactile.image.shape[1] * tactile.metres_per_pixel)
    return MapThumbnail(rgb, f"{tactile.route.value} relief, {width_mm:.3g} mm")


def choose_thumbnail_step(mask: NDArray[np.bool_]) -> int:
    """Return how many pixels of a map (H, W) along each axis become one of its thumbnail."""
    return max(1, min(mask.shape) // THUMBNAIL_PX)


def average_squares(values: NDArray[Any], side: int) -> Float:
    """Return the means over squares of side × side pixels (H, W, …); the rest at the lower and right edge is cut."""
    rows, columns = (length // side for length in values.shape[:2])
    cut = np.asarray(values[: rows * side, : columns * side], dtype=np.float64)
    return np.asarray(cut.reshape(rows, side, columns, side, *values.shape[2:]).mean(axis=(1, 3)))


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
    """Return a round length for a scale bar [mm]: 1, 2 or 5 times a power of ten.

    It is the longest that is at most `MAX_BAR_SHARE` of the image's width `width_mm`.
    """
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
