"""An artist's first five minutes: from the zip to a signal that is seen, heard, changed, exported and kept."""

from pathlib import Path

import bpy
from drive.addon import force_keys, freshness, keys_of, state, strokes

INSTALLED = "no"
SHARE = Path("/share")
PLATE = 0.1  # metres, of make_scene.py


def stroke():
    return strokes()[0]


def check_the_zip_installs(stage):
    archive = next((SHARE / "dist").glob("*.zip"))
    stage.expect("nothing is installed", not hasattr(bpy.types.Scene, "hnf"))
    with stage.over():
        bpy.ops.extensions.package_install_files(
            filepath=str(archive), repo="user_default", enable_on_install=True, overwrite=True
        )
    yield from stage.until("it is on", lambda: hasattr(bpy.types.Scene, "hnf"), 60.0)
    stage.expect("strokes can be made", hasattr(bpy.types.Object, "hnf_stroke"))


def check_the_tab_says_what_to_do(stage):
    yield from stage.show_tab()
    stage.expect("the tab is there", stage.region("UI").active_panel_category == "Touch")
    yield from stage.picture("01-the-tab-on-a-new-file")


def check_a_scene_opens(stage):
    with stage.over():
        bpy.ops.wm.open_mainfile(filepath="/share/ribs.blend")
    yield 1.0
    bpy.context.preferences.view.show_splash = False
    yield from stage.show_tab()
    with stage.over():
        bpy.ops.view3d.view_axis(type="TOP")
        bpy.ops.view3d.view_all()
    yield 0.8
    stage.area().spaces.active.shading.type = "SOLID"
    yield from stage.picture("02-a-surface-to-touch")
    stage.expect("no stroke yet", strokes() == [])


def check_the_tool_draws_a_stroke(stage):
    with stage.over():
        bpy.ops.wm.tool_set_by_id(name="hnf.stroke")
    yield 0.3
    tool = bpy.context.workspace.tools.from_space_view3d_mode("OBJECT").idname
    stage.require("the tool is taken", tool == "hnf.stroke", tool)
    path = [stage.seen_at((-0.03 + 0.0015 * k, 0.008 * ((k % 20) / 10 - 1) ** 2, 0.0)) for k in range(41)]
    yield from stage.move(path[0])
    stage.event("LEFTMOUSE", "PRESS", path[0])
    for k, at in enumerate(path[1:]):
        yield 0.02
        stage.event("MOUSEMOVE", "NOTHING", at)
        if k == 25:
            yield 0.1
            stage.photograph("03-drawing")
    yield 0.05
    stage.event("LEFTMOUSE", "RELEASE", path[-1])
    yield from stage.until("a stroke is there", lambda: len(strokes()) == 1, 10.0)
    stage.expect("on the surface that was stroked", stroke().hnf_stroke.surface is not None)
    stage.expect("the hand's timing is keyed", len(keys_of(stroke(), "progress")) >= 2, keys_of(stroke(), "progress"))
    stage.expect("the force is keyed", len(force_keys(stroke())) >= 1, force_keys(stroke()))
    yield from stage.picture("04-drawn")


def check_it_bakes_while_the_window_lives(stage):
    from drive.addon import start_bake

    start_bake(stage)
    yield from stage.until("the job is shown", lambda: state().job is not None, 5.0)
    yield 1.0
    stage.photograph("05-baking")
    yield from stage.until("the bake ends", lambda: state().job is None, 90.0)
    stage.require("it went well", state().last_job.ok, state().last_job)
    yield from stage.until("it is fresh", lambda: freshness(stroke().name) == "fresh", 10.0)
    stage.expect("tokens are on the mesh", "hnf_palette" in stroke().hnf_stroke.surface.data)
    yield from stage.picture("06-baked")
