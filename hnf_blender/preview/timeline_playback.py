"""Where strokes sound on the timeline: frames and seconds, and one track mixed from many strokes. Pure numpy.

Strokes sound where they stand in time while the timeline plays.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hnf_core.units import frame_to_seconds

from .preview_state import PREVIEW

if TYPE_CHECKING:
    from ..actuator.sound import Sound

Samples = NDArray[np.float32]

MAX_DRIFT_S = 0.1
"""Sound further than this from the picture is moved to it: Blender may drop or delay frames, sound does not."""


class FrameClock(NamedTuple):
    """Frames per second of a scene: fps / fps_base."""

    fps: float
    fps_base: float = 1.0

    def seconds(self, frame: float, start: float) -> float:
        """From start to frame; frames may be fractions."""
        return frame_to_seconds(frame, start, self.fps, self.fps_base)


class PlacedSignal(NamedTuple):
    """A stroke's samples at rate [Hz], the first of them at frame start."""

    start: float
    samples: Samples
    rate: float

    def end(self, clock: FrameClock) -> float:
        """Frame at which the last sample has sounded."""
        return self.start + len(self.samples) / self.rate * clock.fps / clock.fps_base


def mix_strokes(strokes: Sequence[PlacedSignal], frame: float, last_frame: float, clock: FrameClock) -> Samples:
    """What sounds from frame to the end of last_frame: the sum of the strokes, (n,) at their common rate.

    A stroke that has begun before is joined midway; empty where nothing sounds any more. Raises ValueError for
    strokes of several rates.
    """
    if not strokes:
        return np.zeros(0, dtype=np.float32)
    rates = {each.rate for each in strokes}
    if len(rates) > 1:
        raise ValueError(f"strokes of several sample rates: {sorted(rates)}")
    rate = rates.pop()
    most = max(round(clock.seconds(last_frame + 1.0, frame) * rate), 0)
    begins = [round(clock.seconds(each.start, frame) * rate) for each in strokes]
    length = max(min(max(begin + len(each.samples) for begin, each in zip(begins, strokes, strict=True)), most), 0)
    out = np.zeros(length, dtype=np.float32)
    for begin, each in zip(begins, strokes, strict=True):
        low, high = max(begin, 0), min(begin + len(each.samples), length)
        if low < high:
            out[low:high] += each.samples[low - begin : high - begin]
    return out


def has_jumped(frame: float, expected_s: float, start_frame: float, clock: FrameClock) -> bool:
    """Is the timeline elsewhere than the sound? expected_s: how long the sound plays since frame begun_at."""
    return abs(clock.seconds(frame, start_frame) - expected_s) > MAX_DRIFT_S + clock.seconds(1.0, 0.0)


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

        from .controller import PLAYER

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
        from .controller import PLAYER

        if self.start_frame is not None:
            PLAYER.stop()
        self.start_frame, self.is_waiting = None, False

    def follow(self, scene: Any) -> None:
        """Another frame is shown: where the timeline jumped, the sound jumps too."""
        from .controller import PLAYER

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

        from ..actuator.actuator_state import SPEAKERS, get_selected_output
        from .controller import PLAYER

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
    from .controller import make_sound

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
    from ..props.scene_settings import list_cached_strokes
    from .controller import get_problem

    placed = []
    for obj in list_cached_strokes(scene):
        shown = PREVIEW.get_shown(obj.name)
        if shown is not None and not obj.hnf_stroke.mute and not get_problem(obj.name, scene):
            placed.append(PlacedSignal(float(obj.hnf_stroke.start), shown.signal.samples, shown.signal.sample_rate))
    return placed


def on_playback_pre(scene: Any, _depsgraph: Any = None) -> None:
    """animation_playback_pre. Blender opens its sound device after it: speakers wait for the next frame."""
    from .controller import PLAYER

    if PLAYER.use_shared_device(True):
        FOLLOWER.wait(scene)
    else:
        FOLLOWER.start(scene)


def on_playback_post(_scene: Any = None, _depsgraph: Any = None) -> None:
    """animation_playback_post."""
    from .controller import PLAYER

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
