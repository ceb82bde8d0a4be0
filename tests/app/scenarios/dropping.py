"""Files dropped on the window: the zip itself, a material, a sound; and the asset library, offered and used."""

import struct
from pathlib import Path

import bpy
from drive.addon import MODULE, ours
from drive.scenery import empty_room, look_at, plate, stroke_on

INSTALLED = "no"
SCREEN = "1280x800"
SMOOTH = "no"  # nobody looks at how its 3-D view is drawn
DIST = Path("/share/dist")


def dropped(stage, path, at):
    """What Blender does when a file is let go over a place: its own operator picks the file handler."""
    yield from stage.move(at)
    yield 0.2
    with stage.over():
        bpy.ops.wm.drop_import_file("INVOKE_DEFAULT", directory=str(path.parent), files=[{"name": path.name}])
    yield 0.5


def write_material(path, name):
    files = ours("hnf_core.material.hnf_file")
    files.write_hnf(path, files.from_library(ours("hnf_core.material.library").get_material(name)))


def check_the_zip_is_dropped(stage):
    (archive,) = DIST.glob("*.zip")
    stage.expect("it is not there before", MODULE not in bpy.context.preferences.addons)
    yield from stage.move(stage.middle())
    with stage.over():
        bpy.ops.extensions.package_install_files("INVOKE_DEFAULT", url=str(archive))
    yield 0.6
    yield from stage.picture("zip-dropped")
    yield from stage.key("RET")
    yield from stage.until("it is installed and on", lambda: MODULE in bpy.context.preferences.addons, 60.0)
    yield from stage.until("it works", lambda: hasattr(bpy.types.Object, "hnf_stroke"), 20.0)
    empty_room()
    yield 0.5
    yield from stage.show_tab()
    yield from stage.picture("tab-after-the-drop")


def check_a_material_goes_where_the_mouse_is(stage):
    left, right = plate("Left", at=(-0.1, 0.0, 0.0)), plate("Right", at=(0.1, 0.0, 0.0))
    yield from look_at(stage, left)
    with stage.over():
        bpy.ops.view3d.view_all()
    yield 0.6
    material = stage.folder / "own-knit.hnf"
    write_material(material, "wool-knit")
    bpy.context.view_layer.objects.active = left
    yield from dropped(stage, material, stage.seen_at((0.1, 0.0, 0.0)))
    carried = ours("bridge.scene.material_definition").get_definition
    stage.expect("the plate under the mouse has it", carried(right.active_material) is not None)
    stage.expect("the active one has not", left.active_material == right.active_material
                 or carried(left.active_material) is None)  # fmt: skip
    bpy.context.view_layer.objects.active = right
    yield from stage.show_tab()
    yield from stage.picture("material-dropped")
    bpy.ops.ed.undo_push(message="after the drop")


def check_a_sound_becomes_a_speaker_at_the_stroke(stage):
    stroke = stroke_on(bpy.data.objects["Right"])
    bpy.context.view_layer.objects.active = stroke
    sound = stage.folder / "tick.wav"
    samples = b"".join(struct.pack("<h", 12000 if i % 80 < 4 else 0) for i in range(8000))
    head = struct.pack("<4sI8sIHHIIHH4sI", b"RIFF", 36 + len(samples), b"WAVEfmt ", 16, 1, 1, 8000, 16000, 2, 16,
                       b"data", len(samples))  # fmt: skip
    sound.write_bytes(head + samples)
    yield from dropped(stage, sound, stage.seen_at((0.1, 0.0, 0.0)))
    speakers = [obj for obj in bpy.context.scene.objects if obj.type == "SPEAKER"]
    stage.require("there is one speaker", len(speakers) == 1, speakers)
    stage.expect("it moves with the stroke", speakers[0].parent == stroke)
    stage.expect("it plays the file", speakers[0].data.sound is not None)
    yield from stage.picture("sound-dropped")


def check_the_asset_library_is_offered_and_used(stage):
    libraries = bpy.context.preferences.filepaths.asset_libraries
    before = [library.name for library in libraries]
    stage.expect("it is not put there in silence", not any("Haptic" in name for name in before), before)
    bpy.ops.hnf.assets_add()
    name = next(library.name for library in libraries if library.name not in before)
    area = stage.area()
    area.ui_type = "ASSETS"
    yield 0.5
    area.spaces.active.params.asset_library_reference = name
    yield 3.0
    yield from stage.picture("asset-browser")
    bpy.ops.hnf.assets_remove()
    stage.expect("it is taken away again", [library.name for library in libraries] == before)
    area.ui_type = "VIEW_3D"
    yield 0.5


def check_a_bad_material_is_refused_in_words(stage):
    bad = stage.folder / "bad.hnf"
    bad.write_bytes(b"not a material")
    before = len(bpy.data.materials)
    yield from stage.move(stage.seen_at((0.1, 0.0, 0.0)))
    try:
        with stage.over():
            bpy.ops.wm.drop_import_file("INVOKE_DEFAULT", directory=str(bad.parent), files=[{"name": bad.name}])
    except RuntimeError as error:
        stage.expect("it says which file", "bad.hnf" in str(error), error)
    yield 0.5
    stage.expect("no material was made", len(bpy.data.materials) == before)
    yield from stage.picture("bad-material")
