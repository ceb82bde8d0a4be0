"""The files beside a scene's own that it was read with: pictures, libraries, the parts of an imported model."""

from __future__ import annotations

from pathlib import Path

PARTS = {".gltf": (".bin",), ".obj": (".mtl",)}
"""What importers read beside the file and leave no path of: every file of that kind in the same folder is named."""
TILES = ("<UDIM>", "<UVTILE>")


def outside_files(scene: Path) -> list[str]:
    """Absolute paths of the files that the open scene refers to, those of pictures in tiles one by one; packed ones are
    in the scene's own. scene: the file it was opened or imported from. What is not there is left out."""
    import bpy

    named = [Path(path) for path in bpy.utils.blend_paths(absolute=True, packed=False, local=False)]
    found = {path for name in named for path in _tiles(name)}
    for suffix in PARTS.get(scene.suffix.lower(), ()):
        found |= {path for path in scene.absolute().parent.iterdir() if path.suffix.lower() == suffix}
    return sorted(str(path) for path in found if path.is_file())


def _tiles(path: Path) -> list[Path]:
    for word in TILES:
        if word in path.name:
            before, _, after = path.name.partition(word)
            if not path.parent.is_dir():
                return []
            return [
                each for each in path.parent.iterdir() if each.name.startswith(before) and each.name.endswith(after)
            ]
    return [path]
