"""Sink that writes the counts to a 16-bit PCM WAV instead of a device, faster than real time.

If full scale is known, LIST/INFO states the scale, so that `read_wav` returns m/s² (one count is 1/32768 of PCM's full
scale and 1/32767 of the wire's).
"""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np

from ...errors import DeviceError, HnfError, UsageError
from ...export.wav import SCHEMA, UNITS
from ...files import check_writable, write_bytes
from ..limits import FULL_SCALE_COUNTS
from ..sink import Counts, SinkFormat, SinkStatus

QUEUE_S = 0.1
"""Length accepted per write [s]."""
_MAX_DATA_BYTES = 2**32 - 1024


class FileSink:
    """Collects counts; `finish` or `close` writes the file atomically.

    Parameters
    ----------
    path : Path
        WAV to write.
    rate_hz : float
        The source's rate, an integer [Hz].
    channels : int
        Number of channels.
    full_scale_m_s2 : float or None
        Acceleration of a full-scale count [m/s²]; None writes no scale.

    Raises
    ------
    UsageError
        If the rate does not fit into a WAV.
    """

    def __init__(self, path: Path, rate_hz: float, channels: int = 1, full_scale_m_s2: float | None = None) -> None:
        if rate_hz != round(rate_hz) or not 1 <= rate_hz < 2**31 / (2 * channels):
            raise UsageError(f"a WAV needs a whole sample rate, not {rate_hz:g} Hz.", remedy="Resample it first.")
        self._path, self._rate, self._channels, self._full_scale = Path(path), int(rate_hz), channels, full_scale_m_s2
        self._written: list[bytes] = []
        self._frames = 0
        self._open = self._begun = False
        self._problem = ""

    def open(self) -> SinkFormat:
        if self._path.is_dir():
            raise self._make_device_error("it is a folder", "Name a .wav file.")
        try:
            check_writable(self._path)
        except HnfError as error:
            raise DeviceError(error.what, where=error.where, remedy=error.remedy) from error
        self._written, self._frames, self._open, self._begun, self._problem = [], 0, True, False, ""
        queue = max(1, int(self._rate * QUEUE_S))
        return SinkFormat(float(self._rate), self._channels, queue, f"file {self._path}", coil=False, live=False)

    def wait(self, timeout_s: float) -> int:
        return max(1, int(self._rate * QUEUE_S))

    def write(self, counts: Counts) -> None:
        if not self._open:
            raise self._make_device_error("it is closed", "Start again.")
        data = np.ascontiguousarray(counts, dtype="<i2")
        if (self._frames + len(data)) * 2 * self._channels > _MAX_DATA_BYTES:
            raise self._make_device_error("a WAV holds 4 GB, and more has come", "Give --seconds.")
        self._begun = True
        self._written.append(data.tobytes())
        self._frames += len(data)

    def status(self) -> SinkStatus:
        return SinkStatus(played=self._frames, problem=self._problem)

    def finish(self, timeout_s: float) -> None:
        """Write the file; raise DeviceError if that fails."""
        self._begun = True
        try:
            self._save()
        except HnfError as error:
            self._problem = str(error)
            raise DeviceError(error.what, where=error.where, remedy=error.remedy) from error

    def stop(self) -> None:
        """Do nothing: the counts written so far stay."""

    def close(self) -> None:
        try:
            self._save()
        except HnfError as error:
            self._problem = str(error)

    def _save(self) -> None:
        """Write the file if anything was written, so that an abandoned attempt does not replace an earlier file."""
        begun, self._open = self._open and self._begun, False
        if begun:
            write_bytes(
                self._path, encode_pcm_wav(b"".join(self._written), self._rate, self._channels, self._full_scale)
            )

    def _make_device_error(self, what: str, remedy: str) -> DeviceError:
        return DeviceError(f"{what}.", where=str(self._path), remedy=remedy)


def encode_pcm_wav(data: bytes, rate_hz: int, channels: int, full_scale_m_s2: float | None) -> bytes:
    """Encode little-endian 16-bit frames as a WAV, in the layout of `export/wav.py`."""
    format_chunk = struct.pack("<HHIIHH", 1, channels, rate_hz, rate_hz * 2 * channels, 2 * channels, 16)
    body = b"WAVEfmt " + struct.pack("<I", len(format_chunk)) + format_chunk
    if full_scale_m_s2 is not None:
        scale = full_scale_m_s2 * (FULL_SCALE_COUNTS + 1) / FULL_SCALE_COUNTS
        record = {"schema": SCHEMA, "units": UNITS, "scale": scale, "seed": 0, "provenance": {"made by": "hnf stream"}}
        text = json.dumps(record).encode() + b"\0"
        text += b"\0" * (len(text) % 2)
        info = b"INFOICMT" + struct.pack("<I", len(text)) + text
        body += b"LIST" + struct.pack("<I", len(info)) + info
    body += b"data" + struct.pack("<I", len(data)) + data
    return b"RIFF" + struct.pack("<I", len(body)) + body
