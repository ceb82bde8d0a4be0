"""Tactile map → token by the network: cut into views, each described, merged band by band."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...errors import UsageError
from ...tactile.height import fill_masked
from ...tactile.optics import decode_gradients, sensor_by_name, shade
from ...tactile.tactile_map import TactileMap
from ...tactile.views import PITCHES_M, VIEW_PIXELS, band_limited, view_pixels, view_places
from ..encoder import known_bands, smooth_token_values
from ..merge import merge
from ..token import BAND_FEATURES, SHAPE_FEATURES, TOKEN_DIM, Token
from .network import AlexNet, conditions, forward, token_values, view_input

NEAR_VIEWS = 16
"""Finest views of a whole map, spread over it."""
SAME_PITCH = 0.005
"""Relative: a map of 64 pixels whose pitch is this near to one of the four is a view already."""


def describe_by_alexnet(network: AlexNet, tactile_map: TactileMap) -> Token:
    """The token of a tactile map: of a 64-pixel map at one of the four pitches as it is, else of one widest view and
    up to NEAR_VIEWS finest ones inside the mask, cut without aliasing.

    Bands that the map does not resolve, or that no view holds, are unknown and hold the smooth floor, as with the
    band descriptor. Raises UsageError where the image and mask do not fit.
    """
    image, mask = tactile_map.image, tactile_map.mask
    if image.ndim != 3 or image.shape[2] != 3 or mask.shape != image.shape[:2]:
        raise UsageError(f"a tactile map's image {image.shape} and mask {mask.shape} do not fit together.")
    views = views_of_map(tactile_map, NEAR_VIEWS)
    if not views:
        return Token(smooth_token_values(), np.zeros(TOKEN_DIM, dtype=bool))
    sensor = sensor_by_name(tactile_map.sensor)
    inputs = [view_input(view.image, sensor) for view in views]
    pitches = [view.metres_per_pixel for view in views]
    given = np.stack(
        [conditions(contrast, sensor, pitch) for (_, contrast), pitch in zip(inputs, pitches, strict=True)]
    )
    outputs = forward(network, np.stack([view for view, _ in inputs]), given)
    tokens = []
    for output, (_, contrast), pitch in zip(outputs, inputs, pitches, strict=True):
        values, known = token_values(output, contrast, pitch)
        tokens.append(_resolved(values, known, VIEW_PIXELS * pitch, pitch, tactile_map.resolved_wavelength_m))
    return merge(tokens, [pitch**2 for pitch in pitches])


def _resolved(
    values: NDArray[np.float32], known: NDArray[np.bool_], size_m: float, pitch_m: float, resolved_wavelength_m: float
) -> Token:
    """The token without the bands that the source of the map does not resolve."""
    bands = known_bands(size_m, pitch_m, resolved_wavelength_m)
    told = np.concatenate([np.repeat(bands, len(BAND_FEATURES)), np.full(len(SHAPE_FEATURES), bands.sum() > 2)])
    kept = known & told
    return Token(np.where(kept, values, smooth_token_values()), kept)


def views_of_map(tactile_map: TactileMap, near: int) -> tuple[TactileMap, ...]:
    """64-pixel maps at the four pitches: the map itself where it is one, else one widest view and up to `near` finest
    ones inside the mask. Empty where nothing is resolved or seen.

    A coarser view is what the sensor would show of the decimated slopes: averaging the picture instead would mix in
    its curvature, which the network was not trained on.
    """
    image, mask, pitch = tactile_map.image, tactile_map.mask, float(tactile_map.metres_per_pixel)
    if not mask.any() or not np.isfinite(tactile_map.resolved_wavelength_m):
        return ()
    nearest = min(PITCHES_M, key=lambda each: abs(each / pitch - 1.0))
    if image.shape[:2] == (VIEW_PIXELS, VIEW_PIXELS) and abs(nearest / pitch - 1.0) < SAME_PITCH:
        # There is nowhere else to look: what was not seen is as smooth as a filled map shows it.
        return (replace(tactile_map, metres_per_pixel=nearest),)
    sensor = sensor_by_name(tactile_map.sensor)
    gx, gy = (fill_masked(slope, mask) for slope in decode_gradients(image, sensor))
    everywhere = np.ones((VIEW_PIXELS, VIEW_PIXELS), dtype=bool)
    # The widest view always serves: what the map does not resolve is left out of the token afterwards.
    resolved = min(tactile_map.resolved_wavelength_m, 2.0 * PITCHES_M[0])
    found = []
    for wanted, corners in view_places(mask, pitch, resolved, near):
        coarse_x, coarse_y = (band_limited(slope, wanted / pitch) for slope in (gx, gy))
        for corner in corners:
            along, up = (view_pixels(slope, wanted / pitch, corner) for slope in (coarse_x, coarse_y))
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
