"""The available encoders: one layout, one rule for known values, and checked files."""

import json

import numpy as np
import pytest
from alexnet_parts import random_encoder
from hypothesis import given, settings
from hypothesis import strategies as st
from unresolved_maps import unresolved_tactile_map

from hnf_core.errors import FileError, MaterialError, UsageError, WeightsError
from hnf_core.material import alexnet_encoder
from hnf_core.material.alexnet_encoder import (
    CONTRAST_FLOOR,
    LEVEL_INDICES,
    OUTPUT_COUNT,
    decode_outputs,
    describe_with_alexnet,
    load_encoder,
    save_encoder,
)
from hnf_core.material.band_descriptor import describe, get_smooth_token_values
from hnf_core.material.encoder_registry import PREFERRED_ENCODERS, describe_views, get_default_encoder, get_encoder
from hnf_core.material.fuse import merge_tokens
from hnf_core.material.token import ALEXNET_ID, ENCODER_ID, ENCODER_NAMES, LEVELS, TOKEN_DIM, band_slice
from hnf_core.tactile.height import tactile_map_from_height
from hnf_core.tactile.tactile_map import Route, TactileMap
from hnf_core.tactile.views import PITCHES_M
from hnf_lab.encoder.variation import encode_targets

NETWORK = random_encoder(7)
SIDE_M = 20e-3
SIZE = 512
PITCH = SIDE_M / SIZE


def rough(seed: int = 0, size: int = SIZE, rms_m: float = 5e-6) -> np.ndarray:
    """Noise of the tile's own period, falling by 1/f."""
    rng = np.random.default_rng(seed)
    f = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None, :])
    height = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((size, size))) / np.maximum(f, 4.0 / size), (size, size))
    return rms_m * (height - height.mean()) / height.std()


def tactile(
    height: np.ndarray, pitch: float = PITCH, mask: np.ndarray | None = None, resolved: float = 0.0
) -> TactileMap:
    return tactile_map_from_height(height, mask, pitch, resolved or 2.0 * pitch)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**16), st.integers(0, 3), st.floats(1e-3, 1.0))
def test_a_view_is_taught_what_it_is_read_as(seed, index, contrast):
    """target_outputs and token_values are each other's inverse on the view's own bands."""
    rng = np.random.default_rng(seed)
    token = rng.uniform(0.0, 0.5, TOKEN_DIM).astype(np.float32)
    token[LEVELS] = rng.uniform(-7.0, -4.0, 7)
    target = encode_targets(token[None], np.array([contrast]), np.array([index]))[0]
    assert target.shape == (OUTPUT_COUNT,)
    values, known = decode_outputs(target.astype(np.float32), contrast, PITCHES_M[index])
    assert [bool(known[band_slice(band)].all()) for band in range(7)] == [
        index <= band < index + 4 for band in range(7)
    ]
    np.testing.assert_allclose(values[known], token[known], atol=2e-5)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**16), st.floats(1e-3, 0.2), st.floats(0.1, 4.0))
def test_twice_the_contrast_is_twice_the_height(seed, contrast, factor):
    outputs = np.random.default_rng(seed).uniform(0.0, 0.5, OUTPUT_COUNT).astype(np.float32)
    outputs[list(LEVEL_INDICES)] = 0.0
    once, twice = (decode_outputs(outputs, c, PITCHES_M[1])[0] for c in (contrast, factor * contrast))
    np.testing.assert_allclose((twice - once)[LEVELS][1:5], np.log10(factor), atol=1e-5)


@pytest.mark.parametrize("pitch", PITCHES_M)
def test_a_view_of_sixty_four_pixels_tells_its_four_bands(pitch):
    token = describe_with_alexnet(NETWORK, tactile(rough(size=64), pitch))
    first = PITCHES_M.index(pitch)
    told = [bool(token.known[band_slice(band)].all()) for band in range(7)]
    assert told == [first <= band < first + 4 for band in range(7)]
    assert told == [bool(describe(tactile(rough(size=64), pitch)).known[band_slice(band)].all()) for band in range(7)]
    assert np.array_equal(token.values[:-2][~token.known[:-2]], get_smooth_token_values()[:-2][~token.known[:-2]])


@pytest.mark.parametrize("resolved", [2 * PITCH, 0.3e-3, 0.7e-3, 3e-3])
def test_both_makes_know_the_same_bands_of_a_whole_map(resolved):
    whole = tactile(rough(), resolved=resolved)
    assert np.array_equal(describe_with_alexnet(NETWORK, whole).known, describe(whole).known)


def test_nothing_is_said_of_what_was_not_seen():
    mask = np.ones((SIZE, SIZE), dtype=bool)
    mask[:, SIZE // 2 :] = False
    hidden, shown = rough(1), rough(1)
    hidden[~mask] += rough(2)[~mask]
    tokens = [describe_with_alexnet(NETWORK, tactile(height, mask=mask)) for height in (hidden, shown)]
    assert np.array_equal(tokens[0].values, tokens[1].values)
    assert not tokens[0].known[band_slice(0)].any(), "no view of 20 mm lies inside half of the tile"
    assert tokens[0].known[band_slice(6)].all()
    nowhere = TactileMap(
        tactile(rough(1)).image, None, np.zeros_like(mask), PITCH, "gelsight", 2 * PITCH, Route.MEASURED
    )
    assert not describe_with_alexnet(NETWORK, nowhere).known.any()
    assert not describe_with_alexnet(NETWORK, unresolved_tactile_map((SIZE, SIZE), PITCH)).known.any()


def test_a_flat_surface_is_smooth():
    token = describe_with_alexnet(NETWORK, tactile(np.zeros((SIZE, SIZE))))
    assert np.array_equal(token.values, get_smooth_token_values())
    assert token.known.all()
    assert CONTRAST_FLOOR < 1e-4


def test_the_same_map_gives_the_same_token():
    tokens = [describe_with_alexnet(NETWORK, tactile(rough(3))) for _ in range(2)]
    assert tokens[0].values.tobytes() == tokens[1].values.tobytes()


def test_an_encoder_file_gives_back_what_was_written(tmp_path):
    save_encoder(tmp_path / "a.safetensors", NETWORK)
    save_encoder(tmp_path / "b.safetensors", NETWORK)
    back = load_encoder(tmp_path / "a.safetensors")
    assert (tmp_path / "a.safetensors").read_bytes() == (tmp_path / "b.safetensors").read_bytes()
    assert back.config == NETWORK.config
    assert all(np.array_equal(back.tensors[name], value) for name, value in NETWORK.tensors.items())
    assert back.metadata["encoder"] == ALEXNET_ID
    assert back.metadata["licence"] == NETWORK.metadata["licence"]
    encoder = get_encoder(str(tmp_path / "a.safetensors"))
    whole = tactile(rough(4))
    assert encoder.name == ALEXNET_ID
    assert np.array_equal(encoder.describe(whole).values, describe_with_alexnet(NETWORK, whole).values)


def changed(path, metadata=None, tensors=None):
    from safetensors.numpy import load, save

    data = path.read_bytes()
    header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])
    path.write_bytes(save({**load(data), **(tensors or {})}, metadata={**header["__metadata__"], **(metadata or {})}))


@pytest.mark.parametrize(
    ("metadata", "tensors", "message"),
    [
        ({"encoder": "other-9"}, {}, "no encoder .*other-9"),
        ({"format": "hnf-field-1"}, {}, "no encoder"),
        ({"architecture": "{}"}, {}, "unreadable description"),
        ({"architecture": json.dumps({"pixels": 9, "hidden": 16, "mean": [0] * 3, "deviation": [1] * 3})}, {}, "range"),
        ({}, {"head.2.bias": np.zeros(3, dtype=np.float16)}, "do not fit"),
        ({}, {"features.0.bias": np.full(64, np.inf, dtype=np.float16)}, "finite"),
    ],
)
def test_a_wrong_file_is_refused_in_words(tmp_path, metadata, tensors, message):
    path = tmp_path / "e.safetensors"
    save_encoder(path, NETWORK)
    changed(path, metadata, tensors)
    with pytest.raises(WeightsError, match=message):
        load_encoder(path)


def test_what_is_no_encoder_is_named(tmp_path):
    (tmp_path / "e.safetensors").write_bytes(b"nothing")
    with pytest.raises(WeightsError, match="damaged"):
        get_encoder(str(tmp_path / "e.safetensors"))
    with pytest.raises(FileError, match="cannot read"):
        get_encoder(str(tmp_path / "absent.safetensors"))
    with pytest.raises(UsageError, match="no encoder is called 'alex'"):
        get_encoder("alex")
    with pytest.raises(UsageError, match="prior maps"):
        get_default_encoder(Route.PRIOR)


def test_a_missing_network_encoder_raises_with_a_remedy(tmp_path, monkeypatch):
    monkeypatch.setattr(alexnet_encoder, "DEFAULT_ENCODER", tmp_path / "encoder.safetensors")
    for asked in (
        load_encoder,
        lambda: get_encoder(ALEXNET_ID),
        lambda: get_default_encoder(Route.PREDICTED, ENCODER_NAMES),
    ):
        with pytest.raises(MaterialError, match=rf"{ALEXNET_ID} is not part of the Blender extension") as caught:
            asked()
        assert ENCODER_ID in caught.value.remedy
        assert "data/encoder.safetensors" in caught.value.remedy
    save_encoder(tmp_path / "copy.safetensors", NETWORK)
    assert get_encoder(str(tmp_path / "copy.safetensors")).name == ALEXNET_ID
    assert get_default_encoder(Route.PREDICTED).name == ENCODER_ID


def test_views_of_one_patch_make_one_token():
    views = [tactile(rough(5, 64), PITCHES_M[0]), tactile(rough(6, 64), PITCHES_M[3])]
    encoder = get_encoder(ENCODER_ID)
    token = describe_views(encoder, views)
    assert token.known.all()
    for band, view in ((0, views[0]), (6, views[1])):
        np.testing.assert_allclose(token.values[band_slice(band)], describe(view).values[band_slice(band)], atol=1e-5)
    assert np.array_equal(describe_views(encoder, views[:1]).values, describe(views[0]).values)


def test_every_route_with_a_map_has_a_make_that_the_field_knows():
    assert set(PREFERRED_ENCODERS) == {Route.MEASURED, Route.PREDICTED}
    for route, names in PREFERRED_ENCODERS.items():
        assert set(names) <= set(ENCODER_NAMES)
        assert get_default_encoder(route).name == ENCODER_ID
        assert get_default_encoder(route, ENCODER_NAMES).name == names[0]
    with pytest.raises(UsageError, match="among other-9"):
        get_default_encoder(Route.MEASURED, ("other-9",))
    assert get_encoder(ENCODER_ID).describe is describe


def test_a_view_counts_as_much_as_it_shows():
    """Half a view counts half: its token merges as one of two thirds and one of one third of the area."""
    half = np.ones((64, 64), dtype=bool)
    half[:, 32:] = False
    whole, part = tactile(rough(5, 64), PITCH), tactile(0.1 * rough(5, 64), PITCH, half)
    encoder = get_encoder(ENCODER_ID)
    tokens = [describe(whole), describe(part)]
    assert np.array_equal(describe_views(encoder, [whole, part]).values, merge_tokens(tokens, [2.0, 1.0]).values)
    assert not np.array_equal(merge_tokens(tokens, [2.0, 1.0]).values, merge_tokens(tokens).values)
