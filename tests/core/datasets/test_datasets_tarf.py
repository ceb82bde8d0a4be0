"""TaRF: views, depth and DIGIT touches, divided by the split file of the data set."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from picture_files import MID_GREY, linear, write_picture

from hnf_core.datasets.tarf import TarfFolder, read_split
from hnf_core.errors import FileError, UsageError

SPLIT = {
    "train": [["hall_40_30", "0001"], ["hall_40_30", "0002"], ["desk_40_30", "0001"]],
    "val": [["hall_40_30", "0003"]],
    "test": [["desk_40_30", "0002"]],
}
ALL = sorted({tuple(pair) for pairs in SPLIT.values() for pair in pairs})


def write(folder: Path, split=SPLIT, scale="40_30", drop=()) -> TarfFolder:
    """The whole layout; drop: paths that are taken away again."""
    for scene, index in ALL:
        seen = scene.removesuffix("_40_30") + f"_{scale}"
        write_picture(folder / "vision" / seen / f"{index}.jpg", 96, 72, (MID_GREY, 20, 20))
        depth = np.full((72, 96, 1), 0.4, dtype=np.float32)
        depth[:, :12] = 40.0  # outside the middle square
        depth[:36, 12:] = 9.0
        (folder / "depth" / seen).mkdir(parents=True, exist_ok=True)
        np.save(folder / "depth" / seen / f"{index}.npy", depth)
        write_picture(folder / "touch" / scene / f"{index}.jpg", 64, 48, (30, 60, 90))
        write_picture(folder / "touch_bg" / scene / "bg.jpg", 64, 48, (90, 90, 90))
    if split is not None:
        (folder / "split_interval.json").write_text(json.dumps(split), encoding="utf-8")
    for path in drop:
        (folder / path).unlink()
    return TarfFolder(folder, scale=scale, side=32)


def test_the_split_file_decides(tmp_path):
    data = write(tmp_path)
    assert data.splits == ("train", "val", "test")
    train = data.split("train")
    assert train.locations == ("hall", "hall", "desk")
    assert train.labels == (None, None, None)
    assert [entry.rgb.name for entry in train.entries] == ["0001.jpg", "0002.jpg", "0001.jpg"]
    assert not any("left out" in note for note in train.notes)
    assert [len(data.split(name)) for name in ("val", "test")] == [1, 1]
    with pytest.raises(UsageError, match="train, val, test"):
        data.split("tset")


def test_a_pair_is_square_and_in_metres(tmp_path):
    pair = write(tmp_path).split("train")[0]
    assert pair.sensor == "digit"
    assert pair.where == "hall"
    assert pair.metres_per_pixel is None
    assert pair.rgb.shape == pair.touch.shape == pair.background.shape == (32, 32, 3)
    np.testing.assert_allclose(pair.rgb[..., 0], linear(MID_GREY), atol=0.02)
    np.testing.assert_allclose(pair.touch.mean((0, 1)), np.array([30, 60, 90]) / 255.0, atol=0.01)
    np.testing.assert_allclose(pair.background, 90 / 255.0, atol=0.01)
    # clipped at 5 m; rows stay rows; what lies beside the middle square is gone
    np.testing.assert_allclose(pair.depth_m[:16], 5.0)
    np.testing.assert_allclose(pair.depth_m[16:], 0.4)
    assert TarfFolder(tmp_path).split("train")[0].rgb.shape == (256, 256, 3)


def test_a_nested_folder_with_a_separate_split_file_loads(tmp_path):
    write(tmp_path / "pairs_recalib", split=None)
    (tmp_path / "pairs").mkdir()
    (tmp_path / "pairs" / "split_interval.json").write_text(json.dumps(SPLIT))
    assert len(TarfFolder(tmp_path).split("train")) == 3


def test_another_scale_of_the_views_goes_with_the_same_touches(tmp_path):
    train = write(tmp_path, scale="20_15").split("train")
    assert train.entries[0].rgb.parent.name == "hall_20_15"
    assert train.entries[0].touch.parent.name == "hall_40_30"
    with pytest.raises(FileError, match=r"no pair.*3 left out: no view.*_40_30"):
        TarfFolder(tmp_path).split("train")


def test_missing_partners_are_counted(tmp_path):
    drop = (
        "vision/hall_40_30/0001.jpg",
        "touch/hall_40_30/0002.jpg",
        "depth/desk_40_30/0001.npy",
        "touch_bg/desk_40_30/bg.jpg",
    )
    train = write(tmp_path, drop=drop).split("train")
    assert len(train) == 1
    assert {"1 left out: no view (vision)", "1 left out: no touch image", "1 have no depth",
            "1 have no background (touch_bg)"} <= set(train.notes)  # fmt: skip
    assert train[0].depth_m is None
    assert train[0].background is None


def test_no_pair_is_twice_in_a_split_or_in_two(tmp_path):
    pairs = SPLIT["train"]
    split = {
        "train": [*pairs, pairs[0]],
        "val": [pairs[1], ["hall_40_30", "0003"]],
        "test": [["hall", "0003"], ["desk", "0002"]],
    }
    data = write(tmp_path, split)
    parts = [[(e.where, e.rgb.stem) for e in data.split(name).entries] for name in data.splits]
    assert parts == [[("hall", "0001"), ("hall", "0002"), ("desk", "0001")], [("hall", "0003")], [("desk", "0002")]]
    assert "1 left out: named twice" in data.split("train").notes
    assert "1 left out: in an earlier split too" in data.split("val").notes
    assert "1 left out: in an earlier split too" in data.split("test").notes


@pytest.mark.parametrize(
    "pair", [["../hall", "1"], ["hall", "../../etc/passwd"], ["/etc", "passwd"], ["hall\\..", "1"], ["C:", "1"],
             ["", "1"], ["hall", ".."], ["a\0b", "1"]], ids=str,
)  # fmt: skip
def test_a_name_that_leads_out_is_refused(tmp_path, pair):
    with pytest.raises(FileError, match=r"split_interval\.json: train, pair 2: .*no names of files"):
        write(tmp_path, {"train": [["hall_40_30", "0001"], pair]}).split("train")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no JSON"),
        ("[" * 100_000, "no JSON"),
        ("[]", "no list of splits"),
        ("{}", "no list of splits"),
        ('{"train": {"a": 1}}', "'train' is no list"),
        ('{"train": [["hall"]]}', "pair 1: expected"),
        ('{"train": [["hall", 3]]}', "pair 1: expected"),
        ('{"train": ["hall"]}', "pair 1: expected"),
    ],
    ids=lambda text: text[:20],
)
def test_another_split_file_is_refused(tmp_path, text, message):
    write(tmp_path, split=None)
    (tmp_path / "split_interval.json").write_text(text)
    with pytest.raises(FileError, match=message):
        TarfFolder(tmp_path).split("train")


@settings(max_examples=60, deadline=None)
@given(st.recursive(st.none() | st.integers() | st.text(max_size=4), lambda x: st.lists(x, max_size=3), max_leaves=6))
def test_any_json_is_a_split_or_a_file_error(tmp_path_factory, content):
    path = tmp_path_factory.getbasetemp() / "any_split.json"
    path.write_text(json.dumps({"train": content}), encoding="utf-8")
    try:
        pairs = read_split(path)["train"]
    except FileError:
        return
    assert all(isinstance(part, str) and not set(part) & set("/\\\0") for pair in pairs for part in pair)


def test_folders_without_the_layout_are_refused(tmp_path):
    with pytest.raises(FileError, match="vision and touch are not in it"):
        TarfFolder(tmp_path / "none").split("train")
    with pytest.raises(FileError, match="vision and touch are not in it"):
        TarfFolder(tmp_path).split("train")
    with pytest.raises(FileError, match=r"split_interval\.json is not in it"):
        write(tmp_path, split=None).split("train")


def test_damaged_files_and_wrong_sizes_are_told_apart(tmp_path):
    pairs = write(tmp_path).split("train")
    write_picture(tmp_path / "touch_bg/hall_40_30/bg.jpg", 32, 48)
    with pytest.raises(FileError, match=r"bg\.jpg: is \(48, 32\), the touch image 0001\.jpg \(48, 64\)"):
        pairs[0]
    write_picture(tmp_path / "touch_bg/hall_40_30/bg.jpg", 64, 48)
    np.save(tmp_path / "depth/hall_40_30/0001.npy", np.zeros((72, 72, 1)))
    with pytest.raises(FileError, match=r"0001\.npy: is \(72, 72\), its view \(72, 96\)"):
        pairs[0]
    # the same view, stored smaller, is one view
    np.save(tmp_path / "depth/hall_40_30/0001.npy", np.full((36, 48, 1), 0.3))
    np.testing.assert_allclose(pairs[0].depth_m, 0.3, rtol=1e-6)
    (tmp_path / "touch/hall_40_30/0001.jpg").write_bytes(b"\xff\xd8 no more")
    with pytest.raises(FileError, match=r"touch/hall_40_30/0001\.jpg: cannot be read as a picture"):
        pairs[0]
    assert pairs[1].where == "hall"
