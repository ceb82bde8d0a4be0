"""Messages as bytes of a wire that may lose, flip or invent some.

A5 5A | type | sequence | length (2) | payload | CRC-16 (2) over type … payload, little-endian.
"""

from __future__ import annotations

import struct

from ...errors import UsageError
from .crc import crc16
from .messages import Message

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
