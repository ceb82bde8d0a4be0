"""The compiled kernel equals numpy, refuses arguments it would misread, and is optional."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_tools.bench_strokes import clear_carrier_caches, make_keyed_stroke
from hnf_core import threads as both_cores
from hnf_core.field import carrier_rendering
from hnf_core.field.adaptive_sampling import SampledEmission, accumulate_samples
from hnf_core.field.carrier_rendering import REACH_SAMPLES, Knots, render_carrier_hops
from hnf_core.field.carriers import (
    Carriers,
    crossfade_window,
    draw_band_bins,
    make_bins,
    make_wave_plan,
    render_complex_waves,
    render_real_waves,
)
from hnf_core.field.field import FieldConfig
from hnf_core.field.linear_contact import compute_linear_contact
from hnf_core.field.noise_cache import get_arc_hop, get_time_hop
from hnf_core.field.prepare import prepare_stroke
from hnf_core.field.render import render_samples
from hnf_core.field.stroke import extrapolate_position, interpolate_condition, resample_action
from hnf_core.field.weights import load_field
from hnf_core.kernel import compiled_carriers, loader
from hnf_core.kernel.compiled_carriers import ArcHop, ArcReader, CarrierTables, TimeHop
from hnf_core.kernel.compiled_carriers import draw_bins as compiled_bins
from hnf_core.kernel.compiled_carriers import render_real_waves as compiled_waves
from hnf_core.kernel.compiled_field import CONTACT_COLUMNS, TOKEN_FEATURES, ContactTables, blend_rows
from hnf_core.kernel.compiled_field import compute_linear_contact as compiled_contact
from hnf_core.kernel.loader import load_kernel, why_unavailable, without_kernel
from hnf_core.material.library import get_material

CARRIERS = Carriers()
HOP = carrier_rendering.HOP_SIZE
needs_kernel = pytest.mark.skipif(load_kernel() is None, reason=f"no compiled kernel here: {why_unavailable()}")


def level_db(found: np.ndarray, wanted: np.ndarray) -> float:
    return float(20.0 * np.log10(np.std(found - wanted) / np.std(wanted)))


def libraries() -> list[Path]:
    import hnf_kernel

    return sorted(Path(hnf_kernel.__file__).parent.glob(f"hnf_kernel*{loader.LIBRARY_SUFFIX}"))


@pytest.mark.skipif(importlib.util.find_spec("ziglang") is None, reason="an environment that is left without")
def test_an_environment_with_its_compiler_has_it():
    assert why_unavailable() == ""
    assert len(libraries()) == 2


@needs_kernel
@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([0.003, 0.08, 0.5]), st.sampled_from([40, 50, 700]))
def test_a_hop_is_the_one_that_numpy_reads(seed, speed, spacing):
    """Knots anywhere, some of them silent, a hand that turns back; waves drawn by either."""
    rng = np.random.default_rng(seed)
    at = np.cumsum(rng.integers(1, spacing, 2 + (HOP + 2 * REACH_SAMPLES) // (spacing // 2)))
    amplitude = rng.uniform(0.0, 1.0, (len(at), CARRIERS.count)) * rng.integers(0, 4, (len(at), 1)).clip(0, 1)
    place = speed * np.sin(np.arange(HOP + 2 * REACH_SAMPLES) / 1e4 * rng.uniform(0.5, 9.0)) / 3.0 + rng.uniform(
        -3.0, 3.0
    )
    hop = int(rng.integers(-50, 50))
    knots = Knots(at + hop * HOP - REACH_SAMPLES, amplitude)
    clear_carrier_caches()
    found = render_carrier_hops(knots, CARRIERS, seed, place, range(hop, hop + 1))
    with without_kernel():
        read_plainly = render_carrier_hops(knots, CARRIERS, seed, place, range(hop, hop + 1))
        clear_carrier_caches()
        wanted = render_carrier_hops(knots, CARRIERS, seed, place, range(hop, hop + 1))
    assert np.std(wanted) > 0.01
    assert level_db(found, read_plainly) < -120.0
    assert level_db(found, wanted) < -115.0


@needs_kernel
def test_hops_in_a_row_are_what_each_is_alone():
    """Bit for bit; knots far apart and close by, a silent stretch, a hand that jumps."""
    rng, hops = np.random.default_rng(8), range(-2, 5)
    at = np.cumsum(np.where(np.arange(400) % 100 < 50, rng.integers(1, 40, 400), rng.integers(60, 130, 400)))
    amplitude = rng.uniform(0.0, 1.0, (len(at), CARRIERS.count))
    amplitude[200:330] = 0.0
    knots = Knots(at - 3 * HOP, amplitude)
    place = 0.2 * np.sin(np.arange(len(hops) * HOP + 2 * REACH_SAMPLES) / 4e3)
    place[3 * HOP :] += 5.0
    found = render_carrier_hops(knots, CARRIERS, 5, place, hops).reshape(len(hops), HOP)
    for row, hop in zip(found, hops, strict=True):
        about = place[(hop - hops.start) * HOP :][: HOP + 2 * REACH_SAMPLES]
        np.testing.assert_array_equal(row, render_carrier_hops(knots, CARRIERS, 5, about, range(hop, hop + 1)))
    assert np.std(found[0]) > 0.01
    assert not found[2].any()


@needs_kernel
def test_a_stroke_rendered_on_two_cores_is_that_of_one(monkeypatch):
    stroke = make_keyed_stroke(4.0)
    prepared = prepare_stroke(load_field(), stroke, seed=2)
    monkeypatch.setattr(both_cores, "available_cpus", lambda: 1)
    wanted = render_samples(prepared)
    monkeypatch.setattr(both_cores, "available_cpus", lambda: 2)
    assert render_samples(prepared).tobytes() == wanted.tobytes()
    assert render_samples(prepared, 5000, 31_000).tobytes() == wanted[5000:31_000].tobytes()


@needs_kernel
@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.integers(-5, 5), st.integers(0, 7))
def test_noise_and_its_waves_are_numpys(seed, block, octave):
    edges = CARRIERS.arc_edges()[24 * octave :][:25] * CARRIERS.arc_step_m(octave) * 8192
    bins = make_bins(edges, 8192)
    arcs, times = (
        make_wave_plan(bins.starts, crossfade_window(size), middle) for size, middle in ((1024, 384), (2048, 0))
    )
    drawn = draw_band_bins(seed, octave, block, bins)
    found = render_complex_waves(drawn, arcs), render_real_waves(drawn, times)
    with without_kernel():
        np.testing.assert_allclose(drawn, draw_band_bins(seed, octave, block, bins), rtol=1e-13, atol=1e-9)
        wanted = render_complex_waves(drawn, arcs), render_real_waves(drawn, times)
    for one, other in zip(found, wanted, strict=True):
        assert one.dtype == other.dtype
        assert np.abs(one - other).max() < 2e-6 * np.abs(other).max()


@needs_kernel
@pytest.mark.parametrize("material", ["leather", "cotton-canvas", "brass"])
def test_contact_is_numpys_to_the_last_digits(material):
    stroke = make_keyed_stroke(3.0)
    stroke = type(stroke)(
        stroke.action, get_material(material).token[None], (get_material(material).mechanics,), stroke.token_index
    )
    action, index = resample_action(stroke)
    condition = interpolate_condition(stroke, action, index, np.arange(-60, 30_000, 37))
    found = compute_linear_contact(condition, CARRIERS)
    with without_kernel():
        wanted = compute_linear_contact(condition, CARRIERS)
    for name in ("power", "normal", "noise", "resonance"):
        one, other = getattr(found, name), getattr(wanted, name)
        assert other.max() > 0.0
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-15 * other.max())
    # A tone beside its band's centre has next to nothing in the band beyond: digits of its place, not of its power.
    np.testing.assert_allclose(found.lines.power, wanted.lines.power, rtol=0, atol=1e-12 * wanted.lines.power.max())
    np.testing.assert_array_equal(found.lines.low, wanted.lines.low)


@needs_kernel
@given(st.integers(0, 10**6), st.integers(2, 40))
def test_accumulated_states_are_numpys(seed, count):
    rng, config = np.random.default_rng(seed), FieldConfig()
    at = np.unique(np.concatenate([[0, 3000], rng.integers(0, 3000, count)]))
    alpha = rng.uniform(0.0, 2.0, (len(at), config.carriers.count)).astype(np.float32)
    sampled = SampledEmission(at, alpha, rng.uniform(0, 4, (len(at), config.states)), 0.0)
    found_at, found = accumulate_samples(config, sampled, 3000)
    with without_kernel():
        wanted_at, wanted = accumulate_samples(config, sampled, 3000)
    np.testing.assert_array_equal(found_at, wanted_at)
    # Both are summed in double and rounded once.
    np.testing.assert_array_max_ulp(found, wanted, maxulp=1)


@needs_kernel
@pytest.mark.parametrize("tolerance", [None, 0.01])
def test_a_stroke_is_numpys_and_the_same_each_time(tolerance):
    field, stroke = load_field(), make_keyed_stroke(2.0)

    def signal() -> np.ndarray:
        clear_carrier_caches()
        return render_samples(prepare_stroke(field, stroke, seed=8, tolerance=tolerance))

    with without_kernel():
        wanted = signal()
    found = signal()
    assert found.tobytes() == signal().tobytes()
    assert found.tobytes() != wanted.tobytes()
    assert level_db(found, wanted) < -115.0
    clear_carrier_caches()


@needs_kernel
def test_every_build_says_the_same(monkeypatch):
    field, stroke, found = load_field(), make_keyed_stroke(1.0), []
    for path in libraries():
        one = loader._load_library(path)
        monkeypatch.setattr(loader, "_find_library", lambda one=one: (one, ""))
        clear_carrier_caches()
        found.append(render_samples(prepare_stroke(field, stroke, seed=8)))
    assert len(found) == 2
    assert level_db(*found) < -115.0
    clear_carrier_caches()


class Refuses:
    """A kernel that must not be called."""

    def __getattr__(self, name: str):
        return lambda *given: pytest.fail(f"{name} was called")


def test_what_it_would_misread_never_reaches_it():
    none, tables, share = Refuses(), carrier_rendering.build_hop_tables(CARRIERS), np.zeros(8, np.float32)
    place = np.full(8, 0.03)
    kept = get_arc_hop(CARRIERS, 1, 0, 0)

    def read(octaves=(0, 3), place=place, share=share, piece=lambda *_: kept):
        return ArcReader(tables, share).read(none, octaves, place, piece)

    for wrong, error in (
        ({"octaves": (8,)}, ValueError), ({"octaves": (-1,)}, ValueError), ({"share": share[1:]}, ValueError),
        ({"place": np.where(np.arange(8) == 3, np.inf, place)}, ValueError), ({"place": place * np.nan}, ValueError),
        ({"place": place - 1e14}, ValueError),
        ({"place": place.astype(np.float32)}, TypeError), ({"share": share.astype(float)}, TypeError),
        ({"piece": lambda *_: ArcHop.from_waves(np.ones((24, 9), np.complex64))}, ValueError),
    ):  # fmt: skip
        with pytest.raises(error):
            read(**wrong)
    for first, level in ((-1, np.ones(4)), (2, np.ones(4)), (6, np.ones(0))):
        with pytest.raises(ValueError, match="words"):
            compiled_bins(none, (1, 2, 3), 5, first, level)
    plan = make_wave_plan(np.array([3, 5, 9]), np.ones(64))
    given = plan.starts, plan.narrow, plan.slow, plan.turns, plan.window
    for count, size in ((5, 64), (6, 96), (6, 48)):
        with pytest.raises(ValueError, match="waves"):
            compiled_waves(none, np.ones(count, complex), *given, np.ones((2, size), np.float32))
    for starts, which in (
        (plan.starts, [0, 2]), (plan.starts, [-1, 0]),  # no such band
        (np.array([3, 10, 9]), plan.narrow),  # ends before it begins
        (np.array([3, 4, 9]), plan.narrow),  # wider than the tables of slow turns
    ):  # fmt: skip
        with pytest.raises(ValueError, match="waves"):
            compiled_waves(none, np.ones(6, complex), starts, np.array(which), *given[2:], np.ones((2, 64), np.float32))
    sealed = np.ones((2, 64), np.float32)
    sealed.setflags(write=False)
    with pytest.raises(TypeError, match="read-only"):
        compiled_waves(none, np.ones(6, complex), *given, sealed)
    values, one = np.ones((5, 3), np.float32), np.ones((2, 1))
    for row in ([[0], [4]], [[-1], [0]], [[0, 1], [0, 1]], [0, 1]):
        with pytest.raises(ValueError, match="rows"):
            blend_rows(none, values, np.array(row), one, one)
    numbers = (
        "per_octave", "concentration", "bump_mean", "least_left", "hand", "hand_damping", "least_across", "clear_peak",
        "least_offset_scale",
    )  # fmt: skip
    given = {
        "features": TOKEN_FEATURES, "kappa": np.ones(9), "share": np.ones(9), "wavelength": np.ones(3),
        "line_share": np.ones(3), "turn": np.ones((4, 4)), "below": np.ones(9, int), "nearest_end": np.full(3, 9),
        "shift": np.ones(4, int), **dict.fromkeys(numbers, 1.0),
    }  # fmt: skip
    tables, touch = ContactTables(**given), np.ones((2, len(CONTACT_COLUMNS)))
    for wrong in (
        {"below": np.full(9, 2)},
        {"nearest_end": np.full(3, 10)},
        {"shift": -np.ones(4, int)},
        {"share": one},
        {"line_share": np.ones(4)},
    ):
        with pytest.raises(ValueError, match="tables"):
            ContactTables(**given | wrong)
    for tokens, states in ((np.ones((2, 20)), touch), (np.ones((3, 21)), touch), (np.ones((2, 21)), touch[:, :8])):
        with pytest.raises(ValueError, match="contact"):
            compiled_contact(none, tables, tokens, states)


def test_a_hop_that_it_would_misread_never_reaches_it():
    tables, none = carrier_rendering.build_hop_tables(CARRIERS), Refuses()
    at, amplitude = np.array([0, 9000]), np.ones((2, CARRIERS.count), np.float32)
    place, waves = np.linspace(0.0, 0.05, HOP + 2 * REACH_SAMPLES), get_time_hop(CARRIERS, 1, 0)

    def asked(at=at, amplitude=amplitude, place=place, waves=waves, kernel=none, piece=None):
        return compiled_carriers.render_hops(
            kernel, tables, at, amplitude, 0, place, [waves], piece or (lambda octave, number: None)
        )

    for wrong, error in (
        ({"at": at.astype(np.int32)}, TypeError), ({"at": at[:1], "amplitude": amplitude[:1]}, ValueError),
        ({"amplitude": amplitude.astype(float)}, TypeError), ({"amplitude": amplitude[:, 1:]}, ValueError),
        ({"amplitude": np.ones((3, CARRIERS.count), np.float32)}, ValueError), ({"place": place[1:]}, ValueError),
        ({"place": np.where(place > 0.02, np.nan, place)}, ValueError), ({"place": place[::-1]}, TypeError),
        ({"place": place + 1e300}, ValueError), ({"place": np.where(place > 0.02, -np.inf, place)}, ValueError),
    ):  # fmt: skip
        with pytest.raises(error):
            asked(**wrong)
    compiled = load_kernel()
    if compiled is not None:
        with pytest.raises(ValueError, match="carriers in time"):
            asked(
                kernel=compiled,
                waves=TimeHop.from_waves(waves.waves[:2]),
                piece=lambda *_: get_arc_hop(CARRIERS, 1, 0, 0),
            )
        with pytest.raises(ValueError, match="piece"):
            asked(kernel=compiled, piece=lambda *_: ArcHop.from_waves(np.ones((24, 9), np.complex64)))
    with pytest.raises(ValueError, match="states"):
        compiled_carriers.interpolate_position(none, np.zeros(1), 50, 0, 10)
    given = {
        "margin": np.array([0, 6, 10]), "time_band": np.zeros(3, int), "time_bands": np.zeros(3, int),
        "cells_per_m": np.ones(8), "half_band": np.ones(12, np.float32), "cubic": np.ones((4, 4), np.float32),
        "hop": 64, "reach": 40, "time_first": 0, "arc_first": 0, "bands": 24, "piece_cells": 64, "rate": 1e4,
        "highest": 0.25, "band_end": 4800.0, "lowest": 50.0, "turns": 0.1,
    }  # fmt: skip
    CarrierTables(**given)
    for wrong in ({"margin": np.array([0, 6, 8])}, {"margin": np.array([0, 4, 10])}, {"reach": 39}, {"hop": 100},
                  {"time_bands": np.zeros(2, int)}, {"cubic": np.ones((4, 3), np.float32)}):  # fmt: skip
        with pytest.raises(ValueError, match="hop"):
            CarrierTables(**given | wrong)


@needs_kernel
@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(-2.0, 2.0), min_size=2, max_size=30), st.integers(-4000, 4000), st.integers(1, 700))
def test_where_the_hand_is_is_what_numpy_says(states, start, count):
    action = make_keyed_stroke(0.1).action
    action = type(action)(
        action.rate, np.tile([1.0, 0.0], (len(states), 1)), np.ones(len(states)), np.ones(len(states)),
        np.array(states), np.ones(len(states), bool),
    )  # fmt: skip
    found = extrapolate_position(action, start, count)
    with without_kernel():
        wanted = extrapolate_position(action, start, count)
    np.testing.assert_allclose(found, wanted, atol=1e-12)


@needs_kernel
def test_kernel_equals_numpy_for_large_position_jumps():
    """A kilometre within a sample, and a hop of jumps: numpy and the kernel read the same stretches."""
    rng, at = np.random.default_rng(3), np.arange(0, HOP + 200, 50)
    amplitude = rng.uniform(0.0, 1.0, (len(at), CARRIERS.count))
    for where in ([2000], [1, 2, 3, 2500], [*range(0, HOP, 7)], [*range(HOP)]):
        place = 0.1 * np.arange(HOP + 2 * REACH_SAMPLES) / 1e4
        for each in where:
            place[each + 1 :] += 1e3
        knots = Knots(at - 60, amplitude)
        found = render_carrier_hops(knots, CARRIERS, 5, place, range(1))
        with without_kernel():
            wanted = render_carrier_hops(knots, CARRIERS, 5, place, range(1))
        assert np.std(found - wanted) < 1e-6 * np.std(wanted)


def test_switched_off_numpy_does_the_work():
    code = (
        "from hnf_core.kernel.loader import load_kernel, why_unavailable; from data_tools.bench_strokes import "
        "make_keyed_stroke;"
        "from hnf_core.field.synthesis import synthesise; from hnf_core.field.weights import load_field;"
        "s = synthesise(load_field(), make_keyed_stroke(0.3), seed=1).signal.samples; print(load_kernel(), "
        "why_unavailable(), s.std() > 0)"
    )
    run = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"HNF_KERNEL": "off", "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert run.stdout.strip() == "None switched off by HNF_KERNEL True", run.stderr


def test_another_version_or_a_damaged_file_is_left_alone(monkeypatch, tmp_path):
    package = tmp_path / "hnf_kernel"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / f"hnf_kernel{loader.LIBRARY_SUFFIX}").write_text("not a library")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "hnf_kernel", raising=False)
    found, why = loader._find_library.__wrapped__()
    assert found is None
    assert "hnf_kernel" in why
    monkeypatch.undo()
    sys.modules.pop("hnf_kernel", None)
    if load_kernel() is not None:
        monkeypatch.setattr(loader, "ABI", 10**6)
        found, why = loader._find_library.__wrapped__()
        assert found is None
        assert "build and install it anew" in why
