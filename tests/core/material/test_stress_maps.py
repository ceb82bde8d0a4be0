"""Stress: heights, tactile maps and E, linear contact and F_Θ at the ends of what numbers hold."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hnf_core.action.contacts import compute_tangents
from hnf_core.errors import SceneError, StrokeError, UsageError
from hnf_core.field.field import Field, FieldConfig, evaluate, initial_parameters
from hnf_core.field.height_profile import build_stroke_profile
from hnf_core.field.linear_contact import Condition
from hnf_core.field.stroke import LIMITS
from hnf_core.material.band_descriptor import describe
from hnf_core.material.contact_model import (
    Mechanics,
    contact_radius,
    contact_stiffness,
    force_response,
    height_response,
    resonance_hz,
    tip_gain,
)
from hnf_core.material.probe import PROBE_NAMES, get_probe
from hnf_core.material.token import LEVELS, SMOOTH_LEVEL, TOKEN_DIM
from hnf_core.scene.camera import Patch
from hnf_core.tactile.height import MAX_HEIGHT_M, height_from_slopes, tactile_map_from_height
from hnf_core.tactile.optics import SENSORS

SIZE = 64
PITCH = 20e-3 / SIZE
RELIEF = 1e-5 * np.cumsum(np.random.default_rng(0).standard_normal((SIZE, SIZE)), axis=1) / 8.0


def map_of(height, mask=None, pitch=PITCH, resolved=None):
    return tactile_map_from_height(height, mask, pitch, 2.0 * pitch if resolved is None else resolved)


def is_smooth(token) -> bool:
    return bool((token.values[LEVELS] == SMOOTH_LEVEL).all()) and not np.delete(token.values, LEVELS).any()


@pytest.mark.parametrize("height", [0.0, 1e-300, 5e-324, 1e-40, 3.0, -1e4, MAX_HEIGHT_M])
def test_constant_heights(height):
    """A constant height, 0 to 1000 km, denormal → background colour, height 0, the smooth token"""
    found = map_of(np.full((SIZE, SIZE), height))
    np.testing.assert_allclose(found.image, np.broadcast_to(SENSORS["gelsight"].background, found.image.shape), 1e-6)
    assert np.abs(found.height).max() <= 4.0 * np.finfo(np.float64).eps * abs(height)
    assert is_smooth(describe(found))


@pytest.mark.parametrize("size", [5e-324, 1e-300, 1e-45, 1e-20])
def test_denormal_relief(size):
    """A relief of 1e-20 m down to denormals → the smooth token, no NaN"""
    found = map_of(RELIEF / np.abs(RELIEF).max() * size)
    assert np.isfinite(found.height).all()
    np.testing.assert_allclose(describe(found).values[LEVELS], SMOOTH_LEVEL, atol=1e-6)


@pytest.mark.parametrize("size", [1e-2, 1.0, 1e3, 0.9 * MAX_HEIGHT_M])
def test_huge_relief(size):
    """A relief of 10 mm to 900 km in a patch → slopes at the gel's limit, a finite token, the same from 1 m on"""
    found = map_of(RELIEF / np.abs(RELIEF).max() * size)
    token = describe(found)
    assert np.isfinite(found.image).all()
    assert np.isfinite(found.height).all()
    assert np.isfinite(token.values).all()
    if size >= 1.0:
        again = describe(map_of(RELIEF / np.abs(RELIEF).max() * 10.0 * MAX_HEIGHT_M / 16.0))
        np.testing.assert_allclose(token.values[LEVELS], again.values[LEVELS], atol=0.05)


@pytest.mark.parametrize("size", [1.1 * MAX_HEIGHT_M, 1e39, 1e300])
def test_heights_beyond_a_landscape(size):
    """A height over 1000 km → SceneError with it; beyond 3e38 m it became ∞ in silence"""
    with pytest.raises(SceneError, match="a height of this patch is"):
        map_of(np.where(RELIEF.max() == RELIEF, size, RELIEF))


@pytest.mark.parametrize("shift", [10.0, 1e4])
def test_relief_far_from_zero(shift):
    """A relief lifted by 10 m, by 10 km → the same token, within 1e-5"""
    np.testing.assert_allclose(describe(map_of(RELIEF + shift)).values, describe(map_of(RELIEF)).values, atol=1e-5)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_infinite_depth(value):
    """Heights NaN or ±∞ (nothing behind a pixel) → those pixels count as unseen, and nothing else changes"""
    gone = np.zeros((SIZE, SIZE), dtype=bool)
    gone[:, 40:] = True
    found, masked = map_of(np.where(gone, value, RELIEF)), map_of(RELIEF, ~gone)
    np.testing.assert_array_equal(found.mask, ~gone)
    np.testing.assert_array_equal(found.image, masked.image)
    np.testing.assert_array_equal(describe(found).values, describe(masked).values)
    with pytest.raises(SceneError, match="no pixel of this patch"):
        map_of(np.full((SIZE, SIZE), value))


def test_one_pixel_seen():
    """One pixel of a patch seen → a token of which nothing is known"""
    mask = np.zeros((SIZE, SIZE), dtype=bool)
    mask[20, 30] = True
    token = describe(map_of(RELIEF, mask))
    assert np.isfinite(token.values).all()
    assert not token.known.any()


@pytest.mark.parametrize("side", [1e-6, 20e-6, 200e-6])
def test_small_patches(side):
    """A patch of 1 µm to 0.2 mm → finite; only bands of which it holds two waves are known: none"""
    token = describe(map_of(RELIEF * side / 20e-3, pitch=side / SIZE))
    assert np.isfinite(token.values).all()
    assert not token.known[LEVELS].any()


@pytest.mark.parametrize("pitch", [0.0, -1e-3, 1e-10, 1e4, 5e-324, 1e308, np.inf, np.nan])
def test_pixels(pitch):
    """Pixels of 0, under 1 nm, over 1 km, ∞ or NaN → UsageError with their size; they gave NaN images"""
    for make in (
        lambda: map_of(RELIEF, pitch=pitch, resolved=1e-3),
        lambda: height_from_slopes(RELIEF, RELIEF, np.isfinite(RELIEF), pitch),
    ):
        with pytest.raises(UsageError, match="meters per pixel"):
            make()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_sensor_images_with_holes(value):
    """A sensor image with NaN or ∞ → where masked it does not count, where seen UsageError; the token was NaN"""
    plain = map_of(RELIEF)
    image, mask = plain.image.copy(), plain.mask.copy()
    image[10:14, 10:14] = value
    with pytest.raises(UsageError, match="16 seen pixels"):
        describe(dataclasses.replace(plain, image=image))
    mask[10:14, 10:14] = False
    token = describe(dataclasses.replace(plain, image=image, mask=mask))
    assert np.isfinite(token.values).all()
    np.testing.assert_allclose(
        token.values[LEVELS], describe(dataclasses.replace(plain, mask=mask)).values[LEVELS], atol=0.2
    )


@pytest.mark.parametrize("factor", [0.0, 1e-44, 1e30, -1.0])
def test_sensor_images_of_any_brightness(factor):
    """A sensor image that is black, denormal, 1e30 as bright or negative → a finite token"""
    plain = map_of(RELIEF)
    token = describe(dataclasses.replace(plain, image=plain.image * np.float32(factor)))
    assert np.isfinite(token.values).all()


@pytest.mark.parametrize("probe", sorted(PROBE_NAMES))
@pytest.mark.parametrize("stiffness", LIMITS["stiffness [N/m]"])
@pytest.mark.parametrize("damping", LIMITS["damping ratio"])
def test_linear_contact(stiffness, damping, probe):
    """Linear contact at the ends of its limits, forces 0, denormal to 1e7 N, 0 to 1 MHz → finite; at 0 N nothing"""
    mechanics, tip = Mechanics(stiffness, damping, 0.3), get_probe(probe)
    force = np.array([0.0, 5e-324, 1e-300, 1e-9, 1.0, 1e7])
    frequency = np.array([0.0, 5e-324, 1.0, 1e3, 1e6])[:, None]
    values = [contact_stiffness(mechanics, tip, force), contact_radius(mechanics, tip, force)]
    values += [resonance_hz(mechanics, tip, force), tip_gain(frequency, contact_radius(mechanics, tip, force))]
    for response in (height_response, force_response):
        values.append(response(frequency, mechanics, tip, force))
    assert all(np.isfinite(each).all() for each in values)
    assert values[0][0] == values[1][0] == values[2][0] == 0.0
    assert not values[4][:, 0].any()


@pytest.mark.parametrize("start", [0.0, 1e4])
def test_long_paths_over_relief(start):
    """A path of 10 km over relief → StrokeError with its length, before it is sampled; 10 mm at 10 km → its profile"""
    patch = Patch(np.zeros(3), np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]), 0)

    def profile(length):
        way = np.linspace(0.0, length, 50)
        points = np.stack([way, 0.0 * way, 0.0 * way], axis=1)
        return build_stroke_profile(start + way, points, np.zeros(50, dtype=np.int32), [patch], [map_of(RELIEF)])

    with pytest.raises(StrokeError, match=r"is 1e\+04 m long") as caught:
        profile(1e4)
    assert caught.value.remedy
    short = profile(0.01)
    assert short.origin_m == start
    assert np.isfinite(short.height).all()
    assert short.height.std() == pytest.approx(map_of(RELIEF).height[32].std(), rel=0.5)
    assert profile(1e-9) is None


@pytest.mark.parametrize("size", [1e-150, 1e-30, 1e30, 1e150])
def test_uv_of_any_scale(size):
    """UVs 1e-150 to 1e150 as large → the same tangent; of no area, NaN or ∞ an axis of the object"""
    corners, normal = np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]]), np.array([[0.0, 0.0, 1.0]])
    uv = np.array([[[0.0, 0.0], [0.6, 0.8], [-0.8, 0.6]]])
    tangent, known = compute_tangents(corners, uv * size, normal)
    assert known.all()
    np.testing.assert_allclose(tangent, [[0.6, -0.8, 0.0]], atol=1e-12)
    for broken in (0.0 * uv, uv * np.nan, np.where(uv == 0.6, np.inf, uv)):
        tangent, known = compute_tangents(corners, broken, normal)
        assert not known.any()
        np.testing.assert_array_equal(tangent, [[1.0, 0.0, 0.0]])


def test_the_field_at_the_ends_of_its_limits():
    """F_Θ at speeds 0, denormal to 1e4 m/s, forces to 1e7 N, tokens to ±100, any direction → finite amplitudes ≥ 0"""
    speed, force = (part.ravel() for part in np.meshgrid([0.0, 5e-324, 1e-9, 0.1, 1e4], [0.0, 5e-324, 1e-9, 1.0, 1e7]))
    count = len(speed)
    direction = np.stack([np.cos(np.arange(count)), np.sin(np.arange(count))], axis=1)
    direction[::7] = 0.0
    config = FieldConfig(hidden=8, layers=2)
    rng = np.random.default_rng(0)
    parameters = {
        name: (value + rng.standard_normal(value.shape)).astype(np.float32)
        for name, value in initial_parameters(config, 0).items()
    }
    wood, first = (Mechanics(8e4, 0.15, 0.3),), np.zeros(count, dtype=np.int32)
    for value in (-100.0, 0.0, 100.0):
        token = np.full((count, TOKEN_DIM), value)
        condition = Condition(token, wood, first, direction, speed, force, force > 0.0, "pen")
        emission = evaluate(Field(config, parameters), condition)
        assert np.isfinite(emission.alpha).all()
        assert np.isfinite(emission.sigma_dt).all()
        assert (emission.alpha >= 0.0).all()
