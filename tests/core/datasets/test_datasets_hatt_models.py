"""HaTT texture models and their line spectral frequencies."""

from __future__ import annotations

import numpy as np
import pytest
from hatt_files import FORCES, SPEEDS, TRIANGLES, lsf_at, model_xml, read, values
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.datasets.hatt_models import lsf_from_polynomial, polynomial_from_lsf, read_texture_model
from hnf_core.errors import FileError
from hnf_lab.baselines.piecewise_ar import compute_power_spectrum

# --- line spectral frequencies -----------------------------------------------------------------------------------


@settings(max_examples=100, deadline=None)
@given(st.integers(1, 16), st.integers(0, 2**32))
def test_rising_frequencies_give_a_stable_filter_and_come_back(order, seed):
    gaps = np.random.default_rng(seed).uniform(0.2, 1.0, order + 1)
    lsf = np.pi * np.cumsum(gaps)[:-1] / gaps.sum()
    a = polynomial_from_lsf(lsf)
    assert a[0] == 1.0
    assert a.shape == (order + 1,)
    assert np.abs(np.roots(a)).max() < 1.0
    np.testing.assert_allclose(lsf_from_polynomial(a), lsf, atol=1e-6)


def test_the_first_order_filter_is_what_the_definition_says():
    # P = A + z⁻² A(1/z) has its root pair at the LSF: a = −cos ω
    np.testing.assert_allclose(polynomial_from_lsf([1.0]), [1.0, -np.cos(1.0)], atol=1e-15)


def test_many_filters_at_once_equal_one_by_one():
    rows = np.array([lsf_at(vertex, 8) for vertex in range(6)])
    np.testing.assert_array_equal(polynomial_from_lsf(rows), [polynomial_from_lsf(row) for row in rows])


@pytest.mark.parametrize("coefficients", [[1.0, -1.2], [1.0], [2.0, 0.1], [1.0, np.nan]])
def test_an_unstable_or_odd_filter_has_no_frequencies(coefficients):
    with pytest.raises(ValueError, match="filter"):
        lsf_from_polynomial(coefficients)


# --- reading -----------------------------------------------------------------------------------------------------


def test_a_file_is_read_into_si_units(tmp_path):
    model = read(tmp_path)
    np.testing.assert_allclose(model.speeds, np.array(SPEEDS) * 1e-3)
    np.testing.assert_allclose(model.forces, FORCES)
    np.testing.assert_array_equal(model.triangles + 1, TRIANGLES)
    np.testing.assert_allclose(model.ar_lsf, [lsf_at(vertex, 7) for vertex in range(9)])
    assert model.ma_lsf.shape == (9, 0)
    assert (model.material, model.sample_rate, model.friction) == ("Test Cloth", 10_000.0, 0.25)
    assert (model.max_speed, model.max_force) == (0.2, 4.0)
    assert model.notes == ()


@pytest.mark.parametrize(
    ("unit", "attribute", "factor"),
    [
        (("mm/s</SpeedUnits>", "m/s</SpeedUnits>"), "speeds", 1000.0),
        (("mm/s</SpeedUnits>", "CM/S</SpeedUnits>"), "speeds", 10.0),
        ((">N</ForceUnits>", "> mN </ForceUnits>"), "forces", 1e-3),
        (("m/s^2</AccelUnits>", "g</AccelUnits>"), "variances", 9.80665**2),
    ],
)
def test_other_units_are_converted(tmp_path, unit, attribute, factor):
    np.testing.assert_allclose(
        getattr(read(tmp_path, swap=[unit]), attribute), factor * getattr(read(tmp_path), attribute)
    )


def test_what_is_missing_is_taken_from_what_is_there_and_said(tmp_path):
    model = read(tmp_path, drop=("SpeedUnits", "maxSpeed", "speedList", "mu", "numMod", "ARlsf", "SampleRate"))
    np.testing.assert_allclose(model.speeds, np.array(SPEEDS) * 1e-3)
    np.testing.assert_allclose(model.ar_lsf, [lsf_at(vertex, 7) for vertex in range(9)], atol=1e-9)
    assert model.friction is None
    assert {note.partition(" ")[0] for note in model.notes} == {"SpeedUnits", "maxSpeed", "SampleRate"}


def test_models_parse_with_any_tag_case_and_plain_lists(tmp_path):
    text = model_xml().replace("<value>", " ").replace("</value>", "\n").replace("numTri", "NUMTRI")
    path = tmp_path / "odd.xml"
    path.write_text(text, encoding="utf-8")
    np.testing.assert_array_equal(read_texture_model(path).ar_lsf, read(tmp_path).ar_lsf)


BAD = {
    "wrong unit": ({"swap": [("mm/s", "furlongs")]}, "furlongs.*speed"),
    "not a number": ({"swap": [("<var>0.0</var>", "<var>loud</var>")]}, r"model 1, var.*loud"),
    "two variances": ({"swap": [("<var>0.0</var>", "<var>0 1</var>")]}, r"model 1, var.*2 numbers"),
    "NaN": ({"swap": [("<value>100.0</value>", "<value>nan</value>")]}, "speedList.*value 2 is not finite"),
    "count": ({"swap": [("<numMod>9<", "<numMod>8<")]}, "9 models, 8 announced"),
    "short list": ({"swap": [("<value>100.0</value>", "")]}, "speedList.*8 values for 9"),
    "negative variance": ({"swap": [("<var>0.05</var>", "<var>-1</var>")]}, "model 5, var"),
    "no variance": ({"drop": ("var",)}, "model 1, var"),
    "no such vertex": ({"swap": [("<value>7</value></tri>", "<value>17</value></tri>")]}, "tri 6.*between 1 and 9"),
    "no triangles": ({"drop": ("tri",)}, "0 triangles, 8 announced"),
    "flat": ({"swap": [(f'<tri type="array">{values(t)}', f"<tri>{values((1, 2, 3))}") for t in TRIANGLES]}, "no tri"),
    "no filters": ({"drop": ("ARlsf", "ARcoeff")}, "no autoregressive"),
    "unstable": ({"swap": [(values(lsf_at(4, 7)), values(lsf_at(4, 7)[::-1]))]}, "model 5, ARlsf.*rise"),
    "order": ({"swap": [(values(lsf_at(4, 7)), values(lsf_at(4, 6)))]}, "model 5, ARlsf"),
    "rate": ({"rate": "-1"}, "SampleRate.*not above 0"),
    "slow": ({"rate": "10"}, "SampleRate.*no rate of a texture"),
    "huge": ({"swap": [("<var>0.05</var>", "<var>1e300</var>")]}, "model 5, var.*beyond"),
    "friction": ({"swap": [("0.25", "-0.25")]}, "mu.*negative"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_file_is_refused_with_what_and_where(tmp_path, case):
    changes, message = BAD[case]
    with pytest.raises(FileError, match=rf"Models_Test Cloth\.xml.*{message}"):
        read(tmp_path, **changes)


BOMB = """<?xml version="1.0"?><!DOCTYPE a [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;">]><modelSet>&b;</modelSet>"""
OUTSIDE = """<?xml version="1.0"?><!DOCTYPE a SYSTEM "file:///etc/passwd"><modelSet/>"""


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "not well-formed"),
        (bytes(range(256)) * 20, "not well-formed"),
        (model_xml().encode()[:4000], "not well-formed"),
        (BOMB.encode(), "DTD"),
        (OUTSIDE.encode(), "DTD"),
        (b"<a>" * 5000, "nest deeper"),
        (b"<html><body/></html>", "no modelSet"),
        (b"<modelSet/>", "0 models"),
        (model_xml().encode("utf-16-le"), "not well-formed"),
    ],
    ids=["empty", "binary", "truncated", "bomb", "outside", "deep", "other", "bare", "encoding"],
)
def test_what_is_no_model_file_is_refused(tmp_path, content, message):
    path = tmp_path / "x.xml"
    path.write_bytes(content)
    with pytest.raises(FileError, match=message):
        read_texture_model(path)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(FileError, match="cannot read it"):
        read_texture_model(tmp_path / "none.xml")


@settings(max_examples=150, deadline=None)
@given(st.integers(0, len(model_xml()) - 1), st.binary(min_size=1, max_size=6))
def test_damage_anywhere_is_a_usable_model_or_a_file_error(tmp_path_factory, place, junk):
    data = model_xml().encode()
    path = tmp_path_factory.getbasetemp() / "damaged.xml"
    path.write_bytes(data[:place] + junk + data[place + len(junk) :])
    try:
        model = read_texture_model(path)
    except FileError:
        return
    assert np.isfinite(compute_power_spectrum(model, 0.05, 1.0, [10.0, 100.0, 1000.0])).all()
