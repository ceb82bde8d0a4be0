"""Sensor optics from a pressed ball: exact for a sensor of the model, with honest errors for others."""

from __future__ import annotations

import io
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.datasets.ball_calibration import (
    BALL_RADIUS_M,
    BallPresses,
    find_contact_radius_px,
    read_ball_presses,
    select_pixels_under,
)
from hnf_core.errors import FileError, UsageError
from hnf_core.tactile.optics import SENSORS, Sensor, shade
from hnf_lab import ROOT
from hnf_lab.experiments import optics_models
from hnf_lab.experiments.optics_check import (
    check_presses,
    check_table,
    format_ball_check,
    format_table_checks,
    get_lamps,
    plot_presses,
    plot_response,
)
from hnf_lab.experiments.optics_models import (
    PIXEL_PITCH_M,
    PolynomialTable,
    fit_linear_optics,
    make_sensor,
    mount_sensor,
    read_polynomial_table,
)

CALIBRATIONS = ROOT.parent / "shared" / "data" / "tactile_calibration"
needs_calibrations = pytest.mark.skipif(
    not CALIBRATIONS.is_dir(), reason="the real calibrations (shared/data/tactile_calibration) are not here"
)
HEIGHT, WIDTH, BALL, CONTACT = 60, 80, 12.0, 9.0
CENTRES = np.array([[x + 0.5 * (y == 30), y] for x in (16, 30, 46, 62) for y in (15, 30, 43)], dtype=float)


def pressed(sensor: Sensor, background=None, form: str = "frame") -> BallPresses:
    """A ball in a gel that follows it out to CONTACT and then runs out; light exactly as the sensor says."""
    column, row = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    x, y = column - CENTRES[:, :1, None], CENTRES[:, 1:, None] - row
    distance = np.hypot(x, y)
    slope = np.where(distance < CONTACT, 1.0 / np.sqrt(np.maximum(BALL**2 - distance**2, 1.0)), 0.0)
    edge = CONTACT / np.sqrt(BALL**2 - CONTACT**2)
    slope = np.where(distance < CONTACT, slope, edge * np.exp(-(distance - CONTACT) / 3.0) / np.maximum(distance, 1.0))
    light = shade(-x * slope, -y * slope, sensor).astype(float)
    if background is None:
        return BallPresses(light, np.broadcast_to(sensor.background, light.shape[1:]).copy(), CENTRES, BALL)
    frames = background * light if form == "ratio" else background + light
    return BallPresses(frames, background, CENTRES, BALL)


def hilly() -> np.ndarray:
    """A background that varies over the window."""
    column, row = np.meshgrid(np.linspace(0.0, 1.0, WIDTH), np.linspace(0.0, 1.0, HEIGHT))
    return np.stack([0.3 + 0.1 * column, 0.35 + 0.1 * row * column, 0.4 - 0.1 * row], axis=-1)


def flat_is(sensor: Sensor, light: float) -> Sensor:
    return replace(sensor, ambient=tuple(light - sensor.shading[:, 2]))


@pytest.mark.parametrize("name", sorted(SENSORS))
def test_shading_and_ambient_are_recovered_exactly(name):
    sensor = SENSORS[name]
    pixels = select_pixels_under(pressed(sensor), CONTACT)
    fitted = fit_linear_optics(pixels, "frame")
    np.testing.assert_allclose(fitted.sensor.shading, sensor.shading, atol=2e-6)
    np.testing.assert_allclose(fitted.sensor.ambient, sensor.ambient, atol=2e-6)
    np.testing.assert_allclose(fitted.predict(pixels), pixels.colour, atol=2e-6)
    np.testing.assert_allclose(fitted.decode(pixels), pixels.normal, atol=2e-5)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6))
def test_any_three_lamps_are_recovered(seed):
    random = np.random.default_rng(seed)
    turn, _ = np.linalg.qr(random.normal(size=(3, 3)))
    shading = 0.1 * turn @ np.diag(random.uniform(0.5, 1.5, 3))
    fitted = fit_linear_optics(
        select_pixels_under(pressed(make_sensor(shading, np.full(3, 0.4))), CONTACT), "frame"
    ).sensor
    np.testing.assert_allclose(fitted.shading, shading, atol=3e-6)
    np.testing.assert_allclose(fitted.ambient, 0.4, atol=3e-6)


@pytest.mark.parametrize("form", ["difference", "ratio"])
def test_a_background_that_varies_is_no_hindrance(form):
    sensor = flat_is(make_sensor(0.3 * SENSORS["gelsight"].shading, np.zeros(3)), 1.0 if form == "ratio" else 0.0)
    pixels = select_pixels_under(pressed(sensor, hilly(), form), CONTACT)
    fitted = fit_linear_optics(pixels, form)
    np.testing.assert_allclose(fitted.sensor.shading, sensor.shading, atol=1e-5)
    np.testing.assert_allclose(fitted.decode(pixels), pixels.normal, atol=2e-4)
    # and an evenly lit window is what the plain form takes it for
    error = np.abs(fit_linear_optics(pixels, "frame").predict(pixels) - pixels.colour)
    assert error.max() > 0.02
    np.testing.assert_allclose(fitted.predict(pixels), pixels.colour, atol=1e-5)


def test_clipped_pixels_say_nothing():
    presses = pressed(SENSORS["gelsight"])
    clipped = replace(presses, frames=np.minimum(1.7 * presses.frames, 1.0))
    assert (clipped.frames == 1.0).mean() > 0.001
    fitted = fit_linear_optics(select_pixels_under(clipped, CONTACT), "frame").sensor
    np.testing.assert_allclose(fitted.shading, 1.7 * SENSORS["gelsight"].shading, atol=1e-5)


def test_the_contact_ends_where_the_change_is_largest():
    assert find_contact_radius_px(pressed(SENSORS["digit"])) == pytest.approx(CONTACT, abs=1.0)


def test_normals_are_those_of_the_ball():
    pixels = select_pixels_under(pressed(SENSORS["gelsight"]), CONTACT)
    np.testing.assert_allclose(np.linalg.norm(pixels.normal, axis=1), 1.0)
    first = pixels.select(pixels.press == 0)
    right = (first.column == 22) & (first.row == 15)
    np.testing.assert_allclose(first.normal[right], [[0.5, 0.0, np.sqrt(0.75)]])
    above = (first.column == 16) & (first.row == 9)
    np.testing.assert_allclose(first.normal[above], [[0.0, 0.5, np.sqrt(0.75)]], atol=1e-12)
    assert np.degrees(pixels.tilt.max()) < np.degrees(np.arcsin(CONTACT / BALL))
    for radius in (0.0, BALL, np.nan):
        with pytest.raises(UsageError, match="no part of a ball"):
            select_pixels_under(pressed(SENSORS["gelsight"]), radius)


def test_one_direction_of_light_is_refused():
    pixels = select_pixels_under(pressed(SENSORS["gelsight"]), CONTACT)
    with pytest.raises(UsageError, match="do not tell the lamps apart"):
        fit_linear_optics(pixels.select(pixels.normal[:, 1] == 0.0), "frame")


def test_a_sensor_mounted_otherwise_is_the_same_sensor():
    sensor = SENSORS["gelsight"]
    np.testing.assert_allclose(mount_sensor(sensor, 2.0 * np.pi, False, (0, 1, 2)).shading, sensor.shading, atol=1e-12)
    quarter = mount_sensor(sensor, np.pi / 2, False, (0, 1, 2))
    azimuths = [lamp[0] for lamp in get_lamps(sensor)]
    np.testing.assert_allclose([(lamp[0] + 90.0) % 360.0 for lamp in get_lamps(quarter)], azimuths, atol=1e-6)
    mirrored = mount_sensor(sensor, 0.0, True, (0, 2, 1))
    np.testing.assert_allclose(mirrored.shading, sensor.shading, atol=1e-12)


def taxim_table(sensor: Sensor, bins: int) -> PolynomialTable:
    """Return a sensor's change against a flat gel at the middle of every cell, in the published convention.

    The direction is that from the pixel to the ball's centre, in an image whose rows run down.
    """
    tilt = (np.arange(bins)[:, None] + 0.5) * 0.5 * np.pi / (bins - 1)
    direction = (np.arange(bins)[None] + 0.5) * 2.0 * np.pi / (bins - 1) - np.pi
    to_centre_x, to_centre_down = np.cos(direction), np.sin(direction)
    normal = np.stack(
        [-np.sin(tilt) * to_centre_x, np.sin(tilt) * to_centre_down, np.cos(tilt) * np.ones_like(direction)], axis=-1
    )
    coefficients = np.zeros((bins, bins, 3, 6))
    coefficients[..., 5] = (normal - [0.0, 0.0, 1.0]) @ sensor.shading.T
    return PolynomialTable(coefficients)


def test_a_published_table_is_read_in_its_own_convention():
    sensor = SENSORS["digit"]
    pixels = select_pixels_under(pressed(sensor), CONTACT)
    table = taxim_table(sensor, 120)
    error = optics_models.predict_polynomial(table, pixels) - pixels.colour
    assert np.sqrt(np.mean(error**2)) < 0.01
    few = pixels.select(np.arange(len(pixels.press)) % 9 == 0)
    cosine = np.sum(optics_models.decode_polynomial(table, few, np.radians(58.0)) * few.normal, axis=1)
    assert np.degrees(np.arccos(np.minimum(cosine, 1.0))).mean() < 2.0


def test_a_refitted_table_learns_a_varying_background():
    sensor = flat_is(make_sensor(0.3 * SENSORS["gelsight"].shading, np.zeros(3)), 1.0)
    pixels = select_pixels_under(pressed(sensor, hilly(), "ratio"), CONTACT)
    table = optics_models.fit_polynomial_table(pixels, 40)
    assert table.coefficients.shape == (40, 40, 3, 6)
    error = optics_models.predict_polynomial(table, pixels) - pixels.colour
    assert np.sqrt(np.mean(error**2)) < 0.01


def test_a_check_of_ideal_presses_leaves_nothing():
    presses = pressed(SENSORS["gelsight"])
    check = check_presses(presses, taxim_table(SENSORS["gelsight"], 60))
    rows = {row.name: row for row in check.rows}
    assert (check.presses, check.noise_codes < 1.0) == (12, True)
    for name in ("ours, nominal GelSight as it is", "ours, fitted to frames", "ours, fitted to frame − background"):
        assert rows[name].rms_codes < 0.01, name
        assert max(rows[name].angle_deg) < 0.05, name
    assert rows["untouched: the background"].rms_codes > 20.0
    assert rows["untouched: the background"].angle_deg is None
    text = format_ball_check(check)
    assert text.count("\n| ours, fitted to frames | ") == 2
    assert "| polynomials fitted anew (40 × 40 cells) | 28,800 |" in text


def test_one_press_is_not_judged_by_itself():
    presses = pressed(SENSORS["gelsight"])
    with pytest.raises(UsageError, match="not both"):
        check_presses(replace(presses, frames=presses.frames[:1], centre_px=presses.centre_px[:1]))


def test_a_linear_table_stays_linear_for_any_mount_and_exposure():
    mounted = mount_sensor(SENSORS["gelsight"], np.radians(35.0), True, (1, 2, 0))
    check = check_table("made", taxim_table(make_sensor(0.6 * mounted.shading, np.zeros(3)), 120), (64, 48))
    assert check.linear_codes < 0.05 * check.change_codes
    assert check.varying_codes < 0.05 * check.change_codes
    assert check.nominal_codes < 0.05 * check.change_codes
    assert "| made |" in format_table_checks([check])


def test_pictures_are_drawn(tmp_path):
    presses, table = pressed(SENSORS["gelsight"]), taxim_table(SENSORS["gelsight"], 60)
    plot_presses(tmp_path / "a.png", presses, table, (0, 3))
    plot_response(tmp_path / "b.png", presses, table)
    for name in ("a.png", "b.png"):
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")


def write_pack(path: Path, **changes) -> Path:
    frames = np.zeros((2, 8, 10, 3), dtype=np.uint8)
    frames[..., 0] = 255  # blue comes first
    np.savez(path, **({"f0": frames[0], "imgs": frames, "touch_center": [[4.5, 3.0], [9.0, 7.0]]} | changes))
    return path


def test_a_data_pack_is_turned_to_red_green_blue(tmp_path):
    presses = read_ball_presses(write_pack(tmp_path / "dataPack.npz"), 3.0)
    np.testing.assert_array_equal(presses.frames[0, 0, 0], [0.0, 0.0, 1.0])
    np.testing.assert_array_equal(presses.background[0, 0], [0.0, 0.0, 1.0])
    np.testing.assert_array_equal(presses.centre_px, [[4.5, 3.0], [9.0, 7.0]])
    assert presses.ball_radius_px == 3.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"f0": np.zeros((8, 9, 3), dtype=np.uint8)}, r"frames \(2, 8, 10, 3\), background \(8, 9, 3\)"),
        ({"imgs": np.zeros((0, 8, 10, 3), dtype=np.uint8)}, "frames"),
        ({"imgs": np.zeros((2, 8, 10, 3))}, "float64, expected 8 bits"),
        ({"touch_center": [[4.5, 3.0]]}, "outside its frame"),
        ({"touch_center": [[4.5, 3.0], [10.0, 3.0]]}, "outside its frame"),
        ({"touch_center": [[4.5, 3.0], [np.nan, 3.0]]}, "outside its frame"),
        ({"touch_center": np.array([["a", "b"], ["c", "d"]])}, "something else than numbers"),
        ({"imgs": np.array([{}, {}], dtype=object)}, "Pickled ones are not read"),
    ],
    ids=str,
)
def test_another_data_pack_is_refused(tmp_path, changes, message):
    with pytest.raises(FileError, match=rf"dataPack\.npz: .*{message}"):
        read_ball_presses(write_pack(tmp_path / "dataPack.npz", **changes), 3.0)


def test_damaged_archives_are_refused(tmp_path, monkeypatch):
    path = write_pack(tmp_path / "dataPack.npz")
    whole = path.read_bytes()
    for data in (b"", b"PK", whole[:-30], whole[:200] + bytes(60) + whole[260:]):
        path.write_bytes(data)
        with pytest.raises(FileError, match="no archive of plain arrays"):
            read_ball_presses(path, 3.0)
    with pytest.raises(FileError, match="no archive"):
        read_ball_presses(tmp_path / "none.npz", 3.0)
    np.savez(path, f0=np.zeros(3))
    with pytest.raises(FileError, match="imgs, touch_center are missing"):
        read_ball_presses(path, 3.0)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        stream = io.BytesIO()
        np.save(stream, np.zeros(200_000))
        archive.writestr("f0.npy", stream.getvalue())
    monkeypatch.setattr("hnf_core.datasets.ball_calibration.MAX_UNPACKED_BYTES", 1_000_000)
    with pytest.raises(FileError, match="unpacked are too much"):
        read_ball_presses(path, 3.0)


def test_a_polynomial_table_is_checked(tmp_path):
    path, grad = tmp_path / "polycalib.npz", np.arange(2 * 2 * 6.0).reshape(2, 2, 6)
    np.savez(path, bins=2, grad_r=grad, grad_g=2 * grad, grad_b=3 * grad)
    values = read_polynomial_table(path).coefficients
    assert values.shape == (2, 2, 3, 6)
    # grad_r holds the first of blue, green, red
    np.testing.assert_allclose(values[:, :, 2], grad / 255.0)
    for wrong, message in (
        ({"grad_g": grad[:1]}, "grad_r, grad_g, grad_b are"),
        ({"grad_g": grad * np.nan}, "not finite"),
    ):
        np.savez(path, **({"grad_r": grad, "grad_g": grad, "grad_b": grad} | wrong))
        with pytest.raises(FileError, match=message):
            read_polynomial_table(path)


@needs_calibrations
def test_real_presses_are_as_linear_as_the_page_says():
    """Linear optics explain most of a real sensor, and polynomials of the position more (docs/optics.md)."""
    folder = CALIBRATIONS / "objectfolder_gelsight" / "calibs"
    presses = read_ball_presses(folder / "dataPack.npz", BALL_RADIUS_M / PIXEL_PITCH_M["objectfolder"])
    check = check_presses(presses, read_polynomial_table(folder / "polycalib.npz"))
    untouched, as_it_is, mounted, grazing, frame, difference, ratio, decoded, varying, anew, published = check.rows
    assert check.presses == 49
    assert check.contact_px == 13.0
    errors = [
        row.rms_codes for row in (untouched, mounted, grazing, frame, difference, ratio, varying, anew, published)
    ]
    assert errors == sorted(errors, reverse=True)
    assert as_it_is.rms_codes > mounted.rms_codes
    assert decoded.rms_codes > 1.3 * difference.rms_codes
    assert difference.rms_codes < 0.42 * untouched.rms_codes
    assert ratio.angle_deg[0] < 11.0
    assert 2.0 * published.rms_codes > 0.9 * difference.rms_codes  # the rival's own floor is half of it
    lamps = get_lamps(fit_linear_optics(select_pixels_under(presses, check.contact_px), "difference").sensor)
    apart = np.diff([lamp[0] for lamp in lamps])
    np.testing.assert_allclose(apart, 120.0, atol=5.0)


@needs_calibrations
@pytest.mark.parametrize(
    ("path", "size", "share"),
    [("calibs", (640, 480), 0.36), ("calibs/gelsight_r1.5", (240, 320), 0.31), ("calibs/digit", (240, 320), 0.62)],
)
def test_real_tables_are_mostly_linear_in_the_normal(path, size, share):
    table = read_polynomial_table(CALIBRATIONS / "taxim" / path / "polycalib.npz")
    check = check_table(path, table, size, SENSORS["digit" if "digit" in path else "gelsight"])
    assert check.linear_codes < share * check.change_codes
    assert check.varying_codes < check.linear_codes < check.nominal_codes < check.change_codes
