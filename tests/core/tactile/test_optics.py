"""The sensor's optics: rendered gradients decode exactly and follow the symmetries of the surface."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.errors import UsageError
from hnf_core.tactile.optics import SENSORS, decode_gradients, get_sensor, render_sensor_image, shade

SIZE, PITCH = 96, 50e-6
AXIS = (np.arange(SIZE) + 0.5 - SIZE / 2) * PITCH
X, Y = np.meshgrid(AXIS, -AXIS)
INNER = slice(24, -24)
sensors = st.sampled_from(list(SENSORS.values()))
seeds = st.integers(0, 2**32 - 1)


def rough(seed: int, rms: float = 5e-6) -> np.ndarray:
    """Smooth random height, wavelengths from 0.2 mm up."""
    rng = np.random.default_rng(seed)
    f = np.hypot(np.fft.fftfreq(SIZE, PITCH)[:, None], np.fft.rfftfreq(SIZE, PITCH)[None, :])
    height = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((SIZE, SIZE))) * np.exp(-((f / 3e3) ** 2)))
    return rms * height / height.std()


@pytest.mark.parametrize("sensor", SENSORS.values(), ids=str)
def test_every_lamp_reaches_the_steepest_slope(sensor):
    assert sensor.max_slope < np.tan(np.radians(sensor.elevation_deg))
    assert np.linalg.cond(sensor.shading) < 10


@given(sensors, st.floats(-1e-3, 1e-3))
@settings(max_examples=10, deadline=None)
def test_a_flat_surface_shows_the_background_at_any_height(sensor, level):
    image = render_sensor_image(np.full((16, 20), level), PITCH, sensor)
    assert image.dtype == np.float32
    assert image.shape == (16, 20, 3)
    np.testing.assert_allclose(image, np.broadcast_to(sensor.background, image.shape), atol=1e-6)


@given(sensors, st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
@settings(max_examples=25, deadline=None)
def test_a_tilted_plane_reads_back_as_its_slope(sensor, a, b):
    gx, gy = decode_gradients(render_sensor_image(a * X + b * Y, PITCH, sensor), sensor)
    np.testing.assert_allclose(gx, a, atol=2e-5)
    np.testing.assert_allclose(gy, b, atol=2e-5)


@given(sensors, st.floats(0.25e-3, 1.2e-3), st.floats(0, np.pi), st.floats(0, 2 * np.pi))
@settings(max_examples=25, deadline=None)
def test_a_wave_reads_back_as_the_slopes_of_the_gel_over_it(sensor, pitch, angle, phase):
    amplitude = 0.03 * pitch
    k = 2 * np.pi / pitch
    wave = k * (X * np.cos(angle) + Y * np.sin(angle)) + phase
    gx, gy = decode_gradients(render_sensor_image(amplitude * np.sin(wave), PITCH, sensor), sensor)
    through_gel = np.exp(-2 * (np.pi * sensor.gel_sigma_m / pitch) ** 2)
    slope = amplitude * k * through_gel * np.cos(wave)
    # Derivative of a finite piece: the edges of the patch are not known as well as its middle.
    np.testing.assert_allclose(gx[INNER, INNER], (slope * np.cos(angle))[INNER, INNER], atol=1e-3)
    np.testing.assert_allclose(gy[INNER, INNER], (slope * np.sin(angle))[INNER, INNER], atol=1e-3)


@given(sensors, seeds)
@settings(max_examples=15, deadline=None)
def test_small_slopes_change_the_picture_linearly(sensor, seed):
    height = rough(seed, 1e-7)
    flat = sensor.background
    once = render_sensor_image(height, PITCH, sensor) - flat
    twice = render_sensor_image(2 * height, PITCH, sensor) - flat
    assert np.abs(once).max() > 1e-4
    np.testing.assert_allclose(twice, 2 * once, atol=2e-2 * np.abs(once).max())


@given(sensors, seeds)
@settings(max_examples=15, deadline=None)
def test_a_mirrored_surface_has_mirrored_slopes(sensor, seed):
    height = rough(seed)
    gx, gy = decode_gradients(render_sensor_image(height, PITCH, sensor), sensor)
    mx, my = decode_gradients(render_sensor_image(height[:, ::-1], PITCH, sensor), sensor)
    np.testing.assert_allclose(mx, -gx[:, ::-1], atol=1e-5)
    np.testing.assert_allclose(my, gy[:, ::-1], atol=1e-5)


def test_mirroring_a_surface_swaps_two_gelsight_channels():
    sensor, height = SENSORS["gelsight"], rough(3)
    image = render_sensor_image(height, PITCH, sensor)
    mirrored = render_sensor_image(height[:, ::-1], PITCH, sensor)
    np.testing.assert_allclose(mirrored, image[:, ::-1][..., [0, 2, 1]], atol=1e-6)
    assert not np.allclose(image, mirrored, atol=1e-3)


@given(sensors, st.floats(0, 2 * np.pi), st.floats(1.0, 1e3))
@settings(max_examples=25, deadline=None)
def test_steep_slopes_decode_at_the_gel_limit_in_their_direction(sensor, angle, times):
    slope = sensor.max_slope * times
    gx, gy = decode_gradients(
        render_sensor_image(slope * (X * np.cos(angle) + Y * np.sin(angle)), PITCH, sensor), sensor
    )
    np.testing.assert_allclose(gx, sensor.max_slope * np.cos(angle), atol=1e-4)
    np.testing.assert_allclose(gy, sensor.max_slope * np.sin(angle), atol=1e-4)
    foreign = shade(np.full((2, 2), slope * np.cos(angle)), np.full((2, 2), slope * np.sin(angle)), sensor)
    assert np.hypot(*decode_gradients(foreign, sensor)).max() <= sensor.max_slope * (1 + 1e-9)


@given(sensors, seeds, st.floats(0.2, 3.0))
@settings(max_examples=10, deadline=None)
def test_overall_brightness_of_the_lamps_cancels_out(sensor, seed, gain):
    image = render_sensor_image(rough(seed), PITCH, sensor).astype(np.float64)
    brighter = np.asarray(sensor.ambient) + gain * (image - np.asarray(sensor.ambient))
    np.testing.assert_allclose(decode_gradients(brighter, sensor), decode_gradients(image, sensor), atol=1e-9)


def test_nan_heights_and_unknown_sensors_are_refused():
    height = rough(0)
    height[3, 4] = np.nan
    with pytest.raises(UsageError, match="Fill or mask"):
        render_sensor_image(height, PITCH, SENSORS["digit"])
    with pytest.raises(UsageError, match="gelsight, digit"):
        get_sensor("thumb")
