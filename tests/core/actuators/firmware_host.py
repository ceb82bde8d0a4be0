"""The C of tools/firmware, compiled for this machine and driven from Python."""

from __future__ import annotations

import shutil
import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from hnf_core.actuators.serial_protocol import (
    FROM_DEVICE,
    Credit,
    Decoder,
    Encoder,
    Error,
    Hello,
    Message,
    Ping,
    Samples,
    Start,
    Status,
)

FIRMWARE = Path(__file__).resolve().parents[3] / "tools" / "firmware"
STRICT = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Wpedantic", "-Werror", "-g", "-O1"]
SANITIZE = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-fno-omit-frame-pointer"]
RATE = 10_000
QUEUE, RAMP = 150, 40
"""Frames of 15 ms and 4 ms at RATE."""


def build(program: str, folder: Path) -> Path:
    """host/program.c with the core, with sanitizers where the compiler has them. Skips without a compiler."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("there is no C compiler (cc) here")
    made = folder / program
    sources = [FIRMWARE / "host" / f"{program}.c", *sorted(FIRMWARE.glob("hnf_*.c"))]
    order = [compiler, *STRICT, *map(str, sources), "-o", str(made)]
    order += find_sanitizers(compiler, folder)
    done = subprocess.run(order, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return made


def find_sanitizers(compiler: str, folder: Path) -> list[str]:
    """The options of a compiler's sanitizers, none where it has no such."""
    probe = folder / "probe.c"
    probe.write_text("int main(void) { return 0; }\n", encoding="utf-8")
    order = [compiler, *SANITIZE, str(probe), "-o", str(folder / "probe")]
    return SANITIZE if subprocess.run(order, capture_output=True, timeout=60).returncode == 0 else []


def credits_of(messages: list[Message]) -> list[Credit]:
    return [message for message in messages if isinstance(message, Credit)]


def errors_of(messages: list[Message]) -> list[int]:
    return [message.code for message in messages if isinstance(message, Error)]


class Check:
    """host/check.c. A sanitizer's finding ends it, and the next request fails with what it said."""

    def __init__(self, program: Path) -> None:
        self._process = subprocess.Popen(
            [program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )

    def __call__(self, op: str, argument: int = 0, data: bytes = b"") -> bytes:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            self._process.stdin.write(op.encode() + struct.pack("=II", argument, len(data)) + data)
            self._process.stdin.flush()
        except BrokenPipeError:
            pytest.fail(self.end())
        head = self._process.stdout.read(4)
        if len(head) < 4:
            pytest.fail(self.end())
        return self._process.stdout.read(struct.unpack("=I", head)[0])

    def end(self) -> str:
        """What it said last."""
        try:
            _, said = self._process.communicate(timeout=20)
        except subprocess.TimeoutExpired:
            self._process.kill()
            _, said = self._process.communicate()
        return said.decode(errors="replace")


class Device:
    """The C device core beside a host's codec. Time passes by tick() alone."""

    def __init__(
        self,
        check: Check,
        *,
        channels: int = 2,
        lowest: int = 1000,
        highest: int = 48000,
        peak: int = 32767,
        hot: int = 32767,
    ) -> None:
        self.check, self.channels, self.rate, self.session, self.sent = check, channels, RATE, 7, 0
        self._encoder, self._decoder, self._ticks = Encoder(), Decoder(FROM_DEVICE), 0
        self._pause_us = 0
        check("R", 0, f"{channels} 16 {lowest} {highest} {peak} {hot}".encode())

    @property
    def now(self) -> int:
        return (self._pause_us + self._ticks * 1_000_000 // self.rate) & 0xFFFFFFFF

    def encode(self, message: Message) -> bytes:
        return self._encoder.encode(message)

    def feed(self, data: bytes) -> list[Message]:
        return self._heard(self.check("F", self.now, data))

    def send(self, *messages: Message) -> list[Message]:
        return self.feed(b"".join(map(self.encode, messages)))

    def start(self, *, peak: int = 32767, slew: int = 65535, queue: int = 0) -> None:
        """HELLO and START of a stream of all its channels."""
        self.send(Hello(), Start(self.rate, self.channels, peak, self.session, slew, queue))

    def samples(self, counts: NDArray[np.int16]) -> Samples:
        """The next of the stream."""
        message = Samples.from_counts(self.session, self.sent & 0xFFFFFFFF, counts)
        self.sent += len(counts)
        return message

    def tick(self, frames: int) -> NDArray[np.int16]:
        """(frames, channels) that it plays."""
        self._ticks += frames
        played = np.frombuffer(self.check("T", frames), np.int16)
        return played.reshape(frames, -1 if frames else self.channels)

    def poll(self) -> list[Message]:
        return self._heard(self.check("P", self.now))

    def do(self, op: str, argument: int = 0) -> list[Message]:
        """H (temperature in 0.1 °C), U (cable out), X (hardware fault) or W (frames played already)."""
        return self._heard(self.check(op, argument))

    def pause(self, seconds: float) -> None:
        """The main loop's clock alone goes on."""
        self._pause_us += round(seconds * 1e6)

    def status(self) -> Status:
        """That it gives to a PING."""
        heard = self.send(Ping(1)) + self.poll()
        return next(message for message in heard if isinstance(message, Status))

    def stream(self, counts: NDArray[np.int16], piece: int, step: int) -> NDArray[np.int16]:
        """Send counts as the credit allows, piece frames a message; step frames are played between two looks at the
        credit. What it played up to the last of them, from the first sample on."""
        played, end = [], self.sent + len(counts)
        credit = credits_of(self.poll() + self.ask())[-1]
        while self.sent < end or credit.played != self.sent & 0xFFFFFFFF:
            while (room := min(credit.compute_sendable_frames(self.sent), end - self.sent, piece)) > 0:
                at = len(counts) - (end - self.sent)
                self.send(self.samples(counts[at : at + room]))
            played.append(self.tick(step))
            self.pause(0.001)
            credit = credits_of(self.poll())[-1]
        return np.concatenate(played)

    def ask(self) -> list[Message]:
        """What it says after a pause of 2 ms, of the main loop alone."""
        self.pause(0.002)
        return self.poll()

    def _heard(self, data: bytes) -> list[Message]:
        found = self._decoder.feed(data)
        assert self._decoder.skipped == self._decoder.malformed == self._decoder.gaps == 0
        return found
