"""Stream targets as text, the sinks they stand for, and the devices that are connected.

serial:PORT[@BAUD] | audio[:DEVICE[:CHANNELS]] | osc:HOST:PORT[/ADDRESS] | file:PATH | virtual
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

TARGET_FORMS = "serial:PORT[@BAUD], audio[:DEVICE[:CHANNELS]], osc:HOST:PORT[/ADDRESS], file:PATH or virtual"
"""The forms of a target, for messages."""


@dataclass(frozen=True)
class SerialTarget:
    """Target "serial:PORT": a device on a serial port; a baud rate of None means the protocol's usual one."""

    port: str
    baudrate: int | None = None

    @property
    def text(self) -> str:
        return f"serial:{self.port}" + (f"@{self.baudrate}" if self.baudrate is not None else "")


@dataclass(frozen=True)
class AudioTarget:
    """Target "audio": a sound output by part of its name, its index, or None for the system's default.

    channel_map: output channels, counted from 1, in the order of the signals; empty for the first ones.
    """

    device: str | int | None = None
    channel_map: tuple[int, ...] = ()

    @property
    def text(self) -> str:
        device = "" if self.device is None else str(self.device)
        if self.channel_map:
            return f"audio:{device}:{','.join(map(str, self.channel_map))}"
        return f"audio:{device}" if device else "audio"


@dataclass(frozen=True)
class OscTarget:
    """Target "osc:HOST:PORT": a receiver of OSC messages (UDP)."""

    host: str
    port: int
    address: str = DEFAULT_ADDRESS

    @property
    def text(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"osc:{host}:{self.port}" + (self.address if self.address != DEFAULT_ADDRESS else "")


@dataclass(frozen=True)
class FileTarget:
    """Target "file:PATH": a WAV or NPY file to write."""

    path: Path

    @property
    def text(self) -> str:
        return f"file:{self.path}"


@dataclass(frozen=True)
class VirtualTarget:
    """Target "virtual": the simulated device."""

    @property
    def text(self) -> str:
        return "virtual"


Target = SerialTarget | AudioTarget | OscTarget | FileTarget | VirtualTarget


def parse_target(text: str) -> Target:
    """Parse a stream target such as "serial:/dev/ttyACM0"; raise UsageError with the expected form if it is invalid."""
    kind, colon, rest = text.strip().partition(":")
    if kind == "virtual" and not colon:
        return VirtualTarget()
    if kind == "audio" and (rest or not colon):
        device, second, last = rest.rpartition(":")
        channel_map: tuple[int, ...] = ()
        if second and re.fullmatch("[0-9]{1,3}(,[0-9]{1,3})*", last):
            channel_map, rest = tuple(map(int, last.split(","))), device
            if 0 in channel_map or len(set(channel_map)) < len(channel_map):
                raise _make_target_error(text, "audio:DEVICE:3,4, each output channel once, counted from 1")
        return AudioTarget(int(rest) if re.fullmatch("[0-9]{1,6}", rest) else rest or None, channel_map)
    if kind == "serial":
        port, at, baud = rest.rpartition("@")
        if not at:
            port, baud = rest, ""
        if port and (not at or (re.fullmatch("[0-9]{1,9}", baud) and int(baud) > 0)):
            return SerialTarget(port, int(baud) if at else None)
        raise _make_target_error(text, "serial:PORT[@BAUD], e.g. serial:/dev/ttyACM0 or serial:COM3@3000000")
    if kind == "osc":
        match = re.fullmatch(r"(?:\[([0-9A-Fa-f:.%\w]+)\]|([^\s:/\[\]]+)):([0-9]{1,5})(/[^\s#*,?\[\]{}]*)?", rest)
        if match and 0 < int(match[3]) < 65536:
            return OscTarget(match[1] or match[2], int(match[3]), (match[4] or "").rstrip("/") or DEFAULT_ADDRESS)
        raise _make_target_error(text, "osc:HOST:PORT[/ADDRESS], e.g. osc:127.0.0.1:9000/avatar/parameters/hnf")
    if kind == "file" and rest:
        return FileTarget(Path(rest))
    raise _make_target_error(text, TARGET_FORMS)


def make_sink(
    target: Target, source_rate_hz: float, limits: Limits, channels: int = 1, *, connect_s: float | None = None
) -> Sink:
    """Make the sink of a target, not opened yet.

    Parameters
    ----------
    target : Target
        Parsed target.
    source_rate_hz : float
        The source's rate [Hz]; devices with a choice of rates use it.
    limits : Limits
        Limits of the actuator; serial and virtual devices enforce peak and slew as well.
    channels : int
        Number of channels.
    connect_s : float or None
        Longest wait for a serial device to answer [s]; None for the usual.
    """
    if isinstance(target, AudioTarget):
        from .sinks.audio import AudioSink

        return AudioSink(target.device, channels, channel_map=target.channel_map)
    if isinstance(target, OscTarget):
        from .sinks.osc import OscSink

        return OscSink(target.host, target.port, target.address, channels)
    if isinstance(target, FileTarget):
        from .sinks.file import FileSink

        return FileSink(target.path, round(source_rate_hz), channels, limits.full_scale_m_s2)
    rate = round(source_rate_hz)
    if isinstance(target, VirtualTarget):
        from .virtual_port import VirtualSink

        return VirtualSink(rate, channels, peak=limits.peak_counts, slew_per_s=limits.slew_per_s)
    from .sinks.serial import BAUDRATE, CONNECT_S, SerialSink

    baudrate, peak = target.baudrate or BAUDRATE, limits.peak_counts
    return SerialSink(
        target.port,
        baudrate,
        rate,
        channels,
        peak=peak,
        slew_per_s=limits.slew_per_s,
        reply_timeout_s=connect_s or CONNECT_S,
    )


@dataclass(frozen=True)
class Device:
    """A connected device: its target text, its own name, and other known facts."""

    target: str
    title: str
    facts: str = ""


@dataclass(frozen=True)
class DeviceList:
    """Connected devices; `missing` has one line for each list that could not be read."""

    serial: tuple[Device, ...]
    audio: tuple[Device, ...]
    missing: tuple[str, ...]

    @property
    def all(self) -> tuple[Device, ...]:
        """All devices, serial ports first."""
        return self.serial + self.audio


def list_devices() -> DeviceList:
    """List the connected devices as the system reports them; never raises.

    Takes up to a second. Only opening a serial port shows whether the device speaks the project's protocol.
    """
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
    except Exception as error:  # the exception depends on the operating system
        raise DeviceError(f"they cannot be listed ({error}).", remedy="Name the port: serial:PORT.") from error
    devices = []
    for port in ports:
        facts_known = [port.manufacturer, f"USB {port.vid:04x}:{port.pid:04x}" if port.vid is not None else None]
        description = str(port.description or "n/a")
        facts = ", ".join(str(fact) for fact in facts_known if fact)
        devices.append(
            Device(f"serial:{port.device}", description if description != "n/a" else str(port.device), facts)
        )
    return tuple(devices)


def _list_sound_outputs() -> tuple[Device, ...]:
    from .sinks.audio import rescan_devices

    sounddevice = import_optional("sounddevice")
    try:
        rescan_devices(sounddevice)
        default = sounddevice.default.device[1]
        apis = [str(api["name"]) for api in sounddevice.query_hostapis()]
        outputs = [output for output in sounddevice.query_devices() if output["max_output_channels"] > 0]
    except sounddevice.PortAudioError as error:
        raise DeviceError(f"they cannot be listed ({error}).", remedy="Name one: audio:DEVICE.") from error
    names = [f"{output['name']}, {apis[output['hostapi']]}" for output in outputs]
    devices = []
    for name, output in zip(names, outputs, strict=True):
        # A name survives replugging, an index does not. Outputs of the same name only differ by their index.
        name_or_index = name if names.count(name) == 1 else str(output["index"])
        facts = f"{output['default_samplerate']:g} Hz, {output['max_output_channels']} channels"
        default_note = ", the default" if output["index"] == default else ""
        devices.append(Device(f"audio:{name_or_index}", str(output["name"]), facts + default_note))
    return tuple(devices)


def _make_target_error(text: str, form: str) -> UsageError:
    return UsageError(f"'{text}' is no place to stream to.", remedy=f"Say {form}.")
