"""Layers of F_Θ by the compiled kernel equal those of numpy, and each state's bytes do not depend on its batch."""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core import threads as both_cores
from hnf_core.field.field import run_network
from hnf_core.field.weights import load_field
from hnf_core.kernel.compiled_field import STATES_PER_CALL, Layers
from hnf_core.kernel.loader import LIBRARY_SUFFIX, _load_library, load_kernel, why_unavailable

pytestmark = pytest.mark.skipif(load_kernel() is None, reason=f"no compiled kernel here: {why_unavailable()}")


def builds():
    """Those that this processor runs: the plain one, and the one with wide vectors."""
    import hnf_kernel

    folder = Path(hnf_kernel.__file__).parent
    plain = _load_library(folder / f"hnf_kernel{LIBRARY_SUFFIX}")
    wide = folder / f"hnf_kernel_wide{LIBRARY_SUFFIX}"
    return [plain, _load_library(wide)] if plain.hnf_has_wide_vectors() and wide.is_file() else [plain]


def network(rng, inputs, hidden, layers, outputs, densities):
    """The layers, and the same as parameters for numpy."""
    sizes = [*((hidden, hidden if index else inputs) for index in range(layers))]
    last = sizes[-1][0] if sizes else inputs
    sizes += [(outputs, last), (densities, last)]
    names = [*(f"layer{index}" for index in range(layers)), "alpha", "sigma"]
    weights = [(rng.standard_normal(size) * np.sqrt(2.0 / size[1])).astype(np.float32) for size in sizes]
    biases = [0.1 * rng.standard_normal(size[0]).astype(np.float32) for size in sizes]
    told = {f"{name}.weight": weight for name, weight in zip(names, weights, strict=True)}
    told |= {f"{name}.bias": bias for name, bias in zip(names, biases, strict=True)}
    return Layers(weights, biases), told


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 10**6), st.integers(1, 140), st.integers(1, 90), st.integers(0, 4), st.integers(1, 70),
    st.integers(1, 9), st.integers(0, 40),
)  # fmt: skip
def test_they_answer_what_numpy_does(seed, inputs, hidden, layers, outputs, densities, states):
    rng = np.random.default_rng(seed)
    compiled, parameters = network(rng, inputs, hidden, layers, outputs, densities)
    x = rng.standard_normal((states, inputs)).astype(np.float32)
    wanted = run_network(parameters, layers, x)
    for library in builds():
        for found, exact in zip(compiled.evaluate(library, x), wanted, strict=True):
            assert found.dtype == np.float32
            assert found.shape == exact.shape
            np.testing.assert_allclose(found, exact, rtol=1e-4, atol=2e-5 * np.abs(exact).max(initial=1.0))


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 90), st.integers(1, 2 * STATES_PER_CALL + 30), st.data())
def test_a_state_gives_the_same_bytes_in_any_batch(seed, hidden, states, data):
    rng = np.random.default_rng(seed)
    compiled, _ = network(rng, 37, hidden, 3, 41, 5)
    x = rng.standard_normal((states, 37)).astype(np.float32)
    few = data.draw(st.integers(1, states))
    chosen = rng.permutation(states)[:few]
    for library in builds():
        whole, part = compiled.evaluate(library, x), compiled.evaluate(library, np.ascontiguousarray(x[chosen]))
        for all_of_them, some in zip(whole, part, strict=True):
            assert some.tobytes() == all_of_them[chosen].tobytes()


def test_the_shipped_field_gives_equal_bytes_on_any_core_count(monkeypatch):
    layers = load_field().layers
    x = np.random.default_rng(1).standard_normal((500, layers.inputs)).astype(np.float32)
    said = []
    for cores in (1, 2, 3, 7):
        monkeypatch.setattr(both_cores, "available_cpus", lambda cores=cores: cores)
        said.append(b"".join(each.tobytes() for each in layers.evaluate(load_kernel(), x)))
    assert len(set(said)) == 1


def test_what_is_no_number_is_answered_with_none():
    """It goes through a layer: a limit does not make it a zero. And it stays with its own state."""
    compiled, _ = network(np.random.default_rng(2), 9, 50, 2, 33, 5)
    x = np.ones((8, 9), np.float32)
    x[3, 4] = np.nan
    for library in builds():
        for each in compiled.evaluate(library, x):
            assert np.isnan(each[3]).all()
            assert np.isfinite(np.delete(each, 3, axis=0)).all()


def test_a_copy_of_a_field_has_layers_of_its_own():
    field = load_field()
    x = np.ones((3, field.layers.inputs), np.float32)
    wanted = field.layers.evaluate(load_kernel(), x)[0].tobytes()
    other = copy.deepcopy(field)
    assert other.layers.panels[0] is not field.layers.panels[0]
    del field
    assert other.layers.evaluate(load_kernel(), x)[0].tobytes() == wanted
