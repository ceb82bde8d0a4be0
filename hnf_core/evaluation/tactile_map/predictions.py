"""Networks asked about judged tiles; answers are kept under the weights' hash."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...blas import single_blas_thread
from ...cores import available_cpus
from ...datasets.tactile_pairs import PAIR_SENSORS
from ...tactile.diffusion.predict import DEFAULT_STEPS, predict_slopes
from ...tactile.diffusion.weights import MapWeights
from ...tactile.views import AppearanceView
from .kept import ArrayCache, Arrays
from .tiles import TOKEN_VIEWS, HeldOutTile

Single = NDArray[np.float32]


@dataclass(frozen=True)
class Query:
    """How a network is asked. steps, guidance: of a diffusion. views: from which of the tile's views on, and up to
    which. depth, colour: whether it is told."""

    sensor: str = PAIR_SENSORS[0]
    steps: int = DEFAULT_STEPS
    guidance: float = 1.0
    depth: bool = True
    colour: bool = True
    views: tuple[int, int] = (0, TOKEN_VIEWS)


@dataclass(frozen=True)
class Prediction:
    """slopes: (views, 2, 64, 64). seconds: of processor time, for all views."""

    slopes: Single
    seconds: float


def predict_tile(weights: MapWeights, tile: HeldOutTile, query: Query, seed: int, cache: ArrayCache) -> Prediction:
    """Slopes of the tile's views. The noise of each is of the tile, the view and the seed."""

    def one(index: int) -> Single:
        view = mask_depth(tile.views[index], query.depth)
        own = int(np.random.default_rng([seed, tile.order.tile_seed, index]).integers(2**31))
        return predict_slopes(weights, view, query.sensor, own, query.steps, query.guidance, query.colour)

    def make() -> Arrays:
        began = time.process_time()
        with single_blas_thread(), ThreadPoolExecutor(available_cpus()) as pool:
            slopes = list(pool.map(one, range(*query.views)))
        return {
            "slopes": np.stack(slopes).astype(np.float16),
            "seconds": np.array([time.process_time() - began]),
        }

    arrays = cache.get_or_make(f"prediction {weights.fingerprint} {tile.order} {query} {seed}", make)
    return Prediction(arrays["slopes"].astype(np.float32), float(arrays["seconds"][0]))


def mask_depth(view: AppearanceView, depth: bool) -> AppearanceView:
    """The view, its depth unknown unless `depth`."""
    return view if depth else replace(view, depth_m=np.zeros_like(view.depth_m), depth_known=False)
