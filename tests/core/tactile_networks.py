"""Small D_φ with random weights, and looks to ask it about."""

from __future__ import annotations

import json

import numpy as np

from hnf_core.tactile.unet import DIFFUSION, MapConfig, MapWeights, build_unet
from hnf_core.tactile.views import PITCHES_M, AppearanceView

SMALL = {"channels": (16, 24, 32), "embedding": 24, "groups": 4}


def random_weights(seed: int = 0, objective: str = DIFFUSION, **shape) -> MapWeights:
    config = MapConfig(**{**SMALL, **shape}, objective=objective)
    return MapWeights(build_unet(config, random_parameters(config, seed)), {}, "random")


def random_parameters(config: MapConfig, seed: int = 0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {
        name: rng.normal(0.0, 0.3 if len(shape) == 1 else np.prod(shape[1:]) ** -0.5, shape).astype(np.float32)
        for name, shape in config.shapes().items()
    }


def look(seed: int, pitch: int = 0, depth_known: bool = True) -> AppearanceView:
    rng = np.random.default_rng(seed)
    depth = PITCHES_M[pitch] * rng.normal(size=(64, 64)) if depth_known else np.zeros((64, 64))
    rgb = rng.uniform(size=(64, 64, 3))
    return AppearanceView(rgb.astype(np.float32), depth.astype(np.float32), depth_known, PITCHES_M[pitch])


def architecture(**changes) -> str:
    import dataclasses

    return json.dumps({**dataclasses.asdict(MapConfig(**SMALL)), **changes})
