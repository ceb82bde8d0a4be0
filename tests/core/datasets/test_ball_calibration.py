"""Calibration of a touch sensor by presses of a ball: centres are found, normals come back, real balls are round."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from touch_frames import BALL_M, PIXEL_M, SHAPE, draw_ball, write_frame, write_presses

from hnf_core.datasets.ball_calibration import (
    BallPresses,
    calibrate,
    find_ball_centres,
    read_press_folder,
)
from hnf_core.errors import FileError, UsageError
from hnf_core.tactile.optics import SENSORS
from hnf_core.tactile.photometric_stereo import decode_touch_image

REAL = Path(__file__).resolve().parents[4] / "shared/data/tactile_calibration/objectfolder_gelsight/calibs"
RADIUS_PX = BALL_M / PIXEL_M


@pytest.mark.parametrize("name", sorted(SENSORS))
def test_a_folder_of_presses_calibrates_its_sensor(tmp_path, name):
    centres = write_presses(tmp_path, name)
    presses = read_press_folder(tmp_path, RADIUS_PX)
    assert np.abs(presses.centre_px - centres).max() <= 1.0
    calibration = calibrate(presses, name, PIXEL_M)
    assert calibration.error_deg < 4.0
    assert (calibration.rows, calibration.columns) == SHAPE
    new = draw_ball(SENSORS[name], 60.0, 50.0)
    decoded = decode_touch_image(new, presses.background, calibration).tactile_map
    y, x = np.indices(SHAPE)
    true = np.sqrt(np.maximum(RADIUS_PX**2 - (x - 60.0) ** 2 - (y - 50.0) ** 2, 0.0)) * PIXEL_M
    inside = np.hypot(x - 60.0, y - 50.0) < 0.55 * RADIUS_PX
    error = (decoded.height - true)[inside]
    assert error.std() < 0.1 * true[inside].std()
    assert decoded.mask[inside].all()
    assert not decoded.mask[:, 120:].any()


def test_a_background_elsewhere_and_presses_that_do_not_fit(tmp_path):
    folder = tmp_path / "presses"
    write_presses(folder, "gelsight")
    moved = (folder / "background.png").rename(tmp_path / "flat.png")
    with pytest.raises(FileError, match="no picture of the untouched sensor"):
        read_press_folder(folder, RADIUS_PX)
    assert len(read_press_folder(folder, RADIUS_PX, moved).frames) == 9
    untouched = write_frame(folder / "press_9.png", np.broadcast_to(SENSORS["gelsight"].background, (*SHAPE, 3)))
    with pytest.raises(FileError, match=r"press_9\.png: no ball"):
        read_press_folder(folder, RADIUS_PX, moved)
    write_frame(untouched, np.zeros((40, 40, 3)))
    with pytest.raises(FileError, match="not the background's size"):
        read_press_folder(folder, RADIUS_PX, moved)
    large = write_frame(tmp_path / "large.png", np.zeros((1100, 1000, 3)))
    with pytest.raises(FileError, match="Scale all pictures down"):
        read_press_folder(folder, RADIUS_PX, large)
    for path in list(folder.iterdir())[3:]:
        path.unlink()
    with pytest.raises(FileError, match="3 pictures of presses are too few"):
        read_press_folder(folder, RADIUS_PX, moved)
    few = BallPresses(np.zeros((3, *SHAPE, 3)), np.zeros((*SHAPE, 3)), np.zeros((3, 2)), RADIUS_PX)
    for radius in (1.0, 500.0):
        many = BallPresses(np.zeros((5, *SHAPE, 3)), np.zeros((*SHAPE, 3)), np.zeros((5, 2)), radius)
        with pytest.raises(UsageError, match="Check --ball-mm"):
            calibrate(many, "gelsight", PIXEL_M)
    with pytest.raises(UsageError, match="3 presses are too few"):
        calibrate(few, "gelsight", PIXEL_M)


@pytest.mark.skipif(not REAL.is_dir(), reason="ObjectFolder's presses (shared/data/tactile_calibration) are not here")
def test_real_presses_give_the_balls_own_radius():
    """Every seventh press, decoded by a calibration from the others, whose centres are found."""
    pixel_m = 0.1245e-3
    presses = read_press_folder(REAL, BALL_M / pixel_m)
    found = find_ball_centres(presses.frames - presses.background)
    assert np.median(np.hypot(*(found - presses.centre_px).T)) < 2.5
    judged = np.arange(len(presses.frames)) % 7 == 3
    others = BallPresses(presses.frames[~judged], presses.background, found[~judged], presses.ball_radius_px)
    calibration = calibrate(others, "gelsight", pixel_m)
    assert calibration.error_deg < 7.0
    y, x = np.indices(presses.background.shape[:2])
    radii = []
    for frame, (column, row) in zip(presses.frames[judged], presses.centre_px[judged], strict=True):
        decoded = decode_touch_image(frame, presses.background, calibration).tactile_map
        inside = np.hypot(x - column, y - row) < 13
        points = np.stack([x[inside] - column, y[inside] - row, decoded.height[inside] / pixel_m], axis=1)
        solution = np.linalg.lstsq(np.c_[points, np.ones(len(points))], np.sum(points**2, axis=1), rcond=None)[0]
        radii.append(pixel_m * np.sqrt(solution[3] + np.sum((0.5 * solution[:3]) ** 2)))
    assert np.median(radii) == pytest.approx(BALL_M, rel=0.05)
    assert np.abs(np.array(radii) / BALL_M - 1.0).max() < 0.2
