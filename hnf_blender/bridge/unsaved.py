"""Textures that were painted and not saved: their pixels are in memory alone."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from hnf_core.errors import SceneError

from .node_graph import iter_nodes

UNSAVED_IMAGE_REMEDY = "Save it (Image > Save in the Image Editor) or pack it (Image > Pack), and try again."


def check_images_saved(objects: Iterable[Any]) -> None:
    """Raises SceneError for the first texture on objects whose pixels a copy of the file would not hold."""
    for obj in objects:
        for slot in obj.material_slots:
            for node in iter_nodes(None if slot.material is None else slot.material.node_tree):
                image = getattr(node, "image", None)
                if image is not None and image.is_dirty:
                    raise SceneError(
                        f"its texture '{image.name}' was painted and is not saved, and a bake works on what is saved.",
                        where=f"object '{obj.name}', material '{slot.material.name}'",
                        remedy=UNSAVED_IMAGE_REMEDY,
                    )


def has_unsaved_paint(image: Any) -> bool:
    """Was it painted, and would a render read its file instead, and forget the painting?"""
    return bool(image.is_dirty) and image.source in {"FILE", "TILED"} and not image.packed_files
