"""Strokes on the virtual actuator: chosen, tested, played, looped, followed, dragged, touched live, lost and found."""

import json
import os
import signal
import time

import bpy
from drive import scenery
from drive.addon import baked, busy_children, children, heard, ours, strokes
from drive.tab import all_open
from drive.timing import Spent

SCREEN = "1280x1400"
SMOOTH = "no"  # nobody looks at how its 3-D view is drawn
QUICK_S = 0.1  # of one call in the window's own thread, without what other programs took of its core
FRAMES = 72
SOON_S = 30.0


def link():
    return ours("actuator.player_client").PLAYER_CLIENT


def facts():
    return ours("actuator.actuator_state").ACTUATOR.facts


def phase() -> str:
    return facts().phase.value


def choose(stage, target):
    with stage.over():
        stage.expect(f"'{target}' is chosen", bpy.ops.hnf.output_choose(target=target) == {"FINISHED"})
    yield 0.2


def check_a_baked_scene(stage):
    # The panel stands below and opens closed; in these pictures it is seen.
    panel = bpy.types.HNF_PT_actuator
    bpy.utils.unregister_class(panel)
    panel.bl_options, panel.bl_order = set(), -1
    bpy.utils.register_class(panel)
    scenery.empty_room()
    yield from stage.drawn("WINDOW")
    plate = scenery.plate(size_m=0.12)
    scenery.stroke_on(plate, "Along", 0.06, seconds=1.5)
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end, scene.sync_mode = 1, FRAMES, "FRAME_DROP"
    yield from scenery.look_at(stage, plate)
    yield from stage.show_tab()
    yield from stage.widen_sidebar(340)
    yield from baked(stage)
    yield from stage.until("its signal is there", lambda: heard("Along") is not None, SOON_S)
    yield from stage.picture("speakers")
    stage.expect("nothing runs beside Blender", busy_children() == [], children())


def check_live_touch_on_headphones_without_portaudio(stage):
    """One line says so, and it stays."""
    with stage.over():
        bpy.ops.hnf.live_touch("INVOKE_DEFAULT")
    yield from stage.until("it is told", lambda: facts().problem, SOON_S)
    stage.expect("in one line with its remedy", "libportaudio2" in facts().problem, facts().problem)
    yield from stage.move(stage.middle())
    yield from stage.until("it has ended", lambda: not stage.window().modal_operators, 5.0)
    yield from stage.picture("headphones-without-portaudio")
    stage.expect("it is still told", facts().problem)


def check_devices_are_looked_for(stage):
    state = ours("actuator.actuator_state").ACTUATOR
    with stage.over():
        bpy.ops.hnf.actuator_find()
    yield from stage.until("they were looked for", lambda: not state.is_scanning, SOON_S)
    stage.expect("without a fault", state.is_scanned, state.scan_notes)
    yield from stage.picture("found")


def check_the_test_button(stage):
    yield from choose(stage, "virtual")
    began = time.monotonic()
    with Spent() as spent:
        with stage.over():
            stage.expect("pressed", bpy.ops.hnf.actuator_test() == {"FINISHED"})
        yield from stage.until("it plays", lambda: phase() == "playing" and facts().level_m_s2 > 0.5, SOON_S)
        stage.measured("first sound of a fresh player", time.monotonic() - began, "s")
        yield from stage.picture("test", settle=0.2)
        yield from stage.until("it ends", lambda: phase() == "ready", SOON_S)
    stage.measured(f"longest call of ours ({spent.longest_name})", 1e3 * spent.longest, "ms")
    longest = max(max(times) for times in spent.undisturbed.values())
    stage.measured("the longest, without what others took of the core", 1e3 * longest, "ms")
    stage.expect("Blender waits for nothing", longest < QUICK_S, f"{longest:.3f} s {spent.longest_name}")
    stage.expect("without a fault", not facts().problem, facts().problem)


def check_play_and_a_changed_force(stage):
    bpy.context.scene.hnf.loop = True
    with stage.over():
        stage.expect("pressed", bpy.ops.hnf.preview_play() == {"FINISHED"})
    yield from stage.until("it plays", lambda: phase() == "playing", SOON_S)
    began, before = link().began, heard("Along")
    yield from stage.until(
        "what a skin would get is told", lambda: ours("actuator.actuator_state").ACTUATOR.skin_lines, SOON_S
    )
    with all_open("HNF_PT_output"):
        yield from stage.picture("playing", settle=1.5)
        with stage.over(region="UI"):
            bpy.ops.view2d.scroll_down(page=True)
        yield from stage.picture("playing", settle=1.0)
    curve = next(each for each in ours("compat").fcurves_of(strokes()[0]) if each.data_path == "hnf_stroke.force")
    curve.keyframe_points[-1].co[1] = 4.0
    curve.update()
    strokes()[0].update_tag()
    yield from stage.until("the change is there", lambda: heard("Along").stamp != before.stamp, SOON_S)
    yield 1.0
    stage.expect("it goes on", link().is_playing and link().began is began)
    with stage.over():
        bpy.ops.hnf.preview_stop()
    yield from stage.until("silent", lambda: phase() == "ready", SOON_S)
    stage.expect("without a fault", not facts().problem, facts().problem)
    bpy.context.scene.hnf.loop = False


def check_the_timeline(stage):
    bpy.context.scene.frame_set(1)
    yield 0.3
    before = link().current_status.status.play
    with stage.over():
        bpy.ops.screen.animation_play()
    try:
        yield from stage.until("it is felt with the timeline", lambda: felt_since(before), SOON_S)
        yield from stage.until("the playhead moves on", lambda: bpy.context.scene.frame_current >= 10, SOON_S)
    finally:
        with stage.over():
            bpy.ops.screen.animation_cancel(restore_frame=False)
    yield 0.4
    stage.expect("silent once the timeline stands", not link().is_playing)
    stage.expect("without a fault", not facts().problem, facts().problem)


def felt_since(play: int) -> bool:
    """A later play than this one has left for the device."""
    newest = link().current_status
    return newest is not None and newest.status.play > play and newest.status.peak > 0.0


def check_the_playhead_is_dragged(stage):
    area = stage.area("DOPESHEET_EDITOR")
    region = next(each for each in area.regions if each.type == "WINDOW")
    with bpy.context.temp_override(window=stage.window(), area=area, region=region):
        bpy.ops.action.view_all()
    yield 0.5
    bpy.context.scene.frame_set(1)
    header = region.y + region.height - 10
    at = [(region.x + region.width // 4 + 12 * k, header) for k in range(20)]
    numbers = {link().current_status.status.play}
    yield from stage.move(at[0])
    stage.event("LEFTMOUSE", "PRESS", at[0])
    for place in at[1:]:
        yield 0.08
        stage.event("MOUSEMOVE", "NOTHING", place)
        if link().current_status is not None:
            numbers.add(link().current_status.status.play)
    stage.event("LEFTMOUSE", "RELEASE", at[-1])
    yield 0.3
    stage.expect("the playhead went along", bpy.context.scene.frame_current > 1, bpy.context.scene.frame_current)
    yield from stage.until("it was felt, and is silent again", lambda: len(numbers) > 1 and not link().is_playing, 5.0)


def check_live_touch(stage):
    plate = bpy.data.objects["Plate"]
    yield from scenery.look_at(stage, plate)
    with stage.over():
        bpy.ops.hnf.live_touch("INVOKE_DEFAULT")
    yield from stage.until("the device is taken", lambda: phase() == "live", SOON_S)
    stage.expect("nothing is felt before the pen comes down", facts().level_m_s2 < 1e-3, facts().level_m_s2)
    places = [stage.seen_at((0.04 * (k % 40 / 20.0 - 1.0) * (-1) ** (k // 40), 0.0, 0.0)) for k in range(120)]
    levels = []
    with Spent() as spent:
        yield from stage.move(places[0])
        stage.event("LEFTMOUSE", "PRESS", places[0])
        for k, place in enumerate(places):
            yield 0.015
            stage.event("MOUSEMOVE", "NOTHING", place)
            levels.append(facts().level_m_s2)
            if k == 80:
                stage.photograph("live")
        stage.event("LEFTMOUSE", "RELEASE", places[-1])
        yield 0.2
    stage.expect("it is felt", max(levels) > 0.01, max(levels))
    stage.measured(f"longest call of ours ({spent.longest_name})", 1e3 * spent.longest, "ms")
    yield from stage.until("lifted, it is silent", lambda: facts().level_m_s2 < 1e-3, 5.0)
    yield from the_contact_is_drawn(stage, places[:40])
    stage.expect("no stroke was made", len(strokes()) == 1)
    yield from stage.key("ESC")
    yield from stage.until("Esc ends it", lambda: phase() == "ready", 5.0)
    stage.expect("without a fault", not facts().problem, facts().problem)


def the_contact_is_drawn(stage, places):
    """While the pen is down, and only then, under it and beside it."""
    at, height = places[20], stage.window().height
    part = (at[0] - 30, height - at[1] - 30, 260, 60)
    yield 2.0  # the view stands still
    before = stage.photograph("live-lifted", part).read_bytes()
    yield from stage.move(places[0])
    stage.event("LEFTMOUSE", "PRESS", places[0])
    for place in (*places[1:20], at):
        yield 0.05
        stage.event("MOUSEMOVE", "NOTHING", place)
    yield 1.0
    during = stage.photograph("live-touching", part).read_bytes()
    stage.photograph("live-contact")
    stage.event("LEFTMOUSE", "RELEASE", at)
    yield 2.0
    stage.expect("the contact is drawn", during != before)
    stage.expect("lifted, it is gone", stage.photograph("live-lifted-again", part).read_bytes() == before)


def check_a_player_that_dies(stage):
    with stage.over():
        bpy.ops.hnf.preview_play()
    yield from stage.until("it plays", lambda: phase() == "playing", SOON_S)
    os.kill(link().pid, signal.SIGKILL)
    yield from stage.until("it is told", lambda: facts().problem, 5.0)
    stage.expect("in one sentence", "was killed" in facts().problem, facts().problem)
    yield from stage.picture("lost")
    with stage.over():
        bpy.ops.hnf.preview_play()
    yield from stage.until("it plays again", lambda: phase() == "playing", SOON_S)
    stage.expect("and nothing is wrong any more", not facts().problem, facts().problem)


def check_a_sound_output_without_its_library(stage):
    """This machine has no PortAudio: Blender's own sound plays instead, within the limits."""
    stage.require("a sound device, one that plays to nowhere", stage.take_sound_device() != "None")
    stage.require("no PortAudio", "sounddevice" in ours("actuator.actuator_state").ACTUATOR.missing_packages)
    yield from choose(stage, "audio")
    player = ours("preview.controller").PLAYER
    with stage.over():
        stage.expect("pressed", bpy.ops.hnf.preview_play() == {"FINISHED"})
    yield from stage.until("it sounds", lambda: player.is_playing, SOON_S)
    stage.expect("without a player's process", not link().is_running)
    yield from stage.picture("whole", settle=0.3)
    with stage.over():
        bpy.ops.hnf.preview_stop()
    stage.expect("silent", not player.is_playing)
    yield from is_held_and_goes_on(stage)
    yield from choose(stage, "virtual")


def change_the_seed():
    strokes()[0].hnf_stroke.seed += 1
    strokes()[0].update_tag()


def is_held_and_goes_on(stage):
    """Played over and over, paused, changed while it is, let go: all at one place of the stroke. It is stopped in the
    end."""
    player, name = ours("preview.controller").PLAYER, strokes()[0].name
    bpy.context.scene.hnf.loop = True
    with stage.over():
        bpy.ops.hnf.preview_play()
    yield from stage.until("it sounds, somewhere", lambda: player.is_sounding and player.position_s > 0.1, SOON_S)
    with stage.over():
        stage.expect("held", bpy.ops.hnf.preview_pause() == {"FINISHED"})
    held, long_s = player.position_s, heard(name).signal.duration_s
    yield 0.4
    stage.expect("it stays there", player.is_paused and player.position_s == held, (held, player.position_s))
    before = heard(name)
    change_the_seed()
    yield from stage.until("a change is there", lambda: heard(name).stamp != before.stamp, SOON_S)
    yield 0.4
    stage.expect("still held, at the same place", player.is_paused and abs(player.position_s - held) < 0.01)
    began = time.monotonic()
    with stage.over():
        bpy.ops.hnf.preview_pause()
    yield from stage.until("it goes on", lambda: player.is_sounding and player.position_s != held, SOON_S)
    gone = (player.position_s - held + long_s / 2) % long_s - long_s / 2
    stage.expect("from there", -0.01 < gone < time.monotonic() - began + 0.05, gone)
    at, since = player.position_s, time.monotonic()
    change_the_seed()
    last = heard(name)
    yield from stage.until("another change", lambda: heard(name).stamp != last.stamp, SOON_S)
    yield from stage.until("which sounds", lambda: player.is_sounding, SOON_S)
    off = (player.position_s - at - (time.monotonic() - since) + long_s / 2) % long_s - long_s / 2
    stage.expect("where the other was", abs(off) < 0.35, off)
    with stage.over():
        bpy.ops.hnf.preview_stop()
    bpy.context.scene.hnf.loop = False
    stage.expect("silent", not player.is_playing and not player.is_paused)
    yield 0.3
    stage.expect("what faded out has ended", player._speakers._fading == [], player._speakers._fading)


def check_speakers_pause_and_go_on(stage):
    yield from choose(stage, "")
    yield from is_held_and_goes_on(stage)
    yield from choose(stage, "virtual")


def check_a_measured_actuator(stage):
    """What `hnf actuators measure` would have written of one that gives 8 dB too little above 100 Hz."""
    settings, frequency = bpy.context.scene.hnf, [20.0 * 1.1**k for k in range(42)]
    columns = {"frequency_hz": frequency, "gain_db": [-8.0 if each > 100.0 else 0.0 for each in frequency]}
    columns |= {"phase_rad": [0.0] * 42, "coherence": [1.0] * 42, "delay_s": 0.0}
    profile = {"schema": 1, "name": "mine", "title": "My coil", "source": "measured", "range_hz": [40, 800]}
    path = stage.folder / "mine.json"
    path.write_text(json.dumps(profile | {"peak_m_s2": 40.0, "response": columns}), "utf-8")
    settings.actuator, settings.actuator_file = "file", str(path)

    def told() -> str:
        return " ".join(ours("actuator.actuator_state").ACTUATOR.skin_lines)

    yield from stage.until("how far its bands are off is told", lambda: "uncorrected" in told(), SOON_S)
    yield from stage.picture("measured", settle=0.8)
    settings.actuator = "generic-voice-coil"
    yield from stage.until("and not of another", lambda: "uncorrected" not in told(), SOON_S)


def check_another_file_is_silence(stage):
    bpy.context.scene.hnf.loop = True
    with stage.over():
        bpy.ops.hnf.preview_play()
    yield from stage.until("it plays", lambda: phase() == "playing", SOON_S)
    pid = link().pid
    scenery.empty_room()
    yield from stage.until("its process is gone", lambda: pid not in children(), 5.0)
    yield from stage.until("the panel says so", lambda: phase() == "off", 5.0)
    yield from choose(stage, "")
    stage.expect("speakers again", ours("actuator.actuator_state").get_selected_output() == "")
