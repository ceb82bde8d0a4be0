"""A field's description on disk is either refused or loaded and rendered."""

from __future__ import annotations

import contextlib
import dataclasses
import json

import numpy as np
import pytest

from hnf_core.action.primitive_path import make_primitive_action
from hnf_core.action.primitives import DEFAULT_PRIMITIVE
from hnf_core.errors import WeightsError
from hnf_core.field.carriers import Carriers
from hnf_core.field.field import Field, FieldConfig, initial_parameters
from hnf_core.field.stroke import uniform_stroke
from hnf_core.field.synthesis import synthesise
from hnf_core.field.weights import parse_field, read_trained_material, serialise_field
from hnf_core.material.library import get_material
from hnf_core.safetensors_io import dump_tensors, load_tensors

CONFIG = FieldConfig(hidden=8, layers=1, states=2, carriers=Carriers((50.0, 100.0, 200.0), arc_octaves=2), arc_knots=5)
TENSORS, METADATA = load_tensors(serialise_field(Field(CONFIG, initial_parameters(CONFIG, 0))))
ARCHITECTURE = json.loads(METADATA["architecture"])
OAK = get_material("oak-wood")
STROKE = uniform_stroke(make_primitive_action(DEFAULT_PRIMITIVE, seed=0), OAK.token, OAK.mechanics)
STRANGE = (-1, 0, 0.5, 17, 1e300, 10**400, float("nan"), float("inf"), True, None, "x", [], {}, [[1.0]], [2.0, 1.0])


def read(architecture: object) -> Field:
    return parse_field(dump_tensors(TENSORS, {**METADATA, "architecture": json.dumps(architecture)}), "w.safetensors")


def changed(name: str, value: object) -> object:
    """The architecture with one entry replaced, "carriers.NAME" = of its carriers."""
    outer, _, inner = name.partition(".")
    return {**ARCHITECTURE, outer: {**ARCHITECTURE[outer], inner: value} if inner else value}


NAMES = [*ARCHITECTURE, *(f"carriers.{field.name}" for field in dataclasses.fields(Carriers))]


@pytest.mark.parametrize("name", NAMES)
def test_any_description_is_refused_or_renders_finite_samples(name: str) -> None:
    for value in STRANGE:
        with contextlib.suppress(WeightsError):
            field = read(changed(name, value))
            assert np.isfinite(synthesise(field, STROKE, seed=1).signal.samples).all()


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("spacing_s", 0.0075, "a whole multiple of 0.005 s"),
        ("spacing_s", 0.002, "a whole multiple of 0.005 s"),
        ("spacing_s", -0.01, "spacing_s must lie between 0 and 1"),
        ("spacing_s", float("nan"), "spacing_s must lie between 0 and 1"),
        ("spacing_s", "x", "spacing_s is 'x', not of kind float"),
        ("spacing_s", None, "spacing_s is None, not of kind float"),
        ("spacing_s", True, "spacing_s is True, not of kind float"),
        ("hidden", "x", "hidden is 'x', not of kind int"),
        ("carriers.arc_octaves", "x", "arc_octaves is 'x', not of kind int"),
        ("action_octaves", 17, "action_octaves must lie between 0 and 16"),
        ("states", 2.0, "states is 2.0, not of kind int"),
        ("carriers.time_edges_hz", [200.0, 100.0, 50.0], "band 0 holds no bin"),
        ("carriers.time_edges_hz", [50.0, 50.1, 50.2], "holds no bin"),
        ("carriers.time_edges_hz", [50.0, 100.0, float("nan")], "time_edges_hz leave"),
        ("carriers.arc_start_per_m", -50.0, "arc carriers must lie between"),
        ("carriers.arc_octaves", 17, "arc_octaves must lie between 0 and 16"),
    ],
)
def test_it_is_said_what_cannot_be(name: str, value: object, words: str) -> None:
    with pytest.raises(WeightsError, match=words):
        read(changed(name, value))


@pytest.mark.parametrize("spacing_s", [0.0, 0.002, 0.0075, -0.01, 1.005, np.nan, np.inf])
def test_past_states_are_states_of_the_action(spacing_s: float) -> None:
    """Other distances were rounded to a state of the action in one place, to a sample in another."""
    with pytest.raises(ValueError, match=r"0\.005 s"):
        FieldConfig(spacing_s=spacing_s)
    assert [FieldConfig(spacing_s=0.005 * stride).stride for stride in range(1, 201)] == list(range(1, 201))
    assert FieldConfig(accumulation="heads", spacing_s=0.0).alpha_heads == 5


@pytest.mark.parametrize("spacing_s", [-0.01, 1.005, np.nan, np.inf])
def test_heads_of_one_state_are_a_second_apart_at_most(spacing_s: float) -> None:
    with pytest.raises(ValueError, match="between 0 and 1"):
        FieldConfig(accumulation="heads", spacing_s=spacing_s)


@pytest.mark.parametrize("text", ["[" * 100_000, '{"token": [1' + "0" * 400 + "]}", "[]", '{"token": "x"}'])
def test_a_material_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(WeightsError, match="one material"):
        read_trained_material(Field(CONFIG, {}, metadata={"material": text}), "w.safetensors")
    with pytest.raises(WeightsError, match="description"):
        parse_field(dump_tensors(TENSORS, {**METADATA, "architecture": text}), "w.safetensors")
