"""Where a stream can go, in words.

serial:PORT[@BAUD] | audio[:DEVICE] | osc:HOST:PORT[/ADDRESS] | file:PATH | virtual
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from ..errors import DeviceError, UsageError
from .limits import Limits
from .runtime import import_optional
from .sink import Sink
from .sinks.osc import DEFAULT_ADDRESS

TARGET_FORMS = "serial:PORT[@BAUD], audio[:DEVICE], osc:HOST:PORT[/ADDRESS], file:PATH or virtual"


@dataclass(frozen=True)
class SerialTarget:
    """baudrate: None, the protocol's usual one."""

    port: str
    baudrate: int | None = None

    @property
    def text(self) -> str:
        return f"serial:{self.port}" + (f"@{self.baudrate}" if self.baudrate is not None else "")


@dataclass(frozen=True)
class AudioTarget:
    """device: part of its name, its index, or None for the system's default."""

    device: str | int | None = None

    @property
    def text(self) -> str:
        return "audio" if self.device is None else f"audio:{self.device}"


@dataclass(frozen=True)
class OscTarget:
    host: str
    port: int
    address: str = DEFAULT_ADDRESS

    @property
    def text(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"osc:{host}:{self.port}" + (self.address if self.address != DEFAULT_ADDRESS else "")


@dataclass(frozen=True)
class FileTarget:
    path: Path

    @property
    def text(self) -> str:
        return f"file:{self.path}"


@dataclass(frozen=True)
class VirtualTarget:
    @property
    def text(self) -> str:
        return "virtual"


Target = SerialTarget | AudioTarget | OscTarget | FileTarget | VirtualTarget


def parse_target(text: str) -> Target:
    """Raises UsageError, naming the form, where words are none."""
    kind, colon, rest = text.strip().partition(":")
    if kind == "virtual" and not colon:
        return VirtualTarget()
    if kind == "audio" and (rest or not colon):
        return AudioTarget((int(rest) if re.fullmatch("[0-9]{1,6}", rest) else rest) if colon else None)
    if kind == "serial":
        port, at, baud = rest.rpartition("@")
        if not at:
            port, baud = rest, ""
        if port and (not at or (re.fullmatch("[0-9]{1,9}", baud) and int(baud) > 0)):
            return SerialTarget(port, int(baud) if at else None)
        raise _make_target_error(text, "serial:PORT[@BAUD], e.g. serial:/dev/ttyACM0 or serial:COM3@3000000")
    if kind == "osc":
        found = re.fullmatch(r"(?:\[([0-9A-Fa-f:.%\w]+)\]|([^\s:/\[\]]+)):([0-9]{1,5})(/[^\s#*,?\[\]{}]*)?", rest)
        if found and 0 < int(found[3]) < 65536:
            return OscTarget(found[1] or found[2], int(found[3]), (found[4] or "").rstrip("/") or DEFAULT_ADDRESS)
        raise _make_target_error(text, "osc:HOST:PORT[/ADDRESS], e.g. osc:127.0.0.1:9000/avatar/parameters/hnf")
    if kind == "file" and rest:
        return FileTarget(Path(rest))
    raise _make_target_error(text, TARGET_FORMS)


def make_sink(target: Target, source_rate_hz: float, limits: Limits, channels: int = 1) -> Sink:
    """The sink that target means, not opened yet. source_rate_hz: a device that can choose its rate takes it."""
    if isinstance(target, AudioTarget):
        from .sinks.audio import AudioSink

        return AudioSink(target.device, channels)
    if isinstance(target, OscTarget):
        from .sinks.osc import OscSink

        return OscSink(target.host, target.port, target.address, channels)
    if isinstance(target, FileTarget):
        from .sinks.file import FileSink

        return FileSink(target.path, round(source_rate_hz), channels, limits.full_scale_m_s2)
    rate = round(source_rate_hz)
    if isinstance(target, VirtualTarget):
        from .virtual.port import VirtualSink

        return VirtualSink(rate, channels, peak=limits.peak_counts, slew_per_s=limits.slew_per_s)
    from .sinks.serial import BAUDRATE, SerialSink

    baudrate, peak = target.baudrate or BAUDRATE, limits.peak_counts
    return SerialSink(target.port, baudrate, rate, channels, peak=peak, slew_per_s=limits.slew_per_s)


@dataclass(frozen=True)
class Device:
    """A device. target: the words for it. title: what it calls itself. facts: what else is known of it."""

    target: str
    title: str
    facts: str = ""


@dataclass(frozen=True)
class DeviceList:
    """missing: why one of the lists is empty, a line each."""

    serial: tuple[Device, ...]
    audio: tuple[Device, ...]
    missing: tuple[str, ...]

    @property
    def all(self) -> tuple[Device, ...]:
        return self.serial + self.audio


def list_devices() -> DeviceList:
    """What is plugged in now, as the system tells it: whether it speaks our protocol is known when it is opened. Takes
    up to a second. Never raises."""
    missing: list[str] = []
    serial: tuple[Device, ...] = ()
    audio: tuple[Device, ...] = ()
    try:
        serial = _list_serial_ports()
    except DeviceError as error:
        missing.append(f"serial ports: {error}")
    try:
        audio = _list_sound_outputs()
    except DeviceError as error:
        missing.append(f"sound outputs: {error}")
    return DeviceList(serial, audio, tuple(missing))


def _list_serial_ports() -> tuple[Device, ...]:
    import_optional("serial")
    from serial.tools.list_ports import comports

    try:
        ports = sorted(comports(), key=lambda port: str(port.device))
    except Exception as error:  # each system has its own way to fail here
        raise DeviceError(f"they cannot be listed ({error}).", remedy="Name the port: serial:PORT.") from error
    found = []
    for port in ports:
        told = [port.manufacturer, f"USB {port.vid:04x}:{port.pid:04x}" if port.vid is not None else None]
        named = str(port.description or "n/a")
        facts = ", ".join(str(each) for each in told if each)
        found.append(Device(f"serial:{port.device}", named if named != "n/a" else str(port.device), facts))
    return tuple(found)


def _list_sound_outputs() -> tuple[Device, ...]:
    from .sinks.audio import rescan_devices

    sounddevice = import_optional("sounddevice")
    try:
        rescan_devices(sounddevice)
        default = sounddevice.default.device[1]
        apis = [str(api["name"]) for api in sounddevice.query_hostapis()]
        outputs = [each for each in sounddevice.query_devices() if each["max_output_channels"] > 0]
    except sounddevice.PortAudioError as error:
        raise DeviceError(f"they cannot be listed ({error}).", remedy="Name one: audio:DEVICE.") from error
    names = [f"{each['name']}, {apis[each['hostapi']]}" for each in outputs]
    found = []
    for name, each in zip(names, outputs, strict=True):
        # A name outlives plugging and unplugging, an index does not; but two alike can only be told by theirs.
        words = name if names.count(name) == 1 else str(each["index"])
        facts = f"{each['default_samplerate']:g} Hz, {each['max_output_channels']} channels"
        chosen = ", the default" if each["index"] == default else ""
        found.append(Device(f"audio:{words}", str(each["name"]), facts + chosen))
    return tuple(found)


def _make_target_error(text: str, form: str) -> UsageError:
    return UsageError(f"'{text}' is no place to stream to.", remedy=f"Say {form}.")
