"""Splats until there is a picture: the splatter beside the naive way and the reference, and what a crop costs."""

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
SEED = 7
CROP_FACTORS = (1, 2, 4, 8)
NAIVE_NAME = "a loop over splats"


def measure_splats(options: BenchOptions) -> list[Row]:
    """Of a cloud made here and, where there is one, of options.scene. Raises FileError where that cannot be read."""
    pixels = QUICK_PIXELS if options.quick else PIXELS
    found = _measure_cloud("ball", make_ball(QUICK_SPLAT_COUNT if options.quick else SPLAT_COUNT), pixels, options)
    if options.scene is not None:
        from hnf_core.scene.splats.io_ply import read_splats

        found += _measure_cloud(options.scene.stem.partition(".")[0], read_splats(options.scene), pixels, options)
    return found


def make_ball(count: int, seed: int = SEED) -> Splats:
    """A sphere of radius 1 covered with flat splats, as training leaves surfaces, and a tenth of faint floaters."""
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=(count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    half = np.column_stack([1.0 + normal[:, 2], -normal[:, 1], normal[:, 0], np.zeros(count)])
    half /= np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-9)  # turns +z to the normal
    wide = 2.5 / np.sqrt(count) * np.exp(0.6 * rng.normal(size=(count, 3)))
    wide[:, 2] *= 0.05
    floats = rng.random(count) < FLOATERS
    radius = np.where(floats, 1.5 * np.sqrt(rng.random(count)), 1.0)
    opacity = np.where(floats, 0.05, rng.beta(1.0, 1.5, count))
    harmonics = 0.4 * rng.normal(size=(count, 4, 3))
    parts = (radius[:, None] * normal, wide, half, opacity, harmonics)
    return Splats(*(np.ascontiguousarray(each, dtype=np.float32) for each in parts))


def make_camera(splats: Splats, pixels: int) -> Camera:
    """Looks along +z (+y of reconstructions points down) at the middle, a field of 50° round 98 % of the centres."""
    middle = np.median(splats.means, axis=0).astype(np.float64)
    radius = float(np.percentile(np.linalg.norm(splats.means - middle, axis=1), 98))
    tangent = np.tan(np.radians(25.0))
    pose = np.eye(4)
    pose[:3, 3] = middle - [0.0, 0.0, radius / np.sin(np.radians(25.0))]
    focal = 0.5 * pixels / tangent
    intrinsics = np.array([[focal, 0.0, 0.5 * pixels], [0.0, focal, 0.5 * pixels], [0.0, 0.0, 1.0]])
    return Camera("perspective", pixels, pixels, intrinsics, pose, 1e-3 * radius)


def render_naively(splats: Splats, camera: Camera) -> tuple[Single, Single, Single]:
    """rgb, Σ w z and opacity: each splat's bounding box blended into the picture, one after the other."""
    prints = project_splats(splats, camera)
    towards = compute_view_directions(splats.means[prints.index], camera)
    colour = evaluate_sh_colours(splats.harmonics[prints.index], towards).astype(np.float32)
    light = np.ones((camera.height, camera.width), dtype=np.float32)
    rgb, weighted = np.zeros((*light.shape, 3), dtype=np.float32), np.zeros_like(light)
    xx, xy = prints.precision, -prints.precision * prints.shear
    yy = 1.0 / prints.var_y + prints.precision * prints.shear**2
    numbers = np.column_stack([xx, xy, yy, prints.u, prints.v, prints.opacity, prints.depth]).tolist()
    boxes = np.column_stack([prints.left, prints.right, prints.top, prints.bottom]).tolist()
    columns = np.arange(camera.width, dtype=np.float32) + np.float32(0.5)
    rows_ = np.arange(camera.height, dtype=np.float32)[:, None] + np.float32(0.5)
    for (a, b, c, u, v, opacity, z), (left, right, top, bottom), tint in zip(numbers, boxes, colour, strict=True):
        box = np.s_[top:bottom, left:right]
        dx, dy = columns[left:right] - u, rows_[top:bottom] - v
        alpha = np.minimum(opacity * np.exp(-0.5 * (a * dx * dx + c * dy * dy) - b * dx * dy), MAX_ALPHA)
        alpha *= alpha >= MIN_ALPHA
        weight = alpha * light[box]
        rgb[box] += weight[..., None] * tint
        weighted[box] += weight * z
        light[box] *= 1.0 - alpha
    return rgb, weighted, 1.0 - light


def _measure_cloud(name: str, splats: Splats, pixels: int, options: BenchOptions) -> list[Row]:
    camera = make_camera(splats, pixels)
    ways: dict[str, Callable[[], object]] = {
        NAIVE_NAME: partial(render_naively, splats, camera),
        "one thread": partial(render_splats, splats, camera, threads=1),
        "two threads": partial(render_splats, splats, camera, threads=2),
    }
    options.watch(f"{SPLATS_NAME}: {name}, reference")
    plain = Times()
    exact = plain.measure(partial(render_reference, splats, camera))
    options.watch(f"{SPLATS_NAME}: {name}, {len(ways)} ways")
    render_splats(splats, camera)
    walls: dict[str, list[float]] = {way: [] for way in ways}
    times = {way: Times() for way in ways}
    for _ in range(options.repeats):
        for way, run in ways.items():
            begin = time.perf_counter()
            times[way].measure(run)
            walls[way].append(time.perf_counter() - begin)
    title = f"{name}, {len(splats):,} at {pixels}²"
    found = [Row(SPLATS_NAME, f"{title}: reference, float64", plain.seconds, plain.cpu, work=_count_work(exact))]
    found.append(_make_row(f"{title}: {NAIVE_NAME}", times[NAIVE_NAME], len(splats)))
    rgb, _, opacity = render_naively(splats, camera)
    found[-1] = replace(found[-1], error=_compute_max_difference(rgb, opacity, exact), error_unit="of 1")
    for way in ("one thread", "two threads"):
        ratio = Spread.from_values([mine / its for mine, its in zip(walls[way], walls[NAIVE_NAME], strict=True)])
        view = render_splats(splats, camera)
        row = replace(_make_row(f"{title}: {way}", times[way], len(splats)), work=_count_work(view))
        if way == "one thread":
            ratio = times[way].compute_ratio(times[NAIVE_NAME])
            row = replace(row, peak_mb=measure_peak_mb(ways[way]))
        else:
            row = replace(row, cpu=None)
        error = _compute_max_difference(view.rgb, view.opacity, exact)
        found.append(replace(row, ratio=ratio, ratio_to=NAIVE_NAME, error=error, error_unit="of 1"))
    return found + _measure_crops(title, splats, camera, exact, options)


def _measure_crops(title: str, splats: Splats, camera: Camera, exact: SplatView, options: BenchOptions) -> list[Row]:
    """The middle of the picture, by one thread."""
    options.watch(f"{SPLATS_NAME}: {title}, crops")
    found, times = [], {part: Times() for part in CROP_FACTORS}
    side = {part: camera.width // part for part in CROP_FACTORS}
    edge = {part: (camera.width - side[part]) // 2 for part in CROP_FACTORS}
    cameras = {part: camera.crop(edge[part], edge[part], side[part], side[part]) for part in CROP_FACTORS}
    views = {part: render_splats(splats, cameras[part], threads=1) for part in CROP_FACTORS}
    for _ in range(options.repeats):
        for part in CROP_FACTORS:
            times[part].measure(partial(render_splats, splats, cameras[part], threads=1))
    for part in CROP_FACTORS[1:]:
        span = np.s_[edge[part] : edge[part] + side[part], edge[part] : edge[part] + side[part]]
        part_of = replace(exact, rgb=exact.rgb[span], opacity=exact.opacity[span])
        row = Row(
            SPLATS_NAME,
            f"{title}: 1/{part * part} of the area",
            times[part].seconds,
            times[part].cpu,
            times[part].compute_ratio(times[1]),
            "all of it",
            _compute_max_difference(views[part].rgb, views[part].opacity, part_of),
            "of 1",
            work=_count_work(views[part]),
        )
        found.append(row)
    return found


def _make_row(method: str, times: Times, count: int) -> Row:
    return Row(SPLATS_NAME, method, times.seconds, times.cpu, note=f"{count / times.seconds.median:,.0f} splats/s")


def _count_work(view: SplatView) -> dict[str, int]:
    return {"splats": view.drawn, "pairs": view.pairs}


def _compute_max_difference(
    rgb: NDArray[np.floating[Any]], opacity: NDArray[np.floating[Any]], exact: SplatView
) -> float:
    """The largest difference of colour or opacity."""
    return float(max(np.abs(rgb - exact.rgb).max(), np.abs(opacity - exact.opacity).max()))
