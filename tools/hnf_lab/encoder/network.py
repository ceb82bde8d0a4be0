"""AlexNet encoder in torch, and weight files of the user.

`TorchAlexNet` is the trainable twin of hnf_core.material.alexnet_encoder, with the same tensors, names and arithmetic.
`read_state_dict` and `load_backbone` read torchvision weights from .safetensors files.
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
    """Read the tensors by name, and the file's SHA-256 in hex.

    torch's own files (.pth, .pt) are pickles, which run code when read. They are refused unread, with the command that
    converts them.

    Parameters
    ----------
    path
        A .safetensors file.
    network
        Name in torchvision.models, for messages.

    Raises
    ------
    FileError
        If there is no file.
    WeightsError
        If it is not a safetensors file.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load

    remedy = format_save_command(network)
    if path.is_file() and path.suffix != SUFFIX:
        suffix = path.suffix or "no suffix"
        raise WeightsError(
            f"not a file of weights that can be read as data alone ({suffix}, not {SUFFIX}).",
            where=str(path),
            remedy=remedy,
        )
    data = read_weights_bytes(path, "the trunk", remedy)
    try:
        return load(data), hashlib.sha256(data).hexdigest()
    except (SafetensorError, ValueError, KeyError, TypeError, RuntimeError) as error:
        raise WeightsError(f"damaged or not a file of weights ({error}).", where=str(path), remedy=remedy) from error


def format_save_command(network: str) -> str:
    """Return the instruction and one-line command that writes a file for read_state_dict."""
    return (
        f"Save the state dict of torchvision's {network} with your own Python: "
        f'python -c "import torchvision, safetensors.torch as s; '
        f"s.save_file(torchvision.models.{network}(weights='DEFAULT').state_dict(), '{network}{SUFFIX}')\""
    )


BACKBONE_NAME = "alexnet"
_REMEDY = format_save_command(BACKBONE_NAME)


def load_backbone(path: Path) -> tuple[dict[str, Tensor], str]:
    """Load float32 tensors features.0.weight … features.10.bias, and the file's SHA-256 in hex.

    classifier.* is ignored.

    Raises
    ------
    FileError
        If there is no file.
    WeightsError
        If it is not a safetensors file, or names, shapes or numbers are not AlexNet's.
    """
    state, digest = read_state_dict(path, BACKBONE_NAME)
    expected_shapes = get_backbone_shapes()
    missing = sorted(set(expected_shapes) - set(state))
    unknown = sorted(name for name in set(state) - set(expected_shapes) if not name.startswith("classifier."))
    if missing or unknown:
        raise WeightsError(
            f"not the trunk of AlexNet: missing {missing[:3]}, unknown {unknown[:3]}.", where=str(path), remedy=_REMEDY
        )
    tensors = {}
    for name, shape in expected_shapes.items():
        actual_shape = tuple(state[name].shape)
        if actual_shape != shape:
            raise WeightsError(f"{name} is {actual_shape}, AlexNet's is {shape}.", where=str(path), remedy=_REMEDY)
        if not state[name].is_floating_point():
            raise WeightsError(f"{name} is {state[name].dtype}, not real.", where=str(path), remedy=_REMEDY)
        tensors[name] = state[name].to(torch.float32)
        if not torch.isfinite(tensors[name]).all():
            raise WeightsError(f"{name} is not finite.", where=str(path), remedy=_REMEDY)
    return tensors, digest


Single = NDArray[np.float32]


class TorchAlexNet(nn.Module):
    """Trainable AlexNet encoder.

    Maps views (n, 3, 64, 64) of contrast 1 and conditions (n, CONDITION_COUNT) to outputs (n, OUTPUT_COUNT) in units of
    their spread. The state dict has torchvision's names for the backbone (features.0.weight …), head.0 and head.2, and
    output.mean and output.spread as buffers.
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
        """Mean of the training targets, (OUTPUT_COUNT,)."""
        return self.get_buffer("output.mean")

    @property
    def output_spread(self) -> Tensor:
        """Standard deviation of the training targets, (OUTPUT_COUNT,), the unit of forward's result."""
        return self.get_buffer("output.spread")

    def pool_features(self, views: Tensor) -> Tensor:
        """Return (n, BACKBONE_FEATURES) backbone features averaged over positions."""
        features: Tensor = self.features(self.prepare_images(views))
        return features.float().mean(dim=(2, 3))

    def prepare_images(self, views: Tensor) -> Tensor:
        """Convert views to images in the backbone's training units, enlarged if configured."""
        image = (INPUT_MEAN + INPUT_DEVIATION * views - self.mean) / self.deviation
        if self.matrix is not None:
            image = self.matrix @ image @ self.matrix.T
        return image.contiguous(memory_format=torch.channels_last)

    def forward(self, views: Tensor, conditions: Tensor) -> Tensor:
        """Return outputs in units of each output's spread about its mean."""
        outputs: Tensor = self.head(torch.cat([self.pool_features(views), conditions], dim=1))
        return outputs.float()

    def initialise(self, seed: int) -> None:
        """Initialise as He et al. (2015), preserving variance through the ReLUs; the last layer starts small."""
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
        """Scale every trainable layer but the last to mean 0 and deviation 1 before the ReLU on these views.

        By Krähenbühl et al. 2016: a deep network without normalisation layers then starts to learn at once.
        """
        x = self.prepare_images(views)
        for module in self.features:
            if isinstance(module, nn.Conv2d) and module.weight.requires_grad:
                _standardise_layer(module, module(x).transpose(0, 1).flatten(1).T)
            x = module(x)
        first = self.head[0]
        assert isinstance(first, nn.Linear)
        joined = torch.cat([x.mean(dim=(2, 3)), conditions], dim=1)
        # Averages over positions differ little between views, so each is scaled to order 1 like the conditions.
        mean, spread = joined.mean(dim=0), joined.std(dim=0).clamp(min=1e-3)
        first.weight.div_(spread)
        first.bias.sub_(first.weight @ mean)
        _standardise_layer(first, first(joined))

    def to_numpy(self, metadata: Mapping[str, str]) -> AlexNet:
        """Return the run-time network with these tensors."""
        state = {name: value.detach().float().numpy().copy() for name, value in self.state_dict().items()}
        return AlexNet(self.design, {name: state[name] for name in self.design.shapes()}, dict(metadata))


def to_torch(network: AlexNet) -> TorchAlexNet:
    """Return the torch network with a run-time network's tensors."""
    twin = TorchAlexNet(network.config)
    twin.load_state_dict({name: torch.tensor(np.asarray(value)) for name, value in network.tensors.items()})
    return twin


def _standardise_layer(layer: nn.Conv2d | nn.Linear, found: Tensor) -> None:
    """Scale a layer by its current outputs (n, units)."""
    spread = found.std(dim=0).clamp(min=1e-3)
    assert layer.bias is not None
    layer.weight.div_(spread.reshape(-1, *[1] * (layer.weight.dim() - 1)))
    layer.bias.sub_(found.mean(dim=0)).div_(spread)


def _make_backbone() -> list[nn.Module]:
    """Make the layers in torchvision's order, so their names match: ReLU always, pooling after the first two."""
    layers: list[nn.Module] = []
    for layer in BACKBONE_LAYERS:
        layers += [
            nn.Conv2d(layer.inputs, layer.outputs, layer.kernel, layer.stride, layer.padding),
            nn.ReLU(inplace=True),
        ]
        if layer.pool:
            layers.append(nn.MaxPool2d(POOL_SIZE, POOL_STRIDE))
    return layers
