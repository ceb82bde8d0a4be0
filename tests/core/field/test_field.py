"""F_Θ: laws of its inputs, its accumulation, its weights file, and what the shipped weights must hold."""

import dataclasses
import json
from itertools import pairwise

import numpy as np
import pytest
from steady_spectra import expected_rms, expected_spectrum, spectrum_distance_db

from hnf_core.action.action import ACTION_RATE_HZ, Action
from hnf_core.errors import FileError, WeightsError
from hnf_core.field.carriers import Carriers
from hnf_core.field.features import build_inputs
from hnf_core.field.field import Emission, Field, FieldConfig, accumulate, evaluate, initial_parameters
from hnf_core.field.linear_contact import Condition
from hnf_core.field.stroke import uniform_stroke
from hnf_core.field.synthesis import synthesise
from hnf_core.field.weights import DEFAULT_WEIGHTS, load_field, read_encoders, save_field
from hnf_core.material.contact_model import Mechanics
from hnf_core.material.library import load_library
from hnf_core.material.token import BAND_FEATURES, ENCODER_ID, TOKEN_DIM
from hnf_core.metrics.spectra import welch
from hnf_lab.evaluation.texture_statistics import STROKE_ANGLES_RAD

FREQUENCY = np.arange(2.0, 5000.0, 2.0)
ALONG, ACROSS = (1.0, 0.0), (0.0, 1.0)
LIBRARY = load_library()
SMALL = FieldConfig(hidden=16, layers=2)


def flat_token(level: float = -5.5) -> np.ndarray:
    token = np.zeros(TOKEN_DIM, dtype=np.float32)
    token[0 : 7 * len(BAND_FEATURES) : len(BAND_FEATURES)] = level - 0.25 * np.arange(7)
    return token


def grating_token(pitch_m: float, level: float = -5.0) -> np.ndarray:
    """Waves along +x of one pitch, nothing else."""
    token = flat_token(-8.0)
    band = int(np.clip(np.rint(np.log2(8e-3 / pitch_m)), 0, 6))
    start = band * len(BAND_FEATURES)
    centre = 8e-3 / 2**band
    token[start : start + 7] = [level, 1.0, 0.0, 1.0, 0.0, 1.0, np.log2(centre / pitch_m)]
    return token


def condition(**change) -> Condition:
    count = len(change.get("speed", [0.1]))
    values = {
        "tokens": np.tile(flat_token().astype(float), (count, 1)),
        "mechanics": (Mechanics(5e4, 0.2, 0.3),),
        "material": np.zeros(count, dtype=np.int32),
        "direction": np.tile([1.0, 0.0], (count, 1)),
        "speed": np.full(count, 0.1),
        "force": np.full(count, 1.0),
        "contact": np.ones(count, dtype=bool),
        "probe": "pen",
    }
    return Condition(**{**values, **change})


def linear_field() -> Field:
    return Field(SMALL, initial_parameters(SMALL, 0))


def rms_of(field, entry, speed, force, direction=ALONG):
    return expected_rms(field, entry.token, entry.mechanics, "pen", direction, speed, force)


def both_ways(field, entry, speed, force, angles):
    rms = [rms_of(field, entry, speed, force, (np.cos(angle), np.sin(angle))) for angle in angles]
    return float(np.hypot(*rms)) / 2**0.5


AXES = (0.0, 0.5 * np.pi)
WAYS = [
    pytest.param(e, angles, id=f"{e.name}-{name}")
    for e in LIBRARY
    for name, angles in (("axes", AXES), ("library", STROKE_ANGLES_RAD))
]


# -- what the shipped weights must hold ------------------------------------------------------------------------------


@pytest.mark.parametrize("entry", LIBRARY, ids=lambda entry: entry.name)
def test_every_library_material_feels_like_a_material(entry):
    field = load_field()
    for direction in (ALONG, ACROSS):
        assert 0.1 <= rms_of(field, entry, 0.1, 1.0, direction) <= 30.0
        density = expected_spectrum(field, entry.token, entry.mechanics, "pen", direction, 0.1, 1.0, FREQUENCY)
        assert density[FREQUENCY < 1000.0].sum() > 0.5 * density.sum()


@pytest.mark.parametrize(("entry", "angles"), WAYS)
def test_every_library_material_answers_to_speed_and_force(entry, angles):
    """Exactly along the axes, and under the angles that the library itself is held to (simulation.feel)."""
    field = load_field()
    by_speed = np.log(both_ways(field, entry, 0.15, 1.0, angles) / both_ways(field, entry, 0.05, 1.0, angles))
    assert 0.4 <= by_speed / np.log(3.0) <= 1.4
    by_force = np.log(both_ways(field, entry, 0.1, 2.0, angles) / both_ways(field, entry, 0.1, 0.5, angles))
    assert -0.1 <= by_force / np.log(4.0) <= 0.7


def test_materials_differ():
    field = load_field()
    spectra = [
        expected_spectrum(field, e.token, e.mechanics, "pen", ALONG, 0.1, 1.0, np.arange(10.0, 1000.0, 10.0))
        for e in LIBRARY
    ]
    distances = {
        (LIBRARY[i].name, LIBRARY[j].name): spectrum_distance_db(a, b)
        for i, a in enumerate(spectra)
        for j, b in enumerate(spectra[:i])
    }
    # Fitted to the same recordings. Simulated on 48 patches each they are 0.9 dB apart, two halves of either 1.2 dB:
    # under a pen they differ by the chance of their patches alone.
    assert distances.pop(("flannel", "fleece")) < 0.5
    assert np.median(list(distances.values())) > 3.0
    assert min(distances.values()) > 0.3


def test_unknown_mechanics_are_known_territory():
    field = load_field()
    for entry in LIBRARY:
        known = rms_of(field, entry, 0.1, 1.0)
        unknown = expected_rms(field, entry.token, Mechanics(), "pen", ALONG, 0.1, 1.0)
        assert 0.03 * known < unknown < 30.0 * known


def test_probes_differ():
    field, entry = load_field(), LIBRARY[0]
    pen, finger = (
        expected_spectrum(field, entry.token, entry.mechanics, probe, ALONG, 0.1, 1.0, np.arange(10.0, 1000.0, 10.0))
        for probe in ("pen", "finger")
    )
    assert spectrum_distance_db(pen, finger) > 3.0


def test_the_shipped_weights_say_where_they_come_from():
    field = load_field()
    for key in ("training_data", "seed", "metrics", "licence", "encoder", "architecture", "ranges"):
        assert field.metadata[key]
    assert "no recorded data" in field.metadata["training_data"]
    assert DEFAULT_WEIGHTS.stat().st_size <= 8e6
    assert len(field.identity) == 32


@pytest.mark.parametrize("speed", [0.05, 0.1, 0.2, 0.3])
def test_the_tone_of_a_grating_follows_the_speed(speed):
    pitch = 0.8e-3
    density = expected_spectrum(
        load_field(), grating_token(pitch), Mechanics(5e4, 0.2, 0.3), "pen", ALONG, speed, 1.0, FREQUENCY
    )
    relative = FREQUENCY * pitch / speed
    window = (relative > 0.7) & (relative < 1.4)
    peak = float(FREQUENCY[window][np.argmax(density[window])])
    tone = np.abs(FREQUENCY - peak) < 0.04 * peak
    centroid = float((FREQUENCY * density)[tone].sum() / density[tone].sum())
    assert centroid == pytest.approx(speed / pitch, rel=0.02)


def test_turning_surface_and_stroke_together_changes_little():
    """Directions are relative to the surface: a quarter turn of both gives the same spectrum within the fit's error."""
    field, entry = load_field(), LIBRARY[0]
    turned = entry.token.copy()
    for band in range(7):
        start = band * len(BAND_FEATURES)
        turned[start + 1 : start + 3] *= -1.0
    here = expected_spectrum(field, entry.token, entry.mechanics, "pen", ALONG, 0.1, 1.0, FREQUENCY[:500])
    there = expected_spectrum(field, turned, entry.mechanics, "pen", ACROSS, 0.1, 1.0, FREQUENCY[:500])
    back = expected_spectrum(field, entry.token, entry.mechanics, "pen", (-1.0, 0.0), 0.1, 1.0, FREQUENCY[:500])
    assert spectrum_distance_db(here, there) < 1.0
    assert spectrum_distance_db(here, back) < 1.0


def test_a_signal_has_the_expected_spectrum():
    field, entry = load_field(), LIBRARY[0]
    count = round(6.0 * ACTION_RATE_HZ) + 1
    action = Action(
        ACTION_RATE_HZ,
        np.tile([1.0, 0.0], (count, 1)),
        np.full(count, 0.1),
        np.full(count, 1.0),
        np.arange(count) * 0.1 / ACTION_RATE_HZ,
        np.ones(count, dtype=bool),
    )
    stroke = uniform_stroke(action, entry.token, entry.mechanics)
    heard = np.mean([welch(synthesise(field, stroke, seed=s).signal.samples[1000:], 1e4)[1] for s in range(2)], axis=0)
    fine = np.arange(0.5, 1100.0, 1.0)
    density = expected_spectrum(field, entry.token, entry.mechanics, "pen", ALONG, 0.1, 1.0, fine)
    edges = np.geomspace(20.0, 1000.0, 13)
    bins = np.arange(501) * 10.0
    level = [
        (heard[(bins >= low) & (bins < high)].mean(), density[(fine >= low) & (fine < high)].mean())
        for low, high in pairwise(edges)
    ]
    assert spectrum_distance_db(*zip(*level, strict=True)) < 1.2


# -- ranges ----------------------------------------------------------------------------------------------------------


def stroke_of(speed: float, force: float, token: np.ndarray):
    count = 101
    action = Action(
        ACTION_RATE_HZ,
        np.tile([1.0, 0.0], (count, 1)),
        np.full(count, speed),
        np.full(count, force),
        np.arange(count) * speed / ACTION_RATE_HZ,
        np.ones(count, dtype=bool),
    )
    return uniform_stroke(action, token, Mechanics(5e4, 0.2, 0.3))


@pytest.mark.parametrize(
    ("speed", "force", "word"),
    [(0.1, 1.0, None), (0.9, 1.0, "Speed"), (0.001, 1.0, "Speed"), (0.1, 12.0, "Force"), (0.1, 0.03, "Force")],
)
def test_extrapolation_is_said_and_not_clamped(speed, force, word):
    field, token = load_field(), LIBRARY[0].token
    result = synthesise(field, stroke_of(speed, force, token), seed=0)
    assert np.isfinite(result.signal.samples).all()
    if word is None:
        assert (result.confidence, result.warnings) == (1.0, ())
    else:
        assert result.confidence < 1.0
        assert any(word in warning for warning in result.warnings)


def test_a_strange_token_lowers_confidence():
    token = LIBRARY[0].token.copy()
    token[0] = -1.0
    result = synthesise(load_field(), stroke_of(0.1, 1.0, token), seed=0)
    assert result.confidence < 0.9
    assert any("height of its waves about 8 mm" in warning for warning in result.warnings)


# -- inputs and accumulation -----------------------------------------------------------------------------------------


def test_the_untrained_field_is_the_linear_contact():
    quiet, loud = (
        expected_rms(linear_field(), flat_token(level), Mechanics(5e4, 0.2, 0.3), "pen", ALONG, 0.1, 1.0)
        for level in (-5.5, -4.5)
    )
    assert loud == pytest.approx(10.0 * quiet, rel=0.02)


def test_a_grating_is_felt_across_and_not_along():
    token = grating_token(0.8e-3)
    across, along = (
        expected_rms(linear_field(), token, Mechanics(5e4, 0.2, 0.3), "pen", direction, 0.1, 1.0)
        for direction in (ALONG, ACROSS)
    )
    assert across > 10.0 * along


def test_unknown_mechanics_have_their_own_flag():
    known = build_inputs(condition(mechanics=(Mechanics(5e4, 0.2, 0.3),)), Carriers(), True).x
    unknown = build_inputs(condition(mechanics=(Mechanics(),)), Carriers(), True).x
    # Defaults stand for the values, so exactly the three flags differ.
    assert np.count_nonzero(known != unknown) == 3


def test_inputs_are_finite_at_rest_and_in_the_air():
    inputs = build_inputs(
        condition(
            speed=np.array([0.0, 1e-9, 0.1]), force=np.array([1.0, 1.0, 0.0]), contact=np.array([True, True, False])
        ),
        Carriers(),
        True,
    )
    assert np.isfinite(inputs.x).all()
    assert np.isfinite(inputs.prior).all()
    assert not inputs.gate[0].any()
    assert not inputs.gate[2].any()
    assert inputs.gate[1].max() < 1e-5


def test_emission_is_silent_where_the_gate_is_shut():
    emission = evaluate(linear_field(), condition(speed=np.array([0.0, 0.1])))
    assert not emission.alpha[0].any()
    assert emission.alpha[1].any()


def test_knots_are_read_linearly_between():
    expansion = FieldConfig().expansion()
    assert expansion.shape == (192, 25)
    np.testing.assert_allclose(expansion.sum(axis=1), 1.0, rtol=1e-6)
    np.testing.assert_allclose(expansion @ np.arange(25.0), np.linspace(0.0, 24.0, 192), rtol=1e-5, atol=1e-5)
    assert FieldConfig(arc_knots=0).expansion() is None


def test_accumulation_mixes_past_states_with_their_own_densities():
    config = FieldConfig(hidden=4, layers=1, states=2, spacing_s=0.01)
    rng = np.random.default_rng(0)
    emission = Emission(rng.random((7, 1, config.carriers.count)), rng.random((7, 2)))
    amplitude = accumulate(config, emission)
    i = 5
    near, past = emission.sigma_dt[i, 0], emission.sigma_dt[i - 2, 1]
    expected = (1 - np.exp(-near)) * emission.alpha[i, 0] + np.exp(-near) * (1 - np.exp(-past)) * emission.alpha[
        i - 2, 0
    ]
    np.testing.assert_allclose(amplitude[i, 0], expected, rtol=1e-12)
    first = (1 - np.exp(-emission.sigma_dt[0, 0])) * emission.alpha[0, 0]
    np.testing.assert_allclose(amplitude[0, 0], first, rtol=1e-12)


# -- weights ---------------------------------------------------------------------------------------------------------


def test_weights_come_back_as_they_were_written(tmp_path):
    field = dataclasses.replace(linear_field(), ranges=load_field().ranges, metadata={"seed": "7"})
    path = tmp_path / "w.safetensors"
    save_field(path, field)
    again = load_field(path)
    assert again.config == field.config
    assert again.metadata["seed"] == "7"
    for name, value in field.parameters.items():
        np.testing.assert_array_equal(again.parameters[name], value)
    np.testing.assert_array_equal(again.ranges.token_low, field.ranges.token_low)
    save_field(tmp_path / "again.safetensors", field)
    assert (tmp_path / "again.safetensors").read_bytes() == path.read_bytes()


def test_published_configuration_round_trips(tmp_path):
    config = FieldConfig.published(hidden=8, layers=2)
    path = tmp_path / "w.safetensors"
    save_field(path, Field(config, initial_parameters(config, 0)))
    assert load_field(path).config == config


def rewrite(path, **change):
    """Replace metadata entries of a safetensors file."""
    data = path.read_bytes()
    size = int.from_bytes(data[:8], "little")
    header = json.loads(data[8 : 8 + size])
    header["__metadata__"].update(change)
    text = json.dumps(header).encode()
    path.write_bytes(len(text).to_bytes(8, "little") + text + data[8 + size :])


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"encoder": "alexnet"}, "encoder"),
        ({"format": "something"}, "field weights"),
        ({"architecture": "{"}, "description"),
        ({"architecture": json.dumps({"hidden": 4})}, "description"),
    ],
)
def test_weights_of_another_kind_are_refused(tmp_path, change, word):
    path = tmp_path / "w.safetensors"
    save_field(path, linear_field())
    rewrite(path, **change)
    with pytest.raises(WeightsError, match=word) as caught:
        load_field(path)
    assert "w.safetensors" in str(caught.value)
    assert caught.value.remedy


def test_another_architecture_is_refused(tmp_path):
    path = tmp_path / "w.safetensors"
    save_field(path, dataclasses.replace(linear_field(), config=FieldConfig(hidden=32, layers=2)))
    with pytest.raises(WeightsError, match="architecture"):
        load_field(path)


def test_not_finite_parameters_are_refused(tmp_path):
    field = linear_field()
    broken = {**field.parameters, "skip": field.parameters["skip"] * np.float32(np.nan)}
    save_field(tmp_path / "w.safetensors", dataclasses.replace(field, parameters=broken))
    with pytest.raises(WeightsError, match="finite"):
        load_field(tmp_path / "w.safetensors")


@pytest.mark.parametrize("data", [b"", b"\x00" * 20, b"\xff" * 40, b"pickle"])
def test_damaged_files_are_refused(tmp_path, data):
    path = tmp_path / "w.safetensors"
    path.write_bytes(data)
    with pytest.raises(WeightsError):
        load_field(path)


def test_truncated_weights_are_refused(tmp_path):
    path = tmp_path / "w.safetensors"
    save_field(path, linear_field())
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(WeightsError):
        load_field(path)


def test_missing_weights_are_a_file_error(tmp_path):
    with pytest.raises(FileError):
        load_field(tmp_path / "none.safetensors")


def test_the_encoder_is_named():
    assert read_encoders(load_field().metadata) == (ENCODER_ID,)
