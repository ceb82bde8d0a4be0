"""The finest wave that a picture holds: found where it was blurred, and never where it was not."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.errors import UsageError
from hnf_core.tactile.image_resolution import CUTOFF_MTF, compute_soft_window, estimate_resolved_wavelength

SIDE = 160
ALL = np.ones((SIDE, SIDE), dtype=bool)
ROW, COLUMN = np.mgrid[: 2 * SIDE, : 2 * SIDE]


@lru_cache
def law(beta: float, seed: int) -> np.ndarray:
    noise = np.fft.fft2(np.random.default_rng(seed).normal(size=ROW.shape))
    frequency = radius()
    frequency[0, 0] = np.inf
    return np.fft.ifft2(noise * frequency ** (-beta / 2.0)).real


@lru_cache
def grains(seed: int) -> np.ndarray:
    """Hard-edged discs, one over the other."""
    rng = np.random.default_rng(seed)
    values = np.zeros(ROW.shape)
    at = np.mgrid[:29, :29] - 14
    for _ in range(900):
        row, column = rng.integers(0, len(ROW) - 29, 2)
        disc = np.hypot(*at) < rng.uniform(2, 14)
        values[row : row + 29, column : column + 29][disc] = rng.uniform()
    return values


@lru_cache
def wood(seed: int) -> np.ndarray:
    bent = law(3.0, seed)
    return np.floor((COLUMN / 9 + 1.2 * bent / bent.std()) % 1 * 4) / 4


def stripes(seed: int) -> np.ndarray:
    angle = 0.3 + seed
    return np.sign(np.sin(2.0 * np.pi * (np.cos(angle) * COLUMN + np.sin(angle) * ROW) / 23.0))


NATURAL = {"white": lambda seed: law(0.0, seed), "Field": lambda seed: law(2.0, seed),
           "steep": lambda seed: law(3.0, seed), "grains": grains, "wood": wood}  # fmt: skip


def radius() -> np.ndarray:
    return np.hypot(np.fft.fftfreq(len(ROW))[:, None], np.fft.fftfreq(len(ROW))[None])


def blurred(values: np.ndarray, wave: float) -> np.ndarray:
    """As by a Gaussian that leaves CUTOFF_MTF of a wave of so many pixels."""
    return np.fft.ifft2(np.fft.fft2(values) * CUTOFF_MTF ** ((wave * radius()) ** 2)).real


def cut_off(values: np.ndarray, wave: float) -> np.ndarray:
    return np.fft.ifft2(np.fft.fft2(values) * (radius() <= 1.0 / wave)).real


def enlarged(values: np.ndarray, samples: int) -> np.ndarray:
    """Linearly, from means over so many pixels."""
    small = values.reshape(len(values) // samples, samples, -1, samples).mean(axis=(1, 3))
    at = np.clip((np.arange(len(values)) + 0.5) / samples - 0.5, 0, len(small) - 1)
    known = np.arange(len(small))
    across = np.stack([np.interp(at, known, line) for line in small])
    return np.stack([np.interp(at, known, line) for line in across.T], axis=1)


def grey(values: np.ndarray) -> np.ndarray:
    """The middle of it as a picture of linear colour."""
    inner = values[SIDE // 2 : SIDE // 2 + SIDE, SIDE // 2 : SIDE // 2 + SIDE]
    return np.repeat(0.4 + 0.1 * (inner / inner.std())[..., None], 3, axis=-1)


@pytest.mark.parametrize("make", [*NATURAL.values(), stripes], ids=[*NATURAL, "stripes"])
def test_a_sharp_picture_is_not_called_coarse(make) -> None:
    assert max(estimate_resolved_wavelength(grey(make(seed)), ALL, 1.0) for seed in range(2)) <= 2.6


@pytest.mark.parametrize("make", NATURAL.values(), ids=NATURAL)
@pytest.mark.parametrize("wave", [4.0, 8.0, 16.0])
def test_what_was_blurred_away_is_not_held(make, wave) -> None:
    values = make(3)
    assert estimate_resolved_wavelength(grey(blurred(values, wave)), ALL, 1.0) == pytest.approx(wave, rel=0.3)
    assert estimate_resolved_wavelength(grey(cut_off(values, wave)), ALL, 1.0) == pytest.approx(wave, rel=0.3)


@pytest.mark.parametrize("make", [NATURAL["white"], NATURAL["Field"], grains, wood])
def test_an_enlarged_picture_holds_little_beyond_its_samples(make) -> None:
    # At two of them linear interpolation leaves 0.41, at 1.4 a tenth.
    found = estimate_resolved_wavelength(grey(enlarged(make(4), 5)), ALL, 1.0)
    assert 0.7 * 5 < found < 2.2 * 5


def test_stripes_count_by_the_finer_of_their_directions() -> None:
    along = np.fft.ifft2(
        np.fft.fft2(law(2.0, 0)) * CUTOFF_MTF ** ((20.0 * np.fft.fftfreq(len(ROW))[:, None]) ** 2)
    ).real
    assert estimate_resolved_wavelength(grey(along), ALL, 1.0) <= 2.6
    assert estimate_resolved_wavelength(grey(blurred(stripes(0), 12.0)), ALL, 1.0) == pytest.approx(12.0, rel=0.5)


@settings(max_examples=8, deadline=None)
@given(st.sampled_from([None, 6.0, 11.0]), st.floats(1e-6, 1.0), st.floats(1e-4, 1e3), st.floats(0.0, 10.0))
def test_only_the_size_of_a_pixel_counts(wave, metres, contrast, brightness) -> None:
    values = law(2.0, 7) if wave is None else blurred(law(2.0, 7), wave)
    picture = grey(values)
    plain = estimate_resolved_wavelength(picture, ALL, 1.0)
    assert estimate_resolved_wavelength(contrast * (picture + brightness), ALL, metres) == pytest.approx(
        plain * metres, rel=0.1
    )
    assert estimate_resolved_wavelength(np.rot90(picture), ALL, 1.0) == pytest.approx(plain, rel=0.1)
    assert estimate_resolved_wavelength(picture[:, ::-1], ALL, 1.0) == pytest.approx(plain, rel=0.1)


@settings(max_examples=8, deadline=None)
@given(st.floats(0.0, 50.0))
def test_nothing_finer_is_said_than_what_could_be_held_at_best(finest) -> None:
    best = max(finest, 2.0)
    assert best <= estimate_resolved_wavelength(grey(law(2.0, 8)), ALL, 1.0, finest) <= 1.35 * best
    assert estimate_resolved_wavelength(grey(blurred(grains(8), 9.0)), ALL, 1.0, finest) >= best


def test_what_lies_outside_the_mask_does_not_count() -> None:
    rng = np.random.default_rng(9)
    masks = [np.hypot(*(np.indices(ALL.shape) - SIDE / 2)) < 70, np.abs(np.subtract(*np.indices(ALL.shape))) < 45]
    masks.append(ALL.copy())
    for row, column in rng.integers(10, SIDE - 20, (5, 2)):
        masks[-1][row : row + 9, column : column + 7] = False
    for mask in masks:
        assert (compute_soft_window(mask)[~mask] == 0.0).all()
        for values, wave in ((law(2.0, 2), 2.0), (blurred(law(2.0, 2), 9.0), 9.0)):
            picture = np.where(mask[..., None], grey(values), rng.choice([np.nan, 50.0], (SIDE, SIDE, 1)))
            assert estimate_resolved_wavelength(picture, mask, 1.0) == pytest.approx(wave, rel=0.3)


def test_a_little_noise_is_no_detail_and_a_grain_is() -> None:
    rng = np.random.default_rng(10)
    soft = blurred(law(2.0, 1), 10.0)
    soft /= soft.std()
    noise = rng.normal(size=soft.shape)
    assert estimate_resolved_wavelength(grey(soft + 0.03 * noise), ALL, 1.0) == pytest.approx(10.0, rel=0.3)
    assert estimate_resolved_wavelength(grey(soft + 0.5 * noise), ALL, 1.0) == 2.0


def test_where_there_is_nothing_to_tell_the_splats_have_the_word() -> None:
    flat = np.full((SIDE, SIDE, 3), 0.3, dtype=np.float32)
    assert estimate_resolved_wavelength(flat, ALL, 1e-4, 5e-4) == 5e-4
    assert estimate_resolved_wavelength(flat * (1.0 + 1e-7 * law(0.0, 0)[:SIDE, :SIDE, None]), ALL, 1e-4) == 2e-4
    soft = grey(blurred(law(2.0, 1), 10.0))
    assert estimate_resolved_wavelength(soft, np.zeros_like(ALL), 1.0) == 2.0
    thin = np.abs(np.indices(ALL.shape)[0] - 60) < 2
    assert estimate_resolved_wavelength(soft, thin, 1.0) == 2.0
    assert estimate_resolved_wavelength(soft[:12, :12], ALL[:12, :12], 1.0) == 2.0
    with pytest.raises(UsageError, match="fit together"):
        estimate_resolved_wavelength(soft, ALL[1:], 1.0)
    with pytest.raises(UsageError, match="positive"):
        estimate_resolved_wavelength(soft, ALL, 0.0)
