"""A bake is judged by what changes the feel: moving, turning, renaming, hiding and copying silence no stroke."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from job_scene import small_scene
from mathutils import Euler, Matrix
from survival_scene import append, statuses
from touch_scene import line_stroke, ridge_plate

from hnf_blender.jobs import bake_job, job_runner
from hnf_blender.state.session_state import STATE
from hnf_blender.touch.bake_status import Freshness
from hnf_blender.touch.session import make_scene_session

FRESH, STALE = Freshness.FRESH, Freshness.STALE
FINGER_MOVES_M = 1e-5
PLAYS = (FRESH, Freshness.FORCE)

pytestmark = pytest.mark.usefixtures("warm_bake")

angles = st.floats(-3.2, 3.2, allow_nan=False)
places = st.floats(-50.0, 50.0, allow_nan=False)
rigid = st.tuples(st.tuples(angles, angles, angles), st.tuples(places, places, places))


def bake() -> None:
    bake_job.bake_blocking(bpy.context.scene, bpy.context.view_layer)
    assert set(statuses().values()) == {FRESH}


def needs_bake(name: str = "Along") -> bool:
    """Whether a bake would do anything."""
    bpy.context.view_layer.update()
    session = make_scene_session(bpy.context.scene, bpy.context.view_layer, Path())
    return not job_runner.is_up_to_date(session, session.make_curve_job(bpy.data.objects[name]))


def moved(motion, *names: str, metres_per_unit: float = 1.0) -> None:
    """Turn and move objects as one, as an artist does with the objects selected."""
    turn, place = Euler(motion[0]), [value / metres_per_unit for value in motion[1]]
    for name in names:
        obj = bpy.data.objects[name]
        obj.rotation_euler = (turn.to_matrix() @ START[name][1].to_matrix()).to_euler()
        obj.location = np.array(turn.to_matrix() @ START[name][0]) + place
    bpy.context.view_layer.update()


START: dict[str, tuple] = {}


def remember() -> None:
    START.clear()
    START.update({obj.name: (obj.location.copy(), obj.rotation_euler.copy()) for obj in bpy.data.objects})


@pytest.mark.parametrize("unit", [1.0, 0.01, 0.0254])
@pytest.mark.parametrize("size", [(1.0, 1.0, 1.0), (0.7331, 1.1, 0.913)])
def test_no_rigid_motion_silences_a_stroke(unit, size) -> None:
    """Whatever the unit, and with a scale that is not applied; a finger's breadth of the stroke alone is noticed."""
    plate, stroke = small_scene()
    plate.scale = np.array(size) / unit
    stroke.scale = (1.0 / unit,) * 3
    bpy.context.scene.hnf.metres_per_unit = unit
    bpy.context.view_layer.update()
    bake()
    remember()

    @settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
    @given(rigid)
    def holds(motion) -> None:
        moved(motion, "Plate", "Along", metres_per_unit=unit)
        assert statuses() == {"Along": FRESH}, STATE.get_statuses(bpy.context.scene)["Along"].why
        assert not needs_bake()

    holds()
    moved(((0.3, 0.4, 0.5), (0.1, 0.7, 0.3)), "Plate", "Along", metres_per_unit=unit)
    stroke.location += (
        stroke.rotation_euler.to_matrix() @ bpy.context.scene.cursor.matrix.to_3x3().col[0] * (FINGER_MOVES_M / unit)
    )
    assert statuses() == {"Along": STALE}


def test_nor_one_of_a_parent() -> None:
    """The stroke and its surface hang on an object that is scaled, as a character's props do."""
    plate, stroke = small_scene()
    parent = bpy.data.objects.new("Rig", None)
    bpy.context.scene.collection.objects.link(parent)
    parent.rotation_euler, parent.scale = (0.2, -0.7, 1.1), (0.83, 0.83, 0.83)
    bpy.context.view_layer.update()
    for obj in (plate, stroke):
        obj.parent, obj.matrix_parent_inverse = parent, parent.matrix_world.inverted()
    plate.scale = (1.0, 1.3, 1.0)
    bpy.context.view_layer.update()
    bake()

    @settings(max_examples=15, deadline=None, suppress_health_check=list(HealthCheck))
    @given(rigid)
    def holds(motion) -> None:
        parent.rotation_euler, parent.location = motion
        assert statuses() == {"Along": FRESH}, STATE.get_statuses(bpy.context.scene)["Along"].why

    holds()


def test_nor_does_rounding_add_a_sample() -> None:
    """50 mm at 100 mm/s is a whole number of samples, and a last bit more of the length is one more."""
    small_scene()
    bpy.data.objects.remove(bpy.data.objects["Along"])
    stroke = line_stroke("Along", surface=bpy.data.objects["Plate"], length=0.05)
    stroke.animation_data_clear()
    stroke.hnf_stroke.force = 1.0
    bake()
    remember()
    for turn in np.linspace(0.1, 3.0, 20):
        moved(((turn, 0.5 * turn, -turn), (0.1, 7.0, 0.3)), "Plate", "Along")
        assert statuses() == {"Along": FRESH}
    stroke.hnf_stroke.force = 1.5
    assert statuses() == {"Along": Freshness.FORCE}


@settings(max_examples=15, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.lists(st.sampled_from(["Cube.014", "Thing", "x", "Größe 7", "äöü", "A Very Long Name " * 3, "Lid"]),
                min_size=5, max_size=5, unique=True))  # fmt: skip
def test_renaming_silences_no_stroke(names) -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    plate, stroke = small_scene()
    bake()
    for block, name in zip((plate, plate.data, plate.data.materials[0], stroke, stroke.data), names, strict=True):
        block.name = name
    assert [status in PLAYS for status in statuses().values()] == [True]
    # The only name that said what the material is, is gone.
    assert "Names changed" in STATE.get_statuses(bpy.context.scene)[stroke.name].why


def test_only_a_name_that_says_something_needs_a_bake() -> None:
    plate, _ = small_scene()
    bake()
    plate.name = plate.data.name = "Lid.003"
    assert (statuses(), needs_bake()) == ({"Along": FRESH}, False)
    assert STATE.get_statuses(bpy.context.scene)["Along"].object_name == "Lid.003"
    plate.data.materials[0].name = "Oak wood"
    assert statuses() == {"Along": FRESH}
    assert "Names changed" in STATE.get_statuses(bpy.context.scene)["Along"].why
    assert needs_bake()
    bake()
    assert not needs_bake()
    assert STATE.get_statuses(bpy.context.scene)["Along"].why == ""


def hide(how: str, plate: bpy.types.Object, *, hidden: bool) -> None:
    if how == "eye":
        plate.hide_set(hidden)
    elif how == "collection":
        bpy.context.view_layer.layer_collection.children["Aside"].exclude = hidden
    else:
        setattr(plate, how, hidden)


@pytest.mark.parametrize("how", ["eye", "hide_viewport", "hide_render", "collection"])
@pytest.mark.parametrize("is_named", [True, False])
def test_hiding_and_showing_the_surface_silences_no_stroke(how, is_named, tmp_path) -> None:
    plate, stroke = small_scene()
    aside = bpy.data.collections.new("Aside")
    bpy.context.scene.collection.children.link(aside)
    aside.objects.link(plate)
    bpy.context.scene.collection.objects.unlink(plate)
    if not is_named:
        stroke.hnf_stroke.surface = None
    bake()
    hide(how, plate, hidden=True)
    assert statuses() == {"Along": FRESH}
    path = tmp_path / "hidden.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    STATE.clear()
    bpy.ops.wm.open_mainfile(filepath=str(path))
    assert statuses() == {"Along": FRESH}  # as before the reload
    assert "hidden" in STATE.get_statuses(bpy.context.scene)["Along"].why
    bpy.data.objects["Along"].hnf_stroke.force = 1.5
    hide(how, bpy.data.objects["Plate"], hidden=False)
    assert statuses()["Along"] in PLAYS
    bpy.data.objects["Along"].location.y += 0.01
    assert statuses() == {"Along": STALE}


def test_a_full_copy_of_the_scene_plays() -> None:
    small_scene()
    bake()
    bpy.ops.scene.new(type="FULL_COPY")
    copy = bpy.context.scene
    assert {obj.name for obj in copy.objects}.isdisjoint({"Plate", "Along"})
    assert statuses() == {obj.name: FRESH for obj in copy.objects if obj.hnf_stroke.is_stroke}
    assert not needs_bake(next(iter(statuses())))


def test_what_is_appended_or_linked_plays_wherever_it_lies(tmp_path) -> None:
    plate, _ = small_scene()
    group = bpy.data.node_groups.new("Shared", "ShaderNodeTree")
    plate.data.materials[0].node_tree.nodes.new("ShaderNodeGroup").node_tree = group
    bake()
    first, second = tmp_path / "a.blend", tmp_path / "elsewhere" / "b.blend"
    second.parent.mkdir()
    for path in (first, second):
        bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
    for path in (first, second):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        STATE.clear()
        ridge_plate()  # takes the names, so that what comes gets others
        bpy.data.node_groups.new("Shared", "ShaderNodeTree")
        append(path, "Along")
        assert set(statuses().values()) == {FRESH}
    for path in (first, second):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        STATE.clear()
        with bpy.data.libraries.load(str(path), link=True) as (_, wanted):
            wanted.objects = ["Along", "Plate"]
        for obj in wanted.objects:
            bpy.context.scene.collection.objects.link(obj)
        bpy.context.scene.collection.objects.link(ridge_plate().copy())
        assert set(statuses().values()) == {FRESH}


def test_a_job_keeps_what_was_turned_or_renamed_meanwhile() -> None:
    from job_scene import finish, kept, start

    plate, stroke = small_scene()
    job = start()
    for obj in (plate, stroke):
        obj.rotation_euler = (0.3, 0.4, 0.5)
        obj.location = (0.1, 0.2, 0.3)
    plate.data.materials[0].name = "Steel"
    ended = finish(job)
    assert ended.ok, ended
    assert list(kept()["bakes"]) == ["Along"]
    assert statuses() == {"Along": FRESH}


def test_turning_a_surface_without_its_stroke_is_noticed() -> None:
    plate, _ = small_scene()
    bake()
    plate.matrix_world = Matrix.Rotation(0.01, 4, "Z") @ plate.matrix_world
    assert statuses() == {"Along": STALE}
