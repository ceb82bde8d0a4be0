"""Carriers drawn while F_Θ is evaluated: only those needed, with an unchanged signal."""

from __future__ import annotations

import _thread
import threading
import time
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

from data_tools.bench_strokes import clear_carrier_caches, make_keyed_stroke
from hnf_core.action.primitive_path import make_primitive_action
from hnf_core.action.primitives import PRIMITIVES
from hnf_core.field import noise_cache as ahead
from hnf_core.field.field import FieldConfig
from hnf_core.field.noise_cache import (
    MAX_PREFETCHED_ARC_HOPS,
    MAX_PREFETCHED_TIME_HOPS,
    get_arc_hop,
    get_time_hop,
    prefetch_noise,
)
from hnf_core.field.prepare import prepare_stroke
from hnf_core.field.render import render_samples
from hnf_core.field.stroke import StrokeInput, resample_action, uniform_stroke
from hnf_core.field.synthesis import render_stroke
from hnf_core.field.weights import load_field
from hnf_core.kernel.loader import load_kernel, why_unavailable, without_kernel
from hnf_core.material.library import get_material
from hnf_core.progress import count_work

needs_kernel = pytest.mark.skipif(load_kernel() is None, reason=f"no compiled kernel here: {why_unavailable()}")
FIELD = load_field()
CARRIERS = FIELD.config.carriers


@pytest.fixture(autouse=True)
def nothing_kept():
    clear_carrier_caches()
    yield
    clear_carrier_caches()


def drawn() -> tuple[int, int]:
    """Hops in time and in arc length, since all were forgotten."""
    return get_time_hop.cache_info().misses, get_arc_hop.cache_info().misses


def wanted(stroke: StrokeInput, seed: int = 4, origin: int = 0) -> list[object]:
    """Draws all that is wanted ahead."""
    return [each() for each in ahead._plan_draws(CARRIERS, seed, resample_action(stroke)[0], origin)]


def primitive(name: str) -> StrokeInput:
    leather = get_material("leather")
    return uniform_stroke(make_primitive_action(PRIMITIVES[name], seed=1), leather.token, leather.mechanics)


@pytest.mark.parametrize("name", sorted(PRIMITIVES))
def test_what_is_drawn_ahead_is_heard(name):
    """A render needs no fewer for it, and most of what it needs is there."""
    stroke = primitive(name)
    render_samples(prepare_stroke(FIELD, stroke, seed=4))
    alone = drawn()
    clear_carrier_caches()
    wanted(stroke)
    before = drawn()
    render_samples(prepare_stroke(FIELD, stroke, seed=4))
    assert drawn() == alone
    assert sum(before) >= 0.9 * sum(alone)


@needs_kernel
@pytest.mark.parametrize("tolerance", [None, 0.01])
def test_the_signal_is_the_same(tolerance):
    stroke, threads = make_keyed_stroke(3.0), _thread._count()
    found = render_stroke(FIELD, stroke, 4, tolerance)[1]
    clear_carrier_caches()
    assert np.array_equal(found, render_samples(prepare_stroke(FIELD, stroke, seed=4, tolerance=tolerance)))
    assert_none_is_left(threads)


@needs_kernel
def test_it_draws_while_another_thing_is_done_and_ends_with_it(monkeypatch):
    monkeypatch.setattr(ahead, "available_cpus", lambda: 2)
    action, met, threads = resample_action(make_keyed_stroke(2.0))[0], threading.Event(), _thread._count()
    monkeypatch.setattr(ahead, "get_time_hop", Noting(met))
    with suppress(KeyError), prefetch_noise(FIELD.config, 4, action):
        assert met.wait(60.0)
        assert _thread._count() == threads + 1
        raise KeyError
    assert_none_is_left(threads)


def assert_none_is_left(threads: int) -> None:
    """No more threads than so many; one that has said that it is done may take a moment to be gone."""
    until = time.monotonic() + 10.0
    while _thread._count() > threads and time.monotonic() < until:
        time.sleep(0.001)
    assert _thread._count() <= threads


class Noting:
    """time_hop, and that it was called."""

    def __init__(self, met: threading.Event) -> None:
        self._met, self.cache_info = met, get_time_hop.cache_info

    def __call__(self, *given: object) -> object:
        found = get_time_hop(*given)
        self._met.set()
        return found


@needs_kernel
def test_what_cannot_be_drawn_is_told_by_who_needs_it(monkeypatch):
    def fails(*_: object) -> object:
        raise MemoryError

    monkeypatch.setattr(ahead, "get_arc_hop", fails)
    with prefetch_noise(FIELD.config, 4, resample_action(make_keyed_stroke(1.0))[0]):
        pass


def test_nothing_is_drawn_in_the_air_nor_where_it_is_kept():
    stroke = make_keyed_stroke(2.0)
    lifted = replace(stroke, action=replace(stroke.action, contact=np.zeros(len(stroke.action.speed), dtype=bool)))
    assert wanted(lifted) == []
    assert drawn() == (0, 0)
    render_samples(prepare_stroke(FIELD, stroke, seed=4))
    before = drawn()
    assert len(wanted(stroke)) == 1
    assert drawn() == before


def test_prefetch_of_a_long_stroke_evicts_no_unused_carrier():
    drawn_ahead = wanted(make_keyed_stroke(60.0))
    assert 0 < drawn()[0] <= MAX_PREFETCHED_TIME_HOPS
    assert 0 < drawn()[1] <= MAX_PREFETCHED_ARC_HOPS
    assert len(drawn_ahead) == sum(drawn())


def test_a_later_piece_begins_with_its_own_hops():
    stroke = make_keyed_stroke(1.0)
    first = wanted(stroke, origin=40 * 4096)[0]
    assert first is get_time_hop(CARRIERS, 4, 40)


def test_no_thread_is_begun_where_it_would_not_help(monkeypatch):
    action = resample_action(make_keyed_stroke(1.0))[0]
    apart = replace(FIELD.config, accumulation="heads")
    without = replace(FIELD.config, carriers=replace(CARRIERS, time_edges_hz=()))
    with count_work() as work:
        with without_kernel(), prefetch_noise(FIELD.config, 4, action):
            pass
        for config in (FieldConfig.published(8), apart, without):
            with prefetch_noise(config, 4, action):
                pass
        monkeypatch.setattr(ahead, "available_cpus", lambda: 1)
        with prefetch_noise(FIELD.config, 4, action):
            pass
    assert work.total("threads") == 0
    assert drawn() == (0, 0)
