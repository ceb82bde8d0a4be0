"""Objects on the table of the demo scene, at their real sizes in metres."""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np

from . import materials
from .shapes import add_box, add_cord, add_lathe, add_sheet, new_form, new_object, round_corners

CUSHION_HALF = 0.11
TIN_RADIUS = 0.042


def place_object(obj: Any, location: tuple[float, float, float], turn_degrees: float, *mats: Any) -> Any:
    for material in mats:
        obj.data.materials.append(material)
    obj.location, obj.rotation_euler = location, (0.0, 0.0, turn_degrees * pi / 180)
    return obj


def make_table() -> Any:
    form = new_form()
    add_box(form, (1.5, 1.21, 0.03), (0.0, 0.0, -0.015), 0.004)
    return place_object(new_object("Table", form, smooth=False), (0.0, 0.055, 0.0), 0.0, materials.make_oak())


def _compute_cushion_outline(s: float, t: float) -> tuple[float, float]:
    """Compute the outline of a filled cushion, whose sides are drawn in and whose corners stand out."""
    return CUSHION_HALF * s * (0.925 + 0.075 * t * t), CUSHION_HALF * t * (0.925 + 0.075 * s * s)


def _compute_cushion_point(s: float, t: float, side: float) -> tuple[float, float, float]:
    x, y = _compute_cushion_outline(s, t)
    dome = max(0.0, (1 - s**4) * (1 - t**4)) ** 0.6
    # Shallow puckers run in from the corners, where the cloth has too much length.
    pucker = 1.0 + 0.05 * (s * s * t * t) * np.cos(9.0 * (s * s - t * t)) - 0.10 * (s * t) ** 2
    return x, y, side * (0.052 if side > 0 else 0.013) * dome * pucker


def make_cushion() -> Any:
    form = new_form()
    for side in (1.0, -1.0):
        add_sheet(form, lambda s, t, k=side: _compute_cushion_point(s, t, k), CUSHION_HALF, 72, flip=side < 0)
    rim = np.linspace(-1.0, 1.0, 49)[:-1]
    corners = [(r, -1.0) for r in rim] + [(1.0, r) for r in rim] + [(-r, 1.0) for r in rim] + [(-1.0, -r) for r in rim]
    add_cord(form, np.array([(*_compute_cushion_outline(s, t), 0.0) for s, t in corners]), 2.6e-3)
    return place_object(new_object("Cushion", form), (-0.165, 0.14, 0.0135), 14.0, materials.make_corduroy())


def make_tin() -> Any:
    """Make a tea tin with a lid, brushed around."""
    form = new_form()
    r = TIN_RADIUS
    body = round_corners([(0.0, 0.0), (r, 0.0), (r, 0.094)], 1.6e-3)
    lid = [(r + 1.2e-3, 0.086), (r + 1.2e-3, 0.106), (r - 4e-3, 0.106), (r - 5e-3, 0.1045), (0.0, 0.1045)]
    add_lathe(form, body)
    add_lathe(form, [(r, 0.0862), *round_corners(lid, 1.4e-3)])
    return place_object(new_object("Tin", form), (0.085, 0.135, 0.0), 0.0, materials.make_brushed_metal())


def make_tile() -> Any:
    form = new_form()
    add_box(form, (0.19, 0.19, 0.014), (0.0, 0.0, 0.007), 2.5e-3)
    return place_object(new_object("Tile", form), (0.185, -0.065, 0.0), -11.0, materials.make_terracotta())


def make_notebook() -> Any:
    """Make a quarter-bound book: linen over the spine and a strip of the boards, leather over the rest."""
    leather, linen, page = 0, 1, 2
    form = new_form()
    width, length = 0.148, 0.205
    strip = 0.045
    for z in (0.0015, 0.0225):
        add_box(form, (strip, length, 0.003), (-width / 2 + strip / 2, 0.0, z), 0.9e-3, slot=linen)
        rest = width - strip
        add_box(form, (rest, length, 0.003), (width / 2 - rest / 2, 0.0, z), 0.9e-3, slot=leather)
    add_box(form, (0.006, length, 0.0246), (-width / 2 - 0.0012, 0.0, 0.0123), 2.6e-3, slot=linen)
    add_box(form, (width - 0.006, length - 0.008, 0.018), (-0.001, 0.0, 0.012), 0.4e-3, slot=page, rounds=2)
    mats = materials.make_leather(), materials.make_linen(), materials.make_paper()
    return place_object(new_object("Notebook", form), (-0.085, -0.1, 0.0), -17.0, *mats)


def make_bowl() -> Any:
    form = new_form()
    outer = [(0.0, 0.004), (0.026, 0.004), (0.026, 0.0), (0.031, 0.0), (0.036, 0.008), (0.056, 0.030), (0.064, 0.058)]
    inner = [(0.0605, 0.0585), (0.052, 0.031), (0.030, 0.011), (0.0, 0.0085)]
    add_lathe(form, round_corners([*outer, *inner], 6e-3, 6))
    return place_object(new_object("Bowl", form), (0.235, 0.175, 0.0), 0.0, materials.make_glaze())


def make_lemon(name: str, location: tuple[float, float, float], tilt: tuple[float, float, float], material: Any) -> Any:
    form = new_form()
    around = np.linspace(0.0, pi, 49)
    tip = 0.006 * np.exp(-(((np.minimum(around, pi - around)) / 0.28) ** 2))
    radius, height = 0.0275 * np.sin(around), -(0.034 * np.cos(around) + np.sign(np.cos(around)) * tip)
    profile = [(float(r), float(h)) for r, h in zip(radius, height, strict=True)]
    profile[0], profile[-1] = (0.0, profile[0][1]), (0.0, profile[-1][1])
    add_lathe(form, profile, segments=96)
    obj = place_object(new_object(name, form), location, 0.0, material)
    obj.rotation_euler = tilt
    return obj
