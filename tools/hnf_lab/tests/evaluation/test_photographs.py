"""Judge of looks: laws of calibration and accuracy; photographs of a made-up copy of HaTT in Blender."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.errors import FileError
from hnf_core.material.library import get_material
from hnf_lab.evaluation.photographs.measure import (
    CALIBRATION_BINS,
    PhotographResult,
    compute_accuracy,
    compute_calibration,
    is_right,
    measure_photographs,
)
from hnf_lab.evaluation.photographs.report import format_photographs, to_json, write_picture
from hnf_lab.evaluation.recordings.measure import BASELINES, RecordedTexture, find_category
from hnf_lab.evaluation.recordings.spectra import FINE_HZ, Distance

answers = st.lists(st.tuples(st.floats(0.0, 1.0), st.booleans()), min_size=CALIBRATION_BINS, max_size=60)


def recorded(name: str) -> RecordedTexture:
    return RecordedTexture(name, find_category(name), (0,), np.ones((1, len(FINE_HZ))))


def result(name: str, material: str, named: bool = True, confidence: float = 0.5) -> PhotographResult:
    texture, taken = recorded(name), get_material(material)
    some = Distance(5.0, 3.0, 4.0)
    return PhotographResult(
        texture, named, material, taken.category, confidence, "", is_right(taken, texture), some,
        (some,) * len(BASELINES),
    )  # fmt: skip


@settings(max_examples=60, deadline=None)
@given(answers)
def test_calibration_bins_hold_every_answer(pairs) -> None:
    told, right = zip(*pairs, strict=True)
    error, bins = compute_calibration(told, right)
    assert 0.0 <= error <= 1.0
    assert bins[:, 2].sum() == len(pairs)
    assert np.ptp(bins[:, 2]) <= 1
    assert (np.diff(bins[:, 0]) >= -1e-12).all()
    assert np.average(bins[:, 1], weights=bins[:, 2]) == pytest.approx(np.mean(right))


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 20), st.floats(0.0, 1.0))
def test_who_is_sure_and_wrong_is_off_by_the_confidence(count, confidence) -> None:
    told = [confidence] * (CALIBRATION_BINS * count)
    assert compute_calibration(told, [False] * len(told))[0] == pytest.approx(confidence)
    assert compute_calibration(told, [True] * len(told))[0] == pytest.approx(1.0 - confidence)


def test_a_mean_over_kinds_counts_a_rare_kind_as_much() -> None:
    results = [result("Denim", "denim")] * 9 + [result("Granite", "oak-wood")]
    assert compute_accuracy(results) == (pytest.approx(0.9), pytest.approx(0.5))
    assert np.isnan(compute_accuracy([result("Blob", "denim")])[0])


@pytest.mark.parametrize(
    ("name", "material", "right"),
    [
        ("Leather 1", "suede", True),
        ("Terra Cotta", "terracotta", True),
        ("Carbon Fiber", "carbon-fibre", True),
        ("Sandpaper 100", "copy-paper", True),
        ("Denim", "oak-wood", False),
        ("Blob", "denim", False),
    ],
)
def test_kinds_are_compared_by_the_names_of_recordings(name, material, right) -> None:
    assert is_right(get_material(material), recorded(name)) is right


def test_the_report_has_every_table_and_a_picture(tmp_path: Path) -> None:
    results = [
        result(name, material, named, confidence)
        for named in (True, False)
        for name, material, confidence in (("Denim", "denim", 0.9), ("Granite", "oak-wood", 0.2), ("Cork", "cork", 0.6))
    ]
    text = format_photographs(results)
    for title in ("Distance from the recorded", "Identification", "Confidence", "nothing named", "Photographs"):
        assert title in text
    assert to_json(results)["modes"]["nothing named"]["right"] == pytest.approx(2.0 / 3.0)
    write_picture(tmp_path / "picture.png", results)
    assert (tmp_path / "picture.png").stat().st_size > 1000


def test_a_folder_without_photographs_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileError):
        measure_photographs(tmp_path, seconds=1.0)
