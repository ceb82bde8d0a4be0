"""Noise schedule of the diffusion network D_φ: cosine in a thousand steps, v-prediction, and deterministic DDIM.

Nichol & Dhariwal 2021 (cosine), Salimans & Ho 2022 (v = √ᾱ ε − √(1 − ᾱ) x), Song et al. 2021 (DDIM, η = 0). The numbers
equal those of DDIMScheduler of diffusers with squaredcos_cap_v2, v_prediction, trailing steps and clip_sample=False, if
the number of steps divides a thousand.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import UsageError

Float = NDArray[np.float64]

TRAIN_STEPS = 1000
"""Number of noise steps of the schedule in training."""
OFFSET = 0.008
"""Offset s of the cosine schedule, as a fraction of its length (Nichol & Dhariwal 2021)."""
LARGEST_BETA = 0.999
"""Upper limit of β, the noise variance added in one step."""


@lru_cache(maxsize=1)
def alpha_bars() -> Float:
    """Return ᾱ (TRAIN_STEPS,), the fraction of the clean signal's power left after each step of adding noise."""
    progress = np.arange(TRAIN_STEPS + 1) / TRAIN_STEPS
    level = np.cos((progress + OFFSET) / (1.0 + OFFSET) * np.pi / 2.0) ** 2
    betas = np.minimum(1.0 - level[1:] / level[:-1], LARGEST_BETA)
    bars: Float = np.cumprod(1.0 - betas)
    bars.flags.writeable = False
    return bars


def log_snr(alpha_bar: Any) -> Float:
    """Return the log signal-to-noise ratio ln(ᾱ / (1 − ᾱ))."""
    bar = np.asarray(alpha_bar, dtype=np.float64)
    return np.asarray(np.log(bar) - np.log1p(-bar))


def sampling_steps(steps: int) -> tuple[tuple[float, float], ...]:
    """Return (ᾱ before, ᾱ after) of every DDIM step, from pure noise to pure signal (ᾱ = 1 after the last).

    Raises UsageError unless 1 ≤ steps ≤ TRAIN_STEPS.
    """
    if not 1 <= steps <= TRAIN_STEPS:
        raise UsageError(f"{steps} sampling steps.", remedy=f"Choose 1 to {TRAIN_STEPS}.")
    times = np.round(np.arange(TRAIN_STEPS, 0, -TRAIN_STEPS / steps)).astype(int)[:steps] - 1
    before = alpha_bars()[times]
    return tuple((float(a), float(b)) for a, b in zip(before, (*before[1:], 1.0), strict=True))


def noised(x: Any, noise: Any, alpha_bar: Any) -> Any:
    """Return the noisy sample √ᾱ x + √(1 − ᾱ) ε of clean x and unit noise ε, for arrays and tensors alike."""
    return alpha_bar**0.5 * x + (1.0 - alpha_bar) ** 0.5 * noise


def velocity(x: Any, noise: Any, alpha_bar: Any) -> Any:
    """Return the prediction target v = √ᾱ ε − √(1 − ᾱ) x of clean x and unit noise ε, for arrays and tensors alike."""
    return alpha_bar**0.5 * noise - (1.0 - alpha_bar) ** 0.5 * x


def ddim_step(noisy: Any, v: Any, before: float, after: float) -> Any:
    """Take one DDIM step (η = 0) of a noisy sample from ᾱ = before to ᾱ = after, given the predicted v."""
    x = before**0.5 * noisy - (1.0 - before) ** 0.5 * v
    noise = before**0.5 * v + (1.0 - before) ** 0.5 * noisy
    return after**0.5 * x + (1.0 - after) ** 0.5 * noise
