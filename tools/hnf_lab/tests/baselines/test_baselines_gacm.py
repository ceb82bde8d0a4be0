"""GACM rebuilt: Griffin–Lim converges, and the network learns the mean magnitude but no directions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

torch = pytest.importorskip("torch")

from hnf_core.action.synthetic_actions import make_random_smooth_action, make_steady_action
from hnf_core.datasets.recording import Recording
from hnf_core.errors import UsageError
from hnf_core.material.contact_model import UNKNOWN_MECHANICS
from hnf_core.material.token import TOKEN_DIM
from hnf_core.metrics.spectra import welch
from hnf_lab.baselines.gacm import (
    FrameSize,
    Gacm,
    GacmSingleMaterial,
    compute_inconsistency,
    compute_magnitudes,
    compute_stft,
    get_recent_action,
    overlap_add,
    run_griffin_lim,
)
from hnf_lab.baselines.interface import MaterialRecordings

RATE = 10_000
SHAPES = ((100, 25), (250, 62), (64, 32))


def hiss(level, seed, *, seconds=20.0, directed=False):
    """Noise below 400 Hz of RMS level · v / 0.1; with `directed`, nothing but where the hand moves along x."""
    action = make_random_smooth_action(seconds, seed, speed_m_s=(0.03, 0.3), force_n=(0.2, 3.0))
    spectrum = np.fft.rfft(np.random.default_rng(seed).standard_normal(round(seconds * RATE)))
    spectrum[np.fft.rfftfreq(round(seconds * RATE), 1.0 / RATE) > 400.0] = 0.0
    noise = np.fft.irfft(spectrum)
    speed = np.interp(np.arange(len(noise)) / RATE, action.time, action.speed)
    samples = level * noise / noise.std() * speed / 0.1
    if directed:
        samples *= np.abs(np.interp(np.arange(len(noise)) / RATE, action.time, action.direction[:, 0])) > 0.7
    return Recording(action, samples, RATE, "hiss", "made up")


def token(value):
    return np.full(TOKEN_DIM, value, dtype=np.float32)


@pytest.fixture(scope="module")
def shared():
    """A loud and a quiet material."""
    specimens = [
        MaterialRecordings("loud", (hiss(3.0, 1),), token(1.0)),
        MaterialRecordings("quiet", (hiss(0.1, 2),), token(-1.0)),
    ]
    return Gacm(steps=500).fit(specimens, 0)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from(SHAPES))
def test_short_time_and_overlap_add_are_inverse(seed, shape):
    window, hop = shape
    samples = np.random.default_rng(seed).standard_normal(window + 12 * hop)
    back = overlap_add(compute_stft(samples, window, hop), window, hop)
    np.testing.assert_allclose(back[1:-1], samples[1:-1], atol=1e-6)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from(SHAPES))
def test_griffin_lim_never_gets_less_consistent(seed, shape):
    window, hop = shape
    rng = np.random.default_rng(seed)
    magnitude = np.abs(rng.standard_normal((14, window // 2 + 1)))
    signal = rng.standard_normal(window + 13 * hop)
    misses = [compute_inconsistency(magnitude, signal, window, hop)]
    for _ in range(12):
        signal = run_griffin_lim(magnitude, window, hop, 1, signal)
        misses.append(compute_inconsistency(magnitude, signal, window, hop))
    assert np.all(np.diff(misses) <= 1e-9 * misses[0])
    assert misses[-1] < misses[0]


def test_griffin_lim_keeps_a_signal_that_is_consistent_already():
    signal = np.sin(0.3 * np.arange(400.0))
    magnitude = np.abs(compute_stft(signal, 100, 25))
    np.testing.assert_allclose(run_griffin_lim(magnitude, 100, 25, 5, signal)[1:-1], signal[1:-1], atol=1e-6)


def test_gacm_is_given_no_direction():
    along, across = (make_steady_action(1.0, 0.1, 1.0, angle) for angle in (0.0, 1.3))
    at = np.linspace(0.1, 0.9, 5)
    np.testing.assert_array_equal(get_recent_action(along, at), get_recent_action(across, at))


def test_gacm_cannot_tell_directions():
    """Its law, and its limit: the recording vibrates along x only, and the same signal comes out both ways."""
    fitted = GacmSingleMaterial(steps=50).fit(
        MaterialRecordings("directed", (hiss(1.0, 3, seconds=10.0, directed=True),)), 0
    )
    along, across = (fitted.render([make_steady_action(1.0, 0.1, 1.0, angle)], 4)[0] for angle in (0.0, np.pi / 2))
    np.testing.assert_array_equal(along, across)
    assert along.std() > 0.1


@pytest.mark.parametrize(("value", "level"), [(1.0, 3.0), (-1.0, 0.1)])
def test_it_learns_the_mean_magnitude_of_each_material(shared, value, level):
    """π/4 of the power, since E|X|² = 4/π (E|X|)² for noise; and louder where the hand is faster."""
    fitted = shared.for_material(token(value), UNKNOWN_MECHANICS)
    slow, fast = fitted.render([make_steady_action(6.0, 0.07, 1.0), make_steady_action(6.0, 0.14, 1.0)], 1)
    power = np.var(fast) / (level * 1.4) ** 2
    assert 10.0 * np.log10(power) == pytest.approx(10.0 * np.log10(np.pi / 4.0), abs=1.2)
    assert 20.0 * np.log10(fast.std() / slow.std()) == pytest.approx(6.0, abs=1.5)


def test_improved_it_keeps_the_power_and_reaches_above_500_hz():
    recorded = hiss(1.0, 5)
    broad = Recording(
        recorded.action, np.random.default_rng(0).standard_normal(len(recorded.samples)), RATE, "white", "made up"
    )
    plain, improved = (
        GacmSingleMaterial(better, steps=300)
        .fit(MaterialRecordings("white", (broad,)), 0)
        .render([make_steady_action(4.0, 0.1, 1.0)], 0)[0]
        for better in (False, True)
    )
    frequency, density = welch(plain, RATE)
    _, wide = welch(improved, RATE)
    exact = 2.0 / RATE
    low, high = (frequency > 50.0) & (frequency < 400.0), (frequency > 600.0) & (frequency < 1000.0)
    assert 10.0 * np.log10(wide[low].mean() / exact) == pytest.approx(0.0, abs=0.5)
    assert 10.0 * np.log10(wide[high].mean() / exact) == pytest.approx(0.0, abs=0.5)
    assert 10.0 * np.log10(density[low].mean() / exact) == pytest.approx(-1.05, abs=0.5)
    assert density[high].mean() < 1e-3 * exact


def test_gacm_depends_on_the_seed_and_is_silent_without_contact(shared):
    fitted = shared.for_material(token(1.0), UNKNOWN_MECHANICS)
    actions = [make_steady_action(1.0, 0.1, 1.0), make_steady_action(0.5, 0.1, 0.0)]
    first, again, other = (fitted.render(actions, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first[0], again[0])
    assert not np.array_equal(first[0], other[0])
    assert [len(samples) for samples in first] == [10_000, 5_000]
    assert not first[1].any()


def test_measured_magnitudes_have_the_published_size():
    start, magnitude = compute_magnitudes(hiss(1.0, 1, seconds=2.0), FrameSize(1000.0))
    assert magnitude.shape == (39, 51)
    np.testing.assert_allclose(np.diff(start), 0.05)


def test_a_material_without_a_picture_is_refused_by_name():
    with pytest.raises(UsageError, match="'unseen' has no token"):
        Gacm(steps=1).fit([MaterialRecordings("unseen", (hiss(1.0, 1, seconds=1.0),))], 0)
