"""Textures that were painted and not saved: their pixels are in memory alone."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from hnf_core.errors import SceneError

from .node_graph import nodes_of

REMEDY = "Save it (Image > Save in the Image Editor) or pack it (Image > Pack), and try again."


def check_saved(objects: Iterable[Any]) -> None:
    """Raises SceneError for the first texture on objects whose pixels a copy of the file would not hold."""
    for obj in objects:
        for slot in obj.material_slots:
            for node in nodes_of(None if slot.material is None else slot.material.node_tree):
                image = getattr(node, "image", None)
                if image is not None and image.is_dirty:
                    raise SceneError(
                        f"its texture '{image.name}' was painted and is not saved, and a bake works on what is saved.",
                        where=f"object '{obj.name}', material '{slot.material.name}'",
                        remedy=REMEDY,
                    )


def is_read_from_file(image: Any) -> bool:
    """Was it painted, and would a render read its file instead, and forget the painting?"""
    return bool(image.is_dirty) and image.source in {"FILE", "TILED"} and not image.packed_files
