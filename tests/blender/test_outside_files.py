"""The files beside a scene that its result follows from."""

from __future__ import annotations

import os
from pathlib import Path

import bpy
import numpy as np
from builders import add_plane
from outside_pictures import picture

from hnf_blender.bridge.cycles import make_overview_camera
from hnf_blender.bridge.lit_render import RenderHashes
from hnf_blender.bridge.shader.shader_hash import hash_material
from hnf_blender.touch.bake_plan import list_external_files
from hnf_core.progress import count_work


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
    assert set(list_external_files(tmp_path / "cup.blend")) == pictures
    assert set(list_external_files(tmp_path / "cup.obj")) == pictures | {str(tmp_path / "cup.mtl")}
    assert set(list_external_files(tmp_path / "cup.gltf")) == pictures | {str(tmp_path / "cup.bin")}
    (tmp_path / "lone.png").unlink()
    assert str(tmp_path / "lone.png") not in list_external_files(tmp_path / "cup.blend")


def shaded(name: str, image):
    """A plate whose colour is an image."""
    plate, material = add_plane(name, 0.02), bpy.data.materials.new(name)
    material.use_nodes = True
    node = material.node_tree.nodes.new("ShaderNodeTexImage")
    node.image = image
    shader = material.node_tree.nodes["Principled BSDF"]
    material.node_tree.links.new(node.outputs["Color"], shader.inputs["Base Color"])
    plate.data.materials.append(material)
    return plate


def key_of(plate) -> str:
    path = np.array([[-0.01, 0.0, 0.0], [0.01, 0.0, 0.0]])
    camera = make_overview_camera(path, np.array([0.0, 0.0, 1.0]), 0.02, 64, 36)
    hashes = RenderHashes(bpy.context.scene, bpy.context.evaluated_depsgraph_get(), 1.0)
    return hashes.hash_view(camera, [plate])


def world_of(image) -> None:
    world = bpy.context.scene.world = bpy.data.worlds.new("Sky")
    world.use_nodes = True
    node = world.node_tree.nodes.new("ShaderNodeTexEnvironment")
    node.image = image
    world.node_tree.links.new(node.outputs["Color"], world.node_tree.nodes["Background"].inputs["Color"])


def replace_content(path: Path) -> None:
    """Write other bytes in the file, of which only those who read it know."""
    status, content = path.stat(), path.read_bytes()
    path.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))


def test_a_pictures_key_reads_no_file_and_follows_each(tmp_path: Path) -> None:
    """Of a neighbour's texture and of the sky's; what is packed counts by its content."""
    leather, sky = picture(tmp_path / "leather.png"), picture(tmp_path / "sky.png")
    plate = shaded("Beside", leather)
    world_of(sky)
    with count_work() as work:
        first = key_of(plate)
        assert key_of(plate) == first
        keys = {first}
        for name in ("leather.png", "sky.png"):
            path = tmp_path / name
            path.write_bytes(path.read_bytes() + b" ")
            latest = key_of(plate)
            keys.add(latest)
            replace_content(path)
            assert key_of(plate) == latest
    assert len(keys) == 3
    assert work.items["hashed_files"] == []
    with count_work() as work:
        felt = hash_material(plate.data.materials[0])  # what is felt follows from the pixels
    assert work.items["hashed_files"] == [str(tmp_path / "leather.png")]
    replace_content(tmp_path / "leather.png")
    assert hash_material(plate.data.materials[0]) != felt
    leather.pack()
    keys.add(key_of(plate))
    assert len(keys) == 4
