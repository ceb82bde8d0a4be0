"""One place examined by a click: the window goes on, the answer stands in the panel, the file stays as it is."""

import time

import bpy
from drive import scenery
from drive.addon import busy_children, children, job_folders, kept, ours, state

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
    ours("jobs.manager").end_process()  # the one that waits might be done before the key comes
    with stage.over():
        bpy.ops.hnf.probe("INVOKE_DEFAULT")
    yield 0.2
    yield from stage.click(stage.seen_at(AWAY))
    yield from stage.until("the job runs", lambda: state().job is not None, 10.0)
    yield from stage.key("ESC")
    yield from stage.until("it is gone", lambda: state().job is None and not children(), 20.0)
    stage.expect("nothing was examined", state().query_view is None)
    stage.expect("no folder is left", job_folders() == [], job_folders())
