"""The serial sink on real ptys: samples arrive, and errors name the next step."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ptys import needs_pty

from hnf_core.actuators.serial_protocol import (
    FRAME_OVERHEAD_BYTES,
    FROM_HOST,
    Bye,
    Decoder,
    Message,
    Samples,
    Stop,
    frames_per_message,
)
from hnf_core.actuators.sinks import serial as serial_port
from hnf_core.actuators.sinks import serial as serial_sink
from hnf_core.actuators.sinks.serial import FRAMES_PER_MESSAGE, SerialSink
from hnf_core.actuators.virtual_port import VirtualPort, VirtualSink
from hnf_core.actuators.virtual_serial_device import Capabilities
from hnf_core.errors import DeviceError, UsageError

pytest.importorskip("serial", reason="pyserial is not installed")
pytestmark = needs_pty


@pytest.fixture
def port() -> Iterator[VirtualPort]:
    with VirtualPort() as port:
        yield port


def noise(frames: int, channels: int, seed: int = 0) -> np.ndarray:
    """Counts that begin and end with something, and never with silence on all channels."""
    found = np.random.default_rng(seed).integers(-30_000, 30_000, (frames, channels)).astype(np.int16)
    found[found == 0] = 1
    return found


def play(sink: SerialSink, counts: np.ndarray) -> None:
    sent = 0
    while sent < len(counts):
        room = sink.wait(0.5)
        sink.write(counts[sent : sent + room])
        sent += min(room, len(counts) - sent)


@pytest.mark.parametrize(("rate", "channels"), [(8000, 1), (10_000, 3), (8000, 16), (48_000, 2)])
def test_what_is_written_is_what_is_played(rate: int, channels: int) -> None:
    sink, counts = VirtualSink(rate, channels), noise(rate // 2, channels)
    form = sink.open()
    assert (form.rate_hz, form.channels, form.queue_frames) == (float(rate), channels, rate * 15 // 1000)
    assert form.device == "virtual actuator"
    play(sink, counts)
    sink.finish(2.0)
    status = sink.status()
    sink.close()
    assert (status.played, status.errors, status.problem) == (len(counts), 0, "")
    if status.underruns == 0:  # a machine that is too busy to feed it hears the ramps between
        np.testing.assert_array_equal(sink.recording.counts[: len(counts)], counts)
    assert len(sink.recording.counts) >= len(counts)
    assert np.isfinite(sink.recording.motion.acceleration).all()


def test_it_never_takes_more_than_it_can_owe(port: VirtualPort) -> None:
    sink = SerialSink(port.path, rate_hz=8000)
    queue = sink.open().queue_frames
    rooms = []
    for _ in range(50):
        rooms.append(sink.wait(0.1))
        sink.write(noise(rooms[-1], 1))
    sink.close()
    assert max(rooms) <= queue
    assert port.device.status.lost == 0


def test_after_stop_it_begins_again(port: VirtualPort) -> None:
    sink = SerialSink(port.path, rate_hz=8000)
    sink.open()
    for _ in range(3):
        play(sink, noise(400, 1))
        sink.stop()
        with pytest.raises(UsageError, match="wait"):
            sink.write(noise(1, 1))
    play(sink, noise(400, 1))
    sink.finish(2.0)
    assert sink.status().played >= 400
    sink.close()
    sink.close()
    sink.stop()
    assert sink.open().rate_hz == 8000.0
    sink.close()


class Pauses:
    """The module time, but for sleep()."""

    def __init__(self, sleep: Callable[[float], None]) -> None:
        self.sleep = sleep

    def __getattr__(self, name: str) -> Any:
        return getattr(time, name)


def test_close_sends_the_stop_before_it_drops_the_buffer(port: VirtualPort, monkeypatch: pytest.MonkeyPatch) -> None:
    """A pty says that nothing waits while all of it does. This device reads while close() pauses, and not before: where
    it does not pause, what waits is dropped unheard."""
    import serial

    sink, decoder, heard, bye = SerialSink(port.path, rate_hz=8000), Decoder(FROM_HOST), [], threading.Event()
    heard_at_the_drop: list[list[type[Message]]] = []

    def hear(data: bytes) -> bytes:
        heard.extend(type(message) for message in decoder.feed(data))
        if Bye in heard:
            bye.set()
        return data

    def pause(_seconds: float) -> None:
        port.ignores_host = False
        bye.wait(30.0)

    def drop(opened: serial.Serial) -> None:
        heard_at_the_drop.append(list(heard))
        dropping(opened)

    sink.open()
    play(sink, noise(400, 1))
    dropping = serial.Serial.reset_output_buffer
    monkeypatch.setattr(serial.Serial, "reset_output_buffer", drop)
    monkeypatch.setattr(serial_sink, "time", Pauses(pause))
    with port.freeze_clock():
        port.ignores_host, port.from_host = True, hear
    sink.close()
    assert [each[-2:] for each in heard_at_the_drop] == [[Stop, Bye]]


@pytest.mark.parametrize(
    ("has", "wished", "taken"),
    [
        ((1000, 48_000), None, 8000),
        ((10_000, 48_000), None, 10_000),
        ((1000, 4000), None, 4000),
        ((1000, 9000), 44_100, 9000),
        ((1000, 48_000), 11_025, 11_025),
    ],
)
def test_the_nearest_rate_that_the_device_has_is_taken(has: tuple[int, int], wished: int | None, taken: int) -> None:
    with VirtualPort(Capabilities(lowest_hz=has[0], highest_hz=has[1])) as port:
        sink = SerialSink(port.path, rate_hz=wished)
        assert sink.open().rate_hz == taken
        sink.close()


def test_the_temperature_and_the_level_reach_us() -> None:
    sink = VirtualSink(8000)
    sink.open()
    play(sink, np.full((3200, 1), 32767, dtype=np.int16))
    temperature = sink.status().temperature_c
    sink.close()
    assert temperature is not None
    assert temperature > 25.0


@pytest.mark.parametrize(
    ("abilities", "words", "wanted"),
    [
        (Capabilities(version=3), ["version 1", "version 3", "firmware"], {}),
        (Capabilities(channels=2), ["has 2 channels, not 4", "at most 2"], {"channels": 4}),
    ],
)
def test_a_device_that_cannot_is_named(abilities: Capabilities, words: list[str], wanted: dict[str, int]) -> None:
    with VirtualPort(abilities) as port:
        with pytest.raises(DeviceError) as told:
            SerialSink(port.path, **wanted).open()
        assert all(word in str(told.value) for word in [*words, port.path])
        sink = SerialSink(port.path, versions=(1, 3))
        sink.open()
        sink.close()


def test_a_port_in_use_names_who_has_it(port: VirtualPort) -> None:
    first = SerialSink(port.path)
    first.open()
    with pytest.raises(DeviceError, match=f"another program uses.*process {os.getpid()}"):
        SerialSink(port.path).open()
    play(first, noise(400, 1))
    first.close()
    second = SerialSink(port.path)
    second.open()
    second.close()


def test_where_nobody_answers_it_says_what_to_check() -> None:
    import pty
    import tty

    ends = pty.openpty()
    for end in ends:
        tty.setraw(end)
    began = time.monotonic()
    with pytest.raises(DeviceError, match=r"nothing answers.*power.*firmware.*3000000 baud"):
        SerialSink(os.ttyname(ends[1]), reply_timeout_s=0.3).open()
    assert time.monotonic() - began >= 0.3
    for end in ends:
        os.close(end)


def test_a_system_that_gives_no_pty_is_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def none_left() -> None:
        raise OSError("out of pty devices")

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr("pty.openpty", none_left)
    with pytest.raises(DeviceError, match=r"gives none \(out of pty devices\).*/dev/pts"):
        VirtualSink(8000).open()
    assert list(tmp_path.iterdir()) == []


def test_the_next_port_removes_the_folder_of_a_killed_process(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    code = "from hnf_core.actuators.virtual_port import VirtualPort as P; p = P(); print(p.path, flush=True); input()"
    words = [sys.executable, "-c", f"import sys, tempfile; tempfile.tempdir = {str(tmp_path)!r}\n{code}"]
    root, pipe = Path(__file__).resolve().parents[3], subprocess.PIPE
    with subprocess.Popen(words, cwd=root, text=True, stdin=pipe, stdout=pipe) as killed:
        assert killed.stdout is not None
        left = Path(killed.stdout.readline().strip()).parent
        with VirtualPort():
            assert left.is_dir(), "it lives"
        killed.kill()
        killed.wait(10)
    assert left.is_dir()
    with VirtualPort() as port:
        assert [each.name for each in tmp_path.iterdir()] == [Path(port.path).parent.name]
    assert list(tmp_path.iterdir()) == []


def test_there_is_no_such_port() -> None:
    with pytest.raises(DeviceError, match=r"/dev/ttyNONE: there is no such port. Plug"):
        SerialSink("/dev/ttyNONE").open()


def test_a_file_is_no_port(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_bytes(b"")
    with pytest.raises(DeviceError, match=r"no serial port|cannot be opened"):
        SerialSink(str(file)).open()
    assert file.read_bytes() == b""


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (errno.EACCES, "dialout"),
        (errno.EBUSY, "another program uses this port"),
        (errno.ENXIO, "no such port"),
        (errno.EIO, "cannot be opened"),
    ],
)
def test_what_the_system_refuses_is_told(monkeypatch: pytest.MonkeyPatch, number: int, words: str) -> None:
    """The system's own refusals, which a test that runs as root does not meet."""
    import serial

    def refuse(*about: object, **more: object) -> None:
        raise serial.SerialException(number, f"could not open port: {os.strerror(number)}")

    monkeypatch.setattr(serial, "Serial", refuse)
    with pytest.raises(DeviceError, match=words):
        serial_port.open_port("/dev/ttyX", 3_000_000)


def test_a_computer_that_slept_is_told(port: VirtualPort) -> None:
    """The clock jumps by an hour, as over a night."""
    asleep_s = 0.0
    sink = SerialSink(port.path, rate_hz=8000, clock=lambda: time.monotonic() + asleep_s)
    sink.open()
    play(sink, noise(800, 1))
    asleep_s = 3600.0
    with pytest.raises(DeviceError, match=r"stood still for 3600\.\d s"):
        play(sink, noise(8000, 1))
    assert "stood still" in sink.status().problem
    sink.open()
    play(sink, noise(400, 1))
    assert sink.status().problem == ""
    sink.close()


def test_every_call_raises_the_problem_until_reopened(port: VirtualPort) -> None:
    sink = SerialSink(port.path, rate_hz=8000)
    sink.open()
    play(sink, noise(400, 1))
    port.unplug()
    with pytest.raises(DeviceError, match="gone"):
        play(sink, noise(8000, 1))
    for call in (lambda: sink.wait(0.1), lambda: sink.finish(0.1), lambda: sink.write(noise(1, 1))):
        with pytest.raises(DeviceError, match="gone"):
            call()
    sink.stop()
    sink.close()
    with pytest.raises(DeviceError, match="no such port"):
        sink.open()
    port.plug()
    sink.open()
    play(sink, noise(400, 1))
    sink.close()


@pytest.mark.parametrize(("baud", "fits"), [(3_000_000, True), (2_400_000, False)])
def test_sixteen_channels_at_8_khz_fit_three_megabaud(port: VirtualPort, baud: int, fits: bool) -> None:
    """A line of so many bits a second by the device's own clock. A slower one is too slow: the device starves."""
    sink, counts = SerialSink(port.path, rate_hz=8000, channels=16), noise(8000, 16)
    sink.open()
    port.baud = baud
    play(sink, counts)
    sink.finish(2.0)
    status = sink.status()
    sink.close()
    assert (status.played, status.errors) == (8000, 0)
    if not fits:
        assert status.underruns > 3
    elif status.underruns == 0:  # a machine that is too busy starves it too
        np.testing.assert_array_equal(port.recording.counts[:8000], counts)


def test_the_arithmetic_of_that_line() -> None:
    """With a start and a stop bit a byte, and a message every 32 frames."""
    assert frames_per_message(16) >= FRAMES_PER_MESSAGE
    a_message = FRAME_OVERHEAD_BYTES + Samples.HEAD.size + FRAMES_PER_MESSAGE * 16 * 2
    assert 2_400_000 < 10 * a_message * 8000 / FRAMES_PER_MESSAGE < 0.9 * 3_000_000


def test_no_channels_are_refused() -> None:
    with pytest.raises(UsageError, match="1 to 255 channels"):
        SerialSink("x", channels=0)
