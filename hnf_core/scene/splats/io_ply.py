"""Which Gaussians of a file can be used: what is kept as it is, what is mended, what is dropped.

The .ply layout of Kerbl et al. 2023 (3D Gaussian Splatting, gaussian_model.py save_ply and load_ply), which
nerfstudio, gsplat and most others write too.

PlayCanvas's compressed .ply (SuperSplat, splat-transform): 256 splats share bounds, each is four 32-bit words.

Words, from the highest bit: position and log-scale 11-10-11, between the bounds of the chunk; rotation 2-10-10-10,
the place of the largest of w x y z and the other three, of ±1/√2; colour 8888, red green blue between the bounds of
the chunk, or of 0 … 1 where it has none, and opacity. Coefficients of higher harmonics: one byte each for ±4.

Splat files → Gaussians, whole or a block at a time; a damaged file is refused, a few unusable splats are dropped.

Which way is up in the frame of a splat file.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ...errors import FileError
from ..ply import PlyHeader, Rows, count_complete_rows, iter_rows, make_truncated_error, read_ply_header
from .gaussians import C0, Box, Single, Splats

Real = NDArray[np.floating[Any]]

# e^±20 = 4.9e8 and 2.1e-9 units: PlayCanvas's writer clips scales here too. Between them the squares and products that
# rendering takes of float32 neither overflow nor vanish.
MAX_LOG_SCALE = 20.0
MAX_VALUE = float(np.exp(MAX_LOG_SCALE))
MIN_QUATERNION_NORM = 1e-12
NOT_FINITE, TOO_LARGE, NO_ROTATION = "not finite", "too large", "no rotation"
DROP_REASONS = (NOT_FINITE, TOO_LARGE, NO_ROTATION)


@dataclass(frozen=True)
class RawSplats:
    """N Gaussians as a file holds them, unchecked: means (N, 3), log_scales (N, 3), rotations (N, 4) w x y z of any
    length, opacities (N,) in [0, 1], harmonics (N, K, 3)."""

    means: Real
    log_scales: Real
    rotations: Real
    opacities: Real
    harmonics: Real


@dataclass(frozen=True)
class ValidatedSplats:
    """splats: what can be used. total: Gaussians read. dropped: how many for each of REASONS, each counted once, for
    the first that holds. thickened: kept ones with an axis below the thinnest (2.1e-9 units), which it became."""

    splats: Splats
    total: int
    dropped: Mapping[str, int]
    thickened: int


def validate_splats(raw: RawSplats) -> ValidatedSplats:
    """Gaussians that can be drawn, in their order.

    Dropped: a NaN anywhere, or an infinite number other than a scale of 0 (log −∞); a centre, scale or colour
    coefficient beyond 4.9e8; a rotation shorter than 1e-12. A scale of 0 is a flat Gaussian, not a broken one: it is
    kept, with the thinnest axis there is.
    """
    # A float64 beyond float32 becomes infinite on purpose, and a rotation of huge numbers has no finite length.
    with np.errstate(over="ignore", invalid="ignore"):
        total = len(raw.means)
        finite = ~np.isnan(raw.log_scales).any(axis=1) & ~np.isnan(raw.opacities)
        finite &= np.isfinite(raw.means).all(axis=1) & np.isfinite(raw.rotations).all(axis=1)
        finite &= np.isfinite(raw.harmonics).all(axis=(1, 2))
        small = (np.abs(raw.means) <= MAX_VALUE).all(axis=1) & (np.abs(raw.harmonics) <= MAX_VALUE).all(axis=(1, 2))
        small &= (raw.log_scales <= MAX_LOG_SCALE).all(axis=1)
        lengths = np.linalg.norm(raw.rotations.astype(np.float64), axis=1)
        turned = (lengths >= MIN_QUATERNION_NORM) & np.isfinite(lengths)
        dropped = dict(
            zip(DROP_REASONS, map(_count_true, (~finite, finite & ~small, finite & small & ~turned)), strict=True)
        )
        kept = finite & small & turned
        logs = raw.log_scales[kept].astype(np.float64)
        splats = Splats(
            means=np.ascontiguousarray(raw.means[kept], dtype=np.float32),
            scales=np.exp(np.maximum(logs, -MAX_LOG_SCALE)).astype(np.float32),
            rotations=(raw.rotations[kept] / lengths[kept, None]).astype(np.float32),
            opacities=raw.opacities[kept].astype(np.float32),
            harmonics=np.ascontiguousarray(raw.harmonics[kept], dtype=np.float32),
        )
    return ValidatedSplats(splats, total, dropped, _count_true((logs < -MAX_LOG_SCALE).any(axis=1)))


def _count_true(mask: NDArray[np.bool_]) -> int:
    return int(np.count_nonzero(mask))


# Properties f_rest_* of degree 0 … 3: three channels of (L + 1)² − 1.
REST_COUNTS = (0, 9, 24, 45)
CENTRE_PROPERTIES, ROTATION_PROPERTIES = ("x", "y", "z"), ("rot_0", "rot_1", "rot_2", "rot_3")
SCALE_PROPERTIES, DC_PROPERTIES, RGB_PROPERTIES = (
    ("scale_0", "scale_1", "scale_2"),
    ("f_dc_0", "f_dc_1", "f_dc_2"),
    ("red", "green", "blue"),
)


def check_inria(path: Path, header: PlyHeader) -> None:
    """Raises FileError where a property that splats need is missing or of another type."""
    types = dict(zip(header.names("vertex"), header.types["vertex"], strict=True))
    painted = "f_dc_0" not in types
    # 2-D Gaussian Splatting (Huang et al. 2024) writes no third scale: its Gaussians are flat.
    needed = [
        *CENTRE_PROPERTIES,
        *SCALE_PROPERTIES[:2],
        *ROTATION_PROPERTIES,
        "opacity",
        *(RGB_PROPERTIES if painted else DC_PROPERTIES),
    ]
    rest = get_rest_names(path, header.names("vertex"))
    for name in [*needed, *(SCALE_PROPERTIES[2:] if SCALE_PROPERTIES[2] in types else ()), *rest]:
        if name not in types:
            raise FileError(f"has no property '{name}' for its splats.", where=str(path), remedy=_EXPORT_REMEDY)
        if types[name] not in (("u1",) if name in RGB_PROPERTIES and painted else ("f4", "f8")):
            raise FileError(f"its property '{name}' is of the wrong type.", where=str(path), remedy=_EXPORT_REMEDY)


def get_rest_names(path: Path, names: Sequence[str]) -> list[str]:
    """The names f_rest_0 … of an element in order. Raises FileError for a number that is no whole degree up to 3."""
    count = sum(name.startswith("f_rest_") for name in names)
    if count not in REST_COUNTS:
        raise FileError(
            f"has {count} colour coefficients 'f_rest_' a splat; spherical harmonics of degree 0, 1, 2 or 3 have "
            f"{', '.join(map(str, REST_COUNTS))}.",
            where=str(path),
            remedy="Export it with harmonics of degree 3 at most.",
        )
    return [f"f_rest_{number}" for number in range(count)]


def iter_inria(path: Path, header: PlyHeader, block: int) -> Iterator[RawSplats]:
    """Splats as the file holds them, up to block at a time. Raises FileError, also for a file that ends early."""
    rest = get_rest_names(path, header.names("vertex"))
    for rows in iter_rows(path, header, "vertex", block):
        yield RawSplats(
            means=stack_columns(rows, CENTRE_PROPERTIES),
            log_scales=_read_log_scales(rows),
            rotations=stack_columns(rows, ROTATION_PROPERTIES),
            opacities=sigmoid(stack_columns(rows, ("opacity",))[:, 0]),
            harmonics=join_harmonics(_read_dc_coefficients(rows), stack_columns(rows, rest)),
        )


def stack_columns(rows: Rows, names: Sequence[str]) -> Real:
    """(N, len(names)) float32, or float64 where a column is."""
    wide = any(rows.dtype[name].itemsize == 8 for name in names)
    table: Real = np.empty((len(rows), len(names)), dtype=np.float64 if wide else np.float32)
    with np.errstate(invalid="ignore"):  # a signalling NaN complains when it is widened
        for number, name in enumerate(names):
            table[:, number] = rows[name]
    return table


def join_harmonics(constant: Real, rest: Real) -> Real:
    """(N, 3) and (N, 3 (K − 1)), the file's order channel by channel → (N, K, 3)."""
    higher = rest.reshape(len(rest), 3, -1).transpose(0, 2, 1)
    return np.asarray(np.concatenate([constant[:, None, :], higher], axis=1))


def sigmoid(logits: Real) -> NDArray[np.float64]:
    """1 / (1 + e^−x) without overflow; 0 and 1 at ∓∞."""
    with np.errstate(invalid="ignore"):  # a signalling NaN complains when it is widened
        small = np.exp(-np.abs(logits.astype(np.float64)))
    return np.asarray(np.where(logits >= 0.0, 1.0, small) / (1.0 + small))


def _read_log_scales(rows: Rows) -> Real:
    there = [name for name in SCALE_PROPERTIES if name in (rows.dtype.names or ())]
    logs = stack_columns(rows, there)
    return logs if len(there) == 3 else np.pad(logs, ((0, 0), (0, 1)), constant_values=-MAX_LOG_SCALE)


def _read_dc_coefficients(rows: Rows) -> Real:
    if DC_PROPERTIES[0] in (rows.dtype.names or ()):
        return stack_columns(rows, DC_PROPERTIES)
    return np.asarray((stack_columns(rows, RGB_PROPERTIES) / 255.0 - 0.5) / C0)


_EXPORT_REMEDY = "Export it again as Gaussian splats (INRIA's .ply layout)."


SPLATS_PER_CHUNK = 256
PACKED_PROPERTIES = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
CENTRE_BOUNDS = ("min_x", "min_y", "min_z", "max_x", "max_y", "max_z")
SCALE_BOUNDS = ("min_scale_x", "min_scale_y", "min_scale_z", "max_scale_x", "max_scale_y", "max_scale_z")
COLOUR_BOUNDS = ("min_r", "min_g", "min_b", "max_r", "max_g", "max_b")
VECTOR_BITS, COLOUR_BITS, ROTATION_BITS = (
    ((21, 11), (11, 10), (0, 11)),
    ((24, 8), (16, 8), (8, 8), (0, 8)),
    ((20, 10), (10, 10), (0, 10)),
)
# Coefficients of harmonics are clipped to ±4.
HARMONIC_RANGE = 8.0
# Where the three kept numbers of a quaternion go, by the place of the one left out.
REMAINING_COMPONENTS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])

Float = NDArray[np.float64]


def check_compressed(path: Path, header: PlyHeader) -> None:
    """Raises FileError where its elements do not fit together, or a property is missing or of another type."""
    chunk = dict(zip(header.names("chunk"), header.types["chunk"], strict=True))
    vertex = dict(zip(header.names("vertex"), header.types["vertex"], strict=True))
    bounds = [*CENTRE_BOUNDS, *SCALE_BOUNDS, *(COLOUR_BOUNDS if COLOUR_BOUNDS[0] in chunk else ())]
    if any(chunk.get(name) not in ("f4", "f8") for name in bounds) or any(
        vertex.get(name) != "u4" for name in PACKED_PROPERTIES
    ):
        raise _damaged_error(path, "its header names other properties than PlayCanvas's compressed splats have")
    count, chunks = header.count("vertex"), header.count("chunk")
    if chunks != -(-count // SPLATS_PER_CHUNK):
        raise _damaged_error(
            path,
            f"{count} splats need {-(-count // SPLATS_PER_CHUNK)} chunks of {SPLATS_PER_CHUNK}, and it has {chunks}",
        )
    if "sh" in header.elements:
        names = get_rest_names(path, header.names("sh"))
        if header.count("sh") != count:
            raise _damaged_error(path, f"it has harmonics of {header.count('sh')} splats for {count} splats")
        if set(header.names("sh")) != set(names) or set(header.types["sh"]) - {"u1"}:
            raise _damaged_error(path, "its harmonics are not one byte a coefficient")
    if count_complete_rows(path, header, "chunk") < chunks:
        raise make_truncated_error(path, "vertex", 0, count)


def iter_compressed(path: Path, header: PlyHeader, block: int) -> Iterator[RawSplats]:
    """Splats as the file holds them, up to block at a time; the bounds of all chunks are held (0.3 bytes a splat).
    Raises FileError, also for a file that ends early."""
    bounds = np.concatenate(list(iter_rows(path, header, "chunk", block)))
    with_harmonics = header.count("sh") > 0 and len(header.names("sh")) > REST_COUNTS[0]
    bytes_of = iter_rows(path, header, "sh", block) if with_harmonics else None
    first = 0
    for rows in iter_rows(path, header, "vertex", block):
        rest = _unpack_harmonics(next(bytes_of)) if bytes_of is not None else np.zeros((len(rows), 0))
        yield _unpack_splats(rows, bounds[np.arange(first, first + len(rows)) // SPLATS_PER_CHUNK], rest)
        first += len(rows)


def _unpack_splats(rows: Rows, bounds: Rows, rest: Float) -> RawSplats:
    """bounds: of each row."""
    colour = _unpack_fractions(rows["packed_color"], COLOUR_BITS)
    painted = (
        _interpolate_bounds(bounds, COLOUR_BOUNDS, colour[:, :3])
        if "min_r" in (bounds.dtype.names or ())
        else colour[:, :3]
    )
    return RawSplats(
        means=_interpolate_bounds(bounds, CENTRE_BOUNDS, _unpack_fractions(rows["packed_position"], VECTOR_BITS)),
        log_scales=_interpolate_bounds(bounds, SCALE_BOUNDS, _unpack_fractions(rows["packed_scale"], VECTOR_BITS)),
        rotations=_unpack_rotations(rows["packed_rotation"]),
        opacities=colour[:, 3],
        harmonics=join_harmonics((painted - 0.5) / C0, rest),
    )


def _unpack_fractions(words: NDArray[np.uint32], fields: tuple[tuple[int, int], ...]) -> Float:
    """(N,) and (shift, bits) of K fields → (N, K) in [0, 1]."""
    words = words.astype(np.uint32)
    parts = [((words >> np.uint32(shift)) & np.uint32((1 << bits) - 1)) / ((1 << bits) - 1) for shift, bits in fields]
    return np.asarray(np.stack(parts, axis=1), dtype=np.float64)


def _interpolate_bounds(bounds: Rows, names: tuple[str, ...], fractions: Float) -> Float:
    # Infinite bounds give NaN, which is dropped and counted later; a signalling NaN complains when it is widened.
    with np.errstate(invalid="ignore"):
        low, high = np.split(stack_columns(bounds, names).astype(np.float64), 2, axis=1)
        return np.asarray(low * (1.0 - fractions) + high * fractions)


def _unpack_rotations(words: NDArray[np.uint32]) -> Float:
    """(N,) → (N, 4) w x y z; the one left out is the root of what the others leave of 1, and positive."""
    others = (_unpack_fractions(words, ROTATION_BITS) - 0.5) * np.sqrt(2.0)
    largest = (words.astype(np.uint32) >> np.uint32(30)).astype(np.intp)
    rotations = np.empty((len(words), 4))
    np.put_along_axis(rotations, REMAINING_COMPONENTS[largest], others, axis=1)
    left = np.sqrt(np.maximum(0.0, 1.0 - np.square(others).sum(axis=1)))
    np.put_along_axis(rotations, largest[:, None], left[:, None], axis=1)
    return rotations


def _unpack_harmonics(rows: Rows) -> Float:
    """Structured bytes → (N, 3 (K − 1)): the middle of each step, and the ends themselves for 0 and 255."""
    names = [f"f_rest_{number}" for number in range(len(rows.dtype.names or ()))]
    table = stack_columns(rows, names).astype(np.float64)
    fractions = np.where(table == 0.0, 0.0, np.where(table == 255.0, 1.0, (table + 0.5) / 256.0))
    return np.asarray((fractions - 0.5) * HARMONIC_RANGE)


def _damaged_error(path: Path, why: str) -> FileError:
    return FileError(f"is damaged: {why}.", where=str(path), remedy="Export or download it again.")


UNSUPPORTED_SUFFIXES = (".spz", ".splat", ".ksplat", ".sog")
# 32,768 splats of degree 3 are 8 MB in the file.
ROWS_PER_BLOCK = 1 << 15
# Training leaves a few broken splats; where more than these are, the file is what is broken.
MAX_DROPPED_SHARE = 0.1


def read_splats(path: Path, *, within: Box | None = None) -> Splats:
    """The usable Gaussians of a file in their order; within: only those whose centre it holds. Raises as read_whole."""
    return read_validated_splats(path, within=within).splats


def read_validated_splats(path: Path, *, within: Box | None = None) -> ValidatedSplats:
    """read_splats with what was dropped; total and dropped count the whole file, with or without a box.

    Raises FileError where the file is missing, cut short, damaged, of another kind, without splats, or where more than
    a tenth of its splats cannot be used.
    """
    path = Path(path)
    header = check_splat_file(path)
    # The count of an ascii file cannot be checked beforehand, so it gets no room.
    kept = _SplatAccumulator(header.count("vertex") if within is None and header.format != "ascii" else None)
    total, thickened = 0, 0
    dropped: Counter[str] = Counter()
    for reading in iter_validated_splats(path, header, ROWS_PER_BLOCK):
        splats = reading.splats
        kept.add(splats if within is None else splats.take(within.contains(splats.means)))
        total, thickened = total + reading.total, thickened + reading.thickened
        dropped.update(reading.dropped)
    return ValidatedSplats(kept.to_splats(), total, dict(dropped), thickened)


def check_splat_file(path: Path) -> PlyHeader:
    """The header of a file whose splats can be read. Raises FileError where its kind, header or length forbid it."""
    path = Path(path)
    if path.suffix.lower() in UNSUPPORTED_SUFFIXES:
        raise FileError(
            f"splats of kind '{path.suffix.lower()}' are not read.",
            where=str(path),
            remedy="Convert it to .ply with SuperSplat or splat-transform.",
        )
    header = read_ply_header(path)
    if not header.is_splat:
        raise FileError(
            "holds no Gaussian splats.", where=str(path), remedy="Give a .ply in INRIA's or PlayCanvas's layout."
        )
    count = header.count("vertex")
    if count == 0:
        raise FileError("holds no splats: it is empty.", where=str(path), remedy="Export it again.")
    (check_compressed if header.is_compressed else check_inria)(path, header)
    there = min(count_complete_rows(path, header, name) for name in ("vertex", "sh") if header.count(name))
    if there < count:
        raise make_truncated_error(path, "vertex", there, count)
    return header


def iter_validated_splats(path: Path, header: PlyHeader, chunk: int) -> Iterator[ValidatedSplats]:
    """Read splats, chunk rows of the file at a time. header: of check_splat_file.

    Raises FileError for what only the numbers show: too many unusable splats (at the end), or an ascii file's end.
    """
    blocks: Iterator[RawSplats] = (iter_compressed if header.is_compressed else iter_inria)(path, header, chunk)
    dropped = 0
    for raw in blocks:
        reading = validate_splats(raw)
        dropped += sum(reading.dropped.values())
        yield reading
    count = header.count("vertex")
    if dropped > MAX_DROPPED_SHARE * count:
        raise FileError(
            f"is damaged: {dropped} of its {count} splats cannot be used.",
            where=str(path),
            remedy="Export or download it again.",
        )


class _SplatAccumulator:
    """Blocks put together. room: splats at most, where it is to be taken at once, so that nothing is held twice."""

    def __init__(self, capacity: int | None) -> None:
        self._capacity, self._count = capacity, 0
        self._fields: tuple[Single, ...] = ()
        self._blocks: list[tuple[Single, ...]] = []

    def add(self, splats: Splats) -> None:
        block = (splats.means, splats.scales, splats.rotations, splats.opacities, splats.harmonics)
        if self._capacity is None:
            self._blocks.append(block)
            return
        if not self._fields:
            self._fields = tuple(np.empty((self._capacity, *part.shape[1:]), dtype=np.float32) for part in block)
        for field, part in zip(self._fields, block, strict=True):
            field[self._count : self._count + len(part)] = part
        self._count += len(splats)

    def to_splats(self) -> Splats:
        if self._capacity is None:
            return Splats(*map(np.concatenate, zip(*self._blocks, strict=True)))
        return Splats(*(field[: self._count] for field in self._fields))


Axis = Literal["x", "y", "z", "-x", "-y", "-z"]
AXES: dict[str, Axis] = {"x": "x", "y": "y", "z": "z", "-x": "-x", "-y": "-y", "-z": "-z"}
# nerfstudio's exporter (scripts/exporter.py) writes 'Vertical Axis: z'.
UP_AXIS_COMMENT = re.compile(r"vertical axis:\s*\+?(-?[xyz])\s*$", re.IGNORECASE)


@dataclass(frozen=True)
class UpAxis:
    """axis: of the file's frame that points up. reason: why it is taken to, for a person to judge."""

    axis: Axis
    reason: str

    @property
    def direction(self) -> tuple[float, float, float]:
        """The unit vector."""
        sign = -1.0 if self.axis.startswith("-") else 1.0
        x, y, z = (sign if name == self.axis[-1] else 0.0 for name in "xyz")
        return x, y, z


def detect_up_axis(header: PlyHeader) -> UpAxis:
    """What the file says itself, else −y.

    COLMAP's world takes the +y down of its first cameras (OpenCV's axes), training keeps that frame, and PlayCanvas's
    tools write .ply so that half a turn about z makes +y up. Neither file says so; a scene may still be tilted.
    """
    for comment in header.comments:
        if stated := UP_AXIS_COMMENT.search(comment):
            return UpAxis(AXES[stated[1].lower()], f"the file says '{comment.strip()}'")
    if header.is_compressed:
        return UpAxis("-y", "compressed splats are written with +y down")
    return UpAxis("-y", "the file does not say, and 3-D Gaussian Splatting keeps COLMAP's +y down")
