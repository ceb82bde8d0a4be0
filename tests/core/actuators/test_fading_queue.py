"""A queue that ends in silence by itself."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from hnf_core.actuators.sink import FadingQueue

RAMP = 8
Counts = NDArray[np.int16]

counts_of = st.integers(1, 30).flatmap(
    lambda n: st.lists(st.integers(-32767, 32767), min_size=n, max_size=n).map(
        lambda values: np.array(values, dtype=np.int16)[:, None]
    )
)
steps = st.lists(
    st.one_of(counts_of, st.integers(1, 40), st.just("stop"), st.just("finish")), min_size=1, max_size=30
)  # counts are pushed, a number is advanced


def run(queue: FadingQueue, schedule: list[object]) -> Counts:
    heard = [np.zeros((0, 1), np.int16)]
    for step in schedule:
        if isinstance(step, np.ndarray):
            queue.push(step)
        elif isinstance(step, int):
            heard.append(queue.advance(step))
        elif step == "stop":
            queue.stop()
        else:
            queue.finish()
    return np.concatenate(heard)


@given(st.lists(counts_of, min_size=1, max_size=8), st.lists(st.integers(1, 40), max_size=12))
def test_what_comes_in_time_passes_as_it_is(pieces: list[Counts], cuts: list[int]) -> None:
    queue, whole = FadingQueue(300, 1, RAMP), np.concatenate(pieces)
    for piece in pieces:
        queue.push(piece)
    heard = run(queue, [*(cut for cut in cuts)])
    size = min(len(whole), len(heard))
    assert (heard[:size] == whole[:size]).all()
    assert queue.played == size
    assert queue.queued == len(whole) - size


@given(steps)
def test_silence_comes_by_itself_and_nothing_exceeds_what_came(schedule: list[object]) -> None:
    queue = FadingQueue(300, 1, RAMP)
    heard = run(queue, schedule)
    owed = queue.queued
    rest = queue.advance(owed + 2 * RAMP + 40)
    assert not rest[owed + 2 * RAMP :].any()
    assert queue.is_silent
    largest = max((int(np.abs(step.astype(int)).max()) for step in schedule if isinstance(step, np.ndarray)), default=0)
    assert np.abs(np.concatenate([heard, rest]).astype(int)).max(initial=0) <= largest


@given(steps)
def test_any_cut_into_blocks_gives_the_same(schedule: list[object]) -> None:
    one, other = FadingQueue(300, 1, RAMP), FadingQueue(300, 1, RAMP)
    single = [each for step in schedule for each in ([1] * step if isinstance(step, int) else [step])]
    assert (run(one, schedule) == run(other, single)).all()
    assert (one.underruns, one.played, one.is_silent) == (other.underruns, other.played, other.is_silent)


@given(st.integers(1, 32767), st.lists(st.one_of(st.integers(1, 40), st.integers(1, 40).map(str)), max_size=20))
def test_gaps_in_a_steady_level_never_step(level: int, schedule: list[int | str]) -> None:
    """A number is advanced, a text pushes so many frames: whatever is missing when, no step is larger than a ramp's."""
    queue = FadingQueue(300, 1, RAMP)
    heard = [np.full((1, 1), level)]
    queue.push(np.full((1, 1), level, np.int16))
    heard.append(queue.advance(1))
    for step in schedule:
        if isinstance(step, int):
            heard.append(queue.advance(step))
        else:
            queue.push(np.full((int(step), 1), level, np.int16))
    heard.append(queue.advance(300 + 2 * RAMP))
    assert np.abs(np.diff(np.concatenate(heard).astype(int), axis=0)).max() <= -(-level // RAMP) + 1


def test_underruns_are_counted_and_an_end_is_none() -> None:
    queue = FadingQueue(30, 1, RAMP)
    piece = np.full((10, 1), 800, np.int16)
    queue.push(piece)
    assert not queue.would_underrun(10)
    assert queue.advance(15)[10:, 0].tolist() == [700, 600, 500, 400, 300]
    assert queue.would_underrun(1) is False
    assert queue.underruns == 1
    queue.push(piece)
    assert queue.would_underrun(1) is False
    assert queue.advance(15)[:, 0].tolist() == [200, 100, 0, 100, 200, 300, 400, 500, 600, 700, 800, 800, 700, 600, 500]
    assert queue.underruns == 2
    queue.stop()
    queue.advance(RAMP)
    assert queue.is_silent
    queue.push(piece)
    queue.finish()
    queue.advance(40)
    assert queue.underruns == 2
    assert queue.is_silent


def test_stop_drops_what_is_owed() -> None:
    queue = FadingQueue(30, 2, RAMP)
    queue.push(np.full((20, 2), [800, -800], np.int16))
    queue.advance(5)
    queue.stop()
    assert queue.queued == 0
    assert queue.advance(10)[:, 0].tolist() == [700, 600, 500, 400, 300, 200, 100, 0, 0, 0]
    assert queue.underruns == 0
