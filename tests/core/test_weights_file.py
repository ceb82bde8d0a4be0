"""Arrays in safetensors files, and weights that are checked when they are read."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from hnf_core import safetensors_io
from hnf_core.errors import FileError, WeightsError
from hnf_core.files import content_hash
from hnf_core.safetensors_io import (
    MAX_FILE_BYTES,
    WeightsKind,
    dump_tensors,
    load_tensors,
    pack_header,
    read_weights,
    read_weights_bytes,
    split_header,
)

KIND = WeightsKind("the thing", "thing-1", "this is no thing", "Make another.")
NAMES = st.text(min_size=1, max_size=12).filter(lambda name: name != "__metadata__" and name.isprintable())
TYPES = st.sampled_from(["f2", "f4", "f8", "i4", "i8", "u1", "?"])
TENSORS = st.dictionaries(
    NAMES, TYPES.flatmap(lambda kind: arrays.arrays(kind, arrays.array_shapes(min_dims=0, max_side=4))), max_size=4
)
METADATA = st.dictionaries(NAMES, st.text(max_size=20).filter(str.isprintable), max_size=4)


@given(TENSORS, METADATA)
def test_what_is_packed_comes_back(tensors, metadata):
    again, told = load_tensors(dump_tensors(tensors, metadata))
    assert told == metadata
    assert again.keys() == tensors.keys()
    for name, value in tensors.items():
        assert (again[name].dtype, again[name].shape) == (value.dtype, value.shape)
        assert again[name].tobytes() == value.tobytes()


@given(TENSORS, METADATA)
def test_equal_content_gives_equal_bytes(tensors, metadata):
    turned = [dict(reversed(part.items())) for part in (tensors, metadata)]
    assert dump_tensors(*turned) == dump_tensors(tensors, metadata)


@given(TENSORS, METADATA)
def test_packing_what_was_unpacked_changes_nothing(tensors, metadata):
    data = dump_tensors(tensors, metadata)
    assert dump_tensors(*load_tensors(data)) == data


@given(st.binary(max_size=80))
@example(b"\x08\x00\x00\x00\x00\x00\x00\x00[1, 2]  ")
@example(b"\xff" * 40)
@example(b"PK\x03\x04" + bytes(60))
def test_other_bytes_are_refused(data):
    try:
        tensors, metadata = load_tensors(data)
    except ValueError as error:
        assert "damaged or not a safetensors file" in str(error)  # noqa: PT017
    else:
        assert dump_tensors(tensors, metadata)


def test_a_file_that_ends_early_is_refused_wherever_it_ends():
    data = dump_tensors({"a": np.arange(5.0)}, {"b": "c"})
    for length in range(len(data)):
        with pytest.raises(ValueError, match="damaged"):
            load_tensors(data[:length])


def test_numbers_that_numpy_does_not_know_are_refused():
    header = json.dumps({"a": {"dtype": "BF16", "shape": [2], "data_offsets": [0, 4]}}).encode()
    with pytest.raises(ValueError, match="BF16"):
        load_tensors(len(header).to_bytes(8, "little") + header + bytes(4))


def written(path: Path, tensors: dict, metadata: dict | None = None) -> Path:
    path.write_bytes(dump_tensors(tensors, {"format": "thing-1", **(metadata or {})}))
    return path


def test_good_weights_are_read_in_single_precision(tmp_path):
    half = np.linspace(-3, 3, 7, dtype=np.float16)
    path = written(tmp_path / "w.safetensors", {"a": half, "b": np.float32([[1.5]])}, {"seed": "7"})
    file = read_weights(path, KIND)
    found = file.check_parameters({"a": (7,), "b": (1, 1)})
    assert {value.dtype for value in found.values()} == {np.dtype(np.float32)}
    np.testing.assert_array_equal(found["a"], half)
    assert file.parse_metadata(lambda metadata: int(metadata["seed"])) == 7
    assert file.content_id == content_hash(path.read_bytes())


SHAPES = {"a": (2,), "b": (1, 2)}
GOOD = {"a": np.zeros(2, "f4"), "b": np.zeros((1, 2), "f4")}


@pytest.mark.parametrize(
    ("change", "stored", "told"),
    [
        ({"c": np.zeros(1, "f4")}, np.floating, r"do not fit the architecture: \[\('c'"),
        ({"a": np.zeros((2, 1), "f4")}, np.floating, "do not fit the architecture: .*'a'"),
        ({"a": None}, np.floating, "do not fit the architecture: .*'a'"),
        ({"a": np.zeros(2, "i8")}, np.floating, "a is int64, not floating"),
        ({"a": np.zeros(2, "?")}, np.floating, "a is bool"),
        ({"b": np.zeros((1, 2), "f2")}, np.float32, "b is float16, not float32"),
        ({"a": np.array([0, np.nan], "f2")}, np.floating, "a is not all finite"),
        ({"b": np.array([[np.inf, 0]], "f4")}, np.float32, "b is not all finite"),
        ({"a": np.array([0, 1e300])}, np.floating, "a is not all finite"),
    ],
)
def test_parameters_that_do_not_fit_are_named(tmp_path, change, stored, told):
    tensors = {name: value for name, value in {**GOOD, **change}.items() if value is not None}
    file = read_weights(written(tmp_path / "w.safetensors", tensors), KIND)
    with pytest.raises(WeightsError, match=told) as caught:
        file.check_parameters(SHAPES, stored)
    assert "w.safetensors" in str(caught.value)
    assert caught.value.remedy == "Make another."


@pytest.mark.parametrize(
    "read",
    [
        lambda metadata: metadata["size"],
        lambda metadata: int(metadata["format"]),
        lambda metadata: json.loads("{"),
        lambda metadata: 1 + metadata,
    ],
)
def test_an_unreadable_description_is_refused(tmp_path, read):
    file = read_weights(written(tmp_path / "w.safetensors", GOOD), KIND)
    with pytest.raises(WeightsError, match="unreadable description") as caught:
        file.parse_metadata(read)
    assert caught.value.remedy == "Make another."


@pytest.mark.parametrize(("metadata", "found"), [({"format": "other-2"}, "other-2"), (None, "no format")])
def test_another_format_is_refused(tmp_path, metadata, found):
    (tmp_path / "w.safetensors").write_bytes(dump_tensors(GOOD, metadata))
    with pytest.raises(WeightsError, match=rf"this is no thing \({found}, not thing-1\)\. Make another"):
        read_weights(tmp_path / "w.safetensors", KIND)


def test_what_cannot_be_read_is_a_file_error(tmp_path):
    for path in (tmp_path / "none.safetensors", tmp_path):
        with pytest.raises(FileError, match="cannot read the thing") as caught:
            read_weights(path, KIND)
        assert caught.value.remedy == "Check the path."
    (tmp_path / "w.safetensors").write_bytes(b"pickle")
    with pytest.raises(WeightsError, match=r"w\.safetensors: damaged .* Get the file again"):
        read_weights(tmp_path / "w.safetensors", KIND)


def test_a_huge_file_is_refused_unread(tmp_path):
    path = tmp_path / "huge.safetensors"
    with path.open("wb") as stream:
        stream.truncate(MAX_FILE_BYTES + 1)
    with pytest.raises(WeightsError, match=r"larger than any weights \(1024 MiB\)"):
        read_weights(path, KIND)


def test_the_largest_file_is_still_read(tmp_path, monkeypatch):
    path = tmp_path / "large"
    path.write_bytes(bytes(100))
    monkeypatch.setattr(safetensors_io, "MAX_FILE_BYTES", 100)
    assert read_weights_bytes(path, "it", "") == bytes(100)
    path.write_bytes(bytes(101))
    with pytest.raises(WeightsError, match="larger"):
        read_weights_bytes(path, "it", "")


@given(st.dictionaries(st.text(max_size=8), st.text(max_size=8) | st.integers(), max_size=5), st.binary(max_size=40))
def test_a_header_and_what_follows_it_come_back(header: dict[str, object], body: bytes) -> None:
    data = pack_header(header) + body
    assert (len(data) - len(body)) % 8 == 0
    assert split_header(data) == (header, body)
    for cut in (0, 7, len(data) - len(body) - 1):
        with pytest.raises(ValueError, match="ends early"):
            split_header(data[:cut])
    with pytest.raises(ValueError, match="no JSON object"):
        split_header((2).to_bytes(8, "little") + b"[]")
