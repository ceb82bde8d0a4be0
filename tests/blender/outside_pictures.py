"""Images of the open file that lie beside it."""

from __future__ import annotations

from pathlib import Path

import bpy


def picture(path: Path):
    """An image of the open file that lies at path."""
    image = bpy.data.images.new(path.stem, 4, 4)
    image.filepath_raw, image.file_format = str(path), "PNG"
    image.save()
    image.source = "FILE"
    image.use_fake_user = True
    return image
