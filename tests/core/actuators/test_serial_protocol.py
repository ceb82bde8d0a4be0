"""The codec of the serial protocol: what is sent arrives, and nothing that arrives does harm."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hnf_core.actuators.serial_protocol import (
    FRAME_OVERHEAD_BYTES,
    FROM_DEVICE,
    FROM_HOST,
    LARGEST_PAYLOAD,
    Bye,
    Caps,
    Credit,
    Decoder,
    Encoder,
    Error,
    Hello,
    Message,
    Ping,
    Pong,
    Samples,
    Start,
    State,
    Status,
    Stop,
    crc16,
    encode_frame,
    frames_per_message,
)
from hnf_core.errors import UsageError
from reference.device_reference import crc16_reference

U8, U16, U32 = (st.integers(0, 2**bits - 1) for bits in (8, 16, 32))
STATES = st.sampled_from(State)


def text(largest: int) -> st.SearchStrategy[str]:
    return st.text(st.characters(exclude_categories=["Cs"]), max_size=largest).filter(
        lambda each: len(each.encode()) <= largest
    )


HOST_MESSAGES: st.SearchStrategy[Message] = st.one_of(
    st.builds(Hello, U8, U8),
    st.builds(Start, U32, U8, U16, U16, U16, U16, U8),
    st.builds(Samples, U16, U32, st.binary(max_size=40).map(lambda data: data[: len(data) // 2 * 2])),
    st.builds(Stop, st.booleans()),
    st.builds(Ping, U16),
    st.just(Bye()),
)
DEVICE_MESSAGES: st.SearchStrategy[Message] = st.one_of(
    st.builds(Caps, U8, U8, U8, U32, U32, U16, U16, U16, text(64)),
    st.builds(Credit, U16, U32, U16, U16, STATES),
    st.builds(Status, U32, U32, U32, U32, st.integers(-32768, 32767), STATES),
    st.builds(Pong, U16),
    st.builds(Error, U8, text(120)),
)
SIDES = [(FROM_HOST, HOST_MESSAGES), (FROM_DEVICE, DEVICE_MESSAGES)]
GARBAGE = st.one_of(
    st.binary(max_size=60),
    st.lists(st.sampled_from([b"\xa5", b"\x5a", b"\xa5\x5a", b"\x03", b"\x85", b"\x00", b"\x08"]), max_size=30).map(
        b"".join
    ),
)


def pieces(data: bytes, cuts: list[int]) -> list[bytes]:
    ends = sorted({cut % (len(data) + 1) for cut in cuts} | {0, len(data)})
    return [data[begin:end] for begin, end in pairwise(ends)]


@settings(deadline=None)
@given(st.binary(max_size=300))
@example(b"123456789")
def test_the_fast_checksum_is_the_plain_one(data: bytes) -> None:
    assert crc16(data) == crc16_reference(data)


def test_the_checksum_has_the_check_value_of_the_catalogue() -> None:
    assert crc16(b"123456789") == 0x29B1


@pytest.mark.parametrize("side", SIDES, ids=["host", "device"])
@settings(deadline=None)
@given(data=st.data(), cuts=st.lists(st.integers(0, 10_000), max_size=8), first=U8)
def test_messages_arrive_whatever_the_pieces(side: Any, data: st.DataObject, cuts: list[int], first: int) -> None:
    kinds, strategy = side
    messages = data.draw(st.lists(strategy, max_size=8))
    decoder = Decoder(kinds)
    wire = b"".join(encode_frame(message, first + i) for i, message in enumerate(messages))
    assert [found for piece in pieces(wire, cuts) for found in decoder.feed(piece)] == messages
    assert (decoder.crc_errors, decoder.gaps, decoder.malformed, decoder.skipped) == (0, 0, 0, 0)


@pytest.mark.parametrize("side", SIDES, ids=["host", "device"])
@settings(deadline=None)
@given(data=st.data(), noise=GARBAGE)
def test_what_follows_garbage_arrives(side: Any, data: st.DataObject, noise: bytes) -> None:
    """At the latest when the line has been idle, whatever the garbage claimed to be."""
    kinds, strategy = side
    message = data.draw(strategy)
    decoder = Decoder(kinds)
    found = decoder.feed(noise + encode_frame(message, 5)) + decoder.flush()
    assert message in found
    # (garbage is no message but with a CRC by chance, of 1 in 65536)
    assert decoder.skipped <= len(noise)
    assert decoder.feed(encode_frame(message, 6)) == [message]


@settings(deadline=None)
@given(messages=st.lists(HOST_MESSAGES, min_size=1, max_size=5), flips=st.lists(st.integers(0, 10**6), max_size=3))
def test_flipped_bits_cost_what_they_hit(messages: list[Message], flips: list[int]) -> None:
    frames = [bytearray(encode_frame(message, i)) for i, message in enumerate(messages)]
    hit = set()
    ends = np.cumsum([len(frame) for frame in frames])
    for flip in flips:
        bit = flip % (8 * int(ends[-1]))
        which = int(np.searchsorted(ends, bit // 8, side="right"))
        frames[which][bit // 8 - (int(ends[which]) - len(frames[which]))] ^= 1 << bit % 8
        hit.add(which)
    decoder = Decoder(FROM_HOST)
    found = decoder.feed(b"".join(map(bytes, frames))) + decoder.flush()
    # CRC-16 finds every error of up to three bits in frames as short as these.
    remaining = [message for i, message in enumerate(messages) if bytes(frames[i]) == encode_frame(message, i)]
    assert found == remaining


@pytest.mark.parametrize("kinds", [FROM_HOST, FROM_DEVICE], ids=["host", "device"])
@settings(deadline=None)
@given(chunks=st.lists(GARBAGE, max_size=20))
def test_nothing_raises_and_little_is_held(kinds: Any, chunks: list[bytes]) -> None:
    decoder = Decoder(kinds)
    for chunk in chunks:
        decoder.feed(chunk)
        assert len(decoder._buffer) < LARGEST_PAYLOAD + FRAME_OVERHEAD_BYTES
    decoder.flush()
    assert decoder._buffer == b""


def test_a_host_that_died_amid_a_message_does_not_hide_the_next() -> None:
    decoder = Decoder(FROM_HOST)
    assert decoder.feed(encode_frame(Samples(1, 0, bytes(2000)), 0)[:900] + encode_frame(Hello(), 0)) == []
    assert decoder.flush() == [Hello()]


def test_gaps_are_counted_but_not_before_a_hello() -> None:
    decoder = Decoder(FROM_HOST)
    decoder.feed(encode_frame(Ping(1), 250))
    decoder.feed(encode_frame(Ping(1), 2))
    assert decoder.gaps == 7
    decoder.feed(encode_frame(Hello(), 77))
    decoder.feed(encode_frame(Ping(1), 78))
    assert decoder.gaps == 7


def test_a_good_checksum_around_nonsense_is_malformed() -> None:
    decoder = Decoder(FROM_HOST)
    half_a_sample = encode_frame(Samples(1, 0, b"\0\0\0"), 0)
    assert decoder.feed(half_a_sample + encode_frame(Ping(2), 1)) == [Ping(2)]
    assert decoder.malformed == 1


@settings(deadline=None)
@given(st.integers(0, 255))
def test_a_stop_is_never_misunderstood_as_going_on(how: int) -> None:
    frame = bytearray(encode_frame(Stop(), 0))
    frame[6] = how
    frame[7:] = crc16(bytes(frame[2:7])).to_bytes(2, "little")
    assert Decoder(FROM_HOST).feed(bytes(frame)) == [Stop(how == 1)]


def test_the_other_side_alone_is_heard() -> None:
    decoder = Decoder(FROM_DEVICE)
    assert decoder.feed(encode_frame(Ping(1), 0)) == []
    assert decoder.skipped == len(encode_frame(Ping(1), 0))


@settings(deadline=None)
@given(st.lists(HOST_MESSAGES, max_size=300))
def test_an_encoder_counts(messages: list[Message]) -> None:
    encoder = Encoder()
    assert [encoder.encode(message) for message in messages] == [encode_frame(m, i) for i, m in enumerate(messages)]


@settings(deadline=None)
@given(st.integers(1, 16), st.integers(0, 2**32 - 1), st.data())
def test_samples_carry_counts(channels: int, position: int, data: st.DataObject) -> None:
    count = data.draw(st.integers(0, 20))
    rng = np.random.default_rng(data.draw(U32))
    counts = rng.integers(-32768, 32768, (count, channels)).astype(np.int16)
    message = Samples.from_counts(1, position, counts)
    np.testing.assert_array_equal(message.counts(channels), counts)
    assert len(encode_frame(message, 0)) == FRAME_OVERHEAD_BYTES + 6 + 2 * counts.size


@pytest.mark.parametrize("channels", range(1, 17))
def test_the_longest_samples_fit_a_message(channels: int) -> None:
    frames = frames_per_message(channels)
    encode_frame(Samples.from_counts(1, 0, np.zeros((frames, channels), np.int16)), 0)
    with pytest.raises(UsageError, match="no frame"):
        encode_frame(Samples.from_counts(1, 0, np.zeros((frames + 1, channels), np.int16)), 0)


@pytest.mark.parametrize(
    "message", [Ping(65536), Ping(-1), Hello(0, 256), Start(2**32, 1, 1, 1), Error(1, "x" * 121), Pong(70000)]
)
def test_what_does_not_fit_is_refused(message: Message) -> None:
    with pytest.raises(UsageError):
        encode_frame(message, 0)


@settings(deadline=None)
@given(played=U32, queue=st.integers(1, 720), outstanding=st.integers(0, 720))
def test_room_is_what_is_not_outstanding(played: int, queue: int, outstanding: int) -> None:
    credit = Credit(1, played, queue, 0, State.PLAYING)
    assert credit.compute_sendable_frames(played + outstanding) == queue - outstanding
    assert credit.compute_sendable_frames((played + outstanding) % 2**32) == queue - outstanding
