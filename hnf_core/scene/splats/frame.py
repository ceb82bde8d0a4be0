"""Which way is up in the frame of a splat file."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

from ..ply_header import PlyHeader

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
