"""`hnf views`: depth, normals and ids of cameras against the meshes they show, read as nerfstudio reads them."""

from __future__ import annotations

import json
from pathlib import Path

import bpy
import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from mathutils import Matrix, Vector

from hnf_blender.cli import main
from hnf_core.scene.nerfstudio import read_transforms
from hnf_core.scene.rgbd_view import read_exr

OpenEXR = pytest.importorskip("OpenEXR", reason="OpenEXR is not installed here")
SIZE = 2.0
"""Side of the cube, which stands on the middle of a plane five times as wide, in units."""


def add_mesh(name, operator, material, **words):
    operator(**words)
    obj = bpy.context.object
    obj.name = name
    if material:
        obj.data.materials.append(bpy.data.materials.new(material))
    return obj


def build_scene(cameras):
    """A cube 'Würfel 1' of 'Red paint' on a plane 'Floor' without material; `cameras` are (place, target, lens)."""
    add_mesh("Würfel 1", bpy.ops.mesh.primitive_cube_add, "Red paint", size=SIZE, location=(0.0, 0.0, SIZE / 2))
    add_mesh("Floor", bpy.ops.mesh.primitive_plane_add, "", size=5 * SIZE)
    for number, (place, target, lens, shift) in enumerate(cameras):
        data = bpy.data.cameras.new(f"Cam {number}")
        data.lens, data.shift_x, data.clip_end = lens, shift, 1e3
        camera = bpy.data.objects.new(data.name, data)
        bpy.context.scene.collection.objects.link(camera)
        turn = (Vector(target) - Vector(place)).to_track_quat("-Z", "Y").to_matrix().to_4x4()
        camera.matrix_world = Matrix.Translation(place) @ turn
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 96, 64, 50


def save(path: Path) -> Path:
    bpy.context.scene.camera = next((obj for obj in bpy.data.objects if obj.type == "CAMERA"), None)
    if path.suffix == ".glb":
        bpy.ops.export_scene.gltf(filepath=str(path), export_cameras=True)
    else:
        bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


def run(*words) -> int:
    return main(["views", *map(str, words), "--samples", "1"])


def distance_to_scene(points):
    """Distances (n,) to the cube's surface, and to the floor."""
    local = np.abs(points - [0.0, 0.0, SIZE / 2]) - SIZE / 2
    outside = np.linalg.norm(np.maximum(local, 0.0), axis=1)
    return np.abs(outside + np.minimum(local.max(axis=1), 0.0)), np.abs(points[:, 2])


def unproject_as_nerfstudio(frame, depth):
    """World points (n, 3) of a depth image by the text of transforms.json alone: OpenGL axes, centers at +0.5."""
    row, column = np.nonzero(depth)
    z = depth[row, column].astype(float)
    x = (column + 0.5 - frame["cx"]) / frame["fl_x"] * z
    y = -(row + 0.5 - frame["cy"]) / frame["fl_y"] * z
    pose = np.array(frame["transform_matrix"])
    return np.stack([x, y, -z], axis=1) @ pose[:3, :3].T + pose[:3, 3], (row, column)


def read_frames(folder):
    document = json.loads((folder / "transforms.json").read_text())
    return [{**document, **frame} for frame in document["frames"]]


places = st.tuples(
    st.floats(-6.0, 6.0), st.floats(-6.0, 6.0), st.floats(2.5, 6.0), st.floats(20.0, 70.0), st.floats(-0.3, 0.3)
)


@settings(
    max_examples=2, deadline=None, phases=[Phase.generate], suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(cameras=st.lists(places, min_size=3, max_size=3))
@pytest.mark.parametrize("kind", ["blend", "glb"])
def test_depth_lies_on_the_mesh_from_any_camera(kind, cameras, tmp_path_factory) -> None:
    folder = tmp_path_factory.mktemp("views")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    shifts = 0.0 if kind == "glb" else 1.0  # glTF has no lens shift
    build_scene([((x, y, z), (0.3, -0.2, 0.5), lens, shifts * shift) for x, y, z, lens, shift in cameras])
    assert run(save(folder / f"s.{kind}"), "--out", folder / "out", "--size", "48x32") == 0
    ids = json.loads((folder / "out" / "ids.json").read_text())
    assert set(ids["objects"]) <= {"", "Würfel 1", "Floor"}
    assert set(ids["materials"]) <= {"", "Red paint"}
    frames = read_frames(folder / "out")
    assert len(frames) == 3
    for frame, read in zip(frames, read_transforms(folder / "out" / "transforms.json"), strict=True):
        (depth,) = read_exr(folder / "out" / frame["depth_file_path"]).values()
        seen = read_exr(folder / "out" / frame["ids_file_path"])
        normal = read_exr(folder / "out" / frame["normal_file_path"])["N"]
        assert depth.shape == (frame["h"], frame["w"]) == (32, 48)
        assert (read.camera.width, read.camera.height) == (48, 32)
        points, pixels = unproject_as_nerfstudio(frame, depth)
        of_cube, of_floor = distance_to_scene(points)
        assert len(points) > 0
        assert np.minimum(of_cube, of_floor).max() < 1e-3 * SIZE
        objects = np.array(ids["objects"])[seen["object"][pixels].astype(int)]
        materials = np.array(ids["materials"])[seen["material"][pixels].astype(int)]
        near = 2e-3 * SIZE  # at the foot of the cube a point lies on both
        assert set(objects[of_cube > near]) <= {"Floor"}
        assert set(objects[of_floor > near]) <= {"Würfel 1"}
        assert (materials == np.where(objects == "Floor", "", "Red paint")).all()
        assert (seen["object"][depth == 0.0] == 0.0).all()
        up = objects == "Floor"
        np.testing.assert_allclose(normal[pixels][up], np.tile([0.0, 0.0, 1.0], (up.sum(), 1)), atol=1e-4)
        np.testing.assert_allclose(np.linalg.norm(normal[pixels], axis=1), 1.0, atol=1e-4)


ABOVE = ((4.0, -4.0, 4.0), (0.0, 0.0, 1.0), 35.0, 0.0)


def test_colour_is_linear_and_the_picture_is_its_srgb(tmp_path) -> None:
    image = pytest.importorskip("PIL.Image", reason="needs Pillow, which nerfstudio opens pictures with")
    build_scene([ABOVE])
    assert run(save(tmp_path / "s.blend"), "--out", tmp_path / "out") == 0
    (frame,) = read_frames(tmp_path / "out")
    assert (frame["w"], frame["h"]) == (48, 32)  # half of 96 x 64
    color = next(iter(read_exr(tmp_path / "out" / frame["color_file_path"]).values()))
    codes = np.asarray(image.open(tmp_path / "out" / frame["file_path"]))
    assert codes.shape == color.shape == (32, 48, 3)
    low = color <= 0.0031308
    expected = np.where(low, 12.92 * color, 1.055 * np.maximum(color, 1e-9) ** (1 / 2.4) - 0.055)
    assert np.abs(codes - 255.0 * np.clip(expected, 0.0, 1.0)).max() < 0.51


def test_a_frame_moves_the_camera_and_a_scale_the_metres(tmp_path) -> None:
    build_scene([ABOVE])
    camera = bpy.data.objects["Cam 0"]
    for frame, height in ((1, 4.0), (11, 8.0)):
        camera.location[2] = height
        camera.keyframe_insert("location", index=2, frame=frame)
    path = save(tmp_path / "s.blend")
    for frame in (1, 11):
        assert run(path, "--out", tmp_path / str(frame), "--frame", frame, "--scale", "0.01") == 0
    heights = [read_frames(tmp_path / str(frame))[0]["transform_matrix"][2][3] for frame in (1, 11)]
    np.testing.assert_allclose(heights, [0.04, 0.08], rtol=1e-6)


def test_bad_input_says_what_in_one_line_and_leaves_nothing(tmp_path, capfd) -> None:
    build_scene([])
    bare = save(tmp_path / "bare.blend")
    for name, kind in (("Wide", "PANO"), ("Flat", "ORTHO"), ("Good", "PERSP")):
        data = bpy.data.cameras.new(name)
        data.type = kind
        camera = bpy.data.objects.new(name, data)
        camera.location = (0.0, 0.0, 5.0)
        bpy.context.scene.collection.objects.link(camera)
    scene = save(tmp_path / "s.blend")
    full = tmp_path / "full"
    full.mkdir()
    (full / "mine.txt").write_text("kept")
    (tmp_path / "file").write_text("kept")
    before = sorted(tmp_path.rglob("*"))
    capfd.readouterr()
    for words, code, said in (
        ((bare, "--out", tmp_path / "o"), 1, "no camera"),
        ((scene, "--out", tmp_path / "o", "--camera", "Goood"), 2, "Did you mean 'Good'"),
        ((scene, "--out", tmp_path / "o", "--camera", "Flat"), 2, "orthographic"),
        ((scene, "--out", tmp_path / "o", "--camera", "Wide"), 2, "panoramic"),
        ((scene, "--out", full), 1, "new or empty folder"),
        ((scene, "--out", tmp_path / "file"), 1, "is a file"),
        ((scene, "--out", tmp_path / "file" / "o"), 1, "output folder"),
        ((tmp_path / "none.blend", "--out", tmp_path / "o"), 1, "none.blend"),
        ((scene, "--out", tmp_path / "o", "--size", "12"), 2, "--size"),
        ((scene, "--out", tmp_path / "o", "--scale", "nan"), 2, "--scale"),
        ((scene, "--out", tmp_path / "o", "--frame", "nan"), 2, "--frame"),
    ):
        assert run(*words) == code, words
        error = capfd.readouterr().err
        assert said in error
        assert error.startswith("hnf: ")
        assert error.count("\n") == 1
    assert sorted(tmp_path.rglob("*")) == before
    assert run(scene, "--out", tmp_path / "o", "--size", "8x8", "--json") == 0
    found = capfd.readouterr()
    assert list(json.loads(found.out)["views"]) == ["Good"]
    assert "note: camera 'Flat' is an orthographic one, which nerfstudio does not know: left out." in found.err
