"""An artist's first five minutes: from the zip to a signal that is seen, heard, changed, exported and kept."""

from pathlib import Path

import bpy

INSTALLED = "no"
SHARE = Path("/share")


def check_the_zip_installs(stage):
    archive = next((SHARE / "dist").glob("*.zip"))
    stage.expect("nothing is installed", "hnf" not in dir(bpy.types.Scene))
    with stage.over():
        bpy.ops.extensions.package_install_files(
            filepath=str(archive), repo="user_default", enable_on_install=True, overwrite=True
        )
    yield from stage.until("it is on", lambda: hasattr(bpy.types.Scene, "hnf"), 60.0)
    stage.expect("strokes can be made", hasattr(bpy.types.Object, "hnf_stroke"))
