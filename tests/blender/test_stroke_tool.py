"""Drawing a stroke without a window, by the operator with simulated pen events."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from builders import add_plane, add_sphere, datablock_names
from stroke_builders import act, keyed_fcurves, read

from hnf_blender.bridge.viewport_pick import cast_on_surface
from hnf_blender.props.scene_settings import get_active_stroke
from hnf_core.action.pen_stroke import FORCE_TOLERANCE_N, PATH_TOLERANCE_M, PROGRESS_TOLERANCE_M


@pytest.fixture(autouse=True, scope="module")
def operators():
    from hnf_blender.ops import draw_ops as draw

    already = hasattr(bpy.types, "HNF_OT_stroke_draw")
    if not already:
        for each in draw.CLASSES:
            bpy.utils.register_class(each)
    yield
    if not already:
        for each in reversed(draw.CLASSES):
            bpy.utils.unregister_class(each)


def samples(points, seconds=1.0, pressure=1.0, touching=True):
    n = len(points)
    time, press, on = np.linspace(0.0, seconds, n), np.broadcast_to(pressure, n), np.broadcast_to(touching, n)
    return [
        {"name": "", "location": tuple(point), "pressure": float(p), "time": float(t), "touching": bool(o)}
        for point, p, t, o in zip(np.asarray(points, dtype=float).tolist(), press, time, on, strict=True)
    ]


def line(n=61, start=(-0.03, 0.0, 0.0), end=(0.03, 0.01, 0.0)):
    return np.linspace(start, end, n)


def draw(stroke, **settings):
    assert bpy.ops.hnf.stroke_draw("EXEC_DEFAULT", stroke=stroke, **settings) == {"FINISHED"}
    return get_active_stroke(bpy.context)


def fcurves(obj):
    return {curve.data_path.split(".")[-1]: curve for curve in keyed_fcurves(obj)}


def test_it_becomes_a_stroke_on_the_surface():
    plane = add_plane("Cloth")
    scene = bpy.context.scene
    scene.frame_set(12)
    obj = draw(samples(line()))
    assert obj.name == "Stroke on Cloth"
    assert obj.hnf_stroke.is_stroke
    assert (obj.parent, obj.hnf_stroke.surface) == (plane, plane)
    assert [collection.name for collection in obj.users_collection] == ["Touch strokes"]
    assert bpy.context.view_layer.objects.active == obj
    assert bpy.context.selected_objects == [obj]
    assert scene.objects[scene.hnf.stroke_index] == obj
    assert obj.hnf_stroke.start == 12.0
    second = draw(samples(line(end=(0.0, 0.04, 0.0))))
    assert second.users_collection == obj.users_collection
    assert scene.objects[scene.hnf.stroke_index] == second


@pytest.mark.parametrize(("fps", "base"), [(24, 1.0), (30, 1.001)])
def test_the_hand_is_where_it_was_when_it_was(fps, base):
    add_plane("Cloth", size=0.2)
    scene = bpy.context.scene
    scene.render.fps, scene.render.fps_base = fps, base
    t = np.linspace(0.0, 2.0, 241)
    points = np.stack([0.05 * np.sin(2.0 * t), 0.03 * np.cos(3.0 * t), 0.0 * t], axis=1)
    pressure = 0.5 + 0.3 * np.sin(4.0 * t)
    obj = draw(samples(points, 2.0, pressure), force_min_n=0.0, force_max_n=2.0, smoothing_ms=0.0)
    stroke = read(obj)
    assert stroke.motion_profile == "PROGRESS"
    at = [np.interp(stroke.samples.time, t, points[:, axis]) for axis in range(3)]
    off = np.linalg.norm(stroke.samples.point - np.stack(at, axis=1), axis=1)
    assert off.max() <= 2.0 * PATH_TOLERANCE_M + PROGRESS_TOLERANCE_M + 3e-4
    assert np.abs(stroke.samples.force - np.interp(stroke.samples.time, t, 2.0 * pressure)).max() < (
        FORCE_TOLERANCE_N + 5e-3
    )
    assert stroke.samples.time[-1] == pytest.approx(2.0, abs=0.01)
    keys = fcurves(obj)
    assert len(keys["progress"].keyframe_points) < 30
    assert len(keys["force"].keyframe_points) < 20
    assert len(obj.data.splines[0].bezier_points) < 30


def test_a_mouse_presses_evenly_with_two_keys():
    add_plane()
    obj = draw(samples(line()), force_n=1.5)
    assert np.allclose(act(obj)[3].force, 1.5, atol=1e-4)
    assert len(fcurves(obj)["force"].keyframe_points) == 2


def test_constant_speed_is_a_setting_to_change_later():
    add_plane()
    obj = draw(samples(line()), timing="SPEED", speed_mm_s=50.0)
    stroke = read(obj)
    assert stroke.motion_profile == "SPEED"
    assert "progress" not in fcurves(obj)
    assert stroke.samples.velocity.max() == pytest.approx(0.05, rel=1e-3)
    assert fcurves(obj)["force"].range()[1] == pytest.approx(1.0 + 24.0 * stroke.samples.time[-1], abs=0.2)


def test_on_a_turned_scaled_ball_in_centimetres():
    ball = add_sphere("Ball", radius=5.0)
    ball.location, ball.rotation_euler, ball.scale = (10.0, 20.0, 5.0), (0.3, 0.2, 1.0), (1.0, 1.2, 0.8)
    bpy.context.scene.unit_settings.scale_length = 0.01
    bpy.context.view_layer.update()
    angle = np.linspace(0.4, 1.4, 80)
    local = 5.0 * np.stack([np.cos(angle), np.sin(angle), 0.2 + 0.0 * angle], axis=1)
    world = np.array(ball.matrix_world)
    obj = draw(samples(local @ world[:3, :3].T + world[:3, 3]), surface="Ball")
    stroke, contacts, _, action = act(obj, 0.01)
    assert contacts.distance.max() < 3e-4
    assert action.contact.all()
    assert 0.04 < stroke.length_m < 0.07
    before = stroke.samples.point
    ball.location.x += 3.0
    bpy.context.view_layer.update()
    assert np.allclose(act(obj, 0.01)[0].samples.point, before, atol=1e-6)


def test_the_nearest_mesh_is_taken_where_none_is_named():
    add_plane("Far", z=-0.05)
    near = add_plane("Near")
    assert draw(samples(line())).parent == near


def test_off_the_surface_it_is_silent():
    add_plane()
    touching = np.ones(121, dtype=bool)
    touching[50:70] = False
    obj = draw(samples(line(121), 2.0, touching=touching))
    action = act(obj)[3]
    assert 0.1 < np.mean(action.force < 2.0 * FORCE_TOLERANCE_N) < 0.25
    beyond = draw(samples(line(121, end=(0.09, 0.0, 0.0)), 2.0))
    assert act(beyond)[3].contact.all()
    assert act(beyond)[1].point[:, 0].max() < 0.0551


@pytest.mark.parametrize(
    ("stroke", "words"),
    [
        (samples(line(end=(-0.0299, 0.0, 0.0))), "shorter than 0.5 mm"),
        (samples(line()[:1]), "shorter than 0.5 mm"),
        ([], "Nothing was drawn"),
        (samples(line(), touching=False), "touches no surface"),
        (samples(np.full((5, 3), np.nan)), "not a number|no surface"),
    ],
)
def test_what_is_no_stroke_says_so_and_leaves_nothing(stroke, words):
    add_plane()
    before = datablock_names()
    with pytest.raises(RuntimeError, match=words):
        bpy.ops.hnf.stroke_draw("EXEC_DEFAULT", stroke=stroke, surface="Plane")
    assert datablock_names() == before


def test_a_surface_that_cannot_be_touched_is_named():
    add_plane("Ghost").hide_render = True
    with pytest.raises(RuntimeError, match="'Ghost': it is hidden in renders"):
        bpy.ops.hnf.stroke_draw("EXEC_DEFAULT", stroke=samples(line()), surface="Ghost")
    for how in ("hide_viewport", "eye"):
        plane = add_plane(f"Unseen {how}")
        plane.hide_set(True) if how == "eye" else setattr(plane, how, True)
        with pytest.raises(RuntimeError, match=f"'{plane.name}': it is hidden"):
            bpy.ops.hnf.stroke_draw("EXEC_DEFAULT", stroke=samples(line()), surface=plane.name)
    with pytest.raises(RuntimeError, match="no such mesh"):
        bpy.ops.hnf.stroke_draw("EXEC_DEFAULT", stroke=samples(line()), surface="Nobody")


def test_only_in_object_mode():
    plane = add_plane()
    bpy.context.view_layer.objects.active = plane
    bpy.ops.object.mode_set(mode="EDIT")
    with pytest.raises(RuntimeError, match="Object Mode"):
        bpy.ops.hnf.stroke_draw("EXEC_DEFAULT", stroke=samples(line()))
    bpy.ops.object.mode_set(mode="OBJECT")


def test_one_undo_step_takes_it_away():
    add_plane()
    bpy.ops.ed.undo_push(message="before")
    draw(samples(line()))
    bpy.ops.ed.undo_push(message="drawn")
    bpy.ops.ed.undo()
    assert [obj.name for obj in bpy.data.objects] == ["Plane"]
    bpy.ops.ed.redo()
    assert read(bpy.data.objects["Stroke on Plane"]).length_m > 0.06


def ray(at=(0.0, 0.0, 1.0), way=(0.0, 0.0, -1.0)):
    from mathutils import Vector

    return cast_on_surface(bpy.context.scene, bpy.context.evaluated_depsgraph_get(), None, Vector(at), Vector(way))


def test_rays_meet_what_a_person_sees():
    add_plane("Floor")
    glass = add_plane("Glass", z=0.1)
    assert ray().obj.name == "Glass"
    assert ray().world == pytest.approx([0.0, 0.0, 0.1])
    glass.display_type = "WIRE"
    bpy.context.view_layer.update()
    assert ray().obj.name == "Floor"
    glass.display_type = "TEXTURED"
    glass.hide_set(True)
    bpy.context.view_layer.update()
    assert ray().obj.name == "Floor"
    assert ray(at=(1.0, 0.0, 1.0)) is None


def test_rays_pass_through_instances():
    add_plane("Floor")
    group = bpy.data.collections.new("Group")
    lid = add_plane("Lid", z=0.1)
    bpy.context.scene.collection.objects.unlink(lid)
    group.objects.link(lid)
    empty = bpy.data.objects.new("Empty", None)
    empty.instance_type, empty.instance_collection = "COLLECTION", group
    bpy.context.scene.collection.objects.link(empty)
    bpy.context.view_layer.update()
    assert ray().obj.name == "Floor"


def test_the_tools_icon_is_one():
    from hnf_blender.tool import stroke_tool

    assert stroke_tool.ICON.with_suffix(".stroke.dat").is_file()
    assert bpy.app.icons.new_triangles_from_file(str(stroke_tool.ICON) + ".dat") > 0


class Desk:
    """A 3D view of 200 × 200 pixels, straight down on 200 × 200 mm, and the events that its window would send."""

    def __init__(self):
        from types import SimpleNamespace as Plain

        from mathutils import Matrix

        view, window = Matrix.Translation((0.0, 0.0, -1.0)), Matrix.Diagonal((10.0, 10.0, -0.1, 1.0))
        view_of = Plain(
            view_matrix=view, window_matrix=window, perspective_matrix=window @ view, is_perspective=False,
            view_perspective="ORTHO",
        )  # fmt: skip
        self.region = Plain(type="WINDOW", x=0, y=0, width=200, height=200, data=view_of)
        area = Plain(type="VIEW_3D", regions=[self.region], spaces=Plain(active=None), tag_redraw=lambda: None)
        screen = Plain(areas=[area])
        self.context = Plain(
            scene=bpy.context.scene,
            mode="OBJECT",
            view_layer=bpy.context.view_layer,
            evaluated_depsgraph_get=bpy.context.evaluated_depsgraph_get,
            window=Plain(screen=screen),
            window_manager=Plain(windows=[Plain(screen=screen)]),
            workspace=Plain(status_text_set=lambda text: None),
        )

    def event(self, x, y, kind="MOUSEMOVE", pressure=None):
        from types import SimpleNamespace as Plain

        tablet = pressure is not None
        return Plain(type=kind, mouse_x=x, mouse_y=y, is_tablet=tablet, pressure=pressure if tablet else 1.0)


@pytest.fixture
def desk():
    return Desk()


@pytest.fixture
def pen(desk):
    from hnf_blender.ops.pen import Pen

    pen = Pen(desk.context, lambda pressure, is_pen: pressure)
    yield pen
    pen.close(desk.context)


def press(pen, desk, x, y, **how):
    return pen.press(desk.context, desk.event(x, y, **how), desk.region)


def test_what_is_seen_and_no_surface_is_named_with_a_way_out(pen, desk):
    group = bpy.data.collections.new("Group")
    lid = add_plane("Lid", z=0.1)
    bpy.context.scene.collection.objects.unlink(lid)
    group.objects.link(lid)
    empty = bpy.data.objects.new("Asset", None)
    empty.instance_type, empty.instance_collection = "COLLECTION", group
    bpy.context.scene.collection.objects.link(empty)
    bpy.context.view_layer.update()
    assert not press(pen, desk, 100, 100)
    assert pen.reject_reason.startswith("'Asset' shows instances")
    empty.hide_viewport = True
    line = bpy.data.curves.new("Line", "CURVE")
    line.bevel_depth = 0.02
    line.splines.new("POLY").points.add(1)
    line.splines[0].points[1].co = (0.05, 0.0, 0.0, 1.0)
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("Hose", line))
    bpy.context.view_layer.update()
    assert not press(pen, desk, 110, 100)
    assert pen.reject_reason.startswith("'Hose' is not a mesh")


def test_the_pen_follows_the_surface_and_detects_leaving_it(pen, desk):
    add_plane("Cloth")
    assert not press(pen, desk, 10, 100)
    assert "No mesh under the pen" in pen.reject_reason
    assert press(pen, desk, 100, 100)
    assert pen.is_click
    pen.move(desk.context, desk.event(180, 100))
    pen.move(desk.context, desk.event(100, 140))
    assert not pen.is_click
    assert pen.surface == "Cloth"
    found = pen.samples(desk.context)
    points, _, times, touching = (np.array(each) for each in zip(*found, strict=True))
    assert np.allclose(points[0], 0.0, atol=1e-6)
    assert np.allclose(points[-1], [0.0, 0.04, 0.0], atol=1e-6)
    assert points[:, 0].max() == pytest.approx(0.05, abs=0.004)
    assert touching[[0, -1]].all()
    assert not touching.all()
    assert times[0] == 0.0
    assert (np.diff(times) >= 0.0).all()
    steps = np.linalg.norm(np.diff(points[: touching.argmin()], axis=0), axis=1)
    assert steps.max() < 0.0041  # rays every four pixels, though the mouse jumped


def test_events_in_between_share_the_time(pen, desk):
    add_plane()
    press(pen, desk, 80, 100)
    for x in (82, 84, 86):
        pen.move(desk.context, desk.event(x, 100, "INBETWEEN_MOUSEMOVE"))
    assert len(pen.samples(desk.context)) == 1
    pen.move(desk.context, desk.event(88, 100))
    points, _, times, _ = (np.array(each) for each in zip(*pen.samples(desk.context), strict=True))
    assert np.allclose(points[:, 0], [-0.02, -0.018, -0.016, -0.014, -0.012], atol=1e-6)
    assert np.allclose(np.diff(times), times[-1] / 4.0)


def test_a_pen_that_tells_of_itself_late_and_not_at_the_release(pen, desk):
    add_plane()
    press(pen, desk, 80, 100)
    pen.move(desk.context, desk.event(82, 100, pressure=0.4))
    pen.move(desk.context, desk.event(84, 100, pressure=0.6))
    pen.move(desk.context, desk.event(86, 100))
    assert [round(sample[1], 6) for sample in pen.samples(desk.context)] == [0.4, 0.4, 0.6, 0.6]


def test_the_tool_polls_true_only_in_object_mode_over_a_view():
    from types import SimpleNamespace

    from hnf_blender.ops.draw_ops import HNF_OT_stroke_tool

    told = []

    def may(mode, area):
        context = SimpleNamespace(mode=mode, area=area and SimpleNamespace(type=area))
        return HNF_OT_stroke_tool.poll.__func__(SimpleNamespace(poll_message_set=told.append), context)

    assert may("OBJECT", "VIEW_3D")
    assert told == []
    assert [may("EDIT_MESH", "VIEW_3D"), may("OBJECT", "TEXT_EDITOR"), may("OBJECT", None)] == [False] * 3
    assert "Object Mode" in told[0]
    assert "3D view" in told[1]


class Clock:
    """Time as the pen reads it."""

    def __init__(self, monkeypatch) -> None:
        from hnf_blender.ops import pen

        self.now = 100.0
        monkeypatch.setattr(pen.time, "perf_counter", lambda: self.now)


def speeds(pen, desk):
    """Along a drag over the view, of the samples that moved [m/s]."""
    points, _, times, _ = (np.array(each) for each in zip(*pen.samples(desk.context), strict=True))
    moved = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return moved[moved > 0.0] / np.maximum(np.diff(times)[moved > 0.0], 1e-9)


@pytest.mark.parametrize("interval", [0.008, 0.03])
@pytest.mark.parametrize("batch", [1, 7, 25])
def test_how_long_a_view_is_redrawn_changes_no_speed(pen, desk, monkeypatch, interval, batch):
    """A hand at 100 mm/s; events wait while the view is redrawn, and come in one batch."""
    add_plane("Cloth", 0.4)
    clock = Clock(monkeypatch)
    assert press(pen, desk, 20, 100)
    begun = clock.now
    for first in range(1, 51, batch):
        pen._drawn = begun + (first + batch - 1.5) * interval  # what Blender's draw call notes
        clock.now = begun + (first + batch - 1) * interval
        for k in range(first, first + batch):
            kind = "MOUSEMOVE" if k == first + batch - 1 else "INBETWEEN_MOUSEMOVE"
            pen.move(desk.context, desk.event(20 + 100 * interval * k, 100, kind))
    assert np.allclose(speeds(pen, desk), 0.1, rtol=0.05)


def test_a_whole_drag_in_one_batch_is_no_burst(pen, desk, monkeypatch):
    """Press, ten motions and release within 10 ms, all of which waited: not 18 mm in 0.01 s."""
    add_plane("Cloth", 0.4)
    clock = Clock(monkeypatch)
    assert press(pen, desk, 20, 100)
    for k in range(1, 11):
        clock.now += 0.0002
        pen.move(desk.context, desk.event(20 + 2 * k, 100, "MOUSEMOVE" if k == 10 else "INBETWEEN_MOUSEMOVE"))
    assert speeds(pen, desk).max() < 0.2


def test_a_hand_that_rests_still_rests(pen, desk, monkeypatch):
    add_plane("Cloth", 0.4)
    clock = Clock(monkeypatch)
    assert press(pen, desk, 20, 100)
    for at, x in ((0.1, 40), (1.1, 44), (1.12, 46)):
        clock.now = 100.0 + at
        pen.move(desk.context, desk.event(x, 100))
    _, _, times, _ = (np.array(each) for each in zip(*pen.samples(desk.context), strict=True))
    assert np.diff(times).max() == pytest.approx(1.0 - 1.0 / 60.0, abs=0.02)


def test_the_shortest_stroke_is_drawn_too():
    """What plays is seen: 10 ms are more than a step of the action, and less than one of the overlay."""
    from hnf_blender.bridge.stroke.read_stroke import read_stroke, sample_timeline

    add_plane("Cloth")
    curve = bpy.data.curves.new("Flick", "CURVE")
    curve.dimensions = "3D"
    curve.splines.new("POLY").points.add(1)
    curve.splines[0].points[1].co = (0.02, 0.0, 0.0, 1.0)
    obj = bpy.data.objects.new("Flick", curve)
    bpy.context.scene.collection.objects.link(obj)
    obj.hnf_stroke.is_stroke, obj.hnf_stroke.law, obj.hnf_stroke.duration_s = True, "DURATION", 0.01
    bpy.context.view_layer.update()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    assert len(read_stroke(obj, bpy.context.scene, depsgraph, 1.0).samples.time) == 3
    assert len(sample_timeline(obj, bpy.context.scene, 1.0).frames) >= 2


def add_tile(name, x, z=0.0, size=0.06):
    """A square around (x, 0, z)."""
    tile = add_plane(name, size, z=0.0)
    tile.location = (x, 0.0, z)
    bpy.context.view_layer.update()
    return tile


def drag(pen, desk, *places):
    """Press at the first place and move to the others; return what the operator is given."""
    assert press(pen, desk, *places[0])
    for place in places[1:]:
        pen.move(desk.context, desk.event(*place))
    points, _, times, touching = zip(*pen.samples(desk.context), strict=True)
    # At a steady pace: these events have come at once.
    given = samples(points, 1.0, touching=np.array(touching))
    assert times == tuple(sorted(times))
    return [{**each, "name": name} for each, name in zip(given, pen.touched, strict=True)]


def test_a_stroke_over_several_objects_feels_each(pen, desk):
    """From one tile over the seam to the next: no surface of its own, and one step of undo."""
    left = add_tile("Left", -0.03)
    add_tile("Right", 0.03, z=-1e-4)
    bpy.ops.ed.undo_push(message="before")
    obj = draw(drag(pen, desk, (60, 100), (150, 110)), surface=pen.surface, smoothing_ms=0.0)
    assert obj.hnf_stroke.surface is None
    assert obj.name == "Stroke across Left, Right"
    assert obj.parent == left
    stroke = read(obj)
    assert {stroke.object_name, *(each.name for each in stroke.crossed)} == {"Left", "Right"}
    assert stroke.length_m == pytest.approx(0.09, abs=0.003)
    world = np.array(obj.matrix_world)
    knots = np.array([point.co for point in obj.data.splines[0].bezier_points]) @ world[:3, :3].T + world[:3, 3]
    assert knots[0] == pytest.approx([-0.04, 0.0, 0.0], abs=1e-5)
    assert knots[-1] == pytest.approx([0.05, 0.01, -1e-4], abs=1e-5)
    assert act(obj)[3].force.min() > 0.9  # The hand never leaves them.
    bpy.ops.ed.undo_push(message="drawn")
    bpy.ops.ed.undo()
    assert sorted(each.name for each in bpy.data.objects) == ["Left", "Right"]
    bpy.ops.ed.redo()
    assert bpy.data.objects["Stroke across Left, Right"].hnf_stroke.surface is None


def test_beyond_the_edge_of_a_box_the_floor_is_not_meant(pen, desk):
    """A drag goes on over the floor 5 cm below, and never lands on it, however far; another box beside is felt."""
    add_tile("Floor", 0.0, z=-0.05, size=1.0)
    add_tile("Box", -0.06, size=0.04)
    found = drag(pen, desk, (30, 100), (130, 100))
    assert {each["name"] for each in found} == {"Box", ""}
    obj = draw(found, surface=pen.surface)
    assert (obj.name, obj.hnf_stroke.surface.name) == ("Stroke on Box", "Box")
    assert read(obj).length_m == pytest.approx(0.03, abs=0.003)
    add_tile("Lid", 0.06, size=0.04)
    desk.context.scene = bpy.context.scene
    pen.move(desk.context, desk.event(170, 100))
    assert set(pen.touched) == {"Box", "Lid", ""}


def test_what_the_end_of_a_drag_grazes_is_not_meant(pen, desk):
    add_tile("Left", -0.03)
    add_tile("Right", 0.03)
    obj = draw(drag(pen, desk, (50, 100), (103, 100)), surface=pen.surface)
    assert obj.hnf_stroke.surface.name == "Left"
    assert read(obj).length_m == pytest.approx(0.05, abs=0.003)


@pytest.mark.parametrize("moves", ["Left", "Right"])
def test_what_moves_is_not_gone_over_to(pen, desk, moves):
    add_tile("Left", -0.03)
    add_tile("Right", 0.03)
    bpy.data.objects[moves].keyframe_insert("location", frame=1)
    found = drag(pen, desk, (60, 100), (150, 100))
    assert {each["name"] for each in found} == {"Left", ""}
    assert draw(found, surface=pen.surface).hnf_stroke.surface.name == "Left"


def test_sheets_that_a_table_hides_keep_the_first_one(pen, desk):
    """Without a surface the table 0.1 mm below them would be felt (`choose_objects`)."""
    add_tile("Table", 0.0, z=-1e-4, size=0.5)
    add_tile("Left", -0.03, size=0.04)
    add_tile("Right", 0.03, size=0.04)
    obj = draw(drag(pen, desk, (55, 100), (145, 100)), surface=pen.surface)
    assert obj.hnf_stroke.surface.name == "Left"
    assert obj.name == "Stroke on Left"
