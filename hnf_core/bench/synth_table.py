"""One material's F_Θ, tabulated over direction, speed and force: what the network answers, while what linear contact
expects is worked out at each state, since that is what has tones and edges. Measured here, and used nowhere: at the
H = 256 that is shipped the network is a quarter of a state's time, and the table costs more states than a stroke has.

Answers lie on a grid, linear in the direction's angle, log v and log F between its points. A direction is one of many
only where the material is the same in no two of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import UsageError
from ..field.adaptive import interpolate_rows
from ..field.field import Emission, Field, evaluate, get_network
from ..field.linear_contact import FORCE_FLOOR_N, SPEED_FLOOR_M_S, Condition
from ..material.mechanics import Mechanics
from ..material.token import BAND_FEATURES, BAND_WAVELENGTHS_M

Float = NDArray[np.float64]
Float32 = NDArray[np.float32]
Integers = NDArray[np.int64]

SPEEDS_M_S = (SPEED_FLOOR_M_S, 1.024)
FORCES_N = (FORCE_FLOOR_N, 5.12)
"""Beyond them the nearest is read."""
TABLE_BATCH = 512
_ISOTROPY_TOLERANCE = 1e-6


@dataclass(frozen=True)
class TableGrid:
    """Points of a table: directions over the half turn (those of an isotropic material are one), speeds and forces per
    octave."""

    directions: int = 8
    per_octave_speed: int = 64
    per_octave_force: int = 4


@dataclass(frozen=True)
class FieldTable:
    """values: (D, V, F, outputs) float32, what the α head answers and then the σ head. angle_step: radians between
    directions, whose first is 0; the table repeats after the last. speed, force: log of the first point and step of the
    log. outputs: of the α head."""

    values: Float32
    angle_step: float
    speed: tuple[float, float]
    force: tuple[float, float]
    outputs: int

    @property
    def megabytes(self) -> float:
        return self.values.nbytes / 1e6


def tabulate_field(
    model: Field, token: Float32, mechanics: Mechanics, probe: str, grid: TableGrid = TableGrid()
) -> FieldTable:
    """Ask the network all over the grid. Raises UsageError for a field whose α is not an exponential of one head."""
    config = model.config
    if config.emission != "log" or config.alpha_heads != 1:
        raise UsageError("a table needs one head that gives log amplitudes.", remedy="Evaluate the field instead.")
    turn = np.pi if config.stroke_frame or not config.directed else 2.0 * np.pi
    count = 1 if _is_isotropic(token) else grid.directions * round(turn / np.pi)
    speed, force = _make_axis(SPEEDS_M_S, grid.per_octave_speed), _make_axis(FORCES_N, grid.per_octave_force)
    angles = np.arange(count) * turn / count
    d, v, f = (each.ravel() for each in np.meshgrid(angles, speed, force, indexing="ij"))
    asked = get_network(model)
    rows = np.empty((len(d), config.alpha_outputs + config.states), dtype=np.float32)
    for low in range(0, len(d), TABLE_BATCH):
        part = slice(low, low + TABLE_BATCH)

        def noted(x: Float32, part: slice = part) -> tuple[Float32, Float32]:
            answers = asked(x)
            rows[part] = np.concatenate(answers, axis=1)
            return answers

        evaluate(model, _make_conditions(token, mechanics, probe, d[part], v[part], f[part]), noted)
    return FieldTable(
        rows.reshape(count, len(speed), len(force), -1),
        turn / count,
        (float(np.log(speed[0])), float(np.log(speed[1] / speed[0]))),
        (float(np.log(force[0])), float(np.log(force[1] / force[0]))),
        config.alpha_outputs,
    )


def evaluate_table(table: FieldTable, model: Field, condition: Condition) -> Emission:
    """What F_Θ emits at each of n states on the table's material, answered by the table."""
    rows = interpolate_table(table, condition)
    return evaluate(model, condition, (rows[:, : table.outputs], rows[:, table.outputs :]))


def interpolate_table(table: FieldTable, condition: Condition) -> Float32:
    """(n, outputs) what both heads would answer at each of n states."""
    directions, speeds, forces, width = table.values.shape
    rows: list[tuple[Integers, Float]] = [
        (np.zeros(len(condition.speed), dtype=np.int64), np.ones(len(condition.speed)))
    ]
    if directions > 1:
        angle = np.arctan2(condition.direction[:, 1], condition.direction[:, 0]) / table.angle_step
        low = np.floor(angle).astype(np.int64)
        rows = [(low % directions, 1.0 - (angle - low)), ((low + 1) % directions, angle - low)]
    (speed, faster), (force, harder) = (
        _locate(np.log(np.maximum(of, floor)), count, *axis)
        for count, of, floor, axis in (
            (speeds, condition.speed, SPEED_FLOOR_M_S, table.speed),
            (forces, condition.force, FORCE_FLOOR_N, table.force),
        )
    )
    both = ((speed, 1.0 - faster), (speed + 1, faster))
    corners = [((d * speeds + v) * forces + force, of_d * of_v) for d, of_d in rows for v, of_v in both]
    row, factor = (np.stack(each, axis=1) for each in zip(*corners, strict=True))
    return interpolate_rows(
        table.values.reshape(-1, width), row, np.repeat(harder[:, None], len(corners), axis=1), factor
    )


def _locate(log: Float, count: int, start: float, step: float) -> tuple[Integers, Float]:
    """The point of an axis before each number (n,), and how far it is on the way to the next."""
    place = np.clip((log - start) / step, 0.0, count - 1)
    low = np.minimum(place.astype(np.int64), count - 2)
    return low, place - low


def _make_conditions(
    token: Float32, mechanics: Mechanics, probe: str, angle: Float, speed: Float, force: Float
) -> Condition:
    count = len(angle)
    return Condition(
        np.tile(np.asarray(token, dtype=np.float64), (count, 1)), (mechanics,), np.zeros(count, dtype=np.int32),
        np.stack([np.cos(angle), np.sin(angle)], axis=1), speed, force, np.ones(count, dtype=bool), probe,
    )  # fmt: skip


def _make_axis(ends: tuple[float, float], per_octave: int) -> Float:
    return np.geomspace(*ends, round(per_octave * np.log2(ends[1] / ends[0])) + 1)


def _is_isotropic(token: Float32) -> bool:
    """Whether no moment of direction and no tone tells one direction from another."""
    bands = np.asarray(token)[: len(BAND_WAVELENGTHS_M) * len(BAND_FEATURES)].reshape(-1, len(BAND_FEATURES))
    moments = [BAND_FEATURES.index(name) for name in ("cos2", "sin2", "cos4", "sin4", "peak")]
    return bool(np.all(np.abs(bands[:, moments]) < _ISOTROPY_TOLERANCE))
