"""`hnf touch slab.ply` on a reconstruction, run once for all tests, and its results."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import bpy
import numpy as np
import pytest
from predicted_scene import small_weights, use_weights
from splat_builders import FINE_M, HALF_M, METRES, coarse_slab_file, read_point_tokens, slab, slab_file
from touch_scene import place_data, signals, touch

from data_tools.write_splats import write_inria
from hnf_blender.bridge import splat_reconstruction
from hnf_blender.bridge.scene.meshes import read_surface
from hnf_blender.bridge.scene.stored_data import UNBAKED, read_tokens
from hnf_blender.bridge.splat_closeup import HALF_PASS_SIGMAS
from hnf_blender.bridge.splat_cloud import compute_cloud_frame, get_cloud, read_cloud
from hnf_blender.bridge.splat_reconstruction import TouchSurface, read_reconstruction
from hnf_blender.jobs import bake_job
from hnf_blender.state.session_state import STATE
from hnf_blender.state.status_tracker import StatusTracker
from hnf_blender.touch import bake_patches
from hnf_blender.touch.session import make_scene_session
from hnf_core.errors import SceneError
from hnf_core.progress import count_work
from hnf_core.scene.splats.gaussians import Splats
from hnf_core.scene.splats.reconstruct import MIN_CELLS, reconstruct_surface
from hnf_core.scene.splats.splat_file import read_splats
from reference.splat_layouts import WRITERS, get_suffix

STROKE = ("--stroke", "left-right-soft", "--on", "slab", "--scale", str(METRES))
COARSE = ("--stroke", "left-right-soft", "--on", "scan", "--scale", str(METRES))
CELLS = 24


BROWN, WHITE = (0.55, 0.4, 0.25), (0.85, 0.84, 0.82)
"""Display colors of wood and of paper."""


@dataclass(frozen=True)
class Ran:
    """A run of the main job: its file, its folder, its report."""

    path: Path
    out: Path
    code: int
    report: dict


@pytest.fixture(scope="module", autouse=True)
def quick(tmp_path_factory):
    """A coarse surface, small pictures, a small D_φ."""
    weights = small_weights(tmp_path_factory.mktemp("weights") / "small.safetensors")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(splat_reconstruction, "DEFAULT_CELLS", CELLS)
        patch.setattr(bake_patches, "PATCH_PIXELS", 256)
        use_weights(patch, weights)
        yield


@pytest.fixture(scope="module")
def ran(quick, stroke_properties, tmp_path_factory) -> Ran:
    folder = tmp_path_factory.mktemp("slab")
    path = slab_file(folder)
    return Ran(path, folder / "out", *touch(path, folder / "out", *STROKE))


@pytest.fixture
def no_work():
    """Nothing reconstructs or renders splats during the test: it was done before."""
    with count_work() as work:
        yield
    assert (work.total("reconstructions"), work.total("splats")) == (0, 0)


@pytest.fixture
def baked(ran: Ran):
    """The .blend that the run left, open: surface and cloud."""
    bpy.ops.wm.open_mainfile(filepath=str(ran.out / ran.report["baked_blend"]))
    surface = bpy.data.objects["slab"]
    return surface, get_cloud(surface)


def test_a_reconstruction_is_felt_by_the_predicted_route(ran: Ran) -> None:
    assert ran.code == 0
    (entry,) = ran.report["strokes"]
    # 0.85 mm is resolved, so that bands down to 2 mm are seen whole.
    assert [entry["routes"][band] for band in ("8 mm", "2 mm", "0.25 mm")] == ["predicted", "predicted", "prior"]
    assert entry["resolved_wavelength_m"] == pytest.approx(HALF_PASS_SIGMAS * FINE_M, rel=0.02)
    assert entry["height_source"] == "estimated from splats of slab.ply"
    counts = ran.report["counts"]
    assert 0 < counts["diffusion_calls"] == counts["tokens"] <= counts["renders"] - 1
    assert counts["rays"] > 0
    signal = signals(ran.out, ran.report)[entry["name"]]
    assert np.isfinite(signal.samples).all()
    assert signal.rms > 0.0
    assert ran.report["skipped"] == []
    assert not any("no real-world size" in warning for warning in ran.report["warnings"])


@pytest.fixture(scope="module")
def coarse(quick, tmp_path_factory) -> Ran:
    folder = tmp_path_factory.mktemp("coarse")
    path = coarse_slab_file(folder, "scan.ply", BROWN, WHITE)
    return Ran(path, folder / "out", *touch(path, folder / "out", *COARSE))


@pytest.mark.parametrize("layout", ["spz3", "sog2", "glb"])
def test_other_layouts_are_felt_the_same(coarse: Ran, layout: str, tmp_path: Path) -> None:
    """The slab lies as each layout has it: y up, or COLMAP's y down."""
    up = -1.0 if layout == "sog2" else 1.0
    flat = read_splats(coarse.path)
    means = flat.means[:, [0, 2, 1]] * np.array([1.0, up, -up], dtype=np.float32)
    turned = replace(flat, means=means, scales=flat.scales[:, [0, 2, 1]])
    path = WRITERS[layout](tmp_path / f"scan{get_suffix(layout)}", turned)
    code, report = touch(path, tmp_path / "out", *COARSE)
    assert (coarse.code, code, report["skipped"]) == (0, 0, [])
    levels = [each["strokes"][0]["rms_m_s2"] for each in (report, coarse.report)]
    assert levels[0] == pytest.approx(levels[1], rel=0.1)


def test_two_materials_in_one_cloud_are_told_apart(tmp_path) -> None:
    """Detail stops at millimetres: color and look give what each patch could be, and nothing of the other half."""
    along, signal = {}, {}
    for name, left, right in (("both", BROWN, WHITE), ("brown", BROWN, BROWN), ("white", WHITE, WHITE)):
        path = coarse_slab_file(tmp_path, "scan.ply", left, right)
        words = ("--stroke", "left-right-soft", "--on", "scan", "--scale", str(METRES))
        code, report = touch(path, tmp_path / name, *words)
        assert code == 0
        (entry,) = report["strokes"]
        along[name] = entry["materials"]
        (signal[name],) = signals(tmp_path / name, report).values()
        assert set(entry["routes"].values()) == {"prior"}
        assert sum(each["time_share"] for each in entry["materials"]) == pytest.approx(1.0, abs=1e-3)
    first, *_, last = along["both"]
    assert first["library_material"] == along["brown"][0]["library_material"] == "oak-wood"
    assert last["library_material"] == along["white"][-1]["library_material"] == "copy-paper"
    assert first["likely"] == along["brown"][0]["likely"] != along["white"][0]["likely"]
    assert last["likely"] == along["white"][-1]["likely"] != along["brown"][-1]["likely"]
    assert entry["library_material"] == "copy-paper"
    middle = along["both"][1]["likely"]
    for name, half in (("oak-wood", along["brown"][1]), ("copy-paper", along["white"][1])):
        assert 0.0 < middle[name] < half["likely"][name]
    samples = {name: each.samples for name, each in signal.items()}
    quarter = len(samples["both"]) // 4
    for half, part in (("brown", slice(None, quarter)), ("white", slice(-quarter, None))):
        other = {"brown": "white", "white": "brown"}[half]
        error, distance = (np.square(samples["both"] - samples[each])[part].mean() for each in (half, other))
        assert error < 0.2 * distance


def test_a_second_run_does_nothing_again(ran: Ran, no_work) -> None:
    code, report = touch(ran.path, ran.out, *STROKE)
    assert code == 0
    assert set(report["counts"].values()) == {0}
    assert report["strokes"][0]["fresh"]
    assert report["warnings"] == [line for line in ran.report["warnings"] if line in report["warnings"]]


def test_the_plan_lists_the_use_of_splats_and_the_missing_scale(ran: Ran, no_work, tmp_path, capsys) -> None:
    shutil.copytree(ran.out / "cache", tmp_path / "out" / "cache")
    capsys.readouterr()
    assert touch(ran.path, tmp_path / "out", "--plan", "--json", *STROKE[:4])[0] == 0
    plan = json.loads(capsys.readouterr().out)
    (needed,) = plan["needed"]
    (slot,) = needed["slots"]
    assert (slot["route"], slot["why"]) == ("predicted", "no relief, but splats of slab.ply show it")
    assert any("'slab' is a reconstruction, which has no real-world size" in note for note in plan["notes"])


def test_a_plan_keeps_no_surface(ran: Ran, tmp_path, capsys) -> None:
    assert touch(ran.path, tmp_path / "out", "--plan", *STROKE)[0] == 0
    assert "left-right-soft on slab" in capsys.readouterr().out
    assert not (tmp_path / "out").exists()


def test_the_baked_file_feels_the_same_as_the_splat_file(ran: Ran, no_work, tmp_path) -> None:
    shutil.copytree(ran.out / "cache", tmp_path / "out" / "cache")
    code, report = touch(ran.out / ran.report["baked_blend"], tmp_path / "out")  # it keeps its scale
    assert code == 0
    assert report["metres_per_unit"] == METRES
    (first,), (second,) = ran.report["strokes"], report["strokes"]
    assert (tmp_path / "out" / second["wav"]).read_bytes() == (ran.out / first["wav"]).read_bytes()
    assert report["counts"]["renders"] == 1  # the picture


def test_faces_and_splats_carry_the_tokens_of_what_was_touched(baked) -> None:
    surface, cloud = baked
    tokens, points = read_tokens(surface.data), read_point_tokens(cloud)
    assert tokens is not None
    assert points is not None
    told = points.index != UNBAKED
    assert set(points.index[told].tolist()) == set(tokens.index[tokens.index != UNBAKED].tolist())
    assert ((points.confidence > 0.0) == told).all()
    made = read_surface(surface, bpy.context.view_layer.depsgraph, METRES)
    place = compute_cloud_frame(surface, cloud, made.stretch).to_surface(read_cloud(cloud).means)
    assert 0.05 < told.mean() < 0.95
    # The stroke runs over the top, 10 mm above the bottom.
    assert told[place[:, 2] < -0.9 * HALF_M[2]].mean() < 0.5 < told[place[:, 2] > 0.9 * HALF_M[2]].mean()
    assert (bpy.data.objects["slab splats"], cloud.parent) == (cloud, surface)


def test_the_splats_as_they_are_come_back_from_the_file(baked) -> None:
    found, meant = read_cloud(baked[1]), slab()
    assert found.means.tobytes() == meant.means.tobytes()
    assert found.opacities == pytest.approx(meant.opacities, abs=1e-6)
    assert found.scales == pytest.approx(meant.scales, rel=1e-6)


def test_the_key_follows_splat_values_and_not_name_or_location(baked, tmp_path) -> None:
    surface, cloud = baked

    def key() -> str:
        session = make_scene_session(bpy.context.scene, bpy.context.view_layer, tmp_path)
        return session.compute_surface_key(surface)

    first = key()
    cloud.name = "something else"
    surface.location.x += 1.0
    bpy.ops.object.camera_add(location=(1.0, 2.0, 3.0))
    assert key() == first
    watch = StatusTracker(bpy.context.scene, bpy.context.view_layer)
    while not watch.is_idle:
        watch.check_next()
    cloud.data.attributes["sh_0"].data[100].vector.x += 0.01
    assert key() != first
    watch.mark_changed(cloud.data.name)
    assert not watch.is_idle


def test_a_bake_in_the_window_gives_the_same_tokens(baked, ran: Ran, no_work, operators, tmp_path, monkeypatch) -> None:
    cloud = baked[1]
    shutil.copytree(ran.out / "cache", place_data(monkeypatch, tmp_path / "data"))
    meant = read_point_tokens(cloud)
    assert bpy.ops.hnf.purge(what="ALL") == {"FINISHED"}
    assert read_point_tokens(cloud) is None
    ended = bake_job.bake_blocking(bpy.context.scene, bpy.context.view_layer)
    STATE.clear()
    assert ended.ok, ended.message
    found = read_point_tokens(cloud)
    assert found is not None
    assert meant is not None
    assert found.index.tolist() == meant.index.tolist()
    assert found.confidence.tolist() == meant.confidence.tolist()


def test_a_shader_relief_takes_precedence_over_splats(baked, tmp_path) -> None:
    from builders import bump_material

    surface, _ = baked
    surface.data.materials[0] = bump_material("Ridges", wavelength=2e-3, height=5e-5)
    session = make_scene_session(bpy.context.scene, bpy.context.view_layer, tmp_path)
    assert not session.get_touched_object(surface).uses_splats(0)
    surface.data.materials.clear()
    session = make_scene_session(bpy.context.scene, bpy.context.view_layer, tmp_path)
    assert session.get_touched_object(surface).uses_splats(0)


def test_poor_reconstructions_are_said_to_be_poor(baked, tmp_path) -> None:
    surface, _ = baked
    surface["hnf_splats_notes"] = "object 'slab': full of holes."
    session = make_scene_session(bpy.context.scene, bpy.context.view_layer, tmp_path)
    assert session.get_surface(surface).notes[-1] == "object 'slab': full of holes."


def ball_file(folder: Path, count: int) -> Path:
    """A ball of splats."""
    centres = np.random.default_rng(0).normal(size=(count, 3))
    centres /= np.linalg.norm(centres, axis=1, keepdims=True)
    rotations, harmonics = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)), np.zeros((count, 1, 3))
    parts = (centres, np.full((count, 3), 0.12), rotations, np.full(count, 0.97), harmonics)
    write_inria(folder / "ball.ply", Splats(*(part.astype(np.float32) for part in parts)))
    return folder / "ball.ply"


@pytest.mark.parametrize("damage", ["none", "cut", "noise", "indices"])
def test_a_cached_surface_is_used_if_intact_and_rebuilt_if_not(damage, tmp_path) -> None:
    path, cache = ball_file(tmp_path, 150), tmp_path / "cache"
    with count_work() as work:
        first = read_reconstruction(path, cache, cells=MIN_CELLS)
        (kept,) = cache.iterdir()
        whole, plain = kept.read_bytes(), first.surface
        if damage == "indices":
            shifted = TouchSurface(plain.vertices, plain.triangles + 1, plain.colour, ())
            splat_reconstruction._save_cached(cache, read_splats(path), MIN_CELLS, shifted)
        else:
            kept.write_bytes({"none": whole, "cut": whole[:200], "noise": bytes(range(256))}[damage])
        second = read_reconstruction(path, cache, cells=MIN_CELLS)
    assert work.amounts["reconstructions"] == [150] * (1 if damage == "none" else 2)
    assert (first.was_cached, second.was_cached) == (False, damage == "none")
    assert second.surface.warnings == first.surface.warnings
    assert "only 150 splats" in second.surface.warnings[0]
    assert second.surface.vertices.tobytes() == plain.vertices.tobytes()
    assert kept.read_bytes() == whole


def test_a_file_that_makes_no_surface_leaves_nothing_behind(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(
        splat_reconstruction, "reconstruct_surface", lambda *_a, **_n: (_ for _ in ()).throw(SceneError("fog."))
    )
    with pytest.raises(SceneError, match=r"fog"):
        read_reconstruction(slab_file(tmp_path), tmp_path / "cache")
    assert not (tmp_path / "cache").exists()
    assert reconstruct_surface is not splat_reconstruction.reconstruct_surface
