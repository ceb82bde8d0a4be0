"""What a job is asked for, and what it leaves in its folder."""

from __future__ import annotations

import io
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from hnf_core.errors import FileError
from hnf_core.files import NPZ_ERRORS, read_npz, write_text
from hnf_core.material.palette import Palette

from ..bridge.scene.mesh_attributes import FaceTokens, PointTokens
from ..touch.session import InputHashes
from .child_job import from_json, to_json

REQUEST_NAME, RESULT_NAME, SCENE_NAME = "order.json", "result.json", "scene.blend"


@dataclass(frozen=True)
class JobRequest:
    """scene, view_layer: by name. only: names of the strokes to bake, empty = all that are not muted. cache: folder of
    the patches' records. package, package_folder, sys_path: how the child finds this very code. use_scripts: may
    scripts in the file run, as the person has set it. probe_object, probe_at: instead of a bake, look at this place of
    this object (cli.probe.ProbePlace); "" = a bake."""

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
    """A stroke's bake as bytes in a file. stroke: its name when the job began. inputs: what it was made from."""

    stroke: str
    file: str
    inputs: InputHashes


@dataclass(frozen=True)
class TokenFile:
    """Tokens of one mesh in a file. object_name: an object that has the mesh. surface_key: what they were made from.
    strokes: that lead over it."""

    object_name: str
    surface_key: str
    strokes: tuple[str, ...]
    file: str


@dataclass(frozen=True)
class Rejection:
    """what: stroke or mesh that got nothing. why: in words, with what to do."""

    what: str
    why: str


@dataclass(frozen=True)
class JobResult:
    """All that a job made. fresh: how many strokes needed nothing. close_ups: made. probed: a place was looked at
    instead, and the answer lies in the folder (jobs.probe)."""

    strokes: tuple[BakedFile, ...]
    meshes: tuple[TokenFile, ...]
    failed: tuple[Rejection, ...]
    warnings: tuple[str, ...]
    fresh: int
    close_ups: int
    probed: bool = False


def write_request(folder: Path, request: JobRequest) -> None:
    write_text(folder / REQUEST_NAME, to_json(request))


def read_request(folder: Path) -> JobRequest:
    return from_json(JobRequest, _read_text(folder / REQUEST_NAME), where=REQUEST_NAME)


def write_result(folder: Path, result: JobResult) -> None:
    """The last thing that a job does: where it lies, everything it names lies too."""
    write_text(folder / RESULT_NAME, to_json(result))


def read_result(folder: Path) -> JobResult:
    return from_json(JobResult, _read_text(folder / RESULT_NAME), where=RESULT_NAME)


def pack_tokens(tokens: FaceTokens) -> bytes:
    """Equal tokens, equal bytes; no pickle."""
    packed = io.BytesIO()
    points = {} if tokens.points is None else asdict(tokens.points)
    np.savez(
        packed,
        palette=np.frombuffer(tokens.palette.to_bytes(), np.uint8),
        index=tokens.index,
        roughness=tokens.roughness,
        confidence=tokens.confidence,
        source=np.array(tokens.source),
        **{f"points_{name}": values for name, values in points.items()},
    )
    return packed.getvalue()


def unpack_tokens(data: bytes) -> FaceTokens:
    """Raises FileError where data are not what pack_tokens made."""
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
