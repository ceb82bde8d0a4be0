"""A Curve object's spline as an exact curve in object coordinates."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.bezier import PiecewiseBezier, make_bezier_curve, make_poly_curve
from hnf_core.action.curves import require_single_spline
from hnf_core.action.nurbs import make_nurbs_curve
from hnf_core.errors import HnfError, StrokeError

from .. import compat

Float = NDArray[np.float64]

POINT_MOVING_MODIFIERS = {
    *("ARMATURE", "CAST", "CURVE", "HOOK", "LATTICE", "MESH_DEFORM"),
    *("SHRINKWRAP", "SIMPLE_DEFORM", "SMOOTH", "WARP", "WAVE"),
}
"""Modifiers that put the drawn points elsewhere; bevels and other solid looks leave the path as it is."""


def read_curve(obj: Any) -> PiecewiseBezier:
    """The one spline of a Curve object, in object coordinates (Blender units).

    Raises StrokeError naming the stroke: not a curve, no or several splines, broken points, or points that shape
    keys, keyframes or modifiers move.
    """
    where = f"stroke '{obj.name}'"
    if obj.type != "CURVE":
        raise StrokeError(
            f"it is a {obj.type.lower()} object.",
            where=where,
            remedy="Convert it to a curve (Object > Convert > Curve).",
        )
    _refuse_moved_points(obj, where)
    try:
        return require_single_spline(
            [_read_spline(spline) for spline in obj.data.splines if _count_points(spline)], where=where
        )
    except HnfError as error:
        if error.where:
            raise
        raise StrokeError(error.what, where=where, remedy=error.remedy) from error


def _count_points(spline: Any) -> int:
    return len(spline.bezier_points) if spline.type == "BEZIER" else len(spline.points)


def _read_spline(spline: Any) -> PiecewiseBezier:
    cyclic = bool(spline.use_cyclic_u)
    if spline.type == "BEZIER":
        points = spline.bezier_points
        knots = [_read_points(points, name, 3) for name in ("co", "handle_left", "handle_right")]
        return make_bezier_curve(*knots, cyclic=cyclic)
    points = _read_points(spline.points, "co", 4)
    if spline.type == "NURBS":
        return make_nurbs_curve(
            points[:, :3],
            points[:, 3],
            spline.order_u,
            cyclic=cyclic,
            endpoint=bool(spline.use_endpoint_u),
            bezier=bool(spline.use_bezier_u),
        )
    return make_poly_curve(points[:, :3], cyclic=cyclic)


def _read_points(points: Any, name: str, width: int) -> Float:
    values = np.empty(len(points) * width, dtype=np.float32)
    points.foreach_get(name, values)
    return values.reshape(-1, width).astype(np.float64)


def _refuse_moved_points(obj: Any, where: str) -> None:
    modifier = next((m for m in obj.modifiers if m.show_viewport and m.type in POINT_MOVING_MODIFIERS), None)
    if modifier is not None:
        what, remedy = f"its modifier '{modifier.name}' moves the drawn points.", "Apply the modifier or remove it."
    elif obj.data.shape_keys is not None:
        what, remedy = "its curve has shape keys.", "Remove them, or apply the mix."
    elif any(fcurve.data_path.startswith("splines") for fcurve in compat.fcurves_of(obj.data)):
        what, remedy = "its curve points are keyframed.", "Delete those keyframes; move the object instead."
    else:
        return
    raise StrokeError(what, where=where, remedy=remedy)
