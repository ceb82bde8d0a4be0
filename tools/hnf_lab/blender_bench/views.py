"""Bench of RGB-D views: the product's renders and BlenderProc's, by time and error; patches; depth; samples.

All render with the Cycles of this Blender on all cores, with BlenderProc's light bounces and one seed, with the scene
opened again for each. The error is the RMS of sRGB colour in 0–1 against 256 samples of another seed without a
denoiser. Depth from rays and from Cycles is compared with a float64 reference that tests every triangle. A last part
measures how many samples a close-up needs until the token predicted from it is stable. Two real scenes are used if the
development data are present, else a small built-in one.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch as patched

import numpy as np
from numpy.typing import NDArray

from hnf_core.errors import HnfError
from hnf_core.material.token import LEVELS, Token
from hnf_core.scene.camera import PATCH_SIZE_M, Camera, Patch
from hnf_core.scene.mesh import TriangleMesh
from hnf_core.scene.raycast import cast_view, make_embree_caster
from hnf_core.units import linear_to_srgb
from hnf_lab import ROOT
from reference.geometry import ReferenceGeometry

from ..bench.harness import BenchOptions, Row, Spread, run_with_peak
from .scenes import require_bpy

SCENE_DATA = ROOT.parent / "shared" / "data" / "scenes"
REAL_SCENES = (
    SCENE_DATA / "FlightHelmet" / "FlightHelmet.gltf",
    SCENE_DATA / "SheenChairScene" / "MixedLightingExample.gltf",
)
FLOOR_NAME = "Plane"
"""Name of the floor, which the cameras do not frame."""
MARGIN_PX = 8
"""Margin around a patch that the denoiser needs [pixels]."""


@dataclass(frozen=True)
class Rectangle:
    """A rectangle of pixels."""

    left: int
    top: int
    width: int
    height: int

    def crop(self, image: NDArray[Any]) -> NDArray[Any]:
        """Crop an image (H, W, …)."""
        return image[self.top : self.top + self.height, self.left : self.left + self.width]


def list_scenes(quick: bool) -> dict[str, Callable[[], Any]]:
    """Return name → function that opens the scene again, with light, and returns it."""
    if quick or not all(path.is_file() for path in REAL_SCENES):
        return {"three balls": make_three_balls}
    return {path.parent.name: lambda path=path: _open_scene(path) for path in REAL_SCENES}  # type: ignore[misc]


def make_three_balls() -> Any:
    """Make balls of 60 mm on a floor, under a lamp."""
    import bpy

    from hnf_blender.bridge.importers import open_empty_scene

    open_empty_scene()
    scene = bpy.context.scene
    _, floor = bpy.ops.mesh.primitive_plane_add(size=0.6), bpy.context.object
    floor.name = FLOOR_NAME
    for offset in (-0.08, 0.0, 0.08):
        bpy.ops.mesh.primitive_uv_sphere_add(
            segments=24, ring_count=12, radius=0.03, location=(offset, offset / 2, 0.03)
        )
    lamp = bpy.data.objects.new("lamp", bpy.data.lights.new("lamp", "SUN"))
    scene.collection.objects.link(lamp)
    lamp.data.energy, lamp.rotation_euler = 2.0, (0.5, 0.3, 0.0)
    bpy.context.view_layer.update()
    return scene


def place_cameras(scene: Any, count: int, width: int, height: int) -> list[Camera]:
    """Place `count` cameras on a ring, with three-quarter views of everything on the floor."""
    from hnf_blender.bridge.cycles import make_overview_camera
    from hnf_blender.bridge.scene.object_size import get_world_box

    depsgraph = scene.view_layers[0].depsgraph
    boxes = [get_world_box(obj, depsgraph, 1.0) for obj in list_meshes(scene) if obj.name != FLOOR_NAME]
    low, high = np.min([box[0] for box in boxes], axis=0), np.max([box[1] for box in boxes], axis=0)
    corners = np.stack(np.meshgrid(*zip(low, high, strict=True)), axis=-1).reshape(-1, 3)
    turns = 2.0 * np.pi * np.arange(count) / 12.0 + 0.3
    return [make_overview_camera(corners, [np.cos(turn), np.sin(turn), 0.15], 0.05, width, height) for turn in turns]


def list_meshes(scene: Any) -> list[Any]:
    return [obj for obj in scene.objects if obj.type == "MESH"]


def find_patch(camera: Camera, depth: NDArray[np.float32]) -> Rectangle:
    """Return the rectangle with 20 mm of surface around the surface pixel nearest to the image centre."""
    rows, columns = np.nonzero(np.isfinite(depth))
    nearest = np.argmin((rows - camera.height / 2.0) ** 2 + (columns - camera.width / 2.0) ** 2)
    row, column = int(rows[nearest]), int(columns[nearest])
    side = max(4, round(PATCH_SIZE_M * camera.intrinsics[0, 0] / float(depth[row, column])))
    left, top = max(0, column - side // 2), max(0, row - side // 2)
    return Rectangle(left, top, min(side, camera.width - left), min(side, camera.height - top))


def expand_rectangle(patch: Rectangle, camera: Camera) -> Rectangle:
    """Add MARGIN_PX on all sides, within the image."""
    left, top = max(0, patch.left - MARGIN_PX), max(0, patch.top - MARGIN_PX)
    right = min(camera.width, patch.left + patch.width + MARGIN_PX)
    bottom = min(camera.height, patch.top + patch.height + MARGIN_PX)
    return Rectangle(left, top, right - left, bottom - top)


def make_world_mesh(scene: Any) -> TriangleMesh:
    """Merge all meshes of the scene into one, in world metres."""
    from hnf_blender.bridge.scene.meshes import read_surface

    depsgraph = scene.view_layers[0].depsgraph
    solids = [read_surface(obj, depsgraph, 1.0) for obj in list_meshes(scene)]
    starts = np.cumsum([0, *(len(solid.mesh.vertices) for solid in solids)])
    turns = [solid.rigid[:3, :3] for solid in solids]
    return TriangleMesh(
        vertices=np.concatenate([
            solid.mesh.vertices @ turn.T + solid.rigid[:3, 3] for solid, turn in zip(solids, turns, strict=True)
        ]),
        triangles=np.concatenate([solid.mesh.triangles + start for solid, start in zip(solids, starts, strict=False)]),
        normals=np.concatenate([solid.mesh.normals @ turn.T for solid, turn in zip(solids, turns, strict=True)]),
        face=np.concatenate([solid.mesh.face for solid in solids]),
        slot=np.concatenate([solid.mesh.slot for solid in solids]),
    )  # fmt: skip


def _open_scene(path: Path) -> Any:
    """Open a scene; add a neutral dome if it has no light, as the product does."""
    from hnf_blender.bridge.importers import open_scene
    from hnf_blender.bridge.lit_render import add_dome, is_lit

    scene = open_scene(path)
    if not is_lit(scene):
        add_dome(scene)
    return scene


REFERENCE_RAYS, QUICK_REFERENCE_RAYS = 250, 20
"""Rays of each camera compared with the reference."""
NO_DEPTH = 1e9

Depths = list[NDArray[np.float32]]


def measure_depth(
    bench: str, name: str, opened: Callable[[], Any], cameras: Sequence[Camera], options: BenchOptions
) -> list[Row]:
    """Measure time and largest error of three kinds of depth.

    They are BlenderProc's (one sample, no denoiser), Cycles' without light, and ray casting.
    """
    from .blenderproc import render_as_blenderproc

    mesh = make_world_mesh(opened())
    pixels, true = compute_reference(mesh, cameras, QUICK_REFERENCE_RAYS if options.quick else REFERENCE_RAYS)
    methods: dict[str, Callable[[Any], Depths]] = {
        "depth: BlenderProc's way, 1": lambda scene: [d for _, d in render_as_blenderproc(scene, cameras, 1, False)],
        "depth: Cycles without light": lambda scene: _render_unlit_depth(scene, cameras),
        "depth: rays": lambda scene: _cast_depth(scene, cameras),
    }
    walls: dict[str, list[float]] = {method: [] for method in methods}
    cpus: dict[str, list[float]] = {method: [] for method in methods}
    errors: dict[str, tuple[float, float]] = {}
    for _ in range(options.repeats):
        for method, render in methods.items():
            scene = opened()
            wall, cpu = time.perf_counter(), time.process_time()
            depths = render(scene)
            walls[method].append(time.perf_counter() - wall)
            cpus[method].append(time.process_time() - cpu)
            errors[method] = compute_depth_error(depths, pixels, true)
    first = next(iter(methods))
    return [
        Row(
            bench, method, Spread.from_values(walls[method]), Spread.from_values(cpus[method]),
            None if method == first else Spread.from_values(np.divide(cpus[method], cpus[first]).tolist()),
            "" if method == first else first, errors[method][1], "relative, 99.9 %",
            note=f"{name}, {len(cameras)} views, {len(mesh.triangles):,} triangles; median {errors[method][0]:.2g}",
        )
        for method in methods
    ]  # fmt: skip


def compute_reference(
    mesh: TriangleMesh, cameras: Sequence[Camera], count: int
) -> tuple[list[NDArray[np.int64]], list[NDArray[np.float64]]]:
    """Return flat pixel indices and planar depths of `count` surface pixels of each camera."""
    rng = np.random.default_rng(0)
    geometry, caster = ReferenceGeometry(mesh), make_embree_caster(mesh)
    pixels, depths = [], []
    for camera in cameras:
        solid = np.flatnonzero(np.isfinite(cast_view(caster, mesh, camera).depth).ravel())
        chosen = rng.choice(solid, min(count, len(solid)), replace=False)
        origins, directions = (rays.reshape(-1, 3)[chosen] for rays in camera.pixel_rays())
        pixels.append(chosen)
        depths.append(geometry.cast(origins, directions).distance)
    return pixels, depths


def compute_depth_error(
    depths: Depths, pixels: Sequence[NDArray[np.int64]], true: Sequence[NDArray[np.float64]]
) -> tuple[float, float]:
    """Return the median and 99.9 % of the relative error; 1 if only one of the two sees a surface."""
    errors = []
    for depth, chosen, expected in zip(depths, pixels, true, strict=True):
        measured = depth.ravel()[chosen].astype(np.float64)
        both = np.isfinite(expected) & (measured < NO_DEPTH)
        scale = np.where(np.isfinite(expected), expected, 1.0)
        errors.append(np.where(both, np.abs(np.where(both, measured, 0.0) - scale) / scale, 1.0))
    median, largest = np.percentile(np.concatenate(errors), [50.0, 99.9])
    return float(median), float(largest)


def _render_unlit_depth(scene: Any, cameras: Sequence[Camera]) -> Depths:
    from hnf_blender.bridge.cycles import disable_lighting
    from hnf_blender.bridge.lit_render import OverviewRenderer

    with OverviewRenderer(scene, samples=1, entire_scene=True) as overviews:
        disable_lighting(overviews.temporary.scene)
        overviews.temporary.scene.cycles.use_denoising = False
        return [overviews.render_view(camera)[0].depth for camera in cameras]


def _cast_depth(scene: Any, cameras: Sequence[Camera]) -> Depths:
    mesh = make_world_mesh(scene)
    caster = make_embree_caster(mesh)
    return [cast_view(caster, mesh, camera).depth.astype(np.float32) for camera in cameras]


SAMPLES, QUICK_SAMPLES = (1, 4, 16, 64, 256), (1, 4, 16)
"""Numbers of samples; the last is the reference."""
CHAIR = SCENE_DATA / "SheenChairScene" / "MixedLightingExample.gltf"
CHAIR_PARTS = ("SheenChair_wood", "SheenChair_label")
MAX_TRIES = 20
TEXELS, PLATE_M = 256, 0.1


def measure_appearance(bench: str, options: BenchOptions) -> list[Row]:
    """Measure, per material and number of samples, the time of the close-up and the level error of its token."""
    from hnf_blender.bridge.importers import open_scene

    if options.quick or not CHAIR.is_file():
        return _measure_object(bench, make_printed_plate(), "a printed plate", options)
    rows: list[Row] = []
    for name in CHAIR_PARTS:
        options.watch(f"{bench}: the look of {name}")
        rows += _measure_object(bench, open_scene(CHAIR).objects[name], name, options)
    return rows


def _measure_object(bench: str, obj: Any, name: str, options: BenchOptions) -> list[Row]:
    close_up = _find_readable_patch(obj)
    tokens: dict[int, Token] = {}
    times: dict[int, tuple[float, float]] = {}
    counts = QUICK_SAMPLES if options.quick else SAMPLES
    for samples in counts:
        wall, cpu = time.perf_counter(), time.process_time()
        view = close_up(samples)
        times[samples] = time.perf_counter() - wall, time.process_time() - cpu
        tokens[samples] = _predict_token(view)
    return [
        Row(
            bench, f"look, {samples}", Spread.from_values([times[samples][0]]), Spread.from_values([times[samples][1]]),
            error=compute_level_error_db(tokens[samples], tokens[counts[-1]]), error_unit="dB of a band's level",
            note=f"{name}, unlit, against {counts[-1]} samples",
        )
        for samples in counts[:-1]
    ]  # fmt: skip


def compute_level_error_db(token: Token, true: Token) -> float:
    """Return the largest level difference [dB] of a band known to both."""
    known = token.known[LEVELS] & true.known[LEVELS]
    return float(20.0 * np.abs(token.values[LEVELS] - true.values[LEVELS])[known].max())


def _find_readable_patch(obj: Any) -> Callable[[int], Any]:
    """Return a function from samples to the close-up of a patch of obj with a usable image.

    Raises HnfError if there is no such patch.
    """
    import bpy

    from hnf_blender.bridge import closeup
    from hnf_blender.bridge.cycles import configure_cycles
    from hnf_blender.bridge.scene.meshes import make_ray_caster, read_surface
    from hnf_blender.touch.bake_patches import ReliefPredictor

    surface = read_surface(obj, bpy.context.evaluated_depsgraph_get(), 1.0)
    caster, predictor = make_ray_caster(surface.mesh), ReliefPredictor()

    def render_closeup(patch: Patch, samples: int) -> Any:
        with (
            patched.object(closeup, "configure_cycles", lambda scene, **_: configure_cycles(scene, samples)),
            closeup.CloseUpRenderer(obj, [patch], surface=surface, caster=caster) as renderer,
        ):
            return renderer.render(patch)

    corners = surface.mesh.corner_positions()
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    for chosen in np.random.default_rng(0).choice(len(area), MAX_TRIES, p=area / area.sum()):
        patch = _make_patch(corners[chosen], normal[chosen] / area[chosen], int(surface.mesh.slot[chosen]))
        view = render_closeup(patch, 1)
        if view.unlit is not None and predictor.make_views(view.unlit, view.mask, view.metres_per_pixel):
            return partial(render_closeup, patch)
    raise HnfError(f"no place of '{obj.name}' has a picture that can be read.", where="views")


def _make_patch(corners: NDArray[np.float64], normal: NDArray[np.float64], slot: int) -> Patch:
    along = corners[1] - corners[0]
    along = along - normal * (along @ normal)
    return Patch(corners.mean(axis=0), along / np.linalg.norm(along), normal, slot)


def _predict_token(closeup: Any) -> Token:
    from hnf_blender.touch.bake_patches import ReliefPredictor

    predictor = ReliefPredictor()
    views = predictor.make_views(closeup.unlit, closeup.mask, closeup.metres_per_pixel)
    return predictor.predict(closeup.unlit, views, seed=1).token


def make_printed_plate() -> Any:
    """Make a plate of 100 mm with an image of brown noise, 0.4 mm per texel."""
    import bpy

    from hnf_blender import compat
    from hnf_blender.bridge.importers import open_empty_scene

    open_empty_scene()
    bpy.ops.mesh.primitive_plane_add(size=PLATE_M)
    plate, material = bpy.context.object, bpy.data.materials.new("printed")
    plate.data.materials.append(material)
    compat.switch_nodes_on(material)
    nodes = material.node_tree.nodes
    texture = nodes.new("ShaderNodeTexImage")
    texture.image = bpy.data.images.new("print", TEXELS, TEXELS, float_buffer=True)
    grey = 0.4 + 0.1 * np.random.default_rng(0).normal(size=(TEXELS, TEXELS, 1))
    pixels = np.concatenate([np.clip(grey * [1.0, 0.7, 0.5], 0.0, 1.0), np.ones_like(grey)], axis=-1)
    texture.image.pixels.foreach_set(pixels.astype(np.float32).ravel())
    shader = next(node for node in nodes if node.bl_idname == "ShaderNodeBsdfPrincipled")
    material.node_tree.links.new(texture.outputs["Color"], shader.inputs["Base Color"])
    bpy.context.view_layer.update()
    return plate


VIEWS_NAME = "views"
CAMERA_COUNT, IMAGE_SIZE, QUICK_IMAGE_SIZE = 2, (640, 480), (64, 48)
REFERENCE_SAMPLES, QUICK_REFERENCE_SAMPLES = 256, 16
BLENDERPROC_SAMPLES, HNF_SAMPLES, PATCH_SAMPLES = (1, 4, 16), (1, 2, 4, 8), (16, 64)
QUICK_BLENDERPROC_SAMPLES, QUICK_HNF_SAMPLES, QUICK_PATCH_SAMPLES = (1, 4), (1, 4), (4,)
MIN_ERROR = 1e-6
"""Smallest error of sRGB; smaller ones count as this."""
AT_EQUAL_ERROR = "BlenderProc's at equal error"

Colours = list[NDArray[np.float32]]


@dataclass
class TimedRenders:
    """Measurements of one method.

    Attributes
    ----------
    cpus
        Processor times of all threads of this process [s].
    error, patch_error
        Errors of complete images, and within the patches.
    peak_mb
        Memory of the first run beyond that before [MB].
    """

    walls: list[float] = field(default_factory=list)
    cpus: list[float] = field(default_factory=list)
    error: float = 0.0
    patch_error: float = 0.0
    peak_mb: float | None = None

    def measure(self, function: Callable[[], Colours]) -> Colours:
        def run_timed() -> Colours:
            wall, cpu = time.perf_counter(), time.process_time()
            colours = function()
            self.walls.append(time.perf_counter() - wall)
            self.cpus.append(time.process_time() - cpu)
            return colours

        colours, peak = run_with_peak(run_timed)
        if len(self.walls) == 1:
            self.peak_mb = peak
        return colours


@dataclass(frozen=True)
class ReferenceViews:
    """Reference colours of a scene's cameras, and the touched patch in each image."""

    cameras: list[Camera]
    colours: Colours
    patches: list[Rectangle]


def measure_views(options: BenchOptions) -> list[Row]:
    """Measure, for each scene, both ways at several samples, patches alone, and depth alone. Empties the open file.

    Raises
    ------
    HnfError
        Without bpy or Open Image Denoise.
    """
    require_bpy(VIEWS_NAME)
    import bpy  # noqa: F401  # loads _cycles, which reports the denoiser

    from hnf_blender.compat import has_denoiser

    if not has_denoiser():
        raise HnfError("this Blender has no Open Image Denoise, which BlenderProc's way goes by.", where=VIEWS_NAME)
    rows: list[Row] = []
    for name, open_anew in list_scenes(options.quick).items():
        options.watch(f"{VIEWS_NAME}: {name}, the reference")
        truth = render_reference(open_anew(), options.quick)
        rows += _measure_scene(name, open_anew, truth, options) + measure_depth(
            VIEWS_NAME, name, open_anew, truth.cameras, options
        )
    return rows + measure_appearance(VIEWS_NAME, options)


def render_reference(scene: Any, quick: bool) -> ReferenceViews:
    """Render the reference by the product's path, without denoiser and with another seed."""
    cameras = place_cameras(scene, CAMERA_COUNT, *(QUICK_IMAGE_SIZE if quick else IMAGE_SIZE))
    views = render_views(scene, cameras, QUICK_REFERENCE_SAMPLES if quick else REFERENCE_SAMPLES, denoise=False, seed=1)
    patches = [find_patch(camera, depth) for camera, (_, depth) in zip(cameras, views, strict=True)]
    return ReferenceViews(cameras, [rgb for rgb, _ in views], patches)


def render_views(
    scene: Any, cameras: Sequence[Camera], samples: int, denoise: bool = True, seed: int = 0
) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
    """Render colour and depth like the product, but with BlenderProc's bounces."""
    from hnf_blender.bridge.lit_render import OverviewRenderer

    from .blenderproc import limit_bounces

    with OverviewRenderer(scene, samples=samples, entire_scene=True) as overviews:
        temporary = overviews.temporary.scene
        limit_bounces(temporary)
        temporary.cycles.use_denoising, temporary.cycles.seed = denoise, seed
        views = [overviews.render_view(camera)[0] for camera in cameras]
    return [(view.rgb, view.depth) for view in views]


def _measure_scene(name: str, opened: Callable[[], Any], truth: ReferenceViews, options: BenchOptions) -> list[Row]:
    from .blenderproc import render_as_blenderproc

    cameras = truth.cameras
    rectangles = [expand_rectangle(patch, camera) for patch, camera in zip(truth.patches, cameras, strict=True)]
    patch_cameras = [
        camera.crop(each.left, each.top, each.width, each.height)
        for camera, each in zip(cameras, rectangles, strict=True)
    ]
    counts = (
        (QUICK_BLENDERPROC_SAMPLES, QUICK_HNF_SAMPLES,
        QUICK_PATCH_SAMPLES) if options.quick else (BLENDERPROC_SAMPLES, HNF_SAMPLES, PATCH_SAMPLES)
    )  # fmt: skip
    blenderproc, product, on_patches = ({samples: TimedRenders() for samples in count} for count in counts)
    undenoised = TimedRenders()
    for repeat in range(options.repeats):
        options.watch(f"{VIEWS_NAME}: {name}, {repeat + 1} of {options.repeats}")
        for samples, timed in blenderproc.items():
            scene = opened()
            colours = timed.measure(lambda: _get_colours(render_as_blenderproc(scene, cameras, samples)))  # noqa: B023
            _record_errors(timed, colours, truth)
        scene = opened()
        most_samples = counts[0][-1]
        _record_errors(
            undenoised,
            undenoised.measure(lambda: _get_colours(render_as_blenderproc(scene, cameras, most_samples, False))),  # noqa: B023
            truth,
        )
        for samples, timed in product.items():
            scene = opened()
            _record_errors(timed, timed.measure(lambda: _get_colours(render_views(scene, cameras, samples))), truth)  # noqa: B023
        for samples, timed in on_patches.items():
            scene = opened()
            colours = timed.measure(lambda: _get_colours(render_views(scene, patch_cameras, samples)))  # noqa: B023
            timed.patch_error = _compute_patch_error(colours, rectangles, truth)
    note = f"{name}, {len(cameras)} views of {cameras[0].width} × {cameras[0].height}"
    return [
        *(_make_row(f"BlenderProc's way, {samples}", each, note) for samples, each in blenderproc.items()),
        _make_row(f"the same without its denoiser, {most_samples}", undenoised, note),
        *(
            _make_row(
                f"ours, {samples}",
                each,
                note,
                compute_ratio_at_equal_error(each, blenderproc, lambda timed_renders: timed_renders.error),
            )
            for samples, each in product.items()
        ),
        *(
            _make_patch_row(f"touched patches only, {samples}", each, blenderproc, f"{name}, one of 20 mm a view")
            for samples, each in on_patches.items()
        ),
    ]


def compute_ratio_at_equal_error(
    method: TimedRenders, rivals: dict[int, TimedRenders], error: Callable[[TimedRenders], float]
) -> Spread | None:
    """Return the ratio of processor times at equal error, repeat by repeat.

    The other's time is interpolated along its curve of log time over log error. If the method's error is below all
    others, the other's slowest time is used, in its favour; if it is above all others, the result is None.
    """
    curve = sorted(rivals.values(), key=error)
    errors = [max(error(rival), MIN_ERROR) for rival in curve]
    if error(method) > errors[-1]:
        return None
    log_error = np.log(max(error(method), MIN_ERROR))
    times = np.array([rival.cpus for rival in curve])
    theirs_s = [np.exp(np.interp(log_error, np.log(errors), np.log(column))) for column in times.T]
    return Spread.from_values(np.divide(method.cpus, theirs_s).tolist())


def _make_row(method: str, timed: TimedRenders, note: str, ratio: Spread | None = None) -> Row:
    return Row(
        VIEWS_NAME, method, Spread.from_values(timed.walls), Spread.from_values(timed.cpus), ratio,
        AT_EQUAL_ERROR if ratio else "",
        timed.error, "of sRGB", timed.peak_mb, note=note,
    )  # fmt: skip


def _make_patch_row(method: str, timed: TimedRenders, rivals: dict[int, TimedRenders], note: str) -> Row:
    ratio = compute_ratio_at_equal_error(timed, rivals, lambda renders: renders.patch_error)
    least = min(rival.patch_error for rival in rivals.values())
    return Row(
        VIEWS_NAME, method, Spread.from_values(timed.walls), Spread.from_values(timed.cpus), ratio,
        AT_EQUAL_ERROR if ratio else "",
        timed.patch_error, "of sRGB, there", timed.peak_mb, note=f"{note}; BlenderProc's least error there {least:.3g}",
    )  # fmt: skip


def _record_errors(timed: TimedRenders, colours: Colours, reference: ReferenceViews) -> None:
    full = [Rectangle(0, 0, camera.width, camera.height) for camera in reference.cameras]
    timed.error = _compute_patch_error(colours, full, ReferenceViews(reference.cameras, reference.colours, full))
    timed.patch_error = _compute_patch_error(colours, full, reference)


def _compute_patch_error(colours: Colours, rectangles: Sequence[Rectangle], reference: ReferenceViews) -> float:
    """Return the RMS of sRGB over the patches' pixels. rectangles: part of the image each colour covers."""
    differences = [
        (to_srgb(crop_patch(rgb, patch, shown)) - to_srgb(patch.crop(true))).ravel()
        for rgb, true, patch, shown in zip(colours, reference.colours, reference.patches, rectangles, strict=True)
    ]
    return float(np.sqrt(np.mean(np.concatenate(differences) ** 2)))


def crop_patch(rgb: NDArray[np.float32], patch: Rectangle, shown: Rectangle) -> NDArray[np.float32]:
    """Return the pixels of a patch from an image that covers only the rectangle `shown`."""
    return Rectangle(patch.left - shown.left, patch.top - shown.top, patch.width, patch.height).crop(rgb)


def to_srgb(rgb: NDArray[np.float32]) -> NDArray[np.float64]:
    return linear_to_srgb(rgb)


def _get_colours(views: Sequence[tuple[NDArray[np.float32], NDArray[np.float32]]]) -> Colours:
    return [rgb for rgb, _ in views]
