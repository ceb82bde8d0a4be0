"""Cameras → nerfstudio's transforms.json, as hnf_core.scene.nerfstudio reads it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hnf_core.errors import FileError
from hnf_core.files import write_text
from hnf_core.scene.camera import Camera
from hnf_core.scene.nerfstudio import OPENGL_CAMERA_AXES, NerfstudioFrame, check_relative_path


def write_transforms(path: Path, frames: Sequence[NerfstudioFrame], **more: Any) -> None:
    """Write a transforms.json that read_transforms reads; intrinsics are written once where all frames share them.

    Further keys with JSON values are given by name. Raises FileError where a camera is not perspective or a path leaves
    the folder.
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


TRANSFORMS_FILE = "transforms.json"
