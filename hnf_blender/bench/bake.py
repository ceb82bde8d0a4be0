"""A bake in every way there is: how long, how much memory, and how far what is felt then is from what a much finer look
and F_Θ in float64 would have given.

All ways are taken in turn, round by round. Close-ups of fewer pixels and of more stand beside those that are shipped:
of a relief that is a pattern, and of one that is an image, where a first look says how many it takes.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from hnf_core.bench.frame import Options, Row, Times
from hnf_core.bench.memory import with_peak
from hnf_core.errors import HnfError
from hnf_core.field.blocks import rendered
from hnf_core.field.prepared import prepare
from hnf_core.field.stroke import StrokeInput
from hnf_core.field.weights import load_field
from hnf_core.material.token import LEVELS

from .needs import need_bpy
from .scale_scenes import SIZE_M, picture_relief, plate, strokes
from .stage import playing

NAME = "bake"
PIXELS, USUAL, FINE = (128, 256, 512, 1024), 512, 2048
"""Of a close-up's side: those compared, what is shipped, and the reference's, 10 µm each."""
QUICK_PIXELS, QUICK_USUAL, QUICK_FINE = (64, 128), 128, 256
FIRST, QUICK_FIRST = 128, 32
"""Of the first look that is shipped."""
TEXELS = (240, 480)
"""Along a side of an image relief: half a millimetre and a quarter on the plate of 12 cm."""
STROKES, LENGTH_M, QUICK_LENGTH_M = 2, 0.03, 0.01
SEED = 5

Felt = Mapping[str, StrokeInput]
Float = NDArray[np.float64]


@dataclass(frozen=True)
class Way:
    """pixels: of a side of its close-ups. ready: makes what is there before it, neither timed nor counted. first: of a
    side of a first look, None = without."""

    name: str
    pixels: int
    ready: Callable[[], object]
    first: int | None = None


class Room:
    """The file that is open, and the cache of its close-ups."""

    def __init__(self, scene: Any, layer: Any, cache: Path) -> None:
        self._scene, self._layer, self._cache = scene, layer, cache

    def bake(self, pixels: int, first: int | None = None) -> Felt:
        """What the field is asked about each stroke, as the file keeps it. Raises HnfError where a stroke fails."""
        from ..bridge.strokes import stroke_objects
        from ..jobs import running
        from ..touch import bake
        from ..touch.stroke_bake import load_bake

        with (
            patch.object(running, "cache_folder", lambda: self._cache),
            patch.object(bake, "PATCH_PIXELS", pixels),
            patch.object(bake, "FIRST_PIXELS", first),
        ):
            ended = running.bake_in_line(self._scene, self._layer)
        found = {obj.name: load_bake(obj) for obj in stroke_objects(self._scene)}
        if not ended.ok:
            raise HnfError(f"the bake failed: {ended.message}", where=NAME)
        return {name: each.stroke for name, each in found.items() if each is not None}

    def forget_bakes(self) -> None:
        """As before the first bake, but for its close-ups."""
        from ..jobs.purge import purge

        purge(self._scene, self._layer, everything=True)

    def forget_all(self) -> None:
        """As before the first bake."""
        self.forget_bakes()
        shutil.rmtree(self._cache, ignore_errors=True)

    def close_ups_there(self, pixels: int) -> None:
        """As after a bake whose results were removed. What is fresh would not be looked at, whatever its pixels."""
        self.forget_bakes()
        self.bake(pixels)
        self.forget_bakes()


def rows(options: Options) -> list[Row]:
    """Of a pattern: a cold bake at each size of the close-ups, one whose close-ups are there, one of what is fresh. Of
    images: all pixels at once, and the first look.

    Raises HnfError without bpy, or where a bake fails. Empties the file that is open.
    """
    need_bpy(NAME)
    found = _rows(options, "", lambda room: _ways(room, options.quick))
    for texels in TEXELS[: 1 if options.quick else None]:
        told = f"an image of {1e3 * SIZE_M / texels:.2g} mm texels, "
        found += _rows(options, told, partial(_first_looks, told, quick=options.quick), texels)
    return found


def _rows(options: Options, told: str, ways_in: Callable[[Room], list[Way]], texels: int = 0) -> list[Row]:
    """The reference and all ways in one scene. texels: of the image that its relief is; 0: a pattern."""
    with playing() as (scene, layer), tempfile.TemporaryDirectory() as folder:
        surface = plate(32)
        if texels:
            picture_relief(surface, texels, SEED)
        strokes(STROKES, surface, apart=True, length_m=QUICK_LENGTH_M if options.quick else LENGTH_M)
        layer.update()
        room = Room(scene, layer, Path(folder) / "cache")
        ways = ways_in(room)
        times = {way.name: Times(time.process_time) for way in ways}
        felt: dict[str, Felt] = {}
        peaks: dict[str, float | None] = {}
        for repeat in range(options.repeats):
            for way in ways:
                options.watch(f"{NAME}: {way.name}, {repeat + 1} of {options.repeats}")
                way.ready()
                bake = partial(times[way.name].take, partial(room.bake, way.pixels, way.first))
                felt[way.name], peak = with_peak(bake)
                peaks.setdefault(way.name, peak)  # later ones find room that the allocator kept
        options.watch(f"{NAME}: the reference")
        room.forget_all()
        fine = QUICK_FINE if options.quick else FINE
        true = room.bake(fine)
        exact = signals(true, exactly=True)
    usual = next(way.name for way in ways if way.pixels == _usual(options.quick) and way.first is None)
    reference = f"the reference: close-ups of {fine} pixels, F_Θ in float64 2000 times a second"
    found = [Row(NAME, f"{told}fine", error_unit="dB", note=reference)]
    for way in ways:
        row = Row(
            NAME, way.name, times[way.name].seconds, times[way.name].cpu,
            error=off_db(signals(felt[way.name]), exact), error_unit="dB", peak_mb=peaks[way.name],
            note=f"levels of bands off by at most {levels_off_db(felt[way.name], true):.2g} dB",
        )  # fmt: skip
        beside = times[way.name].ratio(times[usual])
        found.append(row if way.name == usual else replace(row, ratio=beside, ratio_to=usual))
    return found


def _usual(quick: bool) -> int:
    return QUICK_USUAL if quick else USUAL


def _sizes(quick: bool) -> tuple[int, ...]:
    return QUICK_PIXELS if quick else PIXELS


def _ways(room: Room, quick: bool) -> list[Way]:
    usual = _usual(quick)
    cold = {pixels: Way(f"cold, {pixels} pixels", pixels, room.forget_all) for pixels in _sizes(quick)}
    return [
        *(way for pixels, way in cold.items() if pixels <= usual),
        Way("close-ups kept", usual, partial(room.close_ups_there, usual)),
        Way("nothing changed", usual, partial(room.bake, usual)),
        *(way for pixels, way in cold.items() if pixels > usual),
    ]


def _first_looks(told: str, room: Room, *, quick: bool) -> list[Way]:
    usual, first = _usual(quick), QUICK_FIRST if quick else FIRST
    return [
        Way(f"{told}{usual} pixels at once", usual, room.forget_all),
        Way(f"{told}a first look of {first}", usual, room.forget_all, first),
    ]


def signals(felt: Felt, *, exactly: bool = False) -> Float:
    """All strokes one after the other, as scenes hear them; exactly: F_Θ in float64, 2000 times a second."""
    field = load_field()
    if exactly:
        field = replace(field, parameters={name: value.astype(np.float64) for name, value in field.parameters.items()})
    tolerance = 0.0 if exactly else None
    made = [rendered(prepare(field, felt[name], seed=SEED, tolerance=tolerance)) for name in sorted(felt)]
    return np.concatenate(made)


def off_db(samples: Float, exact: Float) -> float:
    """Power of the difference over the power of the exact signal."""
    return float(10.0 * np.log10(np.mean(np.square(samples - exact)) / np.mean(np.square(exact))))


def levels_off_db(felt: Felt, true: Felt) -> float:
    """The largest difference of a band's level in any token."""
    return max(float(20.0 * np.abs(felt[name].tokens[:, LEVELS] - true[name].tokens[:, LEVELS]).max()) for name in true)
