"""What one material is trained on: its recordings, or strokes made on its model."""

from __future__ import annotations

from ..action.smooth import make_random_smooth_action
from ..errors import UsageError
from .dataset import DataSet
from .recording import Recording

TRAINING_STROKE_S = 5.0
LOW_END_FACTOR = 0.6
"""How far below the least speed and force of a model's data strokes go: hands do, and the model fades there."""
TYPICAL_SPEED_M_S, TYPICAL_FORCE_N = (0.03, 0.2), (0.3, 3.0)
TYPICAL_SHARE = 0.7
"""Share of strokes that keep to where hands mostly are; the others go wherever the data reach."""


def get_training_recordings(
    data: DataSet, name: str, seconds: float, seed: int, source: str | None = None
) -> list[Recording]:
    """What to train on: `seconds` of wandering strokes on the material's model, or its recordings.

    Raises UsageError where what was asked for does not exist.
    """
    process, recorded = data.process(name), []
    if process is None or source == "recordings":
        recorded = data.recordings(name)
        if not recorded:
            raise UsageError(
                f"there are no recordings of {name!r} here.", remedy="Leave --source out to use its model."
            )
        return recorded
    if not TRAINING_STROKE_S <= seconds < 1e5:
        raise UsageError(f"--seconds {seconds:g}: give at least {TRAINING_STROKE_S:g}.", remedy="480 is plenty.")
    limits = data.action_range(name)
    speed, force = ((LOW_END_FACTOR * low, high) for low, high in (limits.speed_m_s, limits.force_n))
    count = round(seconds / TRAINING_STROKE_S)
    actions = [
        make_random_smooth_action(
            TRAINING_STROKE_S, seed * 100_003 + index,
            speed_m_s=_intersect_ranges(speed, TYPICAL_SPEED_M_S) if index < TYPICAL_SHARE * count else speed,
            force_n=_intersect_ranges(force, TYPICAL_FORCE_N) if index < TYPICAL_SHARE * count else force,
            angle_rad=limits.angle_rad,
        )
        for index in range(count)
    ]  # fmt: skip
    return process.record(actions, seed)


def _intersect_ranges(limits: tuple[float, float], typical: tuple[float, float]) -> tuple[float, float]:
    """The part of both, or limits where they have none (at least a factor of 1.5) in common."""
    low, high = max(limits[0], typical[0]), min(limits[1], typical[1])
    return (low, high) if high >= 1.5 * low else limits
