"""Length of a Blender unit in metres, and a warning for objects of implausible size."""

from __future__ import annotations

from ctypes import c_float
from typing import Any

from hnf_core.errors import SceneError


def get_metres_per_unit(scene: Any, override: float | None = None) -> float:
    """Return the length of one Blender unit [m].

    Parameters
    ----------
    scene : bpy.types.Scene
        Scene that contains the objects.
    override : float, optional
        Value to use instead, rounded to float32 like the setting in the Touch tab. By default the Touch tab's setting,
        else the scene's unit scale, which is 1 without a unit system.

    Returns
    -------
    float

    Raises
    ------
    SceneError
        If `override` is not a positive number.
    """
    if override is None and scene.hnf.metres_per_unit > 0.0:
        return float(scene.hnf.metres_per_unit)
    if override is not None:
        rounded = c_float(override).value
        if not 0.0 < rounded < float("inf"):
            raise SceneError(f"{override:g} metres per unit cannot be.", remedy="Give a positive number.")
        return rounded
    settings = scene.unit_settings
    return 1.0 if settings.system == "NONE" else float(settings.scale_length)


def get_size_warning(obj: Any, metres: float) -> str | None:
    """Return a warning for an object whose bounding box has a diagonal above 5 m or below 5 mm, else None.

    `metres` is the length of a Blender unit [m]. Scenes in centimetres and unapplied scales show up here.
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
