"""Camera records: projection and its inverse, frames, and pixel rays."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hnf_core.scene.camera import CAMERA_DISTANCE_M, Camera, Patch, orthographic

finite = st.floats(-10.0, 10.0)


def rotation(axis, angle):
    """Rodrigues' formula."""
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


@st.composite
def cameras(draw):
    axis = np.array([draw(finite), draw(finite), draw(st.floats(0.1, 10.0))])
    pose = np.eye(4)
    pose[:3, :3] = rotation(axis, draw(st.floats(-np.pi, np.pi)))
    pose[:3, 3] = [draw(finite), draw(finite), draw(finite)]
    width, height = draw(st.integers(1, 2000)), draw(st.integers(1, 2000))
    focal = draw(st.floats(10.0, 1e4))
    aspect = draw(st.floats(0.5, 2.0))
    shift_x, shift_y = draw(st.floats(-1.0, 2.0)) * width, draw(st.floats(-1.0, 2.0)) * height
    intrinsics = np.array([[focal, 0.0, shift_x], [0.0, focal * aspect, shift_y], [0.0, 0.0, 1.0]])
    return Camera(draw(st.sampled_from(["perspective", "orthographic"])), width, height, intrinsics, pose)


@given(cameras(), st.lists(st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(0.01, 100.0)), min_size=1))
def test_unprojecting_a_projection_gives_the_point_back(camera, points):
    local = np.array(points)
    local[:, :2] *= local[:, 2:]  # in front of the camera and near its axis
    world = local @ camera.pose[:3, :3].T + camera.pose[:3, 3]
    uv, z = camera.project(world)
    np.testing.assert_allclose(camera.unproject(uv, z), world, rtol=0.0, atol=1e-11 * (1.0 + np.abs(local).max()))


@given(cameras(), st.floats(0.1, 10.0))
def test_projecting_an_unprojection_gives_the_pixel_back(camera, depth):
    uv = np.array([[0.5, 0.5], [camera.width - 0.5, 0.5], [camera.width / 2, camera.height - 0.5]])
    back, z = camera.project(camera.unproject(uv, np.full(3, depth)))
    np.testing.assert_allclose(back, uv, atol=1e-7)
    np.testing.assert_allclose(z, depth, rtol=1e-12)


@given(cameras(), st.floats(0.1, 10.0))
def test_a_pixel_ray_at_parameter_t_lies_at_planar_depth_t(camera, depth):
    small = Camera(camera.kind, 7, 5, camera.intrinsics, camera.pose)
    origins, directions = small.pixel_rays()
    uv, z = small.project(origins + depth * directions)
    np.testing.assert_allclose(z, depth, rtol=1e-11)
    np.testing.assert_allclose(uv, small.pixel_centres(), atol=1e-7)


@given(cameras(), st.data())
def test_a_rectangle_of_a_camera_has_the_rays_of_its_pixels(camera, data):
    small = Camera(camera.kind, 7, 5, camera.intrinsics, camera.pose)
    left, top = data.draw(st.integers(0, 6)), data.draw(st.integers(0, 4))
    width, height = data.draw(st.integers(1, 7 - left)), data.draw(st.integers(1, 5 - top))
    there = (slice(top, top + height), slice(left, left + width))
    for own, whole in zip(small.crop(left, top, width, height).pixel_rays(), small.pixel_rays(), strict=True):
        np.testing.assert_allclose(own, whole[there], rtol=0.0, atol=1e-11 * (1.0 + np.abs(whole).max()))


@pytest.mark.parametrize("rectangle", [(-1, 0, 2, 2), (0, 0, 0, 2), (6, 0, 2, 2), (0, 4, 2, 2)])
def test_a_rectangle_outside_the_picture_is_refused(rectangle):
    camera = Camera("perspective", 7, 5, np.eye(3), np.eye(4))
    with pytest.raises(ValueError, match="no part of 7 x 5"):
        camera.crop(*rectangle)


def test_a_close_up_shows_the_patch_in_its_own_frame():
    normal = np.array([0.0, 0.6, 0.8])
    patch = Patch(np.array([1.0, 2.0, 3.0]), np.array([1.0, 0.0, 0.0]), normal, slot=0, size_m=0.02)
    camera = patch.camera(100)
    points = patch.centre + np.array([[0.0], [0.005], [0.0], [0.0]]) * patch.x_axis
    points = points + np.array([[0.0], [0.0], [0.005], [0.0]]) * patch.y_axis
    points = points + np.array([[0.0], [0.0], [0.0], [0.001]]) * patch.normal
    uv, z = camera.project(points)
    np.testing.assert_allclose(uv, [[50, 50], [75, 50], [50, 25], [50, 50]], atol=1e-9)  # +y is up: rows fall
    np.testing.assert_allclose(z, CAMERA_DISTANCE_M - np.array([0.0, 0.0, 0.0, 0.001]), atol=1e-12)
    assert np.linalg.det(camera.pose[:3, :3]) == pytest.approx(1.0)


def test_an_orthographic_camera_orthogonalises_its_axes():
    camera = orthographic([0, 0, 0], [1.0, 0.3, 0.5], [0.0, 0.0, 2.0], 0.02, 64, 0.01)
    np.testing.assert_allclose(camera.pose[:3, :3].T @ camera.pose[:3, :3], np.eye(3), atol=1e-12)
    np.testing.assert_allclose(camera.pose[:3, 2], [0, 0, -1])
