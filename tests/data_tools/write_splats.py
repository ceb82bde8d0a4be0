"""Gaussian splats → a .ply in the layout of Kerbl et al. 2023, as the reference code writes it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hnf_core.errors import UsageError
from hnf_core.files import write_atomically
from hnf_core.scene.splats.gaussians import Splats
from hnf_core.scene.splats.io_ply import CENTRE_PROPERTIES, DC_PROPERTIES, ROTATION_PROPERTIES, SCALE_PROPERTIES

# Beyond this logit the logistic function is 0 or 1 in float32.
MAX_LOGIT = 104.0
SPLATS_PER_WRITE = 1 << 14


def write_inria(path: Path, splats: Splats, *, comments: Sequence[str] = ()) -> None:
    """Write splats as little-endian binary in the layout of the reference code, with normals of 0.

    An earlier file is replaced in one step. An opacity of 0 or 1 gets the logit −104 or 104, which reads back as itself
    and not as a number that other readers cannot draw. Comments are one line each, for the header. Raises FileError
    where the file cannot be written, UsageError for a comment of several lines.
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
    """Encode splats as rows (N, 14 + 3 K) of the file."""
    count = len(splats)
    opacities = splats.opacities.astype(np.float64)
    with np.errstate(divide="ignore"):
        logits = np.clip(np.log(opacities) - np.log1p(-opacities), -MAX_LOGIT, MAX_LOGIT)
        logs = np.log(splats.scales.astype(np.float64))
    rest = splats.harmonics[:, 1:].transpose(0, 2, 1).reshape(count, -1)
    parts = [splats.means, np.zeros((count, 3)), splats.harmonics[:, 0], rest, logits[:, None], logs, splats.rotations]
    return np.asarray(np.concatenate(parts, axis=1), dtype="<f4")
