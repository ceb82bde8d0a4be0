"""Measure what a conversion lost, from the signal before it and the written file decoded again."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..metrics.spectra import BandChange, compare_bands
from ..signal import Signal

FRAME_S = 0.02
SILENCE_DB = -120.0
"""Level [dB re 1 m/s²] below which a signal is silent."""
SILENT_OUTPUT = "All of it: what is read back is silent. A .wav in m/s² keeps every sample."
BAND_RANGE_DB = 60.0
"""Range below the loudest band [dB]; softer bands are left out of tables."""


@dataclass(frozen=True)
class SignalStats:
    """Level statistics of a signal.

    Attributes
    ----------
    duration_s, sample_rate_hz : float
        Duration [s] and sample rate [Hz].
    rms, peak : float
        RMS and peak [m/s²].
    crest_db : float or None
        Ratio of peak to RMS [dB]; None for silence.
    range_db : float or None
        Range from the 5th to the 95th percentile of the levels of 20 ms frames [dB]; None for silence.
    """

    duration_s: float
    sample_rate_hz: float
    rms: float
    peak: float
    crest_db: float | None
    range_db: float | None


@dataclass(frozen=True)
class ConversionLoss:
    """Difference between a signal before and after a conversion.

    Attributes
    ----------
    before, after : SignalStats
        Statistics before and after.
    bands : tuple of BandChange
        Energy per octave band.
    exact : bool
        Whether every sample is unchanged.
    dropped : tuple of str
        Sentences on what the format cannot hold.
    """

    before: SignalStats
    after: SignalStats
    bands: tuple[BandChange, ...]
    exact: bool
    dropped: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        bands = [
            {
                "low_hz": band.low_hz,
                "high_hz": None if math.isinf(band.high_hz) else band.high_hz,
                "before_db": power_to_level_db(band.before),
                "after_db": power_to_level_db(band.after),
                "change_db": band.change_db,
            }
            for band in self.bands
        ]
        return {
            "exact": self.exact,
            "before": vars(self.before),
            "after": vars(self.after),
            "bands": bands,
            "bands_are": "octaves; levels re 1 (m/s²)²",
            "dropped": list(self.dropped),
        }


def measure_loss(before: Signal, after: Signal, dropped: tuple[str, ...] = ()) -> ConversionLoss:
    """Compare a signal with the one that was read from its exported file.

    Parameters
    ----------
    before : Signal
        The signal as it was exported.
    after : Signal
        The signal as it was read from the file.
    dropped : tuple of str
        Sentences of the writer. `SILENT_OUTPUT` is put first if nothing is left of the signal.

    Returns
    -------
    ConversionLoss
        Statistics, band energies and the sentences.
    """
    bands = compare_bands(before.samples, before.sample_rate, after.samples, after.sample_rate)
    exact = before.sample_rate == after.sample_rate and np.array_equal(before.samples, after.samples)
    stats_before, stats_after = compute_signal_stats(before), compute_signal_stats(after)
    all_lost = (SILENT_OUTPUT,) if stats_after.rms == 0.0 < stats_before.rms else ()
    return ConversionLoss(stats_before, stats_after, bands, exact, (*all_lost, *dropped))


def compute_signal_stats(signal: Signal) -> SignalStats:
    samples = np.asarray(signal.samples, dtype=np.float64)
    peak, rms = float(np.abs(samples).max(initial=0.0)), signal.rms
    crest = None if rms == 0.0 else 20.0 * math.log10(peak / rms)
    return SignalStats(
        signal.duration_s, signal.sample_rate, rms, peak, crest, _compute_range_db(samples, signal.sample_rate)
    )


def _compute_range_db(samples: np.ndarray[Any, np.dtype[np.float64]], rate: float) -> float | None:
    frame = max(1, round(FRAME_S * rate))
    count = len(samples) // frame
    if count == 0:
        return None
    power = np.square(samples[: count * frame]).reshape(count, frame).mean(axis=1)
    audible = power[power > 10.0 ** (SILENCE_DB / 10.0)]
    if len(audible) == 0:
        return None
    low, high = np.percentile(10.0 * np.log10(audible), [5.0, 95.0])
    return float(high - low)


def power_to_level_db(power: float) -> float | None:
    """Return the level of a mean square [dB re 1 (m/s²)²]; None for silence."""
    return 10.0 * math.log10(power) if power > 10.0 ** (SILENCE_DB / 10.0) else None


def format_loss_table(loss: ConversionLoss) -> str:
    """Format the loss of a conversion as a table for a terminal, or as one line if the conversion is exact."""
    before, after = loss.before, loss.after
    if loss.exact:
        return _append_dropped(f"Every sample reads back as it was: {_format_stats(before)}.", loss)
    rows: list[tuple[str, ...]] = [
        ("", "before", "after", "change"),
        ("duration", f"{before.duration_s:.4f} s", f"{after.duration_s:.4f} s",
         f"{1000.0 * (after.duration_s - before.duration_s):+.2f} ms"),
        ("sample rate", f"{before.sample_rate_hz:g} Hz", f"{after.sample_rate_hz:g} Hz", ""),
        ("level (RMS)", f"{before.rms:.3g} m/s²", f"{after.rms:.3g} m/s²", _format_ratio(before.rms, after.rms)),
        ("peak", f"{before.peak:.3g} m/s²", f"{after.peak:.3g} m/s²", _format_ratio(before.peak, after.peak)),
        ("crest factor", *_format_pair(before.crest_db, after.crest_db)),
        ("dynamics, 5–95 %", *_format_pair(before.range_db, after.range_db)),
    ]  # fmt: skip
    rows += [
        (_format_band(band), *_format_pair(power_to_level_db(band.before), power_to_level_db(band.after)))
        for band in _significant_bands(loss.bands)
    ]
    return _append_dropped(_align_columns(rows), loss)


def format_rendered_summary(loss: ConversionLoss) -> str:
    """Summarize a signal rendered from a file without samples, for which a loss table has nothing to compare."""
    head = "Rendered from strength and frequency over time, and its waveform is made up"
    return _append_dropped(f"{head}: {_format_stats(loss.after)}.", loss)


def describe_sidecar_loss(loss: Mapping[str, Any], where: str) -> tuple[str, ...]:
    """Describe the loss of an earlier export, as `ConversionLoss.to_json` stored it in the sidecar file named `where`.

    The sentences in "dropped" follow unchanged; not all of them are losses, for example the one that states a gain.
    """
    if loss["exact"]:
        return (f"Its export, as {where} says, kept every sample.",)
    before, after = loss["before"], loss["after"]
    ratios = {
        word: _format_ratio(float(before[key]), float(after[key])) for word, key in (("level", "rms"), ("peak", "peak"))
    }
    changed = [f"the {word} by {ratio}" for word, ratio in ratios.items() if ratio not in ("", _format_change(0.0))]
    if not changed:
        return (f"Of its export, {where} says:", *loss["dropped"])
    return (f"Its export, as {where} says, changed {' and '.join(changed)}. It says:", *loss["dropped"])


def format_level_table(facts: SignalStats, bands: tuple[BandChange, ...]) -> str:
    """Format crest factor, range of levels and the level of each octave band (`after` of each band) for a terminal."""
    rows: list[tuple[str, ...]] = [
        ("crest factor", _format_level(facts.crest_db)),
        ("dynamics, 5–95 %", _format_level(facts.range_db)),
        *((_format_band(band), _format_level(power_to_level_db(band.after))) for band in _significant_bands(bands)),
    ]
    return _align_columns(rows)


def _format_stats(facts: SignalStats) -> str:
    length = f"{facts.duration_s:.4f} s at {facts.sample_rate_hz:g} Hz"
    return f"{length}, {facts.rms:.3g} m/s² RMS, peak {facts.peak:.3g} m/s²"


def _significant_bands(bands: tuple[BandChange, ...]) -> list[BandChange]:
    """Return the octave bands that are less than `BAND_RANGE_DB` below the loudest."""
    loudest = max(max(band.before, band.after) for band in bands)
    return [item for item in bands if max(item.before, item.after) > loudest * 10.0 ** (-BAND_RANGE_DB / 10.0)]


def _align_columns(rows: list[tuple[str, ...]]) -> str:
    """Align the cells of a text table: the first column left and the others right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [[row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])] for row in rows]
    return "\n".join("  ".join(line).rstrip() for line in lines)


def _append_dropped(text: str, loss: ConversionLoss) -> str:
    return "\n".join([text, *(f"- {sentence}" for sentence in loss.dropped)])


def _format_band(band: BandChange) -> str:
    low, high = (f"{edge:.2g}" if edge < 99.5 else f"{edge:.0f}" for edge in (band.low_hz, min(band.high_hz, 1e9)))
    return f"above {low} Hz" if math.isinf(band.high_hz) else f"{low}–{high} Hz"


def _format_pair(before: float | None, after: float | None) -> tuple[str, str, str]:
    return (
        _format_level(before),
        _format_level(after),
        "" if before is None or after is None else _format_change(after - before),
    )


def _format_change(decibels: float) -> str:
    # Adding 0.0 removes the sign of a negative zero.
    return f"{round(decibels, 1) + 0.0:+.1f} dB"


def _format_level(value: float | None) -> str:
    return "silent" if value is None else f"{round(value, 1) + 0.0:.1f} dB"


def _format_ratio(before: float, after: float) -> str:
    return _format_change(20.0 * math.log10(after / before)) if before > 0.0 and after > 0.0 else ""
