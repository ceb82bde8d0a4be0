"""Where an export writes beside its file, and what must not be lost there."""

from __future__ import annotations

import os
from pathlib import Path

from ..errors import FileError
from ..files import elsewhere
from .glb import GENERATOR, LARGEST_READ
from .gltf_file import glb_parts
from .hjif import mesh_beside
from .json_files import read_bytes
from .sidecar import is_sidecar, sidecar_of


def check_places(path: Path, *, mesh: bool) -> None:
    """Look before anything is written. path: of the export. mesh: whether one may be written beside it.

    Raises FileError where path, its note or its mesh would replace what is not its own earlier one.
    """
    note = sidecar_of(path)
    for each in (path, note, *((mesh_beside(path),) if mesh else ())):
        if each.is_dir():
            raise FileError("is a folder, and no file.", where=str(each), remedy=elsewhere(each))
    if is_sidecar(path):
        raise _taken(path, f"it is the note of {path.name.removesuffix('.json')}, and says what its numbers stand for.")
    if os.path.lexists(note) and not is_sidecar(note):
        raise _taken(note, f"here goes the note of {path.name}, and another file is in its place.")
    if mesh and os.path.lexists(there := mesh_beside(path)) and not _is_mesh(there):
        raise _taken(there, f"here goes the mesh of {path.name}, and another file is in its place.")
    owner = path.with_name(path.stem)
    if owner.suffix.lower() == ".hjif" and owner.exists() and mesh_beside(owner) == path and _is_mesh(path):
        raise _taken(path, f"it is the mesh of {owner.name}, which counts its vertices.")


def _is_mesh(path: Path) -> bool:
    """Whether it was written beside a texture: a GLB of this project, without a note of its own."""
    if not path.exists() or sidecar_of(path).exists():
        return False
    try:
        tree, _ = glb_parts(read_bytes(path, LARGEST_READ), path)
        return str(tree["asset"]["generator"]).startswith(GENERATOR)
    except (FileError, KeyError, TypeError):
        return False


def _taken(path: Path, why: str) -> FileError:
    return FileError(why, where=str(path), remedy=elsewhere(path))
