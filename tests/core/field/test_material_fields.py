"""Materials with a field of their own, in one file, and strokes over several of them."""

from __future__ import annotations

import json
import tomllib
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from live_strokes import states

from hnf_core.action.primitive_path import make_primitive_action
from hnf_core.action.primitives import DEFAULT_PRIMITIVE
from hnf_core.diagnostics import MIN_TRAINING_PYTHON, TRAINING_PACKAGES
from hnf_core.errors import FileError, StrokeError, WeightsError
from hnf_core.field.carriers import Carriers
from hnf_core.field.field import UNTRAINED, Field, FieldConfig, initial_parameters
from hnf_core.field.live.synthesis import create_live_synthesis
from hnf_core.field.stroke import HeightProfile, StrokeInput, uniform_stroke
from hnf_core.field.synthesis import split_by_field, synthesise, synthesise_by_field
from hnf_core.field.weights import (
    build_learned_material,
    load_field,
    load_material_field,
    parse_field,
    read_trained_material,
    serialise_field,
)
from hnf_core.material.contact_model import UNKNOWN_MECHANICS, Mechanics
from hnf_core.material.hnf_file import parse_hnf
from hnf_core.material.library import get_material
from hnf_core.material.token import TOKEN_DIM

LICENCE = "for a test"
ACTION = make_primitive_action(DEFAULT_PRIMITIVE, seed=0)
STATES = len(ACTION.speed)


def trained(name: str, seed: int, token=None, mechanics=UNKNOWN_MECHANICS) -> Field:
    """Small, and as own_material.train_own leaves it."""
    config = FieldConfig(hidden=8, layers=1, states=1, carriers=Carriers(arc_octaves=0), physics=False)
    values = [0.0] * TOKEN_DIM if token is None else [float(value) for value in token]
    told = json.dumps({"name": name, "token": values, "mechanics": asdict(mechanics)})
    made = Field(config, initial_parameters(config, seed), metadata={"material": told, "licence": LICENCE})
    return parse_field(serialise_field(made), "test")


ROUGH, OTHER = trained("Rough one", 1), trained("Another", 2)
OAK, SLATE = get_material("oak-wood"), get_material("slate")


def stroke_over(*fields: Field | None) -> StrokeInput:
    """Equal thirds, halves … of the stroke on oak and slate in turn, each with its field."""
    known = [(OAK, SLATE)[at % 2] for at in range(len(fields))]
    index = (np.arange(STATES) * len(fields) // STATES).astype(np.int32)
    return StrokeInput(
        ACTION, np.stack([each.token for each in known]), tuple(each.mechanics for each in known), index, fields=fields
    )


def test_learned_materials_round_trip_weights_licence_and_token() -> None:
    weights = serialise_field(ROUGH)
    material = build_learned_material(weights, "test")
    assert (material.name, material.licence, material.field) == ("Rough one", LICENCE, weights)
    assert not material.token.known.any()
    assert build_learned_material(serialise_field(trained("Oak", 1, OAK.token)), "test").token.known.all()
    again = parse_hnf(material.to_bytes(), "test")
    assert again == material
    assert again != replace(material, field=b"")
    read = load_material_field(again)
    assert read is not None
    assert read.identity == ROUGH.identity
    assert load_material_field(replace(material, field=b"")) is None


@pytest.mark.parametrize("name", ["x" * 80, "größer als je zuvor, " * 4, "two\nlines", "\n"])
def test_any_name_that_data_give_becomes_one_that_a_file_takes(name: str) -> None:
    assert build_learned_material(serialise_field(trained(name, 1)), "test").name.strip()


def test_damaged_weights_are_refused_and_said() -> None:
    material = build_learned_material(serialise_field(ROUGH), "test")
    with pytest.raises(FileError, match="ends early"):
        parse_hnf(material.to_bytes()[:-1], "test")
    with pytest.raises(WeightsError, match="Rough one"):
        load_material_field(replace(material, field=material.field[:-9]))
    with pytest.raises(WeightsError, match="one material"):
        build_learned_material(serialise_field(load_field()), "test")
    with pytest.raises(WeightsError, match="stiffness"):
        build_learned_material(serialise_field(trained("Ghost", 1, mechanics=Mechanics(0.0))), "test")


def test_without_a_field_of_its_own_a_stroke_is_what_it_was() -> None:
    plain = uniform_stroke(ACTION, OAK.token, OAK.mechanics)
    for stroke in (plain, replace(plain, fields=(None,))):
        made = synthesise_by_field(load_field(), stroke, seed=3).signal
        assert made.samples.tobytes() == synthesise(load_field(), plain, seed=3).signal.samples.tobytes()


def test_a_field_on_its_own_material_renders_as_trained() -> None:
    """Its own token and mechanics, and no drawn relief under the path: as `hnf synth --weights` does."""
    over = replace(stroke_over(ROUGH, ROUGH), profile=HeightProfile(1e-4, 0.0, np.ones(64), 1e-3))
    own = read_trained_material(ROUGH, "test")
    wanted = synthesise(ROUGH, uniform_stroke(ACTION, own.token, own.mechanics), seed=5)
    made = synthesise_by_field(load_field(), over, seed=5)
    assert made.signal.samples.tobytes() == wanted.signal.samples.tobytes()
    assert made.signal.provenance["field"] == ROUGH.identity
    assert made.confidence == wanted.confidence


def test_fields_that_were_never_saved_each_speak_for_themselves() -> None:
    one, other = (replace(each, identity=UNTRAINED) for each in (ROUGH, OTHER))
    parts = split_by_field(load_field(), stroke_over(one, other, one))
    assert [part.field for part in parts if part.field is one or part.field is other] == [one, other]
    np.testing.assert_array_equal(sum(part.mask for part in parts), np.ones(STATES))


def test_fields_render_their_own_materials_and_fade_at_borders() -> None:
    over = stroke_over(ROUGH, None, OTHER)
    parts = split_by_field(load_field(), over)
    assert {part.field.identity for part in parts} == {ROUGH.identity, load_field().identity, OTHER.identity}
    made = synthesise_by_field(load_field(), over, seed=5).signal
    np.testing.assert_array_equal(sum(part.mask for part in parts), np.ones(STATES))
    step = round(made.sample_rate / ACTION.rate)
    for part in parts:
        alone = synthesise(part.field, part.stroke, seed=5).signal.samples
        inside = np.flatnonzero(part.mask)
        at = np.arange(inside[0] * step, inside[-1] * step)
        np.testing.assert_array_equal(made.samples[at], alone[at])
        assert np.abs(alone[at]).max() > 0.0
    assert set(made.provenance["field"].split("+")) == {part.field.identity for part in parts}


def test_a_material_that_is_not_touched_costs_nothing() -> None:
    over = stroke_over(ROUGH, None)
    (only,) = split_by_field(load_field(), replace(over, token_index=np.ones(STATES, dtype=np.int32)))
    assert only.field is load_field()
    assert only.mask is None


def test_fields_that_do_not_fit_the_tokens_are_refused() -> None:
    with pytest.raises(StrokeError, match="2 tokens but 1 fields"):
        replace(stroke_over(ROUGH, None), fields=(ROUGH,))


def test_a_hand_feels_the_field_that_a_material_brings() -> None:
    own = read_trained_material(ROUGH, "test")
    given = create_live_synthesis(build_learned_material(serialise_field(ROUGH), "test"), seed=1)
    wanted = create_live_synthesis(own, seed=1, field=ROUGH)
    shared = create_live_synthesis(own, seed=1)
    hand = states(uniform_stroke(ACTION, own.token, own.mechanics))[:60]
    heard = [np.concatenate([each.step(state) for state in hand]) for each in (given, wanted, shared)]
    np.testing.assert_array_equal(heard[0], heard[1])
    assert not np.array_equal(heard[0], heard[2])


def test_external_training_packages_match_the_project_pins() -> None:
    project = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    constraints = Path(__file__).parents[3] / "tools" / "requirements" / "constraints.txt"
    pinned = {*project["dependencies"], *constraints.read_text(encoding="utf-8").splitlines()}
    assert set(TRAINING_PACKAGES.values()) <= pinned
    assert project["requires-python"] == ">=" + ".".join(map(str, MIN_TRAINING_PYTHON))
