"""Properties of the limiter for any input, any limits and any block size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hnf_core.actuators.limiter import Limiter
from hnf_core.actuators.limits import FULL_SCALE_COUNTS, Limits, compute_limiter_params
from hnf_core.errors import UsageError
from reference.limiter_reference import ChannelReference, limit

SPECIALS = np.array([np.nan, np.inf, -np.inf, 1e-45, -1e-45, 3.4e38, -3.4e38, 0.0, -0.0, 1.0], dtype=np.float32)
RATES = (100.0, 2800.0, 8000.0, 10000.0, 44100.0)


@dataclass(frozen=True)
class Case:
    """pieces: what is asked of a limiter, in order: frames of samples, or a number of frames of soft stop."""

    limits: Limits
    rate_hz: float
    channels: int
    heat: float
    pieces: tuple[NDArray[np.float32] | int, ...]


@st.composite
def some_limits(draw: st.DrawFn) -> Limits:
    def log(lowest: float, highest: float) -> float:
        return float(10.0 ** draw(st.floats(lowest, highest)))

    return Limits(
        full_scale_m_s2=log(-3, 5),
        peak=draw(st.floats(1e-3, 1.0)),
        slew_per_s=float("inf") if draw(st.booleans()) else log(0, 5),
        sustained=draw(st.one_of(st.just(1.0), st.floats(1e-3, 1.0))),
        thermal_s=log(-5, 2),
        ramp_s=log(-4, -1),
    )


@st.composite
def some_samples(draw: st.DrawFn, limits: Limits, channels: int) -> NDArray[np.float32]:
    frames = draw(st.one_of(st.integers(0, 3), st.integers(0, 400)))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    level = limits.full_scale_m_s2 * draw(st.sampled_from([1e-3, 0.3, 1.0, 30.0, 1e12]))
    shape = (frames, channels)
    kinds = {
        "noise": rng.normal(0.0, level, shape),
        "constant": np.full(shape, level),
        "square": level * np.sign(np.sin(np.arange(frames) * rng.uniform(0.01, 3.0)))[:, None] * np.ones(channels),
        "special": rng.choice(SPECIALS, shape),
        "mixed": np.where(rng.random(shape) < 0.1, rng.choice(SPECIALS, shape), rng.normal(0.0, level, shape)),
    }
    return np.asarray(kinds[draw(st.sampled_from(sorted(kinds)))], dtype=np.float32)


@st.composite
def cases(draw: st.DrawFn) -> Case:
    limits, channels = draw(some_limits()), draw(st.integers(1, 4))
    pieces = draw(st.lists(st.one_of(some_samples(limits, channels), st.integers(0, 200)), min_size=1, max_size=4))
    heat = draw(st.sampled_from([0.0, 0.0, 0.5, 1.0]))
    return Case(limits, draw(st.sampled_from(RATES)), channels, heat, tuple(pieces))


def made(case: Case) -> Limiter | None:
    """None: these limits leave nothing at this rate."""
    try:
        return Limiter(case.limits, case.rate_hz, case.channels, initial_heat=case.heat)
    except UsageError:
        assert (
            min(case.limits.peak, case.limits.sustained, case.limits.slew_per_s / case.rate_hz) * FULL_SCALE_COUNTS
            < 1.0
        )
        return None


def played(limiter: Limiter, pieces: Sequence[NDArray[np.float32] | int]) -> NDArray[np.int64]:
    """Asks for each piece in turn, and every count that left."""
    done = [limiter.soft_stop(piece) if isinstance(piece, int) else limiter.process(piece) for piece in pieces]
    assert all(counts.dtype == np.int16 for counts in done)
    return np.concatenate(done).astype(np.int64)


def mean_squares(counts: NDArray[np.int64], limits: Limits, rate_hz: float, first: float = 0.0) -> NDArray[np.float64]:
    """(n, channels) counts²: the coil's mean square through one pole, frame by frame, as the model has it."""
    keep = float(np.exp(-1.0 / (limits.thermal_s * rate_hz)))
    square, squares = np.full(counts.shape[1], first), np.zeros(counts.shape)
    for place, frame in enumerate(counts):
        squares[place] = square = keep * square + (1.0 - keep) * np.square(frame)
    return squares


@given(cases())
@settings(max_examples=150, deadline=None)
def test_no_count_passes_the_peak_the_slew_or_the_warmth(case: Case) -> None:
    limiter = made(case)
    if limiter is None:
        return
    counts = played(limiter, case.pieces)
    assert np.abs(counts).max(initial=0) <= case.limits.peak_counts
    change = np.abs(np.diff(counts, axis=0, prepend=0)).max(initial=0)
    assert change <= max(case.limits.slew_per_s / case.rate_hz * FULL_SCALE_COUNTS, 1.0)
    bound = (case.limits.sustained * FULL_SCALE_COUNTS) ** 2
    squares = mean_squares(counts, case.limits, case.rate_hz, case.heat * bound)
    assert squares.max(initial=0.0) <= bound * (1.0 + 1e-9)


@given(cases())
@settings(max_examples=80, deadline=None)
def test_the_fast_path_gives_the_bytes_of_the_plain_reference(case: Case) -> None:
    limiter = made(case)
    if limiter is None:
        return
    counts = played(limiter, case.pieces)
    law = compute_limiter_params(case.limits, case.rate_hz)
    warm = case.heat * law.max_mean_square if np.isfinite(law.max_mean_square) else 0.0
    lanes = [ChannelReference(law, mean_square=warm) for _ in range(case.channels)]
    expected = []
    for piece in case.pieces:
        if isinstance(piece, int):
            expected += [[lane.soft_stop() for lane in lanes] for _ in range(piece)]
        else:
            expected += [[lane.process(float(v)) for lane, v in zip(lanes, frame, strict=True)] for frame in piece]
    assert counts.tolist() == expected
    assert limiter.limited == sum(lane.limited for lane in lanes)
    assert limiter.nonfinite == sum(lane.nonfinite for lane in lanes)


@given(cases(), st.randoms(use_true_random=False))
@settings(max_examples=80, deadline=None)
def test_no_cut_into_blocks_shows(case: Case, chance: object) -> None:
    whole, cut = made(case), made(case)
    if whole is None or cut is None:
        return
    pieces: list[NDArray[np.float32] | int] = []
    for piece in case.pieces:
        length = piece if isinstance(piece, int) else len(piece)
        places = sorted(chance.randint(0, length) for _ in range(chance.randint(0, 6)))  # type: ignore[attr-defined]
        for start, end in zip([0, *places], [*places, length], strict=True):
            pieces.append(end - start if isinstance(piece, int) else piece[start:end])
    assert played(whole, case.pieces).tolist() == played(cut, pieces).tolist()
    assert (whole.limited, whole.nonfinite) == (cut.limited, cut.nonfinite)
    assert whole.heat.tolist() == cut.heat.tolist()


@given(cases())
@settings(max_examples=60, deadline=None)
def test_a_release_ends_with_zero_and_nothing_swells(case: Case) -> None:
    limiter = made(case)
    if limiter is None:
        return
    before = played(limiter, case.pieces)
    counts = limiter.flush().astype(np.int64)
    ramp = np.ceil(case.limits.ramp_s * case.rate_hz)
    law = compute_limiter_params(case.limits, case.rate_hz)
    assert len(counts) <= ramp + law.peak / law.max_step + 3
    if len(counts):
        assert not counts[-1].any()
        assert limiter.is_resting
    else:
        assert not before[-1:].any()
    if len(counts) and not isinstance(case.pieces[-1], int) and len(case.pieces[-1]):
        assert (np.abs(counts) <= np.abs(before[-1])).all()
        if not np.isfinite(law.max_mean_square):  # no cap that may rise again as the coil cools
            assert (np.diff(np.abs(np.concatenate([before[-1:], counts])), axis=0) <= 0).all()
    assert not limiter.soft_stop(50).any()


@pytest.mark.parametrize("slew_per_s", [2.0, 10.0, 50.0])
@pytest.mark.parametrize("thermal_s", [0.005, 0.05])
def test_a_slow_slew_is_paid_for_before_the_coil_is_warm(slew_per_s: float, thermal_s: float) -> None:
    """Where the way down takes longer than the coil has, the level must turn back early: the two never contradict."""
    limits, rate = Limits(30.0, slew_per_s=slew_per_s, sustained=0.05, thermal_s=thermal_s), 10000.0
    for hertz in (0.0, 20.0):
        loud = 300.0 * np.cos(2.0 * np.pi * hertz * np.arange(2500) / rate)[:, None]
        counts = Limiter(limits, rate, 1).process(loud)[:, 0].astype(np.int64)
        assert np.abs(np.diff(counts)).max() <= slew_per_s / rate * FULL_SCALE_COUNTS
        assert mean_squares(counts[:, None], limits, rate).max() <= (0.05 * FULL_SCALE_COUNTS) ** 2
        lane = ChannelReference(compute_limiter_params(limits, rate))
        assert counts.tolist() == [lane.process(float(value)) for value in loud[:, 0]]


LIMITS = Limits(30.0, slew_per_s=2.0 * np.pi * 1000.0, sustained=0.3, thermal_s=0.5)


def test_what_is_within_the_limits_passes_untouched() -> None:
    samples = (6.0 * np.sin(2.0 * np.pi * 200.0 * np.arange(4000) / 10000.0)).astype(np.float32)[:, None]
    limiter = Limiter(LIMITS, 10000.0, 1)
    counts = limiter.process(samples)
    expected = np.rint(samples.astype(np.float64) / 30.0 * FULL_SCALE_COUNTS)
    assert np.array_equal(counts[40:], expected[40:])
    assert limiter.limited == 0
    assert (np.abs(counts[:40]) <= np.abs(expected[:40])).all()


def test_full_scale_is_the_largest_count_and_needs_no_limiting() -> None:
    limiter = Limiter(Limits(30.0), 10000.0, 2)
    counts = limiter.process(np.array([[30.0, -30.0]] * 100))
    assert counts[-1].tolist() == [32767, -32767]
    assert limiter.limited == 0


def test_loud_signals_settle_smoothly_below_the_sustained_limit() -> None:
    rate = 10000.0
    share = 0.8 * np.sin(2.0 * np.pi * 200.0 * np.arange(60000) / rate)
    counts = Limiter(LIMITS, rate, 1).process(30.0 * share[:, None])[:, 0].astype(np.float64) / FULL_SCALE_COUNTS
    settled = float(np.sqrt(np.mean(np.square(counts[-20000:]))))
    assert 0.85 * LIMITS.sustained < settled <= LIMITS.sustained
    loud = np.flatnonzero(np.abs(share) > 0.4)
    gain = counts[loud] / share[loud]
    assert gain[200] == pytest.approx(1.0, abs=1e-3), "cold, it is as loud as it came"
    neighbours = (np.diff(loud) == 1) & (loud[1:] > 100)
    assert np.abs(np.diff(gain)[neighbours]).max() < 0.005, "a gain in steps would be felt"


def test_numbers_that_are_none_are_silence_and_counted() -> None:
    limiter = Limiter(Limits(30.0), 10000.0, 2)
    counts = limiter.process(np.array([[np.nan, np.inf], [-np.inf, 3.0]] * 50))
    assert limiter.nonfinite == 150
    assert not counts[:, 0].any()
    assert limiter.limited == 0


def test_the_first_block_and_the_one_after_a_stop_start_softly() -> None:
    limiter = Limiter(Limits(30.0, ramp_s=0.01), 10000.0, 1)
    loud = np.full((200, 1), 30.0)
    first = limiter.process(loud)[:, 0].astype(np.int64)
    limiter.soft_stop(300)
    again = limiter.process(loud)[:, 0].astype(np.int64)
    assert first[0] < 0.01 * FULL_SCALE_COUNTS
    assert first[99] == FULL_SCALE_COUNTS
    assert np.array_equal(first, again)


def test_a_list_of_frames_is_limited_as_a_block_of_them() -> None:
    frames = np.random.default_rng(3).normal(0.0, 40.0, (300, 2))
    assert limit(LIMITS, 8000.0, frames.tolist(), 2) == Limiter(LIMITS, 8000.0, 2).process(frames).tolist()


@pytest.mark.parametrize(
    "limits",
    [Limits(30.0, peak=1e-6), Limits(30.0, slew_per_s=0.1), Limits(30.0, sustained=1e-6)],
)
def test_limits_that_leave_nothing_are_refused(limits: Limits) -> None:
    with pytest.raises(UsageError, match="nothing can be felt"):
        Limiter(limits, 10000.0, 1)


def test_blocks_of_another_shape_are_refused() -> None:
    limiter = Limiter(LIMITS, 10000.0, 2)
    for shape in ((10,), (10, 1), (10, 3), (1, 10, 2)):
        with pytest.raises(UsageError, match="a block is"):
            limiter.process(np.zeros(shape))
    for channels, rate in ((0, 8000.0), (1, 0.0), (1, float("nan"))):
        with pytest.raises(UsageError):
            Limiter(LIMITS, rate, channels)
