"""Strokes sound where they stand in time while the timeline plays."""

from __future__ import annotations

import contextlib
from typing import Any

from .facts import PREVIEW


class Follower:
    """What of the timeline sounds now. begun_at: frame at which it began; None while nothing plays."""

    def __init__(self) -> None:
        self.begun_at: float | None = None
        self.scene = ""

    def start(self, scene: Any) -> None:
        """Sound what lies ahead of the present frame. Nothing where sound is missing: the timeline plays on."""
        from hnf_core.errors import SceneError

        from .current import PLAYER
        from .monitor import to_monitor
        from .placement import Clock, mix

        self.begun_at, self.scene = None, scene.name
        if not scene.hnf.follow_timeline:
            return
        clock = Clock(float(scene.render.fps), float(scene.render.fps_base))
        frame, placed = float(scene.frame_current_final), placed_strokes(scene)
        last = scene.frame_preview_end if scene.use_preview_range else scene.frame_end
        PREVIEW.sounding = ""
        PLAYER.stop()
        self.begun_at = frame
        samples = mix(placed, frame, float(last), clock)
        if len(samples):
            with contextlib.suppress(SceneError):
                PLAYER.play(to_monitor(samples, scene.hnf.monitor_gain_db), placed[0].rate)

    def stop(self) -> None:
        from .current import PLAYER

        if self.begun_at is not None:
            PLAYER.stop()
        self.begun_at = None

    def follow(self, scene: Any) -> None:
        """Another frame is shown: where the timeline jumped, the sound jumps too."""
        from .current import PLAYER
        from .placement import Clock, has_jumped

        if self.begun_at is None or scene.name != self.scene:
            return
        clock = Clock(float(scene.render.fps), float(scene.render.fps_base))
        frame = float(scene.frame_current_final)
        went_back = frame < self.begun_at
        if went_back or (PLAYER.is_playing and has_jumped(frame, PLAYER.position_s, self.begun_at, clock)):
            self.start(scene)


FOLLOWER = Follower()


def placed_strokes(scene: Any) -> list[Any]:
    """Signals that are there and true, of strokes that are not muted, at their start frames."""
    from ..props.scene import strokes_of
    from .current import problem_of
    from .placement import Placed

    placed = []
    for obj in strokes_of(scene):
        shown = PREVIEW.shown(obj.name)
        if shown is not None and not obj.hnf_stroke.mute and not problem_of(obj.name):
            placed.append(Placed(float(obj.hnf_stroke.start), shown.signal.samples, shown.signal.sample_rate))
    return placed


def playback_begins(scene: Any, _depsgraph: Any = None) -> None:
    """animation_playback_pre."""
    FOLLOWER.start(scene)


def playback_ends(_scene: Any, _depsgraph: Any = None) -> None:
    """animation_playback_post."""
    FOLLOWER.stop()


def frame_shown(scene: Any, _depsgraph: Any = None) -> None:
    """frame_change_post."""
    FOLLOWER.follow(scene)
