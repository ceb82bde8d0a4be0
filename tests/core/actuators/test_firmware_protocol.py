"""Frames and messages of tools/firmware against the Python codec, both ways, under the compiler's sanitizers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import astuple
from pathlib import Path

import pytest
from firmware_host import Check, build
from hypothesis import example, given, settings
from hypothesis import strategies as st
from test_serial_protocol import DEVICE_MESSAGES, GARBAGE, HOST_MESSAGES, U8

from hnf_core.actuators.serial_protocol import (
    FROM_DEVICE,
    FROM_HOST,
    Bye,
    Decoder,
    Message,
    Ping,
    Samples,
    Start,
    Stop,
    encode_frame,
)
from reference.device_reference import crc16_reference


@pytest.fixture(scope="module")
def check(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Check]:
    found = Check(build("check", Path(tmp_path_factory.mktemp("check"))))
    yield found
    said = found.end()
    assert said == "", said


def told(message: Message) -> str:
    """As host/check.c words it."""
    if isinstance(message, Samples):
        counts = (str(count) for count in message.counts(1).ravel())
        return " ".join(["samples", str(message.session), str(message.position), *counts])
    if isinstance(message, Start):
        fields = (message.rate_hz, message.channels, message.flags, message.peak)
        return " ".join(map(str, ("start", *fields, message.slew, message.queue, message.session)))
    if isinstance(message, Stop):
        return f"stop {int(message.drain)}"
    if isinstance(message, Bye):
        return "bye"
    return " ".join(map(str, (type(message).__name__.lower(), *astuple(message))))


def counters(check: Check) -> list[int]:
    return [int(number) for number in check("n").split()]


@settings(deadline=None)
@given(data=st.binary(max_size=300))
@example(data=b"123456789")
def test_checksums_agree(check: Check, data: bytes) -> None:
    assert int.from_bytes(check("c", 0, data), "little") == crc16_reference(data)


@settings(deadline=None)
@given(messages=st.lists(HOST_MESSAGES, max_size=8), piece=st.integers(1, 200), first=U8)
@example(messages=[Samples(1, 2**32 - 1, bytes(2042)), Ping(1)], piece=1, first=0)
def test_what_python_sends_c_understands(check: Check, messages: list[Message], piece: int, first: int) -> None:
    check("z")
    wire = b"".join(encode_frame(message, first + i) for i, message in enumerate(messages))
    assert check("d", piece, wire).decode().splitlines() == [told(message) for message in messages]
    assert counters(check) == [0, 0, 0]


@settings(deadline=None)
@given(message=DEVICE_MESSAGES, sequence=U8)
def test_what_c_sends_python_understands(check: Check, message: Message, sequence: int) -> None:
    if "\0" in str(astuple(message)[-1]):  # the end of a text in C
        return
    frame = check("e", sequence, told(message).encode())
    assert frame == encode_frame(message, sequence)
    assert Decoder(FROM_DEVICE).feed(frame) == [message]


@settings(deadline=None)
@given(text=st.text("aäの𝄞", min_size=20, max_size=80))
def test_texts_that_are_too_long_are_cut_between_characters(check: Check, text: str) -> None:
    (error,) = Decoder(FROM_DEVICE).feed(check("e", 0, f"error 3 {text}".encode()))
    said = astuple(error)[1]
    assert text.startswith(said)
    assert said == text or 117 <= len(said.encode()) <= 120


@settings(max_examples=200, deadline=None)
@given(
    chunks=st.lists(st.one_of(GARBAGE, HOST_MESSAGES.map(lambda each: encode_frame(each, 3))), max_size=12),
    flips=st.lists(st.integers(0, 10**6), max_size=6),
    piece=st.integers(1, 100),
)
def test_both_make_the_same_of_a_damaged_line(check: Check, chunks: list[bytes], flips: list[int], piece: int) -> None:
    """Messages and counters, and after an idle line everything is understood again."""
    wire = bytearray(b"".join(chunks))
    for flip in flips:
        if wire:
            wire[flip // 8 % len(wire)] ^= 1 << flip % 8
    check("z")
    decoder = Decoder(FROM_HOST)
    heard = check("d", piece, bytes(wire)) + check("i")
    found = decoder.feed(bytes(wire)) + decoder.flush()
    lines = [line for line in heard.decode().splitlines() if line != "malformed"]
    assert lines == [told(message) for message in found]
    assert heard.count(b"malformed") == decoder.malformed
    assert counters(check) == [decoder.crc_errors, decoder.gaps, decoder.skipped]
    assert check("d", piece, encode_frame(Ping(9), 0)) == b"ping 9\n"
