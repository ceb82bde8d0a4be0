"""The shared field learns the tokens of further makes of E: of the same surfaces, beside the library's own."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from alexnet_parts import random_encoder

pytest.importorskip("torch", reason="training needs the extra [train]")

from hnf_core.field.config import FieldConfig
from hnf_core.field.weights import encoders_of, refuse_other_encoders, save_field
from hnf_core.material.alexnet.weights import save_encoder
from hnf_core.material.token import ALEXNET_ID, ENCODER_ID, TOKEN_DIM
from hnf_core.training.conditions import middle_conditions
from hnf_core.training.fit import Schedule, TrainingSet
from hnf_core.training.gathering import Sizes, gather, tokens_by
from hnf_core.training.model import FieldNetwork
from hnf_core.training.recipe import Plan, described, fit_gathered, tokens_for
from hnf_core.training.references import refer
from hnf_core.training.surfaces import class_specimens

SIZES = Sizes(instances=1, patches=1, described=1, strokes=2, random=2, random_strokes=1, seconds=0.3)
SPECIMENS = class_specimens([1])[::20]
PLAN = Plan(SIZES, Schedule(epochs=1, batch=4), variants=2, elsewhere=1)


@pytest.fixture(scope="module")
def gathered():
    return gather(SPECIMENS, SIZES, 0, workers=1)


@pytest.fixture(scope="module")
def encoder(tmp_path_factory):
    path = tmp_path_factory.mktemp("encoder") / "e.safetensors"
    save_encoder(path, random_encoder(3))
    return str(path)


def test_other_makes_describe_the_surfaces_that_were_stroked_in_their_order(gathered, encoder):
    assert np.array_equal(tokens_by(ENCODER_ID, SPECIMENS, SIZES, 0, workers=1), gathered.tokens)
    other = tokens_by(encoder, SPECIMENS, SIZES, 0, workers=1)
    assert other.shape == gathered.tokens.shape
    assert not np.array_equal(other, gathered.tokens)


def test_their_tokens_are_kept_in_the_cache(tmp_path, encoder):
    first = tokens_for(encoder, SPECIMENS, PLAN, 0, tmp_path, 1)
    (kept,) = tmp_path.iterdir()
    written = kept.stat().st_mtime_ns
    assert np.array_equal(tokens_for(encoder, SPECIMENS, PLAN, 0, tmp_path, 1), first)
    assert kept.stat().st_mtime_ns == written


def test_every_make_adds_variants_described_by_it(gathered, monkeypatch):
    """The network's view of the token is the second make's in exactly the added variants."""
    seen: list[TrainingSet] = []
    config = FieldConfig(hidden=8, layers=1, line_gains=True, stroke_frame=True)

    def watch(config_, data, schedule, seed):
        seen.append(data)
        return FieldNetwork(config_, {name: np.zeros(shape, np.float32) for name, shape in config_.shapes().items()})

    monkeypatch.setattr("hnf_core.training.recipe.fit", watch)
    fit_gathered(gathered, PLAN, config, 0)
    fit_gathered(gathered, PLAN, config, 0, [gathered.tokens + np.float32(0.25)])
    alone, both = (data.x.numpy()[:, :, :TOKEN_DIM] for data in seen)
    assert len(alone) == PLAN.variants + PLAN.elsewhere
    assert len(both) == PLAN.variants + 2 * PLAN.elsewhere
    np.testing.assert_array_equal(both[: len(alone)], alone)
    assert np.abs(both[len(alone) :] - alone[-PLAN.elsewhere :]).max() > 0.05


def test_the_field_names_the_makes_that_it_learnt(gathered, encoder, tmp_path):
    config = FieldConfig(hidden=8, layers=1, line_gains=True, stroke_frame=True)
    plan = replace(PLAN, encoders=(encoder,))
    network = fit_gathered(gathered, plan, config, 0, [gathered.tokens])
    references = refer(SPECIMENS[:1], middle_conditions()[:1], 0, 1, seconds=0.3)
    field = described(network, gathered, references, SPECIMENS[:1], plan, 0)
    assert json.loads(field.metadata["encoder"]) == [ENCODER_ID, ALEXNET_ID]
    save_field(tmp_path / "f.safetensors", field)
    assert encoders_of(field.metadata) == (ENCODER_ID, ALEXNET_ID)
    refuse_other_encoders(field, (ENCODER_ID, ALEXNET_ID))
