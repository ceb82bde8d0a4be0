"""Replies of the device core of tools/firmware in each state."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from firmware_host import QUEUE, RAMP, RATE, Check, Device, build, credits_of, errors_of
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.actuators.serial_protocol import (
    Bye,
    Caps,
    Error,
    ErrorCode,
    Hello,
    Message,
    Ping,
    Pong,
    Samples,
    Start,
    State,
    Stop,
)


@pytest.fixture(scope="module")
def check(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Check]:
    found = Check(build("check", tmp_path_factory.mktemp("check")))
    yield found
    said = found.end()
    assert said == "", said


def playing(check: Check, frames: int = 100) -> Device:
    device = Device(check)
    device.start()
    device.send(device.samples(np.full((frames, 2), 9000, np.int16)))
    device.tick(50)
    assert device.status().state == State.PLAYING
    return device


def test_hello_is_answered_by_what_it_can_do(check: Check) -> None:
    device = Device(check, channels=3, lowest=2000, highest=12000, peak=30000)
    assert device.send(Hello(1, 9)) == [Caps(1, 3, 16, 2000, 12000, 180, 30000, 2048, "host")]
    assert device.status().state == State.READY


@settings(deadline=None)
@given(lowest=st.integers(0, 255), highest=st.integers(0, 255))
def test_a_version_in_common_is_needed(check: Check, lowest: int, highest: int) -> None:
    device = Device(check)
    (answer,) = device.send(Hello(lowest, highest))
    if lowest <= 1 <= highest:
        assert isinstance(answer, Caps)
        assert answer.version == 1
        return
    assert isinstance(answer, Error)
    assert answer.code == ErrorCode.VERSION
    assert "version 1" in answer.text
    assert device.status().state == State.IDLE
    assert errors_of(device.send(Start(RATE, 1, 1000, 7))) == [ErrorCode.STATE]


def test_start_gives_the_first_credit(check: Check) -> None:
    device = Device(check)
    device.send(Hello())
    (credit,) = credits_of(device.send(Start(RATE, 2, 32767, 4711)))
    assert (credit.session, credit.played, credit.queue, credit.free) == (4711, 0, QUEUE, QUEUE)
    assert credit.state == State.WAITING


@settings(deadline=None)
@given(rate=st.integers(1000, 48000), asked=st.integers(0, 65535), channels=st.integers(1, 16))
def test_the_queue_is_15_ms_at_most(check: Check, rate: int, asked: int, channels: int) -> None:
    device = Device(check, channels=channels)
    device.send(Hello())
    (credit,) = credits_of(device.send(Start(rate, channels, 32767, 1, queue=asked)))
    assert credit.queue == min(rate * 15 // 1000, asked or 65535)


REFUSALS: list[tuple[Start, ErrorCode]] = [
    (Start(999, 2, 1000, 7), ErrorCode.RATE),
    (Start(48001, 2, 1000, 7), ErrorCode.RATE),
    (Start(0, 2, 1000, 7), ErrorCode.RATE),
    (Start(2**32 - 1, 2, 1000, 7), ErrorCode.RATE),
    (Start(11025, 2, 1000, 7), ErrorCode.RATE),  # that its clock turns out not to do
    (Start(RATE, 0, 1000, 7), ErrorCode.CHANNELS),
    (Start(RATE, 3, 1000, 7), ErrorCode.CHANNELS),
    (Start(RATE, 2, 0, 7), ErrorCode.LIMITS),
    (Start(RATE, 2, 30001, 7), ErrorCode.LIMITS),
    (Start(RATE, 2, 4001, 7, slew=100), ErrorCode.LIMITS),
    (Start(RATE, 2, 1000, 7, flags=1), ErrorCode.MALFORMED),
]


@pytest.mark.parametrize(("start", "code"), REFUSALS)
def test_what_cannot_be_started_is_refused(check: Check, start: Start, code: ErrorCode) -> None:
    device = Device(check, peak=30000)
    assert errors_of(device.send(Hello(), start)) == [code]
    assert device.status().state == State.READY
    assert not credits_of(device.ask())
    assert not device.tick(20).any()
    assert credits_of(device.send(Start(RATE, 2, 4000, 7, slew=100)))


@pytest.mark.parametrize("message", [Hello(), Start(RATE, 1, 1000, 8)])
def test_who_plays_is_not_disturbed(check: Check, message: Message) -> None:
    device = playing(check)
    assert errors_of(device.send(message)) == [ErrorCode.BUSY]
    assert (device.tick(50) == 9000).all()
    assert credits_of(device.poll())[-1].session == device.session


def test_a_second_host_takes_over_and_the_first_gets_an_error(check: Check) -> None:
    device = playing(check)
    device.tick(50 + RAMP)
    assert isinstance(device.send(Hello())[0], Caps)
    assert errors_of(device.send(device.samples(np.ones((10, 2), np.int16)))) == [ErrorCode.SESSION]
    device.send(Start(RATE, 1, 32767, 8))
    device.pause(0.2)
    assert errors_of(device.send(device.samples(np.ones((10, 2), np.int16)))) == [ErrorCode.SESSION]
    device.send(Samples(8, 0, np.full(100, 5, np.int16).tobytes()))
    assert (device.tick(100) == 5).all()


def test_errors_do_not_flood_the_line(check: Check) -> None:
    device = playing(check)
    found = []
    for _ in range(300):
        found += errors_of(device.send(Samples(9, 0, b"")))
        device.pause(0.001)
    assert 3 <= len(found) <= 4


def test_stop_drops_and_drain_does_not(check: Check) -> None:
    dropped, drained = playing(check), None
    dropped.send(Stop())
    assert np.count_nonzero(dropped.tick(200).any(axis=1)) < RAMP
    drained = playing(check)
    drained.send(Stop(True))
    played = drained.tick(200)
    assert (played[:50] == 9000).all()
    assert np.count_nonzero(played.any(axis=1)) < 50 + RAMP
    (last,) = credits_of(drained.poll())
    assert (last.played, last.free, last.state) == (100, QUEUE, State.READY)
    assert drained.status().underruns == 0


def test_silence_now_is_not_taken_back(check: Check) -> None:
    device = playing(check)
    device.send(Stop(), Stop(True))
    assert np.count_nonzero(device.tick(200).any(axis=1)) < RAMP


def test_stop_again_is_answered_so_that_its_answer_may_be_lost(check: Check) -> None:
    device = playing(check)
    device.send(Stop(True))
    device.tick(200)
    device.poll()
    assert not credits_of(device.ask())
    (credit,) = credits_of(device.send(Stop()))
    assert (credit.played, credit.state) == (100, State.READY)


def test_samples_under_way_when_it_stops_are_no_error(check: Check) -> None:
    device = playing(check)
    device.send(Stop())
    assert not errors_of(device.send(device.samples(np.ones((10, 2), np.int16))))
    assert np.count_nonzero(device.tick(200).any(axis=1)) < RAMP
    device.poll()
    assert not errors_of(device.send(device.samples(np.ones((10, 2), np.int16))))
    assert not device.tick(100).any()


def test_a_stream_can_follow_a_stream(check: Check) -> None:
    device = playing(check)
    device.send(Stop())
    device.tick(RAMP)
    device.poll()
    device.send(Start(RATE, 1, 32767, 12))
    device.send(Samples(12, 0, np.full(100, -7, np.int16).tobytes()))
    assert (device.tick(100) == -7).all()


@pytest.mark.parametrize("leave", ["BYE", "cable"])
def test_whoever_leaves_leaves_it_idle(check: Check, leave: str) -> None:
    device = playing(check)
    if leave == "BYE":
        device.send(Bye())
    else:
        device.do("U")
    assert device.status().state == State.STOPPING
    device.tick(RAMP)
    device.poll()
    assert device.status().state == State.IDLE
    assert isinstance(device.send(Hello())[0], Caps)


def test_an_underrun_is_counted_once(check: Check) -> None:
    device = playing(check)
    device.tick(500)
    assert device.status().underruns == 1
    assert device.status().state == State.WAITING
    device.send(Hello())
    assert device.status().underruns == 0


def test_few_samples_wait_for_more_but_not_long(check: Check) -> None:
    device = Device(check, channels=1)
    device.start()
    device.send(device.samples(np.full((5, 1), 9, np.int16)))
    assert not device.tick(RAMP - 1).any()
    assert (device.tick(5) == 9).all()
    device = Device(check, channels=1)
    device.start()
    device.send(device.samples(np.full((QUEUE // 2, 1), 9, np.int16)))
    assert (device.tick(5) == 9).all()


def test_too_hot_is_silence_until_it_is_cool(check: Check) -> None:
    device = Device(check, hot=700)
    device.start()
    device.send(device.samples(np.full((QUEUE, 2), 9000, np.int16)))
    device.tick(20)
    device.do("H", 699)
    assert (device.tick(20) == 9000).all()
    assert device.status().temperature == 699
    said = device.do("H", 700)
    assert errors_of(said) == [ErrorCode.HOT]
    assert not device.tick(RAMP)[-1].any()
    device.poll()
    assert device.status().state == State.FAULT
    assert errors_of(device.send(Start(RATE, 2, 1000, 7))) == [ErrorCode.STATE]
    assert errors_of(device.send(Hello(), Start(RATE, 2, 1000, 7))) == [ErrorCode.HOT]
    device.do("H", 600)
    assert credits_of(device.send(Start(RATE, 2, 1000, 7)))


def test_a_fault_outlives_its_host(check: Check) -> None:
    device = playing(check)
    device.do("X")
    device.send(Bye(), Stop())
    device.tick(RAMP)
    device.poll()
    assert device.status().state == State.FAULT
    device.send(Bye())
    assert device.status().state == State.FAULT
    device.start()
    assert device.status().state == State.WAITING


def test_damage_is_counted(check: Check) -> None:
    device = playing(check)
    bad = bytearray(device.encode(Ping(1)))
    bad[6] ^= 1
    device.feed(bytes(bad))
    assert device.status().crc_errors == 1
    device.tick(300)
    device.send(Hello())
    assert device.status().crc_errors == 0


def test_half_a_message_does_not_hide_the_next_host(check: Check) -> None:
    device = playing(check)
    device.feed(device.encode(Samples(7, 100, bytes(2000)))[:1500])
    device.tick(300)
    assert isinstance(device.send(Hello())[0], Caps)


@pytest.mark.parametrize("where", ["IDLE", "READY", "WAITING", "PLAYING"])
def test_ping_is_answered_everywhere(check: Check, where: str) -> None:
    device = playing(check) if where == "PLAYING" else Device(check)
    if where in ("READY", "WAITING"):
        device.send(Hello())
    if where == "WAITING":
        device.start()
    said = device.send(Ping(4660)) + device.poll()
    assert Pong(4660) in said
    assert device.status().state.name == where
