"""The finger's level beside published thresholds of Pacinian fibres, and the reading of rates."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.field.weights import load_field
from hnf_core.material.library import get_material
from hnf_core.material.ranking import find_material
from hnf_lab.experiments.afferents import (
    BAND_HZ,
    MASKERS_UM,
    PC_ABSOLUTE_UM,
    PC_HZ,
    PC_TUNING_UM,
    SPEEDS_MM_S,
    average_rate,
    bootstrap_rank,
    compare_levels,
    compare_ranks,
    compute_density,
    compute_level_over,
    compute_threshold,
    convert_masker,
    read_rates,
    sum_band,
)

RATES = Path(__file__).resolve().parents[5] / "shared" / "data" / "afferents"
STEP_HZ = 5.0
FREQUENCY = STEP_HZ * np.arange(401)


def make_tone(frequency_hz: float, rms: float) -> np.ndarray:
    """Density of a sine that lies in one bin."""
    density = np.zeros_like(FREQUENCY)
    density[round(frequency_hz / STEP_HZ)] = np.square(rms) / STEP_HZ
    return density


@settings(max_examples=40, deadline=None)
@given(st.integers(9, 159), st.floats(-20.0, 20.0), st.sampled_from([PC_ABSOLUTE_UM, PC_TUNING_UM]))
def test_a_sine_at_its_threshold_is_at_0_db(place, over_db, amplitude):
    frequency = place * STEP_HZ
    rms = compute_threshold(np.array([frequency]), amplitude)[0] * 10.0 ** (over_db / 20.0)
    assert compute_level_over(FREQUENCY, make_tone(frequency, rms), amplitude) == pytest.approx(over_db, abs=1e-6)


@pytest.mark.parametrize(("low", "high"), [(39.0, 79.3), (79.3, 161.0), (161.0, 205.0)])
def test_fibres_fire_once_a_cycle_well_above_their_threshold(low, high):
    frequency = np.geomspace(low, high, 20)
    ratio = compute_threshold(frequency, PC_TUNING_UM) / compute_threshold(frequency, PC_ABSOLUTE_UM)
    assert (ratio > 1.5).all()
    assert (ratio < 10.0).all()


def test_thresholds_are_accelerations_of_their_displacement():
    time = np.arange(4000) / 40_000.0
    for frequency, amplitude in zip(PC_HZ[1:4], PC_ABSOLUTE_UM[1:4], strict=True):
        place = 1e-6 * amplitude * np.sin(2.0 * np.pi * frequency * time)
        acceleration = np.gradient(np.gradient(place, time), time)[2:-2]
        periods = acceleration[: round(int(frequency * 0.0998) / frequency * 40_000)]
        rms = np.sqrt(np.mean(np.square(periods)))
        assert compute_threshold(np.array([frequency]), PC_ABSOLUTE_UM)[0] == pytest.approx(rms, rel=0.02)
    assert convert_masker(128, 10.0) == pytest.approx((2.0 * np.pi * 128) ** 2 * 5e-6 / np.sqrt(2.0))


@pytest.fixture(scope="module")
def densities():
    field = load_field()
    names = ("fleece", "velvet", "silk", "wool-cloth", "synthetic-leather", "sandpaper")
    return {name: compute_density(field, get_material(name), 0.08, 0.25) for name in names}


def test_surfaces_that_fire_fibres_exceed_their_threshold(densities):
    over = {name: compute_level_over(*density, PC_ABSOLUTE_UM) for name, density in densities.items()}
    assert min(over.values()) > 0.0, over
    assert max(over.values()) < 20.0, over
    assert over["sandpaper"] > over["velvet"] + 6.0


def test_no_cloth_is_louder_than_what_masks_slip(densities):
    for frequency in (64, 128):  # the maskers of the strongest effect
        masker = 20.0 * np.log10(convert_masker(frequency, MASKERS_UM[frequency]))
        octave = (frequency / np.sqrt(2.0), frequency * np.sqrt(2.0))
        for name in ("fleece", "velvet", "silk"):
            assert sum_band(*densities[name], *octave) < masker, (name, frequency)


def test_rates_are_read_by_fibre_and_speed(tmp_path):
    (tmp_path / "mean_rates.csv").write_text(
        "texture,speed_mm_s,SA_imp_s,n_SA,RA_imp_s,n_RA,PC_imp_s,n_PC\n"
        "Satin,40,3.5,12,14.2,11,30.0,5\nSatin,80,5.5,17,18.3,15,80.0,7\nVelvet,80,1.0,2,3.0,4,,0\n",
        encoding="utf-8",
    )
    textures = read_rates(tmp_path)
    assert [each.name for each in textures] == ["Satin", "Velvet"]
    assert average_rate(textures, ("PC", 80)) == 80.0
    assert average_rate(textures, ("RA", 80)) == pytest.approx((18.3 + 3.0) / 2.0)


@pytest.mark.skipif(not RATES.is_dir(), reason="the firing rates (shared/data/afferents) are not here")
def test_levels_rank_as_rates_do_and_every_class_is_felt():
    field, classes, densities = load_field(), {}, {}
    for texture in read_rates(RATES):
        material, _ = find_material(texture.name)
        classes.setdefault(material.name, []).append(texture)
    for name in classes:
        for speed in SPEEDS_MM_S:
            densities[name, speed] = compute_density(field, get_material(name), 1e-3 * speed, 0.25)
    levels = [sum_band(*densities[name, 80], *BAND_HZ) for name in classes]
    rates = [average_rate(group, ("PC", 80)) for group in classes.values()]
    assert bootstrap_rank(levels, rates)[0] > 0.5
    assert "rises from 40 to 80 mm/s on 100 %" in compare_ranks(classes, densities)[-1]
    assert len(compare_levels(classes, densities)) == 2 + len(classes) + 3 + len(MASKERS_UM)
    for name in classes:
        assert compute_level_over(*densities[name, 80], PC_ABSOLUTE_UM) > 0.0, name
