"""Tactile map → token by the network: cut into views, each described, merged band by band."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...errors import UsageError
from ...tactile.height import fill_masked
from ...tactile.optics import decode_gradients, get_sensor, shade
from ...tactile.tactile_map import TactileMap
from ...tactile.views import PITCHES_M, VIEW_PIXELS, antialias, extract_view, find_view_corners
from ..encoder import find_resolved_bands, get_smooth_token_values
from ..merge import merge_tokens
from ..token import BAND_FEATURES, SHAPE_FEATURES, TOKEN_DIM, Token
from .network import AlexNet, build_view_conditions, decode_outputs, forward, normalise_view

FINE_VIEWS = 16
"""Finest views of a whole map, spread over it."""
PITCH_TOLERANCE = 0.005
"""Relative: a map of 64 pixels whose pitch is this near to one of the four is a view already."""


def describe_with_alexnet(network: AlexNet, tactile_map: TactileMap) -> Token:
    """The token of a tactile map: of a 64-pixel map at one of the four pitches as it is, else of one widest view and
    up to NEAR_VIEWS finest ones inside the mask, cut without aliasing.

    Bands that the map does not resolve, or that no view holds, are unknown and hold the smooth floor, as with the
    band descriptor. Raises UsageError where the image and mask do not fit.
    """
    image, mask = tactile_map.image, tactile_map.mask
    if image.ndim != 3 or image.shape[2] != 3 or mask.shape != image.shape[:2]:
        raise UsageError(f"a tactile map's image {image.shape} and mask {mask.shape} do not fit together.")
    views = cut_map_views(tactile_map, FINE_VIEWS)
    if not views:
        return Token(get_smooth_token_values(), np.zeros(TOKEN_DIM, dtype=bool))
    sensor = get_sensor(tactile_map.sensor)
    inputs = [normalise_view(view.image, sensor) for view in views]
    pitches = [view.metres_per_pixel for view in views]
    given = np.stack(
        [build_view_conditions(contrast, sensor, pitch) for (_, contrast), pitch in zip(inputs, pitches, strict=True)]
    )
    outputs = forward(network, np.stack([view for view, _ in inputs]), given)
    tokens = []
    for output, (_, contrast), pitch in zip(outputs, inputs, pitches, strict=True):
        values, known = decode_outputs(output, contrast, pitch)
        tokens.append(_mask_unresolved(values, known, VIEW_PIXELS * pitch, pitch, tactile_map.resolved_wavelength_m))
    return merge_tokens(tokens, [pitch**2 for pitch in pitches])


def _mask_unresolved(
    values: NDArray[np.float32], known: NDArray[np.bool_], size_m: float, pitch_m: float, resolved_wavelength_m: float
) -> Token:
    """The token without the bands that the source of the map does not resolve."""
    bands = find_resolved_bands(size_m, pitch_m, resolved_wavelength_m)
    told = np.concatenate([np.repeat(bands, len(BAND_FEATURES)), np.full(len(SHAPE_FEATURES), bands.sum() > 2)])
    kept = known & told
    return Token(np.where(kept, values, get_smooth_token_values()), kept)


def cut_map_views(tactile_map: TactileMap, fine_count: int) -> tuple[TactileMap, ...]:
    """64-pixel maps at the four pitches: the map itself where it is one, else one widest view and up to `near` finest
    ones inside the mask. Empty where nothing is resolved or seen.

    A coarser view is what the sensor would show of the decimated slopes: averaging the picture instead would mix in
    its curvature, which the network was not trained on.
    """
    image, mask, pitch = tactile_map.image, tactile_map.mask, float(tactile_map.metres_per_pixel)
    if not mask.any() or not np.isfinite(tactile_map.resolved_wavelength_m):
        return ()
    nearest = min(PITCHES_M, key=lambda each: abs(each / pitch - 1.0))
    if image.shape[:2] == (VIEW_PIXELS, VIEW_PIXELS) and abs(nearest / pitch - 1.0) < PITCH_TOLERANCE:
        # There is nowhere else to look: what was not seen is as smooth as a filled map shows it.
        return (replace(tactile_map, metres_per_pixel=nearest),)
    sensor = get_sensor(tactile_map.sensor)
    gx, gy = (fill_masked(slope, mask) for slope in decode_gradients(image, sensor))
    everywhere = np.ones((VIEW_PIXELS, VIEW_PIXELS), dtype=bool)
    # The widest view always serves: what the map does not resolve is left out of the token afterwards.
    resolved = min(tactile_map.resolved_wavelength_m, 2.0 * PITCHES_M[0])
    found = []
    for wanted, corners in find_view_corners(mask, pitch, resolved, fine_count):
        coarse_x, coarse_y = (antialias(slope, wanted / pitch) for slope in (gx, gy))
        for corner in corners:
            along, up = (extract_view(slope, wanted / pitch, corner) for slope in (coarse_x, coarse_y))
            found.append(
                replace(
                    tactile_map,
                    image=shade(along, up, sensor),
                    height=None,
                    mask=everywhere,
                    metres_per_pixel=wanted,
                    resolved_wavelength_m=max(tactile_map.resolved_wavelength_m, 2.0 * wanted),
                )
            )
    return tuple(found)
