"""Strokes in time: the playhead, the overlay, sound in step, the sequencer, speakers."""

import time

import bpy
from drive import scenery
from drive.addon import baked, freshness, heard, ours, strokes
from drive.timing import Spent

SCREEN = "1280x1100"
ALONE = "yes"  # it measures
FRAMES, STEP = 48, 4
QUICK_S = 5.0  # ten times what is promised: this may run on a busy machine
STILL_S = 15.0  # a view is drawn eight times, each smoother; in software, beside other work, that can take seconds
REST_S = 2.5  # Blender draws a view eight times after each change; in software that takes as long


def overlay_pixels(stage, name):
    """A photograph of the surface as the overlay draws on it, once the view stands still, for comparing."""
    yield from stage.drawn("WINDOW")
    yield 0.2
    at, reach = stage.seen_at((0.0, 0.0, 0.0)), 0.045
    right, top = stage.seen_at((reach, reach, 0.0))
    half = (right - at[0], top - at[1])
    height = stage.window().height
    part = (at[0] - half[0], height - at[1] - half[1], 2 * half[0], 2 * half[1])
    photograph, taken = b"", stage.photograph(name, part).read_bytes()
    until = time.monotonic() + STILL_S
    while photograph != taken and time.monotonic() < until:
        yield 0.3
        photograph, taken = taken, stage.photograph(name, part).read_bytes()
    stage.memory[name] = taken


def check_a_baked_scene(stage):
    scenery.empty_room()
    yield from stage.drawn("WINDOW")
    plate = scenery.plate(size_m=0.12)
    scenery.stroke_on(plate, "Along", 0.06, seconds=1.5)
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end, scene.sync_mode = 1, FRAMES, "AUDIO_SYNC"
    yield from scenery.look_at(stage, plate)
    yield from stage.show_tab()
    yield from baked(stage)
    yield from stage.until("its signal is there", lambda: heard("Along") is not None, 20.0)
    stage.expect("fresh", freshness("Along") == "fresh")


def check_the_contact_moves_with_the_playhead(stage):
    bpy.context.scene.frame_set(1)
    yield from overlay_pixels(stage, "playhead-at-1")
    bpy.context.scene.frame_set(20)
    yield from overlay_pixels(stage, "playhead-at-20")
    bpy.context.scene.frame_set(1)
    yield from overlay_pixels(stage, "playhead-back-at-1")
    before, after, again = (stage.memory[f"playhead-{name}"] for name in ("at-1", "at-20", "back-at-1"))
    stage.expect("another frame, another picture", before != after)
    stage.expect("the same frame, the same picture", before == again)


def check_without_the_overlay_nothing_is_drawn(stage):
    settings = bpy.context.preferences.addons["bl_ext.user_default.hnf"].preferences
    settings.overlay = False
    stage.area().tag_redraw()
    yield from overlay_pixels(stage, "overlay-off")
    settings.overlay = True
    stage.area().tag_redraw()
    yield from overlay_pixels(stage, "overlay-on")
    stage.expect("the switch is seen", stage.memory["overlay-off"] != stage.memory["overlay-on"])


def press_the_last_key(stage, newtons):
    """Seconds until the new signal is there."""
    before = heard("Along")
    curve = next(each for each in ours("compat").fcurves_of(strokes()[0]) if each.data_path == "hnf_stroke.force")
    changed = time.monotonic()
    curve.keyframe_points[-1].co[1] = newtons
    curve.update()
    strokes()[0].update_tag()
    yield from stage.until("it is heard", lambda: heard("Along").stamp != before.stamp, 10.0)
    stage.expect("the end is another", heard("Along").signal.samples[-1500] != before.signal.samples[-1500])
    return time.monotonic() - changed


def check_one_force_key_is_heard_at_once(stage):
    took = yield from press_the_last_key(stage, 2.5)
    stage.measured("one force key changed while the view is still being drawn → new signal", took, "s")
    stage.expect("at once", took < QUICK_S, f"{took:.2f} s")
    yield REST_S
    took = yield from press_the_last_key(stage, 3.0)
    stage.measured("one force key changed → new signal", took, "s")
    stage.expect("at once, from rest", took < QUICK_S, f"{took:.2f} s")
    yield from stage.until("nothing is to bake", lambda: freshness("Along") == "force", 5.0)


def check_playback_sounds_and_moves_on(stage):
    player, follower = ours("preview.controller").PLAYER, ours("preview.timeline_playback").FOLLOWER
    scene, unbroken = bpy.context.scene, 0
    for _device in range(2):  # another one: what was open is gone
        bpy.context.preferences.system.audio_device = "None"
        stage.require("a sound device, one that plays to nowhere", stage.take_sound_device() != "None")
        for _time in range(2):
            scene.frame_set(1)
            yield 0.3
            with stage.over():
                bpy.ops.screen.animation_play()
            yield from stage.until("the stroke sounds with the timeline", lambda: player.is_playing, 10.0)
            yield from stage.until("the playhead moves on", lambda: scene.frame_current >= 10, 10.0)
            begun = {follower.start_frame}
            while scene.frame_current >= 10 and player.is_playing:
                begun.add(follower.start_frame)
                yield 0.05
            with stage.over():
                bpy.ops.screen.animation_play()
            yield 0.3
            unbroken += len(begun) == 1
            stage.expect("no sound once the timeline stands", not player.is_playing)
    # Where the machine stands still for a moment, sound is moved to the picture.
    stage.expect("it keeps to the playhead without being moved", unbroken >= 2, unbroken)


def check_scrubbing(stage):
    with Spent() as spent:
        for frame in range(1, FRAMES + 1, STEP):
            bpy.context.scene.frame_set(frame)
            yield 0.01
    stage.measured(
        "scrubbing: time in our own calls", 1e3 * sum(map(sum, spent.calls.values())) / (FRAMES / STEP), "ms a frame"
    )
    stage.measured(f"scrubbing: longest single call ({spent.longest_name})", 1e3 * spent.longest, "ms")
    with stage.over():
        bpy.ops.screen.frame_jump(end=False)
    yield 0.2
    stage.expect("back at the start", bpy.context.scene.frame_current == 1)
    stage.expect("scrubbing made nothing stale", freshness("Along") == "force", freshness("Along"))


def check_into_the_sequencer(stage):
    bpy.context.scene.hnf.export_folder = str(stage.folder / "wavs")
    with stage.over():
        stage.expect("added", bpy.ops.hnf.add_to_sequencer("INVOKE_DEFAULT", True) == {"FINISHED"})
    yield 0.3
    editor = bpy.context.scene.sequence_editor
    strips = list(editor.strips if hasattr(editor, "strips") else editor.sequences)
    stage.expect("one sound strip", [strip.type for strip in strips] == ["SOUND"], strips)
    start = strokes()[0].hnf_stroke.start
    stage.expect("at the stroke's start", abs(strips[0].frame_final_start - start) <= 1, strips[0].frame_final_start)
    with stage.over():
        bpy.ops.hnf.add_to_sequencer("INVOKE_DEFAULT", True)
    yield 0.2
    again = list(editor.strips if hasattr(editor, "strips") else editor.sequences)
    stage.expect("a second time it is replaced", len(again) == 1, again)
    area = stage.area("DOPESHEET_EDITOR")
    area.type = "SEQUENCE_EDITOR"
    yield 0.6
    stage.expect("the sequencer shows this scene", stage.window().workspace.sequencer_scene == bpy.context.scene)
    with stage.over("SEQUENCE_EDITOR"):
        bpy.ops.sequencer.view_all()
    yield from stage.picture("sequencer", settle=1.0)


def check_a_speaker_at_the_stroke(stage):
    with stage.over():
        stage.expect("added", bpy.ops.hnf.add_speaker("INVOKE_DEFAULT", True) == {"FINISHED"})
    yield 0.4
    speakers = [obj for obj in bpy.context.scene.objects if obj.type == "SPEAKER"]
    stage.require("one speaker", len(speakers) == 1, speakers)
    stage.expect("with a sound", speakers[0].data.sound is not None)
    stage.expect("packed", speakers[0].data.sound.packed_file is not None)
    distance = (speakers[0].matrix_world.translation - bpy.data.objects["Plate"].matrix_world.translation).length
    stage.expect("where the stroke is", distance < 0.06, distance)
    yield from stage.picture("speaker")
    yield from stage.key("Z", ctrl=True)
    yield 0.5
    stage.expect("one undo takes it away", not [obj for obj in bpy.context.scene.objects if obj.type == "SPEAKER"])
    stage.expect("and leaves the stroke", len(strokes()) == 1)
