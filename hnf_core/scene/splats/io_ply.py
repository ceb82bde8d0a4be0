"""Reading of Gaussian splat files in two .ply layouts, with validation: INRIA's, and PlayCanvas's compressed one.

INRIA's layout (Kerbl et al. 2023, gaussian_model.py save_ply and load_ply) is also written by nerfstudio, gsplat and
most others. In PlayCanvas's (SuperSplat, splat-transform), 256 splats share the bounds of a chunk and each splat is
four 32-bit words, from the highest bit: position and log-scale 11-10-11 between the chunk's bounds; rotation
2-10-10-10, the index of the largest of w x y z and the other three, of ±1/√2; colour 8888, red green blue between the
chunk's bounds, or 0 … 1 if it has none, and opacity. Coefficients of higher harmonics are one byte each for ±4. Damaged
files raise FileError; a few unusable splats are dropped and counted.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import FileError, make_damaged_error
from ..ply import (
    PlyHeader,
    Rows,
    count_complete_rows,
    iter_rows,
    make_truncated_error,
    read_ply_header,
)
from .gaussians import (
    AXES,
    MAX_LOG_SCALE,
    RawSplats,
    SplatSource,
    UpAxis,
    complete_rotations,
    decode_colours,
)

Real = NDArray[np.floating[Any]]


def open_ply(path: Path) -> SplatSource:
    """Open splats in a .ply; raise FileError if its header or length shows that it cannot be read."""
    header = read_ply_header(path)
    if not header.is_splat:
        raise make_no_splats_error(path)
    count = header.count("vertex")
    if count == 0:
        raise FileError("holds no splats: it is empty.", where=str(path), remedy="Export it again.")
    (check_compressed if header.is_compressed else check_inria)(path, header)
    complete = min(count_complete_rows(path, header, name) for name in ("vertex", "sh") if header.count(name))
    if complete < count:
        raise make_truncated_error(path, "vertex", complete, count)
    iterate = iter_compressed if header.is_compressed else iter_inria
    return SplatSource(
        count, detect_up_axis(header), lambda block: iterate(path, header, block), header.format != "ascii"
    )


def make_no_splats_error(path: Path) -> FileError:
    """Return the error for a file of some other content."""
    return FileError(
        "holds no Gaussian splats.",
        where=str(path),
        remedy="Give splats: a .ply in INRIA's or PlayCanvas's layout, .spz, .sog, .splat, .ksplat or glTF.",
    )


# Properties f_rest_* of degree 0 … 3: three channels of (L + 1)² − 1.
REST_COUNTS = (0, 9, 24, 45)
CENTRE_PROPERTIES, ROTATION_PROPERTIES = ("x", "y", "z"), ("rot_0", "rot_1", "rot_2", "rot_3")
SCALE_PROPERTIES, DC_PROPERTIES, RGB_PROPERTIES = (
    ("scale_0", "scale_1", "scale_2"),
    ("f_dc_0", "f_dc_1", "f_dc_2"),
    ("red", "green", "blue"),
)


def check_inria(path: Path, header: PlyHeader) -> None:
    """Raise FileError if a property that splats need is missing or of another type."""
    types = dict(zip(header.names("vertex"), header.types["vertex"], strict=True))
    has_rgb = "f_dc_0" not in types
    # 2-D Gaussian Splatting (Huang et al. 2024) writes no third scale: its Gaussians are flat.
    needed = [
        *CENTRE_PROPERTIES,
        *SCALE_PROPERTIES[:2],
        *ROTATION_PROPERTIES,
        "opacity",
        *(RGB_PROPERTIES if has_rgb else DC_PROPERTIES),
    ]
    rest_names = get_rest_names(path, header.names("vertex"))
    for name in [*needed, *(SCALE_PROPERTIES[2:] if SCALE_PROPERTIES[2] in types else ()), *rest_names]:
        if name not in types:
            raise FileError(f"has no property '{name}' for its splats.", where=str(path), remedy=_EXPORT_REMEDY)
        if types[name] not in (("u1",) if name in RGB_PROPERTIES and has_rgb else ("f4", "f8")):
            raise FileError(f"its property '{name}' is of the wrong type.", where=str(path), remedy=_EXPORT_REMEDY)


def get_rest_names(path: Path, names: Sequence[str]) -> list[str]:
    """Return the names f_rest_0 … in order; raise FileError unless their number fits a degree of 0 to 3."""
    count = sum(name.startswith("f_rest_") for name in names)
    if count not in REST_COUNTS:
        raise FileError(
            f"has {count} color coefficients 'f_rest_' a splat; spherical harmonics of degree 0, 1, 2 or 3 have "
            f"{', '.join(map(str, REST_COUNTS))}.",
            where=str(path),
            remedy="Export it with harmonics of degree 3 at most.",
        )
    return [f"f_rest_{number}" for number in range(count)]


def iter_inria(path: Path, header: PlyHeader, block: int) -> Iterator[RawSplats]:
    """Yield the splats of a file in INRIA's layout, up to `block` at a time; raise FileError if it ends early."""
    rest_names = get_rest_names(path, header.names("vertex"))
    for rows in iter_rows(path, header, "vertex", block):
        yield RawSplats(
            means=stack_columns(rows, CENTRE_PROPERTIES),
            log_scales=_read_log_scales(rows),
            rotations=stack_columns(rows, ROTATION_PROPERTIES),
            opacities=sigmoid(stack_columns(rows, ("opacity",))[:, 0]),
            harmonics=join_harmonics(_read_dc_coefficients(rows), stack_columns(rows, rest_names)),
        )


def stack_columns(rows: Rows, names: Sequence[str]) -> Real:
    """Return named columns of a structured array as a table (N, len(names)), float32, or float64 if one of them is."""
    has_double = any(rows.dtype[name].itemsize == 8 for name in names)
    table: Real = np.empty((len(rows), len(names)), dtype=np.float64 if has_double else np.float32)
    with np.errstate(invalid="ignore"):  # widening a signalling NaN warns
        for number, name in enumerate(names):
            table[:, number] = rows[name]
    return table


def join_harmonics(constant: Real, rest: Real) -> Real:
    """Join constant (N, 3) and higher-degree (N, 3 (K − 1)) SH coefficients, stored by color channel, to (N, K, 3)."""
    higher = rest.reshape(len(rest), 3, -1).transpose(0, 2, 1)
    return np.asarray(np.concatenate([constant[:, None, :], higher], axis=1))


def sigmoid(logits: Real) -> NDArray[np.float64]:
    """Return 1 / (1 + e^−x) without overflow, for stored opacities; 0 and 1 at ∓∞."""
    with np.errstate(invalid="ignore"):  # widening a signalling NaN warns
        small = np.exp(-np.abs(logits.astype(np.float64)))
    return np.asarray(np.where(logits >= 0.0, 1.0, small) / (1.0 + small))


def _read_log_scales(rows: Rows) -> Real:
    present = [name for name in SCALE_PROPERTIES if name in (rows.dtype.names or ())]
    logs = stack_columns(rows, present)
    return logs if len(present) == 3 else np.pad(logs, ((0, 0), (0, 1)), constant_values=-MAX_LOG_SCALE)


def _read_dc_coefficients(rows: Rows) -> Real:
    if DC_PROPERTIES[0] in (rows.dtype.names or ()):
        return stack_columns(rows, DC_PROPERTIES)
    return decode_colours(stack_columns(rows, RGB_PROPERTIES) / 255.0)


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
# Coefficients of harmonics are clipped to ±4: the width of that range.
HARMONIC_RANGE = 8.0

Float = NDArray[np.float64]


def check_compressed(path: Path, header: PlyHeader) -> None:
    """Raise FileError if the elements do not fit together, or a property is missing or of another type."""
    chunk = dict(zip(header.names("chunk"), header.types["chunk"], strict=True))
    vertex = dict(zip(header.names("vertex"), header.types["vertex"], strict=True))
    bounds = [*CENTRE_BOUNDS, *SCALE_BOUNDS, *(COLOUR_BOUNDS if COLOUR_BOUNDS[0] in chunk else ())]
    if any(chunk.get(name) not in ("f4", "f8") for name in bounds) or any(
        vertex.get(name) != "u4" for name in PACKED_PROPERTIES
    ):
        raise make_damaged_error(path, "its header names other properties than PlayCanvas's compressed splats have")
    count, chunks = header.count("vertex"), header.count("chunk")
    if chunks != -(-count // SPLATS_PER_CHUNK):
        raise make_damaged_error(
            path,
            f"{count} splats need {-(-count // SPLATS_PER_CHUNK)} chunks of {SPLATS_PER_CHUNK}, and it has {chunks}",
        )
    if "sh" in header.elements:
        names = get_rest_names(path, header.names("sh"))
        if header.count("sh") != count:
            raise make_damaged_error(path, f"it has harmonics of {header.count('sh')} splats for {count} splats")
        if set(header.names("sh")) != set(names) or set(header.types["sh"]) - {"u1"}:
            raise make_damaged_error(path, "its harmonics are not one byte a coefficient")
    if count_complete_rows(path, header, "chunk") < chunks:
        raise make_truncated_error(path, "vertex", 0, count)


def iter_compressed(path: Path, header: PlyHeader, block: int) -> Iterator[RawSplats]:
    """Yield the splats of a file in PlayCanvas's layout, up to `block` at a time; raise FileError if it ends early.

    The bounds of all chunks (256 splats each) stay in memory, 0.3 bytes a splat.
    """
    bounds = np.concatenate(list(iter_rows(path, header, "chunk", block)))
    with_harmonics = header.count("sh") > 0 and len(header.names("sh")) > REST_COUNTS[0]
    harmonic_rows = iter_rows(path, header, "sh", block) if with_harmonics else None
    first = 0
    for rows in iter_rows(path, header, "vertex", block):
        rest = _unpack_harmonics(next(harmonic_rows)) if harmonic_rows is not None else np.zeros((len(rows), 0))
        yield _unpack_splats(rows, bounds[np.arange(first, first + len(rows)) // SPLATS_PER_CHUNK], rest)
        first += len(rows)


def _unpack_splats(rows: Rows, bounds: Rows, rest: Float) -> RawSplats:
    """Unpack the four 32-bit words of each splat; `bounds` holds its chunk's bounds, `rest` the higher SH degrees."""
    colour = _unpack_fractions(rows["packed_color"], COLOUR_BITS)
    rgb = (
        _interpolate_bounds(bounds, COLOUR_BOUNDS, colour[:, :3])
        if "min_r" in (bounds.dtype.names or ())
        else colour[:, :3]
    )
    return RawSplats(
        means=_interpolate_bounds(bounds, CENTRE_BOUNDS, _unpack_fractions(rows["packed_position"], VECTOR_BITS)),
        log_scales=_interpolate_bounds(bounds, SCALE_BOUNDS, _unpack_fractions(rows["packed_scale"], VECTOR_BITS)),
        rotations=_unpack_rotations(rows["packed_rotation"]),
        opacities=colour[:, 3],
        harmonics=join_harmonics(decode_colours(rgb), rest),
    )


def _unpack_fractions(words: NDArray[np.uint32], fields: tuple[tuple[int, int], ...]) -> Float:
    """Unpack K bit fields, given as (shift, bits), of 32-bit words (N,) to fractions (N, K) in [0, 1]."""
    words = words.astype(np.uint32)
    parts = [((words >> np.uint32(shift)) & np.uint32((1 << bits) - 1)) / ((1 << bits) - 1) for shift, bits in fields]
    return np.asarray(np.stack(parts, axis=1), dtype=np.float64)


def _interpolate_bounds(bounds: Rows, names: tuple[str, ...], fractions: Float) -> Float:
    # Infinite bounds give NaN, which is dropped and counted later; widening a signalling NaN warns.
    with np.errstate(invalid="ignore"):
        low, high = np.split(stack_columns(bounds, names).astype(np.float64), 2, axis=1)
        return np.asarray(low * (1.0 - fractions) + high * fractions)


def _unpack_rotations(words: NDArray[np.uint32]) -> Float:
    """Unpack unit quaternions (N, 4) w x y z from 32-bit words that omit the largest component, which is positive."""
    stored = (_unpack_fractions(words, ROTATION_BITS) - 0.5) * np.sqrt(2.0)
    largest = (words.astype(np.uint32) >> np.uint32(30)).astype(np.intp)
    return complete_rotations(stored, largest)


def _unpack_harmonics(rows: Rows) -> Float:
    """Dequantize bytes to higher-degree SH coefficients (N, 3 (K − 1)): the middle of each step, ±4 at the ends."""
    names = [f"f_rest_{number}" for number in range(len(rows.dtype.names or ()))]
    table = stack_columns(rows, names).astype(np.float64)
    fractions = np.where(table == 0.0, 0.0, np.where(table == 255.0, 1.0, (table + 0.5) / 256.0))
    return np.asarray((fractions - 0.5) * HARMONIC_RANGE)


# nerfstudio's exporter (scripts/exporter.py) writes 'Vertical Axis: z'.
UP_AXIS_COMMENT = re.compile(r"vertical axis:\s*\+?(-?[xyz])\s*$", re.IGNORECASE)


def detect_up_axis(header: PlyHeader) -> UpAxis:
    """Detect which axis of a splat file's frame points up: the one that a comment in the file states, else −y.

    In COLMAP's world +y points down as in its first camera (OpenCV's axes), and training keeps that frame; PlayCanvas's
    tools write .ply in the same orientation. Neither states it, and a scene may still be tilted.
    """
    for comment in header.comments:
        if stated := UP_AXIS_COMMENT.search(comment):
            return UpAxis(AXES[stated[1].lower()], f"the file says '{comment.strip()}'")
    if header.is_compressed:
        return UpAxis("-y", "compressed splats are written with +y down")
    return UpAxis("-y", "the file does not say, and 3-D Gaussian Splatting keeps COLMAP's +y down")
