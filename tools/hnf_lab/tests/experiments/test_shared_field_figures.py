"""Figures of the shared field: single-material fields, unseen classes, directions, and the interval of a mean."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from shared_field_builders import gather_strokes, make_references, network

from hnf_lab.bootstrap import bootstrap_mean
from hnf_lab.experiments.shared_field import (
    measure_directions,
    measure_single_material_field_db,
    measure_training_token_db,
    measure_unseen_materials,
)
from hnf_lab.shared_field.references import compute_distances_db, select_materials


@pytest.fixture(scope="module")
def gathered():
    return gather_strokes()


@pytest.fixture(scope="module")
def references():
    return make_references()


def test_distances_on_training_tokens_are_finite(references, gathered):
    assert np.isfinite(measure_training_token_db(network(), references, gathered)).all()


def test_a_field_of_its_own_is_finite(references, gathered):
    assert 0.0 < measure_single_material_field_db(gathered, references, 1, 4, 0) < 40.0


def test_rivals_on_unseen_classes_see_only_the_others(references):
    categories = {"oak-wood": "wood", "denim": "fabric", "silk": "fabric"}
    (row,) = measure_unseen_materials(network(), references, ["silk"], categories)
    assert row.name == "silk/1"
    assert row.nearest != "silk/1"
    denim = compute_distances_db(select_materials(references, [3]), references.spectra[[1]]).mean()
    assert row.category_db == pytest.approx(float(denim))


def test_exact_spectral_ratios_have_no_error_at_any_level(references):
    spectra = np.repeat(references.spectra[:1], 4, axis=1)
    eight = dataclasses.replace(references, spectra=spectra * np.arange(1.0, 9.0)[:, None])
    (exact,) = measure_directions(dataclasses.replace(eight, specimens=references.specimens[:1]), 7.0 * eight.spectra)
    assert (exact.ratio_db, exact.third_db, exact.power_db) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    assert exact.anisotropy_db > 6.0
    flat = np.broadcast_to(eight.spectra[:, -1:], eight.spectra.shape)
    (blind,) = measure_directions(dataclasses.replace(eight, specimens=references.specimens[:1]), flat)
    assert blind.ratio_db > 1.0
    assert blind.field_anisotropy_db == pytest.approx(0.0, abs=1e-9)


def test_the_interval_holds_the_mean():
    values = np.random.default_rng(0).normal(2.0, 1.0, 30)
    mean, low, high = bootstrap_mean(values, 0).to_list()
    assert low < mean < high
    assert high - low == pytest.approx(2.0 * 1.96 / np.sqrt(30.0), rel=0.3)
