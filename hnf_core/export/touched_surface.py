"""A baked surface with a stroke on it, for formats that bind touch to geometry."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from ..errors import SceneError
from ..material.palette import Palette
from ..scene.mesh import TriangleMesh

Float = NDArray[np.float64]
UNTOUCHED = -1


@dataclass(frozen=True)
class StrokePath:
    """Path of a stroke over a surface.

    Attributes
    ----------
    time : (n,) float64
        Times [s], increasing from 0.
    distance : (n,) float64
        Distance traveled over the surface [m], non-decreasing from 0.
    triangle : (n,) int32
        Triangle under the hand; `UNTOUCHED` while it is off the surface or does not press.
    """

    time: Float
    distance: Float
    triangle: NDArray[np.int32]

    @property
    def length_m(self) -> float:
        return float(self.distance[-1]) if len(self.distance) else 0.0

    @property
    def mean_speed_m_s(self) -> float:
        """Mean speed while the hand moves [m/s]; 0 if it never does."""
        moving = np.diff(self.distance) > 0.0
        seconds = float(np.diff(self.time)[moving].sum())
        return self.length_m / seconds if seconds > 0.0 else 0.0


@dataclass(frozen=True)
class TouchedSurface:
    """An object with its baked touch: a material token per triangle, and optionally a stroke's path over it.

    Attributes
    ----------
    name : str
        Name of the object.
    mesh : TriangleMesh
        Mesh of T triangles in the surface frame, z up as in Blender.
    materials : tuple of str
        Material names by slot.
    token : (T,) int32
        Index into the palette; `UNTOUCHED` where nothing is baked.
    roughness : (T,) float32
        RMS height [m].
    confidence : (T,) float32
        Confidence, 0–1.
    palette : Palette or None
        Baked materials; None if nothing is baked.
    placement : (4, 4) float64
        World [m] ← surface frame.
    path : StrokePath or None
        Path of the exported stroke; None if unknown.
    action : Action or None
        Action of the exported stroke; None if unknown.

    Raises
    ------
    SceneError
        If the parts do not fit together.
    """

    name: str
    mesh: TriangleMesh
    materials: tuple[str, ...]
    token: NDArray[np.int32]
    roughness: NDArray[np.float32]
    confidence: NDArray[np.float32]
    palette: Palette | None
    placement: Float = field(default_factory=lambda: np.eye(4))
    path: StrokePath | None = None
    action: Action | None = None

    def __post_init__(self) -> None:
        count, entries = len(self.mesh.triangles), 0 if self.palette is None else len(self.palette)
        where = f"object '{self.name}'"
        if count == 0:
            raise SceneError("it has no faces.", where=where, remedy="Choose an object with faces.")
        if not len(self.token) == len(self.roughness) == len(self.confidence) == count:
            raise SceneError(
                f"it has {count} triangles, its bake has {len(self.token)}.", where=where, remedy=_REBAKE_REMEDY
            )
        if self.token.min() < UNTOUCHED or self.token.max() >= entries:
            raise SceneError(
                f"its faces speak of materials beyond the {entries} baked.", where=where, remedy=_REBAKE_REMEDY
            )


_REBAKE_REMEDY = "Bake the object again."
