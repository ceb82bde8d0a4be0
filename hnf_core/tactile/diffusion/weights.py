"""Weights of the tactile-map network D_φ on disk: half-precision safetensors with architecture and metrics."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import UsageError, WeightsError
from ...files import write_bytes
from ...safetensors_io import WeightsKind, dump_tensors, read_weights
from ..optics import SENSORS
from .unet import DIFFUSION, HEADS, REGRESSION, MapConfig, UNet, build_unet

DATA_FOLDER = Path(__file__).parents[2] / "data"
DEFAULT_WEIGHTS = DATA_FOLDER / "tactile-map.safetensors"
SHIPPED_WEIGHTS = {REGRESSION: DEFAULT_WEIGHTS, DIFFUSION: DATA_FOLDER / "tactile-map-diffusion.safetensors"}
"""Shipped weights by the word that chooses them."""
FORMAT = "hnf-tactile-map-1"
TOKEN_ERROR = "token_error"
"""Name of the errors of predicted tokens in the header of weights."""
_MAP_KIND = WeightsKind(
    "weights",
    FORMAT,
    "not weights of tactile maps",
    "Train it again with `hnf train tactile-map`, or choose other weights.",
)


@dataclass(frozen=True)
class MapWeights:
    """Weights of the tactile-map network D_φ, ready to run.

    Attributes
    ----------
    network : UNet
        The network.
    metadata : mapping of str to str
        Training data, seed, metrics, licence.
    fingerprint : str
        Hash of the file.
    """

    network: UNet
    metadata: Mapping[str, str]
    fingerprint: str

    @property
    def config(self) -> MapConfig:
        """Architecture of the network."""
        return self.network.config

    @property
    def token_error(self) -> NDArray[np.float32]:
        """Standard errors (n,) of predicted tokens, as measured on materials that the network never met.

        Raises WeightsError if the weights do not say them.
        """
        try:
            error = np.array(json.loads(self.metadata[TOKEN_ERROR]), dtype=np.float32)
            if error.ndim != 1 or not (np.isfinite(error) & (error > 0.0)).all():
                raise ValueError(f"{error.shape} values")
        except (KeyError, TypeError, ValueError) as cause:
            raise WeightsError(
                "these weights do not say how far off what they predict is.",
                remedy="Train them again, or let them go on: hnf train tactile-map --start FILE --out OTHER.",
            ) from cause
        return error


def find_map_weights(choice: str) -> Path:
    """Return the file of weights that a word of `SHIPPED_WEIGHTS` or a path chooses; "" is the default.

    Raises UsageError if it is neither a word nor a .safetensors file that is there.
    """
    path = SHIPPED_WEIGHTS.get(choice or REGRESSION, Path(choice))
    if choice not in ("", *SHIPPED_WEIGHTS) and (path.suffix != ".safetensors" or not path.is_file()):
        raise UsageError(
            f"no tactile-map network is called '{choice}', and no .safetensors file.",
            remedy=f"Choose {' or '.join(SHIPPED_WEIGHTS)}, or a file that hnf train tactile-map wrote.",
        )
    return path


def refuse_package_data(path: Path) -> None:
    """Raise UsageError if a file to be written lies in the package's data, which nobody overwrites."""
    if path.resolve().parent == DATA_FOLDER.resolve():
        raise UsageError(
            f"{path.name} is part of the installed package.",
            where=str(path),
            remedy="Write a file of your own, and choose it by --tactile-map FILE.",
        )


def save_map_weights(
    path: Path, config: MapConfig, parameters: Mapping[str, NDArray[np.float32]], metadata: Mapping[str, str]
) -> None:
    """Write the weights of D_φ in half precision, atomically; equal weights give equal bytes.

    Parameters
    ----------
    path : Path
        The file.
    config : MapConfig
        Architecture.
    parameters : mapping of str to ndarray
        Parameters by name.
    metadata : mapping of str to str
        Training data, seed, metrics, licence; format and architecture are added.

    Raises
    ------
    FileError
        If the file cannot be written.
    WeightsError
        If half precision cannot hold a parameter.
    """
    with np.errstate(over="ignore"):
        tensors = {name: np.ascontiguousarray(value, dtype=np.float16) for name, value in parameters.items()}
    overflowed = [name for name, value in tensors.items() if not np.isfinite(value).all()]
    if overflowed:
        raise WeightsError(
            f"{overflowed[0]} is not finite in half precision.", where=str(path), remedy=_MAP_KIND.remedy
        )
    header = {**metadata, "format": FORMAT, "architecture": json.dumps(dataclasses.asdict(config), sort_keys=True)}
    write_bytes(path, dump_tensors(tensors, header))


def load_map_weights(path: Path | str | None = None) -> MapWeights:
    """Load the weights of D_φ from a file; without a path the shipped ones, which are read once.

    Raises FileError if there is no file, WeightsError if it is damaged, of another format or architecture, not finite,
    or trained for a sensor that `tactile.optics` lacks.
    """
    return _load_default() if path is None else _read_map_weights(Path(path))


@lru_cache(maxsize=1)
def _load_default() -> MapWeights:
    return _read_map_weights(DEFAULT_WEIGHTS)


def _read_map_weights(path: Path) -> MapWeights:
    file = read_weights(path, _MAP_KIND)
    config, shapes = file.parse_metadata(_parse_architecture)
    return MapWeights(build_unet(config, file.check_parameters(shapes)), file.metadata, file.content_id)


def _parse_architecture(metadata: Mapping[str, str]) -> tuple[MapConfig, Mapping[str, tuple[int, ...]]]:
    config = _parse_config(metadata["architecture"])
    return config, config.shapes()


def _parse_config(text: str) -> MapConfig:
    record = json.loads(text)
    config = MapConfig(**{**record, "channels": tuple(record["channels"]), "sensors": tuple(record["sensors"])})
    sizes = (*config.channels, config.down, config.up, config.deep, config.embedding, config.groups)
    if len(config.channels) != 3 or not all(isinstance(size, int) and 0 < size <= 4096 for size in sizes):
        raise ValueError(f"sizes {sizes}")
    if any(size % config.groups for size in config.channels) or config.channels[2] % HEADS:
        raise ValueError(f"channels {config.channels} do not divide into {config.groups} groups and {HEADS} heads")
    if config.objective not in (DIFFUSION, REGRESSION):
        raise ValueError(f"objective {config.objective!r}")
    if not config.sensors or not set(config.sensors) <= set(SENSORS):
        raise ValueError(f"sensors {config.sensors}")
    if not (np.isfinite(config.level_mean) and 0.0 < config.level_scale < np.inf):
        raise ValueError(f"level {config.level_mean} ± {config.level_scale}")
    return config
