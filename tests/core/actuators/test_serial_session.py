"""Flow control and fault detection of the host from a device's messages and its own clock, without a port."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.actuators.serial_protocol import NO_TEMPERATURE, Caps, Credit, Error, ErrorCode, State, Status
from hnf_core.actuators.sinks.serial_session import (
    CREDIT_TIMEOUT_S,
    MAX_READ_GAP_S,
    STUCK_TIMEOUT_S,
    ClockRateMonitor,
    SerialSession,
)

RATE, QUEUE = 8000, 120
CAPS = Caps(1, 16, 16, 1000, 48_000, 720, 32767, 2048, "a device")


def credit(played: int, state: State = State.PLAYING, session: int = 7) -> Credit:
    return Credit(session, played & 0xFFFFFFFF, QUEUE, 0, state)


def begun(sent: int = 0) -> SerialSession:
    """A session whose first CREDIT has come at 0 s."""
    session = SerialSession("PORT", caps=CAPS)
    session.begin(7, RATE, 0.0)
    session.handle_messages([credit(0, State.WAITING)], 0.0)
    session.sent = sent
    return session


@given(st.lists(st.tuples(st.integers(0, QUEUE), st.integers(0, QUEUE)), max_size=60), st.integers(0, 3))
@settings(deadline=None)
def test_sent_frames_never_exceed_the_queue_if_credits_are_lost(steps: list[tuple[int, int]], heard: int) -> None:
    session, played = begun(), 0
    for at, (wish, plays) in enumerate(steps):
        session.sent += min(wish, session.sendable_frames)
        assert session.sent - played <= QUEUE
        played += min(plays, session.sent - played)
        if at % (heard + 1) == 0:
            session.handle_messages([credit(played)], 0.001 * at)
            assert session.pending_frames == session.sent - played
            assert session.sendable_frames == QUEUE - session.pending_frames
    assert session.problem is None or "Hz" in str(session.problem)


def test_totals_wrap() -> None:
    session = begun()
    session.played = 2**32 - 10
    session.sent = 2**32 + 100
    session.handle_messages([credit(2**32 + 50)], 0.0)
    assert (session.played, session.pending_frames, session.sendable_frames) == (2**32 + 50, 50, QUEUE - 50)


def test_a_device_that_says_nothing_is_gone() -> None:
    session, now = begun(), 0.0
    while session.problem is None:
        now += 0.02
        session.check_timeouts(now)
    assert "does not answer" in str(session.problem)
    assert "PORT" in str(session.problem)
    assert now == pytest.approx(CREDIT_TIMEOUT_S, abs=0.03)


def test_a_device_that_plays_nothing_of_what_it_has_is_stuck() -> None:
    session, now = begun(sent=50), 0.0
    while session.problem is None:
        now += 0.002
        session.handle_messages([credit(0, State.WAITING)], now)
        session.check_timeouts(now)
    assert "takes no more samples" in str(session.problem)
    assert now == pytest.approx(STUCK_TIMEOUT_S, abs=0.01)


def test_a_device_that_is_owed_nothing_may_wait_for_ever() -> None:
    session = begun()
    for at in range(5000):
        session.handle_messages([credit(0, State.WAITING)], 0.002 * at)
        session.check_timeouts(0.002 * at)
    assert session.problem is None


def test_what_we_did_not_read_in_our_sleep_is_no_silence() -> None:
    session = begun(sent=50)
    session.check_timeouts(0.9)
    assert session.problem is None
    session.handle_messages([credit(20)], 0.9 + MAX_READ_GAP_S)
    session.check_timeouts(0.9 + MAX_READ_GAP_S)
    assert session.problem is None


@pytest.mark.parametrize(
    ("messages", "words"),
    [
        ([credit(0, session=9)], "plays for another program"),
        ([CAPS], "restarted, or another program"),
        ([Error(ErrorCode.BUSY, "Somebody plays.")], "another program speaks"),
        ([Error(ErrorCode.SESSION, "Whose?")], "another program speaks"),
        ([Error(ErrorCode.HOT, "Too hot: let it cool."), credit(0, State.FAULT)], "Too hot: let it cool."),
        ([credit(0, State.FAULT)], "a fault"),
        ([Error(ErrorCode.HARDWARE, "")], "error 11"),
        ([Error(99, "of a later version")], "of a later version"),
        ([credit(30)], "30 frames that it never got"),
    ],
)
def test_what_ends_a_stream(messages: list[Caps | Credit | Error], words: str) -> None:
    session = begun()
    session.handle_messages(messages, 0.0)
    assert words in str(session.problem)
    first = session.problem
    session.handle_messages([Error(ErrorCode.HARDWARE, "and another")], 0.0)
    assert session.problem is first
    assert session.to_sink_status().problem == str(first)


def test_only_a_line_that_loses_most_samples_is_a_problem() -> None:
    for lost_of_100, told in ((40, False), (60, True)):
        session = begun(sent=10**6)
        for at in range(60):
            played = RATE // 10 * at
            session.handle_messages(
                [credit(played), Status(0, 0, played * lost_of_100 // 100, 0, 250, State.PLAYING)], 0.1 * at
            )
        assert (session.problem is not None) == told
        assert not told or "damaged on the way" in str(session.problem)


def test_what_does_not() -> None:
    session = begun(sent=50)
    session.unanswered_hellos = 2  # said three times to a device that was still starting
    session.handle_messages(
        [CAPS, CAPS, Error(ErrorCode.OVERRUN, "?"), Error(ErrorCode.MALFORMED, "?"), credit(5)], 0.0
    )
    assert session.problem is None
    session.damaged = 3
    assert session.to_sink_status().errors == 5


def test_credits_of_the_session_before_are_not_ours() -> None:
    session = begun(sent=100)
    session.handle_messages([credit(80)], 0.0)
    session.begin(8, RATE, 0.0)
    session.handle_messages([credit(100)], 0.0)
    assert (session.credit, session.sendable_frames, session.problem) == (None, 0, None)
    session.handle_messages([credit(0, State.WAITING, session=8)], 0.0)
    assert session.sendable_frames == QUEUE
    assert session.to_sink_status().played == 80


def test_status_is_told_in_our_units() -> None:
    session = begun()
    assert session.to_sink_status().temperature_c is None
    session.handle_messages([Status(2, 3, 4, 5, 315, State.PLAYING)], 0.0)
    told = session.to_sink_status()
    assert (told.underruns, told.errors, told.limited, told.temperature_c) == (2, 7, 5, 31.5)
    session.handle_messages([Status(2, 3, 4, 5, NO_TEMPERATURE, State.PLAYING)], 0.0)
    assert session.to_sink_status().temperature_c is None


@given(st.floats(0.97, 1.03), st.floats(0.0, 0.05), st.integers(0, 2**32 - 1))
@settings(deadline=None)
def test_an_honest_device_is_believed(speed: float, late_s: float, seed: int) -> None:
    """However late, within 50 ms, its credits are read."""
    import random

    watch, drawn = ClockRateMonitor(RATE), random.Random(seed)
    for at in range(3000):
        played_s = 0.01 * at
        assert watch.update(played_s + drawn.uniform(0.0, late_s), int(played_s * RATE * speed)) is None


@given(st.one_of(st.floats(0.5, 0.92), st.floats(1.08, 2.0)), st.floats(0.0, 0.01), st.integers(0, 2**32 - 1))
@settings(deadline=None)
def test_a_liar_is_found_within_three_seconds(speed: float, late_s: float, seed: int) -> None:
    import random

    watch, drawn = ClockRateMonitor(RATE), random.Random(seed)
    for at in range(300):
        played_s = 0.01 * at
        found = watch.update(played_s + drawn.uniform(0.0, late_s), int(played_s * RATE * speed))
        if found is not None:
            assert found == pytest.approx(RATE * speed, rel=0.1)
            return
    pytest.fail("believed")


@given(st.lists(st.floats(0.05, 0.8), min_size=40, max_size=80), st.sampled_from([1.0, 0.8, 1.25]))
@settings(deadline=None)
def test_gaps_are_neither_a_lie_nor_its_hiding_place(pieces: list[float], speed: float) -> None:
    """A device that starves again and again: only the time in which it played counts."""
    watch, now, played, found = ClockRateMonitor(RATE), 0.0, 0, []
    for piece in pieces:
        for _ in range(int(piece * 100)):
            now, played = now + 0.01, played + int(0.01 * RATE * speed)
            found.append(watch.update(now, played))
        watch.end_segment()
        now += 0.3
    told = [rate for rate in found if rate is not None]
    assert bool(told) == (speed != 1.0)
    assert all(rate == pytest.approx(RATE * speed, rel=0.02) for rate in told)


def test_a_clock_that_goes_wrong_later_is_found_too() -> None:
    watch, played = ClockRateMonitor(RATE), 0.0
    for at in range(4000):
        played += 0.01 * RATE * (1.0 if at < 1500 else 0.85)
        if watch.update(0.01 * at, int(played)) is not None:
            assert 1500 < at < 3600
            return
    pytest.fail("believed")
