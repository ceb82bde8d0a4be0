"""A bake beside a living window: cancelled and killed at every stage, and one undo step at its end."""

import os
import signal
import time

import bpy
from drive import scenery
from drive.addon import Ending, baked, children, job_folders, kept, start_bake, state, strokes
from drive.timing import Spent

ALONE = "yes"  # it measures
LONG_S = 2.0  # four times what is promised: this may run on a busy machine
QUICK = 0.005
BEGUN = "its first words"
"""Not a stage's name: whatever follows the start."""


def prepare(stage, number):
    """A surface that no cache knows yet, with three strokes."""
    scenery.empty_room()
    plate = scenery.plate(material=scenery.ribbed_material(scale=20.0 + 0.1 * number), size_m=0.12)
    for k in range(3):
        obj = scenery.stroke_on(plate, f"Stroke {k + 1}", 0.02, seconds=3.0)  # one or two close-ups, long synthesis
        obj.hnf_stroke.seed = number + k
    yield 0.4
    yield from scenery.look_at(stage, plate)
    bpy.ops.ed.undo_push(message="prepared")


def until_stage(stage, word):
    """Wait until the running job says it is at this stage; False where it came and went between two looks."""
    deadline = time.monotonic() + 90.0
    while time.monotonic() < deadline:
        job = state().job
        if job is None:
            return False
        if word in job.stage or (word == BEGUN and "starting" not in job.stage):
            return True
        yield QUICK
    return False


def bake_until(stage, word, number):
    for attempt in range(4):
        yield from prepare(stage, 10 * number + attempt)
        start_bake(stage)
        reached = yield from until_stage(stage, word)
        if reached:
            stage.expect(f"the stage '{word}' is seen", True)
            return
        yield from stage.until("that one ended", lambda: state().job is None, 60.0)
    stage.require(f"the stage '{word}' is seen", False, "it came and went four times")


def nothing_left(stage, before):
    stage.expect("no process is left", children() == [], children())
    stage.expect("no folder is left", job_folders() == [], job_folders())
    stage.expect("nothing in the file changed", kept() == before)


def cancelled_at(stage, word, number):
    yield from bake_until(stage, word, number)
    before = kept()
    ending, at = Ending(), stage.middle()
    pressed = time.monotonic()
    stage.event("ESC", "PRESS", at)
    while time.monotonic() < pressed + 10.0 and ending.at is None:
        yield QUICK
    took = (ending.at or time.monotonic()) - pressed
    stage.event("ESC", "RELEASE", at)
    stage.measured(f"ESC while {word} → nothing runs", took, "s")
    stage.expect("it stops at once", took < LONG_S, f"{took:.2f} s")
    stage.expect("it says so", state().last_job is not None and "ancel" in state().last_job.message, state().last_job)
    yield 0.3
    nothing_left(stage, before)


def killed_at(stage, word, number):
    yield from bake_until(stage, word, number)
    before, running = kept(), children()
    stage.require("a child runs", running, running)
    for pid in running:
        os.kill(pid, signal.SIGKILL)
    yield from stage.until("the job ends", lambda: state().job is None, 10.0)
    last = state().last_job
    stage.expect("it is reported as a failure", last is not None and not last.ok, last)
    stage.expect("in words", "killed" in last.message, last.message)
    yield from stage.picture(f"killed-while-{word.replace(' ', '-')}")
    nothing_left(stage, before)


def check_cancel_while_starting(stage):
    yield from cancelled_at(stage, "starting", 1)


def check_cancel_at_its_first_words(stage):
    yield from cancelled_at(stage, BEGUN, 2)


def check_cancel_among_close_ups(stage):
    yield from cancelled_at(stage, "close-ups", 3)


def check_cancel_during_synthesis(stage):
    yield from cancelled_at(stage, "synthesis", 4)


def check_cancel_before_the_commit(stage):
    yield from cancelled_at(stage, "comparing", 5)


def check_kill_while_starting(stage):
    yield from killed_at(stage, "starting", 6)


def check_kill_at_its_first_words(stage):
    yield from killed_at(stage, BEGUN, 7)


def check_kill_among_close_ups(stage):
    yield from killed_at(stage, "close-ups", 8)


def check_kill_during_synthesis(stage):
    """The last stage that has a child: what follows is compared in the window's own process."""
    yield from killed_at(stage, "synthesis", 9)


def check_after_all_that_it_still_bakes(stage):
    yield from prepare(stage, 90)
    yield from baked(stage)
    stage.expect("all are baked", all(kept()[obj.name][-1] for obj in strokes()), kept())


def check_the_result_is_one_undo_step(stage):
    with_bake = kept()
    yield from stage.key("Z", ctrl=True)
    yield 0.6
    without = kept()
    stage.expect("one undo takes all of it away", not any(without[obj.name][-1] for obj in strokes()), without)
    stage.expect("and no stroke", sorted(obj.name for obj in strokes()) == ["Stroke 1", "Stroke 2", "Stroke 3"])
    yield from stage.key("Z", ctrl=True, shift=True)
    yield 0.6
    stage.expect("one redo brings it back", kept() == with_bake, kept())


def check_the_window_lives_while_100k_faces_bake(stage):
    scenery.empty_room()
    plate = scenery.plate("Fine plate", cuts=316, size_m=0.2)
    for k in range(5):
        scenery.stroke_on(plate, f"Long {k}", 0.06, seconds=2.0, turned=0.4 * k)
    yield 0.5
    yield from scenery.look_at(stage, plate)
    yield from stage.show_tab()
    stage.expect("100k faces", len(plate.data.polygons) >= 99_000, len(plate.data.polygons))
    with Spent() as spent:
        start_bake(stage)
        started, gaps, last, ticks = time.monotonic(), [], time.monotonic(), 0
        while state().job is not None and time.monotonic() < started + 120.0:
            stage.event("MOUSEMOVE", "NOTHING", stage.middle(region="UI" if ticks % 20 < 10 else "WINDOW"))
            stage.area().tag_redraw()
            yield 0.02
            now = time.monotonic()
            gaps.append(now - last)
            last, ticks = now, ticks + 1
            if ticks == 60:
                stage.photograph("baking-100k-faces")
    stage.expect("it baked", state().last_job.ok, state().last_job)
    for name, times in sorted(spent.calls.items(), key=lambda one: -max(one[1]))[:4]:
        stage.measured(f"100k faces: longest of {len(times)} calls of {name}", 1e3 * max(times), "ms")
    stage.measured("100k faces: longest gap between two steps of the window", 1e3 * max(gaps), "ms")
    stage.measured("100k faces: 95 % of gaps below", 1e3 * sorted(gaps)[int(0.95 * len(gaps))], "ms")
    stage.expect("ours is short", spent.longest < 0.5, f"{spent.longest:.3f} s in {spent.longest_name}")
    stage.expect("the window went on", ticks > 50, ticks)
