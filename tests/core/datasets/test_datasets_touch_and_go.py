"""Touch and Go: moments with two frames, labels by line, recordings never in two splits."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from picture_files import linear, write_picture

from hnf_core.datasets.touch_and_go import TouchAndGoFolder, read_labels
from hnf_core.errors import FileError, UsageError

RECORDINGS = ("20220601_182052", "20220607_133934")
MOMENTS = ("0000033833", "0000033834", "0000040000")
LABELS = "\n".join(f"{recording}/{moment}.jpg,{3 + i}" for i, recording in enumerate(RECORDINGS) for moment in MOMENTS)


def write(folder: Path, labels: str | None = LABELS, recordings=RECORDINGS, root="dataset", suffix=".jpg"):
    for recording in recordings:
        for moment in MOMENTS:
            write_picture(folder / root / recording / "video_frame" / f"{moment}{suffix}", 96, 54, (200, 100, 50))
            write_picture(folder / root / recording / "gelsight_frame" / f"{moment}{suffix}", 64, 48, (90, 120, 30))
    if labels is not None:
        (folder / "label.txt").write_text(labels, encoding="utf-8")
    return TouchAndGoFolder(folder, side=24)


def test_one_number_is_one_moment(tmp_path):
    pairs = write(tmp_path).pairs
    assert len(pairs) == 6
    assert pairs.locations == (RECORDINGS[0],) * 3 + (RECORDINGS[1],) * 3
    assert pairs.labels == ("class 3",) * 3 + ("class 4",) * 3
    assert not any("left out" in note for note in pairs.notes)
    pair = pairs[0]
    assert (pair.sensor, pair.label, pair.where) == ("gelsight", "class 3", RECORDINGS[0])
    assert pair.depth_m is None
    assert pair.background is None
    assert pair.metres_per_pixel is None
    assert pair.rgb.shape == pair.touch.shape == (24, 24, 3)
    np.testing.assert_allclose(pair.rgb.mean((0, 1)), [linear(c) for c in (200, 100, 50)], atol=0.02)
    np.testing.assert_allclose(pair.touch.mean((0, 1)), np.array([90, 120, 30]) / 255.0, atol=0.02)


@pytest.mark.parametrize("root", ["dataset", ""])
@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_the_folder_and_the_kind_of_picture_may_differ(tmp_path, root, suffix):
    assert len(write(tmp_path, root=root, suffix=suffix).pairs) == 6


def test_without_labels_every_whole_moment_counts(tmp_path):
    data = write(tmp_path, labels=None)
    (tmp_path / "dataset" / RECORDINGS[0] / "gelsight_frame" / f"{MOMENTS[0]}.jpg").unlink()
    (tmp_path / "dataset" / RECORDINGS[0] / "video_frame" / "notes.txt").write_text("x")
    assert data.pairs.labels == (None,) * 5
    assert "no label.txt: no pair has a label" in data.pairs.notes
    assert "1 left out: no gelsight_frame" in data.pairs.notes


def test_class_names_come_from_the_data_set(tmp_path):
    data = write(tmp_path)
    (tmp_path / "category_reference.txt").write_text("Categories\nwood: 3 (any)\n synthetic fabric : 4\nodd line\n")
    assert set(data.pairs.labels) == {"wood", "synthetic fabric"}


def test_what_cannot_be_used_is_counted(tmp_path):
    lines = LABELS.split("\n")
    extra = [
        lines[0],  # twice
        lines[1].replace(",3", ",5"),  # two classes: both are left out
        f"{RECORDINGS[0]}/0000099999.jpg,3",  # no frames
        "20200101_000000/0000000001.jpg,2",  # no recording
        f"{RECORDINGS[1]}/{MOMENTS[0]}.jpg,20",
        "what is this",
        "",
    ]
    last = lines.pop()
    data = write(tmp_path, "\n".join([*lines, last.replace(",4", ",-1"), *extra]))
    (tmp_path / "dataset" / RECORDINGS[1] / "gelsight_frame" / f"{MOMENTS[1]}.jpg").unlink()
    pairs = data.pairs
    assert [(e.where, e.rgb.stem, e.label) for e in pairs.entries] == [
        (RECORDINGS[0], MOMENTS[0], "class 3"),
        (RECORDINGS[0], MOMENTS[2], "class 3"),
        (RECORDINGS[1], MOMENTS[0], "class 4"),
        (RECORDINGS[1], MOMENTS[2], None),
    ]
    assert set(pairs.notes[1:]) == {
        "1 are labeled as undecided",
        "1 left out: named twice",
        "2 left out: labeled as two classes",
        "1 left out: no video_frame",
        "1 left out: no gelsight_frame",
        "1 left out: their recording is not there",
        "1 left out: a class beyond 0 to 19",
        "1 left out: lines of label.txt that are no label",
    }


def test_a_recording_is_in_one_split_only(tmp_path):
    recordings = [f"20220601_1820{index:02d}" for index in range(20)]
    data = write(tmp_path, labels=None, recordings=recordings)
    parts = {name: data.split(name, seed=1) for name in ("train", "val", "test")}
    homes = [set(part.locations) for part in parts.values()]
    assert sum(map(len, homes)) == 20
    assert set.union(*homes) == set(recordings)
    assert [len(part) for part in parts.values()] == [48, 6, 6]
    assert data.split("test", seed=1).locations == parts["test"].locations
    with pytest.raises(UsageError, match="train, val, test"):
        data.split("all")
    with pytest.raises(FileError, match="1 places are too few"):
        write(tmp_path / "few", labels=None, recordings=recordings[:1]).split("test")


@pytest.mark.parametrize(
    "line", ["../0000000001.jpg,3", "/etc/passwd,3", "..\\x\\a.jpg,3", "a/../../b.jpg,3", "\\\\host\\a.jpg,3"]
)
def test_a_line_that_leads_out_is_refused(tmp_path, line):
    with pytest.raises(FileError, match=r"label\.txt: line 7 leads out of the folder"):
        _ = write(tmp_path, f"{LABELS}\n{line}\n").pairs


@pytest.mark.parametrize("text", ["", "\n\n", "a\nb\nc\n", f"{LABELS.splitlines()[0]}\nx\n"], ids=repr)
def test_another_text_is_no_label_file(tmp_path, text):
    with pytest.raises(FileError, match=r"label\.txt: \d+ of its \d+ lines are no labels"):
        _ = write(tmp_path, text).pairs


def test_bytes_are_no_label_file(tmp_path):
    data = write(tmp_path)
    (tmp_path / "label.txt").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FileError, match=r"label\.txt: cannot be read as text"):
        _ = data.pairs


key = st.tuples(st.sampled_from(["a", "b"]), st.sampled_from(["1", "2", "3"]))


@settings(max_examples=80, deadline=None)
@given(st.lists(st.tuples(key, st.integers(-1, 21)), min_size=1, max_size=12))
def test_every_line_is_a_label_or_counted(tmp_path_factory, lines):
    path = tmp_path_factory.getbasetemp() / "any_label.txt"
    path.write_text("".join(f"{recording}/{moment}.jpg,{label}\n" for (recording, moment), label in lines))
    left_out: Counter[str] = Counter()
    labels = read_labels(path, left_out)
    assert len(labels) + sum(left_out.values()) == len(lines)
    for moment, label in labels.items():
        assert {each for at, each in lines if at == moment and each < 20} == {label}


def test_folders_without_frames_are_told_apart(tmp_path):
    with pytest.raises(FileError, match="no recordings are in it"):
        _ = TouchAndGoFolder(tmp_path / "none").pairs
    (tmp_path / "dataset" / "20220601_182052").mkdir(parents=True)
    with pytest.raises(FileError, match="no recordings are in it"):
        _ = TouchAndGoFolder(tmp_path).pairs
    (tmp_path / "dataset" / "20220601_182052" / "video.mp4").write_bytes(b"")
    with pytest.raises(FileError, match=r"1 recordings have videos, none has frames.*Extract"):
        _ = TouchAndGoFolder(tmp_path).pairs
    (tmp_path / "dataset" / "20220601_182052" / "video_frame").mkdir()
    with pytest.raises(FileError, match="no moment has both frames"):
        _ = TouchAndGoFolder(tmp_path).pairs


def test_a_damaged_frame_is_refused_when_it_is_read(tmp_path):
    pairs = write(tmp_path).pairs
    pairs.entries[1].touch.write_bytes(b"")
    assert pairs[0].label == "class 3"
    with pytest.raises(FileError, match=rf"gelsight_frame/{MOMENTS[1]}\.jpg: cannot be read as a picture"):
        pairs[1]
