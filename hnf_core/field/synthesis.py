"""From a stroke to a(t): the fast path.

The field is evaluated at the action rate, its carriers at 10 kHz, in blocks; any block is computable alone. Another
output rate is a resampling of the same signal, never another model.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..action.action import ACTION_RATE_HZ, Action
from ..material.contact import tip_response
from ..material.mechanics import PROBES
from ..signal import Signal
from .carriers import MODEL_RATE_HZ, Carriers
from .contact_filter import LEAD, TAIL, FilterBank, filter_bank
from .extrapolation import at_ceiling, examine
from .field import Field, accumulate, evaluate
from .linear_contact import BAND_END_HZ, FORCE_FLOOR_N, SPEED_FLOOR_M_S, Condition, upper_fade
from .modulation import arc_term, interpolate, time_term
from .profile import ProfileBands, share_power, split_profile
from .resampling import resample
from .stroke import StrokeInput, Synthesis
from .timeline import SAMPLES_PER_STATE, condition_of, cubic, sample_count, smooth, states_in, states_of

Float = NDArray[np.float64]

BLOCK = 4096
"""Samples rendered at once: bounds memory, and how much a small change costs; the last bit depends on it."""
STATES_AT_ONCE = 128
"""States evaluated at once, likewise."""
BEFORE_CONTACT_S, AFTER_CONTACT_S = 0.02, 0.06
"""Beyond these distances from contact the signal is exactly zero."""


@dataclass(frozen=True)
class Prepared:
    """A stroke with F_Θ already evaluated: all that a block of samples needs.

    amplitude: (n, heads, K), what is left to the noise carriers. profile_amplitude: (n, Ka) factor on the profile's
    bands. force: (n,) N as pressed. audible: (count,) 0 … 1, zero far from contact.
    loudest: the field's largest amplitude in each portion of states, m/s². unheld: profile_amplitude as it is
    evaluated, before it is held where the hand rests.
    """

    carriers: Carriers
    seed: int
    action: Action
    amplitude: Float
    bank: FilterBank
    force: Float
    audible: Float
    bands: ProfileBands | None = None
    profile_amplitude: Float | None = None
    loudest: Float = field(default_factory=lambda: np.zeros(0))
    unheld: Float | None = None

    @property
    def count(self) -> int:
        return len(self.audible)


def synthesise(field: Field, stroke: StrokeInput, *, seed: int, sample_rate: float = MODEL_RATE_HZ) -> Synthesis:
    """The vibration of a stroke in m/s². The same seed gives the same bytes.

    Raises StrokeError for an action without duration, UsageError for a sample rate that is not positive. What lies
    outside the field's training ranges is synthesised as it is, and named in warnings.
    """
    prepared = prepare(field, stroke, seed=seed)
    blocks = [render_block(prepared, *block) for block in blocks_of(prepared.count)]
    samples = np.concatenate(blocks) if blocks else np.zeros(0)
    return described(field, stroke, prepared, samples, sample_rate)


def described(
    field: Field, stroke: StrokeInput, prepared: Prepared, samples: Float, sample_rate: float = MODEL_RATE_HZ
) -> Synthesis:
    """Rendered samples (count,) as a signal, with what there is to say of it."""
    output, rate_warnings = resample(samples, MODEL_RATE_HZ, sample_rate)
    confidence, warnings = examine(field, stroke, prepared.action)
    warnings += at_ceiling(field.config, float(prepared.loudest.max(initial=0.0)))
    if stroke.profile is not None and prepared.bands is None:
        warnings += ("This field has no arc-length carriers: the height profile is left out.",)
    provenance = {"probe": stroke.action.probe, "field": field.identity, "model_rate_hz": f"{MODEL_RATE_HZ:g}"}
    signal = Signal(output.astype(np.float32), float(sample_rate), prepared.seed, provenance)
    return Synthesis(signal, confidence, (*warnings, *rate_warnings))


def prepare(field: Field, stroke: StrokeInput, *, seed: int, earlier: Prepared | None = None) -> Prepared:
    """Everything at the action rate: F_Θ, its accumulation over past states, and the profile's share.

    earlier: of a stroke that differs from this one in force and contact alone; only portions of states in which they
    differ are evaluated, and the result is the same.
    """
    action, token_index = states_of(stroke)
    condition = condition_of(stroke, action, token_index)
    carriers, count = field.config.carriers, len(action.speed)
    bands = None
    if stroke.profile is not None and carriers.arc_count:
        bands = split_profile(stroke.profile, carriers) if earlier is None else earlier.bands
    reading = reading_frequency(action, carriers)
    if earlier is None:
        amplitude = np.empty((count, field.config.alpha_heads, carriers.count))
        unheld = None if bands is None else np.empty((count, carriers.arc_count))
        loudest = np.empty(-(-count // STATES_AT_ONCE))
    else:
        amplitude, loudest = earlier.amplitude.copy(), earlier.loudest.copy()
        unheld = None if earlier.unheld is None else earlier.unheld.copy()
    for portion, start in enumerate(range(0, count, STATES_AT_ONCE)):
        rows = slice(start, min(start + STATES_AT_ONCE, count))
        if earlier is not None and not _differ(action, earlier.action, slice(max(start - memory(field), 0), rows.stop)):
            continue
        amplitude[rows], height, loudest[portion] = _evaluate_portion(field, condition, bands, reading[rows], rows)
        if unheld is not None and height is not None:
            unheld[rows] = height
    profile_amplitude = None
    if unheld is not None:
        sliding = condition.contact & (condition.force > FORCE_FLOOR_N) & (condition.speed > SPEED_FLOOR_M_S)
        profile_amplitude = held(unheld, sliding) * upper_fade(reading)
    pressed = np.where(action.contact, action.force, 0.0)
    if earlier is not None and np.array_equal(action.contact, earlier.action.contact):
        audible = earlier.audible
    else:
        audible = _audible(action.contact, sample_count(action))
    return Prepared(
        carriers, seed, action, amplitude, filter_bank(stroke.mechanics, token_index, pressed, action.probe), pressed,
        audible, bands, profile_amplitude, loudest, unheld,
    )  # fmt: skip


def _differ(action: Action, other: Action, rows: slice) -> bool:
    return not (
        np.array_equal(action.force[rows], other.force[rows])
        and np.array_equal(action.contact[rows], other.contact[rows])
    )


def _evaluate_portion(
    field: Field, condition: Condition, bands: ProfileBands | None, reading: Float, rows: slice
) -> tuple[Float, Float | None, float]:
    """Amplitudes of a portion of states, of the noise (m, heads, K) and of the profile (m, Ka), and the largest that
    the field gave. reading: (m, Ka) Hz of the portion."""
    carriers = field.config.carriers
    amplitude = amplitudes(field, condition, rows)
    loudest = float(np.max(np.abs(amplitude), initial=0.0))
    # The field's own gate answers to the speed of each state, but its memory is read at the speed of now.
    amplitude[:, :, carriers.arc_slice] *= (reading < BAND_END_HZ)[:, None, :]
    if bands is None:
        return amplitude, None, loudest
    part = states_in(condition, rows)
    shares = share_power(amplitude[:, 0], bands, part, carriers)
    amplitude[:, :, carriers.arc_slice] *= shares.arc[:, None, :]
    amplitude[:, :, carriers.time_slice] *= shares.time[:, None, :]
    return amplitude, shares.profile * _tip(part, carriers), loudest


def memory(field: Field) -> int:
    """States before its own that a state's amplitudes follow from."""
    config = field.config
    return config.stride * (config.states - 1) if config.accumulation == "past" else 0


def amplitudes(field: Field, condition: Condition, rows: slice) -> Float:
    """(m, heads, K) accumulated amplitudes of the states in rows."""
    first = max(rows.start - memory(field), 0)
    part = states_in(condition, slice(first, rows.stop))
    return accumulate(field.config, evaluate(field, part))[rows.start - first :]


def blocks_of(count: int) -> list[tuple[int, int]]:
    """(start, length) of the blocks in which count samples are rendered."""
    return [(start, min(BLOCK, count - start)) for start in range(0, count, BLOCK)]


def reading_frequency(action: Action, carriers: Carriers) -> Float:
    """(n, Ka) Hz at which each arc band is read: κ · |ds/dt|, by the fastest motion within two states.

    Past BAND_END_HZ a band would alias, and a jump of the hand would ask for metres of micrometres.
    """
    travel = np.abs(np.diff(action.position)) * ACTION_RATE_HZ
    around = np.pad(travel, 2)
    fastest = np.max([around[k : k + len(action.position)] for k in range(4)], axis=0)
    return np.asarray(fastest[:, None] * carriers.arc_centres())


def render_block(prepared: Prepared, start: int, count: int) -> Float:
    """Samples start … start + count − 1 of the model rate in m/s², (count,) float64; independent of other blocks."""
    audible = prepared.audible[start : start + count]
    if not audible.any():
        return np.zeros(count)
    return np.asarray(audible * (texture_term(prepared, start, count) + contact_term(prepared, start, count)))


def texture_term(prepared: Prepared, start: int, count: int) -> Float:
    """The carriers, modulated: 0 at rest and out of contact (but for the 40 ms memory)."""
    carriers, out = prepared.carriers, np.zeros(count)
    for delay in range(prepared.amplitude.shape[1]):
        amplitude = prepared.amplitude[:, delay]
        if carriers.constant:
            out += interpolate(amplitude[:, :1], start, count)[:, 0]
        if carriers.time_count:
            out += time_term(amplitude[:, carriers.time_slice], carriers, prepared.seed, start, count, delay)
        if carriers.arc_count:
            place = position(prepared.action, start - delay, count)
            out += arc_term(
                amplitude[:, carriers.arc_slice], carriers,
                lambda octave, first, length: carriers.arc_samples(prepared.seed, octave, first, length), place, start,
            )  # fmt: skip
    return out


def contact_term(prepared: Prepared, start: int, count: int) -> Float:
    """Pressing: onset, release and dF/dt through the contact, also at v = 0; and the profile under the path."""
    margin_start, margin_count = start - TAIL, TAIL + count + LEAD
    force = smooth(prepared.force, (margin_start + np.arange(margin_count)) / SAMPLES_PER_STATE)
    out = prepared.bank.apply(prepared.bank.force, force, start)
    if prepared.bands is not None and prepared.profile_amplitude is not None:
        height = arc_term(
            prepared.profile_amplitude, prepared.carriers, prepared.bands.source,
            position(prepared.action, margin_start, margin_count), margin_start,
        )  # fmt: skip
        out += prepared.bank.apply(prepared.bank.height, height, start)
    return out


def position(action: Action, start: int, count: int) -> Float:
    """s(t) [m] at samples start … of the model rate, held beyond the stroke."""
    return cubic(action.position, (start + np.arange(count)) / SAMPLES_PER_STATE)


def held(amplitude: Float, sliding: NDArray[np.bool_]) -> Float:
    """(n, K) amplitudes with the states that do not slide filled in from their sliding neighbours, linearly.

    At rest, and before the touch, the height under the hand stands still and must give nothing. Fading it in or out
    there instead would lift the hand by the height itself within some milliseconds: a blow that nobody dealt.
    """
    rows = np.flatnonzero(sliding)
    if len(rows) == 0:
        return np.zeros_like(amplitude)
    gaps = np.flatnonzero(~sliding)
    place = np.interp(gaps, rows, np.arange(len(rows)))
    low = np.floor(place).astype(np.intp)
    high, share = np.minimum(low + 1, len(rows) - 1), (place - low)[:, None]
    out = amplitude.copy()
    out[gaps] = (1.0 - share) * amplitude[rows[low]] + share * amplitude[rows[high]]
    return out


def _tip(condition: Condition, carriers: Carriers) -> Float:
    """(n, Ka) share of each band's height that the finite contact passes on; 0 out of contact."""
    out = np.zeros((len(condition.force), carriers.arc_count))
    for index, mechanics in enumerate(condition.mechanics):
        rows = np.flatnonzero((condition.material == index) & condition.contact & (condition.force > 0.0))
        force = np.maximum(condition.force[rows], FORCE_FLOOR_N)[:, None]
        out[rows] = tip_response(carriers.arc_centres(), mechanics, PROBES[condition.probe], force)
    return out


def _audible(contact: NDArray[np.bool_], count: int) -> Float:
    """1 in contact, fading to exactly 0 at BEFORE_CONTACT_S ahead of it and AFTER_CONTACT_S behind it."""
    touched = contact.astype(bool)
    sample = np.arange(count)
    state = sample / SAMPLES_PER_STATE
    indices = np.flatnonzero(touched)
    if len(indices) == 0:
        return np.zeros(count)
    following = np.searchsorted(indices, state)
    ahead = np.where(following < len(indices), indices[np.minimum(following, len(indices) - 1)] - state, np.inf)
    behind = np.where(following > 0, state - indices[np.maximum(following - 1, 0)], np.inf)
    per_state = SAMPLES_PER_STATE / MODEL_RATE_HZ
    ahead, behind = np.maximum(ahead - 1.0, 0.0) * per_state, np.maximum(behind - 1.0, 0.0) * per_state
    fade = np.maximum(1.0 - ahead / BEFORE_CONTACT_S, 1.0 - behind / AFTER_CONTACT_S)
    return np.asarray(np.sin(0.5 * np.pi * np.clip(fade, 0.0, 1.0)) ** 2)
