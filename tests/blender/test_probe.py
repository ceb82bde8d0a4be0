"""Static touch queries at one place, on the command line and in a background job."""

from __future__ import annotations

import json
import shutil

import bpy
import numpy as np
import pytest
from builders import add_mesh, add_plane, bump_material, datablock_names
from job_scene import finish, kept
from panel_recorder import drawn
from touch_scene import PLATE, line_stroke, ridge_plate, save_scene, touch

from hnf_blender.jobs import manager
from hnf_blender.state.session_state import STATE
from hnf_blender.touch.bake_patches import get_token
from hnf_blender.touch.query import QueryResult, query_surface
from hnf_blender.touch.report import Counts
from hnf_blender.touch.session import gather_jobs, make_scene_session
from hnf_blender.touch.synthesise import bake_stroke
from hnf_core.errors import SceneError
from hnf_core.material.library import load_library
from hnf_core.material.token import BAND_FEATURES, band_slice
from hnf_core.touch_request import TouchQuery

RIDGES = 2
"""The band of 2 mm waves."""


def probed(place: TouchQuery, folder, counts: Counts | None = None) -> QueryResult:
    bpy.context.view_layer.update()
    session = make_scene_session(bpy.context.scene, bpy.context.view_layer, folder)
    return query_surface(session, place, folder / "cache", counts or Counts())


def feature(found: QueryResult, name: str, band: int = RIDGES) -> float:
    return float(found.fused.values[band_slice(band)][BAND_FEATURES.index(name)])


def turn_uv(obj) -> None:
    """By a quarter: what ran along u runs along v."""
    for entry in obj.data.uv_layers.active.data:
        u, v = entry.uv
        entry.uv = (v, -u)
    obj.data.update()


def test_a_place_is_told_in_files_and_report(tmp_path) -> None:
    ridge_plate()
    scene, out = save_scene(tmp_path / "scene.blend"), tmp_path / "out"
    before = scene.read_bytes()
    code, report = touch(scene, out, "--at", f"{PLATE}:0.01,0.02")
    assert code == 0
    (entry,) = report["probes"]
    assert entry["place"]["world"] == pytest.approx([0.01, 0.02, 0.0], abs=1e-6)
    assert entry["place"]["uv"] == pytest.approx([0.01, 0.02], abs=1e-6)
    assert entry["routes"]["2 mm"] == "measured"
    assert entry["routes"]["8 mm"] == "prior"
    # A sine of 60 µm from top to bottom has 60/(2√2) µm RMS.
    assert entry["roughness"]["bands_rms_m"]["2 mm"] == pytest.approx(60e-6 / 8**0.5, rel=0.03)
    assert entry["roughness"]["seen_rms_m"] == pytest.approx(60e-6 / 8**0.5, rel=0.03)
    assert entry["roughness"]["total_rms_m"] >= entry["roughness"]["seen_rms_m"]
    assert 0.1 < entry["friction"]["kinetic_mu"] < 1.1
    assert entry["friction"]["spread_factor"] > 1.0
    assert "not seen" in entry["friction"]["basis"]
    distances = [near["distance"] for near in entry["nearest"]]
    assert distances == sorted(distances)
    assert {near["name"] for near in entry["nearest"]} <= {material.name for material in load_library()}
    assert (out / entry["tactile_map"]["picture"]).read_bytes().startswith(b"\x89PNG")
    with np.load(out / entry["tactile_map"]["numbers"], allow_pickle=False) as numbers:
        assert np.std(numbers["height_m"]) == pytest.approx(60e-6 / 8**0.5, rel=0.05)
        assert numbers["image"].shape == (*numbers["mask"].shape, 3)
    assert report["counts"]["renders"] == 2  # the close-up, and the small view that chooses its sampling
    assert report["counts"]["network_calls"] == 0
    assert scene.read_bytes() == before
    assert not list(out.glob("*.wav"))


def test_a_probe_finds_the_token_that_a_stroke_has_there(tmp_path) -> None:
    ridge_plate()
    line_stroke("Along")
    session = make_scene_session(bpy.context.scene, bpy.context.view_layer, tmp_path)
    (job,) = gather_jobs(session).jobs
    touched = session.get_touched_object(bpy.data.objects[PLATE])
    baked = bake_stroke(job.stroke, touched, {}, tmp_path / "cache", Counts(), session.predictor)
    counts = Counts()
    parts = zip(baked.patches, baked.records, baked.fused, baked.materials, strict=True)
    for patch, record, fused, material in parts:
        local = np.linalg.inv(touched.surface.stretch) @ patch.centre
        found = probed(TouchQuery(PLATE, tuple(local)), tmp_path, counts)
        assert (found.fused.values == fused.values).all()
        assert found.fused.routes == fused.routes
        assert (get_token(found.record).values == get_token(record).values).all()
        assert found.material.library.name == material.library.name
    assert counts.renders == 0  # the very patches that the stroke left in the store


def test_a_query_result_is_invariant_to_object_transforms(tmp_path) -> None:
    plate = ridge_plate()
    first = probed(TouchQuery(PLATE, (0.01, 0.02)), tmp_path)
    plate.location, plate.rotation_euler = (1.0, -2.0, 0.5), (0.4, -0.3, 1.1)
    counts = Counts()
    moved = probed(TouchQuery(PLATE, (0.01, 0.02)), tmp_path, counts)
    assert (moved.fused.values == first.fused.values).all()
    assert moved.point.point == pytest.approx(first.point.point, abs=1e-7)
    assert (moved.friction, moved.stiffness, moved.nearest) == (first.friction, first.stiffness, first.nearest)
    assert counts.renders == 0


def test_uvs_turned_by_a_quarter_swap_what_has_a_direction(tmp_path) -> None:
    """The bump follows u: after the turn it runs along world y, and the tangent frame with it. Only the tangent turned
    back shows the swap: so the ridges stay, and the UV that names directions turns."""
    plate = add_plane(PLATE, 0.12)
    material = bump_material("Ridged plastic", wavelength=2e-3, height=60e-6)
    plate.data.materials.append(material)
    tree = material.node_tree
    coordinates = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeUVMap")
    place = tree.nodes.new("ShaderNodeTexCoord")  # object coordinates: the relief no longer follows the UVs
    for link in list(coordinates.outputs[0].links):
        tree.links.new(place.outputs["Object"], link.to_socket)
    straight = probed(TouchQuery(PLATE, (0.01, 0.02, 0.0)), tmp_path)
    turn_uv(plate)
    turned = probed(TouchQuery(PLATE, (0.01, 0.02, 0.0)), tmp_path)
    assert turned.point.patch.x_axis == pytest.approx([0.0, 1.0, 0.0], abs=1e-6) or turned.point.patch.x_axis == (
        pytest.approx([0.0, -1.0, 0.0], abs=1e-6)
    )
    assert feature(straight, "cos2") > 0.9
    assert feature(turned, "cos2") == pytest.approx(-feature(straight, "cos2"), abs=0.02)
    assert feature(turned, "cos4") == pytest.approx(feature(straight, "cos4"), abs=0.02)
    assert feature(turned, "level") == pytest.approx(feature(straight, "level"), abs=0.01)
    assert [near.suggestion.name for near in turned.nearest] == [near.suggestion.name for near in straight.nearest]
    assert turned.friction.value == pytest.approx(straight.friction.value, rel=1e-3)


def test_invalid_queries_are_reported_and_valid_ones_still_run(tmp_path, capsys) -> None:
    ridge_plate()
    add_mesh("Bare", [(0, 0, 0.2), (0.1, 0, 0.2), (0, 0.1, 0.2)], [(0, 1, 2)])
    scene = save_scene(tmp_path / "scene.blend")
    words = ("Plat:0.5,0.5", f"{PLATE}:5,5", "Bare:0.5,0.5", f"{PLATE}:0.01,0.02,0.5", f"{PLATE}:0.01,0.02")
    code, report = touch(scene, tmp_path / "out", *(word for place in words for word in ("--at", place)))
    assert code == 1
    assert [entry["object"] for entry in report["probes"]] == [PLATE]
    why = [failure["why"] for failure in report["failed"]]
    assert len(why) == 4
    assert f"Did you mean '{PLATE}'?" in why[0]
    assert "Its UVs lie between (-0.06, -0.06) and (0.06, 0.06)" in why[1]
    assert "Unwrap it" in why[2]
    assert "500 mm away" in why[3]
    assert "Traceback" not in capsys.readouterr().err


def test_meshes_without_uvs_accept_3d_query_points_only(tmp_path) -> None:
    add_mesh("Bare", [(0, 0, 0.2), (0.1, 0, 0.2), (0, 0.1, 0.2)], [(0, 1, 2)])
    found = probed(TouchQuery("Bare", (0.02, 0.02, 0.2)), tmp_path)
    assert found.tactile is None
    assert found.observed_rms_m is None
    assert all(near.distance is None for near in found.nearest)
    assert any("no usable UVs" in note for note in found.notes)
    with pytest.raises(SceneError, match="Unwrap it"):
        probed(TouchQuery("Bare", (0.1, 0.1)), tmp_path)


def test_of_overlapping_islands_the_first_is_taken_and_said(tmp_path) -> None:
    low, high = [(0, 0, 0), (0.1, 0, 0), (0, 0.1, 0)], [(0, 0, 0.3), (0.1, 0, 0.3), (0, 0.1, 0.3)]
    add_mesh("Twice", low + high, [(0, 1, 2), (3, 4, 5)], uv=lambda co: (co.x, co.y))
    found = probed(TouchQuery("Twice", (0.02, 0.02)), tmp_path)
    assert found.point.point[2] == pytest.approx(0.0, abs=1e-6)
    assert any("1 more face has the same UV" in note for note in found.notes)


def test_probes_leave_strokes_and_what_is_known_of_them_alone(tmp_path) -> None:
    ridge_plate()
    line_stroke("Along")
    scene, out = save_scene(tmp_path / "scene.blend"), tmp_path / "out"
    _, first = touch(scene, out)
    wav = (out / first["strokes"][0]["wav"]).read_bytes()
    code, report = touch(scene, out, "--at", f"{PLATE}:0.01,0.02")
    assert code == 0
    assert [stroke["name"] for stroke in report["strokes"]] == ["Along"]
    assert report["skipped"][0]["why"] == "only probes are asked for"
    code, again = touch(scene, out)
    assert code == 0
    assert again["counts"]["renders"] == 0
    assert again["strokes"][0]["fresh"]
    assert again["probes"] == []
    assert (out / again["strokes"][0]["wav"]).read_bytes() == wav


def test_a_second_look_costs_nothing_and_the_plan_says_so(tmp_path, capsys) -> None:
    ridge_plate()
    scene, out = save_scene(tmp_path / "scene.blend"), tmp_path / "out"
    words = ("--at", f"{PLATE}:0.01,0.02")
    capsys.readouterr()
    touch(scene, out, *words, "--plan", "--json")
    assert json.loads(capsys.readouterr().out)["probes"][0]["close_ups"] == 1
    _, first = touch(scene, out, *words)
    path = out / first["probes"][0]["tactile_map"]["picture"]
    picture, drawn_ns = path.read_bytes(), path.stat().st_mtime_ns
    touch(scene, out, *words, "--plan")
    assert "nothing to render" in capsys.readouterr().out
    _, second = touch(scene, out, *words)
    assert second["counts"]["renders"] == 0
    assert second["probes"] == first["probes"]
    assert path.stat().st_mtime_ns == drawn_ns, "nothing is drawn again"
    path.unlink()
    touch(scene, out, *words)
    assert path.read_bytes() == picture
    touch(scene, out, *words, "--material", f"{PLATE}=granite")
    assert path.read_bytes() != picture, "it says what it is"


def test_a_chosen_material_is_what_friction_is_told_of(tmp_path) -> None:
    ridge_plate()
    scene = save_scene(tmp_path / "scene.blend")
    _, report = touch(scene, tmp_path / "out", "--at", f"{PLATE}:0.01,0.02", "--material", f"{PLATE}=granite")
    (entry,) = report["probes"]
    assert entry["library_material"] == "granite"
    assert entry["reason"] == "chosen by the artist"
    assert entry["friction"]["kinetic_mu"] == pytest.approx(0.4)
    assert entry["friction"]["spread_factor"] < 1.2


@pytest.fixture
def panel():
    import hnf_blender.ops
    import hnf_blender.ui
    from hnf_blender.ui.materials_panel import HNF_PT_probe

    hnf_blender.ui.register()
    yield HNF_PT_probe
    hnf_blender.ui.unregister()


def test_the_window_s_job_finds_what_is_found_in_line(lone_bake, panel) -> None:
    plate = ridge_plate()
    bpy.context.view_layer.update()
    before = datablock_names()
    assert bpy.ops.hnf.probe(surface=PLATE, at=(0.01, 0.02, 0.0)) == {"FINISHED"}
    in_line, suggestions = STATE.query_view, dict(STATE.suggestions)
    assert in_line.object_name == PLATE
    shutil.rmtree(lone_bake)
    STATE.clear()
    bake = manager.start_bake(bpy.context.scene, bpy.context.view_layer, point=TouchQuery(PLATE, (0.01, 0.02, 0.0)))
    assert bake.pid is not None
    ended = finish(bake)
    assert ended.ok, ended
    assert ended.written == 0
    assert (STATE.query_view.roughness_m, STATE.query_view.nearest) == (in_line.roughness_m, in_line.nearest)
    assert STATE.suggestions == suggestions
    assert datablock_names() == before
    assert kept() == {"bakes": {}, "tokens": {}}
    said = drawn(panel)
    assert "Roughness: 21 µm RMS" in said.words
    assert "not seen" in said.words.replace("\n", " ")
    assert "hnf.material_choose" in said.operators
    assert not plate.active_material.hnf_touch.library  # nothing is chosen unasked


def test_a_place_that_is_gone_is_told_by_the_job(lone_bake) -> None:
    ridge_plate()
    bpy.context.view_layer.update()
    ended = finish(
        manager.start_bake(bpy.context.scene, bpy.context.view_layer, point=TouchQuery("Gone", (0.0, 0.0, 0.0)))
    )
    assert not ended.ok
    assert "no such object" in ended.message
    assert STATE.query_view is None


def test_a_look_that_is_given_up_leaves_nothing(lone_bake) -> None:
    ridge_plate()
    bpy.context.view_layer.update()
    manager.start_bake(bpy.context.scene, bpy.context.view_layer, point=TouchQuery(PLATE, (0.01, 0.02, 0.0)))
    assert manager.cancel()
    assert STATE.last_job.message == "Nothing was examined."
    assert STATE.query_view is None
    assert STATE.job is None


def test_an_empty_query_panel_is_one_button_with_a_tooltip(panel, operators) -> None:
    STATE.clear()
    said = drawn(panel)
    assert said.words == "Examine a Place"
    assert said.operators == ["hnf.probe"]
    assert "Click on a surface" in bpy.ops.hnf.probe.get_rna_type().description
