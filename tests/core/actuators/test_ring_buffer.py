"""The ring loses, doubles and reorders nothing, never holds more than it may, and lets go of whoever sleeps on it."""

from __future__ import annotations

import threading

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.actuators.sink import Counts
from hnf_core.actuators.stream import RingBuffer


def numbered(start: int, frames: int, channels: int = 1) -> Counts:
    return np.repeat(np.arange(start, start + frames, dtype=np.int16)[:, None], channels, axis=1)


@given(
    st.integers(1, 40), st.lists(st.integers(0, 60), max_size=12), st.lists(st.integers(1, 50), min_size=1, max_size=5)
)
@settings(max_examples=60, deadline=None)
def test_what_one_thread_puts_another_takes_in_order(capacity: int, puts: list[int], takes: list[int]) -> None:
    ring, taken = RingBuffer(capacity, 2), []

    def write() -> None:
        start = 0
        for frames in puts:
            assert ring.put(numbered(start, frames, 2))
            start += frames
        ring.finish()

    writer = threading.Thread(target=write)
    writer.start()
    turn = 0
    while not ring.ended:
        counts, _ = ring.get(takes[turn % len(takes)], 1.0)
        assert len(counts) <= min(takes[turn % len(takes)], capacity)
        taken.append(counts)
        turn += 1
    writer.join(5.0)
    assert not writer.is_alive()
    assert np.array_equal(np.concatenate([np.zeros((0, 2), np.int16), *taken]), numbered(0, sum(puts), 2))


def test_a_take_tells_the_stamp_of_its_first_frame() -> None:
    ring = RingBuffer(100, 1)
    for stamp, frames in ((1.0, 10), (2.0, 5), (3.0, 20)):
        ring.put(numbered(0, frames), stamp)
    assert [ring.get(most, 0.0)[1] for most in (4, 4, 4, 3, 1, 100)] == [1.0, 1.0, 1.0, 2.0, 3.0, 3.0]
    assert ring.get(1, 0.0)[1] == 0.0


def test_room_is_told_without_being_taken() -> None:
    ring = RingBuffer(10, 1)
    assert ring.wait_for_space(10, 0.0)
    assert ring.wait_for_space(1000, 0.0), "more than it can ever hold means all of it"
    ring.put(numbered(0, 4))
    assert not ring.wait_for_space(7, 0.0)
    assert ring.wait_for_space(6, 0.0)


def test_closing_wakes_a_writer_and_drops_what_is_there() -> None:
    ring, told = RingBuffer(5, 1), []
    writer = threading.Thread(target=lambda: told.append(ring.put(numbered(0, 50))))
    writer.start()
    ring.close()
    writer.join(5.0)
    assert told == [False]
    assert ring.ended
    assert len(ring.get(5, 0.0)[0]) == 0
    assert not ring.wait_for_space(1, 0.0)


def test_finishing_wakes_a_reader() -> None:
    ring, told = RingBuffer(5, 1), []
    reader = threading.Thread(target=lambda: told.append(len(ring.get(5, 60.0)[0])))
    reader.start()
    ring.finish()
    reader.join(5.0)
    assert told == [0]
    assert ring.ended
