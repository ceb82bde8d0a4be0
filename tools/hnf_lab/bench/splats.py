"""Bench of splat rendering: the rasterizer against a loop over splats and the reference, and the cost of crops."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.scene.camera import Camera
from hnf_core.scene.splats.gaussians import Splats, compute_view_directions, evaluate_sh_colours
from hnf_core.scene.splats.project import MAX_ALPHA, MIN_ALPHA
from hnf_core.scene.splats.rasterize import SplatView, render_splats
from reference.splat_rendering import project_splats, render_reference

from .harness import BenchOptions, Row, Spread, Times, measure_peak_mb

Single = NDArray[np.float32]

SPLATS_NAME = "splats"
SPLAT_COUNT, QUICK_SPLAT_COUNT = 60_000, 300
PIXELS, QUICK_PIXELS = 256, 32
FLOATERS = 0.1
"""Fraction of faint splats off the surface."""
SEED = 7
CROP_FACTORS = (1, 2, 4, 8)
"""Divisors of the image side."""
NAIVE_NAME = "a loop over splats"


def measure_splats(options: BenchOptions) -> list[Row]:
    """Measure a generated cloud and, if given, options.scene. Raises FileError if the scene cannot be read."""
    pixels = QUICK_PIXELS if options.quick else PIXELS
    rows = _measure_cloud("ball", make_ball(QUICK_SPLAT_COUNT if options.quick else SPLAT_COUNT), pixels, options)
    if options.scene is not None:
        from hnf_core.scene.splats.splat_file import read_splats

        rows += _measure_cloud(options.scene.stem.partition(".")[0], read_splats(options.scene), pixels, options)
    return rows


def make_ball(count: int, seed: int = SEED) -> Splats:
    """Make a unit sphere covered with flat splats, as training leaves surfaces, and a tenth of faint floaters."""
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=(count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    half = np.column_stack([1.0 + normal[:, 2], -normal[:, 1], normal[:, 0], np.zeros(count)])
    half /= np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-9)  # turns +z to the normal
    scales = 2.5 / np.sqrt(count) * np.exp(0.6 * rng.normal(size=(count, 3)))
    scales[:, 2] *= 0.05
    is_floater = rng.random(count) < FLOATERS
    radius = np.where(is_floater, 1.5 * np.sqrt(rng.random(count)), 1.0)
    opacity = np.where(is_floater, 0.05, rng.beta(1.0, 1.5, count))
    harmonics = 0.4 * rng.normal(size=(count, 4, 3))
    arrays = (radius[:, None] * normal, scales, half, opacity, harmonics)
    return Splats(*(np.ascontiguousarray(array, dtype=np.float32) for array in arrays))


def make_camera(splats: Splats, pixels: int) -> Camera:
    """Make a camera that looks along +z at the median of the centres (+y of reconstructions points down).

    A field of view of 50° contains 98 % of the centres.
    """
    middle = np.median(splats.means, axis=0).astype(np.float64)
    radius = float(np.percentile(np.linalg.norm(splats.means - middle, axis=1), 98))
    tangent = np.tan(np.radians(25.0))
    pose = np.eye(4)
    pose[:3, 3] = middle - [0.0, 0.0, radius / np.sin(np.radians(25.0))]
    focal = 0.5 * pixels / tangent
    intrinsics = np.array([[focal, 0.0, 0.5 * pixels], [0.0, focal, 0.5 * pixels], [0.0, 0.0, 1.0]])
    return Camera("perspective", pixels, pixels, intrinsics, pose, 1e-3 * radius)


def render_naively(splats: Splats, camera: Camera) -> tuple[Single, Single, Single]:
    """Return rgb, Σ w z and opacity, by blending each splat's bounding box into the image in turn."""
    footprints = project_splats(splats, camera)
    directions = compute_view_directions(splats.means[footprints.index], camera)
    colour = evaluate_sh_colours(splats.harmonics[footprints.index], directions).astype(np.float32)
    transmittance = np.ones((camera.height, camera.width), dtype=np.float32)
    rgb, weighted = np.zeros((*transmittance.shape, 3), dtype=np.float32), np.zeros_like(transmittance)
    xx, xy = footprints.precision, -footprints.precision * footprints.shear
    yy = 1.0 / footprints.var_y + footprints.precision * footprints.shear**2
    numbers = np.column_stack([xx, xy, yy, footprints.u, footprints.v, footprints.opacity, footprints.depth]).tolist()
    boxes = np.column_stack([footprints.left, footprints.right, footprints.top, footprints.bottom]).tolist()
    columns = np.arange(camera.width, dtype=np.float32) + np.float32(0.5)
    row_centres = np.arange(camera.height, dtype=np.float32)[:, None] + np.float32(0.5)
    for (a, b, c, u, v, opacity, z), (left, right, top, bottom), tint in zip(numbers, boxes, colour, strict=True):
        box = np.s_[top:bottom, left:right]
        dx, dy = columns[left:right] - u, row_centres[top:bottom] - v
        alpha = np.minimum(opacity * np.exp(-0.5 * (a * dx * dx + c * dy * dy) - b * dx * dy), MAX_ALPHA)
        alpha *= alpha >= MIN_ALPHA
        weight = alpha * transmittance[box]
        rgb[box] += weight[..., None] * tint
        weighted[box] += weight * z
        transmittance[box] *= 1.0 - alpha
    return rgb, weighted, 1.0 - transmittance


def _measure_cloud(name: str, splats: Splats, pixels: int, options: BenchOptions) -> list[Row]:
    camera = make_camera(splats, pixels)
    variants: dict[str, Callable[[], object]] = {
        NAIVE_NAME: partial(render_naively, splats, camera),
        "one thread": partial(render_splats, splats, camera, threads=1),
        "two threads": partial(render_splats, splats, camera, threads=2),
    }
    options.watch(f"{SPLATS_NAME}: {name}, reference")
    reference_times = Times()
    reference = reference_times.measure(partial(render_reference, splats, camera))
    options.watch(f"{SPLATS_NAME}: {name}, {len(variants)} ways")
    render_splats(splats, camera)
    walls: dict[str, list[float]] = {variant: [] for variant in variants}
    times = {variant: Times() for variant in variants}
    for _ in range(options.repeats):
        for variant, run in variants.items():
            begin = time.perf_counter()
            times[variant].measure(run)
            walls[variant].append(time.perf_counter() - begin)
    title = f"{name}, {len(splats):,} at {pixels}²"
    rows = [
        Row(
            SPLATS_NAME,
            f"{title}: reference, float64",
            reference_times.seconds,
            reference_times.cpu,
            work=_count_work(reference),
        )
    ]
    rows.append(_make_row(f"{title}: {NAIVE_NAME}", times[NAIVE_NAME], len(splats)))
    rgb, _, opacity = render_naively(splats, camera)
    rows[-1] = replace(rows[-1], error=_compute_max_difference(rgb, opacity, reference), error_unit="of 1")
    for variant in ("one thread", "two threads"):
        ratio = Spread.from_values([own / base for own, base in zip(walls[variant], walls[NAIVE_NAME], strict=True)])
        view = render_splats(splats, camera)
        row = replace(_make_row(f"{title}: {variant}", times[variant], len(splats)), work=_count_work(view))
        if variant == "one thread":
            ratio = times[variant].compute_ratio(times[NAIVE_NAME])
            row = replace(row, peak_mb=measure_peak_mb(variants[variant]))
        else:
            row = replace(row, cpu=None)
        error = _compute_max_difference(view.rgb, view.opacity, reference)
        rows.append(replace(row, ratio=ratio, ratio_to=NAIVE_NAME, error=error, error_unit="of 1"))
    return rows + _measure_crops(title, splats, camera, reference, options)


def _measure_crops(title: str, splats: Splats, camera: Camera, exact: SplatView, options: BenchOptions) -> list[Row]:
    """Measure crops of the image centre with one thread."""
    options.watch(f"{SPLATS_NAME}: {title}, crops")
    rows, times = [], {factor: Times() for factor in CROP_FACTORS}
    side = {factor: camera.width // factor for factor in CROP_FACTORS}
    edge = {factor: (camera.width - side[factor]) // 2 for factor in CROP_FACTORS}
    cameras = {factor: camera.crop(edge[factor], edge[factor], side[factor], side[factor]) for factor in CROP_FACTORS}
    views = {factor: render_splats(splats, cameras[factor], threads=1) for factor in CROP_FACTORS}
    for _ in range(options.repeats):
        for factor in CROP_FACTORS:
            times[factor].measure(partial(render_splats, splats, cameras[factor], threads=1))
    for factor in CROP_FACTORS[1:]:
        span = np.s_[edge[factor] : edge[factor] + side[factor], edge[factor] : edge[factor] + side[factor]]
        reference_crop = replace(exact, rgb=exact.rgb[span], opacity=exact.opacity[span])
        row = Row(
            SPLATS_NAME,
            f"{title}: 1/{factor * factor} of the area",
            times[factor].seconds,
            times[factor].cpu,
            times[factor].compute_ratio(times[1]),
            "all of it",
            _compute_max_difference(views[factor].rgb, views[factor].opacity, reference_crop),
            "of 1",
            work=_count_work(views[factor]),
        )
        rows.append(row)
    return rows


def _make_row(method: str, times: Times, count: int) -> Row:
    return Row(SPLATS_NAME, method, times.seconds, times.cpu, note=f"{count / times.seconds.median:,.0f} splats/s")


def _count_work(view: SplatView) -> dict[str, int]:
    return {"splats": view.drawn, "pairs": view.pairs}


def _compute_max_difference(
    rgb: NDArray[np.floating[Any]], opacity: NDArray[np.floating[Any]], exact: SplatView
) -> float:
    """Return the largest difference of colour or opacity."""
    return float(max(np.abs(rgb - exact.rgb).max(), np.abs(opacity - exact.opacity).max()))
