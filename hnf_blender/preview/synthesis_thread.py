"""A stroke object as it is now → its stored bake, pressed as its force curve says now.

A stroke as it is now → what is heard. No Blender in here: it runs beside the window.
"""

from __future__ import annotations

import contextlib
import threading
import traceback
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import bpy
import numpy as np

from hnf_core.action.action import Action
from hnf_core.action.motion_profile import clamp_force
from hnf_core.errors import HnfError, StrokeError
from hnf_core.field.synthesis import RenderedStroke, Superseded, blend, render_incremental, split_by_field
from hnf_core.field.weights import load_field
from hnf_core.files import content_hash
from hnf_core.signal import Signal
from hnf_core.units import seconds_to_frame

from ..bridge.scene.id_properties import get_property
from ..bridge.stroke.animation import read_channel, sample_channels
from ..props.stroke_settings import FORCE_MAX_N
from ..state.session_state import suppress_change_tracking
from ..touch.stroke_bake import BAKE_PROPERTY, StrokeBake, load_bake
from ..touch.synthesise import add_provenance, compute_mean_share
from .stroke_image import ImageStyle, Rgba, draw_stroke_image

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
    if digest not in _bake_cache:
        bake = load_bake(obj)
        assert bake is not None
        _bake_cache[digest] = bake
        while len(_bake_cache) > MAX_CACHED_BAKES:
            _bake_cache.popitem(last=False)
    _bake_cache.move_to_end(digest)
    return _bake_cache[digest]


CACHE_LIMIT_BYTES = 400_000_000
"""Of strokes kept to start from; a minute of stroke takes 70 MB, its profile under the hand 300 MB more."""


@dataclass(frozen=True)
class PreviewResult:
    """signal: in m/s², with the provenance that `hnf touch` writes. action: what the hand does. stamp: of the Present
    it was made from. confidence, warnings: as `hnf touch` reports them. rendered: samples that had to be made."""

    name: str
    stamp: str
    signal: Signal
    action: Action
    confidence: float
    warnings: tuple[str, ...]
    rendered: int
    image: Rgba
    style: ImageStyle


@dataclass
class RenderCache:
    """The last synthesis of each path, the newest last, bounded by KEPT_BYTES."""

    items: OrderedDict[str, RenderedStroke] = field(default_factory=OrderedDict)

    def get(self, key: str) -> RenderedStroke | None:
        return self.items.get(key)

    def put(self, key: str, rendered: RenderedStroke) -> None:
        self.items.pop(key, None)
        self.items[key] = rendered
        while len(self.items) > 1 and sum(map(_count_bytes, self.items.values())) > CACHE_LIMIT_BYTES:
            self.items.popitem(last=False)


def synthesise_preview(
    now: CurrentBake, style: ImageStyle, cache: RenderCache, is_superseded: Callable[[], bool] = lambda: False
) -> PreviewResult:
    """Synthesise and draw, from the last synthesis of the same path where there is one.

    Raises Superseded where superseded() says so, StrokeError as synthesise() does.
    """
    bake = now.bake
    parts, made = split_by_field(load_field(), bake.stroke), []
    for part in parts:
        key = f"{bake.path_key} {part.field.identity}"
        earlier = cache.get(key)
        if earlier is not None and earlier.prepared.seed != bake.seed:
            earlier = None
        made.append(
            render_incremental(part.field, part.stroke, seed=bake.seed, earlier=earlier, superseded=is_superseded)
        )
        cache.put(key, made[-1])
    whole = blend(parts, [each.synthesis for each in made])
    # Pressed nowhere, there is nothing to be unsure of.
    share = compute_mean_share(bake.shares, bake.patch_index) if (bake.patch_index >= 0).any() else 1.0
    confidence = share * whole.confidence
    signal = add_provenance(whole.signal, now.name, bake.facts, confidence)
    action = bake.stroke.action
    picture = draw_stroke_image(signal, action, style)
    return PreviewResult(
        now.name, now.stamp, signal, action, confidence, whole.warnings, sum(each.rendered_count for each in made),
        picture,
        style,
    )  # fmt: skip


Outcome = PreviewResult | str
"""Or why nothing could be heard, in words."""


class SynthesisThread:
    """A thread that hears what is asked for; of each stroke the newest request wins. What was asked for first of all
    does not wait for other strokes: they are begun again after it."""

    def __init__(self) -> None:
        self._condition = threading.Condition()
        self._requests: OrderedDict[str, tuple[CurrentBake, ImageStyle]] = OrderedDict()
        self._first_name = ""
        self._done: dict[str, Outcome] = {}
        self._busy = False
        self._cache = RenderCache()
        self._is_stopping = False
        self._thread: threading.Thread | None = None

    def request(self, now: CurrentBake, style: ImageStyle, *, first: bool = True) -> None:
        """Begin to hear, before all others or after them; returns at once."""
        with self._condition:
            self._requests[now.name] = now, style
            if first:
                self._first_name = now.name
                self._requests.move_to_end(now.name, last=False)
            elif self._first_name == now.name:
                self._first_name = ""
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="hnf preview", daemon=True)
                self._thread.start()
            self._condition.notify()

    def pop_results(self) -> dict[str, Outcome]:
        """What was heard since the last call, by stroke name."""
        with self._condition:
            done, self._done = self._done, {}
            return done

    @property
    def is_busy(self) -> bool:
        with self._condition:
            return bool(self._requests) or self._busy

    def stop(self, *, wait: bool = True) -> None:
        """Stop the thread. wait: until it has ended; between two blocks it looks up, so not long."""
        with self._condition:
            self._is_stopping = True
            self._requests.clear()
            self._condition.notify()
        if wait and self._thread is not None:
            self._thread.join(timeout=5.0)

    def _run(self) -> None:
        while True:
            with self._condition:
                while not self._requests and not self._is_stopping:
                    self._condition.wait()
                if self._is_stopping:
                    return
                name, (now, look) = self._requests.popitem(last=False)
                self._busy = True
            outcome: Outcome | None
            try:
                outcome = synthesise_preview(now, look, self._cache, lambda name=name: self._is_superseded(name))  # type: ignore[misc]
            except Superseded:
                outcome = None
            except HnfError as error:
                outcome = str(error)
            except Exception as error:  # a fault of ours must not end the thread
                traceback.print_exc()
                outcome = f"internal error ({error!r}). Please report it."
            with self._condition:
                self._busy = False
                if outcome is not None:
                    self._done[now.name] = outcome
                elif not self._is_stopping:
                    self._requests.setdefault(name, (now, look))

    def _is_superseded(self, name: str) -> bool:
        with self._condition:
            return self._is_stopping or name in self._requests or self._first_name in self._requests


def _count_bytes(rendered: RenderedStroke) -> int:
    prepared = rendered.prepared
    arrays = (prepared.amplitude, prepared.profile_amplitude, prepared.unbridged, prepared.audible, rendered.samples)
    waves = () if prepared.bands is None else prepared.bands.waves
    return sum(each.nbytes for each in (*arrays, *waves) if isinstance(each, np.ndarray))
