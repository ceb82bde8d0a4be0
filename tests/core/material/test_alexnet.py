"""AlexNet's trunk in numpy and what is fed to it: as defined, as torch has it, as it is trained."""

import numpy as np
import pytest
from alexnet_parts import HIDDEN, random_tensors, trunk_names
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.material.alexnet_encoder import (
    CONDITION_COUNT,
    IMAGENET_DEVIATION,
    IMAGENET_MEAN,
    AlexNet,
    AlexNetConfig,
    build_view_conditions,
    compute_backbone_features,
    convolve,
    cubic_resize_matrix,
    forward,
    get_backbone_shapes,
    max_pool,
    normalise_view,
)
from hnf_core.tactile.optics import SENSORS, shade
from hnf_core.tactile.views import PITCHES_M


def plain_convolution(x: np.ndarray, weight: np.ndarray, bias: np.ndarray, stride: int, padding: int) -> np.ndarray:
    """The definition, one output pixel at a time."""
    kernel = weight.shape[2]
    padded = np.pad(x, ((0, 0), (padding, padding), (padding, padding), (0, 0))).astype(np.float64)
    rows, columns = ((side - kernel) // stride + 1 for side in padded.shape[1:3])
    out = np.zeros((len(x), rows, columns, len(weight)))
    for i in range(rows):
        for j in range(columns):
            window = padded[:, i * stride : i * stride + kernel, j * stride : j * stride + kernel]
            out[:, i, j] = np.einsum("nhwc,ochw->no", window, weight) + bias
    return out


@settings(max_examples=25, deadline=None)
@given(
    st.integers(0, 2**16), st.integers(1, 3), st.sampled_from([1, 3, 5]), st.integers(1, 4), st.integers(0, 2),
    st.integers(6, 11), st.integers(6, 11),
)  # fmt: skip
def test_the_fast_convolution_is_the_definition(seed, count, kernel, stride, padding, rows, columns):
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((count, rows, columns, 2)).astype(np.float32)
    weight = rng.standard_normal((3, 2, kernel, kernel)).astype(np.float32)
    bias = rng.standard_normal(3).astype(np.float32)
    got = convolve(x, weight, bias, stride, padding)
    np.testing.assert_allclose(got, plain_convolution(x, weight, bias, stride, padding), atol=2e-5)


@given(st.integers(0, 2**16), st.integers(3, 12), st.integers(3, 12))
def test_pooling_takes_the_largest_of_nine(seed, rows, columns):
    x = np.random.default_rng(seed).standard_normal((2, rows, columns, 3)).astype(np.float32)
    got = max_pool(x)
    assert got.shape == (2, (rows - 3) // 2 + 1, (columns - 3) // 2 + 1, 3)
    for i in range(got.shape[1]):
        for j in range(got.shape[2]):
            assert np.array_equal(got[:, i, j], x[:, 2 * i : 2 * i + 3, 2 * j : 2 * j + 3].max(axis=(1, 2)))


def test_the_trunk_is_alexnets():
    """2.47 million parameters under torchvision's names."""
    shapes = get_backbone_shapes()
    assert list(shapes) == trunk_names()
    assert shapes["features.0.weight"] == (64, 3, 11, 11)
    assert shapes["features.10.weight"] == (256, 256, 3, 3)
    assert sum(int(np.prod(shape)) for shape in shapes.values()) == 2_469_696


def test_the_smallest_picture_is_the_smallest():
    tensors = random_tensors(AlexNetConfig(hidden=HIDDEN))
    side = 31
    picture = np.zeros((1, side, side, 3), dtype=np.float32)
    assert np.isfinite(compute_backbone_features(picture, tensors)).all()
    with pytest.raises(ValueError, match="window"):
        compute_backbone_features(picture[:, 1:, 1:], tensors)


@pytest.mark.parametrize("pixels", [96, 128])
def test_enlarging_keeps_planes_and_means_by_cubic_convolution(pixels):
    matrix = cubic_resize_matrix(64, pixels)
    np.testing.assert_allclose(matrix.sum(axis=1), 1.0, atol=1e-6)
    ramp = np.arange(64) + 0.5
    inner = slice(4, -4)
    np.testing.assert_allclose((matrix @ ramp)[inner], ((np.arange(pixels) + 0.5) * 64 / pixels)[inner], atol=1e-4)


@pytest.mark.parametrize("pixels", [64, 96])
@pytest.mark.parametrize("imagenet", [False, True])
def test_numpy_and_torch_agree(pixels, imagenet):
    torch = pytest.importorskip("torch", reason="the twin is for training")
    from hnf_lab.encoder.network import to_torch

    design = (
        AlexNetConfig(pixels, HIDDEN, IMAGENET_MEAN, IMAGENET_DEVIATION) if imagenet else AlexNetConfig(pixels, HIDDEN)
    )
    network = AlexNet(design, random_tensors(design, 3), {})
    rng = np.random.default_rng(0)
    views = rng.standard_normal((3, 64, 64, 3)).astype(np.float32)
    told = rng.standard_normal((3, CONDITION_COUNT)).astype(np.float32)
    twin = to_torch(network)
    with torch.no_grad():
        expected = twin(torch.tensor(views).permute(0, 3, 1, 2), torch.tensor(told))
        expected = expected * twin.output_spread + twin.output_mean
    np.testing.assert_allclose(forward(network, views, told), expected.numpy(), atol=2e-5)
    assert np.ptp(expected.numpy(), axis=0).max() > 1e-3, "the views must not all look alike"
    back = twin.to_numpy({})
    assert all(np.array_equal(back.tensors[name], value) for name, value in network.tensors.items())


def test_training_and_run_time_prepare_a_view_alike():
    torch = pytest.importorskip("torch", reason="the twin is for training")
    from hnf_lab.encoder.train import normalise_views, shade_views

    rng = np.random.default_rng(1)
    slopes = 0.3 * rng.standard_normal((2, 2, 64, 64)).astype(np.float32)
    for sensor in SENSORS.values():
        shading, ambient = torch.tensor(sensor.shading).float(), torch.tensor(sensor.ambient).float()
        images = shade_views(
            torch.tensor(slopes), torch.full((2,), sensor.max_slope), shading.expand(2, 3, 3), ambient.expand(2, 3)
        )
        np.testing.assert_allclose(images[0].permute(1, 2, 0), shade(slopes[0, 0], slopes[0, 1], sensor), atol=1e-5)
        views, contrast = normalise_views(images, torch.tensor(sensor.background).float().expand(2, 3))
        view, own = normalise_view(shade(slopes[0, 0], slopes[0, 1], sensor), sensor)
        assert float(contrast[0]) == pytest.approx(own, rel=1e-5)
        np.testing.assert_allclose(views[0].permute(1, 2, 0), view, atol=1e-4)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**16), st.floats(-0.3, 0.3), st.floats(-0.3, 0.3))
def test_a_view_has_contrast_one_and_neither_mean_nor_tilt(seed, tilt_x, tilt_y):
    gx, gy = 0.05 * np.random.default_rng(seed).standard_normal((2, 64, 64))
    ramp = np.linspace(-1, 1, 64)
    view, contrast = normalise_view(
        shade(gx + tilt_x * ramp, gy + tilt_y * ramp[:, None], SENSORS["digit"]), SENSORS["digit"]
    )
    assert float(np.sqrt(np.mean(np.square(view)))) == pytest.approx(1.0, abs=1e-4)
    assert contrast > 0.0
    for weight in (np.ones((64, 64)), ramp[None, :] * np.ones((64, 1)), ramp[:, None] * np.ones((1, 64))):
        np.testing.assert_allclose(np.mean(view * weight[..., None], axis=(0, 1)), 0.0, atol=1e-5)


def test_sensors_and_pitches_tell_the_head_apart():
    told = {build_view_conditions(0.1, sensor, pitch).tobytes() for sensor in SENSORS.values() for pitch in PITCHES_M}
    assert len(told) == 8
