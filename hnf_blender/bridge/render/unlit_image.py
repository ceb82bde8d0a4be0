"""Unlit image of a patch: its color and depth, used to predict a relief where the shader has none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hnf_core.scene.mesh import TriangleMesh

from ..shader.aov_taps import Passes, compute_resolved_wavelength
from ..shader.closures import ColourSources

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]

MAX_CODE = 255.0
"""Largest value of an 8-bit image."""
MAX_READABLE_WAVELENGTH_M = 1e-3
"""Longest resolved wavelength of an image from which a relief is predicted [m]. It is softer than the widest view, but
within the training data of D_φ: the blur of its training images (σ up to 0.6 pixels) halves a wave of 1 mm."""
MIN_COLOUR_STD_CODES = 1.0
"""RMS variation, in steps of 1/255, below which a color counts as uniform: a texture's rounding."""


@dataclass(frozen=True)
class UnlitImage:
    """Unlit color and depth of a patch (a square of surface), from which a relief can be predicted.

    Attributes
    ----------
    rgb : (H, W, 3) uint8 array
        255 times the square root of linear color, which has finer steps in the dark, as vision does.
    depth_m : (H, W) float32 array
        Planar depth from the close-up's camera [m], NaN without surface.
    resolved_wavelength_m : float
        Shortest wavelength that the image shows [m]: two texels of its finest texture, two pixels if procedural, two
        vertex spacings for vertex colors.
    source : str
        Description of what it is made from.
    """

    rgb: NDArray[np.uint8]
    depth_m: NDArray[np.float32]
    resolved_wavelength_m: float
    source: str

    @property
    def linear(self) -> NDArray[np.float32]:
        """Linear color (H, W, 3), 0 to 1."""
        return np.asarray((self.rgb.astype(np.float32) / np.float32(MAX_CODE)) ** 2)


def make_unlit_image(
    sources: ColourSources,
    albedo: NDArray[np.float32],
    depth_m: Float,
    mask: Mask,
    *,
    passes: Passes,
    pixel_m: float,
    mesh: TriangleMesh,
    triangle: NDArray[np.int32],
) -> UnlitImage | None:
    """Make the unlit image of a patch.

    Parameters
    ----------
    sources : ColourSources
        Sources of the color.
    albedo : (H, W, 3) array
        Linear color.
    depth_m : (H, W) array
        Planar depth [m].
    mask : (H, W) bool array
        The patch's own surface.
    passes : Passes
        Rendered AOV passes with the texture coordinates of `sources`.
    pixel_m : float
        Size of a pixel [m].
    mesh : TriangleMesh
        Mesh of the surface.
    triangle : (H, W) int array
        Triangle at each pixel, −1 for none.

    Returns
    -------
    UnlitImage or None
        None if the color is uniform under `mask`, or its resolution is unknown.
    """
    if not mask.any():
        return None
    rgb = np.rint(MAX_CODE * np.sqrt(np.clip(np.nan_to_num(albedo), 0.0, 1.0))).astype(np.uint8)
    if float(rgb[mask].std(axis=0).max()) < MIN_COLOUR_STD_CODES:
        return None
    resolved = compute_resolved_wavelength((sources,), passes, mask, pixel_m)
    if sources.painted:
        resolved = min(resolved, max(2.0 * _compute_vertex_spacing(mesh, triangle[mask]), 2.0 * pixel_m))
    if not np.isfinite(resolved):
        return None
    depth = np.where(np.isfinite(depth_m), depth_m, np.nan).astype(np.float32)
    return UnlitImage(rgb, depth, resolved, sources.source)


def _compute_vertex_spacing(mesh: TriangleMesh, triangle: NDArray[np.int32]) -> float:
    """Return the vertex spacing [m] of a regular mesh whose triangles have the median area of the visible ones.

    `triangle` (H, W) is the triangle at each pixel, −1 for none.
    """
    corners = mesh.vertices[mesh.triangles[np.unique(triangle)]]
    areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=-1)
    return float(np.sqrt(2.0 * np.median(areas)))
