"""Strokes across several objects: each is felt in its turn, with tokens, routes and confidence of its own."""

from __future__ import annotations

import math

import bpy
import numpy as np
import pytest
from builders import add_mesh, bump_material
from job_scene import bake
from stroke_builders import read
from touch_scene import line_stroke, save_scene, signals
from touch_scene import touch_without_pictures as touch

from hnf_blender.bridge.scene.stored_data import read_tokens
from hnf_blender.state.session_state import STATE
from hnf_blender.state.status_tracker import refresh_status
from hnf_blender.touch.bake_status import Freshness
from hnf_blender.touch.stroke_bake import load_bake
from hnf_core.field.stroke import SAMPLES_PER_STATE

HALF_M = 0.03


def tile(name: str, x: float, z: float = 0.0, *, material=None, angle: float = 0.0):
    """A square of 60 mm around x, whose mesh lies around its own origin, turned about the vertical."""
    corners = [(-HALF_M, -HALF_M, 0), (HALF_M, -HALF_M, 0), (HALF_M, HALF_M, 0), (-HALF_M, HALF_M, 0)]
    obj = add_mesh(name, corners, [(0, 1, 2, 3)], uv=lambda co: (co.x, co.y))
    obj.data.materials.append(material or bpy.data.materials.new(f"{name} plastic"))
    obj.location, obj.rotation_euler = (x, 0.0, z), (0.0, 0.0, angle)
    bpy.context.view_layer.update()
    return obj


def ridges(name: str = "Ribbed plastic"):
    return bump_material(name, wavelength=2e-3, height=6e-5)


def two_tiles(z: float = 0.0):
    """Ridges at the left, glass at the right, and a stroke of 80 mm across their seam at x = 0."""
    left = tile("Ridges", -HALF_M, material=ridges())
    right = tile("Glass", HALF_M, z, material=bpy.data.materials.new("Clear glass"))
    return left, right, line_stroke("Across", length=0.08)


def test_each_object_is_felt_in_its_turn(tmp_path) -> None:
    two_tiles()
    code, report = touch(save_scene(tmp_path / "scene.blend"), tmp_path / "out")
    assert code == 0
    (entry,) = report["strokes"]
    assert [each["object"] for each in entry["objects"]] == ["Ridges", "Glass"]
    ridged, glass = entry["objects"]
    assert "measured" in ridged["routes"].values()
    assert set(glass["routes"].values()) == {"prior"}
    assert ridged["confidence"] > glass["confidence"] > 0.0
    assert ridged["time_share"] + glass["time_share"] == pytest.approx(1.0, abs=1e-3)
    assert ridged["time_share"] == pytest.approx(0.5, abs=0.06)  # it begins and ends slowly
    assert min(ridged["tokens"], glass["tokens"]) >= 1
    assert [each["object"] for each in entry["materials"]] == sorted(
        (each["object"] for each in entry["materials"]), reverse=True
    )
    assert entry["off_surface"] == 0.0
    assert not [each for each in report["skipped"] if "Glass" in each["what"]]
    samples = signals(tmp_path / "out", report)["Across"].samples.astype(np.float64)
    first, second = samples[1000:3500], samples[4500:7000]
    assert np.sqrt(np.mean(first**2)) > 3.0 * np.sqrt(np.mean(second**2))  # 2 mm ridges at 100 mm/s, then glass
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "out" / report["baked_blend"]))
    assert all(read_tokens(bpy.data.objects[name].data) is not None for name in ("Ridges", "Glass"))


def test_a_stroke_with_a_chosen_surface_feels_that_alone(tmp_path) -> None:
    left, _, stroke = two_tiles()
    stroke.hnf_stroke.surface = left
    code, report = touch(save_scene(tmp_path / "scene.blend"), tmp_path / "out")
    (entry,) = report["strokes"]
    assert code == 1  # more than a tenth of its time is beside its surface
    assert [each["object"] for each in entry["objects"]] == ["Ridges"]
    assert entry["off_surface"] > 0.3


def test_what_lies_beside_or_just_below_changes_no_byte(tmp_path) -> None:
    tile("Ridges", 0.0, material=ridges())
    stroke = line_stroke("Along", length=0.05)
    alone = read(stroke)
    scene = save_scene(tmp_path / "one.blend")
    _, before = touch(scene, tmp_path / "alone")
    bpy.ops.wm.open_mainfile(filepath=str(scene))
    copy = bpy.data.objects["Ridges"].copy()
    copy.location.z -= 2e-4  # a copy just below, as of a decal or a shell
    bpy.context.scene.collection.objects.link(copy)
    tile("Beside", 2 * HALF_M)
    assert read(bpy.data.objects["Along"]).crossed == alone.crossed == ()
    _, after = touch(save_scene(tmp_path / "more.blend"), tmp_path / "more")
    first, second = signals(tmp_path / "alone", before)["Along"], signals(tmp_path / "more", after)["Along"]
    assert (first.samples == second.samples).all()
    assert before["counts"] == after["counts"]


def test_two_halves_of_one_plate_feel_as_the_plate(tmp_path) -> None:
    """Ridges that go on over the seam of two level objects: no blow, and the same level to either side."""
    two = [tile(name, x, material=None) for name, x in (("Left", -HALF_M), ("Right", HALF_M))]
    for obj in two:
        obj.data.materials[0] = ridges()
        obj.data.materials[0].name = "Ribbed plastic"
    line_stroke("Across", length=0.08)
    _, report = touch(save_scene(tmp_path / "scene.blend"), tmp_path / "out")
    (entry,) = report["strokes"]
    samples = signals(tmp_path / "out", report)["Across"].samples.astype(np.float64)
    level = [np.sqrt(np.mean(samples[i : i + 1000] ** 2)) for i in (1500, 3500, 5500)]
    assert max(level) / min(level) < 10 ** (1.5 / 20)
    assert len({each["library_material"] for each in entry["objects"]}) == 1


@pytest.mark.parametrize("step_mm", [0.1, -0.3])
def test_a_step_between_objects_is_a_blow_at_its_place(tmp_path, step_mm) -> None:
    """The seam is at half of the way; level objects have no blow there."""
    peaks = {}
    for name, z in (("level", 0.0), ("step", step_mm * 1e-3)):
        bpy.ops.wm.read_homefile(use_empty=True)
        tile("Left", -HALF_M, material=bpy.data.materials.new("Clear glass"))
        tile("Right", HALF_M, z, material=bpy.data.materials["Clear glass"])
        position = read(line_stroke("Across", length=0.08)).samples.position
        middle = int(np.searchsorted(position, 0.04)) * SAMPLES_PER_STATE
        _, report = touch(save_scene(tmp_path / f"{name}.blend"), tmp_path / name)
        samples = np.abs(signals(tmp_path / name, report)["Across"].samples.astype(np.float64))
        peaks[name] = samples[middle - 300 : middle + 300].max()
        assert report["strokes"][0]["rms_m_s2"] < 100.0
        if name == "step":
            assert int(samples.argmax()) == pytest.approx(middle, abs=150)
    assert peaks["step"] > 4.0 * peaks["level"]


def test_where_the_objects_stand_changes_nothing(tmp_path) -> None:
    """Another origin and turn of the second object, with its vertices where they were: the same contacts."""
    found = []
    for angle, moved in ((0.0, 0.0), (math.pi / 2.0, 0.01)):
        bpy.ops.wm.read_homefile(use_empty=True)
        tile("Left", -HALF_M)
        tile("Right", HALF_M, -1e-4, angle=angle)
        for obj in bpy.data.objects:
            obj.location.y += moved
        stroke = line_stroke("Across", length=0.08, centre=(0.0, moved, 0.0))
        (crossed,) = read(stroke).crossed
        assert crossed.name == "Right"
        found.append(crossed.move_samples(read(stroke).samples).point)
    turn = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(found[1], found[0] @ turn.T, atol=1e-8)


def test_the_window_bakes_what_the_command_line_writes(tmp_path) -> None:
    two_tiles(z=1e-4)
    scene = save_scene(tmp_path / "scene.blend")
    _, report = touch(scene, tmp_path / "out")
    written = signals(tmp_path / "out", report)["Across"].samples
    bpy.ops.wm.open_mainfile(filepath=str(scene))
    assert bake().ok
    from hnf_core.field.synthesis import synthesise_by_field
    from hnf_core.field.weights import load_field

    baked = load_bake(bpy.data.objects["Across"])
    assert baked is not None
    assert baked.facts["objects"] == "Ridges, Glass"
    assert baked.stroke.profile is not None
    assert baked.stroke.profile.seam is not None
    again = synthesise_by_field(load_field(), baked.stroke, seed=baked.seed).signal
    assert (again.samples == written).all()
    assert all(read_tokens(bpy.data.objects[name].data) is not None for name in ("Ridges", "Glass"))

    def freshness() -> Freshness:
        bpy.context.view_layer.update()
        refresh_status(bpy.context.scene)
        return STATE.get_statuses(bpy.context.scene)["Across"].freshness

    assert freshness() is Freshness.FRESH
    right = bpy.data.objects["Glass"]
    right.location.z += 1e-4
    assert freshness() is Freshness.STALE
    right.location.z -= 1e-4
    assert freshness() is Freshness.FRESH
    right.data.materials[0].hnf_touch.library = "oak-wood"
    assert freshness() is Freshness.STALE


def test_the_plan_and_notes_name_both(tmp_path, capsys) -> None:
    two_tiles()
    code, _ = touch(save_scene(tmp_path / "scene.blend"), tmp_path / "out", "--plan")
    assert code == 0
    text = capsys.readouterr().out
    assert "Ribbed plastic" in text
    assert "Clear glass" in text
    assert "object 'Glass'" not in text


def test_what_moves_is_left_out(tmp_path) -> None:
    _, right, stroke = two_tiles()
    right.keyframe_insert("location", frame=1)
    right.location.y = 0.01
    right.keyframe_insert("location", frame=20)
    right.location.y = 0.0
    bpy.context.view_layer.update()
    assert read(stroke).crossed == ()
