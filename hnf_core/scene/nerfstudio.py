"""Cameras of a nerfstudio reconstruction, read from its transforms.json, and written to one.

nerfstudio's cameras look along −z with +y up (OpenGL, Blender); pixel centres lie at +0.5, as in `camera.py`. A trained
model and its exports use another frame: x_model = scale · (T x_original) by dataparser_transforms.json, and x_poses =
applied_scale · (A x_original) by applied_transform and applied_scale of transforms.json
(https://docs.nerf.studio/quickstart/data_conventions.html; nerfstudio_dataparser.py).
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FileError
from ..files import write_text
from .camera import Camera

Float = NDArray[np.float64]

TRANSFORMS_FILE = "transforms.json"
MODEL_TRANSFORM_FILE = "dataparser_transforms.json"
PINHOLE_MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "PERSPECTIVE")
DISTORTION_KEYS = ("k1", "k2", "k3", "k4", "p1", "p2")
LENS_KEYS = ("fl_x", "fl_y", "cx", "cy", "w", "h")
OPENGL_CAMERA_AXES = np.diag([1.0, -1.0, -1.0, 1.0])
"""OpenGL's camera axes (+y up, −z forward) in ours (+y down, +z forward), and back."""
RIGID_TOLERANCE = 1e-3
"""Largest deviation of R Rᵀ from 1; files store float32 or typed numbers."""
MAX_PIXELS = 1 << 16
"""Largest accepted width or height of an image [pixels]."""


@dataclass(frozen=True)
class NerfstudioFrame:
    """One image of a reconstruction and its camera.

    Attributes
    ----------
    file_path, depth_file_path : str
        Paths below the folder of transforms.json, with '/'; "" if there is no depth image.
    camera : Camera
        Camera in the frame and unit of the file's poses, or of the trained model if read by `read_model_transforms`.
    more : mapping of str to str
        Further keys that are written, which nerfstudio passes over.
    """

    file_path: str
    camera: Camera
    depth_file_path: str = ""
    more: Mapping[str, str] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Name of the image without folder and suffix."""
        return PurePosixPath(self.file_path).stem


def read_transforms(path: Path) -> tuple[NerfstudioFrame, ...]:
    """Read the images of a transforms.json in file order, with cameras in the frame of the file's poses.

    Raises FileError if the file is damaged, a key is missing or no number, a lens is no plain pinhole, a matrix is not
    rigid, or a path leaves the file's folder.
    """
    document = _read_document(path)
    entries = document.get("frames")
    if not isinstance(entries, list) or not entries:
        raise _unusable_error(path, "it has no 'frames'", "Give the transforms.json of the pictures, not of the model.")
    return tuple(_parse_frame(path, document, entry, index) for index, entry in enumerate(entries))


def read_model_transforms(path: Path) -> tuple[NerfstudioFrame, ...]:
    """Read the images of a transforms.json, with cameras in the frame of the exported model.

    Parameters
    ----------
    path : Path
        The transforms.json. The transform to the model is read from dataparser_transforms.json in the same folder;
        without that file the frame of the poses is returned.

    Returns
    -------
    tuple of NerfstudioFrame
        The frames in file order.

    Raises
    ------
    FileError
        If a file is damaged, a key is missing or no number, a lens is no plain pinhole, a path leaves the folder, or a
        transform is not rigid or cannot be inverted.
    """
    frames = read_transforms(path)
    model_path = path.with_name(MODEL_TRANSFORM_FILE)
    if not model_path.is_file():
        return frames
    document, model = _read_document(path), _read_document(model_path)
    applied_axes = np.eye(4)
    if "applied_transform" in document:
        applied_axes = _read_rigid_matrix(path, document["applied_transform"], "applied_transform")
    applied = _read_number(path, document, "applied_scale", "") if "applied_scale" in document else 1.0
    to_model = _read_rigid_matrix(model_path, model.get("transform"), "transform")
    scale = _read_number(model_path, model, "scale", "")
    if not applied > 0.0 or not scale > 0.0:
        raise _unusable_error(path, "a scale is not positive", "Export it again.")
    return tuple(
        replace(frame, camera=_transform_camera(frame.camera, applied_axes, applied, to_model, scale))
        for frame in frames
    )


def _parse_frame(path: Path, document: Mapping[str, Any], entry: Any, index: int) -> NerfstudioFrame:
    where = f"frame {index}"
    if not isinstance(entry, dict) or not isinstance(entry.get("file_path"), str) or not entry["file_path"]:
        raise _unusable_error(path, f"{where} has no 'file_path'")
    where = f"frame '{entry['file_path']}'"
    settings = {**document, **entry}
    model = settings.get("camera_model", "OPENCV")
    if model not in PINHOLE_MODELS:
        raise _unusable_error(
            path, f"{where} has the camera model {model!r}, and only pinholes are read", UNDISTORT_REMEDY
        )
    for key in DISTORTION_KEYS:
        if key in settings and _read_number(path, settings, key, where) != 0.0:
            raise _unusable_error(path,
            f"{where}: its lens distorts ({key} = {settings[key]:g}), and only pinholes are read",
                         UNDISTORT_REMEDY)  # fmt: skip
    fl_x, fl_y, cx, cy, width, height = (_read_number(path, settings, key, where) for key in LENS_KEYS)
    if not (fl_x > 0.0 and fl_y > 0.0):
        raise _unusable_error(path, f"{where}: its focal lengths must be positive")
    if not (1 <= width <= MAX_PIXELS and 1 <= height <= MAX_PIXELS and width % 1 == 0 and height % 1 == 0):
        raise _unusable_error(path, f"{where}: {width:g} × {height:g} is no size of a picture")
    if "transform_matrix" not in entry:
        raise _unusable_error(path, f"{where} has no 'transform_matrix'")
    pose = _read_rigid_matrix(path, entry["transform_matrix"], f"{where}: its transform_matrix") @ OPENGL_CAMERA_AXES
    intrinsics = np.array([[fl_x, 0.0, cx], [0.0, fl_y, cy], [0.0, 0.0, 1.0]])
    depth = entry.get("depth_file_path") or ""
    if not isinstance(depth, str):
        raise _unusable_error(path, f"{where}: its depth_file_path is no text")
    return NerfstudioFrame(
        file_path=check_relative_path(path, entry["file_path"], where),
        camera=Camera("perspective", int(width), int(height), intrinsics, pose),
        depth_file_path=check_relative_path(path, depth, where) if depth else "",
    )


UNDISTORT_REMEDY = "Undistort the pictures first (colmap image_undistorter), and make transforms.json of those."


def _transform_camera(camera: Camera, axes: Float, applied: float, to_model: Float, scale: float) -> Camera:
    pose = camera.pose.copy()
    pose[:3, 3] /= applied
    pose = to_model @ np.linalg.inv(axes) @ pose
    pose[:3, 3] *= scale
    return replace(camera, pose=pose)


def _read_document(path: Path) -> dict[str, Any]:
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise FileError(
            f"cannot be read ({error.strerror or error}).", where=str(path), remedy="Check the path."
        ) from error
    except (ValueError, RecursionError) as error:
        raise _unusable_error(path, "it is no JSON") from error
    if isinstance(document, list):
        raise _unusable_error(
            path, "it lists poses without their lenses", "Give the transforms.json that was trained on."
        )
    if not isinstance(document, dict):
        raise _unusable_error(path, "it is no JSON object")
    return document


def _read_number(path: Path, settings: Mapping[str, Any], key: str, where: str) -> float:
    if key not in settings:
        raise _unusable_error(path, f"{where} has no '{key}'" if where else f"it has no '{key}'")
    value = settings[key]
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise _unusable_error(path, f"{where or 'it'}: '{key}' is no number")
    return float(value)


def _read_rigid_matrix(path: Path, values: Any, name: str) -> Float:
    """Return the rigid (4, 4) matrix of three or four rows, its rotation made exact; raise FileError if not rigid."""
    try:
        rows = np.array(values, dtype=np.float64)
    except (ValueError, TypeError, OverflowError):
        rows = np.zeros(0)
    if rows.shape not in {(3, 4), (4, 4)} or not np.isfinite(rows).all():
        raise _unusable_error(path, f"{name} is no matrix of 3 × 4 or 4 × 4 numbers")
    if len(rows) == 4 and not np.allclose(rows[3], [0.0, 0.0, 0.0, 1.0], atol=RIGID_TOLERANCE):
        raise _unusable_error(path, f"{name} does not end with 0 0 0 1")
    rotation = rows[:3, :3]
    if float(np.abs(rotation).max()) > 2.0 or float(np.abs(rotation @ rotation.T - np.eye(3)).max()) > RIGID_TOLERANCE:
        raise _unusable_error(path, f"{name} does more than turn and move")
    if np.linalg.det(rotation) < 0.0:
        raise _unusable_error(path, f"{name} mirrors")
    matrix = np.eye(4)
    left, _, right = np.linalg.svd(rotation)
    matrix[:3, :3], matrix[:3, 3] = left @ right, rows[:3, 3]
    return matrix


def check_relative_path(path: Path, name: str, where: str) -> str:
    """Return a path relative to the folder of the file `path`, with '/'; raise FileError if it leaves that folder."""
    text = name.replace("\\", "/")
    parts = PurePosixPath(text).parts
    if not parts or ".." in parts or PurePosixPath(text).is_absolute() or PureWindowsPath(text).drive or "\0" in text:
        raise _unusable_error(
            path, f"{where}: the path {name!r} leaves its folder", "Keep the pictures beside the file."
        )
    folder = path.parent.resolve()
    if not (folder / text).resolve().is_relative_to(folder):
        raise _unusable_error(
            path, f"{where}: the path {name!r} leaves its folder", "Keep the pictures beside the file."
        )
    return str(PurePosixPath(text))


def _unusable_error(path: Path, why: str, remedy: str = "Export it again.") -> FileError:
    return FileError(f"cannot be used: {why}.", where=str(path), remedy=remedy)


def write_transforms(path: Path, frames: Sequence[NerfstudioFrame], **more: Any) -> None:
    """Write a transforms.json that nerfstudio and `read_transforms` read.

    Intrinsics are written once if all frames share them.

    Parameters
    ----------
    path : Path
        The file.
    frames : sequence of NerfstudioFrame
        Images with perspective cameras, their paths below the file's folder.
    **more
        Further keys of the document, with JSON values.

    Raises
    ------
    FileError
        If a camera is not perspective, a path leaves the folder, or the file cannot be written.
    """
    lenses = [_encode_lens(path, frame.camera) for frame in frames]
    shared = all(lens == lenses[0] for lens in lenses)
    document: dict[str, Any] = {"camera_model": "OPENCV", **(lenses[0] if shared and lenses else {}), **more}
    document["frames"] = [
        {
            "file_path": check_relative_path(path, frame.file_path, "file_path"),
            **(
                {"depth_file_path": check_relative_path(path, frame.depth_file_path, "depth")}
                if frame.depth_file_path
                else {}
            ),
            **frame.more,
            **({} if shared else lens),
            "transform_matrix": (frame.camera.pose @ OPENGL_CAMERA_AXES).tolist(),
        }
        for frame, lens in zip(frames, lenses, strict=True)
    ]
    write_text(path, json.dumps(document, indent=1) + "\n")


def _encode_lens(path: Path, camera: Camera) -> dict[str, float]:
    if camera.kind != "perspective":
        raise FileError("nerfstudio knows no orthographic camera.", where=str(path), remedy="Choose Perspective.")
    matrix = camera.intrinsics
    return {
        "fl_x": float(matrix[0, 0]), "fl_y": float(matrix[1, 1]), "cx": float(matrix[0, 2]), "cy": float(matrix[1, 2]),
        "w": camera.width, "h": camera.height,
    }  # fmt: skip
