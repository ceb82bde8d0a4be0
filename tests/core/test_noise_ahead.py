"""Carriers that are drawn while F_Θ is evaluated: those that are needed, no others, and the same signal."""

from __future__ import annotations

import _thread
import threading
import time
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

from hnf_core.action.primitive_path import primitive_action
from hnf_core.action.primitives import PRIMITIVES
from hnf_core.bench.synth import forget_carriers, ten_seconds
from hnf_core.field import noise_ahead as ahead
from hnf_core.field.blocks import rendered
from hnf_core.field.config import FieldConfig
from hnf_core.field.hops import arc_hop, time_hop
from hnf_core.field.noise_ahead import MOST_ARC_HOPS, MOST_TIME_HOPS, noise_ahead
from hnf_core.field.prepared import prepare
from hnf_core.field.stroke import StrokeInput, uniform_stroke
from hnf_core.field.synthesis import synthesised
from hnf_core.field.timeline import states_of
from hnf_core.field.weights import load_field
from hnf_core.kernel.library import kernel, plainly, why_not
from hnf_core.material.library import find

needs_kernel = pytest.mark.skipif(kernel() is None, reason=f"no compiled kernel here: {why_not()}")
FIELD = load_field()
CARRIERS = FIELD.config.carriers


@pytest.fixture(autouse=True)
def nothing_kept():
    forget_carriers()
    yield
    forget_carriers()


def drawn() -> tuple[int, int]:
    """Hops in time and in arc length, since all were forgotten."""
    return time_hop.cache_info().misses, arc_hop.cache_info().misses


def wanted(stroke: StrokeInput, seed: int = 4, origin: int = 0) -> list[object]:
    """Draws all that is wanted ahead."""
    return [each() for each in ahead._wanted(CARRIERS, seed, states_of(stroke)[0], origin)]


def primitive(name: str) -> StrokeInput:
    leather = find("leather")
    return uniform_stroke(primitive_action(PRIMITIVES[name], seed=1), leather.token, leather.mechanics)


@pytest.mark.parametrize("name", sorted(PRIMITIVES))
def test_what_is_drawn_ahead_is_heard(name):
    """A render needs no fewer for it, and most of what it needs is there."""
    stroke = primitive(name)
    rendered(prepare(FIELD, stroke, seed=4))
    alone = drawn()
    forget_carriers()
    wanted(stroke)
    before = drawn()
    rendered(prepare(FIELD, stroke, seed=4))
    assert drawn() == alone
    assert sum(before) >= 0.9 * sum(alone)


@needs_kernel
@pytest.mark.parametrize("tolerance", [None, 0.01])
def test_the_signal_is_the_same(tolerance):
    stroke, threads = ten_seconds(3.0), _thread._count()
    found = synthesised(FIELD, stroke, 4, tolerance)[1]
    forget_carriers()
    assert np.array_equal(found, rendered(prepare(FIELD, stroke, seed=4, tolerance=tolerance)))
    assert_none_is_left(threads)


@needs_kernel
def test_it_draws_while_another_thing_is_done_and_ends_with_it(monkeypatch):
    monkeypatch.setattr(ahead, "cores", lambda: 2)
    action, met, threads = states_of(ten_seconds(2.0))[0], threading.Event(), _thread._count()
    monkeypatch.setattr(ahead, "time_hop", Noting(met))
    with suppress(KeyError), noise_ahead(FIELD.config, 4, action):
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
        self._met, self.cache_info = met, time_hop.cache_info

    def __call__(self, *given: object) -> object:
        found = time_hop(*given)
        self._met.set()
        return found


@needs_kernel
def test_what_cannot_be_drawn_is_told_by_who_needs_it(monkeypatch):
    def fails(*_: object) -> object:
        raise MemoryError

    monkeypatch.setattr(ahead, "arc_hop", fails)
    with noise_ahead(FIELD.config, 4, states_of(ten_seconds(1.0))[0]):
        pass


def test_nothing_is_drawn_in_the_air_nor_where_it_is_kept():
    stroke = ten_seconds(2.0)
    lifted = replace(stroke, action=replace(stroke.action, contact=np.zeros(len(stroke.action.speed), dtype=bool)))
    assert wanted(lifted) == []
    assert drawn() == (0, 0)
    rendered(prepare(FIELD, stroke, seed=4))
    before = drawn()
    assert len(wanted(stroke)) == 1
    assert drawn() == before


def test_a_long_stroke_pushes_nothing_out_that_is_yet_to_be_heard():
    drawn_ahead = wanted(ten_seconds(60.0))
    assert 0 < drawn()[0] <= MOST_TIME_HOPS
    assert 0 < drawn()[1] <= MOST_ARC_HOPS
    assert len(drawn_ahead) == sum(drawn())


def test_a_later_piece_begins_with_its_own_hops():
    stroke = ten_seconds(1.0)
    first = wanted(stroke, origin=40 * 4096)[0]
    assert first is time_hop(CARRIERS, 4, 40)


def test_no_thread_is_begun_where_it_would_not_help(monkeypatch):
    monkeypatch.setattr(ahead, "beside", lambda _: pytest.fail("a thread"))
    action = states_of(ten_seconds(1.0))[0]
    with plainly(), noise_ahead(FIELD.config, 4, action):
        pass
    apart = replace(FIELD.config, accumulation="heads")
    without = replace(FIELD.config, carriers=replace(CARRIERS, time_edges_hz=()))
    for config in (FieldConfig.published(8), apart, without):
        with noise_ahead(config, 4, action):
            pass
    monkeypatch.setattr(ahead, "cores", lambda: 1)
    with noise_ahead(FIELD.config, 4, action):
        pass
    assert drawn() == (0, 0)
