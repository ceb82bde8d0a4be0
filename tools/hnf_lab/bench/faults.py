"""Bench of stream faults on a serial device: one function per fault, injected at random frames.

Each fault runs on a virtual device behind a real pty. Every one must end in silence within MAX_SILENCE_DELAY_S, with
the promised number of messages, and the stream must be able to start again.
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
from hnf_core.actuators.virtual_serial_device import Capabilities, VirtualDevice
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
"""Function that injects a fault into a rig and returns the outcome."""

RATE_DETECTION_S = 40.0
"""Longest time until a wrong rate is detected [s].

A host that is itself late many times a second waits for calmer seconds before it reports the device; it starts a new
measurement every 10 s.
"""


@dataclass(frozen=True)
class Fault:
    """A kind of fault.

    Attributes
    ----------
    trial
        Function that injects it once.
    expected_messages
        Number of messages that the user must get.
    survives
        True if the stream must play on.
    """

    name: str
    trial: Trial
    expected_messages: int = 1
    survives: bool = False


def unplug(rig: FaultRig) -> Outcome:
    """Unplug the device, which has its own power supply."""
    rig.play_random_time()
    outcome = rig.wait_for_end(rig.inject_fault(rig.port.unplug))
    rig.port.plug()
    return replace(outcome, restart_problem=rig.restart())


def unplug_while_opening(rig: FaultRig) -> Outcome:
    """Unplug the device during or just after the handshake."""
    injected_at: list[int] = []
    timer = threading.Timer(
        float(rig.rng.uniform(0.0, 0.02)), lambda: injected_at.append(rig.inject_fault(rig.port.unplug))
    )
    timer.start()
    messages: tuple[str, ...] = ()
    try:
        rig.play()
    except DeviceError as error:
        messages = (str(error),)
    timer.join()
    if messages:
        outcome = Outcome(
            to_seconds(rig.device.last_sound_clock - injected_at[0]), messages, hung=not rig.wait_for_silence()
        )
    else:
        outcome = rig.wait_for_end(injected_at[0])
    rig.port.plug()
    return replace(outcome, restart_problem=rig.restart())


def stop_reading(rig: FaultRig) -> Outcome:
    """Make the device stop reading while it plays what it has and reports its credit."""

    def set_ignoring(ignoring: bool) -> None:
        rig.port.ignores_host = ignoring

    rig.play_random_time()
    outcome = rig.wait_for_end(rig.inject_fault(lambda: set_ignoring(True)))
    set_ignoring(False)
    return replace(outcome, restart_problem=rig.restart())


def damage_bytes(share: float, to_device: bool, to_host: bool) -> Trial:
    """Return a trial that flips a bit of every byte with probability `share`, from a random frame on."""

    def trial(rig: FaultRig) -> Outcome:
        def flip(data: bytes) -> bytes:
            values = np.frombuffer(data, dtype=np.uint8).copy()
            is_hit = rig.rng.random(len(values)) < share
            values[is_hit] ^= np.left_shift(1, rig.rng.integers(0, 8, int(is_hit.sum()))).astype(np.uint8)
            return values.tobytes()

        return _disturb_wire(rig, flip, to_device, to_host, ends=share > 0.01, gets_through=share < 0.1)

    return trial


def send_garbage(to_device: bool, to_host: bool) -> Trial:
    """Return a trial that replaces all data by random bytes, some of which look like the start of a message."""

    def trial(rig: FaultRig) -> Outcome:
        def replace_data(data: bytes) -> bytes:
            return rig.rng.bytes(len(data) // 2) + b"\xa5\x5a" + rig.rng.bytes(len(data) // 2)

        return _disturb_wire(rig, replace_data, to_device, to_host, ends=True)

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
    """Apply `wire` to the data. gets_through: enough arrives to play on until the host notices."""

    def set_wire(transform: Callable[[bytes], bytes]) -> None:
        if to_device:
            rig.port.from_host = transform
        if to_host:
            rig.port.to_host = transform

    rig.play_random_time()
    injected_at = rig.inject_fault(lambda: set_wire(wire))
    if not ends:
        rig.wait_for_frames(rig.device.played + RATE_HZ // 2)
        with rig.port.freeze_clock():
            set_wire(bytes)
        return rig.stop_stream()
    since = SilenceOrigin.NOTICE if gets_through else SilenceOrigin.FAULT if to_device else SilenceOrigin.SAMPLES
    outcome = rig.wait_for_end(injected_at, since)
    with rig.port.freeze_clock():
        set_wire(bytes)
    return replace(outcome, restart_problem=rig.restart())


def announce_wrong_version(rig: FaultRig) -> Outcome:
    """Restart the device with firmware of version 2."""

    def restart_device(version: int) -> None:
        port = rig.port
        port.device = VirtualDevice(Capabilities(version=version), on_output=port.recording.record)

    rig.play_random_time()
    assert rig.stream is not None
    rig.stream.stop()
    rig.wait_for_silence()
    rig.port.recording.clear()
    rig.inject_fault(lambda: restart_device(2))
    messages: tuple[str, ...] = ()
    try:
        rig.play()
    except DeviceError as error:
        messages = (str(error),)
    last_sound = rig.device.last_sound_clock
    rig.inject_fault(lambda: restart_device(1))
    names_both = all("version 1" in text and "version 2" in text for text in messages)
    return Outcome(
        last_sound / RATE_HZ,
        messages if names_both else (*messages, "does not name both"),
        restart_problem=rig.restart(),
    )


def misreport_rate(rig: FaultRig) -> Outcome:
    """Run the sample clock 15 to 30 % too fast or too slow."""

    def set_speed(speed: float) -> None:
        rig.port.speed = speed

    rig.play_random_time()
    deviation = float(rig.rng.choice([-1.0, 1.0]) * rig.rng.uniform(0.15, 0.3))
    outcome = rig.wait_for_end(
        rig.inject_fault(lambda: set_speed(1.0 + deviation)), SilenceOrigin.NOTICE, RATE_DETECTION_S
    )
    set_speed(1.0)
    names_rate = all(f"{RATE_HZ} Hz" in text for text in outcome.messages)
    messages = outcome.messages if names_rate else (*outcome.messages, "does not name the rate")
    return replace(outcome, messages=messages, restart_problem=rig.restart())


def open_from_second_program(rig: FaultRig) -> Outcome:
    """Open the port from a second program while we play: it is refused, we play on."""
    rig.play_random_time()
    messages: tuple[str, ...] = ()
    try:
        SerialSink(rig.port.path).open()
    except DeviceError as error:
        messages = (str(error),)
    return rig.stop_stream(messages)


def write_from_second_program(rig: FaultRig) -> Outcome:
    """Write HELLO, START and samples from a second program that takes no lock, into our stream."""
    rig.play_random_time()
    encoder = Encoder()
    loud = np.full((32, 1), 30_000, dtype=np.int16)
    data = b"".join(
        encoder.encode(message) for message in (Hello(), Start(RATE_HZ, 1, 32767, 1), Samples.from_counts(1, 0, loud))
    )

    def intrude() -> None:
        port = os.open(rig.port.path, os.O_RDWR | os.O_NOCTTY)
        try:
            os.write(port, data)
        finally:
            os.close(port)

    return replace(rig.wait_for_end(rig.inject_fault(intrude), SilenceOrigin.NOTICE), restart_problem=rig.restart())


def write_few_bytes(rig: FaultRig) -> Outcome:
    """Let the system accept a few bytes of each write: slower, but complete."""
    with _patch_system_write(lambda descriptor, data: os.write(descriptor, data[: int(rig.rng.integers(1, 40))])):
        rig.play_random_time()
        outcome = rig.stop_stream()
    return outcome


def truncate_write(rig: FaultRig) -> Outcome:
    """Let the system accept half of a message and then nothing more."""
    budget: list[int] = []

    def write(descriptor: int, data: bytes) -> int:
        accepted = bytes(data) if not budget else bytes(data)[: budget[0]]
        if not accepted:
            raise BlockingIOError(errno.EAGAIN, "full")
        count = os.write(descriptor, accepted)
        if budget:
            budget[0] -= count
        return count

    with _patch_system_write(write):
        rig.play_random_time()
        outcome = rig.wait_for_end(rig.inject_fault(lambda: budget.append(int(rig.rng.integers(1, 40)))))
    return replace(outcome, restart_problem=rig.restart())


@contextmanager
def _patch_system_write(write: Callable[[int, bytes], int]) -> Iterator[None]:
    """Route the system writes of pyserial through `write`."""
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
    """Stop the stream without any fault."""
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
"""Number of trials of each fault per repeat: 100 with 5 repeats."""

QUICK_TRIALS = 2


def measure_faults(options: BenchOptions) -> list[Row]:
    """Measure, for each fault, the time to silence by the device's sample clock and the number of failures."""
    count = QUICK_TRIALS if options.quick else TRIALS_PER_REPEAT * options.repeats
    return [_make_row(kind, _run_fault(kind, count, options)) for kind in FAULTS]


def run_trials(fault: Fault, count: int, seed: int) -> list[Outcome]:
    """Run the fault `count` times, each time on a new device."""
    outcomes = []
    for trial in range(count):
        with FaultRig(np.random.default_rng([seed, trial])) as rig:
            outcomes.append(fault.trial(rig))
    return outcomes


def find_violations(fault: Fault, outcome: Outcome) -> list[str]:
    """Return the broken promises; empty if all is well."""
    promises = {
        f"{1e3 * outcome.silent_after_s:.1f} ms until silence": outcome.silent_after_s <= MAX_SILENCE_DELAY_S,
        f"{len(outcome.messages)} messages": len(outcome.messages) == fault.expected_messages,
        f"{outcome.violations} counts beyond limits": outcome.violations == 0,
        "hung": not outcome.hung,
        f"does not start again ({outcome.restart_problem})": not outcome.restart_problem,
        "played on" if outcome.played_on else "did not play on": outcome.played_on == fault.survives,
    }
    return [text for text, is_kept in promises.items() if not is_kept]


def _run_fault(fault: Fault, count: int, options: BenchOptions) -> list[Outcome]:
    options.watch(f"{FAULTS_NAME}: {fault.name}")
    return run_trials(fault, count, SEED)


def _normalise_message(message: str) -> str:
    """Return the message without the port and without numbers, which differ each time."""
    return re.sub(r"\d+([.]\d+)?", "#", message.partition(": ")[2] or message)


def _make_row(fault: Fault, found: Sequence[Outcome]) -> Row:
    failures = [problems for outcome in found if (problems := find_violations(fault, outcome))]
    noticed = [outcome.noticed_s for outcome in found if outcome.noticed_s is not None]
    notes = ["plays on until stopped" if fault.survives else "ends"]
    if noticed:
        notes.append(f"known to the host within {1e3 * max(noticed):.0f} ms")
    counts = Counter(_normalise_message(message) for outcome in found for message in outcome.messages)
    notes += [f"“{text}” × {times}" for text, times in counts.most_common(2)]
    notes += [f"NOT WELL: {', '.join(problems)}" for problems in failures[:3]]
    return Row(
        FAULTS_NAME,
        fault.name,
        Spread.from_values([outcome.silent_after_s for outcome in found]),
        error=float(len(failures)),
        error_unit=f"of {len(found)} not as promised",
        note="; ".join(notes),
    )
