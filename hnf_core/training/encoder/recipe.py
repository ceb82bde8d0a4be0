"""From pairs to an encoder: `hnf train encoder`, and how the shipped weights come about."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...datasets.tactile_pairs import HELD_OUT_INSTANCES, TRAIN, Pairs, load_pairs
from ...errors import FileError
from ...material.alexnet.network import IMAGENET_DEVIATION, IMAGENET_MEAN, AlexNet, Design
from ...material.alexnet.reading import describe_by_alexnet
from ...material.encoders import Encoder
from ...material.token import ALEXNET_ID
from .fit import Schedule, Watch, fit
from .judge import Errors, errors_in_words, judge
from .trunk_file import load_trunk

LICENCE = "GPL-3.0-or-later"
USERS_LICENCE = "the trunk's own terms apply; the head: GPL-3.0-or-later"
JUDGED_VIEWS = 400
"""Views of held-out instances that the metrics in the weights come from."""
USERS_PIXELS = 128
"""Views are enlarged to this for a trunk that was trained on photographs of 224 pixels."""


@dataclass(frozen=True)
class TrainedEncoder:
    """errors: on held-out instances, None where the folder has none."""

    network: AlexNet
    errors: Errors | None


def train_encoder(
    folder: Path,
    schedule: Schedule,
    seed: int,
    *,
    trunk: Path | None = None,
    design: Design | None = None,
    start: AlexNet | None = None,
    partial: bool = False,
    watch: Watch | None = None,
) -> TrainedEncoder:
    """Train on the pairs in folder: everything, or with a trunk file the head alone. Raises FileError, WeightsError.

    start: an encoder to go on from. partial: train on the shards that are there, and take in at every epoch what has
    come since.
    """
    pairs = load_pairs(folder, TRAIN, partial=partial)
    if trunk is None:
        design, weights, source = (
            design or (start.design if start else Design()),
            None,
            "trunk and head trained together",
        )
    else:
        design = design or Design(pixels=USERS_PIXELS, mean=IMAGENET_MEAN, deviation=IMAGENET_DEVIATION)
        weights, digest = load_trunk(trunk)
        source = f"trunk of {trunk.name} (SHA-256 {digest}) as it is, head trained"

    def there_now() -> Pairs:
        nonlocal pairs
        pairs = load_pairs(folder, TRAIN, partial=True)
        return pairs

    refresh = there_now if partial else None
    twin = fit(design, pairs, schedule, seed, trunk=weights, start=start, refresh=refresh, watch=watch)
    metadata = {
        "training_data": f"{len(pairs)} views of {pairs.tiles} tiles made by this project's generator of surfaces; "
        f"no recorded data; {source}",
        "seed": str(seed),
        **({"continued": json.dumps({"from": start.content_id, **start.metadata}, sort_keys=True)} if start else {}),
        "licence": LICENCE if trunk is None else USERS_LICENCE,
    }
    network = twin.to_numpy(metadata)
    errors = _judged(network, folder, partial)
    if errors is not None:
        words = f"single views of held-out instances against their whole tiles: {errors_in_words(errors)}"
        network = AlexNet(network.design, network.tensors, {**metadata, "metrics": words})
    return TrainedEncoder(network, errors)


def _judged(network: AlexNet, folder: Path, partial: bool) -> Errors | None:
    try:
        held = load_pairs(folder, HELD_OUT_INSTANCES, partial=partial)
    except FileError:
        if partial:
            return None
        raise
    # Chosen at random: views of one pitch stand at equal distances.
    rows = sorted(np.random.default_rng(0).permutation(len(held))[:JUDGED_VIEWS].tolist())
    return judge(Encoder(ALEXNET_ID, "", lambda each: describe_by_alexnet(network, each)), held, rows)
