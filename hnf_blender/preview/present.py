"""A stroke object as it is now → its stored bake, pressed as its force curve says now."""

from __future__ import annotations

import contextlib
from collections import OrderedDict
from dataclasses import dataclass, replace
from typing import Any

import bpy
import numpy as np

from hnf_core.action.time_law import checked_force
from hnf_core.errors import StrokeError
from hnf_core.files import content_hash
from hnf_core.units import seconds_to_frame

from ..bridge.channels import read_channel, sample_channels
from ..bridge.keeping import kept
from ..props.stroke import FORCE_MAX_N
from ..state.guard import own_changes
from ..touch.stroke_bake import BAKE_PROPERTY, StrokeBake

KEPT = 16
_loaded: OrderedDict[str, StrokeBake] = OrderedDict()


@dataclass(frozen=True)
class Present:
    """bake: with force, probe and seed of now. stamp: hash of all that its signal follows from."""

    name: str
    bake: StrokeBake
    stamp: str


def present(obj: Any, scene: Any) -> Present | None:
    """What obj sounds like now, as far as its own properties tell; None where nothing is baked.

    Surface, path and timing are not looked at: whether the bake still holds for them is state.watch's to say.
    Raises StrokeError where force presses on what the bake did not touch, FileError where the bake is damaged.
    """
    stored = kept(obj, BAKE_PROPERTY)
    if stored is None:
        return None
    where, group = f"stroke '{obj.name}'", obj.hnf_stroke
    digest = content_hash(stored) if isinstance(stored, bytes) else ""
    baked = _load(obj, digest)
    action = baked.stroke.action
    fps, base, start = float(scene.render.fps), float(scene.render.fps_base), float(group.start)
    frames = np.array([seconds_to_frame(float(t), start, fps, base) for t in action.time])
    channel = read_channel(obj, "force", scene)
    # Drivers are evaluated in a scene made for it: that is no change of the artist's.
    with own_changes(bpy.context.view_layer) if channel.source == "driven" else contextlib.nullcontext():
        (keyed,) = sample_channels(obj, scene, (channel,), frames)
    force = checked_force(keyed, frames, where=where, most=FORCE_MAX_N)
    try:
        now = replace(baked.with_force(force, str(group.probe)), seed=int(group.seed))
    except StrokeError as error:
        raise StrokeError(error.what, where=where, remedy=error.remedy) from None
    return Present(obj.name, now, content_hash(digest, force.tobytes(), str(group.probe), str(group.seed)))


def forget() -> None:
    _loaded.clear()


def _load(obj: Any, digest: str) -> StrokeBake:
    """Decoding takes milliseconds, and a hand on a key asks many times a second."""
    from ..touch.stroke_bake import load_bake

    if digest not in _loaded:
        bake = load_bake(obj)
        assert bake is not None
        _loaded[digest] = bake
        while len(_loaded) > KEPT:
            _loaded.popitem(last=False)
    _loaded.move_to_end(digest)
    return _loaded[digest]
