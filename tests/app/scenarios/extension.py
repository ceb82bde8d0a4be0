"""The add-on as a guest: light, leaving nothing behind, and taking what is dropped on the window."""

import sys
from pathlib import Path
from types import FunctionType

import bpy
from drive.addon import MODULE, ours

SMOOTH = "no"  # nobody looks at how its 3-D view is drawn
TIMES = 50
HANDLERS = [name for name in dir(bpy.app.handlers) if isinstance(getattr(bpy.app.handlers, name), list)]


def left_behind():
    """Everything of ours that Blender holds: handlers, timers, classes, keys, properties, menu entries, commands."""
    ours = [
        f"{name}: {call}" for name in HANDLERS for call in getattr(bpy.app.handlers, name) if MODULE in call.__module__
    ]
    classes = [
        kind.__name__
        for base in (bpy.types.Panel, bpy.types.Operator, bpy.types.UIList, bpy.types.Menu, bpy.types.PropertyGroup,
                     bpy.types.FileHandler, bpy.types.Header, bpy.types.GizmoGroup, bpy.types.AssetShelf)
        for kind in base.__subclasses__()
        if kind.__module__.startswith(MODULE) and getattr(kind, "is_registered", False)
    ]  # fmt: skip
    keys = [
        f"{keymap.name}: {item.idname}"
        for config in keyconfigs()
        for keymap in config.keymaps
        for item in keymap.keymap_items
        if "hnf" in item.idname or "hnf" in str(getattr(item.properties, "name", ""))
    ]
    properties = [
        f"{kind.__name__}.{name}"
        for kind in (bpy.types.Object, bpy.types.Scene, bpy.types.Material, bpy.types.WindowManager)
        for name in dir(kind)
        if "hnf" in name
    ]
    entries = [
        f"{menu}: {function.__module__}"
        for menu in dir(bpy.types)
        for function in getattr(getattr(getattr(bpy.types, menu), "draw", None), "_draw_funcs", ())
        if function.__module__.startswith(MODULE)
    ]
    operators = list(dir(bpy.ops.hnf))
    return ours + timers() + classes + keys + properties + entries + operators


def keyconfigs():
    every = bpy.context.window_manager.keyconfigs
    return every.addon, every.default, every.user


def timers():
    """Functions of ours that Blender calls by the clock."""
    return [
        f"timer: {module}.{name}"
        for module, held in sorted(sys.modules.items())
        if module.startswith(MODULE)
        for name, value in vars(held).items()
        if isinstance(value, FunctionType) and bpy.app.timers.is_registered(value)
    ]


def at_rest(stage):
    """Once what runs a single time, soon after a change, has run."""
    yield from stage.until(
        "nothing waits to be computed", lambda: not bpy.app.timers.is_registered(ours("tool.overlay")._refresh)
    )


def is_drawn(handle):
    """Does Blender still draw what this handle stands for? If so, no longer."""
    try:
        bpy.types.SpaceView3D.draw_handler_remove(handle, "WINDOW")
    except ValueError:
        return False
    return True


def counts():
    """How many of everything there are, whoever's."""
    return {
        "handlers": sum(len(getattr(bpy.app.handlers, name)) for name in HANDLERS),
        "panels": len(bpy.types.Panel.__subclasses__()),
        "keymaps": len(bpy.context.window_manager.keyconfigs.addon.keymaps),
        "keys": sum(len(one.keymap_items) for one in bpy.context.window_manager.keyconfigs.addon.keymaps),
    }


def check_the_window_takes_events(stage):
    """The driver itself: without this, nothing below would mean anything."""
    stage.expect("one window", len(bpy.context.window_manager.windows) == 1)
    with stage.over():
        bpy.ops.view3d.view_axis(type="TOP")
    yield 0.5
    before = stage.area().spaces.active.region_3d.view_distance
    yield from stage.key("NUMPAD_PLUS")
    yield 0.3
    stage.expect("a key reaches the view", stage.area().spaces.active.region_3d.view_distance < before)
    yield from stage.click(stage.seen_at((0.0, 0.0, 1.0)))
    yield 0.3
    stage.expect("a click selects the cube", [obj.name for obj in bpy.context.selected_objects] == ["Cube"])


def check_it_is_on_and_light(stage):
    names = [addon.module for addon in bpy.context.preferences.addons]
    stage.expect("it is on", MODULE in names, names)
    heavy = [name for name in ("torch", "scipy", "matplotlib", "hnf_core", "hnf_blender") if name in sys.modules]
    stage.expect("nothing heavy or foreign is imported", heavy == [], heavy)
    yield from stage.show_tab()
    yield from stage.picture("tab-on-the-default-cube")
    stage.expect("the tab is there", stage.region("UI").active_panel_category == "Touch")


def check_switched_off_it_leaves_nothing(stage):
    import addon_utils

    stage.expect("something is there while it is on", left_behind())
    stage.expect("timers among it", len(timers()) >= 2, timers())
    overlay = ours("tool.overlay").OVERLAY.handle
    addon_utils.disable(MODULE)
    yield 0.3
    stage.expect("it draws nothing while it is off", not is_drawn(overlay))
    stage.expect("nothing is there while it is off", left_behind() == [], left_behind())
    addon_utils.enable(MODULE)
    yield 0.3


def check_on_and_off_fifty_times(stage):
    import addon_utils

    yield from at_rest(stage)
    before, held = counts(), sorted(left_behind())
    for i in range(TIMES):
        addon_utils.disable(MODULE)
        if i % 10 == 0:
            yield 0.05  # and once in a while with redraws between
        addon_utils.enable(MODULE)
        if i % 10 == 0:
            yield 0.05
    yield from at_rest(stage)
    stage.expect("as many of everything as before", counts() == before, f"{before} → {counts()}")
    stage.expect("the same of ours as before", sorted(left_behind()) == held, set(left_behind()) ^ set(held))
    yield from stage.picture("after-fifty-times")


def check_a_second_blender_runs_beside_this_one(stage):
    """What the bake's child process needs."""
    import subprocess

    child = subprocess.Popen(
        [bpy.app.binary_path, "-b", "--factory-startup", "--python-expr", "print('CHILD IS HERE')"],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    yield from stage.until("the child ends", lambda: child.poll() is not None, 60.0)
    stage.expect("it ran", "CHILD IS HERE" in child.stdout.read(), child.returncode)


def check_a_material_file_is_dropped(stage):
    """As the file browser's drop calls it: the handler's operator, with the path, the mouse over the surface."""
    path = make_material_file(stage.folder)
    handler = next(kind for kind in bpy.types.FileHandler.__subclasses__() if kind.bl_file_extensions == ".hnf")
    stage.expect("a handler for .hnf", handler.bl_import_operator == "hnf.import_material")
    at = stage.seen_at((0.0, 0.0, 1.0))
    yield from stage.move(at)
    with stage.over():
        bpy.ops.hnf.import_material("INVOKE_DEFAULT", True, filepath=str(path))
    yield 0.4
    own = ours("bridge.scene.material_definition").get_artist_choice
    word = own(bpy.data.objects["Cube"].active_material)
    stage.expect("the cube feels like it", getattr(word, "name", "") != "", word)
    yield from stage.picture("material-dropped")
    yield from stage.key("Z", ctrl=True)
    yield 0.4
    word = own(bpy.data.objects["Cube"].active_material)
    stage.expect("one undo takes it back", word == "", word)


def check_the_asset_library_comes_and_goes(stage):
    libraries = bpy.context.preferences.filepaths.asset_libraries
    before = len(libraries)
    with stage.over():
        stage.expect("added", bpy.ops.hnf.assets_add() == {"FINISHED"})
    stage.require("one library more", len(libraries) == before + 1, [one.name for one in libraries])
    stage.expect("where blend files are", any(Path(libraries[-1].path).glob("**/*.blend")), libraries[-1].path)
    name = libraries[-1].name
    area = stage.area("DOPESHEET_EDITOR")
    area.ui_type = "ASSETS"
    yield 1.0
    area.spaces.active.params.asset_library_reference = name
    yield from enlarged(stage, "FILE_BROWSER")
    yield 3.0
    yield from stage.picture("asset-browser")
    with stage.over("FILE_BROWSER"):
        bpy.ops.screen.back_to_previous()
    yield 0.5
    with stage.over():
        stage.expect("removed", bpy.ops.hnf.assets_remove() == {"FINISHED"})
    stage.expect("as many as before", len(libraries) == before)


def enlarged(stage, kind):
    with stage.over(kind):
        bpy.ops.screen.screen_full_area()
    yield 0.6


def make_material_file(folder):
    """A .hnf file of a library material, as `hnf materials --export` writes it."""
    import subprocess

    path = folder / "dropped.hnf"
    done = subprocess.run(
        [bpy.app.binary_path, "-b", "--command", "hnf", "materials", "--export", "denim", "--out", str(path)],
        capture_output=True, text=True, timeout=100,
    )  # fmt: skip
    if not path.is_file():
        raise RuntimeError(done.stdout + done.stderr)
    return path
