"""Splats in three packed binary layouts: .splat, .spz and .ksplat.

`.splat` (antimatter15) is rows of 32 bytes without a header: centre and standard deviations as float32, colour and
opacity, and the quaternion w x y z as (byte − 128) / 128. `.spz` (Niantic) holds one attribute of all splats after the
other, gzipped in versions 2 and 3 and as Zstandard streams in version 4, with +y up. `.ksplat` (mkkellogg's
GaussianSplats3D, version 0.1) holds sections of rows; at levels 1 and 2 a centre is 16 bits a coordinate from the
middle of its bucket, and what follows it float16, at level 2 with harmonics of one byte.
"""

from __future__ import annotations

import gzip
import io
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ...errors import FileError, make_damaged_error
from ..file_kind import MAX_KSPLAT_LEVEL, SPLAT_ROW
from ..ply import make_truncated_error, make_unreadable_error
from .gaussians import Floats, RawSplats, SplatSource, UpAxis, complete_rotations, decode_colours, pad_harmonics

HARMONIC_COUNTS = (1, 4, 9, 16, 25)
"""Number of spherical harmonics up to degree 0 … 4."""
MAX_DEGREE = 3
"""Highest degree that is kept."""
TRAINING_FRAME = UpAxis("-y", "it keeps the frame of training, COLMAP's, with +y down")


def open_splat(path: Path) -> SplatSource:
    """Open a .splat file; raise FileError if it is no whole number of splats."""
    count, rest = divmod(_get_size(path), SPLAT_ROW.itemsize)
    if rest:
        raise make_damaged_error(path, f"its length is no multiple of {SPLAT_ROW.itemsize} bytes, so it is cut short")
    if count == 0:
        raise make_damaged_error(path, "it is empty")
    return SplatSource(count, TRAINING_FRAME, lambda block: _iter_splat(path, count, block))


def _iter_splat(path: Path, count: int, block: int) -> Iterator[RawSplats]:
    for rows in _iter_rows(path, SPLAT_ROW, 0, count, block):
        colour = rows["colour"] / 255.0
        yield RawSplats(
            means=rows["means"],
            log_scales=_log(rows["scales"]),
            rotations=(rows["rotation"] - 128.0) / 128.0,
            opacities=colour[:, 3],
            harmonics=decode_colours(colour[:, None, :3]),
        )


def _get_size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError as error:
        raise make_unreadable_error(path, error) from error


def _iter_rows(path: Path, row: np.dtype[Any], offset: int, count: int, block: int) -> Iterator[NDArray[np.void]]:
    """Yield rows of a file, up to `block` at a time."""
    try:
        with path.open("rb") as stream:
            stream.seek(offset)
            for first in range(0, count, block):
                rows = min(block, count - first)
                data = stream.read(rows * row.itemsize)
                if len(data) < rows * row.itemsize:
                    raise make_truncated_error(path, "vertex", first + len(data) // row.itemsize, count)
                yield np.frombuffer(data, dtype=row)
    except OSError as error:
        raise make_unreadable_error(path, error) from error


def _log(scales: Floats) -> Floats:
    """Return logarithms; −∞ for a scale of 0, NaN for one below it."""
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(np.where(scales >= 0.0, _widen(scales), np.nan)))


def _widen(values: NDArray[Any]) -> NDArray[np.float64]:
    with np.errstate(invalid="ignore"):  # widening a signalling NaN warns
        return values.astype(np.float64)


SPZ_HEADER = struct.Struct("<4sIIBBBB")
SPZ_TABLE_OFFSET = struct.Struct("<I")
SPZ_HEADER_BYTES = {2: 16, 3: 16, 4: 32}
"""Version → bytes of the header."""
SPZ_COLOUR_SCALE = 0.15
MAX_PACKING = 1100
"""Largest ratio of packed bytes that is believed; gzip reaches 1,032."""


@dataclass(frozen=True)
class _SpzHeader:
    version: int
    count: int
    degree: int
    fraction_bits: int
    streams: int
    table_offset: int

    @property
    def widths(self) -> tuple[int, ...]:
        """Bytes of a splat in each attribute: centre, opacity, color, scale, rotation, harmonics."""
        return 9, 1, 3, 3, 3 if self.version == 2 else 4, 3 * (HARMONIC_COUNTS[self.degree] - 1)


def open_spz(path: Path) -> SplatSource:
    """Open a .spz file; raise FileError if its header or length shows that it cannot be read."""
    try:
        with _open_spz_stream(path) as stream:
            header = _read_spz_header(path, stream.read(max(SPZ_HEADER_BYTES.values())))
    except (OSError, EOFError, zlib.error) as error:
        raise _make_spz_error(path, error) from error
    if header.count * sum(header.widths) > MAX_PACKING * _get_size(path):
        raise make_damaged_error(path, f"it is too short for the {header.count} splats of its header")
    up = UpAxis("y", "splats in .spz are stored with +y up")
    return SplatSource(header.count, up, lambda block: _iter_spz(path, header, block))


def _open_spz_stream(path: Path) -> BinaryIO:
    with path.open("rb") as stream:
        is_packed = stream.read(2) == b"\x1f\x8b"
    return gzip.open(path) if is_packed else path.open("rb")  # type: ignore[return-value]


def _make_spz_error(path: Path, error: Exception) -> FileError:
    if isinstance(error, OSError) and error.errno is not None:
        return make_unreadable_error(path, error)
    return make_damaged_error(path, "it cannot be unpacked, or it is cut short")


def _read_spz_header(path: Path, data: bytes) -> _SpzHeader:
    if len(data) < SPZ_HEADER.size or not data.startswith(b"NGSP"):
        raise make_damaged_error(path, "it does not begin like a .spz file")
    _, version, count, degree, fraction_bits, _, streams = SPZ_HEADER.unpack_from(data)
    if version not in SPZ_HEADER_BYTES:
        raise FileError(
            f"is a .spz file of version {version}; versions {', '.join(map(str, SPZ_HEADER_BYTES))} are read.",
            where=str(path),
            remedy="Export it as version 3, or convert it to .ply.",
        )
    if degree >= len(HARMONIC_COUNTS) or fraction_bits > 24:
        raise make_damaged_error(
            path, f"its header says harmonics of degree {degree} and {fraction_bits} binary places"
        )
    if count == 0:
        raise make_damaged_error(path, "it holds no splats")
    if len(data) < SPZ_HEADER_BYTES[version]:
        raise make_damaged_error(path, "it is cut short in its header")
    table_offset = SPZ_TABLE_OFFSET.unpack_from(data, SPZ_HEADER.size)[0] if version == 4 else 0
    return _SpzHeader(version, count, degree, fraction_bits, streams, table_offset)


def _iter_spz(path: Path, header: _SpzHeader, block: int) -> Iterator[RawSplats]:
    """Yield splats; the unpacked bytes, 20 to 65 a splat, stay in memory."""
    try:
        parts = (_read_zstandard_streams if header.version == 4 else _read_plain_stream)(path, header)
    except (OSError, EOFError, zlib.error) as error:
        raise _make_spz_error(path, error) from error
    tables = [
        np.frombuffer(part, dtype=np.uint8).reshape(header.count, width)
        for part, width in zip(parts, header.widths, strict=True)
    ]
    for first in range(0, header.count, block):
        centres, opacities, colours, scales, rotations, harmonics = (each[first : first + block] for each in tables)
        constant = ((colours / 255.0 - 0.5) / SPZ_COLOUR_SCALE)[:, None]
        higher = (harmonics.reshape(len(harmonics), -1, 3) - 128.0) / 128.0
        yield RawSplats(
            means=_unpack_fixed_point(centres, header.fraction_bits),
            log_scales=scales / 16.0 - 10.0,
            rotations=_unpack_three_bytes(rotations) if header.version == 2 else _unpack_words(rotations),
            opacities=opacities[:, 0] / 255.0,
            harmonics=np.concatenate([constant, higher], axis=1)[:, : HARMONIC_COUNTS[MAX_DEGREE]],
        )


def _read_plain_stream(path: Path, header: _SpzHeader) -> list[bytes]:
    with _open_spz_stream(path) as stream:
        stream.read(SPZ_HEADER_BYTES[header.version])
        parts = [stream.read(header.count * width) for width in header.widths]
        if sum(map(len, parts)) < header.count * sum(header.widths):
            raise EOFError
        stream.read(1 << 16)  # to the end, where gzip compares its checksum
    return parts


def _read_zstandard_streams(path: Path, header: _SpzHeader) -> list[bytes]:
    try:
        import zstandard
    except ImportError as error:
        raise FileError(
            "is a .spz file of version 4, which needs the Python package zstandard.",
            where=str(path),
            remedy="Run it in Blender, which has it, install zstandard, or export it as version 3.",
        ) from error
    data = path.read_bytes()
    sizes = [header.count * width for width in header.widths if width]
    offset = header.table_offset + 16 * len(sizes)
    if header.streams != len(sizes) or header.table_offset < SPZ_HEADER_BYTES[4] or offset > len(data):
        raise make_damaged_error(path, "its table of streams does not fit its header")
    parts = []
    for number, size in enumerate(sizes):
        packed, unpacked = struct.unpack_from("<QQ", data, header.table_offset + 16 * number)
        if unpacked != size or offset + packed > len(data):
            raise make_damaged_error(path, f"its stream {number + 1} is cut short or of another length")
        reader = zstandard.ZstdDecompressor().stream_reader(io.BytesIO(data[offset : offset + packed]))
        try:
            parts.append(reader.read(size + 1))
        except (zstandard.ZstdError, MemoryError) as error:
            raise make_damaged_error(path, f"its stream {number + 1} cannot be unpacked") from error
        if len(parts[-1]) != size:
            raise make_damaged_error(path, f"its stream {number + 1} is cut short or of another length")
        offset += packed
    return [*parts, *([b""] * (len(header.widths) - len(parts)))]


def _unpack_fixed_point(centres: NDArray[np.uint8], fraction_bits: int) -> Floats:
    """Unpack centres (N, 3) of signed 24-bit fixed point, little endian."""
    wide = np.zeros((len(centres), 3, 4), dtype=np.uint8)
    wide[:, :, 1:] = centres.reshape(-1, 3, 3)
    return np.asarray((wide.view("<i4")[:, :, 0] >> 8) / float(1 << fraction_bits))


def _unpack_three_bytes(rotations: NDArray[np.uint8]) -> Floats:
    """Unpack quaternions (N, 4) w x y z from x y z in a byte each; w is positive."""
    return complete_rotations(rotations / 127.5 - 1.0, np.zeros(len(rotations), dtype=np.intp))


def _unpack_words(rotations: NDArray[np.uint8]) -> Floats:
    """Unpack quaternions (N, 4) w x y z from words of the largest's index in x y z w and three of a sign and 9 bits."""
    words = np.ascontiguousarray(rotations).view("<u4")[:, 0]
    fields = np.stack([(words >> shift) & 1023 for shift in (20, 10, 0)], axis=1).astype(np.int64)
    stored = np.where(fields > 511, -1.0, 1.0) * (fields & 511) / 511.0 * np.sqrt(0.5)
    return complete_rotations(stored, (words >> 30).astype(np.intp))[:, [3, 0, 1, 2]]


KSPLAT_HEADER_BYTES, KSPLAT_SECTION_BYTES = 4096, 1024
DEFAULT_HARMONIC_BOUND = 1.5
DEFAULT_CENTRE_RANGE = 32767
DEGREE_SIZES = (3, 5, 7)
"""Harmonics of degree 1, 2 and 3."""


@dataclass(frozen=True)
class _KsplatSection:
    count: int
    degree: int
    bucket_size: int
    full_buckets: int
    partial_buckets: int
    buckets: int
    step: float
    centre_range: int
    offset: int
    row: np.dtype[Any]

    @property
    def data_offset(self) -> int:
        return self.offset + 4 * self.partial_buckets + 12 * self.buckets


def open_ksplat(path: Path) -> SplatSource:
    """Open a .ksplat file; raise FileError if its headers or length show that it cannot be read."""
    size = _get_size(path)
    try:
        with path.open("rb") as stream:
            head = stream.read(KSPLAT_HEADER_BYTES)
            if len(head) < KSPLAT_HEADER_BYTES or not head.startswith(b"\x00\x01"):
                raise make_damaged_error(path, "it does not begin like a .ksplat file of version 0.1")
            sections, _, _, count = struct.unpack_from("<4I", head, 4)
            level, low, high = (*struct.unpack_from("<H", head, 20), *struct.unpack_from("<ff", head, 36))
            if level > MAX_KSPLAT_LEVEL:
                raise make_damaged_error(path, f"its compression level is {level}, not 0, 1 or 2")
            if KSPLAT_HEADER_BYTES + sections * KSPLAT_SECTION_BYTES > size:
                raise make_damaged_error(path, f"it is cut short in its {sections} section headers")
            headers = [stream.read(KSPLAT_SECTION_BYTES) for _ in range(sections)]
    except OSError as error:
        raise make_unreadable_error(path, error) from error
    found, offset, total = [], KSPLAT_HEADER_BYTES + sections * KSPLAT_SECTION_BYTES, 0
    for data in headers:
        section, offset = _read_ksplat_section(path, data, level, offset)
        if offset > size:
            there = max(0, size - section.data_offset) // section.row.itemsize
            raise make_truncated_error(path, "vertex", total + min(there, section.count), count)
        total += section.count
        found.append(section)
    if total != count or count == 0:
        raise make_damaged_error(path, f"its sections hold {total} splats, its header says {count}")
    bounds = (low or -DEFAULT_HARMONIC_BOUND, high or DEFAULT_HARMONIC_BOUND)
    return SplatSource(count, TRAINING_FRAME, lambda block: _iter_ksplat(path, found, bounds, block))


def _read_ksplat_section(path: Path, data: bytes, level: int, offset: int) -> tuple[_KsplatSection, int]:
    """Return a section and the position after it."""
    count, capacity, bucket_size, buckets = struct.unpack_from("<4I", data)
    (block_size,), (bucket_bytes,) = struct.unpack_from("<f", data, 16), struct.unpack_from("<H", data, 20)
    (centre_range,), (full, partial) = struct.unpack_from("<I", data, 24), struct.unpack_from("<2I", data, 32)
    (degree,) = struct.unpack_from("<H", data, 40)
    centre_range = centre_range or DEFAULT_CENTRE_RANGE
    if degree > MAX_DEGREE or count > capacity or (buckets and bucket_bytes != 12) or full + partial > buckets:
        raise make_damaged_error(path, "a section's header contradicts itself")
    floats, harmonic = ("<f4", "<f4") if level == 0 else ("<f2", "<f2" if level == 1 else "u1")
    row = np.dtype(
        [
            ("means", "<f4" if level == 0 else "<u2", 3),
            ("scales", floats, 3),
            ("rotations", floats, 4),
            ("colour", "u1", 4),
            ("harmonics", harmonic, 3 * (HARMONIC_COUNTS[degree] - 1)),
        ]
    )
    step = block_size / 2.0 / centre_range
    section = _KsplatSection(count, degree, bucket_size, full, partial, buckets, step, centre_range, offset, row)
    return section, section.data_offset + capacity * row.itemsize


def _iter_ksplat(
    path: Path, sections: list[_KsplatSection], bounds: tuple[float, float], block: int
) -> Iterator[RawSplats]:
    harmonics = HARMONIC_COUNTS[max(section.degree for section in sections)]
    for section in sections:
        centres = None
        if section.row["means"].base == np.dtype("<u2"):
            centres, ends = _read_buckets(path, section)
        first = 0
        for rows in _iter_rows(path, section.row, section.data_offset, section.count, block):
            means = _widen(rows["means"])
            if centres is not None:
                bucket = np.searchsorted(ends, np.arange(first, first + len(rows)), side="right")
                with np.errstate(invalid="ignore", over="ignore"):  # a bucket that is not finite is dropped later
                    means = (means - section.centre_range) * section.step + centres[bucket]
            first += len(rows)
            colour = rows["colour"] / 255.0
            constant = decode_colours(colour[:, None, :3])
            higher = _unpack_ksplat_harmonics(rows["harmonics"], section.degree, bounds)
            yield RawSplats(
                means=means,
                log_scales=_log(rows["scales"]),
                rotations=_widen(rows["rotations"]),
                opacities=colour[:, 3],
                harmonics=pad_harmonics(np.concatenate([constant, higher], axis=1), harmonics),
            )


def _read_buckets(path: Path, section: _KsplatSection) -> tuple[Floats, NDArray[np.int64]]:
    """Return the middles (B, 3) of a section's buckets, and the index (B,) of the splat after each."""
    try:
        with path.open("rb") as stream:
            stream.seek(section.offset)
            partial = np.frombuffer(stream.read(4 * section.partial_buckets), dtype="<u4").astype(np.int64)
            centres = np.frombuffer(stream.read(12 * section.buckets), dtype="<f4").reshape(-1, 3)
    except OSError as error:
        raise make_unreadable_error(path, error) from error
    full = np.full(section.full_buckets, section.bucket_size, dtype=np.int64)
    ends = np.cumsum(np.concatenate([full, partial]))
    if section.count and (len(ends) == 0 or ends[-1] < section.count):
        raise make_damaged_error(path, "its buckets do not hold all of its splats")
    return centres, ends


def _unpack_ksplat_harmonics(table: NDArray[Any], degree: int, bounds: tuple[float, float]) -> Floats:
    """Return coefficients (N, K − 1, 3) of rows (N, 3 (K − 1)), which go by degree, then by color channel."""
    values = _widen(table)
    if table.dtype == np.uint8:
        values = bounds[0] + values / 255.0 * (bounds[1] - bounds[0])
    parts, first = [np.empty((len(table), 0, 3))], 0
    for size in DEGREE_SIZES[:degree]:
        parts.append(values[:, first : first + 3 * size].reshape(-1, 3, size).transpose(0, 2, 1))
        first += 3 * size
    return np.concatenate(parts, axis=1)
