"""L_mag as published, and the literal HNF, which is silent under a smooth stroke (finding 1)."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

torch = pytest.importorskip("torch")

from hnf_core.action.synthetic_actions import make_random_smooth_action
from hnf_core.datasets.recording import Recording
from hnf_core.errors import UsageError
from hnf_core.field.field import (
    FieldConfig,
    initial_parameters,
)
from hnf_core.material.contact_model import UNKNOWN_MECHANICS
from hnf_core.material.token import TOKEN_DIM
from hnf_core.training.model import FieldNetwork
from hnf_lab.baselines.interface import MaterialRecordings
from hnf_lab.baselines.published_hnf import (
    PublishedHnf,
    build_window_batch,
    compute_l_mag,
    cut_windows,
    predict_windows,
)

RATE = 10_000
TOKEN = np.zeros(TOKEN_DIM, dtype=np.float32)
SMALL = FieldConfig.published(hidden=32)


def texture(seconds=5.0, seed=1):
    action = make_random_smooth_action(seconds, seed, speed_m_s=(0.03, 0.3), force_n=(0.2, 3.0))
    speed = np.interp(np.arange(round(seconds * RATE)) / RATE, action.time, action.speed)
    noise = np.random.default_rng(seed).standard_normal(len(speed))
    return Recording(action, 10.0 * speed * np.convolve(noise, np.ones(8) / 8.0, "same"), RATE, "noise", "made up")


def plain_l_mag(predicted, recorded, bins):
    """The formula, term by term, with a DFT written out."""
    n = np.arange(1000)
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * n / 1000.0)
    total = 0.0
    for a, b in zip(predicted, recorded, strict=True):
        for k in range(1, bins + 1):
            wave = window * np.exp(-2j * np.pi * k * n / 1000.0)
            total += (abs(np.sum(wave * a)) - abs(np.sum(wave * b))) ** 2
    return total / (len(predicted) * bins)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 4), st.sampled_from((1, 7, 100)))
def test_l_mag_is_the_formula(seed, count, bins):
    a, b = np.random.default_rng(seed).standard_normal((2, count, 1000))
    value = compute_l_mag(torch.from_numpy(a), torch.from_numpy(b), bins)
    assert float(value) == pytest.approx(plain_l_mag(a, b, bins), rel=1e-9)


def test_l_mag_hears_10_to_1000_hz_and_no_phase():
    n = np.arange(1000) / RATE
    silence = torch.zeros(1, 1000, dtype=torch.float64)

    def tone(hz, phase=0.0):
        return torch.from_numpy(np.sin(2.0 * np.pi * hz * n + phase))[None]

    assert float(compute_l_mag(tone(1100.0), silence)) < 1e-20
    assert float(compute_l_mag(torch.ones(1, 1000, dtype=torch.float64) * 5.0, silence, 100)) == pytest.approx(
        plain_l_mag(np.full((1, 1000), 5.0), np.zeros((1, 1000)), 100)
    )
    assert float(compute_l_mag(tone(200.0), silence)) > 100.0
    assert float(compute_l_mag(tone(200.0), tone(200.0, 1.0))) < 1e-9


def test_l_mag_checks_window_length_and_has_a_finite_gradient():
    with pytest.raises(ValueError, match="1000"):
        compute_l_mag(torch.zeros(1, 500), torch.zeros(1, 500))
    silent = torch.zeros(2, 1000, requires_grad=True)
    compute_l_mag(silent, torch.ones(2, 1000)).backward()
    assert torch.isfinite(silent.grad).all()


def test_evaluation_at_the_action_rate_equals_every_sample():
    """A network of the published shape needs no finer rate, since a smooth action has no detail between its samples."""
    windows = cut_windows([texture(2.0)], 2.0)[:4]
    network = FieldNetwork(SMALL, initial_parameters(SMALL, 3))
    rows = torch.arange(4)
    with torch.no_grad():
        every, states = (
            predict_windows(network, build_window_batch(windows, TOKEN, UNKNOWN_MECHANICS, SMALL, step), rows)
            for step in (1, 50)
        )
    assert every.shape == (4, 1000)
    assert float((every - states).abs().max()) < 1e-2 * float(every.abs().max())


def test_windows_are_ten_in_a_row_and_spread_over_all_recordings():
    recordings = [texture(5.0, seed) for seed in (1, 2, 3)]
    windows = cut_windows(recordings, 3.0)
    assert len(windows) == 30
    assert {id(action) for action, _, _ in windows} == {id(recording.action) for recording in recordings}
    for low in range(0, 30, 10):
        starts = [start for _, start, _ in windows[low : low + 10]]
        assert np.all(np.diff(starts) == 1000)


def test_literal_hnf_is_silent_under_a_smooth_stroke():
    """Trained on 4 s, judged on the same stroke: 30 dB below the texture between 20 and 1000 Hz."""
    recorded = texture(4.0)
    fitted = PublishedHnf(SMALL, epochs=15).fit(MaterialRecordings("noise", (recorded,)), 0)
    samples = fitted.render([recorded.action], 0)[0]
    assert len(samples) == len(recorded.samples)
    window = np.hanning(len(samples))
    band = slice(round(20.0 * 4.0), round(1000.0 * 4.0))
    powers = [np.sum(np.square(np.abs(np.fft.rfft(window * each)[band]))) for each in (samples, recorded.samples)]
    assert powers[0] < 1e-3 * powers[1]
    np.testing.assert_array_equal(samples, fitted.render([recorded.action], 99)[0])


def test_a_second_is_the_least_and_the_rate_is_checked():
    with pytest.raises(UsageError, match="8/1/1"):
        cut_windows([texture(0.5)], 20.0)
    slow = texture(2.0)
    with pytest.raises(UsageError, match="5000 Hz"):
        cut_windows([Recording(slow.action, slow.samples[::2], 5000.0, "noise", "made up")], 20.0)
