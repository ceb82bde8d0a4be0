"""From noise to slopes: the loop around the network, for numpy arrays and torch tensors alike."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from .schedule import ddim_step, log_snr, sampling_steps

Velocity = Callable[[Any, Any, float], tuple[Any, Any]]
"""(noisy slopes, noisy level, log-SNR) → v of both."""


def denoise(velocity: Velocity, slopes: Any, level: Any, steps: int) -> tuple[Any, Any]:
    """DDIM (η = 0) from unit noise in slopes and level to a sample of both. Raises UsageError for impossible steps."""
    for before, after in sampling_steps(steps):
        v_slopes, v_level = velocity(slopes, level, float(log_snr(before)))
        slopes = ddim_step(slopes, v_slopes, before, after)
        level = ddim_step(level, v_level, before, after)
    return slopes, level


def apply_guidance(conditional: tuple[Any, Any], unconditional: tuple[Any, Any], guidance: float) -> tuple[Any, Any]:
    """Classifier-free guidance (Ho & Salimans 2022): from what the network says without the look's colour to what it
    says with it, `guidance` times as far."""
    return (
        unconditional[0] + guidance * (conditional[0] - unconditional[0]),
        unconditional[1] + guidance * (conditional[1] - unconditional[1]),
    )
