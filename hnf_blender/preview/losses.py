"""What an export cost, in a sentence of the artist's language."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ..translations import tr

if TYPE_CHECKING:
    from hnf_core.export.convert import ExportResult
    from hnf_core.metrics.band_energy import BandChange

NEGLIGIBLE_DB = 0.05
"""Changes below it are told as none, in these very figures."""
QUIET_DB = 40.0
"""Bands this far below the loudest are nothing to tell of."""


def describe_loss(exported: ExportResult) -> str:
    """Of one file: how its level, its most changed octave and its duration differ from the stroke's."""
    name, loss = exported.path.name, exported.loss
    if loss.exact:
        return tr("{file}: nothing is lost").format(file=name)
    level = _level_change_db(loss.before.rms, loss.after.rms)
    worst = _find_most_changed(loss.bands)
    longer = 1000.0 * (loss.after.duration_s - loss.before.duration_s)
    band_db = 0.0 if worst is None or worst.change_db is None else worst.change_db
    if max(abs(level), abs(band_db)) < NEGLIGIBLE_DB and abs(longer) < 0.05:
        return tr("{file}: no octave changed by 0.05 dB").format(file=name)
    if worst is None:
        return tr("{file}: no signal is left").format(file=name)
    said = tr("{file}: level {level} dB, most changed {low:.0f}–{high:.0f} Hz {band} dB, duration {ms} ms")
    high = min(worst.high_hz, loss.before.sample_rate_hz / 2.0)
    change = {"level": _format_signed(level), "band": _format_signed(band_db), "ms": _format_signed(longer)}
    return said.format(file=name, low=worst.low_hz, high=high, **change)


def _format_signed(value: float) -> str:
    return f"{value + 0.0:+.1f}".replace("-", "−")


def _find_most_changed(bands: tuple[BandChange, ...]) -> BandChange | None:
    loudest = max((max(band.before, band.after) for band in bands), default=0.0)
    heard = [
        band for band in bands if band.before > loudest * 10.0 ** (-QUIET_DB / 10.0) and band.change_db is not None
    ]
    return max(heard, key=lambda band: abs(band.change_db or 0.0), default=None)


def _level_change_db(before: float, after: float) -> float:
    return 20.0 * math.log10(after / before) if before > 0.0 and after > 0.0 else 0.0
