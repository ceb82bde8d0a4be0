"""Height maps: filling, levelling, low-pass filtering, integration of normals, and sampling under a stroke."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from unresolved_maps import unresolved_tactile_map

from hnf_core.errors import MaterialError, SceneError, UsageError
from hnf_core.tactile.height import (
    ROLL_OFF,
    fill_masked,
    has_flipped_green,
    height_from_slopes,
    integrate_gradients,
    low_pass,
    remove_plane,
    sample_height,
    tactile_map_from_height,
)
from hnf_core.tactile.optics import SENSORS
from hnf_core.tactile.tactile_map import Route

SIZE, PITCH = 128, 50e-6
AXIS = (np.arange(SIZE) + 0.5 - SIZE / 2) * PITCH
X, Y = np.meshgrid(AXIS, -AXIS)
EVERYWHERE = np.ones((SIZE, SIZE), dtype=bool)
angles = st.floats(0, 2 * np.pi)


def wave(pitch: float, angle: float, phase: float = 0.0) -> np.ndarray:
    return np.sin(2 * np.pi / pitch * (X * np.cos(angle) + Y * np.sin(angle)) + phase)


@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(-1e-3, 1e-3), st.integers(0, 99))
@settings(max_examples=20, deadline=None)
def test_no_plane_is_left_whatever_is_masked(a, b, c, seed):
    mask = np.random.default_rng(seed).random((SIZE, SIZE)) < 0.3
    mask[:, : SIZE // 2] = False
    np.testing.assert_allclose(remove_plane(a * X + b * Y + c, mask), 0.0, atol=1e-12)
    np.testing.assert_allclose(remove_plane(a * X + b * Y + c), 0.0, atol=1e-12)


@given(angles, angles, st.floats(1.05, 4.0))
@settings(max_examples=20, deadline=None)
def test_resolved_waves_stay_and_the_texel_rate_goes(angle, phase, ratio):
    resolved = 0.5e-3
    # A finite piece is not a pure wave near its edges.
    inner = slice(40, -40)
    kept = wave(ratio * resolved, angle, phase)
    error = low_pass(kept, PITCH, resolved) - kept
    assert np.sqrt(np.mean(error[inner, inner] ** 2)) < 0.03
    texels = low_pass(wave(resolved / 2, angle, phase), PITCH, resolved)
    assert np.sqrt(np.mean(texels[inner, inner] ** 2)) < 0.01


def test_the_low_pass_limits():
    rng = np.random.default_rng(1)
    height = rng.standard_normal((SIZE, SIZE))
    assert np.array_equal(low_pass(height, PITCH, 2 * PITCH), height)
    np.testing.assert_allclose(low_pass(height + 3e3 * X, PITCH, np.inf), 3e3 * X + height.mean(), atol=0.3)
    once = low_pass(height, PITCH, 1e-3)
    spectrum = np.abs(np.fft.rfft2(once * np.outer(np.hanning(SIZE), np.hanning(SIZE)))) ** 2
    f = np.hypot(np.fft.fftfreq(SIZE, PITCH)[:, None], np.fft.rfftfreq(SIZE, PITCH)[None, :])
    assert spectrum[f > 1.1 / (ROLL_OFF * 1e-3)].sum() < 1e-3 * spectrum.sum()


@given(st.integers(0, 2**32 - 1), st.floats(0.02, 0.9))
@settings(max_examples=20, deadline=None)
def test_filling_changes_only_masked_pixels_within_the_extremes(seed, share):
    rng = np.random.default_rng(seed)
    mask = rng.random((37, 50)) < share
    mask[5, 7] = True
    values = rng.standard_normal((37, 50))
    filled = fill_masked(np.where(mask, values, np.nan), mask)
    assert np.array_equal(filled[mask], values[mask])
    assert filled.min() >= values[mask].min() - 1e-12
    assert filled.max() <= values[mask].max() + 1e-12


def test_filling_continues_constants_and_smooth_surfaces():
    mask = np.ones((SIZE, SIZE), dtype=bool)
    mask[40:60, 50:80] = False
    np.testing.assert_allclose(fill_masked(np.full((SIZE, SIZE), 2.5), mask), 2.5, atol=1e-12)
    smooth = wave(8e-3, 0.7)
    assert np.abs(fill_masked(smooth, mask) - smooth).max() < 0.3


def without_long_waves(height: np.ndarray) -> np.ndarray:
    """Less its mean and the three cosine modes that are longer than the patch."""
    first = np.cos(np.pi * (np.arange(SIZE) + 0.5) / SIZE)
    for mode in (
        np.ones((SIZE, SIZE)),
        np.outer(np.ones(SIZE), first),
        np.outer(first, np.ones(SIZE)),
        np.outer(first, first),
    ):
        height = height - mode * (mode * height).sum() / (mode**2).sum()
    return height


@given(st.floats(0.4e-3, 2e-3), angles, angles)
@settings(max_examples=20, deadline=None)
def test_slopes_integrate_to_the_height_they_came_from(pitch, angle, phase):
    amplitude, k = 0.02 * pitch, 2 * np.pi / pitch
    slope = amplitude * k * np.cos(k * (X * np.cos(angle) + Y * np.sin(angle)) + phase)
    height = height_from_slopes(slope * np.cos(angle), slope * np.sin(angle), EVERYWHERE, PITCH)
    texture = amplitude * wave(pitch, angle, phase)
    expected = without_long_waves(texture - slope.mean() * (X * np.cos(angle) + Y * np.sin(angle)))
    assert expected.std() > 0.5 * texture.std()
    assert (height - expected).std() < 0.04 * texture.std()  # the mirrored edges' kinks


@given(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
@settings(max_examples=10, deadline=None)
def test_a_tilted_patch_has_no_texture(a, b):
    slopes = (np.full((SIZE, SIZE), slope) for slope in (a, b))
    np.testing.assert_allclose(height_from_slopes(*slopes, EVERYWHERE, PITCH), 0.0, atol=1e-12)


def test_integration_keeps_nothing_longer_than_the_patch():
    height = integrate_gradients(np.full((SIZE, SIZE), 0.3), np.zeros((SIZE, SIZE)), PITCH)
    ramp = 0.3 * X
    assert height.std() < 0.35 * ramp.std()


def test_slopes_that_are_not_seen_are_filled():
    seen = EVERYWHERE.copy()
    seen[0, 0] = seen[1, 1] = False
    gx, gy = np.where(seen, 0.1, np.nan), np.where(seen, -0.2, 7.0)
    np.testing.assert_allclose(height_from_slopes(gx, gy, seen, PITCH), 0.0, atol=1e-12)
    with pytest.raises(SceneError, match="normal"):
        height_from_slopes(gx, gy, ~EVERYWHERE, PITCH)


def test_a_map_is_level_and_resolves_no_finer_than_two_pixels():
    height = 1e-5 * wave(1e-3, 0.3) + 0.2 * X + 1e-3
    tactile = tactile_map_from_height(height, None, PITCH, 1e-9, "digit", Route.PREDICTED, "a test")
    assert tactile.resolved_wavelength_m == 2 * PITCH
    assert (tactile.sensor, tactile.route, tactile.height_source) == ("digit", Route.PREDICTED, "a test")
    assert tactile.height.dtype == tactile.image.dtype == np.float32
    np.testing.assert_allclose(tactile.height, 1e-5 * wave(1e-3, 0.3), atol=2e-6)
    assert tactile.mask.all()


def test_unseen_pixels_change_nothing_where_the_surface_is_seen():
    height = 1e-5 * wave(1e-3, 0.3)
    mask = np.ones((SIZE, SIZE), dtype=bool)
    mask[:, 100:] = False
    spoiled = height.copy()
    spoiled[:, 100:], spoiled[3, 3] = 7.0, np.nan
    tactile = tactile_map_from_height(spoiled, mask, PITCH, 0.2e-3)
    assert np.isfinite(tactile.image).all()
    assert not tactile.mask[3, 3]
    assert not tactile.mask[:, 100:].any()
    np.testing.assert_allclose(tactile.height[20:-20, 20:80], height[20:-20, 20:80], atol=1.5e-6)


def test_nothing_resolved_is_flat_and_nothing_seen_is_an_error():
    blank = unresolved_tactile_map((16, 16), PITCH)
    assert blank.height is None
    assert blank.route is Route.PRIOR
    np.testing.assert_allclose(blank.image[0, 0], SENSORS["gelsight"].background, atol=1e-6)
    flat = tactile_map_from_height(1e-5 * wave(1e-3, 0.0), None, PITCH, np.inf)
    np.testing.assert_allclose(flat.image, np.broadcast_to(blank.image[0, 0], flat.image.shape), atol=1e-6)
    with pytest.raises(SceneError, match="visible"):
        tactile_map_from_height(np.zeros((16, 16)), np.zeros((16, 16), bool), PITCH, 1e-3)
    with pytest.raises(UsageError):
        tactile_map_from_height(np.zeros((16, 16)), np.ones((8, 8), bool), PITCH, 1e-3)
    with pytest.raises(UsageError):
        tactile_map_from_height(np.zeros((16, 16)), None, 0.0, 1e-3)


@given(angles, st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_sampling_meets_pixel_centres_and_is_smooth_between(angle, seed):
    pitch = 1e-3
    tactile = tactile_map_from_height(1e-5 * wave(pitch, angle), None, PITCH, 2 * PITCH)
    rng = np.random.default_rng(seed)
    row, column = rng.integers(0, SIZE, 20), rng.integers(0, SIZE, 20)
    centres = np.stack([X[row, column], Y[row, column]], axis=1)
    np.testing.assert_allclose(sample_height(tactile, centres), tactile.height[row, column], atol=1e-11)
    points = rng.uniform(-0.9, 0.9, (50, 2)) * SIZE / 2 * PITCH
    plane = tactile.height - 1e-5 * wave(pitch, angle)
    expected = 1e-5 * np.sin(2 * np.pi / pitch * (points @ [np.cos(angle), np.sin(angle)]))
    np.testing.assert_allclose(sample_height(tactile, points), expected, atol=2e-8 + np.abs(plane).max())


def test_outside_the_map_the_edge_is_held_or_the_map_mirrored():
    tactile = tactile_map_from_height(1e-5 * wave(1e-3, 0.4), None, PITCH, 2 * PITCH)
    side = SIZE * PITCH
    inside = np.array([[side / 2 - 0.2e-3, 0.1e-3]])
    mirrored = np.array([[side / 2 + 0.2e-3, 0.1e-3]])
    assert sample_height(tactile, mirrored, "mirror") == pytest.approx(sample_height(tactile, inside, "mirror"))
    np.testing.assert_allclose(
        sample_height(tactile, np.add(mirrored, [side, 0.0]), "mirror"),
        sample_height(tactile, np.add(inside, [-side + 0.4e-3, 0.0]), "mirror"),
    )
    edge = np.array([[side / 2 - PITCH / 2, 0.1e-3], [1.0, 0.1e-3]])
    held = sample_height(tactile, edge)
    assert held[0] == pytest.approx(held[1])
    with pytest.raises(MaterialError):
        sample_height(unresolved_tactile_map((16, 16), PITCH), edge)


def test_curl_tells_which_way_green_points():
    height = np.random.default_rng(0).standard_normal((64, 64))
    for _ in range(3):
        height = (height + np.roll(height, 1, 0) + np.roll(height, 1, 1) + np.roll(height, -1, 0)) / 4
    gx, gy = np.gradient(height, axis=1), -np.gradient(height, axis=0)
    everywhere = np.ones((64, 64), dtype=bool)
    assert not has_flipped_green(gx, gy, everywhere)
    assert has_flipped_green(gx, -gy, everywhere)
