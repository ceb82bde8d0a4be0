"""Everything that a person who helps from afar asks for first, in one text."""

# No `from __future__ import annotations`: Blender reads these annotations as values.

import platform
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import bpy
import numpy

from hnf_core import __version__
from hnf_core.cli.health import field_identity, kernel_state, version_of
from hnf_core.errors import HnfError

from .. import compat
from ..state.folders import cache_folder
from ..state.session import STATE
from ..state.texts import byte_text
from ..translations import tr
from .greyed import greyed

PACKAGES = ("OpenEXR", "embreex", "safetensors", "matplotlib")


def versions() -> tuple[tuple[str, str], ...]:
    """What is known without looking anywhere: for the panel, at every draw."""
    return (
        ("Add-on", __version__),
        ("Blender", compat.version_text()),
        ("Python", platform.python_version()),
        ("numpy", numpy.__version__),
    )


def collect() -> tuple[tuple[str, str], ...]:
    """Versions, identities, paths and the last error. Reads the weights and looks through folders; never raises."""
    from hnf_core.material.token import ENCODER_ID

    cache = cache_folder()
    rows = [
        *versions(),
        ("System", f"{platform.system()} {platform.release()} {platform.machine()}"),
        *((package, version_of(package) or "not installed") for package in PACKAGES),
        ("Compiled kernel", kernel_state()),
        ("Field", field_identity()),
        ("Encoder", ENCODER_ID),
        ("Weights for pictures", _map_weights()),
        ("Blender file", bpy.data.filepath or "not saved"),
        ("Blender program", bpy.app.binary_path or sys.executable),
        ("Add-on folder", str(Path(__file__).resolve().parents[1])),
        ("Cache folder", str(cache)),
        ("Cache size", byte_text(folder_bytes(cache))),
        ("Baked data in this file", byte_text(touch_bytes())),
        ("External Python", _outside()),
    ]
    if STATE.last_job is not None:
        outcome = "done" if STATE.last_job.ok else "failed"
        rows.append(("Last job", f"{outcome}: {STATE.last_job.message}"))
        rows += [("", detail) for detail in STATE.last_job.details]
    return tuple(rows)


def collect_again() -> None:
    """After sizes changed: where they are shown, show those of now."""
    if STATE.diagnosis:
        STATE.diagnosis = collect()


def as_text(rows: tuple[tuple[str, str], ...]) -> str:
    """The rows for the clipboard, aligned."""
    width = max((len(name) for name, _ in rows), default=0)
    return "\n".join(f"{name:<{width}}  {value}" for name, value in rows) + "\n"


def folder_bytes(folder: Path) -> int:
    """Bytes of all files below; 0 where there is no folder."""
    total = 0
    for path in folder.rglob("*"):
        try:
            total += path.stat().st_size if path.is_file() else 0
        except OSError:  # removed meanwhile
            continue
    return total


def touch_bytes() -> int:
    """Bytes of bakes, tokens and palettes in the open file: what purging everything would take out."""
    from ..bridge.storage import token_bytes
    from ..touch.stored import stored_bytes

    return sum(stored_bytes(obj) for obj in bpy.data.objects) + sum(token_bytes(mesh) for mesh in bpy.data.meshes)


def _outside() -> str:
    """As last checked: it is not run for this."""
    from .outside_python import found_text, python_path

    path, found = python_path(), STATE.outside
    if not path:
        return "none"
    known = found is not None and bpy.path.abspath(found.path) == path
    return f"{path}: {found_text(found) if known and found is not None else 'not checked'}"


def _map_weights() -> str:
    from ..touch.seeing import Seeing

    try:
        return Seeing().weights_hash or "not there"
    except (HnfError, ImportError) as error:
        return str(error)


class HNF_OT_diagnose(bpy.types.Operator):  # type: ignore[misc]  # noqa: N801  # bpy has no types, Blender's naming
    bl_idname = "hnf.diagnose"
    bl_label = "Show Details"
    bl_description = "Collect versions, paths, sizes and the last error, and show them here"
    bl_options = {"REGISTER"}  # noqa: RUF012  # Blender reads a set

    def execute(self, _context: Any) -> set[str]:
        STATE.diagnosis = collect()
        return {"FINISHED"}


class HNF_OT_diagnose_copy(bpy.types.Operator):  # type: ignore[misc]  # noqa: N801
    bl_idname = "hnf.diagnose_copy"
    bl_label = "Copy Report"
    bl_description = "Collect versions, paths, sizes and the last error, and put them on the clipboard"
    bl_options = {"REGISTER"}  # noqa: RUF012

    def execute(self, context: Any) -> set[str]:
        STATE.diagnosis = collect()
        context.window_manager.clipboard = as_text(STATE.diagnosis)
        self.report({"INFO"}, tr("Report copied: paste it when you report a problem"))
        return {"FINISHED"}


class HNF_OT_cache_clear(bpy.types.Operator):  # type: ignore[misc]  # noqa: N801
    bl_idname = "hnf.cache_clear"
    bl_label = "Clear Cache"
    bl_description = "Delete the close-up renders kept from earlier bakes. Costs nothing but time at the next bake"
    bl_options = {"REGISTER"}  # noqa: RUF012

    @classmethod
    def poll(cls, _context: Any) -> bool:
        if STATE.job is not None:
            return greyed(cls, "A bake is running and uses the cache")
        return True

    def execute(self, _context: Any) -> set[str]:
        folder = cache_folder()
        before = folder_bytes(folder)
        for path in folder.rglob("*"):
            if path.is_file():
                with suppress(OSError):  # in use by another Blender: Windows keeps it
                    path.unlink()
        collect_again()
        self.report({"INFO"}, tr("{size} freed").format(size=byte_text(before - folder_bytes(folder))))
        return {"FINISHED"}


CLASSES = (HNF_OT_diagnose, HNF_OT_diagnose_copy, HNF_OT_cache_clear)
