"""The checksum of the wire: CRC-16/CCITT-FALSE (polynomial 0x1021, start 0xFFFF, most significant bit first, nothing
inverted; check value 0x29B1). Listed as CRC-16/IBM-3740 in G. Cook's catalogue of parametrised CRC algorithms.

What host and device tell each other: protocol version 1, as docs/serial-protocol.md has it.

Every message is a frozen dataclass with TYPE (the byte on the wire), SIZES (shortest and longest payload), pack() and
unpack(). Numbers are little-endian and unsigned unless said otherwise.

Messages as bytes of a wire that may lose, flip or invent some.

A5 5A | type | sequence | length (2) | payload | CRC-16 (2) over type … payload, little-endian.
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
    """0 … 0xFFFF. Python's own crc_hqx is this polynomial with a start of one's choice."""
    return binascii.crc_hqx(data, CRC_START)


VERSION = 1
LARGEST_PAYLOAD = 2048
LARGEST_NAME = 64
LARGEST_TEXT = 120
NO_TEMPERATURE = -32768
"""Of a device that does not measure it."""
NO_SLEW_LIMIT = 65535
"""Larger than any step between two counts."""
RAMP_MS = 4
"""Longest that a device takes to fade."""


class State(IntEnum):
    """Of the device. WAITING: started, silent for want of samples. STOPPING: on its way to silence. FAULT: silent until
    a new HELLO, because of what its last ERROR said."""

    IDLE = 0
    READY = 1
    WAITING = 2
    PLAYING = 3
    STOPPING = 4
    FAULT = 5


class ErrorCode(IntEnum):
    """Of an ERROR."""

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
    """A message of numbers only."""

    LAYOUT: ClassVar[struct.Struct]

    def pack(self) -> bytes:
        return self.LAYOUT.pack(*astuple(self))  # type: ignore[call-overload]


@dataclass(frozen=True)
class Hello(_NumericMessage):
    """Host: I speak versions lowest … highest."""

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
    """Host: a stream begins, its first frame has position 0.

    rate_hz, channels. flags: 0. peak: largest magnitude of a count that may be played. slew: largest step in counts
    from frame to frame. queue: most frames that the device shall owe, 0 = its own choice. session: drawn by the host,
    told apart from that of any other.
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
    """Host: frames of the stream from position on (frames since START, modulo 2³²). data: int16, little-endian,
    interleaved, whole frames. No frames at all say where the host is."""

    session: int
    position: int
    data: bytes

    TYPE: ClassVar[int] = 0x03
    SIZES: ClassVar[tuple[int, int]] = (6, LARGEST_PAYLOAD)
    HEAD: ClassVar[struct.Struct] = struct.Struct("<HI")

    @classmethod
    def from_counts(cls, session: int, position: int, counts: NDArray[np.int16]) -> Samples:
        """counts: (n, channels), at most frames_per_message(channels) of them."""
        return cls(session, position, np.ascontiguousarray(counts, dtype="<i2").tobytes())

    def counts(self, channels: int) -> NDArray[np.int16]:
        """(n, channels). Raises ValueError where data is not whole frames."""
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
    """Host: silence. drain: after what is queued; otherwise now, and what is queued is dropped. What says neither is
    taken for now."""

    drain: bool = False

    TYPE: ClassVar[int] = 0x04
    SIZES: ClassVar[tuple[int, int]] = (1, 1)
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<B")

    @classmethod
    def unpack(cls, payload: bytes) -> Stop:
        return cls(payload == b"\1")


@dataclass(frozen=True)
class Ping(_NumericMessage):
    """Host: are you there? Answered by PONG and STATUS."""

    token: int

    TYPE: ClassVar[int] = 0x05
    SIZES: ClassVar[tuple[int, int]] = (2, 2)
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<H")

    @classmethod
    def unpack(cls, payload: bytes) -> Ping:
        return cls(*cls.LAYOUT.unpack(payload))


@dataclass(frozen=True)
class Bye(_NumericMessage):
    """Host: I am gone. Silence as after STOP, then IDLE."""

    TYPE: ClassVar[int] = 0x06
    SIZES: ClassVar[tuple[int, int]] = (0, 0)
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<")

    @classmethod
    def unpack(cls, payload: bytes) -> Bye:
        return cls()


@dataclass(frozen=True)
class Caps:
    """Device, to HELLO: version that is spoken from now on, and what I can do.

    channels: most. bits: that reach the transducer. lowest_hz, highest_hz: rates. queue: most frames it ever owes.
    peak: largest magnitude of a count it accepts. payload: longest it takes. name: for people.
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
    """Device, at least every 2 ms while a stream lasts.

    session: whose. played: frames of the stream that have left the queue, modulo 2³². queue: most that it owes.
    free: of them, empty now. state.
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
        """Frames that may be sent now by a host that has sent `sent` frames (any integer; modulo 2³²); below 0 where it
        has sent more than it may."""
        outstanding = (sent - self.played) & 0xFFFFFFFF
        return self.queue - (outstanding if outstanding < 0x80000000 else outstanding - 0x100000000)


@dataclass(frozen=True)
class Status(_NumericMessage):
    """Device, since HELLO. underruns: times that samples were missing while it played. crc_errors: damaged frames of
    the wire. lost: frames of the stream that never came. limited: samples that its own limits changed.
    temperature: 0.1 °C, signed, or NO_TEMPERATURE. state."""

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
    """Device: yes. token: of the PING."""

    token: int

    TYPE: ClassVar[int] = 0x84
    SIZES: ClassVar[tuple[int, int]] = (2, 2)
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<H")

    @classmethod
    def unpack(cls, payload: bytes) -> Pong:
        return cls(*cls.LAYOUT.unpack(payload))


@dataclass(frozen=True)
class Error:
    """Device: I did not do that, or cannot go on. code: a Code, or one of a later version. text: for people."""

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
FROM_DEVICE: dict[int, type[Message]] = {kind.TYPE: kind for kind in (Caps, Credit, Status, Pong, Error)}


def frames_per_message(channels: int, payload: int = LARGEST_PAYLOAD) -> int:
    """Most frames that one SAMPLES carries within payload bytes."""
    return (payload - Samples.HEAD.size) // (2 * channels)


def _encode_text(text: str, max_bytes: int) -> bytes:
    data = text.encode("utf-8", "replace")
    if len(data) > max_bytes:
        raise UsageError(f"'{text}' is {len(data)} bytes long.", remedy=f"Say it in {max_bytes}.")
    return data


SYNC = b"\xa5\x5a"
HEADER = struct.Struct("<BBH")
FRAME_OVERHEAD_BYTES = len(SYNC) + HEADER.size + 2
"""Bytes of a frame that are not payload."""
FRAME_TIMEOUT_S = 0.020
"""Without a byte, and a frame that was begun is given up."""


def encode_frame(message: Message, sequence: int) -> bytes:
    """The frame of message; sequence is taken modulo 256. Raises UsageError where a value does not fit its field."""
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
    """encode() that counts its frames, as each side does for what it sends."""

    def __init__(self) -> None:
        self._sequence = 0

    def encode(self, message: Message) -> bytes:
        data = encode_frame(message, self._sequence)
        self._sequence = (self._sequence + 1) & 0xFF
        return data


class Decoder:
    """Messages out of bytes in pieces of any size. Never raises, holds at most one frame of the longest kind.

    What cannot be a frame (a type that the other side does not send, a length that the type does not have, a wrong
    CRC) costs its two bytes of sync only: everything after them is looked at again.

    crc_errors: frames whose CRC was wrong. gaps: frames missing by the sequence numbers, modulo 256 each time.
    malformed: frames with a good CRC whose content means nothing. skipped: bytes outside good frames.
    """

    def __init__(self, message_types: dict[int, type[Message]]) -> None:
        """kinds: FROM_HOST or FROM_DEVICE, what the other side sends."""
        self._message_types = message_types
        self._sizes = {kind: message.SIZES for kind, message in message_types.items()}
        self._buffer = b""
        self._expected_sequence: int | None = None
        self.crc_errors = self.gaps = self.malformed = self.skipped = 0

    def feed(self, data: bytes) -> list[Message]:
        """The messages that end within data, in order."""
        found: list[Message] = []
        held = self._buffer + bytes(data)
        at = 0
        while True:
            sync = held.find(SYNC, at)
            if sync < 0:
                # The last byte may be the first of a sync.
                keep = len(held) - 1 if held[at:].endswith(SYNC[:1]) else len(held)
                self.skipped += keep - at
                at = keep
                break
            self.skipped += sync - at
            at = sync
            body = at + len(SYNC)
            if len(held) < body + HEADER.size:
                break
            kind, sequence, length = HEADER.unpack_from(held, body)
            smallest, largest = self._sizes.get(kind, (1, 0))
            if smallest <= length <= largest:
                end = body + HEADER.size + length
                if len(held) < end + 2:
                    break
                if crc16(held[body:end]) == held[end] | held[end + 1] << 8:
                    found += self._unpack_message(kind, sequence, held[body + HEADER.size : end])
                    at = end + 2
                    continue
                self.crc_errors += 1
            self.skipped += len(SYNC)
            at += len(SYNC)
        self._buffer = held[at:]
        return found

    def flush(self) -> list[Message]:
        """To be called when nothing has come for IDLE_S: what was begun will not end. The messages found in it."""
        found: list[Message] = []
        while self._buffer:
            held, self._buffer = self._buffer[1:], b""
            self.skipped += 1
            found += self.feed(held)
        return found

    def _unpack_message(self, kind: int, sequence: int, payload: bytes) -> list[Message]:
        # A HELLO and its CAPS begin a conversation: what was sent before them is not missed.
        if self._expected_sequence is not None and kind not in (0x01, 0x81):
            self.gaps += (sequence - self._expected_sequence) & 0xFF
        self._expected_sequence = (sequence + 1) & 0xFF
        try:
            return [self._message_types[kind].unpack(payload)]
        except ValueError:
            self.malformed += 1
            return []
