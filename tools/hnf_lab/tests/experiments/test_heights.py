"""Heights beside measured ones: octaves of known waves, files of maps, and what is said without any."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hnf_core.material.library import get_material
from hnf_lab.experiments.heights import (
    MAP_OCTAVES_M,
    OCTAVES_M,
    SAMPLE_M,
    compute_library_octaves,
    fit_slope,
    main,
    measure_map,
    measure_octaves,
    read_tmd,
)

MAPS = Path(__file__).resolve().parents[5] / "shared" / "data" / "tmd_heights"
PIXEL_M = 20e-6


def write_tmd(path, height_m, pixel_m=PIXEL_M):
    """A TrueMap file as its examples are laid out."""
    rows, columns = height_m.shape
    sizes = np.array([columns, rows], "<i4").tobytes()
    lengths = np.array([1e3 * pixel_m * columns, 1e3 * pixel_m * rows, 0.0, 0.0], "<f4").tobytes()
    heights = (1e3 * height_m).astype("<f4").tobytes()
    path.write_bytes(b"Binary TrueMap Data File v2.0\r\n\0" + b"made here\r\n\0" + sizes + lengths + heights)


def make_map(wave_m=1e-3, amplitude_m=3e-6, rows=300, columns=400):
    """Waves along x of one length, tilted by more than they are high."""
    x = PIXEL_M * np.arange(columns)
    return np.tile(amplitude_m * np.sin(2.0 * np.pi * x / wave_m) + 1e-2 * x, (rows, 1))


def test_a_sine_is_in_its_octave_alone():
    place = np.arange(100_000) * SAMPLE_M
    found = measure_octaves(3e-6 * np.sin(2.0 * np.pi * place / 1e-3))
    assert found[OCTAVES_M.index(1e-3)] == pytest.approx(3e-6 / np.sqrt(2.0), rel=0.01)
    assert found[OCTAVES_M.index(0.5e-3)] < 1e-9


def test_a_tilted_map_has_its_waves_along_one_axis_alone(tmp_path):
    write_tmd(tmp_path / "map.tmd", make_map())
    height, pixel = read_tmd(tmp_path / "map.tmd")
    assert pixel == pytest.approx((PIXEL_M, PIXEL_M), rel=1e-6)
    assert height.shape == (300, 400)
    found = dict(zip(MAP_OCTAVES_M, measure_map(height, pixel), strict=True))
    # Half the power: rows have the waves, columns none.
    assert found[1e-3] == pytest.approx(3e-6 / 2.0, rel=0.02)
    assert found[0.25e-3] < 0.01 * found[1e-3]
    assert np.isnan(found[0.125e-3]) == (4 * PIXEL_M > 0.125e-3 / 2.0**0.5)


def test_places_that_were_not_measured_are_left_out(tmp_path):
    height = make_map()
    height[7, 100] = -1e7
    height[:, 0] = -1e7
    write_tmd(tmp_path / "map.tmd", height)
    read, pixel = read_tmd(tmp_path / "map.tmd")
    assert np.isnan(read).sum() == 301
    assert np.isnan(measure_map(read, pixel)).all()  # no row is whole
    assert np.isfinite(measure_map(read[:, 1:], pixel)[:3]).all()


@pytest.mark.parametrize("broken", [b"", b"P5 4 4 255", b"Binary TrueMap Data File v2.0\r\n\0a\0" + bytes(40)])
def test_a_broken_map_is_named(tmp_path, broken, capsys):
    (tmp_path / "paper.tmd").write_bytes(broken)
    assert main([str(tmp_path)]) == 2
    assert "paper.tmd" in capsys.readouterr().err
    write_tmd(tmp_path / "paper.tmd", make_map())
    whole = (tmp_path / "paper.tmd").read_bytes()
    (tmp_path / "paper.tmd").write_bytes(whole[:-4])
    assert main([str(tmp_path)]) == 2
    assert "Copy it again" in capsys.readouterr().err


@pytest.mark.parametrize("exponent", [0.3, 0.9])
def test_the_slope_of_a_self_affine_profile_is_its_exponent(exponent):
    rng = np.random.default_rng(1)
    wavenumber = np.fft.rfftfreq(4096, PIXEL_M)
    scale = np.maximum(wavenumber, wavenumber[1]) ** -(0.5 + exponent)
    lines = np.fft.irfft(scale * np.exp(2j * np.pi * rng.random((200, len(scale)))), axis=-1)
    heights = measure_octaves(lines, PIXEL_M, MAP_OCTAVES_M)
    assert fit_slope(heights, MAP_OCTAVES_M) == pytest.approx(exponent, abs=0.05)
    assert np.isnan(fit_slope(np.where(np.arange(5) == 2, heights, np.nan), MAP_OCTAVES_M))


@pytest.mark.skipif(not MAPS.is_dir(), reason="the height maps (shared/data/tmd_heights) are not here")
@pytest.mark.parametrize(("name", "pixel_um", "rms_um"), [("paper", 0.63, 4.1), ("money", 15.0, 16.6)])
def test_measured_maps_are_as_high_as_they_are_said_to_be(name, pixel_um, rms_um):
    height, pixel = read_tmd(MAPS / f"{name}.tmd")
    assert 1e6 * height.std() == pytest.approx(rms_um, rel=0.02)
    assert 1e6 * pixel[0] == pytest.approx(pixel_um, rel=0.02)


def test_maps_and_profiles_are_read_together(tmp_path, capsys):
    write_tmd(tmp_path / "money.tmd", make_map())
    np.save(tmp_path / "acrylic.npy", 1e-6 * np.random.default_rng(0).standard_normal(20_000))
    assert main([str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "copy-paper" in said
    assert "smooth-plastic" in said
    assert "0.125 mm" in said


def test_a_rougher_material_is_higher():
    rough, smooth = (compute_library_octaves(get_material(name).token) for name in ("sandstone", "clear-glass"))
    assert (rough > 10.0 * smooth).all()


def test_a_folder_without_profiles_is_named(tmp_path, capsys):
    assert main([str(tmp_path)]) == 2
    assert "acrylic.npy" in capsys.readouterr().err
    np.save(tmp_path / "acrylic.npy", 1e-6 * np.random.default_rng(0).standard_normal(20_000))
    assert main([str(tmp_path)]) == 0
    assert "smooth-plastic" in capsys.readouterr().out
