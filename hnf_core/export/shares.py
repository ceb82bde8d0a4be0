"""m/s² and Hz ↔ the 0 … 1 of formats that know nothing else, and what did not fit."""

from __future__ import annotations

from typing import Any

import numpy as np

from .envelope import Envelope
from .options import ExportOptions

CLIPPED_PREFIX = "Clipped"
"""How the sentence of what did not fit begins."""


def normalise_frequency(hertz: Any, range_hz: tuple[float, float]) -> Any:
    """Hz → 0 … 1 of the range, linear."""
    return (hertz - range_hz[0]) / (range_hz[1] - range_hz[0])


def denormalise_frequency(share: Any, range_hz: tuple[float, float]) -> Any:
    """0 … 1 of the range → Hz."""
    return range_hz[0] + share * (range_hz[1] - range_hz[0])


def count_clipped(envelope: Envelope, options: ExportOptions) -> int:
    """How many of its values and clicks exceed full scale; rounding is not counted."""
    levels = np.concatenate([envelope.amplitude, [each.amplitude for each in envelope.emphases]])
    return int(np.count_nonzero(np.round(levels / options.full_scale_m_s2, 12) > 1.0))


def format_clipped(count: int, options: ExportOptions) -> tuple[str, ...]:
    """The sentence, where count is not 0."""
    if not count:
        return ()
    return (f"{CLIPPED_PREFIX}: {count} values above the full scale of {options.full_scale_m_s2:g} m/s².",)
