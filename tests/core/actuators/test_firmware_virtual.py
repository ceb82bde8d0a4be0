"""The virtual device is the firmware's core in another language: the same bytes, the same samples, tick by tick."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from firmware_host import Check, Device, build, errors_of
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.actuators.serial_protocol import (
    FROM_DEVICE,
    Bye,
    Caps,
    Credit,
    Decoder,
    Hello,
    Message,
    Ping,
    Pong,
    Samples,
    Start,
    Status,
    Stop,
    encode_frame,
)
from hnf_core.actuators.virtual_serial_device import VirtualDevice

STARTS = st.builds(
    Start,
    st.sampled_from([1000, 8000, 10_000, 11_111]),
    st.integers(1, 2),
    st.integers(100, 32767),
    st.integers(7, 8),
    st.sampled_from([900, 5000, 65535]),
    st.sampled_from([0, 5, 40]),
)
SAMPLES = st.builds(
    lambda session, ahead, count, value: (session, ahead, count, value),
    st.sampled_from([7, 7, 7, 8]),
    st.sampled_from([0, 0, 0, 0, 3, 20, -5]),
    st.integers(0, 90),
    st.integers(-32768, 32767),
)
STEPS = st.one_of(
    STARTS,
    SAMPLES,
    SAMPLES,
    SAMPLES,
    st.integers(1, 60),
    st.integers(1, 60),
    st.sampled_from([Hello(), Hello(2, 3), Stop(), Stop(True), Ping(3), Bye()]),
)


@pytest.fixture(scope="module")
def check(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Check]:
    found = Check(build("check", tmp_path_factory.mktemp("check")))
    yield found
    said = found.end()
    assert said == "", said


def essence(message: Message) -> object:
    """Temperatures and names differ."""
    if isinstance(message, Status):
        return (message.underruns, message.crc_errors, message.lost, message.limited, message.state)
    if isinstance(message, Caps):
        return (message.version, message.channels, message.queue)
    return message


def said(messages: list[Message], kinds: tuple[type, ...]) -> list[object]:
    return [essence(message) for message in messages if isinstance(message, kinds)]


@settings(max_examples=150, deadline=None)
@given(st.lists(STEPS, max_size=30))
def test_both_play_the_same_and_answer_the_same(check: Check, steps: list[Message | int | tuple[int, ...]]) -> None:
    ours, theirs, decoder = Device(check, channels=16), VirtualDevice(), Decoder(FROM_DEVICE)
    sent = position = 0
    told: set[int] = set()
    for step in [Hello(), Start(10_000, 1, 32767, 7), *steps]:
        if isinstance(step, int):
            played = ours.tick(step)
            other = theirs.advance(step)
            np.testing.assert_array_equal(played[:, : other.shape[1]], other)
            ours.poll()
            decoder.feed(theirs.poll_output())
            continue
        if isinstance(step, Start):
            position = 0
        if isinstance(step, tuple):
            session, ahead, count, value = step
            channels = theirs._playout.form.channels
            counts = np.resize(np.array([value, -value // 2, value // 3], np.int16), (count, channels))
            step = Samples.from_counts(session, (position + ahead) & 0xFFFFFFFF, counts)
            position += ahead + count
        data = encode_frame(step, sent)
        sent += 1
        theirs.receive(data)
        answers, others = ours.feed(data), decoder.feed(theirs.poll_output())
        assert said(answers, (Caps, Credit, Pong)) == said(others, (Caps, Credit, Pong))
        # How soon an ERROR is said again is a matter of clocks, and the firmware's knows no change of rate.
        assert set(errors_of(answers)) - told == set(errors_of(others)) - told
        told = set() if said(answers, (Caps,)) else told | set(errors_of(answers))
    theirs.receive(encode_frame(Ping(9), sent))
    theirs.advance(1)
    ours.tick(1)
    assert essence(ours.status()) == said(decoder.feed(theirs.poll_output()), (Status,))[-1]
