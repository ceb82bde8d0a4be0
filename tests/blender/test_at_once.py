"""Immediate updates in depsgraph handlers: the overlay is computed and the signal is requested before the redraw."""

from __future__ import annotations

import bpy
import pytest
from builders import add_plane
from job_scene import small_scene
from stroke_builders import LINE, add_stroke, key

from hnf_blender import handlers, preview
from hnf_blender.jobs import bake_job
from hnf_blender.preview.preview_state import PREVIEW
from hnf_blender.preview.synthesis_thread import SynthesisThread
from hnf_blender.props.object_cache import CHANGES
from hnf_blender.state.session_state import suppress_change_tracking
from hnf_blender.tool import overlay


@pytest.fixture
def told():
    """Blender tells the overlay of changes, as in a window, after it told those who note them."""
    listed = bpy.app.handlers.depsgraph_update_post
    listed += [handlers.on_depsgraph_update, overlay._on_depsgraph_update]
    CHANGES.is_notified = True
    yield
    CHANGES.is_notified = False
    CHANGES.mark_changed()
    for each in (handlers.on_depsgraph_update, overlay._on_depsgraph_update):
        listed.remove(each)
    if bpy.app.timers.is_registered(overlay._refresh):
        bpy.app.timers.unregister(overlay._refresh)
    overlay._remove_all_paths()
    overlay.OVERLAY.all_dirty = True


def some_strokes(count: int) -> list[bpy.types.Object]:
    plane = add_plane()
    found = [add_stroke(LINE, speed_mm_s=60.0, surface=plane) for _ in range(count)]
    for stroke in found:
        key(stroke, "force", (1, 0.5), (25, 2.0))
    bpy.context.view_layer.update()
    refreshed()
    bpy.app.timers.unregister(overlay._refresh)
    return found


def refreshed() -> int:
    """How many ticks it took."""
    ticks = 1
    while overlay._refresh() is not None:
        ticks += 1
    return ticks


def press(stroke: bpy.types.Object, newtons: float) -> None:
    from hnf_blender.compat import fcurves_of

    curve = next(each for each in fcurves_of(stroke) if each.data_path == "hnf_stroke.force")
    highest = max(curve.keyframe_points, key=lambda point: point.co[1])
    highest.co[1] = newtons
    curve.update()
    stroke.update_tag()
    bpy.context.view_layer.update()


def last_forces() -> list[float]:
    return [round(float(path.forces.max()), 1) for path in overlay.OVERLAY.paths.values()]


def test_a_changed_stroke_alone_is_recomputed_for_the_redraw(told) -> None:
    first, second = some_strokes(2)
    assert last_forces() == [2.0, 2.0]
    kept = overlay.OVERLAY.paths[second.name]
    press(first, 1.0)
    assert last_forces() == [1.0, 2.0]
    assert overlay.OVERLAY.paths[second.name] is kept
    assert not bpy.app.timers.is_registered(overlay._refresh)


def test_what_is_no_part_of_a_stroke_computes_nothing(told) -> None:
    (stroke,) = some_strokes(1)
    kept = overlay.OVERLAY.paths[stroke.name]
    bpy.data.objects["Plane"].location.x += 0.1
    bpy.context.view_layer.update()
    assert overlay.OVERLAY.paths[stroke.name] is kept
    assert not bpy.app.timers.is_registered(overlay._refresh)


def test_many_changed_strokes_wait_for_the_timer(told) -> None:
    strokes = some_strokes(overlay.FEW_STROKES + 1)
    for stroke in strokes:
        stroke.location.z += 0.01
    bpy.context.view_layer.update()
    assert bpy.app.timers.is_registered(overlay._refresh)
    kept = dict(overlay.OVERLAY.paths)
    refreshed()
    assert all(overlay.OVERLAY.paths[name] is not kept[name] for name in kept)
    assert len(kept) == len(strokes)


def test_undo_recomputes_all_strokes_in_steps_while_drawing(told, monkeypatch) -> None:
    strokes = some_strokes(3)
    kept = dict(overlay.OVERLAY.paths)
    monkeypatch.setattr(overlay, "REFRESH_BUDGET_S", 0.0)
    overlay._on_undo()
    assert overlay.OVERLAY.paths == kept
    assert overlay._refresh() == 0.0
    assert [name for name, path in overlay.OVERLAY.paths.items() if path is not kept[name]] == [strokes[0].name]
    assert refreshed() == 2
    assert not any(path is kept[name] for name, path in overlay.OVERLAY.paths.items())
    overlay._on_load_post()
    assert overlay.OVERLAY.paths == {}


def test_a_deleted_stroke_is_forgotten_with_the_next_look_at_all(told) -> None:
    first, second = some_strokes(2)
    name = second.name
    bpy.data.objects.remove(first)
    overlay._mark_all_dirty()
    refreshed()
    assert list(overlay.OVERLAY.paths) == [name]


@pytest.fixture
def listening(warm_bake):
    """A baked stroke that has been heard once, and its handler as in a window."""
    preview.on_load_post()
    plate, stroke = small_scene()
    bake_job.bake_blocking(bpy.context.scene, bpy.context.view_layer)
    bpy.context.view_layer.update()
    PREVIEW.synthesis_thread = SynthesisThread()
    handler = lambda _scene, depsgraph: preview._request_preview(bpy.context, depsgraph)  # noqa: E731
    bpy.app.handlers.depsgraph_update_post.append(handler)
    yield plate, stroke
    bpy.app.handlers.depsgraph_update_post.remove(handler)
    preview.on_load_post()


def test_the_active_strokes_force_is_asked_for_without_a_timer(listening) -> None:
    _, stroke = listening
    press(stroke, 1.5)
    first = PREVIEW.requested[stroke.name]
    press(stroke, 2.5)
    assert PREVIEW.requested[stroke.name] != first
    stamp = PREVIEW.requested[stroke.name]
    stroke.update_tag()
    bpy.context.view_layer.update()
    assert PREVIEW.requested[stroke.name] == stamp


def test_unrelated_or_driven_changes_request_no_preview(listening) -> None:
    plate, stroke = listening
    plate.location.x += 0.1
    bpy.context.view_layer.update()
    assert stroke.name not in PREVIEW.requested
    driver = stroke.driver_add("hnf_stroke.force").driver
    driver.expression = "1 + frame / 10"
    bpy.context.view_layer.update()
    assert stroke.name not in PREVIEW.requested


def test_our_own_changes_are_no_news(listening) -> None:
    _, stroke = listening
    with suppress_change_tracking(bpy.context.view_layer):
        press(stroke, 2.5)
        assert stroke.name not in PREVIEW.requested
    press(stroke, 2.0)
    assert stroke.name in PREVIEW.requested
