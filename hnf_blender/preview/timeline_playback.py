"""Playback of strokes with Blender's timeline: baked strokes at their start frames → one mixed, synchronized track.

`mix_strokes` mixes the strokes from a frame on; `PlayheadFollower` plays the mix and follows jumps of the playhead.
"""

from __future__ import annotations

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
"""Offset between sound and timeline above which the sound is restarted [s]: Blender may drop frames, sound does not."""


class FrameClock(NamedTuple):
    """Frame rate of a scene: fps / fps_base frames per second."""

    fps: float
    fps_base: float = 1.0

    def seconds(self, frame: float, start: float) -> float:
        """Return the time from frame `start` to `frame` [s]; frames may be fractional."""
        return frame_to_seconds(frame, start, self.fps, self.fps_base)


class PlacedSignal(NamedTuple):
    """Samples (n,) of a stroke at `rate` [Hz] that begin at frame `start`."""

    start: float
    samples: Samples
    rate: float

    def end(self, clock: FrameClock) -> float:
        """Return the frame at which the last sample has been played."""
        return self.start + len(self.samples) / self.rate * clock.fps / clock.fps_base


def mix_strokes(strokes: Sequence[PlacedSignal], frame: float, last_frame: float, clock: FrameClock) -> Samples:
    """Return the sum of the strokes from `frame` to the end of `last_frame`, (n,) at their common rate.

    Strokes that began earlier are joined midway; the result is empty if nothing plays any more. Raises ValueError for
    strokes of several rates.
    """
    if not strokes:
        return np.zeros(0, dtype=np.float32)
    rates = {stroke.rate for stroke in strokes}
    if len(rates) > 1:
        raise ValueError(f"strokes of several sample rates: {sorted(rates)}")
    rate = rates.pop()
    max_length = max(round(clock.seconds(last_frame + 1.0, frame) * rate), 0)
    offsets = [round(clock.seconds(stroke.start, frame) * rate) for stroke in strokes]
    length = max(
        min(max(offset + len(stroke.samples) for offset, stroke in zip(offsets, strokes, strict=True)), max_length), 0
    )
    out = np.zeros(length, dtype=np.float32)
    for offset, stroke in zip(offsets, strokes, strict=True):
        low, high = max(offset, 0), min(offset + len(stroke.samples), length)
        if low < high:
            out[low:high] += stroke.samples[low - offset : high - offset]
    return out


def has_jumped(frame: float, expected_s: float, start_frame: float, clock: FrameClock) -> bool:
    """Return whether the timeline has jumped away from the sound.

    `frame` is shown now; the sound has played for `expected_s` [s] since `start_frame`.
    """
    return abs(clock.seconds(frame, start_frame) - expected_s) > MAX_DRIFT_S + clock.seconds(1.0, 0.0)


SCRUB_S = 0.06
"""Shortest excerpt of a stroke that is played when the playhead is dragged [s]; at least one frame."""

TAIL_S = 1.0
"""Silence after the sound [s].

The device stays open when the playhead moves, since opening it takes longer. And a device that loses its last buffers
(OpenAL, up to a sixth of a second) loses silence only.
"""


class PlayheadFollower:
    """Player of the scene's strokes along Blender's timeline.

    Attributes
    ----------
    start_frame : float or None
        Frame at which playback began; None while nothing plays.
    is_waiting : bool
        Playback begins with the next frame.
    scene : str
        Name of the playing scene.
    """

    def __init__(self) -> None:
        self.start_frame: float | None = None
        self.is_waiting = False
        self.scene = ""

    def is_playing(self, scene: Any) -> bool:
        return self.start_frame is not None and self.scene == scene.name

    def wait(self, scene: Any) -> None:
        """Make playback start with the next frame that is shown."""
        self.start_frame, self.scene, self.is_waiting = float(scene.frame_current_final), scene.name, True

    def start(self, scene: Any) -> None:
        """Play the strokes from the current frame on.

        Without a sound device nothing is played, and the timeline plays on.
        """
        from .controller import PLAYER

        self.start_frame, self.scene, self.is_waiting = None, scene.name, False
        if not scene.hnf.follow_timeline:
            return
        last_frame = scene.frame_preview_end if scene.use_preview_range else scene.frame_end
        PREVIEW.sounding = ""
        self.start_frame = float(scene.frame_current_final)
        sound = make_sound_ahead(scene, float(last_frame))
        if sound is None:
            PLAYER.stop()
            return
        _play(sound)

    def stop(self) -> None:
        from .controller import PLAYER

        if self.start_frame is not None:
            PLAYER.stop()
        self.start_frame, self.is_waiting = None, False

    def follow(self, scene: Any) -> None:
        """Restart the sound if the timeline has jumped."""
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
        """Play a short excerpt at the dragged playhead, on an actuator only.

        Speakers are left to Blender's own scrubbing.
        """
        from ..actuator.actuator_state import SPEAKERS, get_selected_output

        if get_selected_output() == SPEAKERS or not scene.hnf.follow_timeline:
            return
        frames = max(1.0, SCRUB_S * scene.render.fps / scene.render.fps_base)
        excerpt = make_sound_ahead(scene, float(scene.frame_current_final) + frames - 1.0)
        if excerpt is None:
            return
        PREVIEW.sounding = ""
        _play(excerpt)


def _play(sound: Sound) -> None:
    """Play a part of the timeline; where that fails the tab says why, and the timeline plays on."""
    from hnf_core.errors import HnfError

    from ..state.interface import redraw_tab
    from .controller import PLAYER

    before, PREVIEW.sound_problem = PREVIEW.sound_problem, ""
    try:
        PLAYER.play(pad_with_silence(sound))
    except HnfError as error:
        PREVIEW.sound_problem = str(error)
    if PREVIEW.sound_problem != before:
        redraw_tab()


FOLLOWER = PlayheadFollower()


def make_sound_ahead(scene: Any, last_frame: float) -> Sound | None:
    """Return the mixed strokes from the current frame to the end of `last_frame`; None if there are none."""
    from .controller import make_sound

    clock = FrameClock(float(scene.render.fps), float(scene.render.fps_base))
    placed = list_placed_signals(scene)
    samples = mix_strokes(placed, float(scene.frame_current_final), last_frame, clock)
    return make_sound(samples, placed[0].rate, scene) if len(samples) else None


def pad_with_silence(sound: Sound) -> Sound:
    """Append TAIL_S of silence."""
    silence = np.zeros(round(TAIL_S * sound.rate), dtype=np.float32)
    return replace(sound, samples=np.concatenate([sound.samples, silence]))


def list_placed_signals(scene: Any) -> list[Any]:
    """Return the valid signals of strokes that are not muted, with their start frames.

    On the output of Blender's own sound, strokes with a strip or a speaker object of their own are left to Blender, or
    they would sound twice.
    """
    from ..actuator.actuator_state import get_selected_output, shares_blender_output
    from ..props.scene_settings import list_cached_strokes
    from .controller import get_problem
    from .strips_and_speakers import find_sounding

    placed, is_shared = [], shares_blender_output(get_selected_output())
    for obj in list_cached_strokes(scene):
        if is_shared and find_sounding(obj, scene):
            continue
        shown = PREVIEW.get_shown(obj.name)
        if shown is not None and not obj.hnf_stroke.mute and not get_problem(obj.name, scene):
            placed.append(PlacedSignal(float(obj.hnf_stroke.start), shown.signal.samples, shown.signal.sample_rate))
    return placed


def on_playback_pre(scene: Any, _depsgraph: Any = None) -> None:
    """Start playback, for speakers with the next frame: Blender opens its sound device after animation_playback_pre."""
    from .controller import PLAYER

    if PLAYER.use_shared_device(True):
        FOLLOWER.wait(scene)
    else:
        FOLLOWER.start(scene)


def on_playback_post(_scene: Any = None, _depsgraph: Any = None) -> None:
    """Stop playback (handler animation_playback_post)."""
    from .controller import PLAYER

    FOLLOWER.stop()
    PLAYER.use_shared_device(False)


def on_frame_change(scene: Any, _depsgraph: Any = None) -> None:
    """Follow the timeline or the dragged playhead (handler frame_change_post)."""
    import bpy

    if FOLLOWER.start_frame is not None:
        FOLLOWER.follow(scene)
        return
    windows = bpy.context.window_manager.windows
    if any(window.screen.is_scrubbing and window.scene.name == scene.name for window in windows):
        FOLLOWER.scrub(scene)
