"""Every panel as an artist may meet it: empty and full, dark and light, wide and narrow, short names and long ones."""

from pathlib import Path

import bpy
import numpy as np
from drive import scenery
from drive.addon import baked, heard, kept, ours, state, strokes
from drive.tab import all_open

SCREEN = "1280x1900"
SMOOTH = "no"  # nobody looks at how its 3-D view is drawn
LONG = "Weathered oak plank from the harbour warehouse, second floor, left of the window"


def whole(stage):
    """The sidebar wide enough to read, every panel of the tab in view."""
    yield from stage.show_tab()
    yield from stage.widen_sidebar(340)


def settled(stage, name):
    """A panel that grew pushes those below it away step by step, and takes a step only when it is drawn: twice."""
    yield from stage.picture(name, settle=1.0)
    yield from stage.picture(name, settle=1.0)


def pages(stage, name, count):
    """NAME-1.png, NAME-2.png…: the whole sidebar from the top, a page each; the last one ends where it ends."""
    for page in range(1, count + 1):
        yield from settled(stage, f"{name}-{page}")
        with stage.over(region="UI"):
            bpy.ops.view2d.scroll_down(page=True)
    for _page in range(count):
        with stage.over(region="UI"):
            bpy.ops.view2d.scroll_up(page=True)


def check_a_new_file(stage):
    yield from whole(stage)
    yield from stage.picture("new-file")
    stage.expect("it stands on Touch", stage.region("UI").active_panel_category == "Touch")


def check_an_empty_scene(stage):
    scenery.empty_room()
    yield from whole(stage)
    yield from stage.picture("no-mesh")
    with all_open():
        yield from pages(stage, "no-mesh-open", 2)
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
    yield from settled(stage, "baked")
    stage.expect("four strokes with bakes", len(strokes()) == 4 and all(kept()[obj.name][-1] for obj in strokes()))


def picture_on_screen(stage, name):
    """Columns of the preview's picture and a row within it, in pixels of the window."""
    image = bpy.data.images.load(str(stage.photograph(name)))
    pixels = np.empty(len(image.pixels), dtype=np.float32)
    image.pixels.foreach_get(pixels)
    pixels = np.rint(255.0 * pixels).astype(np.uint8).reshape(image.size[1], image.size[0], 4)
    bpy.data.images.remove(image)
    drawing, box = ours("preview.stroke_image"), stage.region("UI")
    theme = heard("Stroke").style.theme
    for y in range(box.y + box.height - 100, box.y, -10):
        columns = drawing.find_on_screen(pixels, box.x + box.width // 2 - 20, y, theme)
        if columns:
            return columns, y - 20
    return None, 0


def check_a_press_on_the_picture_scrubs(stage):
    """At both sizes of the interface; a press on anything else in the tab moves no frame."""
    scene = bpy.context.scene
    bpy.context.view_layer.objects.active = bpy.data.objects["Stroke"]
    for scale in (1.0, 2.0):
        bpy.context.preferences.view.ui_scale = scale
        yield 0.6
        yield from stage.widen_sidebar(int(340 * scale))
        yield from stage.picture(f"playhead-{scale:g}", settle=1.0)
        columns, y = picture_on_screen(stage, f"playhead-{scale:g}")
        stage.require("the picture is found", columns, scale)
        first, last = columns
        stage.expect("it is as large as the interface", abs(last - first - 170 * scale) <= 6 * scale, columns)
        scene.frame_set(1)
        yield 0.2
        at = [(round(first + share * (last - first)), y) for share in (0.1, 0.3, 0.5, 0.75)]
        yield from stage.drag(at, pause=0.15)
        yield 0.4
        wanted = 1.0 + 0.75 * 0.6 * scene.render.fps
        stage.expect("the frame follows", abs(scene.frame_current - wanted) <= 1.0, (scene.frame_current, wanted))
        yield from stage.picture(f"scrubbed-{scale:g}")
        yield from stage.drag([(first - 8, y), (first - 8, y - 30), (last, y - 30)], pause=0.15)
        yield 0.4
        stage.expect("beside it nothing moves", abs(scene.frame_current - wanted) <= 1.0, scene.frame_current)
        scene.frame_set(1)
    bpy.context.preferences.view.ui_scale = 1.0
    yield 0.6
    yield from stage.widen_sidebar(340)


def check_light_theme(stage):
    folder = Path(bpy.utils.resource_path("SYSTEM")) / "scripts" / "presets" / "interface_theme"
    preset = next(path for path in folder.glob("*.xml") if "light" in path.name.lower())
    bpy.ops.script.execute_preset(filepath=str(preset), menu_idname="USERPREF_MT_interface_theme_presets")
    try:
        colour = bpy.context.preferences.themes[0].user_interface.wcol_regular.inner
        stage.expect("the theme is light", sum(colour[:3]) > 1.5, tuple(colour))
        yield from heard_in(stage, "LIGHT")
        yield from settled(stage, "light")
    finally:
        bpy.ops.preferences.reset_default_theme()
    yield from heard_in(stage, "DARK")


def heard_in(stage, theme):
    """Until the preview's picture is of this theme; nothing but the theme changed."""
    wanted = getattr(ours("preview.stroke_image"), theme)
    yield from stage.until(f"its picture is {theme}", lambda: heard("Stroke").style.theme == wanted, 20.0)


def check_every_panel_open(stage):
    with all_open():
        yield from pages(stage, "open", 3)
        yield from used(stage)
        yield from pages(stage, "used", 3)
        yield from stage.widen_sidebar(190)
        yield from pages(stage, "used-narrow", 4)
        yield from stage.widen_sidebar(340)
    bpy.data.objects["Stroke 2"].hnf_stroke.mute = False
    bpy.data.objects["Stroke 4"].hnf_stroke.duration_s = 0.5


def used(stage):
    """What Plan, Export and Diagnose show after their buttons were pressed."""
    bpy.ops.wm.save_as_mainfile(filepath=str(stage.folder / "panels.blend"), check_existing=False)
    bpy.context.scene.hnf.export_format = "haptic"
    with stage.over():
        stage.expect("exported", bpy.ops.hnf.export(all=True) == {"FINISHED"})
        stage.expect("looked closer", bpy.ops.hnf.diagnose() == {"FINISHED"})
    stage.expect("of each stroke is told what was lost", len(ours("preview.preview_state").PREVIEW.exported) == 4)
    bpy.data.objects["Stroke 2"].hnf_stroke.mute = True
    bpy.data.objects["Stroke 4"].hnf_stroke.duration_s = 0.8
    yield 1.0
    with stage.over():
        bpy.ops.hnf.plan()
    kinds = {line.kind for line in state().plan.lines}
    stage.expect("the plan has something of each", {"needed", "fresh", "skipped"} <= kinds, kinds)


def check_in_another_language(stage):
    """Words that Blender draws, words that the add-on puts together, and the room that longer ones need."""
    view = bpy.context.preferences.view
    view.language = "de_DE"
    try:
        yield 1.0
        stage.expect("labels are translated", bpy.app.translations.pgettext("Bake Touch") == "Berührung backen")
        with stage.over():
            bpy.ops.hnf.plan()
        with all_open():
            yield from pages(stage, "german", 3)
    finally:
        view.language = "en_US"
    yield 0.5
    stage.expect("and back", bpy.app.translations.pgettext("Bake Touch") == "Bake Touch")


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
