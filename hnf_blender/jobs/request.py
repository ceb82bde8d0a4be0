"""Request and result of a job: dataclasses stored as JSON in its folder, and the tokens of meshes as NPZ.

A token describes a material's micro-geometry; a mesh has one per face.
"""

from __future__ import annotations

import io
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from hnf_core.errors import FileError
from hnf_core.files import NPZ_ERRORS, read_npz, write_text
from hnf_core.json_io import encode_json
from hnf_core.material.palette import Palette

from ..bridge.scene.stored_data import FaceTokens, PointTokens
from ..touch.session import InputHashes
from .child_job import from_json

REQUEST_NAME, RESULT_NAME, SCENE_NAME = "order.json", "result.json", "scene.blend"
"""File names in a job's folder."""


@dataclass(frozen=True)
class JobRequest:
    """Request of a bake or touch query, written for the child process.

    Attributes
    ----------
    scene, view_layer : str
        Names.
    only : tuple of str
        Names of the strokes to bake; empty for all that are not muted.
    cache : str
        Folder of cached close-ups.
    package, package_folder, sys_path : str, str, tuple of str
        Package of the add-on, as the child process imports it.
    use_scripts : bool
        Whether scripts in the file may run, as set by the user.
    probe_object : str
        Object of a touch query (`hnf_core.touch_request.TouchQuery`); "" for a bake.
    probe_at : tuple of float
        Point of the touch query on that object.
    """

    scene: str
    view_layer: str
    only: tuple[str, ...]
    cache: str
    package: str
    package_folder: str
    sys_path: tuple[str, ...]
    use_scripts: bool
    probe_object: str = ""
    probe_at: tuple[float, ...] = ()


@dataclass(frozen=True)
class BakedFile:
    """File with a stroke's bake; `stroke` is the stroke's name when the job began, `inputs` hashes of its inputs."""

    stroke: str
    file: str
    inputs: InputHashes


@dataclass(frozen=True)
class TokenFile:
    """File with the tokens (material descriptions per face) of a mesh.

    Attributes
    ----------
    object_name : str
        An object that has the mesh.
    surface_key : str
        Hash of what they were made from.
    strokes : tuple of str
        Strokes on the mesh.
    file : str
        File name.
    """

    object_name: str
    surface_key: str
    strokes: tuple[str, ...]
    file: str


@dataclass(frozen=True)
class Rejection:
    """A stroke or mesh for which nothing was written to the scene, and the reason with a remedy."""

    what: str
    why: str


@dataclass(frozen=True)
class JobResult:
    """Result of a bake or touch query, written by the child process.

    Attributes
    ----------
    strokes : tuple of BakedFile
        Bakes.
    meshes : tuple of TokenFile
        Tokens.
    failed : tuple of Rejection
        Strokes that could not be baked.
    warnings : tuple of str
        Warnings.
    fresh : int
        Number of strokes that needed nothing.
    close_ups : int
        Number of rendered close-ups.
    probed : bool
        Whether the job was a touch query, whose result is a file of `query_job`.
    """

    strokes: tuple[BakedFile, ...]
    meshes: tuple[TokenFile, ...]
    failed: tuple[Rejection, ...]
    warnings: tuple[str, ...]
    fresh: int
    close_ups: int
    probed: bool = False


def write_request(folder: Path, request: JobRequest) -> None:
    write_text(folder / REQUEST_NAME, encode_json(request))


def read_request(folder: Path) -> JobRequest:
    return from_json(JobRequest, _read_text(folder / REQUEST_NAME), where=REQUEST_NAME)


def write_result(folder: Path, result: JobResult) -> None:
    """Write a job's result, last of all its files, so that it exists only if all files that it names do."""
    write_text(folder / RESULT_NAME, encode_json(result))


def read_result(folder: Path) -> JobResult:
    return from_json(JobResult, _read_text(folder / RESULT_NAME), where=RESULT_NAME)


def pack_tokens(tokens: FaceTokens) -> bytes:
    """Pack the tokens of a mesh as NPZ bytes without pickle; equal tokens give equal bytes."""
    buffer = io.BytesIO()
    points = {} if tokens.points is None else asdict(tokens.points)
    np.savez(
        buffer,
        palette=np.frombuffer(tokens.palette.to_bytes(), np.uint8),
        index=tokens.index,
        roughness=tokens.roughness,
        confidence=tokens.confidence,
        source=np.array(tokens.source),
        **{f"points_{name}": values for name, values in points.items()},
    )
    return buffer.getvalue()


def unpack_tokens(data: bytes) -> FaceTokens:
    """Unpack the tokens of a mesh. Raises FileError if the data were not written by `pack_tokens`."""
    try:
        arrays = read_npz(data)
        return FaceTokens(
            palette=Palette.from_bytes(arrays["palette"].tobytes()),
            index=arrays["index"].astype(np.int32),
            roughness=arrays["roughness"].astype(np.float32),
            confidence=arrays["confidence"].astype(np.float32),
            source=str(arrays["source"]),
            points=PointTokens(arrays["points_index"].astype(np.int32), arrays["points_confidence"].astype(np.float32))
            if "points_index" in arrays
            else None,
        )
    except NPZ_ERRORS as error:
        raise FileError(f"the tokens are damaged ({error}).", where="job folder", remedy="Bake again.") from error


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(f"it cannot be read ({error}).", where=path.name, remedy="Bake again.") from error
