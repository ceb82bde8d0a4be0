"""The tables of decoded touch images: exact where the truth is drawn, and one line where nothing is there."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image
from test_heights import write_tmd

from hnf_core.tactile.optics import SENSORS, render_sensor_image
from hnf_lab.experiments import touch_images
from hnf_lab.experiments.touch_images import (
    compute_depth_normals,
    draw_presses,
    fit_lamps,
    fit_sphere,
    judge_balls,
    main,
)


@pytest.fixture
def small_frames(monkeypatch):
    monkeypatch.setattr(touch_images, "DRAWN_SHAPE", (120, 160))
    monkeypatch.setattr(touch_images, "DRAWN_PIXEL_M", 120e-6)


def test_a_drawn_ball_has_its_own_radius(small_frames):
    presses = draw_presses("gelsight", np.random.default_rng(0), 0.5)
    row = next(row for row in judge_balls(presses, 120e-6) if "centers marked by" in row)
    assert abs(float(row.split("|")[2])) < 5.0


def test_a_sphere_is_fitted_exactly():
    row, column = np.indices((60, 80))
    height = np.sqrt(np.maximum(400.0 - (column - 40.5) ** 2 - (row - 29.0) ** 2, 0.0))
    assert fit_sphere(height + 7.0, np.array([40.5, 29.0]), 12.0) == pytest.approx(20.0, rel=1e-6)


def test_lamps_are_where_they_shine_from():
    towards, contrast = np.radians([10.0, 130.0, 250.0]), np.array([1.0, 0.5, 2.0])
    rng = np.random.default_rng(0)
    lateral = rng.uniform(-0.6, 0.6, (500, 2))
    normal = np.concatenate([lateral, np.sqrt(1.0 - np.sum(lateral**2, axis=1, keepdims=True))], axis=1)
    change = lateral @ (contrast * np.stack([np.cos(towards), np.sin(towards)]))
    assert np.allclose(fit_lamps(normal, change), np.stack([[10.0, 130.0, 250.0], contrast], axis=1))


def test_all_that_is_there_is_in_the_tables(tmp_path, capsys, small_frames):
    rng = np.random.default_rng(0)
    depth = np.cumsum(np.cumsum(rng.standard_normal((4, 64, 80)), axis=1), axis=2)
    for number, each in enumerate(depth):
        each = 8.0 * (each - each.mean()) / np.abs(np.gradient(each)).max()
        frame = render_sensor_image(1e-4 * each, 1e-4, SENSORS["gelsight"])
        Image.fromarray(np.rint(255.0 * frame).clip(0, 255).astype(np.uint8)).save(tmp_path / f"s{number}_gelsight.png")
        np.save(tmp_path / f"s{number}_depth.npy", each.astype(np.float32))
    y, x = np.indices((160, 160)) * 50e-6
    write_tmd(tmp_path / "money.tmd", 20e-6 * np.sin(2 * np.pi * x / 1.9e-3) * np.cos(2 * np.pi * y / 2.1e-3), 50e-6)
    assert main([str(tmp_path)]) == 0
    text = capsys.readouterr().out
    assert "GelSight Mini (every second place of the steel)" in text
    cells = next(line for line in text.splitlines() if line.startswith("| money | gelsight")).split("|")
    assert abs(float(cells[5])) < 1.5  # the octave about 2 mm


def test_nothing_is_one_line(tmp_path, capsys):
    assert main([str(tmp_path)]) == 1
    assert capsys.readouterr().err.count("\n") == 1
    assert main([str(tmp_path / "none")]) == 1


def test_normals_of_a_plane():
    row, column = np.indices((9, 9)).astype(float)
    assert np.allclose(compute_depth_normals(column)[4, 4], [-(0.5**0.5), 0.0, 0.5**0.5])
    assert np.allclose(compute_depth_normals(row)[4, 4], [0.0, 0.5**0.5, 0.5**0.5])
