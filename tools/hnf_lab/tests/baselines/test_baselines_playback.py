"""Playback keeps power, finds the action, does not repeat itself; the oracle is the process with another seed."""

import numpy as np
import pytest

from hnf_core.action.primitive_path import make_primitive_action
from hnf_core.action.synthetic_actions import make_random_smooth_action, make_steady_action
from hnf_core.datasets.recording import Recording
from hnf_core.errors import FileError
from hnf_lab.baselines.interface import MaterialRecordings, OracleMethod, render_by_duration
from hnf_lab.baselines.nearest_neighbour import GRAIN_SAMPLES, NearestNeighbour

RATE = 10_000


class Hiss:
    """White noise of RMS 10 v √F; when `directed`, three times as loud along x as along y."""

    name = "hiss"

    def __init__(self, directed=False):
        self.directed = directed

    def record(self, actions, seed):
        out = []
        for index, action in enumerate(actions):
            count = round(action.duration_s * RATE)
            at = np.arange(count) / RATE
            read = [np.interp(at, action.time, each) for each in (action.speed, action.force, action.direction[:, 0])]
            level = 10.0 * read[0] * np.sqrt(read[1]) * float(action.contact.any())
            if self.directed:
                level = level * np.where(np.abs(read[2]) > 0.7, 3.0, 1.0)
            noise = np.random.default_rng([seed, index]).standard_normal(count)
            out.append(Recording(action, level * noise, RATE, self.name, "made up"))
        return out


def specimen(process, seconds=40.0, **known):
    stroke = make_random_smooth_action(seconds, 3, speed_m_s=(0.02, 0.3), force_n=(0.2, 3.0))
    return MaterialRecordings("hiss", tuple(process.record([stroke], 1)))


@pytest.fixture(scope="module")
def fitted():
    return NearestNeighbour().fit(specimen(Hiss()), 0)


def decibel(samples, wanted):
    return 20.0 * np.log10(np.std(samples) / wanted)


@pytest.mark.parametrize(("speed", "force"), [(0.05, 0.5), (0.1, 1.0), (0.2, 2.0)])
def test_playback_conserves_power(fitted, speed, force):
    samples = fitted.render([make_steady_action(8.0, speed, force)], 5)[0]
    assert len(samples) == 8 * RATE
    assert decibel(samples, 10.0 * speed * np.sqrt(force)) == pytest.approx(0.0, abs=0.4)
    # and evenly so: nowhere does a fade leave a hole or a bump
    pieces = np.sqrt(np.mean(np.square(samples.reshape(-1, GRAIN_SAMPLES // 2)), axis=1))
    assert pieces.std() < 0.12 * pieces.mean()


def test_a_whole_recording_played_back_has_its_power():
    process = Hiss()
    recorded = specimen(process)
    played = NearestNeighbour().fit(recorded, 0).render([recorded.recordings[0].action], 7)[0]
    assert decibel(played, recorded.recordings[0].samples.std()) == pytest.approx(0.0, abs=0.4)


def test_it_tells_directions():
    fitted = NearestNeighbour().fit(specimen(Hiss(directed=True), 80.0), 0)
    along, across = fitted.render([make_steady_action(6.0, 0.1, 1.0, angle) for angle in (0.0, np.pi / 2)], 2)
    assert decibel(along, across.std()) == pytest.approx(20.0 * np.log10(3.0), abs=2.0)


def test_directions_that_were_not_recorded_are_not_looked_at():
    known = Hiss().record([make_random_smooth_action(10.0, 1, speed_m_s=(0.02, 0.3), force_n=(0.2, 3.0))], 1)[0]
    assumed = Recording(known.action, known.samples, RATE, "hiss", "made up", frozenset({"speed", "force"}))
    fitted = NearestNeighbour().fit(MaterialRecordings("hiss", (assumed,)), 0)
    one, two = (fitted.render([make_steady_action(2.0, 0.1, 1.0, angle)], 4)[0] for angle in (0.0, 2.0))
    np.testing.assert_array_equal(one, two)


def test_it_does_not_repeat_itself_and_is_deterministic(fitted):
    action = make_steady_action(8.0, 0.1, 1.0)
    first, again, other = (fitted.render([action], seed)[0] for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert abs(np.corrcoef(first, other)[0, 1]) < 0.1
    spectrum = np.fft.rfft(first, 2 * len(first))
    correlation = np.fft.irfft(np.square(np.abs(spectrum)))[: len(first)]
    assert np.abs(correlation[GRAIN_SAMPLES : 4 * RATE]).max() < 0.3 * correlation[0]


def test_rest_and_air_are_silent(fitted):
    rest, air = fitted.render([make_steady_action(1.0, 0.0, 1.0), make_steady_action(1.0, 0.1, 0.0)], 0)
    assert not rest.any()
    assert not air.any()


def test_nothing_to_play_is_said():
    silent = Hiss().record([make_steady_action(2.0, 0.1, 0.0)], 0)
    with pytest.raises(FileError, match="steady speed and force in contact"):
        NearestNeighbour().fit(MaterialRecordings("hiss", tuple(silent)), 0)


def test_the_oracle_is_the_process_with_another_seed():
    process = Hiss()
    actions = [
        make_steady_action(2.0, 0.1, 1.0),
        make_primitive_action("left-right-soft"),
        make_steady_action(2.0, 0.1, 1.0),
    ]
    rendered = OracleMethod(process).fit(specimen(process), 0).render(actions, 1)
    again = OracleMethod(process).fit(specimen(process), 9).render(actions, 1)
    for samples, action, same in zip(rendered, actions, again, strict=True):
        assert len(samples) == round(action.duration_s * RATE)
        np.testing.assert_array_equal(samples, same)
    assert abs(np.corrcoef(rendered[0], process.record(actions[:1], 1)[0].samples)[0, 1]) < 0.05
    assert abs(np.corrcoef(rendered[0], rendered[2])[0, 1]) < 0.05


def test_actions_are_grouped_by_length_and_come_back_in_order():
    actions = [make_steady_action(seconds, 0.1, 1.0) for seconds in (1.0, 2.0, 1.0, 3.0, 2.0)]
    calls = []

    def record(same, group):
        calls.append((len(same), group))
        assert len({len(action.speed) for action in same}) == 1
        return [np.full(3, action.duration_s) for action in same]

    assert [samples[0] for samples in render_by_duration(actions, record)] == [1.0, 2.0, 1.0, 3.0, 2.0]
    assert calls == [(2, 0), (2, 1), (1, 2)]
