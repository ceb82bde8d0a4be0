"""LMT's two sets: accelerations alone, the action assumed and said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hnf_core.datasets.lmt import ASSUMPTIONS
from hnf_core.datasets.registry import open_dataset
from hnf_core.errors import FileError, MaterialError

SIGNAL = np.random.default_rng(3).standard_normal((5000, 3))


def write(path: Path, numbers) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(f"{x:.8g}" for x in numbers) + "\n", encoding="utf-8")


def test_the_69_set(tmp_path):
    write(tmp_path / "Training/Accel/SquaredAluminumMesh_query0.txt", SIGNAL[:, 0] + 2.0)
    write(tmp_path / "Training/Accel/SquaredAluminumMesh_query1.txt", SIGNAL[:, 1])
    write(tmp_path / "Testing/AccelScansDFT321/SquaredAluminumMesh_Anna.txt", SIGNAL[:, 2])
    write(tmp_path / "Training/Sound/SquaredAluminumMesh_query0.txt", SIGNAL[:, 0])
    (tmp_path / "readme.txt").write_text("one line_of words")
    data = open_dataset("lmt", tmp_path)
    assert data.materials == ("SquaredAluminumMesh",)
    recordings = data.recordings("squared aluminum mesh")
    assert len(recordings) == 3
    first = next(each for each in recordings if each.source.endswith("query0.txt"))
    np.testing.assert_allclose(first.samples, (SIGNAL[:, 0] - SIGNAL[:, 0].mean())[: len(first.samples)], atol=1e-6)
    assert len(first.samples) >= 4950
    assert first.known == frozenset()
    assert first.notes == ASSUMPTIONS
    assert (first.action.speed[0], first.action.force[0]) == (0.1, 1.0)
    assert data.process("SquaredAluminumMesh") is None
    assert data.action_range("SquaredAluminumMesh").speed_m_s == (0.1, 0.1)


@pytest.mark.parametrize(
    "form",
    ["Movement/Training/G1EpoxyRasterPlate_Movement_{}_train1", "Movement/Training/{}/G1EpoxyRasterPlate_train1"],
)
def test_the_108_set_with_axes(tmp_path, form):
    for k, axis in enumerate("XYZ"):
        write(tmp_path / "AccelScansComponents" / f"{form.format(axis)}.txt", SIGNAL[:, k])
    write(tmp_path / "AccelScansComponents/Movement/Testing/G1EpoxyRasterPlate_Movement_test2.txt", SIGNAL[:, 0])
    data = open_dataset("lmt", tmp_path)
    assert data.materials == ("G1EpoxyRasterPlate",)
    recordings = data.recordings("g1 epoxy raster plate")
    powers = sorted(float(np.mean(np.square(each.samples))) for each in recordings)
    assert powers == pytest.approx([1.0, 3.0], rel=0.06)  # DFT321 keeps the sum of three


def test_a_picture_is_found_by_its_beginning(tmp_path):
    write(tmp_path / "Accel/Cork_query0.txt", SIGNAL[:, 0])
    (tmp_path / "Cork_query0.jpg").write_bytes(b"\xff\xd8")
    assert open_dataset("lmt", tmp_path).image("cork") == tmp_path / "Cork_query0.jpg"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "empty"),
        (b"1\n2\nnan\n4\n", "line 3: a value is not finite"),
        (b"1\n2\nthree\n", "line 3"),
        (b"1\n2\n3\n", "0.000 s only"),
        (bytes(range(256)), "not a text file"),
        (b"1\x002", "not a text file"),
        (b"1e999\n", "line 1: a value is not finite"),
    ],
    ids=["empty", "nan", "word", "short", "binary", "zero byte", "overflow"],
)
def test_a_bad_file_is_refused(tmp_path, content, message):
    (tmp_path / "Accel").mkdir()
    (tmp_path / "Accel" / "Cork_query0.txt").write_bytes(content)
    with pytest.raises(FileError, match=rf"Cork_query0\.txt.*{message}"):
        open_dataset("lmt", tmp_path).recordings("cork")


def test_a_missing_axis_and_uneven_axes_are_refused(tmp_path):
    path = tmp_path / "AccelScansComponents/Movement/Training"
    for axis in "XY":
        write(path / f"G2Cork_{axis}_train1.txt", SIGNAL[:, 0])
    data = open_dataset("lmt", tmp_path)
    with pytest.raises(FileError, match="only x, y are there"):
        data.recordings("G2Cork")
    write(path / "G2Cork_Z_train1.txt", SIGNAL[:9, 0])
    with pytest.raises(FileError, match="not equally long"):
        open_dataset("lmt", tmp_path).recordings("G2Cork")
    with pytest.raises(MaterialError, match="Near ones: G2Cork"):
        data.recordings("G3 Cork")
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileError, match="no accelerations"):
        _ = open_dataset("lmt", tmp_path / "empty").materials
