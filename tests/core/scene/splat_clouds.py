"""Clouds of splats and cameras for what is seen of them, and how two views are compared."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hnf_core.scene.camera import Camera, orthographic
from hnf_core.scene.splats.gaussians import Splats
from hnf_core.scene.splats.rasterize import render_splats
from reference import splat_rendering
from reference.splat_rendering import render_reference

TIE = 1e-5
"""Of the light: where so much more or less would give the other median, either is right."""


def splats(means, scales=0.1, opacities=0.8, colours=0.5, rotations=(1.0, 0.0, 0.0, 0.0)) -> Splats:
    """Of degree 0. Everything but the means may be one for all."""
    means = np.asarray(means, dtype=np.float32).reshape(-1, 3)

    def each(value, *shape):
        value = np.asarray(value, dtype=np.float32)
        value = value[..., None] if shape and value.ndim < 2 and value.shape in ((), (len(means),)) else value
        return np.broadcast_to(value, (len(means), *shape)).copy()

    harmonics = (each(colours, 3) - 0.5) / np.float32(0.28209479177387814)
    return Splats(means, each(scales, 3), each(rotations, 4), each(opacities), harmonics[:, None])


def both(one: Splats, other: Splats) -> Splats:
    names = ("means", "scales", "rotations", "opacities", "harmonics")
    return Splats(*(np.concatenate([getattr(one, name), getattr(other, name)]) for name in names))


def cloud(seed: int, count: int, *, degree: int = 0, size: float = 0.1, spread: float = 1.0) -> Splats:
    """Around the origin: needles, discs and balls of about that size, of every opacity."""
    rng = np.random.default_rng(seed)
    rotations = rng.normal(size=(count, 4))
    return Splats(
        *(
            np.asarray(each, dtype=np.float32)
            for each in (
                rng.uniform(-1.0, 1.0, (count, 3)),
                size * np.exp(spread * rng.normal(size=(count, 3))),
                rotations / np.linalg.norm(rotations, axis=1, keepdims=True),
                rng.choice([0.0, 1.0, 0.5, 0.02], count) * rng.choice([1.0, 0.9, 0.3], count),
                0.7 * rng.normal(size=(count, (degree + 1) ** 2, 3)),
            )
        )
    )


def perspective(width=40, height=30, *, distance=3.0, focal=36.0, start=0.05, turn=None) -> Camera:
    """Looks at the origin along +z, or along what turn (3, 3) makes of it; its principal point is off the centre."""
    pose = np.eye(4)
    pose[:3, :3] = np.eye(3) if turn is None else turn
    pose[:3, 3] = -distance * pose[:3, 2]
    intrinsics = np.array([[focal, 0.0, 0.52 * width], [0.0, 1.1 * focal, 0.47 * height], [0.0, 0.0, 1.0]])
    return Camera("perspective", width, height, intrinsics, pose, start)


def close_up(pixels=32, size=2.0, distance=3.0) -> Camera:
    return orthographic(np.zeros(3), [1.0, 0.0, 0.0], [0.0, 0.0, -1.0], size, pixels, distance)


def assert_same_view(fast, exact, within=1e-4, span=None):
    """rgb and opacity within, depths within that much of the span of depths that are seen. span: instead of that."""
    assert np.abs(fast.rgb - exact.rgb).max(initial=0.0) <= within * max(1.0, exact.rgb.max(initial=0.0))
    assert np.abs(fast.opacity - exact.opacity).max(initial=0.0) <= within
    for one, other in ((fast.depth, exact.depth), (fast.median, exact.median)):
        seen = np.isfinite(other)
        np.testing.assert_array_equal(np.isfinite(one), seen)
        if seen.any():
            room = np.ptp(exact.depth[np.isfinite(exact.depth)]) if span is None else span
            # float32 cannot write a depth any finer than this
            room = within * room + 1e-7 * np.abs(other[seen]).max()
            assert np.abs(one[seen] - other[seen]).max() <= room


def assert_as_defined(one: Splats, camera: Camera, **settings):
    """render_splats against the reference; the median against the reference's at half the light, a little more and a
    little less, of which it must be one."""
    exact, fast = render_reference(one, camera, **settings), render_splats(one, camera, **settings)
    with pytest.MonkeyPatch.context() as patch:
        medians = [exact.median]
        for share in (0.5 - TIE, 0.5 + TIE):
            patch.setattr(splat_rendering, "MEDIAN_TRANSMITTANCE", share)
            medians.append(render_reference(one, camera, **settings).median)
    with np.errstate(invalid="ignore"):
        apart = [np.where(fast.median == median, 0.0, np.abs(fast.median - median)) for median in medians]
    nearest = np.argmin(np.nan_to_num(apart, nan=np.inf), axis=0)
    median = np.take_along_axis(np.array(medians), nearest[None], axis=0)[0]
    assert (nearest > 0).mean() < 0.01 or len(one) < 10
    assert_same_view(fast, replace(exact, median=median), span=depth_span(one, camera))
    assert (fast.drawn, fast.pairs <= exact.pairs) == (exact.drawn, True)
    return fast, exact


def depth_span(one: Splats, camera: Camera) -> float:
    """Between the nearest and the farthest that any splat reaches."""
    z = (one.means - camera.pose[:3, 3]) @ camera.pose[:3, 2]
    reach = 3.3 * one.scales.max(axis=1, initial=0.0)
    return float(np.max(z + reach, initial=0.0) - np.min(z - reach, initial=0.0))
