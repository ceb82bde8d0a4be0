"""Measure how long a sound output continues after a stream is stopped, paused, interrupted or killed.

  Usage: python -m hnf_lab.experiments.audio_silence [TIMES]    100 of each by default; needs pulseaudio,
         pulseaudio-utils

Each case runs many times at random moments through a real sound server (PulseAudio with a null sink, as in the tests).
The time is taken from a recording of the output: a frame cannot have sounded later than it was recorded, so the
earliest start that all blocks of a recording allow is the latest that its first frame sounded. The result is therefore
an upper bound, counted from just before the command. Prints a Markdown table.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hnf_lab import ROOT

sys.path.insert(0, str(ROOT / "tests" / "core"))

from sound_server import RATE_HZ, SoundServer, sound_server, why_not

from hnf_core.actuators.limits import Limits
from hnf_core.actuators.sinks.audio import AudioSink
from hnf_core.actuators.sources import BufferSource
from hnf_core.actuators.stream import Stream

Play = Callable[[], Callable[[], None]]
"""Starts playing, and returns the command that must end it."""
Ending = Callable[[], AbstractContextManager[Play]]

PLAY_RANGE_S = (0.15, 0.4)
RECORDED_AFTER_S = 0.35
"""Recording time after the command [s], the largest result."""
MAX_WAIT_S = 30.0
CHILD_CODE = f"""
import sys; sys.path[:0] = [{str(ROOT)!r}, {str(ROOT / "tools")!r}]
from hnf_lab.experiments.audio_silence import make_endless_stream
with make_endless_stream() as stream:
    stream.start()
    print("plays", flush=True)
    stream.wait()
"""


def make_endless_stream() -> Stream:
    """Make a stream that is never zero, so that a zero frame is silence."""
    return Stream(BufferSource(np.ones((500, 1)), 10_000.0, loop=True), AudioSink(), Limits(10.0))


class Recorder:
    """Records the output with the arrival time of each block."""

    def __init__(self, server: SoundServer) -> None:
        command = ["parec", "--device=lab.monitor", "--format=s16le", f"--rate={RATE_HZ}", "--channels=1"]
        self._process = subprocess.Popen(
            [*command, "--latency-msec=2"], stdout=subprocess.PIPE, env=server.environment, bufsize=0
        )
        self._blocks: list[tuple[float, bytes]] = []
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        while block := self._process.stdout.read(4096):
            self._blocks.append((time.monotonic(), block))

    def stop(self) -> tuple[NDArray[np.int16], float]:
        """Return the counts (n,), and the latest moment at which the first of them sounded."""
        self._process.terminate()
        self._process.wait(MAX_WAIT_S)
        self._thread.join(MAX_WAIT_S)
        ends = np.cumsum([len(block) // 2 for _, block in self._blocks])
        start = min(arrival - end / RATE_HZ for (arrival, _), end in zip(self._blocks, ends, strict=True))
        return np.frombuffer(b"".join(block for _, block in self._blocks), dtype="<i2"), start


def measure_sound_s(server: SoundServer, play: Play, moment_s: float) -> float:
    """Return the seconds from the command, moment_s after play(), until silence."""
    recorder = Recorder(server)
    command = play()
    time.sleep(moment_s)
    commanded_at = time.monotonic()
    command()
    time.sleep(max(0.0, commanded_at + RECORDED_AFTER_S - time.monotonic()))
    counts, start = recorder.stop()
    loud = np.flatnonzero(counts)
    if len(loud) == 0 or counts[loud[0] : loud[-1]].max() < 1000:
        raise SystemExit("nothing was heard: the sound server is too late for this machine; try again at rest.")
    return float(start + (loud[-1] + 1) / RATE_HZ - commanded_at)


@contextmanager
def play_until_stop() -> Iterator[Play]:
    streams: list[Stream] = []

    def play() -> Callable[[], None]:
        streams.append(make_endless_stream())
        streams[-1].start()
        return streams[-1].stop

    yield play
    for stream in streams:
        stream.stop()


@contextmanager
def play_until_pause() -> Iterator[Play]:
    with make_endless_stream() as stream:

        def play() -> Callable[[], None]:
            stream.start()
            return stream.pause

        yield play


def play_until_signal(number: signal.Signals) -> Ending:
    @contextmanager
    def play_in_child() -> Iterator[Play]:
        with subprocess.Popen(
            [sys.executable, "-c", CHILD_CODE], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        ) as child:

            def play() -> Callable[[], None]:
                assert child.stdout is not None
                assert child.stdout.readline() == "plays\n"
                return lambda: os.kill(child.pid, number)

            try:
                yield play
            finally:
                child.kill()

    return play_in_child


ENDINGS: dict[str, Ending] = {
    "stop": play_until_stop,
    "pause": play_until_pause,
    "Ctrl C": play_until_signal(signal.SIGINT),
    "the program is killed": play_until_signal(signal.SIGKILL),
    "the program stands still (SIGSTOP)": play_until_signal(signal.SIGSTOP),
}


def main(times: int) -> None:
    missing = why_not()
    if missing:
        raise SystemExit(f"{missing}: apt-get install pulseaudio pulseaudio-utils, and pip install sounddevice.")
    rng = np.random.default_rng(0)
    print("| | median | 99 % | most | beyond 20 ms |\n|---|---|---|---|---|", flush=True)
    with tempfile.TemporaryDirectory() as folder, sound_server(Path(folder)) as server:
        for name, ending in ENDINGS.items():
            durations_ms = []
            for _ in range(times):
                with ending() as play:
                    durations_ms.append(1e3 * measure_sound_s(server, play, rng.uniform(*PLAY_RANGE_S)))
            median, p99, beyond = (
                np.median(durations_ms),
                np.percentile(durations_ms, 99),
                sum(duration > 20.0 for duration in durations_ms),
            )
            print(
                f"| {name} | {median:.1f} ms | {p99:.1f} | {max(durations_ms):.1f} | {beyond} of {times} |", flush=True
            )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 100)
