"""How long a Blender unit is, and whether a hand would meet what is as large as that."""

from __future__ import annotations

from ctypes import c_float
from typing import Any

from hnf_core.errors import SceneError


def get_metres_per_unit(scene: Any, override: float | None = None) -> float:
    """Length of one Blender unit in metres: override, as exact as the Touch tab keeps it, else what the Touch tab says,
    else the scene's unit scale (1 where it has no unit system)."""
    if override is None and scene.hnf.metres_per_unit > 0.0:
        return float(scene.hnf.metres_per_unit)
    if override is not None:
        kept = c_float(override).value
        if not 0.0 < kept < float("inf"):
            raise SceneError(f"{override:g} metres per unit cannot be.", remedy="Give a positive number.")
        return kept
    settings = scene.unit_settings
    return 1.0 if settings.system == "NONE" else float(settings.scale_length)


def get_size_warning(obj: Any, metres: float) -> str | None:
    """A line for a touched object whose bounding box no hand would meet: diagonal above 5 m or below 5 mm.

    metres: metres per Blender unit. Centimetre scenes and unapplied unit scales show here first.
    """
    scale = obj.matrix_world.to_scale()
    corners = list(obj.bound_box)
    sides = [
        abs(scale[i]) * (max(corner[i] for corner in corners) - min(corner[i] for corner in corners)) * metres
        for i in range(3)
    ]
    diagonal = sum(side * side for side in sides) ** 0.5
    if 5e-3 <= diagonal <= 5.0:
        return None
    size = f"{diagonal:.3g} m" if diagonal > 5.0 else f"{diagonal * 1e3:.3g} mm"
    if diagonal > 5.0:
        unit = f"If it is drawn in centimetres, one unit is {metres * 0.01:g} m; in millimetres, {metres * 0.001:g} m"
    else:
        unit = f"Perhaps one unit is more than {metres:g} m"
    return f"object '{obj.name}' is {size} across. {unit}: set it under Units in the Touch tab."
