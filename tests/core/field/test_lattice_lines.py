"""Spectral lines and noise: their sum is the linear contact, a gain scales one line, and torch equals numpy."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from steady_spectra import steady_amplitudes

from hnf_core.errors import WeightsError
from hnf_core.field.carriers import ARC_PER_OCTAVE, Carriers
from hnf_core.field.contact.lattice_lines import (
    LINE_COUNT,
    LINE_GAIN_COUNT,
    SpectralLines,
    compute_line_power,
    encode_line_prior,
)
from hnf_core.field.features import build_inputs
from hnf_core.field.field import Field, FieldConfig, evaluate, initial_parameters, steady_amplitude
from hnf_core.field.linear_contact import Condition, compute_linear_contact
from hnf_core.field.weights import load_field, save_field
from hnf_core.material.contact_model import Mechanics
from hnf_core.material.library import get_material

CONFIG = FieldConfig(hidden=8, layers=1, line_gains=True)
WOVEN = ("denim", "knurled-metal", "corduroy", "oak-wood")


def condition() -> Condition:
    rng = np.random.default_rng(3)
    angle, count = rng.uniform(0.0, 2.0 * np.pi, 40), 40
    material = np.arange(count, dtype=np.int32) % len(WOVEN)
    entries = [get_material(name) for name in WOVEN]
    return Condition(
        tokens=np.stack([entries[m].token for m in material]).astype(np.float64),
        mechanics=tuple(entry.mechanics for entry in entries),
        material=material,
        direction=np.stack([np.cos(angle), np.sin(angle)], axis=1),
        speed=np.exp(rng.uniform(np.log(0.01), np.log(0.4), count)),
        force=rng.uniform(0.2, 4.0, count),
        contact=np.ones(count, dtype=bool),
        probe="pen",
    )


def test_noise_and_tones_together_are_the_whole_contact():
    linear, carriers = compute_linear_contact(condition(), Carriers()), Carriers()
    tones = compute_line_power(
        np.zeros((40, LINE_GAIN_COUNT)), encode_line_prior(linear.lines), carriers.arc_count, 6.0
    )
    # Harmonics start at −25 and −30 dB of a tone.
    assert np.all(linear.noise + tones >= 0.999 * linear.power)
    # Of a line below the carriers only the harmonics are heard.
    heard = ((linear.lines.low >= 0) | (linear.lines.power.sum(axis=0) == 0.0)).all(axis=1)
    assert heard.sum() > 20
    lines = (linear.power - linear.noise).sum(axis=1)
    assert tones.sum(axis=1)[heard] == pytest.approx(lines[heard], rel=0.006, abs=1e-7)


def test_untrained_line_gains_barely_change_the_power():
    plain = dataclasses.replace(CONFIG, line_gains=False)
    power = [
        np.square(steady_amplitude(config, evaluate(Field(config, initial_parameters(config, 0)), condition()))).sum()
        for config in (CONFIG, plain)
    ]
    assert power[0] == pytest.approx(power[1], rel=0.01)


def test_a_gain_moves_its_own_tone_and_nothing_else():
    power = np.zeros((2, 1, LINE_COUNT))
    power[0, 0, 3], power[0, 0, 5] = 1.0, 4.0
    low = np.full((1, LINE_COUNT), -100)
    low[0, 3], low[0, 5] = 40, 90
    gains = np.zeros((1, LINE_GAIN_COUNT))
    before = compute_line_power(gains, encode_line_prior(SpectralLines(power, low)), 192, 6.0)[0]
    gains[0, 3] = np.log(10.0)
    after = compute_line_power(gains, encode_line_prior(SpectralLines(power, low)), 192, 6.0)[0]
    changed = np.flatnonzero(np.abs(after - before) > 1e-9)
    np.testing.assert_array_equal(changed, [40, 41])
    assert (before[40], after[40], after[90]) == pytest.approx((1.0, 100.0, 4.0), rel=1e-6)
    assert before[40 + ARC_PER_OCTAVE] == pytest.approx(10.0**-2.5, rel=1e-6)
    assert before[40 + 38] == pytest.approx(10.0**-3.0, rel=1e-6)


def test_tones_out_of_reach_are_dropped():
    low = np.array([[-1, 191, 192, 500, -30] + [0] * (LINE_COUNT - 5)])
    out = compute_line_power(
        np.zeros((1, LINE_GAIN_COUNT)), encode_line_prior(SpectralLines(np.ones((2, 1, LINE_COUNT)), low)), 192, 6.0
    )
    assert np.isfinite(out).all()
    assert out[0, 191] == pytest.approx(1.0, rel=0.02)


def test_the_torch_twin_equals_numpy():
    torch = pytest.importorskip("torch")
    from hnf_core.training.model import FieldNetwork

    parameters = {
        name: value + np.random.default_rng(1).normal(0.0, 0.05, value.shape).astype(np.float32)
        for name, value in initial_parameters(CONFIG, 2).items()
    }
    inputs = build_inputs(condition(), CONFIG.carriers, True, line_gains=True)
    with torch.no_grad():
        twin = FieldNetwork(CONFIG, parameters).compute_steady_amplitude(
            *(torch.tensor(a, dtype=torch.float32) for a in (inputs.x, inputs.prior, inputs.gate))
        )
    numpy = steady_amplitude(CONFIG, evaluate(Field(CONFIG, parameters), condition()))[:, 0]
    np.testing.assert_allclose(twin.numpy(), numpy, rtol=1e-4, atol=1e-6 * numpy.max())


def test_the_stroke_frame_depends_on_relative_angle_only():
    framed = dataclasses.replace(CONFIG, stroke_frame=True)
    still, turned = condition(), condition()
    angle, tokens = 0.7, turned.tokens.copy()
    for band in range(7):
        for offset, fold in ((1, 2), (3, 4)):
            first = band * 7 + offset
            moment = (tokens[:, first] + 1j * tokens[:, first + 1]) * np.exp(1j * fold * angle)
            tokens[:, first], tokens[:, first + 1] = moment.real, moment.imag
    spin = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    turned = dataclasses.replace(turned, tokens=tokens, direction=turned.direction @ spin)
    back = dataclasses.replace(still, direction=-still.direction)
    x = [build_inputs(c, framed.carriers, True, stroke_frame=True).x for c in (still, turned, back)]
    # The linear contact rounds angles to its grid.
    np.testing.assert_allclose(x[1], x[0], atol=5e-3)
    np.testing.assert_allclose(x[1][:, :49], x[0][:, :49], atol=1e-6)
    np.testing.assert_allclose(x[2], x[0], atol=5e-3)
    plain = [build_inputs(c, framed.carriers, True).x for c in (still, turned)]
    assert np.abs(plain[0] - plain[1]).max() > 0.1


def test_line_gain_weights_round_trip_and_bad_ones_are_refused(tmp_path):
    path = tmp_path / "w.safetensors"
    save_field(path, Field(CONFIG, initial_parameters(CONFIG, 0)))
    entry = get_material("denim")
    assert load_field(path).config == CONFIG
    assert np.isfinite(
        steady_amplitudes(load_field(path), entry.token, Mechanics(), "finger", (1.0, 0.0), 0.1, 1.0)
    ).all()
    wrong = dataclasses.replace(CONFIG, physics=False)
    save_field(path, Field(wrong, initial_parameters(wrong, 0)))
    with pytest.raises(WeightsError):
        load_field(path)
