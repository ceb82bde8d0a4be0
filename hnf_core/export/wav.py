"""WAV files of acceleration [m/s²], with their provenance in the file.

Three kinds are written. Float32 files hold m/s² at the signal's own rate and are never normalised. 16-bit PCM copies
for actuators hold fractions of full scale: a count of 32767 is full_scale_m_s2, as in `hnf_core/actuators`. They are
rounded without dither, so that silence stays silence and equal signals give equal bytes. Copies for listening are
scaled to just below clipping by one gain, which the file states; they are not meant for actuators, and their loudness
must not be compared.

Layout (Microsoft/IBM "Multimedia Programming Interface and Data Specifications 1.0", 1991, and the 1994 revision that
adds the fact chunk to every non-PCM format): fmt (WAVE_FORMAT_IEEE_FLOAT), fact, LIST/INFO, data. INFO holds ISFT (the
software), INAM (the stroke), ISBJ (the material) and ICMT, a JSON object

    {"schema": 1, "units": "m/s^2", "scale": 1.0, "seed": 7, "provenance": {"stroke": …, "material": …, "probe": …, …}}

A sample (−1 … 1 for PCM) times scale is an acceleration in units.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .. import __version__
from ..errors import FileError
from ..field.resampling import resample
from ..files import write_atomically, write_bytes
from ..signal import Signal
from .envelope import format_clipped
from .options import MAX_FULL_SCALE_M_S2, MIN_FULL_SCALE_M_S2, ExportOptions, ImportOptions, get_finite_samples

UNITS = "m/s^2"
SCHEMA = 1
_PCM, _IEEE_FLOAT, _EXTENSIBLE = 1, 3, 0xFFFE
_MAX_UINT32 = 2**32 - 1
_UNKNOWN_SIZE = _MAX_UINT32
"""Chunk size written by programs that stream to a pipe and do not know the length."""


def write_wav(path: Path, signal: Signal) -> None:
    """Write a signal as a mono float32 WAV [m/s²] at its own rate, atomically.

    Parameters
    ----------
    path : Path
        File to write.
    signal : Signal
        Acceleration [m/s²].

    Raises
    ------
    FileError
        If a sample is not finite, the rate is not a whole number of Hz, the signal exceeds a WAV's 4 GB, or the file
        cannot be written; an earlier file at path is then unchanged.
    """
    write_bytes(Path(path), encode_wav(signal, where=str(path)))


def write_wav_stream(path: Path, template: Signal, sample_count: int, blocks: Iterable[NDArray[np.float32]]) -> None:
    """Write a signal that arrives in blocks as a WAV like `write_wav`, with one block in memory at a time.

    Parameters
    ----------
    path : Path
        File to write.
    template : Signal
        Signal without samples, for rate, seed and provenance.
    sample_count : int
        Number of samples in all blocks.
    blocks : iterable of arrays
        Samples [m/s²].

    Raises
    ------
    FileError
        If `write_wav` would raise it (a signal that is too long: before any block is read), or the blocks hold another
        number of samples; an earlier file at path is then unchanged.
    """
    path = Path(path)
    start = _encode_header(template, sample_count, str(path))

    def write(temporary: Path) -> None:
        written = 0
        with temporary.open("wb") as stream:
            stream.write(start)
            for block in blocks:
                samples = get_finite_samples(replace(template, samples=block), str(path))
                stream.write(samples.tobytes())
                written += len(samples)
        if written != sample_count:
            raise FileError(f"{written} samples came of {sample_count}, so nothing was written.", where=str(path))

    write_atomically(path, write)


def encode_wav(signal: Signal, *, where: str = "WAV") -> bytes:
    """Return the bytes that `write_wav` writes; equal signals give equal bytes."""
    samples = get_finite_samples(signal, where)
    return _encode_header(signal, len(samples), where) + samples.tobytes()


def _encode_header(signal: Signal, count: int, where: str) -> bytes:
    """Return all bytes of the file before its samples."""
    rate, size = signal.sample_rate, 4 * count
    if not (math.isfinite(rate) and rate == int(rate) and 1 <= rate <= _MAX_UINT32 // 4):
        raise FileError(
            f"a WAV needs a whole sample rate, not {rate:g} Hz.", where=where, remedy="Synthesise at e.g. 8000 Hz."
        )
    format_chunk = struct.pack("<HHIIHHH", _IEEE_FLOAT, 1, int(rate), int(rate) * 4, 4, 32, 0)
    head = _encode_chunk(b"fmt ", format_chunk) + _encode_chunk(b"fact", struct.pack("<I", min(count, _MAX_UINT32)))
    head += encode_info_chunk(signal)
    body = b"WAVE" + head + b"data" + struct.pack("<I", min(size, _MAX_UINT32))
    if len(body) + size > _MAX_UINT32:
        raise FileError(
            f"{count / rate:.0f} s at {rate:g} Hz is more than a WAV can hold (4 GB).",
            where=where,
            remedy="Split the stroke or lower the rate.",
        )
    return b"RIFF" + struct.pack("<I", len(body) + size) + body


def read_wav(path: Path) -> Signal:
    """Read a mono WAV: a file of this project, or any PCM (8, 16, 24, 32 bit) or float (32, 64 bit) file.

    Parameters
    ----------
    path : Path
        File to read.

    Returns
    -------
    Signal
        Files of this project keep samples, rate, seed and provenance. A file without a unit gives PCM as −1 … 1 of
        full scale and float as stored; provenance["units"] states this.

    Raises
    ------
    FileError
        If the file is missing, damaged or compressed, has several channels, or a sample is not finite.
    """
    path = Path(path)
    return decode_wav(_read_file(path), path)


def read_wav_channels(path: Path) -> tuple[Signal, ...]:
    """Read a WAV with any number of channels like `read_wav`: one signal per channel."""
    path = Path(path)
    return decode_wav_channels(_read_file(path), path)


def _read_file(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise FileError(
            f"cannot be read ({error.strerror or error}).", where=str(path), remedy="Check the file's path."
        ) from error


def decode_wav(data: bytes, path: Path) -> Signal:
    """Decode the bytes of a mono WAV like `read_wav`; error messages name `path`."""
    signals = decode_wav_channels(data, path)
    if len(signals) != 1:
        raise FileError(
            f"has {len(signals)} channels, a vibration has one.", where=str(path), remedy="Export one channel as mono."
        )
    return signals[0]


def decode_wav_channels(data: bytes, path: Path) -> tuple[Signal, ...]:
    """Decode the bytes of a WAV like `read_wav_channels`; error messages name `path`."""
    if len(data) < 12 or data[:4] != b"RIFF" or data[8:12] != b"WAVE":
        raise FileError("is not a RIFF/WAVE file.", where=str(path), remedy="Give a .wav file.")
    form: bytes | None = None
    content: bytes | None = None
    info: dict[str, str] = {}
    for tag, body in _iter_chunks(data[12:], str(path)):
        if tag == b"fmt " and form is None:
            form = body
        elif tag == b"data" and content is None:
            content = body
        elif tag == b"LIST" and body[:4] == b"INFO":
            info = {name.decode("latin-1"): _decode_text(text) for name, text in _iter_chunks(body[4:], str(path))}
    if form is None or content is None:
        raise _damaged_error(path, "it has no " + ("fmt" if form is None else "data") + " chunk")
    if len(form) < 16:
        raise _damaged_error(path, "its fmt chunk is too short")
    rate, samples = _decode_samples(form, content, path)
    record = _parse_comment(info.get("ICMT", ""))
    seed, provenance = 0, {"units": "as stored", "source": path.name}
    if record is not None:
        seed, provenance = record.seed, record.provenance
        if record.scale != 1.0:
            samples = np.asarray(samples * record.scale, dtype=np.float32)
    elif info.get("ICMT"):
        provenance["comment"] = info["ICMT"]
    if not np.isfinite(samples).all():
        raise _damaged_error(path, "some samples are not finite")
    return tuple(Signal(channel, float(rate), seed, provenance) for channel in samples)


def encode_info_chunk(signal: Signal, scale: float = 1.0) -> bytes:
    """Encode the signal's provenance as LIST/INFO; a stored sample (PCM: −1 … 1) times scale is in m/s²."""
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
    """Encode a RIFF chunk; an odd body is padded by a byte that its size does not count."""
    return tag + struct.pack("<I", len(body)) + body + b"\0" * (len(body) % 2)


def _iter_chunks(data: bytes, where: str) -> Iterator[tuple[bytes, bytes]]:
    """Yield tag and body of each chunk.

    Fewer than 8 trailing bytes are ignored, as by most readers. A data chunk of unknown size extends to the end.
    """
    at = 0
    while at + 8 <= len(data):
        tag, size = data[at : at + 4], struct.unpack_from("<I", data, at + 4)[0]
        body = data[at + 8 : at + 8 + size]
        if len(body) < size and not (tag == b"data" and size == _UNKNOWN_SIZE):
            name = tag.decode("latin-1").strip()
            raise _damaged_error(Path(where), f"chunk '{name}' should hold {size} bytes and {len(body)} are there")
        yield tag, body
        at += 8 + size + size % 2


def _decode_samples(format_chunk: bytes, data_chunk: bytes, path: Path) -> tuple[int, NDArray[np.float32]]:
    """Return sample rate [Hz] and samples (channels, n)."""
    kind, channels, rate, _, block, bits = struct.unpack_from("<HHIIHH", format_chunk)
    if kind == _EXTENSIBLE and len(format_chunk) >= 26:
        kind = struct.unpack_from("<H", format_chunk, 24)[0]
    if channels == 0:
        raise _damaged_error(path, "it has no channel")
    if rate == 0:
        raise _damaged_error(path, "its sample rate is 0")
    if kind not in (_PCM, _IEEE_FLOAT) or bits not in ((8, 16, 24, 32) if kind == _PCM else (32, 64)):
        raise FileError(
            f"has an encoding that cannot be read (format {kind}, {bits} bits).",
            where=str(path),
            remedy="Convert it to PCM or 32-bit float.",
        )
    size = bits // 8
    if block != channels * size or len(data_chunk) % block:
        raise _damaged_error(path, "its data does not divide into whole samples")
    if kind == _IEEE_FLOAT:
        with np.errstate(over="ignore", invalid="ignore"):  # refused by their number, later
            return rate, _deinterleave(np.frombuffer(data_chunk, f"<f{size}").astype(np.float32), channels)
    if bits == 8:
        values = np.frombuffer(data_chunk, np.uint8).astype(np.float64) - 128.0
    elif bits == 24:
        wide = np.zeros((len(data_chunk) // 3, 4), np.uint8)
        wide[:, 1:] = np.frombuffer(data_chunk, np.uint8).reshape(-1, 3)
        values = (wide.view("<i4")[:, 0] >> 8).astype(np.float64)
    else:
        values = np.frombuffer(data_chunk, f"<i{size}").astype(np.float64)
    return rate, _deinterleave((values / 2.0 ** (bits - 1)).astype(np.float32), channels)


def _deinterleave(samples: NDArray[np.float32], channels: int) -> NDArray[np.float32]:
    """Convert interleaved samples to (channels, n)."""
    return samples[None] if channels == 1 else np.ascontiguousarray(samples.reshape(-1, channels).T)


@dataclass(frozen=True)
class _CommentRecord:
    """Content of the ICMT entry in files of this project."""

    seed: int
    scale: float
    provenance: dict[str, str]


def _parse_comment(comment: str) -> _CommentRecord | None:
    """Parse the ICMT entry; None if it is not from this project."""
    try:
        record = json.loads(comment)
        if record["units"] != UNITS or not isinstance(record["provenance"], dict):
            return None
        facts = {str(name): str(value) for name, value in record["provenance"].items()}
        return _CommentRecord(int(record["seed"]), float(record["scale"]), facts)
    except (ValueError, KeyError, TypeError, RecursionError, OverflowError):
        return None


def _damaged_error(path: Path, why: str) -> FileError:
    return FileError(f"is damaged: {why}.", where=str(path), remedy="Export or download it again.")


FULL_SCALE_COUNTS = 32767
UNSTATED_UNITS = "as stored"
"""Unit that `read_wav` reports for a file without one."""
_PCM16_DIVISOR = 32768.0
"""Divisor that maps 16-bit samples to −1 … 1."""
_MAX_COPY_BYTES = 2**32 - 2**16


def write_native_wav(path: Path, signal: Signal, options: ExportOptions) -> tuple[str, ...]:
    """Write float32 [m/s²] at the signal's own rate, without loss."""
    write_wav(path, signal)
    return ()


def make_copy_writer(rate_hz: int) -> Callable[[Path, Signal, ExportOptions], tuple[str, ...]]:
    """Return a writer of PCM copies at rate_hz [Hz]."""

    def write(path: Path, signal: Signal, options: ExportOptions) -> tuple[str, ...]:
        return write_pcm16_wav(path, signal, float(rate_hz), options)

    return write


def write_pcm16_wav(path: Path, signal: Signal, rate_hz: float, options: ExportOptions) -> tuple[str, ...]:
    """Write a signal at rate_hz [Hz] as 16-bit PCM; return what was lost, in sentences.

    Below 0.9 of the lower Nyquist frequency the resampler (`field/resampling.py`) keeps amplitudes within 0.01 dB.
    Raises FileError if a sample is not finite, the file would exceed 4 GB, or it cannot be written.
    """
    samples = get_finite_samples(signal, str(path)).astype(np.float64)
    resampled, warnings = resample(samples, signal.sample_rate, rate_hz)
    share = resampled / options.full_scale_m_s2
    counts = np.clip(np.rint(share * FULL_SCALE_COUNTS), -FULL_SCALE_COUNTS, FULL_SCALE_COUNTS).astype("<i2")
    if counts.nbytes > _MAX_COPY_BYTES:
        raise FileError(f"{signal.duration_s:.0f} s are more than a WAV can hold (4 GB).", where=str(path))
    scale = options.full_scale_m_s2 * _PCM16_DIVISOR / FULL_SCALE_COUNTS
    head = struct.pack("<4sIHHIIHH", b"fmt ", 16, 1, 1, int(rate_hz), int(rate_hz) * 2, 2, 16)
    body = b"WAVE" + head + encode_info_chunk(replace(signal, sample_rate=rate_hz), scale)
    body += b"data" + struct.pack("<I", counts.nbytes)
    write_bytes(path, b"RIFF" + struct.pack("<I", len(body) + counts.nbytes) + body + counts.tobytes())
    step = options.full_scale_m_s2 / FULL_SCALE_COUNTS
    words: tuple[str, ...] = (f"Everything finer than half a step of {step:.3g} m/s² (16 bit).",)
    if rate_hz < signal.sample_rate:
        words += (f"Frequencies above {0.45 * rate_hz:.0f} Hz fade; above {0.5 * rate_hz:.0f} Hz there are none.",)
    clipped = int(np.count_nonzero(np.abs(share) > 1.0 + 0.5 / FULL_SCALE_COUNTS))
    return words + warnings + format_clipped(clipped, options)


def read_wav_with_units(path: Path) -> Signal:
    """Read a WAV that states its unit. Raises FileError if it does not, and as `read_wav`."""
    signal = read_wav(path)
    if signal.provenance.get("units") == UNSTATED_UNITS:
        raise FileError(
            "states no unit, so that nobody knows how strong it is.",
            where=str(path),
            remedy=f"Say it once: hnf import {path.name} --full-scale 30 --out IN_M_S2.wav, and export that.",
        )
    return signal


def read_wav_scaled(path: Path, options: ImportOptions) -> Signal:
    """Read a WAV; samples of a file without a unit are multiplied by options.full_scale_m_s2.

    Raises FileError if neither the file nor the options give a scale, and as `read_wav`.
    """
    signal = read_wav(path)
    if signal.provenance.get("units") != UNSTATED_UNITS:
        return signal
    if options.full_scale_m_s2 is None:
        raise FileError(
            "states no unit, so that nobody knows how strong it is.",
            where=str(path),
            remedy=f"Say how many {UNITS} a sample of 1.0 stands for: --full-scale 30 (1 for a float file in m/s²).",
        )
    with np.errstate(over="ignore"):
        samples = (signal.samples.astype(np.float64) * options.full_scale_m_s2).astype(np.float32)
    if not np.isfinite(samples).all():
        raise FileError("its samples are beyond all measure.", where=str(path), remedy="Give a smaller full scale.")
    facts = {**signal.provenance, "units": UNITS, "scale": f"1 = {options.full_scale_m_s2:g} m/s² (told)"}
    return Signal(samples, signal.sample_rate, signal.seed, facts)


LISTEN_FORMAT = "listen"
LISTEN_RATE_HZ = 48_000.0
LISTEN_PEAK_DBFS = -1.0
"""Peak of a listening copy [dBFS]; the rest is headroom for converters and players."""


def fit_full_scale(signal: Signal, options: ExportOptions) -> ExportOptions:
    """Return options with the full scale [m/s²] that brings the signal's peak to `LISTEN_PEAK_DBFS`.

    Silence leaves the options unchanged. Raises FileError if a sample is not finite.
    """
    samples = get_finite_samples(signal, LISTEN_FORMAT).astype(np.float64)
    loudest = float(np.abs(resample(samples, signal.sample_rate, LISTEN_RATE_HZ)[0]).max(initial=0.0))
    if loudest == 0.0:
        return options
    full_scale = loudest * 10.0 ** (-LISTEN_PEAK_DBFS / 20.0)
    return replace(options, full_scale_m_s2=min(max(full_scale, MIN_FULL_SCALE_M_S2), MAX_FULL_SCALE_M_S2))


def write_listening_copy(path: Path, signal: Signal, options: ExportOptions) -> tuple[str, ...]:
    """Write a 48 kHz, 16-bit copy; return what was lost, in sentences. Raises FileError as `write_pcm16_wav`."""
    own = fit_full_scale(signal, options)
    gain = f"One gain for the whole file: 1 stands for {own.full_scale_m_s2:.3g} m/s². For ears, not for an actuator."
    return (gain, *write_pcm16_wav(path, signal, LISTEN_RATE_HZ, own))
