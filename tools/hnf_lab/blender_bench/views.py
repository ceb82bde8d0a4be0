"""Scenes to look at from all sides: two real ones where the data for development are, else a small one of ours.

Depth alone: rays of ours, and Cycles' own depth, against every triangle tried for every ray in float64.

How many samples a close-up needs until the token that is predicted from its look no longer moves.

RGB-D of the same cameras: ours and BlenderProc's way, time beside error; the touched patches alone; depth alone.

Both render by the Cycles of this Blender, on all cores, with BlenderProc's light bounces, one seed, the scene opened
anew for each. Error is the RMS of sRGB colour in 0–1 against 256 samples of another seed without a denoiser.
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
from hnf_core.scene.camera import Camera
from hnf_core.scene.mesh import TriangleMesh
from hnf_core.scene.patch import PATCH_SIZE_M, Patch
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
"""Not what the cameras are to show."""
MARGIN_PX = 8
"""Around a patch, so that the denoiser sees what goes on beside it."""


@dataclass(frozen=True)
class Rectangle:
    """Of pixels."""

    left: int
    top: int
    width: int
    height: int

    def crop(self, image: NDArray[Any]) -> NDArray[Any]:
        """Of an image (H, W, …)."""
        return image[self.top : self.top + self.height, self.left : self.left + self.width]


def list_scenes(quick: bool) -> dict[str, Callable[[], Any]]:
    """Name → what opens it anew, lit, and returns it."""
    if quick or not all(path.is_file() for path in REAL_SCENES):
        return {"three balls": make_three_balls}
    return {path.parent.name: lambda path=path: _open_scene(path) for path in REAL_SCENES}  # type: ignore[misc]


def make_three_balls() -> Any:
    """Balls of 60 mm on a floor, under a lamp."""
    import bpy

    from hnf_blender.bridge.importers import open_empty_scene

    open_empty_scene()
    scene = bpy.context.scene
    _, floor = bpy.ops.mesh.primitive_plane_add(size=0.6), bpy.context.object
    floor.name = FLOOR_NAME
    for place in (-0.08, 0.0, 0.08):
        bpy.ops.mesh.primitive_uv_sphere_add(segments=24, ring_count=12, radius=0.03, location=(place, place / 2, 0.03))
    lamp = bpy.data.objects.new("lamp", bpy.data.lights.new("lamp", "SUN"))
    scene.collection.objects.link(lamp)
    lamp.data.energy, lamp.rotation_euler = 2.0, (0.5, 0.3, 0.0)
    bpy.context.view_layer.update()
    return scene


def place_cameras(scene: Any, count: int, width: int, height: int) -> list[Camera]:
    """count cameras on a ring, three-quarter views of all that stands on the floor."""
    from hnf_blender.bridge.render.cycles import make_overview_camera
    from hnf_blender.bridge.scene.bounding_boxes import get_world_box

    depsgraph = scene.view_layers[0].depsgraph
    boxes = [get_world_box(obj, depsgraph, 1.0) for obj in list_meshes(scene) if obj.name != FLOOR_NAME]
    low, high = np.min([box[0] for box in boxes], axis=0), np.max([box[1] for box in boxes], axis=0)
    corners = np.stack(np.meshgrid(*zip(low, high, strict=True)), axis=-1).reshape(-1, 3)
    turns = 2.0 * np.pi * np.arange(count) / 12.0 + 0.3
    return [make_overview_camera(corners, [np.cos(turn), np.sin(turn), 0.15], 0.05, width, height) for turn in turns]


def list_meshes(scene: Any) -> list[Any]:
    return [obj for obj in scene.objects if obj.type == "MESH"]


def find_patch(camera: Camera, depth: NDArray[np.float32]) -> Rectangle:
    """What shows 20 mm of surface around the pixel nearest to the middle of the picture that shows any."""
    rows, columns = np.nonzero(np.isfinite(depth))
    nearest = np.argmin((rows - camera.height / 2.0) ** 2 + (columns - camera.width / 2.0) ** 2)
    row, column = int(rows[nearest]), int(columns[nearest])
    side = max(4, round(PATCH_SIZE_M * camera.intrinsics[0, 0] / float(depth[row, column])))
    left, top = max(0, column - side // 2), max(0, row - side // 2)
    return Rectangle(left, top, min(side, camera.width - left), min(side, camera.height - top))


def expand_rectangle(patch: Rectangle, camera: Camera) -> Rectangle:
    """With MARGIN_PX around it, as far as the picture reaches."""
    left, top = max(0, patch.left - MARGIN_PX), max(0, patch.top - MARGIN_PX)
    right = min(camera.width, patch.left + patch.width + MARGIN_PX)
    bottom = min(camera.height, patch.top + patch.height + MARGIN_PX)
    return Rectangle(left, top, right - left, bottom - top)


def make_world_mesh(scene: Any) -> TriangleMesh:
    """Every solid of the scene in one mesh, world metres."""
    from hnf_blender.bridge.scene.meshes import read_surface

    depsgraph = scene.view_layers[0].depsgraph
    parts = [read_surface(obj, depsgraph, 1.0) for obj in list_meshes(scene)]
    starts = np.cumsum([0, *(len(part.mesh.vertices) for part in parts)])
    turned = [part.rigid[:3, :3] for part in parts]
    return TriangleMesh(
        vertices=np.concatenate([
            part.mesh.vertices @ turn.T + part.rigid[:3, 3] for part, turn in zip(parts, turned, strict=True)
        ]),
        triangles=np.concatenate([part.mesh.triangles + start for part, start in zip(parts, starts, strict=False)]),
        normals=np.concatenate([part.mesh.normals @ turn.T for part, turn in zip(parts, turned, strict=True)]),
        face=np.concatenate([part.mesh.face for part in parts]),
        slot=np.concatenate([part.mesh.slot for part in parts]),
    )  # fmt: skip


def _open_scene(path: Path) -> Any:
    """Lit by a neutral dome where it has no light, as our pictures of it are."""
    from hnf_blender.bridge.importers import open_scene
    from hnf_blender.bridge.render.lit_render import add_dome, is_lit

    scene = open_scene(path)
    if not is_lit(scene):
        add_dome(scene)
    return scene


REFERENCE_RAYS, QUICK_REFERENCE_RAYS = 250, 20
"""Compared with the reference, of each camera."""
NO_DEPTH = 1e9

Depths = list[NDArray[np.float32]]


def measure_depth(
    bench: str, name: str, opened: Callable[[], Any], cameras: Sequence[Camera], options: BenchOptions
) -> list[Row]:
    """BlenderProc's depth (one sample, no denoiser), Cycles' without light, and ours by rays: time, worst error."""
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
    """Flat pixel numbers and planar depths of count pixels of each camera that surely show a surface."""
    rng = np.random.default_rng(0)
    geometry, caster = ReferenceGeometry(mesh), make_embree_caster(mesh)
    pixels, depths = [], []
    for camera in cameras:
        solid = np.flatnonzero(np.isfinite(cast_view(caster, mesh, camera).depth).ravel())
        chosen = rng.choice(solid, min(count, len(solid)), replace=False)
        origins, directions = (each.reshape(-1, 3)[chosen] for each in camera.pixel_rays())
        pixels.append(chosen)
        depths.append(geometry.cast(origins, directions).distance)
    return pixels, depths


def compute_depth_error(
    depths: Depths, pixels: Sequence[NDArray[np.int64]], true: Sequence[NDArray[np.float64]]
) -> tuple[float, float]:
    """Median and 99.9 % of the relative error; where only one of the two sees a surface, 1."""
    errors = []
    for depth, chosen, expected in zip(depths, pixels, true, strict=True):
        found = depth.ravel()[chosen].astype(np.float64)
        both = np.isfinite(expected) & (found < NO_DEPTH)
        scale = np.where(np.isfinite(expected), expected, 1.0)
        errors.append(np.where(both, np.abs(np.where(both, found, 0.0) - scale) / scale, 1.0))
    median, most = np.percentile(np.concatenate(errors), [50.0, 99.9])
    return float(median), float(most)


def _render_unlit_depth(scene: Any, cameras: Sequence[Camera]) -> Depths:
    from hnf_blender.bridge.render.cycles import disable_lighting
    from hnf_blender.bridge.render.lit_render import OverviewRenderer

    with OverviewRenderer(scene, samples=1, entire_scene=True) as overviews:
        disable_lighting(overviews.temporary.scene)
        overviews.temporary.scene.cycles.use_denoising = False
        return [overviews.render_view(camera)[0].depth for camera in cameras]


def _cast_depth(scene: Any, cameras: Sequence[Camera]) -> Depths:
    mesh = make_world_mesh(scene)
    caster = make_embree_caster(mesh)
    return [cast_view(caster, mesh, camera).depth.astype(np.float32) for camera in cameras]


SAMPLES, QUICK_SAMPLES = (1, 4, 16, 64, 256), (1, 4, 16)
"""The last is the reference."""
CHAIR = SCENE_DATA / "SheenChairScene" / "MixedLightingExample.gltf"
CHAIR_PARTS = ("SheenChair_wood", "SheenChair_label")
MAX_TRIES = 20
TEXELS, PLATE_M = 256, 0.1


def measure_appearance(bench: str, options: BenchOptions) -> list[Row]:
    """For each material and number of samples: time of the close-up, and by how many dB its token's levels are off."""
    from hnf_blender.bridge.importers import open_scene

    if options.quick or not CHAIR.is_file():
        return _measure_object(bench, make_printed_plate(), "a printed plate", options)
    found: list[Row] = []
    for name in CHAIR_PARTS:
        options.watch(f"{bench}: the look of {name}")
        found += _measure_object(bench, open_scene(CHAIR).objects[name], name, options)
    return found


def _measure_object(bench: str, obj: Any, name: str, options: BenchOptions) -> list[Row]:
    close_up = _find_readable_patch(obj)
    tokens: dict[int, Token] = {}
    times: dict[int, tuple[float, float]] = {}
    counts = QUICK_SAMPLES if options.quick else SAMPLES
    for samples in counts:
        wall, cpu = time.perf_counter(), time.process_time()
        seen = close_up(samples)
        times[samples] = time.perf_counter() - wall, time.process_time() - cpu
        tokens[samples] = _predict_token(seen)
    return [
        Row(
            bench, f"look, {samples}", Spread.from_values([times[samples][0]]), Spread.from_values([times[samples][1]]),
            error=compute_level_error_db(tokens[samples], tokens[counts[-1]]), error_unit="dB of a band's level",
            note=f"{name}, unlit, against {counts[-1]} samples",
        )
        for samples in counts[:-1]
    ]  # fmt: skip


def compute_level_error_db(token: Token, true: Token) -> float:
    """The largest difference of a band's level that both know, in dB."""
    known = token.known[LEVELS] & true.known[LEVELS]
    return float(20.0 * np.abs(token.values[LEVELS] - true.values[LEVELS])[known].max())


def _find_readable_patch(obj: Any) -> Callable[[int], Any]:
    """Samples → the close-up of a place of obj whose picture can be read. Raises HnfError where there is none."""
    import bpy

    from hnf_blender.bridge.render import closeup
    from hnf_blender.bridge.render.cycles import configure_cycles
    from hnf_blender.bridge.scene.meshes import make_ray_caster, read_surface
    from hnf_blender.touch.bake_patches import ReliefPredictor

    surface = read_surface(obj, bpy.context.evaluated_depsgraph_get(), 1.0)
    caster, seeing = make_ray_caster(surface.mesh), ReliefPredictor()

    def sampled(place: Patch, samples: int) -> Any:
        with patched.object(closeup, "configure_cycles", lambda scene, **_: configure_cycles(scene, samples)):
            (found,) = closeup.iter_closeups(obj, [place], surface=surface, caster=caster)
            return found

    corners = surface.mesh.corner_positions()
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    for chosen in np.random.default_rng(0).choice(len(area), MAX_TRIES, p=area / area.sum()):
        place = _make_patch(corners[chosen], normal[chosen] / area[chosen], int(surface.mesh.slot[chosen]))
        seen = sampled(place, 1)
        if seen.unlit is not None and seeing.make_views(seen.unlit, seen.mask, seen.metres_per_pixel):
            return partial(sampled, place)
    raise HnfError(f"no place of '{obj.name}' has a picture that can be read.", where="views")


def _make_patch(corners: NDArray[np.float64], normal: NDArray[np.float64], slot: int) -> Patch:
    along = corners[1] - corners[0]
    along = along - normal * (along @ normal)
    return Patch(corners.mean(axis=0), along / np.linalg.norm(along), normal, slot)


def _predict_token(closeup: Any) -> Token:
    from hnf_blender.touch.bake_patches import ReliefPredictor

    seeing = ReliefPredictor()
    views = seeing.make_views(closeup.unlit, closeup.mask, closeup.metres_per_pixel)
    return seeing.predict(closeup.unlit, views, seed=1).token


def make_printed_plate() -> Any:
    """A plate of 100 mm under a picture of brown noise, 0.4 mm a texel."""
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

    from hnf_blender.compat import has_denoiser

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
    from hnf_blender.bridge.render.lit_render import OverviewRenderer

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
        (QUICK_BLENDERPROC_SAMPLES, QUICK_HNF_SAMPLES,
        QUICK_PATCH_SAMPLES) if options.quick else (BLENDERPROC_SAMPLES, HNF_SAMPLES, PATCH_SAMPLES)
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
            plain.measure(lambda: _get_colours(render_as_blenderproc(scene, cameras, most, False))),  # noqa: B023
            truth,
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
        VIEWS_NAME, method, Spread.from_values(timed.walls), Spread.from_values(timed.cpus), ratio,
        AT_EQUAL_ERROR if ratio else "",
        timed.error, "of sRGB", timed.peak_mb, note=note,
    )  # fmt: skip


def _make_patch_row(method: str, timed: TimedRenders, rivals: dict[int, TimedRenders], note: str) -> Row:
    ratio = compute_ratio_at_equal_error(timed, rivals, lambda one: one.patch_error)
    least = min(each.patch_error for each in rivals.values())
    return Row(
        VIEWS_NAME, method, Spread.from_values(timed.walls), Spread.from_values(timed.cpus), ratio,
        AT_EQUAL_ERROR if ratio else "",
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
