"""How a signal's power spreads over frequency and time, for pictures and reports.

What the hand did and what was felt, on one time axis.

The colour of a force, the same wherever a stroke is drawn: bright enough for dark and light backgrounds.

No stroke has a scale of its own: yellow is 2 N in every picture and every viewport.

How every picture of this project is drawn and saved: one style, no display, no global state.

Text of a picture, in rows: cut where there is no room, with a mark.

How training went, in one picture.
"""

from __future__ import annotations

import io
import textwrap
import warnings
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from ... import __version__
from ...action.action import Action
from ...errors import FileError
from ...files import write_bytes
from ...signal import Signal
from ...units import m_to_mm, power_to_db

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Float = NDArray[np.float64]
SPECTROGRAM_WINDOW_S = 0.064
"""Long enough to part 30 Hz steps, short enough to show a 20 Hz gesture."""


@dataclass(frozen=True)
class Spectrogram:
    """power: (f, t) one-sided power spectral density in (m/s²)²/Hz. frequency: (f,) Hz. time: (t,) s, the windows'
    centres."""

    power: Float
    frequency: Float
    time: Float

    def mean(self) -> Float:
        """(f,) Welch's estimate of the whole signal's density."""
        return np.asarray(self.power.mean(axis=1))


def compute_spectrogram(signal: Signal, window_s: float = SPECTROGRAM_WINDOW_S, overlap: float = 0.75) -> Spectrogram:
    """Short-time periodograms under a Hann window (Welch 1967; scaled so that the integral over frequency of a
    stationary signal's mean is its mean square). A signal shorter than the window is padded with silence."""
    n = max(8, round(window_s * signal.sample_rate))
    hop = max(1, round(n * (1.0 - overlap)))
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


# Okabe & Ito's palette and matplotlib's cividis keep apart under every common colour blindness.
# Force is orange and speed is green in the add-on's Preview too.
INK, MUTED, FORCE_COLOUR, SPEED_COLOUR = "#1c2430", "#5c6672", "#d55e00", "#009e73"
POWER_COLOUR_MAP = "cividis"
DISPLAY_RANGE_DB = 70.0
TRACKS_BOTTOM = 0.075
SILENCE_DB = -120.0
"""Density at which the picture calls a signal silent: 1 µ(m/s²)²/Hz is far below any skin."""


def draw_tracks(
    figure: Figure, action: Action, signal: Signal, frequency_scale: Literal["linear", "log"], highest_hz: float
) -> None:
    """Force, speed, acceleration and spectrogram in the right half of figure."""
    left, width = 0.575, 0.345
    end = max(action.duration_s, signal.duration_s, 1e-3)
    rows = {"force": (0.785, 0.13), "speed": (0.62, 0.13), "wave": (0.425, 0.16), "power": (TRACKS_BOTTOM, 0.315)}
    axes = {name: figure.add_axes((left, bottom, width, tall)) for name, (bottom, tall) in rows.items()}
    _draw_action(axes["force"], action, action.force, "force", "N", FORCE_COLOUR)
    _draw_action(axes["speed"], action, m_to_mm(1.0) * action.speed, "speed", "mm/s", SPEED_COLOUR)
    _draw_wave(axes["wave"], signal)
    _draw_power(
        figure, axes["power"], signal, (left + width + 0.012, TRACKS_BOTTOM, 0.010, 0.315), frequency_scale, highest_hz
    )
    for name, panel in axes.items():
        panel.set_xlim(0.0, end)
        panel.yaxis.set_label_coords(-0.085, 0.5)
        if name != "power":
            panel.tick_params(labelbottom=False)
    axes["power"].set_xlabel("time [s]")


def draw_spectrum(figure: Figure, signal: Signal, bounds: tuple[float, float, float, float]) -> None:
    """The whole signal's power density over 10 Hz … 1 kHz, both axes logarithmic."""
    axes = figure.add_axes(bounds)
    spectra = compute_spectrogram(signal, window_s=0.128)
    decibels = power_to_db(spectra.mean())
    band = (spectra.frequency >= 4.0) & (spectra.frequency <= 1000.0)
    axes.set_xscale("log")
    axes.set_xlim(10.0, 1000.0)
    axes.set_xticks([10, 20, 50, 100, 200, 500, 1000], labels=["10", "20", "50", "100", "200", "500", "1000"])
    axes.set_xticks([], minor=True)
    axes.set_xlabel("frequency [Hz]")
    axes.set_ylabel("mean density [dB]")
    top = float(decibels[band].max(initial=-np.inf))
    if top >= SILENCE_DB:
        low = max(float(decibels[band].min()) - 3.0, top - DISPLAY_RANGE_DB)
        axes.fill_between(spectra.frequency[band], low, decibels[band], color=INK, alpha=0.1, lw=0)
        axes.plot(spectra.frequency[band], decibels[band], color=INK, lw=1.6)
        axes.set_ylim(low, top + 4.0)


def _draw_action(axes: Axes, action: Action, values: NDArray[np.float64], name: str, unit: str, colour: str) -> None:
    axes.fill_between(action.time, values, color=colour, alpha=0.16, lw=0)
    axes.plot(action.time, values, color=colour, lw=2.0)
    axes.set_ylabel(f"{name} [{unit}]")
    axes.set_ylim(0.0, 1.12 * max(float(np.max(values, initial=0.0)), 1e-3))
    away = ~action.contact
    if (away[:-1] & away[1:]).any():  # a single instant has no width to hatch
        low, high = axes.get_ylim()
        axes.fill_between(
            action.time, low, high, where=away.tolist(), facecolor="none", edgecolor="#c3c8ce", hatch="///", lw=0
        )
        if name == "force":
            axes.set_title("hatched: no contact", loc="right", fontsize=9, color=MUTED, pad=3)


def _draw_wave(axes: Axes, signal: Signal) -> None:
    samples = np.nan_to_num(signal.samples.astype(np.float64))
    time, low, high = _compute_column_ranges(samples, signal.sample_rate)
    axes.fill_between(time, low, high, color=INK, lw=0.4)
    reach = 1.1 * max(float(np.abs(samples).max(initial=0.0)), 1e-6)
    axes.set_ylim(-reach, reach)
    axes.set_ylabel("acceleration [m/s²]")


def _compute_column_ranges(
    samples: NDArray[np.float64], rate: float, columns: int = 1100
) -> tuple[NDArray[np.float64], ...]:
    """Time, lowest and highest value per drawn column, so that no peak is lost between pixels. Each column begins
    with the last sample of the one before: the drawn line then has no gaps."""
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
    highest_hz: float,
) -> None:
    spectra = compute_spectrogram(signal)
    decibels = np.maximum(power_to_db(spectra.power), -300.0)
    top = float(decibels.max())
    axes.grid(False)
    axes.set_ylabel("frequency [Hz]")
    lowest = float(spectra.frequency[1])
    highest = min(highest_hz, float(spectra.frequency[-1]))
    axes.set_yscale("log" if frequency_scale == "log" else "linear")
    axes.set_ylim(lowest if frequency_scale == "log" else 0.0, highest)
    if top < SILENCE_DB:
        axes.text(0.5, 0.5, "silent", transform=axes.transAxes, ha="center", va="center", color=MUTED, fontsize=16)
        return
    # What lies above the picture costs as much as what is in it; one row more, since colours run from row to row.
    rows = slice(int(frequency_scale == "log"), int(np.searchsorted(spectra.frequency, highest)) + 1)
    mesh = axes.pcolormesh(
        spectra.time,
        spectra.frequency[rows],
        decibels[rows],
        cmap=POWER_COLOUR_MAP,
        vmin=top - DISPLAY_RANGE_DB,
        vmax=top,
        shading="gouraud" if len(spectra.time) > 1 else "nearest",
        rasterized=True,
    )
    axes.set_facecolor("#00224e")
    scale = figure.colorbar(mesh, cax=figure.add_axes(bar))
    scale.outline.set_visible(False)
    scale.set_label("power density [dB re 1 (m/s²)²/Hz]")


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
"""Newtons → RGBA: grey is no contact, blue light, green 1 N, yellow firm, red hard."""


def force_to_colour(newtons: float) -> Colour:
    """RGBA, 0 to 1 each, of a normal force; linear between the stops, held beyond them."""
    after = bisect_right([force for force, _ in FORCE_COLOUR_STOPS], newtons)
    if after == 0:
        return FORCE_COLOUR_STOPS[0][1]
    if after == len(FORCE_COLOUR_STOPS):
        return FORCE_COLOUR_STOPS[-1][1]
    (low, a), (high, b) = FORCE_COLOUR_STOPS[after - 1], FORCE_COLOUR_STOPS[after]
    share = (newtons - low) / (high - low)
    return (
        a[0] + share * (b[0] - a[0]),
        a[1] + share * (b[1] - a[1]),
        a[2] + share * (b[2] - a[2]),
        a[3] + share * (b[3] - a[3]),
    )


BACKGROUND = "#fbfbf9"
PNG_COMPRESSION = 4
"""Of zlib's levels: half the time of the usual 6 for 3 % more bytes."""
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
    """Let draw fill an empty figure of size_px and save it, atomically: as SVG where path says so, else as PNG.

    Equal input gives equal bytes with one version of matplotlib. Raises FileError where matplotlib is missing or the
    file cannot be written.
    """
    try:
        import matplotlib.style
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise FileError(
            f"pictures need matplotlib ({error}).", where=str(path), remedy="Install it, or go without pictures."
        ) from error
    with matplotlib.style.context(["default", STYLE]), warnings.catch_warnings():
        # Names in scripts that the font lacks show as boxes; that is no reason to write to the terminal.
        warnings.filterwarnings("ignore", message="Glyph .* missing")
        figure = Figure(figsize=(size_px[0] / 100, size_px[1] / 100), dpi=100)
        FigureCanvasAgg(figure)
        draw(figure)
        buffer = io.BytesIO()
        made_by = f"Haptic Neural Fields {__version__}"
        if Path(path).suffix.lower() == ".svg":
            figure.savefig(buffer, format="svg", metadata={"Creator": made_by, "Date": None})
        else:
            packed = {"compress_level": PNG_COMPRESSION}
            figure.savefig(buffer, format="png", dpi=100, metadata={"Software": made_by}, pil_kwargs=packed)
    write_bytes(Path(path), buffer.getvalue())


def wrap_lines(lines: list[tuple[str, str]], width: int, max_rows: int) -> list[tuple[str, str]]:
    """(label, row) of each line, cut short only where together they are more than `most` rows; the longest first."""
    for each in range(max_rows, 0, -1):
        rows = [
            (label, row)
            for label, text in lines
            for row in textwrap.wrap(text, width, max_lines=each, placeholder=" …") or [""]
        ]
        if len(rows) <= max_rows:
            break
    return rows


TRAINING_CURVE_SIZE_PX = (900, 520)


def write_training_curve(path: Path, title: str, history: NDArray[np.float64]) -> None:
    """history: (epochs, 3) number, training and validation loss. Marks the epoch that was kept. Raises FileError."""
    kept = int(np.argmin(history[:, 2]))

    def draw(figure: Figure) -> None:
        axes = figure.add_axes((0.1, 0.13, 0.86, 0.73))
        axes.plot(history[:, 0], history[:, 1], color="#8a94a0", label="training")
        axes.plot(history[:, 0], history[:, 2], color="#2a6f97", label="validation")
        axes.plot(history[kept, 0], history[kept, 2], "o", color="#d1495b", label=f"kept: epoch {kept + 1}")
        axes.set(xlabel="epoch", ylabel="negative log-likelihood per bin")
        axes.legend(frameon=False)
        figure.text(0.1, 0.92, title, fontsize=14, fontweight="bold")

    write_figure(path, TRAINING_CURVE_SIZE_PX, draw)
