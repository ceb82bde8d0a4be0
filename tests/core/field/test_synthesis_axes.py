"""Three axes of a stroke: their powers add up to what DFT321 fuses, and one WAV holds them."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.action.synthetic_actions import make_steady_action
from hnf_core.cli.main import main
from hnf_core.errors import UsageError
from hnf_core.export.wav import read_wav_channels
from hnf_core.field.field import Field, FieldConfig, initial_parameters
from hnf_core.field.linear_contact import compute_axis_power, compute_linear_contact
from hnf_core.field.stroke import build_condition, resample_action, uniform_stroke
from hnf_core.field.synthesis import compute_axis_shares, synthesise, synthesise_axes
from hnf_core.field.weights import load_field
from hnf_core.material.library import get_material, load_library
from hnf_core.metrics.spectra import welch

MATERIALS = st.sampled_from([material.name for material in load_library()])


def no_blender(_arguments):
    raise AssertionError("hnf synth needs no Blender")


def make_condition(name, speed, force, angle, probe):
    material = get_material(name)
    stroke = uniform_stroke(make_steady_action(0.1, speed, force, angle, probe), material.token, material.mechanics)
    return build_condition(stroke, *resample_action(stroke))


@settings(max_examples=40, deadline=None)
@given(MATERIALS, st.floats(0.001, 0.5), st.floats(0.02, 10.0), st.floats(0.0, 6.3), st.sampled_from(["pen", "finger"]))
def test_axes_divide_the_power_of_the_linear_contact(name, speed, force, angle, probe):
    field, condition = load_field(), make_condition(name, speed, force, angle, probe)
    axes = compute_axis_power(condition, field.config.carriers)
    assert (axes >= 0.0).all()
    total = compute_linear_contact(condition, field.config.carriers).power
    np.testing.assert_allclose(axes.sum(axis=0), total, rtol=1e-6, atol=1e-9 * total.max() + 1e-30)
    shares = compute_axis_shares(field, condition)
    assert (shares >= 0.0).all()
    np.testing.assert_allclose(shares.sum(axis=0), 1.0, rtol=1e-12)


@pytest.mark.parametrize("name", ["oak-wood", "brick"])
def test_spectra_of_the_axes_add_up_to_the_fused_one(name):
    material = get_material(name)
    stroke = uniform_stroke(make_steady_action(6.0, 0.1, 1.0, 0.4), material.token, material.mechanics)
    fused = synthesise(load_field(), stroke, seed=3).signal.samples
    axes = [each.signal.samples for each in synthesise_axes(load_field(), stroke, seed=3)]
    density = [welch(each[2500:].astype(np.float64), 10_000.0, 500)[1] for each in (fused, *axes)]
    band = slice(2, 50)
    level = 10.0 * np.log10(sum(density[1:])[band] / density[0][band])
    assert abs(level.mean()) < 0.3
    assert np.sqrt(np.mean(level**2)) < 1.0
    assert abs(np.corrcoef(axes[0], axes[2])[0, 1]) < 0.1


def test_a_field_without_the_linear_contact_has_no_axes():
    config = FieldConfig(hidden=8, physics=False)
    material = get_material("denim")
    stroke = uniform_stroke(make_steady_action(0.1, 0.1, 1.0, 0.0), material.token, material.mechanics)
    with pytest.raises(UsageError, match="axes"):
        synthesise_axes(Field(config, initial_parameters(config, 0)), stroke, seed=0)


def test_synth_writes_three_channels_on_request(tmp_path, capsys):
    out = tmp_path / "axes.wav"
    command = ["synth", "--material", "denim", "--stroke", "left-right-hard", "--axes", "--json", "--out", str(out)]
    assert main(command, no_blender) == 0
    record, channels = json.loads(capsys.readouterr().out), read_wav_channels(out)
    assert len(channels) == 3
    power = sum(float(np.mean(np.square(each.samples, dtype=np.float64))) for each in channels)
    assert record["rms_m_s2"] == pytest.approx(np.sqrt(power), rel=1e-5)
    assert "along the normal" in channels[0].provenance["channels"]


def test_axes_with_a_tolerance_are_refused(tmp_path, capsys):
    out = tmp_path / "axes.wav"
    command = ["synth", "--material", "denim", "--stroke", "left-right-hard", "--axes", "--tolerance", "-40"]
    assert main([*command, "--out", str(out)], no_blender) != 0
    assert "--axes" in capsys.readouterr().err
    assert not out.exists()
