"""RGB-D of the same cameras: ours and BlenderProc's way, time beside error; the touched patches alone; depth alone.

Both render by the Cycles of this Blender, on all cores, with BlenderProc's light bounces, one seed, the scene opened
anew for each. Error is the RMS of sRGB colour in 0–1 against 256 samples of another seed without a denoiser.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.bench.frame import BenchOptions, Row, Spread
from hnf_core.bench.memory import run_with_peak
from hnf_core.errors import HnfError
from hnf_core.export.srgb import linear_to_srgb
from hnf_core.scene.camera import Camera

from .needs import require_bpy
from .views_depth import measure_depth
from .views_look import measure_appearance
from .views_scene import Rectangle, expand_rectangle, find_patch, list_scenes, place_cameras

VIEWS_NAME = "views"
CAMERA_COUNT, IMAGE_SIZE, QUICK_IMAGE_SIZE = 2, (640, 480), (64, 48)
REFERENCE_SAMPLES, QUICK_REFERENCE_SAMPLES = 256, 16
BLENDERPROC_SAMPLES, HNF_SAMPLES, PATCH_SAMPLES = (1, 4, 16), (1, 2, 4, 8), (16, 64)
QUICK_BLENDERPROC_SAMPLES, QUICK_HNF_SAMPLES, QUICK_PATCH_SAMPLES = (1, 4), (1, 4), (4,)
MIN_ERROR = 1e-6
"""Of sRGB: a smaller error counts as this one."""
AT_EQUAL_ERROR = "BlenderProc's at equal error"

Colours = list[NDArray[np.float32]]


@dataclass
class TimedRenders:
    """One method. cpu: of all threads of this process. errors: of whole pictures, and inside the patches. peak_mb: of
    the first time, beyond what was there."""

    walls: list[float] = field(default_factory=list)
    cpus: list[float] = field(default_factory=list)
    error: float = 0.0
    patch_error: float = 0.0
    peak_mb: float | None = None

    def measure(self, function: Callable[[], Colours]) -> Colours:
        def timed() -> Colours:
            wall, cpu = time.perf_counter(), time.process_time()
            found = function()
            self.walls.append(time.perf_counter() - wall)
            self.cpus.append(time.process_time() - cpu)
            return found

        found, peak = run_with_peak(timed)
        if len(self.walls) == 1:
            self.peak_mb = peak
        return found


@dataclass(frozen=True)
class ReferenceViews:
    """What a scene looks like from its cameras, and where it is touched in each picture."""

    cameras: list[Camera]
    colours: Colours
    patches: list[Rectangle]


def measure_views(options: BenchOptions) -> list[Row]:
    """For each scene: BlenderProc's way and ours at several samples, patches alone, depth alone.

    Raises HnfError without bpy, or without Open Image Denoise. Empties the file that is open.
    """
    require_bpy(VIEWS_NAME)
    import bpy  # noqa: F401  # it brings _cycles, which is asked for the denoiser

    from ..compat import has_denoiser

    if not has_denoiser():
        raise HnfError("this Blender has no Open Image Denoise, which BlenderProc's way goes by.", where=VIEWS_NAME)
    found: list[Row] = []
    for name, opened in list_scenes(options.quick).items():
        options.watch(f"{VIEWS_NAME}: {name}, the reference")
        truth = render_reference(opened(), options.quick)
        found += _measure_scene(name, opened, truth, options) + measure_depth(
            VIEWS_NAME, name, opened, truth.cameras, options
        )
    return found + measure_appearance(VIEWS_NAME, options)


def render_reference(scene: Any, quick: bool) -> ReferenceViews:
    """By our own path, undenoised, with a seed of its own."""
    cameras = place_cameras(scene, CAMERA_COUNT, *(QUICK_IMAGE_SIZE if quick else IMAGE_SIZE))
    views = render_views(scene, cameras, QUICK_REFERENCE_SAMPLES if quick else REFERENCE_SAMPLES, denoise=False, seed=1)
    patches = [find_patch(camera, depth) for camera, (_, depth) in zip(cameras, views, strict=True)]
    return ReferenceViews(cameras, [rgb for rgb, _ in views], patches)


def render_views(
    scene: Any, cameras: Sequence[Camera], samples: int, denoise: bool = True, seed: int = 0
) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
    """Colour and depth as the product's pictures are made, but with BlenderProc's bounces."""
    from ..bridge.picture import OverviewRenderer
    from .blenderproc import limit_bounces

    with OverviewRenderer(scene, samples=samples, entire_scene=True) as overviews:
        own = overviews.temporary.scene
        limit_bounces(own)
        own.cycles.use_denoising, own.cycles.seed = denoise, seed
        views = [overviews.render_view(camera)[0] for camera in cameras]
    return [(view.rgb, view.depth) for view in views]


def _measure_scene(name: str, opened: Callable[[], Any], truth: ReferenceViews, options: BenchOptions) -> list[Row]:
    from .blenderproc import render_as_blenderproc

    cameras = truth.cameras
    cut = [expand_rectangle(patch, camera) for patch, camera in zip(truth.patches, cameras, strict=True)]
    near = [
        camera.crop(each.left, each.top, each.width, each.height) for camera, each in zip(cameras, cut, strict=True)
    ]
    counts = (
        (QUICK_BLENDERPROC_SAMPLES, QUICK_HNF_SAMPLES, QUICK_PATCH_SAMPLES) if options.quick else (BLENDERPROC_SAMPLES, HNF_SAMPLES, PATCH_SAMPLES)
    )  # fmt: skip
    theirs, ours, on_patches = ({samples: TimedRenders() for samples in each} for each in counts)
    plain = TimedRenders()
    for repeat in range(options.repeats):
        options.watch(f"{VIEWS_NAME}: {name}, {repeat + 1} of {options.repeats}")
        for samples, timed in theirs.items():
            scene = opened()
            colours = timed.measure(lambda: _get_colours(render_as_blenderproc(scene, cameras, samples)))  # noqa: B023
            _record_errors(timed, colours, truth)
        scene = opened()
        most = counts[0][-1]
        _record_errors(
            plain,
            plain.measure(lambda: _get_colours(render_as_blenderproc(scene, cameras, most, False))),
            truth,  # noqa: B023
        )
        for samples, timed in ours.items():
            scene = opened()
            _record_errors(timed, timed.measure(lambda: _get_colours(render_views(scene, cameras, samples))), truth)  # noqa: B023
        for samples, timed in on_patches.items():
            scene = opened()
            colours = timed.measure(lambda: _get_colours(render_views(scene, near, samples)))  # noqa: B023
            timed.patch_error = _compute_patch_error(colours, cut, truth)
    note = f"{name}, {len(cameras)} views of {cameras[0].width} × {cameras[0].height}"
    return [
        *(_make_row(f"BlenderProc's way, {samples}", each, note) for samples, each in theirs.items()),
        _make_row(f"the same without its denoiser, {most}", plain, note),
        *(
            _make_row(f"ours, {samples}", each, note, compute_ratio_at_equal_error(each, theirs, lambda one: one.error))
            for samples, each in ours.items()
        ),
        *(
            _make_patch_row(f"touched patches only, {samples}", each, theirs, f"{name}, one of 20 mm a view")
            for samples, each in on_patches.items()
        ),
    ]


def compute_ratio_at_equal_error(
    method: TimedRenders, rivals: dict[int, TimedRenders], error: Callable[[TimedRenders], float]
) -> Spread | None:
    """Mine to theirs, repeat by repeat, of CPU: theirs' time where its error is mine, along its own curve of log time
    over log error. Where mine is smaller than any of its errors, its slowest time counts, which flatters it; None where
    mine is larger than all."""
    curve = sorted(rivals.values(), key=error)
    errors = [max(error(each), MIN_ERROR) for each in curve]
    if error(method) > errors[-1]:
        return None
    reached = np.log(max(error(method), MIN_ERROR))
    times = np.array([each.cpus for each in curve])
    theirs_s = [np.exp(np.interp(reached, np.log(errors), np.log(column))) for column in times.T]
    return Spread.from_values(np.divide(method.cpus, theirs_s).tolist())


def _make_row(method: str, timed: TimedRenders, note: str, ratio: Spread | None = None) -> Row:
    return Row(
        VIEWS_NAME, method, Spread.from_values(timed.walls), Spread.from_values(timed.cpus), ratio, AT_EQUAL_ERROR if ratio else "",
        timed.error, "of sRGB", timed.peak_mb, note=note,
    )  # fmt: skip


def _make_patch_row(method: str, timed: TimedRenders, rivals: dict[int, TimedRenders], note: str) -> Row:
    ratio = compute_ratio_at_equal_error(timed, rivals, lambda one: one.patch_error)
    least = min(each.patch_error for each in rivals.values())
    return Row(
        VIEWS_NAME, method, Spread.from_values(timed.walls), Spread.from_values(timed.cpus), ratio, AT_EQUAL_ERROR if ratio else "",
        timed.patch_error, "of sRGB, there", timed.peak_mb, note=f"{note}; BlenderProc's least error there {least:.3g}",
    )  # fmt: skip


def _record_errors(timed: TimedRenders, colours: Colours, reference: ReferenceViews) -> None:
    whole = [Rectangle(0, 0, camera.width, camera.height) for camera in reference.cameras]
    timed.error = _compute_patch_error(colours, whole, ReferenceViews(reference.cameras, reference.colours, whole))
    timed.patch_error = _compute_patch_error(colours, whole, reference)


def _compute_patch_error(colours: Colours, rectangles: Sequence[Rectangle], reference: ReferenceViews) -> float:
    """RMS of sRGB over the patches' pixels. shown: which pixels of the whole picture each colour holds."""
    differences = [
        (to_srgb(crop_patch(rgb, patch, part)) - to_srgb(patch.crop(true))).ravel()
        for rgb, true, patch, part in zip(colours, reference.colours, reference.patches, rectangles, strict=True)
    ]
    return float(np.sqrt(np.mean(np.concatenate(differences) ** 2)))


def crop_patch(rgb: NDArray[np.float32], patch: Rectangle, shown: Rectangle) -> NDArray[np.float32]:
    """The pixels of a patch, where rgb shows only a part of the picture."""
    return Rectangle(patch.left - shown.left, patch.top - shown.top, patch.width, patch.height).crop(rgb)


def to_srgb(rgb: NDArray[np.float32]) -> NDArray[np.float64]:
    return linear_to_srgb(rgb)


def _get_colours(views: Sequence[tuple[NDArray[np.float32], NDArray[np.float32]]]) -> Colours:
    return [rgb for rgb, _ in views]
