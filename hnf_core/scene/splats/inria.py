"""The .ply layout of Kerbl et al. 2023 (3D Gaussian Splatting, gaussian_model.py save_ply and load_ply), which
nerfstudio, gsplat and most others write too."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import FileError, UsageError
from ...files import write_atomically
from ..ply_header import PlyHeader
from ..ply_rows import Rows, iter_rows
from .cloud import Splats
from .usable import MAX_LOG_SCALE, RawSplats, Real

# Y_00 = 1 / (2 √π): colour = 0.5 + Y_00 · c.
Y_00 = 0.5 / np.sqrt(np.pi)
# Properties f_rest_* of degree 0 … 3: three channels of (L + 1)² − 1.
REST_COUNTS = (0, 9, 24, 45)
CENTRE_PROPERTIES, ROTATION_PROPERTIES = ("x", "y", "z"), ("rot_0", "rot_1", "rot_2", "rot_3")
SCALE_PROPERTIES, DC_PROPERTIES, RGB_PROPERTIES = (
    ("scale_0", "scale_1", "scale_2"),
    ("f_dc_0", "f_dc_1", "f_dc_2"),
    ("red", "green", "blue"),
)
# Beyond it the logistic function is 0 or 1 in float32.
MAX_LOGIT = 104.0
SPLATS_PER_WRITE = 1 << 14


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


def write_inria(path: Path, splats: Splats, *, comments: Sequence[str] = ()) -> None:
    """Little-endian binary as the reference code writes it, with normals of 0. An earlier file is replaced in one step.

    An opacity of 0 or 1 gets the logit −104 or 104, which reads back as itself and not as a number that other
    readers cannot draw. comments: of one line each, for the header. Raises FileError where it cannot be written,
    UsageError for a comment of several lines.
    """
    if any("\n" in comment or "\r" in comment for comment in comments):
        raise UsageError("A comment of a .ply is one line.", where=str(path))
    rest = [f"f_rest_{number}" for number in range(3 * (splats.harmonics.shape[1] - 1))]
    names = [
        *CENTRE_PROPERTIES,
        "nx",
        "ny",
        "nz",
        *DC_PROPERTIES,
        *rest,
        "opacity",
        *SCALE_PROPERTIES,
        *ROTATION_PROPERTIES,
    ]
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment {comment}" for comment in comments)]
    lines += [f"element vertex {len(splats)}", *(f"property float {name}" for name in names), "end_header", ""]

    def write(temporary: Path) -> None:
        with temporary.open("wb") as stream:
            stream.write("\n".join(lines).encode())
            for first in range(0, len(splats), SPLATS_PER_WRITE):
                stream.write(
                    _encode_rows(splats.take(np.arange(first, min(first + SPLATS_PER_WRITE, len(splats))))).tobytes()
                )

    write_atomically(path, write)


def _encode_rows(splats: Splats) -> NDArray[np.float32]:
    """(N, 14 + 3 K) as the file holds it."""
    count = len(splats)
    opacities = splats.opacities.astype(np.float64)
    with np.errstate(divide="ignore"):
        logits = np.clip(np.log(opacities) - np.log1p(-opacities), -MAX_LOGIT, MAX_LOGIT)
        logs = np.log(splats.scales.astype(np.float64))
    rest = splats.harmonics[:, 1:].transpose(0, 2, 1).reshape(count, -1)
    parts = [splats.means, np.zeros((count, 3)), splats.harmonics[:, 0], rest, logits[:, None], logs, splats.rotations]
    return np.asarray(np.concatenate(parts, axis=1), dtype="<f4")


def _read_log_scales(rows: Rows) -> Real:
    there = [name for name in SCALE_PROPERTIES if name in (rows.dtype.names or ())]
    logs = stack_columns(rows, there)
    return logs if len(there) == 3 else np.pad(logs, ((0, 0), (0, 1)), constant_values=-MAX_LOG_SCALE)


def _read_dc_coefficients(rows: Rows) -> Real:
    if DC_PROPERTIES[0] in (rows.dtype.names or ()):
        return stack_columns(rows, DC_PROPERTIES)
    return np.asarray((stack_columns(rows, RGB_PROPERTIES) / 255.0 - 0.5) / Y_00)


_EXPORT_REMEDY = "Export it again as Gaussian splats (INRIA's .ply layout)."
