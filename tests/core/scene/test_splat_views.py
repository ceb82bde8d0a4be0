"""What a camera sees of splats: the fast way against the reference, and both against what must hold."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from splat_clouds import assert_as_defined, assert_same_view, both, close_up, cloud, perspective, splats

from hnf_core.errors import UsageError
from hnf_core.progress import count_work
from hnf_core.scene.camera import Camera, orthographic
from hnf_core.scene.splats import rasterize
from hnf_core.scene.splats.rasterize import render_splats
from hnf_core.scene.splats.splat_file import read_splats
from reference.splat_rendering import render_reference

GUITAR = Path(__file__).resolve().parents[4] / "shared" / "data" / "splats" / "guitar.compressed.ply"
SEEDS = st.integers(0, 2**32 - 1)
CAMERAS = [perspective(), perspective(start=0.0, distance=0.3, focal=20.0), close_up()]
WAYS = [render_reference, render_splats]


def turned(seed: int):
    """A rotation: (3, 3) and the same as a quaternion."""
    w, x, y, z = quaternion = (lambda q: q / np.linalg.norm(q))(np.random.default_rng(seed).normal(size=4))
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + 2.0 * w * cross + 2.0 * cross @ cross, quaternion


def product(p, q):
    """Of a quaternion and quaternions (N, 4)."""
    vector = p[0] * q[:, 1:] + q[:, :1] * p[1:] + np.cross(p[1:], q[:, 1:])
    return np.concatenate([p[0] * q[:, :1] - q[:, 1:] @ p[1:, None], vector], axis=1)


def arrays(view):
    return (view.rgb, view.depth, view.median, view.opacity)


@settings(max_examples=25)
@given(SEEDS, st.integers(0, 60), st.integers(0, 3), st.sampled_from(CAMERAS), st.floats(-3.0, 1.0))
def test_the_fast_way_shows_what_the_reference_defines(seed, count, degree, camera, size):
    assert_as_defined(cloud(seed, count, degree=degree, size=10.0**size), camera)


FLAT = (0.3, 0.2, 1e-7)
GREYS = [0.2, 0.4, 0.6, 0.8]
TURNS = [(1.0, 0.0, 0.0, 0.0), (0.7071, 0.7071, 0.0, 0.0), (0.7071, 0.0, 0.7071, 0.0), (0.9, 0.3, 0.1, 0.3)]
DEGENERATE = {
    "needles": splats(np.zeros((4, 3)), [(2.0, 1e-7, 1e-7), (1e-7, 1e-7, 3.0), (30.0, 1e-6, 1e-6), (1e3, 1e-8, 1.0)],
                      0.9, GREYS, TURNS[::-1]),
    "discs": splats([(0.0, 0.0, 0.1 * k) for k in range(4)], FLAT, 0.7, GREYS, TURNS),
    "one before everything": both(splats([(0.0, 0.0, -1.0)], 500.0, 0.6, 0.9), cloud(1, 30)),
    "behind and around": both(splats([(0.0, 0.0, -3.0), (0.0, 0.0, -9.0), (0.1, 0.0, -2.9), (2.0, 0.0, -2.8)], 0.5),
                              cloud(2, 20)),
    "clear and opaque": splats([(0.0, 0.0, 0.0), (0.1, 0.0, 0.2), (0.0, 0.1, 0.4)], 0.3, [0.0, 1.0, 1.0 / 255.0]),
    "equal depths": splats(np.random.default_rng(3).uniform(-0.3, 0.3, (20, 3)) * [1.0, 1.0, 0.0], 0.2, 0.5,
                           np.linspace(0.0, 1.0, 20)),
    "the same place": splats(np.zeros((300, 3)), 0.2, 0.02),
    "dust": splats(np.random.default_rng(4).uniform(-1.0, 1.0, (200, 3)), 1e-8, 0.9),
    "no splats": splats(np.zeros((0, 3))),
}  # fmt: skip


@pytest.mark.parametrize("camera", [perspective(), close_up()], ids=["perspective", "orthographic"])
@pytest.mark.parametrize("name", DEGENERATE)
def test_also_of_degenerate_splats(name, camera):
    for low_pass in (0.3, 0.0):
        fast, _ = assert_as_defined(DEGENERATE[name], camera, low_pass=low_pass)
        assert all(np.isfinite(each).all() for each in (fast.rgb, fast.opacity))


@pytest.mark.skipif(not GUITAR.is_file(), reason="needs the published splat files in ../shared/data/splats")
def test_also_of_a_real_guitar():
    guitar = read_splats(GUITAR)
    whole = perspective(256, 256, distance=6.0, focal=274.0)
    whole.pose[:3, 3] += [0.0, -2.0, 0.0]
    part = whole.crop(124, 150, 12, 10)
    fast, exact = assert_as_defined(guitar, part)
    assert fast.pairs > 2_000
    assert_same_view(fast, exact, within=3e-5)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("camera", [perspective(), close_up()], ids=["perspective", "orthographic"])
def test_one_ball_is_a_gaussian(way, camera):
    """In front of the camera's axis, where the projection is a plain scaling by f / z."""
    centre = camera.pose[:3, 3] + 2.5 * camera.pose[:3, 2]
    scale = camera.intrinsics[[0, 1], [0, 1]] / (2.5 if camera.kind == "perspective" else 1.0)
    view = way(splats([centre], 0.2, 0.8, [(0.9, 0.5, 0.1)]), camera)
    x, y = np.moveaxis((camera.pixel_centres() - camera.intrinsics[:2, 2]) ** 2 / (0.04 * scale**2 + 0.3), -1, 0)
    alpha = 0.8 * np.exp(-0.5 * (x + y))
    alpha = np.where(alpha < 1.0 / 255.0, 0.0, alpha)
    np.testing.assert_allclose(view.opacity, alpha, atol=1e-6)
    np.testing.assert_allclose(view.rgb, alpha[..., None] * [0.9, 0.5, 0.1], atol=1e-6)
    np.testing.assert_allclose(view.depth, np.where(alpha > 0.0, 2.5, np.inf), rtol=1e-6)
    np.testing.assert_allclose(view.median, np.where(alpha >= 0.5, 2.5, np.inf), rtol=1e-6)


@settings(max_examples=10)
@given(SEEDS)
def test_moving_splats_and_camera_together_changes_nothing(seed):
    """But for pixels where rounding brings a splat to the other side of the cutoff, by one splat of 1 / 255."""
    one, camera, (rotation, quaternion) = cloud(seed, 40), perspective(), turned(seed)
    shift = np.array([3.0, -2.0, 1.0])
    moved = replace(
        one,
        means=(one.means @ rotation.T + shift).astype(np.float32),
        rotations=product(quaternion, one.rotations.astype(np.float64)).astype(np.float32),
    )
    pose = camera.pose.copy()
    pose[:3, :3], pose[:3, 3] = rotation @ pose[:3, :3], rotation @ pose[:3, 3] + shift
    before, after = render_splats(one, camera), render_splats(moved, replace(camera, pose=pose))
    apart = np.abs(before.opacity - after.opacity)
    assert apart.max() < 0.01
    assert (apart < 1e-5).mean() > 0.99
    seen = np.isfinite(before.depth) & np.isfinite(after.depth)
    assert np.median(np.abs(before.depth[seen] - after.depth[seen])) < 1e-5


@settings(max_examples=15)
@given(SEEDS, st.sampled_from([perspective(150, 140, focal=130.0), close_up(140)]), st.data())
def test_a_crop_is_that_part_of_the_picture(seed, camera, data):
    """Of splats all around the camera, too, which reach into the picture from beyond its field of view."""
    one = both(cloud(seed, 60, degree=1), cloud(seed, 20, degree=1, size=0.3))
    one.means[-20:] += (camera.pose[:3, 3] + [0.0, 0.0, 0.5]).astype(np.float32)
    left, top = data.draw(st.integers(0, camera.width - 1)), data.draw(st.integers(0, camera.height - 1))
    wide, high = (data.draw(st.integers(1, end)) for end in (camera.width - left, camera.height - top))
    whole, part = render_splats(one, camera), render_splats(one, camera.crop(left, top, wide, high))
    for all_of_it, seen in zip(arrays(whole), arrays(part), strict=True):
        np.testing.assert_allclose(seen, all_of_it[top : top + high, left : left + wide], rtol=1e-6, atol=1e-6)
    assert (part.drawn <= whole.drawn, part.pairs <= whole.pairs) == (True, True)


def test_a_crop_of_a_crop_knows_the_whole_picture():
    camera = perspective(40, 30)
    assert camera.crop(5, 6, 20, 20).crop(1, 2, 3, 4).frame == (-6.0, -8.0, 34.0, 22.0)


@settings(max_examples=10)
@given(SEEDS)
def test_their_order_in_the_file_changes_nothing(seed):
    one = cloud(seed, 50, degree=2)
    shuffled = one.take(np.random.default_rng(seed).permutation(len(one)))
    for before, after in zip(*(arrays(render_splats(each, perspective())) for each in (one, shuffled)), strict=True):
        np.testing.assert_array_equal(before, after)


def test_of_equal_depths_the_first_in_the_file_is_in_front():
    two = splats(np.zeros((2, 3)), 0.3, 0.9, [0.2, 0.8])
    for way in WAYS:
        for each in (0, 1):
            view = way(two.take(np.array([each, 1 - each])), close_up(8))
            assert (view.rgb[4, 4, 0] > 0.5 * view.opacity[4, 4]) == (each == 1)


@settings(max_examples=10)
@given(SEEDS, SEEDS)
def test_more_splats_hide_more_and_never_more_than_all(seed, other):
    fewer = cloud(seed, 30, size=0.3)
    less, more = (
        render_splats(each, perspective()).opacity for each in (fewer, both(fewer, cloud(other, 30, size=0.3)))
    )
    assert less.min() >= 0.0
    assert more.max() <= 1.0
    assert (more - less).min() > -2e-5  # what is left of the light when a pixel is done


@settings(max_examples=10)
@given(SEEDS)
def test_what_is_behind_a_wall_is_not_seen(seed):
    x, y = np.meshgrid(np.linspace(-3.0, 3.0, 13), np.linspace(-3.0, 3.0, 13))
    wall = splats(np.stack([x, y, np.full_like(x, -1.5)], axis=-1), (1.0, 1.0, 1e-3), 1.0, 0.3)
    camera = perspective()
    alone, hiding = render_splats(wall, camera), render_splats(both(wall, cloud(seed, 40)), camera)
    assert_same_view(hiding, alone, within=5e-5, span=2.0)


@pytest.mark.parametrize("camera", [perspective(), close_up()], ids=["perspective", "orthographic"])
@pytest.mark.parametrize("times", [2.0**-10, 2.0**7])
def test_another_unit_scales_depth_and_nothing_else(camera, times):
    one, pose, intrinsics = cloud(5, 50, degree=3), camera.pose.copy(), camera.intrinsics.copy()
    pose[:3, 3] *= times
    if camera.kind == "orthographic":
        intrinsics[[0, 1], [0, 1]] /= times
    ends = {"clip_start": times * camera.clip_start, "clip_end": times * camera.clip_end}
    scaled = replace(one, means=one.means * np.float32(times), scales=one.scales * np.float32(times))
    before, after = (
        render_splats(one, camera),
        render_splats(scaled, replace(camera, pose=pose, intrinsics=intrinsics, **ends)),
    )
    np.testing.assert_array_equal(after.rgb, before.rgb)
    np.testing.assert_array_equal(after.opacity, before.opacity)
    np.testing.assert_allclose(after.depth, before.depth * times, rtol=1e-6)
    np.testing.assert_allclose(after.median, before.median * times, rtol=1e-6)


def test_a_far_camera_sees_what_an_orthographic_one_sees():
    one, near, far = cloud(6, 60, degree=1), close_up(), 3e5
    intrinsics = near.intrinsics.copy()
    intrinsics[[0, 1], [0, 1]] *= far
    pose = near.pose.copy()
    pose[2, 3] = -far
    flat, deep = render_splats(one, near), render_splats(one, Camera("perspective", 32, 32, intrinsics, pose))
    apart = np.abs(flat.opacity - deep.opacity)
    assert (apart.max() < 0.01, (apart < 1e-4).mean() > 0.99) == (True, True)
    seen = np.isfinite(flat.depth) & np.isfinite(deep.depth)
    shift = deep.depth[seen].astype(np.float64) - flat.depth[seen]
    assert np.abs(np.median(shift) - (far - 3.0)) < 0.05


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("tilt", [0.0, 30.0, 60.0, 80.0])
def test_the_depth_of_a_slanted_disc_is_its_plane(way, tilt):
    camera, (cosine, sine) = close_up(48), np.cos(np.radians([tilt, 90.0 - tilt]))
    half = np.radians(tilt) / 2.0
    disc = splats(np.zeros((1, 3)), (0.4, 0.3, 1e-6), 0.9, rotations=[(np.cos(half), 0.0, np.sin(half), 0.0)])
    view = way(disc, camera)
    x = camera.unproject(camera.pixel_centres(), np.zeros((48, 48)))[..., 0]
    inside = view.opacity > 0.05
    assert inside.sum() > 100
    assert np.abs(view.depth - (3.0 - x * sine / cosine))[inside].max() < 1e-4


def test_seen_from_its_edge_a_disc_keeps_to_its_own_depth():
    disc = splats(np.zeros((1, 3)), (0.4, 0.4, 1e-6), 0.9, rotations=[(0.70710678, 0.70710690, 0.0, 0.0)])
    depth = render_reference(disc, close_up()).depth
    assert np.abs(depth[np.isfinite(depth)] - 3.0).max() <= 2.0 * 3.33 * 0.4


def test_one_thread_and_several_give_the_same_bytes():
    one, camera = cloud(7, 400, degree=1), perspective(300, 140, focal=250.0)
    views = [render_splats(one, camera, threads=threads) for threads in (1, 2, 3)]
    assert len({(*(each.tobytes() for each in arrays(view)), view.pairs) for view in views}) == 1
    assert views[0].rgb.dtype == views[0].depth.dtype == views[0].median.dtype == views[0].opacity.dtype == np.float32


def test_the_size_of_tiles_changes_nothing(monkeypatch):
    one, camera, views = cloud(10, 200, degree=1), perspective(150, 131, focal=120.0), []
    for side in (2, 4, 8):
        monkeypatch.setattr(rasterize, "TILE_SIDES", ((np.inf, side),))
        views.append(render_splats(one, camera))
    for view in views[1:]:
        assert view.pairs == views[0].pairs
        for this, first in zip(arrays(view), arrays(views[0]), strict=True):
            np.testing.assert_allclose(this, first, rtol=1e-6, atol=1e-6)


def test_work_follows_the_crop():
    """A sheet of splats: those met, their colours and the pairs all shrink with the area that is looked at."""
    places = np.random.default_rng(8).uniform(-1.0, 1.0, (4000, 3)) * [1.0, 1.0, 0.01]
    sheet, camera = splats(places, 0.01, 0.3), close_up(128)
    with count_work() as work:
        whole = render_splats(sheet, camera)
    assert work.total("splats") == whole.drawn
    for times in (2, 4, 8):
        side = 128 // times
        with count_work() as work:
            part = render_splats(sheet, camera.crop(40, 56, side, side))
        assert work.total("splats") == part.drawn
        assert part.pairs == pytest.approx(whole.pairs / times**2, rel=0.25)
        assert part.drawn < 1.2 * (whole.drawn / times**2) * (1.0 + 4.0 / side) ** 2


def test_an_opaque_front_ends_the_work():
    layers = splats([(0.0, 0.0, 0.001 * k) for k in range(60_000)], 5.0, 0.9)
    view = render_splats(layers, close_up(8))
    assert view.pairs < 64 * 10


@pytest.mark.parametrize("way", WAYS)
def test_only_what_lies_in_the_clip_range_is_seen(way):
    three = splats([(0.0, 0.0, z) for z in (1.0, 2.0, 4.0)], 0.1, 0.9)
    camera = replace(close_up(), pose=np.eye(4))
    for ends, drawn in (((0.0, 9.0), 3), ((1.5, 9.0), 2), ((1.0, 2.0), 2), ((1.5, 1.9), 0), ((-9.0, 0.5), 0)):
        assert way(three, replace(camera, clip_start=ends[0], clip_end=ends[1])).drawn == drawn
    assert way(three, replace(perspective(), pose=np.diag([1.0, -1.0, -1.0, 1.0]))).drawn == 0


@pytest.mark.parametrize("low_pass", [-0.1, np.nan, np.inf])
@pytest.mark.parametrize("way", WAYS)
def test_a_low_pass_that_is_none_is_refused(way, low_pass):
    with pytest.raises(UsageError, match="low_pass"):
        way(cloud(9, 3), close_up(), low_pass=low_pass)


def test_a_close_up_needs_no_origin():
    """Far from the origin float64 carries the camera, and depths are kept relative to the nearest splat."""
    one = splats([(0.0, 0.0, 0.0), (0.25, 0.0, 0.5)], 0.25, 0.6)
    there = replace(one, means=one.means + np.float32(4096.0))
    camera = orthographic(np.full(3, 4096.0), [1.0, 0.0, 0.0], [0.0, 0.0, -1.0], 2.0, 32, 3.0)
    for before, after in zip(arrays(render_splats(one, close_up())), arrays(render_splats(there, camera)), strict=True):
        np.testing.assert_allclose(after, before, atol=1e-6)
