"""Vibration under a hand as it moves: synthesis state by state, strictly causal.

Each state of 5 ms gives the 5 ms of samples that lead up to it; nothing later is known. Where field/synthesis.py
looks ahead:

* s(t) between states: a cubic whose slopes are backward differences of second order (three states), not central ones.
* What is read too fast to be held: by the last three motions, not by two on either side.
* Pressing is one more state late, since the force's spline needs the state after (see pressing).
* The touch begins when it is told, not 20 ms before; after a lift the fade of 60 ms is a state shorter, so that both
  together end within 60 ms.

A hand that slides steadily therefore sounds as in synthesise(), sample by sample, one state later: step(state) gives
what lies between the state before and this one. What pressing alone gives comes another state later.

A material, as one has it at hand, ready to be touched.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...action.action import ACTION_RATE_HZ
from ...errors import UsageError
from ...material.contact_model import Mechanics, describe_limit_violation
from ...material.hnf_file import HNF_SUFFIX, MaterialFile, read_hnf, with_library_defaults
from ...material.library import LibraryMaterial, get_material
from ...material.probe import PROBES
from ...material.token import LARGEST_VALUE, TOKEN_DIM
from ..carriers import ARC_PER_OCTAVE, MODEL_RATE_HZ
from ..field import Field
from ..linear_contact import BAND_END_HZ
from ..prepare import AFTER_CONTACT_S
from ..stroke import SAMPLES_PER_STATE, STATE_FRACTIONS
from ..weights import load_field, load_material_field, read_trained_material
from .carriers import LiveArcCarriers, LiveTimeCarriers
from .contact_filter import LiveContactFilter
from .emission import LiveEmission
from .hand_tracker import LiveState

Float = NDArray[np.float64]

_FADE_STATES = round(AFTER_CONTACT_S * ACTION_RATE_HZ) - 1
_HERMITE = np.stack(
    [
        2 * STATE_FRACTIONS**3 - 3 * STATE_FRACTIONS**2 + 1,
        STATE_FRACTIONS**3 - 2 * STATE_FRACTIONS**2 + STATE_FRACTIONS,
        3 * STATE_FRACTIONS**2 - 2 * STATE_FRACTIONS**3,
        STATE_FRACTIONS**3 - STATE_FRACTIONS**2,
    ],
    axis=1,
)


class LiveSynthesis:
    """Materials under a hand.

    tokens: (M, TOKEN_DIM), mechanics: (M,) of the same materials. The same states and seed give the same bytes. Before
    the first state the hand is in the air. Memory does not grow. Raises UsageError where these do not fit together or
    leave stroke.LIMITS, and for a field of the published form, whose carriers lag by themselves.
    """

    rate_hz = MODEL_RATE_HZ

    def __init__(
        self,
        field: Field,
        tokens: NDArray[np.float32],
        mechanics: Sequence[Mechanics],
        *,
        seed: int,
        probe: str = "pen",
    ) -> None:
        tokens = np.asarray(tokens)
        if tokens.ndim != 2 or tokens.shape[1] != TOKEN_DIM or not 0 < len(tokens) == len(mechanics):
            raise UsageError(f"{len(mechanics)} mechanics and tokens of shape {tokens.shape} are no materials.")
        problem = next(filter(None, map(describe_limit_violation, mechanics)), "")
        if problem or not (np.abs(tokens) <= LARGEST_VALUE).all():
            raise UsageError(
                problem or f"a token holds NaN or leaves ±{LARGEST_VALUE:g}.",
                where="live touch",
                remedy="Choose another material, or describe this one again.",
            )
        if probe not in PROBES:
            raise UsageError(f"there is no probe '{probe}'.", remedy=f"Known: {', '.join(PROBES)}.")
        carriers = field.config.carriers
        if field.config.accumulation != "past" or carriers.constant or not carriers.time_count:
            raise UsageError("a field of the published form cannot be felt live.", remedy="Use the shared field.")
        self._config, self._carriers = field.config, field.config.carriers
        self._emission = [LiveEmission(field, *each, probe) for each in zip(tokens, mechanics, strict=True)]
        self._noise, self._arcs = LiveTimeCarriers(self._carriers, seed), LiveArcCarriers(self._carriers, seed)
        self._pressing = LiveContactFilter(mechanics, probe)
        self._kappa = self._carriers.arc_centres()
        self._lowest = self._kappa[::ARC_PER_OCTAVE].tolist()
        states, stride = field.config.states, field.config.stride
        # Of the states that are remembered, the newest first.
        self._emitted = np.zeros((stride * (states - 1) + 1, self._carriers.count))
        self._density = np.zeros((len(self._emitted), states))
        self._remembers = False
        self._pair = np.zeros((2, self._carriers.count), dtype=np.float32)
        self._places: deque[float] = deque(maxlen=4)
        self._audible, self._air = 0.0, 0
        self._sample, self._prepared = -SAMPLES_PER_STATE, True

    @property
    def materials(self) -> int:
        return len(self._emission)

    @property
    def cached_blocks(self) -> int:
        """Pieces of noise in memory: at most seven blocks in time and four hops of each octave."""
        return self._noise.cached_blocks + self._arcs.cached_hops

    @property
    def late_blocks(self) -> int:
        """Pieces of noise that a step had to wait for: the hand jumped."""
        return self._noise.at_once + self._arcs.at_once

    def step(self, state: LiveState) -> Float:
        """(SAMPLES_PER_STATE,) m/s², finite: from the state before to this one. Raises UsageError for a material that
        is not there."""
        if not 0 <= state.material < self.materials:
            raise UsageError(f"there is no material {state.material} of {self.materials}.")
        self.prepare()
        while len(self._places) < 4:
            self._places.append(state.position)
        self._places.append(state.position)
        out = self._render_contact(state) if state.contact or self._audible > 0.0 else self._render_silence()
        self._sample += SAMPLES_PER_STATE
        self._prepared = False
        return out

    def prepare(self) -> None:
        """Noise for the states to come, as much as is one state's share. step() begins with it where nobody asked for
        it since the last one: who has time between two states asks, and the next is made the sooner."""
        if self._prepared:
            return
        self._prepared = True
        busy = self._arcs.prepare(self._places[-1], (self._places[-1] - self._places[-2]) * ACTION_RATE_HZ)
        self._noise.prepare(self._sample, spare=not busy)

    def _render_contact(self, state: LiveState) -> Float:
        travel = max(abs(new - old) for old, new in pairwise(self._places))
        amplitude = self._accumulate(state)
        amplitude[self._carriers.arc_slice] *= self._kappa * (travel * ACTION_RATE_HZ) < BAND_END_HZ
        self._pair[0] = self._pair[1]
        self._pair[1] = amplitude
        fade = self._fade(state.contact)
        pressing = self._pressing.step(state.force if state.contact else 0.0, state.material)
        out = self._render_carriers(travel) + pressing
        return out if fade is None else fade * out

    def _render_silence(self) -> Float:
        """In the air for so long that nothing is heard or remembered: the next touch begins anew."""
        self._remembers = False
        self._emitted[:] = self._pair[1] = 0.0
        return np.zeros(SAMPLES_PER_STATE)

    def _accumulate(self, state: LiveState) -> Float:
        """(K,) Σ_n w_n α of the past states; as field.accumulate."""
        emitted, density, stride = self._emitted, self._density, self._config.stride
        alpha, sigma = self._emission[state.material].evaluate(state.direction, state.speed, state.force, state.contact)
        if not self._remembers:
            density[:] = sigma  # before the first state nothing was emitted, as densely as then
        self._remembers = True
        emitted[1:], density[1:] = emitted[:-1], density[:-1]
        emitted[0], density[0] = alpha, sigma
        # rendering.render_weights: sums in pairs no handful of states needs, nor arrays.
        weights, passed = list[float](), 0.0
        for own in density[::stride].diagonal().tolist():
            weights.append(math.exp(-passed) * -math.expm1(-own))
            passed += own
        return np.asarray(weights @ emitted[::stride])

    def _fade(self, contact: bool) -> Float | None:
        """(SAMPLES_PER_STATE,) of this stretch; None for all of it."""
        before = self._audible
        if contact and before == 0.0:
            self._pressing.reset()  # what still rang unheard must not come up with the new touch
            before = 1.0
        self._air = 0 if contact else self._air + 1
        fading = max(1.0 - max(self._air - 1, 0) / _FADE_STATES, 0.0)
        self._audible = 1.0 if contact else min(fading, before)
        if before == self._audible == 1.0:
            return None
        return np.asarray(np.sin(0.5 * np.pi * (before + (self._audible - before) * STATE_FRACTIONS)) ** 2)

    def _render_carriers(self, travel: float) -> Float:
        carriers, pair, out = self._carriers, self._pair, np.zeros(SAMPLES_PER_STATE)
        if not pair.any():
            return out
        mixed = self._noise.mix(pair[:, carriers.time_slice], self._sample, SAMPLES_PER_STATE)
        out += mixed[0] * (1.0 - STATE_FRACTIONS) + mixed[1] * STATE_FRACTIONS
        if carriers.arc_count:
            out += self._render_arc_carriers(pair[:, carriers.arc_slice].reshape(2, -1, ARC_PER_OCTAVE), travel)
        return out

    def _render_arc_carriers(self, pair: NDArray[np.float32], travel: float) -> Float:
        """Σ_k A_k c_k(s(t)). pair: (2, octaves, 24). An octave that is left behind, being read too fast, fades out on
        the spot."""
        lowest = BAND_END_HZ / max(travel * ACTION_RATE_HZ, 1e-12)
        active = np.flatnonzero(pair.any(axis=(0, 2))).tolist()
        heard = [octave for octave in active if self._lowest[octave] < lowest]
        out = np.zeros(SAMPLES_PER_STATE)
        if heard:
            out += self._arcs.read(pair, heard, self._interpolate_position())
        if len(heard) < len(active):
            left = [octave for octave in active if self._lowest[octave] >= lowest]
            out += self._arcs.read(pair, left, np.full(SAMPLES_PER_STATE, self._places[-2]))
        return out

    def _interpolate_position(self) -> Float:
        """s (SAMPLES_PER_STATE,) from the state before to this one."""
        oldest, older, old, new = self._places
        return np.asarray(
            _HERMITE @ [old, 1.5 * old - 2.0 * older + 0.5 * oldest, new, 1.5 * new - 2.0 * old + 0.5 * older]
        )


AnyMaterial = str | Path | LibraryMaterial | MaterialFile
"""A name of the library, a `.hnf` file, or what was read from either."""


def resolve_material(material: AnyMaterial) -> LibraryMaterial:
    """With nothing left open: what a file does not know comes from the library (hnf_file.completed).

    Raises MaterialError for a name that is not in the library, FileError for a file that cannot be used.
    """
    if isinstance(material, LibraryMaterial):
        return material
    definition = _read_definition(material)
    return get_material(str(material)) if definition is None else with_library_defaults(definition)


def create_live_synthesis(
    *materials: AnyMaterial, seed: int = 0, probe: str = "pen", field: Field | None = None
) -> LiveSynthesis:
    """Materials 0, 1, … under a hand. field: None is that of a single material that brings one, else the shared one.
    Takes some 50 ms, as its first noise is made.

    Raises what material_of() and LiveSynthesis raise.
    """
    if not materials:
        raise UsageError("there is nothing to touch.", remedy="Name a material.")
    if len(materials) == 1 and field is None:
        definition = _read_definition(materials[0])
        field = None if definition is None else load_material_field(definition)
        if definition is not None and field is not None:
            materials = (read_trained_material(field, definition.name),)
    known = [resolve_material(material) for material in materials]
    tokens = np.stack([material.token for material in known])
    return LiveSynthesis(
        load_field() if field is None else field, tokens, [each.mechanics for each in known], seed=seed, probe=probe
    )


def _read_definition(material: AnyMaterial) -> MaterialFile | None:
    """What a file says, where material is or names one."""
    if isinstance(material, Path) or (isinstance(material, str) and material.lower().endswith(HNF_SUFFIX)):
        return read_hnf(Path(material))
    return material if isinstance(material, MaterialFile) else None
