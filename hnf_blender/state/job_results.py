"""What the last look at one place found, as the panel shows it.

What is known of a Python outside Blender, in which a material can be learned.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hnf_core.material.token import Token
    from hnf_core.tactile.tactile_map import Route


@dataclass(frozen=True)
class Relief:
    """token: E of the tactile map at a place that was examined. route: how that map came to be known."""

    token: Token
    route: Route


@dataclass(frozen=True)
class NearestMaterial:
    """A library material and how sure the ranking is of it. distance: of its token, None where nothing was seen."""

    name: str
    confidence: float
    distance: float | None
    reason: str


@dataclass(frozen=True)
class QueryView:
    """object_name, material: by name; material_full: full name of the Blender material, "" = none. library_material,
    confidence, reason: what is taken to be there. roughness_m: RMS of all bands; seen_m: of those that were seen, None
    where none was. friction, stiffness_n_m with the factor of one standard deviation. routes: in words. source: where
    the tactile map comes from. icon: of its picture, 0 = none. scene: by name."""

    object_name: str
    material: str
    material_full: str
    library_material: str
    confidence: float
    reason: str
    roughness_m: float
    seen_m: float | None
    friction: float
    friction_factor: float
    stiffness_n_m: float
    stiffness_factor: float
    routes: str
    source: str
    nearest: tuple[NearestMaterial, ...]
    notes: tuple[str, ...]
    icon: int
    scene: str


@dataclass(frozen=True)
class ExternalPython:
    """path: as the artist named it. version: "3.11.9", "" = it is no Python. found: (package, version) of what it can
    import. missing: packages that it cannot. problem: why it cannot train, one sentence; "" = it can. command: what
    installs the missing, "" = nothing would help."""

    path: str
    version: str
    found: tuple[tuple[str, str], ...]
    missing: tuple[str, ...]
    problem: str
    command: str = ""
