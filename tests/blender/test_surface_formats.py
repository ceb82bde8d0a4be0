"""Formats that bind touch to geometry, from a baked scene, read back by Blender's own importer."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import bpy
import numpy as np
import pytest
from builders import add_mesh
from job_scene import small_scene
from touch_scene import PLATE, save_scene
from touch_scene import touch_without_pictures as touch

from hnf_blender.bridge.scene.stored_data import FaceTokens, read_tokens, write_tokens
from hnf_blender.bridge.stroke.surface_export import read_touched_surface
from hnf_blender.cli import main
from hnf_core.action.action import read_action_csv
from hnf_core.export.gltf import decode_glb, read_glb
from hnf_core.export.hjif import read_hjif
from hnf_core.export.options import ImportOptions
from hnf_core.export.wav import read_wav
from hnf_core.material.contact_model import Mechanics
from hnf_core.material.palette import Palette
from hnf_core.material.token import TOKEN_DIM


@pytest.fixture(scope="module")
def baked(rendered_plate, tmp_path_factory) -> tuple[Path, Path]:
    """The WAV of the small scene, and its baked .blend."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    small_scene()
    folder = tmp_path_factory.mktemp("baked")
    out = folder / "touched"
    shutil.copytree(rendered_plate, out / "cache")
    code, report = touch(save_scene(folder / "small.blend"), out)
    assert code == 0
    return out / report["strokes"][0]["wav"], out / report["baked_blend"]


def export(wav: Path, word: str, out: Path, *words: str) -> tuple[dict, bytes]:
    """JSON and bytes of the GLB that lies at out, or beside it."""
    assert main(["export", str(wav), "--format", word, "--out", str(out), *words]) == 0
    lies = out if out.suffix == ".glb" else out.with_name(f"{out.name}.glb")
    return decode_glb(lies.read_bytes(), out)


def imported(path: Path):
    """The one mesh object in a GLB, as Blender sees it."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=str(path))
    (obj,) = (each for each in bpy.context.scene.objects if each.type == "MESH")
    return obj


def values(mesh, name: str) -> np.ndarray:
    attribute = mesh.attributes[name]
    assert attribute.domain == "POINT"
    found = np.empty(len(attribute.data), np.float32)
    attribute.data.foreach_get("value", found)
    return found


def test_a_glb_comes_back_into_blender_as_it_was(baked, tmp_path) -> None:
    wav, blend = baked
    out = tmp_path / "x.glb"
    tree, _ = export(wav, "glb", out, "--scene", str(blend))
    bpy.ops.wm.open_mainfile(filepath=str(blend))
    plate = bpy.data.objects[PLATE]
    plate_tokens = read_tokens(plate.data)
    assert plate_tokens is not None
    size, place = plate.dimensions.copy(), plate.matrix_world.copy()
    faces = [sorted(tuple(round(c, 6) for c in plate.data.vertices[v].co) for v in f.vertices)
             for f in plate.data.polygons]  # fmt: skip
    names = plate_tokens.palette.names

    obj = imported(out)
    mesh = obj.data
    assert obj.name == PLATE
    np.testing.assert_allclose(obj.dimensions, size, atol=1e-6)
    np.testing.assert_allclose(obj.matrix_world, place, atol=1e-6)
    token, roughness, confidence = (values(mesh, f"_HNF_{name}") for name in ("TOKEN", "ROUGHNESS", "CONFIDENCE"))
    seen = set()
    for face in mesh.polygons:
        own = {float(token[v]) for v in face.vertices}
        assert len(own) == 1  # no face mixes two materials
        corners = {tuple(round(c, 6) for c in mesh.vertices[v].co) for v in face.vertices}
        (source,) = (i for i, points in enumerate(faces) if corners <= set(points))
        assert own == {float(plate_tokens.index[source])}
        assert {float(roughness[v]) for v in face.vertices} == {float(plate_tokens.roughness[source])}
        assert {float(confidence[v]) for v in face.vertices} == {float(plate_tokens.confidence[source])}
        seen.add(source)
    assert seen == set(range(len(faces)))
    assert len(mesh.uv_layers) == 2
    assert [material.name for material in mesh.materials] == [f"{PLATE} plastic"]

    record = mesh["hnf"]["palette"].to_dict() if hasattr(mesh["hnf"], "to_dict") else mesh["hnf"]["palette"]
    assert list(record["names"]) == list(names)
    np.testing.assert_array_equal(np.array([list(row) for row in record["tokens"]], np.float32),
                                  plate_tokens.palette.tokens)  # fmt: skip
    assert tree["extensionsUsed"] == ["MPEG_haptic_material"]
    (material,) = tree["extensions"]["MPEG_haptic_material"]["materials"]
    assert tree["meshes"][0]["extensions"]["MPEG_haptic_material"] == {"hapticMaterialIndex": 0}
    for name in ("stiffness", "friction", "vibrotactileTexture"):
        (texture,) = material[name]
        assert texture["type"] in ("High_Resolution", "Low_Resolution", "Reference", "Other")
        assert texture["texture"]["texCoord"] == 1
        assert len(texture["extras"]["hnf"]["values"]) == len(names)


def test_the_signal_in_a_glb_is_that_of_the_wav(baked, tmp_path) -> None:
    wav, blend = baked
    export(wav, "glb", tmp_path / "x.glb", "--scene", str(blend))
    back = tmp_path / "back.wav"
    assert main(["import", str(tmp_path / "x.glb"), "--out", str(back)]) == 0
    assert read_wav(back).samples.tobytes() == read_wav(wav).samples.tobytes()
    assert read_glb(tmp_path / "x.glb", ImportOptions()).provenance["stroke"] == "Along"


def test_an_hjif_names_the_vertices_of_the_mesh_beside_it(baked, tmp_path) -> None:
    """The stroke runs 26 mm along x through the middle of the plate: so do the vertices, in the .glb beside."""
    wav, blend = baked
    out = tmp_path / "x.hjif"
    tree, block = export(wav, "hjif", out, "--scene", str(blend), "--object", PLATE)
    record = json.loads(out.read_text(encoding="utf-8"))
    assert record["avatars"][0]["mesh"] == "x.hjif.glb"
    (perception,) = record["perceptions"]
    assert perception["perception_modality"] == "VibrotactileTexture"
    accessor = tree["accessors"][tree["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]
    at = tree["bufferViews"][accessor["bufferView"]]["byteOffset"]
    positions = np.frombuffer(block, "<f4", 3 * accessor["count"], at).reshape(-1, 3)
    under = positions[perception["channels"][0]["vertices"]]
    assert len(under) > 0
    assert under[:, 0].min() <= -0.012
    assert under[:, 0].max() >= 0.012
    found, signal = read_hjif(out, ImportOptions()), read_wav(wav)
    assert found.duration_s == pytest.approx(signal.duration_s, abs=0.006)
    # The plate's ridges are 2 mm apart, however fast the hand went over them.
    way = np.fft.rfftfreq(len(found.samples), 10.0 ** perception["unit_exponent"])
    power = np.abs(np.fft.rfft(found.samples)) ** 2
    assert way[power.argmax()] == pytest.approx(1.0 / 2e-3, abs=1.0 / 26e-3)


def test_another_object_has_no_way_and_says_so(baked, tmp_path, capsys) -> None:
    wav, blend = baked
    bpy.ops.wm.open_mainfile(filepath=str(blend))
    bpy.ops.mesh.primitive_cube_add(size=0.05)
    blend = save_scene(tmp_path / "more.blend")
    assert main(["export", str(wav), "--format", "hjif", "--out", str(tmp_path / "x.hjif"), "--scene", str(blend),
                 "--object", "Cube"]) == 0  # fmt: skip
    assert "where the stroke goes on object 'Cube' is not known" in capsys.readouterr().out
    assert main(["export", str(wav), "--format", "glb", "--out", str(tmp_path / "x.glb"), "--scene", str(blend),
                 "--object", "Cube"]) == 0  # fmt: skip
    assert "nothing is baked on object 'Cube'" in capsys.readouterr().out
    tree, _ = decode_glb((tmp_path / "x.glb").read_bytes(), tmp_path / "x.glb")
    assert "extensionsUsed" not in tree


def test_the_action_of_a_touch_is_a_table(baked, tmp_path, capsys) -> None:
    wav, blend = baked
    out = tmp_path / "x.csv"
    words = ["export", str(wav), "--format", "action", "--out", str(out)]
    assert main([*words, "--scene", str(blend)]) == 0
    assert "for hnf synth --action" in capsys.readouterr().out
    assert read_action_csv(out).duration_s == pytest.approx(read_wav(wav).duration_s, abs=0.01)
    assert main(words) == 2
    assert "--scene TOUCHED.blend" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--format", "glb"], "--scene BAKED.blend"),
        (["--format", "glb", "--object", "Plate"], "--object without --scene"),
        (["--format", "glb", "--scene", "BLEND", "--object", "Nobody"], f"Baked: {PLATE}"),
    ],
)
def test_what_is_missing_is_asked_for(words, said, baked, tmp_path, capsys) -> None:
    wav, blend = baked
    words = [str(blend) if word == "BLEND" else word for word in words]
    assert main(["export", str(wav), "--out", str(tmp_path / "x.glb"), *words]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "x.glb").exists()


def test_faces_from_modifiers_inherit_the_token_of_their_source() -> None:
    """Two squares side by side, each made sixteen: what is left of the middle is the left one's."""
    corners = [(x, y, 0.0) for y in (0.0, 0.1) for x in (-0.1, 0.0, 0.1)]
    obj = add_mesh("Pair", corners, [(0, 1, 4, 3), (1, 2, 5, 4)])
    tokens = np.zeros((2, TOKEN_DIM), np.float32)
    tokens[1] = 0.5
    palette = Palette(tokens, (Mechanics(friction=0.2), Mechanics(friction=0.4)), ("denim", "steel"))
    each = np.array([0.25, 0.75], np.float32)
    write_tokens(obj.data, FaceTokens(palette, np.array([1, 0], np.int32), each * 1e-5, each, "made by hand"))
    finer = obj.modifiers.new("finer", "SUBSURF")
    finer.subdivision_type, finer.levels = "SIMPLE", 2
    obj.scale.x = -1.0
    bpy.context.view_layer.update()
    surface = read_touched_surface(bpy.context.scene, bpy.context.evaluated_depsgraph_get(), 1.0, obj=obj)
    assert len(surface.mesh.triangles) == 2 * 2 * 16
    assert surface.path is None
    left_in_blender = surface.mesh.corner_positions().mean(axis=1)[:, 0] > 0.0  # it is mirrored
    np.testing.assert_array_equal(surface.token, np.where(left_in_blender, 1, 0))
    np.testing.assert_array_equal(surface.confidence, np.where(left_in_blender, np.float32(0.25), np.float32(0.75)))
    assert surface.palette == palette
