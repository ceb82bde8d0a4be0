"""A material as a file: what is written comes back, and nothing damaged gets in."""

from __future__ import annotations

import contextlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hnf_core.cli.main import main
from hnf_core.errors import FileError, MaterialError
from hnf_core.material.contact_model import MECHANICS_LIMITS, Mechanics
from hnf_core.material.hnf_file import (
    HNF_FORMAT,
    MAX_FILE_BYTES,
    MaterialFile,
    from_library,
    parse_hnf,
    read_hnf,
    with_library_defaults,
    write_hnf,
)
from hnf_core.material.library import Appearance, get_material, load_library
from hnf_core.material.token import ALEXNET_ID, ENCODER_ID, TOKEN_DIM, Token, band_slice

OAK = from_library(get_material("oak-wood"), "CC0-1.0")


def repacked(data: bytes, change) -> bytes:
    """The file with its header changed: change(header) edits the parsed JSON in place."""
    size = int.from_bytes(data[:8], "little")
    header = json.loads(data[8 : 8 + size])
    change(header)
    text = json.dumps(header).encode()
    return len(text).to_bytes(8, "little") + text + data[8 + size :]


finite = st.floats(-50.0, 50.0, width=32)
share = st.none() | st.floats(0.0, 1.0)
materials = st.builds(
    MaterialFile,
    name=st.text(st.characters(codec="utf-8", categories=["L", "N"]), min_size=1, max_size=12),
    token=st.builds(
        lambda values, known: Token(np.array(values, np.float32), np.array(known)),
        st.lists(finite, min_size=TOKEN_DIM, max_size=TOKEN_DIM),
        st.lists(st.booleans(), min_size=TOKEN_DIM, max_size=TOKEN_DIM),
    ),
    mechanics=st.builds(Mechanics, *(st.none() | st.floats(*limits) for limits in MECHANICS_LIMITS.values())),
    category=st.sampled_from(["", "wood", "metal"]),
    words=st.lists(st.text(max_size=8), max_size=4).map(tuple),
    appearance=st.builds(Appearance, st.none() | st.tuples(*[st.floats(0.0, 1.0)] * 3), share, share, share, share),
    licence=st.text(max_size=20),
)


@given(materials)
def test_what_is_written_comes_back(material: MaterialFile) -> None:
    back = parse_hnf(material.to_bytes(), "memory")
    assert back == material
    assert np.array_equal(back.token.values, material.token.values)
    assert np.array_equal(back.token.known, material.token.known)
    assert (back.name, back.words, back.licence) == (material.name, material.words, material.licence)
    assert (back.mechanics, back.appearance) == (material.mechanics, material.appearance)


def test_it_is_a_safetensors_file(tmp_path: Path) -> None:
    safetensors = pytest.importorskip("safetensors")
    write_hnf(tmp_path / "oak.hnf", OAK)
    with safetensors.safe_open(tmp_path / "oak.hnf", "np") as opened:
        assert set(opened.keys()) == {"token", "known"}
        assert np.array_equal(opened.get_tensor("token"), OAK.token.values)
        assert opened.metadata()["format"] == HNF_FORMAT
        metadata = opened.metadata()
    from safetensors.numpy import save

    others = save({"known": OAK.token.known, "token": OAK.token.values}, metadata=metadata)
    assert parse_hnf(others, "written by another") == OAK


def test_what_can_be_written_can_be_read_to_the_last_byte() -> None:
    """A field of too many units is refused where the material is made, not when its file is opened again."""
    room = MAX_FILE_BYTES - len(replace(OAK, field=bytes(MAX_FILE_BYTES - 4096)).to_bytes()) + MAX_FILE_BYTES - 4096
    largest = replace(OAK, field=bytes(room))
    assert len(largest.to_bytes()) == MAX_FILE_BYTES
    assert parse_hnf(largest.to_bytes(), "memory").field == largest.field
    for wrong in ({"field": bytes(room + 1)}, {"words": ("x" * MAX_FILE_BYTES,)}):
        with pytest.raises(MaterialError, match="16 MiB") as caught:
            replace(OAK, **wrong)
        assert "fewer units" in caught.value.remedy


def test_every_library_material_survives_the_file(tmp_path: Path) -> None:
    for material in load_library():
        path = tmp_path / f"{material.name}.hnf"
        write_hnf(path, from_library(material))
        back = read_hnf(path).complete(get_material("silk"))  # nothing of silk: all is known
        assert np.array_equal(back.token, material.token)
        assert (back.mechanics, back.name, back.words) == (material.mechanics, material.name, material.words)
        assert path.stat().st_size < 2000


def test_what_is_not_known_comes_from_the_library() -> None:
    known = np.zeros(TOKEN_DIM, dtype=bool)
    known[band_slice(2)] = True
    own = replace(OAK, token=Token(OAK.token.values, known), mechanics=Mechanics(friction=0.9))
    prior = get_material("silk")
    whole = own.complete(prior)
    assert np.array_equal(whole.token[band_slice(2)], OAK.token.values[band_slice(2)])
    assert np.array_equal(whole.token[~known], prior.token[~known])
    assert whole.mechanics == replace(prior.mechanics, friction=0.9)


def test_left_alone_it_is_completed_from_what_its_words_mean() -> None:
    nothing = Token(np.zeros(TOKEN_DIM, np.float32), np.zeros(TOKEN_DIM, bool))
    whole = with_library_defaults(
        MaterialFile("Grandmother's table", nothing, Mechanics(friction=0.5), "wood", ("oak",))
    )
    oak = get_material("oak-wood")
    assert np.array_equal(whole.token, oak.token)
    assert whole.mechanics == replace(oak.mechanics, friction=0.5)
    assert whole.name == "Grandmother's table"


@pytest.mark.parametrize("cut", [0, 4, 8, 100, -1])
def test_a_truncated_file_is_refused(tmp_path: Path, cut: int) -> None:
    path = tmp_path / "cut.hnf"
    path.write_bytes(OAK.to_bytes()[:cut])
    with pytest.raises(FileError, match=r"cut\.hnf.*ends early"):
        read_hnf(path)


@pytest.mark.parametrize("size", [MAX_FILE_BYTES + 1, 2**63, 2**64 - 1])
def test_a_huge_header_is_refused_unread(size: int) -> None:
    with pytest.raises(FileError, match="larger than any material, or something else"):
        parse_hnf(size.to_bytes(8, "little") + OAK.to_bytes()[8:], "huge.hnf")


def test_a_huge_file_is_not_read_whole(tmp_path: Path) -> None:
    path = tmp_path / "huge.hnf"
    with path.open("wb") as stream:
        stream.write(OAK.to_bytes())
        stream.truncate(1 << 33)  # sparse
    with pytest.raises(FileError, match="larger than any material, or something else"):
        read_hnf(path)


def test_a_file_names_the_makes_of_its_token() -> None:
    made = replace(OAK, encoder=ALEXNET_ID)
    assert parse_hnf(made.to_bytes(), "here").encoder == ALEXNET_ID
    assert made != OAK
    assert parse_hnf(OAK.to_bytes(), "here").encoder == ENCODER_ID


def test_another_encoder_is_refused_and_named() -> None:
    data = repacked(OAK.to_bytes(), lambda header: header["__metadata__"].update(encoder="other-9"))
    with pytest.raises(FileError, match=f"'other-9'.*'{ENCODER_ID}'"):
        parse_hnf(data, "other.hnf")


BROKEN = {
    "another format": lambda header: header["__metadata__"].update(format="hnf-material-9"),
    "no metadata": lambda header: header.pop("__metadata__"),
    "no name": lambda header: header["__metadata__"].pop("name"),
    "an empty name": lambda header: header["__metadata__"].update(name=" "),
    "a long name": lambda header: header["__metadata__"].update(name="x" * 64),
    "a name of two lines": lambda header: header["__metadata__"].update(name="a\nb"),
    "another shape": lambda header: header["token"].update(shape=[TOKEN_DIM - 1]),
    "two axes": lambda header: header["token"].update(shape=[1, TOKEN_DIM]),
    "another type": lambda header: header["token"].update(dtype="F16"),
    "no flags": lambda header: header.pop("known"),
    "offsets beyond the end": lambda header: header["token"].update(data_offsets=[1000, 1000 + 4 * TOKEN_DIM]),
    "offsets before the start": lambda header: header["token"].update(data_offsets=[-4, 4 * TOKEN_DIM - 4]),
    "flags that are numbers": lambda header: header["known"].update(data_offsets=[0, TOKEN_DIM]),
    "negative friction": lambda header: header["__metadata__"].update(mechanics='{"friction": -1.0}'),
    "no stiffness": lambda header: header["__metadata__"].update(mechanics='{"stiffness_n_m": 0.0}'),
    "huge damping": lambda header: header["__metadata__"].update(mechanics='{"damping_ratio": 1e200}'),
    "infinite stiffness": lambda header: header["__metadata__"].update(mechanics='{"stiffness_n_m": Infinity}'),
    "a huge whole number": lambda header: header["__metadata__"].update(mechanics=json.dumps({"friction": 10**400})),
    "an unknown property": lambda header: header["__metadata__"].update(mechanics='{"colour": 1.0}'),
    "roughness 2": lambda header: header["__metadata__"].update(appearance='{"roughness": 2.0}'),
    "two colour channels": lambda header: header["__metadata__"].update(appearance='{"base_color": [0, 1]}'),
    "words that are one word": lambda header: header["__metadata__"].update(words='"oak"'),
    "mechanics that are a list": lambda header: header["__metadata__"].update(mechanics="[1]"),
    "words that are no list": lambda header: header["__metadata__"].update(words="7"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_what_cannot_be_is_refused(name: str) -> None:
    with pytest.raises(FileError, match=r"bad\.hnf: is not a usable material file"):
        parse_hnf(repacked(OAK.to_bytes(), BROKEN[name]), "bad.hnf")


@pytest.mark.parametrize("data", [b"", b"\0" * 8, b"RIFF" * 20, b"\x10" + b"\0" * 7 + b"[" * 16])
def test_something_else_is_refused(data: bytes) -> None:
    with pytest.raises(FileError):
        parse_hnf(data, "else.hnf")


@given(st.integers(0, len(OAK.to_bytes()) - 1), st.integers(0, 255))
def test_whatever_byte_is_damaged_it_is_read_or_refused(place: int, value: int) -> None:
    data = bytearray(OAK.to_bytes())
    data[place] = value
    with contextlib.suppress(FileError):
        assert parse_hnf(bytes(data), "damaged.hnf").token.values.shape == (TOKEN_DIM,)


@pytest.mark.parametrize("value", [np.nan, np.inf, -101.0])
def test_a_token_that_is_not_finite_is_refused(value: float) -> None:
    values = OAK.token.values.copy()
    values[3] = value
    with pytest.raises(MaterialError, match="finite"):
        replace(OAK, token=Token(values, OAK.token.known))
    data = OAK.to_bytes()
    with pytest.raises(FileError, match="finite"):
        parse_hnf(data.replace(OAK.token.values.tobytes(), values.tobytes()), "nan.hnf")


def test_a_missing_file_says_so(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"none\.hnf"):
        read_hnf(tmp_path / "none.hnf")


def unused(_: object) -> int:
    raise AssertionError("touch was not asked for")


def test_the_command_line_exports_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "knit.hnf"
    assert main(["materials", "--export", "Wool knit", "--out", str(path)], unused) == 0
    assert read_hnf(path).name == "wool-knit"
    assert str(path) in capsys.readouterr().out


def test_the_command_line_says_what_is_missing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["materials", "--export", "oak-wood"], unused) == 2
    assert "--out" in capsys.readouterr().err
    assert main(["materials", "--export", "oakk-wood", "--out", str(tmp_path / "x.hnf")], unused) == 1
    assert "Did you mean oak-wood" in capsys.readouterr().err
    assert not (tmp_path / "x.hnf").exists()
