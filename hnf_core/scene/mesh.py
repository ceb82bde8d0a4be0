"""The geometry that rays and strokes meet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class TriangleMesh:
    """A triangulated surface in metres.

    vertices: (V, 3) float64. triangles: (T, 3) int32. face: (T,) int32 polygon each triangle came from.
    slot: (T,) int32 material slot. normals: (T, 3, 3) float64 unit corner normals (smooth shading included).
    uv: (T, 3, 2) float64 corner UVs, or None where the mesh has none.
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]
    face: NDArray[np.int32]
    slot: NDArray[np.int32]
    normals: NDArray[np.float64]
    uv: NDArray[np.float64] | None = None

    def corner_positions(self) -> NDArray[np.float64]:
        """(T, 3, 3)."""
        return self.vertices[self.triangles]
