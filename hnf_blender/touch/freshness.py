"""How a stroke's stored bake stands to the scene of now."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple


class Freshness(Enum):
    """How a stroke's stored bake stands to the scene.

    UNKNOWN: not looked at since the last change. UNBAKED: none. FRESH: true as it is. FORCE: only force, seed or probe
    changed; heard at once, nothing to bake. STALE: path, timing, surface or material changed; must be baked again.
    BROKEN: the stroke cannot be read; why says so.
    """

    UNKNOWN = "unknown"
    UNBAKED = "unbaked"
    FRESH = "fresh"
    FORCE = "force"
    STALE = "stale"
    BROKEN = "broken"


class StrokeStatus(NamedTuple):
    """why: one sentence for the artist. duration_s, library_material, routes, confidence, warnings: as last baked.
    shader: the Blender material that it mostly touches."""

    freshness: Freshness
    why: str = ""
    duration_s: float = 0.0
    object_name: str = ""
    library_material: str = ""
    routes: str = ""
    confidence: float = 0.0
    warnings: tuple[str, ...] = ()
    shader: str = ""
