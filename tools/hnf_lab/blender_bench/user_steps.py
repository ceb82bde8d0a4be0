"""Steps of a user, as random_steps takes them; this file needs bpy.

Each changes the scene that is shown, as a person would by the tab's buttons or Blender's own, and raises RefusedError
where it cannot be taken now.
"""

from __future__ import annotations

from collections.abc import Callable
from math import cos, pi, sin
from pathlib import Path
from typing import TYPE_CHECKING

import bpy
from mathutils import Euler, Matrix, Vector

from hnf_blender.preview.strips_and_speakers import iter_strips
from hnf_blender.preview.timeline_playback import on_frame_change, on_playback_post, on_playback_pre

if TYPE_CHECKING:
    from .random_steps import Walk

MOST_STROKES, MOST_SURFACES, MOST_SCENES = 8, 4, 3
"""Numbers above which nothing is added, so that a step stays quick."""
FRAMES = 40
"""Length of the scene."""


class RefusedError(Exception):
    """A step that cannot be taken now, or that the add-on refused in a sentence."""


def add_surface(walk: Walk) -> None:
    """Add a plate with a wave as its relief."""
    if len(walk.surfaces()) >= MOST_SURFACES:
        raise RefusedError("enough surfaces")
    mesh = bpy.data.meshes.new("Plate")
    mesh.from_pydata([(x, y, 0.0) for y in (-0.05, 0.05) for x in (-0.05, 0.05)], [], [(0, 1, 3, 2)])
    layer = mesh.uv_layers.new()
    for loop, place in zip(layer.uv, ((0, 0), (1, 0), (1, 1), (0, 1)), strict=True):
        loop.vector = place
    obj = bpy.data.objects.new("Plate", mesh)
    obj.location = (0.2 * len(walk.surfaces()), 0.0, 0.0)
    walk.scene.collection.objects.link(obj)
    material = bpy.data.materials.new(walk.random.choice(("Oak", "Denim", "Brass", "Thing")))
    if material.node_tree is None:
        material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    wave, bump = nodes.new("ShaderNodeTexWave"), nodes.new("ShaderNodeBump")
    wave.inputs["Scale"].default_value, bump.inputs["Distance"].default_value = 20.0, 1e-4
    links.new(wave.outputs["Fac"], bump.inputs["Height"])
    links.new(bump.outputs["Normal"], next(node for node in nodes if node.type == "BSDF_PRINCIPLED").inputs["Normal"])
    mesh.materials.append(material)
    walk.layer.update()


def draw(walk: Walk) -> None:
    """Draw a stroke on a surface, as the pen does."""
    if len(walk.strokes()) >= MOST_STROKES:
        raise RefusedError("enough strokes")
    surface = walk.choose(walk.surfaces())
    turn, samples = walk.random.uniform(0.0, 2.0 * pi), []
    for k in range(12):
        way = 0.02 * (k / 11 - 0.5)
        point = surface.matrix_world @ Vector((way * cos(turn), way * sin(turn), 0.0))
        samples.append({"name": "", "location": tuple(point), "pressure": 0.3 + 0.05 * k, "time": 0.02 * k,
                        "touching": True})  # fmt: skip
    bpy.ops.hnf.stroke_draw("EXEC_DEFAULT", stroke=samples, surface=surface.name)


def draw_across(walk: Walk) -> None:
    """Draw a stroke from one surface to another, as the pen does."""
    if len(walk.strokes()) >= MOST_STROKES:
        raise RefusedError("enough strokes")
    first, second = walk.choose(walk.surfaces()), walk.choose(walk.surfaces())
    samples: list[dict[str, object]] = []
    for number, surface in enumerate((first, second)):
        for k in range(6):
            point = surface.matrix_world @ Vector((0.004 * k - 0.01, 0.01 * number, 0.0))
            samples.append({"name": surface.name, "location": tuple(point), "pressure": 0.5,
                            "time": 0.02 * len(samples), "touching": True})  # fmt: skip
    bpy.ops.hnf.stroke_draw("EXEC_DEFAULT", stroke=samples, surface=first.name)


def add_ready_stroke(walk: Walk) -> None:
    """Lay a ready stroke on a surface."""
    if len(walk.strokes()) >= MOST_STROKES:
        raise RefusedError("enough strokes")
    walk.activate(walk.choose(walk.surfaces()))
    bpy.ops.hnf.stroke_add(primitive=walk.random.choice(("rub-fast", "left-right-soft", "top-bottom-hard")))


def bake(walk: Walk) -> None:
    bpy.ops.hnf.bake(only_active=False)


def undo(walk: Walk) -> None:
    walk.travel(-1)


def redo(walk: Walk) -> None:
    walk.travel(1)


def turn_everything(walk: Walk) -> None:
    """Turn and move all objects together: a rigid motion, which nobody feels."""
    motion = Matrix.Translation([walk.random.uniform(-0.3, 0.3) for _ in range(3)])
    motion @= Euler([walk.random.uniform(-pi, pi) for _ in range(3)]).to_matrix().to_4x4()
    for obj in walk.scene.objects:
        if obj.parent is None and obj.library is None:
            obj.matrix_world = motion @ obj.matrix_world


def turn_surface(walk: Walk) -> None:
    """Turn one surface, and leave strokes that do not ride on it behind."""
    obj = walk.choose_local(walk.surfaces())
    obj.rotation_euler[2] += walk.random.uniform(-pi, pi)


def rename(walk: Walk) -> None:
    """Rename a stroke, a surface, a material or the scene."""
    things = [*walk.strokes(), *walk.surfaces(), *bpy.data.materials, walk.scene]
    walk.choose_local(things).name = f"Renamed {walk.random.randrange(50)}"


def hide(walk: Walk) -> None:
    """Hide or show a stroke or a surface, in one of three ways."""
    obj = walk.choose([*walk.strokes(), *walk.surfaces()])
    way = walk.random.randrange(3)
    if way == 0 and obj.name in walk.layer.objects:
        obj.hide_set(not obj.hide_get(view_layer=walk.layer), view_layer=walk.layer)
    elif obj.library is None:
        name = "hide_viewport" if way == 1 else "hide_render"
        setattr(obj, name, not getattr(obj, name))


def show_all(walk: Walk) -> None:
    for obj in walk.scene.objects:
        if obj.name in walk.layer.objects:
            obj.hide_set(False, view_layer=walk.layer)
        if obj.library is None:
            obj.hide_viewport = obj.hide_render = False


def duplicate(walk: Walk) -> None:
    """Copy a stroke or a surface: its data too, or sharing it; by Blender or by the tab's button."""
    stroke = walk.random.random() < 0.7
    if len(walk.strokes()) >= MOST_STROKES or len(walk.surfaces()) >= MOST_SURFACES:
        raise RefusedError("enough of them")
    walk.activate(walk.choose(walk.strokes() if stroke else walk.surfaces()))
    if stroke and walk.random.random() < 0.3:
        bpy.ops.hnf.stroke_duplicate()
    else:
        bpy.ops.object.duplicate(linked=walk.random.random() < 0.5)


def delete(walk: Walk) -> None:
    """Delete a stroke by the tab's button or Blender's, or a surface."""
    if walk.random.random() < 0.75:
        obj = walk.activate(walk.choose(walk.strokes()))
        if walk.random.random() < 0.5:
            bpy.ops.hnf.stroke_delete()
        else:
            bpy.data.objects.remove(obj)
    elif len(walk.surfaces()) > 1:
        bpy.data.objects.remove(walk.choose(walk.surfaces()))


def delete_orphans(_walk: Walk) -> None:
    bpy.ops.hnf.strokes_delete_orphans()


def bring(walk: Walk, *, link: bool) -> None:
    """Append or link the strokes of the file that was saved last."""
    path = walk.folder / "saved.blend"
    if not path.is_file() or len(walk.strokes()) >= MOST_STROKES - 2:
        raise RefusedError("nothing to bring")
    if Path(bpy.data.filepath) == path:
        raise RefusedError("it is this file")
    with bpy.data.libraries.load(str(path), link=link) as (there, here):
        here.objects = [name for name in there.objects if name.startswith(("Stroke", "Plate", "Renamed", "Left"))][:2]
    for obj in here.objects:
        if obj is not None and obj.name not in walk.scene.collection.objects:
            walk.scene.collection.objects.link(obj)
    walk.layer.update()


def append(walk: Walk) -> None:
    bring(walk, link=False)


def link(walk: Walk) -> None:
    bring(walk, link=True)


def save(walk: Walk) -> None:
    """Save; now and then as the file that others are appended from."""
    name = walk.random.choice(("begun", "begun", "saved"))
    if any(Path(bpy.path.abspath(each.filepath)).stem == name for each in bpy.data.libraries):
        raise RefusedError("a file cannot link to itself")
    bpy.ops.wm.save_as_mainfile(filepath=str(walk.folder / f"{name}.blend"), copy=name == "saved")


def reload(walk: Walk) -> None:
    """Save, and open again: what is kept must be equal."""
    if any(obj.mode == "EDIT" for obj in walk.scene.objects):
        raise RefusedError("Edit Mode is written out when a file is saved")
    path = str(walk.folder / "begun.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    before = {key: value for key, value in walk.read_state().items() if not key.startswith(("mesh", "choice"))}
    bpy.ops.wm.open_mainfile(filepath=path)
    found = walk.read_state()
    lost = sorted(key for key, value in before.items() if found.get(key) != value and has_user(key))
    walk.forget_the_past()
    if lost:
        raise AssertionError(f"saved and opened, {lost} is another")


def has_user(key: str) -> bool:
    """Return whether a stroke is in the file that was just opened: Blender drops what nothing uses."""
    return key.partition(" ")[2] in {obj.name_full for obj in bpy.data.objects}


def switch_scene(walk: Walk) -> None:
    """Make a scene (empty, or a full copy), or show another."""
    scenes = list(bpy.data.scenes)
    if len(scenes) < MOST_SCENES and walk.random.random() < 0.4:
        bpy.ops.scene.new(type=walk.random.choice(("NEW", "FULL_COPY", "LINK_COPY")))
        if not walk.surfaces():
            add_surface(walk)
    else:
        bpy.context.window_manager.windows[0].scene = walk.choose(scenes)


def delete_scene(walk: Walk) -> None:
    if len(bpy.data.scenes) < 2:
        raise RefusedError("the last one stays")
    bpy.ops.scene.delete()


def switch_mode(walk: Walk) -> None:
    """Enter Edit, Sculpt or Paint Mode, or leave it."""
    active = walk.layer.objects.active
    if active is not None and active.mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")
        return
    obj = walk.activate(walk.choose_local([*walk.strokes(), *walk.surfaces()]))
    bpy.ops.object.mode_set(mode="EDIT" if obj.type == "CURVE" else walk.random.choice(("EDIT", "SCULPT")))


def leave_mode(walk: Walk) -> None:
    active = walk.layer.objects.active
    if active is None or active.mode == "OBJECT":
        raise RefusedError("in Object Mode already")
    bpy.ops.object.mode_set(mode="OBJECT")


def key_force(walk: Walk) -> None:
    stroke = walk.choose_local(walk.strokes())
    stroke.hnf_stroke.force = round(walk.random.uniform(0.2, 3.0), 2)
    stroke.keyframe_insert("hnf_stroke.force", frame=walk.random.randrange(1, 12))


def change_stroke(walk: Walk) -> None:
    """Change a setting of a stroke, as a script does: nobody reports it."""
    group = walk.choose_local(walk.strokes()).hnf_stroke
    name, values = walk.random.choice(
        (("seed", (0, 1, 2)), ("mute", (True, False)), ("probe", ("pen", "finger")), ("material", ("", "cork", "silk")),
         ("start", (1.0, 5.0, 12.0)), ("rides", (True, False)))
    )  # fmt: skip
    setattr(group, name, walk.random.choice(values))


def move_point(walk: Walk) -> None:
    curve = walk.choose_editable(walk.strokes()).data
    points = curve.splines[0].points or curve.splines[0].bezier_points
    points[0].co[0] += walk.random.uniform(-0.003, 0.003)


def dent(walk: Walk) -> None:
    mesh = walk.choose_editable(walk.surfaces()).data
    mesh.vertices[0].co.z += walk.random.uniform(-1e-4, 1e-4)
    mesh.update()


def choose_material(walk: Walk) -> None:
    material = walk.choose_local(list(bpy.data.materials))
    material.hnf_touch.library = walk.random.choice(("", "oak-wood", "denim"))


def change_units(walk: Walk) -> None:
    walk.scene.unit_settings.scale_length = walk.random.choice((1.0, 1.0, 0.9))


def add_strip(walk: Walk) -> None:
    walk.scene.hnf.export_folder = str(walk.folder / "out")
    walk.activate(walk.choose(walk.strokes()))
    bpy.ops.hnf.add_to_sequencer()


def add_speaker(walk: Walk) -> None:
    walk.activate(walk.choose(walk.strokes()))
    bpy.ops.hnf.add_speaker()


def change_source(walk: Walk) -> None:
    """Mute, hide, copy or delete a strip or a speaker."""
    strips = list(iter_strips(walk.scene))
    speakers = [obj for obj in walk.scene.objects if obj.type == "SPEAKER"]
    if strips and walk.random.random() < 0.5:
        strip, holder, _ = walk.choose(strips)
        if walk.random.random() < 0.7:
            strip.mute = not strip.mute
        else:
            holder.remove(strip)
        return
    speaker, way = walk.choose_local(speakers), walk.random.randrange(4)
    if way == 0:
        speaker.data.muted = not speaker.data.muted
    elif way == 1:
        speaker.hide_viewport = not speaker.hide_viewport
    elif way == 2:
        walk.activate(speaker)
        bpy.ops.object.duplicate()
    else:
        bpy.data.objects.remove(speaker)


def export(walk: Walk) -> None:
    walk.scene.hnf.export_folder = str(walk.folder / "out")
    bpy.ops.hnf.export(all=True)


def compare(walk: Walk) -> None:
    """Keep a signal as A, switch, or forget it."""
    walk.activate(walk.choose(walk.strokes()))
    bpy.ops.hnf.preview_ab(action=walk.random.choice(("KEEP", "SWITCH", "FORGET")))


def play(walk: Walk) -> None:
    """Press Play or Stop."""
    walk.activate(walk.choose(walk.strokes()))
    bpy.ops.hnf.preview_play()
    bpy.ops.hnf.preview_stop()


def play_timeline(walk: Walk) -> None:
    """Play the timeline from some frame, and stop it."""
    on_playback_pre(walk.scene)
    for frame in (walk.random.randrange(1, FRAMES), walk.random.randrange(1, FRAMES)):
        walk.scene.frame_set(frame)
        on_frame_change(walk.scene)
    on_playback_post()


UNDONE: set[Callable[[Walk], None]] = {undo, redo, save, reload, play, play_timeline, compare, export}
"""Steps after which no undo step is made."""
STEPS: dict[Callable[[Walk], None], float] = {
    add_surface: 1, draw: 4, draw_across: 1, add_ready_stroke: 3, bake: 5, undo: 12, redo: 6, turn_everything: 3,
    turn_surface: 2, rename: 4, hide: 4, show_all: 3, duplicate: 4, delete: 3, delete_orphans: 1, append: 1.5,
    link: 0.5, save: 1.5, reload: 1.5, switch_scene: 2, delete_scene: 0.5, switch_mode: 2, leave_mode: 2, key_force: 5,
    change_stroke: 5, move_point: 2, dent: 1, choose_material: 2, change_units: 0.5, add_strip: 2, add_speaker: 2,
    change_source: 3, export: 1, compare: 2, play: 2, play_timeline: 2,
}  # fmt: skip
"""Steps and how often each is taken, relatively."""
