"""What can go wrong with a stream on a serial device, one function each: from a rig at rest to what came of it."""

from __future__ import annotations

import errno
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from ..actuators.protocol.frames import Encoder
from ..actuators.protocol.messages import Hello, Samples, Start
from ..actuators.sinks.serial import SerialSink
from ..actuators.virtual.device import Abilities, VirtualDevice
from ..errors import DeviceError
from .faults_process import killed, slept_briefly, slept_long
from .faults_rig import RATE_HZ, Outcome, Rig, Since, seconds

Trial = Callable[[Rig], Outcome]

JUDGED_S = 40.0
"""Longest until a wrong rate is known: a host that is itself late, many times a second, waits for calmer seconds before
it calls a device a liar. It begins to look anew every 10 s."""


@dataclass(frozen=True)
class Kind:
    """name: in the table. trial: lets it happen once. told: messages that a person shall get. survives: the stream
    shall play on."""

    name: str
    trial: Trial
    told: int = 1
    survives: bool = False


def unplugged(rig: Rig) -> Outcome:
    """The plug is pulled; the device has power of its own."""
    rig.play_for_a_while()
    outcome = rig.ended(rig.strike(rig.port.unplug))
    rig.port.plug()
    return replace(outcome, not_again=rig.again())


def unplugged_while_opened(rig: Rig) -> Outcome:
    """The plug is pulled while host and device greet each other, or just after."""
    struck: list[int] = []
    pull = threading.Timer(float(rig.rng.uniform(0.0, 0.02)), lambda: struck.append(rig.strike(rig.port.unplug)))
    pull.start()
    told: tuple[str, ...] = ()
    try:
        rig.play()
    except DeviceError as error:
        told = (str(error),)
    pull.join()
    if told:
        outcome = Outcome(seconds(rig.device.sounded - struck[0]), told, hung=not rig.quiet())
    else:
        outcome = rig.ended(struck[0])
    rig.port.plug()
    return replace(outcome, not_again=rig.again())


def stops_reading(rig: Rig) -> Outcome:
    """The device plays what it has, tells its credit, and reads nothing more."""

    def deafen(deaf: bool) -> None:
        rig.port.deaf = deaf

    rig.play_for_a_while()
    outcome = rig.ended(rig.strike(lambda: deafen(True)))
    deafen(False)
    return replace(outcome, not_again=rig.again())


def damaged(share: float, to_device: bool, to_host: bool) -> Trial:
    """Every byte has a bit flipped with the probability share, from a random frame on."""

    def trial(rig: Rig) -> Outcome:
        def flip(data: bytes) -> bytes:
            found = np.frombuffer(data, dtype=np.uint8).copy()
            hit = rig.rng.random(len(found)) < share
            found[hit] ^= np.left_shift(1, rig.rng.integers(0, 8, int(hit.sum()))).astype(np.uint8)
            return found.tobytes()

        return _on_the_wire(rig, flip, to_device, to_host, ends=share > 0.01, gets_through=share < 0.1)

    return trial


def garbage(to_device: bool, to_host: bool) -> Trial:
    """Random bytes instead of all that is sent, with pieces that look like the beginning of a message."""

    def trial(rig: Rig) -> Outcome:
        def replaced(data: bytes) -> bytes:
            return rig.rng.bytes(len(data) // 2) + b"\xa5\x5a" + rig.rng.bytes(len(data) // 2)

        return _on_the_wire(rig, replaced, to_device, to_host, ends=True)

    return trial


def _on_the_wire(
    rig: Rig,
    wire: Callable[[bytes], bytes],
    to_device: bool,
    to_host: bool,
    *,
    ends: bool,
    gets_through: bool = False,
) -> Outcome:
    """gets_through: enough to play on until the host knows."""

    def lay(now: Callable[[bytes], bytes]) -> None:
        if to_device:
            rig.port.from_host = now
        if to_host:
            rig.port.to_host = now

    rig.play_for_a_while()
    struck = rig.strike(lambda: lay(wire))
    if not ends:
        rig.reach(rig.device.played + RATE_HZ // 2)
        with rig.port.standing():
            lay(bytes)
        return rig.stopped()
    since = Since.NOTICE if gets_through else Since.FAULT if to_device else Since.SAMPLES
    outcome = rig.ended(struck, since)
    with rig.port.standing():
        lay(bytes)
    return replace(outcome, not_again=rig.again())


def wrong_version(rig: Rig) -> Outcome:
    """The device has restarted with firmware of version 2."""

    def other(version: int) -> None:
        port = rig.port
        port.device = VirtualDevice(Abilities(version=version), heard=port.recording.hear)

    rig.play_for_a_while()
    assert rig.stream is not None
    rig.stream.stop()
    rig.quiet()
    rig.port.recording.forget()
    rig.strike(lambda: other(2))
    told: tuple[str, ...] = ()
    try:
        rig.play()
    except DeviceError as error:
        told = (str(error),)
    sounded = rig.device.sounded
    rig.strike(lambda: other(1))
    named = all("version 1" in words and "version 2" in words for words in told)
    return Outcome(sounded / RATE_HZ, told if named else (*told, "does not name both"), not_again=rig.again())


def rate_lie(rig: Rig) -> Outcome:
    """The sample clock is off by 15 to 30 %, to either side."""

    def pace(speed: float) -> None:
        rig.port.speed = speed

    rig.play_for_a_while()
    off = float(rig.rng.choice([-1.0, 1.0]) * rig.rng.uniform(0.15, 0.3))
    outcome = rig.ended(rig.strike(lambda: pace(1.0 + off)), Since.NOTICE, JUDGED_S)
    pace(1.0)
    named = all(f"{RATE_HZ} Hz" in words for words in outcome.messages)
    told = outcome.messages if named else (*outcome.messages, "does not name the rate")
    return replace(outcome, messages=told, not_again=rig.again())


def second_program(rig: Rig) -> Outcome:
    """Another program opens the port while we play: it is refused, we play on."""
    rig.play_for_a_while()
    told: tuple[str, ...] = ()
    try:
        SerialSink(rig.port.path).open()
    except DeviceError as error:
        told = (str(error),)
    return rig.stopped(told)


def second_program_without_a_lock(rig: Rig) -> Outcome:
    """Another program does not ask: it says HELLO and START and sends samples into ours."""
    rig.play_for_a_while()
    encoder = Encoder()
    loud = np.full((32, 1), 30_000, dtype=np.int16)
    intruding = b"".join(
        encoder.encode(message) for message in (Hello(), Start(RATE_HZ, 1, 32767, 1), Samples.of(1, 0, loud))
    )

    def intrude() -> None:
        port = os.open(rig.port.path, os.O_RDWR | os.O_NOCTTY)
        try:
            os.write(port, intruding)
        finally:
            os.close(port)

    return replace(rig.ended(rig.strike(intrude), Since.NOTICE), not_again=rig.again())


def short_writes(rig: Rig) -> Outcome:
    """The system takes a few bytes of each write: slower, and whole all the same."""
    with _system_write(lambda descriptor, data: os.write(descriptor, data[: int(rig.rng.integers(1, 40))])):
        rig.play_for_a_while()
        outcome = rig.stopped()
    return outcome


def write_that_ends_short(rig: Rig) -> Outcome:
    """The system takes half of a message, and then no more."""
    budget: list[int] = []

    def write(descriptor: int, data: bytes) -> int:
        taken = bytes(data) if not budget else bytes(data)[: budget[0]]
        if not taken:
            raise BlockingIOError(errno.EAGAIN, "full")
        count = os.write(descriptor, taken)
        if budget:
            budget[0] -= count
        return count

    with _system_write(write):
        rig.play_for_a_while()
        outcome = rig.ended(rig.strike(lambda: budget.append(int(rig.rng.integers(1, 40)))))
    return replace(outcome, not_again=rig.again())


@contextmanager
def _system_write(write: Callable[[int, bytes], int]) -> Iterator[None]:
    """What pyserial hands to the system goes through write."""
    from serial import serialposix

    class System:
        def __getattr__(self, name: str) -> object:
            return getattr(os, name)

        def write(self, descriptor: int, data: bytes) -> int:
            return write(descriptor, data)

    before, serialposix.os = serialposix.os, System()
    try:
        yield
    finally:
        serialposix.os = before


def stopped(rig: Rig) -> Outcome:
    """No fault at all: stop()."""
    rig.play_for_a_while()
    return rig.stopped()


KINDS = (
    Kind("stop()", stopped, 0, True),
    Kind("port unplugged", unplugged),
    Kind("port unplugged while it is opened", unplugged_while_opened),
    Kind("device stops reading", stops_reading),
    Kind("all messages to the device damaged", damaged(0.6, True, False)),
    Kind("all messages to the host damaged", damaged(0.6, False, True)),
    Kind("garbage to the device", garbage(True, False)),
    Kind("garbage to the host", garbage(False, True)),
    Kind("garbage both ways", garbage(True, True)),
    Kind("1 byte in 2000 flipped, both ways", damaged(0.0005, True, True), 0, True),
    Kind("1 byte in 40 flipped, both ways", damaged(0.025, True, True)),
    Kind("wrong version", wrong_version),
    Kind("short writes", short_writes, 0, True),
    Kind("a write that ends short", write_that_ends_short),
    Kind("sample rate lie", rate_lie),
    Kind("second program, refused", second_program, 1, True),
    Kind("second program without a lock", second_program_without_a_lock),
    Kind("asleep for 0.3 s", slept_briefly, 0, True),
    Kind("asleep for more than 1 s", slept_long),
    Kind("process killed", killed, 0),
)
