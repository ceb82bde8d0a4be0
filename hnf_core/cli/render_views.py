"""`hnf views`: options of the command that renders a scene's cameras to files, parsed into a `ViewsRequest`.

The request is carried out by hnf_blender.touch.scene_views.
"""

from __future__ import annotations

import argparse
import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import UsageError
from .commands import HELP

DEFAULT_SAMPLES = 64
MAX_PIXELS, MAX_SAMPLES = 1 << 14, 1 << 16
"""Largest side of an image [pixels] and number of samples per pixel."""


@dataclass(frozen=True)
class ViewsRequest:
    """Arguments of one run of `hnf views`.

    Attributes
    ----------
    scene : Path or None
        File to open; None for the file already open in Blender.
    out : Path
        Folder of the results.
    cameras : tuple of str
        Names of the cameras; empty for all.
    frame : float or None
        Scene frame; None for the current one.
    size : tuple of int, or None
        Width and height of the images [pixels]; None for the scene's own.
    samples : int
        Samples per pixel of the color.
    metres_per_unit : float or None
        Length of a scene unit [m]; None for the scene's own.
    as_json : bool
        Print JSON.
    """

    scene: Path | None
    out: Path
    cameras: tuple[str, ...] = ()
    frame: float | None = None
    size: tuple[int, int] | None = None
    samples: int = DEFAULT_SAMPLES
    metres_per_unit: float | None = None
    as_json: bool = False


def add_parser(verbs: Any) -> argparse.ArgumentParser:
    """Add `hnf views`."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        "views",
        help=HELP["views"],
        description="Render the cameras of SCENE to DIR: color (scene linear), depth (m, along the optical axis), "
        "world normals, and ids of objects and materials as EXR, pictures as PNG, and transforms.json as nerfstudio "
        "reads it.",
    )
    parser.add_argument(
        "scene", nargs="?", type=Path, metavar="SCENE",
        help="scene file as of hnf touch; may be left out inside Blender, for the open file",
    )  # fmt: skip
    parser.add_argument("--out", type=Path, metavar="DIR", required=True, help="a new or empty folder for the files")
    parser.add_argument(
        "--camera", action="append", default=[], metavar="NAME", dest="cameras", help="only this camera; repeatable"
    )
    parser.add_argument("--frame", type=float, metavar="N", help="scene frame; default: the file's current one")
    parser.add_argument("--size", metavar="WxH", help="size in pixels; default: the scene's own")
    parser.add_argument(
        "--samples", type=int, default=DEFAULT_SAMPLES, metavar="N",
        help="samples per pixel of the color, which is denoised (default: %(default)s); all else is exact",
    )  # fmt: skip
    parser.add_argument("--scale", type=float, metavar="METERS_PER_UNIT", help="length of one scene unit in meters")
    parser.add_argument("--json", action="store_true", help="print what was written as JSON")
    return parser


def make_views_request(arguments: argparse.Namespace) -> ViewsRequest:
    """Convert parsed options to a request. Raises UsageError for a value that cannot be."""
    if not 1 <= arguments.samples <= MAX_SAMPLES:
        raise UsageError(f"--samples {arguments.samples}: not within 1 to {MAX_SAMPLES}.", remedy="Example: 64.")
    if arguments.frame is not None and not abs(arguments.frame) <= 1e6:
        raise UsageError(f"--frame {arguments.frame:g}: no frame of a scene.", remedy="Example: --frame 12")
    if arguments.scale is not None and not (math.isfinite(arguments.scale) and arguments.scale > 0.0):
        raise UsageError("--scale must be a positive number of meters per unit.", remedy="Example: --scale 0.01")
    return ViewsRequest(
        arguments.scene, arguments.out, tuple(dict.fromkeys(arguments.cameras)), arguments.frame,
        _parse_size(arguments.size), arguments.samples, arguments.scale, arguments.json,
    )  # fmt: skip


def _parse_size(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    match = re.fullmatch(r"(\d{1,6})[x×](\d{1,6})", text.strip().lower())
    size = (int(match[1]), int(match[2])) if match else (0, 0)
    if not all(4 <= side <= MAX_PIXELS for side in size):
        raise UsageError(
            f"--size {text}: not WIDTHxHEIGHT, each within 4 to {MAX_PIXELS} pixels.", remedy="Example: --size 640x480"
        )
    return size
