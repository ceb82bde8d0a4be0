"""Status updates by handlers: recorded changes, and the cost and result of a check."""

from __future__ import annotations

import bpy
import pytest
from builders import add_plane
from job_scene import PLATE, line_stroke, small_scene

from hnf_blender import handlers, preview
from hnf_blender.jobs import bake_job, manager
from hnf_blender.preview.preview_state import PREVIEW
from hnf_blender.props.object_cache import CHANGES, STROKES
from hnf_blender.props.scene_settings import has_strokes, list_cached_strokes, list_strokes
from hnf_blender.state import interface, status_tracker
from hnf_blender.state.session_state import STATE, suppress_change_tracking
from hnf_blender.state.status_tracker import EVERYTHING, FEW_NAMES, refresh_status
from hnf_blender.touch.bake_status import Freshness, StrokeStatus


@pytest.fixture(autouse=True)
def lone(warm_bake):
    return warm_bake


@pytest.fixture
def noting():
    """Blender tells of changes, as in a window."""
    listed = bpy.app.handlers.depsgraph_update_post
    listed.append(handlers.on_depsgraph_update)
    status_tracker.clear_trackers()
    CHANGES.is_notified = True
    yield
    CHANGES.is_notified = False
    CHANGES.mark_changed()
    listed.remove(handlers.on_depsgraph_update)
    status_tracker.clear_trackers()


def update() -> None:
    bpy.context.view_layer.update()


def baked_scene():
    plate, stroke = small_scene()
    bake_job.bake_blocking(bpy.context.scene, bpy.context.view_layer)
    update()
    STATE.dirty_names.clear()
    return plate, stroke


def drain() -> list[str]:
    """Look until all is known; names of the strokes that were looked at."""
    before = {name: StrokeStatus(Freshness.UNKNOWN, "old") for name in STATE.get_statuses(bpy.context.scene)}
    STATE.get_statuses(bpy.context.scene).update(before)
    for _ in range(100):
        status_tracker.process_changes([(bpy.context.scene, bpy.context.view_layer)])
        if not STATE.dirty_names and all(each.is_idle for each in status_tracker._trackers.values()):
            return sorted(
                name for name, status in STATE.get_statuses(bpy.context.scene).items() if status != before.get(name)
            )
    raise AssertionError("it goes on for ever")


def test_nothing_is_registered_without_a_window() -> None:
    count = [len(getattr(bpy.app.handlers, name)) for name, _ in handlers.HANDLERS]
    handlers.register()
    assert [len(getattr(bpy.app.handlers, name)) for name, _ in handlers.HANDLERS] == count
    assert not bpy.app.timers.is_registered(handlers.tick)
    handlers.unregister()


def test_handlers_only_note_names(noting) -> None:
    plate, _ = small_scene()
    update()
    STATE.dirty_names.clear()
    plate.location.x += 0.1
    update()
    assert PLATE in STATE.dirty_names
    STATE.dirty_names.clear()
    plate.active_material.node_tree.nodes["Principled BSDF"].inputs["Roughness"].default_value = 0.9
    update()
    assert plate.active_material.name in STATE.dirty_names
    assert STATE.get_statuses(bpy.context.scene) == {}


def test_own_changes_are_no_news_and_a_persons_pending_ones_are(noting) -> None:
    plate, stroke = small_scene()
    update()
    STATE.dirty_names.clear()
    stroke.location.x += 0.1  # not told yet
    with suppress_change_tracking(bpy.context.view_layer):
        plate.location.x += 0.1
    assert "Along" in STATE.dirty_names
    assert PLATE not in STATE.dirty_names


def test_a_bake_does_not_make_its_own_mesh_dirty(noting) -> None:
    small_scene()
    update()
    STATE.dirty_names.clear()
    assert bake_job.bake_blocking(bpy.context.scene, bpy.context.view_layer).ok
    update()
    assert STATE.dirty_names == set()
    assert STATE.get_statuses(bpy.context.scene)["Along"].freshness is Freshness.FRESH


def edit_mesh(plate, _):
    plate.data.vertices[0].co.z += 0.01
    plate.data.update()


def edit_shader(plate, _):
    plate.active_material.node_tree.nodes["Principled BSDF"].inputs["Roughness"].default_value = 0.9


def choose(plate, _):
    plate.active_material.hnf_touch.library = "cork"


def move_stroke(_, stroke):
    stroke.location.x += 1e-3


def scale_scene(*_):
    bpy.context.scene.unit_settings.scale_length = 0.5


@pytest.mark.parametrize("change", [edit_mesh, edit_shader, choose, move_stroke, scale_scene])
def test_what_a_signal_follows_from_makes_it_stale(noting, change) -> None:
    plate, stroke = baked_scene()
    assert drain() == ["Along"]
    assert STATE.get_statuses(bpy.context.scene)["Along"].freshness is Freshness.FRESH
    change(plate, stroke)
    update()
    assert drain() == ["Along"]
    assert STATE.get_statuses(bpy.context.scene)["Along"].freshness is Freshness.STALE
    assert STATE.get_statuses(bpy.context.scene)["Along"].library_material


def test_another_frame_rate_is_noticed(noting) -> None:
    """At a given speed the path stays; the force keys come at other times."""
    baked_scene()
    drain()
    bpy.context.scene.render.fps = 30
    assert drain() == ["Along"]
    assert STATE.get_statuses(bpy.context.scene)["Along"].freshness is Freshness.FORCE


def test_a_changed_seed_is_noticed_though_blender_tells_nothing(noting) -> None:
    _, stroke = baked_scene()
    drain()
    stroke.hnf_stroke.seed += 1
    assert drain() == ["Along"]
    assert STATE.get_statuses(bpy.context.scene)["Along"].freshness is Freshness.FORCE
    stroke.hnf_stroke.seed -= 1
    assert drain() == ["Along"]
    assert STATE.get_statuses(bpy.context.scene)["Along"].freshness is Freshness.FRESH


def test_only_concerned_strokes_are_looked_at(noting) -> None:
    baked_scene()
    other = add_plane("Other", 0.12, z=0.5)
    line_stroke("Elsewhere", surface=other, centre=(0.0, 0.0, 0.5))
    update()
    assert drain() == ["Along", "Elsewhere"]
    assert drain() == []
    edit_mesh(other, None)
    update()
    assert drain() == ["Elsewhere"]


def test_a_surface_that_moves_is_looked_at_once(noting) -> None:
    """Reading such a stroke visits other frames, which must not wake the handlers again."""
    plate, _ = baked_scene()
    for frame, x in ((1, 0.0), (20, 0.001)):
        plate.location.x = x
        plate.keyframe_insert("location", frame=frame)
    update()
    assert drain() == ["Along"]
    update()
    assert STATE.dirty_names == set()
    assert drain() == []


def test_deleted_and_renamed_strokes_leave_no_status(noting) -> None:
    _, stroke = baked_scene()
    drain()
    stroke.name = "New name"
    update()
    drain()
    assert list(STATE.get_statuses(bpy.context.scene)) == ["New name"]
    bpy.data.objects.remove(stroke)
    STATE.dirty_names.add(EVERYTHING)
    drain()
    assert STATE.get_statuses(bpy.context.scene) == {}


def test_two_scenes_in_two_windows_keep_their_statuses(noting) -> None:
    """What is looked at in one window says nothing of strokes that another shows."""
    plate, _ = baked_scene()
    first, second = bpy.context.scene, bpy.data.scenes.new("Second")
    second.collection.objects.link(plate)
    there = line_stroke("There", surface=plate)
    first.collection.objects.unlink(there)
    second.collection.objects.link(there)
    shown = [(scene, scene.view_layers[0]) for scene in (first, second)]
    for dirty in ((), (EVERYTHING,), ("Along", "There")):
        for order in (shown, shown[::-1]):
            STATE.dirty_names.update(dirty)
            for _ in range(20):
                status_tracker.process_changes(order)
            assert [set(STATE.get_statuses(scene)) for scene in (first, second)] == [{"Along"}, {"There"}]
    refresh_status(second)
    assert STATE.get_statuses(first)["Along"].freshness is Freshness.FRESH
    bpy.data.objects.remove(there)
    STATE.dirty_names.add("There")
    status_tracker.process_changes(shown)
    assert [set(STATE.get_statuses(scene)) for scene in (first, second)] == [{"Along"}, set()]


def test_the_active_stroke_of_a_second_scene_is_previewed_too() -> None:
    plate, stroke = baked_scene()
    second = bpy.data.scenes.new("Second")
    second.collection.objects.link(plate)
    second.collection.objects.link(stroke)
    preview.on_load_post()
    try:
        with bpy.context.temp_override(scene=second, view_layer=second.view_layers[0]):
            preview._update_scene(bpy.context, set(), ended=False, is_first=False)
        assert "Along" in PREVIEW.requested
        assert "Along" in PREVIEW.facts
        assert set(preview._snapshots) == {"Second"}
    finally:
        preview.on_load_post()  # what is still being heard ends with it
        bpy.data.scenes.remove(second)


def test_history_makes_everything_unknown(noting) -> None:
    baked_scene()
    drain()
    handlers.on_undo_redo(bpy.context.scene)
    assert drain() == ["Along"]


def test_another_file_forgets_all(noting, tmp_path) -> None:
    baked_scene()
    drain()
    handlers.on_load_post("")
    assert STATE.get_statuses(bpy.context.scene) == {}
    assert STATE.dirty_names == {EVERYTHING}
    assert drain() == ["Along"]


def test_leaving_the_file_stops_its_bake() -> None:
    from hnf_blender.jobs import manager

    small_scene()
    manager.start_bake(bpy.context.scene, bpy.context.view_layer)
    handlers.on_load_pre("")
    assert not manager.is_running()
    assert STATE.job is None


def test_an_internal_error_is_shown_and_other_strokes_update(noting, monkeypatch) -> None:
    from hnf_blender.touch.session import Session

    plate, _ = baked_scene()
    line_stroke("Beside", surface=plate)
    read = Session.read_stroke

    def faulty(self, curve):
        if curve.name == "Along":
            raise ZeroDivisionError("a fault")
        return read(self, curve)

    monkeypatch.setattr(Session, "read_stroke", faulty)
    assert drain() == ["Along", "Beside"]
    assert STATE.get_statuses(bpy.context.scene)["Along"].freshness is Freshness.BROKEN
    assert "a fault" in STATE.get_statuses(bpy.context.scene)["Along"].why
    assert STATE.get_statuses(bpy.context.scene)["Beside"].freshness is Freshness.UNBAKED


def test_the_picked_stroke_stays_picked_when_objects_come_and_go() -> None:
    plate, _ = small_scene()
    line_stroke("Beside", surface=plate)
    scene = bpy.context.scene
    settings, objects = scene.hnf, scene.objects
    strokes = bpy.data.collections.new("Touch strokes")
    scene.collection.children.link(strokes)
    for name in ("Along", "Beside"):
        strokes.objects.link(objects[name])
        scene.collection.objects.unlink(objects[name])
    interface.clear_active_strokes()
    settings.stroke_index = objects.find("Beside")
    assert not interface.restore_active_stroke(scene)
    before = settings.stroke_index
    other = add_plane("Other")
    assert objects[before].name == "Along"  # what Blender's list would show now
    assert interface.restore_active_stroke(scene)
    assert objects[settings.stroke_index].name == "Beside"
    bpy.data.objects.remove(other)
    assert interface.restore_active_stroke(scene)
    assert settings.stroke_index == before
    objects["Beside"].name = "Renamed"
    assert not interface.restore_active_stroke(scene)
    settings.stroke_index = objects.find("Along")  # another one is picked
    assert not interface.restore_active_stroke(scene)
    assert objects[settings.stroke_index].name == "Along"
    interface.clear_active_strokes()


def test_the_list_of_strokes_is_scanned_once_and_always_true(noting, monkeypatch) -> None:
    plate, _ = small_scene()
    scene = bpy.context.scene
    update()

    def listed() -> list[str]:
        return [obj.name for obj in list_cached_strokes(scene)]

    assert listed() == ["Along"]
    held = dict(STROKES._indices)
    assert listed() == ["Along"]
    assert STROKES._indices == held
    beside = line_stroke("Beside", surface=plate)
    assert set(listed()) == {"Along", "Beside"}
    beside.hnf_stroke.is_stroke = False  # of which Blender tells nothing
    assert listed() == ["Along"]
    bpy.data.objects.remove(bpy.data.objects["Along"])
    assert listed() == []
    assert not has_strokes(scene)
    beside.hnf_stroke.is_stroke = True  # nor of this; it is seen as soon as the list is old, and at once by operators
    assert list_strokes(scene) == [beside]
    monkeypatch.setattr("hnf_blender.props.scene_settings.REDRAW_LIFETIME_S", 0.0)
    assert has_strokes(scene)
    assert listed() == ["Beside"]
    beside.hnf_stroke.is_stroke = False
    assert listed() == []
    beside.hnf_stroke.is_stroke = True
    monkeypatch.setattr("hnf_blender.props.object_cache.CACHE_LIFETIME_S", 0.0)
    assert listed() == ["Beside"]


@pytest.mark.parametrize("count", [1, FEW_NAMES, 5 * FEW_NAMES])
def test_one_name_that_is_nobodys_is_found_among_few_and_many(count) -> None:
    small_scene()
    names = {bpy.data.objects.new(f"Other {k}", None).name for k in range(count)}
    assert not status_tracker._has_unknown_names(names)
    assert not status_tracker._has_unknown_names(names | {bpy.data.meshes[0].name, bpy.data.curves[0].name})
    assert status_tracker._has_unknown_names(names | {bpy.data.images.new("Picture", 1, 1).name})


def test_edit_mode_is_waited_for(noting) -> None:
    plate, _ = baked_scene()
    bpy.context.view_layer.objects.active = plate
    bpy.ops.object.mode_set(mode="EDIT")
    update()
    STATE.dirty_names.add(PLATE)
    drain()
    assert STATE.get_statuses(bpy.context.scene)["Along"].freshness is Freshness.UNKNOWN
    assert "Edit Mode" in STATE.get_statuses(bpy.context.scene)["Along"].why
    bpy.ops.object.mode_set(mode="OBJECT")
    update()
    drain()
    assert STATE.get_statuses(bpy.context.scene)["Along"].freshness is Freshness.FRESH


def test_refresh_fills_what_is_asked_for() -> None:
    plate, _ = baked_scene()
    line_stroke("Beside", surface=plate, force=2.0)
    STATE.get_statuses(bpy.context.scene).clear()
    refresh_status(bpy.context.scene, ["Beside"])
    assert {name: status.freshness for name, status in STATE.get_statuses(bpy.context.scene).items()} == {
        "Beside": Freshness.UNBAKED
    }
    refresh_status(bpy.context.scene)
    assert STATE.get_statuses(bpy.context.scene)["Along"].freshness is Freshness.FRESH
    bpy.data.objects[PLATE].hide_render = True
    refresh_status(bpy.context.scene)
    found = STATE.get_statuses(bpy.context.scene)
    assert found["Along"].freshness is Freshness.FRESH  # it has a bake, which hiding does not change
    assert found["Beside"].freshness is Freshness.BROKEN
    assert "hidden" in found["Along"].why
    assert "hidden" in found["Beside"].why


@pytest.fixture
def ticking(noting, monkeypatch):
    """The window's timer, on a machine that is always too late."""
    monkeypatch.setattr(status_tracker, "TICK_BUDGET_S", -1.0)
    monkeypatch.setattr(manager, "is_preloaded", lambda: True)
    STATE.clear()


def tick_until_known() -> dict[str, tuple[Freshness, str]]:
    for _ in range(50):
        handlers.tick()
    return {name: status[:2] for name, status in STATE.get_statuses(bpy.context.scene).items()}


def look_afresh() -> dict[str, tuple[Freshness, str]]:
    refresh_status(bpy.context.scene)
    return {name: status[:2] for name, status in STATE.get_statuses(bpy.context.scene).items()}


def test_a_slow_machine_learns_all_statuses(ticking) -> None:
    """The first tick may have time for nothing but a surface, and nothing changes after it."""
    plate, _ = small_scene()
    for k in range(3):
        line_stroke(f"More {k}", surface=plate)
    STATE.dirty_names.clear()
    STATE.dirty_names.add(EVERYTHING)
    assert sorted(tick_until_known()) == ["Along", "More 0", "More 1", "More 2"]


HIDING = {
    "by its eye": lambda plate, is_hidden: plate.hide_set(is_hidden),
    "in viewports": lambda plate, is_hidden: setattr(plate, "hide_viewport", is_hidden),
    "in renders": lambda plate, is_hidden: setattr(plate, "hide_render", is_hidden),
    "by its collection": lambda plate, is_hidden: setattr(plate.users_collection[0], "hide_render", is_hidden),
    "excluded": lambda plate, is_hidden: setattr(
        bpy.context.view_layer.layer_collection.children["Aside"], "exclude", is_hidden
    ),
}


@pytest.mark.parametrize("is_baked", [True, False])
@pytest.mark.parametrize("how", HIDING)
def test_a_surface_hidden_or_shown_is_noticed(ticking, how, is_baked) -> None:
    """Blender reports it for no object; the status is that of a fresh look."""
    plate, _ = small_scene()
    aside = bpy.data.collections.new("Aside")
    bpy.context.scene.collection.children.link(aside)
    aside.objects.link(plate)
    bpy.context.scene.collection.objects.unlink(plate)
    if is_baked:
        bake_job.bake_blocking(bpy.context.scene, bpy.context.view_layer)
    update()
    STATE.dirty_names.add(EVERYTHING)
    shown = tick_until_known()
    for is_hidden in (True, False):
        HIDING[how](plate, is_hidden)
        STATE.dirty_names.clear()
        seen = tick_until_known()
        assert (seen == shown) is not is_hidden
        assert seen == look_afresh()


def test_a_choice_is_noticed_beside_a_linked_namesake(ticking, tmp_path) -> None:
    """Of two materials of one name the linked one has a choice, too."""
    plate, _ = small_scene()
    material = plate.active_material
    material.hnf_touch.library = "oak-wood"
    library = tmp_path / "library.blend"
    bpy.data.libraries.write(str(library), {material})
    with bpy.data.libraries.load(str(library), link=True) as (there, here):
        here.materials = there.materials
    assert [each.name for each in bpy.data.materials].count(material.name) == 2
    bake_job.bake_blocking(bpy.context.scene, bpy.context.view_layer)
    update()
    STATE.dirty_names.add(EVERYTHING)
    assert tick_until_known()["Along"][0] is Freshness.FRESH
    material.hnf_touch.library = ""
    STATE.dirty_names.clear()
    assert tick_until_known()["Along"][0] is Freshness.STALE
    assert tick_until_known() == look_afresh()


def test_the_baked_surface_is_watched_after_the_stroke_lost_it(ticking) -> None:
    """Another one is the nearest now; hidden, the one of the bake makes it play as it was baked."""
    plate, stroke = small_scene()
    bake_job.bake_blocking(bpy.context.scene, bpy.context.view_layer)
    stroke.hnf_stroke.surface = None
    add_plane("Nearer", z=1e-5)
    update()
    STATE.dirty_names.add(EVERYTHING)
    tick_until_known()
    plate.hide_viewport = True
    STATE.dirty_names.clear()
    assert tick_until_known() == look_afresh()


def test_a_scene_that_is_shown_again_is_looked_at(ticking) -> None:
    """From an empty scene, of which nothing is known, to one with strokes; Blender reports no change."""
    small_scene()
    window, first = bpy.context.window_manager.windows[0], bpy.context.scene
    update()
    window.scene = bpy.data.scenes.new("Empty")
    STATE.dirty_names.clear()
    for _ in range(5):
        handlers.tick()
    window.scene = first
    STATE.dirty_names.clear()
    assert sorted(tick_until_known()) == ["Along"]
