"""The contact filter: close to the exact response, equal in C and numpy, and independent for each state."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.field.carriers import MODEL_RATE_HZ
from hnf_core.field.contact.contact_filter import (
    LEAD_SAMPLES,
    TAIL_SAMPLES,
    build_filter_bank,
    compute_impulse_response,
)
from hnf_core.field.stroke import SAMPLES_PER_STATE, evaluate_bspline
from hnf_core.kernel.compiled_carriers import StateResponses
from hnf_core.kernel.loader import load_kernel, why_unavailable, without_kernel
from hnf_core.material.contact_model import force_response
from hnf_core.material.library import get_material, load_library
from hnf_core.material.probe import PROBE_NAMES, get_probe

MATERIALS = tuple(get_material(name).mechanics for name in ("leather", "brass"))
needs_kernel = pytest.mark.skipif(load_kernel() is None, reason=f"no compiled kernel here: {why_unavailable()}")


@needs_kernel
@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.tuples(st.floats(0.0, 8.0), st.integers(1, 120)), min_size=1, max_size=5),
    st.integers(-3000, 12000), st.integers(2, 6000), st.sampled_from(sorted(PROBE_NAMES)), st.integers(0, 99),
)  # fmt: skip
def test_the_kernel_presses_as_numpy_does(steps, start, count, probe, seed):
    """Forces that last and change, two materials, any stretch of samples, also beyond the ends."""
    force = np.concatenate([np.full(lasts, newtons) for newtons, lasts in steps])
    material = np.random.default_rng(seed).integers(0, 2, len(force)).astype(np.int32)
    bank = build_filter_bank(MATERIALS, material, force, probe)
    found = bank.render_force(force, start, count)
    with without_kernel():
        wanted = bank.render_force(force, start, count)
    assert found.shape == (count,)
    np.testing.assert_allclose(found, wanted, atol=1e-10)
    middle = count // 2
    parts = [bank.render_force(force, start, middle), bank.render_force(force, start + middle, count - middle)]
    np.testing.assert_array_equal(np.concatenate(parts), found)


def test_constant_force_is_exactly_silent_after_the_transient():
    """Exactly nothing, not little: silence is told from sound by it."""
    time = np.arange(400) / 200.0
    force = np.where(time < 0.5, 0.0, 2.0)
    out = build_filter_bank(MATERIALS[:1], np.zeros(400, np.int32), force, "pen").render_force(force, 0, 399 * 50)
    assert np.abs(out).max() > 0.1
    assert not out[int(0.9 * MODEL_RATE_HZ) :].any()
    assert not out[: int(0.4 * MODEL_RATE_HZ)].any()


def test_a_response_that_is_cut_short_is_the_exact_one():
    """Against the response to the whole force at once, without an end: all of the library, both probes. A hand presses
    and lets go 1.1 times a second and once lands on it."""
    time = np.arange(400) / 200.0
    force = np.abs(1.5 * np.sin(7.0 * time)) + 2.0 * (time > 0.6)
    size, margin = 1 << 16, LEAD_SAMPLES + TAIL_SAMPLES
    pressed = evaluate_bspline(force, np.arange(-margin, 400 * SAMPLES_PER_STATE + margin) / SAMPLES_PER_STATE)
    frequency = np.fft.rfftfreq(size, 1.0 / MODEL_RATE_HZ)
    taper = 0.5 + 0.5 * np.cos(np.pi * np.clip((frequency - 4000.0) / 800.0, 0.0, 1.0))
    spectrum = np.fft.rfft(pressed - pressed.mean(), size) * taper
    inside, errors = slice(2 * margin, margin + 19_000), []
    for material in load_library():
        for probe in map(get_probe, PROBE_NAMES):
            response = compute_impulse_response(force_response, material.mechanics, probe, 1.0)
            exact = np.fft.irfft(spectrum * force_response(frequency, material.mechanics, probe, 1.0), size)
            found = np.convolve(pressed, response)[LEAD_SAMPLES:]
            errors.append(20.0 * np.log10(np.std((found - exact[: len(found)])[inside]) / np.std(exact[inside])))
    assert max(errors) < -75.0
    assert np.median(errors) < -90.0


def test_a_response_passes_nothing_on_that_is_steady():
    for probe in map(get_probe, PROBE_NAMES):
        response = compute_impulse_response(force_response, MATERIALS[0], probe, 1.0)
        for steady in (
            np.ones(LEAD_SAMPLES + TAIL_SAMPLES),
            np.arange(LEAD_SAMPLES + TAIL_SAMPLES) / (LEAD_SAMPLES + TAIL_SAMPLES),
        ):
            assert abs(response @ steady) < 1e-12 * np.abs(response).sum()


def test_what_it_would_misread_never_reaches_the_kernel():
    class Refuses:
        def __getattr__(self, name: str):
            return lambda *_: pytest.fail(f"{name} was called")

    table, weight = np.ones((10, 50)), np.ones((5, 1))
    for tables, ahead in (([table, np.ones((10, 49))], 8), ([np.ones((10, 65))], 8), ([table], 10), ([], 8)):
        with pytest.raises(ValueError, match="given to states"):
            StateResponses(tables, ahead)
    for force, weights, error in (
        (np.ones(4), weight, ValueError), (np.ones(5), np.ones((5, 2)), ValueError),
        (np.ones(0), np.ones((0, 1)), ValueError), (np.ones(5, np.float32), weight, TypeError),
        (np.ones(10)[::2], weight, TypeError),
    ):  # fmt: skip
        with pytest.raises(error):
            StateResponses([table], 8).compute_force_response(Refuses(), force, weights, 0, 5)
