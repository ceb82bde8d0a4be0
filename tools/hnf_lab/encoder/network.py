"""A network that the user has, as a file: torchvision's names and tensors as .safetensors, read as data alone.

A trunk that the user has: torchvision's AlexNet as a .safetensors file.

The torch twin of hnf_core.material.alexnet: the same tensors, names and arithmetic, with gradients.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from hnf_core.errors import WeightsError
from hnf_core.material.alexnet_encoder import (
    BACKBONE_FEATURES,
    BACKBONE_LAYERS,
    CONDITION_COUNT,
    INPUT_DEVIATION,
    INPUT_MEAN,
    OUTPUT_COUNT,
    POOL_SIZE,
    POOL_STRIDE,
    AlexNet,
    AlexNetConfig,
    cubic_resize_matrix,
    get_backbone_shapes,
)
from hnf_core.safetensors_io import read_weights_bytes
from hnf_core.tactile.views import VIEW_PIXELS

SUFFIX = ".safetensors"


def read_state_dict(path: Path, network: str) -> tuple[dict[str, Tensor], str]:
    """The tensors by name, as they were saved, and the file's SHA-256 in hex.

    network: its name in torchvision.models, for messages. torch's own files (.pth, .pt) are pickles, programs that run
    when they are read: they are refused unread, with the command that converts one. Raises FileError where there is no
    file, WeightsError where it is not a safetensors file.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load

    remedy = format_save_command(network)
    if path.is_file() and path.suffix != SUFFIX:
        found = path.suffix or "no suffix"
        raise WeightsError(
            f"not a file of weights that can be read as data alone ({found}, not {SUFFIX}).",
            where=str(path),
            remedy=remedy,
        )
    data = read_weights_bytes(path, "the trunk", remedy)
    try:
        return load(data), hashlib.sha256(data).hexdigest()
    except (SafetensorError, ValueError, KeyError, TypeError, RuntimeError) as error:
        raise WeightsError(f"damaged or not a file of weights ({error}).", where=str(path), remedy=remedy) from error


def format_save_command(network: str) -> str:
    """What to run for a file that read_state_dict reads, in words and as one line for a shell."""
    return (
        f"Save the state dict of torchvision's {network} with your own Python: "
        f'python -c "import torchvision, safetensors.torch as s; '
        f"s.save_file(torchvision.models.{network}(weights='DEFAULT').state_dict(), '{network}{SUFFIX}')\""
    )


BACKBONE_NAME = "alexnet"
_REMEDY = format_save_command(BACKBONE_NAME)


def load_backbone(path: Path) -> tuple[dict[str, Tensor], str]:
    """Float32 tensors features.0.weight … features.10.bias, and the file's SHA-256 in hex.

    classifier.* is ignored. Raises FileError where there is no file, WeightsError where it is not a safetensors file,
    or names, shapes or numbers are not AlexNet's.
    """
    state, digest = read_state_dict(path, BACKBONE_NAME)
    wanted = get_backbone_shapes()
    missing = sorted(set(wanted) - set(state))
    strange = sorted(name for name in set(state) - set(wanted) if not name.startswith("classifier."))
    if missing or strange:
        raise WeightsError(
            f"not the trunk of AlexNet: missing {missing[:3]}, unknown {strange[:3]}.", where=str(path), remedy=_REMEDY
        )
    out = {}
    for name, shape in wanted.items():
        found = tuple(state[name].shape)
        if found != shape:
            raise WeightsError(f"{name} is {found}, AlexNet's is {shape}.", where=str(path), remedy=_REMEDY)
        if not state[name].is_floating_point():
            raise WeightsError(f"{name} is {state[name].dtype}, not real.", where=str(path), remedy=_REMEDY)
        out[name] = state[name].to(torch.float32)
        if not torch.isfinite(out[name]).all():
            raise WeightsError(f"{name} is not finite.", where=str(path), remedy=_REMEDY)
    return out, digest


Single = NDArray[np.float32]


class TorchAlexNet(nn.Module):
    """forward: views (n, 3, 64, 64) of contrast 1 and conditions (n, CONDITIONS) → (n, OUTPUTS) in units of spread.

    State dict: torchvision's names for the trunk (features.0.weight …), head.0 and head.2; output.mean and
    output.spread belong to it as buffers.
    """

    def __init__(self, design: AlexNetConfig) -> None:
        super().__init__()
        self.design = design
        self.features = nn.Sequential(*_make_backbone())
        self.head = nn.Sequential(
            nn.Linear(BACKBONE_FEATURES + CONDITION_COUNT, design.hidden),
            nn.ReLU(),
            nn.Linear(design.hidden, OUTPUT_COUNT),
        )
        self.output = nn.Module()
        self.output.register_buffer("mean", torch.zeros(OUTPUT_COUNT))
        self.output.register_buffer("spread", torch.ones(OUTPUT_COUNT))
        self.mean = torch.tensor(design.mean)[:, None, None]
        self.deviation = torch.tensor(design.deviation)[:, None, None]
        self.matrix = (
            torch.tensor(cubic_resize_matrix(VIEW_PIXELS, design.pixels)) if design.pixels != VIEW_PIXELS else None
        )

    @property
    def output_mean(self) -> Tensor:
        """(OUTPUTS,) of the training targets."""
        return self.get_buffer("output.mean")

    @property
    def output_spread(self) -> Tensor:
        """(OUTPUTS,) standard deviation of the training targets: the unit of forward's result."""
        return self.get_buffer("output.spread")

    def pool_features(self, views: Tensor) -> Tensor:
        """(n, FEATURES) trunk features averaged over positions."""
        found: Tensor = self.features(self.prepare_images(views))
        return found.float().mean(dim=(2, 3))

    def prepare_images(self, views: Tensor) -> Tensor:
        """What the trunk sees: views as pictures, in the units it was trained on, enlarged."""
        picture = (INPUT_MEAN + INPUT_DEVIATION * views - self.mean) / self.deviation
        if self.matrix is not None:
            picture = self.matrix @ picture @ self.matrix.T
        return picture.contiguous(memory_format=torch.channels_last)

    def forward(self, views: Tensor, conditions: Tensor) -> Tensor:
        """In units of each output's spread about its mean."""
        found: Tensor = self.head(torch.cat([self.pool_features(views), conditions], dim=1))
        return found.float()

    def initialise(self, seed: int) -> None:
        """He et al. (2015): rectified layers that keep their input's variance; the last layer starts at nothing."""
        generator = torch.Generator().manual_seed(seed)
        for module in self.modules():
            if isinstance(module, nn.Conv2d | nn.Linear):
                fan_in = module.weight[0].numel()
                with torch.no_grad():
                    module.weight.normal_(0.0, (2.0 / fan_in) ** 0.5, generator=generator)
                    if module.bias is not None:
                        module.bias.zero_()
        last = self.head[2]
        assert isinstance(last, nn.Linear)
        with torch.no_grad():
            last.weight.mul_(0.1)

    @torch.no_grad()
    def standardise_layers(self, views: Tensor, conditions: Tensor) -> None:
        """Scale every trainable layer but the last so that on these views each of its units has mean 0 and deviation 1
        before the rectifier (Krähenbühl et al. 2016): a plain deep network of no normalisation starts to learn at once.
        """
        x = self.prepare_images(views)
        for module in self.features:
            if isinstance(module, nn.Conv2d) and module.weight.requires_grad:
                _standardise_layer(module, module(x).transpose(0, 1).flatten(1).T)
            x = module(x)
        first = self.head[0]
        assert isinstance(first, nn.Linear)
        joined = torch.cat([x.mean(dim=(2, 3)), conditions], dim=1)
        # Averages over positions hardly differ between views: each is brought to order 1, as the conditions are.
        mean, spread = joined.mean(dim=0), joined.std(dim=0).clamp(min=1e-3)
        first.weight.div_(spread)
        first.bias.sub_(first.weight @ mean)
        _standardise_layer(first, first(joined))

    def to_numpy(self, metadata: Mapping[str, str]) -> AlexNet:
        """The run-time network with these tensors."""
        state = {name: value.detach().float().numpy().copy() for name, value in self.state_dict().items()}
        return AlexNet(self.design, {name: state[name] for name in self.design.shapes()}, dict(metadata))


def to_torch(network: AlexNet) -> TorchAlexNet:
    """The torch network with a run-time network's tensors."""
    twin = TorchAlexNet(network.config)
    twin.load_state_dict({name: torch.tensor(np.asarray(value)) for name, value in network.tensors.items()})
    return twin


def _standardise_layer(layer: nn.Conv2d | nn.Linear, found: Tensor) -> None:
    """found: (n, units) of what the layer gives now."""
    spread = found.std(dim=0).clamp(min=1e-3)
    assert layer.bias is not None
    layer.weight.div_(spread.reshape(-1, *[1] * (layer.weight.dim() - 1)))
    layer.bias.sub_(found.mean(dim=0)).div_(spread)


def _make_backbone() -> list[nn.Module]:
    """In torchvision's order, so that its names come out: ReLU after every convolution, pooling after the first two."""
    layers: list[nn.Module] = []
    for part in BACKBONE_LAYERS:
        layers += [
            nn.Conv2d(part.inputs, part.outputs, part.kernel, part.stride, part.padding),
            nn.ReLU(inplace=True),
        ]
        if part.pool:
            layers.append(nn.MaxPool2d(POOL_SIZE, POOL_STRIDE))
    return layers
