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

from hnf_core.errors import HnfError
from hnf_core.field.prepare import prepare_stroke
from hnf_core.field.render import render_samples
from hnf_core.field.stroke import StrokeInput
from hnf_core.field.weights import load_field
from hnf_core.material.token import LEVELS

from ..bench.harness import BenchOptions, Row, Times, run_with_peak
from .scenes import PLATE_M, add_relief_plate, add_strokes, open_test_file, require_bpy, set_image_relief

BAKE_NAME = "bake"
COMPARED_PIXELS, DEFAULT_PIXELS, REFERENCE_PIXELS = (128, 256, 512, 1024), 512, 2048
"""Of a close-up's side: those compared, what is shipped, and the reference's, 10 µm each."""
QUICK_PIXELS, QUICK_USUAL, QUICK_FINE = (64, 128), 128, 256
FIRST_PASS_PIXELS, QUICK_FIRST = 128, 32
"""Of the first look that is shipped."""
IMAGE_TEXELS = (240, 480)
"""Along a side of an image relief: half a millimetre and a quarter on the plate of 12 cm."""
STROKE_COUNT, LENGTH_M, QUICK_LENGTH_M = 2, 0.03, 0.01
SEED = 5

StrokeInputs = Mapping[str, StrokeInput]
Float = NDArray[np.float64]


@dataclass(frozen=True)
class BakeMethod:
    """pixels: of a side of its close-ups. ready: makes what is there before it, neither timed nor counted. first: of a
    side of a first look, None = without."""

    name: str
    pixels: int
    prepare: Callable[[], object]
    first_pass: int | None = None


class BakeSession:
    """The file that is open, and the cache of its close-ups."""

    def __init__(self, scene: Any, layer: Any, cache: Path) -> None:
        self._scene, self._layer, self._cache = scene, layer, cache

    def bake(self, pixels: int, first_pass: int | None = None) -> StrokeInputs:
        """What the field is asked about each stroke, as the file keeps it. Raises HnfError where a stroke fails."""
        from hnf_blender.bridge.stroke.read_stroke import list_strokes
        from hnf_blender.jobs import bake_job
        from hnf_blender.touch import bake_patches as bake
        from hnf_blender.touch.stroke_bake import load_bake

        with (
            patch.object(bake_job, "get_cache_folder", lambda: self._cache),
            patch.object(bake, "PATCH_PIXELS", pixels),
            patch.object(bake, "FIRST_PASS_PIXELS", first_pass),
        ):
            ended = bake_job.bake_blocking(self._scene, self._layer)
        found = {obj.name: load_bake(obj) for obj in list_strokes(self._scene)}
        if not ended.ok:
            raise HnfError(f"the bake failed: {ended.message}", where=BAKE_NAME)
        return {name: each.stroke for name, each in found.items() if each is not None}

    def clear_bakes(self) -> None:
        """As before the first bake, but for its close-ups."""
        from hnf_blender.jobs.baked_data import purge

        purge(self._scene, self._layer, everything=True)

    def clear_all(self) -> None:
        """As before the first bake."""
        self.clear_bakes()
        shutil.rmtree(self._cache, ignore_errors=True)

    def prepare_close_ups(self, pixels: int) -> None:
        """As after a bake whose results were removed. What is fresh would not be looked at, whatever its pixels."""
        self.clear_bakes()
        self.bake(pixels)
        self.clear_bakes()


def measure_bake(options: BenchOptions) -> list[Row]:
    """Of a pattern: a cold bake at each size of the close-ups, one whose close-ups are there, one of what is fresh. Of
    images: all pixels at once, and the first look.

    Raises HnfError without bpy, or where a bake fails. Empties the file that is open.
    """
    require_bpy(BAKE_NAME)
    found = _measure_scene(options, "", lambda room: _make_pattern_methods(room, options.quick))
    for texels in IMAGE_TEXELS[: 1 if options.quick else None]:
        told = f"an image of {1e3 * PLATE_M / texels:.2g} mm texels, "
        found += _measure_scene(options, told, partial(_make_two_pass_methods, told, quick=options.quick), texels)
    return found


def _measure_scene(
    options: BenchOptions, prefix: str, make_methods: Callable[[BakeSession], list[BakeMethod]], texels: int = 0
) -> list[Row]:
    """The reference and all ways in one scene. texels: of the image that its relief is; 0: a pattern."""
    with open_test_file() as (scene, layer), tempfile.TemporaryDirectory() as folder:
        surface = add_relief_plate(32)
        if texels:
            set_image_relief(surface, texels, SEED)
        add_strokes(STROKE_COUNT, surface, apart=True, length_m=QUICK_LENGTH_M if options.quick else LENGTH_M)
        layer.update()
        room = BakeSession(scene, layer, Path(folder) / "cache")
        ways = make_methods(room)
        times = {way.name: Times(time.process_time) for way in ways}
        felt: dict[str, StrokeInputs] = {}
        peaks: dict[str, float | None] = {}
        for repeat in range(options.repeats):
            for way in ways:
                options.watch(f"{BAKE_NAME}: {way.name}, {repeat + 1} of {options.repeats}")
                way.prepare()
                bake = partial(times[way.name].measure, partial(room.bake, way.pixels, way.first_pass))
                felt[way.name], peak = run_with_peak(bake)
                peaks.setdefault(way.name, peak)  # later ones find room that the allocator kept
        options.watch(f"{BAKE_NAME}: the reference")
        room.clear_all()
        fine = QUICK_FINE if options.quick else REFERENCE_PIXELS
        true = room.bake(fine)
        exact = synthesise_strokes(true, exactly=True)
    usual = next(
        way.name for way in ways if way.pixels == _get_default_pixels(options.quick) and way.first_pass is None
    )
    reference = f"the reference: close-ups of {fine} pixels, F_Θ in float64 2000 times a second"
    found = [Row(BAKE_NAME, f"{prefix}fine", error_unit="dB", note=reference)]
    for way in ways:
        row = Row(
            BAKE_NAME, way.name, times[way.name].seconds, times[way.name].cpu,
            error=compute_error_db(synthesise_strokes(felt[way.name]), exact), error_unit="dB", peak_mb=peaks[way.name],
            note=f"levels of bands off by at most {compute_level_error_db(felt[way.name], true):.2g} dB",
        )  # fmt: skip
        beside = times[way.name].compute_ratio(times[usual])
        found.append(row if way.name == usual else replace(row, ratio=beside, ratio_to=usual))
    return found


def _get_default_pixels(quick: bool) -> int:
    return QUICK_USUAL if quick else DEFAULT_PIXELS


def _get_pixel_sizes(quick: bool) -> tuple[int, ...]:
    return QUICK_PIXELS if quick else COMPARED_PIXELS


def _make_pattern_methods(session: BakeSession, quick: bool) -> list[BakeMethod]:
    usual = _get_default_pixels(quick)
    cold = {
        pixels: BakeMethod(f"cold, {pixels} pixels", pixels, session.clear_all) for pixels in _get_pixel_sizes(quick)
    }
    return [
        *(way for pixels, way in cold.items() if pixels <= usual),
        BakeMethod("close-ups kept", usual, partial(session.prepare_close_ups, usual)),
        BakeMethod("nothing changed", usual, partial(session.bake, usual)),
        *(way for pixels, way in cold.items() if pixels > usual),
    ]


def _make_two_pass_methods(prefix: str, session: BakeSession, *, quick: bool) -> list[BakeMethod]:
    usual, first = _get_default_pixels(quick), QUICK_FIRST if quick else FIRST_PASS_PIXELS
    return [
        BakeMethod(f"{prefix}{usual} pixels at once", usual, session.clear_all),
        BakeMethod(f"{prefix}a first look of {first}", usual, session.clear_all, first),
    ]


def synthesise_strokes(inputs: StrokeInputs, *, exactly: bool = False) -> Float:
    """All strokes one after the other, as scenes hear them; exactly: F_Θ in float64, 2000 times a second."""
    field = load_field()
    if exactly:
        field = replace(field, parameters={name: value.astype(np.float64) for name, value in field.parameters.items()})
    tolerance = 0.0 if exactly else None
    made = [
        render_samples(prepare_stroke(field, inputs[name], seed=SEED, tolerance=tolerance)) for name in sorted(inputs)
    ]
    return np.concatenate(made)


def compute_error_db(samples: Float, exact: Float) -> float:
    """Power of the difference over the power of the exact signal."""
    return float(10.0 * np.log10(np.mean(np.square(samples - exact)) / np.mean(np.square(exact))))


def compute_level_error_db(inputs: StrokeInputs, true: StrokeInputs) -> float:
    """The largest difference of a band's level in any token."""
    return max(
        float(20.0 * np.abs(inputs[name].tokens[:, LEVELS] - true[name].tokens[:, LEVELS]).max()) for name in true
    )
