"""Command line of the add-on: `hnf VERB` at a shell and `blender -b FILE --command hnf VERB` behave alike.

The verbs that need Blender, touch, views and export, are added to those of `hnf_core.cli`. Each verb imports what it
needs when it runs, so that `hnf --help` loads nothing.
"""

from __future__ import annotations

import argparse
import atexit
import contextlib
import importlib.util
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hnf_core.cli.main import main as run_command_line
from hnf_core.errors import HnfError

if TYPE_CHECKING:
    from hnf_core.export.touched_surface import TouchedSurface

SUPERVISED = (["touch"], ["views"], ["export"])
"""First words of the commands that open a file in Blender."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code.

    Parameters
    ----------
    argv : sequence of str, optional
        Words of the command, without the program's name; None means those of this process, whose only work this then
        is: what opens a file in Blender is supervised.

    Returns
    -------
    int
    """
    words = sys.argv[1:] if argv is None else argv
    if argv is None and words[:1] in SUPERVISED:
        from .supervisor import run_supervised

        return run_supervised(lambda: run_command_line(words, run_touch, run_export, run_views))
    return run_command_line(words, run_touch, run_export, run_views)


def run_touch(arguments: argparse.Namespace) -> int:
    """Run `hnf touch`: synthesize the strokes of a scene and write them to files."""
    from hnf_core.cli.touch import make_touch_request

    request = make_touch_request(arguments)
    with _contain_session():
        _start_blender("touch", request.scene)
        from .touch.run import run

        return run(request)


@contextlib.contextmanager
def _contain_session() -> Iterator[None]:
    """Let bpy, if it is not imported yet, keep its session's folder in one that names this process.

    Blender gives its own a random name, so that nobody could tell that the process of a left one was killed.
    """
    if "bpy" in sys.modules:
        yield
        return
    from hnf_core.files import make_run_folder

    folder, before = make_run_folder("touch"), os.environ.get("TMPDIR")
    os.environ["TMPDIR"] = folder.name
    try:
        yield
    finally:
        if before is None:
            del os.environ["TMPDIR"]
        else:
            os.environ["TMPDIR"] = before
        atexit.register(folder.cleanup)


def run_views(arguments: argparse.Namespace) -> int:
    """Run `hnf views`: render a scene's cameras to files."""
    from hnf_core.cli.render_views import make_views_request

    request = make_views_request(arguments)
    with _contain_session():
        _start_blender("views", request.scene)
        from .touch.scene_views import write_views

        return write_views(request)


def _start_blender(verb: str, scene: Path | None) -> None:
    """Load Blender for a command; raise HnfError without bpy, FileError if the scene's file cannot be opened."""
    if importlib.util.find_spec("bpy") is None:
        raise HnfError(
            f"{verb} needs Blender, and this Python has no bpy.",
            remedy=f"Install it (pip install bpy, Python 3.11 or 3.13), or run: blender -b --command hnf {verb} …",
        )
    if scene is not None:
        from .bridge.importers import check_scene_file

        check_scene_file(scene)  # a mistyped path fails before Blender starts
    _register_properties()


def run_export(arguments: argparse.Namespace) -> int:
    """Run `hnf export`: convert a signal to another format.

    Without bpy, formats that need the scene's geometry are not available.
    """
    from hnf_core.cli import export

    without_blender = importlib.util.find_spec("bpy") is None
    return export.run(arguments) if without_blender else export.run(arguments, read_scene_surface)


def read_scene_surface(path: Path, provenance: Mapping[str, str], object_name: str | None) -> TouchedSurface:
    """Open a scene file and return the surface that a signal's stroke touched.

    Parameters
    ----------
    path : Path
        Scene file.
    provenance : Mapping[str, str]
        Provenance of the signal; its stroke and object are looked up in the scene.
    object_name : str or None
        Object to use instead of the one in the provenance.

    Returns
    -------
    TouchedSurface

    Raises
    ------
    HnfError
        If the scene cannot be opened or has no such object.
    """
    _register_properties()
    import bpy

    from .bridge.importers import open_scene
    from .bridge.scene.object_size import get_metres_per_unit
    from .bridge.stroke.surface_export import find_surface_in_scene

    scene, view_layer = open_scene(path), bpy.context.view_layer
    view_layer.update()
    return find_surface_in_scene(scene, view_layer.depsgraph, get_metres_per_unit(scene), provenance, object_name)


def _register_properties() -> None:
    """Register the add-on's properties, since no add-on is enabled at a shell."""
    import bpy

    if not hasattr(bpy.types.Object, "hnf_stroke"):
        from . import props

        props.register()


if __name__ == "__main__":
    sys.exit(main())
