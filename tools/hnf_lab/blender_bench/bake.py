"""Bench of a bake by all methods: time, memory, and error against fine close-ups and F_Θ in float64.

The methods run in turn in every round. Close-ups of fewer and of more pixels than the shipped ones are compared, on a
procedural relief, and on an image relief with a first pass that determines the number of pixels.
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
"""Pixels along the side of a close-up: compared values, shipped value, and reference (10 µm per pixel)."""
QUICK_PIXELS, QUICK_USUAL, QUICK_FINE = (128, 256), 256, 512
"""The same of a quick run. With 128 pixels the token's 0.25 mm band is not resolved and comes from the library, so that
noise stands where the reference has the relief itself."""
FIRST_PASS_PIXELS, QUICK_FIRST = 128, 32
"""Pixels of the shipped first pass."""
IMAGE_TEXELS = (240, 480)
"""Texels along a side of an image relief: half and a quarter of a millimetre on the plate of 12 cm."""
STROKE_COUNT, QUICK_STROKE_COUNT, LENGTH_M, QUICK_LENGTH_M = 2, 1, 0.03, 0.01
SEED = 5

StrokeInputs = Mapping[str, StrokeInput]
Float = NDArray[np.float64]


@dataclass(frozen=True)
class BakeMethod:
    """A way to bake.

    Attributes
    ----------
    pixels
        Side of its close-ups [pixels].
    prepare
        Function that sets up the state before it, neither timed nor counted.
    first_pass
        Side of the first pass [pixels], or None.
    """

    name: str
    pixels: int
    prepare: Callable[[], object]
    first_pass: int | None = None


class BakeSession:
    """The open file, and the cache of its close-ups."""

    def __init__(self, scene: Any, layer: Any, cache: Path) -> None:
        self._scene, self._layer, self._cache = scene, layer, cache

    def bake(self, pixels: int, first_pass: int | None = None) -> StrokeInputs:
        """Bake, and return the field's input for each stroke. Raises HnfError if a stroke fails."""
        from hnf_blender.bridge.stroke.read_stroke import list_strokes
        from hnf_blender.jobs import bake_job
        from hnf_blender.touch import bake_patches as bake
        from hnf_blender.touch.stroke_bake import load_bake

        with (
            patch.object(bake_job, "get_cache_folder", lambda: self._cache),
            patch.object(bake, "PATCH_PIXELS", pixels),
            patch.object(bake, "FIRST_PASS_PIXELS", first_pass),
        ):
            result = bake_job.bake_blocking(self._scene, self._layer)
        bakes = {obj.name: load_bake(obj) for obj in list_strokes(self._scene)}
        if not result.ok:
            raise HnfError(f"the bake failed: {result.message}", where=BAKE_NAME)
        return {name: stroke_bake.stroke for name, stroke_bake in bakes.items() if stroke_bake is not None}

    def clear_bakes(self) -> None:
        """Restore the state before the first bake, except for the cached close-ups."""
        from hnf_blender.jobs.baked_data import purge

        purge(self._scene, self._layer, everything=True)

    def clear_all(self) -> None:
        """Restore the state before the first bake."""
        self.clear_bakes()
        shutil.rmtree(self._cache, ignore_errors=True)

    def prepare_close_ups(self, pixels: int) -> None:
        """Leave the close-ups of a bake in the cache and remove its results.

        Fresh results would not be rendered again, whatever the number of pixels.
        """
        self.clear_bakes()
        self.bake(pixels)
        self.clear_bakes()


def measure_bake(options: BenchOptions) -> list[Row]:
    """Measure bakes of a procedural relief and of image reliefs.

    Procedural: a cold bake at each size of the close-ups, one with cached close-ups, and one without changes. Image:
    all pixels at once, and with a first pass. Empties the open file.

    Raises
    ------
    HnfError
        Without bpy, or if a bake fails.
    """
    require_bpy(BAKE_NAME)
    rows = _measure_scene(options, "", lambda session: _make_pattern_methods(session, options.quick))
    for texels in IMAGE_TEXELS[: 1 if options.quick else None]:
        prefix = f"an image of {1e3 * PLATE_M / texels:.2g} mm texels, "
        rows += _measure_scene(options, prefix, partial(_make_two_pass_methods, prefix, quick=options.quick), texels)
    return rows


def _measure_scene(
    options: BenchOptions, prefix: str, make_methods: Callable[[BakeSession], list[BakeMethod]], texels: int = 0
) -> list[Row]:
    """Measure the reference and all methods in one scene. texels: side of its image relief; 0: procedural."""
    with open_test_file() as (scene, layer), tempfile.TemporaryDirectory() as folder:
        surface = add_relief_plate(32)
        if texels:
            set_image_relief(surface, texels, SEED)
        count, length_m = (QUICK_STROKE_COUNT, QUICK_LENGTH_M) if options.quick else (STROKE_COUNT, LENGTH_M)
        add_strokes(count, surface, apart=True, length_m=length_m)
        layer.update()
        session = BakeSession(scene, layer, Path(folder) / "cache")
        methods = make_methods(session)
        times = {way.name: Times(time.process_time) for way in methods}
        inputs: dict[str, StrokeInputs] = {}
        peaks: dict[str, float | None] = {}
        for repeat in range(options.repeats):
            for way in methods:
                options.watch(f"{BAKE_NAME}: {way.name}, {repeat + 1} of {options.repeats}")
                way.prepare()
                bake = partial(times[way.name].measure, partial(session.bake, way.pixels, way.first_pass))
                inputs[way.name], peak = run_with_peak(bake)
                peaks.setdefault(way.name, peak)  # later peaks are lower, as the allocator reuses memory
        options.watch(f"{BAKE_NAME}: the reference")
        session.clear_all()
        fine = QUICK_FINE if options.quick else REFERENCE_PIXELS
        true = session.bake(fine)
        exact = synthesise_strokes(true, exactly=True)
    default_name = next(
        way.name for way in methods if way.pixels == _get_default_pixels(options.quick) and way.first_pass is None
    )
    reference = f"the reference: close-ups of {fine} pixels, F_Θ in float64 2000 times a second"
    rows = [Row(BAKE_NAME, f"{prefix}fine", error_unit="dB", note=reference)]
    for way in methods:
        row = Row(
            BAKE_NAME, way.name, times[way.name].seconds, times[way.name].cpu,
            error=compute_error_db(synthesise_strokes(inputs[way.name]), exact), error_unit="dB",
            peak_mb=peaks[way.name],
            note=f"levels of bands off by at most {compute_level_error_db(inputs[way.name], true):.2g} dB",
        )  # fmt: skip
        ratio = times[way.name].compute_ratio(times[default_name])
        rows.append(row if way.name == default_name else replace(row, ratio=ratio, ratio_to=default_name))
    return rows


def _get_default_pixels(quick: bool) -> int:
    return QUICK_USUAL if quick else DEFAULT_PIXELS


def _get_pixel_sizes(quick: bool) -> tuple[int, ...]:
    return QUICK_PIXELS if quick else COMPARED_PIXELS


def _make_pattern_methods(session: BakeSession, quick: bool) -> list[BakeMethod]:
    default = _get_default_pixels(quick)
    cold = {
        pixels: BakeMethod(f"cold, {pixels} pixels", pixels, session.clear_all) for pixels in _get_pixel_sizes(quick)
    }
    return [
        *(method for pixels, method in cold.items() if pixels <= default),
        BakeMethod("close-ups kept", default, partial(session.prepare_close_ups, default)),
        BakeMethod("nothing changed", default, partial(session.bake, default)),
        *(method for pixels, method in cold.items() if pixels > default),
    ]


def _make_two_pass_methods(prefix: str, session: BakeSession, *, quick: bool) -> list[BakeMethod]:
    default, first = _get_default_pixels(quick), QUICK_FIRST if quick else FIRST_PASS_PIXELS
    return [
        BakeMethod(f"{prefix}{default} pixels at once", default, session.clear_all),
        BakeMethod(f"{prefix}a first look of {first}", default, session.clear_all, first),
    ]


def synthesise_strokes(inputs: StrokeInputs, *, exactly: bool = False) -> Float:
    """Synthesise all strokes in turn as scenes do; exactly: F_Θ in float64, 2000 times a second."""
    field = load_field()
    if exactly:
        field = replace(field, parameters={name: value.astype(np.float64) for name, value in field.parameters.items()})
    tolerance = 0.0 if exactly else None
    signals = [
        render_samples(prepare_stroke(field, inputs[name], seed=SEED, tolerance=tolerance)) for name in sorted(inputs)
    ]
    return np.concatenate(signals)


def compute_error_db(samples: Float, exact: Float) -> float:
    """Return the power of the difference over the power of the exact signal [dB]."""
    return float(10.0 * np.log10(np.mean(np.square(samples - exact)) / np.mean(np.square(exact))))


def compute_level_error_db(inputs: StrokeInputs, true: StrokeInputs) -> float:
    """Return the largest difference of a band's level in any token [dB]."""
    return max(
        float(20.0 * np.abs(inputs[name].tokens[:, LEVELS] - true[name].tokens[:, LEVELS]).max()) for name in true
    )
