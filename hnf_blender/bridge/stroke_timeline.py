"""Where a stroke's hand is and how hard it presses at each time, without looking at the surface: for what is drawn
in the viewport, and for fitting one stroke's force to another's time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.curves import ArcCurve, build_arc_curve
from hnf_core.action.time_law import clamp_force, clamp_progress, make_time_grid

from ..props.stroke import FORCE_MAX_N
from .channels import Channel, read_channel, sample_channels
from .splines import read_curve
from .strokes import choose_motion_profile, compute_motion

Float = NDArray[np.float64]

TIMELINE_RATE_HZ = 60.0


@dataclass(frozen=True)
class StrokeTimeline:
    """frames: (n,) scene frames, even. position: (n,) m along the curve as its object stands now. force: (n,) N.
    arc: the curve in metres, in world axes."""

    frames: Float
    position: Float
    force: Float
    arc: ArcCurve


def sample_timeline(obj: Any, scene: Any, metres_per_unit: float, rate: float = TIMELINE_RATE_HZ) -> StrokeTimeline:
    """Sample a stroke's motion and force at rate [Hz]. What drivers and the NLA move counts with its present value.

    Raises StrokeError as read_stroke does.
    """
    group, where = obj.hnf_stroke, f"stroke '{obj.name}'"
    world = np.array(obj.matrix_world, dtype=np.float64)
    world[:3] *= metres_per_unit
    arc = build_arc_curve(read_curve(obj).transform(world))
    start, frame_s = float(group.start), float(scene.render.fps_base) / float(scene.render.fps)
    channels = tuple(_ignore_drivers(read_channel(obj, name, scene)) for name in ("force", "progress"))
    law, duration = choose_motion_profile(group, arc.length, (channels[0], channels[1]), start, frame_s, where)
    time = make_time_grid(duration, rate, where=where)
    frames = start + time / frame_s
    force, progress = sample_channels(obj, scene, channels, frames)
    motion = compute_motion(group, law, clamp_progress(progress, frames, where=where), time, arc.length, rate)
    return StrokeTimeline(frames, motion.position, clamp_force(force, frames, where=where, max_force=FORCE_MAX_N), arc)


def get_motion_end(obj: Any, scene: Any, metres_per_unit: float) -> float:
    """Frame at which the hand stops moving, whatever force does: the last key of progress, or the end of the law."""
    group, where = obj.hnf_stroke, f"stroke '{obj.name}'"
    start, frame_s = float(group.start), float(scene.render.fps_base) / float(scene.render.fps)
    progress = _ignore_drivers(read_channel(obj, "progress", scene))
    world = np.array(obj.matrix_world, dtype=np.float64)
    world[:3] *= metres_per_unit
    length = build_arc_curve(read_curve(obj).transform(world)).length
    still = Channel("force", "set", -np.inf)
    return start + choose_motion_profile(group, length, (still, progress), start, frame_s, where)[1] / frame_s


def _ignore_drivers(channel: Channel) -> Channel:
    """A driven channel as if it were set: evaluating drivers needs a scene of its own, which a redraw cannot wait
    for."""
    return channel if channel.source != "driven" else Channel(channel.name, "set", channel.last_frame)
