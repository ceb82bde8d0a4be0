"""What splats look like, by the plainest code there is: the definition that the fast way is held to."""

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
    """Project a cloud to the footprints that the image sees, front to back.

    Raises UsageError where low_pass [pixels²] is negative or not finite.
    """
    found = concatenate_footprints(
        [project_chunk(splats, camera, low_pass, chunk) for chunk in split_into_chunks(len(splats))]
    )
    return found.take(sort_front_to_back(found))


def render_reference(splats: Splats, camera: Camera, *, low_pass: float = LOW_PASS_PX2) -> SplatView:
    """The view of a camera in the splats' own frame and unit, in float64, one splat after the other from the nearest:
    α = min(0.99, o exp(−q / 2)) at each pixel of its box, left out where o exp(−q / 2) < 1/255; w = α T, T ← T (1 − α),
    and never an early end. low_pass: pixels², added to the variance of every splat. Raises UsageError for one that is
    negative or not finite."""
    prints = project_splats(splats, camera, low_pass)
    colour = evaluate_sh_colours(
        splats.harmonics[prints.index].astype(np.float64),
        compute_view_directions(splats.means[prints.index].astype(np.float64), camera),
    )
    shape = (camera.height, camera.width)
    light, rgb, weighted = np.ones(shape), np.zeros((*shape, 3)), np.zeros(shape)
    median, pairs = np.full(shape, np.inf), 0
    for i in range(len(prints)):
        y = np.arange(prints.top[i], prints.bottom[i])[:, None]
        x = np.arange(prints.left[i], prints.right[i])[None, :]
        steep, across, along = evaluate_quadratic_form(prints, np.array(i), y)
        offset = (x + 0.5) - across
        q = steep + prints.precision[i] * (offset * offset)
        covered = q <= prints.cutoff[i]
        alpha = np.where(covered, np.minimum(MAX_ALPHA, prints.opacity[i] * np.exp(-0.5 * q)), 0.0)
        z = prints.depth[i] + prints.depth_slope_x[i] * ((x + 0.5) - prints.u[i]) + prints.depth_slope_y[i] * along
        box = np.s_[prints.top[i] : prints.bottom[i], prints.left[i] : prints.right[i]]
        before = light[box]
        after = before * (1.0 - alpha)
        rgb[box] += (alpha * before)[..., None] * colour[i]
        weighted[box] += alpha * before * z
        median[box] = np.where((before > MEDIAN_TRANSMITTANCE) & (after <= MEDIAN_TRANSMITTANCE), z, median[box])
        light[box] = after
        pairs += int(covered.sum())
    opacity = 1.0 - light
    depth = np.where(opacity > 0.0, weighted / np.where(opacity > 0.0, opacity, 1.0), np.inf)
    return SplatView(camera, rgb, depth, median, opacity, len(prints), pairs)
