"""The window with the add-on on: drawn, quiet, light."""

import sys

import bpy


def check_the_window_is_drawn(stage):
    stage.expect("one window", len(bpy.context.window_manager.windows) == 1)
    yield from stage.show_tab("View")
    yield from stage.picture("window")
    area = stage.area()
    with stage.over():
        bpy.ops.view3d.view_axis(type="TOP")
    yield 0.5
    before = area.spaces.active.region_3d.view_distance
    yield from stage.key("NUMPAD_PLUS")
    yield 0.3
    stage.expect("a key reaches the view", stage.area().spaces.active.region_3d.view_distance < before)
    yield from stage.click(stage.seen_at((0.0, 0.0, 1.0)))
    yield 0.3
    stage.expect("a click selects the cube", [obj.name for obj in bpy.context.selected_objects] == ["Cube"])


def check_the_add_on_is_on_and_light(stage):
    names = [addon.module for addon in bpy.context.preferences.addons]
    stage.expect("it is on", "bl_ext.user_default.hnf" in names, names)
    heavy = [name for name in ("torch", "scipy", "matplotlib", "hnf_core", "hnf_blender") if name in sys.modules]
    stage.expect("nothing heavy or foreign is imported", heavy == [], heavy)
    yield 0.1
