"""Strokes for training and evaluation: steady ones, and ones that wander slowly through speed, force and direction."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .action import ACTION_RATE_HZ, Action

Float = NDArray[np.float64]

SMOOTH_BANDWIDTH_HZ = 1.5
"""Bandwidth of a wandering hand: well inside the 20 Hz that an artist's stroke holds, slow enough that a 0.1 s window
has one speed and one force to within a few per cent."""


DIRECTION_SLOWDOWN = 6.0
"""By how much slower direction wanders: one window of 0.1 s should have one direction too."""


def make_steady_action(
    duration_s: float, speed_m_s: float, force_n: float, angle_rad: float = 0.0, probe: str = "pen"
) -> Action:
    """Constant direction, speed and force."""
    count = round(duration_s * ACTION_RATE_HZ) + 1
    turned = np.tile([np.cos(angle_rad), np.sin(angle_rad)], (count, 1))
    return _make_action(turned, np.full(count, speed_m_s), np.full(count, force_n), probe)


def make_random_smooth_action(
    duration_s: float,
    seed: int,
    *,
    speed_m_s: tuple[float, float],
    force_n: tuple[float, float],
    angle_rad: tuple[float, float] = (0.0, 2.0 * np.pi),
    bandwidth_hz: float = SMOOTH_BANDWIDTH_HZ,
    probe: str = "pen",
) -> Action:
    """Speed and force wander log-uniformly through their ranges (both limits positive), direction uniformly.

    Content lies below bandwidth_hz. A full circle of angles is walked as a turning hand does, without a seam at ±180°.
    """
    rng = np.random.Generator(np.random.Philox(key=seed))
    count = round(duration_s * ACTION_RATE_HZ) + 1
    speed, force = (_draw_uniform_noise(count, bandwidth_hz, rng) for _ in range(2))
    turn = _draw_uniform_noise(count, bandwidth_hz / DIRECTION_SLOWDOWN, rng)
    low, high = angle_rad
    if high - low >= 2.0 * np.pi - 1e-9:
        # Twice round, so that the folded distribution is even; it starts anywhere.
        angle = rng.uniform(0.0, 2.0 * np.pi) + 4.0 * np.pi * turn
    else:
        angle = low + (high - low) * turn
    return _make_action(
        np.stack([np.cos(angle), np.sin(angle)], axis=1),
        speed_m_s[0] * (speed_m_s[1] / speed_m_s[0]) ** speed,
        force_n[0] * (force_n[1] / force_n[0]) ** force,
        probe,
    )


def make_circular_action(
    duration_s: float, speed_m_s: float, force_n: float, radius_m: float, start_rad: float = 0.0, probe: str = "pen"
) -> Action:
    """Round and round at constant speed and force: what the paper's recordings are made of."""
    count = round(duration_s * ACTION_RATE_HZ) + 1
    angle = start_rad + np.arange(count) / ACTION_RATE_HZ * (speed_m_s / radius_m)
    turned = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return _make_action(turned, np.full(count, speed_m_s), np.full(count, force_n), probe)


def _make_action(direction: Float, speed: Float, force: Float, probe: str) -> Action:
    position = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]))]) / ACTION_RATE_HZ
    return Action(ACTION_RATE_HZ, direction, speed, force, position, force > 0.0, probe)


def _draw_uniform_noise(count: int, bandwidth_hz: float, rng: np.random.Generator) -> Float:
    """(count,) in 0 … 1, uniformly distributed over time, with nothing above bandwidth_hz before the mapping."""
    length = count + round(2.0 * ACTION_RATE_HZ / bandwidth_hz)  # what is cut off lets the two ends differ
    frequency = np.fft.rfftfreq(length, 1.0 / ACTION_RATE_HZ)
    spectrum = rng.standard_normal((2, len(frequency)))
    spectrum[:, frequency > bandwidth_hz] = 0.0
    spectrum[:, 0] = 0.0
    noise = np.fft.irfft(spectrum[0] + 1j * spectrum[1], length)
    # The logistic stands in for the normal's distribution function to 1 % (Bowling et al. 2009).
    return np.asarray(1.0 / (1.0 + np.exp(-1.702 * noise[:count] / max(float(noise.std()), 1e-300))))
