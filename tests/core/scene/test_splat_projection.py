"""Projection and colour of splats against independent formulas."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import legendre
from splat_clouds import close_up, cloud, perspective, splats
from test_splat_views import turned

from hnf_core.scene.camera import Camera
from hnf_core.scene.splats.gaussians import compute_view_directions, evaluate_sh_basis, evaluate_sh_colours
from hnf_core.scene.splats.project import evaluate_quadratic_form
from reference.splat_rendering import project_splats


def covariances(one):
    """(N, 3, 3), by the text book."""
    w, x, y, z = np.moveaxis(one.rotations.astype(np.float64), -1, 0)
    cross = np.zeros((len(one), 3, 3))
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -z, y, -x
    cross -= cross.transpose(0, 2, 1)
    rotation = np.eye(3) + 2.0 * w[:, None, None] * cross + 2.0 * cross @ cross
    return rotation @ (one.scales.astype(np.float64)[:, :, None] ** 2 * rotation.transpose(0, 2, 1))


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_a_footprint_is_the_covariance_in_the_picture(seed, flat):
    """Σ' = J Σ Jᵀ + 0.3, J by finite differences of the camera's own projection; its inverse is the quadratic form, and
    the depth plane is the conditional mean of the 3-D Gaussian in the picture."""
    one, (turn, _) = cloud(seed, 30, spread=0.3), turned(seed)
    one.opacities[:] = 0.9
    camera = close_up() if flat else perspective(turn=turn, distance=5.0)
    prints = project_splats(one, camera)
    assert len(prints) > 10
    centres, step = one.means[prints.index].astype(np.float64), 1e-5
    moves = []
    for axis in np.eye(3):
        ahead, behind = (np.column_stack(camera.project(centres + sign * step * axis)) for sign in (1.0, -1.0))
        moves.append((ahead - behind) / (2.0 * step))
    jacobian = np.stack(moves, axis=-1)
    seen = jacobian @ covariances(one)[prints.index] @ jacobian.transpose(0, 2, 1)
    planar = seen[:, :2, :2]
    rise = np.linalg.solve(planar, seen[:, :2, 2:])[..., 0]
    np.testing.assert_allclose(
        np.stack([prints.depth_slope_x, prints.depth_slope_y], axis=-1), rise, rtol=1e-4, atol=1e-5
    )
    conic = np.linalg.inv(planar + 0.3 * np.eye(2))
    (u, v), z = camera.project(centres)[0].T, camera.project(centres)[1]
    np.testing.assert_allclose([prints.u, prints.v, prints.depth], [u, v, z], rtol=1e-9, atol=1e-9)
    y, x = np.full(len(prints), 7), 11
    steep, across, along = evaluate_quadratic_form(prints, np.arange(len(prints)), y)
    offset = np.stack([x + 0.5 - u, y + 0.5 - v], axis=-1)
    q = np.einsum("ni,nij,nj->n", offset, conic, offset)
    np.testing.assert_allclose(steep + prints.precision * (x + 0.5 - across) ** 2, q, rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(along, y + 0.5 - v, atol=1e-9)


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1))
def test_a_bounding_box_holds_every_pixel_of_its_ellipse_tightly(seed):
    one, camera = cloud(seed, 20, size=0.2), perspective()
    prints = project_splats(one, camera)
    y, x = np.mgrid[: camera.height, : camera.width]
    for i in range(len(prints)):
        steep, across, _ = evaluate_quadratic_form(prints, np.array(i), y)
        counts = steep + prints.precision[i] * (x + 0.5 - across) ** 2 <= prints.cutoff[i]
        box = (x >= prints.left[i]) & (x < prints.right[i]) & (y >= prints.top[i]) & (y < prints.bottom[i])
        assert not (counts & ~box).any()
        extent = np.sqrt(prints.cutoff[i] * prints.var_y[i])
        assert prints.bottom[i] - prints.top[i] <= 2.0 * extent + 1.0


def test_the_jacobian_is_clamped_to_1_3_times_the_field_of_view():
    """Beside the camera, close to its plane, a splat would be smeared over the whole picture."""
    beside = splats([(8.0, 0.0, -2.9)], 0.3, 0.9)
    assert len(project_splats(beside, perspective())) == 0
    camera = Camera("perspective", 40, 40, np.array([[20.0, 0.0, 20.0], [0.0, 20.0, 20.0], [0.0, 0.0, 1.0]]), np.eye(4))
    above = splats([(0.0, -3.0, 1.0)], 1.0, 0.9)
    expected = 20.0**2 * (1.0 + 1.3**2) + 0.3  # of a ball, at 1.3 times the tangent of half the field of view
    for each in (camera, camera.crop(10, 0, 20, 8)):
        np.testing.assert_allclose(project_splats(above, each).var_y, [expected], rtol=1e-12)


def literal(towards, degree, m):
    """Real spherical harmonic with the Condon-Shortley phase, from Rodrigues' formula."""
    x, y, z = towards.T
    order = abs(m)
    curve = np.eye(degree + 1)[degree]
    slope = legendre.legval(z, legendre.legder(curve, order) if order else curve)
    ratio = math.factorial(degree - order) / math.factorial(degree + order)
    scale = math.sqrt((2 * degree + 1) / (4.0 * math.pi) * ratio)
    turn = (x + 1j * y) ** order
    wave = 1.0 if m == 0 else math.sqrt(2.0) * (turn.real if m > 0 else turn.imag)
    return (-1.0) ** order * scale * slope * wave


def test_harmonics_are_those_of_rodrigues():
    towards = np.random.default_rng(0).normal(size=(50, 3))
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    expected = [literal(towards, n, m) for n in range(4) for m in range(-n, n + 1)]
    for degree in range(4):
        np.testing.assert_allclose(evaluate_sh_basis(towards, degree), expected[: (degree + 1) ** 2], atol=1e-12)


def test_colour_is_half_grey_plus_harmonics_clamped_at_black():
    towards = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    harmonics = np.zeros((2, 4, 3))
    harmonics[:, 0], harmonics[:, 2] = [1.0, 0.0, -9.0], [0.5, 0.5, 0.0]
    c0, c1 = 0.28209479177387814, 0.4886025119029199
    np.testing.assert_allclose(
        evaluate_sh_colours(harmonics, towards),
        [[0.5 + c0 + 0.5 * c1, 0.5 + 0.5 * c1, 0.0], [0.5 + c0 - 0.5 * c1, 0.5 - 0.5 * c1, 0.0]],
    )


def test_directions_lead_from_the_camera_to_the_splat():
    turn, _ = turned(3)
    camera = perspective(turn=turn)
    point = camera.pose[:3, 3] + 5.0 * turn[:, 0]
    np.testing.assert_allclose(
        compute_view_directions(np.array([point, camera.pose[:3, 3]]), camera), [turn[:, 0], np.zeros(3)], atol=1e-12
    )
    np.testing.assert_allclose(compute_view_directions(np.array([point]), close_up()), [[0.0, 0.0, 1.0]])
