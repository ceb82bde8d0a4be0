"""What the hand did and what was felt, on one time axis."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from ..signal import Signal
from ..units import m_to_mm, power_to_db
from .spectra import compute_spectrogram

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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
