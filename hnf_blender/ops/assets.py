"""The asset library that comes with the add-on: offered, never put into the preferences without being asked."""

# No `from __future__ import annotations`: Blender reads class attributes as values.

from pathlib import Path
from typing import Any

import bpy

from .greyed import fail_poll

ASSET_FOLDER = Path(__file__).resolve().parents[1] / "assets"
ASSET_LIBRARY_NAME = "Haptic Neural Fields"


def find_asset_library(context: Any) -> Any:
    """The preferences' entry that points to the add-on's assets, or None."""
    libraries = context.preferences.filepaths.asset_libraries
    return next((library for library in libraries if _is_same_folder(library.path, ASSET_FOLDER)), None)


class HNF_OT_assets_add(bpy.types.Operator):  # type: ignore[misc]  # noqa: N801  # bpy has no types, Blender's naming
    bl_idname = "hnf.assets_add"
    bl_label = "Add Asset Library"
    bl_description = (
        "Show ready materials and strokes in the asset browser: puts the add-on's folder in the preferences"
    )
    bl_options = {"REGISTER"}  # noqa: RUF012  # Blender reads a set

    @classmethod
    def poll(cls, context: Any) -> bool:
        if not ASSET_FOLDER.is_dir():
            return fail_poll(cls, "This copy of the add-on has no assets: run make assets in its source folder")
        if find_asset_library(context) is not None:
            return fail_poll(cls, "The asset library is in the preferences already")
        return True

    def execute(self, context: Any) -> set[str]:
        library = context.preferences.filepaths.asset_libraries.new(
            name=ASSET_LIBRARY_NAME, directory=str(ASSET_FOLDER)
        )
        library.import_method = "APPEND"  # strokes and choices are there to be edited
        context.preferences.is_dirty = True
        self.report({"INFO"}, f"{library.name}: {ASSET_FOLDER}")
        return {"FINISHED"}


class HNF_OT_assets_remove(bpy.types.Operator):  # type: ignore[misc]  # noqa: N801
    bl_idname = "hnf.assets_remove"
    bl_label = "Remove Asset Library"
    bl_description = "Take the add-on's folder out of the preferences again. What you have used in your files stays"
    bl_options = {"REGISTER"}  # noqa: RUF012

    @classmethod
    def poll(cls, context: Any) -> bool:
        if find_asset_library(context) is None:
            return fail_poll(cls, "The asset library is not in the preferences")
        return True

    def execute(self, context: Any) -> set[str]:
        context.preferences.filepaths.asset_libraries.remove(find_asset_library(context))
        context.preferences.is_dirty = True
        return {"FINISHED"}


def _is_same_folder(path: str, folder: Path) -> bool:
    return bool(path) and Path(bpy.path.abspath(path)).resolve() == folder


ASSET_CLASSES = (HNF_OT_assets_add, HNF_OT_assets_remove)
