"""Properties of the output of the device core of tools/firmware for any input, clocked by its tick alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest
from firmware_host import QUEUE, RAMP, RATE, Check, Device, build, credits_of, errors_of
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hnf_core.actuators.serial_protocol import Bye, ErrorCode, Hello, Samples, Start, State, Stop, encode_frame
from hnf_core.actuators.serial_protocol import Credit as Credits

Counts = NDArray[np.int16]
SEEDS = st.integers(0, 2**32 - 1)


@pytest.fixture(scope="module")
def check(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Check]:
    found = Check(build("check", tmp_path_factory.mktemp("check")))
    yield found
    said = found.end()
    assert said == "", said


def noise(seed: int, frames: int, channels: int, peak: int = 32767) -> Counts:
    return np.random.default_rng(seed).integers(-peak, peak + 1, (frames, channels)).astype(np.int16)


def started(check: Check, channels: int = 2, **limits: int) -> Device:
    device = Device(check, channels=channels)
    device.start(**limits)
    return device


def without_silence_before(played: Counts) -> Counts:
    sounding = np.flatnonzero(np.any(played != 0, axis=1))
    return played[sounding[0] :] if len(sounding) else played[:0]


@settings(deadline=None)
@given(
    seed=SEEDS,
    channels=st.integers(1, 16),
    frames=st.integers(200, 400),
    piece=st.integers(1, 63),
    step=st.integers(5, 40),
)
def test_what_is_sent_is_played_byte_for_byte(
    check: Check, seed: int, channels: int, frames: int, piece: int, step: int
) -> None:
    device = started(check, channels)
    sent = noise(seed, frames, channels)
    sent[0] = 1
    played = without_silence_before(device.stream(sent, piece, step))[:frames]
    assert played.tobytes() == sent[: len(played)].tobytes()
    assert len(played) > frames - step - 1
    status = device.status()
    assert (status.lost, status.limited, status.crc_errors) == (0, 0, 0)


@settings(max_examples=200, deadline=None)
@given(
    data=st.data(),
    seed=SEEDS,
    peak=st.integers(1, 32767),
    channels=st.integers(1, 3),
    queue=st.sampled_from([0, 1, 7, 60]),
)
def test_no_count_beyond_peak_and_no_step_beyond_slew(
    check: Check, data: st.DataObject, seed: int, peak: int, channels: int, queue: int
) -> None:
    """Whatever comes, when it comes, what is lost, and however it ends."""
    smallest = -(-peak // RAMP)
    slew = data.draw(st.one_of(st.just(smallest), st.integers(smallest, 65535)))
    device = started(check, channels, peak=peak, slew=slew, queue=queue)
    rng, out = np.random.default_rng(seed), []
    for what in data.draw(st.lists(st.sampled_from(["send", "lose", "play", "wait", "stop", "again"]), max_size=25)):
        if what in ("send", "lose"):
            counts = rng.choice([-32768, 32767, 0, 5, -5000], (int(rng.integers(0, 90)), channels)).astype(np.int16)
            message = device.samples(counts)
            if what == "send":
                device.send(message)
        elif what == "stop":
            device.send(Stop(bool(rng.integers(2))))
        elif what == "again":
            device.send(Hello(), Start(RATE, channels, peak, device.session, slew, queue))
            device.sent = 0
        else:
            out.append(device.tick(int(rng.integers(1, 60)) if what == "play" else 60))
            device.poll()
    out.append(device.tick(QUEUE + 2 * RAMP))
    played = np.concatenate([np.zeros((1, channels), np.int16), *out]).astype(int)
    assert np.abs(played).max() <= peak
    assert np.abs(np.diff(played, axis=0)).max() <= slew


def fill(device: Device, frames: int) -> None:
    """At full scale, from which silence is farthest."""
    device.send(device.samples(np.full((frames, device.channels), 32767, np.int16)))


ENDS: dict[str, Callable[[Device], object]] = {
    "nothing more": lambda device: None,
    "cable out": lambda device: device.do("U"),
    "STOP": lambda device: device.send(Stop()),
    "STOP after what is queued": lambda device: device.send(Stop(True)),
    "BYE": lambda device: device.send(Bye()),
    "garbage": lambda device: device.feed(bytes(range(256)) * 5 + b"\xa5\x5a\x03\x00\x00\x08"),
    "half a message": lambda device: device.feed(device.encode(Samples(7, 0, bytes(300)))[:200]),
    "hardware fault": lambda device: device.do("X"),
    "more than the credit": lambda device: device.send(Samples(7, device.sent, bytes(2000))),
    "samples of another": lambda device: device.send(Samples(8, device.sent, bytes(200))),
}


@pytest.mark.parametrize("end", ENDS)
@given(first=st.integers(0, QUEUE), played=st.integers(0, 400), again=st.integers(0, QUEUE), more=st.integers(0, 60))
@example(first=QUEUE, played=QUEUE + 1, again=QUEUE, more=0)
@settings(max_examples=40, deadline=None)
def test_silence_within_20_ms_of_the_last_byte(
    check: Check, end: str, first: int, played: int, again: int, more: int
) -> None:
    """Also when samples came back just after an underrun, or too few to begin with."""
    device = started(check)
    fill(device, first)
    device.tick(played)
    credit = credits_of(device.ask())[-1]
    fill(device, min(again, credit.compute_sendable_frames(device.sent)))
    device.tick(more)
    ENDS[end](device)
    after = device.tick(RATE * 60 // 1000)
    assert not after[RATE * 20 // 1000 :].any()
    if end in ("cable out", "STOP", "BYE", "hardware fault"):
        assert not after[RAMP:].any()


def test_all_of_the_20_ms_are_used_at_most_19(check: Check) -> None:
    """The bound above is met by a full queue, so that it is no accident."""
    device = started(check)
    device.send(device.samples(np.full((QUEUE, 2), 32767, np.int16)))
    played = device.tick(300)
    assert int(np.flatnonzero(played.any(axis=1))[-1]) + 1 == QUEUE + RAMP - 1


def bridged(whole: Counts, kept: NDArray[np.bool_]) -> Counts:
    """The plain reference: lost frames on the straight line between their neighbours, rounded towards the first."""
    found = whole.astype(int)
    at = 0
    while at < len(whole):
        if kept[at]:
            at += 1
            continue
        end = at + int(np.argmax(kept[at:]))
        before = found[at - 1] if at else np.zeros(whole.shape[1], int)
        for k in range(1, end - at + 1):
            found[at + k - 1] = before + np.trunc((whole[end] - before) * k / (end - at + 1)).astype(int)
        at = end
    return found.astype(np.int16)


@settings(deadline=None)
@given(seed=SEEDS, pieces=st.lists(st.tuples(st.integers(1, 25), st.booleans()), max_size=5), last=st.integers(1, 25))
def test_lost_samples_are_interpolated_without_a_time_shift(
    check: Check, seed: int, pieces: list[tuple[int, bool]], last: int
) -> None:
    device = started(check)
    kept = np.concatenate([np.full(count, arrives) for count, arrives in [*pieces, (last, True)]])
    whole = noise(seed, len(kept), 2)
    for count, arrives in [*pieces, (last, True)]:
        message = device.samples(whole[device.sent : device.sent + count])
        if arrives:
            device.send(message)
    device.send(Stop(True))
    np.testing.assert_array_equal(device.tick(len(kept)), bridged(whole, kept))
    status = device.status()
    assert (status.lost, status.limited, status.underruns) == (int((~kept).sum()), 0, 0)


@settings(deadline=None)
@given(seed=SEEDS, step=st.integers(1, 3000))
def test_a_line_is_never_steeper_than_what_was_sent(check: Check, seed: int, step: int) -> None:
    rng = np.random.default_rng(seed)
    walk = np.cumsum(rng.integers(-step, step + 1, (140, 2)), axis=0)
    walk = np.abs((walk + 32767) % (4 * 32767) - 2 * 32767) - 32767  # folded at full scale: as steep as before
    device = started(check)
    at = 0
    while at < len(walk):
        count = int(rng.integers(1, 20))
        message = device.samples(walk[at : at + count].astype(np.int16))
        if rng.random() < 0.6 or at + count >= len(walk):
            device.send(message)
        at += count
    device.send(Stop(True))
    played = device.tick(len(walk)).astype(int)
    # The first frames may be lost too: their line starts at 0, where the walk does not.
    first = int(np.abs(walk[0]).max())
    assert np.abs(np.diff(played, axis=0)).max() <= max(step, first)


def test_an_empty_message_resumes_after_all_samples_were_lost(check: Check) -> None:
    device = started(check)
    device.samples(noise(1, QUEUE, 2))
    credit = credits_of(device.ask())[-1]
    assert (credit.compute_sendable_frames(device.sent), credit.free) == (0, QUEUE)
    device.send(Samples(device.session, device.sent, b""))
    device.tick(QUEUE + RAMP)
    assert credits_of(device.ask())[-1].compute_sendable_frames(device.sent) == QUEUE
    assert device.status().lost == QUEUE


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_the_queue_never_overruns(check: Check, data: st.DataObject) -> None:
    """Any positions, any lengths, any noise: it never owes more than the queue, nor plays what was overwritten."""
    device = started(check, queue=data.draw(st.integers(0, 200)))
    queue = credits_of(device.ask())[-1].queue
    assert queue <= QUEUE
    for _ in range(data.draw(st.integers(1, 15))):
        position = device.sent + data.draw(st.one_of(st.integers(-50, 250), st.integers(-(2**31), 2**31)))
        count = data.draw(st.integers(0, 300))
        device.send(Samples(device.session, position & 0xFFFFFFFF, bytes(4 * count)))
        device.tick(data.draw(st.integers(0, 60)))
        device.feed(data.draw(st.binary(max_size=30)))
        credit = credits_of(device.ask())[-1]
        assert 0 <= credit.free <= credit.queue == queue
        device.sent = credit.played + credit.queue - credit.free
    device.tick(QUEUE + 2 * RAMP)
    assert not device.tick(10).any()


@settings(deadline=None)
@given(before=st.integers(2**32 - 400, 2**32 - 1), piece=st.integers(5, 40))
def test_totals_wrap(check: Check, before: int, piece: int) -> None:
    """As after 4 294 967 296 frames, 119 hours at 10 kHz."""
    device = started(check)
    device.do("W", before)
    device.sent = before
    sent = noise(before, 600, 2)
    sent[0] = 1
    played = without_silence_before(device.stream(sent, piece, 10))[:600]
    assert played.tobytes() == sent[: len(played)].tobytes()
    assert device.status().lost == 0


def test_after_an_underrun_it_rises_from_what_still_fades(check: Check) -> None:
    device = started(check, 1, peak=20000)
    device.send(device.samples(np.full((QUEUE, 1), 20000, np.int16)))
    device.tick(QUEUE)
    falling = device.tick(10).ravel()
    assert np.array_equal(falling, 20000 - 500 * np.arange(1, 11))
    device.send(device.samples(np.full((QUEUE, 1), 10000, np.int16)))
    both = device.tick(QUEUE).ravel().astype(int)
    fading = np.maximum(15000 - 500 * np.arange(1, QUEUE + 1), 0)
    assert np.array_equal(both, fading + 10000 * np.minimum(np.arange(1, QUEUE + 1), RAMP) // RAMP)
    assert device.status().underruns == 1


@settings(deadline=None)
@given(
    st.lists(
        st.one_of(
            st.binary(max_size=80),
            st.sampled_from(
                [
                    encode_frame(Hello(), 1),
                    encode_frame(Start(RATE, 2, 900, 7), 2),
                    encode_frame(Start(1000, 1, 900, 7, 900, 3), 2),
                    encode_frame(Samples(7, 0, bytes(range(200))), 3),
                    encode_frame(Stop(), 4),
                    encode_frame(Bye(), 4),
                ]
            ),
        ),
        max_size=30,
    ),
    SEEDS,
)
def test_no_bytes_do_harm(check: Check, chunks: list[bytes], seed: int) -> None:
    """And afterwards a host is served as ever."""
    rng = np.random.default_rng(seed)
    device = Device(check)
    for chunk in chunks:
        device.feed(chunk)
        device.pause(float(rng.choice([0.0, 0.001, 0.03])))
        assert np.abs(device.tick(int(rng.integers(0, 50))).astype(int)).max(initial=0) <= 900
        device.poll()
    device.tick(300)
    device.pause(0.1)
    device.poll()
    device.start()
    sent = noise(seed, 300, 2)
    sent[0] = 1
    played = without_silence_before(device.stream(sent, 20, 10))[:300]
    assert played.tobytes() == sent[: len(played)].tobytes()


def test_a_credit_is_never_lacking(check: Check) -> None:
    """Its place in the stream, every millisecond of a stream, whatever the state."""
    device = started(check)
    fill(device, 100)
    for _ in range(30):
        device.tick(10)
        (credit,) = credits_of(device.poll())
        assert credit.played == min(100, device._ticks)
        assert (credit.session, credit.queue) == (7, QUEUE)
    assert credit == Credits(7, 100, QUEUE, QUEUE, State.WAITING)
    assert ErrorCode.OVERRUN in errors_of(device.send(Samples(7, 100, bytes(4 * QUEUE + 4))))
