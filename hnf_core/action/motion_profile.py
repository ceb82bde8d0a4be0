"""Motion profile of a stroke: position on the path over time, from keyed progress, a constant speed or a duration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import StrokeError
from .keyframes import make_eased_travel

Float = NDArray[np.float64]

RAMP_S = 0.1
"""Duration of the S-shaped ramp at both ends of a motion at constant speed [s], since a hand has inertia."""
MAX_DURATION_S = 600.0
"""Longest stroke [s]."""
MAX_SPEED_M_S = 1e4
"""Largest speed, that of `field.stroke.LIMITS` [m/s]; a faster motion is a scene of another unit."""


@dataclass(frozen=True)
class MotionProfile:
    """Position (n,) along the curve [m], and velocity (n,) [m/s], negative where the stroke runs backward."""

    position: Float
    velocity: Float


def make_time_grid(duration_s: float, rate: float, *, where: str = "") -> Float:
    """Make even times 0, 1/rate, … up to at least `duration_s` [s].

    Raises StrokeError for a duration that is not positive, shorter than a step of the grid, or beyond ten minutes.
    """
    if not duration_s > 0.0:
        raise StrokeError(
            "the stroke lasts no time.",
            where=where,
            remedy="Set keyframes of progress or force at two different frames, or use the speed or duration law.",
        )
    if not duration_s <= MAX_DURATION_S:
        raise StrokeError(
            f"the stroke lasts {duration_s:g} s, and {MAX_DURATION_S:g} s is the most.",
            where=where,
            remedy="Move its last keyframe closer or raise its speed.",
        )
    if not duration_s * rate >= 1.0 - 1e-6:
        raise StrokeError(
            f"the stroke lasts {duration_s:.3g} s, and {1.0 / rate:g} s is the least.",
            where=where,
            remedy="Move its keyframes apart, or give it a longer duration or path.",
        )
    return np.arange(int(np.ceil(duration_s * rate - 1e-6)) + 1) / rate


def clamp_force(force: ArrayLike, frames: ArrayLike, *, where: str, max_force: float = np.inf) -> Float:
    """Clamp normal forces to 0 … `max_force`, since F-curve handles overshoot.

    Parameters
    ----------
    force : array_like, shape (n,)
        Normal force [N].
    frames : array_like, shape (n,)
        Frames of the values, for messages.
    where : str
        Name of the stroke in messages.
    max_force : float
        Upper limit [N].

    Returns
    -------
    ndarray, shape (n,)
        Clamped force [N].

    Raises
    ------
    StrokeError
        Names the first frame whose value is not finite.
    """
    return np.clip(_check_finite(force, frames, "force", where), 0.0, max_force)


def clamp_progress(progress: ArrayLike, frames: ArrayLike, *, where: str) -> Float:
    """Clamp progress along a curve (n,) to 0–1; raise StrokeError with the first frame whose value is not finite."""
    return np.clip(_check_finite(progress, frames, "progress", where), 0.0, 1.0)


def _check_finite(values: ArrayLike, frames: ArrayLike, name: str, where: str) -> Float:
    array = np.asarray(values, dtype=np.float64)
    broken = np.flatnonzero(~np.isfinite(array))
    if len(broken):
        frame = float(np.asarray(frames, dtype=np.float64)[broken[0]])
        raise StrokeError(
            f"{name} is not a number at frame {frame:g}.",
            where=where,
            remedy="Delete or correct the keyframe there in the Graph Editor.",
        )
    return array


def check_motion(motion: MotionProfile, *, where: str) -> MotionProfile:
    """Return `motion`; raise StrokeError if it is faster than `MAX_SPEED_M_S`."""
    fastest = float(np.abs(motion.velocity).max(initial=0.0))
    if not fastest <= MAX_SPEED_M_S:
        raise StrokeError(
            f"the hand moves at {fastest:.2g} m/s, and {MAX_SPEED_M_S:g} m/s is the most.",
            where=where,
            remedy="Check the scene's unit scale, and move the stroke's keyframes apart or give it a longer duration.",
        )
    return motion


def make_motion_from_progress(progress: Float, length_m: float, rate: float) -> MotionProfile:
    """Make a motion from progress (n,), the fraction 0–1 of the curve's length at each sample of rate `rate` [Hz].

    The velocity is a second-order finite difference of the position.
    """
    position = progress * length_m
    if len(position) < 3:
        return MotionProfile(
            position, np.gradient(position, 1.0 / rate) if len(position) > 1 else np.zeros(len(position))
        )
    return MotionProfile(position, np.gradient(position, 1.0 / rate, edge_order=2))


def make_motion_at_speed(time: Float, length_m: float, speed_m_s: float) -> MotionProfile:
    """Make a motion from end to end at constant speed with eased ends, from time 0."""
    if length_m == 0.0:
        return MotionProfile(np.zeros(len(time)), np.zeros(len(time)))
    return MotionProfile(*make_eased_travel(length_m, speed_m_s, RAMP_S).sample(time))


def compute_travel_time(length_m: float, speed_m_s: float) -> float:
    """Return the duration [s] of a motion over a length at constant speed with eased ends (`make_motion_at_speed`)."""
    return length_m / speed_m_s + min(RAMP_S, length_m / speed_m_s)


def compute_speed_for_duration(length_m: float, duration_s: float) -> float:
    """Return the speed [m/s] at which a motion with eased ends takes `duration_s`, inverse of compute_travel_time."""
    return length_m / (duration_s - min(RAMP_S, duration_s / 2.0))
