"""`hnf VERB` at a shell and `blender -b FILE --command hnf VERB`: the same words, the same behaviour.

What a verb needs is imported when it is asked for, so that `hnf --help` loads nothing.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hnf_core.cli.main import main as run_command_line
from hnf_core.errors import HnfError

if TYPE_CHECKING:
    from hnf_core.export.touched_surface import TouchedSurface


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; argv without the program's name. Returns the exit code."""
    return run_command_line(sys.argv[1:] if argv is None else argv, run_touch, run_export)


def run_touch(arguments: argparse.Namespace) -> int:
    from hnf_core.cli.touch import make_touch_request

    request = make_touch_request(arguments)
    if importlib.util.find_spec("bpy") is None:
        raise HnfError(
            "touch needs Blender, and this Python has no bpy.",
            remedy="Install it (pip install bpy==5.0.1, Python 3.11), or run: blender -b --command hnf touch …",
        )
    if request.scene is not None:
        from .bridge.importers import check_scene_file

        check_scene_file(request.scene)  # before Blender starts: a slip in a name is told at once
    _register_properties()
    from .touch.run import run

    return run(request)


def run_export(arguments: argparse.Namespace) -> int:
    from hnf_core.cli import export

    without_blender = importlib.util.find_spec("bpy") is None
    return export.run(arguments) if without_blender else export.run(arguments, read_scene_surface)


def read_scene_surface(path: Path, provenance: Mapping[str, str], object_name: str | None) -> TouchedSurface:
    """What a signal was felt on, in a scene file. Raises HnfError."""
    _register_properties()
    import bpy

    from .bridge.importers import open_scene
    from .bridge.scene.unit_scale import get_metres_per_unit
    from .bridge.stroke.surface_export import find_surface_in_scene

    scene, view_layer = open_scene(path), bpy.context.view_layer
    view_layer.update()
    return find_surface_in_scene(scene, view_layer.depsgraph, get_metres_per_unit(scene), provenance, object_name)


def _register_properties() -> None:
    """At a shell no add-on is switched on."""
    import bpy

    if not hasattr(bpy.types.Object, "hnf_stroke"):
        from . import props

        props.register()
