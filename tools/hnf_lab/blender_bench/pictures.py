"""Bench of strokes' pictures: the view of a plate with a fine relief in several ways, and the figure over it.

All ways show one camera's view in turn, each with the start of its temporary scene. The error is the RMS of sRGB color
in 0–1 against many samples without a denoiser.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_tools.bench_strokes import make_scrape
from hnf_core.export.stroke_figure import StrokeView, write_stroke_figure
from hnf_core.field import synthesis
from hnf_core.field.weights import load_field
from hnf_core.scene.camera import Camera
from hnf_core.units import linear_to_srgb

from ..bench.harness import BenchOptions, Row, Times
from .scenes import add_relief_plate, open_test_file, require_bpy

PICTURES_NAME = "pictures"
SHIPPED = "view: as shipped"
FIGURE = "figure over the view"
STROKE_M, STROKE_S, SEED = 0.06, 1, 3
REFERENCE_SAMPLES, QUICK_REFERENCE_SAMPLES = 256, 32
QUICK_WIDTH_PX = 192


@dataclass(frozen=True)
class ViewMethod:
    """A way to render a stroke's view: samples a pixel, and what of a relief its denoiser preserves."""

    name: str
    samples: int
    relief: Any


def list_methods() -> tuple[ViewMethod, ...]:
    """List the ways to render a view, the shipped one first."""
    from hnf_blender.touch.overview import SAMPLES

    return (
        ViewMethod(SHIPPED, SAMPLES, "fast"),
        ViewMethod("view: 2 samples, relief kept accurately", 2, "accurate"),
        ViewMethod("view: 2 samples, relief kept fast", 2, "fast"),
        ViewMethod("view: 1 sample, by color alone", 1, ""),
    )


def measure_pictures(options: BenchOptions) -> list[Row]:
    """Measure the view of a stroke in every way and the figure over it, in turn; raise HnfError without bpy."""
    require_bpy(PICTURES_NAME)
    methods = list_methods()
    times = {method.name: Times(time.process_time) for method in methods}
    times[FIGURE] = Times(time.process_time)
    with open_test_file() as (scene, layer), tempfile.TemporaryDirectory() as folder:
        plate = add_relief_plate(32)
        layer.update()
        camera = _make_camera(options.quick)
        true = _render_reference(scene, plate, camera, options.quick)
        images: dict[str, NDArray[np.float32]] = {}
        draw = _prepare_figure(Path(folder) / "picture.png", camera)
        draw(true)  # starts matplotlib
        for repeat in range(options.repeats):
            options.watch(f"{PICTURES_NAME}: {repeat + 1} of {options.repeats}")
            for method in methods:
                render = partial(_render_view, scene, plate, camera, method)
                images[method.name] = times[method.name].measure(render)
            times[FIGURE].measure(partial(draw, images[SHIPPED]))
    rows = [Row(PICTURES_NAME, name, each.seconds, each.cpu, error_unit="") for name, each in times.items()]
    return [_add_comparison(row, images, true, times) for row in rows]


def compute_error(image: NDArray[np.float32], true: NDArray[np.float32]) -> float:
    """Return the RMS difference of two linear images (H, W, 3) as sRGB in 0–1."""
    return float(np.sqrt(np.mean((linear_to_srgb(image) - linear_to_srgb(true)) ** 2)))


def _add_comparison(
    row: Row, images: dict[str, NDArray[np.float32]], true: NDArray[np.float32], times: dict[str, Times]
) -> Row:
    if row.method == FIGURE:
        return row
    row = replace(row, error=compute_error(images[row.method], true), error_unit="of sRGB in 0-1, RMS")
    if row.method == SHIPPED:
        return row
    return replace(row, ratio=times[row.method].compute_ratio(times[SHIPPED]), ratio_to=SHIPPED)


def _make_camera(quick: bool) -> Camera:
    from hnf_blender.bridge.cycles import make_overview_camera
    from hnf_blender.touch.overview import HEIGHT, WIDTH, resize_camera

    ends = [[-STROKE_M / 2.0, 0.0, 0.0], [STROKE_M / 2.0, 0.0, 0.0]]
    camera = make_overview_camera(ends, [0.0, 0.0, 1.0], STROKE_M, WIDTH, HEIGHT)
    return resize_camera(camera, QUICK_WIDTH_PX) if quick else camera


def _render_view(scene: Any, plate: Any, camera: Camera, method: ViewMethod) -> NDArray[np.float32]:
    from hnf_blender.bridge.lit_render import OverviewRenderer

    with OverviewRenderer(scene, samples=method.samples, relief=method.relief) as overviews:
        return overviews.render_view(camera, [plate])[0].rgb


def _render_reference(scene: Any, plate: Any, camera: Camera, quick: bool) -> NDArray[np.float32]:
    from hnf_blender.bridge.lit_render import OverviewRenderer

    samples = QUICK_REFERENCE_SAMPLES if quick else REFERENCE_SAMPLES
    with OverviewRenderer(scene, samples=samples) as overviews:
        cycles = overviews.temporary.scene.cycles
        cycles.use_denoising, cycles.seed = False, 1
        return overviews.render_view(camera, [plate])[0].rgb


def _prepare_figure(path: Path, camera: Camera) -> Callable[[NDArray[np.float32]], None]:
    """Return a function that draws the figure of a stroke over a view (H, W, 3)."""
    stroke = make_scrape(STROKE_S)
    signal = synthesis.synthesise(load_field(), stroke, seed=SEED).signal
    count = len(stroke.action.force)
    along = np.linspace(-STROKE_M / 2.0, STROKE_M / 2.0, count)
    uv, _ = camera.project(np.stack([along, np.zeros(count), np.zeros(count)], axis=-1))

    def draw(rgb: NDArray[np.float32]) -> None:
        view = StrokeView(rgb, uv, np.ones(count))
        write_stroke_figure(path, title="A stroke", action=stroke.action, signal=signal, view=view)

    return draw
