"""The makes of E: each turns tactile maps into tokens of one layout (token.py), and each has a name that bakes keep."""

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
"""Which makes describe maps of which route, best first: the descriptor is exact on a whole map that has no noise; of a
few views it takes chance for peaks, which the network does not (docs/encoder.md has the figures)."""


@dataclass(frozen=True)
class Encoder:
    """name: of the make; fields name the makes whose tokens they were trained on. content_id: changes with anything
    that changes a token, for keys of what is kept. describe: one tactile map → its token."""

    name: str
    content_id: str
    describe: Callable[[TactileMap], Token]


def get_encoder(name: str) -> Encoder:
    """The encoder of that name, or the one in the file of that name (.safetensors, see `hnf train encoder`).

    Raises UsageError for an unknown name, FileError and WeightsError where a file cannot be used, MaterialError where
    the network was left out of the Blender extension.
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
    """The make that describes maps of a route where nobody chose one: the best of those that the field knows.

    known: field.weights.encoders_of the field in use. Raises UsageError for the prior route, and where the field knows
    none of the route's makes; MaterialError where the Blender extension leaves out the one that it knows best.
    """
    found = next((name for name in PREFERRED_ENCODERS.get(route, ()) if name in known), None)
    if found is None:
        raise UsageError(
            f"there is no make of E for {route.value} maps among {', '.join(known)}.",
            remedy=f"Use a field that was trained on tokens of {ENCODER_ID}.",
        )
    return get_encoder(found)


def describe_views(encoder: Encoder, maps: Sequence[TactileMap]) -> Token:
    """One token of a patch from its tactile map, or from several views of it (merged band by band, by the area that
    each shows).

    Raises MaterialError where there is no map.
    """
    sizes = [max(np.count_nonzero(each.mask), 1) * each.metres_per_pixel**2 for each in maps]
    return merge_tokens([encoder.describe(each) for each in maps], sizes)
