"""Vibration under a hand as it moves: synthesis state by state, strictly causal.

Each state of 5 ms gives the 5 ms of samples that lead up to it. Where field/synthesis.py looks ahead, this differs:

* s(t) between states: a cubic whose slopes are second-order backward differences (three states), not central ones.
* The band limit of the arc carriers: by the last three motions, not by two on either side.
* Pressing is one more state late, since the force's spline needs the next state (see contact_filter.py).
* The touch begins with its first state, not 20 ms before. After a lift the fade of 60 ms is one state shorter, so that
  all ends within 60 ms.

A hand that slides steadily therefore sounds as in `synthesise`, sample by sample, one state later: step(state) gives
the samples between the previous state and this one. The contribution of pressing alone comes another state later.
`create_live_synthesis` starts one from library materials or `.hnf` files.
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
from ...material.probe import get_probe
from ...material.token import LARGEST_VALUE, TOKEN_DIM
from ..carriers import ARC_PER_OCTAVE, MODEL_RATE_HZ
from ..contact.lattice_lines import find_lines
from ..field import Field
from ..linear_contact import BAND_END_HZ
from ..prepare import AFTER_CONTACT_S
from ..stroke import SAMPLES_PER_STATE, STATE_FRACTIONS
from ..weights import load_field, load_material_field, read_trained_material
from .carriers import LiveArcCarriers, LiveTimeCarriers, LiveTones
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
    """Synthesis, state by state, of the vibration of M materials under a moving hand.

    The same states and seed give the same bytes. Before the first state the hand is in the air. Memory does not grow.

    Parameters
    ----------
    field
        The field, which must accumulate over past states.
    tokens
        (M, TOKEN_DIM) descriptors of the materials.
    mechanics
        (M,) stiffness, damping and friction of the same materials.
    seed
        Seed of the carriers.
    probe
        Name of the probe.

    Raises
    ------
    UsageError
        If these do not fit together or leave stroke.LIMITS, or the field is of the published form, whose carriers lag.
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
        get_probe(probe)
        carriers = field.config.carriers
        if field.config.accumulation != "past" or carriers.constant or not carriers.time_count:
            raise UsageError("a field of the published form cannot be felt live.", remedy="Use the shared field.")
        self._config, self._carriers = field.config, field.config.carriers
        lines = find_lines(tokens.astype(np.float32)) if field.config.line_gains else None
        if lines is not None and not lines.count:
            lines = None
        self._emission = [
            LiveEmission(field, *each, probe, None if lines is None else lines.select(index))
            for index, each in enumerate(zip(tokens, mechanics, strict=True))
        ]
        self._noise, self._arcs = LiveTimeCarriers(self._carriers, seed), LiveArcCarriers(self._carriers, seed)
        self._pressing = LiveContactFilter(mechanics, probe)
        self._tones = None if lines is None else LiveTones(lines, mechanics, seed)
        columns = self._carriers.count + (0 if lines is None else lines.tone_count)
        self._kappa = self._carriers.arc_centres()
        self._lowest = self._kappa[::ARC_PER_OCTAVE].tolist()
        states, stride = field.config.states, field.config.stride
        # Emissions and densities of past states, the newest first.
        self._emitted = np.zeros((stride * (states - 1) + 1, columns))
        self._density = np.zeros((len(self._emitted), states))
        self._remembers = False
        self._pair = np.zeros((2, self._carriers.count), dtype=np.float32)
        self._places: deque[float] = deque(maxlen=4)
        self._audible, self._air = 0.0, 0
        self._sample, self._prepared = -SAMPLES_PER_STATE, True

    @property
    def materials(self) -> int:
        """Number of materials."""
        return len(self._emission)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings in words: taps on a contact that is too stiff to be integrated."""
        return self._pressing.warnings

    @property
    def cached_blocks(self) -> int:
        """Number of noise blocks in memory: at most seven in time and four along the path of each octave."""
        return self._noise.cached_blocks + self._arcs.cached_hops

    @property
    def late_blocks(self) -> int:
        """Number of noise blocks that a step had to wait for, because the hand jumped."""
        return self._noise.at_once + self._arcs.at_once

    def step(self, state: LiveState) -> Float:
        """Render the samples between the previous state and this one.

        Parameters
        ----------
        state
            The hand at this state, ACTION_RATE_HZ after the previous one.

        Returns
        -------
        ndarray
            (SAMPLES_PER_STATE,) [m/s²], finite.

        Raises
        ------
        UsageError
            If there is no such material.
        """
        if not 0 <= state.material < self.materials:
            raise UsageError(f"there is no material {state.material} of {self.materials}.")
        self.prepare()
        while len(self._places) < 4:
            self._places.append(state.position)
        self._places.append(state.position)
        if self._tones is not None:
            self._tones.move(state.material, state.direction, self._places[-1] - self._places[-2])
        out = self._render_contact(state) if state.contact or self._audible > 0.0 else self._render_silence()
        self._sample += SAMPLES_PER_STATE
        self._prepared = False
        return out

    def prepare(self) -> None:
        """Make noise for the states to come, the share of the work that falls to one 5 ms state.

        Call it between two steps if there is time, so that the next step is faster; otherwise step() begins with it.
        """
        if self._prepared:
            return
        self._prepared = True
        busy = self._arcs.prepare(self._places[-1], (self._places[-1] - self._places[-2]) * ACTION_RATE_HZ)
        self._noise.prepare(self._sample, spare=not busy)

    def _render_contact(self, state: LiveState) -> Float:
        """Render a state in contact or fading out after it."""
        travel = max(abs(new - old) for old, new in pairwise(self._places))
        amplitude = self._accumulate(state)
        amplitude[self._carriers.arc_slice] *= self._kappa * (travel * ACTION_RATE_HZ) < BAND_END_HZ
        if self._tones is not None:
            self._tones.take(amplitude[self._carriers.count :], travel * ACTION_RATE_HZ)
        self._pair[0] = self._pair[1]
        self._pair[1] = amplitude[: self._carriers.count]
        fade = self._fade(state.contact)
        pressing = self._pressing.step(state.force if state.contact else 0.0, state.material)
        position = self._interpolate_position()
        out = self._render_carriers(travel, position) + pressing
        if self._tones is not None:
            self._tones.add(out, position, self._places[-2])
        return out if fade is None else fade * out

    def _render_silence(self) -> Float:
        """Forget the past and return silence: the hand has been in the air for longer than the fade."""
        self._remembers = False
        self._emitted[:] = self._pair[1] = 0.0
        if self._tones is not None:
            self._tones.silence()
        return np.zeros(SAMPLES_PER_STATE)

    def _accumulate(self, state: LiveState) -> Float:
        """Compute the amplitudes (K + tones,), Σ_n w_n α over the past states, as field.accumulate does."""
        emitted, density, stride = self._emitted, self._density, self._config.stride
        alpha, sigma = self._emission[state.material].evaluate(state.direction, state.speed, state.force, state.contact)
        if not self._remembers:
            density[:] = sigma  # Before the first state nothing is emitted, with the density of that state.
        self._remembers = True
        emitted[1:], density[1:] = emitted[:-1], density[:-1]
        emitted[0], density[0] = alpha, sigma
        # As render_weights.render_weights, without arrays and sums in pairs, which few states do not need.
        weights, total = list[float](), 0.0
        for state_density in density[::stride].diagonal().tolist():
            weights.append(math.exp(-total) * -math.expm1(-state_density))
            total += state_density
        return np.asarray(weights @ emitted[::stride])

    def _fade(self, contact: bool) -> Float | None:
        """Return the fade after a lift, a gain (SAMPLES_PER_STATE,) on this state's samples; None if it is all 1."""
        before = self._audible
        if contact and before == 0.0:
            self._pressing.reset()  # A decaying response that was faded out must not return with the new touch.
            before = 1.0
        self._air = 0 if contact else self._air + 1
        fading = max(1.0 - max(self._air - 1, 0) / _FADE_STATES, 0.0)
        self._audible = 1.0 if contact else min(fading, before)
        if before == self._audible == 1.0:
            return None
        return np.asarray(np.sin(0.5 * np.pi * (before + (self._audible - before) * STATE_FRACTIONS)) ** 2)

    def _render_carriers(self, travel: float, position: Float) -> Float:
        """Render all noise carriers between the previous state and this one.

        travel: path length in between [m]. position: (SAMPLES_PER_STATE,) along the path [m].
        """
        carriers, pair = self._carriers, self._pair
        if not pair.any():
            return np.zeros(SAMPLES_PER_STATE)
        mixed = self._noise.mix(pair[:, carriers.time_slice], self._sample, SAMPLES_PER_STATE)
        out: Float = mixed[0] * (1.0 - STATE_FRACTIONS) + mixed[1] * STATE_FRACTIONS
        if carriers.arc_count:
            arcs = pair[:, carriers.arc_slice].reshape(2, -1, ARC_PER_OCTAVE)
            out += self._render_arc_carriers(arcs, travel, position)
        return out

    def _render_arc_carriers(self, pair: NDArray[np.float32], travel: float, position: Float) -> Float:
        """Compute Σ_k A_k c_k(s(t)) over the arc carriers. pair: (2, octaves, 24) amplitudes at two states.

        An octave that would alias because the hand has become too fast fades out, at a position that is held.
        """
        lowest = BAND_END_HZ / max(travel * ACTION_RATE_HZ, 1e-12)
        active = [octave for octave, sounds in enumerate(pair.any(axis=(0, 2)).tolist()) if sounds]
        readable = [octave for octave in active if self._lowest[octave] < lowest]
        out = self._arcs.read(pair, readable, position) if readable else np.zeros(SAMPLES_PER_STATE)
        if len(readable) < len(active):
            too_fast = [octave for octave in active if self._lowest[octave] >= lowest]
            out += self._arcs.read(pair, too_fast, np.full(SAMPLES_PER_STATE, self._places[-2]))
        return out

    def _interpolate_position(self) -> Float:
        """Return the path position s (SAMPLES_PER_STATE,) [m] from the previous state to this one."""
        oldest, older, old, new = self._places
        return np.asarray(
            _HERMITE @ [old, 1.5 * old - 2.0 * older + 0.5 * oldest, new, 1.5 * new - 2.0 * old + 0.5 * older]
        )


AnyMaterial = str | Path | LibraryMaterial | MaterialFile
"""Name of a library material, path of a `.hnf` file, or the material read from either."""


def resolve_material(material: AnyMaterial) -> LibraryMaterial:
    """Return a complete material; properties that a file leaves unknown come from the library.

    Raises MaterialError for a name that is not in the library, FileError for a file that cannot be used.
    """
    if isinstance(material, LibraryMaterial):
        return material
    definition = _read_definition(material)
    return get_material(str(material)) if definition is None else with_library_defaults(definition)


def create_live_synthesis(
    *materials: AnyMaterial, seed: int = 0, probe: str = "pen", field: Field | None = None
) -> LiveSynthesis:
    """Start a live synthesis of materials 0, 1, … under a hand; takes some 50 ms to make the first noise.

    Parameters
    ----------
    *materials
        Names, `.hnf` files, or materials.
    seed
        Seed of the carriers.
    probe
        Name of the probe.
    field
        The field; None for that of a single material that contains one, else the shared field.

    Returns
    -------
    LiveSynthesis
        Ready for the first state.

    Raises
    ------
    UsageError
        If no material is given, or it cannot be synthesised live.
    MaterialError
        If a name is not in the library.
    FileError
        If a file cannot be used.
    """
    if not materials:
        raise UsageError("there is nothing to touch.", remedy="Name a material.")
    if len(materials) == 1 and field is None:
        definition = _read_definition(materials[0])
        field = None if definition is None else load_material_field(definition)
        if definition is not None and field is not None:
            materials = (read_trained_material(field, definition.name),)
    resolved = [resolve_material(material) for material in materials]
    tokens = np.stack([material.token for material in resolved])
    return LiveSynthesis(
        load_field() if field is None else field, tokens, [item.mechanics for item in resolved], seed=seed, probe=probe
    )


def _read_definition(material: AnyMaterial) -> MaterialFile | None:
    """Return the content of a `.hnf` file if `material` is or names one, else None."""
    if isinstance(material, Path) or (isinstance(material, str) and material.lower().endswith(HNF_SUFFIX)):
        return read_hnf(Path(material))
    return material if isinstance(material, MaterialFile) else None
