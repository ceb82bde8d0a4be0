"""A material with a field of its own: one file, and a stroke over several of them."""

from __future__ import annotations

import json
import tomllib
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from live_strokes import states

from hnf_core.action.primitive_path import primitive_action
from hnf_core.action.primitives import DEFAULT_PRIMITIVE
from hnf_core.cli.train_needs import LEAST_PYTHON, PACKAGES
from hnf_core.errors import FileError, StrokeError, WeightsError
from hnf_core.field.carriers import Carriers
from hnf_core.field.config import FieldConfig
from hnf_core.field.field import UNTRAINED, Field, initial_parameters
from hnf_core.field.learned import field_of, learned_material
from hnf_core.field.live.materials import synthesis_for_material
from hnf_core.field.parts import parts_of, synthesise_parts
from hnf_core.field.stroke import HeightProfile, StrokeInput, uniform_stroke
from hnf_core.field.synthesis import synthesise
from hnf_core.field.weights import field_bytes, load_field, own_material, parse_field
from hnf_core.material.hnf_file import parse_hnf
from hnf_core.material.library import find
from hnf_core.material.mechanics import UNKNOWN, Mechanics
from hnf_core.material.token import TOKEN_DIM

LICENCE = "for a test"
ACTION = primitive_action(DEFAULT_PRIMITIVE, seed=0)
STATES = len(ACTION.speed)


def trained(name: str, seed: int, token=None, mechanics=UNKNOWN) -> Field:
    """Small, and as own_material.train_own leaves it."""
    config = FieldConfig(hidden=8, layers=1, states=1, carriers=Carriers(arc_octaves=0), physics=False)
    values = [0.0] * TOKEN_DIM if token is None else [float(value) for value in token]
    told = json.dumps({"name": name, "token": values, "mechanics": asdict(mechanics)})
    made = Field(config, initial_parameters(config, seed), metadata={"material": told, "licence": LICENCE})
    return parse_field(field_bytes(made), "test")


ROUGH, OTHER = trained("Rough one", 1), trained("Another", 2)
OAK, SLATE = find("oak-wood"), find("slate")


def stroke_over(*fields: Field | None) -> StrokeInput:
    """Equal thirds, halves … of the stroke on oak and slate in turn, each with its field."""
    known = [(OAK, SLATE)[at % 2] for at in range(len(fields))]
    index = (np.arange(STATES) * len(fields) // STATES).astype(np.int32)
    return StrokeInput(
        ACTION, np.stack([each.token for each in known]), tuple(each.mechanics for each in known), index, fields=fields
    )


def test_a_learned_material_keeps_its_weights_licence_and_what_is_known_of_its_token() -> None:
    weights = field_bytes(ROUGH)
    material = learned_material(weights, "test")
    assert (material.name, material.licence, material.field) == ("Rough one", LICENCE, weights)
    assert not material.token.known.any()
    assert learned_material(field_bytes(trained("Oak", 1, OAK.token)), "test").token.known.all()
    again = parse_hnf(material.to_bytes(), "test")
    assert again == material
    assert again != replace(material, field=b"")
    read = field_of(again)
    assert read is not None
    assert read.identity == ROUGH.identity
    assert field_of(replace(material, field=b"")) is None


@pytest.mark.parametrize("name", ["x" * 80, "größer als je zuvor, " * 4, "two\nlines", "\n"])
def test_any_name_that_data_give_becomes_one_that_a_file_takes(name: str) -> None:
    assert learned_material(field_bytes(trained(name, 1)), "test").name.strip()


def test_damaged_weights_are_refused_and_said() -> None:
    material = learned_material(field_bytes(ROUGH), "test")
    with pytest.raises(FileError, match="ends early"):
        parse_hnf(material.to_bytes()[:-1], "test")
    with pytest.raises(WeightsError, match="Rough one"):
        field_of(replace(material, field=material.field[:-9]))
    with pytest.raises(WeightsError, match="one material"):
        learned_material(field_bytes(load_field()), "test")
    with pytest.raises(WeightsError, match="stiffness"):
        learned_material(field_bytes(trained("Ghost", 1, mechanics=Mechanics(0.0))), "test")


def test_without_a_field_of_its_own_a_stroke_is_what_it_was() -> None:
    plain = uniform_stroke(ACTION, OAK.token, OAK.mechanics)
    for stroke in (plain, replace(plain, fields=(None,))):
        made = synthesise_parts(load_field(), stroke, seed=3).signal
        assert made.samples.tobytes() == synthesise(load_field(), plain, seed=3).signal.samples.tobytes()


def test_on_its_material_alone_a_field_is_asked_as_it_was_trained() -> None:
    """Its own token and mechanics, and no drawn relief under the path: as `hnf synth --weights` does."""
    over = replace(stroke_over(ROUGH, ROUGH), profile=HeightProfile(1e-4, 0.0, np.ones(64), 1e-3))
    own = own_material(ROUGH, "test")
    wanted = synthesise(ROUGH, uniform_stroke(ACTION, own.token, own.mechanics), seed=5)
    made = synthesise_parts(load_field(), over, seed=5)
    assert made.signal.samples.tobytes() == wanted.signal.samples.tobytes()
    assert made.signal.provenance["field"] == ROUGH.identity
    assert made.confidence == wanted.confidence


def test_fields_that_were_never_saved_each_speak_for_themselves() -> None:
    one, other = (replace(each, identity=UNTRAINED) for each in (ROUGH, OTHER))
    parts = parts_of(load_field(), stroke_over(one, other, one))
    assert [part.field for part in parts if part.field is one or part.field is other] == [one, other]
    np.testing.assert_array_equal(sum(part.share for part in parts), np.ones(STATES))


def test_each_field_speaks_where_its_material_is_touched_and_fades_at_the_border() -> None:
    over = stroke_over(ROUGH, None, OTHER)
    parts = parts_of(load_field(), over)
    assert {part.field.identity for part in parts} == {ROUGH.identity, load_field().identity, OTHER.identity}
    made = synthesise_parts(load_field(), over, seed=5).signal
    np.testing.assert_array_equal(sum(part.share for part in parts), np.ones(STATES))
    step = round(made.sample_rate / ACTION.rate)
    for part in parts:
        alone = synthesise(part.field, part.stroke, seed=5).signal.samples
        inside = np.flatnonzero(part.share)
        at = np.arange(inside[0] * step, inside[-1] * step)
        np.testing.assert_array_equal(made.samples[at], alone[at])
        assert np.abs(alone[at]).max() > 0.0
    assert set(made.provenance["field"].split("+")) == {part.field.identity for part in parts}


def test_a_material_that_is_not_touched_costs_nothing() -> None:
    over = stroke_over(ROUGH, None)
    (only,) = parts_of(load_field(), replace(over, token_index=np.ones(STATES, dtype=np.int32)))
    assert only.field is load_field()
    assert only.share is None


def test_fields_that_do_not_fit_the_tokens_are_refused() -> None:
    with pytest.raises(StrokeError, match="2 tokens but 1 fields"):
        replace(stroke_over(ROUGH, None), fields=(ROUGH,))


def test_a_hand_feels_the_field_that_a_material_brings() -> None:
    own = own_material(ROUGH, "test")
    given = synthesis_for_material(learned_material(field_bytes(ROUGH), "test"), seed=1)
    wanted = synthesis_for_material(own, seed=1, field=ROUGH)
    shared = synthesis_for_material(own, seed=1)
    hand = states(uniform_stroke(ACTION, own.token, own.mechanics))[:60]
    heard = [np.concatenate([each.step(state) for state in hand]) for each in (given, wanted, shared)]
    np.testing.assert_array_equal(heard[0], heard[1])
    assert not np.array_equal(heard[0], heard[2])


def test_what_an_external_python_is_asked_for_is_what_the_project_pins() -> None:
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    pinned = {*project["dependencies"], *project["optional-dependencies"]["train"]}
    assert set(PACKAGES.values()) <= pinned
    assert project["requires-python"] == ">=" + ".".join(map(str, LEAST_PYTHON))
