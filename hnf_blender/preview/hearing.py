"""A stroke as it is now → what is heard. No Blender in here: it runs beside the window."""

from __future__ import annotations

import threading
import traceback
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from hnf_core.action.action import Action
from hnf_core.errors import HnfError
from hnf_core.field.incremental import Rendered, Superseded, render
from hnf_core.field.parts import parts_of, together
from hnf_core.field.weights import load_field
from hnf_core.signal import Signal

from ..touch.feel import delivered, mean_share
from .pictures import Look, Rgba, stroke_picture
from .present import Present

KEPT_BYTES = 400_000_000
"""Of strokes kept to start from; a minute of stroke takes 70 MB, its profile under the hand 300 MB more."""


@dataclass(frozen=True)
class Heard:
    """signal: in m/s², with the provenance that `hnf touch` writes. action: what the hand does. stamp: of the Present
    it was made from. confidence, warnings: as `hnf touch` reports them. rendered: samples that had to be made."""

    name: str
    stamp: str
    signal: Signal
    action: Action
    confidence: float
    warnings: tuple[str, ...]
    rendered: int
    picture: Rgba
    look: Look


@dataclass
class Kept:
    """The last synthesis of each path, the newest last, bounded by KEPT_BYTES."""

    items: OrderedDict[str, Rendered] = field(default_factory=OrderedDict)

    def get(self, key: str) -> Rendered | None:
        return self.items.get(key)

    def put(self, key: str, rendered: Rendered) -> None:
        self.items.pop(key, None)
        self.items[key] = rendered
        while len(self.items) > 1 and sum(map(_weight, self.items.values())) > KEPT_BYTES:
            self.items.popitem(last=False)


def hear(now: Present, look: Look, kept: Kept, superseded: Callable[[], bool] = lambda: False) -> Heard:
    """Synthesise and draw, from the last synthesis of the same path where there is one.

    Raises Superseded where superseded() says so, StrokeError as synthesise() does.
    """
    bake = now.bake
    parts, made = parts_of(load_field(), bake.stroke), []
    for part in parts:
        key = f"{bake.path_key} {part.field.identity}"
        earlier = kept.get(key)
        if earlier is not None and earlier.prepared.seed != bake.seed:
            earlier = None
        made.append(render(part.field, part.stroke, seed=bake.seed, earlier=earlier, superseded=superseded))
        kept.put(key, made[-1])
    whole = together(parts, [each.synthesis for each in made])
    # Pressed nowhere, there is nothing to be unsure of.
    share = mean_share(bake.shares, bake.patch_index) if (bake.patch_index >= 0).any() else 1.0
    confidence = share * whole.confidence
    signal = delivered(whole.signal, now.name, bake.facts, confidence)
    action = bake.stroke.action
    picture = stroke_picture(signal, action, look)
    return Heard(
        now.name, now.stamp, signal, action, confidence, whole.warnings, sum(each.rendered for each in made), picture,
        look,
    )  # fmt: skip


Outcome = Heard | str
"""Or why nothing could be heard, in words."""


class Listener:
    """A thread that hears what is asked for; of each stroke the newest request wins. What was asked for first of all
    does not wait for other strokes: they are begun again after it."""

    def __init__(self) -> None:
        self._condition = threading.Condition()
        self._wanted: OrderedDict[str, tuple[Present, Look]] = OrderedDict()
        self._first = ""
        self._done: dict[str, Outcome] = {}
        self._busy = False
        self._kept = Kept()
        self._ending = False
        self._thread: threading.Thread | None = None

    def ask(self, now: Present, look: Look, *, first: bool = True) -> None:
        """Begin to hear, before all others or after them; returns at once."""
        with self._condition:
            self._wanted[now.name] = now, look
            if first:
                self._first = now.name
                self._wanted.move_to_end(now.name, last=False)
            elif self._first == now.name:
                self._first = ""
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="hnf preview", daemon=True)
                self._thread.start()
            self._condition.notify()

    def take(self) -> dict[str, Outcome]:
        """What was heard since the last call, by stroke name."""
        with self._condition:
            done, self._done = self._done, {}
            return done

    @property
    def is_busy(self) -> bool:
        with self._condition:
            return bool(self._wanted) or self._busy

    def end(self, *, wait: bool = True) -> None:
        """Stop the thread. wait: until it has ended; between two blocks it looks up, so not long."""
        with self._condition:
            self._ending = True
            self._wanted.clear()
            self._condition.notify()
        if wait and self._thread is not None:
            self._thread.join(timeout=5.0)

    def _run(self) -> None:
        while True:
            with self._condition:
                while not self._wanted and not self._ending:
                    self._condition.wait()
                if self._ending:
                    return
                name, (now, look) = self._wanted.popitem(last=False)
                self._busy = True
            outcome: Outcome | None
            try:
                outcome = hear(now, look, self._kept, lambda name=name: self._is_superseded(name))  # type: ignore[misc]
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
                elif not self._ending:
                    self._wanted.setdefault(name, (now, look))

    def _is_superseded(self, name: str) -> bool:
        with self._condition:
            return self._ending or name in self._wanted or self._first in self._wanted


def _weight(rendered: Rendered) -> int:
    prepared = rendered.prepared
    arrays = (prepared.amplitude, prepared.profile_amplitude, prepared.unheld, prepared.audible, rendered.samples)
    waves = () if prepared.bands is None else prepared.bands.waves
    return sum(each.nbytes for each in (*arrays, *waves) if isinstance(each, np.ndarray))
