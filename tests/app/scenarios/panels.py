"""Every panel as an artist may meet it: empty and full, dark and light, wide and narrow, short names and long ones."""

from pathlib import Path

import bpy
from drive import scenery
from drive.addon import baked, heard, kept, state, strokes

SCREEN = "1280x1900"
SMOOTH = "no"  # nobody looks at how its 3-D view is drawn
LONG = "Weathered oak plank from the harbour warehouse, second floor, left of the window"


def whole(stage):
    """The sidebar wide enough to read, every panel of the tab in view."""
    yield from stage.show_tab()
    yield from stage.widen_sidebar(340)


def check_a_new_file(stage):
    yield from whole(stage)
    yield from stage.picture("new-file")
    stage.expect("it stands on Touch", stage.region("UI").active_panel_category == "Touch")


def check_an_empty_scene(stage):
    scenery.empty_room()
    yield from whole(stage)
    yield from stage.picture("no-mesh")
    stage.expect("no stroke", strokes() == [])


def check_a_stroke_that_is_not_baked(stage):
    plate = scenery.plate()
    obj = scenery.stroke_on(plate)
    yield from scenery.look_at(stage, plate)
    with stage.over():
        bpy.ops.hnf.stroke_select(name=obj.name)
        bpy.ops.hnf.suggest()
        bpy.ops.hnf.plan()
    yield from stage.picture("unbaked", settle=2.0)
    stage.expect("the plan is there", state().plan is not None)


def check_everything_baked(stage):
    plate = bpy.data.objects["Plate"]
    for k in range(1, 4):
        scenery.stroke_on(plate, f"Stroke {k + 1}", 0.05, 0.5, turned=0.5 * k)
    yield 0.3
    yield from baked(stage)
    with stage.over():
        bpy.ops.hnf.plan()
    yield from stage.until("its signal is there", lambda: heard("Stroke") is not None, 20.0)
    yield from stage.picture("baked", settle=2.0)
    stage.expect("four strokes with bakes", len(strokes()) == 4 and all(kept()[obj.name][-1] for obj in strokes()))


def check_long_names(stage):
    plate = bpy.data.objects["Plate"]
    plate.name = LONG[:60]
    plate.active_material.name = LONG[:60]
    for k, obj in enumerate(strokes()):
        obj.name = f"{LONG[:50]} {k}"
    yield 0.4
    yield from stage.picture("long-names")
    yield from stage.widen_sidebar(190)
    yield from stage.picture("long-names-narrow")
    yield from stage.widen_sidebar(340)
    stage.expect("nothing is lost by a name", len(strokes()) == 4)


def check_light_theme(stage):
    folder = Path(bpy.utils.resource_path("SYSTEM")) / "scripts" / "presets" / "interface_theme"
    preset = next(path for path in folder.glob("*.xml") if "light" in path.name.lower())
    bpy.ops.script.execute_preset(filepath=str(preset), menu_idname="USERPREF_MT_interface_theme_presets")
    yield 0.6
    yield from stage.picture("light")
    colour = bpy.context.preferences.themes[0].user_interface.wcol_regular.inner
    stage.expect("the theme is light", sum(colour[:3]) > 1.5, tuple(colour))
    bpy.ops.preferences.reset_default_theme()
    yield 0.4


def check_edit_mode(stage):
    yield from scenery.look_at(stage, next(obj for obj in bpy.data.objects if obj.type == "MESH"))
    yield from stage.key("TAB")
    yield 0.4
    stage.expect("Edit Mode", bpy.context.object.mode == "EDIT")
    yield from stage.picture("edit-mode")
    yield from stage.key("TAB")
    yield 0.3


def check_a_large_interface(stage):
    bpy.context.preferences.view.ui_scale = 1.5
    yield 0.6
    yield from stage.picture("large-interface")
    bpy.context.preferences.view.ui_scale = 1.0
    yield 0.4
    stage.expect("back to size", bpy.context.preferences.view.ui_scale == 1.0)


def check_the_preferences(stage):
    bpy.context.preferences.active_section = "ADDONS"
    with stage.over():
        bpy.ops.screen.userpref_show(section="ADDONS")
    yield 0.8
    bpy.context.window_manager.addon_search = "haptic"
    with bpy.context.temp_override(window=bpy.context.window_manager.windows[-1]):
        bpy.ops.preferences.addon_expand(module="bl_ext.user_default.hnf")
    yield from stage.picture("preferences")
    stage.expect("a window of preferences", len(bpy.context.window_manager.windows) == 2)
    with bpy.context.temp_override(window=bpy.context.window_manager.windows[-1]):
        bpy.ops.wm.window_close()
    yield 0.3


def check_the_list_in_a_file_that_was_opened(stage):
    """It follows what is selected, and keeps what is picked while other objects come and go."""
    path = stage.folder / "panels.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path), check_existing=False)
    bpy.ops.wm.open_mainfile(filepath=str(path))
    yield 1.0

    def picked():
        scene = bpy.context.scene
        return scene.objects[scene.hnf.stroke_index].name

    for name in sorted(obj.name for obj in strokes())[1:3]:
        bpy.context.view_layer.objects.active = bpy.context.scene.objects[name]
        yield 0.5
        stage.expect("it follows the selection", picked() == name, (picked(), name))
    last = picked()
    with stage.over():
        bpy.ops.object.empty_add()
    yield 1.0
    stage.expect("it keeps what is picked", picked() == last, (picked(), last))
