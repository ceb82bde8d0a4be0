"""The weights that are shipped: reading and writing them gives the committed bytes again."""

from pathlib import Path

import pytest

from hnf_core.field.weights import DEFAULT_WEIGHTS as FIELD
from hnf_core.field.weights import EVERY_ENCODER_WEIGHTS, HELD_OUT_WEIGHTS, load_field, save_field
from hnf_core.material.alexnet_encoder import DEFAULT_ENCODER, load_encoder, save_encoder
from hnf_core.tactile.unet import SHIPPED_WEIGHTS, load_map_weights, save_map_weights


def copy_field(source: Path, target: Path) -> None:
    save_field(target, load_field(source))


def copy_encoder(source: Path, target: Path) -> None:
    save_encoder(target, load_encoder(source))


def copy_maps(source: Path, target: Path) -> None:
    weights = load_map_weights(source)
    save_map_weights(target, weights.config, weights.network.parameters, weights.metadata)


COPIES = {
    FIELD: copy_field, HELD_OUT_WEIGHTS: copy_field, EVERY_ENCODER_WEIGHTS: copy_field, DEFAULT_ENCODER: copy_encoder,
    **dict.fromkeys(SHIPPED_WEIGHTS.values(), copy_maps),
}  # fmt: skip


@pytest.mark.parametrize("path", COPIES, ids=lambda path: path.stem)
def test_reading_and_writing_gives_the_committed_bytes(path: Path, tmp_path: Path) -> None:
    COPIES[path](path, tmp_path / path.name)
    assert (tmp_path / path.name).read_bytes() == path.read_bytes()


def test_these_are_all() -> None:
    assert set(FIELD.parent.glob("*.safetensors")) == set(COPIES)
