"""Vision–touch pairs: lazy sequences, splits by location, and images of unknown origin."""

from __future__ import annotations

import io

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from picture_files import MID_GREY, image, linear, write_picture, write_pixels

from hnf_core.datasets import vision_touch
from hnf_core.datasets.data_files import is_safe_name
from hnf_core.datasets.vision_touch import (
    FilePairs,
    PairFiles,
    VisionTouchPair,
    crop_centre_square,
    read_array,
    read_depth,
    read_photograph,
    read_touch_image,
    resize_by_area,
    split_by_location,
)
from hnf_core.errors import FileError, UsageError
from hnf_lab.alignment.hatt_touch import iterate_readable


def some_pair(where: str) -> VisionTouchPair:
    grey = np.full((4, 6, 3), 0.5, dtype=np.float32)
    return VisionTouchPair(grey, None, grey, None, "gelsight", None, where, None)


def of_places(places, tmp_path) -> FilePairs:
    def read(files: PairFiles) -> VisionTouchPair:
        if files.rgb.name == "bad":
            raise FileError("is damaged.", where=files.where)
        return some_pair(files.where)

    name = ["bad" if place.startswith("bad") else "good" for place in places]
    return FilePairs(
        tuple(PairFiles(tmp_path / n, tmp_path, p, label=p) for n, p in zip(name, places, strict=True)),
        read,
        ("a note",),
    )


def test_a_sequence_opens_nothing_until_it_is_asked(tmp_path):
    pairs = of_places(["bad 1", "b", "c"], tmp_path)
    assert len(pairs) == 3
    assert pairs.labels == pairs.locations == ("bad 1", "b", "c")
    assert [pair.where for pair in pairs[1:]] == ["b", "c"]
    assert pairs[1:].notes == ("a note",)
    with pytest.raises(FileError, match="bad 1: is damaged"):
        pairs[0]
    with pytest.raises(IndexError):
        pairs[3]


def test_damaged_pairs_are_left_out_and_told(tmp_path):
    skipped: list[FileError] = []
    pairs = of_places(["a", "bad 1", "b", "bad 2"], tmp_path)
    assert [pair.where for pair in iterate_readable(pairs, skipped)] == ["a", "b"]
    assert [error.where for error in skipped] == ["bad 1", "bad 2"]


places = st.lists(st.integers(0, 30).map(str), max_size=200)


@settings(max_examples=60, deadline=None)
@given(places, st.integers(0, 5), st.randoms())
def test_splits_partition_by_location_whatever_the_order(tmp_path_factory, names, seed, random):
    folder = tmp_path_factory.getbasetemp()
    split = split_by_location(of_places(names, folder), seed)
    assert list(split) == ["train", "val", "test"]
    homes = [set(part.locations) for part in split.values()]
    assert sum(map(len, homes)) == len(set.union(*homes))
    assert sorted(place for part in split.values() for place in part.locations) == sorted(names)
    shuffled = list(names)
    random.shuffle(shuffled)
    again = split_by_location(of_places(shuffled, folder), seed)
    assert [set(part.locations) for part in again.values()] == homes


def test_shares_are_met_to_one_place_and_seeds_differ(tmp_path):
    pairs = of_places([f"{place}" for place in range(100) for _ in range(7)], tmp_path)
    split = split_by_location(pairs, 3)
    for name, share in (("train", 560), ("val", 70), ("test", 70)):
        assert abs(len(split[name]) - share) <= 7, name
    assert set(split["test"].locations) != set(split_by_location(pairs, 4)["test"].locations)
    with pytest.raises(UsageError, match="above 0"):
        split_by_location(pairs, 0, {"train": 1.0, "test": 0.0})


@pytest.mark.parametrize("mode", ["RGB", "L", "RGBA"])
def test_pictures_become_linear_light(tmp_path, mode):
    values = read_photograph(write_picture(tmp_path / "a.png", mode=mode))
    assert values.shape == (48, 64, 3)
    assert values.dtype == np.float32
    codes = (MID_GREY,) * 3 if mode == "L" else (MID_GREY, 128, 0)
    np.testing.assert_allclose(values, np.broadcast_to([linear(code) for code in codes], values.shape), rtol=1e-6)
    every = write_pixels(tmp_path / "b.png", np.arange(256 * 3).reshape(16, 16, 3) % 256)
    assert read_photograph(every).min() == 0.0
    assert read_photograph(every).max() == 1.0


def test_touch_images_stay_as_they_are(tmp_path):
    values = read_touch_image(write_picture(tmp_path / "a.png"))
    assert values.dtype == np.float32
    np.testing.assert_allclose(values[0, 0], np.array([MID_GREY, 128, 0]) / 255.0, rtol=1e-6)


def test_means_are_of_light_and_a_square_is_in_the_middle(tmp_path):
    columns = np.zeros((16, 32, 3), dtype=np.uint8)
    columns[:, ::2] = 255
    values = resize_by_area(read_photograph(write_pixels(tmp_path / "a.png", columns)), 16)
    np.testing.assert_allclose(values, 0.5, atol=1e-6)
    ramp = np.broadcast_to(np.arange(10, dtype=np.float32), (4, 10)).copy()
    np.testing.assert_array_equal(crop_centre_square(ramp), ramp[:, 3:7])
    assert resize_by_area(ramp, 3).shape == (3, 3)


def test_depth_is_clipped_metres(tmp_path):
    depth = np.linspace(-1.0, 9.0, 400).reshape(20, 20, 1)
    depth[0, 0] = np.inf
    np.save(tmp_path / "a.npy", depth)
    values = read_depth(tmp_path / "a.npy", 5.0)
    assert values.shape == (20, 20)
    assert (values.min(), values.max(), values[0, 0]) == (0.0, 5.0, 5.0)
    np.testing.assert_allclose(values.ravel()[50:200], depth.ravel()[50:200].clip(0, 5), rtol=1e-6)


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros((20, 20, 2)), "no depth image"),
        (np.zeros((20, 3)), "no depth image"),
        (np.zeros((20, 20), dtype=complex), "no depth image"),
        (np.full((20, 20), np.nan), "not a number"),
        (np.array([["a"] * 20] * 20), "no depth image"),
        (np.array([[{}] * 20] * 20, dtype=object), "is no array of numbers"),
    ],
    ids=str,
)
def test_another_array_is_no_depth(tmp_path, array, message):
    np.save(tmp_path / "a.npy", array)
    with pytest.raises(FileError, match=rf"a\.npy: .*{message}"):
        read_depth(tmp_path / "a.npy", 5.0)


def test_a_header_larger_than_its_file_is_refused(tmp_path):
    buffer = io.BytesIO()
    header = {"descr": "<f8", "fortran_order": False, "shape": (10**6, 10**6)}
    np.lib.format.write_array_header_1_0(buffer, header)
    (tmp_path / "a.npy").write_bytes(buffer.getvalue() + bytes(800))
    with pytest.raises(FileError, match="is no array of numbers"):
        read_array(tmp_path / "a.npy")
    np.savez(tmp_path / "b.npz", a=np.zeros(3))
    with pytest.raises(FileError, match="several arrays"):
        read_array(tmp_path / "b.npz")


def test_what_is_no_picture_is_refused(tmp_path, monkeypatch):
    whole = write_picture(tmp_path / "a.jpg").read_bytes()
    for name, data in (("empty", b""), ("text", b"hello"), ("cut", whole[: len(whole) // 2])):
        (tmp_path / f"{name}.jpg").write_bytes(data)
        with pytest.raises(FileError, match=rf"{name}\.jpg: cannot be read as a picture"):
            read_photograph(tmp_path / f"{name}.jpg")
    with pytest.raises(FileError, match="cannot be read"):
        read_photograph(tmp_path / "none.jpg")
    image.new("RGB", (40, 40)).save(tmp_path / "c.tiff")
    with pytest.raises(FileError, match="cannot be read"):
        read_photograph(tmp_path / "c.tiff")
    image.fromarray(np.full((20, 20), 40_000, dtype=np.uint16)).save(tmp_path / "deep.png")
    with pytest.raises(FileError, match=r"deep\.png: is of the kind I;16, not of 8 bits"):
        read_photograph(tmp_path / "deep.png")
    with pytest.raises(FileError, match="has 64 × 8 pixels"):
        read_photograph(write_picture(tmp_path / "d.png", height=8))
    monkeypatch.setattr(vision_touch, "MAX_PIXELS", 1000)
    with pytest.raises(FileError, match="has 64 × 48 pixels"):
        read_photograph(tmp_path / "a.jpg")


@settings(max_examples=150, deadline=None)
@given(st.sampled_from([".jpg", ".png", ".bmp", ".npy"]), st.integers(0, 10**6), st.binary(min_size=1, max_size=6))
def test_damage_anywhere_is_a_picture_or_a_file_error(tmp_path_factory, suffix, place, junk):
    folder = tmp_path_factory.getbasetemp() / "damaged-pictures"
    path, whole = folder / f"bad{suffix}", folder / f"good{suffix}"
    if not whole.exists():
        folder.mkdir(exist_ok=True)
        if suffix == ".npy":
            np.save(whole, np.ones((20, 20)))
        else:
            write_picture(whole, 20, 20)
    data = whole.read_bytes()
    place %= len(data)
    path.write_bytes(data[:place] + junk + data[place + len(junk) :])
    try:
        values = read_depth(path, 5.0) if suffix == ".npy" else read_photograph(path)
    except FileError:
        return
    assert values.dtype == np.float32
    assert np.isfinite(values).all()


def test_a_pair_that_does_not_go_together_is_refused():
    grey = np.zeros((4, 6, 3), dtype=np.float32)
    whole = {"rgb": grey, "depth_m": grey[..., 0], "touch": grey, "background": grey}
    rest = {"sensor": "digit", "label": None, "where": "here", "metres_per_pixel": None}
    assert VisionTouchPair(**whole, **rest).where == "here"
    for wrong in (
        {"rgb": grey.astype(float)}, {"touch": grey[..., 0]}, {"depth_m": grey[:2, :, 0]}, {"background": grey[:2]},
        {"depth_m": grey}, {"rgb": grey[..., :2]},
    ):  # fmt: skip
        with pytest.raises(UsageError, match="here"):
            VisionTouchPair(**(whole | wrong), **rest)


@pytest.mark.parametrize(
    "name", ["", ".", "..", "a/b", "a\\b", "C:", "a\0", "a\n", ".hidden", "dots.", "é" * 201, "~a", "-a"]
)
def test_names_that_lead_elsewhere(name):
    assert not is_safe_name(name)


@given(st.from_regex(r"\A[A-Za-z0-9_]{1,20}\Z"))
def test_plain_names(name):
    assert is_safe_name(name)
    assert is_safe_name(f"{name} 1.2 (b)")
