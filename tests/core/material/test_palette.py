"""The palette: one entry per distinct material, exact round trips, and detection of damage."""

from dataclasses import replace
from hashlib import sha256

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from hnf_core.errors import FileError, MaterialError
from hnf_core.material.contact_model import MECHANICS_NAMES, UNKNOWN_MECHANICS, Mechanics
from hnf_core.material.palette import MERGE_TOLERANCE, Palette, build_palette
from hnf_core.material.token import ALEXNET_ID, ENCODER_ID, TOKEN_DIM, split_encoders

finite = st.floats(-100, 100, width=32)
values = st.none() | st.floats(1e-3, 1e6)
three = st.builds(Mechanics, values, values, values)
mechanics = three | st.builds(Mechanics, *[values] * len(MECHANICS_NAMES))
tokens = hnp.arrays(np.float32, TOKEN_DIM, elements=finite)
entries = st.lists(st.tuples(tokens, mechanics, st.text(max_size=12)), max_size=5)


def palette_of(items: list) -> tuple[Palette, np.ndarray]:
    return build_palette([t for t, _, _ in items], [m for _, m, _ in items], [n for _, _, n in items])


@settings(max_examples=40, deadline=None)
@given(entries)
def test_a_stored_palette_comes_back_equal(items):
    palette, _ = palette_of(items)
    again = Palette.from_bytes(palette.to_bytes())
    assert again == palette
    assert np.array_equal(again.tokens, palette.tokens)
    assert (again.mechanics, again.names) == (palette.mechanics, palette.names)
    assert again.content_hash == palette.content_hash


@settings(max_examples=40, deadline=None)
@given(entries)
def test_every_index_maps_to_its_material_within_tolerance(items):
    palette, index = palette_of(items + items)
    assert np.array_equal(index[: len(items)], index[len(items) :])
    for (token, contact, name), i in zip(items + items, index, strict=True):
        assert (palette.names[i], palette.mechanics[i]) == (name, contact)
        assert np.max(np.abs(palette.tokens[i].astype(float) - token), initial=0.0) <= MERGE_TOLERANCE


@pytest.fixture
def pair() -> Palette:
    rng = np.random.default_rng(0)
    both = [rng.standard_normal(TOKEN_DIM).astype(np.float32) for _ in range(2)]
    return build_palette(both, [Mechanics(1e4, 0.1), UNKNOWN_MECHANICS], ["oak", "félt"])[0]


def test_near_tokens_merge_only_with_equal_name_and_mechanics():
    token = np.zeros(TOKEN_DIM, dtype=np.float32)
    near, far = token + np.float32(0.5 * MERGE_TOLERANCE), token + np.float32(2 * MERGE_TOLERANCE)
    stiff = Mechanics(1e5)
    palette, index = build_palette(
        [token, near, far, token, token], [UNKNOWN_MECHANICS] * 4 + [stiff], ["oak", "oak", "oak", "ash", "oak"]
    )
    assert index.tolist() == [0, 0, 1, 2, 3]
    assert palette.names == ("oak", "oak", "ash", "oak")


def test_any_flipped_bit_and_any_lost_tail_is_noticed(pair):
    data = pair.to_bytes()
    for place in range(len(data)):
        flipped = data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :]
        with pytest.raises(FileError, match="Bake the object again"):
            Palette.from_bytes(flipped)
    for end in range(0, len(data), 7):
        with pytest.raises(FileError):
            Palette.from_bytes(data[:end])
    with pytest.raises(FileError):
        Palette.from_bytes(data + b"\0")


def test_another_encoder_or_schema_is_refused_by_name(pair):
    other = Palette(pair.tokens, pair.mechanics, pair.names, encoder_id="alexnet-9")
    with pytest.raises(FileError, match="alexnet-9"):
        Palette.from_bytes(other.to_bytes())
    later = Palette(pair.tokens, pair.mechanics, pair.names, schema=99)
    with pytest.raises(FileError, match="schema 99"):
        Palette.from_bytes(later.to_bytes())


@pytest.mark.parametrize("names", [(ENCODER_ID,), (ALEXNET_ID,), (ALEXNET_ID, ENCODER_ID)])
def test_a_palette_keeps_the_makes_of_its_tokens(pair, names):
    made = build_palette(list(pair.tokens), pair.mechanics, pair.names, encoders=names)[0]
    again = Palette.from_bytes(made.to_bytes())
    assert set(split_encoders(again.encoder_id)) == set(names)
    assert (again == pair) == (names == (ENCODER_ID,))
    with pytest.raises(ValueError, match="unknown encoder 'other'"):
        build_palette(list(pair.tokens), pair.mechanics, pair.names, encoders=("other",))


def test_three_properties_are_written_as_by_version_0_1():
    rows = [np.arange(TOKEN_DIM, dtype=np.float32) / 8 - k for k in range(2)]
    palette, _ = build_palette(rows, [Mechanics(1e4, 0.1, 0.3), UNKNOWN_MECHANICS], ["oak", "félt"])
    data = palette.to_bytes()
    assert len(data) == 784
    assert sha256(data).hexdigest() == "a851aafc1c0339ba1f2b49d3d4d0ac9d800e28cdf862b909b587274f1d0c9107"
    assert palette.content_hash == "5c534257d645c0ad23a03f5f9cf441f6"


@pytest.mark.parametrize("name", MECHANICS_NAMES[3:])
def test_one_further_property_is_written_with_all_before_it(pair, name):
    """Also a zero, which is not unknown."""
    for value in (0.0, 0.7):
        richer = replace(pair, mechanics=(replace(pair.mechanics[0], **{name: value}), pair.mechanics[1]))
        again = Palette.from_bytes(richer.to_bytes())
        assert again.mechanics == richer.mechanics
        # Palettes from before pitch scattered had seven properties, and keep their bytes.
        width = 8 if name == "pitch_scatter_m" else 7
        assert f'"shape": [2, {width}]'.encode() in richer.to_bytes()
        assert richer.content_hash != pair.content_hash


def test_a_palette_of_another_number_of_properties_is_refused(pair):
    data = pair.to_bytes().replace(b'"shape": [2, 3]', b'"shape": [2, 4]')
    assert data != pair.to_bytes()
    with pytest.raises(FileError, match="4 properties"):
        Palette.from_bytes(data)


def test_other_programs_can_read_the_stored_form(pair):
    arrays = pytest.importorskip("safetensors.numpy").load(pair.to_bytes())
    assert np.array_equal(arrays["tokens"], pair.tokens)
    assert arrays["mechanics"][0, 0] == 1e4
    assert np.isnan(arrays["mechanics"][1]).all()


def test_parts_that_do_not_fit_are_refused(pair):
    with pytest.raises(MaterialError):
        Palette(pair.tokens, pair.mechanics, ("one",))
    with pytest.raises(MaterialError, match="finite"):
        Palette(np.full_like(pair.tokens, np.nan), pair.mechanics, pair.names)
