"""A field and the makes of E whose tokens it was trained on."""

import json
from dataclasses import replace

import pytest

from hnf_core.errors import WeightsError
from hnf_core.field import weights
from hnf_core.field.field import Field
from hnf_core.field.weights import (
    EVERY_ENCODER_WEIGHTS,
    check_encoders,
    load_field,
    load_field_for_encoders,
    read_encoders,
    save_field,
)
from hnf_core.material.token import ALEXNET_ID, ENCODER_ID, ENCODER_NAMES, joined_encoders, split_encoders


def named(*names: str) -> Field:
    return replace(load_field(), metadata={"encoder": json.dumps(names)})


@pytest.mark.parametrize(
    ("text", "names"),
    [
        (ENCODER_ID, (ENCODER_ID,)),
        (json.dumps([ENCODER_ID, ALEXNET_ID]), (ENCODER_ID, ALEXNET_ID)),
        ("", ()),
        ("7", ("7",)),
    ],
)
def test_one_name_or_a_list_is_read(text, names):
    assert read_encoders({"encoder": text}) == names
    assert read_encoders({}) == ()


def test_the_list_survives_the_file(tmp_path):
    path = tmp_path / "f.safetensors"
    save_field(path, named(ENCODER_ID, ALEXNET_ID))
    field = load_field(path)
    assert read_encoders(field.metadata) == (ENCODER_ID, ALEXNET_ID)
    save_field(tmp_path / "g.safetensors", field)
    assert (tmp_path / "g.safetensors").read_bytes() == path.read_bytes()
    check_encoders(field, (ENCODER_ID, ALEXNET_ID))


def test_a_field_without_a_word_of_encoders_knows_the_librarys(tmp_path):
    field = replace(load_field(), metadata={})
    check_encoders(field, (ENCODER_ID,))
    save_field(tmp_path / "f.safetensors", field)
    assert read_encoders(load_field(tmp_path / "f.safetensors").metadata) == (ENCODER_ID,)


def test_tokens_of_another_make_are_refused_in_words():
    with pytest.raises(WeightsError, match=r"of encoder 'band-descriptor-1', .*'alexnet-bands-1'") as caught:
        check_encoders(named(ENCODER_ID), (ENCODER_ID, ALEXNET_ID), "f.safetensors")
    assert caught.value.remedy


def test_a_field_that_does_not_know_the_library_is_not_loaded(tmp_path):
    path = tmp_path / "f.safetensors"
    save_field(path, named(ALEXNET_ID))
    with pytest.raises(WeightsError, match="encoder"):
        load_field(path)


def test_makes_are_joined_in_one_order():
    assert split_encoders(joined_encoders(reversed(ENCODER_NAMES))) == ENCODER_NAMES
    assert joined_encoders([ENCODER_ID, ENCODER_ID]) == ENCODER_ID
    for text in ("", "other", "+".join(reversed(ENCODER_NAMES)), f"{ENCODER_ID}+{ENCODER_ID}"):
        with pytest.raises(ValueError, match="encoder"):
            split_encoders(text)


def test_the_field_that_knows_a_make_is_found() -> None:
    assert load_field_for_encoders(()) is load_field_for_encoders((ENCODER_ID,)) is load_field()
    every = load_field_for_encoders((ENCODER_ID, ALEXNET_ID))
    assert every.identity == load_field_for_encoders((ALEXNET_ID,)).identity != load_field().identity
    assert set(read_encoders(every.metadata)) == {ENCODER_ID, ALEXNET_ID}
    with pytest.raises(WeightsError, match="'other-9'"):
        load_field_for_encoders(("other-9",))


def test_where_it_was_left_out_that_is_said(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(weights, "EVERY_ENCODER_WEIGHTS", tmp_path / EVERY_ENCODER_WEIGHTS.name)
    with pytest.raises(WeightsError, match="not part of the Blender extension"):
        load_field_for_encoders((ALEXNET_ID,))
    assert load_field_for_encoders((ENCODER_ID,)) is load_field()
