"""A file to measure in: a plate of many faces with strokes on it."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

PLATE_CUTS, QUICK_PLATE_CUTS = 316, 8
"""Faces along each side of the plate: 99,856 of them, or 64."""
LARGE_PLATE_M = 0.2
STROKE_COUNT = 3


@contextmanager
def open_test_file() -> Iterator[tuple[Any, Any]]:
    """An empty file with the add-on's properties, and a cache of its own; (scene, view layer)."""
    import bpy

    from .. import props
    from ..jobs import current, running
    from ..jobs.warm import is_preloaded
    from ..state.session import STATE
    from ..state.watch import clear_trackers

    while not is_preloaded():
        time.sleep(0.01)
    if not hasattr(bpy.types.Object, "hnf_stroke"):
        props.register()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with tempfile.TemporaryDirectory() as folder, patch.object(running, "get_cache_folder", lambda: Path(folder)):
        try:
            yield bpy.context.scene, bpy.context.view_layer
        finally:
            current.cancel()
            clear_trackers()
            STATE.clear()


def add_plate_with_strokes(cuts: int) -> Any:
    """A plate of cuts × cuts faces with strokes on it, one more of them to be edited."""
    import bpy

    plate = add_plate("Plate", cuts)
    for name in (*list_stroke_names(), "Beside"):
        add_crossing_stroke(plate, name, turned=0.4 * len(name))
    bpy.context.view_layer.update()
    return plate


def add_plate(name: str, cuts: int) -> Any:
    """A plate of cuts × cuts faces in the scene."""
    import bpy

    mesh = bpy.data.meshes.new(name)
    side = np.linspace(-LARGE_PLATE_M / 2.0, LARGE_PLATE_M / 2.0, cuts + 1)
    x, y = np.meshgrid(side, side)
    corner = (np.arange(cuts)[:, None] * (cuts + 1) + np.arange(cuts)).reshape(-1, 1)
    mesh.from_pydata(
        np.stack([x, y, 0.0 * x], axis=-1).reshape(-1, 3), [], corner + np.array([0, 1, cuts + 2, cuts + 1])
    )
    plate = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(plate)
    return plate


def list_stroke_names() -> tuple[str, ...]:
    return tuple(f"Stroke {'i' * (k + 1)}" for k in range(STROKE_COUNT))


def add_crossing_stroke(plate: Any, name: str, turned: float) -> Any:
    """60 mm through the middle of the plate at 100 mm/s."""
    import bpy

    curve = bpy.data.curves.new(name, "CURVE")
    curve.dimensions = "3D"
    spline = curve.splines.new("POLY")
    spline.points.add(1)
    for point, side in zip(spline.points, (-0.03, 0.03), strict=True):
        point.co = (side * np.cos(turned), side * np.sin(turned), 0.0, 1.0)
    obj = bpy.data.objects.new(name, curve)
    bpy.context.scene.collection.objects.link(obj)
    group = obj.hnf_stroke
    group.is_stroke, group.surface, group.start, group.force = True, plate, 1.0, 1.0
    return obj
