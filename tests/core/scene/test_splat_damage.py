"""Damaged splat files are refused in one line, a few broken splats dropped and counted; memory follows the block."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from splat_files import floats, inria_columns, ply_bytes, random_splats, write_compressed

from data_tools.write_splats import write_inria
from hnf_core.errors import FileError
from hnf_core.scene.ply import read_ply_header
from hnf_core.scene.splats import splat_file
from hnf_core.scene.splats.splat_file import iter_validated_splats, open_splat_file, read_splats, read_validated_splats


def in_a_folder(examples: int) -> settings:
    """Each example writes over the last one's files."""
    quiet = [HealthCheck.function_scoped_fixture]
    return settings(max_examples=examples, suppress_health_check=quiet, deadline=None)


FIELDS = ("means", "scales", "rotations", "opacities", "harmonics")
LAYOUTS = ["inria", "compressed", "ascii"]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """300 splats of degree 1 in three layouts."""
    folder = tmp_path_factory.mktemp("whole")
    splats = random_splats(300, 1)
    write_inria(folder / "inria.ply", splats)
    write_compressed(folder / "compressed.ply", splats)
    (folder / "ascii.ply").write_bytes(ply_bytes([("vertex", floats(inria_columns(splats)))], "ascii"))
    return {path.stem: path for path in folder.glob("*.ply")}


def refusal(path: Path) -> FileError:
    with pytest.raises(FileError) as caught:
        read_splats(path)
    assert caught.value.where == str(path)
    assert caught.value.remedy
    assert "\n" not in str(caught.value)
    return caught.value


def broken(values: dict[str, float]) -> bytes:
    """100 splats; some properties of one of them replaced, a different one for each."""
    columns = inria_columns(random_splats(100, 1))
    for place, (name, value) in enumerate(values.items()):
        columns[name] = columns[name].astype(np.float32)
        columns[name][place] = value
    return ply_bytes([("vertex", floats(columns))])


def test_broken_splats_are_dropped_and_counted(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    path.write_bytes(broken({}))
    sound = read_splats(path)
    nan, inf = float("nan"), float("inf")
    values = {"x": nan, "f_rest_8": inf, "rot_2": -inf, "scale_1": inf, "opacity": nan, "y": 1e30, "scale_0": 21.0}
    path.write_bytes(broken(values))
    found = read_validated_splats(path)
    assert (found.total, found.thickened) == (100, 0)
    assert found.dropped == {"not finite": 4, "too large": 3, "no rotation": 0}
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(found.splats, name), getattr(sound, name)[7:])


@pytest.mark.parametrize("length", [0.0, 1e-13, 1e300])
def test_a_splat_whose_rotation_has_no_direction_is_dropped(tmp_path: Path, length: float) -> None:
    columns = inria_columns(random_splats(100))
    for part in range(4):
        columns[f"rot_{part}"] = np.where(np.arange(100) == 40, length / 2.0, columns[f"rot_{part}"].astype(np.float64))
    (tmp_path / "a.ply").write_bytes(ply_bytes([("vertex", floats(columns, "double"))]))
    found = read_validated_splats(tmp_path / "a.ply")
    assert found.dropped == {"not finite": 0, "too large": 0, "no rotation": 1}
    assert len(found.splats) == 99


def test_extremes_that_mean_something_are_kept(tmp_path: Path) -> None:
    """A scale of 0 is flat; logits of ±∞, which unpacked files have, are opaque and clear."""
    columns = inria_columns(random_splats(20))
    columns["opacity"][:2] = [np.inf, -np.inf]
    columns["scale_2"][2:4] = [-np.inf, -1000.0]
    columns["scale_0"][4] = -20.5
    (tmp_path / "a.ply").write_bytes(ply_bytes([("vertex", floats(columns))]))
    found = read_validated_splats(tmp_path / "a.ply")
    assert (len(found.splats), found.thickened) == (20, 3)
    np.testing.assert_array_equal(found.splats.opacities[:2], [1.0, 0.0])
    np.testing.assert_allclose(found.splats.scales[[2, 3, 4], [2, 2, 0]], np.exp(-20.0), rtol=1e-6)
    assert (np.square(found.splats.scales) > 0.0).all()


def test_more_broken_splats_than_a_tenth_are_a_broken_file(tmp_path: Path) -> None:
    columns = inria_columns(random_splats(100))
    columns["z"][50:60] = np.nan
    path = tmp_path / "a.ply"
    path.write_bytes(ply_bytes([("vertex", floats(columns))]))
    assert len(read_splats(path)) == 90
    columns["z"][60] = np.nan
    path.write_bytes(ply_bytes([("vertex", floats(columns))]))
    assert "11 of its 100 splats cannot be used" in str(refusal(path))
    readings = iter_validated_splats(path, open_splat_file(path), 10)
    assert [sum(next(readings).dropped.values()) for _ in range(10)] == [0] * 5 + [10, 1, 0, 0, 0]
    with pytest.raises(FileError, match="11 of its 100"):
        next(readings)


@pytest.mark.parametrize("layout", LAYOUTS)
@in_a_folder(10)
@given(kept=st.floats(0.0, 0.999))
def test_a_cut_file_says_how_much_is_there(whole: dict[str, Path], tmp_path: Path, layout: str, kept: float) -> None:
    path = tmp_path / "a.ply"
    begin = read_ply_header(whole[layout]).data_offset
    data = whole[layout].read_bytes()
    size = int(kept * (len(data) - begin))
    path.write_bytes(data[: begin + size])
    # INRIA: 26 floats a splat. Compressed: 2 chunks of 18 floats, 4 words and 9 bytes a splat, one after the other.
    there = {
        "ascii": data[begin : begin + size].count(b"\n"),
        "inria": size // 104,
        "compressed": max(0, size - 144 - 300 * 16) // 9,
    }[layout]
    assert f"is cut short: {there} of its 300 splats are there." in str(refusal(path))
    if layout != "ascii":  # whose end only reading finds
        with pytest.raises(FileError, match="cut short"):
            open_splat_file(path)


def sound_or_refused(path: Path) -> None:
    try:
        splats = read_splats(path)
    except FileError:
        refusal(path)
        return
    assert len(splats) > 0
    assert all(np.isfinite(getattr(splats, name)).all() for name in FIELDS)
    assert (splats.scales > 0.0).all()
    assert ((splats.opacities >= 0.0) & (splats.opacities <= 1.0)).all()
    np.testing.assert_allclose(np.linalg.norm(splats.rotations, axis=1), 1.0, atol=1e-6)


@pytest.mark.parametrize(("layout", "numbers"), [("inria", 17), ("compressed", 18)])
def test_a_signalling_nan_is_no_worse_than_another(
    whole: dict[str, Path], tmp_path: Path, layout: str, numbers: int
) -> None:
    """Bits that complain when float32 is widened; numpy warns of it."""
    data, path = whole[layout].read_bytes(), tmp_path / "a.ply"
    begin = read_ply_header(whole[layout]).data_offset
    for number in range(numbers):
        at = begin + 4 * number
        path.write_bytes(data[:at] + b"\x00\x00\xa0\x7f" + data[at + 4 :])
        sound_or_refused(path)


@pytest.mark.parametrize("layout", LAYOUTS)
@in_a_folder(60)
@given(data=st.data())
def test_flipped_bytes_give_an_error_or_sound_splats(
    whole: dict[str, Path], tmp_path: Path, layout: str, data: st.DataObject
) -> None:
    """In the header as often as in the data."""
    path = tmp_path / "a.ply"
    begin = read_ply_header(whole[layout]).data_offset
    changed = bytearray(whole[layout].read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        ends = data.draw(st.sampled_from([(0, begin - 1), (begin, len(changed) - 1)]))
        changed[data.draw(st.integers(*ends))] = data.draw(st.integers(0, 255))
    path.write_bytes(bytes(changed))
    sound_or_refused(path)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("element vertex 300", "element vertex 0", "it is empty"),
        ("element vertex 300", "element vertex 999999999999999999", "300 of its 999999999999999999 splats"),
        ("element vertex 300", "element vertex " + "9" * 5000, "cannot be read"),
        ("element vertex 300", "element vertex -5", "cannot be read"),
        ("property float x", "property float x\nproperty", "'property' cannot be read"),
        ("property float x", "property float", "'property float' cannot be read"),
        ("element vertex 300", "element vertex 300\nelement vertex 300", "cannot be read"),
        ("property float x\n", "property int x\n", "'x' is of the wrong type"),
        ("property float x\n", "property list uchar float x\n", "'x' is of the wrong type"),
        ("property float x\n", "property flaot x\n", "'x' is of the wrong type"),
        ("property float nx\n", "property list uchar float nx\n", "'nx' is a list or of an unknown type"),
        ("property float x\n", "property float u\n", "no property 'x'"),
        ("property float nx\n", "property float x\n", "names a property twice"),
        ("property float scale_1\n", "property float size_1\n", "no property 'scale_1'"),
        ("property float f_rest_8\n", "property float other\n", "has 8 color coefficients"),
        ("property float f_rest_8\n", "property float f_rest_x\n", "no property 'f_rest_8'"),
        ("binary_little_endian", "binary_middle_endian", "its format 'binary_middle_endian' is not one of"),
        ("property float opacity\n", "property float alpha\n", "holds no Gaussian splats"),
        ("end_header", "end_of_header", "no PLY header"),
        ("ply\n", "plx\n", "no PLY header"),
    ],
)
def test_a_header_that_does_not_fit_is_refused(
    whole: dict[str, Path], tmp_path: Path, old: str, new: str, message: str
) -> None:
    path = tmp_path / "a.ply"
    data = whole["inria"].read_bytes()
    assert old.encode() in data
    path.write_bytes(data.replace(old.encode(), new.encode(), 1))
    assert message in str(refusal(path))


def test_an_absurd_count_of_an_ascii_file_takes_no_room(
    whole: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not even once some of it was found to be there."""
    monkeypatch.setattr(splat_file, "ROWS_PER_BLOCK", 100)
    path = tmp_path / "a.ply"
    path.write_bytes(whole["ascii"].read_bytes().replace(b"vertex 300", b"vertex 999999999999999999"))
    assert "cut short: 300 of its 999999999999999999" in str(refusal(path))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("element chunk 2", "element chunk 1", "300 splats need 2 chunks of 256, and it has 1"),
        ("element sh 300", "element sh 299", "harmonics of 299 splats for 300"),
        ("property uchar f_rest_8", "property char f_rest_8", "not one byte"),
        ("property uchar f_rest_8", "property uchar f_rest_8\nproperty uchar f_rest_9", "has 10 color coefficients"),
        ("property uchar f_rest_8", "property uchar f_rest_8\nproperty uchar more", "not one byte"),
        ("property float min_x", "property int min_x", "other properties"),
        ("property float max_b", "property float max_c", "other properties"),
        ("property uint packed_color", "property int packed_color", "other properties"),
    ],
)
def test_compressed_headers_that_do_not_fit_are_refused(
    whole: dict[str, Path], tmp_path: Path, old: str, new: str, message: str
) -> None:
    path = tmp_path / "a.ply"
    data = whole["compressed"].read_bytes()
    assert old.encode() in data
    path.write_bytes(data.replace(old.encode(), new.encode(), 1))
    assert message in str(refusal(path))


@pytest.mark.parametrize("suffix", [".spz", ".splat", ".ksplat", ".sog", ".SPZ", ".glb", ".gltf"])
def test_a_name_alone_makes_no_splats(tmp_path: Path, suffix: str) -> None:
    (tmp_path / f"a{suffix}").write_bytes(b"anything")
    assert "damaged" in str(refusal(tmp_path / f"a{suffix}"))


def test_missing_files_and_folders_are_named(tmp_path: Path) -> None:
    assert "cannot be read" in str(refusal(tmp_path / "gone.ply"))
    assert "cannot be read" in str(refusal(tmp_path))


@pytest.mark.parametrize("word", ["nothing", "1.0 2.0", "0x10"])
def test_ascii_data_are_numbers(whole: dict[str, Path], tmp_path: Path, word: str) -> None:
    head, end, data = whole["ascii"].read_bytes().partition(b"end_header\n")
    lines = data.split(b"\n")
    lines[7] = word.encode() + b" " + lines[7].partition(b" ")[2]
    (tmp_path / "a.ply").write_bytes(head + end + b"\n".join(lines))
    assert "a line of its data holds" in str(refusal(tmp_path / "a.ply"))


def test_memory_follows_the_block_and_not_the_file(tmp_path: Path) -> None:
    """The first of a million splats, of a file that is mostly a hole, come without the rest."""
    path = tmp_path / "a.ply"
    write_inria(path, random_splats(2000))
    head, end, data = path.read_bytes().partition(b"end_header\n")
    with path.open("wb") as stream:
        stream.write(head.replace(b"vertex 2000", b"vertex 1000000") + end + data)
        stream.truncate(stream.tell() + len(data) * 499)
    blocks = iter_validated_splats(path, open_splat_file(path), 1000)
    tracemalloc.start()
    first = [next(blocks).splats for _ in range(2)]
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert [len(piece) for piece in first] == [1000, 1000]
    assert path.stat().st_size > 60e6
    assert peak < 2e6


@pytest.mark.parametrize("layout", ["inria", "compressed"])
def test_a_stream_of_blocks_holds_one_at_a_time(tmp_path: Path, layout: str) -> None:
    splats = random_splats(4000, 2)
    path = tmp_path / "a.ply"
    (write_inria if layout == "inria" else write_compressed)(path, splats)

    def peak(chunk: int) -> int:
        tracemalloc.start()
        count = sum(len(reading.splats) for reading in iter_validated_splats(path, open_splat_file(path), chunk))
        _, highest = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert count == 4000
        return highest

    assert peak(100) < peak(4000) / 8
