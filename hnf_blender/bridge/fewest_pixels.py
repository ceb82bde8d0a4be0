"""How many pixels a close-up needs: as many as the images behind its shader have something for, and no more."""

from __future__ import annotations

from itertools import chain

import numpy as np
from numpy.typing import NDArray

from .appearance import list_closures, list_mix_factors
from .look import MAX_READABLE_WAVELENGTH_M
from .shader_height import Relief, Slopes
from .stage import SlotReading
from .taps import Constant, Passes
from .texels import find_finest_texel

Mask = NDArray[np.bool_]

PIXELS_PER_TEXEL = 3.0
"""Of an image that a relief is read from. Images are read by cubic splines, which leave next to nothing beyond their
texels; docs/benchmarks.md has what fewer pixels change."""
PIXELS_PER_TRIANGLE = 16
"""On average: hardly a face under the patch is missed then."""


def get_relief_sources(slot: SlotReading) -> tuple[Relief | Slopes, ...]:
    """All that shapes a slot's surface."""
    micros = [each.micro for each in list_closures(slot.reading.layers)] + [slot.reading.displacement]
    return tuple(chain.from_iterable((*micro.reliefs, *micro.slopes) for micro in micros))


def is_image_based(slot: SlotReading) -> bool:
    """Is all that a slot shows in images, whose texels a first look can measure? What reliefs are mixed by has to be
    the same everywhere: its own detail is not measured."""
    if slot.colour is not None:
        return bool(slot.colour.images) and not (slot.colour.procedural or slot.colour.painted)
    detail = get_relief_sources(slot)
    of_images = bool(detail) and all(each.images and each.texel_limited and not each.procedural for each in detail)
    return of_images and all(isinstance(each, Constant) for each in list_mix_factors(slot.reading.layers))


def choose_resolution(
    slot: SlotReading, passes: Passes, mask: Mask, triangle: NDArray[np.int32], size_m: float, max_pixels: int
) -> int:
    """Side in pixels from which on a slot's images give nothing more, as a first look of fewer tells; at most `most`,
    and as many where it cannot be told.

    A colour that shows waves short enough to estimate a relief from is looked at with all pixels. mask: (H, W), the
    patch's own surface. triangle: (H, W) that each pixel shows. size_m: of the patch's side.
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
