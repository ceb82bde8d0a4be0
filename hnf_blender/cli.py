"""`hnf VERB` at a shell and `blender -b FILE --command hnf VERB`: the same words, the same behaviour."""

from __future__ import annotations

import argparse
import importlib.util
import sys
from collections.abc import Sequence

from hnf_core.cli.bench import not_here, run_benches
from hnf_core.cli.main import main as run_command_line
from hnf_core.cli.touch import request_from
from hnf_core.errors import HnfError


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; argv without the program's name. Returns the exit code."""
    return run_command_line(sys.argv[1:] if argv is None else argv, run_touch, run_bench)


def run_touch(arguments: argparse.Namespace) -> int:
    request = request_from(arguments)
    if importlib.util.find_spec("bpy") is None:
        raise HnfError(
            "touch needs Blender, and this Python has no bpy.",
            remedy="Install it (pip install bpy==5.0.1, Python 3.11), or run: blender -b --command hnf touch …",
        )
    import bpy

    if not hasattr(bpy.types.Object, "hnf_stroke"):  # at a shell no add-on is switched on
        from . import props

        props.register()
    from .touch.run import run

    return run(request)


def run_bench(arguments: argparse.Namespace) -> int:
    try:
        from .bench.catalogue import BENCHES
    except ImportError as error:
        raise not_here(error) from error
    return run_benches(arguments, BENCHES)
