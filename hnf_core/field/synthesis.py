"""From a stroke to a(t): the fast path.

The field is evaluated at the action rate, its carriers at 10 kHz, in blocks; any block is computable alone. Another
output rate is a resampling of the same signal, never another model.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from ..cores import beside, cores
from ..kernel.library import kernel, one_blas_thread_in_numpy
from ..material.contact import tip_response
from ..material.probe import PROBES
from ..signal import Signal
from .adaptive import Sampler, accumulated, sample_emission
from .audible import BLOCK, audible_gain, blocks_of, heard_spans, is_heard
from .breakpoints import breakpoints_of
from .carriers import MODEL_RATE_HZ, Carriers
from .contact_filter import LEAD, TAIL, FilterBank, filter_bank
from .extrapolation import at_ceiling, examine
from .field import Emission, Field, accumulate, evaluate
from .hops import HOP
from .knots import Knots
from .linear_contact import BAND_END_HZ, FORCE_FLOOR_N, SPEED_FLOOR_M_S, Condition, upper_fade
from .modulation import arc_term
from .noise_ahead import noise_ahead
from .path import position, position_beyond
from .plain import plain_texture
from .profile import ProfileBands, share_power, split_profile
from .resampling import resample
from .stroke import StrokeInput, Synthesis
from .texture import REACH, texture_hops
from .timeline import (
    SAMPLES_PER_STATE,
    condition_at,
    condition_of,
    fastest,
    sample_count,
    states_in,
    states_of,
)

Float = NDArray[np.float64]
Evaluate = Callable[[Field, Condition], Emission]

THREAD_FROM_SAMPLES = 4 * BLOCK
"""From this many samples on, the contact term runs in a second thread."""
STATES_AT_ONCE = 128
"""Action states per F_Θ batch. Float32 results depend on the size of a batch, so this is part of the byte-exact
contract."""


@dataclass(frozen=True)
class Prepared:
    """A stroke with F_Θ already evaluated: all that a block of samples needs.

    amplitude: (m, heads, K), what is left to the noise carriers, linear in time between knots. knots: (m,) samples of
    the model rate; None for one at each of the n states. profile_amplitude: (n, Ka) factor on the profile's bands.
    force: (n,) N as pressed. audible: (count,) 0 … 1, zero far from contact.
    loudest: the field's largest amplitude in each portion of states, m/s². unheld: profile_amplitude as it is
    evaluated, before hold_at_rest(). missed: share of the power that knots leave out, see Sampled.
    origin: the sample of the carriers' clock at which this begins, where it is a piece of a longer stroke.
    """

    carriers: Carriers
    seed: int
    action: Action
    amplitude: NDArray[np.floating[Any]]
    bank: FilterBank
    force: Float
    audible: Float
    bands: ProfileBands | None = None
    profile_amplitude: Float | None = None
    loudest: Float = field(default_factory=lambda: np.zeros(0))
    unheld: Float | None = None
    knots: NDArray[np.int64] | None = None
    missed: float = 0.0
    origin: int = 0

    @property
    def count(self) -> int:
        return len(self.audible)


def synthesise(
    field: Field,
    stroke: StrokeInput,
    *,
    seed: int,
    sample_rate: float = MODEL_RATE_HZ,
    tolerance: float | None = None,
) -> Synthesis:
    """The vibration of a stroke in m/s². The same seed gives the same bytes.

    tolerance: see prepare(). Raises StrokeError for an action without duration, UsageError for a sample rate that is
    not positive. What lies outside the field's training ranges is synthesised as it is, and named in warnings.
    """
    prepared, samples = synthesised(field, stroke, seed, tolerance)
    told = to_synthesis(field, stroke, prepared, samples, sample_rate)
    return replace(told, warnings=(*told.warnings, *fallen_short(prepared.missed, tolerance)))


def fallen_short(missed: float, tolerance: float | None) -> tuple[str, ...]:
    """What there is to say of a stroke that was not followed as closely as was asked for. missed: see Prepared."""
    if tolerance is None or missed <= tolerance**2 * (1.0 + 1e-9):
        return ()
    return (
        f"the tolerance of {20.0 * np.log10(tolerance):.0f} dB is not kept: the field changes faster along this stroke "
        f"than it is followed, which is to within about {10.0 * np.log10(missed):.0f} dB.",
    )


def synthesised(
    field: Field, stroke: StrokeInput, seed: int, tolerance: float | None = None, emission: Evaluate = evaluate
) -> tuple[Prepared, Float]:
    """prepare() and rendered(), with carriers drawn while F_Θ is evaluated."""
    with noise_ahead(field.config, seed, states_of(stroke)[0]):
        prepared = prepare(field, stroke, seed=seed, tolerance=tolerance, emission=emission)
    return prepared, rendered(prepared)


def to_synthesis(
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


def prepare(
    field: Field,
    stroke: StrokeInput,
    *,
    seed: int,
    earlier: Prepared | None = None,
    tolerance: float | None = None,
    emission: Evaluate = evaluate,
) -> Prepared:
    """Everything at the action rate: F_Θ, its accumulation over past states, and the profile's share.

    earlier: of a stroke that differs from this one in force and contact alone; only portions of states in which they
    differ are evaluated, and the result is the same. tolerance: F_Θ is evaluated where the action asks for it, until
    the amplitudes of the whole stroke are within it of their power (root; see adaptive), in place of at every state;
    it has no say where a profile shares in the power or heads lag. emission: what stands for F_Θ, a table.
    """
    action, token_index = states_of(stroke)
    if tolerance is not None and adapts(field, stroke):
        return prepare_within(field, stroke, seed, action, token_index, tolerance, emission)
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
        felt = slice(max(start - memory(field), 0), rows.stop)
        if earlier is not None and not _differ(action, earlier.action, felt):
            continue
        if in_the_air(condition, felt):
            amplitude[rows], loudest[portion] = 0.0, 0.0
            if unheld is not None:
                unheld[rows] = 0.0
            continue
        amplitude[rows], height, loudest[portion] = _evaluate_portion(field, condition, bands, reading[rows], rows)
        if unheld is not None and height is not None:
            unheld[rows] = height
    profile_amplitude = None
    if unheld is not None:
        sliding = condition.contact & (condition.force > FORCE_FLOOR_N) & (condition.speed > SPEED_FLOOR_M_S)
        profile_amplitude = hold_at_rest(unheld, sliding) * upper_fade(reading)
    pressed = np.where(action.contact, action.force, 0.0)
    if earlier is not None and np.array_equal(action.contact, earlier.action.contact):
        audible = earlier.audible
    else:
        audible = audible_gain(action.contact, sample_count(action))
    return Prepared(
        carriers, seed, action, amplitude, filter_bank(stroke.mechanics, token_index, pressed, action.probe), pressed,
        audible, bands, profile_amplitude, loudest, unheld,
    )  # fmt: skip


def in_the_air(condition: Condition, states: slice) -> bool:
    """Whether these touch nothing: then nothing is emitted, and nothing remembered."""
    return not condition.contact[states].any()


def adapts(field: Field, stroke: StrokeInput) -> bool:
    """Whether a tolerance has a say: with past states, and no profile that shares in the power."""
    shared = stroke.profile is not None and field.config.carriers.arc_count > 0
    return field.config.accumulation == "past" and not shared


def prepare_within(
    field: Field,
    stroke: StrokeInput,
    seed: int,
    action: Action,
    token_index: NDArray[np.int32],
    tolerance: float,
    emission: Evaluate = evaluate,
    sample: Sampler = sample_emission,
) -> Prepared:
    """prepare() with a tolerance, of what adapts(). sample: chooses where F_Θ is evaluated."""
    carriers, config, count = field.config.carriers, field.config, sample_count(action)
    felt = _remembered(action.contact, memory(field))

    def emit(at: NDArray[np.int64]) -> Emission:
        """Nothing in the air, but for what remembers the contact or interpolates towards it."""
        rows = felt[np.minimum(at // SAMPLES_PER_STATE, len(felt) - 1)]
        if rows.all():
            return emission(field, condition_at(stroke, action, token_index, at))
        alpha, sigma_dt = np.zeros((len(at), 1, carriers.count)), np.zeros((len(at), config.states))
        if rows.any():
            found = emission(field, condition_at(stroke, action, token_index, at[rows]))
            alpha[rows], sigma_dt[rows] = found.alpha, found.sigma_dt
        return Emission(alpha, sigma_dt)

    sampled = sample(emit, count, tolerance, breakpoints_of(action, token_index))
    knots, amplitude = accumulated(field.config, sampled, count)
    if carriers.arc_count:
        pace, state = fastest(action), knots // SAMPLES_PER_STATE
        around = np.maximum(pace[state], pace[np.minimum(state + 1, len(pace) - 1)])
        fast = np.flatnonzero(around * carriers.arc_centres()[-1] >= BAND_END_HZ)
        amplitude[fast, carriers.arc_slice] *= around[fast, None] * carriers.arc_centres() < BAND_END_HZ
    pressed = np.where(action.contact, action.force, 0.0)
    bank = filter_bank(stroke.mechanics, token_index, pressed, action.probe)
    loudest = np.array([np.max(sampled.alpha, initial=0.0)], dtype=np.float64)
    return Prepared(
        carriers, seed, action, amplitude[:, None, :], bank, pressed, audible_gain(action.contact, count),
        loudest=loudest, knots=knots, missed=sampled.missed,
    )  # fmt: skip


def _remembered(contact: NDArray[np.bool_], states: int) -> NDArray[np.bool_]:
    """(n,) whether a state, the next one, or any of so many before it and one more touches."""
    touched = np.concatenate([[0], np.cumsum(contact)])
    by_next = np.append(touched[2:], touched[-1])
    before = np.concatenate([np.zeros(states + 1, dtype=touched.dtype), touched])[: len(contact)]
    return np.asarray(by_next > before)


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


def reading_frequency(action: Action, carriers: Carriers) -> Float:
    """(n, Ka) Hz at which each arc band is read: κ · |ds/dt|, by the fastest motion within two states.

    Past BAND_END_HZ a band would alias, and a jump of the hand would ask for metres of micrometres.
    """
    return np.asarray(fastest(action)[:, None] * carriers.arc_centres())


def rendered(prepared: Prepared, start: int = 0, stop: int | None = None) -> Float:
    """Samples start … stop − 1, all of them where nothing is said, (stop − start,)."""
    stop = prepared.count if stop is None else stop
    out = np.zeros(stop - start)
    with one_blas_thread_in_numpy():
        for first, count in heard_spans(prepared.audible[start:stop]):
            out[first : first + count] = render_block(prepared, start + first, count)
    return out


def render_block(prepared: Prepared, start: int, count: int) -> Float:
    """Samples start … start + count − 1 of the model rate in m/s², (count,) float64; independent of other blocks."""
    audible = prepared.audible[start : start + count]
    if not is_heard(audible):
        return np.zeros(count)
    if count < THREAD_FROM_SAMPLES or kernel() is None or cores() < 2:
        out = texture_term(prepared, start, count)
        out += contact_term(prepared, start, count)
    else:
        felt: list[Float] = []
        # Numpy would only wait for the interpreter, which the other thread holds.
        wait = beside(lambda: felt.append(contact_term(prepared, start, count)))
        try:
            out = texture_term(prepared, start, count)
        finally:
            wait()
        out += felt[0]
    out *= audible
    return out


def texture_term(prepared: Prepared, start: int, count: int) -> Float:
    """The carriers, modulated: 0 at rest and out of contact (but for the 40 ms memory)."""
    carriers, seed, action, origin = prepared.carriers, prepared.seed, prepared.action, prepared.origin
    if prepared.amplitude.shape[1] > 1 or carriers.constant:
        return plain_texture(prepared.amplitude, carriers, seed, action, start, count, origin)
    at = prepared.knots
    if at is None:
        at = SAMPLES_PER_STATE * np.arange(len(prepared.amplitude))
    knots, first = Knots(at + origin, prepared.amplitude[:, 0]), (origin + start) // HOP
    hops = range(first, (origin + start + count - 1) // HOP + 1)
    place = position_beyond(action, first * HOP - origin - REACH, len(hops) * HOP + 2 * REACH)
    begin = origin + start - first * HOP
    return texture_hops(knots, carriers, seed, place, hops)[begin : begin + count]


def contact_term(prepared: Prepared, start: int, count: int) -> Float:
    """Pressing: onset, release and dF/dt through the contact, also at v = 0; and the profile under the path."""
    out = prepared.bank.force_term(prepared.force, start, count)
    for at, many in blocks_of(count):
        out[at : at + many] += _profile_term(prepared, start + at, many)
    return out


def _profile_term(prepared: Prepared, start: int, count: int) -> Float | float:
    if prepared.bands is None or prepared.profile_amplitude is None:
        return 0.0
    first, many = start - TAIL, TAIL + count + LEAD
    height = arc_term(
        prepared.profile_amplitude, prepared.carriers, prepared.bands.source,
        position(prepared.action, first, many), first,
    )  # fmt: skip
    return prepared.bank.height_term(height, start)


def hold_at_rest(amplitude: Float, sliding: NDArray[np.bool_]) -> Float:
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
