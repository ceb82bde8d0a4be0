"""The linear contact as a filter in time: profile height or pressing force in, acceleration out.

Stiffness follows material and load, both slow; a small bank of impulse responses, one per material and half octave of
force, is cross-faded at the action rate. Its loads are the same for every stroke, so that pressing harder in one place
changes nothing in another.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray

from ..kernel.compiled_carriers import StateResponses
from ..kernel.loader import load_kernel
from ..material.contact_model import Mechanics, force_response, height_response
from ..material.probe import PROBES, Probe
from .carrier_rendering import find_states_read, interpolate_amplitudes
from .carriers import MODEL_RATE_HZ
from .stroke import SAMPLES_PER_STATE, STATE_FRACTIONS, evaluate_bspline

Float = NDArray[np.float64]
Response = Callable[[ArrayLike, Mechanics, Probe, ArrayLike], NDArray[np.complex128]]

LEAD_SAMPLES, TAIL_SAMPLES = 256, 3840
"""Samples of an impulse response kept before and after t = 0 (0.38 s: a 50 Hz contact of 5 % damping is 50 dB down)."""
RESPONSE_PERIOD = 8192
"""Samples of the period in which a response is worked out."""
LOADS_PER_OCTAVE = 2
"""Between two loads their responses are blended: over the library's materials 0.6 % of the response's energy norm off
at worst, 0.02 % in the median (a test holds it)."""
MIN_FORCE_OCTAVE = -6
"""2⁻⁶ N = 16 mN; what presses less answers alike."""
RESIDUAL_ENERGY = 1e-12
"""Of a response's energy: what comes after is left out. Half of the library's last 72 ms, the longest 0.26 s."""
CACHED_RESPONSES = 512
LoadedContact = tuple[Mechanics, Probe, float]
"""What is touched, with what, at which load [N]."""

STATE_CURVE = np.concatenate([evaluate_bspline(unit, 1.0 + STATE_FRACTIONS) for unit in np.eye(4)[::-1]])
"""What one state of 1 N makes of the force: the spline between the second and the third of four states, oldest last."""
CURVE_LEAD = 2 * SAMPLES_PER_STATE
"""Samples of it before the state's own."""
STATES_AHEAD = -(-(LEAD_SAMPLES + CURVE_LEAD) // SAMPLES_PER_STATE)
STATES_BEHIND = (TAIL_SAMPLES + len(STATE_CURVE) - CURVE_LEAD - 1) // SAMPLES_PER_STATE
"""Past states that contribute to the 50 samples after a state."""


@dataclass(frozen=True)
class FilterBank:
    """contacts: B of them. weights: (n, B) of each at every state, sum 1."""

    contacts: tuple[LoadedContact, ...]
    weights: Float

    def render_height(self, height: Float, start: int) -> Float:
        """Acceleration (count,) [m/s²] of a profile height (TAIL + count + LEAD,) [m], which begins TAIL samples before
        sample `start`."""
        count = len(height) - LEAD_SAMPLES - TAIL_SAMPLES
        # A circle as long as the signal is enough: what wraps round is in the samples before `start`.
        size = 1 << (len(height) - 1).bit_length()
        used = self._find_active(find_states_read(len(self.weights), start, count))
        kernels = np.stack([compute_impulse_response(height_response, *self.contacts[each]) for each in used])
        full = np.fft.irfft(np.fft.rfft(height, size) * np.fft.rfft(kernels, size), size)
        fades = interpolate_amplitudes(self.weights[:, used], start, count)
        return np.asarray(
            np.einsum("tb,bt->t", fades, full[:, TAIL_SAMPLES + LEAD_SAMPLES : TAIL_SAMPLES + LEAD_SAMPLES + count])
        )

    def render_force(self, force: Float, start: int, count: int) -> Float:
        """The same, of the force (n,) [N] that presses at each state, with the cubic B-spline through them.

        Spline and response are linear, so each state adds the same curve, at its own place, to all samples about it:
        a small sum for a state, where a transform would be of all its samples.
        """
        first, last = start // SAMPLES_PER_STATE, (start + count - 1) // SAMPLES_PER_STATE
        states, compiled = last + 1 - first, load_kernel()
        if compiled is not None:
            low = min(max(first - STATES_BEHIND, 0), len(force) - 1)
            near = slice(low, max(first + states + STATES_AHEAD + 1, low + 1))
            pressed, weights = np.ascontiguousarray(force[near]), np.ascontiguousarray(self.weights[near])
            out = self._responses.compute_force_response(compiled, pressed, weights, first - low, states)
        else:
            out = self._render_force_numpy(force, first, states)
        return out[start - first * SAMPLES_PER_STATE :][:count]

    def _render_force_numpy(self, force: Float, first: int, count: int) -> Float:
        """In numpy: what the kernel is tested against."""
        near = force[np.clip(np.arange(first - STATES_BEHIND, first + count + STATES_AHEAD), 0, len(force) - 1)]
        out = np.zeros((count, SAMPLES_PER_STATE))
        around = sliding_window_view(near, STATES_BEHIND + 1 + STATES_AHEAD)
        states = np.clip(np.arange(first, first + count + 1), 0, len(force) - 1)
        for each in self._find_active(slice(states[0], states[-1] + 1)):
            table, weight = self._responses.tables[each], self.weights[states, each]
            pressing = around[:, -len(table) :]
            # The responses pass nothing constant on, and most hands press evenly for a while.
            rows = np.flatnonzero(np.ptp(pressing, axis=1) > 0.0)
            fade = weight[rows, None] * (1.0 - STATE_FRACTIONS) + weight[rows + 1, None] * STATE_FRACTIONS
            out[rows] += fade * (pressing[rows] @ table)
        return out.reshape(-1)

    @cached_property
    def _responses(self) -> StateResponses:
        return StateResponses([_state_response_table(*each) for each in self.contacts], STATES_AHEAD)

    def _find_active(self, states: slice) -> NDArray[np.intp]:
        return np.flatnonzero(np.any(self.weights[states] > 0.0, axis=0))


def build_filter_bank(
    mechanics: tuple[Mechanics, ...], material: NDArray[np.int32], force: Float, probe: str
) -> FilterBank:
    """Every different mechanics that is touched, at the loads next to those it is pressed with.

    material: (n,) index into mechanics at each state; force: (n,) N.
    """
    floor = 2.0**MIN_FORCE_OCTAVE
    place = LOADS_PER_OCTAVE * np.log2(np.maximum(force, floor) / floor)
    kinds = list(dict.fromkeys(mechanics[index] for index in np.unique(material)))
    kind = np.array([kinds.index(each) if each in kinds else -1 for each in mechanics])[material]
    contacts: list[LoadedContact] = []
    weights = []
    for index, each in enumerate(kinds):
        mine = kind == index
        low = np.floor(place[mine]).astype(np.int64)
        first, row = int(low.min()), np.flatnonzero(mine)
        hats = np.zeros((len(force), int(low.max()) - first + 2))
        hats[row, low - first + 1] = place[mine] - low
        hats[row, low - first] = 1.0 - hats[row, low - first + 1]
        used = np.flatnonzero(hats.any(axis=0))
        contacts += [(each, PROBES[probe], floor * 2.0 ** (float(first + n) / LOADS_PER_OCTAVE)) for n in used]
        weights.append(hats[:, used])
    return FilterBank(tuple(contacts), np.concatenate(weights, axis=1))


@lru_cache(maxsize=CACHED_RESPONSES)
def _state_response_table(mechanics: Mechanics, probe: Probe, force: float) -> Float:
    """(states behind + 1 + STATES_AHEAD, SAMPLES_PER_STATE): response of a state's samples to 1 N at each
    neighbouring state, the earliest first; as many behind as the response lasts, STATES_BEHIND at most."""
    response = compute_impulse_response(force_response, mechanics, probe, force)
    lasts = int(np.flatnonzero(response)[-1]) + 1 - LEAD_SAMPLES
    curve = np.fft.irfft(
        np.fft.rfft(response, RESPONSE_PERIOD) * np.fft.rfft(STATE_CURVE, RESPONSE_PERIOD), RESPONSE_PERIOD
    )
    behind = (lasts + len(STATE_CURVE) - CURVE_LEAD - 1) // SAMPLES_PER_STATE
    whole = np.zeros((behind + 1 + STATES_AHEAD, SAMPLES_PER_STATE))
    begin = STATES_AHEAD * SAMPLES_PER_STATE - LEAD_SAMPLES - CURVE_LEAD
    length = LEAD_SAMPLES + lasts + len(STATE_CURVE) - 1
    whole.reshape(-1)[begin : begin + length] = curve[:length]
    table = np.ascontiguousarray(whole[::-1])
    table.setflags(write=False)
    return table


@lru_cache(maxsize=CACHED_RESPONSES)
def compute_impulse_response(response: Response, mechanics: Mechanics, probe: Probe, force: float) -> Float:
    """(LEAD + TAIL,) samples at the model rate from −LEAD on; no DC, no slope, nothing above 4.8 kHz. Zero where less
    than LASTS of its energy is left."""
    frequency = np.fft.rfftfreq(RESPONSE_PERIOD, 1.0 / MODEL_RATE_HZ)
    taper = 0.5 + 0.5 * np.cos(np.pi * np.clip((frequency - 4000.0) / 800.0, 0.0, 1.0))
    whole = np.fft.irfft(response(frequency, mechanics, probe, force) * taper, RESPONSE_PERIOD)
    kept = np.roll(whole, LEAD_SAMPLES)[: LEAD_SAMPLES + TAIL_SAMPLES]
    window = np.ones(LEAD_SAMPLES + TAIL_SAMPLES)
    window[:LEAD_SAMPLES] = 0.5 - 0.5 * np.cos(np.pi * (np.arange(LEAD_SAMPLES) + 0.5) / LEAD_SAMPLES)
    fade = TAIL_SAMPLES // 4
    window[-fade:] = 0.5 + 0.5 * np.cos(np.pi * (np.arange(fade) + 0.5) / fade)
    kept = kept * window
    left = np.cumsum(np.square(kept[::-1]))[::-1]
    window[left < RESIDUAL_ENERGY * left[0]] = 0.0
    kept = kept * (window > 0.0)
    # What is constant must give nothing, also after the cut, and what rises evenly too: the mass follows it at rest.
    steady = np.stack(
        [np.ones(LEAD_SAMPLES + TAIL_SAMPLES), (np.arange(LEAD_SAMPLES + TAIL_SAMPLES) - LEAD_SAMPLES) / TAIL_SAMPLES]
    )
    kept = kept - window * (np.linalg.solve((steady * window) @ steady.T, steady @ kept) @ steady)
    kept.setflags(write=False)
    return np.asarray(kept)
