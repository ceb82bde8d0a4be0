"""A recording plays from anywhere, and nothing that is changed while it plays clicks."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hnf_core.actuators.sources import CROSSFADE_S, BufferSource
from hnf_core.errors import UsageError

RATE = 8000.0
FADE = round(CROSSFADE_S * RATE)


def wave(frames: int, hz: float = 50.0, phase: float = 0.0, channels: int = 1) -> NDArray[np.float32]:
    one = np.sin(2.0 * np.pi * hz * np.arange(frames) / RATE + phase)
    return np.repeat(one.astype(np.float32)[:, None], channels, axis=1)


STEP = 2.0 * np.pi * 50.0 / RATE
"""Largest change of that wave from frame to frame."""


def steepest(samples: NDArray[np.float32]) -> float:
    return float(np.abs(np.diff(samples[:, 0].astype(np.float64))).max(initial=0.0))


@given(st.integers(0, 500), st.booleans(), st.floats(-0.01, 0.1), st.lists(st.integers(0, 300), max_size=12))
@settings(max_examples=60, deadline=None)
def test_blocks_of_any_size_are_the_recording(frames: int, loop: bool, start_s: float, sizes: list[int]) -> None:
    samples = np.random.default_rng(frames).normal(size=(frames, 2)).astype(np.float32)
    blocks, once = (
        BufferSource(samples, RATE, loop=loop, start_s=start_s),
        BufferSource(samples, RATE, loop=loop, start_s=start_s),
    )
    read = np.concatenate([np.zeros((0, 2), np.float32), *(blocks.read(size) for size in sizes)])
    assert np.array_equal(read, once.read(sum(sizes)))
    assert read.dtype == np.float32
    start = min(max(round(start_s * RATE), 0), frames)
    if loop and frames:
        assert len(read) == sum(sizes)
    else:
        assert np.array_equal(read, samples[start : start + sum(sizes)])
    assert blocks.position_s == once.position_s


def test_it_ends_with_a_short_block_and_stays_ended() -> None:
    source = BufferSource(wave(100), RATE)
    assert [len(source.read(64)) for _ in range(4)] == [64, 36, 0, 0]
    source.seek(0.0)
    assert len(source.read(200)) == 100


def test_a_loop_keeps_its_period_and_its_seam_does_not_click() -> None:
    samples = wave(1000, phase=1.0) + np.float32(3.0)  # it ends elsewhere than it starts
    out = BufferSource(samples, RATE, loop=True).read(5000)
    for turn in range(1, 5):
        inside = slice(turn * 1000 + FADE, (turn + 1) * 1000)
        assert np.array_equal(out[inside], samples[FADE:])
    jump = float(abs(samples[-1, 0] - samples[0, 0]))
    assert jump > 5.0 * STEP
    assert steepest(out) < STEP + jump / FADE + 1e-3


@pytest.mark.parametrize("frames", [1, 2, 7, FADE - 1, FADE])
def test_a_loop_shorter_than_a_fade_still_loops(frames: int) -> None:
    samples = np.random.default_rng(0).normal(size=(frames, 1)).astype(np.float32)
    out = BufferSource(samples, RATE, loop=True).read(1000)
    assert len(out) == 1000
    assert np.abs(out).max() <= np.abs(samples).max() + 1e-6


@given(st.floats(0.0, 0.9), st.integers(1, 3000), st.integers(1, 500))
@settings(max_examples=40, deadline=None)
def test_a_seek_does_not_click_and_lands_where_it_says(to_s: float, before: int, block: int) -> None:
    samples = wave(8000)
    source = BufferSource(samples, RATE)
    first = source.read(before)
    source.seek(to_s)
    assert source.position_s == pytest.approx(to_s, abs=1.0 / RATE)
    rest = np.concatenate([source.read(block) for _ in range(1 + 400 // block)])
    out = np.concatenate([first, rest])
    # Equal power: two waves as one at most √2, and its gains change by π / 2 FADE a frame.
    assert steepest(out) < np.sqrt(2.0) * STEP + np.pi / FADE
    at = round(to_s * RATE)
    assert np.array_equal(rest[FADE:], samples[at + FADE : at + len(rest)])


def test_a_swap_goes_on_at_its_place_without_a_click() -> None:
    quiet, loud = wave(8000), 3.0 * wave(8000, phase=0.3)
    source = BufferSource(quiet, RATE)
    first = source.read(2000)
    source.swap(loud)
    rest = np.concatenate([source.read(37) for _ in range(50)])
    assert steepest(np.concatenate([first, rest])) < 3.0 * STEP + 4.0 / FADE
    assert np.array_equal(rest[FADE:], loud[2000 + FADE : 2000 + len(rest)])


def test_a_swap_for_the_same_changes_nothing() -> None:
    samples = wave(4000)
    source = BufferSource(samples, RATE)
    first = source.read(1000)
    source.swap(samples.copy())
    assert np.allclose(np.concatenate([first, source.read(1000)]), samples[:2000], atol=1e-6)


def test_a_swap_for_something_shorter_ends_softly_or_loops() -> None:
    for loop in (False, True):
        source = BufferSource(wave(4000), RATE, loop=loop)
        source.read(2010)
        source.swap(0.5 * wave(1000))
        out = source.read(500)
        assert len(out) == (500 if loop else 0)


def test_of_many_changes_the_latest_counts() -> None:
    samples = np.arange(8000, dtype=np.float32)[:, None]
    source = BufferSource(samples, RATE)
    source.read(10)
    for place in (0.1, 0.5, 0.25):
        source.seek(place)
    assert np.array_equal(source.read(FADE + 10)[FADE:], samples[2000 + FADE : 2000 + FADE + 10])
    for place in (0.1, 0.5):  # one comes while another fades in
        source.seek(place)
        source.read(3)
    assert source.position_s == pytest.approx(0.5)
    out = source.read(3 * FADE)
    assert np.array_equal(out[2 * FADE :], samples[4000 + FADE + 3 :][FADE : 2 * FADE]) or out[-1, 0] > 4000


def test_a_gain_changes_along_a_straight_line() -> None:
    source = BufferSource(np.ones((4000, 1), np.float32), RATE)
    assert np.array_equal(source.read(100), np.ones((100, 1)))
    source.set_gain(0.25)
    out = np.concatenate([source.read(7) for _ in range(40)])[:, 0]
    assert np.allclose(np.diff(out[: FADE - 1]), -0.75 / FADE, atol=1e-6)
    assert np.array_equal(out[FADE:], np.full(len(out) - FADE, 0.25, np.float32))
    source.set_gain(1.0)
    source.read(FADE // 2)
    source.set_gain(0.0)  # from where it is by then
    assert steepest(np.concatenate([source.read(FADE)])) <= 0.7 / FADE + 1e-6
    assert not source.read(10).any()


def test_looping_may_be_switched_while_it_plays() -> None:
    source = BufferSource(wave(1000), RATE)
    source.set_loop(True)
    assert len(source.read(2500)) == 2500
    source.set_loop(False)
    assert len(source.read(2500)) == 500


def test_two_threads_may_use_it_at_once() -> None:
    source, over = BufferSource(wave(4000), RATE, loop=True), threading.Event()

    def meddle() -> None:
        rng = np.random.default_rng(1)
        while not over.is_set():
            source.seek(float(rng.uniform(0.0, 0.5)))
            source.set_gain(float(rng.uniform(0.5, 1.0)))
            source.swap(wave(4000, phase=0.1))

    thread = threading.Thread(target=meddle)
    thread.start()
    out = np.concatenate([source.read(40) for _ in range(500)])
    over.set()
    thread.join(5.0)
    assert len(out) == 20000
    assert steepest(out) < np.sqrt(2.0) * STEP + np.pi / FADE + 0.5 / FADE


def test_what_is_no_recording_is_refused() -> None:
    for samples in (np.zeros(10), np.zeros((10, 0)), np.zeros((2, 2, 2))):
        with pytest.raises(UsageError, match="a recording is"):
            BufferSource(samples, RATE)
    with pytest.raises(UsageError):
        BufferSource(np.zeros((10, 1)), 0.0)
    source = BufferSource(np.zeros((10, 1)), RATE)
    with pytest.raises(UsageError, match="channels"):
        source.swap(np.zeros((10, 2)))
    for gain in (-1.0, float("nan"), float("inf")):
        with pytest.raises(UsageError, match="gain"):
            source.set_gain(gain)
    source.seek(float("nan"))
    assert source.position_s == 0.0
    source.seek(1e308)
    assert source.position_s == source.duration_s
