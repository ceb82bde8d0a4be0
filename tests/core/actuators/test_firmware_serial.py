"""The device core as a program on a real pty, played by the real SerialSink: counts arrive byte for byte."""

from __future__ import annotations

import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from firmware_host import build
from numpy.typing import NDArray
from ptys import needs_pty

from hnf_core.actuators.sinks import serial_session
from hnf_core.actuators.sinks.serial import SerialSink
from hnf_core.errors import DeviceError

pytest.importorskip("serial", reason="pyserial is not installed")
pytestmark = needs_pty


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build("device", tmp_path_factory.mktemp("device"))


class Running:
    """The program on a pty of its own."""

    def __init__(self, program: Path, out: Path, *words: str) -> None:
        self.out = out
        self.process = subprocess.Popen(
            [program, out, "--patient", "--once", *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        assert self.process.stdout is not None
        self.port = self.process.stdout.readline().strip()

    def played(self, channels: int) -> NDArray[np.int16]:
        """What it had played when its host was gone."""
        try:
            _, said = self.process.communicate(timeout=10)
        except subprocess.TimeoutExpired:
            self.process.kill()
            raise
        assert (self.process.returncode, said) == (0, "")
        return np.fromfile(self.out, np.int16).reshape(-1, channels)


@pytest.fixture
def keeps_no_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    """A patient device waits for a slow machine; that shall not look like a lie."""
    monkeypatch.setattr(serial_session, "RATE_TOLERANCE", 100.0)


def send(sink: SerialSink, counts: NDArray[np.int16]) -> None:
    at, until = 0, time.monotonic() + 15.0
    while at < len(counts):
        room = sink.wait(0.1)
        sink.write(counts[at : at + room])
        at += min(room, len(counts) - at)
        assert time.monotonic() < until, "nothing moves"


@pytest.mark.usefixtures("keeps_no_rate")
@pytest.mark.parametrize(("channels", "rate"), [(1, 10_000), (3, 8000)])
def test_what_the_host_sends_is_what_the_device_plays(program: Path, tmp_path: Path, channels: int, rate: int) -> None:
    device = Running(program, tmp_path / "played.raw", "--channels", str(channels))
    sink = SerialSink(device.port, rate_hz=rate, channels=channels)
    form = sink.open()
    assert (form.rate_hz, form.channels, form.queue_frames) == (rate, channels, rate * 15 // 1000)
    rng = np.random.default_rng(6)
    counts = rng.integers(-32767, 32768, (rate * 6 // 10, channels)).astype(np.int16)
    counts[[0, -1]] = 1
    try:
        send(sink, counts)
        sink.finish(2.0)
        status = sink.status()
    finally:
        sink.close()
    assert (status.played, status.underruns, status.errors, status.problem) == (len(counts), 0, 0, "")
    played = device.played(channels)
    sounding = np.flatnonzero(played.any(axis=1))
    assert played[sounding[0] : sounding[0] + len(counts)].tobytes() == counts.tobytes()
    assert not played[sounding[0] + len(counts) :].any()


@pytest.mark.usefixtures("keeps_no_rate")
def test_stop_cuts_what_is_queued_within_its_ramp(program: Path, tmp_path: Path) -> None:
    device = Running(program, tmp_path / "played.raw")
    sink = SerialSink(device.port, rate_hz=10_000)
    sink.open()
    try:
        send(sink, np.full((2000, 1), 12345, np.int16))
        sink.stop()
    finally:
        sink.close()
    played = device.played(1).ravel().astype(int)
    fading = played[np.flatnonzero(played == 12345)[-1] :]
    # 4 ms at 10 kHz, of the peak that the sink asked for.
    assert np.array_equal(fading, np.maximum(12345 - np.arange(len(fading)) * -(-32767 // 40), 0))
    assert 0 < np.count_nonzero(played) < 2000 + 40


def test_a_device_that_lies_about_its_rate_is_found_out(program: Path, tmp_path: Path) -> None:
    device = Running(program, tmp_path / "played.raw", "--percent", "70")
    sink = SerialSink(device.port, rate_hz=10_000)
    sink.open()
    try:
        with pytest.raises(DeviceError, match="Hz"):
            send(sink, np.full((100_000, 1), 500, np.int16))
    finally:
        sink.close()
    assert not device.played(1)[-1].any()
