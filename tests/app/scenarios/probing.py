"""One place examined by a click: the window goes on, the answer stands in the panel, the file stays as it is."""

import time

import bpy
from drive import scenery
from drive.addon import busy_children, children, freshness, heard, job_folders, kept, ours, state, strokes

SMOOTH = "no"  # nobody looks at how its 3-D view is drawn
LIMIT_S = 120.0
AWAY = (0.045, 0.045, 0.0)
"""A corner of the plate, seen from above."""


def check_a_click_is_answered(stage):
    scenery.empty_room()
    plate = scenery.plate()
    yield from scenery.look_at(stage, plate)
    yield from stage.show_tab()
    before = kept()
    with stage.over():
        bpy.ops.hnf.probe("INVOKE_DEFAULT")
    yield 0.3
    stage.expect("it waits for a click", state().job is None)
    pressed = time.monotonic()
    yield from stage.click(stage.seen_at((0.01, 0.02, 0.0)))
    yield from stage.until("the job runs", lambda: state().job is not None, 10.0)
    yield from stage.until("it ends", lambda: state().job is None, LIMIT_S)
    stage.measured("from the click to the answer", time.monotonic() - pressed, "s")
    view = state().query_view
    stage.require("a place was examined", view is not None, state().last_job)
    stage.expect("it is the plate", view.object_name == "Plate", view)
    stage.expect("its relief was seen", view.seen_m is not None and 1e-6 < view.seen_m < 1e-4, view.seen_m)
    stage.expect("it has a picture", view.icon > 0)
    stage.expect("its material has suggestions", bool(state().suggestions))
    stage.expect("nothing was chosen unasked", not plate.active_material.hnf_touch.library)
    stage.expect("nothing was kept in the file", kept() == before)
    stage.expect("nothing is left", (busy_children(), job_folders()) == ([], []), (children(), job_folders()))
    yield from stage.picture("examined", settle=1.5)


def check_a_click_beside_everything_goes_on_waiting(stage):
    with stage.over():
        bpy.ops.hnf.probe("INVOKE_DEFAULT")
    yield 0.3
    yield from stage.click(stage.seen_at((0.08, 0.0, 0.0)))
    yield 0.3
    stage.expect("no job began", state().job is None)
    yield from stage.key("ESC")
    yield 0.3
    stage.expect("the operator has ended", bpy.context.window.modal_operators[:] == [])


def check_esc_gives_a_look_up(stage):
    state().query_view = None
    ours("jobs.bake_process").end_process()  # the one that waits might be done before the key comes
    with stage.over():
        bpy.ops.hnf.probe("INVOKE_DEFAULT")
    yield 0.2
    yield from stage.click(stage.seen_at(AWAY))
    yield from stage.until("the job runs", lambda: state().job is not None, 10.0)
    yield from stage.key("ESC")
    yield from stage.until("it is gone", lambda: state().job is None and not children(), 20.0)
    stage.expect("nothing was examined", state().query_view is None)
    stage.expect("no folder is left", job_folders() == [], job_folders())


def check_a_stroke_goes_over_to_a_neighbor(stage):
    """From a tile to the one beside it, and on over the floor 5 cm below: both tiles are felt, the floor is not."""
    scenery.empty_room()
    yield 1.0
    scenery.plate("Left", 0.06, at=(-0.03, 0.0, 0.0))
    scenery.plate("Right", 0.06, at=(0.03, 0.0, -1e-4), material=bpy.data.materials.new("Clear glass"))
    scenery.plate("Floor", 1.0, at=(0.0, 0.0, -0.05), material=bpy.data.materials.new("Oak"))
    yield from stage.show_tab()
    yield from scenery.look_at(stage, bpy.data.objects["Left"])
    view = stage.area().spaces.active.region_3d
    view.view_distance, view.view_location = 2.6 * view.view_distance, (0.03, 0.0, 0.0)
    with stage.over():
        bpy.ops.ed.undo_push(message="Tiles")
    yield 0.3
    with stage.over():
        bpy.ops.hnf.stroke_tool()
    yield 0.3
    path = [stage.seen_at((-0.05 + 0.008 * k, 0.006, 0.0)) for k in range(16)]
    yield from stage.drag(path, pause=0.04)
    yield from stage.until("a stroke is there", lambda: len(strokes()) == 1, 10.0)
    stage.expect(
        "it has no surface of its own", strokes()[0].hnf_stroke.surface is None, strokes()[0].hnf_stroke.surface
    )
    stage.expect("it is named after both", strokes()[0].name == "Stroke across Left, Right", strokes()[0].name)
    yield from stage.key("Z", ctrl=True)
    yield from stage.until("one undo takes it away", lambda: strokes() == [], 10.0)
    yield from stage.key("Z", ctrl=True, shift=True)
    yield from stage.until("redo brings it back", lambda: len(strokes()) == 1, 10.0)
    with stage.over():
        bpy.ops.hnf.bake("INVOKE_DEFAULT", True)
    yield from stage.until("the job is shown", lambda: state().job is not None, 5.0)
    yield from stage.until("the bake ends", lambda: state().job is None, 90.0)
    stage.require("it went well", state().last_job.ok, state().last_job)
    yield from stage.until("it is fresh", lambda: freshness(strokes()[0].name) == "fresh", 10.0)
    felt = {obj.name for obj in bpy.context.scene.objects if obj.type == "MESH" and "hnf_palette" in obj.data}
    stage.expect("both tiles are felt, and nothing else", felt == {"Left", "Right"}, felt)
    yield from stage.until("the signal is there", lambda: heard(strokes()[0].name) is not None, 20.0)
    yield from stage.picture("both-are-felt", settle=1.5)
