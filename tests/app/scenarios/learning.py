"""A material learned from recordings as an artist does it: the preferences, the button, the dialog, Esc, undo."""

import random
import time
from pathlib import Path

import bpy
from drive import buttons
from drive.addon import MODULE, children, job_folders, ours, state
from drive.tab import all_open

SCREEN = "1280x1100"
SMOOTH = "no"  # nobody looks at how its 3-D view is drawn
PYTHON = "/share/home/torch/bin/python"
RECORDINGS = Path("/share/recordings")
SECONDS, RATE_HZ = 3, 10_000
MATERIAL = "Coarse mesh"
ROW_PX, LINE_PX = 26, 16
FIELDS = ("effort", "name", "folder", "kind")
"""Of the dialog, from the bottom to the top."""


def record():
    """A recording of one's own: noise."""
    path = RECORDINGS / MATERIAL / "first.csv"
    path.parent.mkdir(parents=True)
    noise = random.Random(3)
    rows = (f"{at / RATE_HZ:.4f},{noise.gauss(0.0, 1.0):.5g},1.0" for at in range(SECONDS * RATE_HZ))
    path.write_text("\n".join(["time [s],acceleration [m/s^2],force [N]", *rows]))


def slot():
    """Everything the active slot's material says of its feel."""
    material = bpy.context.object.active_material
    return (
        material.name,
        material.hnf_touch.library,
        ours("bridge.scene.material_definition").get_artist_choice(material),
    )


def learned():
    return sorted(path.name for path in ours("state.addon_settings").get_learned_folder().iterdir())


def pasted(stage, at, text):
    """Into a text field."""
    yield from stage.click(at)
    bpy.context.window_manager.clipboard = text
    yield from stage.key("V", at, ctrl=True)
    yield from stage.key("RET", at)


def picked(stage, at, key):
    """From a drop-down list, by the letter that it underlines."""
    yield from stage.click(at)
    yield 0.2
    yield from stage.key(key, at)
    yield 0.2


def dialog(stage, name):
    """Press the button in the Materials panel; a generator that returns where OK is."""
    yield 1.0  # a message that came or went has moved the panels
    at = yield from buttons.find(stage, "bpy.ops.hnf.learn", below=stage.memory.get("button", 10_000))
    stage.memory["button"] = at[1] + 2 * buttons.ROW_PX  # messages push it down, never up
    yield 0.2  # what the mouse left before is closed
    yield from stage.click(at)
    yield 0.4
    return buttons.default_button(stage, name)


def field(ok, name, lines=1):
    """Where a field of the dialog is. lines: of the licence, which stands between them and OK."""
    return ok[0], ok[1] + 53 + LINE_PX * (lines - 1) + ROW_PX * FIELDS.index(name)


def check_a_python_is_named_and_checked(stage):
    record()
    area = stage.area()
    area.type = "PREFERENCES"
    bpy.context.preferences.active_section = "ADDONS"
    bpy.context.window_manager.addon_search = "haptic"
    with stage.over("PREFERENCES"):
        bpy.ops.preferences.addon_expand(module=MODULE)
    yield from stage.picture("no-python")
    check = yield from buttons.find(stage, "bpy.ops.hnf.python_check", "PREFERENCES", "WINDOW", across=0.93)
    yield from stage.move((check[0], check[1] + 300))  # a greyed button keeps its tooltip, and the next click
    yield 0.2
    yield from pasted(stage, (check[0] - 250, check[1]), PYTHON)
    yield 0.2
    named = bpy.context.preferences.addons[MODULE].preferences.external_python
    stage.require("it is named", named == PYTHON, named)
    yield from stage.click(check)
    yield from stage.until("it has answered", lambda: state().external_python is not None, 60.0)
    found = state().external_python
    stage.require("it can learn", not found.problem, found)
    yield from stage.picture("python-found")
    stage.area("PREFERENCES").type = "VIEW_3D"
    yield 0.3


def check_without_a_folder_it_is_refused_in_words(stage):
    yield from stage.show_tab()
    yield from stage.widen_sidebar(330)
    stage.memory["materials"] = all_open("HNF_PT_materials")
    stage.memory["materials"].__enter__()
    yield 0.5
    stage.memory["before"] = slot()
    ok = yield from dialog(stage, "dialog-simulated")
    yield from picked(stage, (ok[0], ok[1] + 53 + 2 * ROW_PX), "Y")
    ok = buttons.default_button(stage, "dialog-own")
    yield from stage.click(ok)
    yield 0.4
    stage.expect("no job runs", state().job is None, state().job)
    stage.photograph("refused")
    yield from stage.key("ESC", ok)  # closes the message
    yield from stage.move(stage.middle())
    yield 0.3


def check_esc_leaves_all_as_it_was(stage):
    """The dialog opens with what was chosen before it was refused."""
    ok = yield from dialog(stage, "dialog-reopened")
    yield from pasted(stage, field(ok, "folder"), str(RECORDINGS))
    yield from pasted(stage, field(ok, "name"), MATERIAL)
    yield from picked(stage, field(ok, "effort"), "Q")
    ok = buttons.default_button(stage, "dialog-filled")
    pressed = time.monotonic()
    yield from stage.click(ok)
    yield from stage.until("the job runs", lambda: state().job is not None, 10.0)
    yield from stage.until("it trains", lambda: state().job.stage == "epoch" and state().job.done >= 1, 60.0)
    stage.measured("OK → the first epoch is done", time.monotonic() - pressed, "s")
    stage.expect("Quick is ten epochs", state().job.total == 11, state().job)
    stage.photograph("learning")
    yield from stage.key("ESC")
    yield from stage.until("it is gone", lambda: state().job is None and not children(), 10.0)
    stage.expect("it says so", "canceled" in state().last_job.message, state().last_job)
    stage.expect("no folder is left", job_folders() == [], job_folders())
    stage.expect("nothing in the file changed", slot() == stage.memory["before"], slot())
    kept = learned()
    stage.expect("the checkpoint alone waits", [Path(name).suffix for name in kept] == [".checkpoint"], kept)
    yield from stage.picture("cancelled")


def check_the_same_choices_go_on_to_the_end(stage):
    """The dialog opens with them: the checkpoint of this very lesson goes with it."""
    ok = yield from dialog(stage, "dialog-again")
    pressed = time.monotonic()
    yield from stage.click(ok)
    yield from stage.until("the job runs", lambda: state().job is not None, 10.0)
    yield from stage.until("it ends", lambda: state().job is None, 60.0)
    stage.measured("OK → the material is there", time.monotonic() - pressed, "s")
    last = state().last_job
    stage.require("it went well", last.ok and last.written == 1, last)
    name, _, definition = slot()
    stage.expect("the slot keeps its material", name == stage.memory["before"][0], name)
    stage.expect("which feels as it was learned", getattr(definition, "name", "") == MATERIAL, definition)
    stage.expect("a copy is kept", learned() == [f"{MATERIAL} (own).hnf"], learned())
    yield from stage.picture("learned")


def check_it_is_one_undo_step(stage):
    after = slot()
    yield from stage.key("Z", ctrl=True)
    yield 0.5
    stage.expect("one undo takes it off", slot() == stage.memory["before"], slot())
    yield from stage.key("Z", ctrl=True, shift=True)
    yield 0.5
    stage.expect("one redo puts it back", slot() == after, slot()[:2])
    yield from stage.picture("redone")
    stage.memory["materials"].__exit__(None, None, None)
