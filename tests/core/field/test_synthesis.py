"""Properties of synthesis: blocks, seeds, rest, air, pressing, sample rate, the reference, seams and borders."""

import dataclasses
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from steady_spectra import spectrum_distance_db

from hnf_core.action.action import ACTION_RATE_HZ, Action
from hnf_core.errors import StrokeError, UsageError
from hnf_core.field.carriers import Carriers
from hnf_core.field.field import Field, FieldConfig, initial_parameters
from hnf_core.field.prepare import prepare_stroke
from hnf_core.field.render import render_block, render_carriers
from hnf_core.field.stroke import (
    SAMPLES_PER_STATE,
    HeightProfile,
    StrokeInput,
    interpolate_cubic,
    interpolate_cubic_samples,
    uniform_stroke,
)
from hnf_core.field.synthesis import synthesise
from hnf_core.field.weights import load_field
from hnf_core.material.contact_model import Mechanics
from hnf_core.material.library import get_material
from hnf_core.material.token import BAND_FEATURES, TOKEN_DIM
from hnf_core.metrics.spectra import welch
from hnf_core.simulation.contact_dynamics import SmoothedMaps
from hnf_core.simulation.simulate import Stroke, simulate
from hnf_core.simulation.surface_recipe import SurfaceRecipe, height_map
from hnf_lab.shared_field.simulated_strokes import make_surface
from reference.literal_synthesis import synthesise_reference

WOOD = Mechanics(8e4, 0.15, 0.3)
FOAM = Mechanics(2e3, 0.5, 0.7)


def rough_token(level: float = -5.3, slope: float = -0.25) -> np.ndarray:
    token = np.zeros(TOKEN_DIM, dtype=np.float32)
    for band in range(7):
        token[band * len(BAND_FEATURES)] = level + slope * band
    return token


def linear_field() -> Field:
    """Untrained: the linear contact alone, known in closed form."""
    config = FieldConfig(hidden=16, layers=2)
    return Field(config, initial_parameters(config, 0))


def make_action(speed, force, *, angle: float = 0.0, rate: float = ACTION_RATE_HZ) -> Action:
    speed, force = np.broadcast_arrays(np.asarray(speed, dtype=float), np.asarray(force, dtype=float))
    position = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) / rate)])
    direction = np.tile([np.cos(angle), np.sin(angle)], (len(speed), 1))
    return Action(rate, direction, speed.copy(), force.copy(), position, force > 0.0)


def steady(seconds: float = 1.0, speed: float = 0.1, force: float = 1.0) -> Action:
    return make_action(np.full(round(seconds * ACTION_RATE_HZ) + 1, speed), force)


def bump(seconds: float = 0.5) -> Action:
    t = np.linspace(0.0, 1.0, round(seconds * ACTION_RATE_HZ) + 1)
    return make_action(0.15 * np.sin(np.pi * t) ** 2, 0.2 + 1.5 * np.sin(np.pi * t) ** 2, angle=0.4)


def random_profile(length_m: float, seed: int, rms_m: float = 2e-6) -> HeightProfile:
    step = 25e-6
    count = int(length_m / step)
    kappa = np.fft.rfftfreq(count, step)
    rng = np.random.default_rng(seed)
    gain = np.where(kappa > 0, (1.0 + (kappa / 300.0) ** 2) ** -0.7, 0.0) * (kappa < 1e4)
    height = np.fft.irfft(np.fft.rfft(rng.standard_normal(count)) * gain, count)
    return HeightProfile(step, -2e-3, height * (rms_m / height.std()), 120e-6)


@pytest.mark.parametrize("size", [1, 777, 4096, 5000])
def test_blocks_of_any_size_are_the_whole(size):
    action = bump(0.3)
    stroke = StrokeInput(
        action, rough_token()[None], (WOOD,), np.zeros(len(action.speed), np.int32), random_profile(0.05, 1)
    )
    prepared = prepare_stroke(linear_field(), stroke, seed=4)
    if size == 1:
        whole = render_block(prepared, 1000, 8)
        parts = np.concatenate([render_block(prepared, 1000 + k, 1) for k in range(8)])
    else:
        whole = render_block(prepared, 0, prepared.count)
        parts = np.concatenate(
            [render_block(prepared, k, min(size, prepared.count - k)) for k in range(0, prepared.count, size)]
        )
    assert np.max(np.abs(whole - parts)) < 1e-6 * np.sqrt(np.mean(render_block(prepared, 0, prepared.count) ** 2))


def test_the_same_seed_gives_the_same_bytes_and_another_does_not():
    stroke = uniform_stroke(bump(), rough_token(), WOOD)
    first, again, other = (synthesise(linear_field(), stroke, seed=seed).signal for seed in (5, 5, 6))
    assert first.samples.tobytes() == again.samples.tobytes()
    assert np.corrcoef(first.samples, other.samples)[0, 1] ** 2 < 0.05
    assert first.samples.dtype == np.float32
    assert (first.sample_rate, first.seed, len(first.samples)) == (10_000.0, 5, 5000)


def test_at_rest_the_texture_is_silent_but_pressing_is_not():
    t = np.arange(401) / ACTION_RATE_HZ
    force = 2.0 * np.clip((t - 0.5) / 0.03, 0.0, 1.0) * np.clip((1.5 - t) / 0.03, 0.0, 1.0)
    stroke = uniform_stroke(make_action(np.zeros(401), force), rough_token(), FOAM)
    prepared = prepare_stroke(linear_field(), stroke, seed=0)
    assert not render_carriers(prepared, 0, prepared.count).any()
    samples = synthesise(linear_field(), stroke, seed=0).signal.samples
    onset, hold, release = samples[4800:6000], samples[9000:11_000], samples[14_500:15_500]
    assert np.sqrt(np.mean(onset**2)) > 0.05
    assert np.sqrt(np.mean(release**2)) > 0.05
    assert np.max(np.abs(hold)) < 1e-3 * np.max(np.abs(onset))


def test_in_the_air_there_is_exactly_nothing():
    speed = np.full(401, 0.1)
    force = np.where((np.arange(401) > 150) & (np.arange(401) < 250), 1.0, 0.0)
    samples = synthesise(linear_field(), uniform_stroke(make_action(speed, force), rough_token(), WOOD), seed=0)
    values = samples.signal.samples
    assert not values[: 150 * 50 - 500].any()
    assert not values[250 * 50 + 1000 :].any()
    assert values[150 * 50 : 250 * 50].any()


def test_off_the_surface_counts_as_air_even_with_force():
    action = steady(0.5)
    contact = np.arange(len(action.speed)) < 40
    stroke = uniform_stroke(dataclasses.replace(action, contact=contact), rough_token(), WOOD)
    values = synthesise(linear_field(), stroke, seed=0).signal.samples
    assert values[: 40 * 50].any()
    assert not values[40 * 50 + 1000 :].any()


def test_fast_path_agrees_with_the_literal_reference():
    """Stated error: −40 dB, from reading amplitudes linearly between the samples at which F_Θ is evaluated."""
    stroke = uniform_stroke(bump(0.4), rough_token(), WOOD)
    field = load_field()
    reference = synthesise_reference(field, stroke, seed=2, start=1000, count=1500)
    prepared = prepare_stroke(field, stroke, seed=2)
    fast = render_block(prepared, 1000, 1500)
    error = np.sqrt(np.mean((fast - reference) ** 2) / np.mean(reference**2))
    assert error < 10 ** (-40 / 20)


def test_carriers_on_the_grid_agree_with_their_fourier_sums():
    """With a steady action only the cubic reading of arc carriers differs: −55 dB."""
    stroke = uniform_stroke(steady(0.3), rough_token(), WOOD)
    reference = synthesise_reference(linear_field(), stroke, seed=2, start=1500, count=1000)
    fast = render_block(prepare_stroke(linear_field(), stroke, seed=2), 1500, 1000)
    assert np.sqrt(np.mean((fast - reference) ** 2) / np.mean(reference**2)) < 10 ** (-55 / 20)


def test_the_published_form_is_silent_under_a_smooth_stroke():
    """Finding 1: a pointwise function of a smooth u(t) has no vibration; the same code with carriers has."""
    config = FieldConfig.published(hidden=32)
    literal = Field(config, initial_parameters(config, 3))
    t = np.linspace(0.0, 1.0, 401)
    action = make_action(0.1 + 0.05 * np.sin(2 * np.pi * t), np.full(401, 1.0))
    stroke = uniform_stroke(action, rough_token(), WOOD)
    prepared = prepare_stroke(literal, stroke, seed=0)
    assert prepared.amplitude.shape[1:] == (5, 1)
    samples = render_carriers(prepared, 0, prepared.count)
    assert np.std(samples) > 0.0
    frequency, density = welch(samples - samples.mean(), 10_000.0)
    assert density[frequency >= 30.0].sum() < 1e-4 * density.sum()
    vibrating = render_carriers(prepare_stroke(linear_field(), stroke, seed=0), 0, prepared.count)
    frequency, density = welch(vibrating, 10_000.0)
    assert density[frequency >= 30.0].sum() > 0.9 * density.sum()


def test_published_form_agrees_with_its_reference():
    config = FieldConfig.published(hidden=16)
    literal = Field(config, initial_parameters(config, 3))
    stroke = uniform_stroke(bump(0.3), rough_token(), WOOD)
    reference = synthesise_reference(literal, stroke, seed=0, start=1000, count=500)
    fast = render_block(prepare_stroke(literal, stroke, seed=0), 1000, 500)
    assert np.max(np.abs(fast - reference)) < 0.02 * np.max(np.abs(reference))


@pytest.mark.parametrize("rate", [8000.0, 44_100.0, 48_000.0])
def test_the_output_rate_never_changes_the_touch(rate):
    stroke = uniform_stroke(steady(2.0), rough_token(), WOOD)
    model = synthesise(linear_field(), stroke, seed=1).signal
    other = synthesise(linear_field(), stroke, seed=1, sample_rate=rate).signal
    assert len(other.samples) == round(2.0 * rate)
    # Equal windows in seconds: the same bins of 10 Hz.
    _, first = welch(model.samples, model.sample_rate, 1000)
    _, second = welch(other.samples, rate, round(rate / 10))
    assert spectrum_distance_db(first[1:101], second[1:101]) < 0.05


def test_low_sample_rates_warn_and_invalid_ones_are_refused():
    stroke = uniform_stroke(steady(0.2), rough_token(), WOOD)
    assert any(
        "1000 Hz" in warning for warning in synthesise(linear_field(), stroke, seed=1, sample_rate=1500).warnings
    )
    for rate in (0.0, -1.0, float("nan")):
        with pytest.raises(UsageError):
            synthesise(linear_field(), stroke, seed=1, sample_rate=rate)


def test_the_action_rate_does_not_change_the_touch():
    slow, fast = (make_action(np.full(n, 0.1), 1.0, rate=r) for n, r in ((101, 100.0), (501, 500.0)))
    _, first = welch(synthesise(linear_field(), uniform_stroke(slow, rough_token(), WOOD), seed=1).signal.samples, 1e4)
    _, second = welch(synthesise(linear_field(), uniform_stroke(fast, rough_token(), WOOD), seed=1).signal.samples, 1e4)
    assert spectrum_distance_db(first[1:101], second[1:101]) < 0.3


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(-5.0, 5.0), min_size=1, max_size=30), st.integers(-4000, 4000), st.integers(1, 700))
def test_states_read_at_every_sample_are_read_anywhere(states, start, count):
    values, place = np.array(states), (start + np.arange(count)) / SAMPLES_PER_STATE
    np.testing.assert_allclose(
        interpolate_cubic_samples(values, start, count), interpolate_cubic(values, place), atol=1e-12
    )


def test_a_slow_force_ramp_does_not_hum():
    t = np.arange(401) / ACTION_RATE_HZ
    force = 1.5 + np.sin(2.0 * np.pi * 5.0 * t)
    samples = synthesise(linear_field(), uniform_stroke(make_action(np.zeros(401), force), rough_token(), FOAM), seed=0)
    frequency, density = welch(samples.signal.samples[2000:-2000], 10_000.0)
    assert density[(frequency >= 150.0)].sum() < 1e-3 * density.sum()


def test_profile_on_or_off_leaves_the_average_spectrum():
    """Nothing is counted twice: on a uniform random texture the distance is at most 0.5 dB."""
    material, field, step, angle = get_material("sandpaper"), load_field(), 3e-5, 0.15
    surface = make_surface("sandpaper", height_map(SurfaceRecipe.from_dict(material.recipe), material.seed))
    action = make_action(np.full(1201, 0.05), 2.0, angle=angle)
    # Aslant, so that the 20 mm of the map are not repeated at once.
    way = np.arange(round(0.32 / step)) * step
    height = surface.maps.sample(np.stack([way * np.cos(angle), way * np.sin(angle)], axis=1), 0.0)[0]
    plain = uniform_stroke(action, surface.token, material.mechanics)
    with_profile = dataclasses.replace(plain, profile=HeightProfile(step, 0.0, height, 8e-5))
    spectra = [
        np.mean([welch(synthesise(field, stroke, seed=seed).signal.samples, 1e4)[1] for seed in range(3)], axis=0)
        for stroke in (plain, with_profile)
    ]
    # Third octaves: a realisation of 6 s blurs single bins by more than the law.
    edges = np.geomspace(20.0, 1000.0, 13)
    frequency = np.arange(501) * 10.0
    level = [
        [density[(frequency >= low) & (frequency < high)].mean() for low, high in pairwise(edges)]
        for density in spectra
    ]
    assert spectrum_distance_db(*level) < 0.5
    # And the profile does take part.
    prepared = [prepare_stroke(field, stroke, seed=0) for stroke in (plain, with_profile)]
    power = [np.mean(each.amplitude[:, :, each.carriers.arc_slice] ** 2) for each in prepared]
    assert power[1] < 0.7 * power[0]


def test_landing_on_a_ridge_is_no_blow():
    """The hand presses at rest on top of a wave, slides, and rests again: at rest the height under it gives nothing."""
    speed = np.interp(np.arange(161), [0, 40, 60, 100, 120, 160], [0, 0, 0.1, 0.1, 0, 0])
    force = np.interp(np.arange(161), [0, 20, 140, 160], [0, 1, 1, 0])
    action = make_action(speed, force)
    place = np.arange(0.0, 0.08, 1e-4)
    ridges = HeightProfile(1e-4, 0.0, 100e-6 * np.cos(2 * np.pi * place / 8e-3), 5e-4)
    flat = HeightProfile(1e-4, 0.0, np.zeros(len(place)), 5e-4)
    plain = dataclasses.replace(uniform_stroke(action, rough_token(-4.5), WOOD), profile=flat)
    with_ridges = dataclasses.replace(plain, profile=ridges)
    without, heard = (
        synthesise(linear_field(), stroke, seed=0).signal.samples.astype(np.float64) for stroke in (plain, with_ridges)
    )
    sliding = np.sqrt(np.mean(heard[2500:5500] ** 2))
    assert np.abs(heard[:1900] - without[:1900]).max() < 0.02 * sliding
    # A lift from a flank lets the hand draw the tip along it, as in the simulator, and no more than there.
    wave = 100e-6 * np.cos(2.0 * np.pi * np.arange(512) * (24e-3 / 512) / 8e-3)
    ridged = SmoothedMaps(np.broadcast_to(wave, (512, 512)).astype(np.float32).copy(), size_m=24e-3)
    sample = np.arange(8000) / SAMPLES_PER_STATE
    path = np.stack([interpolate_cubic(action.position, sample), np.zeros(8000)], axis=1)
    stroke = Stroke(path, np.interp(sample, np.arange(161), force))
    level = SmoothedMaps(np.zeros((512, 512), np.float32), size_m=24e-3)
    simulated = simulate(ridged, stroke, WOOD) - simulate(level, stroke, WOOD)
    assert np.abs(heard[6300:] - without[6300:]).max() < np.abs(simulated[6300:]).max()


def test_a_seam_is_felt_where_it_is_seen():
    action = steady(1.0)
    profile = random_profile(0.11, 5, rms_m=2e-6)
    place = profile.origin_m + np.arange(len(profile.height)) * profile.step_m
    seam = dataclasses.replace(profile, height=profile.height + 60e-6 * np.clip((place - 0.05) / 1e-4, 0.0, 1.0))
    stroke = dataclasses.replace(uniform_stroke(action, rough_token(-5.6), WOOD), profile=seam)
    samples = synthesise(linear_field(), stroke, seed=0).signal.samples
    envelope = np.sqrt(np.convolve(np.square(samples), np.ones(200) / 200, mode="same"))
    assert abs(int(np.argmax(envelope)) - 5000) < 200
    assert envelope.max() > 3.0 * np.median(envelope)


def test_no_click_at_a_border_between_materials():
    """A border between two equal materials changes nothing at all; between two levels, no peak beyond the louder."""
    action = steady(1.0)
    index = (np.arange(len(action.speed)) > 100).astype(np.int32)
    one = uniform_stroke(action, rough_token(), WOOD)
    same = StrokeInput(action, np.stack([rough_token()] * 2), (WOOD, WOOD), index)
    np.testing.assert_allclose(
        synthesise(linear_field(), same, seed=1).signal.samples,
        synthesise(linear_field(), one, seed=1).signal.samples,
        atol=1e-5,
    )
    soft, hard = rough_token(-6.0), rough_token(-5.0)
    both = synthesise(linear_field(), StrokeInput(action, np.stack([soft, hard]), (WOOD, WOOD), index), seed=1)
    louder = synthesise(linear_field(), uniform_stroke(action, hard, WOOD), seed=1)
    jump = np.max(np.abs(np.diff(both.signal.samples[4900:5200])))
    assert jump <= 1.05 * np.max(np.abs(np.diff(louder.signal.samples)))
    assert np.std(both.signal.samples[6000:]) > 3.0 * np.std(both.signal.samples[1000:4500])


def test_louder_with_speed_and_roughness():
    def rms(**change):
        level = change.pop("level", -5.3)
        return synthesise(linear_field(), uniform_stroke(steady(**change), rough_token(level), WOOD), seed=0).signal.rms

    assert rms(speed=0.05) < rms() < rms(speed=0.2)
    assert rms(level=-5.0) == pytest.approx(10**0.3 * rms(), rel=0.05)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda s: {"tokens": s.tokens[:, :5]}, "tokens have shape"),
        (lambda s: {"mechanics": ()}, "mechanics"),
        (lambda s: {"token_index": s.token_index[:-1]}, "token_index has shape"),
        (lambda s: {"token_index": s.token_index + 1}, "points outside"),
        (lambda s: {"tokens": s.tokens * np.nan}, "NaN"),
        (lambda s: {"action": dataclasses.replace(s.action, speed=-s.action.speed)}, "negative"),
        (lambda s: {"action": dataclasses.replace(s.action, force=s.action.force[:-1])}, "force has shape"),
        (
            lambda s: {"action": dataclasses.replace(s.action, direction=s.action.direction[:, 0])},
            "direction has shape",
        ),
        (lambda s: {"action": dataclasses.replace(s.action, position=s.action.position[1:])}, "position has shape"),
        (lambda s: {"action": dataclasses.replace(s.action, contact=s.action.contact[:1])}, "contact has shape"),
        (lambda s: {"action": dataclasses.replace(s.action, speed=s.action.speed[:, None])}, "speed has shape"),
        (
            lambda s: {"action": dataclasses.replace(s.action, probe="brush")},
            "no probe 'brush', only pen, finger, rigid-tip and files",
        ),
        (lambda s: {"profile": HeightProfile(0.0, 0.0, np.zeros(4), 1e-4)}, "profile"),
    ],
)
def test_inputs_that_do_not_fit_are_refused_in_words(change, word):
    stroke = uniform_stroke(steady(0.1), rough_token(), WOOD)
    with pytest.raises(StrokeError, match=word):
        dataclasses.replace(stroke, **change(stroke))


def test_an_action_without_duration_is_refused():
    with pytest.raises(StrokeError, match="duration"):
        synthesise(linear_field(), uniform_stroke(make_action([0.1], [1.0]), rough_token(), WOOD), seed=0)


def test_only_time_carriers_or_only_arc_carriers_work():
    for carriers in (Carriers(arc_octaves=0), Carriers(time_edges_hz=())):
        config = FieldConfig(hidden=8, layers=1, carriers=carriers)
        field = Field(config, initial_parameters(config, 0))
        stroke = dataclasses.replace(uniform_stroke(steady(0.3), rough_token(), WOOD), profile=random_profile(0.04, 1))
        result = synthesise(field, stroke, seed=0)
        assert np.isfinite(result.signal.samples).all()
        assert result.signal.rms > 0.0
        assert any("profile" in warning for warning in result.warnings) == (carriers.arc_octaves == 0)
