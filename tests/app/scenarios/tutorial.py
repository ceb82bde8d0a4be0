"""docs/first-stroke.md, done word for word in a window: what it says happens, and its pictures are of this."""

import time
from pathlib import Path

import bpy
from drive import buttons, tab
from drive.addon import force_keys, freshness, heard, ours, state, strokes

SCREEN = "1360x1600"  # the sidebar down to the preview's buttons
SIDEBAR_PX = 330
RULER_PX = 26
"""Height of the frame numbers at the top of a Graph Editor."""
FOLDER = Path("/share/tutorial")


def stroke():
    return strokes()[0]


def check_a_new_file(stage):
    bpy.context.preferences.view.show_splash = False
    yield 0.5
    yield from stage.show_tab()
    yield from stage.widen_sidebar(SIDEBAR_PX)
    yield from stage.picture("new-file")
    stage.expect("the default cube is active", bpy.context.object.name == "Cube")


def check_a_thing_for_a_hand(stage):
    yield from stage.key("S")
    for key in ("ZERO", "PERIOD", "ZERO", "FIVE"):
        yield from stage.key(key)
    yield from stage.key("RET")
    yield from stage.key("NUMPAD_7")
    yield 0.5
    with stage.over():
        bpy.ops.view3d.view_selected(use_all_regions=False)
    yield 0.8
    view = stage.area().spaces.active.region_3d
    view.view_distance, view.view_location = 1.5 * view.view_distance, (0.035, -0.028, 0.0)
    yield 0.3
    stage.expect("the cube is 10 cm wide", abs(bpy.context.object.dimensions.x - 0.1) < 1e-4)


def check_what_it_feels_like_is_chosen(stage):
    with tab.all_open("HNF_PT_materials"):
        yield from stage.drawn()
        at = yield from buttons.find(stage, "bpy.ops.hnf.material_choose(", across=0.5)
        yield from stage.click(at)
        yield 0.6
        for key in "CORD":
            yield from stage.key(key, at)
        yield from stage.picture("choose")
        yield from stage.key("RET", at)
        yield 0.4
    yield from stage.drawn()
    chosen = bpy.data.materials["Material"].hnf_touch.library
    stage.require("corduroy is chosen", chosen == "corduroy", chosen)
    yield from stage.picture("chosen")


def check_a_stroke_is_drawn(stage):
    with stage.over():
        bpy.ops.hnf.stroke_tool()
    tool = bpy.context.workspace.tools.from_space_view3d_mode("OBJECT")
    tool.operator_properties("hnf.stroke_draw").timing = "SPEED"
    yield 0.3
    path = [stage.seen_at((-0.036 + 0.0072 * k, 0.02 - 0.03 * (k / 10) ** 2, 0.05)) for k in range(11)]
    # Given up once: a photograph takes longer than a hand's stroke.
    yield from stage.move(path[0])
    stage.event("LEFTMOUSE", "PRESS", path[0])
    for at in path[1:8]:
        yield 0.02
        stage.event("MOUSEMOVE", "NOTHING", at)
    yield 0.3
    stage.photograph("drawing")
    yield from stage.key("ESC", path[7])
    stage.event("LEFTMOUSE", "RELEASE", path[7])
    yield 0.3
    stage.expect("Esc gives up", strokes() == [])
    yield from stage.drag(path)
    yield from stage.until("a stroke is there", lambda: len(strokes()) == 1, 10.0)
    yield from stage.until("its status is known", lambda: freshness(stroke().name) == "unbaked", 10.0)
    yield from stage.picture("drawn")


def check_it_is_baked(stage):
    began = time.monotonic()
    with stage.over():
        bpy.ops.hnf.bake("INVOKE_DEFAULT", True)
    yield from stage.until("the job is shown", lambda: state().job is not None, 5.0)
    yield from stage.until("it works", lambda: state().job is None or state().job.stage != "starting", 60.0)
    yield 0.4
    stage.photograph("baking")
    yield from stage.until("the bake ends", lambda: state().job is None, 90.0)
    stage.measured("bake of the first stroke", time.monotonic() - began, "s")
    stage.require("it went well", state().last_job.ok, state().last_job)
    yield from stage.until("it is fresh", lambda: freshness(stroke().name) == "fresh", 10.0)
    yield from stage.until("its signal is there", lambda: heard(stroke().name) is not None, 20.0)
    yield 1.0
    yield from stage.picture("baked")


def check_play_is_pressed(stage):
    """Other scenarios listen; here it is what ends the first steps."""
    stage.take_sound_device()
    with stage.over():
        bpy.ops.hnf.preview_play()
    yield 2.0
    stage.expect("the three steps are done", ours("state.addon_settings").is_guide_done())
    with stage.over():
        bpy.ops.hnf.preview_stop()
    yield from stage.picture("heard", settle=1.0)


def check_it_is_pressed_harder(stage):
    with stage.over():
        bpy.ops.hnf.preview_ab(action="KEEP")
        bpy.ops.hnf.force_graph("INVOKE_DEFAULT", True)
    yield from stage.picture("graph-editor", settle=1.5)
    region, keys = stage.region("WINDOW", "GRAPH_EDITOR"), force_keys(stroke())
    stage.require("a key at each end", len(keys) >= 2, keys)
    # A timer frames the keys: on a busy machine after the picture.
    wide = 2.0 * keys[-1][0]
    yield from stage.until("they are framed", lambda: region.view2d.region_to_view(region.width, 0)[0] < wide, 20.0)
    yield 0.5
    at = region.view2d.view_to_region(*keys[-1], clip=False)
    at = (region.x + at[0], region.y + at[1])
    yield from stage.click(at)
    yield 0.3
    first = heard(stroke().name).signal.samples.copy()
    for key in ("G", "Y", "TWO", "RET"):
        yield from stage.key(key, at)
    yield from stage.until(
        "the new force is heard", lambda: heard(stroke().name).signal.samples.tobytes() != first.tobytes(), 10.0
    )
    after = force_keys(stroke())
    stage.expect("the last key is two newtons up", abs(after[-1][1] - keys[-1][1] - 2.0) < 1e-3, (keys, after))
    stage.expect("the first is where it was", after[0] == keys[0], (keys, after))
    yield from stage.until("nothing is to bake", lambda: freshness(stroke().name) == "force", 5.0)
    moved = region.view2d.view_to_region(*after[-1], clip=False)
    stage.expect("the key is still in view, below the ruler", 0 < moved[1] < region.height - RULER_PX, moved)
    yield from stage.picture("harder", settle=1.5)
    with stage.over():
        bpy.ops.screen.screen_full_area()
    yield from stage.picture("harder-alone", settle=1.5)
    with stage.over():
        bpy.ops.screen.screen_full_area()
    yield 0.5
    samples = heard(stroke().name).signal.samples
    half = len(samples) // 2
    stage.expect("its end is stronger", (samples[half:] ** 2).mean() > (first[half:] ** 2).mean())


def check_it_is_exported(stage):
    FOLDER.mkdir()
    with stage.over():
        bpy.ops.wm.save_as_mainfile(filepath=str(FOLDER / "corduroy.blend"))
        stage.expect("written", bpy.ops.hnf.export() == {"FINISHED"})
        stage.expect("a strip", bpy.ops.hnf.add_to_sequencer("INVOKE_DEFAULT", True) == {"FINISHED"})
    files = sorted(path.name for path in FOLDER.glob("touch/*"))
    stage.expect("one WAV, and what it stands for", files == ["stroke-on-cube.wav", "stroke-on-cube.wav.json"], files)
    yield 0.3
    area = stage.area("GRAPH_EDITOR")
    area.type = "SEQUENCE_EDITOR"
    yield 0.6
    with stage.over("SEQUENCE_EDITOR"):
        bpy.ops.sequencer.view_all()
    yield from stage.picture("sequencer", settle=1.0)
