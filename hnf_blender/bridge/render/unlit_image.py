"""What a patch looks like: its unlit colour, kept where the shader says nothing of its relief."""

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
MAX_READABLE_WAVELENGTH_M = 1e-3
"""A picture from which a relief is to be estimated must show waves as short as this. It is then softer than the widest
view, though not softer than D_φ knows: of 1 mm the blur of its training pictures (σ up to 0.6 pixels) leaves a half."""
MIN_COLOUR_STD_CODES = 1.0
"""A colour that varies by less than this many of 255 steps (RMS) is the same everywhere: a texture's own rounding."""


@dataclass(frozen=True)
class UnlitImage:
    """A patch's unlit look.

    rgb: (H, W, 3) uint8, 255 times the square root of linear colour: finer in the dark, as eyes are. depth_m: (H, W)
    float32 planar depth from the close-up's camera, NaN where there is no surface. resolved_wavelength_m: shortest wave
    that the picture shows (two texels of its finest image, two pixels where procedural, two points of a painted mesh).
    source: what it is made from, in words.
    """

    rgb: NDArray[np.uint8]
    depth_m: NDArray[np.float32]
    resolved_wavelength_m: float
    source: str

    @property
    def linear(self) -> NDArray[np.float32]:
        """(H, W, 3) linear colour, 0–1."""
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
    """The look of a patch; None where its colour is the same all over mask, or its detail cannot be told.

    albedo: (H, W, 3) linear. triangle: (H, W) that each pixel shows, −1 = none.
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
    """Metres between the points of an even mesh whose triangles have the median area of those seen."""
    corners = mesh.vertices[mesh.triangles[np.unique(triangle)]]
    areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=-1)
    return float(np.sqrt(2.0 * np.median(areas)))
