"""How far a reconstructed surface is to be trusted, in numbers and in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .cloud import Splats
from .nearest import find_nearest_triangles
from .sights import DepthView

Float = NDArray[np.float64]

OPAQUE_OPACITY = 0.5
"""Opacity from which a splat's centre should lie on the surface."""
NEAR_SPACINGS = 2.0
SEARCH_SPACINGS = 4.0
"""Spacings: near the surface; as far as it is looked for."""
MAX_SAMPLED_SPLATS = 1 << 12
"""Splats whose distance is taken, evenly chosen: a share of so many is right to 0.8 %."""
MIN_NEAR_SHARE = 0.6
MAX_OPEN_SHARE = 0.05
MAX_TRANSLUCENT_SHARE = 0.2
MAX_RAGGED_SHARE = 0.25
MIN_RETAINED_SHARE = 0.7
MIN_SPLATS = 200
TRANSLUCENT_RANGE = (0.1, 0.9)
"""Opacity between which a pixel shows neither something solid nor nothing."""
DEPTH_JUMP_PX = 3.0
"""Pixels of depth between two neighbours that no surface has, but at an outline."""


@dataclass(frozen=True)
class Clarity:
    """What views look like. translucent: share of the pixels showing anything that are TRANSLUCENT. ragged: share of
    neighbouring pixels with a CLIFF between them. Both are small where there is a surface, whatever its shape."""

    translucent: float
    ragged: float


def measure_clarity(depth_views: Sequence[DepthView]) -> Clarity:
    """Over all the views; lengths in their pixels."""
    shown = pale = pairs = cliffs = 0
    for sight in depth_views:
        shown += int(np.count_nonzero(sight.opacity > TRANSLUCENT_RANGE[0]))
        pale += int(np.count_nonzero((sight.opacity > TRANSLUCENT_RANGE[0]) & (sight.opacity < TRANSLUCENT_RANGE[1])))
        for axis in (0, 1):
            with np.errstate(invalid="ignore"):
                step = np.abs(np.diff(sight.depth, axis=axis))
            pairs += int(np.count_nonzero(np.isfinite(step)))
            cliffs += int(np.count_nonzero(np.isfinite(step) & (step > DEPTH_JUMP_PX)))
    return Clarity(pale / max(shown, 1), cliffs / max(pairs, 1))


@dataclass(frozen=True)
class Quality:
    """median, most: distance of the opaque splats' centres to the surface, half of them and 95 % within it, in the
    cloud's unit (inf: beyond REACH spacings). spacing: of the surface's vertices, in that unit. near: share of the
    opaque splats' opacity within NEAR spacings. kept: share of all opacity that cleaning left. spread: median over the
    vertices of how far the views disagree on their depth (standard deviation), in spacings. views: how many views see
    the median vertex. open: share of edges with one triangle only. pieces: connected parts. clarity: of the views.
    warnings: what makes it too poor to touch, for an artist to read."""

    median: float
    most: float
    spacing: float
    near: float
    retained: float
    spread: float
    views: float
    open: float
    components: int
    clarity: Clarity
    warnings: tuple[str, ...]

    @property
    def touchable(self) -> bool:
        """Nothing to warn of."""
        return not self.warnings

    def summary(self) -> str:
        """One sentence."""
        half, most = (
            f"{each / self.spacing:.1f}" if np.isfinite(each) else f"more than {SEARCH_SPACINGS:.0f}"
            for each in (self.median, self.most)
        )
        return (
            f"Half of the opaque splats lie within {half} and 95 % within {most} spacings ({self.spacing:.3g} units) "
            f"of the surface; the views disagree by {self.spread:.2f} spacings; "
            f"{100 * self.open:.1f} % of its edges are open."
        )


def measure_surface_distance(
    splats: Splats, vertices: Float, triangles: NDArray[np.integer[Any]], spacing: float
) -> tuple[Float, Float]:
    """Distances of the opaque splats' centres to the surface, inf beyond REACH spacings, and their opacities.

    Where no splat is opaque, of all of them.
    """
    opaque = splats.opacities >= OPAQUE_OPACITY
    which = np.flatnonzero(opaque if opaque.any() else np.ones(len(splats), dtype=np.bool_))
    chosen = splats.take(which[:: max(1, -(-len(which) // MAX_SAMPLED_SPLATS))])
    found = find_nearest_triangles(vertices, triangles, chosen.means, SEARCH_SPACINGS * spacing)
    return found.distance, chosen.opacities.astype(np.float64)


def assess_quality(
    splats: Splats,
    retained: float,
    vertices: Float,
    triangles: NDArray[np.integer[Any]],
    spacing: float,
    spread: NDArray[np.floating[Any]],
    views: NDArray[np.integer[Any]],
    components: int,
    clarity: Clarity,
) -> Quality:
    """splats: the cleaned ones, in the frame of vertices (V, 3). kept: share of all opacity in them. spread: (V,), in
    spacings, of the vertices that views (V,) see."""
    distance, weight = measure_surface_distance(splats, vertices, triangles, spacing)
    median, most = (float(each) for each in np.quantile(distance, (0.5, 0.95), method="higher"))
    near = float(weight[distance <= NEAR_SPACINGS * spacing].sum() / weight.sum())
    seen = views > 0
    disagreement = float(np.median(spread[seen])) if seen.any() else float("inf")
    open_ = compute_open_edge_share(triangles)
    return Quality(
        median, most, spacing, near, retained, disagreement, float(np.median(views)), open_, components, clarity,
        _make_warnings(len(splats), near, retained, open_, clarity),
    )  # fmt: skip


def compute_open_edge_share(triangles: NDArray[np.integer[Any]]) -> float:
    """Share of the edges that belong to one triangle only."""
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    keys = edges[:, 0].astype(np.int64) * (int(edges.max(initial=0)) + 1) + edges[:, 1]
    _, count = np.unique(keys, return_counts=True)
    return float((count == 1).mean()) if len(count) else 1.0


def _make_warnings(count: int, near: float, retained: float, open_: float, clarity: Clarity) -> tuple[str, ...]:
    said = []
    if count < MIN_SPLATS:
        said.append(f"There are only {count} splats: too few to make a surface.")
    if near < MIN_NEAR_SHARE:
        said.append(
            f"Only {100 * near:.0f} % of the opaque splats lie near the surface: this is a cloud or fog more than a "
            "solid thing, or most of it is hidden inside."
        )
    if clarity.translucent > MAX_TRANSLUCENT_SHARE:
        said.append(
            f"{100 * clarity.translucent:.0f} % of what the views show is half transparent: fog, glass, or splats too "
            "small for the gaps between them."
        )
    if clarity.ragged > MAX_RAGGED_SHARE:
        said.append(
            f"Depth jumps between {100 * clarity.ragged:.0f} % of neighbouring pixels: the splats are loose grains, not "
            "a surface. Use fewer cells, or train the reconstruction longer."
        )
    if open_ > MAX_OPEN_SHARE:
        said.append(
            f"{100 * open_:.0f} % of the surface's edges are open: it is full of holes. Touch only where it is whole, "
            "or use fewer cells."
        )
    if retained < MIN_RETAINED_SHARE:
        said.append(f"Cleaning dropped {100 * (1 - retained):.0f} % of the cloud as floating, blurred or far away.")
    return tuple(said)
