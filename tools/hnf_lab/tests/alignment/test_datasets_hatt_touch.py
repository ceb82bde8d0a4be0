"""HaTT photographs with GelSight images: no layout is published, so several are understood and every guess is said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from picture_files import linear, write_picture

from hnf_core.errors import FileError, UsageError
from hnf_lab.alignment.hatt_touch import HattTouchFolder

PHOTOS = ("ABS Plastic", "Brick 1", "Brick 2", "Wood")


def write_photos(folder: Path, names=PHOTOS, ending="_square.bmp", side=64) -> Path:
    for name in names:
        write_picture(folder / f"{name}{ending}", side, side, (150, 75, 30))
    return folder


def pairs_of(tmp_path: Path, *touches: str):
    for touch in touches:
        write_picture(tmp_path / "gel" / touch, 64, 48, (30, 200, 30))
    return HattTouchFolder(write_photos(tmp_path / "photos"), tmp_path / "gel", side=24).pairs


@pytest.mark.parametrize(
    ("touch", "material"),
    [
        ("ABS Plastic/0001.png", "ABS Plastic"),
        ("abs_plastic/session/anything at all.jpg", "ABS Plastic"),
        ("ABS Plastic.png", "ABS Plastic"),
        ("ABSPlastic_3.png", "ABS Plastic"),
        ("abs-plastic-gelsight-02.jpg", "ABS Plastic"),
        ("Brick 1.png", "Brick 1"),
        ("Brick 2_1.png", "Brick 2"),
        ("Brick_1_2.png", "Brick 1"),
        ("Wood_frame12.png", "Wood"),
        ("Wood/Brick 1.png", "Wood"),
    ],
)
def test_a_touch_image_is_known_by_its_folder_or_its_name(tmp_path, touch, material):
    pairs = pairs_of(tmp_path, touch)
    assert pairs.labels == pairs.locations == (material,)
    assert pairs.entries[0].rgb.name == f"{material}_square.bmp"


@pytest.mark.parametrize("touch", ["Woodchip.png", "Brick 3_1.png", "Wood stained.png", "0001.png", "Brick.png"])
def test_an_unknown_name_is_counted_not_guessed(tmp_path, touch):
    pairs = pairs_of(tmp_path, "Wood/1.png", touch)
    assert pairs.labels == ("Wood",)
    assert "1 left out: touch images of no photographed material" in pairs.notes
    assert "3 left out: photographs without touch image" in pairs.notes


def test_a_pair_keeps_the_photographs_scale(tmp_path):
    pair = pairs_of(tmp_path, "Wood/1.png")[0]
    assert (pair.sensor, pair.label, pair.where) == ("gelsight", "Wood", "Wood")
    assert pair.rgb.shape == (64, 64, 3)
    # 1024 pixels of 1/15 mm, shown with 64
    assert pair.metres_per_pixel == pytest.approx(1e-3 / 15.0 * 1024 / 64)
    assert pair.touch.shape == (24, 24, 3)
    np.testing.assert_allclose(pair.rgb[0, 0], [linear(c) for c in (150, 75, 30)], rtol=1e-5)
    np.testing.assert_allclose(pair.touch[0, 0], np.array([30, 200, 30]) / 255.0, rtol=1e-5)
    assert pair.background is None
    assert pair.depth_m is None


def test_a_photograph_that_is_not_square_has_no_scale(tmp_path):
    write_picture(tmp_path / "photos" / "Wood_square.png", 64, 48)
    write_picture(tmp_path / "gel" / "Wood_1.png")
    assert HattTouchFolder(tmp_path / "photos", tmp_path / "gel").pairs[0].metres_per_pixel is None


def test_the_nearest_background_counts(tmp_path):
    pairs = pairs_of(tmp_path, "Wood/1.png", "Brick 1/1.png", "Brick 1/background.png", "bg_0.png")
    assert [entry.background.relative_to(tmp_path / "gel").as_posix() for entry in pairs.entries] == [
        "Brick 1/background.png", "bg_0.png",
    ]  # fmt: skip
    assert pairs[0].background.shape == (24, 24, 3)
    assert not any("no background" in note for note in pairs.notes)
    write_picture(tmp_path / "gel" / "bg_0.png", 32, 48)
    with pytest.raises(FileError, match=r"bg_0\.png: is \(48, 32\), the touch image 1\.png \(48, 64\)"):
        pairs[1]


def test_takes_of_one_texture_stay_together(tmp_path):
    names = [f"Cloth {index}" for index in range(20)]
    write_photos(tmp_path / "photos", names)
    for name in names:
        for take in (1, 2):
            write_picture(tmp_path / "gel" / f"{name}_{take}.png")
    data = HattTouchFolder(tmp_path / "photos", tmp_path / "gel")
    homes = [set(data.split(name).locations) for name in ("train", "val", "test")]
    assert [len(home) for home in homes] == [16, 2, 2]
    assert len(set.union(*homes)) == 20
    with pytest.raises(UsageError, match="train, val, test"):
        data.split("rest")


def test_touch_images_may_lie_among_the_photographs(tmp_path):
    write_photos(tmp_path, ["Wood"], ending=".jpg")
    write_picture(tmp_path / "gelsight" / "Wood_1.jpg")
    pairs = HattTouchFolder(tmp_path, tmp_path / "gelsight").pairs
    assert [entry.rgb.name for entry in pairs.entries] == ["Wood.jpg"]
    write_picture(tmp_path / "both" / "Wood_square.jpg")
    write_picture(tmp_path / "both" / "Wood_gelsight_1.jpg")
    mixed = HattTouchFolder(tmp_path / "both", tmp_path / "both").pairs
    assert [entry.touch.name for entry in mixed.entries] == ["Wood_gelsight_1.jpg"]


def test_folders_that_do_not_go_together_are_refused(tmp_path):
    with pytest.raises(FileError, match="no folder"):
        _ = HattTouchFolder(tmp_path / "none", tmp_path).pairs
    with pytest.raises(FileError, match="no photographs are in it"):
        _ = HattTouchFolder(tmp_path, tmp_path / "gel").pairs
    write_photos(tmp_path / "photos")
    (tmp_path / "gel").mkdir()
    with pytest.raises(FileError, match=r"no touch image is called as a photograph is.*ABS Plastic, Brick 1, Brick 2"):
        _ = HattTouchFolder(tmp_path / "photos", tmp_path / "gel").pairs
    write_picture(tmp_path / "gel" / "Wood" / "1.png")
    with pytest.raises(FileError, match=r"1 places are too few for a split 'val'"):
        HattTouchFolder(tmp_path / "photos", tmp_path / "gel").split("val")


def test_a_damaged_picture_is_refused_when_it_is_read(tmp_path):
    pairs = pairs_of(tmp_path, "Wood/1.png", "Brick 1/1.png")
    pairs.entries[0].rgb.write_bytes(b"BM")
    with pytest.raises(FileError, match=r"Brick 1_square\.bmp: cannot be read as a picture"):
        pairs[0]
    assert pairs[1].label == "Wood"
