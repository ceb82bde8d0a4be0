"""PlayCanvas's compressed .ply (SuperSplat, splat-transform): 256 splats share bounds, each is four 32-bit words.

Words, from the highest bit: position and log-scale 11-10-11, between the bounds of the chunk; rotation 2-10-10-10,
the place of the largest of w x y z and the other three, of ±1/√2; colour 8888, red green blue between the bounds of
the chunk, or of 0 … 1 where it has none, and opacity. Coefficients of higher harmonics: one byte each for ±4.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import FileError
from ..ply_header import PlyHeader
from ..ply_rows import Rows, count_complete_rows, iter_rows, make_truncated_error
from .inria import REST_COUNTS, Y_00, get_rest_names, join_harmonics, stack_columns
from .usable import RawSplats

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
        harmonics=join_harmonics((painted - 0.5) / Y_00, rest),
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
