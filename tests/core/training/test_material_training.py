"""Training of one material's field from recordings: splits, likelihood, resuming, and convergence."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

torch = pytest.importorskip("torch", reason="training needs the extra [train]")

from steady_spectra import expected_spectrum

from hnf_core.action.synthetic_actions import make_circular_action, make_random_smooth_action, make_steady_action
from hnf_core.datasets.recording import Recording
from hnf_core.errors import UsageError
from hnf_core.field.carriers import Carriers
from hnf_core.field.field import (
    Field,
    FieldConfig,
    initial_parameters,
)
from hnf_core.field.stroke import uniform_stroke
from hnf_core.field.synthesis import synthesise
from hnf_core.material.contact_model import UNKNOWN_MECHANICS
from hnf_core.material.token import TOKEN_DIM
from hnf_core.metrics.spectra import WINDOW_SAMPLES
from hnf_core.training.fit import load_checkpoint
from hnf_core.training.from_recordings import (
    TrainingOverrides,
    choose_config,
    make_fine_carriers,
    train_from_recordings,
)
from hnf_core.training.model import FieldNetwork
from hnf_core.training.train_material import (
    RenderedPower,
    Schedule,
    build_rendered_inputs,
    make_speed_table,
    train_material,
)
from hnf_core.training.windows import HOP, ROLES, TRAIN, cut_windows, find_role_runs

RATE = 10_000.0
NO_TOKEN = np.zeros(TOKEN_DIM, dtype=np.float32)
SMALL = FieldConfig(hidden=32, layers=2, states=1, carriers=make_fine_carriers(), physics=False, action_octaves=1)
SHORT = Schedule(epochs=4, batches=4, batch=64)


def noise_recording(action, seed: int, slope: float = 1.0) -> Recording:
    """White noise through one real pole, as loud as the action is fast: a process whose spectrum is known."""
    count = round(action.duration_s * RATE)
    rng = np.random.default_rng(seed)
    white, out, last = rng.standard_normal(count), np.zeros(count), 0.0
    for index in range(count):
        last = 0.8 * last + white[index]
        out[index] = last
    speed = np.interp(np.arange(count) / RATE, action.time, action.speed)
    return Recording(action, out * (speed / 0.1) ** slope, RATE, "noise", f"noise {seed}", frozenset({"speed"}))


def noise_density(frequency, speed: float, slope: float = 1.0):
    return 2.0 / RATE / np.abs(1.0 - 0.8 * np.exp(-2j * np.pi * frequency / RATE)) ** 2 * (speed / 0.1) ** (2 * slope)


def wander(seconds: float, seed: int):
    return make_random_smooth_action(seconds, seed, speed_m_s=(0.03, 0.2), force_n=(0.3, 3.0))


@pytest.fixture(scope="module")
def minute() -> list[Recording]:
    return [noise_recording(wander(5.0, seed), seed) for seed in range(12)]


@given(st.integers(0, 1000), st.integers(0, 60))
def test_split_is_8_1_1_of_every_ten_windows_and_covers_all(first: int, count: int) -> None:
    stretches = find_role_runs(first, count)
    covered = [(slot, role) for role, low, high in stretches for slot in range(low, high)]
    assert [slot for slot, _ in covered] == list(range(count))
    assert all(role == ROLES[(first + slot) % 10] for slot, role in covered)


def test_no_window_crosses_a_border(minute: list[Recording]) -> None:
    _, windows = cut_windows(minute[:2])
    states_per_slot = WINDOW_SAMPLES // 50
    assert windows.node.shape[1] == 1
    for role, node in zip(windows.role, windows.node[:, 0], strict=True):
        start = node - states_per_slot // 2  # the middle state stands for the window
        local = start - windows.first[node]
        low, high = local // states_per_slot, -(-(local + states_per_slot) // states_per_slot)
        offset = 0 if windows.first[node] == 0 else 50
        assert {ROLES[(offset + slot) % 10] for slot in range(low, high)} == {role}
    # 8 slots hold 15 half-overlapping windows, the others one each
    assert np.bincount(windows.role).tolist() == [150, 10, 10]
    assert HOP * 2 == WINDOW_SAMPLES


def test_reversed_windows_are_trained_ones_with_the_hand_turned(minute: list[Recording]) -> None:
    """As if each recording were played backward; what validates and tests stays as it is."""
    states, windows = cut_windows(minute[:3])
    both, more = cut_windows(minute[:3], add_reversed=True)
    count, trained = len(windows.role), np.flatnonzero(windows.role == TRAIN)
    assert np.bincount(more.role).tolist() == [2 * len(trained), *np.bincount(windows.role)[1:]]
    np.testing.assert_array_equal(more.power[count:], windows.power[trained])
    np.testing.assert_array_equal(more.node[:count], windows.node)
    before, after = windows.node[trained], more.node[count:][:, ::-1]
    np.testing.assert_allclose(both.direction[after], -states.direction[before])
    for name in ("speed", "force", "contact"):
        np.testing.assert_array_equal(getattr(both, name)[after], getattr(states, name)[before])
    # Its past is what came after, within the same recording.
    for past in (1, 10):
        earlier = more.node[count:] - past
        alive = earlier >= more.first[more.node[count:]]
        later = windows.node[trained][:, ::-1] + past
        inside = later < len(states.speed)
        same = inside & (windows.first[np.minimum(later, len(states.speed) - 1)] == windows.first[later - past])
        np.testing.assert_array_equal(alive, same)
        np.testing.assert_array_equal(both.speed[earlier][alive], states.speed[later[alive]])


def test_augmenting_needs_a_direction_and_says_what_it_did(minute: list[Recording]) -> None:
    small = TrainingOverrides(hidden=8, layers=1, epochs=1, augment=True)
    with pytest.raises(UsageError, match="none was recorded"):
        train_from_recordings(minute[:2], "own", "", 0, small)
    known = [dataclasses.replace(each, known=frozenset({"speed", "direction"})) for each in minute[:2]]
    trained, record = train_from_recordings(known, "own", "", 0, small)
    assert "each training window backward too, in the opposite direction" in record["notes"]
    assert "backward" in trained.field.metadata["training_data"]
    plain, unchanged = train_from_recordings(known, "own", "", 0, dataclasses.replace(small, augment=None))
    assert unchanged["notes"] == []
    assert record["test"]["windows"] == unchanged["test"]["windows"]
    assert not np.array_equal(plain.history, trained.history)


def test_short_recordings_train_and_too_short_ones_are_refused(minute: list[Recording]) -> None:
    pieces = [noise_recording(make_steady_action(0.3, 0.1, 1.0), seed) for seed in range(10)]
    assert set(cut_windows(pieces)[1].role) == {0, 1, 2}
    with pytest.raises(UsageError, match="leave nothing to validate on"):
        cut_windows(pieces[:1])
    finger = dataclasses.replace(minute[0], action=dataclasses.replace(minute[0].action, probe="finger"))
    with pytest.raises(UsageError, match="2 probes"):
        cut_windows([minute[0], finger])


def test_bands_above_a_low_rate_are_not_heard_and_not_played() -> None:
    action = wander(10.0, 0)
    samples = np.random.default_rng(0).standard_normal(round(action.duration_s * 1000))
    slow = Recording(action, samples, 1000.0, "slow", "slow")
    _, windows = cut_windows([slow])
    assert windows.counted_bins[:44].all()
    assert not windows.counted_bins[46:].any()
    field = train_material([slow], SMALL, 0, schedule=SHORT).field
    high = expected_spectrum(
        field, NO_TOKEN, UNKNOWN_MECHANICS, "pen", (1.0, 0.0), 0.1, 1.0, np.linspace(600.0, 4900.0, 200)
    )
    low = expected_spectrum(
        field, NO_TOKEN, UNKNOWN_MECHANICS, "pen", (1.0, 0.0), 0.1, 1.0, np.linspace(50.0, 400.0, 200)
    )
    assert high.max() < 1e-4 * low.mean()


def circle(seed: int) -> Recording:
    recording = noise_recording(make_circular_action(5.0, 0.1, 1.0, 0.02), seed)
    return dataclasses.replace(recording, known=frozenset({"speed", "direction"}))


def test_a_turning_hand_is_looked_at_more_than_once_in_a_window() -> None:
    windows = cut_windows([circle(0), circle(1)])[1]
    assert windows.node.shape[1] == 5
    assert windows.node_weight.sum() == pytest.approx(1.0)
    assert np.all(np.abs(windows.node - windows.node[:, 2:3]) <= 8)


@pytest.mark.parametrize(
    "config",
    [
        dataclasses.replace(SMALL, states=3, accumulation="past"),
        dataclasses.replace(SMALL, states=3, accumulation="heads", spacing_s=0.0),
        dataclasses.replace(SMALL, carriers=Carriers(arc_octaves=2, arc_start_per_m=800.0), arc_knots=5),
    ],
    ids=["past", "heads", "arc"],
)
def test_expected_power_is_what_synthesis_gives(config: FieldConfig) -> None:
    parameters = initial_parameters(config, 3)
    field = Field(config, parameters)
    action = make_random_smooth_action(30.0, 1, speed_m_s=(0.05, 0.15), force_n=(0.5, 2.0), bandwidth_hz=0.3)
    signal = synthesise(field, uniform_stroke(action, NO_TOKEN, UNKNOWN_MECHANICS), seed=1).signal
    states, windows = cut_windows([Recording(action, signal.samples.astype(np.float64), RATE, "own", "own")])
    inputs = build_rendered_inputs(config, states, windows, NO_TOKEN, UNKNOWN_MECHANICS)
    expected, _ = RenderedPower(config, make_speed_table(states))(
        FieldNetwork(config, parameters), inputs, torch.arange(len(windows.role))
    )
    level = 10.0 * np.log10(expected.detach().numpy().mean(axis=0) / windows.power.mean(axis=0))
    # 500 windows: a fine bin scatters by 4.34 / sqrt(500) = 0.2 dB, more where tones pass
    assert np.sqrt(np.mean(level[3:100] ** 2)) < 0.6
    assert abs(np.mean(level[3:100])) < 0.15


def test_learns_a_known_process(minute: list[Recording]) -> None:
    trained = train_material(minute, SMALL, 0, schedule=Schedule(epochs=25, batches=8))
    assert trained.test.l_mag_share == pytest.approx(1.0 - np.pi / 4.0, abs=0.02)
    field = trained.field
    frequency = np.arange(20.0, 1000.0, 10.0)
    for speed in (0.05, 0.1, 0.15):
        found = expected_spectrum(field, NO_TOKEN, UNKNOWN_MECHANICS, "pen", (0.0, 1.0), speed, 1.0, frequency)
        error = 10.0 * np.log10(found / noise_density(frequency, speed))
        assert np.sqrt(np.mean(error**2)) < 0.8
        assert abs(error.mean()) < 0.5


def test_a_field_that_never_heard_of_direction_ignores_it(minute: list[Recording]) -> None:
    trained, record = train_from_recordings(
        minute[:2], "hatt", "none", 0, TrainingOverrides(hidden=16, layers=1, epochs=1)
    )
    assert not trained.field.config.directed
    frequency = np.arange(20.0, 1000.0, 10.0)
    across, along = (
        expected_spectrum(trained.field, NO_TOKEN, UNKNOWN_MECHANICS, "pen", d, 0.1, 1.0, frequency)
        for d in ((1.0, 0.0), (0.0, -1.0))
    )
    np.testing.assert_array_equal(across, along)
    assert record["material"] == "noise"
    assert record["test"]["windows"] == 10


def test_memory_is_learned_only_where_strokes_can_tell_of_it(minute: list[Recording]) -> None:
    time = minute[0].action.time
    rubbing = dataclasses.replace(
        minute[0].action, speed=0.1 * np.abs(np.sin(6.0 * time)), direction=np.sign(np.sin(6.0 * time + 1e-3))[:, None]
        * np.array([1.0, 0.0]),
    )  # fmt: skip
    turning = dataclasses.replace(minute[0], action=rubbing)
    assert choose_config(minute, arc=False, token_known=False).states == 1
    assert choose_config([circle(0)], arc=False, token_known=False).states == 1
    assert choose_config([*minute, turning], arc=False, token_known=False).states == 5
    assert choose_config([turning], arc=True, token_known=True).accumulation == "past"


def test_same_seed_same_weights_other_seed_others(minute: list[Recording]) -> None:
    first, again, other = (train_material(minute[:2], SMALL, seed, schedule=SHORT) for seed in (0, 0, 1))
    for name, value in first.field.parameters.items():
        np.testing.assert_array_equal(value, again.field.parameters[name])
    assert any(not np.array_equal(first.field.parameters[n], other.field.parameters[n]) for n in first.field.parameters)


class KilledError(Exception):
    pass


def test_a_killed_run_goes_on_to_the_same_bytes(minute: list[Recording], tmp_path) -> None:
    path = tmp_path / "run.checkpoint"

    def kill(epoch: int, epochs: int, loss: float) -> None:
        if epoch == 2:
            raise KilledError

    with pytest.raises(KilledError):
        train_material(minute[:2], SMALL, 0, schedule=SHORT, checkpoint=path, watch=kill)
    assert path.exists()
    seen: list[int] = []
    resumed = train_material(
        minute[:2], SMALL, 0, schedule=SHORT, checkpoint=path, watch=lambda epoch, epochs, loss: seen.append(epoch)
    )
    whole = train_material(minute[:2], SMALL, 0, schedule=SHORT)
    assert seen == [3, 4]
    assert not path.exists()
    np.testing.assert_array_equal(resumed.history, whole.history)
    for name, value in whole.field.parameters.items():
        np.testing.assert_array_equal(value, resumed.field.parameters[name])


def test_foreign_and_damaged_checkpoints_are_ignored(minute: list[Recording], tmp_path) -> None:
    path = tmp_path / "run.checkpoint"

    def kill(epoch: int, epochs: int, loss: float) -> None:
        raise KilledError

    with pytest.raises(KilledError):
        train_material(minute[:2], SMALL, 0, schedule=SHORT, checkpoint=path, watch=kill)
    seen: list[int] = []
    train_material(
        minute[:2], SMALL, 1, schedule=SHORT, checkpoint=path, watch=lambda epoch, epochs, loss: seen.append(epoch)
    )
    assert seen[0] == 1
    for junk in (b"", b"\x00" * 8, b"not a checkpoint"):
        path.write_bytes(junk)
        assert load_checkpoint(path, "any") is None
    assert load_checkpoint(tmp_path / "none", "any") is None


def test_early_stopping_keeps_the_best_epoch(minute: list[Recording]) -> None:
    schedule = Schedule(epochs=60, batches=8, batch=64, learning_rate=0.02, smoothness=0.0, decay=0.0, patience=3)
    trained = train_material(minute[:1], SMALL, 0, schedule=schedule)
    best = int(np.argmin(trained.history[:, 2]))
    assert len(trained.history) == best + 1 + 4 < 60
    states, windows = cut_windows(minute[:1])
    assert np.isfinite(trained.test.loss)
    assert np.sum(windows.role == TRAIN) == 75
    assert len(states.speed) == len(minute[0].action.speed)
