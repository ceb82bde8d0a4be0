"""The contrastive core of the alignment: published form of the encoders, InfoNCE, and gradients in little memory."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

torch = pytest.importorskip("torch", reason="alignment trains with torch")

from hnf_core.errors import WeightsError
from hnf_lab.alignment.encoders import RESNET50, Architecture, ResNetEncoder, load_backbone
from hnf_lab.alignment.train import (
    TEMPERATURE,
    Loss,
    backward_with_gradient_cache,
    compute_info_nce,
    freeze_running_statistics,
)

PUBLISHED = Path(__file__).with_name("resnet50_names.txt")
"""Names and shapes of torchvision's resnet50 (0.28.0), in its order, as its own code lists them."""
TINY = Architecture((1, 1, 1, 1), 4, 8)


def unit(rng: np.random.Generator, n: int, d: int = 16) -> torch.Tensor:
    rows = rng.standard_normal((n, d))
    return torch.tensor(rows / np.linalg.norm(rows, axis=1, keepdims=True))


def plain_info_nce(vision: np.ndarray, touch: np.ndarray, temperature: float) -> float:
    """By the softmax as it is written, in float64."""
    likeness = np.exp(vision @ touch.T / temperature)
    right = np.diag(likeness)
    return float(-0.5 * np.mean(np.log(right / likeness.sum(axis=0)) + np.log(right / likeness.sum(axis=1))))


def test_names_and_shapes_are_the_published_ones() -> None:
    with torch.device("meta"):
        ours = ResNetEncoder(Architecture(outputs=1000)).state_dict()
    listed = [line.split() for line in PUBLISHED.read_text(encoding="utf-8").splitlines()]
    assert [[name, "x".join(map(str, value.shape)) or "scalar"] for name, value in ours.items()] == listed
    parameters = {name: value for name, value in ours.items() if "running" not in name and "batches" not in name}
    assert sum(value.numel() for value in parameters.values()) == 25_557_032  # torchvision's own figure
    assert Architecture((3, 4, 6, 3), 64, 128) == RESNET50


def test_embeddings_have_length_one() -> None:
    torch.manual_seed(0)
    out = ResNetEncoder(TINY)(torch.randn(5, 3, 32, 32))
    assert out.shape == (5, 8)
    assert torch.allclose(out.norm(dim=1), torch.ones(5), atol=1e-6)


def test_a_trunk_is_taken_whole_or_not_at_all() -> None:
    torch.manual_seed(1)
    given_weights = ResNetEncoder(Architecture((1, 1, 1, 1), 4, 1000)).state_dict()
    encoder = ResNetEncoder(TINY)
    before = encoder.fc.weight.clone()
    load_backbone(encoder, given_weights, "file")
    assert torch.equal(encoder.layer3[0].conv2.weight, given_weights["layer3.0.conv2.weight"])
    assert torch.equal(encoder.fc.weight, before)
    name = "layer1.0.bn2.running_var"
    missing = {key: value for key, value in given_weights.items() if key != name}
    for bad in (
        missing,
        {**given_weights, "layer9.weight": before},
        {**given_weights, name: given_weights[name][:2]},
        {**given_weights, name: given_weights[name] * torch.nan},
    ):
        with pytest.raises(WeightsError, match="file: these are no weights of a ResNet-50"):
            load_backbone(encoder, bad, "file")


@settings(max_examples=40, deadline=None)
@given(st.integers(2, 40), st.floats(0.05, 2.0), st.integers(0, 2**31))
def test_it_is_the_softmax_formula(n: int, temperature: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    vision, touch = unit(rng, n), unit(rng, n)
    plain = plain_info_nce(vision.numpy(), touch.numpy(), temperature)
    assert float(compute_info_nce(vision, touch, temperature)) == pytest.approx(plain, rel=1e-10, abs=1e-12)


@settings(max_examples=20, deadline=None)
@given(st.integers(2, 30), st.integers(0, 2**31))
def test_order_and_sides_do_not_matter(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    vision, touch = unit(rng, n), unit(rng, n)
    order = torch.tensor(rng.permutation(n))
    loss = float(compute_info_nce(vision, touch))
    assert float(compute_info_nce(vision[order], touch[order])) == pytest.approx(loss, rel=1e-12)
    assert float(compute_info_nce(touch, vision)) == pytest.approx(loss, rel=1e-12)


def test_info_nce_is_minimal_on_a_regular_simplex() -> None:
    """Up to d + 1 points are farthest apart as a regular simplex: every other cosine −1 / (n − 1)."""
    n = 9
    corners = np.eye(n) - 1.0 / n
    corners /= np.linalg.norm(corners, axis=1, keepdims=True)
    best = torch.tensor(corners, requires_grad=True)
    least = compute_info_nce(best, best)
    assert least.item() == pytest.approx(np.log1p((n - 1) * np.exp(-(1.0 + 1.0 / (n - 1)) / TEMPERATURE)), rel=1e-9)
    (slope,) = torch.autograd.grad(least, best)
    along_sphere = slope - (slope * best.detach()).sum(dim=1, keepdim=True) * best.detach()
    assert float(along_sphere.abs().max()) < 1e-9
    for seed in range(20):
        rng = np.random.default_rng(seed)
        moved = best.detach() + 0.1 * torch.tensor(rng.standard_normal(best.shape))
        moved = torch.nn.functional.normalize(moved, dim=1)
        assert float(compute_info_nce(best.detach(), moved)) > least.item()


def test_float32_holds_for_thousands_of_rows() -> None:
    """Aligned rows, where the loss is a rest of 1e-3 beside logits of 14, and opposed ones, where it is 28."""
    rng = np.random.default_rng(0)
    vision = unit(rng, 3000, 128)
    for touch in (vision, -vision, torch.nn.functional.normalize(vision + 0.05 * unit(rng, 3000, 128), dim=1)):
        exact = plain_info_nce(vision.numpy(), touch.numpy(), TEMPERATURE)
        wide = compute_info_nce(vision, touch)
        narrow = compute_info_nce(vision.float().requires_grad_(), touch.float())
        assert float(wide) == pytest.approx(exact, rel=1e-9)
        assert narrow.item() == pytest.approx(exact, rel=1e-4, abs=2e-6)
    constant = torch.ones(2000, 4) / 2.0
    assert float(compute_info_nce(constant, constant)) == pytest.approx(np.log(2000), rel=1e-6)


def test_autocast_does_not_narrow_it() -> None:
    rng = np.random.default_rng(2)
    vision, touch = unit(rng, 64).float(), unit(rng, 64).float()
    with torch.autocast("cpu", torch.bfloat16):
        inside = compute_info_nce(vision, touch)
    assert inside.dtype == torch.float32
    assert float(inside) == float(compute_info_nce(vision, touch))


class Grouped(torch.nn.Module):
    """A small convolutional encoder whose normalisation does not look at the batch."""

    def __init__(self) -> None:
        super().__init__()
        self.net = torch.nn.Sequential(
            torch.nn.Conv2d(3, 8, 3),
            torch.nn.GroupNorm(2, 8),
            torch.nn.ReLU(),
            torch.nn.Flatten(),
            torch.nn.Linear(288, 6),
        )

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return torch.nn.functional.normalize(self.net(x), dim=1)


def gradients(encoders: list[torch.nn.Module]) -> list[torch.Tensor]:
    found = [each.grad.clone() for encoder in encoders for each in encoder.parameters() if each.grad is not None]
    for encoder in encoders:
        encoder.zero_grad()
    return found


def assert_equal_gradients(one: list[torch.Tensor], other: list[torch.Tensor], relative: float) -> None:
    assert len(one) == len(other) > 0
    size = max(float(each.abs().max()) for each in one)
    assert size > 0
    for left, right in zip(one, other, strict=True):
        assert float((left - right).abs().max()) <= relative * size


def backward_reference(
    encoders: Sequence[torch.nn.Module], inputs: Sequence[torch.Tensor], loss: Loss, chunk: int
) -> torch.Tensor:
    """Compute what backward_with_gradient_cache does, the plain way: one graph over all chunks."""
    value = loss(
        *(
            torch.cat([encoder(part) for part in torch.split(batch, chunk)])
            for encoder, batch in zip(encoders, inputs, strict=True)
        )
    )
    value.backward()
    return value.detach()


def inputs_of(n: int, side: int, dtype: torch.dtype) -> list[torch.Tensor]:
    generator = torch.Generator().manual_seed(n)
    return [torch.randn(n, 3, side, side, generator=generator, dtype=dtype) for _ in range(2)]


@pytest.mark.parametrize("chunk", [1, 3, 4, 11, 64])
def test_cached_gradients_are_those_of_the_plain_batch(chunk: int) -> None:
    torch.manual_seed(3)
    encoders: list[torch.nn.Module] = [Grouped().double(), Grouped().double()]
    inputs = inputs_of(11, 8, torch.float64)
    plain = backward_reference(encoders, inputs, compute_info_nce, 11)
    expected = gradients(encoders)
    cached = backward_with_gradient_cache(encoders, inputs, compute_info_nce, chunk)
    assert float(cached) == pytest.approx(float(plain), rel=1e-12)
    assert_equal_gradients(expected, gradients(encoders), 1e-6)


def test_a_resnet_with_frozen_statistics_likewise() -> None:
    torch.manual_seed(4)
    encoders: list[torch.nn.Module] = [ResNetEncoder(TINY).double().eval(), ResNetEncoder(TINY).double().eval()]
    inputs = inputs_of(12, 32, torch.float64)
    backward_reference(encoders, inputs, compute_info_nce, 12)
    expected = gradients(encoders)
    backward_with_gradient_cache(encoders, inputs, compute_info_nce, 5)
    assert_equal_gradients(expected, gradients(encoders), 1e-6)


def test_batch_normalisation_knows_its_chunk_in_both_passes() -> None:
    """Chunks of four: as a plain batch embedded four by four; another thing than a batch embedded at once."""
    torch.manual_seed(5)
    encoders = [ResNetEncoder(TINY).double(), ResNetEncoder(TINY).double()]
    for encoder in encoders:
        for module in encoder.modules():  # blocks must not be their identity, or little would be tested
            if isinstance(module, torch.nn.BatchNorm2d):
                torch.nn.init.uniform_(module.weight, 0.5, 1.5)
    start = [{name: value.clone() for name, value in each.state_dict().items()} for each in encoders]
    inputs = inputs_of(12, 48, torch.float64)
    results = {}
    for way, chunk in ((backward_reference, 4), (backward_with_gradient_cache, 4), (backward_reference, 12)):
        for encoder, state in zip(encoders, start, strict=True):
            encoder.load_state_dict(state)
        way(encoders, inputs, compute_info_nce, chunk)
        statistics = [each.clone() for encoder in encoders for each in encoder.buffers()]
        results[way, chunk] = gradients(list(encoders)), statistics
    ghost, cached, whole = results.values()
    assert_equal_gradients(ghost[0], cached[0], 1e-6)
    assert all(torch.allclose(left, right, atol=1e-12) for left, right in zip(ghost[1], cached[1], strict=True))
    assert next(int(each) for each in cached[1] if each.ndim == 0) == 3
    with pytest.raises(AssertionError):
        assert_equal_gradients(ghost[0], whole[0], 1e-2)


def test_still_statistics_end_even_after_an_error() -> None:
    encoder = ResNetEncoder(TINY)
    frozen = encoder.layer1[0].bn1.eval()
    with pytest.raises(RuntimeError, match="channels"), freeze_running_statistics(encoder):
        encoder(torch.randn(3, 3, 32, 32)) + encoder(torch.randn(3, 4, 32, 32))
    assert int(encoder.bn1.num_batches_tracked) == 0
    assert encoder.bn1.track_running_stats
    assert frozen.track_running_stats
    encoder(torch.randn(3, 3, 32, 32))
    assert int(encoder.bn1.num_batches_tracked) == 1
