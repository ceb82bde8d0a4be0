"""Serial protocol version 1: messages between host and device, and their framing (see docs/serial-protocol.md).

Every message is a frozen dataclass with `TYPE` (its byte on the wire), `SIZES` (shortest and longest payload), `pack`
and `unpack`. Numbers are little-endian and unsigned unless stated otherwise. A frame is

    A5 5A | type | sequence | length (2) | payload | CRC-16 (2) over type … payload, little-endian

`Encoder` and `Decoder` convert messages to and from bytes of a wire that may lose, flip or invent some. The checksum is
CRC-16/CCITT-FALSE (polynomial 0x1021, start 0xFFFF, most significant bit first, not inverted; check value 0x29B1),
listed as CRC-16/IBM-3740 in G. Cook's catalogue of parametrised CRC algorithms.
"""

from __future__ import annotations

import binascii
import struct
from dataclasses import astuple, dataclass
from enum import IntEnum
from typing import ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..errors import UsageError

CRC_START = 0xFFFF
CRC_POLYNOMIAL = 0x1021


def crc16(data: bytes) -> int:
    """Compute the frame checksum, 0–0xFFFF; `binascii.crc_hqx` has the same polynomial."""
    return binascii.crc_hqx(data, CRC_START)


VERSION = 1
"""Version of the protocol."""
LARGEST_PAYLOAD = 2048
"""Largest payload of a frame [bytes]."""
LARGEST_NAME = 64
"""Largest device name [bytes]."""
LARGEST_TEXT = 120
"""Largest error text [bytes]."""
NO_TEMPERATURE = -32768
"""Temperature of a device that does not measure it."""
NO_SLEW_LIMIT = 65535
"""Slew that limits nothing: larger than any step between two counts."""
RAMP_MS = 4
"""Longest fade of a device [ms]."""


class State(IntEnum):
    """State of the device in the protocol.

    `WAITING` means started but silent for lack of samples, `STOPPING` fading to silence, and `FAULT` silent until a new
    HELLO because of the last ERROR.
    """

    IDLE = 0
    READY = 1
    WAITING = 2
    PLAYING = 3
    STOPPING = 4
    FAULT = 5


class ErrorCode(IntEnum):
    """Code of an ERROR message."""

    VERSION = 1
    BUSY = 2
    RATE = 3
    CHANNELS = 4
    LIMITS = 5
    STATE = 6
    SESSION = 7
    OVERRUN = 8
    MALFORMED = 9
    HOT = 10
    HARDWARE = 11


class _NumericMessage:
    """Base of messages that hold numbers only."""

    LAYOUT: ClassVar[struct.Struct]

    def pack(self) -> bytes:
        return self.LAYOUT.pack(*astuple(self))  # type: ignore[call-overload]


@dataclass(frozen=True)
class Hello(_NumericMessage):
    """Message from the host: offers the protocol versions `lowest` to `highest`."""

    lowest: int = VERSION
    highest: int = VERSION

    TYPE: ClassVar[int] = 0x01
    SIZES: ClassVar[tuple[int, int]] = (2, 2)
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<BB")

    @classmethod
    def unpack(cls, payload: bytes) -> Hello:
        return cls(*cls.LAYOUT.unpack(payload))


@dataclass(frozen=True)
class Start(_NumericMessage):
    """Message from the host: starts a stream, whose first frame has position 0.

    Attributes
    ----------
    rate_hz : int
        Frames per second.
    channels : int
        Number of channels.
    peak : int
        Largest magnitude that may be played [counts].
    session : int
        Random number of the stream, different from the previous one.
    slew : int
        Largest step between frames [counts].
    queue : int
        Largest number of frames that the device shall queue; 0 = the device chooses.
    flags : int
        0, reserved.
    """

    rate_hz: int
    channels: int
    peak: int
    session: int
    slew: int = NO_SLEW_LIMIT
    queue: int = 0
    flags: int = 0

    TYPE: ClassVar[int] = 0x02
    SIZES: ClassVar[tuple[int, int]] = (14, 14)
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<IBBHHHH")

    def pack(self) -> bytes:
        return self.LAYOUT.pack(self.rate_hz, self.channels, self.flags, self.peak, self.slew, self.queue, self.session)

    @classmethod
    def unpack(cls, payload: bytes) -> Start:
        rate_hz, channels, flags, peak, slew, queue, session = cls.LAYOUT.unpack(payload)
        return cls(rate_hz, channels, peak, session, slew, queue, flags)


@dataclass(frozen=True)
class Samples:
    """Message from the host: frames of the stream from `position` on (frames since START, modulo 2³²).

    `data` is int16, little-endian, interleaved, in complete frames. A message without frames only reports the host's
    position.
    """

    session: int
    position: int
    data: bytes

    TYPE: ClassVar[int] = 0x03
    SIZES: ClassVar[tuple[int, int]] = (6, LARGEST_PAYLOAD)
    HEAD: ClassVar[struct.Struct] = struct.Struct("<HI")

    @classmethod
    def from_counts(cls, session: int, position: int, counts: NDArray[np.int16]) -> Samples:
        """Make a message from (n, channels) counts, n at most `frames_per_message(channels)`."""
        return cls(session, position, np.ascontiguousarray(counts, dtype="<i2").tobytes())

    def counts(self, channels: int) -> NDArray[np.int16]:
        """Return the counts, (n, channels); raise ValueError if `data` is not made of complete frames."""
        return np.frombuffer(self.data, "<i2").astype(np.int16).reshape(-1, channels)

    def pack(self) -> bytes:
        return self.HEAD.pack(self.session, self.position) + self.data

    @classmethod
    def unpack(cls, payload: bytes) -> Samples:
        if len(payload) % 2:
            raise ValueError("half a sample")
        session, position = cls.HEAD.unpack_from(payload)
        return cls(session, position, payload[cls.HEAD.size :])


@dataclass(frozen=True)
class Stop(_NumericMessage):
    """Message from the host: stops the stream, after the queued frames if `drain`, else now with the queue dropped.

    A payload other than 0 or 1 means now.
    """

    drain: bool = False

    TYPE: ClassVar[int] = 0x04
    SIZES: ClassVar[tuple[int, int]] = (1, 1)
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<B")

    @classmethod
    def unpack(cls, payload: bytes) -> Stop:
        return cls(payload == b"\1")


@dataclass(frozen=True)
class Ping(_NumericMessage):
    """Message from the host: checks the connection; the device replies with PONG and STATUS."""

    token: int

    TYPE: ClassVar[int] = 0x05
    SIZES: ClassVar[tuple[int, int]] = (2, 2)
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<H")

    @classmethod
    def unpack(cls, payload: bytes) -> Ping:
        return cls(*cls.LAYOUT.unpack(payload))


@dataclass(frozen=True)
class Bye(_NumericMessage):
    """Message from the host: it leaves. The device becomes silent as after STOP, then IDLE."""

    TYPE: ClassVar[int] = 0x06
    SIZES: ClassVar[tuple[int, int]] = (0, 0)
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<")

    @classmethod
    def unpack(cls, payload: bytes) -> Bye:
        return cls()


@dataclass(frozen=True)
class Caps:
    """Message from the device, in reply to HELLO: chosen protocol version and capabilities.

    Attributes
    ----------
    version : int
        Version used from now on.
    channels : int
        Largest number of channels.
    bits : int
        Bits that reach the transducer.
    lowest_hz, highest_hz : int
        Range of rates.
    queue : int
        Largest number of frames queued.
    peak : int
        Largest magnitude accepted [counts].
    payload : int
        Largest payload accepted [bytes].
    name : str
        Name shown to people.
    """

    version: int
    channels: int
    bits: int
    lowest_hz: int
    highest_hz: int
    queue: int
    peak: int
    payload: int
    name: str

    TYPE: ClassVar[int] = 0x81
    SIZES: ClassVar[tuple[int, int]] = (17, 17 + LARGEST_NAME)
    HEAD: ClassVar[struct.Struct] = struct.Struct("<BBBIIHHH")

    def pack(self) -> bytes:
        return self.HEAD.pack(*astuple(self)[:-1]) + _encode_text(self.name, LARGEST_NAME)

    @classmethod
    def unpack(cls, payload: bytes) -> Caps:
        version, channels, bits, lowest, highest, queue, peak, longest = cls.HEAD.unpack_from(payload)
        name = payload[cls.HEAD.size :].decode("utf-8", "replace")
        return cls(version, channels, bits, lowest, highest, queue, peak, longest, name)


@dataclass(frozen=True)
class Credit(_NumericMessage):
    """Message from the device, at least every 2 ms during a stream: how many frames it can take.

    Attributes
    ----------
    session : int
        Stream that it refers to.
    played : int
        Frames of the stream that have left the queue, modulo 2³².
    queue : int
        Size of the queue [frames].
    free : int
        Free part of the queue [frames].
    state : State
        State of the device.
    """

    session: int
    played: int
    queue: int
    free: int
    state: State

    TYPE: ClassVar[int] = 0x82
    SIZES: ClassVar[tuple[int, int]] = (11, 11)
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<HIHHB")

    @classmethod
    def unpack(cls, payload: bytes) -> Credit:
        session, played, queue, free, state = cls.LAYOUT.unpack(payload)
        return cls(session, played, queue, free, State(state))

    def compute_sendable_frames(self, sent: int) -> int:
        """Return how many more frames a host may send that has sent `sent` (modulo 2³²); negative if too many."""
        outstanding = (sent - self.played) & 0xFFFFFFFF
        return self.queue - (outstanding if outstanding < 0x80000000 else outstanding - 0x100000000)


@dataclass(frozen=True)
class Status(_NumericMessage):
    """Message from the device: counters since HELLO.

    Attributes
    ----------
    underruns : int
        Times that samples were missing during playback.
    crc_errors : int
        Damaged frames on the wire.
    lost : int
        Frames of the stream that never arrived.
    limited : int
        Samples changed by the device's own limits.
    temperature : int
        Coil temperature [0.1 °C], signed, or `NO_TEMPERATURE`.
    state : State
        State of the device.
    """

    underruns: int
    crc_errors: int
    lost: int
    limited: int
    temperature: int
    state: State

    TYPE: ClassVar[int] = 0x83
    SIZES: ClassVar[tuple[int, int]] = (19, 19)
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<IIIIhB")

    @classmethod
    def unpack(cls, payload: bytes) -> Status:
        underruns, crc_errors, lost, limited, temperature, state = cls.LAYOUT.unpack(payload)
        return cls(underruns, crc_errors, lost, limited, temperature, State(state))


@dataclass(frozen=True)
class Pong(_NumericMessage):
    """Message from the device: reply to PING with its token."""

    token: int

    TYPE: ClassVar[int] = 0x84
    SIZES: ClassVar[tuple[int, int]] = (2, 2)
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<H")

    @classmethod
    def unpack(cls, payload: bytes) -> Pong:
        return cls(*cls.LAYOUT.unpack(payload))


@dataclass(frozen=True)
class Error:
    """Message from the device: a request was refused, or the device cannot continue.

    `code` is an `ErrorCode` or a code of a later version; `text` is for people.
    """

    code: int
    text: str

    TYPE: ClassVar[int] = 0x85
    SIZES: ClassVar[tuple[int, int]] = (1, 1 + LARGEST_TEXT)

    def pack(self) -> bytes:
        return struct.pack("<B", self.code) + _encode_text(self.text, LARGEST_TEXT)

    @classmethod
    def unpack(cls, payload: bytes) -> Error:
        return cls(payload[0], payload[1:].decode("utf-8", "replace"))


FromHost: TypeAlias = Hello | Start | Samples | Stop | Ping | Bye
FromDevice: TypeAlias = Caps | Credit | Status | Pong | Error
Message: TypeAlias = FromHost | FromDevice

FROM_HOST: dict[int, type[Message]] = {kind.TYPE: kind for kind in (Hello, Start, Samples, Stop, Ping, Bye)}
"""Messages that a host sends, by their type byte."""
FROM_DEVICE: dict[int, type[Message]] = {kind.TYPE: kind for kind in (Caps, Credit, Status, Pong, Error)}
"""Messages that a device sends, by their type byte."""


def frames_per_message(channels: int, payload: int = LARGEST_PAYLOAD) -> int:
    """Return the largest number of frames in one SAMPLES message of at most `payload` bytes."""
    return (payload - Samples.HEAD.size) // (2 * channels)


def _encode_text(text: str, max_bytes: int) -> bytes:
    data = text.encode("utf-8", "replace")
    if len(data) > max_bytes:
        raise UsageError(f"'{text}' is {len(data)} bytes long.", remedy=f"Say it in {max_bytes}.")
    return data


SYNC = b"\xa5\x5a"
"""First bytes of every frame."""
HEADER = struct.Struct("<BBH")
FRAME_OVERHEAD_BYTES = len(SYNC) + HEADER.size + 2
"""Bytes of a frame besides the payload."""
FRAME_TIMEOUT_S = 0.020
"""Silence after which an incomplete frame is discarded [s]."""


def encode_frame(message: Message, sequence: int) -> bytes:
    """Encode a message as a frame; `sequence` is taken modulo 256.

    Raises
    ------
    UsageError
        If a value does not fit its field.
    """
    try:
        payload = message.pack()
    except struct.error as error:
        raise UsageError(f"{message} does not fit its fields ({error}).") from error
    smallest, largest = message.SIZES
    if not smallest <= len(payload) <= largest:
        raise UsageError(f"a {type(message).__name__} of {len(payload)} bytes has no frame.", remedy="Send less of it.")
    body = HEADER.pack(message.TYPE, sequence & 0xFF, len(payload)) + payload
    return SYNC + body + struct.pack("<H", crc16(body))


class Encoder:
    """Encoder of messages as frames, which it numbers; host and device have one each."""

    def __init__(self) -> None:
        self._sequence = 0

    def encode(self, message: Message) -> bytes:
        data = encode_frame(message, self._sequence)
        self._sequence = (self._sequence + 1) & 0xFF
        return data


class Decoder:
    """Incremental decoder of frames from bytes that arrive in pieces of any size.

    It never raises, and stores at most one frame of maximum size. Of bytes that cannot be a frame (a type that the
    other side does not send, a length that the type does not have, a wrong CRC) only the two sync bytes are dropped;
    the search for a frame continues right after them.

    Parameters
    ----------
    message_types : dict
        `FROM_HOST` or `FROM_DEVICE`, the messages of the other side.

    Attributes
    ----------
    crc_errors : int
        Frames with a wrong CRC.
    gaps : int
        Frames missing by their sequence numbers, modulo 256 each time.
    malformed : int
        Frames with a correct CRC but an invalid content.
    skipped : int
        Bytes outside valid frames.
    """

    def __init__(self, message_types: dict[int, type[Message]]) -> None:
        self._message_types = message_types
        self._sizes = {kind: message.SIZES for kind, message in message_types.items()}
        self._buffer = b""
        self._expected_sequence: int | None = None
        self.crc_errors = self.gaps = self.malformed = self.skipped = 0

    def feed(self, data: bytes) -> list[Message]:
        """Return the messages that become complete with `data`, in order."""
        messages: list[Message] = []
        buffer = self._buffer + bytes(data)
        position = 0
        while True:
            sync = buffer.find(SYNC, position)
            if sync < 0:
                # The last byte may be the first of a sync.
                end_of_garbage = len(buffer) - 1 if buffer[position:].endswith(SYNC[:1]) else len(buffer)
                self.skipped += end_of_garbage - position
                position = end_of_garbage
                break
            self.skipped += sync - position
            position = sync
            body = position + len(SYNC)
            if len(buffer) < body + HEADER.size:
                break
            kind, sequence, length = HEADER.unpack_from(buffer, body)
            smallest, largest = self._sizes.get(kind, (1, 0))
            if smallest <= length <= largest:
                end = body + HEADER.size + length
                if len(buffer) < end + 2:
                    break
                if crc16(buffer[body:end]) == buffer[end] | buffer[end + 1] << 8:
                    messages += self._unpack_message(kind, sequence, buffer[body + HEADER.size : end])
                    position = end + 2
                    continue
                self.crc_errors += 1
            self.skipped += len(SYNC)
            position += len(SYNC)
        self._buffer = buffer[position:]
        return messages

    def flush(self) -> list[Message]:
        """Discard the incomplete frame after `FRAME_TIMEOUT_S` of silence; return the messages found inside it."""
        messages: list[Message] = []
        while self._buffer:
            remaining, self._buffer = self._buffer[1:], b""
            self.skipped += 1
            messages += self.feed(remaining)
        return messages

    def _unpack_message(self, kind: int, sequence: int, payload: bytes) -> list[Message]:
        # HELLO and CAPS begin a connection, so frames missing before them do not count.
        if self._expected_sequence is not None and kind not in (0x01, 0x81):
            self.gaps += (sequence - self._expected_sequence) & 0xFF
        self._expected_sequence = (sequence + 1) & 0xFF
        try:
            return [self._message_types[kind].unpack(payload)]
        except ValueError:
            self.malformed += 1
            return []
