"""Results of jobs as the panels show them: touch queries, material rankings and the check of an external Python."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hnf_core.material.token import Token
    from hnf_core.tactile.tactile_map import Route


@dataclass(frozen=True)
class Relief:
    """Relief of a material as a touch query found it: token and route.

    The token describes its wavelength bands; the route says whether it was measured, predicted or prior.
    """

    token: Token
    route: Route


@dataclass(frozen=True)
class NearestMaterial:
    """Library material similar to the result of a touch query, with the confidence of its ranking.

    `distance` is the distance of its token from the query's, None without a relief.
    """

    name: str
    confidence: float
    distance: float | None
    reason: str


@dataclass(frozen=True)
class QueryView:
    """Result of a touch query (what one point feels like), as the panel shows it.

    Attributes
    ----------
    object_name, material : str
        Names of the object and its material.
    material_full : str
        Full name of the Blender material; "" for none.
    library_material, confidence, reason : str, float, str
        Library material assumed there, its confidence and the reason.
    likely : str
        What it could be, with probabilities; "" if one alone is felt.
    roughness_m : float
        RMS height over all bands [m].
    seen_m : float or None
        RMS height over the measured or predicted bands [m]; None if there are none.
    friction, friction_factor : float
        Friction coefficient, and the factor of one standard deviation.
    stiffness_n_m, stiffness_factor : float
        Stiffness [N/m], and the factor of one standard deviation.
    routes : str
        Routes of the bands as text.
    source : str
        Source of the tactile map.
    nearest : tuple of NearestMaterial
        Library materials, best first.
    notes : tuple of str
        Remarks for the artist.
    icon : int
        Icon of the close-up; 0 for none.
    scene : str
        Name of the scene.
    is_height_doubted : bool
        True if the relief there has the height of the library material, since its own is not believed.
    """

    object_name: str
    material: str
    material_full: str
    library_material: str
    confidence: float
    reason: str
    likely: str
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
    is_height_doubted: bool = False


@dataclass(frozen=True)
class ExternalPython:
    """Python interpreter outside Blender in which materials can be learned.

    Attributes
    ----------
    path : str
        Path as the artist entered it.
    version : str
        For example "3.11.9"; "" if it is no Python.
    found : tuple of (str, str)
        Packages that it can import, with their versions.
    missing : tuple of str
        Packages that it cannot import.
    problem : str
        Why it cannot train, one sentence; "" if it can.
    command : str
        Command that installs the missing packages; "" if none would help.
    """

    path: str
    version: str
    found: tuple[tuple[str, str], ...]
    missing: tuple[str, ...]
    problem: str
    command: str = ""
