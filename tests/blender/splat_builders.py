"""Clouds of flat Gaussians whose surface and look are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from data_tools.write_splats import write_inria
from hnf_blender.bridge.scene.stored_data import CONFIDENCE_ATTRIBUTE, TOKEN_ATTRIBUTE, PointTokens
from hnf_core.scene.splats.gaussians import Splats

Y_00 = 0.28209479177387814
HALF_M = (30e-3, 15e-3, 5e-3)
"""Of the slab at METRES a unit."""
METRES = 2.0**-6
"""Exact in float32 too, as Blender keeps it."""
FINE_M, LONG_M = 0.16e-3, 1.6e-3
"""Standard deviations of the splats on its top, along x and along y."""
COARSE_M = 2.2e-3
"""Of those on its other sides."""
STRIPE_M = 2.4e-3


def read_point_tokens(cloud) -> PointTokens | None:
    """What write_point_tokens stored; None where there is nothing."""
    mesh, count = cloud.data, len(cloud.data.vertices)
    if any(mesh.attributes.get(name) is None for name in (TOKEN_ATTRIBUTE, CONFIDENCE_ATTRIBUTE)):
        return None
    tokens = PointTokens(np.empty(count, dtype=np.int32), np.empty(count, dtype=np.float32))
    mesh.attributes[TOKEN_ATTRIBUTE].data.foreach_get("value", tokens.index)
    mesh.attributes[CONFIDENCE_ATTRIBUTE].data.foreach_get("value", tokens.confidence)
    return tokens


def slab(*, degree: int = 0) -> Splats:
    """A box of flat Gaussians on jittered grids, striped along x: about 7,700 splats, +z up, METRES a unit."""
    sides = [_side(axis, sign) for axis in (0, 1, 2) for sign in (-1.0, 1.0)]
    centres = np.concatenate([centre for centre, _ in sides])
    sizes = np.concatenate([size for _, size in sides])
    light = 0.5 + 0.35 * np.sign(np.sin(2.0 * np.pi * centres[:, 0] / STRIPE_M))
    harmonics = np.zeros((len(centres), (degree + 1) ** 2, 3))
    harmonics[:, 0] = (light[:, None] * [1.0, 0.8, 0.5] - 0.5) / Y_00
    harmonics[:, 1:] = np.random.default_rng(5).normal(0.0, 0.02, harmonics[:, 1:].shape)
    rotations = np.tile([1.0, 0.0, 0.0, 0.0], (len(centres), 1))
    parts = (centres / METRES, sizes / METRES, rotations, np.full(len(centres), 0.97), harmonics)
    return Splats(*(np.ascontiguousarray(part, dtype=np.float32) for part in parts))


def coarse_slab_file(folder: Path, name: str, left: tuple, right: tuple) -> Path:
    """A slab whose detail stops at millimetres: sRGB `left` where x < 0 and `right` beyond, each with broad stripes."""
    sides = [_side(axis, sign, fine_top=False) for axis in (0, 1, 2) for sign in (-1.0, 1.0)]
    centres = np.concatenate([centre for centre, _ in sides])
    sizes = np.concatenate([size for _, size in sides])
    stripes = 1.0 + 0.15 * np.sin(2.0 * np.pi * centres[:, :1] / 15e-3)
    colours = np.where(centres[:, :1] < 0.0, left, right) * stripes
    harmonics = (colours[:, None, :] - 0.5) / Y_00
    rotations = np.tile([1.0, 0.0, 0.0, 0.0], (len(centres), 1))
    parts = (centres / METRES, sizes / METRES, rotations, np.full(len(centres), 0.97), harmonics)
    splats = Splats(*(np.ascontiguousarray(part, dtype=np.float32) for part in parts))
    write_inria(folder / name, splats, comments=("Vertical Axis: z",))
    return folder / name


def _side(axis: int, sign: float, fine_top: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3) centres and standard deviations in metres of a side; the top (+z) is finer than the rest."""
    along, across = (axis + 1) % 3, (axis + 2) % 3
    fine = fine_top and axis == 2 and sign > 0.0
    sigma = {along: FINE_M if fine else COARSE_M, across: LONG_M if fine else COARSE_M}
    pitch = 1.05  # standard deviations from one to the next
    counts = {each: max(2, int(np.ceil(2.0 * HALF_M[each] / (pitch * sigma[each])))) for each in (along, across)}
    rng = np.random.default_rng(8 + axis)
    grids = np.meshgrid(*((np.arange(counts[each]) + 0.5) / counts[each] for each in (along, across)))
    centres, sizes = np.zeros((grids[0].size, 3)), np.full((grids[0].size, 3), 0.05e-3)
    for each, grid in zip((along, across), grids, strict=True):
        jitter = rng.normal(0.0, 0.1 * sigma[each], grid.size)
        centres[:, each] = (2.0 * grid.ravel() - 1.0) * HALF_M[each] + jitter
        sizes[:, each] = sigma[each]
    # Never all in one plane: which of two splats at one depth is in front, only rounding would say.
    centres[:, axis] = sign * HALF_M[axis] + rng.normal(0.0, 20e-6, grids[0].size)
    return centres, sizes


def slab_file(folder: Path, name: str = "slab.ply", *, degree: int = 0) -> Path:
    path = folder / name
    write_inria(path, slab(degree=degree), comments=("Vertical Axis: z",))
    return path
