"""Data stored in the .blend: custom properties of datablocks, and the baked tokens of a mesh.

A token describes a material's micro-geometry for the haptic field. A mesh stores palette indices, roughness and
confidence per face, and the palette of tokens as an ID property. All of them are part of the mesh datablock, so that
they survive saving, appending and copying, also without the add-on. Vertex colors of scans are handled here too.

A library override saves neither ID properties that hold bytes nor new ones; it does save registered text. On a stroke
that is an override, everything is therefore stored in one registered property, Object.hnf_stroke.kept, as JSON with
bytes in base 85.
"""

from __future__ import annotations

import base64
import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hnf_core.errors import SceneError

from ... import compat

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hnf_core.material.palette import Palette


def set_property(block: Any, name: str, value: bytes | str | int) -> None:
    """Set a custom property of a datablock.

    The old value is deleted first: when Blender (4.2, 4.5, 5.0) overwrites bytes, it stops at the first zero byte.
    """
    if _is_override(block):
        encoded = {"bytes": base64.b85encode(value).decode()} if isinstance(value, bytes) else value
        block.hnf_stroke.kept = json.dumps({**_read_override(block), name: encoded})
        return
    if name in block:
        del block[name]
    block[name] = value


def get_property(block: Any, name: str) -> Any:
    """Return a custom property written by `set_property`: None if missing, b"" if an override's bytes are damaged."""
    overridden = _read_override(block) if _is_override(block) else {}
    if name not in overridden:
        return block.get(name)
    value = overridden[name]
    if not isinstance(value, dict):
        return value
    try:
        return base64.b85decode(value["bytes"])
    except (ValueError, KeyError, TypeError):
        return b""


def has_property(block: Any, name: str) -> bool:
    """Return True if `get_property` would return a value; nothing is decoded, as this is called at every redraw."""
    overridden = _read_override(block) if _is_override(block) else {}
    return overridden[name] is not None if name in overridden else name in block


def delete_property(block: Any, name: str) -> None:
    """Delete a custom property of a datablock; on a library override, the linked original's value stays hidden."""
    if _is_override(block):
        block.hnf_stroke.kept = json.dumps({**_read_override(block), name: None})
    elif name in block:
        del block[name]


def _is_override(block: Any) -> bool:
    """Return True for a library override that has stroke settings."""
    return block.override_library is not None and hasattr(block, "hnf_stroke")


def _read_override(block: Any) -> dict[str, Any]:
    """Return the properties stored on a library override; {} if their text is damaged: the original's then count."""
    try:
        return dict(json.loads(block.hnf_stroke.kept or "{}"))
    except (ValueError, TypeError):
        return {}


TOKEN_ATTRIBUTE = "hnf_token"
ROUGHNESS_ATTRIBUTE = "hnf_roughness"
CONFIDENCE_ATTRIBUTE = "hnf_confidence"
PALETTE_PROPERTY = "hnf_palette"
SOURCE_PROPERTY = "hnf_source"
SCHEMA_PROPERTY = "hnf_schema"
SCHEMA = 1
UNBAKED = -1
"""Palette index of faces that were not baked."""


@dataclass(frozen=True)
class PointTokens:
    """Baked tokens of the splats that a mesh was made from: palette index (N,) int32, confidence (N,) float32."""

    index: NDArray[np.int32]
    confidence: NDArray[np.float32]


@dataclass(frozen=True)
class FaceTokens:
    """Baked tokens (descriptions of the micro-geometry felt) of one mesh, per face.

    Attributes
    ----------
    palette : Palette
    index : (F,) int32 array
        Palette index of every face, UNBAKED where nothing was touched.
    roughness : (F,) float32 array
        RMS roughness [m].
    confidence : (F,) float32 array
    source : str
        Hash of the inputs of the bake.
    points : PointTokens or None
        Tokens of the splats of a reconstructed surface, which are stored on the cloud (`bridge/splat_cloud.py`).
    """

    palette: Palette
    index: NDArray[np.int32]
    roughness: NDArray[np.float32]
    confidence: NDArray[np.float32]
    source: str
    points: PointTokens | None = None


def write_tokens(mesh: Any, tokens: FaceTokens) -> None:
    """Store tokens on a mesh. Raises SceneError for a linked mesh, Edit Mode, or a wrong number of faces."""
    _check_writable(mesh)
    count = len(mesh.polygons)
    if not len(tokens.index) == len(tokens.roughness) == len(tokens.confidence) == count:
        raise SceneError(f"it has {count} faces, the bake has {len(tokens.index)}.", where=f"mesh '{mesh.name}'")
    _write_attribute(mesh, TOKEN_ATTRIBUTE, "INT", np.ascontiguousarray(tokens.index, dtype=np.int32))
    _write_attribute(mesh, ROUGHNESS_ATTRIBUTE, "FLOAT", np.ascontiguousarray(tokens.roughness, dtype=np.float32))
    _write_attribute(mesh, CONFIDENCE_ATTRIBUTE, "FLOAT", np.ascontiguousarray(tokens.confidence, dtype=np.float32))
    set_property(mesh, PALETTE_PROPERTY, tokens.palette.to_bytes())
    set_property(mesh, SOURCE_PROPERTY, tokens.source)
    set_property(mesh, SCHEMA_PROPERTY, SCHEMA)


def read_tokens(mesh: Any) -> FaceTokens | None:
    """Read the tokens of a mesh.

    Returns None if there are none or their schema is another, and in Edit Mode, where Blender gives no attribute
    values.
    """
    if (
        mesh.is_editmode
        or mesh.get(SCHEMA_PROPERTY) != SCHEMA
        or any(
            mesh.attributes.get(name) is None for name in (TOKEN_ATTRIBUTE, ROUGHNESS_ATTRIBUTE, CONFIDENCE_ATTRIBUTE)
        )
    ):
        return None
    from hnf_core.material.palette import Palette  # here, as it is not needed to switch the add-on on

    return FaceTokens(
        palette=Palette.from_bytes(bytes(mesh[PALETTE_PROPERTY])),
        index=_read_attribute(mesh, TOKEN_ATTRIBUTE, np.int32),
        roughness=_read_attribute(mesh, ROUGHNESS_ATTRIBUTE, np.float32),
        confidence=_read_attribute(mesh, CONFIDENCE_ATTRIBUTE, np.float32),
        source=str(mesh[SOURCE_PROPERTY]),
    )


def count_token_bytes(mesh: Any) -> int:
    """Return the size of the tokens stored on a mesh [bytes]."""
    names = (TOKEN_ATTRIBUTE, ROUGHNESS_ATTRIBUTE, CONFIDENCE_ATTRIBUTE)
    attributes = sum(4 * len(mesh.polygons) for name in names if name in mesh.attributes)
    palette = mesh.get(PALETTE_PROPERTY)
    return attributes + (len(palette) if isinstance(palette, bytes) else 0)


def remove_tokens(mesh: Any) -> int:
    """Remove the tokens from a mesh; return the bytes freed. Raises SceneError for a linked mesh or in Edit Mode."""
    _check_writable(mesh)
    freed = count_token_bytes(mesh)
    for name in (TOKEN_ATTRIBUTE, ROUGHNESS_ATTRIBUTE, CONFIDENCE_ATTRIBUTE):
        attribute = mesh.attributes.get(name)
        if attribute is not None:
            mesh.attributes.remove(attribute)
    for name in (PALETTE_PROPERTY, SOURCE_PROPERTY, SCHEMA_PROPERTY):
        if name in mesh:
            del mesh[name]
    return freed


def _check_writable(mesh: Any) -> None:
    """Raise SceneError for a linked mesh or one in Edit Mode."""
    if mesh.library is not None:
        raise SceneError(
            f"its mesh is linked from {mesh.library.filepath} and cannot be written.",
            where=f"mesh '{mesh.name}'",
            remedy="Make it local (Object > Relations > Make Local) to keep tokens on it; the signals are unharmed.",
        )
    if mesh.is_editmode:
        raise SceneError("it is in Edit Mode.", where=f"mesh '{mesh.name}'", remedy="Leave Edit Mode and bake again.")


def _write_attribute(mesh: Any, name: str, kind: str, values: NDArray[Any]) -> None:
    attribute = mesh.attributes.get(name)
    if attribute is not None and (attribute.data_type != kind or attribute.domain != "FACE"):
        mesh.attributes.remove(attribute)
        attribute = None
    if attribute is None:
        mesh.attributes.new(name, kind, "FACE")
    mesh.attributes[name].data.foreach_set("value", values)  # fetched anew: new() invalidates earlier references


def _read_attribute(mesh: Any, name: str, dtype: type) -> NDArray[Any]:
    values: NDArray[Any] = np.empty(len(mesh.polygons), dtype=dtype)
    mesh.attributes[name].data.foreach_get("value", values)
    return values


def show_vertex_colours(obj: Any) -> None:
    """Give a scan a material that shows its vertex colors, since its file has none.

    Objects that are not meshes, have a material, or have no vertex colors are left alone.
    """
    import bpy

    if obj.type != "MESH" or obj.data.materials or not obj.data.color_attributes:
        return
    material = bpy.data.materials.new(obj.name)
    compat.switch_nodes_on(material)
    tree = material.node_tree
    vertex_colour = tree.nodes.new("ShaderNodeVertexColor")
    vertex_colour.layer_name = obj.data.color_attributes[0].name
    shader = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeBsdfPrincipled")
    tree.links.new(vertex_colour.outputs["Color"], shader.inputs["Base Color"])
    obj.data.materials.append(material)
