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

from hnf_core.bench.frame import Options, Row, Spread
from hnf_core.bench.memory import with_peak
from hnf_core.errors import HnfError
from hnf_core.export.srgb import linear_to_srgb
from hnf_core.scene.camera import Camera

from .needs import need_bpy
from .views_depth import depth_rows
from .views_look import look_rows
from .views_scene import Rectangle, around, patch_in, scenes, widened

NAME = "views"
CAMERAS, SIZE, QUICK_SIZE = 2, (640, 480), (64, 48)
REFERENCE, QUICK_REFERENCE = 256, 16
THEIRS, OURS, ON_PATCHES = (1, 4, 16), (1, 2, 4, 8), (16, 64)
QUICK_THEIRS, QUICK_OURS, QUICK_ON_PATCHES = (1, 4), (1, 4), (4,)
EXACT = 1e-6
"""Of sRGB: a smaller error counts as this one."""
AT_EQUAL_ERROR = "BlenderProc's at equal error"

Colours = list[NDArray[np.float32]]


@dataclass
class Timed:
    """One method. cpu: of all threads of this process. errors: of whole pictures, and inside the patches. peak_mb: of
    the first time, beyond what was there."""

    walls: list[float] = field(default_factory=list)
    cpus: list[float] = field(default_factory=list)
    error: float = 0.0
    on_patches: float = 0.0
    peak_mb: float | None = None

    def take(self, function: Callable[[], Colours]) -> Colours:
        def timed() -> Colours:
            wall, cpu = time.perf_counter(), time.process_time()
            found = function()
            self.walls.append(time.perf_counter() - wall)
            self.cpus.append(time.process_time() - cpu)
            return found

        found, peak = with_peak(timed)
        if len(self.walls) == 1:
            self.peak_mb = peak
        return found


@dataclass(frozen=True)
class Truth:
    """What a scene looks like from its cameras, and where it is touched in each picture."""

    cameras: list[Camera]
    colours: Colours
    patches: list[Rectangle]


def rows(options: Options) -> list[Row]:
    """For each scene: BlenderProc's way and ours at several samples, patches alone, depth alone.

    Raises HnfError without bpy, or without Open Image Denoise. Empties the file that is open.
    """
    need_bpy(NAME)
    import bpy  # noqa: F401  # it brings _cycles, which is asked for the denoiser

    from ..compat import has_denoiser

    if not has_denoiser():
        raise HnfError("this Blender has no Open Image Denoise, which BlenderProc's way goes by.", where=NAME)
    found: list[Row] = []
    for name, opened in scenes(options.quick).items():
        options.watch(f"{NAME}: {name}, the reference")
        truth = truth_of(opened(), options.quick)
        found += _of(name, opened, truth, options) + depth_rows(NAME, name, opened, truth.cameras, options)
    return found + look_rows(NAME, options)


def truth_of(scene: Any, quick: bool) -> Truth:
    """By our own path, undenoised, with a seed of its own."""
    cameras = around(scene, CAMERAS, *(QUICK_SIZE if quick else SIZE))
    views = our_views(scene, cameras, QUICK_REFERENCE if quick else REFERENCE, denoise=False, seed=1)
    patches = [patch_in(camera, depth) for camera, (_, depth) in zip(cameras, views, strict=True)]
    return Truth(cameras, [rgb for rgb, _ in views], patches)


def our_views(
    scene: Any, cameras: Sequence[Camera], samples: int, denoise: bool = True, seed: int = 0
) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
    """Colour and depth as the product's pictures are made, but with BlenderProc's bounces."""
    from ..bridge.picture import Overviews
    from .blenderproc import few_bounces

    with Overviews(scene, samples=samples, whole=True) as overviews:
        own = overviews.temporary.scene
        few_bounces(own)
        own.cycles.use_denoising, own.cycles.seed = denoise, seed
        views = [overviews.view(camera)[0] for camera in cameras]
    return [(view.rgb, view.depth) for view in views]


def _of(name: str, opened: Callable[[], Any], truth: Truth, options: Options) -> list[Row]:
    from .blenderproc import render_as_blenderproc

    cameras = truth.cameras
    cut = [widened(patch, camera) for patch, camera in zip(truth.patches, cameras, strict=True)]
    near = [
        camera.crop(each.left, each.top, each.width, each.height) for camera, each in zip(cameras, cut, strict=True)
    ]
    counts = (
        (QUICK_THEIRS, QUICK_OURS, QUICK_ON_PATCHES) if options.quick else (THEIRS, OURS, ON_PATCHES)
    )  # fmt: skip
    theirs, ours, on_patches = ({samples: Timed() for samples in each} for each in counts)
    plain = Timed()
    for repeat in range(options.repeats):
        options.watch(f"{NAME}: {name}, {repeat + 1} of {options.repeats}")
        for samples, timed in theirs.items():
            scene = opened()
            colours = timed.take(lambda: _colours(render_as_blenderproc(scene, cameras, samples)))  # noqa: B023
            _judge(timed, colours, truth)
        scene = opened()
        most = counts[0][-1]
        _judge(plain, plain.take(lambda: _colours(render_as_blenderproc(scene, cameras, most, False))), truth)  # noqa: B023
        for samples, timed in ours.items():
            scene = opened()
            _judge(timed, timed.take(lambda: _colours(our_views(scene, cameras, samples))), truth)  # noqa: B023
        for samples, timed in on_patches.items():
            scene = opened()
            colours = timed.take(lambda: _colours(our_views(scene, near, samples)))  # noqa: B023
            timed.on_patches = _patch_error(colours, cut, truth)
    note = f"{name}, {len(cameras)} views of {cameras[0].width} × {cameras[0].height}"
    return [
        *(_row(f"BlenderProc's way, {samples}", each, note) for samples, each in theirs.items()),
        _row(f"the same without its denoiser, {most}", plain, note),
        *(
            _row(f"ours, {samples}", each, note, at_equal_error(each, theirs, lambda one: one.error))
            for samples, each in ours.items()
        ),
        *(
            _patch_row(f"touched patches only, {samples}", each, theirs, f"{name}, one of 20 mm a view")
            for samples, each in on_patches.items()
        ),
    ]


def at_equal_error(mine: Timed, theirs: dict[int, Timed], error: Callable[[Timed], float]) -> Spread | None:
    """Mine to theirs, repeat by repeat, of CPU: theirs' time where its error is mine, along its own curve of log time
    over log error. Where mine is smaller than any of its errors, its slowest time counts, which flatters it; None where
    mine is larger than all."""
    curve = sorted(theirs.values(), key=error)
    errors = [max(error(each), EXACT) for each in curve]
    if error(mine) > errors[-1]:
        return None
    reached = np.log(max(error(mine), EXACT))
    times = np.array([each.cpus for each in curve])
    theirs_s = [np.exp(np.interp(reached, np.log(errors), np.log(column))) for column in times.T]
    return Spread.of(np.divide(mine.cpus, theirs_s).tolist())


def _row(method: str, timed: Timed, note: str, ratio: Spread | None = None) -> Row:
    return Row(
        NAME, method, Spread.of(timed.walls), Spread.of(timed.cpus), ratio, AT_EQUAL_ERROR if ratio else "",
        timed.error, "of sRGB", timed.peak_mb, note=note,
    )  # fmt: skip


def _patch_row(method: str, timed: Timed, theirs: dict[int, Timed], note: str) -> Row:
    ratio = at_equal_error(timed, theirs, lambda one: one.on_patches)
    least = min(each.on_patches for each in theirs.values())
    return Row(
        NAME, method, Spread.of(timed.walls), Spread.of(timed.cpus), ratio, AT_EQUAL_ERROR if ratio else "",
        timed.on_patches, "of sRGB, there", timed.peak_mb, note=f"{note}; BlenderProc's least error there {least:.3g}",
    )  # fmt: skip


def _judge(timed: Timed, colours: Colours, truth: Truth) -> None:
    whole = [Rectangle(0, 0, camera.width, camera.height) for camera in truth.cameras]
    timed.error = _patch_error(colours, whole, Truth(truth.cameras, truth.colours, whole))
    timed.on_patches = _patch_error(colours, whole, truth)


def _patch_error(colours: Colours, shown: Sequence[Rectangle], truth: Truth) -> float:
    """RMS of sRGB over the patches' pixels. shown: which pixels of the whole picture each colour holds."""
    differences = [
        (srgb(patch_of(rgb, patch, part)) - srgb(patch.of(true))).ravel()
        for rgb, true, patch, part in zip(colours, truth.colours, truth.patches, shown, strict=True)
    ]
    return float(np.sqrt(np.mean(np.concatenate(differences) ** 2)))


def patch_of(rgb: NDArray[np.float32], patch: Rectangle, part: Rectangle) -> NDArray[np.float32]:
    """The pixels of a patch, where rgb shows only a part of the picture."""
    return Rectangle(patch.left - part.left, patch.top - part.top, patch.width, patch.height).of(rgb)


def srgb(rgb: NDArray[np.float32]) -> NDArray[np.float64]:
    return linear_to_srgb(rgb)


def _colours(views: Sequence[tuple[NDArray[np.float32], NDArray[np.float32]]]) -> Colours:
    return [rgb for rgb, _ in views]
