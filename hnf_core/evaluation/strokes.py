"""What is stroked: to learn from, and to be judged on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..action.action import ACTION_RATE_HZ, Action
from ..action.primitive_path import primitive_action
from ..action.primitives import PRIMITIVE_NAMES
from ..action.smooth import circular_action, steady_action, wandering_action
from ..datasets.dataset import ActionRange

Diet = Literal["wandering", "circular", "circular and primitives"]
"""What a method learns from. wandering: speed, force and direction walk through their ranges. circular: as the paper's
recordings. circular and primitives: HNF+, the eight synthetic classes of action added."""

PIECE_S = 5.0
CIRCLE_M = 0.02
CIRCLE_S = 5.0


@dataclass(frozen=True)
class Trial:
    """kind: "window" (new, but of the kind most methods learn from) or "unseen" (of a kind in no diet). name: words."""

    kind: Literal["window", "unseen"]
    name: str
    action: Action


def diet_actions(diet: Diet, limits: ActionRange, seconds: float, seed: int) -> list[Action]:
    """Some `seconds` of strokes within the limits; at least one. Deterministic with a seed."""
    if diet == "wandering":
        count = max(1, round(seconds / PIECE_S))
        return [_wandering(limits, min(seconds, PIECE_S), 10_000 + 100 * seed + index) for index in range(count)]
    circles = seconds if diet == "circular" else 0.5 * seconds
    actions = _circles(limits, circles, seed)
    if diet == "circular and primitives":
        kinds = [primitive_action(name, seed=seed) for name in PRIMITIVE_NAMES]
        repeats = max(1, round((seconds - circles) / sum(each.duration_s for each in kinds)))
        actions += [
            primitive_action(name, seed=1000 * seed + again) for again in range(repeats) for name in PRIMITIVE_NAMES
        ]
    return actions


def trials(limits: ActionRange, seconds: float, seed: int) -> list[Trial]:
    """Two new wandering strokes; a steady stroke; and a speed sweep at constant force: the last two are in no diet."""
    speed, force = _middle(limits.speed_m_s), _middle(limits.force_n)
    low, high = limits.speed_m_s
    angle = float(np.random.default_rng(seed).uniform(*limits.angle_rad))
    return [
        Trial("window", "wandering 1", _wandering(limits, seconds, 1000 + seed)),
        Trial("window", "wandering 2", _wandering(limits, seconds, 2000 + seed)),
        Trial(
            "unseen",
            f"steady {1e3 * speed:.0f} mm/s, {force:.2g} N, {np.degrees(angle):.0f}°",
            steady_action(seconds, speed, force, angle),
        ),
        Trial(
            "unseen",
            f"sweep {1e3 * low:.0f}–{1e3 * high:.0f} mm/s, {force:.2g} N",
            sweep_action(seconds, limits.speed_m_s, force, angle),
        ),
    ]


def sweep_action(duration_s: float, speed_m_s: tuple[float, float], force_n: float, angle_rad: float) -> Action:
    """Speed rises evenly from one limit to the other; direction and force stay."""
    count = round(duration_s * ACTION_RATE_HZ) + 1
    speed = np.linspace(*speed_m_s, count)
    position = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]))]) / ACTION_RATE_HZ
    direction = np.tile([np.cos(angle_rad), np.sin(angle_rad)], (count, 1))
    return Action(ACTION_RATE_HZ, direction, speed, np.full(count, force_n), position, np.ones(count, dtype=bool))


def _circles(limits: ActionRange, seconds: float, seed: int) -> list[Action]:
    """Circles of constant speed and force, a grid of both gone through in turn."""
    rng = np.random.default_rng(seed)
    length = min(CIRCLE_S, seconds)
    count = max(1, round(seconds / length))
    actions = []
    for index in range(count):
        speed = _between(limits.speed_m_s, (index + 0.5) / count)
        force = _between(limits.force_n, (0.618034 * index + rng.uniform()) % 1.0)
        actions.append(circular_action(length, speed, force, CIRCLE_M, rng.uniform(0.0, 2.0 * np.pi)))
    return actions


def _wandering(limits: ActionRange, seconds: float, seed: int) -> Action:
    return wandering_action(
        seconds, seed, speed_m_s=limits.speed_m_s, force_n=limits.force_n, angle_rad=limits.angle_rad
    )


def _middle(limits: tuple[float, float]) -> float:
    return _between(limits, 0.5)


def _between(limits: tuple[float, float], share: float) -> float:
    return float(limits[0] * (limits[1] / limits[0]) ** share)
