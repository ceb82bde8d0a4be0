"""The shared field's recipe: specimens, references, and equal results of reruns."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from shared_field_builders import CONDITIONS, CONFIG, SIZES, gather_strokes, make_references, network, pick_specimens

from hnf_core.errors import FileError
from hnf_core.material.library import LIBRARY_PATH
from hnf_core.simulation.material_classes import list_classes
from hnf_lab.shared_field.fit import Schedule, build_training_set
from hnf_lab.shared_field.references import (
    compute_distances_db,
    compute_new_patch_distances_db,
    load_references,
    predict_spectra,
    save_references,
    select_materials,
)
from hnf_lab.shared_field.simulated_strokes import make_middle_conditions
from hnf_lab.shared_field.train_shared import TrainingPlan, collect_training_ranges, fit_shared_field
from hnf_lab.shared_field.training_data import (
    Sizes,
    build_training_data,
    load_specimens,
    load_training_data,
    save_training_data,
    select_classes,
)

PLAN = TrainingPlan(SIZES, Schedule(epochs=2, batch=16))


@pytest.fixture(scope="module")
def specimens():
    return pick_specimens()


@pytest.fixture(scope="module")
def gathered():
    return gather_strokes()


@pytest.fixture(scope="module")
def references():
    return make_references()


def test_specimens_are_the_library_and_one_of_every_class():
    every = load_specimens(LIBRARY_PATH, Sizes())
    assert len(every) >= 64
    assert len({each.name for each in every}) == len(every)
    assert {each.class_name for each in every} == set(list_classes())


def test_gathering_is_the_same_with_any_number_of_workers(specimens, gathered):
    again = build_training_data(specimens, SIZES, 3, workers=2)
    np.testing.assert_array_equal(again.power, gathered.power)
    np.testing.assert_array_equal(again.tokens, gathered.tokens)


def test_gathered_strokes_come_back_from_disk(tmp_path, gathered):
    save_training_data(tmp_path / "g.safetensors", gathered)
    again = load_training_data(tmp_path / "g.safetensors")
    assert (again.names, again.classes, again.strokes) == (gathered.names, gathered.classes, gathered.strokes)
    np.testing.assert_array_equal(again.power, gathered.power)
    with pytest.raises(FileError):
        load_training_data(tmp_path / "none.safetensors")
    (tmp_path / "bad.safetensors").write_bytes(b"not tensors")
    with pytest.raises(FileError):
        load_training_data(tmp_path / "bad.safetensors")


def test_another_patch_is_of_the_same_material(gathered):
    for stroke, there in zip(
        gathered.strokes, gathered.draw_alternative_patches(np.random.default_rng(0)), strict=True
    ):
        assert gathered.material[there] == gathered.material[stroke.surface]
        assert (there == stroke.surface) == (gathered.material[stroke.surface] < 0)


def test_later_variants_are_described_by_another_patch(gathered):
    strokes = gathered.strokes[:4]
    elsewhere = gathered.draw_alternative_patches(np.random.default_rng(0))[:4]
    data = build_training_set(CONFIG, strokes, gathered.tokens, gathered.power[:4], 2, 0, [elsewhere, elsewhere])
    moved = [dataclasses.replace(s, surface=e) for s, e in zip(strokes, elsewhere, strict=True)]
    there = build_training_set(CONFIG, moved, gathered.tokens, gathered.power[:4], 1, 0)
    torch.testing.assert_close(data.x[2], there.x[0])
    torch.testing.assert_close(data.prior[2], there.prior[0])
    assert len(data.x) == 4
    assert not torch.allclose(data.x[0], data.x[2])


def test_leaving_classes_out_leaves_none_of_their_strokes(gathered):
    kept = select_classes(gathered, ["oak-wood"])
    found = {gathered.classes[m] for m in kept.get_stroke_materials() if m >= 0}
    assert found == {"oak-wood"}
    assert np.sum(kept.get_stroke_materials() < 0) == SIZES.random * SIZES.random_strokes


def test_the_same_seed_fits_the_same_field(gathered):
    first, again = (fit_shared_field(gathered, PLAN, CONFIG, 1).to_numpy_parameters() for _ in range(2))
    for name in first:
        np.testing.assert_array_equal(first[name], again[name])


def test_ranges_are_where_the_strokes_lay(gathered):
    ranges = collect_training_ranges(gathered, SIZES.seconds)
    forces = [stroke.force for stroke in gathered.strokes]
    assert ranges.force == pytest.approx((min(forces), max(forces)))
    assert ranges.probes == ("finger", "pen")
    assert ranges.mechanics["friction"].unknown


def test_reference_distances_are_zero_to_self_and_in_decibels(references):
    assert compute_distances_db(references, references.spectra) == pytest.approx(0.0, abs=1e-12)
    assert compute_distances_db(references, references.spectra * 10.0**0.1) == pytest.approx(1.0)
    assert (references.scatter_db > 0.0).all()
    assert float(np.median(references.scatter_db)) < 2.0


def test_references_round_trip_and_mismatched_ones_are_refused(tmp_path, references, specimens):
    save_references(tmp_path / "r.safetensors", references)
    again = load_references(tmp_path / "r.safetensors", specimens, CONDITIONS)
    np.testing.assert_array_equal(again.spectra, references.spectra)
    with pytest.raises(FileError):
        load_references(tmp_path / "r.safetensors", specimens[:2], CONDITIONS)
    with pytest.raises(FileError):
        load_references(tmp_path / "r.safetensors", specimens, make_middle_conditions())


def test_distances_come_material_by_material(references, gathered):
    whole = compute_new_patch_distances_db(network(), references)
    assert whole.shape == (4,)
    assert compute_new_patch_distances_db(network(), select_materials(references, [2]))[0] == pytest.approx(
        whole[2], rel=1e-4
    )


def test_expectation_hears_the_condition(references):
    tokens = references.tokens[:, 0]
    known = predict_spectra(network(), references, tokens)
    assert known.shape == references.spectra.shape
    assert not np.allclose(known, predict_spectra(network(), references, tokens, mechanics_known=False))
