"""Each quick part of live synthesis beside its plain reference."""

from contextlib import nullcontext

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from live_strokes import BLOCK, SEED, error, hand, on

from hnf_core.field.carriers import Carriers
from hnf_core.field.contact.contact_filter import TAIL_SAMPLES
from hnf_core.field.field import Field, FieldConfig, evaluate, initial_parameters
from hnf_core.field.linear_contact import (
    FORCE_FLOOR_N,
    SPEED_FLOOR_M_S,
    Condition,
    compute_linear_contact,
    time_band_power,
)
from hnf_core.field.live.carriers import CACHED_BLOCKS, CACHED_HOPS, LiveArcCarriers, LiveTimeCarriers
from hnf_core.field.live.contact_filter import LiveContactFilter, compute_causal_response
from hnf_core.field.live.emission import LiveEmission, LiveLinearContact, TimeBandPower
from hnf_core.field.prepare import prepare_stroke
from hnf_core.field.render import render_contact
from hnf_core.field.weights import load_field
from hnf_core.kernel.loader import without_kernel
from hnf_core.material.contact_model import UNKNOWN_MECHANICS, body_response, force_response
from hnf_core.material.library import load_library
from hnf_core.material.probe import PROBE_NAMES, get_probe
from hnf_core.progress import count_work

LIBRARY = load_library()
ROUNDING = 1e-11


def untrained(**changed) -> Field:
    config = FieldConfig(hidden=16, layers=2, **changed)
    rng = np.random.default_rng(1)
    parameters = {
        name: (value + 0.05 * rng.standard_normal(value.shape)).astype(np.float32)
        for name, value in initial_parameters(config, 3).items()
    }
    return Field(config, parameters)


FIELDS = {
    "shared": load_field(),
    "physics": untrained(),
    "lines and octaves": untrained(line_gains=True, action_octaves=2),
    "no direction": untrained(directed=False, action_octaves=1),
    "one material": untrained(physics=False, action_octaves=3, carriers=Carriers(arc_octaves=0)),
    "one material with tones": untrained(physics=False),
    "linear heads": untrained(emission="linear", physics=False),
}
ANGLE, SPEED = st.floats(-np.pi, np.pi), st.floats(-4.0, 0.7).map(lambda x: 10.0**x)
FORCE, MATERIAL = st.floats(-3.0, 1.3).map(lambda x: 10.0**x), st.sampled_from(LIBRARY)
PROBE = st.sampled_from(sorted(PROBE_NAMES))


def condition(material, mechanics, angle: float, speed: float, force: float, probe: str) -> Condition:
    direction = np.array([[np.cos(angle), np.sin(angle)]])
    one = np.ones(1)
    index, tokens = np.zeros(1, np.int32), material.token[None].astype(float)
    return Condition(tokens, (mechanics,), index, direction, speed * one, force * one, one > 0.0, probe)


def close(found, wanted, tolerance: float = ROUNDING) -> bool:
    return bool(np.max(np.abs(found - wanted)) <= tolerance * max(float(np.max(np.abs(wanted))), 1e-30))


@pytest.mark.parametrize("way", [nullcontext, without_kernel])
def test_a_live_state_evaluates_the_field_once(way):
    material = LIBRARY[0]
    with way():
        emission = LiveEmission(FIELDS["shared"], material.token, material.mechanics, "finger")
        with count_work() as work:
            for speed in (0.0, 0.05, 0.1):
                emission.evaluate((1.0, 0.0), speed, 1.0, contact=speed > 0.0)
    assert work.amounts["states"] == [1, 1, 1]


@settings(max_examples=60, deadline=None)
@given(MATERIAL, ANGLE, SPEED, FORCE, PROBE, st.booleans())
def test_the_linear_contact_of_one_state(material, angle, speed, force, probe, known):
    carriers, mechanics = Carriers(), material.mechanics if known else UNKNOWN_MECHANICS
    speed, force = max(speed, SPEED_FLOOR_M_S), max(force, FORCE_FLOOR_N)
    told = condition(material, mechanics, angle, speed, force, probe)
    wanted = compute_linear_contact(told, carriers)
    turned = float(np.arctan2(told.direction[0, 1], told.direction[0, 0]))
    found = LiveLinearContact(material.token, mechanics, get_probe(probe), carriers).evaluate(turned, speed, force)
    assert close(found.power, wanted.power[0])
    assert close(found.noise, wanted.noise[0])
    assert close(found.lines, wanted.lines.power[:, 0])
    assert close(found.normal, wanted.normal[0])
    assert close(found.resonance, wanted.resonance[0])
    sounding = found.lines.max(axis=0) > 0.0
    inside = sounding & (found.low > -2)
    assert np.array_equal(found.low[inside], wanted.lines.low[0][inside])
    assert close(
        TimeBandPower(carriers).to_time_bands(found.power, speed),
        time_band_power(wanted.power, np.array([speed]), carriers)[0],
    )


@pytest.mark.parametrize("name", FIELDS)
@settings(max_examples=25, deadline=None)
@given(MATERIAL, ANGLE, SPEED, FORCE, PROBE)
def test_the_field_of_one_state(name, material, angle, speed, force, probe):
    told = condition(material, material.mechanics, angle, speed, force, probe)
    wanted = evaluate(FIELDS[name], told)
    emission = LiveEmission(FIELDS[name], material.token, material.mechanics, probe)
    alpha, sigma = emission.evaluate(told.direction[0], speed, force, True)
    assert close(alpha, wanted.alpha[0, 0], 1e-5)
    assert close(sigma, wanted.sigma_dt[0], 1e-5)
    assert not emission.evaluate(told.direction[0], speed, force, False)[0].any()
    assert not emission.evaluate(told.direction[0], 0.0, force, True)[0].any()


@settings(max_examples=30, deadline=None)
@given(st.integers(-20_000, 20_000), st.integers(1, 900))
def test_noise_is_that_of_the_carriers(first, count):
    wanted = CARRIERS.time_samples(SEED, first, count)
    weights = np.linspace(-1.0, 1.0, 2 * NOISE.bands, dtype=np.float32).reshape(2, -1)
    scale = float(np.sqrt(np.square(weights).sum(axis=1).max()))
    assert np.abs(NOISE.mix(weights, first, count) - weights @ wanted).max() < 2e-6 * scale
    assert NOISE.cached_blocks <= CACHED_BLOCKS + 1


CARRIERS = Carriers()
NOISE = LiveTimeCarriers(CARRIERS, SEED)


@pytest.mark.parametrize("alone", [False, True])
@settings(max_examples=30, deadline=None)
@given(st.integers(0, 7), st.integers(-20_000, 20_000), st.sampled_from([-9, -1, 0, 1, 4, 11]))
def test_octaves_are_read_as_the_carriers_are(alone, octave, first, stride):
    """At the carriers' own samples, over the borders of hops, forwards and backwards, compiled and in numpy. A hand
    that hardly moves sees a wave or none, where it may be 52 dB off: it is asked in forty places."""
    rows, share = np.arange(24), np.arange(BLOCK) / BLOCK
    pair = np.zeros((2, 8, 24), dtype=np.float32)
    pair[:, octave] = 1.0 + np.sin(rows), 1.5 + np.cos(rows)
    amplitude = pair[0, octave][:, None] * (1.0 - share) + pair[1, octave][:, None] * share
    missed = []
    for begin in first + 977 * np.arange(40 if abs(stride) < 4 else 1):
        at = int(begin) + stride * np.arange(BLOCK)
        waves = CARRIERS.arc_samples(SEED, octave, int(at.min()), int(np.ptp(at)) + 1)[:, at - at.min()]
        with without_kernel() if alone else nullcontext():
            found = ARC.read(pair, np.array([octave]), at * CARRIERS.arc_step_m(octave))
        missed.append(found - (amplitude * waves).sum(axis=0))
    level = np.sqrt(np.square(pair[:, octave]).sum() / 2)
    assert np.sqrt(np.mean(np.square(missed))) < 10 ** (-57 / 20) * level


ARC = LiveArcCarriers(CARRIERS, SEED)


@pytest.mark.parametrize("speed", [0.02, -0.2, 0.7, 4.0])
def test_noise_lies_ready_where_the_hand_goes(speed):
    noise, arc, place = LiveTimeCarriers(CARRIERS, 1), LiveArcCarriers(CARRIERS, 1), 0.0
    pair, share = np.ones((2, 8, 24), np.float32), np.arange(BLOCK) / BLOCK
    heard = np.flatnonzero(CARRIERS.arc_start_per_m * 2.0 ** np.arange(8) * abs(speed) < 4800.0)
    for sample in range(0, 400 * BLOCK, BLOCK):
        noise.mix(np.zeros((1, noise.bands), np.float32), sample, BLOCK)
        arc.read(pair, heard, place + speed * 0.005 * share)
        place += speed * 0.005
        noise.prepare(sample + BLOCK)
        arc.prepare(place, speed)
    assert (noise.at_once, arc.at_once) == (0, 0)
    assert arc.cached_hops <= 8 * CACHED_HOPS
    assert noise.cached_blocks <= CACHED_BLOCKS + 1


def test_noise_is_made_soon_where_a_hand_jumped():
    arc = LiveArcCarriers(CARRIERS, 1)
    for _ in range(2 * CARRIERS.arc_octaves):  # 5 m lies between two hops of some octaves
        arc.prepare(5.0, 0.1)
    arc.read(np.ones((2, 8, 24), np.float32), np.arange(8), np.full(BLOCK, 5.0))
    assert arc.at_once == 0
    arc.read(np.ones((2, 8, 24), np.float32), np.arange(8), np.full(BLOCK, -5.0))
    assert arc.at_once >= 8


@pytest.mark.parametrize("material", ["oak-wood", "eva-foam", "slate"])
@pytest.mark.parametrize("probe", sorted(PROBE_NAMES))
def test_a_causal_response_answers_as_the_contact_does(material, probe):
    mechanics = next(each.mechanics for each in LIBRARY if each.name == material)
    kernel = compute_causal_response(mechanics, get_probe(probe), 1.0)
    frequency = np.array([5.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 3000.0])
    found = np.exp(-2j * np.pi * frequency[:, None] * np.arange(TAIL_SAMPLES) * 1e-4) @ kernel
    wanted = force_response(frequency, mechanics, get_probe(probe), 1.0)
    # What is left before t = 0 is a share of what the contact passes, so it weighs more where the body lowers that.
    lowered = np.minimum(np.abs(body_response(frequency, get_probe(probe))), 1.0)
    assert (np.abs(20.0 * np.log10(np.abs(found / wanted))) * lowered).max() < 0.1
    # What is late is a quarter of a sample.
    assert np.abs(np.angle(found / wanted) / (2.0 * np.pi * frequency) * 1e4)[1:].max() < 0.5
    assert abs(kernel.sum()) < 1e-9 * np.abs(kernel).sum()


@pytest.mark.parametrize("material", ["oak-wood", "eva-foam"])
def test_pressing_is_that_of_offline_two_states_later(material):
    rng = np.random.default_rng(2)
    swing = np.cumsum(rng.standard_normal(700)) * 0.02
    stroke = on(hand(0.0, lambda t: 1.5 + np.tanh(swing[: len(t)]), seconds=3.0), material)
    pressing = LiveContactFilter(stroke.mechanics, "pen")
    found = np.concatenate([pressing.step(force, 0) for force in stroke.action.force])[2 * BLOCK :]
    wanted = render_contact(prepare_stroke(load_field(), stroke, seed=0), 0, 3 * 10_000)
    assert error(found[TAIL_SAMPLES + 200 :], wanted[TAIL_SAMPLES + 200 : len(found)]) < 0.03


def test_a_touch_forgets_what_rang_before():
    pressing, other = (LiveContactFilter((LIBRARY[0].mechanics,), "pen") for _ in range(2))
    for force in (0.0, 3.0, 1.0, 2.0, 0.0):
        pressing.step(force, 0)
    pressing.reset()
    assert all(np.array_equal(pressing.step(force, 0), other.step(force, 0)) for force in (1.0, 1.5, 1.2))
