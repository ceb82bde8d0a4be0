"""Write and read WAV files in m/s² (float32, never normalized), 16-bit copies for actuators, and copies to listen to.

Layout (Microsoft/IBM "Multimedia Programming Interface and Data Specifications 1.0", 1991, and the 1994 revision that
adds the fact chunk to every non-PCM format): fmt (WAVE_FORMAT_IEEE_FLOAT), fact, LIST/INFO, data. INFO holds ISFT (the
software), INAM (the stroke), ISBJ (the material) and ICMT, a JSON object

    {"schema": 1, "units": "m/s^2", "scale": 1.0, "seed": 7, "provenance": {"stroke": …, "material": …, "probe": …, …}}

A sample times scale is an acceleration in units.

16-bit copies: a count of 32767 is full_scale_m_s2, as in every protocol of `hnf_core/actuators`; ICMT holds the factor
from a sample (−1 … 1) to m/s², so that `read_wav` returns accelerations again. Values are rounded, not dithered:
silence stays silence, and equal signals give equal bytes.

Copies to listen to: a signal in m/s² exceeds the −1 … 1 that players take for full scale and would be clipped. Such a
copy is scaled to just below clipping by one gain that the file states. It is not for actuators: its loudness does not
show the strength of a touch, and two copies cannot be compared by loudness.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .. import __version__
from ..errors import FileError, make_damaged_error
from ..field.resampling import resample
from ..files import describe_content, refuse_pointer, write_atomically, write_bytes
from ..signal import Signal
from .envelope import format_clipped
from .options import (
    MAX_FULL_SCALE_M_S2,
    MIN_FULL_SCALE_M_S2,
    ExportOptions,
    ImportOptions,
    get_finite_samples,
    require_samples,
)

UNITS = "m/s^2"
SCHEMA = 1
_PCM, _IEEE_FLOAT, _EXTENSIBLE = 1, 3, 0xFFFE
_MAX_UINT32 = 2**32 - 1
_MIN_UNTOLD_SIZE = 2**31 - 4096
"""Least size of a data chunk that stands for an unknown one where the file is shorter.

Writers that cannot return to the header leave 0xFFFFFFFF (ffmpeg), 0x7FFFF000 (SoX) or 2³¹ less the header (arecord);
one that is killed leaves 0 (Python's wave, GStreamer).
"""
_CHUNK_TAGS = (
    b"fact",
    b"LIST",
    b"cue ",
    b"bext",
    b"smpl",
    b"id3 ",
    b"ID3 ",
    b"PEAK",
    b"JUNK",
    b"iXML",
    b"inst",
    b"data",
)
"""Chunks that may follow an empty data chunk; anything else there are samples whose size was never filled in."""
_FRAMES_PER_BLOCK = 2**16
UNTOLD_SIZE = "its header never told how long it is, so all that follows counts as samples"


def write_wav(path: Path, signal: Signal) -> None:
    """Write a signal as a mono float32 WAV at its own rate, in m/s², atomically.

    Parameters
    ----------
    path : Path
        File to write; an earlier file is unharmed if writing fails.
    signal : Signal
        Signal in m/s².

    Raises
    ------
    FileError
        If a sample is not finite, the rate is not a whole number of Hz, the file would exceed 4 GB, or it cannot be
        written.
    """
    write_bytes(Path(path), encode_wav(signal, where=str(path)))


def write_wav_channels(path: Path, signals: Sequence[Signal]) -> None:
    """Write signals of one rate and length as the channels of a float32 WAV in m/s², atomically.

    Parameters
    ----------
    path : Path
        File to write; an earlier file is unharmed if writing fails.
    signals : sequence of Signal
        Channels; the file states the seed and provenance of the first.

    Raises
    ------
    FileError
        As `write_wav`.
    ValueError
        If rates or lengths differ.
    """
    if len({(signal.sample_rate, len(signal.samples)) for signal in signals}) != 1:
        raise ValueError("channels need one rate and one length")
    samples = np.stack([get_finite_samples(signal, str(path)) for signal in signals], axis=1)
    header = _encode_header(signals[0], len(samples), str(path), len(signals))
    write_bytes(Path(path), header + samples.tobytes())


def write_wav_stream(path: Path, template: Signal, sample_count: int, blocks: Iterable[NDArray[np.float32]]) -> None:
    """Write a signal that arrives in blocks as `write_wav` does; only one block is in memory.

    Parameters
    ----------
    path : Path
        File to write; an earlier file is unharmed if writing fails.
    template : Signal
        Signal without samples, for the rate, seed and provenance.
    sample_count : int
        Total number of samples.
    blocks : iterable of (n,) float32
        Samples [m/s²].

    Raises
    ------
    FileError
        As `write_wav` (for a signal that is too long before the first block is requested), or if the blocks hold
        another number of samples.
    """
    path = Path(path)
    header = _encode_header(template, sample_count, str(path))

    def write(temporary: Path) -> None:
        written = 0
        with temporary.open("wb") as stream:
            stream.write(header)
            for block in blocks:
                samples = get_finite_samples(replace(template, samples=block), str(path))
                stream.write(samples.tobytes())
                written += len(samples)
        if written != sample_count:
            raise FileError(f"{written} samples came of {sample_count}, so nothing was written.", where=str(path))

    write_atomically(path, write)


def encode_wav(signal: Signal, *, where: str = "WAV") -> bytes:
    """Return the bytes that `write_wav` writes: a mono float32 WAV in m/s². Equal signals give equal bytes."""
    samples = get_finite_samples(signal, where)
    return _encode_header(signal, len(samples), where) + samples.tobytes()


def _encode_header(signal: Signal, count: int, where: str, channels: int = 1) -> bytes:
    """Return the bytes of a WAV file before its `count` samples per channel."""
    rate, size = signal.sample_rate, 4 * count * channels
    if not (math.isfinite(rate) and rate == int(rate) and 1 <= rate <= _MAX_UINT32 // 4):
        raise FileError(
            f"a WAV needs a whole sample rate, not {rate:g} Hz.", where=where, remedy="Synthesise at e.g. 8000 Hz."
        )
    frame = 4 * channels
    format_chunk = struct.pack("<HHIIHHH", _IEEE_FLOAT, channels, int(rate), int(rate) * frame, frame, 32, 0)
    chunks = _encode_chunk(b"fmt ", format_chunk) + _encode_chunk(b"fact", struct.pack("<I", min(count, _MAX_UINT32)))
    chunks += encode_info_chunk(signal)
    body = b"WAVE" + chunks + b"data" + struct.pack("<I", min(size, _MAX_UINT32))
    if len(body) + size > _MAX_UINT32:
        raise FileError(
            f"{count / rate:.0f} s at {rate:g} Hz is more than a WAV can hold (4 GB).",
            where=where,
            remedy="Split the stroke or lower the rate.",
        )
    return b"RIFF" + struct.pack("<I", len(body) + size) + body


def read_wav(path: Path, channel: int | None = None) -> Signal:
    """Read one channel of a WAV: one of this project, or any PCM (8, 16, 24, 32 bit) or float (32, 64 bit) file.

    Parameters
    ----------
    path : Path
        File to read: RIFF, or RF64 and BW64 with sizes of 64 bits.
    channel : int or None
        Channel, counted from 1; None for a file that has but one.

    Returns
    -------
    Signal
        Samples, rate, seed and provenance as they were written. A file that does not state its unit gives PCM as −1 … 1
        of full scale and float as stored, and provenance["units"] notes it.

    Raises
    ------
    FileError
        If the file is missing, damaged or compressed, has several channels and none is chosen, or holds samples that
        are not finite.
    """
    path = Path(path)
    return decode_wav(_read_file(path), path, channel)


def read_wav_channels(path: Path) -> tuple[Signal, ...]:
    """Read a WAV of any number of channels as `read_wav` does; return a signal per channel."""
    path = Path(path)
    return decode_wav_channels(_read_file(path), path)


def _read_file(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise FileError(
            f"cannot be read ({error.strerror or error}).", where=str(path), remedy="Check the file's path."
        ) from error


def decode_wav(data: bytes, path: Path, channel: int | None = None) -> Signal:
    """Decode the bytes of a WAV as `read_wav` does; `path` is only for messages."""
    signals = decode_wav_channels(data, path, channel)
    if len(signals) > 1:
        raise FileError(
            f"has {len(signals)} channels, a vibration has one.",
            where=str(path),
            remedy=f"Choose one: hnf import {path.name} --channel 1 --out ONE.wav",
        )
    return signals[0]


def decode_wav_channels(data: bytes, path: Path, channel: int | None = None) -> tuple[Signal, ...]:
    """Decode the bytes of a WAV as `read_wav_channels` does; of one `channel`, counted from 1, if it is given."""
    kind = data[:4]
    if len(data) < 12 or kind not in (b"RIFF", b"RF64", b"BW64") or data[8:12] != b"WAVE":
        refuse_pointer(data, path)
        raise FileError(
            f"is not a RIFF/WAVE file, {describe_content(data)}.", where=str(path), remedy="Give a .wav file."
        )
    chunks, untold = _find_chunks(memoryview(data), path)
    if b"fmt " not in chunks or b"data" not in chunks:
        raise make_damaged_error(path, "it has no " + ("data" if b"fmt " in chunks else "fmt") + " chunk")
    if len(chunks[b"fmt "]) < 16:
        raise make_damaged_error(path, "its fmt chunk is too short")
    rate, samples = _decode_samples(bytes(chunks[b"fmt "]), chunks[b"data"], path, untold, channel)
    info = dict(_iter_info_texts(bytes(chunks.get(b"LIST", b""))))
    record = _parse_comment(info.get("ICMT", ""))
    seed, provenance = 0, {"units": "as stored", "source": path.name}
    if record is not None:
        seed, provenance = record.seed, record.provenance
        if record.scale != 1.0:
            with np.errstate(over="ignore"):
                samples = np.asarray(samples * np.float32(record.scale), dtype=np.float32)
    elif info.get("ICMT"):
        provenance["comment"] = info["ICMT"]
    if untold:
        provenance["assumed"] = UNTOLD_SIZE
    if not np.isfinite(samples).all():
        raise make_damaged_error(path, "some samples are not finite")
    return tuple(Signal(values, float(rate), seed, provenance) for values in samples)


def encode_info_chunk(signal: Signal, scale: float = 1.0) -> bytes:
    """Return LIST/INFO with the signal's provenance; a stored sample (PCM: −1 … 1) times `scale` is in m/s²."""
    return _encode_chunk(
        b"LIST", b"INFO" + b"".join(_encode_chunk(tag, text) for tag, text in _iter_info(signal, scale))
    )


def _iter_info(signal: Signal, scale: float) -> Iterator[tuple[bytes, bytes]]:
    facts = {str(name): str(value) for name, value in signal.provenance.items()}
    record = {"schema": SCHEMA, "units": UNITS, "scale": scale, "seed": int(signal.seed), "provenance": facts}
    yield b"ISFT", _encode_text(f"Haptic Neural Fields {__version__}")
    for tag, name in ((b"INAM", "stroke"), (b"ISBJ", "material")):
        if facts.get(name):
            yield tag, _encode_text(facts[name])
    yield b"ICMT", _encode_text(json.dumps(record))


def _encode_text(text: str) -> bytes:
    return text.replace("\0", " ").encode("utf-8", "replace") + b"\0"


def _decode_text(data: bytes) -> str:
    return data.split(b"\0", 1)[0].decode("utf-8", "replace")


def _encode_chunk(tag: bytes, body: bytes) -> bytes:
    """Encode a RIFF chunk; odd bodies are padded, and the size does not count the pad byte."""
    return tag + struct.pack("<I", len(body)) + body + b"\0" * (len(body) % 2)


def _find_chunks(data: memoryview, path: Path) -> tuple[dict[bytes, memoryview], bool]:
    """Return the first chunk of each tag (of LIST that with INFO), and whether the size of the samples was unknown.

    Nothing beyond the size that RIFF states is read, and of a damaged chunk that holds neither format nor samples only
    what is there. In RF64, the chunk ds64 has the sizes that do not fit 32 bits.
    """
    end, at = len(data), 12
    stated = struct.unpack_from("<I", data, 4)[0]
    long_data = None
    if bytes(data[:4]) == b"RIFF" and 36 <= stated < min(end - 8, _MIN_UNTOLD_SIZE):
        end = stated + 8
    chunks: dict[bytes, memoryview] = {}
    while at + 8 <= end:
        tag, size = bytes(data[at : at + 4]), struct.unpack_from("<I", data, at + 4)[0]
        if tag == b"ds64" and size >= 24 and end - at >= 32:
            long_data = struct.unpack_from("<Q", data, at + 16)[0]
        if tag == b"data" and size == _MAX_UINT32 and long_data is not None:
            size = long_data
        start = at + 8
        if tag == b"data":
            is_unknown = size >= _MIN_UNTOLD_SIZE and start + size > len(data)
            # An empty chunk of samples at the end, or before another chunk, is empty indeed.
            never_filled = size == 0 and start < len(data) and bytes(data[start : start + 4]) not in _CHUNK_TAGS
            if is_unknown or never_filled:
                chunks.setdefault(tag, data[start:])
                return chunks, True
        if start + size > len(data) and tag in (b"fmt ", b"data"):
            name = tag.decode("latin-1").strip()
            raise make_damaged_error(path, f"chunk '{name}' should hold {size} bytes and {len(data) - start} are there")
        if tag != b"LIST" or bytes(data[start : start + 4]) == b"INFO":
            chunks.setdefault(tag, data[start : start + size])
        at = start + size + size % 2
    return chunks, False


def _iter_info_texts(body: bytes) -> Iterator[tuple[str, str]]:
    """Yield name and text of each entry of a LIST/INFO chunk, up to the first that is damaged."""
    at = 4
    while at + 8 <= len(body):
        size = struct.unpack_from("<I", body, at + 4)[0]
        if at + 8 + size > len(body):
            return
        yield body[at : at + 4].decode("latin-1"), _decode_text(body[at + 8 : at + 8 + size])
        at += 8 + size + size % 2


def _decode_samples(
    format_chunk: bytes, data_chunk: memoryview, path: Path, untold: bool, channel: int | None
) -> tuple[int, NDArray[np.float32]]:
    """Return the sample rate and the samples (channels, n) of a WAV's fmt and data chunks.

    `untold` tells that the size of data was unknown, so that an unfinished sample at its end is left out. One `channel`
    alone is decoded if it is given. Beside the file only the samples of the result are held.
    """
    encoding, channels, rate, _, block, bits = struct.unpack_from("<HHIIHH", format_chunk)
    if encoding == _EXTENSIBLE and len(format_chunk) >= 26:
        encoding = struct.unpack_from("<H", format_chunk, 24)[0]
    if channels == 0:
        raise make_damaged_error(path, "it has no channel")
    if rate == 0:
        raise make_damaged_error(path, "its sample rate is 0")
    if encoding not in (_PCM, _IEEE_FLOAT) or bits not in ((8, 16, 24, 32) if encoding == _PCM else (32, 64)):
        raise FileError(
            f"has an encoding that cannot be read (format {encoding}, {bits} bits).",
            where=str(path),
            remedy="Convert it to PCM or 32-bit float.",
        )
    size = bits // 8
    if untold and block:
        data_chunk = data_chunk[: len(data_chunk) - len(data_chunk) % block]
    if block != channels * size or len(data_chunk) % block:
        raise make_damaged_error(path, "its data does not divide into whole samples")
    if channel is not None and not 1 <= channel <= channels:
        raise FileError(
            f"has {channels} channel{'s' if channels > 1 else ''}, and no channel {channel}.",
            where=str(path), remedy=f"Give --channel 1{f' … {channels}' if channels > 1 else ''}.",
        )  # fmt: skip
    chosen = range(channels) if channel is None else (channel - 1,)
    count = len(data_chunk) // block
    samples = np.empty((len(chosen), count), np.float32)
    scale = np.float32(2.0 ** (1 - bits))
    for row, number in enumerate(chosen):
        for first in range(0, count, _FRAMES_PER_BLOCK):
            last = min(count, first + _FRAMES_PER_BLOCK)
            raw = np.frombuffer(data_chunk[first * block : last * block], np.uint8)
            raw = raw.reshape(-1, channels, size)[:, number]
            with np.errstate(over="ignore", invalid="ignore"):  # the caller refuses samples that are not finite
                if encoding == _IEEE_FLOAT:
                    samples[row, first:last] = np.ascontiguousarray(raw).view(f"<f{size}")[:, 0]
                elif bits == 8:
                    samples[row, first:last] = (raw[:, 0].astype(np.float32) - 128.0) * scale
                elif bits == 24:
                    padded = np.zeros((len(raw), 4), np.uint8)
                    padded[:, 1:] = raw
                    samples[row, first:last] = (padded.view("<i4")[:, 0] >> 8) * scale
                else:
                    samples[row, first:last] = np.ascontiguousarray(raw).view(f"<i{size}")[:, 0] * np.float64(scale)
    return rate, samples


@dataclass(frozen=True)
class _CommentRecord:
    """Seed, scale and provenance from an ICMT comment of this project."""

    seed: int
    scale: float
    provenance: dict[str, str]


def _parse_comment(comment: str) -> _CommentRecord | None:
    """Parse an ICMT comment; None if it is not this project's."""
    try:
        record = json.loads(comment)
        if record["units"] != UNITS or not isinstance(record["provenance"], dict):
            return None
        facts = {str(name): str(value) for name, value in record["provenance"].items()}
        return _CommentRecord(int(record["seed"]), float(record["scale"]), facts)
    except (ValueError, KeyError, TypeError, RecursionError, OverflowError):
        return None


FULL_SCALE_COUNTS = 32767
UNSTATED_UNITS = "as stored"
"""Value of provenance["units"] for a file that states no unit."""
_PCM16_DIVISOR = 32768.0
"""Divisor that maps 16-bit samples to −1 … 1."""
_MAX_COPY_BYTES = 2**32 - 2**16


def write_native_wav(path: Path, signal: Signal, options: ExportOptions) -> tuple[str, ...]:
    """Write a signal as float32 WAV in m/s² at its own rate, without loss."""
    write_wav(path, signal)
    return ()


def make_copy_writer(rate_hz: int) -> Callable[[Path, Signal, ExportOptions], tuple[str, ...]]:
    """Return a writer (see `formats.py`) of 16-bit copies for actuators at `rate_hz`."""

    def write(path: Path, signal: Signal, options: ExportOptions) -> tuple[str, ...]:
        return write_pcm16_wav(path, signal, float(rate_hz), options)

    return write


def write_pcm16_wav(path: Path, signal: Signal, rate_hz: float, options: ExportOptions) -> tuple[str, ...]:
    """Write a signal as 16-bit PCM at `rate_hz`; return sentences on what was lost.

    Below 0.9 of the lower Nyquist frequency the resampler (`field/resampling.py`) keeps amplitudes within 0.01 dB.

    Raises FileError if a sample is not finite, the file would exceed 4 GB, or it cannot be written.
    """
    samples = get_finite_samples(signal, str(path)).astype(np.float64)
    resampled, warnings = resample(samples, signal.sample_rate, rate_hz)
    relative = resampled / options.full_scale_m_s2
    counts = np.clip(np.rint(relative * FULL_SCALE_COUNTS), -FULL_SCALE_COUNTS, FULL_SCALE_COUNTS).astype("<i2")
    if counts.nbytes > _MAX_COPY_BYTES:
        raise FileError(f"{signal.duration_s:.0f} s are more than a WAV can hold (4 GB).", where=str(path))
    scale = options.full_scale_m_s2 * _PCM16_DIVISOR / FULL_SCALE_COUNTS
    format_chunk = struct.pack("<4sIHHIIHH", b"fmt ", 16, 1, 1, int(rate_hz), int(rate_hz) * 2, 2, 16)
    body = b"WAVE" + format_chunk + encode_info_chunk(replace(signal, sample_rate=rate_hz), scale)
    body += b"data" + struct.pack("<I", counts.nbytes)
    write_bytes(path, b"RIFF" + struct.pack("<I", len(body) + counts.nbytes) + body + counts.tobytes())
    step = options.full_scale_m_s2 / FULL_SCALE_COUNTS
    losses: tuple[str, ...] = (f"Everything finer than half a step of {step:.3g} m/s² (16 bit).",)
    if rate_hz < signal.sample_rate:
        losses += (f"Frequencies above {0.45 * rate_hz:.0f} Hz fade; above {0.5 * rate_hz:.0f} Hz there are none.",)
    clipped = int(np.count_nonzero(np.abs(relative) > 1.0 + 0.5 / FULL_SCALE_COUNTS))
    return losses + warnings + format_clipped(clipped, options)


def read_wav_with_units(path: Path) -> Signal:
    """Read a WAV that states its unit. Raises FileError for one that does not, and for a damaged one."""
    signal = require_samples(read_wav(path), str(path))
    if signal.provenance.get("units") == UNSTATED_UNITS:
        raise FileError(
            "states no unit, so that nobody knows how strong it is.",
            where=str(path),
            remedy=f"Say it once: hnf import {path.name} --full-scale 30 --out IN_M_S2.wav, and export that.",
        )
    return signal


def read_wav_scaled(path: Path, options: ImportOptions) -> Signal:
    """Read a WAV of this project unchanged, any other multiplied by options.full_scale_m_s2.

    Raises FileError for a file without a unit if `options` has no full scale, and if the file is damaged.
    """
    signal = read_wav(path, options.channel)
    if signal.provenance.get("units") != UNSTATED_UNITS:
        return signal
    if options.full_scale_m_s2 is None:
        raise FileError(
            "states no unit, so that nobody knows how strong it is.",
            where=str(path),
            remedy=f"Say how many {UNITS} a sample of 1.0 stands for: --full-scale 30 (1 for a float file in m/s²).",
        )
    with np.errstate(over="ignore"):
        samples = signal.samples * np.float32(options.full_scale_m_s2)
    if not np.isfinite(samples).all():
        raise FileError("its samples are beyond all measure.", where=str(path), remedy="Give a smaller full scale.")
    facts = {**signal.provenance, "units": UNITS, "scale": f"1 = {options.full_scale_m_s2:g} m/s² (told)"}
    return Signal(samples, signal.sample_rate, signal.seed, facts)


LISTEN_FORMAT = "listen"
LISTEN_RATE_HZ = 48_000.0
LISTEN_PEAK_DBFS = -1.0
"""Peak of a copy to listen to [dBFS]; the rest is headroom for converters and players."""


def fit_full_scale(signal: Signal, options: ExportOptions) -> ExportOptions:
    """Return options with the full scale [m/s²] that brings the signal's peak to `LISTEN_PEAK_DBFS`.

    Silence leaves them unchanged. Raises FileError if a sample is not finite.
    """
    samples = get_finite_samples(signal, LISTEN_FORMAT).astype(np.float64)
    peak = float(np.abs(resample(samples, signal.sample_rate, LISTEN_RATE_HZ)[0]).max(initial=0.0))
    if peak == 0.0:
        return options
    full_scale = peak * 10.0 ** (-LISTEN_PEAK_DBFS / 20.0)
    return replace(options, full_scale_m_s2=min(max(full_scale, MIN_FULL_SCALE_M_S2), MAX_FULL_SCALE_M_S2))


def write_listening_copy(path: Path, signal: Signal, options: ExportOptions) -> tuple[str, ...]:
    """Write a copy to listen to, scaled to just below clipping, 48 kHz and 16 bit; return sentences on what was lost.

    Raises FileError if a sample is not finite or the file cannot be written.
    """
    fitted = fit_full_scale(signal, options)
    gain = (
        f"One gain for the whole file: 1 stands for {fitted.full_scale_m_s2:.3g} m/s². For ears, not for an actuator."
    )
    return (gain, *write_pcm16_wav(path, signal, LISTEN_RATE_HZ, fitted))
