"""Photometric stereo of touch images: frames drawn by the project's own optics come back as the height they show."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.errors import FileError, SceneError, UsageError
from hnf_core.tactile.height import integrate_gradients, remove_plane
from hnf_core.tactile.optics import SENSORS, gel_gradients, render_sensor_image
from hnf_core.tactile.photometric_stereo import (
    TERM_COUNT,
    TouchCalibration,
    compute_terms,
    decode_touch_image,
    find_contact,
    fit_coefficients,
    get_nominal_calibration,
    load_calibration,
    measure_integrability,
    save_calibration,
)
from hnf_core.tactile.tactile_map import Route
from hnf_lab.encoder.variation import perturb_sensor

SHAPE, PIXEL_M = (96, 128), 60e-6


def bumps(seed: int, height_m: float = 60e-6, shape=SHAPE):
    """Waves of 1 to 4 mm, level at the edges."""
    rng = np.random.default_rng(seed)
    y, x = np.indices(shape) * PIXEL_M
    waves = 0.0
    for _ in range(6):
        angle, length, phase = rng.uniform(0, np.pi), rng.uniform(1e-3, 4e-3), rng.uniform(0, 2 * np.pi)
        waves = waves + np.sin(2 * np.pi * (x * np.cos(angle) + y * np.sin(angle)) / length + phase)
    return height_m * waves / waves.std() * np.outer(np.hanning(shape[0]), np.hanning(shape[1]))


def calibration_of(sensor, shape=SHAPE) -> TouchCalibration:
    """A calibration from every normal up to 45°, everywhere."""
    rng = np.random.default_rng(0)
    lateral = rng.uniform(-0.7, 0.7, (20_000, 2))
    lateral = lateral[np.hypot(*lateral.T) < 0.7]
    normal = np.concatenate([lateral, np.sqrt(1.0 - np.sum(lateral**2, axis=1, keepdims=True))], axis=1)
    colour = normal @ sensor.shading.T + np.asarray(sensor.ambient)
    x, y = rng.uniform(-1.0, 1.0, (2, len(normal)))
    terms = compute_terms(colour, np.broadcast_to(sensor.background, colour.shape), x, y)
    coefficients = tuple(map(tuple, fit_coefficients(terms, normal).tolist()))
    return TouchCalibration(sensor.name, coefficients, *shape, PIXEL_M, 1.0)


def flat_frame(sensor, shape=SHAPE):
    return np.broadcast_to(sensor.background, (*shape, 3)).copy()


@settings(max_examples=20, deadline=None)
@given(name=st.sampled_from(sorted(SENSORS)), seed=st.integers(0, 2**16), height=st.floats(15e-6, 120e-6))
def test_the_height_of_a_drawn_frame_comes_back(name, seed, height):
    """Of any specimen of a sensor, whatever its lamps, once it is calibrated."""
    sensor = perturb_sensor(SENSORS[name], np.random.default_rng(seed))
    true = bumps(seed, height)
    decoded = decode_touch_image(render_sensor_image(true, PIXEL_M, sensor), flat_frame(sensor), calibration_of(sensor))
    membrane = integrate_gradients(*gel_gradients(true, PIXEL_M, sensor), PIXEL_M)
    assert (decoded.tactile_map.height - membrane).std() < 0.005 * true.std()
    assert remove_plane(decoded.tactile_map.height - true).std() < 0.2 * true.std()  # long waves are left out
    assert decoded.integrability_db > 10.0
    assert decoded.tactile_map.route is Route.MEASURED
    assert decoded.notes == ()


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**16), gain=st.floats(0.3, 1.3))
def test_brightness_that_varies_over_the_window_cancels_out(seed, gain):
    sensor, true = SENSORS["gelsight"], bumps(seed)
    frame, flat = render_sensor_image(true, PIXEL_M, sensor), flat_frame(sensor)
    light = gain * np.linspace(0.7, 1.0, SHAPE[1])[None, :, None]
    calibration = calibration_of(sensor)
    plain = decode_touch_image(frame, flat, calibration).tactile_map.height
    shaded = decode_touch_image(light * frame, light * flat, calibration).tactile_map.height
    assert np.abs(shaded - plain).max() < 1e-3 * np.ptp(true)


def test_a_larger_picture_gives_the_same_height():
    sensor, true = SENSORS["digit"], bumps(3, shape=(96, 128))
    calibration = calibration_of(sensor)
    frame, flat = render_sensor_image(true, PIXEL_M, sensor), flat_frame(sensor)
    twice = [np.repeat(np.repeat(image, 2, axis=0), 2, axis=1) for image in (frame, flat)]
    small, large = decode_touch_image(frame, flat, calibration), decode_touch_image(*twice, calibration)
    assert large.tactile_map.metres_per_pixel == pytest.approx(0.5 * small.tactile_map.metres_per_pixel)
    rms = [each.tactile_map.height.std() for each in (small, large)]
    assert rms[1] == pytest.approx(rms[0], rel=0.05)
    halved = decode_touch_image(frame, flat, calibration, metres_per_pixel=0.5 * PIXEL_M)
    assert halved.tactile_map.height.std() == pytest.approx(0.5 * rms[0], rel=1e-3)


def test_a_frame_of_many_megapixels_is_reduced():
    sensor, shape = SENSORS["gelsight"], (1200, 1600)
    frame = render_sensor_image(bumps(1, 200e-6, shape), PIXEL_M, sensor)
    decoded = decode_touch_image(frame, flat_frame(sensor, shape), calibration_of(sensor, shape))
    assert decoded.tactile_map.image.shape == (600, 800, 3)
    assert decoded.tactile_map.metres_per_pixel == pytest.approx(2.0 * PIXEL_M)


def test_noise_and_a_wrong_calibration_have_curl():
    rng = np.random.default_rng(0)
    wavelength, ratio_db = measure_integrability(*rng.standard_normal((2, 200, 300)), PIXEL_M)
    assert np.isinf(wavelength)
    assert abs(ratio_db) < 1.0
    gx, gy = gel_gradients(bumps(0, 30e-6), PIXEL_M, SENSORS["gelsight"])
    assert measure_integrability(gx, gy, PIXEL_M)[1] > 15.0
    assert measure_integrability(-gy, gx, PIXEL_M)[1] < -15.0
    sensor = SENSORS["gelsight"]
    turned = calibration_of(replace(sensor, azimuth_deg=tuple(angle + 90.0 for angle in sensor.azimuth_deg)))
    decoded = decode_touch_image(render_sensor_image(bumps(0), PIXEL_M, sensor), flat_frame(sensor), turned)
    assert decoded.integrability_db < 0.0
    assert any("another sensor's" in note for note in decoded.notes)


@pytest.mark.parametrize("noise", [0.003, 0.01, 0.03])
def test_more_noise_resolves_longer_waves_only(noise):
    sensor, rng = SENSORS["gelsight"], np.random.default_rng(1)
    frame = render_sensor_image(bumps(2), PIXEL_M, sensor)
    calibration, flat = calibration_of(sensor), flat_frame(sensor)
    clean, noisy = (
        decode_touch_image(frame + level * rng.standard_normal(frame.shape), flat, calibration).tactile_map
        for level in (0.0, noise)
    )
    assert 2.0 * PIXEL_M <= clean.resolved_wavelength_m < noisy.resolved_wavelength_m < 4e-3


def test_the_contact_is_where_something_presses_gaps_included():
    flat = flat_frame(SENSORS["gelsight"], (120, 160))
    frame = flat.copy()
    frame[40:80, 40:55] += 0.1
    frame[40:80, 65:80] -= 0.1
    contact = find_contact(frame, flat)
    assert contact[45:75, 42:78].all()
    assert not contact[:20].any()
    assert not contact[:, 120:].any()


def test_without_a_calibration_the_route_is_predicted():
    frame = render_sensor_image(bumps(0), PIXEL_M, SENSORS["digit"])
    decoded = decode_touch_image(frame, flat_frame(SENSORS["digit"]), sensor="digit")
    assert decoded.tactile_map.route is Route.PREDICTED
    assert "no calibration" in decoded.notes[0]
    assert decoded.tactile_map.metres_per_pixel == pytest.approx(19e-3 / 128)
    without = decode_touch_image(frame, sensor="digit")
    assert any("no background" in note for note in without.notes)
    assert without.tactile_map.mask.all()


def test_a_digit_on_its_side_has_its_lamps_turned():
    """Turning the frame a quarter counterclockwise turns the slopes with it."""
    upright, aside = (get_nominal_calibration("digit", *shape) for shape in ((320, 240), (240, 320)))
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    first, second = (np.asarray(each.coefficients)[:3].T for each in (upright, aside))
    assert np.allclose(first, turn @ second)


def test_what_cannot_be_decoded_is_refused():
    sensor, calibration = SENSORS["gelsight"], calibration_of(SENSORS["gelsight"])
    frame, flat = render_sensor_image(bumps(0), PIXEL_M, sensor), flat_frame(sensor)
    with pytest.raises(UsageError, match="background has 64 × 96 pixels"):
        decode_touch_image(frame, flat[:, :64], calibration)
    with pytest.raises(UsageError, match="the calibration's 128 × 96"):
        decode_touch_image(frame[:, :64], flat[:, :64], calibration)
    with pytest.raises(SceneError, match="overexposed"):
        decode_touch_image(np.minimum(4.0 * frame, 1.0), flat, calibration)
    with pytest.raises(SceneError, match="nothing touches"):
        decode_touch_image(flat, flat, calibration)
    with pytest.raises(UsageError, match="gelsight, digit"):
        decode_touch_image(frame, flat, sensor="tactip")


def test_a_calibration_file_is_read_back_and_damage_is_refused(tmp_path):
    path, calibration = tmp_path / "c.json", calibration_of(SENSORS["digit"])
    save_calibration(path, calibration)
    assert load_calibration(path) == calibration
    record = json.loads(path.read_text())
    for change in (
        {"format": "x"}, {"coefficients": [[0.0, 0.0]] * (TERM_COUNT - 1)}, {"coefficients": [[0.0]] * TERM_COUNT},
        {"sensor": "tactip"}, {"metres_per_pixel": -1.0}, {"rows": 0}, {"more": 1}, {"error_deg": "small"},
    ):  # fmt: skip
        path.write_text(json.dumps({**record, **change}))
        with pytest.raises(FileError, match="hnf describe --calibrate"):
            load_calibration(path)
    for text in ("", "[]", '{"format": NaN}', "\xff"):
        path.write_bytes(text.encode("latin-1"))
        with pytest.raises(FileError, match="no calibration"):
            load_calibration(path)
    with pytest.raises(FileError, match="No such file"):
        load_calibration(tmp_path / "none.json")
