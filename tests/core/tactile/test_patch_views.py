"""Views of a patch: their placement, decimation, and antialiasing."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.errors import UsageError
from hnf_core.material.token import BAND_WAVELENGTHS_M
from hnf_core.tactile.views import PITCHES_M, VIEW_PIXELS, antialias, cut_views, measure_contrast
from hnf_lab.evaluation.tactile_map.tiles import decimate_tile

NATIVE = PITCHES_M[-1]
SIDE = 512


def wave(period: float, side: int = SIDE, angle: float = 0.0) -> np.ndarray:
    row, column = np.mgrid[:side, :side] + 0.5
    return np.cos(2.0 * np.pi * (np.cos(angle) * column - np.sin(angle) * row) / period)


def grey(values: np.ndarray) -> np.ndarray:
    return np.repeat(values[..., None], 3, axis=-1)


def test_every_pitch_resolves_four_bands_at_the_same_pixels():
    for index, pitch in enumerate(PITCHES_M):
        np.testing.assert_allclose(BAND_WAVELENGTHS_M[index : index + 4] / pitch, (25.6, 12.8, 6.4, 3.2))
        assert VIEW_PIXELS * pitch >= 2.0 * BAND_WAVELENGTHS_M[index]


@given(factor=st.sampled_from((2, 4, 8)), cycles=st.integers(1, 200), angle=st.sampled_from((0.0, np.pi / 2)))
@settings(max_examples=25, deadline=None)
def test_a_tiles_wave_is_kept_exactly_or_gone(factor, cycles, angle):
    side = 256
    new_nyquist = side / factor / 2
    if 0.9 * new_nyquist < cycles < new_nyquist:
        return
    cycles = min(cycles, side // 2 - 1)
    tile = wave(side / cycles, side, angle)
    small = decimate_tile(tile, factor)
    expected = wave(side / factor / cycles, side // factor, angle) if cycles < new_nyquist else np.zeros_like(small)
    np.testing.assert_allclose(small, expected, atol=1e-9)


def test_a_tile_is_decimated_per_plane_by_a_divisor_only():
    tile = np.random.default_rng(3).normal(size=(2, 64, 64))
    np.testing.assert_array_equal(decimate_tile(tile, 4)[1], decimate_tile(tile[1], 4))
    np.testing.assert_array_equal(decimate_tile(tile, 1), tile)
    with pytest.raises(UsageError):
        decimate_tile(tile, 3)


@pytest.mark.parametrize("factor", [2.0, 3.3, 8.0])
def test_antialiasing_passes_planes_and_long_waves_only(factor):
    row, column = np.mgrid[:SIDE, :SIDE]
    plane = 3.0 + 0.02 * column - 0.05 * row
    np.testing.assert_allclose(antialias(plane, factor), plane, atol=1e-9)
    inner = np.s_[96:-96, 96:-96]
    long, short = wave(2.3 * factor, angle=0.0), wave(1.9 * factor, angle=0.0)
    np.testing.assert_allclose(antialias(long, factor)[inner], long[inner], atol=0.06)
    assert np.abs(antialias(short, factor)[inner]).max() < 0.06


def test_a_whole_patch_gives_one_wide_view_and_four_near_ones():
    views = cut_views(grey(0.5 + 0.4 * wave(100.0)), wave(300.0) * 1e-3, None, NATIVE, 2.0 * NATIVE)
    assert [view.pitch_m for view in views] == [PITCHES_M[0]] + 4 * [PITCHES_M[3]]
    for view in views:
        assert view.rgb.shape == (VIEW_PIXELS, VIEW_PIXELS, 3)
        assert view.rgb.dtype == view.depth_m.dtype == np.float32
        assert view.depth_known
        assert abs(float(view.depth_m.mean())) < 1e-8
    np.testing.assert_allclose(views[0].rgb[..., 0], decimate_tile(0.5 + 0.4 * wave(100.0), 8), atol=0.03)


def test_near_views_show_what_lies_there_and_none_lies_twice():
    row, column = np.mgrid[:SIDE, :SIDE]
    place = np.stack([row / SIDE, column / SIDE, np.zeros((SIDE, SIDE))], axis=-1)
    near = cut_views(place, None, None, NATIVE, 2.0 * NATIVE)[1:]
    corners = np.array([view.rgb[0, 0, :2] * SIDE for view in near])
    np.testing.assert_allclose(corners, np.round(corners), atol=1e-3)
    for view, corner in zip(near, corners, strict=True):
        start = np.round(corner).astype(int)
        cut = place[start[0] : start[0] + VIEW_PIXELS, start[1] : start[1] + VIEW_PIXELS]
        np.testing.assert_allclose(view.rgb, cut, atol=1e-6)
    for index, corner in enumerate(corners):
        assert (np.abs(corners[index + 1 :] - corner).max(axis=1) >= VIEW_PIXELS - 1e-3).all()


@given(
    resolved=st.floats(0.05e-3, 2e-3),
    pitch=st.floats(30e-6, 300e-6),
    side=st.integers(20, 300),
    near=st.integers(0, 6),
    seed=st.integers(0, 99),
)
@settings(max_examples=30, deadline=None)
def test_views_stay_within_image_resolution_and_mask(resolved, pitch, side, near, seed):
    rng = np.random.default_rng(seed)
    mask = np.ones((side, side + 8), dtype=bool)
    hole = rng.integers(0, side, 2)
    mask[hole[0] : hole[0] + side // 8, hole[1] : hole[1] + side // 8] = False
    # Colour tells apart: outside the mask there is red, which must nowhere be seen.
    rgb = np.where(mask[..., None], (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))
    views = cut_views(rgb, None, mask, pitch, resolved, fine_count=near)
    assert len(views) <= 1 + near
    for view in views:
        assert view.pitch_m >= resolved / 2.0 * (1 - 1e-5)
        assert view.pitch_m >= pitch * (1 - 1e-5)
        np.testing.assert_allclose(view.rgb, np.broadcast_to((0.0, 1.0, 0.0), view.rgb.shape), atol=1e-6)
        assert not view.depth_known
        assert not view.depth_m.any()
    widths = [VIEW_PIXELS * view.pitch_m for view in views]
    assert widths == sorted(widths, reverse=True)


def test_coarse_images_give_one_wide_view_and_blurred_ones_none():
    rgb = grey(0.5 + 0.1 * wave(200.0))
    assert [view.pitch_m for view in cut_views(rgb, None, None, NATIVE, 2.0 * PITCHES_M[0])] == [PITCHES_M[0]]
    assert cut_views(rgb, None, None, NATIVE, 2.1 * PITCHES_M[0]) == ()


def test_unknown_depth_is_zero_and_does_not_move_the_rest():
    depth = np.full((SIDE, SIDE), 2e-3)
    depth[:, 300:] = np.nan
    wide = cut_views(grey(np.full((SIDE, SIDE), 0.3)), depth, None, NATIVE, 2.0 * NATIVE)[0]
    assert wide.depth_known
    np.testing.assert_allclose(wide.depth_m, 0.0, atol=1e-9)


def test_shapes_that_do_not_fit_are_refused():
    rgb = np.zeros((80, 80, 3))
    for bad in (
        lambda: cut_views(rgb[..., 0], None, None, NATIVE, 1e-4),
        lambda: cut_views(rgb, np.zeros((4, 4)), None, NATIVE, 1e-4),
        lambda: cut_views(rgb, None, np.ones((4, 4), dtype=bool), NATIVE, 1e-4),
        lambda: cut_views(rgb, None, None, 0.0, 1e-4),
    ):
        with pytest.raises(UsageError):
            bad()


@given(st.integers(0, 2**16), st.floats(0.0, 0.2), st.floats(0.3, 0.7))
def test_contrast_is_the_spread_of_what_eight_bits_store(seed, spread, middle):
    """Half of the pixels above, half below, anywhere; what was not seen does not count."""
    way = np.random.default_rng(seed).permutation(np.repeat([-1.0, 1.0], 32)).reshape(8, 8, 1)
    rgb = np.square(middle + spread * way) * np.ones(3)
    assert measure_contrast(rgb) == pytest.approx(spread, abs=1e-9)
    holed = np.concatenate([rgb, np.full((2, 8, 3), np.nan)])
    assert measure_contrast(holed) == pytest.approx(measure_contrast(rgb), abs=1e-12)
    assert measure_contrast(np.full((4, 4, 3), np.nan)) == 0.0
