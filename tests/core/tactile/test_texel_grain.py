"""Grain at the texel and finer than a pixel: interpolation undone, folding avoided."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.tactile.fourier_filters import decimate, restore_texels

PIXEL_M = 25e-6


def interpolate(texels: np.ndarray, per_texel: int) -> np.ndarray:
    """Cubic B-spline interpolation of (H, W) texels, as Cycles does, at `per_texel` pixels a texel."""
    for axis in (0, 1):
        position = (np.arange(texels.shape[axis] * per_texel) + 0.5) / per_texel - 0.5
        base = np.floor(position).astype(int)
        t = position - base
        weights = np.stack([(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3]) / 6.0
        taken = [np.take(texels, base + k - 1, axis, mode="wrap") for k in range(4)]
        shape = (-1, 1) if axis == 0 else (1, -1)
        texels = sum(weight.reshape(shape) * each for weight, each in zip(weights, taken, strict=True))
    return texels


def wave(shape, pixel_m, wavelength_m, angle):
    y, x = np.mgrid[: shape[0], : shape[1]] * pixel_m
    return np.sin(2.0 * np.pi * (np.cos(angle) * x + np.sin(angle) * y) / wavelength_m)


@given(st.floats(2.2, 12.0), st.floats(0.0, np.pi), st.integers(3, 4))
@settings(max_examples=30, deadline=None)
def test_a_wave_of_little_more_than_two_texels_has_its_height(texels_per_wave, angle, per_texel):
    texel_m = per_texel * PIXEL_M
    shown = wave((64, 64), texel_m, texels_per_wave * texel_m, angle)
    grid = np.diag([1.0 / texel_m, 1.0 / texel_m])
    restored = restore_texels(1e-6 * interpolate(shown, per_texel), PIXEL_M, grid)
    inner = slice(12 * per_texel, -12 * per_texel)
    level = np.std(restored[inner, inner]) / (1e-6 * np.std(shown[12:-12, 12:-12]))
    assert abs(20.0 * np.log10(level)) < 1.0


def test_long_texels_of_a_strip_do_not_blur_the_short_ones():
    """Texels 16 times as long as wide: a wave of three short texels stays, whatever the long ones resolve."""
    texel_m = 4 * PIXEL_M
    height = 1e-6 * interpolate(wave((8, 64), texel_m, 3.2 * texel_m, 0.0), 4)
    height = np.repeat(height, 8, axis=0)
    grid = np.diag([1.0 / texel_m, 1.0 / (8 * 4 * PIXEL_M)])
    inner = restore_texels(height, PIXEL_M, grid)[:, 48:-48]
    assert np.std(inner) == pytest.approx(1e-6 / np.sqrt(2.0), rel=0.1)


@given(st.floats(0.55, 1.9), st.floats(0.0, np.pi), st.sampled_from([2, 4]))
@settings(max_examples=30, deadline=None)
def test_waves_finer_than_two_pixels_do_not_fold(pixels, angle, factor):
    """Down to the renders' own limit; `pixels` is the wavelength in pixels of the result."""
    pixels = max(pixels, 2.3 / factor)
    fine = wave((64 * factor, 64 * factor), 1.0 / factor, pixels, angle)
    # Along the diagonal the pixels themselves show waves down to √2 pixels.
    along = pixels / max(abs(np.cos(angle)), abs(np.sin(angle)))
    if along < 1.7:
        assert np.std(decimate(fine, factor)[10:-10, 10:-10]) < 0.02


@given(st.floats(2.6, 30.0), st.floats(0.0, np.pi), st.sampled_from([2, 4]))
@settings(max_examples=30, deadline=None)
def test_longer_waves_pass_in_place(pixels, angle, factor):
    fine = wave((64 * factor, 64 * factor), 1.0 / factor, pixels, angle)
    y, x = (np.mgrid[:64, :64] + 0.5) - 0.5 / factor
    exact = np.sin(2.0 * np.pi * (np.cos(angle) * x + np.sin(angle) * y) / pixels)
    inner = slice(10, -10)
    assert np.abs(decimate(fine, factor)[inner, inner] - exact[inner, inner]).max() < 0.1
