"""ResNet-50 with the state-dict names that the published weights have, and an embedding on the unit sphere.

The network of He et al. (2016) in the form that torchvision publishes (the stride in the 3×3 convolution), so that its
files load here and ours there; only the last layer, `fc`, has as many outputs as the shared space has dimensions. It
stands here because the package torchvision as published does not import beside a torch that was built without CUDA.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from ...errors import WeightsError
from ..state_dict import format_save_command

BOTTLENECK_EXPANSION = 4
"""A block's outputs per unit of its width."""


@dataclass(frozen=True)
class Architecture:
    """blocks: in each of the four stages. width: of the first stage, doubled by each later one. outputs: dimensions of
    the shared space."""

    blocks: tuple[int, int, int, int] = (3, 4, 6, 3)
    width: int = 64
    outputs: int = 128


RESNET50 = Architecture()


class Bottleneck(nn.Module):
    """1×1 → 3×3 → 1×1 beside the identity, or beside a 1×1 convolution where the shape changes."""

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
        beside = x if self.downsample is None else self.downsample(x)
        y = torch.relu(self.bn1(self.conv1(x)))
        y = torch.relu(self.bn2(self.conv2(y)))
        return torch.relu(self.bn3(self.conv3(y)) + beside)


class ResNetEncoder(nn.Module):
    """Pictures (n, 3, H, W) → embeddings (n, outputs) of length 1, float32 at least."""

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
        """(n, 32 width): the last stage, averaged over the picture."""
        x = torch.relu(self.bn1(self.conv1(x)))
        x = functional.max_pool2d(x, 3, stride=2, padding=1)
        return self.layer4(self.layer3(self.layer2(self.layer1(x)))).mean(dim=(2, 3))  # type: ignore[no-any-return]

    def forward(self, x: Tensor) -> Tensor:
        point = self.fc(self.pool_features(x))
        return functional.normalize(point.to(torch.promote_types(point.dtype, torch.float32)), dim=1)


def load_backbone(encoder: ResNetEncoder, published: Mapping[str, Tensor], where: str) -> None:
    """Take all weights but `fc` from a state dict with the standard names, as of ImageNet.

    Raises WeightsError where one is missing, left over, of another shape, or not finite.
    """
    own = encoder.state_dict()
    trunk = {name: value for name, value in own.items() if not name.startswith("fc.")}
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
    encoder.load_state_dict({**own, **{name: given[name].to(value.dtype) for name, value in trunk.items()}})


def _is_compatible(given: Tensor, expected: Tensor) -> bool:
    return given.shape == expected.shape and bool(given.isfinite().all())


def _make_stage(inputs: int, width: int, blocks: int, stride: int) -> nn.Sequential:
    first = Bottleneck(inputs, width, stride)
    return nn.Sequential(first, *(Bottleneck(BOTTLENECK_EXPANSION * width, width, 1) for _ in range(blocks - 1)))


def _initialise(encoder: ResNetEncoder) -> None:
    """Convolutions as He et al. (2015); every block starts as its identity (Goyal et al. 2017, 5.1)."""
    for module in encoder.modules():
        if isinstance(module, nn.Conv2d):
            nn.init.kaiming_normal_(module.weight, mode="fan_out", nonlinearity="relu")
        if isinstance(module, Bottleneck):
            nn.init.zeros_(module.bn3.weight)
