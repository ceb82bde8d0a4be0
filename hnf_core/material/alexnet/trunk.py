"""AlexNet's convolutional trunk in numpy, with the names and shapes of torchvision.models.alexnet.

Krizhevsky, "One weird trick for parallelizing convolutional neural networks" (2014): the one-column network that
torchvision ships. Its last max-pooling (features.12) is left out: positions are averaged instead.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

Single = NDArray[np.float32]


@dataclass(frozen=True)
class Convolution:
    """name: in torchvision's state dict. pool: whether ReLU is followed by 3 × 3 max-pooling of stride 2."""

    name: str
    inputs: int
    outputs: int
    kernel: int
    stride: int
    padding: int
    pool: bool


BACKBONE_LAYERS = (
    Convolution("features.0", 3, 64, 11, 4, 2, True),
    Convolution("features.3", 64, 192, 5, 1, 2, True),
    Convolution("features.6", 192, 384, 3, 1, 1, False),
    Convolution("features.8", 384, 256, 3, 1, 1, False),
    Convolution("features.10", 256, 256, 3, 1, 1, False),
)
BACKBONE_FEATURES = BACKBONE_LAYERS[-1].outputs
POOL_SIZE, POOL_STRIDE = 3, 2


def get_backbone_shapes() -> dict[str, tuple[int, ...]]:
    """Shape of every tensor of the trunk, by torchvision's name."""
    shapes: dict[str, tuple[int, ...]] = {}
    for layer in BACKBONE_LAYERS:
        shapes[f"{layer.name}.weight"] = (layer.outputs, layer.inputs, layer.kernel, layer.kernel)
        shapes[f"{layer.name}.bias"] = (layer.outputs,)
    return shapes


def compute_backbone_features(images: Single, weights: Mapping[str, Single]) -> Single:
    """(n, FEATURES): the last convolution's rectified outputs for (n, H, W, 3) pictures, averaged over positions."""
    x = images
    for layer in BACKBONE_LAYERS:
        x = convolve(x, weights[f"{layer.name}.weight"], weights[f"{layer.name}.bias"], layer.stride, layer.padding)
        np.maximum(x, 0.0, out=x)
        if layer.pool:
            x = max_pool(x)
    return np.asarray(x.mean(axis=(1, 2)))


def convolve(x: Single, weight: Single, bias: Single, stride: int, padding: int) -> Single:
    """(n, H, W, inputs) → (n, H', W', outputs), as torch.nn.functional.conv2d with weight (outputs, inputs, k, k).

    Windows become rows of one matrix, and the convolution one product (im2col; Chellapilla et al. 2006).
    """
    outputs, inputs, kernel, _ = weight.shape
    padded = np.pad(x, ((0, 0), (padding, padding), (padding, padding), (0, 0)))
    windows = sliding_window_view(padded, (kernel, kernel), axis=(1, 2))[  # type: ignore[call-overload]
        :, ::stride, ::stride
    ]
    count, rows, columns = windows.shape[:3]
    # (n, H', W', inputs, k, k): the order of the weight's own axes, so that it is not copied.
    matrix = windows.reshape(count * rows * columns, inputs * kernel * kernel)
    product = matrix @ weight.reshape(outputs, -1).T
    product += bias
    return np.asarray(product.reshape(count, rows, columns, outputs))


def max_pool(x: Single) -> Single:
    """(n, H, W, C) → 3 × 3 maxima, two pixels apart, as torch.nn.functional.max_pool2d(x, 3, 2)."""
    rows, columns = ((side - POOL_SIZE) // POOL_STRIDE + 1 for side in x.shape[1:3])
    shifted = [
        x[:, i : i + POOL_STRIDE * rows : POOL_STRIDE, j : j + POOL_STRIDE * columns : POOL_STRIDE]
        for i in range(POOL_SIZE)
        for j in range(POOL_SIZE)
    ]
    out = shifted[0].copy()
    for part in shifted[1:]:
        np.maximum(out, part, out=out)
    return np.asarray(out)
