"""Output and limits of the virtual device; test_firmware_virtual.py compares it with the firmware."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.actuators.serial_protocol import (
    FROM_DEVICE,
    Bye,
    Caps,
    Credit,
    Decoder,
    Encoder,
    Error,
    ErrorCode,
    Hello,
    Message,
    Samples,
    Start,
    State,
    Stop,
)
from hnf_core.actuators.virtual_port import Recording
from hnf_core.actuators.virtual_serial_device import (
    Capabilities,
    Playout,
    PlayoutCommand,
    PlayoutFormat,
    VirtualDevice,
    compute_queue_frames,
    interpolate_gap,
)
from hnf_core.actuators.virtual_transducer import GENERIC_TRANSDUCER, Transducer, counts_to_drive, simulate_motion
from reference.device_reference import ReferencePlayout

RATE = 8000
QUEUE, RAMP = 120, 32
"""Frames of 15 ms and 4 ms."""

ACTIONS = st.one_of(
    st.tuples(st.just("push"), st.integers(0, 90), st.integers(0, 2**32 - 1)),
    st.tuples(st.just("advance"), st.integers(0, 200), st.just(0)),
    st.tuples(st.just("command"), st.integers(1, 3), st.just(0)),
)
FORMATS = st.builds(
    PlayoutFormat,
    st.integers(1, 3),
    st.integers(1, 150),
    st.integers(1, 32767),
    st.sampled_from([3000, 9000, 65535]),
    st.integers(4, 60),
)


def loud(count: int, seed: int = 0, channels: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).integers(-32768, 32768, (count, channels)).astype(np.int16)


@given(FORMATS, st.lists(ACTIONS, max_size=25))
@settings(max_examples=150, deadline=None)
def test_whole_pieces_are_what_tick_by_tick_is(form: PlayoutFormat, actions: list[tuple[str, int, int]]) -> None:
    fast, plain = Playout(form), ReferencePlayout(form)
    for action, argument, seed in actions:
        if action == "push":
            counts = loud(min(argument, fast.free), seed, form.channels)
            fast.push(counts)
            plain.push(counts)
        elif action == "command":
            fast.command = plain.command = PlayoutCommand(argument)
        else:
            np.testing.assert_array_equal(fast.advance(argument), plain.advance(argument))
        assert (fast.phase, fast.fill, fast.played) == (plain.phase, plain.fill, plain.played)
        assert (fast.underruns, fast.limited) == (plain.underruns, plain.limited)


@given(FORMATS, st.lists(ACTIONS, max_size=25))
@settings(max_examples=100, deadline=None)
def test_the_output_stays_within_limits_and_ends_in_silence(
    form: PlayoutFormat, actions: list[tuple[str, int, int]]
) -> None:
    playout, out = Playout(form), [np.zeros((1, form.channels), dtype=np.int16)]
    for action, argument, seed in actions:
        if action == "push":
            playout.push(loud(min(argument, playout.free), seed, form.channels))
        elif action == "command":
            playout.command = PlayoutCommand(argument)
        else:
            out.append(playout.advance(argument))
    owed = playout.advance(form.queue + 2 * form.ramp + 1)
    assert not owed[form.ramp + form.queue + form.ramp :].any()
    everything = np.concatenate([*out, owed]).astype(np.int64)
    assert np.abs(everything).max() <= form.peak
    assert np.abs(np.diff(everything, axis=0)).max(initial=0) <= max(form.slew, form.step)


class Host:
    """The other end of a device's wire, without a wire."""

    def __init__(self, abilities: Capabilities | None = None, transducer: Transducer = GENERIC_TRANSDUCER) -> None:
        self.recording = Recording(transducer)
        self.device = VirtualDevice(abilities, transducer, self.recording.record)
        self._encoder, self._decoder = Encoder(), Decoder(FROM_DEVICE)

    def says(self, *messages: Message) -> list[Message]:
        self.device.receive(b"".join(self._encoder.encode(message) for message in messages))
        return self.hears()

    def hears(self) -> list[Message]:
        return self._decoder.feed(self.device.poll_output())

    def begins(self, channels: int = 1) -> None:
        self.says(Hello(), Start(RATE, channels, 32767, 1))

    def sends(self, position: int, counts: np.ndarray) -> list[Message]:
        return self.says(Samples.from_counts(1, position, counts))


def errors(messages: list[Message]) -> list[int]:
    return [message.code for message in messages if isinstance(message, Error)]


@given(st.integers(1, 500), st.integers(0, 99))
@settings(max_examples=30, deadline=None)
def test_a_host_that_dies_leaves_silence_within_20_ms(frames: int, seed: int) -> None:
    host = Host()
    host.begins()
    sent = 0
    for _ in range(frames):
        room = QUEUE - (sent - host.device.played)
        sent += len(counts := loud(room, seed + sent))
        host.sends(sent - len(counts), counts)
        host.device.advance(1)
    died = host.device.clock
    host.device.advance(RATE)
    assert host.device.last_sound_clock - died <= 0.020 * RATE
    assert host.device.state is State.WAITING
    assert host.device.status.underruns == 1


@pytest.mark.parametrize("end", [Stop(), Bye()])
def test_stop_fades_at_once(end: Message) -> None:
    host = Host()
    host.begins()
    host.sends(0, np.full((100, 1), 20_000, dtype=np.int16))
    host.device.advance(20)
    stopped = host.device.clock
    host.says(end)
    fading = host.device.advance(200)[:, 0]
    assert host.device.last_sound_clock - stopped < RAMP
    assert np.all(np.diff(fading) <= 0)
    assert host.device.state is (State.READY if isinstance(end, Stop) else State.IDLE)
    assert host.device.played == 20


def test_draining_plays_all_and_counts_no_underrun() -> None:
    host, counts = Host(), loud(50, 3)
    host.begins()
    host.sends(0, counts)
    host.says(Stop(drain=True))
    played = host.device.advance(200)
    np.testing.assert_array_equal(played[:50], np.maximum(counts, -32767))
    assert (host.device.state, host.device.status.underruns) == (State.READY, 0)


def test_the_stream_keeps_its_time_over_lost_samples() -> None:
    host = Host()
    host.begins()
    ramp = (100 * np.arange(1, 91))[:, None].astype(np.int16)
    host.sends(0, ramp[:30])
    host.sends(60, ramp[60:90])
    np.testing.assert_array_equal(host.device.advance(90), ramp)
    assert (host.device.status.lost, host.device.played) == (30, 90)


@given(st.integers(-32767, 32767), st.integers(-32767, 32767), st.integers(0, 100))
def test_a_bridge_is_straight_and_between_its_ends(one: int, other: int, gap: int) -> None:
    line = interpolate_gap(np.array([one], dtype=np.int16), np.array([other], dtype=np.int16), gap)[:, 0]
    exact = one + (other - one) * np.arange(1, gap + 1) / (gap + 1)
    assert np.abs(line - exact).max(initial=0.0) < 1.0
    assert np.all((line >= min(one, other)) & (line <= max(one, other)))


def test_a_damaged_length_delays_samples_but_not_a_stop() -> None:
    """The decoder waits for the rest of a message that never was so long; 20 ms later it looks at what it has."""
    for late, state in ((Samples.from_counts(1, 60, loud(60)), State.WAITING), (Stop(), State.READY)):
        host = Host()
        host.begins()
        host.sends(0, loud(60))
        encoder = Encoder()
        damaged = bytearray(encoder.encode(Samples.from_counts(1, 60, loud(8))))
        damaged[5] = 7
        host.device.receive(bytes(damaged) + encoder.encode(late))
        host.device.advance(RATE)
        assert host.device.last_sound_clock <= 0.020 * RATE
        assert host.device.state is state


def test_credit_comes_every_two_milliseconds_and_is_true() -> None:
    host = Host()
    host.begins()
    host.hears()
    host.sends(0, loud(QUEUE))
    host.device.advance(80)
    credits = [message for message in host.hears() if isinstance(message, Credit)]
    assert len(credits) >= 5
    assert credits[-1] == Credit(1, 80, QUEUE, 80, State.PLAYING)
    assert credits[-1].compute_sendable_frames(QUEUE) == 80


@pytest.mark.parametrize(
    ("start", "code"),
    [
        (Start(999, 1, 32767, 1), ErrorCode.RATE),
        (Start(48_001, 1, 32767, 1), ErrorCode.RATE),
        (Start(RATE, 0, 32767, 1), ErrorCode.CHANNELS),
        (Start(RATE, 17, 32767, 1), ErrorCode.CHANNELS),
        (Start(RATE, 1, 0, 1), ErrorCode.LIMITS),
        (Start(RATE, 1, 32767, 1, slew=1000), ErrorCode.LIMITS),
        (Start(RATE, 1, 32767, 1, flags=1), ErrorCode.MALFORMED),
    ],
)
def test_what_it_cannot_do_is_refused(start: Start, code: ErrorCode) -> None:
    host = Host()
    assert errors(host.says(start)) == [ErrorCode.STATE]
    host.says(Hello())
    assert errors(host.says(start)) == [code]
    assert host.device.state is State.READY


def test_versions_meet_or_do_not() -> None:
    host = Host(Capabilities(version=2, name="Zwei"))
    refused = host.says(Hello(1, 1))
    assert errors(refused) == [ErrorCode.VERSION]
    assert isinstance(refused[0], Error)
    assert "version 2" in refused[0].text
    (caps, *_) = host.says(Hello(1, 3))
    assert isinstance(caps, Caps)
    assert (caps.version, caps.name, caps.queue) == (2, "Zwei", compute_queue_frames(48_000))


def _twice(host: Host) -> list[Message]:
    return host.says(Hello())


def _foreign(host: Host) -> list[Message]:
    return host.says(Samples.from_counts(9, 0, loud(5)))


def _too_much(host: Host) -> list[Message]:
    return host.sends(60, loud(QUEUE))


@pytest.mark.parametrize(
    ("intrude", "code"), [(_twice, ErrorCode.BUSY), (_foreign, ErrorCode.SESSION), (_too_much, ErrorCode.OVERRUN)]
)
def test_another_host_or_too_much_does_not_change_what_plays(
    intrude: Callable[[Host], list[Message]], code: ErrorCode
) -> None:
    host, counts = Host(), loud(60, 5)
    host.begins()
    host.sends(0, counts)
    first = host.device.advance(20)
    assert errors(intrude(host)) == [code]
    np.testing.assert_array_equal(np.concatenate([first, host.device.advance(40)]), np.maximum(counts, -32767))


def test_a_hot_coil_ends_the_stream() -> None:
    host = Host(Capabilities(shutdown_c=30.0), Transducer(thermal_s=0.5))
    host.begins()
    sent, said = 0, host.hears()
    for _ in range(400):
        room = QUEUE - (sent - host.device.played)
        said += host.sends(sent, np.full((room, 1), 32767, dtype=np.int16))
        sent += room
        host.device.advance(40)
        if host.device.state is State.FAULT:
            break
    assert host.device.state is State.FAULT
    assert errors(said + host.hears()) == [ErrorCode.HOT]
    assert host.device.temperature_c == pytest.approx(30.0, abs=2.0)
    host.device.advance(RATE)
    assert host.device.clock - host.device.last_sound_clock > RATE // 2


def test_the_temperature_that_is_told_is_that_of_the_whole_model() -> None:
    host = Host()
    host.begins()
    sent, played = 0, []
    for _ in range(100):
        room = QUEUE - (sent - host.device.played)
        host.sends(sent, loud(room, sent))
        sent += room
        played.append(host.device.advance(80))
    exact = simulate_motion(GENERIC_TRANSDUCER, counts_to_drive(np.concatenate(played)), RATE).end.temperature[0]
    assert host.device.temperature_c == pytest.approx(exact, abs=0.05)
    np.testing.assert_array_equal(host.recording.counts, np.concatenate(played)[np.concatenate(played).any(axis=1)])


def test_a_recording_holds_the_silence_between_sounds() -> None:
    recording = Recording()
    assert recording.counts.shape == (0, 1)
    recording.record(100, 8000, np.array([[0], [5]], dtype=np.int16))
    recording.record(105, 8000, np.array([[7], [0]], dtype=np.int16))
    assert recording.counts[:, 0].tolist() == [5, 0, 0, 0, 7]
    recording.record(200, 4000, np.array([[3, 4]], dtype=np.int16))
    assert recording.counts.tolist() == [[3, 4]]
    assert recording.motion.acceleration.shape == (1, 2)


@given(st.lists(st.tuples(st.integers(0, 40), st.integers(1, 9000)), min_size=1, max_size=12), st.integers(0, 99))
@settings(max_examples=30, deadline=None)
def test_a_recording_is_all_that_was_heard_however_it_came(pieces: list[tuple[int, int]], seed: int) -> None:
    recording, whole = Recording(), [np.zeros((0, 2), dtype=np.int16)]
    for gap, count in pieces:
        whole.append(np.zeros((gap, 2), dtype=np.int16))
        sound = np.random.default_rng(seed).integers(1, 99, (count, 2)).astype(np.int16)
        recording.record(sum(map(len, whole)), 8000, sound)
        whole.append(sound)
    np.testing.assert_array_equal(recording.counts, np.concatenate(whole)[pieces[0][0] :])
