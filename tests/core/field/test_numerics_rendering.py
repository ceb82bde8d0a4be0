"""Temporal rendering against mpmath,
over all that each number type holds. The figures: tools/hnf_lab/experiments/numerics.py."""

import numpy as np
import pytest

pytest.importorskip("mpmath", reason="the exact weights need mpmath (test extra)")
torch = pytest.importorskip("torch", reason="the twin needs torch (train extra)")

from hnf_core.field.render_weights import render_weights
from hnf_core.training.model import render_weights as twin
from hnf_lab.experiments.numerics import (
    TORCH_TYPES,
    compute_exact_gradient,
    compute_exact_weights,
    find_worst_error,
    make_density_cases,
    measure_emission_errors,
    measure_gradient_errors,
    measure_weight_errors,
)

SHORT = (1, 5, 64)
HALF_AN_ULP = 0.51
"""In units of ε, the spacing at 1: what rounding the exact result costs, and a hundredth for the accumulation."""
IN_FLOAT64 = 1e-12
"""float64 has nothing wider: the transmittance exp(−S) carries the rounding of S, up to 708, ⌈log2 N⌉ times."""
NARROW = [dtype for dtype in TORCH_TYPES if dtype != torch.float64]


@pytest.mark.parametrize("dtype", NARROW, ids=str)
def test_weights_and_gradients_are_the_exact_ones_rounded_once(dtype):
    bound = HALF_AN_ULP * torch.finfo(dtype).eps
    assert measure_weight_errors(dtype, "torch", SHORT).relative <= bound
    assert measure_gradient_errors(dtype, SHORT).relative <= bound
    if dtype != torch.bfloat16:  # numpy has none
        assert measure_weight_errors(dtype, "numpy", SHORT).relative <= bound
        assert measure_emission_errors(dtype, SHORT).relative <= bound


def test_weights_and_gradients_in_float64():
    for worst in (
        measure_weight_errors(torch.float64, "numpy", SHORT),
        measure_weight_errors(torch.float64, "torch", SHORT),
        measure_gradient_errors(torch.float64, SHORT),
        measure_emission_errors(torch.float64, SHORT),
    ):
        assert worst.relative <= IN_FLOAT64, worst
    # Absolutely, no weight is off by more than one last digit of 1.
    assert measure_weight_errors(torch.float64, "numpy", SHORT).absolute <= np.finfo(np.float64).eps


def test_four_thousand_states_cost_no_digits():
    """Equal densities are the running sum's worst case: there it was off by 1.5e-12 in float64, 8e-4 in float32."""
    sigma_dt = make_density_cases(4096, 1.0, 1e-30)["equal"]
    exact = compute_exact_weights(sigma_dt.tolist())
    for found in (render_weights(sigma_dt), twin(torch.tensor(sigma_dt)).numpy()):
        assert find_worst_error(found, exact, 1e-300, "equal").relative < 1e-14
    single = sigma_dt.astype(np.float32)
    exact = compute_exact_weights(single.tolist())
    for found in (render_weights(single), twin(torch.tensor(single)).numpy()):
        assert find_worst_error(found, exact, 1e-30, "equal").relative <= HALF_AN_ULP * np.finfo(np.float32).eps


def test_gradients_far_behind_a_dense_state_keep_their_digits():
    """expm1(−x) + 1, expm1's own gradient, has none of exp(−x) left at x = 30 in float32."""
    given = torch.tensor([0.0, 30.0, 2.0], dtype=torch.float32, requires_grad=True)
    twin(given)[1].backward()
    exact, _ = compute_exact_gradient([0.0, 30.0, 2.0], [0.0, 1.0, 0.0])
    assert given.grad[1] == pytest.approx(float(exact[1]), rel=1e-6)
    assert 0.0 < given.grad[1] < 1e-12


def test_gradients_are_the_derivatives_first_and_second():
    rng = np.random.default_rng(2)
    for values in (rng.exponential(1.0, (3, 5)), rng.exponential(20.0, (2, 4)), np.zeros((1, 6)), np.full((1, 3), 0.5)):
        given = torch.tensor(values, requires_grad=True)
        assert torch.autograd.gradcheck(twin, (given,))
        assert torch.autograd.gradgradcheck(twin, (given,))


@pytest.mark.parametrize("dtype", TORCH_TYPES, ids=str)
def test_no_density_gives_a_gradient_that_is_not_finite(dtype):
    limits = torch.finfo(dtype)
    least = limits.tiny * limits.eps
    values = [0.0, least, limits.tiny, 1e-3, 1.0, 30.0, limits.max, float("inf")]
    for order in (values, values[::-1], [float("inf")] * 8, [limits.max] * 8):
        given = torch.tensor(order, dtype=dtype, requires_grad=True)
        twin(given).sum().backward()
        assert torch.isfinite(given.grad).all()
        # Σ w = 1 − exp(−Σ σΔt) never falls where a density grows.
        assert (given.grad >= -float(limits.eps)).all()
