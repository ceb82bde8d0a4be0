"""What every format asks of a signal before it writes it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import FileError
from ..signal import Signal

MAX_RENDERED_SAMPLES = 2**24
"""Rendered from envelopes: 28 minutes at 10 kHz. A file that claims more is damaged, or made to fill memory."""


def get_finite_samples(signal: Signal, where: str) -> NDArray[np.float32]:
    """The signal's samples, (n,). Raises FileError where there is one that is not finite, or another shape."""
    with np.errstate(over="ignore"):
        samples = np.asarray(signal.samples, dtype="<f4")
    if samples.ndim != 1:
        raise FileError(f"a signal is one-dimensional, this one has shape {samples.shape}.", where=where)
    bad = int(np.count_nonzero(~np.isfinite(samples)))
    if bad:
        raise FileError(
            f"{bad} of {len(samples)} samples are not finite, so nothing was written.",
            where=where,
            remedy="Check the stroke's keyframes and the material's values for NaN or infinity.",
        )
    return samples


def choose_render_rate(signal: Signal, range_hz: tuple[float, float]) -> float:
    """Hz at which an envelope of signal is rendered again: the signal's own, or what holds the range."""
    return float(min(max(round(signal.sample_rate), round(2.5 * range_hz[1]), 1), 1_000_000))
