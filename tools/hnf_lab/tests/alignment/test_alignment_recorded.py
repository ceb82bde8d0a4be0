"""Alignment on copies of published sets: GelSight from one, DIGIT from another, places never on both sides."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="alignment trains with torch")

from picture_files import write_picture, write_pixels

from hnf_core.cli.main import main
from hnf_core.datasets.tactile_pairs import PAIR_SENSORS
from hnf_core.errors import UsageError
from hnf_lab.alignment import train
from hnf_lab.alignment.encoders import Architecture
from hnf_lab.alignment.inputs import NO_LABEL, open_source

RECORDINGS, MOMENTS = 10, 6


def noise(seed: int, width: int = 72) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (64, width, 3))


def touch_and_go(folder: Path) -> Path:
    """Ten recordings of two materials by turns."""
    lines = []
    for recording in range(RECORDINGS):
        name = f"2022060{recording}_120000"
        for moment in range(MOMENTS):
            seed, file = 100 * recording + moment, f"{moment:010d}.png"
            write_pixels(folder / "dataset" / name / "video_frame" / file, noise(seed))
            write_pixels(folder / "dataset" / name / "gelsight_frame" / file, noise(seed + 50))
            lines.append(f"{name}/{file},{3 + recording % 2}")
    (folder / "label.txt").write_text("\n".join(lines), encoding="utf-8")
    return folder


def tarf(folder: Path) -> Path:
    split: dict[str, list[list[str]]] = {"train": [], "val": [], "test": []}
    for index in range(12):
        scene, file = ("hall", "desk")[index % 2], f"{index:04d}"
        write_pixels(folder / "vision" / f"{scene}_40_30" / f"{file}.jpg", noise(index))
        write_pixels(folder / "touch" / f"{scene}_40_30" / f"{file}.jpg", noise(index + 50))
        split["test" if index > 8 else "val" if index > 7 else "train"].append([f"{scene}_40_30", file])
    (folder / "split_interval.json").write_text(json.dumps(split), encoding="utf-8")
    return folder


def test_two_sets_give_two_sensors(tmp_path: Path) -> None:
    walks, scenes = touch_and_go(tmp_path / "walks"), tarf(tmp_path / "scenes")
    source = open_source([["touch-and-go", str(walks)], ["tarf", str(scenes)]])
    learn, judged = source.load_training(), source.load_held_out()
    gelsight, digit = (learn.select_sensor(name) for name in PAIR_SENSORS)
    assert len(digit) == 9
    assert set(digit.label) == {NO_LABEL}
    tested = judged.known["gelsight"]
    assert len(gelsight) + len(tested) == RECORDINGS * MOMENTS
    assert len(tested) == MOMENTS
    assert set(gelsight.label) == {0, 1}
    assert tested.label.min() >= 0
    assert learn.classes == tested.classes
    assert len(judged.known["digit"]) == 3
    assert judged.unseen == {}
    assert judged.disjoint is None
    assert any("no background" in note for note in source.messages)


def test_of_hatt_every_fifth_touch_is_for_the_test(tmp_path: Path) -> None:
    for name in ("Brick 1", "Wood"):
        write_picture(tmp_path / "photos" / f"{name}_square.bmp", 64, 64)
        for take in range(10):
            write_pixels(tmp_path / "gel" / name / f"{take:02d}.png", noise(take))
    source = open_source([["hatt", str(tmp_path / "photos"), str(tmp_path / "gel")]])
    learn, tested = source.load_training(), source.load_held_out().known["gelsight"]
    assert (len(learn), len(tested)) == (16, 4)
    assert sorted(tested.label) == [0, 0, 1, 1]
    shown = {
        learn.images.touch(np.array([row]), *[np.zeros(1, int)] * 2, np.random.default_rng()).tobytes()
        for row in learn.row
    }
    assert len(shown) == 8
    for row in tested.row:
        picture = tested.images.touch(np.array([row]), *[np.zeros(1, int)] * 2, np.random.default_rng())
        assert picture.tobytes() not in shown


def test_a_damaged_picture_is_left_out_and_told(tmp_path: Path) -> None:
    folder = touch_and_go(tmp_path)
    (folder / "dataset" / "20220604_120000" / "video_frame" / f"{2:010d}.png").write_bytes(b"no picture")
    source = open_source([["touch-and-go", str(folder)]])
    learn, judged = source.load_training(), source.load_held_out()
    assert len(learn) + len(judged.known["gelsight"]) == RECORDINGS * MOMENTS - 1
    assert any("1 pairs could not be read" in note for note in source.messages)
    with pytest.raises(UsageError, match="no digit picture"):
        learn.select_sensor("digit")


def test_the_words_take_copies(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.setattr(train, "RESNET50", Architecture((1, 1, 1, 1), 4, 8))
    walks, scenes = touch_and_go(tmp_path / "walks"), tarf(tmp_path / "scenes")
    data = ["--data", "touch-and-go", str(walks), "--data", "tarf", str(scenes)]

    def hnf(*words: object) -> int:
        return main([str(word) for word in words], lambda arguments: 1)

    out = tmp_path / "out"
    quick = ("--steps", 2, "--batch", 16, "--encoder", "resnet50", "--pixels", 32)
    assert hnf("train", "alignment", *data, *quick, "--out", out, "--json") == 0
    record = json.loads(capsys.readouterr().out)
    assert (record["sensor"], record["tuples"]) == ("both", 63)
    assert hnf("eval", "alignment", *data, "--models", out, "--items", 30, "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["chance"] == {"known": 1.0}
    assert {row["tested_on"] for row in told["accuracy"]} == {"looks", "gelsight"}
    assert set(told["recall"]["both"]) == {"gallery", "gelsight", "digit"}
