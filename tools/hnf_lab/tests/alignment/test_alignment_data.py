"""Training data of the aligned encoders: rotation, cropping, lamps, and one sensor per place."""

from __future__ import annotations

import numpy as np
import pytest
from alignment_pairs import MET, grooved_pairs, write_pairs
from hypothesis import given, settings
from hypothesis import strategies as st

torch = pytest.importorskip("torch", reason="alignment trains with torch")

from hnf_core.datasets.tactile_pairs import PAIR_SENSORS, encode_rgb
from hnf_core.datasets.vision_touch import VisionTouchPair
from hnf_core.errors import FileError, UsageError
from hnf_core.tactile.optics import SENSORS, gel_gradients, shade
from hnf_lab.alignment.encoders import (
    COLOUR_SCALE,
    TOUCH_SCALE,
    crop_corners,
    make_image_tensor,
    make_training_batch,
)
from hnf_lab.alignment.inputs import (
    NO_LABEL,
    NOISE,
    RecordedImagePairs,
    Tuples,
    apply_symmetry,
    apply_symmetry_to_slopes,
    make_recorded_tuples,
    make_test_tuples,
    make_training_tuples,
    open_source,
    render_touch,
    select_labelled,
)
from hnf_lab.encoder.variation import perturb_sensor


@given(st.integers(0, 7), st.integers(0, 2**31))
@settings(max_examples=20, deadline=None)
def test_slopes_turn_as_the_surface_does(turn: int, seed: int) -> None:
    """Away from the border, where a field that is no tile is continued."""
    height = np.random.default_rng(seed).standard_normal((16, 16)).cumsum(axis=0).cumsum(axis=1) * 1e-6
    sensor = SENSORS["digit"]
    of_turned = gel_gradients(apply_symmetry(height, turn), 1e-5, sensor)
    turned_of = apply_symmetry_to_slopes(np.array(gel_gradients(height, 1e-5, sensor)), turn)
    assert np.allclose(np.array(of_turned)[:, 4:-4, 4:-4], np.array(turned_of)[:, 4:-4, 4:-4], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("name", PAIR_SENSORS)
def test_a_touch_image_is_the_optics_minus_background_plus_noise(name: str) -> None:
    slopes = np.random.default_rng(0).uniform(-0.5, 0.5, (2, 64, 64)).astype(np.float32)
    piece = perturb_sensor(SENSORS[name], np.random.default_rng(7))
    plain = shade(slopes[0], slopes[1], piece) - piece.background
    shown = render_touch(slopes, SENSORS[name], 0, np.random.default_rng(7))
    noise = shown - plain
    assert noise.std() == pytest.approx(NOISE, rel=0.05)
    assert abs(noise.mean()) < NOISE / 20
    other = render_touch(slopes, SENSORS[name], 0, np.random.default_rng(8))
    assert (other - shown).std() > 10 * NOISE


def test_each_place_has_one_sensor_and_each_class_has_both() -> None:
    pairs = grooved_pairs(41, MET[:3], 0)
    tuples = make_training_tuples(pairs, MET[:3])
    assert len(tuples) == len(pairs)
    tile = pairs.tile_index[tuples.row]
    assert all(len(set(tuples.sensor[tile == each])) == 1 for each in np.unique(tile))
    for label in range(3):
        mine = tuples.label == label
        shares = np.bincount(tuples.sensor[mine], minlength=2)
        assert abs(int(shares[0]) - int(shares[1])) <= 4
    assert set(tuples.label[tile == 40]) == {NO_LABEL}
    one = tuples.select_sensor("digit")
    assert set(one.sensor) == {PAIR_SENSORS.index("digit")}
    with pytest.raises(UsageError, match="no gelsight picture"):
        one.select_sensor("gelsight")


def test_pieces_are_groups_and_only_classes_asked_for_are_judged() -> None:
    pairs = grooved_pairs(13, MET[:3], 0)
    judged = make_test_tuples(pairs, "gelsight", MET[:3])
    assert len(judged) == 48
    assert len(set(judged.group)) == 6
    assert all(len(set(judged.label[judged.group == group])) == 1 for group in set(judged.group))
    assert len(make_test_tuples(pairs, "digit", MET[1:3])) == 32


class Marked:
    """Pictures whose every pixel says where it comes from, the same for look and touch."""

    turns = 8
    floor = 0.02
    mark = np.arange(64 * 64, dtype=np.float32).reshape(64, 64)

    def rgb(self, rows: np.ndarray, turn: np.ndarray) -> np.ndarray:
        return np.stack([np.repeat(apply_symmetry(self.mark, way)[..., None], 3, axis=-1) for way in turn])

    def touch(self, rows: np.ndarray, sensor: np.ndarray, turn: np.ndarray, rng: object) -> np.ndarray:
        return self.rgb(rows, turn)


def marked(count: int) -> Tuples:
    rows = np.arange(count)
    return Tuples(Marked(), rows, rows % 2, rows, rows, tuple(map(str, rows)))


def test_look_and_touch_are_turned_and_cut_alike() -> None:
    batch = make_training_batch(marked(16), np.arange(16), 40, np.random.default_rng(0))
    assert batch.vision.shape == batch.touch.shape == (16, 3, 40, 40)
    assert batch.vision.is_contiguous(memory_format=torch.channels_last)
    looks = batch.vision[:, 0].numpy()
    marks = np.sinh(batch.touch[:, 0].numpy().astype(np.float64) * TOUCH_SCALE) * Marked.floor
    seen = set()
    for look, mark in zip(looks, marks, strict=True):  # what networks are shown grows with what there is
        assert np.array_equal(np.argsort(look, axis=None), np.argsort(mark, axis=None))
        seen.add(tuple(np.rint([mark[0, 1] - mark[0, 0], mark[1, 0] - mark[0, 0]]).astype(int)))
    assert len(seen) >= 4  # several of the eight turns


def test_a_look_is_its_colour_with_its_texture_on_top() -> None:
    looks = np.random.default_rng(0).uniform(0.2, 0.4, (3, 8, 8, 3)).astype(np.float32)
    shown = make_image_tensor(looks)
    brighter = make_image_tensor(looks + np.float32(0.1))
    assert torch.allclose(brighter - shown, torch.full_like(shown, 0.1 / COLOUR_SCALE), atol=1e-4)
    faint = make_image_tensor(0.3 + 0.01 * (looks - 0.3))
    contrast = faint.std(dim=(2, 3)) / shown.std(dim=(2, 3))
    assert float(contrast.min()) > 0.01  # a hundredth of the texture is more than a hundredth of what is shown


@pytest.mark.parametrize(("pixels", "count"), [(64, 1), (40, 4), (32, 4)])
def test_corners_cover_the_picture(pixels: int, count: int) -> None:
    pictures = np.arange(2 * 64 * 64 * 3, dtype=np.float32).reshape(2, 64, 64, 3)
    found = crop_corners(pictures, pixels)
    assert [each.shape for each in found] == [(2, pixels, pixels, 3)] * count
    assert len(np.unique(np.concatenate([each.ravel() for each in found]))) == pictures.size


def test_equal_seeds_give_equal_batches() -> None:
    tuples = make_training_tuples(grooved_pairs(4, MET[:2], 0), MET)
    one, same, other = (
        make_training_batch(tuples, np.arange(8), 48, np.random.default_rng(seed)) for seed in (1, 1, 2)
    )
    assert torch.equal(one.touch, same.touch)
    assert torch.equal(one.vision, same.vision)
    assert not torch.equal(one.touch, other.touch)


def a_pair(sensor: str, label: str | None, where: str, background: bool) -> VisionTouchPair:
    rng = np.random.default_rng(len(where))
    look = rng.uniform(0.0, 1.0, (80, 100, 3)).astype(np.float32)
    touch = (0.3 + 0.1 * rng.uniform(-1.0, 1.0, (96, 70, 3))).astype(np.float32)
    flat = np.full_like(touch, 0.3) if background else None
    return VisionTouchPair(look, None, touch, flat, sensor, label, where, None)  # type: ignore[arg-type]


def test_recordings_are_squares_less_their_background() -> None:
    pytest.importorskip("PIL", reason="pictures are resized by Pillow")
    pairs = [
        a_pair("gelsight", "oak", "a", True),
        a_pair("digit", None, "bb", False),
        a_pair("digit", "fir", "a", True),
    ]
    tuples = make_recorded_tuples(pairs, ("fir", "oak"))
    assert tuples.label.tolist() == [1, NO_LABEL, 0]
    assert tuples.sensor.tolist() == [0, 1, 1]
    assert tuples.group.tolist() == [0, 1, 0]
    pictures = tuples.images
    assert isinstance(pictures, RecordedImagePairs)
    assert pictures.images.shape == pictures.touch_images.shape == (3, 64, 64, 3)
    assert pictures.turns == 1
    assert abs(float(pictures.touch_images[1].astype(float).mean())) < 1e-3
    square = pairs[0].rgb[:, 10:90]
    assert float((pictures.images[0] / 255.0).mean()) == pytest.approx(
        float((encode_rgb(square) / 255.0).mean()), rel=0.05
    )
    with pytest.raises(UsageError, match="no vision–touch pairs"):
        make_recorded_tuples([], ())


def test_a_folder_of_generated_pairs_is_a_source(tmp_path) -> None:
    write_pairs(tmp_path)
    source = open_source([[str(tmp_path)]])
    learn, judged = source.load_training(), source.load_held_out()
    assert len(learn) == 96
    assert set(learn.label) == {NO_LABEL, 0, 1, 2}
    assert learn.classes == MET
    assert {name: len(each) for name, each in judged.known.items()} == {"gelsight": 92, "digit": 92}
    assert {name: len(each) for name, each in judged.unseen.items()} == {"gelsight": 92, "digit": 92}
    assert judged.disjoint is not None
    gelsight, digit = (set(judged.known[name].row[judged.disjoint[name]]) for name in PAIR_SENSORS)
    assert not gelsight & digit
    assert len(gelsight | digit) == 92
    few = select_labelled(learn, 20, 0)
    assert len(few) == 20
    assert few.label.min() >= 0
    with pytest.raises(FileError, match="no tactile pairs here"):
        open_source([[str(tmp_path / "none")]]).load_training()
    for bad in ([["pairs"]], [["tarf"]], [["hatt", "a"]], [["pairs", "a"], ["tarf", "b"]], [["a", "b"]]):
        with pytest.raises(UsageError):
            open_source(bad)
