"""E: tokens of surfaces for any sensor, mask and place."""

import numpy as np
import pytest
from hypothesis import Phase, example, given, settings
from hypothesis import strategies as st
from unresolved_maps import unresolved_tactile_map

from hnf_core.errors import UsageError
from hnf_core.material.band_descriptor import (
    band_edges_per_metre,
    describe,
    find_resolved_bands,
    get_smooth_token_values,
)
from hnf_core.material.token import BAND_FEATURES, BAND_WAVELENGTHS_M, SMOOTH_LEVEL, band_slice
from hnf_core.tactile.height import tactile_map_from_height
from hnf_core.tactile.tactile_map import TactileMap

SIZE = 256
SIDE = 10e-3
PITCH = SIDE / SIZE
AXIS = (np.arange(SIZE) + 0.5 - SIZE / 2) * PITCH
X, Y = np.meshgrid(AXIS, -AXIS)
FIRST = int(np.flatnonzero(find_resolved_bands(SIDE, PITCH, 2 * PITCH))[0])
BANDS = range(FIRST, len(BAND_WAVELENGTHS_M))
"""A 10 mm patch holds two periods of 4 mm and less."""


def bands_of(values: np.ndarray) -> np.ndarray:
    return values[: len(BAND_WAVELENGTHS_M) * len(BAND_FEATURES)].reshape(len(BAND_WAVELENGTHS_M), -1)[FIRST:]


def assert_same_token(got: np.ndarray, expected: np.ndarray, atol: float = 5e-3, bands: slice = slice(None)) -> None:
    """Equal within atol; but of noise, which has no wave to name, the peak within 0.15 and its place not at all:
    which of two like bins leads is chance."""
    a, b = bands_of(got)[bands], bands_of(expected)[bands]
    np.testing.assert_allclose(a[:, :5], b[:, :5], atol=atol)
    real = (a[:, 5] > 0.9) & (b[:, 5] > 0.9)
    np.testing.assert_allclose(a[real, 5:], b[real, 5:], atol=4 * atol)
    np.testing.assert_allclose(a[:, 5], b[:, 5], atol=0.15)
    np.testing.assert_allclose(got[-2:], expected[-2:], atol=atol)


QUARTER_TURN = np.array([1, -1, -1, 1, 1, 1, 1])
MIRROR = np.array([1, 1, -1, 1, -1, 1, 1])


def with_bands(values: np.ndarray, factors: np.ndarray) -> np.ndarray:
    """A token whose band features are multiplied by (7,) factors."""
    return values * np.concatenate([np.tile(factors, len(BAND_WAVELENGTHS_M)), [1, 1]])


def tactile(height: np.ndarray, sensor: str = "gelsight", mask: np.ndarray | None = None) -> TactileMap:
    return tactile_map_from_height(height, mask, PITCH, 2 * PITCH, sensor)


def random_height(seed: int, slope: float, stretch: float = 1.0, rms: float = 5e-6) -> np.ndarray:
    """Power-law noise cut from a larger sheet, so that nothing repeats; stretch > 1 makes grain along x."""
    rng = np.random.default_rng(seed)
    fy, fx = np.fft.fftfreq(2 * SIZE, PITCH)[:, None], np.fft.rfftfreq(2 * SIZE, PITCH)[None, :]
    f = np.sqrt((fx * stretch) ** 2 + fy**2)
    gain = np.maximum(f, 1.0 / SIDE) ** (-slope / 2) * (f < 0.45 / PITCH)
    sheet = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((2 * SIZE, 2 * SIZE))) * gain)
    height = sheet[:SIZE, :SIZE] - sheet[:SIZE, :SIZE].mean()
    return rms * height / height.std()


surfaces = st.builds(
    random_height, st.integers(0, 2**32 - 1), st.floats(2.0, 4.0), st.floats(1.0, 4.0), st.floats(1e-6, 8e-6)
)


@settings(max_examples=12, deadline=None)
@given(surfaces)
def test_gelsight_and_digit_give_one_token(height):
    a, b = (describe(tactile(height, sensor)) for sensor in ("gelsight", "digit"))
    assert np.array_equal(a.known, b.known)
    assert_same_token(a.values, b.values)


@settings(max_examples=12, deadline=None)
@given(surfaces)
def test_doubling_the_height_raises_every_level_by_log_two(height):
    once, twice = (describe(tactile(gain * height)).values for gain in (1.0, 2.0))
    # A few nanometres fade into the floor; this is the law of what stands clear of it.
    clear = int((bands_of(once)[:, 0] > SMOOTH_LEVEL + 1.5).sum())
    assert clear >= 3
    raised = once.copy()
    raised[:-2].reshape(len(BAND_WAVELENGTHS_M), -1)[FIRST:, 0] += np.log10(2)
    assert_same_token(twice, raised, bands=slice(0, clear))


@settings(max_examples=12, deadline=None)
@given(surfaces)
def test_a_quarter_turn_turns_the_anisotropy_and_nothing_else(height):
    plain, turned = (describe(tactile(h)).values for h in (height, np.rot90(height)))
    assert_same_token(turned, with_bands(plain, QUARTER_TURN))


@settings(max_examples=8, deadline=None)
@given(surfaces)
def test_mirroring_and_pressing_the_negative_do_what_they_must(height):
    plain = describe(tactile(height)).values
    assert_same_token(describe(tactile(height[:, ::-1])).values, with_bands(plain, MIRROR))
    negative = describe(tactile(-height)).values
    assert negative[-2] == pytest.approx(-plain[-2], abs=5e-3)
    negative[-2] = plain[-2]
    assert_same_token(negative, plain)


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.3e-3, 2.5e-3), st.floats(0, np.pi))
def test_a_wave_in_noise_has_one_token_for_all_sensors_and_turns(seed, pitch, angle):
    wave = 2 * np.pi / pitch * (X * np.cos(angle) + Y * np.sin(angle))
    height = random_height(seed, 2.5, rms=0.2e-6) + 4e-6 * np.sin(wave)
    band = slice(int(np.argmin(np.abs(np.log(BAND_WAVELENGTHS_M / pitch)))) - FIRST, None)
    plain = bands_of(describe(tactile(height)).values)[band][0]
    assert plain[5] > 0.9
    for other, factors in ((tactile(height, "digit"), np.ones(7)), (tactile(np.rot90(height)), QUARTER_TURN)):
        np.testing.assert_allclose(bands_of(describe(other).values)[band][0], plain * factors, atol=5e-3)


@settings(max_examples=8, deadline=None)
@given(surfaces, st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), st.floats(-1e-2, 1e-2))
def test_tilt_lift_and_a_gentle_curve_are_shape_not_texture(height, a, b, c):
    plain = describe(tactile(height)).values
    bent = describe(tactile(height + a * X + b * Y + c + 2.0 * (X**2 - Y**2))).values
    np.testing.assert_allclose(bands_of(bent)[1:, :5], bands_of(plain)[1:, :5], atol=2e-2)


@settings(max_examples=25, deadline=None)
@given(st.floats(0.1, 3.6), st.floats(0, np.pi), st.floats(0, 2 * np.pi))
def test_a_grating_names_its_pitch_direction_and_height(pitch_mm, angle, phase):
    pitch = pitch_mm * 1e-3
    amplitude = 0.01 * pitch
    wave = 2 * np.pi / pitch * (X * np.cos(angle) + Y * np.sin(angle)) + phase
    values = describe(tactile(amplitude * np.sin(wave))).values
    band = int(np.argmin(np.abs(np.log(BAND_WAVELENGTHS_M / pitch))))
    _, cos2, sin2, cos4, sin4, peak, offset = values[band_slice(band)]
    assert BAND_WAVELENGTHS_M[band] / 2**offset == pytest.approx(pitch, rel=0.01)
    assert peak > 0.95
    # Near a band's edge the neighbour gets its share: together they hold the wave.
    total = np.sum(10.0 ** (2 * bands_of(values)[:, 0]))
    assert total == pytest.approx(amplitude**2 / 2, rel=0.25 if pitch > 2e-3 else 0.02)
    # Directions are as sharp as the window is wide: the spread of one lobe.
    spread = 2.5 * (pitch / SIDE) ** 2 + 0.02
    np.testing.assert_allclose([cos2, sin2], [np.cos(2 * angle), np.sin(2 * angle)], atol=spread)
    np.testing.assert_allclose([cos4, sin4], [np.cos(4 * angle), np.sin(4 * angle)], atol=4 * spread)


def test_noise_has_no_peak_and_a_weave_is_four_fold():
    noise = bands_of(describe(tactile(random_height(0, 2.0))).values)
    assert noise[2:, 5].max() < 0.2
    pitch = 1e-3
    weave = 3e-6 * (np.sin(2 * np.pi * X / pitch) + np.sin(2 * np.pi * Y / pitch))
    values = describe(tactile(weave)).values[band_slice(3)]
    assert values[3] == pytest.approx(1.0, abs=0.05)
    assert abs(values[1]) < 0.02
    assert values[5] == pytest.approx(0.5, abs=0.02)


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(-2, 2), st.integers(-2, 2))
def test_a_small_shift_changes_little(seed, down, across):
    sheet = random_height(seed, 3.0)
    part = slice(8, SIZE - 8)
    here = describe(tactile(sheet[part, part])).values
    there = describe(tactile(sheet[8 + down : SIZE - 8 + down, 8 + across : SIZE - 8 + across])).values
    np.testing.assert_allclose(bands_of(there)[1:, :5], bands_of(here)[1:, :5], atol=0.05)


@settings(max_examples=8, deadline=None, phases=[Phase.explicit, Phase.reuse, Phase.generate])
@example(random_height(11904, 3.94, 3.68, 1e-6))
@given(surfaces)
def test_the_token_agrees_with_a_plain_spectrum_of_the_height(height):
    """Reference: the height itself less its best quadric, one complex FFT, bins on an edge shared and the floor
    added as E does, loops."""
    window = np.outer(np.hanning(SIZE + 2)[1:-1], np.hanning(SIZE + 2)[1:-1])
    quadric = np.stack([g.ravel() for g in (X**0, X, Y, X * X, X * Y, Y * Y)], axis=1) / [
        1,
        *[SIDE] * 2,
        *[SIDE**2] * 3,
    ]
    weighted = window.ravel()[:, None] * quadric
    fit = np.linalg.solve(quadric.T @ weighted, weighted.T @ height.ravel())
    rest = height - (quadric @ fit).reshape(SIZE, SIZE)
    power = np.abs(np.fft.fft2(window * rest)) ** 2 / (SIZE**2 * np.sum(window**2))
    fy, fx = -np.fft.fftfreq(SIZE, PITCH)[:, None], np.fft.fftfreq(SIZE, PITCH)[None, :]
    theta, f = np.arctan2(fy, fx), np.hypot(fx, fy)
    above = [np.clip((f - edge) * SIDE + 0.5, 0.0, 1.0) for edge in band_edges_per_metre()]
    values = describe(tactile(height)).values
    for band in BANDS:
        share = above[band] - above[band + 1]
        p = power * share
        level, cos2, sin2, cos4, sin4, _, _ = values[band_slice(band)]
        total = p.sum() + 10.0 ** (2.0 * SMOOTH_LEVEL)
        # Where few bins hold the power, it weighs that E's window is on slopes and this one on heights.
        loose = np.sqrt((p**2).sum()) / p.sum()
        assert level == pytest.approx(0.5 * np.log10(total), abs=0.002 + 0.52 * loose)
        sums = [(p * wave(n * theta)).sum() / total for n in (2, 4) for wave in (np.cos, np.sin)]
        np.testing.assert_allclose([cos2, sin2, cos4, sin4], sums, atol=0.005 + 2.0 / np.sqrt(share.sum()))


def test_pits_and_grains_differ_in_the_sign_of_skewness():
    rng = np.random.default_rng(5)
    grains = np.zeros((SIZE, SIZE))
    for x, y in rng.uniform(-SIDE / 2, SIDE / 2, (150, 2)):
        grains += 5e-6 * np.exp(-((X - x) ** 2 + (Y - y) ** 2) / (2 * 0.1e-3**2))
    up, down = describe(tactile(grains)).values, describe(tactile(-grains)).values
    assert up[-2] > 1.0
    assert down[-2] == pytest.approx(-up[-2], abs=0.01)
    assert up[-1] > 0.2
    noise = describe(tactile(random_height(2, 2.0))).values
    assert abs(noise[-2]) < 0.2
    assert abs(noise[-1]) < 0.1


def test_flat_and_subnanometre_relief_give_the_smooth_token():
    flat = describe(tactile(np.zeros((SIZE, SIZE))))
    np.testing.assert_allclose(flat.values, get_smooth_token_values(), atol=0.02)
    assert bands_of(flat.known).all()
    whisper = describe(tactile(random_height(0, 3.0, rms=1e-11)))
    np.testing.assert_allclose(bands_of(whisper.values)[:, 0], SMOOTH_LEVEL, atol=0.05)
    np.testing.assert_allclose(bands_of(whisper.values)[:, 1:], 0.0, atol=0.1)


@pytest.mark.parametrize("resolved", [1e-9, 0.3e-3, 1.2e-3, 3.1e-3, np.inf])
def test_only_resolved_bands_are_known_and_others_are_smooth(resolved):
    token = describe(tactile_map_from_height(random_height(1, 3.0), None, PITCH, resolved))
    expected = find_resolved_bands(SIDE, PITCH, resolved)
    for band, known in enumerate(expected):
        part = band_slice(band)
        assert (token.known[part] == known).all()
        if not known:
            assert np.array_equal(token.values[part], get_smooth_token_values()[part])
    assert expected.any() == (resolved < 2e-3)
    for band in np.flatnonzero(expected):
        assert resolved <= BAND_WAVELENGTHS_M[band] / np.sqrt(2)


def test_known_bands_do_not_depend_on_what_lies_below_the_cut():
    height = random_height(1, 3.0)
    full = describe(tactile(height)).values
    cut = describe(tactile_map_from_height(height, None, PITCH, 0.3e-3))
    known = bands_of(cut.known)[:, 0]
    np.testing.assert_allclose(bands_of(cut.values)[known, :5], bands_of(full)[known, :5], atol=0.05)
    assert known.any()


def test_a_partly_covered_patch_is_described_by_what_is_seen():
    height = random_height(4, 2.5)
    mask = np.ones((SIZE, SIZE), dtype=bool)
    mask[:, 170:] = False
    token = describe(tactile(np.where(mask, height, 5e-3), mask=mask))
    reference = describe(tactile(height))
    np.testing.assert_allclose(bands_of(token.values)[2:, 0], bands_of(reference.values)[2:, 0], atol=0.1)
    np.testing.assert_allclose(bands_of(token.values)[3:, 1:5], bands_of(reference.values)[3:, 1:5], atol=0.15)
    sprinkled = np.random.default_rng(0).random((SIZE, SIZE)) > 0.02
    speckled = describe(tactile(height, mask=sprinkled))
    np.testing.assert_allclose(bands_of(speckled.values)[:-1, 0], bands_of(reference.values)[:-1, 0], atol=0.05)


def test_an_unresolved_map_knows_nothing_and_a_misfit_is_refused():
    nothing = describe(unresolved_tactile_map((SIZE, SIZE), PITCH))
    assert not nothing.known.any()
    assert np.array_equal(nothing.values, get_smooth_token_values())
    good = tactile(random_height(0, 3.0))
    with pytest.raises(UsageError):
        describe(TactileMap(good.image[:-1], None, good.mask, PITCH, "gelsight", 2 * PITCH, good.route))
    hidden = TactileMap(good.image, None, np.zeros_like(good.mask), PITCH, "gelsight", 2 * PITCH, good.route)
    assert not describe(hidden).known.any()
