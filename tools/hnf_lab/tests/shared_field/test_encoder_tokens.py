"""Tokens of further encoders for the shared field, of the same surfaces as the library's."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from alexnet_parts import random_encoder

pytest.importorskip("torch", reason="training needs the extra [train]")

from hnf_core.field.field import FieldConfig
from hnf_core.field.weights import check_encoders, read_encoders, save_field
from hnf_core.material.alexnet_encoder import save_encoder
from hnf_core.material.token import ALEXNET_ID, ENCODER_ID, TOKEN_DIM
from hnf_core.training.model import FieldNetwork
from hnf_lab.shared_field.fit import Schedule, TrainingSet
from hnf_lab.shared_field.references import simulate_references
from hnf_lab.shared_field.simulated_strokes import make_class_specimens, make_middle_conditions
from hnf_lab.shared_field.train_shared import TrainingPlan, describe_field, fit_shared_field, load_or_encode_tokens
from hnf_lab.shared_field.training_data import Sizes, build_training_data, encode_surfaces

SIZES = Sizes(instances=1, patches=1, described=1, strokes=2, random=2, random_strokes=1, seconds=0.3)
SPECIMENS = make_class_specimens([1])[::20]
PLAN = TrainingPlan(SIZES, Schedule(epochs=1, batch=4), variants=2, alternative_patches=1)


@pytest.fixture(scope="module")
def gathered():
    return build_training_data(SPECIMENS, SIZES, 0, workers=1)


@pytest.fixture(scope="module")
def encoder(tmp_path_factory):
    path = tmp_path_factory.mktemp("encoder") / "e.safetensors"
    save_encoder(path, random_encoder(3))
    return str(path)


def test_other_encoders_describe_the_same_surfaces_in_order(gathered, encoder):
    assert np.array_equal(encode_surfaces(ENCODER_ID, SPECIMENS, SIZES, 0, workers=1), gathered.tokens)
    other = encode_surfaces(encoder, SPECIMENS, SIZES, 0, workers=1)
    assert other.shape == gathered.tokens.shape
    assert not np.array_equal(other, gathered.tokens)


def test_their_tokens_are_kept_in_the_cache(tmp_path, encoder):
    first = load_or_encode_tokens(encoder, SPECIMENS, PLAN, 0, tmp_path, 1)
    (kept,) = tmp_path.iterdir()
    written = kept.stat().st_mtime_ns
    assert np.array_equal(load_or_encode_tokens(encoder, SPECIMENS, PLAN, 0, tmp_path, 1), first)
    assert kept.stat().st_mtime_ns == written


def test_every_make_adds_variants_described_by_it(gathered, monkeypatch):
    """The network's view of the token is the second make's in exactly the added variants."""
    seen: list[TrainingSet] = []
    config = FieldConfig(hidden=8, layers=1, line_gains=True, stroke_frame=True)

    def watch(config_, data, schedule, seed):
        seen.append(data)
        return FieldNetwork(config_, {name: np.zeros(shape, np.float32) for name, shape in config_.shapes().items()})

    monkeypatch.setattr("hnf_lab.shared_field.train_shared.fit_network", watch)
    fit_shared_field(gathered, PLAN, config, 0)
    fit_shared_field(gathered, PLAN, config, 0, [gathered.tokens + np.float32(0.25)])
    alone, both = (data.x.numpy()[:, :, :TOKEN_DIM] for data in seen)
    assert len(alone) == PLAN.variants + PLAN.alternative_patches
    assert len(both) == PLAN.variants + 2 * PLAN.alternative_patches
    np.testing.assert_array_equal(both[: len(alone)], alone)
    assert np.abs(both[len(alone) :] - alone[-PLAN.alternative_patches :]).max() > 0.05


def test_the_field_names_the_makes_that_it_learnt(gathered, encoder, tmp_path):
    config = FieldConfig(hidden=8, layers=1, line_gains=True, stroke_frame=True)
    plan = replace(PLAN, encoders=(encoder,))
    network = fit_shared_field(gathered, plan, config, 0, [gathered.tokens])
    references = simulate_references(SPECIMENS[:1], make_middle_conditions()[:1], 0, 1, seconds=0.3)
    field = describe_field(network, gathered, references, SPECIMENS[:1], plan, 0)
    assert json.loads(field.metadata["encoder"]) == [ENCODER_ID, ALEXNET_ID]
    save_field(tmp_path / "f.safetensors", field)
    assert read_encoders(field.metadata) == (ENCODER_ID, ALEXNET_ID)
    check_encoders(field, (ENCODER_ID, ALEXNET_ID))
