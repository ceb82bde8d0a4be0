"""Properties that the add-on registers on Blender's objects, materials and scenes.

Read `stroke_settings.py` first: it defines what makes a curve object a stroke.
"""

from __future__ import annotations

from types import ModuleType

from ..registration import register_modules, unregister_modules
from . import material_settings, scene_settings, stroke_settings

GROUPS = (stroke_settings, material_settings, scene_settings)

_registered: list[ModuleType] = []


def register() -> None:
    register_modules(GROUPS, _registered)


def unregister() -> None:
    unregister_modules(_registered)
