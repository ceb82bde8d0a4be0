"""The training recipe: expectations, agreement of torch and numpy, and recovery of the level."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from hnf_core.field import linear_contact as physics
from hnf_core.field.carrier_rendering import sum_arc_carriers
from hnf_core.field.carriers import MODEL_RATE_HZ, Carriers
from hnf_core.field.features import PROBE_KINDS
from hnf_core.field.field import (
    FieldConfig,
    evaluate,
    initial_parameters,
    steady_amplitude,
)
from hnf_core.field.linear_contact import compute_surface_spectrum, project_spectrum
from hnf_core.field.weights import load_field
from hnf_core.material.contact_model import Mechanics
from hnf_core.metrics.spectra import window_power
from hnf_core.simulation import contact_dynamics
from hnf_core.simulation import simulate as simulator
from hnf_core.simulation.surface_recipe import Noise, SurfaceRecipe, height_map, wavenumbers
from hnf_core.training.fit import compute_band_expectation, compute_whittle_loss
from hnf_core.training.model import FieldNetwork
from hnf_core.training.windows import pool_bins
from hnf_lab.shared_field.fit import (
    Likelihood,
    Schedule,
    TrainingSet,
    build_network_inputs,
    build_training_set,
    fit_network,
    make_condition,
    rotate_inputs,
)
from hnf_lab.shared_field.simulated_strokes import (
    SteadyStroke,
    draw_mechanics,
    draw_steady_strokes,
    make_random_surfaces,
    make_speed_grid,
    make_surface,
    record_strokes,
    splice_spectra,
    withhold_mechanics,
)

WOOD = Mechanics(8e4, 0.15, 0.3)


@pytest.fixture(scope="module")
def surfaces():
    return make_random_surfaces(3, 5)


@pytest.fixture(scope="module")
def strokes(surfaces):
    return draw_steady_strokes(surfaces, 16, 6)


@pytest.fixture(scope="module")
def tokens(surfaces):
    return np.stack([surface.token for surface in surfaces])


def test_expected_powers_are_the_mean_of_what_carriers_give():
    carriers = Carriers()
    matrix = compute_band_expectation(carriers.time_edges())
    waves = carriers.time_samples(1, 0, 400_000)
    for band in (0, 1, 20, 49, 53):
        mean = pool_bins(window_power(waves[band], MODEL_RATE_HZ)).mean(axis=0)
        top = matrix[band] > 0.1 * matrix[band].max()
        np.testing.assert_allclose(mean[top], matrix[band][top], rtol=0.2)
        assert mean.sum() == pytest.approx(matrix[band].sum(), rel=0.08)


def test_expected_powers_of_arc_carriers_move_with_speed():
    carriers, speed, band = Carriers(), 0.1, 100
    matrix = compute_band_expectation(carriers.arc_edges()[band : band + 2] * speed)
    amplitude = np.zeros((6001, carriers.arc_count))
    amplitude[:, band] = 1.0
    wave = sum_arc_carriers(
        amplitude, carriers, lambda o, a, n: carriers.arc_samples(2, o, a, n), np.arange(300_000) * speed / 1e4, 0
    )
    mean = pool_bins(window_power(wave, MODEL_RATE_HZ)).mean(axis=0)
    assert np.argmax(mean) == np.argmax(matrix[0])
    assert mean.sum() == pytest.approx(matrix[0].sum(), rel=0.15)


def test_white_noise_has_its_level_in_every_bin():
    power = pool_bins(window_power(np.random.default_rng(0).standard_normal(500_000), 1e4)).mean(axis=0)
    np.testing.assert_allclose(power, 1.0 / 5000.0, rtol=0.15)


def test_the_likelihood_is_least_at_the_mean_power():
    recorded = torch.distributions.Gamma(1.0, 1.0).sample((4000,)) * 3.0
    levels = torch.linspace(1.0, 6.0, 101)
    loss = torch.stack(
        [compute_whittle_loss(level.expand(4000, 1), recorded[:, None], torch.ones(1)).mean() for level in levels]
    )
    assert float(levels[loss.argmin()]) == pytest.approx(float(recorded.mean()), rel=0.03)


def test_one_outlier_pulls_with_bounded_strength():
    expected = torch.tensor([[1.0]], requires_grad=True)
    compute_whittle_loss(expected, torch.tensor([[1e9]]), torch.ones(1)).sum().backward()
    assert torch.isfinite(expected.grad).all()
    assert -25.0 < float(expected.grad) < -15.0


def test_the_torch_twin_equals_numpy(strokes, tokens):
    field = load_field()
    field = replace(field, config=replace(field.config, force_noise=False))  # what torch learns
    rows = [stroke for stroke in strokes if stroke.probe == "pen"]
    condition = make_condition(rows, tokens, [stroke.mechanics for stroke in rows])
    inputs = build_network_inputs(field.config, rows, tokens, [stroke.mechanics for stroke in rows])
    network = FieldNetwork(field.config, field.parameters)
    with torch.no_grad():
        twin = network.compute_steady_amplitude(*(torch.tensor(a, dtype=torch.float32) for a in inputs))
    numpy = steady_amplitude(field.config, evaluate(field, condition))[:, 0]
    np.testing.assert_allclose(twin.numpy(), numpy, rtol=1e-5, atol=1e-7 * numpy.max() + 1e-9)


def test_parameters_survive_the_twin():
    config = FieldConfig(hidden=8, layers=2)
    parameters = initial_parameters(config, 1)
    again = FieldNetwork(config, parameters).to_numpy_parameters()
    assert set(again) == set(parameters)
    for name, value in parameters.items():
        np.testing.assert_array_equal(again[name], value)


def test_turning_inputs_is_turning_surface_and_stroke(strokes, tokens):
    config, angle = FieldConfig(hidden=8, layers=1), 0.7
    data = build_training_set(config, strokes[:4], tokens, np.ones((4, 107)), 1, 0)
    spun_tokens = tokens.copy()
    for band in range(7):
        for offset, fold in ((1, 2), (3, 4)):
            first = band * 7 + offset
            z = (tokens[:, first] + 1j * tokens[:, first + 1]) * np.exp(1j * fold * angle)
            spun_tokens[:, first], spun_tokens[:, first + 1] = z.real, z.imag
    spun_strokes = [
        SteadyStroke(s.surface, s.mechanics, s.probe, s.speed, s.angle + angle, s.force, s.start) for s in strokes[:4]
    ]
    spun = build_training_set(config, spun_strokes, spun_tokens, np.ones((4, 107)), 1, 0)
    np.testing.assert_allclose(rotate_inputs(data.x[0], torch.full((4,), angle)).numpy(), spun.x[0].numpy(), atol=2e-4)
    np.testing.assert_allclose(data.prior[0].numpy(), spun.prior[0].numpy(), atol=1e-3)


def test_fitting_finds_the_level_without_bias(strokes, tokens):
    """Exponential window powers around a known truth: the fit is neither too loud nor too quiet (finding 3)."""
    config = FieldConfig(hidden=16, layers=1)
    data = build_training_set(config, strokes, tokens, np.ones((len(strokes), 107)), 1, 0)
    likelihood = Likelihood(config)
    start = FieldNetwork(config, initial_parameters(config, 0))
    with torch.no_grad():
        truth = 9.0 * likelihood.compute_expected_power(
            start.compute_steady_amplitude(data.x[0], data.prior[0], data.gate), data.speed
        )
    draw = torch.distributions.Exponential(1.0)
    torch.manual_seed(0)
    noisy = TrainingSet(data.x, data.prior, data.gate, data.speed, truth * draw.sample((4, *truth.shape)).mean(dim=0))
    network = fit_network(config, noisy, Schedule(epochs=60, batch=16, learning_rate=5e-3), 0)
    with torch.no_grad():
        found = likelihood.compute_expected_power(
            network.compute_steady_amplitude(data.x[0], data.prior[0], data.gate), data.speed
        )
    bias_db = float(10.0 * torch.log10(found / truth)[:, :100].median())
    assert abs(bias_db) < 0.7


def test_fitting_is_deterministic(strokes, tokens):
    config = FieldConfig(hidden=8, layers=1)
    data = build_training_set(config, strokes, tokens, np.ones((len(strokes), 107)), 2, 0)
    first, again = (fit_network(config, data, Schedule(epochs=2, batch=16), 3).to_numpy_parameters() for _ in range(2))
    for name in first:
        np.testing.assert_array_equal(first[name], again[name])


def test_recording_does_not_depend_on_the_number_of_workers(surfaces, strokes):
    few = strokes[:4]
    np.testing.assert_array_equal(
        record_strokes(surfaces, few, 0.12, workers=1), record_strokes(surfaces, few, 0.12, workers=2)
    )


def test_the_linear_contact_matches_the_simulator_when_linear():
    """A fine surface under a firm load: no hopping. All axes together, in third octaves, within 3 dB."""
    height = height_map(SurfaceRecipe(noise=(Noise(0.4e-6),)), 3)
    surface = make_surface("fine", height)
    speed, force = float(make_speed_grid()[44]), 2.0
    strokes = [
        SteadyStroke(0, WOOD, "pen", 44, angle, force, (0.0, 0.001 * k)) for k, angle in enumerate((0.2, 1.3, 2.4, 4.0))
    ]
    mean = record_strokes([surface], strokes, 0.6, workers=1).mean(axis=0)[:100]
    condition = make_condition(strokes[:1], surface.token[None], [WOOD])
    carriers = Carriers()
    power = physics.compute_linear_contact(condition, carriers).power[0]
    expected = power @ compute_band_expectation(carriers.arc_edges() * speed)[:, :100]
    edges = np.unique(np.geomspace(3, 60, 8).astype(int))
    level = [10 * np.log10(expected[a:b].mean() / mean[a:b].mean()) for a, b in pairwise(edges)]
    assert np.max(np.abs(level)) < 3.0


def test_the_cut_of_a_described_surface_is_its_profile_spectrum():
    height = height_map(SurfaceRecipe(noise=(Noise(3e-6, stretch=1.0),)), 8).astype(float)
    surface = make_surface("iso", height.astype(np.float32))
    carriers = Carriers()
    predicted = project_spectrum(
        compute_surface_spectrum(surface.token[None], np.array([[1.0, 0.0]]), carriers), np.ones((1, 192)), carriers
    )[0]
    spectrum = 2.0 * np.mean(np.square(np.abs(np.fft.rfft(height, axis=1))), axis=0) / height.shape[1] ** 2
    kappa = np.fft.rfftfreq(height.shape[1], 20e-3 / height.shape[1])
    for low in (200.0, 400.0, 800.0, 1600.0, 3200.0):
        inside = (kappa >= low) & (kappa < 2 * low)
        bands = (carriers.arc_centres() >= low) & (carriers.arc_centres() < 2 * low)
        assert abs(10 * np.log10(predicted[bands].sum() / spectrum[inside].sum())) < 2.0


def test_constants_are_the_simulators():
    for name in ("ASPERITY_SHARE", "FLANK_FRICTION"):
        owner = contact_dynamics if hasattr(contact_dynamics, name) else simulator
        assert getattr(physics, name) == getattr(owner, name)


def test_spliced_maps_take_long_and_short_waves_from_each_input(surfaces):
    low, high = surfaces[0].maps.height, surfaces[2].maps.height
    mixed = np.abs(np.fft.rfft2(splice_spectra(low, high, 1000.0)))
    kx, ky = wavenumbers(512, 20e-3)
    below = np.hypot(kx, ky) < 1000.0
    np.testing.assert_allclose(mixed[below], np.abs(np.fft.rfft2(low))[below], rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(mixed[~below], np.abs(np.fft.rfft2(high))[~below], rtol=1e-3, atol=1e-6)


def test_conditions_cover_their_ranges_and_withhold_mechanics(strokes):
    rng = np.random.default_rng(0)
    assert {stroke.probe for stroke in strokes} == set(PROBE_KINDS)
    drawn = [draw_mechanics(WOOD, rng) for _ in range(200)]
    near = [0.5 < m.stiffness_n_m / WOOD.stiffness_n_m < 2.0 for m in drawn]
    assert 0.5 < np.mean(near) < 0.9
    unknown = np.mean([withhold_mechanics(WOOD, rng).friction is None for _ in range(2000)])
    assert 0.28 < unknown < 0.42
