"""Synthesis of previews in a thread: the current bake of a stroke → signal, confidence and image.

A bake is all that a signal is synthesized from. `read_current_bake` reads the stored one with the force, probe and seed
of now; `synthesise_preview` renders it, again only where it changed; `SynthesisThread` does so outside Blender's main
thread, the newest request of each stroke first.
"""

from __future__ import annotations

import contextlib
import threading
import traceback
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import bpy
import numpy as np

from hnf_core.action.action import Action
from hnf_core.action.motion_profile import clamp_force
from hnf_core.errors import HnfError, StrokeError
from hnf_core.field.synthesis import RenderedStroke, Superseded, blend, render_incremental, split_by_field
from hnf_core.field.weights import load_field
from hnf_core.files import content_hash
from hnf_core.material.fuse import LOUDEST_M_S2
from hnf_core.signal import Signal
from hnf_core.units import seconds_to_frame

from .. import compat
from ..bridge.scene.stored_data import get_property
from ..bridge.stroke.animation import read_channel, sample_channels
from ..props.stroke_settings import FORCE_MAX_N
from ..state.session_state import suppress_change_tracking
from ..touch.stroke_bake import BAKE_PROPERTY, StrokeBake, load_bake
from ..touch.synthesise import add_provenance, compute_mean_share
from .stroke_image import Ghost, ImageStyle, Rgba, draw_stroke_image

MAX_CACHED_BAKES = 16
"""Number of decoded bakes in the cache."""
_bake_cache: OrderedDict[str, StrokeBake] = OrderedDict()


@dataclass(frozen=True)
class CurrentBake:
    """Bake of a stroke with its current force, probe and seed; `stamp` is a hash of all that its signal depends on."""

    name: str
    bake: StrokeBake
    stamp: str


def read_current_bake(obj: Any, scene: Any) -> CurrentBake | None:
    """Return the stored bake with the stroke's current force, probe and seed; None if nothing is baked.

    Surface, path and timing are not compared: `state.status_tracker` checks whether the bake is still valid for them.

    Parameters
    ----------
    obj : bpy.types.Object
        Stroke object.
    scene : bpy.types.Scene
        Scene whose frame rate and animation are read.

    Raises
    ------
    StrokeError
        If the force presses where the bake has no contact.
    FileError
        If the bake is damaged.
    """
    stored = get_property(obj, BAKE_PROPERTY)
    if stored is None:
        return None
    location, group = f"stroke '{obj.name}'", obj.hnf_stroke
    digest = content_hash(stored) if isinstance(stored, bytes) else ""
    baked = _load_bake(obj, digest)
    action = baked.stroke.action
    fps, base, start = float(scene.render.fps), float(scene.render.fps_base), float(group.start)
    frames = np.array([seconds_to_frame(float(t), start, fps, base) for t in action.time])
    channel = read_channel(obj, "force", scene)
    # Drivers are evaluated in a temporary scene, which must not count as a change by the artist.
    with suppress_change_tracking(bpy.context.view_layer) if channel.source == "driven" else contextlib.nullcontext():
        (keyed,) = sample_channels(obj, scene, (channel,), frames)
    force = clamp_force(keyed, frames, where=location, max_force=FORCE_MAX_N)
    try:
        bake = replace(baked.with_force(force, str(group.probe)), seed=int(group.seed))
    except StrokeError as error:
        raise StrokeError(error.what, where=location, remedy=error.remedy) from None
    return CurrentBake(obj.name, bake, content_hash(digest, force.tobytes(), str(group.probe), str(group.seed)))


def _load_bake(obj: Any, digest: str) -> StrokeBake:
    """Return a cached bake: decoding takes milliseconds, and a dragged value requests it many times a second."""
    if digest not in _bake_cache:
        bake = load_bake(obj)
        assert bake is not None
        _bake_cache[digest] = bake
        while len(_bake_cache) > MAX_CACHED_BAKES:
            _bake_cache.popitem(last=False)
    _bake_cache.move_to_end(digest)
    return _bake_cache[digest]


CACHE_LIMIT_BYTES = 400_000_000
"""Memory limit of the cached renders [bytes]; one minute of stroke takes 37 MB, over a height profile 44 MB."""


@dataclass(frozen=True)
class PreviewResult:
    """Synthesized signal of a stroke with its image.

    Attributes
    ----------
    name : str
        Name of the stroke.
    stamp : str
        Stamp of the `CurrentBake` that it was made from.
    signal : Signal
        Acceleration [m/s²], with the provenance that `hnf touch` writes.
    action : Action
        Action over the stroke.
    confidence : float
        Confidence, 0 to 1, as `hnf touch` reports it.
    warnings : tuple of str
        Warnings of the synthesis, and those on heights that are not believed, as `hnf touch` reports them.
    rendered : int
        Number of samples that had to be rendered.
    image : (340, 340, 4) float32 array
        Image for the panel.
    style : ImageStyle
        Style of the image.
    """

    name: str
    stamp: str
    signal: Signal
    action: Action
    confidence: float
    warnings: tuple[str, ...]
    rendered: int
    image: Rgba
    style: ImageStyle

    @cached_property
    def as_ghost(self) -> Ghost:
        """Signal and action for the image of another; the same object each time, since images are compared by it."""
        return Ghost(self.signal, self.action)


@dataclass
class RenderCache:
    """Last rendered signal of every path, the newest last, limited to CACHE_LIMIT_BYTES."""

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
    """Synthesize a stroke and draw its image, starting from the cached signal of the same path if there is one.

    If the force decides whether the heights of a relief are believed, it does so here as in `hnf touch`.

    Parameters
    ----------
    now : CurrentBake
        Bake to render.
    style : ImageStyle
        Style of the image.
    cache : RenderCache
        Earlier renders, updated.
    is_superseded : callable
        Called between blocks; returns True to cancel.

    Raises
    ------
    Superseded
        If `is_superseded` returns True.
    StrokeError
        If the stroke cannot be synthesized.
    """
    bakes = [bake for bake in (now.bake, now.bake.alternative) if bake is not None]
    for bake in sorted(bakes, key=lambda bake: bake.is_softened):
        result = _synthesise_bake(now, bake, style, cache, is_superseded)
        if result.signal.rms <= LOUDEST_M_S2:
            break
    return result


def _synthesise_bake(
    now: CurrentBake, bake: StrokeBake, style: ImageStyle, cache: RenderCache, is_superseded: Callable[[], bool]
) -> PreviewResult:
    field_parts, renders = split_by_field(load_field(), bake.stroke), []
    for field_part in field_parts:
        key = f"{bake.path_key} {field_part.field.identity} {bake.is_softened}"
        earlier = cache.get(key)
        if earlier is not None and earlier.prepared.seed != bake.seed:
            earlier = None
        renders.append(
            render_incremental(
                field_part.field, field_part.stroke, seed=bake.seed, earlier=earlier, superseded=is_superseded
            )
        )
        cache.put(key, renders[-1])
    blended = blend(field_parts, [render.synthesis for render in renders])
    # Without contact the signal is zero, which is certain.
    material_confidence = compute_mean_share(bake.shares, bake.patch_index) if (bake.patch_index >= 0).any() else 1.0
    confidence = material_confidence * blended.confidence
    signal = add_provenance(blended.signal, now.name, bake.facts, confidence)
    action = bake.stroke.action
    image = draw_stroke_image(signal, action, style)
    return PreviewResult(
        now.name, now.stamp, signal, action, confidence, (*blended.warnings, *bake.doubts),
        sum(render.rendered_count for render in renders),
        image,
        style,
    )  # fmt: skip


@dataclass(frozen=True)
class Failure:
    """Text of why there is no signal of the bake with this `stamp`."""

    stamp: str
    why: str


Outcome = PreviewResult | Failure


class SynthesisThread:
    """Thread that synthesizes requested strokes; the newest request of each stroke replaces earlier ones.

    A request with `first`, and an operator that waits for the thread to pause, interrupt a synthesis, which is started
    again afterwards.
    """

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
        """Request the signal of a stroke, before all others (`first`) or after them."""
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
        """Return the signals or errors since the last call, by stroke name."""
        with self._condition:
            done, self._done = self._done, {}
            return done

    @property
    def is_busy(self) -> bool:
        with self._condition:
            return bool(self._requests) or self._busy

    def stop(self, *, wait: bool = True) -> None:
        """Stop the thread; `wait` until it has ended, which takes one block at most."""
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
                name, (current, style) = self._requests.popitem(last=False)
                self._busy = True
            outcome: Outcome | None
            try:
                with compat.WORK_LOCK:
                    outcome = synthesise_preview(current, style, self._cache, partial(self._is_superseded, name))
            except Superseded:
                outcome = None
            except HnfError as error:
                outcome = Failure(current.stamp, str(error))
            except Exception as error:  # An unexpected error must not end the thread.
                traceback.print_exc()
                outcome = Failure(current.stamp, f"internal error ({error!r}). Please report it.")
            with self._condition:
                self._busy = False
                if outcome is not None:
                    self._done[current.name] = outcome
                elif not self._is_stopping:
                    self._requests.setdefault(name, (current, style))
                    if name == self._first_name:
                        self._requests.move_to_end(name, last=False)

    def _is_superseded(self, name: str) -> bool:
        with self._condition:
            is_outdated = self._is_stopping or name in self._requests or self._first_name in self._requests
        return is_outdated or compat.WORK_LOCK.is_wanted


def _count_bytes(rendered: RenderedStroke) -> int:
    prepared = rendered.prepared
    arrays = [prepared.amplitude, prepared.tone_amplitude, prepared.motion, prepared.audible, rendered.samples]
    if rendered.stroke.profile is not None:
        arrays += [rendered.stroke.profile.height, rendered.stroke.profile.seam]
    return sum(array.nbytes for array in arrays if isinstance(array, np.ndarray))
