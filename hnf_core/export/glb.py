"""GLB (glTF 2.0): the touched mesh with its UVs, what was baked onto it, and the stroke's signal.

What stands where: MPEG_haptic_material as `gltf_haptics.py` says; vertex attributes _HNF_TOKEN (index into the palette,
−1 untouched), _HNF_ROUGHNESS (m RMS), _HNF_CONFIDENCE (0–1) and _HNF_VERTEX (of the mesh in Blender), floats, as glTF
allows no other exact kind for −1 and large numbers; the palette, in extras.hnf of the mesh; the stroke's WAV, byte for
byte, in a view that extras.hnf of the asset names (glTF has no place for a vibration that is not .hmpg).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from ..errors import FileError, UsageError
from ..files import write_bytes
from ..signal import Signal
from .gltf_file import BufferBuilder, decode_glb, encode_glb, get_view_bytes
from .gltf_haptics import HAPTIC_EXTENSION, encode_haptic_material, encode_palette
from .gltf_mesh import VertexTable, build_vertex_table, encode_placement
from .json_files import read_limited_bytes
from .options import ExportOptions, ImportOptions
from .surface import TouchedSurface
from .wav import decode_wav, encode_wav

MAX_READ_BYTES = 512 * 2**20
GENERATOR = "Haptic Neural Fields"
"""How what a file says of its maker begins."""
_TRIANGLES = 4


def write_glb(path: Path, signal: Signal, options: ExportOptions) -> tuple[str, ...]:
    """Write the surface in options with signal. Returns what was left out. Raises UsageError where options have no
    surface, FileError where the signal is not finite or the disk refuses."""
    if options.surface is None:
        raise UsageError(
            "a GLB needs the mesh that the stroke was drawn on.",
            remedy="Name the baked scene: --scene BAKED.blend, and with --object NAME which mesh.",
        )
    surface = options.surface
    write_bytes(path, encode_surface(surface, build_vertex_table(surface), signal, where=str(path)))
    left_out = []
    if surface.palette is None:
        left_out.append(f"What it feels like: nothing is baked on object '{surface.name}'.")
    left_out.append("The surface's look: its materials are named, without shaders.")
    return tuple(left_out)


def read_glb(path: Path, options: ImportOptions) -> Signal:
    """The signal in a GLB of write_glb, as it was. Raises FileError where the file is damaged or holds none."""
    tree, block = decode_glb(read_limited_bytes(path, MAX_READ_BYTES), path)
    try:
        view = tree["asset"]["extras"]["hnf"]["signal"]["bufferView"]
    except (KeyError, TypeError) as error:
        raise FileError(
            "holds no vibration.", where=str(path), remedy="Give a .glb that hnf wrote, or open it as a scene."
        ) from error
    return decode_wav(get_view_bytes(tree, block, view, path), path)


def encode_surface(
    surface: TouchedSurface, table: VertexTable, signal: Signal | None = None, *, where: str = "glb"
) -> bytes:
    """The file of a surface, and of a stroke's signal on it. Equal input gives equal bytes."""
    buffer = BufferBuilder()
    tree = _encode_tree(surface, table, buffer)
    if signal is not None:
        view = buffer.add_bytes(encode_wav(signal, where=where))
        facts = {str(name): str(value) for name, value in signal.provenance.items()}
        tree["asset"]["extras"]["hnf"]["signal"] = {"bufferView": view, "mimeType": "audio/wav", "provenance": facts}
    tree |= {"accessors": buffer.accessors, "bufferViews": buffer.views}
    return encode_glb(tree, buffer.data, where=where)


def _encode_tree(surface: TouchedSurface, table: VertexTable, buffer: BufferBuilder) -> dict[str, Any]:
    attributes = {
        "POSITION": buffer.add_vertices(table.position),
        "NORMAL": buffer.add_vertices(table.normal),
        "_HNF_TOKEN": buffer.add_vertices(table.token),
        "_HNF_ROUGHNESS": buffer.add_vertices(table.roughness),
        "_HNF_CONFIDENCE": buffer.add_vertices(table.confidence),
        "_HNF_VERTEX": buffer.add_vertices(table.vertex),
    }
    maps = [each for each in (table.uv, None if surface.palette is None else table.taxel) if each is not None]
    attributes |= {f"TEXCOORD_{number}": buffer.add_vertices(each) for number, each in enumerate(maps)}
    mesh: dict[str, Any] = {"name": surface.name, "primitives": []}
    slots = np.unique(surface.mesh.slot)
    tree: dict[str, Any] = {
        "asset": {
            "version": "2.0",
            "generator": f"{GENERATOR} {__version__}",
            "extras": {"hnf": {"units": {"_HNF_ROUGHNESS": "m", "position": "m"}}},
        },
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": surface.name, "mesh": 0, **_encode_node_matrix(surface)}],
        "meshes": [mesh],
        "materials": [{"name": _get_material_name(surface, int(slot))} for slot in slots],
    }
    if surface.palette is not None:
        tree |= encode_haptic_material(surface.palette, buffer, len(maps) - 1)
        mesh["extensions"] = {HAPTIC_EXTENSION: {"hapticMaterialIndex": 0}}
        mesh["extras"] = {"hnf": {"palette": encode_palette(surface.palette)}}
    for number, slot in enumerate(slots):
        corners = table.corner[surface.mesh.slot == slot]
        primitive = {"attributes": attributes, "indices": buffer.add_indices(corners), "mode": _TRIANGLES}
        mesh["primitives"].append({**primitive, "material": number})
    return tree


def _encode_node_matrix(surface: TouchedSurface) -> dict[str, Any]:
    matrix = encode_placement(surface.placement)
    return {} if matrix == np.eye(4).ravel().tolist() else {"matrix": matrix}


def _get_material_name(surface: TouchedSurface, slot: int) -> str:
    return surface.materials[slot] if slot < len(surface.materials) else ""
