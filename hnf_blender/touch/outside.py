"""The files beside a scene's own that it was read with: pictures, libraries, the parts of an imported model."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path

from hnf_core.files import content_hash

COMPANION_SUFFIXES = {".gltf": (".bin",), ".obj": (".mtl",)}
"""What importers read beside the file and leave no path of: every file of that kind in the same folder is named."""
TILE_PLACEHOLDERS = ("<UDIM>", "<UVTILE>")


def list_external_files(scene: Path) -> list[str]:
    """Absolute paths of the files that the open scene refers to, those of pictures in tiles one by one; packed ones are
    in the scene's own. scene: the file it was opened or imported from. What is not there is left out."""
    import bpy

    named = [Path(path) for path in bpy.utils.blend_paths(absolute=True, packed=False, local=False)]
    found = {path for name in named for path in _expand_tiles(name)}
    for suffix in COMPANION_SUFFIXES.get(scene.suffix.lower(), ()):
        found |= {path for path in scene.absolute().parent.iterdir() if path.suffix.lower() == suffix}
    return sorted(str(path) for path in found if path.is_file())


def hash_source_files(scene: Path, external_files: Iterable[str]) -> str:
    """Of the scene's own file by its content, of those outside, which may be films, by their size and time of change;
    "" where one cannot be read any more."""
    try:
        with scene.open("rb") as stream:
            own = hashlib.file_digest(stream, lambda: hashlib.blake2b(digest_size=16)).hexdigest()
        facts = [(name, Path(name).stat()) for name in external_files]
    except OSError:
        return ""
    return content_hash(own, *(f"{name}\0{fact.st_size}\0{fact.st_mtime_ns}" for name, fact in facts))


def _expand_tiles(path: Path) -> list[Path]:
    for word in TILE_PLACEHOLDERS:
        if word in path.name:
            before, _, after = path.name.partition(word)
            if not path.parent.is_dir():
                return []
            return [
                each for each in path.parent.iterdir() if each.name.startswith(before) and each.name.endswith(after)
            ]
    return [path]
