"""Strokes sound where they stand in time while the timeline plays."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from .facts import PREVIEW

if TYPE_CHECKING:
    from ..actuator.sound import Sound

SCRUB_S = 0.06
"""Of a stroke that is felt where the playhead is dragged to, or a frame where that is longer."""

TAIL_S = 1.0
"""Of silence after what sounds. The device stays open when the playhead has moved: to take one takes longer than to
move on. And a device that loses count of its last buffers (OpenAL, by up to a sixth of a second) does so in it."""


class PlayheadFollower:
    """What of the timeline sounds now. begun_at: frame at which it began; None while nothing plays. waits: it sounds
    from the next frame on."""

    def __init__(self) -> None:
        self.start_frame: float | None = None
        self.is_waiting = False
        self.scene = ""

    def is_playing(self, scene: Any) -> bool:
        return self.start_frame is not None and self.scene == scene.name

    def wait(self, scene: Any) -> None:
        """Begin to sound with the next frame that is shown."""
        self.start_frame, self.scene, self.is_waiting = float(scene.frame_current_final), scene.name, True

    def start(self, scene: Any) -> None:
        """Sound what lies ahead of the present frame. Nothing where sound is missing: the timeline plays on."""
        from hnf_core.errors import HnfError

        from .current import PLAYER

        self.start_frame, self.scene, self.is_waiting = None, scene.name, False
        if not scene.hnf.follow_timeline:
            return
        last = scene.frame_preview_end if scene.use_preview_range else scene.frame_end
        PREVIEW.sounding = ""
        self.start_frame = float(scene.frame_current_final)
        ahead = make_sound_ahead(scene, float(last))
        if ahead is None:
            PLAYER.stop()
            return
        with contextlib.suppress(HnfError):
            PLAYER.play(pad_with_silence(ahead))

    def stop(self) -> None:
        from .current import PLAYER

        if self.start_frame is not None:
            PLAYER.stop()
        self.start_frame, self.is_waiting = None, False

    def follow(self, scene: Any) -> None:
        """Another frame is shown: where the timeline jumped, the sound jumps too."""
        from .current import PLAYER
        from .placement import FrameClock, has_jumped

        if self.start_frame is None or not self.is_playing(scene):
            return
        clock = FrameClock(float(scene.render.fps), float(scene.render.fps_base))
        frame = float(scene.frame_current_final)
        went_back = frame < self.start_frame
        if (
            self.is_waiting
            or went_back
            or (PLAYER.is_sounding and has_jumped(frame, PLAYER.position_s, self.start_frame, clock))
        ):
            self.start(scene)

    def scrub(self, scene: Any) -> None:
        """The playhead was dragged to another frame: feel the moment there, on an actuator alone. Speakers are left to
        Blender's own scrubbing."""
        from hnf_core.errors import HnfError

        from ..actuator.choice import get_selected_output
        from ..actuator.state import SPEAKERS
        from .current import PLAYER

        if get_selected_output() == SPEAKERS or not scene.hnf.follow_timeline:
            return
        frames = max(1.0, SCRUB_S * scene.render.fps / scene.render.fps_base)
        moment = make_sound_ahead(scene, float(scene.frame_current_final) + frames - 1.0)
        if moment is None:
            return
        PREVIEW.sounding = ""
        with contextlib.suppress(HnfError):
            PLAYER.play(pad_with_silence(moment))


FOLLOWER = PlayheadFollower()


def make_sound_ahead(scene: Any, last_frame: float) -> Sound | None:
    """What sounds from the present frame to the end of last_frame; None where nothing does."""
    from .current import make_sound
    from .placement import FrameClock, mix_strokes

    clock = FrameClock(float(scene.render.fps), float(scene.render.fps_base))
    placed = list_placed_signals(scene)
    samples = mix_strokes(placed, float(scene.frame_current_final), last_frame, clock)
    return make_sound(samples, placed[0].rate, scene) if len(samples) else None


def pad_with_silence(sound: Sound) -> Sound:
    """A sound and LINGER_S of silence after it."""
    quiet = np.zeros(round(TAIL_S * sound.rate), dtype=np.float32)
    return replace(sound, samples=np.concatenate([sound.samples, quiet]))


def list_placed_signals(scene: Any) -> list[Any]:
    """Signals that are there and true, of strokes that are not muted, at their start frames."""
    from ..props.scene import list_cached_strokes
    from .current import get_problem
    from .placement import PlacedSignal

    placed = []
    for obj in list_cached_strokes(scene):
        shown = PREVIEW.get_shown(obj.name)
        if shown is not None and not obj.hnf_stroke.mute and not get_problem(obj.name, scene):
            placed.append(PlacedSignal(float(obj.hnf_stroke.start), shown.signal.samples, shown.signal.sample_rate))
    return placed


def on_playback_pre(scene: Any, _depsgraph: Any = None) -> None:
    """animation_playback_pre. Blender opens its sound device after it: speakers wait for the next frame."""
    from .current import PLAYER

    if PLAYER.use_shared_device(True):
        FOLLOWER.wait(scene)
    else:
        FOLLOWER.start(scene)


def on_playback_post(_scene: Any = None, _depsgraph: Any = None) -> None:
    """animation_playback_post."""
    from .current import PLAYER

    FOLLOWER.stop()
    PLAYER.use_shared_device(False)


def on_frame_change(scene: Any, _depsgraph: Any = None) -> None:
    """frame_change_post."""
    import bpy

    if FOLLOWER.start_frame is not None:
        FOLLOWER.follow(scene)
        return
    windows = bpy.context.window_manager.windows
    if any(window.screen.is_scrubbing and window.scene.name == scene.name for window in windows):
        FOLLOWER.scrub(scene)
