"""The contact simulator as a data set: library materials that can be stroked any number of times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from ..errors import UsageError
from ..material.contact_model import Mechanics
from ..material.library import LibraryMaterial, load_library
from ..material.probe import get_probe
from ..signal import dft321
from ..simulation.contact_dynamics import SmoothedMaps
from ..simulation.simulate import SAMPLE_RATE_HZ, Stroke, simulate_batch
from ..simulation.surface_recipe import TILE_PIXELS, TILE_SIZE_M, SurfaceRecipe, height_map
from .recording import ActionRange, DataSet, Recording, match_name

Float = NDArray[np.float64]

PATCH_TILES = 2
"""Side of a patch in library tiles: with a period of 40 mm, the spectral lines of a straight stroke are closer than a
100 ms window resolves, up to 0.4 m/s."""
ROTATION_RAD = (np.radians(1.0), np.radians(2.0))
"""Range of the surface's rotation under a stroke, either way [rad]. A straight stroke along the tile would repeat the
same 40 mm; rotated, each repetition runs 0.7 to 1.4 mm beside the last."""
PATCH_COUNT = 4
"""Number of different patches in a call, so that no single one represents the material."""
SETTLE_S = 0.06
"""Time simulated before the recording at the first speed and force [s], since the start from rest is not part of it."""
MAX_BATCH_SAMPLES = 5_000_000
"""Largest number of rows times samples simulated at once; about 1.1 GB."""
SPEED_RANGE_M_S = (0.03, 0.25)
"""Range of typical speeds [m/s]; the simulator itself has no limit here."""
FORCE_RANGE_N = (0.3, 3.0)
"""Range of typical forces [N]."""


@dataclass(frozen=True)
class SimulatedProcess:
    """A simulated material as a source of recordings: a surface recipe with mechanics, stroked by the action's probe.

    A seed draws the patches (the recipe's random parts) and the position on them where each stroke starts.
    """

    name: str
    recipe: SurfaceRecipe
    mechanics: Mechanics

    def record(self, actions: Sequence[Action], seed: int) -> list[Recording]:
        """Simulate one recording per action, mean removed, fused by DFT321; without contact the axes are 0.

        The result for action i depends on (seed, i) and the action, not on the other actions. Raises UsageError if the
        actions are not equally long.
        """
        if len({round(action.duration_s * SAMPLE_RATE_HZ) for action in actions}) != 1:
            raise UsageError("the actions of one call must be equally long.")
        patches = [self._make_patch(seed, index) for index in range(min(PATCH_COUNT, len(actions)))]
        starts = _make_generator(seed, 0).uniform(0.0, PATCH_TILES * TILE_SIZE_M, (len(actions), 2))
        rotations = _make_generator(seed, 2).uniform(*ROTATION_RAD, (len(actions), 2))
        rotations = rotations[:, 0] * np.where(rotations[:, 1] < np.mean(ROTATION_RAD), -1.0, 1.0)
        # Rows are sorted so that a batch has one probe, and rows that share a smoothed patch are adjacent.
        order = sorted(
            range(len(actions)),
            key=lambda row: (actions[row].probe, row % PATCH_COUNT, float(actions[row].force.max())),
        )
        signals: dict[int, Float] = {}
        for rows in _group_batches(order, actions):
            acceleration = simulate_batch(
                [patches[row % PATCH_COUNT] for row in rows],
                [build_stroke(actions[row], starts[row], float(rotations[row])) for row in rows],
                [self.mechanics] * len(rows),
                get_probe(actions[rows[0]].probe),
            )[:, round(SETTLE_S * SAMPLE_RATE_HZ) :]
            for row, axes in zip(rows, acceleration, strict=True):
                signals[row] = _fuse_axes(axes, actions[row])
        source = f"simulated {self.name}, seed {seed}"
        return [
            Recording(action, signals[row], SAMPLE_RATE_HZ, self.name, f"{source}, action {row}")
            for row, action in enumerate(actions)
        ]

    def _make_patch(self, seed: int, index: int) -> SmoothedMaps:
        size = PATCH_TILES * TILE_SIZE_M
        draw = int(_make_generator(seed, 1, index).integers(2**63))
        return SmoothedMaps(
            height_map(_widen_recipe(self.recipe), draw, pixels=PATCH_TILES * TILE_PIXELS, size_m=size), size
        )


@dataclass(frozen=True)
class SimulatedLibrary(DataSet):
    """The library's materials as a data set that is simulated on demand; it has no recordings and no photographs."""

    @property
    def materials(self) -> tuple[str, ...]:
        return tuple(sorted(material.name for material in load_library()))

    def recordings(self, name: str) -> list[Recording]:
        self._find_material(name)
        return []

    def process(self, name: str) -> SimulatedProcess:
        material = self._find_material(name)
        return SimulatedProcess(material.name, SurfaceRecipe.from_dict(material.recipe), material.mechanics)

    def action_range(self, name: str) -> ActionRange:
        self._find_material(name)
        return ActionRange(SPEED_RANGE_M_S, FORCE_RANGE_N)

    def image(self, name: str) -> Path | None:
        self._find_material(name)
        return None

    def _find_material(self, name: str) -> LibraryMaterial:
        known = match_name(name, self.materials, "the material library")
        return next(material for material in load_library() if material.name == known)


def build_stroke(action: Action, start_m: Float, rotation_rad: float = 0.0) -> Stroke:
    """Build the simulator's input, an action's path at 10 kHz, preceded by `SETTLE_S` of its first state to settle.

    Speed, direction and force are interpolated by cubics (R. G. Keys 1981, IEEE Trans. ASSP 29), since linear segments
    would excite the contact at every corner. Without contact the force is 0.

    Parameters
    ----------
    action : Action
        The action.
    start_m : ndarray, shape (2,)
        Position of its start on the map [m].
    rotation_rad : float
        Rotation of its path [rad].

    Returns
    -------
    Stroke
        The stroke.
    """
    count, settle_samples = round(action.duration_s * SAMPLE_RATE_HZ), round(SETTLE_S * SAMPLE_RATE_HZ)
    position = np.maximum(np.arange(-settle_samples, count) / SAMPLE_RATE_HZ * action.rate, 0.0)
    force = np.where(_is_touching(action, position), np.maximum(_interpolate_cubic(action.force, position), 0.0), 0.0)
    velocity = np.stack([_interpolate_cubic(action.speed * axis, position) for axis in action.direction.T], axis=1)
    cosine, sine = np.cos(rotation_rad), np.sin(rotation_rad)
    velocity = velocity @ np.array([[cosine, sine], [-sine, cosine]])
    path = np.cumsum(velocity, axis=0) / SAMPLE_RATE_HZ
    return Stroke(np.asarray(start_m) + path - path[settle_samples], force)


def _is_touching(action: Action, sample_index: Float) -> NDArray[np.bool_]:
    return np.asarray(action.contact[np.clip(np.round(sample_index).astype(np.int64), 0, len(action.contact) - 1)])


def _interpolate_cubic(values: Float, position: Float) -> Float:
    padded = np.concatenate([2.0 * values[:1] - values[1:2], values, np.repeat(2.0 * values[-1:] - values[-2:-1], 2)])
    low = np.clip(np.floor(position).astype(np.int64), 0, len(values) - 1)
    t = position - low
    a, b, c, d = (padded[low + k] for k in range(4))
    return np.asarray(b + 0.5 * t * (c - a + t * (2.0 * a - 5.0 * b + 4.0 * c - d + t * (3.0 * (b - c) + d - a))))


def _fuse_axes(axes: Float, action: Action) -> Float:
    sample_index = np.arange(len(axes)) / SAMPLE_RATE_HZ * action.rate
    touching = _is_touching(action, sample_index)
    if touching.any():
        axes = np.where(touching[:, None], axes - axes[touching].mean(axis=0), 0.0)
    else:
        axes = np.zeros_like(axes)
    return dft321(axes)


def _group_batches(row_order: Sequence[int], actions: Sequence[Action]) -> list[list[int]]:
    max_rows = max(1, int(MAX_BATCH_SAMPLES / (actions[0].duration_s * SAMPLE_RATE_HZ)))
    batches: list[list[int]] = []
    for row in row_order:
        if batches and len(batches[-1]) < max_rows and actions[batches[-1][0]].probe == actions[row].probe:
            batches[-1].append(row)
        else:
            batches.append([row])
    return batches


def _widen_recipe(recipe: SurfaceRecipe) -> SurfaceRecipe:
    """Return a surface recipe for a tile `PATCH_TILES` times as wide, with lattices of the same wavelength."""
    lattices = tuple(
        replace(
            lattice,
            waves=tuple(
                (PATCH_TILES * x, PATCH_TILES * y, amplitude, phase) for x, y, amplitude, phase in lattice.waves
            ),
        )
        for lattice in recipe.lattices
    )
    return replace(recipe, lattices=lattices)


def _make_generator(seed: int, *key: int) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=key)))
