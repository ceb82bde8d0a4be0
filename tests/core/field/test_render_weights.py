"""Laws of temporal rendering."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hnf_core.field.render_weights import render, render_weights
from reference.render_weights_reference import render_weights_reference

densities = arrays(
    np.float64,
    st.tuples(st.integers(1, 4), st.integers(1, 7)),
    elements=st.one_of(st.floats(0.0, 1e-12), st.floats(0.0, 5.0), st.floats(0.0, 1e4)),
)


@given(densities)
def test_weights_equal_the_published_formula(sigma_dt):
    np.testing.assert_allclose(render_weights(sigma_dt), render_weights_reference(sigma_dt), rtol=1e-9, atol=1e-15)


@given(densities)
def test_weights_are_a_share_of_what_is_absorbed(sigma_dt):
    weights = render_weights(sigma_dt)
    assert np.all((weights >= 0.0) & (weights <= 1.0))
    np.testing.assert_allclose(weights.sum(axis=-1), -np.expm1(-sigma_dt.sum(axis=-1)), rtol=1e-12, atol=0.0)


@given(st.floats(1e-300, 1e-9), st.integers(1, 6))
def test_small_densities_keep_their_digits(density, states):
    """1 − exp(−x) would be 0 or coarse here; the limit σ → 0 is w = σΔt."""
    weights = render_weights(np.full(states, density))
    np.testing.assert_allclose(weights, density, rtol=1e-7)


def test_a_density_without_states_is_refused_in_words():
    with pytest.raises(ValueError, match="no states"):
        render_weights(0.5)


def test_infinite_density_hides_everything_behind_it():
    np.testing.assert_array_equal(render_weights([0.0, np.inf, 3.0]), [0.0, 1.0, 0.0])


@given(st.floats(0.0, 50.0))
def test_one_state_is_plain_absorption(density):
    assert render_weights([density])[0] == pytest.approx(-np.expm1(-density), rel=1e-14)


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
def test_every_float_type_stays_finite_and_keeps_its_type(dtype):
    limits = np.finfo(dtype)
    sigma_dt = np.array([[0.0, limits.tiny, 1.0, float(limits.max), 0.5], [0.1, 0.2, 0.3, 0.4, 0.5]], dtype=dtype)
    weights = render_weights(sigma_dt)
    assert weights.dtype == dtype
    assert np.isfinite(weights).all()
    np.testing.assert_allclose(
        weights.astype(float), render_weights_reference(sigma_dt.astype(float)), atol=4.0 * float(limits.eps)
    )


def test_half_precision_is_summed_in_single():
    """In float16 the transmittance of 400 states of 0.004 would stall; in float32 it does not."""
    sigma_dt = np.full(400, 0.004, dtype=np.float16)
    exact = render_weights_reference(sigma_dt.astype(float))
    np.testing.assert_allclose(render_weights(sigma_dt).astype(float), exact, rtol=2e-3)


@given(densities, st.integers(1, 4))
def test_rendering_bands_is_rendering_each(sigma_dt, bands):
    emission = np.random.default_rng(0).standard_normal((*sigma_dt.shape, bands))
    together = render(sigma_dt, emission)
    apart = np.stack([render(sigma_dt, emission[..., k]) for k in range(bands)], axis=-1)
    np.testing.assert_allclose(together, apart, atol=1e-12)


def test_torch_twin_equals_numpy_and_has_finite_gradients():
    torch = pytest.importorskip("torch")
    from hnf_core.training.model import render_weights as twin

    sigma_dt = np.concatenate([np.zeros((1, 5)), np.full((1, 5), 1e4), np.random.default_rng(1).exponential(1, (6, 5))])
    tensor = torch.tensor(sigma_dt, requires_grad=True)
    np.testing.assert_allclose(twin(tensor).detach().numpy(), render_weights(sigma_dt), atol=1e-14)
    twin(tensor).square().sum().backward()
    assert torch.isfinite(tensor.grad).all()
    inner = torch.tensor(sigma_dt[2:], requires_grad=True)
    assert torch.autograd.gradcheck(twin, (inner,))


FLOATS = (np.float16, np.float32, np.float64)


@given(st.data(), st.sampled_from(FLOATS), st.integers(1, 9), st.integers(1, 3))
def test_no_emission_is_too_large(data, dtype, states, bands):
    """Σ w ≤ 1, so â lies between 0 and the outermost α: also where α is the greatest number of the type."""
    width = np.finfo(dtype).bits
    density = st.floats(0.0, allow_nan=False, allow_infinity=True, width=width)
    sigma_dt = data.draw(arrays(dtype, (2, states), elements=density | st.floats(0.0, 1.0, width=width)))
    limit = float(np.finfo(dtype).max)
    value = st.floats(allow_nan=False, allow_infinity=False, width=width) | st.sampled_from([limit, -limit])
    alpha = data.draw(arrays(dtype, (2, states, bands), elements=value))
    result = render(sigma_dt, alpha)
    assert result.dtype == dtype
    assert result.shape == (2, bands)
    assert np.isfinite(result).all()
    assert np.all((result >= np.minimum(alpha.min(axis=1), 0)) & (result <= np.maximum(alpha.max(axis=1), 0)))
    np.testing.assert_array_equal(render(sigma_dt, alpha[..., 0]).shape, (2,))


@pytest.mark.parametrize("dtype", FLOATS)
def test_a_dense_neighbourhood_gives_the_greatest_number_back(dtype):
    """Rounded weights sum to a little over 1 in many places; the largest number must not become infinite there."""
    limit = np.finfo(dtype).max
    for states in range(1, 200, 7):
        sigma_dt = np.full(states, 40.0 / states, dtype)
        assert render(sigma_dt, np.full(states, limit, dtype)) >= 0.99 * float(limit)
        np.testing.assert_array_equal(
            render(sigma_dt, np.full((states, 2), -limit, dtype)) <= -0.99 * float(limit), True
        )


def test_half_precision_is_rendered_in_single():
    """400 emissions of weight 0.0025 each: in float16 the sum would stall at a quarter of a digit."""
    sigma_dt = np.full(400, 0.004, dtype=np.float16)
    alpha = np.linspace(1.0, 2.0, 400).astype(np.float16)
    exact = float(render_weights_reference(sigma_dt.astype(float)) @ alpha.astype(float))
    assert float(render(sigma_dt, alpha)) == pytest.approx(exact, rel=5e-4)
