"""Import of scene files: meshes of each format in an empty scene, and one-line errors for bad files."""

from __future__ import annotations

import json
import re
import shutil
import struct
import subprocess
import sys
from pathlib import Path

import bpy
import numpy as np
import pytest
from builders import add_plane, add_sphere, float_image

from hnf_blender.bridge.importers import open_scene
from hnf_blender.bridge.scene.object_size import get_metres_per_unit, get_size_warning
from hnf_blender.bridge.scene.temp_scene import suppress_output
from hnf_blender.bridge.shader.closures import ReliefSource, find_relief_source
from hnf_blender.bridge.shader.images import explain_missing_image, get_missing_remedy
from hnf_core.errors import FileError, HnfError, SceneError
from hnf_core.scene.ply import read_ply_header

REPOSITORY = Path(__file__).parents[2]
SCENES = REPOSITORY.parent / "shared" / "data" / "scenes"
FORMATS = ("blend", "gltf", "glb", "obj", "ply", "usd", "usda", "usdc", "usdz", "fbx", "stl")
RADIUS = 0.05


def export(path: Path) -> None:
    """Write the open scene with Blender's own exporter for the suffix of path."""
    kind = path.suffix[1:]
    with suppress_output():
        if kind == "blend":
            bpy.ops.wm.save_as_mainfile(filepath=str(path), compress=False)
        elif kind in ("gltf", "glb"):
            form = {"gltf": "GLTF_SEPARATE", "glb": "GLB"}[kind]
            bpy.ops.export_scene.gltf(filepath=str(path), export_format=form)
        elif kind == "fbx":
            bpy.ops.export_scene.fbx(filepath=str(path))
        else:
            wm = bpy.ops.wm
            operator = {"obj": wm.obj_export, "ply": wm.ply_export, "stl": wm.stl_export}.get(kind, wm.usd_export)
            operator(filepath=str(path))


@pytest.fixture(scope="module")
def ball_files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one ball in every format."""
    folder = tmp_path_factory.mktemp("balls")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    ball = add_sphere("Ball", RADIUS, 24, 12)
    ball.data.materials.append(bpy.data.materials.new("Leather"))
    for kind in FORMATS:
        export(folder / f"ball.{kind}")
    return folder


def meshes(scene) -> list:
    return [obj for obj in scene.objects if obj.type == "MESH" and len(obj.data.polygons)]


def start_up_scene() -> dict[str, list]:
    """A scene that stands for the user's open work, and what it looks like."""
    bpy.ops.wm.read_factory_settings()
    return everything()


def everything() -> dict[str, list]:
    return {obj.name: [obj.type, list(obj.location)] for obj in bpy.data.objects}


@pytest.mark.parametrize("kind", FORMATS)
def test_every_format_imports_only_its_mesh_in_metres(ball_files: Path, kind: str) -> None:
    assert "Cube" in start_up_scene()
    scene = open_scene(ball_files / f"ball.{kind}")
    assert scene == bpy.context.scene
    (ball,) = meshes(scene)
    assert not {"Cube", "Light", "Camera"} & {obj.name for obj in scene.objects}
    corners = np.array([ball.matrix_world @ vertex.co for vertex in ball.data.vertices])
    assert np.linalg.norm(corners, axis=1) * get_metres_per_unit(scene) == pytest.approx(RADIUS, rel=1e-4)
    if kind not in ("ply", "stl"):
        assert [slot.name for slot in ball.material_slots] == ["Leather"]


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        *[("glb", "ball.gltf"), ("gltf", "ball.json"), ("ply", "ball.obj"), ("fbx", "ball")],
        *[("blend", "ball.blend1"), ("glb", "ball.bin")],
    ],
)
def test_content_counts_more_than_the_name(ball_files: Path, tmp_path: Path, kind: str, name: str) -> None:
    for file in ball_files.glob("ball.*"):
        shutil.copy(file, tmp_path)
    shutil.copy(ball_files / f"ball.{kind}", tmp_path / name)
    assert len(meshes(open_scene(tmp_path / name))) == 1


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize(
    ("head", "said"),
    [
        (b"version https://git-lfs.github.com/spec/v1\noid", "Git LFS pointer, not the file itself. Run git lfs pull"),
        (b"<!DOCTYPE html><html>", "web page, not the file itself"),
        ("v 0 0 0".encode("utf-16"), "UTF-16 text. Save it as UTF-8"),
    ],
)
def test_what_stands_for_a_scene_is_named(tmp_path: Path, kind: str, head: bytes, said: str) -> None:
    before = start_up_scene()
    (tmp_path / f"a.{kind}").write_bytes(head)
    with pytest.raises(FileError, match=said):
        open_scene(tmp_path / f"a.{kind}")
    assert everything() == before


def test_a_usd_file_of_another_form_is_told_its_name(ball_files: Path, tmp_path: Path) -> None:
    shutil.copy(ball_files / "ball.usdc", tmp_path / "ball.obj")
    with pytest.raises(FileError, match=r"is a USD file\. Rename it to ball\.usdc"):
        open_scene(tmp_path / "ball.obj")


def test_collada_is_opened_or_told_who_reads_it(tmp_path: Path) -> None:
    start_up_scene()
    path = tmp_path / "sheet.dae"
    if "collada_export" in dir(bpy.ops.wm):
        with suppress_output():
            bpy.ops.wm.collada_export(filepath=str(path))
        assert len(meshes(open_scene(path))) == 1
        return
    path.write_text('<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema"></COLLADA>')
    before = everything()
    with pytest.raises(FileError, match=r"COLLADA.*up to version 4\.5.*glTF"):
        open_scene(path)
    assert everything() == before


def test_suffix_in_capitals_and_relative_paths(ball_files: Path, tmp_path: Path, monkeypatch) -> None:
    shutil.copy(ball_files / "ball.ply", tmp_path / "BALL.PLY")
    monkeypatch.chdir(tmp_path)
    assert len(meshes(open_scene(Path("BALL.PLY")))) == 1


def test_obj_without_normals_and_uv_written_by_hand(tmp_path: Path) -> None:
    path = tmp_path / "square.obj"
    path.write_text("o Square\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n")
    (square,) = meshes(open_scene(path))
    assert (square.name, len(square.data.uv_layers)) == ("Square", 0)
    path.write_text(
        "v 0 0 0\nv 1 0 0\nv 1 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvn 0 0 1\nmtllib gone.mtl\nusemtl A\nf 1/1/1 2/2/1 3/3/1\n"
    )
    (triangle,) = meshes(open_scene(path))
    assert len(triangle.data.uv_layers) == 1


def test_an_ascii_ply_written_by_hand(tmp_path: Path) -> None:
    path = tmp_path / "tri.ply"
    head = "ply\r\nformat ascii 1.0\r\ncomment by hand\r\nelement vertex 3\r\nproperty float x\r\nproperty float y\r\n"
    head += "property float z\r\nelement face 1\r\nproperty list uchar int vertex_indices\r\nend_header\r\n"
    path.write_bytes(head.replace("\r\n", "\n").encode() + b"0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    assert len(meshes(open_scene(path))) == 1
    path.write_bytes(head.encode())
    assert read_ply_header(path).elements == {"vertex": (3, ("x", "y", "z")), "face": (1, ("vertex_indices",))}


def test_the_colours_of_a_scanned_ply_are_seen(tmp_path: Path) -> None:
    """Two triangles of 0.2 mm, red and green points: what the file holds is what the surface shows."""
    path = tmp_path / "scan.ply"
    colours = "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    path.write_text(
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
        f"{colours}element face 2\nproperty list uchar int vertex_indices\nend_header\n"
        "0 0 0 255 0 0\n0.0002 0 0 0 255 0\n0 0.0002 0 0 255 0\n0.0002 0.0002 0 255 0 0\n3 0 1 2\n3 1 3 2\n"
    )
    (scan,) = meshes(open_scene(path))
    (material,) = scan.data.materials
    assert material.name == scan.name
    assert find_relief_source(material) is ReliefSource.VARYING_COLOUR


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize("damage", ["empty", "noise", "cut short", "early end", "directory", "missing"])
def test_damaged_files_give_one_line_that_names_them(ball_files: Path, tmp_path: Path, kind: str, damage: str) -> None:
    whole = (ball_files / f"ball.{kind}").read_bytes()
    path = tmp_path / f"bad.{kind}"
    if damage == "directory":
        path.mkdir()
    elif damage != "missing":
        noise = bytes(range(1, 256)) * 20
        # Half an OBJ is a whole, smaller OBJ; only a cut before its faces can be noticed.
        cut = whole[: len(whole) // (8 if kind == "obj" else 2)]
        path.write_bytes({"empty": b"", "noise": noise, "cut short": cut, "early end": whole[:30]}[damage])
    with pytest.raises(HnfError) as caught:
        open_scene(path)
    text = str(caught.value)
    assert isinstance(caught.value, FileError | SceneError)
    assert str(path) in text
    assert "\n" not in text
    assert "Traceback" not in text


@pytest.mark.parametrize("kind", FORMATS)
def test_a_file_refused_by_its_head_leaves_the_open_scene(tmp_path: Path, kind: str) -> None:
    before = start_up_scene()
    path = tmp_path / f"bad.{kind}"
    if kind == "obj":
        path = tmp_path / "gone.obj"
    else:
        path.write_bytes(b"this is no scene at all")
    with pytest.raises(FileError):
        open_scene(path)
    assert everything() == before


def test_a_broken_blend_leaves_the_open_scene(ball_files: Path, tmp_path: Path) -> None:
    before = start_up_scene()
    whole = (ball_files / "ball.blend").read_bytes()
    (tmp_path / "bad.blend").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(FileError, match=r"bad\.blend: Blender could not open it"):
        open_scene(tmp_path / "bad.blend")
    assert everything() == before


def test_a_blend_keeps_its_scene_and_runs_no_script(tmp_path: Path) -> None:
    add_plane("Cloth")
    bpy.context.scene.name = "Mine"
    text = bpy.data.texts.new("run.py")
    text.write(f"open({str(tmp_path / 'ran')!r}, 'w').close()")
    text.use_module = True
    export(tmp_path / "a.blend")
    bpy.ops.wm.read_factory_settings()
    assert open_scene(tmp_path / "a.blend").name == "Mine"
    assert not (tmp_path / "ran").exists()


def test_a_blend_with_nothing_to_touch_is_refused(tmp_path: Path) -> None:
    export(tmp_path / "a.blend")
    with pytest.raises(SceneError, match="holds no object to touch"):
        open_scene(tmp_path / "a.blend")


def test_unsupported_kinds_list_the_supported_ones(tmp_path: Path) -> None:
    for name in ("a.step", "scene", "a.blend.zip"):
        (tmp_path / name).write_bytes(b"x")
        with pytest.raises(FileError, match=r"\.gltf \.glb"):
            open_scene(tmp_path / name)


def ply(properties: list[str], count: int, *, before: str = "") -> bytes:
    head = f"ply\nformat binary_little_endian 1.0\n{before}element vertex {count}\n"
    head += "".join(f"property float {name}\n" for name in properties) + "end_header\n"
    return head.encode() + struct.pack(f"<{len(properties) * count}f", *([0.0] * len(properties) * count))


SPLAT = [*"xyz", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"]


@pytest.mark.parametrize("damage", ["cut short", "all zero", "empty", "no surface", "spz"])
def test_unusable_splats_raise_one_line_and_keep_the_open_scene(tmp_path: Path, damage: str) -> None:
    before = start_up_scene()
    path = tmp_path / ("garden.spz" if damage == "spz" else "garden.ply")
    names = [*SPLAT, "rot_0", "rot_1", "rot_2", "rot_3"]
    whole = ply(names, 0 if damage == "empty" else 5)
    if damage == "no surface":  # five faint splats far from each other
        head, rows = ply(names, 0).replace(b"vertex 0", b"vertex 5"), np.zeros((5, len(names)), dtype="<f4")
        rows[:, :3], rows[:, 9], rows[:, 10:13], rows[:, 13] = np.arange(15).reshape(5, 3) ** 2, -9.0, -6.0, 1.0
        whole = head + rows.tobytes()
    path.write_bytes(whole[:-30] if damage == "cut short" else whole)
    with pytest.raises(HnfError) as caught:
        open_scene(path)
    assert isinstance(caught.value, FileError | SceneError)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert everything() == before


def test_a_point_cloud_is_refused(tmp_path: Path) -> None:
    (tmp_path / "points.ply").write_bytes(ply(["x", "y", "z"], 7))
    with pytest.raises(SceneError, match="cloud of 7 points"):
        open_scene(tmp_path / "points.ply")


def test_edges_alone_are_refused(tmp_path: Path) -> None:
    (tmp_path / "wire.obj").write_text("v 0 0 0\nv 1 0 0\nl 1 2\n")
    with pytest.raises(SceneError, match="no faces"):
        open_scene(tmp_path / "wire.obj")


@pytest.mark.parametrize("content", ['over "Steel" {}', 'class "Steel" {}'])
def test_a_layer_of_changes_alone_is_refused_as_such(tmp_path: Path, content: str) -> None:
    (tmp_path / "look.usda").write_text(f"#usda 1.0\n\n{content}\n")
    with pytest.raises(SceneError, match="materials or changes to another file alone: open the file"):
        open_scene(tmp_path / "look.usda")


TENT = """#usda 1.0
def Mesh "Tent" {
    int[] faceVertexCounts = [3, 3, 3]
    int[] faceVertexIndices = [0, 1, 2, 0, 3, 1, 1, 3, 2]
    point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
}
"""


@pytest.mark.skipif(not hasattr(bpy.utils, "expose_bundled_modules"), reason="Blender brings no USD library yet")
@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[3, 3, 3]", "[3, 3, 3]", ""),
        ("[3, 3, 3]", "[3, 3, 4]", "want 10 corners, and 9 are there"),
        ("[3, 3, 3]", "[3, 3, -3]", "want 3 corners, and 9 are there"),
        ("[0, 1, 2,", "[0, 1, 4,", "names a point that is not among its 4"),
        ("[0, 1, 2,", "[0, 1, -2,", "names a point that is not among its 4"),
        ("(0, 0, 1)]", "]", "names a point that is not among its 3"),
        ("(0, 0, 1)]", "(0, 0]", "cannot be parsed"),
        ("(0, 0, 1)]", "", "cannot be parsed"),
    ],
)
def test_a_usd_mesh_whose_faces_do_not_fit_is_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert old in TENT
    (tmp_path / "tent.usda").write_text(TENT.replace(old, new))
    if not said:
        assert len(open_scene(tmp_path / "tent.usda").objects["Tent"].data.polygons) == 3
        return
    with pytest.raises(FileError, match=said):
        open_scene(tmp_path / "tent.usda")


@pytest.mark.skipif(not hasattr(bpy.utils, "expose_bundled_modules"), reason="Blender brings no USD library yet")
@pytest.mark.parametrize(
    ("points", "corners", "said"),
    [
        ("(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 2)", "3, 1", ""),
        ("(0, 0, 0), (1, 0, 0), (0, 1, 0)", "3, 1", "'Tent' at frame 5 names a point that is not among its 3"),
        (
            "(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 2)",
            "4, 1",
            "'Tent' at frame 3 names a point that is not among its 4",
        ),
        ("(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 2)", "3", "'Tent' at frame 3 want 9 corners, and 8 are there"),
    ],
)
def test_an_animated_usd_mesh_is_checked_at_every_frame(tmp_path: Path, points: str, corners: str, said: str) -> None:
    still = "point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]"
    moving = still.replace("points = ", "points.timeSamples = {1: ") + f", 5: [{points}]}}"
    faces = "int[] faceVertexIndices = [0, 1, 2, 0, 3, 1, 1, 3, 2]"
    changing = faces.replace("Indices = ", "Indices.timeSamples = {1: ") + f", 3: [0, 1, 2, 0, {corners}, 1, 3, 2]}}"
    assert still in TENT
    assert faces in TENT
    text = TENT.replace(still, moving).replace(faces, changing)
    (tmp_path / "tent.usda").write_text(text.replace("#usda 1.0", "#usda 1.0\n(startTimeCode = 1\nendTimeCode = 5)"))
    if not said:
        assert len(open_scene(tmp_path / "tent.usda").objects["Tent"].data.polygons) == 3
        return
    with pytest.raises(FileError, match=said):
        open_scene(tmp_path / "tent.usda")


@pytest.mark.parametrize(
    ("what", "number", "said"),
    [
        ("table", 2**40, "its table of contents lies outside of it"),
        ("table", -1, "its table of contents lies outside of it"),
        ("sections", 300_000_000, "wants 300000000 sections, and has no place for them"),
        ("start of TOKENS", 10**6, "its section 'TOKENS' lies outside of it"),
        ("entries of TOKENS", 2**50, r"its section 'TOKENS' of \d+ bytes wants 1125899906842624 entries"),
        ("entries of SPECS", 10**9, r"its section 'SPECS' of \d+ bytes wants 1000000000 entries"),
        ("points", 10**9, "a value in it cannot be read"),
    ],
)
def test_a_usdc_file_that_wants_too_much_is_refused(ball_files, tmp_path, what: str, number: int, said: str) -> None:
    data = bytearray((ball_files / "ball.usdc").read_bytes())
    (table,) = struct.unpack_from("<q", data, 16)
    verb, _, section = what.rpartition(" of ")
    entry = data.index(section.encode() + b"\0", table) if verb else 0
    places = {
        "table": 16,
        "sections": table,
        "start": entry + 16,
        "entries": struct.unpack_from("<q", data, entry + 16)[0],
        "points": data.index(struct.pack("<Q", 24 * 11 + 2)),
    }
    struct.pack_into("<q", data, places[verb or what], number)
    (tmp_path / "ball.usdc").write_bytes(data)
    if what == "points" and not hasattr(bpy.utils, "expose_bundled_modules"):
        pytest.skip("Blender brings no USD library yet")
    with pytest.raises(FileError, match=said):
        open_scene(tmp_path / "ball.usdc")


@pytest.mark.skipif(not hasattr(bpy.utils, "expose_bundled_modules"), reason="Blender brings no USD library yet")
def test_a_usd_file_that_changed_is_read_anew(tmp_path: Path) -> None:
    bpy.utils.expose_bundled_modules()
    from pxr import Sdf

    path = tmp_path / "tent.usda"
    path.write_text(TENT)
    held = Sdf.Layer.FindOrOpen(str(path))
    path.write_text(TENT.replace("[3, 3, 3]", "[3, 3, 4]"))
    with pytest.raises(FileError, match="want 10 corners"):
        open_scene(path)
    assert held


def test_a_usd_file_that_refers_to_a_broken_one_shows_the_rest(ball_files: Path, tmp_path: Path) -> None:
    shutil.copy(ball_files / "ball.usda", tmp_path / "ball.usda")
    (tmp_path / "broken.usda").write_text('#usda 1.0\ndef Mesh "Lost" {\n    point3f[] points = [(0, 0]\n}\n')
    references = "".join(f'def "{name}" (references = @./{name}.usda@) {{}}\n' for name in ("ball", "broken"))
    (tmp_path / "both.usda").write_text(f"#usda 1.0\n{references}")
    assert [obj.type for obj in open_scene(tmp_path / "both.usda").objects].count("MESH") == 1


def test_a_gltf_without_meshes_is_refused(tmp_path: Path) -> None:
    document = {"asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "nodes": [{"name": "Nothing"}], "scene": 0}
    (tmp_path / "a.gltf").write_text(json.dumps(document))
    with pytest.raises(SceneError, match="holds no mesh"):
        open_scene(tmp_path / "a.gltf")


def test_a_gltf_names_its_missing_data_and_its_damaged_data(ball_files: Path, tmp_path: Path) -> None:
    shutil.copy(ball_files / "ball.gltf", tmp_path)
    with pytest.raises(FileError, match=r"data file 'ball\.bin' is missing"):
        open_scene(tmp_path / "ball.gltf")
    (tmp_path / "ball.bin").write_bytes(b"abc")
    with pytest.raises(FileError) as caught:
        open_scene(tmp_path / "ball.gltf")
    assert "\n" not in str(caught.value)
    assert "ball.gltf" in str(caught.value)


BREAKING = {
    "indices": lambda tree: tree["meshes"][0]["primitives"][0].update(indices=99),
    "material": lambda tree: tree["meshes"][0]["primitives"][0].update(material=7),
    "view": lambda tree: tree["accessors"][0].update(bufferView=40),
    "node": lambda tree: tree["scenes"][0].update(nodes=[12]),
    "type": lambda tree: tree["accessors"][0].update(type="VEC9"),
    "child": lambda tree: tree["nodes"][0].update(children=[0]),
    "count": lambda tree: tree["accessors"][0].update(count=10**9),
}


@pytest.mark.parametrize("part", BREAKING)
def test_a_gltf_that_breaks_its_importer_is_refused_in_words(ball_files: Path, tmp_path: Path, part: str) -> None:
    shutil.copy(ball_files / "ball.bin", tmp_path)
    tree = json.loads((ball_files / "ball.gltf").read_text())
    BREAKING[part](tree)
    path = tmp_path / "broken.gltf"
    path.write_text(json.dumps(tree))
    with pytest.raises(HnfError) as caught:
        open_scene(path)
    text = str(caught.value)
    assert text.startswith(str(path))
    assert caught.value.remedy
    assert "\n" not in text
    assert not re.search(r"Error|Exception|Traceback|Python|list index|KeyError|object has no", text), text


def test_an_importer_that_is_switched_off_is_switched_on(ball_files: Path) -> None:
    import addon_utils

    addon_utils.disable("io_scene_gltf2", default_set=False)
    assert not addon_utils.check("io_scene_gltf2")[1]
    assert len(meshes(open_scene(ball_files / "ball.glb"))) == 1


def test_nothing_is_printed(ball_files: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    capfd.readouterr()
    for kind in FORMATS:
        open_scene(ball_files / f"ball.{kind}")
    shutil.copy(ball_files / "ball.gltf", tmp_path)
    (tmp_path / "ball.bin").write_bytes(b"abc")
    with pytest.raises(FileError):
        open_scene(tmp_path / "ball.gltf")
    assert capfd.readouterr() == ("", "")


def test_quiet_holds_back_c_output_and_puts_the_streams_back() -> None:
    code = (
        "import ctypes, os, sys\n"
        "from hnf_blender.bridge.scene.temp_scene import suppress_output\n"
        "libc = ctypes.CDLL(None)\n"
        "print('before')\n"
        "try:\n"
        "    with suppress_output():\n"
        "        libc.printf(b'noise\\n'); print('noise'); os.system('echo noise; echo noise >&2'); raise KeyError\n"
        "except KeyError:\n"
        "    print('after')\n"
        "libc.printf(b'end\\n')\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=REPOSITORY, capture_output=True, text=True, timeout=60)
    assert sorted(done.stdout.split()) == ["after", "before", "end"]
    assert done.stderr == ""


def test_units() -> None:
    scene = bpy.context.scene
    scene.unit_settings.system = "METRIC"
    scene.unit_settings.scale_length = 0.01
    assert get_metres_per_unit(scene) == pytest.approx(0.01)
    assert get_metres_per_unit(scene, 0.5) == 0.5
    told = get_metres_per_unit(scene, 0.0254)
    scene.hnf.metres_per_unit = told
    assert get_metres_per_unit(scene) == told
    scene.hnf.metres_per_unit = 0.0
    scene.unit_settings.system = "NONE"
    assert get_metres_per_unit(scene) == 1.0
    for bad in (0.0, -1.0, 1e-60, 1e60, float("nan"), float("inf")):
        with pytest.raises(SceneError):
            get_metres_per_unit(scene, bad)


def test_implausible_sizes_are_said() -> None:
    cup = add_plane("Cup", 9.0)
    assert "object 'Cup' is 12.7 m across" in str(get_size_warning(cup, 1.0))
    assert "centimeters, one unit is 0.01 m" in str(get_size_warning(cup, 1.0))
    assert get_size_warning(cup, 0.01) is None
    assert "1.27 mm across" in str(get_size_warning(cup, 1e-4))
    cup.scale = (0.01, 0.01, 0.01)
    bpy.context.view_layer.update()
    assert get_size_warning(cup, 1.0) is None


def test_missing_and_damaged_images_are_named(tmp_path: Path) -> None:
    path = tmp_path / "cloth.png"
    made = bpy.data.images.new("made", 4, 4)
    made.filepath_raw, made.file_format = str(path), "PNG"
    assert explain_missing_image(bpy.data.images.new("generated", 4, 4)) is None
    assert explain_missing_image(float_image("packed", np.zeros((4, 4, 3)))) is None
    made.save()
    there = bpy.data.images.load(str(path))
    assert explain_missing_image(there) is None
    path.write_bytes(b"no picture")
    there.reload()
    assert explain_missing_image(there) == f"{path} cannot be read as a picture"
    path.write_bytes(b"\xabKTX 20\xbb\r\n\x1a\n" + bytes(64))
    there.reload()
    assert explain_missing_image(there) == f"{path} is a KTX2 texture, which cannot be read as a picture"
    assert get_missing_remedy(there).startswith("Convert it to PNG")
    path.unlink()
    assert explain_missing_image(there) == f"{path} is missing"
    there.source, there.filepath = "TILED", str(tmp_path / "tile.<UDIM>.png")
    assert explain_missing_image(there) == f"{tmp_path / 'tile.1001.png'} is missing"
    (tmp_path / "tile.1001.png").write_bytes(b"x")
    assert explain_missing_image(there) is None


@pytest.mark.skipif(not SCENES.is_dir(), reason="the real scenes are not beside the repository")
@pytest.mark.parametrize(
    ("file", "materials"),
    [
        ("FlightHelmet/FlightHelmet.gltf", {"LeatherPartsMat", "MetalPartsMat", "RubberWoodMat", "GlassPlasticMat"}),
        ("SheenChairScene/MixedLightingExample.gltf", {"fabric Mystere Mango Velvet", "wood Brown"}),
    ],
)
def test_real_scenes(file: str, materials: set[str]) -> None:
    scene = open_scene(SCENES / file)
    names = {slot.material.name for obj in meshes(scene) for slot in obj.material_slots}
    assert materials <= names
    assert [explain_missing_image(image) for image in bpy.data.images if image.source == "FILE"].count(None) > 0


@pytest.mark.skipif(not SCENES.is_dir(), reason="the real scenes are not beside the repository")
def test_a_scene_opens_and_lists_its_missing_texture(tmp_path: Path) -> None:
    for part in (SCENES / "FlightHelmet").iterdir():
        if "LeatherPartsMat_Normal" not in part.name:
            (tmp_path / part.name).symlink_to(part)
    open_scene(tmp_path / "FlightHelmet.gltf")
    missing = [line for image in bpy.data.images if (line := explain_missing_image(image))]
    assert missing == [f"{tmp_path / 'FlightHelmet_Materials_LeatherPartsMat_Normal.png'} is missing"]
