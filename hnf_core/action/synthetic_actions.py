"""Synthetic actions for training and evaluation: steady, circular, primitive, or smooth and random."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .action import ACTION_RATE_HZ, Action

Float = NDArray[np.float64]

SMOOTH_BANDWIDTH_HZ = 1.5
"""Bandwidth of random smooth motion [Hz]: well below the 20 Hz of an artist's stroke, and slow enough that a 0.1 s
window has one speed and one force to within a few per cent."""


DIRECTION_SLOWDOWN = 6.0
"""Factor by which direction changes more slowly, so that a window of 0.1 s has one direction too."""


def make_steady_action(
    duration_s: float, speed_m_s: float, force_n: float, angle_rad: float = 0.0, probe: str = "pen"
) -> Action:
    """Make an action of constant direction, speed and force.

    Parameters
    ----------
    duration_s : float
        Duration [s].
    speed_m_s : float
        Speed [m/s].
    force_n : float
        Normal force [N].
    angle_rad : float
        Direction [rad].
    probe : str
        Contacting tip.

    Returns
    -------
    Action
        The action.
    """
    count = round(duration_s * ACTION_RATE_HZ) + 1
    direction = np.tile([np.cos(angle_rad), np.sin(angle_rad)], (count, 1))
    return _make_action(direction, np.full(count, speed_m_s), np.full(count, force_n), probe)


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
    """Make an action with random smooth speed and force, log-uniform in their ranges, and direction, uniform.

    Parameters
    ----------
    duration_s : float
        Duration [s].
    seed : int
        Seed.
    speed_m_s, force_n : tuple of float
        Positive ranges of speed [m/s] and force [N].
    angle_rad : tuple of float
        Range of direction [rad]; a full circle is traversed without a seam at ±180°.
    bandwidth_hz : float
        Upper limit of the frequencies [Hz].
    probe : str
        Contacting tip.

    Returns
    -------
    Action
        The action.
    """
    rng = np.random.Generator(np.random.Philox(key=seed))
    count = round(duration_s * ACTION_RATE_HZ) + 1
    speed, force = (_draw_uniform_noise(count, bandwidth_hz, rng) for _ in range(2))
    progress = _draw_uniform_noise(count, bandwidth_hz / DIRECTION_SLOWDOWN, rng)
    low, high = angle_rad
    if high - low >= 2.0 * np.pi - 1e-9:
        # Two full turns make the wrapped distribution uniform; the start is random.
        angle = rng.uniform(0.0, 2.0 * np.pi) + 4.0 * np.pi * progress
    else:
        angle = low + (high - low) * progress
    return _make_action(
        np.stack([np.cos(angle), np.sin(angle)], axis=1),
        speed_m_s[0] * (speed_m_s[1] / speed_m_s[0]) ** speed,
        force_n[0] * (force_n[1] / force_n[0]) ** force,
        probe,
    )


def make_circular_action(
    duration_s: float, speed_m_s: float, force_n: float, radius_m: float, start_rad: float = 0.0
) -> Action:
    """Make a circular action of a pen at constant speed and force, as in the paper's recordings."""
    count = round(duration_s * ACTION_RATE_HZ) + 1
    angle = start_rad + np.arange(count) / ACTION_RATE_HZ * (speed_m_s / radius_m)
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return _make_action(direction, np.full(count, speed_m_s), np.full(count, force_n), "pen")


def _make_action(direction: Float, speed: Float, force: Float, probe: str) -> Action:
    position = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]))]) / ACTION_RATE_HZ
    return Action(ACTION_RATE_HZ, direction, speed, force, position, force > 0.0, probe)


def _draw_uniform_noise(count: int, bandwidth_hz: float, rng: np.random.Generator) -> Float:
    """Draw smooth noise (count,), uniformly distributed in 0 … 1, by mapping band-limited Gaussian noise."""
    length = count + round(2.0 * ACTION_RATE_HZ / bandwidth_hz)  # the part that is cut off lets the two ends differ
    frequency = np.fft.rfftfreq(length, 1.0 / ACTION_RATE_HZ)
    spectrum = rng.standard_normal((2, len(frequency)))
    spectrum[:, frequency > bandwidth_hz] = 0.0
    spectrum[:, 0] = 0.0
    noise = np.fft.irfft(spectrum[0] + 1j * spectrum[1], length)
    # The logistic function approximates the normal distribution function to 1 % (Bowling et al. 2009).
    return np.asarray(1.0 / (1.0 + np.exp(-1.702 * noise[:count] / max(float(noise.std()), 1e-300))))
