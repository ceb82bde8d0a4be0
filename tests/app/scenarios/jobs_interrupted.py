"""What a window does to a bake that runs: undo and redo, edits, another file, and leaving."""

import time
from pathlib import Path

import bpy
from drive import scenery
from drive.addon import (
    baked,
    busy_children,
    children,
    freshness,
    heard,
    job_folders,
    kept,
    ours,
    start_bake,
    state,
    strokes,
)

SMOOTH = "no"  # nobody looks at how its 3-D view is drawn
QUICK = 0.005


def prepare(stage, scale):
    """A surface that no cache knows yet, with two strokes."""
    scenery.empty_room()
    plate = scenery.plate(material=scenery.ribbed_material(scale=scale), size_m=0.12)
    for k in range(2):
        scenery.stroke_on(plate, f"Stroke {k + 1}", 0.02, seconds=2.0)
    yield 0.4
    yield from scenery.look_at(stage, plate)
    bpy.ops.ed.undo_push(message="prepared")
    bpy.context.scene.frame_end = 123
    bpy.ops.ed.undo_push(message="something to undo")


def at_work(stage):
    yield from stage.until("the child is at work", lambda: state().job is None or "Stroke" in state().job.stage, 60.0)
    stage.require("the bake runs", state().job is not None, state().last_job)


def done(stage):
    yield from stage.until("the bake ends", lambda: state().job is None, 120.0)
    stage.expect("no process is at work", busy_children() == [], children())
    stage.expect("no folder is left", job_folders() == [], job_folders())


def check_undo_and_redo_while_it_runs(stage):
    yield from prepare(stage, 31.0)
    start_bake(stage)
    yield from at_work(stage)
    yield from stage.key("Z", ctrl=True)
    yield 0.3
    stage.expect("the undo was done", bpy.context.scene.frame_end != 123, bpy.context.scene.frame_end)
    stage.expect("the bake goes on", state().job is not None, state().last_job)
    yield from stage.key("Z", ctrl=True, shift=True)
    yield from done(stage)
    stage.expect("and is kept", all(kept()[obj.name][-1] for obj in strokes()), state().last_job)
    yield 0.6
    stage.expect("as fresh", all(freshness(obj.name) == "fresh" for obj in strokes()), state().statuses)


def check_an_edit_while_it_runs_costs_that_stroke_alone(stage):
    yield from prepare(stage, 32.0)
    start_bake(stage)
    yield from at_work(stage)
    bpy.data.objects["Stroke 1"].location.x += 0.002
    yield from done(stage)
    stage.expect("one is kept", [bool(kept()[obj.name][-1]) for obj in strokes()] == [False, True], kept())
    stage.expect("and the other is named", "Stroke 1" in state().last_job.message, state().last_job)
    yield from stage.show_tab()
    yield from stage.picture("edited-while-baking")


def check_statuses_follow_an_edit(stage):
    yield from baked(stage)
    yield 0.6
    stage.expect("fresh", freshness("Stroke 1") == "fresh", state().statuses)
    bpy.data.objects["Stroke 1"].hnf_stroke.seed += 1
    yield from stage.until("a seed is noticed", lambda: freshness("Stroke 1") == "force", 5.0)
    bpy.data.objects["Stroke 1"].location.x += 0.002
    yield from stage.until("a move is noticed", lambda: freshness("Stroke 1") == "stale", 5.0)
    bpy.ops.ed.undo_push(message="moved")
    yield from stage.key("Z", ctrl=True)
    yield from stage.until("an undo is noticed", lambda: freshness("Stroke 1") != "stale", 5.0)


def check_another_file_ends_it(stage):
    path = Path(stage.folder) / "another.blend"
    yield from prepare(stage, 33.0)
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
    start_bake(stage)
    yield from at_work(stage)
    with stage.over():
        bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False)
    yield 0.5
    yield from done(stage)
    stage.expect("nothing was written into it", not any(kept()[obj.name][-1] for obj in strokes()), kept())
    yield from baked(stage)
    stage.expect("and there it bakes", all(kept()[obj.name][-1] for obj in strokes()), state().last_job)


def check_a_second_bake_finds_its_process(stage):
    """To and fro between two places whose close-ups are there: nothing is heard there before the bake."""
    yield from prepare(stage, 36.0)
    obj = bpy.data.objects["Stroke 1"]
    bpy.context.view_layer.objects.active = obj
    pids = []
    for what in ("", "", "in a new process", "in the one that waits", "again in it"):
        if what == "in a new process":
            ours("jobs.manager").close()
        obj.location.x += 0.002 if len(pids) % 2 else -0.002
        yield 1.0
        pressed, before = time.monotonic(), kept()
        stamp = heard(obj.name).stamp if heard(obj.name) else None
        start_bake(stage)
        while state().job is not None and time.monotonic() < pressed + 60.0:
            yield QUICK
        took = time.monotonic() - pressed
        while (heard(obj.name) is None or heard(obj.name).stamp == stamp) and time.monotonic() < pressed + 60.0:
            yield QUICK
        if what:
            stage.measured(f"one changed stroke {what}, click → kept", took, "s")
            stage.measured(f"one changed stroke {what}, click → sound", time.monotonic() - pressed, "s")
        stage.expect("it is kept", kept() != before and state().last_job.ok, state().last_job)
        pids.append(ours("jobs.bake_process").get_process().pid)
    stage.expect("each process does all bakes until it is ended", len(set(pids[:2])) == len(set(pids[2:])) == 1, pids)
    stage.expect("which it was once", pids[0] != pids[2], pids)
    scenery.empty_room()
    yield from stage.until("it ends with the file", lambda: children() == [], 5.0)


def check_a_second_window_closes_without_harm(stage):
    yield from prepare(stage, 34.0)
    with stage.over():
        bpy.ops.wm.window_new()
    yield 0.5
    start_bake(stage)
    yield from at_work(stage)
    other = next(window for window in bpy.context.window_manager.windows if window != stage.window())
    with bpy.context.temp_override(window=other):
        bpy.ops.wm.window_close()
    yield 0.3
    yield from done(stage)
    stage.expect("it is kept", all(kept()[obj.name][-1] for obj in strokes()), state().last_job)


def check_switching_the_add_on_off_ends_it(stage):
    import addon_utils
    from drive.addon import MODULE

    yield from prepare(stage, 35.0)
    start_bake(stage)
    yield from at_work(stage)
    addon_utils.disable(MODULE)
    yield 0.5
    stage.expect("no process is left", children() == [], children())
    stage.expect("no folder is left", job_folders() == [], job_folders())
    addon_utils.enable(MODULE)
    yield 0.3
    stage.expect("no job is left", state().job is None, state().job)
