"""A stroke object as it is now → its stored bake, pressed as its force curve says now."""

from __future__ import annotations

import contextlib
from collections import OrderedDict
from dataclasses import dataclass, replace
from typing import Any

import bpy
import numpy as np

from hnf_core.action.time_law import clamp_force
from hnf_core.errors import StrokeError
from hnf_core.files import content_hash
from hnf_core.units import seconds_to_frame

from ..bridge.channels import read_channel, sample_channels
from ..bridge.keeping import get_property
from ..props.stroke import FORCE_MAX_N
from ..state.guard import suppress_change_tracking
from ..touch.stroke_bake import BAKE_PROPERTY, StrokeBake

MAX_CACHED_BAKES = 16
_bake_cache: OrderedDict[str, StrokeBake] = OrderedDict()


@dataclass(frozen=True)
class CurrentBake:
    """bake: with force, probe and seed of now. stamp: hash of all that its signal follows from."""

    name: str
    bake: StrokeBake
    stamp: str


def read_current_bake(obj: Any, scene: Any) -> CurrentBake | None:
    """What obj sounds like now, as far as its own properties tell; None where nothing is baked.

    Surface, path and timing are not looked at: whether the bake still holds for them is state.watch's to say.
    Raises StrokeError where force presses on what the bake did not touch, FileError where the bake is damaged.
    """
    stored = get_property(obj, BAKE_PROPERTY)
    if stored is None:
        return None
    where, group = f"stroke '{obj.name}'", obj.hnf_stroke
    digest = content_hash(stored) if isinstance(stored, bytes) else ""
    baked = _load_bake(obj, digest)
    action = baked.stroke.action
    fps, base, start = float(scene.render.fps), float(scene.render.fps_base), float(group.start)
    frames = np.array([seconds_to_frame(float(t), start, fps, base) for t in action.time])
    channel = read_channel(obj, "force", scene)
    # Drivers are evaluated in a scene made for it: that is no change of the artist's.
    with suppress_change_tracking(bpy.context.view_layer) if channel.source == "driven" else contextlib.nullcontext():
        (keyed,) = sample_channels(obj, scene, (channel,), frames)
    force = clamp_force(keyed, frames, where=where, max_force=FORCE_MAX_N)
    try:
        now = replace(baked.with_force(force, str(group.probe)), seed=int(group.seed))
    except StrokeError as error:
        raise StrokeError(error.what, where=where, remedy=error.remedy) from None
    return CurrentBake(obj.name, now, content_hash(digest, force.tobytes(), str(group.probe), str(group.seed)))


def clear_bake_cache() -> None:
    _bake_cache.clear()


def _load_bake(obj: Any, digest: str) -> StrokeBake:
    """Decoding takes milliseconds, and a hand on a key asks many times a second."""
    from ..touch.stroke_bake import load_bake

    if digest not in _bake_cache:
        bake = load_bake(obj)
        assert bake is not None
        _bake_cache[digest] = bake
        while len(_bake_cache) > MAX_CACHED_BAKES:
            _bake_cache.popitem(last=False)
    _bake_cache.move_to_end(digest)
    return _bake_cache[digest]
