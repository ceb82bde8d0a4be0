"""Surfaces from splats: known shapes, properties of each step, and refusal of poor input."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from splat_shapes import fog, joined, moved, sheet, sphere, torus

from hnf_core.errors import SceneError, UsageError
from hnf_core.progress import Cancelled, Progress
from hnf_core.scene.splats.depth_views import (
    fit_orthographic_camera,
    make_depth_view,
    make_sphere_directions,
    make_surrounding_cameras,
    sample_points,
)
from hnf_core.scene.splats.rasterize import SplatView
from hnf_core.scene.splats.reconstruct import (
    MAX_RAGGED_SHARE,
    MAX_TRANSLUCENT_SHARE,
    Clarity,
    SplatSurface,
    assess_quality,
    compute_open_edge_share,
    reconstruct_surface,
)
from hnf_core.scene.splats.splat_file import read_splats
from hnf_core.units import srgb_to_linear

SPLATS = Path(__file__).resolve().parents[3].parent / "shared" / "data" / "splats"
CELLS, VIEWS = 32, 20


def ball_distance(points):
    return np.linalg.norm(points, axis=-1) - 1.0


def ring_distance(points):
    return np.hypot(np.hypot(points[:, 0], points[:, 1]) - 0.7, points[:, 2]) - 0.3


@cache
def made(name: str) -> SplatSurface:
    red_side = np.where(make_sphere_directions(1500)[:, :1] > 0.0, [[0.9, 0.2, 0.2]], [[0.2, 0.2, 0.9]])
    half = sphere(1500)
    clouds = {
        "ball": lambda: sphere(1500, colour=red_side),
        "ring": torus,
        "sheet": sheet,
        "shell": lambda: half.take(half.means[:, 2] > 0.0),
        "two": lambda: joined(sphere(800), moved(sphere(800), by=(3.2, 0.0, 0.0))),
        "fog": fog,
    }
    return reconstruct_surface(clouds[name](), cells=CELLS, views=VIEWS)


def times_used(triangles):
    ends = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    pairs, times = np.unique(np.sort(ends, axis=1), axis=0, return_counts=True)
    return pairs, times


@pytest.mark.parametrize(("name", "distance", "euler"), [("ball", ball_distance, 2), ("ring", ring_distance, 0)])
def test_a_solid_becomes_its_closed_surface(name, distance, euler):
    found = made(name)
    pairs, times = times_used(found.triangles)
    assert (times % 2 == 0).all()  # an ambiguous cube gives an edge four triangles
    assert (times == 4).mean() < 1e-3
    assert abs(len(found.vertices) - len(pairs) + len(found.triangles) - euler) <= (times == 4).sum()
    away = distance(found.vertices.astype(np.float64)) / found.spacing
    assert np.abs(away).mean() < 0.2
    assert np.quantile(np.abs(away), 0.99) < 0.6
    assert found.quality.touchable, found.quality.warnings
    assert found.quality.open == compute_open_edge_share(found.triangles) == 0.0


def test_normals_point_outward_and_colours_match_the_splats():
    ball = made("ball")
    outward = ball.vertices / np.linalg.norm(ball.vertices, axis=1, keepdims=True)
    assert np.quantile(np.sum(ball.normals * outward, axis=1), 0.01) > 0.97
    np.testing.assert_allclose(np.linalg.norm(ball.normals, axis=1), 1.0, rtol=1e-5)
    corner = ball.vertices[ball.triangles].astype(np.float64)
    faces = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    assert (np.sum(faces * corner[:, 0], axis=1) > 0.0).mean() > 0.998
    for side, colour in ((1.0, [0.9, 0.2, 0.2]), (-1.0, [0.2, 0.2, 0.9])):
        there = side * ball.vertices[:, 0] > 0.4
        np.testing.assert_allclose(np.median(ball.colour[there], axis=0), srgb_to_linear(colour), atol=0.02)
    assert (ball.support >= 1).all()
    assert (ball.support <= VIEWS).all()


def test_a_sheet_without_an_inside_has_two_sides_that_look_apart():
    found = made("sheet")
    inner = (np.abs(found.vertices[:, :2]) < 0.8).all(axis=1)
    up, down = inner & (found.normals[:, 2] > 0.9), inner & (found.normals[:, 2] < -0.9)
    assert (up | down).sum() == inner.sum()
    assert abs(up.sum() / down.sum() - 1.0) < 0.1
    assert (found.vertices[up, 2] > 0.1 * found.spacing).all()
    assert (found.vertices[down, 2] < -0.1 * found.spacing).all()
    assert np.abs(found.vertices[inner, 2]).max() < 0.4 * found.spacing


def test_a_half_shell_is_open_inside_and_right_on_both_sides():
    found = made("shell")
    height = found.vertices[:, 2]
    away = np.abs(ball_distance(found.vertices.astype(np.float64)))[height > 0.2] / found.spacing
    assert np.quantile(away, 0.9) < 0.6
    radial = np.sum(found.normals * found.vertices, axis=1)[height > 0.2]
    assert 0.3 < (radial > 0.5).mean() < 0.7
    assert 0.3 < (radial < -0.5).mean() < 0.7
    assert height.min() > -0.2


def test_two_solids_stay_two():
    found = made("two")
    assert found.quality.components == 2
    assert found.quality.touchable, found.quality.warnings


def test_fog_is_too_poor_to_touch_and_says_why():
    found = made("fog").quality
    assert not found.touchable
    assert any("fog" in each for each in found.warnings), found
    assert found.clarity.translucent > 1.2 * MAX_TRANSLUCENT_SHARE


def test_loose_grains_are_no_surface():
    random = np.random.default_rng(3)
    ball = sphere(1500)
    shaken = (ball.means + 0.15 * random.standard_normal(ball.means.shape)).astype(np.float32)
    found = reconstruct_surface(replace(ball, means=shaken, scales=0.5 * ball.scales), cells=CELLS, views=VIEWS).quality
    assert not found.touchable
    assert found.clarity.translucent > MAX_TRANSLUCENT_SHARE or found.clarity.ragged > MAX_RAGGED_SHARE


def test_each_thing_that_makes_it_poor_is_said():
    ball = made("ball")
    clear = ball.quality.clarity

    def said(count=1500, kept=1.0, triangles=ball.triangles, seen=clear, away=0.0) -> tuple[str, ...]:
        vertices = ball.vertices.astype(np.float64) + away
        spread, views = ball.spread, ball.support.astype(np.int32)
        return assess_quality(
            sphere(1500).take(np.arange(count)), kept, vertices, triangles, ball.spacing, spread, views, 1, seen
        ).warnings

    assert said() == ()
    for words, problem in (
        ("only 150 splats", {"count": 150}),
        ("dropped 40 %", {"kept": 0.6}),
        ("full of holes", {"triangles": ball.triangles[np.arange(len(ball.triangles)) % 5 > 0]}),
        ("half transparent", {"seen": Clarity(0.3, 0.0)}),
        ("loose grains", {"seen": Clarity(0.0, 0.3)}),
        ("fog", {"away": 20.0 * ball.spacing}),
    ):
        (warning,) = said(**problem)
        assert words in warning


def test_neither_scale_nor_dirt_changes_the_surface():
    ball = made("ball")
    specks = moved(sphere(6), 0.01, (2.0, 0.0, 0.0))
    same = reconstruct_surface(sphere(1500), cells=CELLS, views=VIEWS)
    large = reconstruct_surface(moved(joined(sphere(1500), specks), 1024.0), cells=CELLS, views=VIEWS)
    np.testing.assert_array_equal(same.vertices, ball.vertices)
    np.testing.assert_array_equal(large.vertices, same.vertices * np.float32(1024.0))
    np.testing.assert_array_equal(large.triangles, same.triangles)
    assert large.pruned.dropped["floating"] == 6
    assert large.quality.median == pytest.approx(1024.0 * same.quality.median, rel=1e-6)


def test_progress_is_told_in_order_and_can_stop_it():
    told: list[Progress] = []
    reconstruct_surface(sphere(300), cells=12, views=6, progress=told.append)
    shares = [progress.fraction for progress in told]
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, 1.0)
    stages = list(dict.fromkeys(progress.stage for progress in told))
    assert stages == ["cleaning", "looking", "fusing", "meshing", "settling", "judging", "done"]

    def stop(progress: Progress) -> None:
        if progress.stage == "fusing":
            raise Cancelled

    with pytest.raises(Cancelled):
        reconstruct_surface(sphere(300), cells=12, views=6, progress=stop)


def test_what_makes_no_surface_is_refused_in_words():
    ball = sphere(300)
    faint = replace(ball, opacities=np.full(300, 0.06, dtype=np.float32), scales=0.2 * ball.scales)
    with pytest.raises(SceneError, match=r"ball\.ply: no view shows anything solid"):
        reconstruct_surface(faint, cells=12, views=6, where="ball.ply")
    for cells, views in ((7, 6), (100_000, 6), (12, 5), (12, 10_000)):
        with pytest.raises(UsageError):
            reconstruct_surface(ball, cells=cells, views=views)


def test_cameras_see_everything_from_outside():
    cloud = joined(sphere(200), moved(torus(20, 10), 0.5, (3.0, 1.0, -2.0)))
    means, reach = cloud.means.astype(np.float64), np.full(len(cloud), 0.2)
    directions = make_sphere_directions(26)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, rtol=1e-12)
    gaps = np.sort(np.arccos(np.clip(directions @ directions.T, -1.0, 1.0)), axis=1)[:, 1]
    assert gaps.min() > 0.3
    for camera, direction in zip(make_surrounding_cameras(means, reach, 26, 0.1), directions, strict=True):
        uv, z = camera.project(means)
        assert (z > 0.19).all()
        assert (z < camera.clip_end - 0.19).all()
        assert (uv >= 1.9).all()
        assert (uv <= np.array([camera.width, camera.height]) - 1.9).all()
        np.testing.assert_allclose(camera.pose[:3, 2], -direction, atol=1e-12)
        np.testing.assert_allclose(np.linalg.det(camera.pose[:3, :3]), 1.0)


@pytest.mark.parametrize("tilt", [0.0, 0.3, 0.9])
def test_a_glance_at_a_plane_is_the_distance_to_it(tilt):
    camera = fit_orthographic_camera([0.0, 0.0, 1.0], np.array([[-8.0, -8.0, 0.0], [8.0, 8.0, 8.0]]), np.zeros(2), 1.0)
    normal = np.array([np.sin(tilt), 0.0, -np.cos(tilt)])
    centres = camera.unproject(camera.pixel_centres(), np.zeros((camera.height, camera.width)))
    depth = centres @ normal / np.cos(tilt)
    full = np.ones_like(depth)
    view = SplatView(camera, np.zeros((*depth.shape, 3)), depth, depth, full, 1, 1)
    points = np.random.default_rng(0).uniform(-6.0, 6.0, (50, 3))
    seen = sample_points(make_depth_view(view), points)
    cosine = make_depth_view(view).cosine.reshape(-1)[seen.pixel]
    np.testing.assert_allclose(seen.ahead * cosine, points @ normal, atol=1e-4)
    assert sample_points(make_depth_view(view), np.array([[100.0, 0.0, 0.0]])).pixel.tolist() == [-1]


def test_where_the_light_stops_at_two_surfaces_the_first_counts():
    camera = fit_orthographic_camera([0.0, 0.0, 1.0], np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 9.0]]), np.zeros(2), 1.0)
    near, shape = np.float32(2.0), (camera.height, camera.width)
    plain = {"rgb": np.zeros((*shape, 3)), "opacity": np.ones(shape), "drawn": 1, "pairs": 1, "camera": camera}
    two = SplatView(depth=np.full(shape, near + 4.0), median=np.full(shape, near), **plain)
    one = SplatView(depth=np.full(shape, near + 0.5), median=np.full(shape, near), **plain)
    assert (make_depth_view(two).depth == near).all()
    assert (make_depth_view(one).depth == near + 0.5).all()
    none = replace(one, opacity=np.full(shape, 0.4))
    assert np.isinf(make_depth_view(none).depth).all()


@pytest.mark.skipif(not SPLATS.is_dir(), reason="needs the published splat files in ../shared/data/splats")
def test_a_real_guitar_is_touchable():
    guitar = read_splats(SPLATS / "guitar.compressed.ply")
    found = reconstruct_surface(guitar, cells=40, views=6)
    assert found.quality.touchable, found.quality
    assert found.quality.near > 0.9
    assert found.quality.median < 0.8 * found.spacing
