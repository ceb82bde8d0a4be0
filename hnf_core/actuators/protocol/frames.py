"""Messages as bytes of a wire that may lose, flip or invent some.

A5 5A | type | sequence | length (2) | payload | CRC-16 (2) over type … payload, little-endian.
"""

from __future__ import annotations

import struct

from ...errors import UsageError
from .crc import crc16
from .messages import Message

SYNC = b"\xa5\x5a"
HEAD = struct.Struct("<BBH")
OVERHEAD = len(SYNC) + HEAD.size + 2
"""Bytes of a frame that are not payload."""
IDLE_S = 0.020
"""Without a byte, and a frame that was begun is given up."""


def encode(message: Message, sequence: int) -> bytes:
    """The frame of message; sequence is taken modulo 256. Raises UsageError where a value does not fit its field."""
    try:
        payload = message.pack()
    except struct.error as error:
        raise UsageError(f"{message} does not fit its fields ({error}).") from error
    smallest, largest = message.SIZES
    if not smallest <= len(payload) <= largest:
        raise UsageError(f"a {type(message).__name__} of {len(payload)} bytes has no frame.", remedy="Send less of it.")
    body = HEAD.pack(message.TYPE, sequence & 0xFF, len(payload)) + payload
    return SYNC + body + struct.pack("<H", crc16(body))


class Encoder:
    """encode() that counts its frames, as each side does for what it sends."""

    def __init__(self) -> None:
        self._sequence = 0

    def encode(self, message: Message) -> bytes:
        data = encode(message, self._sequence)
        self._sequence = (self._sequence + 1) & 0xFF
        return data


class Decoder:
    """Messages out of bytes in pieces of any size. Never raises, holds at most one frame of the longest kind.

    What cannot be a frame (a type that the other side does not send, a length that the type does not have, a wrong
    CRC) costs its two bytes of sync only: everything after them is looked at again.

    crc_errors: frames whose CRC was wrong. gaps: frames missing by the sequence numbers, modulo 256 each time.
    malformed: frames with a good CRC whose content means nothing. skipped: bytes outside good frames.
    """

    def __init__(self, kinds: dict[int, type[Message]]) -> None:
        """kinds: FROM_HOST or FROM_DEVICE, what the other side sends."""
        self._kinds = kinds
        self._sizes = {kind: message.SIZES for kind, message in kinds.items()}
        self._held = b""
        self._expected: int | None = None
        self.crc_errors = self.gaps = self.malformed = self.skipped = 0

    def feed(self, data: bytes) -> list[Message]:
        """The messages that end within data, in order."""
        found: list[Message] = []
        held = self._held + bytes(data)
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
            if len(held) < body + HEAD.size:
                break
            kind, sequence, length = HEAD.unpack_from(held, body)
            smallest, largest = self._sizes.get(kind, (1, 0))
            if smallest <= length <= largest:
                end = body + HEAD.size + length
                if len(held) < end + 2:
                    break
                if crc16(held[body:end]) == held[end] | held[end + 1] << 8:
                    found += self._message(kind, sequence, held[body + HEAD.size : end])
                    at = end + 2
                    continue
                self.crc_errors += 1
            self.skipped += len(SYNC)
            at += len(SYNC)
        self._held = held[at:]
        return found

    def idle(self) -> list[Message]:
        """To be called when nothing has come for IDLE_S: what was begun will not end. The messages found in it."""
        found: list[Message] = []
        while self._held:
            held, self._held = self._held[1:], b""
            self.skipped += 1
            found += self.feed(held)
        return found

    def _message(self, kind: int, sequence: int, payload: bytes) -> list[Message]:
        # A HELLO and its CAPS begin a conversation: what was sent before them is not missed.
        if self._expected is not None and kind not in (0x01, 0x81):
            self.gaps += (sequence - self._expected) & 0xFF
        self._expected = (sequence + 1) & 0xFF
        try:
            return [self._kinds[kind].unpack(payload)]
        except ValueError:
            self.malformed += 1
            return []
