"""A stroke with F_Θ evaluated: all at the action rate that a block of samples is rendered from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from ..material.contact import tip_response
from ..material.probe import PROBES
from .adaptive import Sampled, Sampler, Sampling, accumulated, sampling
from .audible import audible_gain
from .breakpoints import breakpoints_of
from .carriers import Carriers
from .contact_filter import FilterBank, filter_bank
from .emissions import AT_ONCE, Asking, Evaluate, answered, one_after_another
from .field import Emission, Field, accumulate, evaluate, kernel_for
from .linear_contact import BAND_END_HZ, FORCE_FLOOR_N, SPEED_FLOOR_M_S, Condition, upper_fade
from .profile import ProfileBands, share_power, split_profile
from .stroke import StrokeInput
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

STATES_AT_ONCE = 128
"""Action states in a portion: F_Θ is asked about one after the other. In numpy results depend on how many are asked for
at once, so this is part of the byte-exact contract."""


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


def prepare(
    field: Field,
    stroke: StrokeInput,
    *,
    seed: int,
    earlier: Prepared | None = None,
    tolerance: float | None = None,
    emission: Evaluate = evaluate,
) -> Prepared:
    """preparing(), answered. emission: what stands for F_Θ, a table."""
    return answered(field, preparing(field, stroke, seed=seed, earlier=earlier, tolerance=tolerance), emission)


def preparing(
    field: Field, stroke: StrokeInput, *, seed: int, earlier: Prepared | None = None, tolerance: float | None = None
) -> Asking[Prepared]:
    """Everything at the action rate: F_Θ, its accumulation over past states, and the profile's share.

    earlier: of a stroke that differs from this one in force and contact alone; only portions of states in which they
    differ are evaluated, and the result is the same. tolerance: F_Θ is evaluated where the action asks for it, until
    the amplitudes of the whole stroke are within it of their power (root; see adaptive), in place of at every state;
    it has no say where a profile shares in the power or heads lag.
    """
    action, token_index = states_of(stroke)
    if tolerance is not None and adapts(field, stroke):
        return (yield from preparing_within(field, stroke, seed, action, token_index, tolerance))
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
    known = None
    if earlier is None and kernel_for(field) is not None:  # of any number of states what it is of a portion
        known = _Known(field, condition)
    for portion, (rows, felt) in enumerate(portions(field, count)):
        if earlier is not None and not _differ(action, earlier.action, felt):
            continue
        if in_the_air(condition, felt):
            amplitude[rows], loudest[portion] = 0.0, 0.0
            if unheld is not None:
                unheld[rows] = 0.0
            continue
        given = (yield states_in(condition, felt)) if known is None else (yield from known.of(felt))
        amplitude[rows], height, loudest[portion] = _amplitudes(field, condition, given, bands, reading[rows], rows)
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


def portions(field: Field, count: int) -> Iterator[tuple[slice, slice]]:
    """Of so many states: the rows of each portion, and those that it follows from, the same and its memory."""
    for start in range(0, count, STATES_AT_ONCE):
        stop = min(start + STATES_AT_ONCE, count)
        yield slice(start, stop), slice(max(start - memory(field), 0), stop)


class _Known:
    """F_Θ at the states of one portion after another, each asked about once, together with those of the next portions;
    not at those that nobody will use."""

    def __init__(self, field: Field, condition: Condition) -> None:
        self._field, self._condition = field, condition
        self._wanted = np.zeros(len(condition.speed), dtype=bool)
        for _, felt in portions(field, len(self._wanted)):
            self._wanted[felt] |= not in_the_air(condition, felt)
        self._begin = self._end = 0
        self._held = _nothing(field, 0)

    def of(self, felt: slice) -> Asking[Emission]:
        if felt.stop > self._end:
            left = self._held.of(slice(max(felt.start - self._begin, 0), None))
            begin = max(felt.start, self._end)
            end = min(max(begin + AT_ONCE, felt.stop), len(self._wanted))
            self._held = one_after_another([left, (yield from self._asked(slice(begin, end)))])
            self._begin, self._end = felt.start, end
        return self._held.of(slice(felt.start - self._begin, felt.stop - self._begin))

    def _asked(self, rows: slice) -> Asking[Emission]:
        wanted = self._wanted[rows]
        part = states_in(self._condition, rows)
        if wanted.all():
            return (yield part)
        emitted = _nothing(self._field, len(wanted))
        emitted.take(wanted, (yield states_in(part, wanted)))
        return emitted


def _nothing(field: Field, count: int) -> Emission:
    config = field.config
    return Emission(np.zeros((count, config.alpha_heads, config.carriers.count)), np.zeros((count, config.states)))


def in_the_air(condition: Condition, states: slice) -> bool:
    """Whether these touch nothing: then nothing is emitted, and nothing remembered."""
    return not condition.contact[states].any()


def adapts(field: Field, stroke: StrokeInput) -> bool:
    """Whether a tolerance has a say: with past states, and no profile that shares in the power."""
    shared = stroke.profile is not None and field.config.carriers.arc_count > 0
    return field.config.accumulation == "past" and not shared


def preparing_within(
    field: Field,
    stroke: StrokeInput,
    seed: int,
    action: Action,
    token_index: NDArray[np.int32],
    tolerance: float,
    sampler: Sampler = sampling,
) -> Asking[Prepared]:
    """preparing() with a tolerance, of what adapts(). sampler: chooses where F_Θ is evaluated."""
    carriers, count = field.config.carriers, sample_count(action)
    wanted = sampler(count, tolerance, breakpoints_of(action, token_index))
    sampled = yield from _felt_samples(field, stroke, action, token_index, wanted)
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


def _felt_samples(
    field: Field, stroke: StrokeInput, action: Action, token_index: NDArray[np.int32], wanted: Sampling
) -> Asking[Sampled]:
    """Nothing in the air, but for what remembers the contact or interpolates towards it."""
    felt = _remembered(action.contact, memory(field))
    try:
        at = next(wanted)
        while True:
            rows = felt[np.minimum(at // SAMPLES_PER_STATE, len(felt) - 1)]
            if rows.all():
                emitted = yield condition_at(stroke, action, token_index, at)
            else:
                emitted = _nothing(field, len(at))
                if rows.any():
                    emitted.take(rows, (yield condition_at(stroke, action, token_index, at[rows])))
            at = wanted.send(emitted)
    except StopIteration as done:
        sampled: Sampled = done.value
        return sampled


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


def _amplitudes(
    field: Field, condition: Condition, given: Emission, bands: ProfileBands | None, reading: Float, rows: slice
) -> tuple[Float, Float | None, float]:
    """Amplitudes of a portion of states, of the noise (m, heads, K) and of the profile (m, Ka), and the largest that
    the field gave. given: what it emits there and in its memory. reading: (m, Ka) Hz of the portion."""
    carriers = field.config.carriers
    amplitude = accumulate(field.config, given, len(given.alpha) - (rows.stop - rows.start))
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


def reading_frequency(action: Action, carriers: Carriers) -> Float:
    """(n, Ka) Hz at which each arc band is read: κ · |ds/dt|, by the fastest motion within two states.

    Past BAND_END_HZ a band would alias, and a jump of the hand would ask for metres of micrometres.
    """
    return np.asarray(fastest(action)[:, None] * carriers.arc_centres())


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
