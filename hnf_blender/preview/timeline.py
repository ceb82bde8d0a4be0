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

LINGER_S = 1.0
"""Of silence after what sounds. The device stays open when the playhead has moved: to take one takes longer than to
move on. And a device that loses count of its last buffers (OpenAL, by up to a sixth of a second) does so in it."""


class Follower:
    """What of the timeline sounds now. begun_at: frame at which it began; None while nothing plays. waits: it sounds
    from the next frame on."""

    def __init__(self) -> None:
        self.begun_at: float | None = None
        self.waits = False
        self.scene = ""

    def plays(self, scene: Any) -> bool:
        return self.begun_at is not None and self.scene == scene.name

    def wait(self, scene: Any) -> None:
        """Begin to sound with the next frame that is shown."""
        self.begun_at, self.scene, self.waits = float(scene.frame_current_final), scene.name, True

    def start(self, scene: Any) -> None:
        """Sound what lies ahead of the present frame. Nothing where sound is missing: the timeline plays on."""
        from hnf_core.errors import HnfError

        from .current import PLAYER

        self.begun_at, self.scene, self.waits = None, scene.name, False
        if not scene.hnf.follow_timeline:
            return
        last = scene.frame_preview_end if scene.use_preview_range else scene.frame_end
        PREVIEW.sounding = ""
        self.begun_at = float(scene.frame_current_final)
        ahead = sound_ahead(scene, float(last))
        if ahead is None:
            PLAYER.stop()
            return
        with contextlib.suppress(HnfError):
            PLAYER.play(lingering(ahead))

    def stop(self) -> None:
        from .current import PLAYER

        if self.begun_at is not None:
            PLAYER.stop()
        self.begun_at, self.waits = None, False

    def follow(self, scene: Any) -> None:
        """Another frame is shown: where the timeline jumped, the sound jumps too."""
        from .current import PLAYER
        from .placement import Clock, has_jumped

        if self.begun_at is None or not self.plays(scene):
            return
        clock = Clock(float(scene.render.fps), float(scene.render.fps_base))
        frame = float(scene.frame_current_final)
        went_back = frame < self.begun_at
        if (
            self.waits
            or went_back
            or (PLAYER.is_sounding and has_jumped(frame, PLAYER.position_s, self.begun_at, clock))
        ):
            self.start(scene)

    def scrub(self, scene: Any) -> None:
        """The playhead was dragged to another frame: feel the moment there, on an actuator alone. Speakers are left to
        Blender's own scrubbing."""
        from hnf_core.errors import HnfError

        from ..actuator.choice import chosen_output
        from ..actuator.state import SPEAKERS
        from .current import PLAYER

        if chosen_output() == SPEAKERS or not scene.hnf.follow_timeline:
            return
        frames = max(1.0, SCRUB_S * scene.render.fps / scene.render.fps_base)
        moment = sound_ahead(scene, float(scene.frame_current_final) + frames - 1.0)
        if moment is None:
            return
        PREVIEW.sounding = ""
        with contextlib.suppress(HnfError):
            PLAYER.play(lingering(moment))


FOLLOWER = Follower()


def sound_ahead(scene: Any, last_frame: float) -> Sound | None:
    """What sounds from the present frame to the end of last_frame; None where nothing does."""
    from .current import sound_of
    from .placement import Clock, mix

    clock = Clock(float(scene.render.fps), float(scene.render.fps_base))
    placed = placed_strokes(scene)
    samples = mix(placed, float(scene.frame_current_final), last_frame, clock)
    return sound_of(samples, placed[0].rate, scene) if len(samples) else None


def lingering(moment: Sound) -> Sound:
    """A sound and LINGER_S of silence after it."""
    quiet = np.zeros(round(LINGER_S * moment.rate), dtype=np.float32)
    return replace(moment, samples=np.concatenate([moment.samples, quiet]))


def placed_strokes(scene: Any) -> list[Any]:
    """Signals that are there and true, of strokes that are not muted, at their start frames."""
    from ..props.scene import listed_strokes
    from .current import problem_of
    from .placement import Placed

    placed = []
    for obj in listed_strokes(scene):
        shown = PREVIEW.shown(obj.name)
        if shown is not None and not obj.hnf_stroke.mute and not problem_of(obj.name, scene):
            placed.append(Placed(float(obj.hnf_stroke.start), shown.signal.samples, shown.signal.sample_rate))
    return placed


def playback_begins(scene: Any, _depsgraph: Any = None) -> None:
    """animation_playback_pre. Blender opens its sound device after it: speakers wait for the next frame."""
    from .current import PLAYER

    if PLAYER.share(True):
        FOLLOWER.wait(scene)
    else:
        FOLLOWER.start(scene)


def playback_ends(_scene: Any = None, _depsgraph: Any = None) -> None:
    """animation_playback_post."""
    from .current import PLAYER

    FOLLOWER.stop()
    PLAYER.share(False)


def frame_shown(scene: Any, _depsgraph: Any = None) -> None:
    """frame_change_post."""
    import bpy

    if FOLLOWER.begun_at is not None:
        FOLLOWER.follow(scene)
        return
    windows = bpy.context.window_manager.windows
    if any(window.screen.is_scrubbing and window.scene.name == scene.name for window in windows):
        FOLLOWER.scrub(scene)
