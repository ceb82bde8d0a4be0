"""The contact simulator as a data set: library materials that can be stroked as often as one likes."""

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
from ..material.probe import PROBES
from ..simulation.dft321 import dft321
from ..simulation.height_sampling import SmoothedMaps
from ..simulation.simulate import SAMPLE_RATE_HZ, Stroke, simulate_batch
from ..simulation.surface_recipe import TILE_PIXELS, TILE_SIZE_M, SurfaceRecipe, height_map
from .recording import ActionRange, DataSet, Recording, match_name

Float = NDArray[np.float64]

PATCH_TILES = 2
"""A patch is so many library tiles wide: its period of 40 mm puts the lines of a straight stroke closer together than a
100 ms window resolves, up to 0.4 m/s."""
ROTATION_RAD = (np.radians(1.0), np.radians(2.0))
"""By how much the surface lies turned under a stroke, one way or the other. A straight stroke along the tile would else
meet the same 40 mm again and again; so each time round it runs 0.7 to 1.4 mm beside."""
PATCH_COUNT = 4
"""Different patches in one call, so that no single one stands for the material."""
SETTLE_S = 0.06
"""Simulated ahead of the recording, at the first speed and force: the start from rest is not part of it."""
MAX_BATCH_SAMPLES = 5_000_000
"""Rows times samples simulated at once: about 1.1 GB."""
SPEED_RANGE_M_S = (0.03, 0.25)
FORCE_RANGE_N = (0.3, 3.0)
"""Where strokes mostly are; the simulator itself has no limit here."""


@dataclass(frozen=True)
class SimulatedProcess:
    """A recipe with mechanics, stroked with the probe that each action names. A seed draws the patches (the recipe's
    random parts anew) and the place on them where each stroke starts."""

    name: str
    recipe: SurfaceRecipe
    mechanics: Mechanics

    def record(self, actions: Sequence[Action], seed: int) -> list[Recording]:
        """One recording per action, DFT321 over the whole of it, mean removed; out of contact the axes are 0.

        What action i gets depends on (seed, i) and on the action, not on its company. Raises UsageError where actions
        are not equally long.
        """
        if len({round(action.duration_s * SAMPLE_RATE_HZ) for action in actions}) != 1:
            raise UsageError("the actions of one call must be equally long.")
        patches = [self._make_patch(seed, index) for index in range(min(PATCH_COUNT, len(actions)))]
        starts = _make_generator(seed, 0).uniform(0.0, PATCH_TILES * TILE_SIZE_M, (len(actions), 2))
        turns = _make_generator(seed, 2).uniform(*ROTATION_RAD, (len(actions), 2))
        turns = turns[:, 0] * np.where(turns[:, 1] < np.mean(ROTATION_RAD), -1.0, 1.0)
        # Side by side: one probe per batch, and rows that share what a patch has smoothed.
        order = sorted(
            range(len(actions)),
            key=lambda row: (actions[row].probe, row % PATCH_COUNT, float(actions[row].force.max())),
        )
        signals: dict[int, Float] = {}
        for rows in _group_batches(order, actions):
            acceleration = simulate_batch(
                [patches[row % PATCH_COUNT] for row in rows],
                [build_stroke(actions[row], starts[row], float(turns[row])) for row in rows],
                [self.mechanics] * len(rows),
                PROBES[actions[rows[0]].probe],
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
    """The library's materials. There are no recordings of them and no photographs."""

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
    """The action's path from start_m (x, y), turned by turn_rad, at 10 kHz, with SETTLE_S of its first state ahead.

    Between action samples speed, direction and force are cubic (R. G. Keys 1981, IEEE Trans. ASSP 29): straight pieces
    would ring the contact at every corner. Out of contact the force is 0.
    """
    count, ahead = round(action.duration_s * SAMPLE_RATE_HZ), round(SETTLE_S * SAMPLE_RATE_HZ)
    place = np.maximum(np.arange(-ahead, count) / SAMPLE_RATE_HZ * action.rate, 0.0)
    force = np.where(_is_touching(action, place), np.maximum(_interpolate_cubic(action.force, place), 0.0), 0.0)
    velocity = np.stack([_interpolate_cubic(action.speed * axis, place) for axis in action.direction.T], axis=1)
    cosine, sine = np.cos(rotation_rad), np.sin(rotation_rad)
    velocity = velocity @ np.array([[cosine, sine], [-sine, cosine]])
    travelled = np.cumsum(velocity, axis=0) / SAMPLE_RATE_HZ
    return Stroke(np.asarray(start_m) + travelled - travelled[ahead], force)


def _is_touching(action: Action, sample_index: Float) -> NDArray[np.bool_]:
    return np.asarray(action.contact[np.clip(np.round(sample_index).astype(np.int64), 0, len(action.contact) - 1)])


def _interpolate_cubic(values: Float, position: Float) -> Float:
    padded = np.concatenate([2.0 * values[:1] - values[1:2], values, np.repeat(2.0 * values[-1:] - values[-2:-1], 2)])
    low = np.clip(np.floor(position).astype(np.int64), 0, len(values) - 1)
    t = position - low
    a, b, c, d = (padded[low + k] for k in range(4))
    return np.asarray(b + 0.5 * t * (c - a + t * (2.0 * a - 5.0 * b + 4.0 * c - d + t * (3.0 * (b - c) + d - a))))


def _fuse_axes(axes: Float, action: Action) -> Float:
    place = np.arange(len(axes)) / SAMPLE_RATE_HZ * action.rate
    touching = _is_touching(action, place)
    if touching.any():
        axes = np.where(touching[:, None], axes - axes[touching].mean(axis=0), 0.0)
    else:
        axes = np.zeros_like(axes)
    return dft321(axes)


def _group_batches(row_order: Sequence[int], actions: Sequence[Action]) -> list[list[int]]:
    most = max(1, int(MAX_BATCH_SAMPLES / (actions[0].duration_s * SAMPLE_RATE_HZ)))
    out: list[list[int]] = []
    for row in row_order:
        if out and len(out[-1]) < most and actions[out[-1][0]].probe == actions[row].probe:
            out[-1].append(row)
        else:
            out.append([row])
    return out


def _widen_recipe(recipe: SurfaceRecipe) -> SurfaceRecipe:
    """The same surface on a tile TILES times as wide: lattices repeat so many times more often on it."""
    lattices = tuple(
        replace(
            part,
            waves=tuple((PATCH_TILES * x, PATCH_TILES * y, amplitude, phase) for x, y, amplitude, phase in part.waves),
        )
        for part in recipe.lattices
    )
    return replace(recipe, lattices=lattices)


def _make_generator(seed: int, *key: int) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=key)))
