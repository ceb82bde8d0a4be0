"""What is stroked: to learn from, and to be judged on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..action.action import ACTION_RATE_HZ, Action
from ..action.primitive_path import make_primitive_action
from ..action.primitives import PRIMITIVE_NAMES
from ..action.smooth import make_circular_action, make_random_smooth_action, make_steady_action
from ..datasets.dataset import ActionRange

TrainingStrokes = Literal["wandering", "circular", "circular and primitives"]
"""What a method learns from. wandering: speed, force and direction walk through their ranges. circular: as the paper's
recordings. circular and primitives: HNF+, the eight synthetic classes of action added."""

STROKE_S = 5.0
CIRCLE_RADIUS_M = 0.02
CIRCLE_S = 5.0


@dataclass(frozen=True)
class Trial:
    """kind: "window" (new, but of the kind most methods learn from) or "unseen" (of a kind in no diet). name: words."""

    kind: Literal["window", "unseen"]
    name: str
    action: Action


def make_training_actions(
    training_strokes: TrainingStrokes, limits: ActionRange, seconds: float, seed: int
) -> list[Action]:
    """Some `seconds` of strokes within the limits; at least one. Deterministic with a seed."""
    if training_strokes == "wandering":
        count = max(1, round(seconds / STROKE_S))
        return [_make_wandering(limits, min(seconds, STROKE_S), 10_000 + 100 * seed + index) for index in range(count)]
    circles = seconds if training_strokes == "circular" else 0.5 * seconds
    actions = _make_circles(limits, circles, seed)
    if training_strokes == "circular and primitives":
        kinds = [make_primitive_action(name, seed=seed) for name in PRIMITIVE_NAMES]
        repeats = max(1, round((seconds - circles) / sum(each.duration_s for each in kinds)))
        actions += [
            make_primitive_action(name, seed=1000 * seed + again)
            for again in range(repeats)
            for name in PRIMITIVE_NAMES
        ]
    return actions


def make_trials(limits: ActionRange, seconds: float, seed: int) -> list[Trial]:
    """Two new wandering strokes; a steady stroke; and a speed sweep at constant force: the last two are in no diet."""
    speed, force = _compute_middle(limits.speed_m_s), _compute_middle(limits.force_n)
    low, high = limits.speed_m_s
    angle = float(np.random.default_rng(seed).uniform(*limits.angle_rad))
    return [
        Trial("window", "wandering 1", _make_wandering(limits, seconds, 1000 + seed)),
        Trial("window", "wandering 2", _make_wandering(limits, seconds, 2000 + seed)),
        Trial(
            "unseen",
            f"steady {1e3 * speed:.0f} mm/s, {force:.2g} N, {np.degrees(angle):.0f}°",
            make_steady_action(seconds, speed, force, angle),
        ),
        Trial(
            "unseen",
            f"sweep {1e3 * low:.0f}–{1e3 * high:.0f} mm/s, {force:.2g} N",
            make_sweep_action(seconds, limits.speed_m_s, force, angle),
        ),
    ]


def make_sweep_action(duration_s: float, speed_m_s: tuple[float, float], force_n: float, angle_rad: float) -> Action:
    """Speed rises evenly from one limit to the other; direction and force stay."""
    count = round(duration_s * ACTION_RATE_HZ) + 1
    speed = np.linspace(*speed_m_s, count)
    position = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]))]) / ACTION_RATE_HZ
    direction = np.tile([np.cos(angle_rad), np.sin(angle_rad)], (count, 1))
    return Action(ACTION_RATE_HZ, direction, speed, np.full(count, force_n), position, np.ones(count, dtype=bool))


def _make_circles(limits: ActionRange, seconds: float, seed: int) -> list[Action]:
    """Circles of constant speed and force, a grid of both gone through in turn."""
    rng = np.random.default_rng(seed)
    length = min(CIRCLE_S, seconds)
    count = max(1, round(seconds / length))
    actions = []
    for index in range(count):
        speed = _interpolate_log(limits.speed_m_s, (index + 0.5) / count)
        force = _interpolate_log(limits.force_n, (0.618034 * index + rng.uniform()) % 1.0)
        actions.append(make_circular_action(length, speed, force, CIRCLE_RADIUS_M, rng.uniform(0.0, 2.0 * np.pi)))
    return actions


def _make_wandering(limits: ActionRange, seconds: float, seed: int) -> Action:
    return make_random_smooth_action(
        seconds, seed, speed_m_s=limits.speed_m_s, force_n=limits.force_n, angle_rad=limits.angle_rad
    )


def _compute_middle(limits: tuple[float, float]) -> float:
    return _interpolate_log(limits, 0.5)


def _interpolate_log(limits: tuple[float, float], share: float) -> float:
    return float(limits[0] * (limits[1] / limits[0]) ** share)
