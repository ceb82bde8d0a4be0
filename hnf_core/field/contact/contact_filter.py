"""Linear contact as a filter in time: pressing force in, acceleration out.

The contact's stiffness depends on material and load, which change slowly. A small bank of impulse responses, one per
material and half octave of force, is therefore cross-faded at the action rate (200 Hz). The loads of the bank are the
same for every stroke, so that pressing harder at one point changes nothing elsewhere. Where the force changes fast, the
whole contact takes its place (`taps`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray

from ...kernel.compiled_carriers import StateResponses
from ...kernel.loader import load_kernel
from ...material.contact_model import Mechanics, force_response
from ...material.probe import Probe, get_probe
from ..carriers import MODEL_RATE_HZ
from ..stroke import SAMPLES_PER_STATE, STATE_FRACTIONS, evaluate_bspline

Float = NDArray[np.float64]
Response = Callable[[ArrayLike, Mechanics, Probe, ArrayLike], NDArray[np.complex128]]

LEAD_SAMPLES, TAIL_SAMPLES = 256, 3840
"""Samples of an impulse response before and after t = 0 (0.38 s: a 50 Hz contact of 5 % damping has decayed by 50
dB)."""
RESPONSE_PERIOD = 8192
"""FFT length in which a response is computed [samples]."""
LOADS_PER_OCTAVE = 2
"""Loads of the bank per octave of force.

Between two loads the responses are blended; over the library's materials the error is at most 0.6 % of the response's
energy norm, 0.02 % in the median (checked by a test).
"""
MIN_FORCE_OCTAVE = -6
"""Exponent of the lightest load, 2⁻⁶ N = 16 mN; lighter contacts have the same response."""
RESIDUAL_ENERGY = 1e-12
"""Fraction of a response's energy at which it is cut off. Half of the library's responses last 72 ms, the longest 0.26
s."""
CACHED_RESPONSES = 512
LoadedContact = tuple[Mechanics, Probe, float]
"""Material, probe and load [N]."""

STATE_CURVE = np.concatenate([evaluate_bspline(unit, 1.0 + STATE_FRACTIONS) for unit in np.eye(4)[::-1]])
"""Force curve of one state of 1 N: the spline between the second and the third of four states, oldest last."""
CURVE_LEAD = 2 * SAMPLES_PER_STATE
"""Samples of STATE_CURVE before the state itself."""
STATES_AHEAD = -(-(LEAD_SAMPLES + CURVE_LEAD) // SAMPLES_PER_STATE)
STATES_BEHIND = (TAIL_SAMPLES + len(STATE_CURVE) - CURVE_LEAD - 1) // SAMPLES_PER_STATE
"""Past states that contribute to the 50 samples after a state."""


@dataclass(frozen=True)
class FilterBank:
    """Impulse responses of B contacts (a material under a load each), and their weights at every state.

    contacts: the B (mechanics, probe, force). weights: (n, B) at the n action samples (200 Hz); each row sums to 1.
    """

    contacts: tuple[LoadedContact, ...]
    weights: Float

    def render_force(self, force: Float, start: int, count: int) -> Float:
        """Compute the acceleration (count,) [m/s²] that the pressing force (n,) [N] causes, from sample `start` on.

        Between the 200 Hz states the force follows a cubic B-spline. Spline and response are linear, so each state adds
        the same curve around itself: a small sum per state, where an FFT would process all samples.
        """
        first, last = start // SAMPLES_PER_STATE, (start + count - 1) // SAMPLES_PER_STATE
        states, kernel = last + 1 - first, load_kernel()
        if kernel is not None:
            low = min(max(first - STATES_BEHIND, 0), len(force) - 1)
            rows = slice(low, max(first + states + STATES_AHEAD + 1, low + 1))
            nearby_force, nearby_weights = np.ascontiguousarray(force[rows]), np.ascontiguousarray(self.weights[rows])
            acceleration = self._responses.compute_force_response(
                kernel, nearby_force, nearby_weights, first - low, states
            )
        else:
            acceleration = self._render_force_numpy(force, first, states)
        return acceleration[start - first * SAMPLES_PER_STATE :][:count]

    def _render_force_numpy(self, force: Float, first: int, count: int) -> Float:
        """Compute the acceleration due to the force in numpy as the kernel does, for `count` states from `first` on."""
        nearby_force = force[np.clip(np.arange(first - STATES_BEHIND, first + count + STATES_AHEAD), 0, len(force) - 1)]
        out = np.zeros((count, SAMPLES_PER_STATE))
        windows = sliding_window_view(nearby_force, STATES_BEHIND + 1 + STATES_AHEAD)
        states = np.clip(np.arange(first, first + count + 1), 0, len(force) - 1)
        for contact in self._find_active(slice(states[0], states[-1] + 1)):
            table, weight = self._responses.tables[contact], self.weights[states, contact]
            forces = windows[:, -len(table) :]
            # A constant force gives nothing, and most hands press evenly for a while, so such rows are skipped.
            rows = np.flatnonzero(np.ptp(forces, axis=1) > 0.0)
            fade = weight[rows, None] * (1.0 - STATE_FRACTIONS) + weight[rows + 1, None] * STATE_FRACTIONS
            out[rows] += fade * (forces[rows] @ table)
        return out.reshape(-1)

    @cached_property
    def _responses(self) -> StateResponses:
        """Response of each contact to 1 N in one state, as tables of samples."""
        return StateResponses([_state_response_table(*contact) for contact in self.contacts], STATES_AHEAD)

    def _find_active(self, states: slice) -> NDArray[np.intp]:
        """Return the indices of the contacts whose weight is above 0 at any of the states."""
        return np.flatnonzero(np.any(self.weights[states] > 0.0, axis=0))


def build_filter_bank(
    mechanics: tuple[Mechanics, ...], material: NDArray[np.int32], force: Float, probe: str
) -> FilterBank:
    """Build the filter bank of a stroke: all materials touched, each at the loads next to the occurring forces.

    Parameters
    ----------
    mechanics
        Stiffness, damping and friction, one per material.
    material
        (n,) index into mechanics at each state.
    force
        (n,) pressing force [N].
    probe
        Name of the probe.

    Returns
    -------
    FilterBank
        Contacts and their weights at the n states.
    """
    floor = 2.0**MIN_FORCE_OCTAVE
    load_position = LOADS_PER_OCTAVE * np.log2(np.maximum(force, floor) / floor)
    distinct = list(dict.fromkeys(mechanics[index] for index in np.unique(material)))
    distinct_index = np.array([distinct.index(touched) if touched in distinct else -1 for touched in mechanics])[
        material
    ]
    contacts: list[LoadedContact] = []
    weights = []
    for index, touched in enumerate(distinct):
        in_contact = distinct_index == index
        low = np.floor(load_position[in_contact]).astype(np.int64)
        first, row = int(low.min()), np.flatnonzero(in_contact)
        load_weights = np.zeros((len(force), int(low.max()) - first + 2))
        load_weights[row, low - first + 1] = load_position[in_contact] - low
        load_weights[row, low - first] = 1.0 - load_weights[row, low - first + 1]
        used = np.flatnonzero(load_weights.any(axis=0))
        contacts += [
            (touched, get_probe(probe), floor * 2.0 ** (float(first + step) / LOADS_PER_OCTAVE)) for step in used
        ]
        weights.append(load_weights[:, used])
    return FilterBank(tuple(contacts), np.concatenate(weights, axis=1))


@lru_cache(maxsize=CACHED_RESPONSES)
def _state_response_table(mechanics: Mechanics, probe: Probe, force: float) -> Float:
    """Compute the acceleration that 1 N in one 5 ms state causes, as seen from the samples of a state.

    Rows are the neighbouring states that the force acts in, the earliest first: (states behind + 1 + STATES_AHEAD,
    SAMPLES_PER_STATE), with as many states behind as the response lasts, STATES_BEHIND at most.
    """
    response = compute_impulse_response(force_response, mechanics, probe, force)
    duration = int(np.flatnonzero(response)[-1]) + 1 - LEAD_SAMPLES
    curve = np.fft.irfft(
        np.fft.rfft(response, RESPONSE_PERIOD) * np.fft.rfft(STATE_CURVE, RESPONSE_PERIOD), RESPONSE_PERIOD
    )
    behind = (duration + len(STATE_CURVE) - CURVE_LEAD - 1) // SAMPLES_PER_STATE
    padded = np.zeros((behind + 1 + STATES_AHEAD, SAMPLES_PER_STATE))
    begin = STATES_AHEAD * SAMPLES_PER_STATE - LEAD_SAMPLES - CURVE_LEAD
    length = LEAD_SAMPLES + duration + len(STATE_CURVE) - 1
    padded.reshape(-1)[begin : begin + length] = curve[:length]
    table = np.ascontiguousarray(padded[::-1])
    table.setflags(write=False)
    return table


@lru_cache(maxsize=CACHED_RESPONSES)
def compute_impulse_response(response: Response, mechanics: Mechanics, probe: Probe, force: float) -> Float:
    """Compute an impulse response (LEAD_SAMPLES + TAIL_SAMPLES,) at 10 kHz, from −LEAD_SAMPLES on.

    response: transfer function of height or force to acceleration, at a load `force` [N]. The result has no DC, no
    slope and nothing above 4.8 kHz, and is 0 where less than RESIDUAL_ENERGY of its energy is left.
    """
    frequency = np.fft.rfftfreq(RESPONSE_PERIOD, 1.0 / MODEL_RATE_HZ)
    taper = 0.5 + 0.5 * np.cos(np.pi * np.clip((frequency - 4000.0) / 800.0, 0.0, 1.0))
    periodic = np.fft.irfft(response(frequency, mechanics, probe, force) * taper, RESPONSE_PERIOD)
    impulse = np.roll(periodic, LEAD_SAMPLES)[: LEAD_SAMPLES + TAIL_SAMPLES]
    window = np.ones(LEAD_SAMPLES + TAIL_SAMPLES)
    window[:LEAD_SAMPLES] = 0.5 - 0.5 * np.cos(np.pi * (np.arange(LEAD_SAMPLES) + 0.5) / LEAD_SAMPLES)
    fade = TAIL_SAMPLES // 4
    window[-fade:] = 0.5 + 0.5 * np.cos(np.pi * (np.arange(fade) + 0.5) / fade)
    impulse = impulse * window
    energy_left = np.cumsum(np.square(impulse[::-1]))[::-1]
    window[energy_left < RESIDUAL_ENERGY * energy_left[0]] = 0.0
    impulse = impulse * (window > 0.0)
    # After the cut too, a constant input and one that rises evenly must give nothing, because the mass follows at rest.
    polynomials = np.stack(
        [np.ones(LEAD_SAMPLES + TAIL_SAMPLES), (np.arange(LEAD_SAMPLES + TAIL_SAMPLES) - LEAD_SAMPLES) / TAIL_SAMPLES]
    )
    impulse = impulse - window * (
        np.linalg.solve((polynomials * window) @ polynomials.T, polynomials @ impulse) @ polynomials
    )
    impulse.setflags(write=False)
    return np.asarray(impulse)
