"""Where an export writes beside its file, and what must not be lost there."""

from __future__ import annotations

import os
from pathlib import Path

from ..errors import FileError
from ..files import suggest_other_path
from .glb import GENERATOR, MAX_READ_BYTES
from .gltf_file import decode_glb
from .hjif import get_mesh_path
from .json_files import read_limited_bytes
from .sidecar import get_sidecar_path, is_sidecar


def check_output_paths(path: Path, *, with_mesh: bool) -> None:
    """Look before anything is written. path: of the export. mesh: whether one may be written beside it.

    Raises FileError where path, its note or its mesh would replace what is not its own earlier one.
    """
    note = get_sidecar_path(path)
    for each in (path, note, *((get_mesh_path(path),) if with_mesh else ())):
        if each.is_dir():
            raise FileError("is a folder, and no file.", where=str(each), remedy=suggest_other_path(each))
    if is_sidecar(path):
        raise _occupied_error(
            path, f"it is the note of {path.name.removesuffix('.json')}, and says what its numbers stand for."
        )
    if os.path.lexists(note) and not is_sidecar(note):
        raise _occupied_error(note, f"here goes the note of {path.name}, and another file is in its place.")
    if with_mesh and os.path.lexists(there := get_mesh_path(path)) and not _is_exported_mesh(there):
        raise _occupied_error(there, f"here goes the mesh of {path.name}, and another file is in its place.")
    owner = path.with_name(path.stem)
    if owner.suffix.lower() == ".hjif" and owner.exists() and get_mesh_path(owner) == path and _is_exported_mesh(path):
        raise _occupied_error(path, f"it is the mesh of {owner.name}, which counts its vertices.")


def _is_exported_mesh(path: Path) -> bool:
    """Whether it was written beside a texture: a GLB of this project, without a note of its own."""
    if not path.exists() or get_sidecar_path(path).exists():
        return False
    try:
        tree, _ = decode_glb(read_limited_bytes(path, MAX_READ_BYTES), path)
        return str(tree["asset"]["generator"]).startswith(GENERATOR)
    except (FileError, KeyError, TypeError):
        return False


def _occupied_error(path: Path, why: str) -> FileError:
    return FileError(why, where=str(path), remedy=suggest_other_path(path))
