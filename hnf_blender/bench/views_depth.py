"""Depth alone: rays of ours, and Cycles' own depth, against every triangle tried for every ray in float64."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.bench.frame import BenchOptions, Row, Spread
from hnf_core.scene.camera import Camera
from hnf_core.scene.mesh import TriangleMesh
from hnf_core.scene.raycast import ReferenceGeometry, cast_view, make_embree_caster

from .views_scene import make_world_mesh

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
    from ..bridge.picture import OverviewRenderer
    from ..bridge.render import disable_lighting

    with OverviewRenderer(scene, samples=1, entire_scene=True) as overviews:
        disable_lighting(overviews.temporary.scene)
        overviews.temporary.scene.cycles.use_denoising = False
        return [overviews.render_view(camera)[0].depth for camera in cameras]


def _cast_depth(scene: Any, cameras: Sequence[Camera]) -> Depths:
    mesh = make_world_mesh(scene)
    caster = make_embree_caster(mesh)
    return [cast_view(caster, mesh, camera).depth.astype(np.float32) for camera in cameras]
