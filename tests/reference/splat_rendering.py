"""Brute-force reference for rendering Gaussian splats, which the fast rasterizer must match."""

from __future__ import annotations

import numpy as np

from hnf_core.scene.camera import Camera
from hnf_core.scene.splats.gaussians import Splats, compute_view_directions, evaluate_sh_colours
from hnf_core.scene.splats.project import (
    LOW_PASS_PX2,
    MAX_ALPHA,
    MEDIAN_TRANSMITTANCE,
    Footprints,
    concatenate_footprints,
    evaluate_quadratic_form,
    project_chunk,
    sort_front_to_back,
    split_into_chunks,
)
from hnf_core.scene.splats.rasterize import SplatView


def project_splats(splats: Splats, camera: Camera, low_pass: float = LOW_PASS_PX2) -> Footprints:
    """Project splats to the footprints that are visible in the image, front to back.

    Raises UsageError where low_pass [pixels²] is negative or not finite.
    """
    footprints = concatenate_footprints(
        [project_chunk(splats, camera, low_pass, chunk) for chunk in split_into_chunks(len(splats))]
    )
    return footprints.take(sort_front_to_back(footprints))


def render_reference(splats: Splats, camera: Camera, *, low_pass: float = LOW_PASS_PX2) -> SplatView:
    """Render splats from a camera in their own frame and unit, in float64, one after the other from the nearest.

    Parameters
    ----------
    splats
        The splats.
    camera
        Camera in the splats' frame.
    low_pass
        Variance added to every splat [pixels²].

    Returns
    -------
    SplatView
        The rendered view.

    Raises
    ------
    UsageError
        If low_pass is negative or not finite.

    Notes
    -----
    α = min(0.99, o exp(−q / 2)) at each pixel of a splat's box, left out where o exp(−q / 2) < 1/255; w = α T,
    T ← T (1 − α). No ray ends early.
    """
    footprints = project_splats(splats, camera, low_pass)
    colour = evaluate_sh_colours(
        splats.harmonics[footprints.index].astype(np.float64),
        compute_view_directions(splats.means[footprints.index].astype(np.float64), camera),
    )
    shape = (camera.height, camera.width)
    transmittance, rgb, weighted = np.ones(shape), np.zeros((*shape, 3)), np.zeros(shape)
    median, pairs = np.full(shape, np.inf), 0
    for i in range(len(footprints)):
        y = np.arange(footprints.top[i], footprints.bottom[i])[:, None]
        x = np.arange(footprints.left[i], footprints.right[i])[None, :]
        steep, across, along = evaluate_quadratic_form(footprints, np.array(i), y)
        offset = (x + 0.5) - across
        q = steep + footprints.precision[i] * (offset * offset)
        covered = q <= footprints.cutoff[i]
        alpha = np.where(covered, np.minimum(MAX_ALPHA, footprints.opacity[i] * np.exp(-0.5 * q)), 0.0)
        z = (
            footprints.depth[i]
            + footprints.depth_slope_x[i] * ((x + 0.5) - footprints.u[i])
            + footprints.depth_slope_y[i] * along
        )
        box = np.s_[footprints.top[i] : footprints.bottom[i], footprints.left[i] : footprints.right[i]]
        before = transmittance[box]
        after = before * (1.0 - alpha)
        rgb[box] += (alpha * before)[..., None] * colour[i]
        weighted[box] += alpha * before * z
        median[box] = np.where((before > MEDIAN_TRANSMITTANCE) & (after <= MEDIAN_TRANSMITTANCE), z, median[box])
        transmittance[box] = after
        pairs += int(covered.sum())
    opacity = 1.0 - transmittance
    depth = np.where(opacity > 0.0, weighted / np.where(opacity > 0.0, opacity, 1.0), np.inf)
    return SplatView(camera, rgb, depth, median, opacity, len(footprints), pairs)
