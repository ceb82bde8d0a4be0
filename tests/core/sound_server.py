"""A sound server of its own for tests: PulseAudio in user space with a null sink, and PortAudio led to it."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

RATE_HZ = 44100
ALSA = "pcm.!default { type pulse }\nctl.!default { type pulse }\n"


def why_not() -> str:
    """What is missing here for a sound server, or ""."""
    missing = [tool for tool in ("pulseaudio", "pactl", "parec") if shutil.which(tool) is None]
    if missing:
        return f"{', '.join(missing)} not installed"
    try:
        import sounddevice  # noqa: F401
    except (ImportError, OSError) as error:
        return f"no sounddevice: {error}"
    return ""


@dataclass
class SoundServer:
    """process: of the server. environment: for programs that are to reach it."""

    process: subprocess.Popen[bytes]
    environment: dict[str, str]

    @contextmanager
    def recording(self) -> Iterator[list[NDArray[np.int16]]]:
        """What the null sink gets meanwhile: one array (n, 2), put into the list at the end."""
        words = ["parec", "--device=lab.monitor", "--format=s16le", f"--rate={RATE_HZ}", "--channels=2"]
        result: list[NDArray[np.int16]] = []
        with tempfile.TemporaryFile() as file:
            recorder = subprocess.Popen([*words, "--latency-msec=100"], stdout=file, env=self.environment)
            time.sleep(0.3)
            try:
                yield result
                time.sleep(0.3)
            finally:
                recorder.terminate()
                recorder.wait(10)
                file.seek(0)
                data = file.read()
                result.append(np.frombuffer(data[: len(data) // 4 * 4], dtype="<i2").reshape(-1, 2))

    def end(self) -> None:
        self.process.kill()
        self.process.wait(10)


@contextmanager
def sound_server(folder: Path) -> Iterator[SoundServer]:
    """Running, and the default of PortAudio in this process, until the end."""
    import sounddevice

    folder.chmod(0o700)
    (folder / ".asoundrc").write_text(ALSA)
    socket = folder / "native"
    changes = {"HOME": str(folder), "XDG_RUNTIME_DIR": str(folder), "PULSE_SERVER": f"unix:{socket}"}
    environment = {**os.environ, **changes}
    words = ["pulseaudio", "-n", "--daemonize=no", "--exit-idle-time=-1", "--use-pid-file=no", "--disable-shm=yes"]
    words += ["-L", f"module-native-protocol-unix socket={socket} auth-anonymous=1"]
    words += ["-L", f"module-null-sink sink_name=lab rate={RATE_HZ} channels=2 norewinds=1"]
    before = {name: os.environ.get(name) for name in changes}
    with subprocess.Popen(words, env=environment, stderr=subprocess.DEVNULL) as process:
        server = SoundServer(process, environment)
        try:
            until = time.monotonic() + 10.0
            ask = ["pactl", "info"]
            while subprocess.run(ask, env=environment, capture_output=True).returncode and time.monotonic() < until:
                time.sleep(0.05)
            os.environ.update(changes)
            sounddevice._terminate()
            sounddevice._initialize()
            yield server
        finally:
            server.end()
            for name, value in before.items():
                if value is None:
                    os.environ.pop(name)
                else:
                    os.environ[name] = value
