"""A hand's events → states → samples: even where events are not, silent where the hand is, and the same bytes."""

import itertools
import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from live_strokes import error

from hnf_core.actuators.live_source import MAX_CLOCK_ERROR_S, LiveSource
from hnf_core.errors import FileError, MaterialError, UsageError
from hnf_core.field.live.hand_tracker import (
    FORCE_STATES,
    LONGEST_GAP_S,
    SPEED_STATES,
    STATE_S,
    WINDOW_S,
    HandEvent,
    HandTracker,
    LiveState,
)
from hnf_core.field.live.synthesis import create_live_synthesis
from hnf_core.material.hnf_file import from_library, write_hnf
from hnf_core.material.library import get_material

GAPS = st.lists(st.floats(0.004, 0.03), min_size=12, max_size=40)


def steps(hand: HandTracker, events: list[HandEvent], until_s: float) -> list[LiveState]:
    """States every 5 ms, each told the events up to it."""
    waiting, states = list(events), []
    for time_s in np.arange(0.0, until_s, STATE_S):
        while waiting and waiting[0].time_s <= time_s:
            hand.push(waiting.pop(0))
        states.append(hand.state(float(time_s)))
    return states


@settings(max_examples=40, deadline=None)
@given(GAPS, st.floats(-3.1, 3.1), st.floats(0.005, 2.0))
def test_a_steady_hand_is_steady_however_its_events_come(gaps, angle, speed):
    times = np.cumsum(gaps)
    events = [HandEvent(t, speed * t * np.cos(angle), speed * t * np.sin(angle), 1.0) for t in times.tolist()]
    states = steps(HandTracker(), events, float(times[-1]))
    settled = states[int((times[1] + (SPEED_STATES + 1) * STATE_S) / STATE_S) + 1 :]
    # A gap twice as long as all before it is a hand that rests, as far as anybody can know.
    even = [s for s in settled if max(gaps) < 1.5 * min(gaps)]
    for state in even:
        assert state.speed == pytest.approx(speed, rel=1e-9)
        assert state.direction == pytest.approx((np.cos(angle), np.sin(angle)), abs=1e-6)
    assert all(state.speed <= speed * (1.0 + 1e-9) for state in states)


def test_even_events_of_a_mouse_give_an_even_path():
    rng = np.random.default_rng(0)
    times = np.cumsum(rng.uniform(0.008, 0.0119, 100))
    states = steps(HandTracker(), [HandEvent(t, 0.1 * t, 0.0, 1.0) for t in times.tolist()], 0.9)
    speeds = np.array([state.speed for state in states[20:]])
    assert np.allclose(speeds, 0.1, rtol=1e-9)
    assert np.allclose(np.diff([state.position for state in states[20:]]), 0.1 * STATE_S, rtol=1e-6)


def test_a_hand_that_stands_still_comes_to_rest():
    times = np.arange(0.0, 0.3, 0.01)
    states = steps(HandTracker(), [HandEvent(t, 0.2 * t, 0.0, 1.0) for t in times.tolist()], 0.6)
    rest = int((times[-1] + LONGEST_GAP_S + WINDOW_S + SPEED_STATES * STATE_S) / STATE_S) + 2
    speeds = np.array([state.speed for state in states])
    assert np.all(np.diff(speeds[int(times[-1] / STATE_S) + 1 :]) <= 1e-12)
    assert np.all(speeds[rest:] < 1e-12)
    assert all(state.contact for state in states)
    assert states[-1].direction == (1.0, 0.0)


def test_force_is_even_and_a_touch_begins_at_its_own():
    hand = HandTracker()
    hand.push(HandEvent(0.0, 0.0, 0.0, 2.0))
    assert hand.state(0.0).force == 2.0
    hand.push(HandEvent(0.006, 0.0, 0.0, 1.0))
    forces = [hand.state(STATE_S * (k + 1)).force for k in range(FORCE_STATES + 1)]
    assert forces == sorted(forces, reverse=True)
    assert forces[0] < 2.0
    assert forces[-1] == 1.0
    hand.push(HandEvent(0.1, 0.0, 0.0, 0.0))
    assert hand.state(0.1).contact is False
    hand.push(HandEvent(0.2, 0.5, 0.0, 0.7))
    touched = hand.state(0.2)
    assert (touched.force, touched.speed, touched.contact) == (0.7, 0.0, True)


def test_a_jump_is_no_motion():
    hand = HandTracker()
    for k in range(5):
        hand.push(HandEvent(0.01 * k, 0.001 * k, 0.0, 1.0))
        hand.state(0.01 * k)
    place = hand.state(0.045).position
    hand.push(HandEvent(0.05, 300.0, 0.0, 3.0))
    states = [hand.state(0.05 + STATE_S * k) for k in range(20)]
    assert {(state.speed, state.position, state.force) for state in states} == {(0.0, place, 3.0)}


def test_a_material_is_one_of_those_that_there_are():
    hand = HandTracker()
    for material, materials, wanted in ((3, None, 3), (3, 2, 1), (0, 1, 0), (3, 0, 0), (-2, 4, 0)):
        hand.push(HandEvent(0.0, 0.0, 0.0, 1.0, material))
        assert hand.state(0.0, materials=materials).material == wanted


@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.tuples(st.floats(-1e3, 1e3), st.floats(-1e7, 1e7), st.floats(-1e7, 1e7), st.floats(0.0, 1e7)), max_size=30
    )
)
def test_whatever_a_hand_does_its_states_are_such(events):
    """LiveState refuses what is none."""
    hand, place = HandTracker(), 0.0
    for k, event in enumerate(events):
        hand.push(HandEvent(*event))
        state = hand.state(k * STATE_S)
        assert state.position >= place
        assert np.hypot(*state.direction) == pytest.approx(1.0)
        place = state.position


def recorded(seed: int = 4, *, shift_s: float = 0.0, seconds: float = 0.6) -> LiveSource:
    """A hand that was recorded, all told beforehand: it rubs, and lifts."""
    live = LiveSource(create_live_synthesis("denim", "oak-wood", seed=seed), clock=None)
    rng, time_s = np.random.default_rng(1), 0.0
    while time_s < seconds:
        place = (0.05 * np.sin(9.0 * time_s), 0.03 * np.cos(5.0 * time_s))
        live.move(time_s + shift_s, place, 1.0 + 0.3 * np.sin(20.0 * time_s), int(time_s > 0.4))
        time_s += float(rng.uniform(0.008, 0.016))
    live.lift(time_s + shift_s)
    return live


WHOLE = 8000


def read_all(live: LiveSource, cuts) -> np.ndarray:
    pieces, count = [], 0
    while count < WHOLE:
        pieces.append(live.read(min(next(cuts), WHOLE - count)))
        count += len(pieces[-1])
    return np.concatenate(pieces)


REFERENCE = read_all(recorded(), itertools.repeat(50))


@settings(max_examples=5, deadline=None)
@given(st.lists(st.integers(0, 700), min_size=1, max_size=9).filter(any))
def test_the_same_hand_gives_the_same_bytes_however_it_is_read(cuts):
    found = read_all(recorded(), itertools.cycle(cuts))
    assert found.dtype == np.float32
    assert found.shape == (WHOLE, 1)
    assert np.array_equal(found, REFERENCE)


def test_what_it_plays_is_there_and_ends_with_the_hand():
    assert np.sqrt(np.mean(np.square(REFERENCE[1000:6000]))) > 0.05
    assert np.all(REFERENCE[6000 + 200 + 700 :] == 0.0)
    assert not np.array_equal(read_all(recorded(5), itertools.repeat(50)), REFERENCE)


def test_its_clock_may_start_anywhere():
    shifted = read_all(recorded(shift_s=4096.0), itertools.repeat(50))
    # Times are rounded otherwise; which of a lattice's two axes comes first hangs on the last bit in places.
    assert error(shifted, REFERENCE) < 0.01


def test_what_is_no_number_is_held():
    live, told = recorded(), recorded()
    for bad in (float("nan"), float("inf"), 1e9):
        live.move(0.1, (bad, 0.0), 1.0)
        live.move(0.1, (0.0, 0.0), bad)
    live.move(float("nan"), (0.0, 0.0), 1.0)
    live.move(0.1, (0.0, 0.0), -1.0)
    live.move(0.1, (0.0, 0.0), 1.0, 2)
    assert live.rejected_events == 9
    assert np.array_equal(live.read(WHOLE), told.read(WHOLE))


class Clock:
    """Told by hand."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def drive(live: LiveSource, clock: Clock, blocks: int, jitter: np.ndarray, hand_from: float = 7.0) -> list[np.ndarray]:
    """Blocks asked for every 5 ms, give or take; a hand of 100 mm/s, of another clock, that says so every 9 ms."""
    out, told = [], 0
    for block in range(blocks):
        while 0.009 * told <= 0.005 * block:
            clock.now = 100.0 + 0.009 * told
            live.move(hand_from + 0.009 * told, (0.1 * 0.009 * told, 0.0), 1.0)
            told += 1
        clock.now = 100.0 + 0.005 * block + float(jitter[block % len(jitter)])
        out.append(live.read(50))
    return out


def test_the_first_sample_of_a_move_is_in_the_next_block():
    clock = Clock()
    live = LiveSource(create_live_synthesis("denim", seed=0), clock=clock)
    assert not np.concatenate([live.read(50) for _ in range(4)]).any()
    drive(live, clock, 60, np.zeros(1))
    heard = live.pop_event_timings()
    assert [each.frame % 50 for each in heard] == [0] * len(heard)
    # Told at 0, 9, 18 … ms, made at 0, 10, 20 … ms: never later than a state.
    waits = [(each.frame - 200) * 1e-4 - (each.moved_s - 100.0) for each in heard]
    assert min(waits) > -1e-9
    assert max(waits) < STATE_S
    assert live.latency_p99_ms <= 5.0
    assert live.pop_event_timings() == []


def test_a_ragged_stream_does_not_shake_the_hand():
    rng = np.random.default_rng(3)
    speeds = []
    for jitter in (np.zeros(1), rng.uniform(0.0, 0.004, 200)):
        clock = Clock()
        live = LiveSource(create_live_synthesis("denim", seed=0), clock=clock)
        speeds.append(np.concatenate(drive(live, clock, 150, jitter)))
    # The samples' clock runs on its own: even bytes are the same, as the events that each state knew are.
    assert np.array_equal(speeds[0], speeds[1])


def test_a_paused_stream_goes_on_with_the_hand_of_now():
    clock = Clock()
    live = LiveSource(create_live_synthesis("denim", seed=0), clock=clock)
    drive(live, clock, 40, np.zeros(1))
    clock.now += 10.0 + MAX_CLOCK_ERROR_S
    after = np.concatenate([live.read(50) for _ in range(100)])
    assert np.all(after[3000:] == 0.0)  # it has stood still


def test_other_materials_under_the_same_hand():
    live, time_s, out = LiveSource(create_live_synthesis("denim", seed=1), clock=None), 0.0, []
    for block in range(160):
        live.move(time_s, (0.15 * time_s, 0.0), 1.0)
        if block == 80:
            live.set_synthesis(create_live_synthesis("slate", seed=1))
        out.append(live.read(50))
        time_s += STATE_S
    samples = np.concatenate(out)[:, 0]
    assert np.sqrt(np.mean(samples[4000:4200] ** 2)) > 1e-3
    largest = max(np.abs(np.diff(samples[1000:4000])).max(), np.abs(np.diff(samples[5000:])).max())
    assert np.abs(np.diff(samples[3900:4800])).max() < 1.5 * largest


def test_a_hand_and_a_stream_in_two_threads():
    live, stop = LiveSource(create_live_synthesis("denim", seed=1)), threading.Event()

    def hand() -> None:
        for k in itertools.count():
            live.move(0.002 * k, (0.0002 * k, 0.0), 1.0)
            if stop.wait(0.001):
                return

    thread = threading.Thread(target=hand)
    thread.start()
    try:
        blocks = [live.read(73) for _ in range(200)]
    finally:
        stop.set()
        thread.join()
    assert all(block.shape == (73, 1) and np.isfinite(block).all() for block in blocks)
    live.end()
    assert len(live.read(1000)) < 50


def test_a_material_by_name_by_file_and_as_it_is(tmp_path):
    known = get_material("oak-wood")
    path = tmp_path / "mine.hnf"
    write_hnf(path, from_library(known))
    state = LiveState((1.0, 0.0), 0.2, 0.001, 1.0, True)
    wanted = None
    for given_as in ("Oak wood", known, path, str(path), from_library(known)):
        synthesis = create_live_synthesis(given_as, seed=2)
        block = np.concatenate([synthesis.step(state) for _ in range(5)])
        wanted = block if wanted is None else wanted
        assert block.any()
        assert np.array_equal(block, wanted)
    with pytest.raises(MaterialError, match="no library material"):
        create_live_synthesis("unobtainium")
    with pytest.raises(FileError, match="cannot be read"):
        create_live_synthesis(tmp_path / "none.hnf")
    with pytest.raises(UsageError, match="nothing to touch"):
        create_live_synthesis()
