"""Laws of the height profile under a stroke: it is the surface's height, whatever patches it was stitched from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hnf_core.field.height_profile import build_stroke_profile
from hnf_core.scene.camera import PATCH_SIZE_M, Patch
from hnf_core.tactile.height import tactile_map_from_height
from hnf_core.tactile.tactile_map import TactileMap

PIXELS = 256
MPP = PATCH_SIZE_M / PIXELS
PITCH = 2.5e-3
AMPLITUDE = 50e-6


def ridge_patch(x_centre: float) -> tuple[Patch, TactileMap]:
    """A patch of the plane z = A sin(2πx / pitch), seen from its own centre."""
    patch = Patch(np.array([x_centre, 0.0, 0.0]), np.array([1.0, 0, 0]), np.array([0, 0, 1.0]), slot=0)
    x = x_centre + (np.arange(PIXELS) + 0.5) * MPP - PATCH_SIZE_M / 2
    height = np.broadcast_to(AMPLITUDE * np.sin(2 * np.pi * x / PITCH), (PIXELS, PIXELS))
    return patch, tactile_map_from_height(height, None, MPP, 2 * MPP)


def straight_path(length: float, samples: int = 241) -> tuple[np.ndarray, np.ndarray]:
    position = np.linspace(0.0, length, samples)
    point = np.stack([position, np.zeros(samples), np.zeros(samples)], axis=-1)
    return position, point


def error_against_ridge(profile) -> float:
    """Share of the ridge's own RMS; the line through the difference is left out, for every map loses its mean plane."""
    places = profile.origin_m + profile.step_m * np.arange(len(profile.height))
    truth = AMPLITUDE * np.sin(2 * np.pi * places / PITCH)
    middle = slice(40, -40)
    difference = profile.height[middle] - truth[middle]
    difference = difference - np.polyval(np.polyfit(places[middle], difference, 1), places[middle])
    return float(np.std(difference) / np.std(truth))


def test_one_patch_gives_the_surface() -> None:
    patch, tactile = ridge_patch(6e-3)
    position, point = straight_path(12e-3)
    profile = build_stroke_profile(position, point, np.zeros(len(position), np.int32), [patch], [tactile])
    assert profile is not None
    assert error_against_ridge(profile) < 0.03


def test_stitched_patches_leave_no_seam() -> None:
    pairs = [ridge_patch(x) for x in (7e-3, 20e-3, 33e-3)]
    position, point = straight_path(40e-3)
    owner = np.digitize(position, [13.5e-3, 26.5e-3]).astype(np.int32)
    profile = build_stroke_profile(position, point, owner, [p for p, _ in pairs], [m for _, m in pairs])
    assert profile is not None
    assert error_against_ridge(profile) < 0.05


def test_going_back_meets_the_same_height() -> None:
    patch, tactile = ridge_patch(6e-3)
    position, point = straight_path(12e-3)
    there = build_stroke_profile(position, point, np.zeros(len(position), np.int32), [patch], [tactile])
    back_position, back_point = np.concatenate([position, position[::-1]]), np.concatenate([point, point[::-1]])
    back = build_stroke_profile(back_position, back_point, np.zeros(len(back_position), np.int32), [patch], [tactile])
    assert there is not None
    assert back is not None
    np.testing.assert_allclose(back.height, there.height, atol=1e-12)


def test_unmeasured_stretch_is_flat() -> None:
    patch, tactile = ridge_patch(6e-3)
    far = Patch(np.array([19e-3, 0, 0]), patch.x_axis, patch.normal, slot=1)
    position, point = straight_path(25e-3)
    owner = (position > 12.5e-3).astype(np.int32)
    profile = build_stroke_profile(position, point, owner, [patch, far], [tactile, None])
    assert profile is not None
    places = profile.origin_m + profile.step_m * np.arange(len(profile.height))
    assert np.abs(profile.height[places > 15e-3]).max() == 0.0
    assert np.abs(profile.height[places < 10e-3]).max() > 0.5 * AMPLITUDE


def test_a_patch_that_resolves_nothing_is_an_unmeasured_one() -> None:
    """Collapsed UVs give texels of infinite size: one such patch does not cost the stroke the others' relief."""
    patch, tactile = ridge_patch(6e-3)
    far = Patch(np.array([19e-3, 0, 0]), patch.x_axis, patch.normal, slot=1)
    position, point = straight_path(25e-3)
    owner = (position > 12.5e-3).astype(np.int32)
    told = build_stroke_profile(
        position, point, owner, [patch, far], [tactile, replace(tactile, resolved_wavelength_m=np.inf)]
    )
    silent = build_stroke_profile(position, point, owner, [patch, far], [tactile, None])
    assert told is not None
    assert silent is not None
    assert told.resolved_wavelength_m == silent.resolved_wavelength_m == 2 * MPP
    np.testing.assert_array_equal(told.height, silent.height)


@pytest.mark.parametrize("case", ["rest", "off", "unmeasured", "unresolved"])
def test_nothing_to_follow_gives_none(case: str) -> None:
    patch, tactile = ridge_patch(0.0)
    position, point = straight_path(12e-3)
    owner = np.zeros(len(position), np.int32)
    if case == "rest":
        position, point = np.zeros_like(position), np.zeros_like(point)
    if case == "off":
        owner -= 1
    if case == "unresolved":
        tactile = replace(tactile, resolved_wavelength_m=np.inf)
    maps = [None if case == "unmeasured" else tactile]
    assert build_stroke_profile(position, point, owner, [patch], maps) is None
