"""From pairs to an encoder: `hnf train encoder`, and how the shipped weights come about."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...datasets.tactile_pairs import HELD_OUT_INSTANCES, TRAIN, Pairs, load_pairs
from ...errors import FileError
from ...material.alexnet.network import IMAGENET_DEVIATION, IMAGENET_MEAN, AlexNet, AlexNetConfig
from ...material.alexnet.reading import describe_with_alexnet
from ...material.encoders import Encoder
from ...material.token import ALEXNET_ID
from .fit import ProgressCallback, Schedule, fit_encoder
from .judge import TokenErrors, evaluate_encoder, format_errors
from .trunk_file import load_backbone

LICENCE = "GPL-3.0-or-later"
USER_BACKBONE_LICENCE = "the trunk's own terms apply; the head: GPL-3.0-or-later"
EVALUATED_VIEWS = 400
"""Views of held-out instances that the metrics in the weights come from."""
USER_BACKBONE_PIXELS = 128
"""Views are enlarged to this for a trunk that was trained on photographs of 224 pixels."""


@dataclass(frozen=True)
class TrainedEncoder:
    """errors: on held-out instances, None where the folder has none."""

    network: AlexNet
    errors: TokenErrors | None


def train_encoder(
    folder: Path,
    schedule: Schedule,
    seed: int,
    *,
    backbone: Path | None = None,
    design: AlexNetConfig | None = None,
    start: AlexNet | None = None,
    partial: bool = False,
    watch: ProgressCallback | None = None,
) -> TrainedEncoder:
    """Train on the pairs in folder: everything, or with a trunk file the head alone. Raises FileError, WeightsError.

    start: an encoder to go on from. partial: train on the shards that are there, and take in at every epoch what has
    come since.
    """
    pairs = load_pairs(folder, TRAIN, partial=partial)
    if backbone is None:
        design, weights, source = (
            design or (start.config if start else AlexNetConfig()),
            None,
            "trunk and head trained together",
        )
    else:
        design = design or AlexNetConfig(pixels=USER_BACKBONE_PIXELS, mean=IMAGENET_MEAN, deviation=IMAGENET_DEVIATION)
        weights, digest = load_backbone(backbone)
        source = f"trunk of {backbone.name} (SHA-256 {digest}) as it is, head trained"

    def there_now() -> Pairs:
        nonlocal pairs
        pairs = load_pairs(folder, TRAIN, partial=True)
        return pairs

    refresh = there_now if partial else None
    twin = fit_encoder(design, pairs, schedule, seed, backbone=weights, start=start, refresh=refresh, watch=watch)
    metadata = {
        "training_data": f"{len(pairs)} views of {pairs.tiles} tiles made by this project's generator of surfaces; "
        f"no recorded data; {source}",
        "seed": str(seed),
        **({"continued": json.dumps({"from": start.content_id, **start.metadata}, sort_keys=True)} if start else {}),
        "licence": LICENCE if backbone is None else USER_BACKBONE_LICENCE,
    }
    network = twin.to_numpy(metadata)
    errors = _evaluate_held_out(network, folder, partial)
    if errors is not None:
        words = f"single views of held-out instances against their whole tiles: {format_errors(errors)}"
        network = AlexNet(network.config, network.tensors, {**metadata, "metrics": words})
    return TrainedEncoder(network, errors)


def _evaluate_held_out(network: AlexNet, folder: Path, partial: bool) -> TokenErrors | None:
    try:
        held = load_pairs(folder, HELD_OUT_INSTANCES, partial=partial)
    except FileError:
        if partial:
            return None
        raise
    # Chosen at random: views of one pitch stand at equal distances.
    rows = sorted(np.random.default_rng(0).permutation(len(held))[:EVALUATED_VIEWS].tolist())
    return evaluate_encoder(Encoder(ALEXNET_ID, "", lambda each: describe_with_alexnet(network, each)), held, rows)
