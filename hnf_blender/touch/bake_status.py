"""Status of a stroke's stored bake, as the panels show it: whether it is still valid, why not, and what was felt."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple


class Freshness(Enum):
    """State of a stroke's stored bake.

    UNKNOWN: not checked since the last change. UNBAKED: there is none. FRESH: still valid. FORCE: only force, seed or
    probe changed, which needs no bake. STALE: path, timing, surface or material changed; it must be baked again.
    BROKEN: the stroke cannot be read.
    """

    UNKNOWN = "unknown"
    UNBAKED = "unbaked"
    FRESH = "fresh"
    FORCE = "force"
    STALE = "stale"
    BROKEN = "broken"


class StrokeStatus(NamedTuple):
    """State of a stroke's stored bake, as the panels show it.

    Attributes
    ----------
    freshness : Freshness
    why : str
        Reason, one sentence for the user.
    duration_s : float
        Duration of the baked stroke [s].
    object_name, library_material, routes : str
        Facts of the bake.
    confidence : float
        Confidence of the bake, 0 to 1.
    warnings : tuple of str
        Warnings and notes of the bake.
    shader : str
        Blender material that the stroke touches most.
    doubted_shaders : tuple of str
        Blender materials whose relief has the height of the library material, since its own is not believed.
    likely : str
        What the material could be, with probabilities; "" if one alone is felt.
    """

    freshness: Freshness
    why: str = ""
    duration_s: float = 0.0
    object_name: str = ""
    library_material: str = ""
    routes: str = ""
    confidence: float = 0.0
    warnings: tuple[str, ...] = ()
    shader: str = ""
    doubted_shaders: tuple[str, ...] = ()
    likely: str = ""
