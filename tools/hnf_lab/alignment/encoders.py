"""The encoders, and the embedding of tuples: small heads on texture statistics, and ResNet-50.

`StatisticsEncoder` is a head of `hnf_core.material.shared_space`, to be trained. `ResNetEncoder` is that of He et al.
(2016) in the form published by torchvision (stride in the 3×3 convolution), so weight files are interchangeable; only
the last layer, `fc`, has as many outputs as the embedding space has dimensions. It is implemented here because the
published torchvision package does not import with a torch built without CUDA; its embedding of a view is the mean of
those of the four corner crops.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from hnf_core.errors import WeightsError
from hnf_core.material.shared_space import (
    EMBEDDING_SIZE,
    LARGEST_STATISTIC,
    LAYERS,
    LOOK_FLOOR,
    STATISTICS_COUNT,
    TOUCH_FLOOR,
    Head,
    compute_texture_statistics,
)

from ..encoder.network import format_save_command
from .inputs import Tuples

BOTTLENECK_EXPANSION = 4
"""Outputs of a block per unit of its width."""


@dataclass(frozen=True)
class Architecture:
    """Size of a ResNet.

    Attributes
    ----------
    blocks
        Number of blocks in each of the four stages.
    width
        Width of the first stage; each later stage doubles it.
    outputs
        Dimensions of the embedding space.
    """

    blocks: tuple[int, int, int, int] = (3, 4, 6, 3)
    width: int = 64
    outputs: int = 128


RESNET50 = Architecture()


class Bottleneck(nn.Module):
    """Residual block 1×1 → 3×3 → 1×1.

    The skip connection is the identity, or a 1×1 convolution if the shape changes.
    """

    def __init__(self, inputs: int, width: int, stride: int) -> None:
        super().__init__()
        outputs = BOTTLENECK_EXPANSION * width
        self.conv1 = nn.Conv2d(inputs, width, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(width)
        self.conv2 = nn.Conv2d(width, width, 3, stride=stride, padding=1, bias=False)
        self.bn2 = nn.BatchNorm2d(width)
        self.conv3 = nn.Conv2d(width, outputs, 1, bias=False)
        self.bn3 = nn.BatchNorm2d(outputs)
        self.downsample = (
            nn.Sequential(nn.Conv2d(inputs, outputs, 1, stride=stride, bias=False), nn.BatchNorm2d(outputs))
            if stride != 1 or inputs != outputs
            else None
        )

    def forward(self, x: Tensor) -> Tensor:
        skip = x if self.downsample is None else self.downsample(x)
        y = torch.relu(self.bn1(self.conv1(x)))
        y = torch.relu(self.bn2(self.conv2(y)))
        return torch.relu(self.bn3(self.conv3(y)) + skip)


class ResNetEncoder(nn.Module):
    """Images (n, 3, H, W) → embeddings (n, outputs) of unit length, float32 at least."""

    def __init__(self, architecture: Architecture = RESNET50) -> None:
        super().__init__()
        width = architecture.width
        self.conv1 = nn.Conv2d(3, width, 7, stride=2, padding=3, bias=False)
        self.bn1 = nn.BatchNorm2d(width)
        self.layer1 = _make_stage(width, width, architecture.blocks[0], 1)
        self.layer2 = _make_stage(BOTTLENECK_EXPANSION * width, 2 * width, architecture.blocks[1], 2)
        self.layer3 = _make_stage(2 * BOTTLENECK_EXPANSION * width, 4 * width, architecture.blocks[2], 2)
        self.layer4 = _make_stage(4 * BOTTLENECK_EXPANSION * width, 8 * width, architecture.blocks[3], 2)
        self.fc = nn.Linear(8 * BOTTLENECK_EXPANSION * width, architecture.outputs)
        _initialise(self)

    def pool_features(self, x: Tensor) -> Tensor:
        """Return the (n, 32 width) features of the last stage, averaged over the image."""
        x = torch.relu(self.bn1(self.conv1(x)))
        x = functional.max_pool2d(x, 3, stride=2, padding=1)
        return self.layer4(self.layer3(self.layer2(self.layer1(x)))).mean(dim=(2, 3))  # type: ignore[no-any-return]

    def forward(self, x: Tensor) -> Tensor:
        return self.project(self.pool_features(x))

    def project(self, features: Tensor) -> Tensor:
        """Return the (n, outputs) unit vectors of pooled features."""
        point = self.fc(features)
        unit: Tensor = functional.normalize(point.to(torch.promote_types(point.dtype, torch.float32)), dim=1)
        return unit


@dataclass(frozen=True)
class HeadArchitecture:
    """Size of a head on texture statistics.

    Attributes
    ----------
    hidden
        Units of both hidden layers.
    dropout
        Share of the hidden units that are dropped in training, and half as many of the statistics.
    looks
        Number of times that each tuple is varied; its statistics are kept in memory.
    """

    hidden: int = 256
    dropout: float = 0.2
    looks: int = 4
    outputs: int = EMBEDDING_SIZE


class StatisticsEncoder(nn.Module):
    """Texture statistics (n, STATISTICS_COUNT) → embeddings (n, outputs) of unit length."""

    mean: Tensor
    scale: Tensor

    def __init__(self, architecture: HeadArchitecture) -> None:
        super().__init__()
        hidden = architecture.hidden
        self.register_buffer("mean", torch.zeros(STATISTICS_COUNT))
        self.register_buffer("scale", torch.ones(STATISTICS_COUNT))
        self.lin0, self.bn0 = nn.Linear(STATISTICS_COUNT, hidden), nn.BatchNorm1d(hidden)
        self.lin1, self.bn1 = nn.Linear(hidden, hidden), nn.BatchNorm1d(hidden)
        self.fc = nn.Linear(hidden, architecture.outputs)
        self.piece = nn.Linear(hidden, architecture.outputs)
        self.drop_inputs = nn.Dropout(0.5 * architecture.dropout)
        self.drop = nn.Dropout(architecture.dropout)

    def standardise(self, statistics: Tensor) -> None:
        """Set the mean and scale of the inputs to those of `statistics`."""
        self.mean.copy_(statistics.mean(dim=0))
        self.scale.copy_(statistics.std(dim=0) + 1e-4)

    def pool_features(self, statistics: Tensor) -> Tensor:
        """Return the (n, hidden) features before the last layer."""
        x = ((statistics - self.mean) / self.scale).clamp(-LARGEST_STATISTIC, LARGEST_STATISTIC)
        x = self.drop(torch.relu(self.bn0(self.lin0(self.drop_inputs(x)))))
        features: Tensor = self.drop(torch.relu(self.bn1(self.lin1(x))))
        return features

    def project(self, features: Tensor) -> Tensor:
        """Return the (n, outputs) unit vectors of features."""
        return functional.normalize(self.fc(features), dim=1)

    def project_piece(self, features: Tensor) -> Tensor:
        """Return unit vectors (n, outputs) that are alike for views of one piece; only training uses them."""
        return functional.normalize(self.piece(features), dim=1)

    def forward(self, statistics: Tensor) -> Tensor:
        return self.project(self.pool_features(statistics))

    def export(self) -> Head:
        """Return the head in numpy, batch normalisation folded into its layers."""
        tensors = {"mean": self.mean, "scale": self.scale}
        for layer, linear, norm in zip(
            LAYERS, (self.lin0, self.lin1, self.fc), (self.bn0, self.bn1, None), strict=True
        ):
            weight, bias = linear.weight.detach(), linear.bias.detach()
            if norm is not None and norm.running_mean is not None and norm.running_var is not None:
                gain = norm.weight.detach() / torch.sqrt(norm.running_var + norm.eps)
                weight, bias = weight * gain[:, None], (bias - norm.running_mean) * gain + norm.bias.detach()
            tensors |= {f"{layer}.weight": weight, f"{layer}.bias": bias}
        return Head({name: np.array(value, dtype=np.float32) for name, value in tensors.items()})


Encoder = ResNetEncoder | StatisticsEncoder


def make_encoder(architecture: Architecture | HeadArchitecture) -> Encoder:
    """Make an untrained encoder."""
    if isinstance(architecture, HeadArchitecture):
        return StatisticsEncoder(architecture)
    return ResNetEncoder(architecture).to(memory_format=torch.channels_last)  # type: ignore[call-overload, no-any-return]


def load_backbone(encoder: ResNetEncoder, published: Mapping[str, Tensor], where: str) -> None:
    """Load all weights except `fc` from a state dict with the standard names, such as ImageNet weights.

    Raises
    ------
    WeightsError
        If a weight is missing, unknown, of another shape, or not finite.
    """
    state = encoder.state_dict()
    trunk = {name: value for name, value in state.items() if not name.startswith("fc.")}
    given = {name: value for name, value in published.items() if not name.startswith("fc.")}
    wrong = sorted(trunk.keys() ^ given.keys()) or [
        name for name, value in trunk.items() if not _is_compatible(given[name], value)
    ]
    if wrong:
        raise WeightsError(
            f"these are no weights of a ResNet-50: {wrong[0]} is missing, unknown, misshapen or not finite"
            f" ({len(wrong)} such).",
            where=where,
            remedy=format_save_command("resnet50"),
        )
    encoder.load_state_dict({**state, **{name: given[name].to(value.dtype) for name, value in trunk.items()}})


def _is_compatible(given: Tensor, expected: Tensor) -> bool:
    return given.shape == expected.shape and bool(given.isfinite().all())


def _make_stage(inputs: int, width: int, blocks: int, stride: int) -> nn.Sequential:
    first = Bottleneck(inputs, width, stride)
    return nn.Sequential(first, *(Bottleneck(BOTTLENECK_EXPANSION * width, width, 1) for _ in range(blocks - 1)))


def _initialise(encoder: ResNetEncoder) -> None:
    """Initialise convolutions as He et al. (2015); every block starts as the identity (Goyal et al. 2017, 5.1)."""
    for module in encoder.modules():
        if isinstance(module, nn.Conv2d):
            nn.init.kaiming_normal_(module.weight, mode="fan_out", nonlinearity="relu")
        if isinstance(module, Bottleneck):
            nn.init.zeros_(module.bn3.weight)


Float32 = NDArray[np.float32]
Rows = NDArray[np.int64]

COLOUR_MEAN, COLOUR_SCALE = 0.45, 0.5
IMAGE_FLOOR = 0.03
"""Contrast of an image's texture below which it enters linearly; colours differ ten times as much."""
IMAGE_SCALE = 1.5
TOUCH_SCALE = 1.5
MAX_LOG_GAIN = 0.2
"""Images are made darker or brighter by up to exp(± this)."""


@dataclass(frozen=True)
class Batch:
    """Inputs of both encoders: (k, 3, pixels, pixels) float32 with channels last in memory, or texture statistics.

    Row i of both belongs to the same tuple.
    """

    vision: Tensor
    touch: Tensor


def make_training_batch(tuples: Tuples, chosen: Rows, pixels: int, rng: np.random.Generator) -> Batch:
    """Make a batch with augmentation.

    Each tuple is rotated or mirrored and cropped at a random position, the same for both inputs; the image's brightness
    and the sensor's lamps vary.
    """
    image, touch = _vary(tuples, chosen, rng)
    corner = rng.integers(image.shape[1] - pixels + 1, size=(len(chosen), 2))
    return Batch(
        make_image_tensor(_crop(image, corner, pixels)),
        make_touch_tensor(_crop(touch, corner, pixels), tuples.images.floor),
    )


def compute_varied_statistics(tuples: Tuples, seed: int, look: int) -> Batch:
    """Compute the statistics of all tuples, each varied as in `make_training_batch`, whole views.

    look: number of the variation.
    """
    vision, touch = [], []
    for start in range(0, len(tuples), VIEWS_PER_BATCH):
        chosen = np.arange(start, min(start + VIEWS_PER_BATCH, len(tuples)))
        image, contact = _vary(tuples, chosen, np.random.default_rng([seed, 2, look, start]))
        vision.append(torch.from_numpy(compute_texture_statistics(image, LOOK_FLOOR)))
        touch.append(torch.from_numpy(compute_texture_statistics(contact, TOUCH_FLOOR)))
    return Batch(torch.cat(vision), torch.cat(touch))


def _vary(tuples: Tuples, chosen: Rows, rng: np.random.Generator) -> tuple[Float32, Float32]:
    """Return images and touches (k, P, P, 3), turned alike, of other brightness and other lamps."""
    rows, count = tuples.row[chosen], len(chosen)
    turn = rng.integers(tuples.images.turns, size=count)
    image = tuples.images.rgb(rows, turn).astype(np.float32) / np.float32(255.0)
    image *= np.exp(rng.uniform(-MAX_LOG_GAIN, MAX_LOG_GAIN, (count, 1, 1, 1))).astype(np.float32)
    return image, tuples.images.touch(rows, tuples.sensor[chosen], turn, rng)


def make_image_tensor(images: Float32) -> Tensor:
    """Convert (k, P, P, 3) square root of linear colour, 0–1, to (k, 3, P, P).

    Each image's mean colour is scaled; its texture is added, compressed logarithmically where it is strong.
    """
    colour = images.mean(axis=(1, 2), keepdims=True)
    texture = np.arcsinh((images - colour) / IMAGE_FLOOR) / IMAGE_SCALE
    return _to_tensor((colour - COLOUR_MEAN) / COLOUR_SCALE + texture)


def make_touch_tensor(touches: Float32, floor: float) -> Tensor:
    """Convert (k, P, P, 3) linear touch images without background to (k, 3, P, P)."""
    return _to_tensor(np.arcsinh(touches / floor) / TOUCH_SCALE)


def _crop(images: Float32, corner: Rows, pixels: int) -> Float32:
    return np.stack(
        [image[top : top + pixels, left : left + pixels] for image, (top, left) in zip(images, corner, strict=True)]
    )


def _to_tensor(images: Float32) -> Tensor:
    """Convert (k, H, W, 3) in memory to (k, 3, H, W) with channels last."""
    return torch.from_numpy(np.ascontiguousarray(images, dtype=np.float32)).permute(0, 3, 1, 2)


VIEWS_PER_BATCH = 128
"""Number of views embedded at once."""


class Embedding(NamedTuple):
    """Unit vectors (n, d) of n views, and the features (n, f) before the last layer, which probes read."""

    points: Float32
    features: Float32


def embed_images(encoder: Encoder, tuples: Tuples, pixels: int) -> Embedding:
    """Embed the images, without augmentation."""

    def load_images(rows: slice) -> Float32:
        upright = np.zeros(len(tuples.row[rows]), dtype=np.int64)
        return tuples.images.rgb(tuples.row[rows], upright).astype(np.float32) / np.float32(255.0)

    return _embed(encoder, len(tuples), pixels, load_images, make_image_tensor, LOOK_FLOOR)


def embed_touches(encoder: Encoder, tuples: Tuples, pixels: int, seed: int) -> Embedding:
    """Embed the touches, each with its own variation of the sensor."""

    def load_touches(rows: slice) -> Float32:
        upright = np.zeros(len(tuples.row[rows]), dtype=np.int64)
        rng = np.random.default_rng([seed, rows.start])
        return tuples.images.touch(tuples.row[rows], tuples.sensor[rows], upright, rng)

    tensor = partial(make_touch_tensor, floor=tuples.images.floor)
    return _embed(encoder, len(tuples), pixels, load_touches, tensor, TOUCH_FLOOR)


def _embed(
    encoder: Encoder,
    count: int,
    pixels: int,
    load_images: Callable[[slice], Float32],
    tensor: Callable[[Float32], Tensor],
    floor: float,
) -> Embedding:
    if not count:
        width = encoder.fc.in_features, encoder.fc.out_features
        return Embedding(np.zeros((0, width[1]), dtype=np.float32), np.zeros((0, width[0]), dtype=np.float32))
    was_training, points, features = encoder.training, [], []
    encoder.eval()
    is_network = isinstance(encoder, ResNetEncoder)
    with torch.inference_mode(), torch.autocast("cpu", torch.bfloat16, enabled=is_network):
        for first in range(0, count, VIEWS_PER_BATCH):
            views = load_images(slice(first, min(first + VIEWS_PER_BATCH, count)))
            inputs = (
                [tensor(corner) for corner in crop_corners(views, pixels)]
                if is_network
                else [torch.from_numpy(compute_texture_statistics(views, floor))]
            )
            pooled = [encoder.pool_features(each) for each in inputs]
            point = torch.stack([encoder.project(each) for each in pooled]).mean(dim=0)
            points.append(functional.normalize(point, dim=1).numpy())
            features.append(torch.stack(pooled).mean(dim=0).float().numpy())
    encoder.train(was_training)
    return Embedding(np.concatenate(points), np.concatenate(features))


def crop_corners(images: Float32, pixels: int) -> list[Float32]:
    """Return the four corner crops of images (k, P, P, 3), or the images themselves if they are no larger."""
    spare = images.shape[1] - pixels
    starts = (0, spare) if spare else (0,)
    return [images[:, top : top + pixels, left : left + pixels] for top in starts for left in starts]
