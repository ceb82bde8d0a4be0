"""Relief of a mesh: spacing of faces by direction, the smooth shape, and what the faces hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hnf_core.scene.camera import CAMERA_DISTANCE_M
from hnf_core.scene.mesh import TriangleMesh, compute_smooth_normals
from hnf_core.tactile.height import low_pass
from hnf_core.tactile.mesh_relief import (
    ANGLE_COUNT,
    GRID,
    LONGEST_SPACING_M,
    FaceSpacing,
    MeshRelief,
    add_heights,
    compute_mesh_relief,
    compute_spacing,
    low_pass_by_direction,
)

SIZE_M, PIXELS = 20e-3, 128
PIXEL_M = SIZE_M / PIXELS
SIDE = (np.arange(PIXELS) + 0.5) * PIXEL_M - SIZE_M / 2.0
X, Y = np.meshgrid(SIDE, -SIDE)
EVERYWHERE = np.ones((PIXELS, PIXELS), dtype=bool)


def fine(wavelength: float = 1e-3) -> FaceSpacing:
    return FaceSpacing(np.ones((GRID, GRID), dtype=bool), np.full(ANGLE_COUNT, wavelength))


def test_spacing_of_strips_depends_on_the_direction():
    """A quad of 0.1 × 20 mm is two triangles, whose edges a line along x crosses every 0.05 mm, along y every 10 mm."""
    a, b = 0.1e-3, 20e-3
    quad = np.array([[[0.0, 0.0], [a, 0.0], [a, b]], [[0.0, 0.0], [a, b], [0.0, b]]])
    spacing = compute_spacing(quad)
    assert spacing[:, 0] == pytest.approx(a / 2.0)
    assert spacing[:, ANGLE_COUNT // 2] == pytest.approx(b / 2.0)
    assert spacing[:, ANGLE_COUNT // 4] == pytest.approx(a / np.sqrt(2.0), rel=0.01)


def test_a_triangle_without_area_holds_no_wave_of_its_own():
    point = compute_spacing(np.zeros((1, 3, 2)))
    large = compute_spacing(np.array([[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]]))
    assert np.isfinite(point).all()
    assert large == pytest.approx(LONGEST_SPACING_M)


def test_an_even_low_pass_is_the_usual_one():
    height = np.random.default_rng(0).normal(size=(PIXELS, PIXELS))
    everywhere = np.full(ANGLE_COUNT, 1e-3)
    np.testing.assert_allclose(
        low_pass_by_direction(height, PIXEL_M, everywhere), low_pass(height, PIXEL_M, 1e-3), atol=1e-12
    )


@pytest.mark.parametrize("angle", [0.0, 0.3, 0.5, 0.9])
def test_a_low_pass_removes_waves_across_long_faces_alone(angle):
    """Waves of 2 mm pass along x, and not along y, at whatever turn of the patch."""
    turn = angle * np.pi
    along = np.cos(turn) * X + np.sin(turn) * Y
    across = -np.sin(turn) * X + np.cos(turn) * Y
    direction = np.arange(ANGLE_COUNT) * np.pi / ANGLE_COUNT - turn
    cut = np.where(np.abs(np.cos(direction)) > np.sqrt(0.5), 1e-3, 8e-3)
    middle = (slice(32, -32), slice(32, -32))
    kept = low_pass_by_direction(np.sin(2.0 * np.pi * along / 2e-3), PIXEL_M, cut)[middle]
    lost = low_pass_by_direction(np.sin(2.0 * np.pi * across / 2e-3), PIXEL_M, cut)[middle]
    assert np.std(kept) == pytest.approx(np.sqrt(0.5), rel=0.02)
    assert np.std(lost) < 0.05


def measure(height: np.ndarray, spacing: FaceSpacing) -> MeshRelief | None:
    return compute_mesh_relief(CAMERA_DISTANCE_M - height, EVERYWHERE, spacing, SIZE_M)


@pytest.mark.parametrize("radius", [0.02, 0.05, np.inf])
def test_waves_stay_and_the_shape_goes(radius):
    ball = 0.0 if np.isinf(radius) else np.sqrt(radius**2 - X**2 - Y**2) - radius
    wave = 50e-6 * np.sin(2.0 * np.pi * X / 4e-3)
    relief = measure(ball + wave, fine())
    assert relief is not None
    assert relief.resolved_wavelength_m == 1e-3
    middle = np.hypot(X, Y) < 6e-3
    assert np.std((relief.height - wave)[middle]) < 2e-6


@pytest.mark.parametrize(("wavelength", "height"), [(0.6e-3, 50e-6), (3e-3, 0.2e-6), (60e-3, 0.2e-3)])
def test_facets_small_and_long_waves_are_no_relief(wavelength, height):
    assert measure(height * np.sin(2.0 * np.pi * X / wavelength), fine()) is None


def test_little_is_left_of_a_wave_that_is_longer_than_the_patch():
    relief = measure(1e-3 * np.sin(2.0 * np.pi * X / 30e-3), fine())
    assert relief is not None
    assert np.std(relief.height) < 0.03e-3
    assert np.std(relief.height[24:-24, 24:-24]) < 0.01e-3


def test_coarse_faces_beside_fine_ones_are_flat():
    region = np.zeros((GRID, GRID), dtype=bool)
    region[:, GRID // 2 :] = True
    relief = measure(50e-6 * np.sin(2.0 * np.pi * X / 2e-3), FaceSpacing(region, np.full(ANGLE_COUNT, 1e-3)))
    assert relief is not None
    assert np.std(relief.height[:, : PIXELS // 2 - 1]) == 0.0
    assert np.std(relief.height[:, PIXELS // 2 + 16 : -8]) == pytest.approx(50e-6 / np.sqrt(2.0), rel=0.1)


def test_each_source_counts_in_the_waves_that_it_holds():
    mesh = MeshRelief(50e-6 * np.sin(2.0 * np.pi * X / 2e-3), 1e-3)
    shader = (10e-6 * np.sin(2.0 * np.pi * X / 0.5e-3)).astype(np.float32)
    bands = np.array([4e-3, 2e-3, 1e-3, 0.5e-3, 0.25e-3])
    both = add_heights(shader, 0.4e-3, mesh, EVERYWHERE, PIXEL_M, bands)
    assert both.resolved_wavelength_m == 0.4e-3
    assert both.mesh_bands == (False, True, False, False, False)
    assert both.empty_bands == (False, False, False, False, True)
    np.testing.assert_allclose(both.height, mesh.height + shader, atol=1e-9)
    alone = add_heights(None, np.inf, mesh, EVERYWHERE, PIXEL_M, bands)
    assert alone.resolved_wavelength_m == 1e-3
    assert alone.empty_bands == (True, False, True, True, True)


def make_strip(height, length: float = 0.06, width: float = 0.02, step: float = 0.1e-3) -> TriangleMesh:
    """A strip along x whose height is a function of x, flat-shaded."""
    xs = np.arange(-length / 2.0, length / 2.0 + step / 2.0, step)
    count = len(xs)
    sides = [np.stack([xs, np.full(count, side), height(xs)], axis=1) for side in (-width / 2.0, width / 2.0)]
    vertices = np.concatenate(sides)
    low = np.arange(count - 1)
    triangles = np.concatenate([
        np.stack([low, low + 1, low + 1 + count], axis=1), np.stack([low, low + 1 + count, low + count], axis=1)
    ]).astype(np.int32)  # fmt: skip
    corners = vertices[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = np.repeat((normal / np.linalg.norm(normal, axis=1)[:, None])[:, None], 3, axis=1)
    return TriangleMesh(
        vertices, triangles, np.arange(len(triangles), dtype=np.int32), np.zeros(len(triangles), np.int32), normal
    )


@pytest.mark.parametrize(("pitch", "width"), [(0.5e-3, 0.02), (2e-3, 0.02), (2e-3, 0.3), (5e-3, 0.02)])
def test_ridges_cancel_in_the_normals_of_the_smooth_shape(pitch, width):
    mesh = make_strip(lambda x: pitch / 8.0 * np.sin(2.0 * np.pi * x / pitch), width=width, step=pitch / 16.0)
    count = len(mesh.triangles) // 2
    triangle = np.arange(count // 4, 3 * count // 4, 3, dtype=np.int32)
    point = mesh.corner_positions()[triangle].mean(axis=1)
    point[:, 1] = 0.0
    smooth = compute_smooth_normals(mesh, point, mesh.normals[triangle, 0], triangle)
    assert smooth is not None
    assert np.degrees(np.arccos(smooth[:, 2].min())) < 2.0


@pytest.mark.parametrize("corners", [(200, 200, 200), (200, 200, 201), (200, 201, 200)])
def test_a_face_of_one_point_or_line_changes_no_smooth_normal(corners):
    mesh = make_strip(lambda x: 0.25e-3 * np.sin(2.0 * np.pi * x / 2e-3), step=0.125e-3)
    triangle = np.arange(100, 300, 3, dtype=np.int32)
    point = mesh.corner_positions()[triangle].mean(axis=1)
    expected = compute_smooth_normals(mesh, point, mesh.normals[triangle, 0], triangle)
    with_flat = replace(
        mesh,
        triangles=np.concatenate([mesh.triangles, [corners]]).astype(np.int32),
        face=np.append(mesh.face, mesh.face.max() + 1).astype(np.int32),
        slot=np.append(mesh.slot, 0).astype(np.int32),
        normals=np.concatenate([mesh.normals, mesh.normals[:1]]),
    )
    with np.errstate(all="raise"):
        found = compute_smooth_normals(with_flat, point, mesh.normals[triangle, 0], triangle)
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_smooth_and_coarse_surfaces_keep_their_normals():
    bowl = make_strip(lambda x: 2.0 * x**2)
    triangle = np.arange(100, 500, dtype=np.int32)
    point = bowl.corner_positions()[triangle].mean(axis=1)
    assert compute_smooth_normals(bowl, point, bowl.normals[triangle, 0], triangle) is None
    coarse = make_strip(lambda x: 1e-3 * np.sin(2.0 * np.pi * x / 40e-3), step=10e-3)
    few = np.arange(6, dtype=np.int32)
    centre = coarse.corner_positions()[few].mean(axis=1)
    assert compute_smooth_normals(coarse, centre, coarse.normals[few, 0], few) is None
