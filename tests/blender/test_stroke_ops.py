"""Stroke operators: add, convert, duplicate, delete, select, solo, and force."""

from __future__ import annotations

from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from builders import add_plane, datablock_names
from panel_recorder import Recorder, rna_of
from stroke_builders import LINE, act, add_stroke, key, keyed_fcurves, read

from hnf_blender.bridge.stroke.read_stroke import get_motion_end, list_strokes
from hnf_blender.ops.stroke_ops import describe_words
from hnf_blender.props.scene_settings import find_namesake, get_active_stroke
from hnf_core.action.primitives import PRIMITIVE_NAMES, PRIMITIVES


@pytest.fixture(autouse=True, scope="module")
def operators():
    from hnf_blender.ops import draw_ops
    from hnf_blender.ops import force_ops as force
    from hnf_blender.ops import stroke_ops as strokes

    classes = [
        each
        for module in (draw_ops, strokes, force)
        for each in module.CLASSES
        if not hasattr(bpy.types, each.__name__) and not (each.__name__ == "HnfPenSample" and each.is_registered)
    ]
    for each in classes:
        bpy.utils.register_class(each)
    yield
    for each in reversed(classes):
        bpy.utils.unregister_class(each)


def select(*objects):
    layer = bpy.context.view_layer
    for obj in layer.objects:
        obj.select_set(obj in objects)
    layer.objects.active = objects[-1] if objects else None


def curve(obj, name):
    return next(each for each in keyed_fcurves(obj) if each.data_path == f"hnf_stroke.{name}")


def keys_of(obj, name="force"):
    return [
        (round(float(x), 3), round(float(y), 4)) for x, y in (point.co for point in curve(obj, name).keyframe_points)
    ]


@pytest.mark.parametrize("name", PRIMITIVE_NAMES)
def test_add_each_ready_stroke(name):
    select(add_plane())
    bpy.context.scene.frame_set(7)
    assert bpy.ops.hnf.stroke_add(primitive=name, probe="finger") == {"FINISHED"}
    obj = get_active_stroke(bpy.context)
    assert list_strokes(bpy.context.scene) == [obj]
    assert bpy.context.scene.objects[bpy.context.scene.hnf.stroke_index] == obj
    assert [collection.name for collection in obj.users_collection] == ["Touch strokes"]
    assert (obj.hnf_stroke.start, obj.hnf_stroke.probe) == (7.0, "finger")
    action = act(obj)[3]
    assert action.force.max() == pytest.approx(PRIMITIVES[name].force, rel=1e-3)
    assert action.speed.max() == pytest.approx(PRIMITIVES[name].speed, rel=2e-2)


def test_add_in_words():
    select(add_plane())
    assert bpy.ops.hnf.stroke_add(words="scrape right to left, 1.5 N, 80 mm/s") == {"FINISHED"}
    action = act(get_active_stroke(bpy.context))[3]
    assert action.force.max() == pytest.approx(1.5, rel=1e-3)
    assert action.speed.max() == pytest.approx(0.08, rel=1e-2)
    assert np.allclose(action.direction[action.speed > 0.01], [-1.0, 0.0], atol=1e-3)
    with pytest.raises(RuntimeError, match="the word 'tickle' is unknown"):
        bpy.ops.hnf.stroke_add(words="tickle")


def test_add_several_steps_in_words():
    select(add_plane())
    assert bpy.ops.hnf.stroke_add(words="tap twice, then rub slowly in circles") == {"FINISHED"}
    obj = get_active_stroke(bpy.context)
    assert obj.name == "tap-2-times-then-circle-40mm-s on Plane"
    action = act(obj)[3]
    assert np.sum(np.diff(action.contact.astype(int)) == 1) == 3
    assert action.speed.max() == pytest.approx(0.04, rel=1e-2)


@pytest.mark.parametrize(
    ("words", "icon", "text"),
    [
        ("tap twice, then rub slowly in circles", "CHECKMARK", "tap 2 times, then circle 40mm/s"),
        ("tickle it", "ERROR", "the word 'tickle' is unknown"),
        ("press left to right", "ERROR", "says nothing of a press"),
        ("  ", "INFO", "For example: tap twice"),
    ],
)
def test_the_dialog_says_what_it_understood(words, icon, text):
    recorder = Recorder()
    operator = SimpleNamespace(layout=recorder, words=words, dialog=True, bl_rna=rna_of("hnf.stroke_add"))
    bpy.types.HNF_OT_stroke_add.draw(operator, bpy.context)
    assert text in recorder.words.replace("\n", " ")
    assert recorder.props == ["words", "slot", "seed", "probe"]
    assert describe_words(words)[0] == icon
    select(add_plane())
    with pytest.raises(RuntimeError, match="Say a stroke in words"):
        bpy.ops.hnf.stroke_add(words=" ", dialog=True)


def test_a_new_stroke_uses_the_active_surface_and_a_given_slot():
    plane = add_plane()
    add_plane("Other").location.x = 1.0
    select(plane)
    bpy.ops.hnf.stroke_add()
    assert bpy.context.view_layer.objects.active != plane
    bpy.ops.hnf.stroke_add(slot=0)
    assert [obj.parent for obj in list_strokes(bpy.context.scene)] == [plane, plane]
    with pytest.raises(RuntimeError, match="has no material slot 3"):
        bpy.ops.hnf.stroke_add(slot=3)


def test_a_new_stroke_is_seen_though_the_collection_was_hidden():
    select(add_plane())
    bpy.ops.hnf.stroke_add()
    (layer,) = bpy.context.view_layer.layer_collection.children
    for hide in ("exclude", "hide_viewport"):
        setattr(layer, hide, True)
        select(bpy.data.objects["Plane"])
        assert bpy.ops.hnf.stroke_add() == {"FINISHED"}
        assert not getattr(layer, hide)
        stroke = bpy.context.view_layer.objects.active
        assert stroke.hnf_stroke.is_stroke
        assert stroke.visible_get()
        assert stroke.select_get()


def test_nothing_to_touch_says_so():
    with pytest.raises(RuntimeError, match="Select the mesh"):
        bpy.ops.hnf.stroke_add()


def test_a_curve_becomes_a_stroke():
    add_plane()
    line, other = add_stroke(LINE, name="Line"), add_stroke([(0, 0, 0), (0, 0.03, 0)], name="Other")
    two = add_stroke(LINE, name="Two")
    two.data.splines.new("POLY").points.add(1)
    for obj in (line, other, two):
        obj.hnf_stroke.is_stroke = False
    bpy.context.scene.frame_set(5)
    select(two, line, other)
    assert bpy.ops.hnf.stroke_from_curve(speed_mm_s=40.0) == {"FINISHED"}
    assert [obj.name for obj in list_strokes(bpy.context.scene)] == ["Line", "Other"]
    assert act(line)[3].speed.max() == pytest.approx(0.04, rel=1e-3)
    assert get_active_stroke(bpy.context) == other
    assert line.hnf_stroke.start == 5.0
    line["hnf_bake"] = b"a bake"
    assert bpy.ops.hnf.stroke_to_curve(name="Line") == {"FINISHED"}
    assert bpy.ops.hnf.stroke_delete(name="Other") == {"FINISHED"}  # the artist's own curve
    assert list_strokes(bpy.context.scene) == []
    assert other.name == "Other"
    assert "hnf_bake" not in line
    select(line, other)
    assert bpy.ops.hnf.stroke_from_curve() == {"FINISHED"}
    select(line)
    with pytest.raises(RuntimeError, match="not a stroke yet"):
        bpy.ops.hnf.stroke_from_curve()
    select(two)
    assert bpy.ops.hnf.stroke_from_curve() == {"CANCELLED"}
    assert not two.hnf_stroke.is_stroke


def test_delete_takes_curve_and_keys_along():
    select(add_plane())
    before = datablock_names()
    bpy.ops.hnf.stroke_add()
    first = get_active_stroke(bpy.context).name
    bpy.ops.hnf.stroke_add(primitive="rub-slow")
    second = get_active_stroke(bpy.context)
    assert bpy.ops.hnf.stroke_delete(name=first) == {"FINISHED"}
    assert list_strokes(bpy.context.scene) == [second]
    assert get_active_stroke(bpy.context) == second
    assert bpy.ops.hnf.stroke_delete() == {"FINISHED"}
    after = datablock_names()
    after["collections"].remove("Touch strokes")
    assert after == before
    with pytest.raises(RuntimeError, match="no stroke yet"):
        bpy.ops.hnf.stroke_delete()


def test_a_stroke_is_not_pulled_from_under_its_edit():
    select(add_plane())
    bpy.ops.hnf.stroke_add()
    stroke = get_active_stroke(bpy.context)
    select(stroke)
    bpy.ops.object.mode_set(mode="EDIT")
    for work in (bpy.ops.hnf.stroke_delete, bpy.ops.hnf.stroke_duplicate):
        with pytest.raises(RuntimeError, match="Object Mode"):
            work()
    assert list_strokes(bpy.context.scene) == [stroke]
    assert stroke.mode == "EDIT"
    bpy.ops.object.mode_set(mode="OBJECT")
    assert bpy.ops.hnf.stroke_delete() == {"FINISHED"}


def test_duplicate_has_keys_of_its_own():
    select(add_plane())
    bpy.ops.hnf.stroke_add()
    stroke = get_active_stroke(bpy.context)
    before = read(stroke).samples
    assert bpy.ops.hnf.stroke_duplicate() == {"FINISHED"}
    copy = get_active_stroke(bpy.context)
    assert copy != stroke
    assert copy.data != stroke.data
    assert copy.animation_data.action != stroke.animation_data.action
    assert copy.users_collection == stroke.users_collection
    again = read(copy).samples
    assert np.array_equal(again.force, before.force)
    assert np.array_equal(again.point, before.point)
    for point in curve(copy, "force").keyframe_points:
        point.co[1] = 0.25
    copy.data.splines[0].bezier_points[0].co.x += 0.01
    assert np.array_equal(read(stroke).samples.force, before.force)
    assert np.array_equal(read(stroke).samples.point, before.point)


def test_select_and_add_to_the_selection():
    add_plane()
    one, two = add_stroke(LINE, name="One"), add_stroke(LINE, name="Two")
    bpy.ops.hnf.stroke_select(name="One")
    assert (get_active_stroke(bpy.context), bpy.context.selected_objects) == (one, [one])
    bpy.ops.hnf.stroke_select(name="Two", extend=True)
    assert get_active_stroke(bpy.context) == two
    assert set(bpy.context.selected_objects) == {one, two}
    with pytest.raises(RuntimeError, match="no stroke 'Plane'"):
        bpy.ops.hnf.stroke_select(name="Plane")


def test_a_linked_stroke_is_not_mistaken_for_the_one_of_its_name(tmp_path):
    linked = add_stroke(LINE, name="One")
    library = str(tmp_path / "library.blend")
    bpy.data.libraries.write(library, {linked})
    with bpy.data.libraries.load(library, link=True) as (_, wanted):
        wanted.objects = ["One"]
    own, linked = linked, wanted.objects[0]
    bpy.context.scene.collection.objects.link(linked)
    assert (find_namesake(bpy.context.scene, own), find_namesake(bpy.context.scene, linked)) == (linked, own)
    for stroke in (linked, own):
        assert bpy.ops.hnf.stroke_select(name=stroke.name_full) == {"FINISHED"}
        assert get_active_stroke(bpy.context) == stroke == bpy.context.scene.objects[bpy.context.scene.hnf.stroke_index]
    select(linked)
    with pytest.raises(RuntimeError, match=r"'One': it is linked from library\.blend"):
        bpy.ops.hnf.stroke_delete()
    assert {obj.name_full for obj in list_strokes(bpy.context.scene)} == {"One", "One [library.blend]"}
    assert bpy.ops.hnf.stroke_delete(name="One") == {"FINISHED"}
    assert list_strokes(bpy.context.scene) == [linked]


def test_solo_and_back():
    add_plane()
    strokes = [add_stroke(LINE, name=name) for name in ("A", "B", "C")]
    strokes[2].hnf_stroke.mute = True
    bpy.ops.hnf.stroke_solo(name="C")
    assert [obj.name for obj in list_strokes(bpy.context.scene)] == ["C"]
    bpy.ops.hnf.stroke_solo(name="A")
    assert [obj.name for obj in list_strokes(bpy.context.scene)] == ["A"]
    bpy.ops.hnf.stroke_solo(name="A")
    assert [obj.name for obj in list_strokes(bpy.context.scene)] == ["A", "B", "C"]


def test_key_force_at_the_playhead():
    add_plane()
    stroke = add_stroke(LINE, speed_mm_s=10.0)
    select(stroke)
    for frame, force in ((1, 0.5), (12.5, 2.0), (30, 1.0)):
        bpy.context.scene.frame_set(int(frame), subframe=frame % 1)
        assert bpy.ops.hnf.stroke_key_force(force_n=force) == {"FINISHED"}
    assert keys_of(stroke) == [(1.0, 0.5), (12.5, 2.0), (30.0, 1.0)]
    stroke.hnf_stroke.force = 1.75
    bpy.ops.hnf.stroke_key_force()
    assert keys_of(stroke)[-1] == (30.0, 1.75)
    assert act(stroke)[3].force.max() == pytest.approx(2.0, abs=0.05)


def test_a_stroke_begun_later_feels_the_same():
    """Its keys go along, handles too, and those of a stroke that shared them stay."""
    add_plane()
    stroke = add_stroke(LINE, start=3.0)
    key(stroke, "force", (3, 0.5), (8, 2.0), (15, 0.2))
    key(stroke, "progress", (3, 0.0), (6, 0.7), (15, 1.0))
    twin = stroke.copy()
    bpy.context.scene.collection.objects.link(twin)
    select(stroke)
    before = read(stroke).samples
    assert bpy.ops.hnf.stroke_move(frame=50.5) == {"FINISHED"}
    assert stroke.hnf_stroke.start == 50.5
    assert keys_of(stroke) == [(50.5, 0.5), (55.5, 2.0), (62.5, 0.2)]
    for each in (stroke, twin):
        assert np.allclose(read(each).samples.force, before.force, atol=1e-4)
        assert np.allclose(read(each).samples.point, before.point, atol=1e-6)
    stroke.animation_data.nla_tracks.new().strips.new("Held", 1, stroke.animation_data.action)
    with pytest.raises(RuntimeError, match="in the NLA"):
        bpy.ops.hnf.stroke_move(frame=1.0)
    assert stroke.hnf_stroke.start == 50.5


def given_and_taken():
    add_plane()
    given, taken = add_stroke(LINE, name="Given", speed_mm_s=60.0), add_stroke(LINE, name="Taken", speed_mm_s=30.0)
    key(given, "force", (1, 0.5), (13, 2.0), (25, 1.0))
    taken.hnf_stroke.start = 11.0
    key(taken, "force", (11, 0.1), (12, 0.2), (13, 0.3), (14, 0.4))
    select(taken, given)
    return given, taken


def test_copy_force_to_the_same_seconds():
    given, taken = given_and_taken()
    curve(given, "force").keyframe_points[1].interpolation = "LINEAR"
    assert bpy.ops.hnf.stroke_copy_force(fit_time=False) == {"FINISHED"}
    assert keys_of(taken) == [(11.0, 0.5), (23.0, 2.0), (35.0, 1.0)]
    a, b = read(given).samples, read(taken).samples
    assert np.allclose(a.force, b.force[: len(a.force)], atol=1e-5)


def test_copy_force_fitted_to_the_duration():
    given, taken = given_and_taken()
    assert bpy.ops.hnf.stroke_copy_force() == {"FINISHED"}
    a, b = read(given).samples, read(taken).samples
    share = np.linspace(0.0, 1.0, 50)
    seconds = [0.06 / speed + 0.1 for speed in (0.06, 0.03)]
    ours, theirs = (
        np.interp(share * total, samples.time, samples.force) for total, samples in zip(seconds, (a, b), strict=True)
    )
    assert np.allclose(ours, theirs, atol=0.02)


def test_copy_a_force_that_is_not_keyed():
    given, taken = given_and_taken()
    given.animation_data_clear()
    given.hnf_stroke.force = 1.25
    bpy.ops.hnf.stroke_copy_force()
    assert np.allclose(read(taken).samples.force, 1.25)


def test_copy_needs_somebody_to_take_it():
    given, _ = given_and_taken()
    select(given)
    with pytest.raises(RuntimeError, match="Select the strokes to copy the force to"):
        bpy.ops.hnf.stroke_copy_force()


def test_the_force_graph_needs_a_window():
    select(add_stroke(LINE))
    with pytest.raises(RuntimeError, match="needs a window"):
        bpy.ops.hnf.force_graph()


def test_the_force_graph_is_cancelled_in_a_full_screen_view():

    from hnf_blender.ops.force_ops import HNF_OT_force_graph

    add_plane()
    stroke, told = add_stroke(LINE), []
    select(stroke)
    view = SimpleNamespace(ui_type="VIEW_3D", type="VIEW_3D", width=1600, height=900)
    window = SimpleNamespace(screen=SimpleNamespace(areas=[view], show_fullscreen=True))
    context = SimpleNamespace(window=window, scene=bpy.context.scene, view_layer=bpy.context.view_layer)
    operator = SimpleNamespace(report=lambda kind, words: told.append(words))
    assert HNF_OT_force_graph.execute(operator, context) == {"CANCELLED"}
    assert "Ctrl Space" in told[0]
    assert view.ui_type == "VIEW_3D"
    assert not keyed_fcurves(stroke)


def test_a_force_that_is_not_keyed_gets_two_keys_for_the_graph():
    from hnf_blender.bridge.stroke.edit_keyframes import ensure_force_keys

    add_plane()
    stroke = add_stroke(LINE, speed_mm_s=60.0, force=1.5, start=3.0)
    ensure_force_keys(stroke, bpy.context.scene, 1.0)
    assert keys_of(stroke) == [(3.0, 1.5), (pytest.approx(3.0 + 24 * 1.1), 1.5)]
    ensure_force_keys(stroke, bpy.context.scene, 1.0)
    assert len(keys_of(stroke)) == 2


def test_the_overlay_follows_the_force_and_the_playhead():
    from hnf_blender.tool.overlay_drawing import compute_overlay_path
    from hnf_core.export.figure import force_to_colour

    plane = add_plane()
    stroke = add_stroke(LINE, speed_mm_s=60.0, surface=plane)
    key(stroke, "force", (1, 0.5), (25, 2.0))
    stroke.location.y = 0.02
    bpy.context.view_layer.update()
    path = compute_overlay_path(stroke, bpy.context.scene, bpy.context.evaluated_depsgraph_get(), 1.0)
    assert np.allclose(path.points[[0, -1]], LINE, atol=1e-5)
    assert np.allclose(path.colours[0], force_to_colour(0.5))
    assert np.allclose(path.colours[-1], force_to_colour(2.0), atol=0.02)
    assert (path.frames[0], path.forces[0]) == (1.0, pytest.approx(0.5))
    arms = path.ticks.reshape(-1, 2, 2, 3)
    assert np.allclose(arms[..., 2], 0.0, atol=1e-6)  # they lie on the plane
    assert (arms[:, 0, 1, 0] > arms[:, 0, 0, 0]).all()  # and point where the hand goes
    stroke.data.splines.new("POLY").points.add(1)
    assert compute_overlay_path(stroke, bpy.context.scene, bpy.context.evaluated_depsgraph_get(), 1.0) is None


def test_a_stroke_too_fast_for_a_hand_is_made_constant():
    """Its force keys are stretched with it."""
    from hnf_blender.bridge.stroke.read_stroke import sample_timeline

    add_plane()
    stroke = add_stroke(LINE)
    key(stroke, "progress", (1.0, 0.0), (1.5, 1.0))
    key(stroke, "force", (1.0, 0.5), (1.5, 2.0))
    bpy.context.view_layer.objects.active = stroke
    assert bpy.ops.hnf.stroke_constant(speed_mm_s=60.0) == {"FINISHED"}
    timeline = sample_timeline(stroke, bpy.context.scene, 1.0)
    fps = bpy.context.scene.render.fps
    speed = np.gradient(timeline.position) / np.gradient(timeline.frames) * fps
    assert np.median(speed) == pytest.approx(0.06, rel=0.02)
    assert (timeline.force[0], timeline.force[-1]) == (pytest.approx(0.5), pytest.approx(2.0, abs=0.05))


def test_a_stroke_begins_where_the_last_one_has_ended() -> None:
    """Muted strokes and its own end do not count, and the keys move along."""
    plane, scene = add_plane(), bpy.context.scene
    first, second, last = (add_stroke(LINE, name=name, surface=plane) for name in "ABC")
    first.hnf_stroke.start, second.hnf_stroke.start, second.hnf_stroke.mute = 11.0, 500.0, True
    key(last, "force", (1, 1.0), (9, 2.0))
    select(last)
    end = get_motion_end(first, scene, 1.0)
    for _ in range(2):
        assert bpy.ops.hnf.stroke_after_last() == {"FINISHED"}
        assert end <= last.hnf_stroke.start < end + 1.0
        assert keys_of(last)[0][0] == last.hnf_stroke.start
    bpy.data.objects.remove(first)
    assert bpy.ops.hnf.stroke_after_last() == {"CANCELLED"}


def test_strokes_of_a_deleted_surface_are_deleted_together() -> None:
    plane, other = add_plane(), add_plane()
    gone = [add_stroke(LINE, name=name, surface=plane) for name in "AB"]
    free, own = add_stroke(LINE, name="D"), add_stroke(LINE, name="E", surface=plane, was_curve=True)
    add_stroke(LINE, name="C", surface=other)
    assert not bpy.ops.hnf.strokes_delete_orphans.poll()
    curves = {obj.data.name for obj in gone}
    select(plane)
    assert bpy.ops.object.delete() == {"FINISHED"}
    assert bpy.ops.hnf.strokes_delete_orphans() == {"FINISHED"}
    assert sorted(obj.name for obj in list_strokes(bpy.context.scene)) == ["C", "D"]
    assert not own.hnf_stroke.is_stroke
    assert free.hnf_stroke.is_stroke
    assert not curves & {curve.name for curve in bpy.data.curves}
    assert not bpy.ops.hnf.strokes_delete_orphans.poll()
