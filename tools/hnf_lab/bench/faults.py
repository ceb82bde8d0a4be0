"""What can go wrong with a stream on a serial device, one function each: from a rig at rest to what came of it.

Every fault ends in silence: each of them at frames drawn at random, on a virtual device behind a real pty.
"""

from __future__ import annotations

import errno
import os
import re
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from hnf_core.actuators.serial_protocol import Encoder, Hello, Samples, Start
from hnf_core.actuators.sinks.serial import SerialSink
from hnf_core.actuators.virtual.serial_device import Capabilities, VirtualDevice
from hnf_core.errors import DeviceError

from .fault_harness import (
    MAX_SILENCE_DELAY_S,
    RATE_HZ,
    FaultRig,
    Outcome,
    SilenceOrigin,
    kill_player,
    suspend_briefly,
    suspend_for_long,
    to_seconds,
)
from .harness import BenchOptions, Row, Spread

Trial = Callable[[FaultRig], Outcome]

RATE_DETECTION_S = 40.0
"""Longest until a wrong rate is known: a host that is itself late, many times a second, waits for calmer seconds before
it calls a device a liar. It begins to look anew every 10 s."""


@dataclass(frozen=True)
class Fault:
    """name: in the table. trial: lets it happen once. told: messages that a person shall get. survives: the stream
    shall play on."""

    name: str
    trial: Trial
    expected_messages: int = 1
    survives: bool = False


def unplug(rig: FaultRig) -> Outcome:
    """The plug is pulled; the device has power of its own."""
    rig.play_random_time()
    outcome = rig.wait_for_end(rig.inject_fault(rig.port.unplug))
    rig.port.plug()
    return replace(outcome, restart_problem=rig.restart())


def unplug_while_opening(rig: FaultRig) -> Outcome:
    """The plug is pulled while host and device greet each other, or just after."""
    struck: list[int] = []
    pull = threading.Timer(float(rig.rng.uniform(0.0, 0.02)), lambda: struck.append(rig.inject_fault(rig.port.unplug)))
    pull.start()
    told: tuple[str, ...] = ()
    try:
        rig.play()
    except DeviceError as error:
        told = (str(error),)
    pull.join()
    if told:
        outcome = Outcome(to_seconds(rig.device.last_sound_clock - struck[0]), told, hung=not rig.wait_for_silence())
    else:
        outcome = rig.wait_for_end(struck[0])
    rig.port.plug()
    return replace(outcome, restart_problem=rig.restart())


def stop_reading(rig: FaultRig) -> Outcome:
    """The device plays what it has, tells its credit, and reads nothing more."""

    def deafen(deaf: bool) -> None:
        rig.port.ignores_host = deaf

    rig.play_random_time()
    outcome = rig.wait_for_end(rig.inject_fault(lambda: deafen(True)))
    deafen(False)
    return replace(outcome, restart_problem=rig.restart())


def damage_bytes(share: float, to_device: bool, to_host: bool) -> Trial:
    """Every byte has a bit flipped with the probability share, from a random frame on."""

    def trial(rig: FaultRig) -> Outcome:
        def flip(data: bytes) -> bytes:
            found = np.frombuffer(data, dtype=np.uint8).copy()
            hit = rig.rng.random(len(found)) < share
            found[hit] ^= np.left_shift(1, rig.rng.integers(0, 8, int(hit.sum()))).astype(np.uint8)
            return found.tobytes()

        return _disturb_wire(rig, flip, to_device, to_host, ends=share > 0.01, gets_through=share < 0.1)

    return trial


def send_garbage(to_device: bool, to_host: bool) -> Trial:
    """Random bytes instead of all that is sent, with pieces that look like the beginning of a message."""

    def trial(rig: FaultRig) -> Outcome:
        def replaced(data: bytes) -> bytes:
            return rig.rng.bytes(len(data) // 2) + b"\xa5\x5a" + rig.rng.bytes(len(data) // 2)

        return _disturb_wire(rig, replaced, to_device, to_host, ends=True)

    return trial


def _disturb_wire(
    rig: FaultRig,
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

    rig.play_random_time()
    struck = rig.inject_fault(lambda: lay(wire))
    if not ends:
        rig.wait_for_frames(rig.device.played + RATE_HZ // 2)
        with rig.port.freeze_clock():
            lay(bytes)
        return rig.stop_stream()
    since = SilenceOrigin.NOTICE if gets_through else SilenceOrigin.FAULT if to_device else SilenceOrigin.SAMPLES
    outcome = rig.wait_for_end(struck, since)
    with rig.port.freeze_clock():
        lay(bytes)
    return replace(outcome, restart_problem=rig.restart())


def announce_wrong_version(rig: FaultRig) -> Outcome:
    """The device has restarted with firmware of version 2."""

    def other(version: int) -> None:
        port = rig.port
        port.device = VirtualDevice(Capabilities(version=version), on_output=port.recording.record)

    rig.play_random_time()
    assert rig.stream is not None
    rig.stream.stop()
    rig.wait_for_silence()
    rig.port.recording.clear()
    rig.inject_fault(lambda: other(2))
    told: tuple[str, ...] = ()
    try:
        rig.play()
    except DeviceError as error:
        told = (str(error),)
    sounded = rig.device.last_sound_clock
    rig.inject_fault(lambda: other(1))
    named = all("version 1" in words and "version 2" in words for words in told)
    return Outcome(sounded / RATE_HZ, told if named else (*told, "does not name both"), restart_problem=rig.restart())


def misreport_rate(rig: FaultRig) -> Outcome:
    """The sample clock is off by 15 to 30 %, to either side."""

    def pace(speed: float) -> None:
        rig.port.speed = speed

    rig.play_random_time()
    off = float(rig.rng.choice([-1.0, 1.0]) * rig.rng.uniform(0.15, 0.3))
    outcome = rig.wait_for_end(rig.inject_fault(lambda: pace(1.0 + off)), SilenceOrigin.NOTICE, RATE_DETECTION_S)
    pace(1.0)
    named = all(f"{RATE_HZ} Hz" in words for words in outcome.messages)
    told = outcome.messages if named else (*outcome.messages, "does not name the rate")
    return replace(outcome, messages=told, restart_problem=rig.restart())


def open_from_second_program(rig: FaultRig) -> Outcome:
    """Another program opens the port while we play: it is refused, we play on."""
    rig.play_random_time()
    told: tuple[str, ...] = ()
    try:
        SerialSink(rig.port.path).open()
    except DeviceError as error:
        told = (str(error),)
    return rig.stop_stream(told)


def write_from_second_program(rig: FaultRig) -> Outcome:
    """Another program does not ask: it says HELLO and START and sends samples into ours."""
    rig.play_random_time()
    encoder = Encoder()
    loud = np.full((32, 1), 30_000, dtype=np.int16)
    intruding = b"".join(
        encoder.encode(message) for message in (Hello(), Start(RATE_HZ, 1, 32767, 1), Samples.from_counts(1, 0, loud))
    )

    def intrude() -> None:
        port = os.open(rig.port.path, os.O_RDWR | os.O_NOCTTY)
        try:
            os.write(port, intruding)
        finally:
            os.close(port)

    return replace(rig.wait_for_end(rig.inject_fault(intrude), SilenceOrigin.NOTICE), restart_problem=rig.restart())


def write_few_bytes(rig: FaultRig) -> Outcome:
    """The system takes a few bytes of each write: slower, and whole all the same."""
    with _patch_system_write(lambda descriptor, data: os.write(descriptor, data[: int(rig.rng.integers(1, 40))])):
        rig.play_random_time()
        outcome = rig.stop_stream()
    return outcome


def truncate_write(rig: FaultRig) -> Outcome:
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

    with _patch_system_write(write):
        rig.play_random_time()
        outcome = rig.wait_for_end(rig.inject_fault(lambda: budget.append(int(rig.rng.integers(1, 40)))))
    return replace(outcome, restart_problem=rig.restart())


@contextmanager
def _patch_system_write(write: Callable[[int, bytes], int]) -> Iterator[None]:
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


def stop_normally(rig: FaultRig) -> Outcome:
    """No fault at all: stop()."""
    rig.play_random_time()
    return rig.stop_stream()


FAULTS = (
    Fault("stop()", stop_normally, 0, True),
    Fault("port unplugged", unplug),
    Fault("port unplugged while it is opened", unplug_while_opening),
    Fault("device stops reading", stop_reading),
    Fault("all messages to the device damaged", damage_bytes(0.6, True, False)),
    Fault("all messages to the host damaged", damage_bytes(0.6, False, True)),
    Fault("garbage to the device", send_garbage(True, False)),
    Fault("garbage to the host", send_garbage(False, True)),
    Fault("garbage both ways", send_garbage(True, True)),
    Fault("1 byte in 2000 flipped, both ways", damage_bytes(0.0005, True, True), 0, True),
    Fault("1 byte in 40 flipped, both ways", damage_bytes(0.025, True, True)),
    Fault("wrong version", announce_wrong_version),
    Fault("short writes", write_few_bytes, 0, True),
    Fault("a write that ends short", truncate_write),
    Fault("sample rate lie", misreport_rate),
    Fault("second program, refused", open_from_second_program, 1, True),
    Fault("second program without a lock", write_from_second_program),
    Fault("asleep for 0.3 s", suspend_briefly, 0, True),
    Fault("asleep for more than 1 s", suspend_for_long),
    Fault("process killed", kill_player, 0),
)


FAULTS_NAME = "faults"
SEED = 20
TRIALS_PER_REPEAT = 20
"""Of each kind for each repeat: 100 with 5."""

QUICK_TRIALS = 2


def measure_faults(options: BenchOptions) -> list[Row]:
    """For each kind: how long something still sounded, by the device's sample clock; how many did not end well."""
    count = QUICK_TRIALS if options.quick else TRIALS_PER_REPEAT * options.repeats
    return [_make_row(kind, _run_fault(kind, count, options)) for kind in FAULTS]


def run_trials(fault: Fault, count: int, seed: int) -> list[Outcome]:
    """Let it happen so often, each time on a device of its own."""
    found = []
    for trial in range(count):
        with FaultRig(np.random.default_rng([seed, trial])) as rig:
            found.append(fault.trial(rig))
    return found


def find_violations(fault: Fault, outcome: Outcome) -> list[str]:
    """What was not as promised; nothing where all is well."""
    promises = {
        f"{1e3 * outcome.silent_after_s:.1f} ms until silence": outcome.silent_after_s <= MAX_SILENCE_DELAY_S,
        f"{len(outcome.messages)} messages": len(outcome.messages) == fault.expected_messages,
        f"{outcome.violations} counts beyond limits": outcome.violations == 0,
        "hung": not outcome.hung,
        f"does not start again ({outcome.restart_problem})": not outcome.restart_problem,
        "played on" if outcome.played_on else "did not play on": outcome.played_on == fault.survives,
    }
    return [broken for broken, kept in promises.items() if not kept]


def _run_fault(fault: Fault, count: int, options: BenchOptions) -> list[Outcome]:
    options.watch(f"{FAULTS_NAME}: {fault.name}")
    return run_trials(fault, count, SEED)


def _normalise_message(message: str) -> str:
    """Without the port and the figures, which differ each time."""
    return re.sub(r"\d+([.]\d+)?", "#", message.partition(": ")[2] or message)


def _make_row(fault: Fault, found: Sequence[Outcome]) -> Row:
    bad = [broken for outcome in found if (broken := find_violations(fault, outcome))]
    noticed = [outcome.noticed_s for outcome in found if outcome.noticed_s is not None]
    notes = ["plays on until stopped" if fault.survives else "ends"]
    if noticed:
        notes.append(f"known to the host within {1e3 * max(noticed):.0f} ms")
    told = Counter(_normalise_message(message) for outcome in found for message in outcome.messages)
    notes += [f"“{words}” × {times}" for words, times in told.most_common(2)]
    notes += [f"NOT WELL: {', '.join(broken)}" for broken in bad[:3]]
    return Row(
        FAULTS_NAME,
        fault.name,
        Spread.from_values([outcome.silent_after_s for outcome in found]),
        error=float(len(bad)),
        error_unit=f"of {len(found)} not as promised",
        note="; ".join(notes),
    )
