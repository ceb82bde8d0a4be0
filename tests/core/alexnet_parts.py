"""Small encoders and random trunks for tests: the real architecture, weights from a seed."""

import numpy as np

from hnf_core.material.alexnet_encoder import BACKBONE_LAYERS, AlexNet, AlexNetConfig

HIDDEN = 16


def random_tensors(design: AlexNetConfig, seed: int = 0) -> dict[str, np.ndarray]:
    """Every layer keeps its input's variance, so that nothing dies or grows on the way (He et al. 2015)."""
    rng = np.random.default_rng(seed)
    out = {}
    for name, shape in design.shapes().items():
        if name.endswith("weight"):
            out[name] = rng.standard_normal(shape) * np.sqrt(2.0 / np.prod(shape[1:]))
        elif name == "output.spread":
            out[name] = rng.uniform(0.1, 0.3, shape)
        else:
            out[name] = 0.05 * rng.standard_normal(shape)
        # As half precision keeps them, so that a file gives back what was written.
        out[name] = out[name].astype(np.float16).astype(np.float32)
    return out


def random_encoder(seed: int = 0, pixels: int = 64) -> AlexNet:
    design = AlexNetConfig(pixels=pixels, hidden=HIDDEN)
    return AlexNet(design, random_tensors(design, seed), {"licence": "none"})


def trunk_names() -> list[str]:
    return [f"{layer.name}.{part}" for layer in BACKBONE_LAYERS for part in ("weight", "bias")]
