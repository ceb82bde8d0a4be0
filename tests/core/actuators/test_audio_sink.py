"""The audio sink on a real sound server: the output receives the samples that are written."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from sound_server import RATE_HZ, SoundServer, sound_server, why_not

from hnf_core.actuators.limits import Limits
from hnf_core.actuators.signal_chain import render_counts
from hnf_core.actuators.sink import RAMP_S
from hnf_core.actuators.sinks.audio import CALLBACK_TIMEOUT_S, QUEUE_S, AudioSink
from hnf_core.actuators.sources import BufferSource
from hnf_core.actuators.stream import Stream
from hnf_core.actuators.stream_targets import list_devices
from hnf_core.errors import DeviceError

needs_server = pytest.mark.skipif(why_not() != "", reason=why_not())
RAMP = int(RAMP_S * RATE_HZ)

CALM_S = 0.3
"""Owed at most: a machine that is busy with other tests is late by more than a live device may owe."""

Counts = NDArray[np.int16]


@pytest.fixture
def server(tmp_path: Path) -> Iterator[SoundServer]:
    with sound_server(tmp_path) as running:
        yield running


def noise(frames: int, channels: int = 1) -> Counts:
    return np.random.default_rng(1).integers(-20000, 20000, (frames, channels)).astype(np.int16)


def play(sink: AudioSink, counts: Counts) -> None:
    at = 0
    while at < len(counts):
        room = sink.wait(0.5)
        sink.write(counts[at : at + room])
        at += room


def place_of(counts: Counts, heard: Counts) -> int:
    """Where in heard (n,) the counts (m,) lie, by cross-correlation."""
    size = 1 << (len(heard) + len(counts)).bit_length()
    product = np.fft.rfft(heard.astype(float), size) * np.conj(np.fft.rfft(counts.astype(float), size))
    return int(np.argmax(np.fft.irfft(product, size)[: len(heard)]))


def without_underruns(attempt: int, underruns: int) -> bool:
    """A busy machine may be late; then what came is tried again, three times."""
    if underruns:
        assert attempt < 3, "it was late four times"
    return underruns == 0


def heard_of(counts: Counts, found: Counts) -> Counts:
    """As long a part of what was recorded, from where counts begin in it."""
    at = place_of(counts[:, 0], found[:, 0])
    return found[at : at + len(counts)]


@needs_server
@pytest.mark.parametrize("channels", [1, 2])
def test_what_is_written_is_what_the_output_gets(server: SoundServer, channels: int) -> None:
    counts, sink = noise(RATE_HZ // 2, channels), AudioSink(channels=channels, queue_s=CALM_S)
    both = counts if channels == 2 else np.repeat(counts, 2, axis=1)
    for _ in range(4):  # on a busy machine the recorder loses some too, and says nothing
        with server.recording() as found:
            form = sink.open()
            play(sink, counts)
            sink.finish(2.0)
            status = sink.status()
            sink.close()
        heard = heard_of(both, found[0])
        if np.array_equal(heard, both):
            break
    assert np.array_equal(heard, both)
    assert (form.rate_hz, form.channels) == (RATE_HZ, channels)
    assert form.queue_frames <= CALM_S * RATE_HZ
    assert status.played == len(counts)
    assert status.underruns == 0
    assert np.abs(found[0].astype(int)).max() <= 20000


@needs_server
def test_a_stream_reaches_the_output_as_its_chain_made_it(server: SoundServer) -> None:
    """From 10 kHz, and beyond the limits."""
    samples = np.random.default_rng(2).normal(0.0, 12.0, (8000, 1)).astype(np.float32)
    limits = Limits(30.0, peak=0.7)
    for _ in range(4):
        with server.recording() as found:
            stream = Stream(BufferSource(samples, 10_000.0), AudioSink(queue_s=CALM_S), limits, block_s=0.02)
            with stream:
                device = stream.start()
                assert stream.wait(20.0)
        assert stream.report.problem == ""
        expected = np.repeat(render_counts(BufferSource(samples, 10_000.0), device, limits), 2, axis=1)
        heard = heard_of(expected, found[0])
        if np.array_equal(heard, expected):
            break
    assert np.array_equal(heard, expected)
    assert np.abs(found[0].astype(int)).max() <= limits.peak_counts


@needs_server
def test_what_is_missing_fades_and_is_counted(server: SoundServer) -> None:
    sink, piece = AudioSink(queue_s=CALM_S), np.full((200, 1), 16000, np.int16)
    for attempt in range(4):
        with server.recording() as found:
            sink.open()
            sink.write(piece)
            time.sleep(0.1)
            assert sink.status().underruns >= 1
            assert sink.wait(0.0) > 0
            sink.write(piece)
            sink.finish(1.0)
            sink.close()
        if without_underruns(attempt, sink.status().underruns - 1):
            break
    assert sink.status().played == 400
    heard = found[0][:, 0]
    first = heard[np.flatnonzero(heard)[0] :]
    assert (first[:200] == 16000).all()
    assert np.abs(np.diff(first[200:].astype(int))).max() <= 16000 // RAMP + 1
    assert np.count_nonzero(heard) <= 400 + 2 * RAMP


@needs_server
def test_stop_drops_what_is_owed(server: SoundServer) -> None:
    sink = AudioSink(queue_s=CALM_S)
    for attempt in range(4):
        with server.recording() as found:
            sink.open()
            play(sink, np.full((RATE_HZ, 1), 16000, np.int16))
            sink.stop()
            time.sleep(0.05)
            played = sink.status().played
            sink.close()
            sink.close()
        if without_underruns(attempt, sink.status().underruns):
            break
    assert 0 < played < RATE_HZ
    loud = np.flatnonzero(found[0][:, 0])
    assert loud[-1] - loud[0] + 1 <= played + RAMP
    ending = found[0][loud[-1] - RAMP + 2 : loud[-1] + 2, 0].astype(int)
    assert ending[-1] == 0
    assert np.abs(np.diff(ending)).max() <= 16000 // RAMP + 1  # let out to its very end
    with pytest.raises(DeviceError, match="closed"):
        sink.write(np.zeros((1, 1), np.int16))


@needs_server
def test_a_device_that_goes_is_told_once_and_can_be_opened_again(server: SoundServer, tmp_path: Path) -> None:
    sink = AudioSink()
    form = sink.open()
    assert form.queue_frames <= QUEUE_S * RATE_HZ
    play(sink, noise(2000))
    server.end()
    with pytest.raises(DeviceError, match=r"sound output: no longer takes sound.*start again"):
        play(sink, noise(RATE_HZ * 10))
    assert "no longer" in sink.status().problem
    sink.stop()
    sink.close()
    (tmp_path / "again").mkdir()
    with sound_server(tmp_path / "again"):
        sink.open()
        play(sink, noise(2000))
        sink.finish(1.0)
        assert sink.status().played == 2000
        sink.close()


@needs_server
def test_what_still_plays_ends_softly_with_the_interpreter(server: SoundServer) -> None:
    code = f"""
import sys; sys.path.insert(0, {str(Path(__file__).parents[3])!r})
import numpy as np
from hnf_core.actuators.limits import Limits
from hnf_core.actuators.sinks.audio import AudioSink
from hnf_core.actuators.sources import BufferSource
from hnf_core.actuators.stream import Stream
stream = Stream(BufferSource(np.ones((500, 1)), 10000.0, loop=True), AudioSink(queue_s={CALM_S}), Limits(10.0))
stream.start()
while stream.report.played_s < 0.5 and not stream.wait(0.01):
    pass
"""
    for _ in range(4):  # on a busy machine the recorder loses some, and says nothing
        with server.recording() as found:
            run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
        assert run.returncode == 0
        assert "Traceback" not in run.stderr
        heard = found[0][:, 0].astype(int)
        largest_step = np.abs(np.diff(heard)).max()
        if largest_step < 300:
            break
    assert heard.max() > 3000
    assert largest_step < 300, "it fades"


@needs_server
def test_a_program_that_stood_still_blames_no_device(server: SoundServer) -> None:
    code = f"""
import sys; sys.path.insert(0, {str(Path(__file__).parents[3])!r})
import numpy as np
from hnf_core.actuators.limits import Limits
from hnf_core.actuators.sinks.audio import AudioSink
from hnf_core.actuators.sources import BufferSource
from hnf_core.actuators.stream import Stream
stream = Stream(BufferSource(np.ones((20000, 1)), 10000.0), AudioSink(queue_s={CALM_S}), Limits(10.0))
stream.start()
while stream.report.played_s < 0.3 and not stream.wait(0.01):
    pass
print("plays", flush=True)
print(stream.wait(60.0), stream.report.played_s >= 2.0, stream.report.problem, flush=True)
"""
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "plays\n"
        process.send_signal(signal.SIGSTOP)
        time.sleep(3.0 * CALLBACK_TIMEOUT_S)
        process.send_signal(signal.SIGCONT)
        assert process.communicate(timeout=90)[0] == "True True \n"


@needs_server
def test_a_device_opens_by_name_or_listed_target(server: SoundServer) -> None:
    listed = list_devices()
    assert listed.missing == ()
    assert {each.title for each in listed.audio} >= {"pulse", "default"}
    assert [each.facts.endswith("the default") for each in listed.audio].count(True) == 1
    for each in listed.audio:
        sink = AudioSink(each.target.partition(":")[2])
        assert each.title in sink.open().device
        sink.close()
    with pytest.raises(DeviceError, match=r"sound output 'no such': cannot be opened.*hnf actuators"):
        AudioSink("no such").open()
    with pytest.raises(DeviceError, match="sound output '77': cannot be opened"):
        AudioSink(77).open()


def test_without_its_library_the_remedy_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "sounddevice", None)
    with pytest.raises(DeviceError, match="pip install sounddevice"):
        AudioSink().open()
