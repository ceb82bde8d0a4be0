"""The files beside a scene that its result follows from."""

from __future__ import annotations

from pathlib import Path

import bpy
from outside_pictures import picture

from hnf_blender.touch.outside import outside_files


def test_files_beside_a_scene(tmp_path: Path) -> None:
    for name in ("lone", "packed", "tile.1001", "tile.1002", "other"):
        picture(tmp_path / f"{name}.png")
    bpy.data.images["packed"].pack()
    bpy.data.images.remove(bpy.data.images["other"])
    bpy.data.images.remove(bpy.data.images["tile.1002"])
    tiled = bpy.data.images["tile.1001"]
    tiled.source, tiled.filepath = "TILED", str(tmp_path / "tile.<UDIM>.png")
    for name in ("cup.obj", "cup.mtl", "cup.bin"):
        (tmp_path / name).touch()
    pictures = {str(tmp_path / f"{name}.png") for name in ("lone", "tile.1001", "tile.1002")}
    assert set(outside_files(tmp_path / "cup.blend")) == pictures
    assert set(outside_files(tmp_path / "cup.obj")) == pictures | {str(tmp_path / "cup.mtl")}
    assert set(outside_files(tmp_path / "cup.gltf")) == pictures | {str(tmp_path / "cup.bin")}
    (tmp_path / "lone.png").unlink()
    assert str(tmp_path / "lone.png") not in outside_files(tmp_path / "cup.blend")
