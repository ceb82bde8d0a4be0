"""Choice of the encoder E by name or by origin of the map: encoders turn tactile maps into tokens (see `token.py`).

Baked data and trained fields store the name of the encoder.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import UsageError
from ..files import content_hash
from ..tactile.tactile_map import Route, TactileMap
from .alexnet_encoder import describe_with_alexnet, load_encoder
from .band_descriptor import describe
from .fuse import merge_tokens
from .token import ALEXNET_ID, ENCODER_ID, ENCODER_NAMES, Token

PREFERRED_ENCODERS = {Route.MEASURED: (ENCODER_ID,), Route.PREDICTED: (ALEXNET_ID, ENCODER_ID)}
"""Encoders for maps of each origin, best first: the band descriptor is exact on a complete map without noise; on a few
views it mistakes chance for peaks, which the network does not (docs/encoder.md has the figures)."""


@dataclass(frozen=True)
class Encoder:
    """An encoder E: a function from a tactile map to a material token, with its name.

    Attributes
    ----------
    name : str
        Its name; fields store the names of the encoders whose tokens they were trained on.
    content_id : str
        Hash that changes with anything that changes its tokens, for cache keys.
    describe : callable
        Function from a tactile map to its token.
    """

    name: str
    content_id: str
    describe: Callable[[TactileMap], Token]


def get_encoder(name: str) -> Encoder:
    """Return an encoder by its name, or load it from a file of weights.

    Parameters
    ----------
    name : str
        Name of an encoder, or path of a .safetensors file written by `hnf train encoder`.

    Returns
    -------
    Encoder
        The encoder.

    Raises
    ------
    UsageError
        For an unknown name.
    FileError, WeightsError
        If a file cannot be used.
    MaterialError
        If the network's weights are not installed, as in the Blender extension.
    """
    if name == ENCODER_ID:
        return Encoder(ENCODER_ID, ENCODER_ID, describe)
    if name != ALEXNET_ID and Path(name).suffix != ".safetensors":
        raise UsageError(
            f"no encoder is called '{name}'.",
            remedy=f"Choose one of {', '.join(ENCODER_NAMES)}, or give a file written by `hnf train encoder`.",
        )
    network = load_encoder(None if name == ALEXNET_ID else name)
    return Encoder(
        ALEXNET_ID,
        content_hash(ALEXNET_ID, network.content_id),
        lambda tactile_map: describe_with_alexnet(network, tactile_map),
    )


def get_default_encoder(route: Route, known: Sequence[str] = (ENCODER_ID,)) -> Encoder:
    """Return the best encoder for tactile maps of an origin (route) among those that the field was trained on.

    Parameters
    ----------
    route : Route
        Origin of the maps, measured or predicted.
    known : sequence of str
        Names of the encoders whose tokens the field was trained on.

    Returns
    -------
    Encoder
        The encoder.

    Raises
    ------
    UsageError
        For the prior route, or if the field knows no encoder of this route.
    MaterialError
        If the best one is not installed, as in the Blender extension.
    """
    best = next((name for name in PREFERRED_ENCODERS.get(route, ()) if name in known), None)
    if best is None:
        raise UsageError(
            f"there is no make of E for {route.value} maps among {', '.join(known)}.",
            remedy=f"Use a field that was trained on tokens of {ENCODER_ID}.",
        )
    return get_encoder(best)


def describe_views(encoder: Encoder, maps: Sequence[TactileMap]) -> Token:
    """Describe a patch by one material token, from its tactile map or from the maps of several views of it.

    Tokens of several views are merged in each wavelength band, weighted by the area that each view shows. Raises
    MaterialError if there is no map.
    """
    sizes = [max(np.count_nonzero(view.mask), 1) * view.metres_per_pixel**2 for view in maps]
    return merge_tokens([encoder.describe(view) for view in maps], sizes)
