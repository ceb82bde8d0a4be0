"""Operators of the Diagnose panel: report of versions, paths and sizes, cache, and the add-on's asset library.

The asset library is only added to the preferences on request.
"""

# No `from __future__ import annotations`: Blender reads these annotations as values.

import platform
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import bpy
import numpy

from hnf_core import __version__
from hnf_core.errors import HnfError

from .. import compat
from ..state.addon_settings import get_cache_folder
from ..state.labels import format_bytes
from ..state.session_state import STATE
from ..translations import tr
from .operator_base import fail_poll

REPORTED_PACKAGES = ("OpenEXR", "embreex", "safetensors", "matplotlib")
"""Optional packages whose versions are reported."""


def list_versions() -> tuple[tuple[str, str], ...]:
    """Return names and versions that are known at once; the panel queries them at every draw."""
    return (
        ("Add-on", __version__),
        ("Blender", compat.version_text()),
        ("Python", platform.python_version()),
        ("numpy", numpy.__version__),
    )


def collect_diagnosis() -> tuple[tuple[str, str], ...]:
    """Return (name, value) rows: versions, hashes of the networks, paths, sizes and the last error.

    Reads weights and folders, never raises.
    """
    from hnf_core.diagnostics import describe_field, describe_kernel, get_version
    from hnf_core.material.token import ENCODER_ID

    cache = get_cache_folder()
    rows = [
        *list_versions(),
        ("System", f"{platform.system()} {platform.release()} {platform.machine()}"),
        *((package, get_version(package) or "not installed") for package in REPORTED_PACKAGES),
        ("Compiled kernel", describe_kernel()),
        ("Field", describe_field()),
        ("Encoder", ENCODER_ID),
        ("Weights for pictures", _describe_map_weights()),
        ("Blender file", bpy.data.filepath or "not saved"),
        ("Blender program", bpy.app.binary_path or sys.executable),
        ("Add-on folder", str(Path(__file__).resolve().parents[1])),
        ("Cache folder", str(cache)),
        ("Cache size", format_bytes(measure_folder(cache))),
        ("Baked data in this file", format_bytes(measure_baked_data())),
        ("External Python", _describe_external_python()),
    ]
    if STATE.last_job is not None:
        outcome = "done" if STATE.last_job.ok else "failed"
        rows.append(("Last job", f"{outcome}: {STATE.last_job.message}"))
        rows += [("", detail) for detail in STATE.last_job.details]
    return tuple(rows)


def refresh_diagnosis() -> None:
    """Update the shown diagnosis after sizes changed."""
    if STATE.diagnosis:
        STATE.diagnosis = collect_diagnosis()


def format_rows(rows: tuple[tuple[str, str], ...]) -> str:
    """Format the (name, value) rows of the diagnosis for the clipboard, aligned."""
    width = max((len(name) for name, _ in rows), default=0)
    return "\n".join(f"{name:<{width}}  {value}" for name, value in rows) + "\n"


def measure_folder(folder: Path) -> int:
    """Return the size of all files in a folder [bytes]; 0 if it does not exist."""
    total = 0
    for path in folder.rglob("*"):
        try:
            total += path.stat().st_size if path.is_file() else 0
        except OSError:  # The file was removed meanwhile.
            continue
    return total


def measure_baked_data() -> int:
    """Return the size of bakes, tokens and palettes stored in the open .blend [bytes]."""
    from ..bridge.scene.stored_data import count_token_bytes
    from ..touch.bake_storage import count_stored_bytes

    return sum(count_stored_bytes(obj) for obj in bpy.data.objects) + sum(
        count_token_bytes(mesh) for mesh in bpy.data.meshes
    )


def _describe_external_python() -> str:
    """Describe the external Python as last checked, without running it."""
    from .learn_ops import format_python_status, get_python_path

    path, python = get_python_path(), STATE.external_python
    if not path:
        return "none"
    is_checked = python is not None and bpy.path.abspath(python.path) == path
    return f"{path}: {format_python_status(python) if is_checked and python is not None else 'not checked'}"


def _describe_map_weights() -> str:
    from ..touch.bake_patches import ReliefPredictor

    try:
        return ReliefPredictor().weights_hash or "not there"
    except (HnfError, ImportError) as error:
        return str(error)


class HNF_OT_diagnose(bpy.types.Operator):  # type: ignore[misc]  # bpy has no types, Blender's naming
    bl_idname = "hnf.diagnose"
    bl_label = "Show Details"
    bl_description = "Collect versions, paths, sizes and the last error, and show them here"
    bl_options = {"REGISTER"}  # Blender reads a set

    def execute(self, _context: Any) -> set[str]:
        STATE.diagnosis = collect_diagnosis()
        return {"FINISHED"}


class HNF_OT_diagnose_copy(bpy.types.Operator):  # type: ignore[misc]
    bl_idname = "hnf.diagnose_copy"
    bl_label = "Copy Report"
    bl_description = "Collect versions, paths, sizes and the last error, and put them on the clipboard"
    bl_options = {"REGISTER"}

    def execute(self, context: Any) -> set[str]:
        STATE.diagnosis = collect_diagnosis()
        context.window_manager.clipboard = format_rows(STATE.diagnosis)
        self.report({"INFO"}, tr("Report copied: paste it when you report a problem"))
        return {"FINISHED"}


class HNF_OT_cache_clear(bpy.types.Operator):  # type: ignore[misc]
    bl_idname = "hnf.cache_clear"
    bl_label = "Clear Cache"
    bl_description = "Delete the close-up renders kept from earlier bakes. Costs nothing but time at the next bake"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, _context: Any) -> bool:
        if STATE.job is not None:
            return fail_poll(cls, "A bake is running and uses the cache")
        return True

    def execute(self, _context: Any) -> set[str]:
        folder = get_cache_folder()
        previous_size = measure_folder(folder)
        for path in folder.rglob("*"):
            if path.is_file():
                with suppress(OSError):  # Windows cannot delete files that another Blender uses.
                    path.unlink()
        refresh_diagnosis()
        self.report({"INFO"}, tr("{size} freed").format(size=format_bytes(previous_size - measure_folder(folder))))
        return {"FINISHED"}


ASSET_FOLDER = Path(__file__).resolve().parents[1] / "assets"
ASSET_LIBRARY_NAME = "Haptic Neural Fields"


def find_asset_library(context: Any) -> Any:
    """Return the entry of the add-on's asset library in Blender's preferences, or None."""
    libraries = context.preferences.filepaths.asset_libraries
    return next((library for library in libraries if _is_same_folder(library.path, ASSET_FOLDER)), None)


class HNF_OT_assets_add(bpy.types.Operator):  # type: ignore[misc]  # bpy has no types, Blender's naming
    bl_idname = "hnf.assets_add"
    bl_label = "Add Asset Library"
    bl_description = (
        "Show ready materials and strokes in the asset browser: puts the add-on's folder in the preferences"
    )
    bl_options = {"REGISTER"}  # Blender reads a set

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
        library.import_method = "APPEND"  # Appended strokes and choices can be edited.
        context.preferences.is_dirty = True
        self.report({"INFO"}, f"{library.name}: {ASSET_FOLDER}")
        return {"FINISHED"}


class HNF_OT_assets_remove(bpy.types.Operator):  # type: ignore[misc]
    bl_idname = "hnf.assets_remove"
    bl_label = "Remove Asset Library"
    bl_description = "Take the add-on's folder out of the preferences again. What you have used in your files stays"
    bl_options = {"REGISTER"}

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


CLASSES = (HNF_OT_diagnose, HNF_OT_diagnose_copy, HNF_OT_cache_clear, HNF_OT_assets_add, HNF_OT_assets_remove)
