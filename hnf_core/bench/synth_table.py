"""One material's F_Θ, tabulated over direction, speed and force: measured here, and used nowhere, since its errors are
large where its size is bearable.

log α (before its gate, which is exact and cheap) and σΔt lie on a grid, linear in the direction's angle, log v and
log F between its points. A direction is one of many only where the material is the same in no two of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import UsageError
from ..field.features import gate_of
from ..field.field import Emission, Field, before_gate
from ..field.linear_contact import FORCE_FLOOR_N, SPEED_FLOOR_M_S, Condition
from ..material.mechanics import Mechanics
from ..material.token import BAND_FEATURES, BAND_WAVELENGTHS_M

Float = NDArray[np.float64]

SPEEDS_M_S = (SPEED_FLOOR_M_S, 1.024)
FORCES_N = (FORCE_FLOOR_N, 5.12)
"""Beyond them the nearest is read."""
AT_ONCE = 512
_QUIETEST = 1e-12
_ISOTROPIC = 1e-6


@dataclass(frozen=True)
class Grid:
    """Points of a table: directions over the half turn (those of an isotropic material are one), speeds and forces per
    octave."""

    directions: int = 48
    per_octave_speed: int = 4
    per_octave_force: int = 2


@dataclass(frozen=True)
class Table:
    """values: (D, V, F, K + N) float32, log α and σΔt. angle_step: radians between directions, whose first is 0; the
    table repeats after the last. speed, force: log of the first point and step of the log. material: what it is of."""

    values: NDArray[np.float32]
    angle_step: float
    speed: tuple[float, float]
    force: tuple[float, float]
    carriers: int
    material: tuple[bytes, Mechanics, str]

    @property
    def megabytes(self) -> float:
        return self.values.nbytes / 1e6


def tabulate(field: Field, token: NDArray[np.float32], mechanics: Mechanics, probe: str, grid: Grid = Grid()) -> Table:
    """Evaluate F_Θ all over the grid. Raises UsageError for a field whose α is not an exponential of one head."""
    config = field.config
    if config.emission != "log" or config.alpha_heads != 1:
        raise UsageError("a table needs one head that gives log amplitudes.", remedy="Evaluate the field instead.")
    turn = np.pi if config.stroke_frame or not config.directed else 2.0 * np.pi
    count = 1 if _isotropic(token) else grid.directions * round(turn / np.pi)
    speed, force = _axis(SPEEDS_M_S, grid.per_octave_speed), _axis(FORCES_N, grid.per_octave_force)
    angles = np.arange(count) * turn / count
    d, v, f = (each.ravel() for each in np.meshgrid(angles, speed, force, indexing="ij"))
    rows = np.empty((len(d), config.carriers.count + config.states), dtype=np.float32)
    for low in range(0, len(d), AT_ONCE):
        part = slice(low, low + AT_ONCE)
        here = _conditions(token, mechanics, probe, d[part], v[part], f[part])
        alpha, sigma_dt, _ = before_gate(field, here)
        rows[part] = np.concatenate([np.log(np.maximum(alpha[:, 0], _QUIETEST)), sigma_dt], axis=1)
    return Table(
        rows.reshape(count, len(speed), len(force), -1),
        turn / count,
        (float(np.log(speed[0])), float(np.log(speed[1] / speed[0]))),
        (float(np.log(force[0])), float(np.log(force[1] / force[0]))),
        config.carriers.count,
        (np.asarray(token, dtype=np.float32).tobytes(), mechanics, probe),
    )


def read_table(table: Table, field: Field, condition: Condition) -> Emission:
    """What F_Θ would emit at each of n states on the table's material."""
    values = table.values
    count, width = len(condition.speed), values.shape[-1]
    angle = np.arctan2(condition.direction[:, 1], condition.direction[:, 0]) / table.angle_step
    low = np.floor(angle).astype(np.int64)
    places = [(low % len(values), (low + 1) % len(values), angle - low)]
    for axis, (of, floor, (start, step)) in enumerate(
        ((condition.speed, SPEED_FLOOR_M_S, table.speed), (condition.force, FORCE_FLOOR_N, table.force)), start=1
    ):
        last = values.shape[axis] - 1
        place = np.clip((np.log(np.maximum(of, floor)) - start) / step, 0.0, last)
        low = np.minimum(place.astype(np.int64), last - 1)
        places.append((low, low + 1, place - low))
    total = np.zeros((count, width), dtype=np.float32)
    (d0, d1, dt), (v0, v1, vt), (f0, f1, ft) = places
    for d, dw in ((d0, 1.0 - dt),) if len(values) == 1 else ((d0, 1.0 - dt), (d1, dt)):
        dw = np.ones(count) if len(values) == 1 else dw
        for v, vw in ((v0, 1.0 - vt), (v1, vt)):
            for f, fw in ((f0, 1.0 - ft), (f1, ft)):
                total += (dw * vw * fw).astype(np.float32)[:, None] * values[d, v, f]
    alpha = np.exp(total[:, : table.carriers]) * gate_of(condition, field.config.carriers)
    return Emission(alpha[:, None, :].astype(np.float64), total[:, table.carriers :].astype(np.float64))


def _conditions(
    token: NDArray[np.float32], mechanics: Mechanics, probe: str, angle: Float, speed: Float, force: Float
) -> Condition:
    count = len(angle)
    return Condition(
        np.tile(np.asarray(token, dtype=np.float64), (count, 1)), (mechanics,), np.zeros(count, dtype=np.int32),
        np.stack([np.cos(angle), np.sin(angle)], axis=1), speed, force, np.ones(count, dtype=bool), probe,
    )  # fmt: skip


def _axis(ends: tuple[float, float], per_octave: int) -> Float:
    return np.geomspace(*ends, round(per_octave * np.log2(ends[1] / ends[0])) + 1)


def _isotropic(token: NDArray[np.float32]) -> bool:
    """Whether no moment of direction and no tone tells one direction from another."""
    bands = np.asarray(token)[: len(BAND_WAVELENGTHS_M) * len(BAND_FEATURES)].reshape(-1, len(BAND_FEATURES))
    moments = [BAND_FEATURES.index(name) for name in ("cos2", "sin2", "cos4", "sin4", "peak")]
    return bool(np.all(np.abs(bands[:, moments]) < _ISOTROPIC))
