"""Resolution of a close-up: how many pixels show what a material's images and a mesh's faces hold, and no more."""

from __future__ import annotations

from itertools import chain

import numpy as np
from numpy.typing import NDArray

from hnf_core.tactile.mesh_relief import FaceSpacing

from ..shader.aov_taps import Constant, Passes, find_finest_texel
from ..shader.bump_displacement import Relief, Slopes
from ..shader.closures import list_closures, list_mix_factors
from .cycles import MAX_READABLE_WAVELENGTH_M
from .isolated_object import SlotReading

Mask = NDArray[np.bool_]

PIXELS_PER_MESH_WAVE = 4.0
"""Pixels per shortest wave that the faces under a patch hold."""
PIXELS_PER_TEXEL = 3.0
"""Pixels per texel of an image from which a relief is read. Images are interpolated by cubic splines, which leave
almost nothing beyond their texels; docs/benchmarks.md shows the effect of fewer pixels."""
PIXELS_PER_TRIANGLE = 16
"""Mean number of pixels per triangle, at which hardly a face under the patch is missed."""


def get_relief_sources(slot: SlotReading) -> tuple[Relief | Slopes, ...]:
    """Return what shapes a material slot's surface: reliefs (bump, displacement) and slopes (normal maps)."""
    micros = [closure.micro for closure in list_closures(slot.reading.layers)] + [slot.reading.displacement]
    return tuple(chain.from_iterable((*micro.reliefs, *micro.slopes) for micro in micros))


def is_image_based(slot: SlotReading) -> bool:
    """Return True if all detail of a material slot is in images, whose texels a first render can measure.

    If shaders are mixed, the mix factors must be constant, as their own detail is not measured.
    """
    if slot.colour is not None:
        return bool(slot.colour.images) and not (slot.colour.procedural or slot.colour.painted)
    sources = get_relief_sources(slot)
    if not all(source.images and source.texel_limited and not source.procedural for source in sources):
        return False
    return bool(sources) and all(isinstance(factor, Constant) for factor in list_mix_factors(slot.reading.layers))


def choose_resolution(
    slot: SlotReading, passes: Passes, mask: Mask, triangle: NDArray[np.int32], size_m: float, max_pixels: int
) -> int:
    """Return the image side [pixels] beyond which a slot's images show nothing more, at most `max_pixels`.

    It is `max_pixels` if the size of the texels is unknown, or if the slot has no relief and its color image is fine
    enough for a relief to be predicted from it.

    Parameters
    ----------
    slot : SlotReading
        The patch's material slot.
    passes : Passes
        AOV passes (H, W) of the first, coarse render.
    mask : (H, W) bool array
        The patch's own surface.
    triangle : (H, W) int array
        Triangle at each pixel.
    size_m : float
        Side of the patch [m].
    max_pixels : int
        Maximum side [pixels].

    Returns
    -------
    int
    """
    side = mask.shape[1]
    if not mask.any():
        return max_pixels
    sources = get_relief_sources(slot) if slot.colour is None else (slot.colour,)
    texel = find_finest_texel(sources, passes, mask, size_m / side)
    if not np.isfinite(texel) or (slot.colour is not None and 2.0 * texel <= MAX_READABLE_WAVELENGTH_M):
        return max_pixels
    while side < max_pixels and (
        size_m / side > texel / PIXELS_PER_TEXEL
        or mask.sum() * (side / mask.shape[1]) ** 2 < PIXELS_PER_TRIANGLE * len(np.unique(triangle[mask]))
    ):
        side *= 2
    return min(side, max_pixels)


def choose_mesh_side(side: int, size_m: float, spacing: FaceSpacing) -> int:
    """Return the image side [pixels], at least `side`, that shows the shortest waves that the faces hold."""
    while size_m / side > spacing.shortest_m / PIXELS_PER_MESH_WAVE:
        side *= 2
    return side
