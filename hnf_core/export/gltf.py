"""Write a touched mesh, its baked touch and a stroke's signal as GLB (glTF 2.0), and read the signal back.

Container (Khronos, "glTF 2.0 Specification", 4.4 "Binary glTF Layout"): magic "glTF", version 2, length; chunks of
uint32 length, uint32 type and data, padded to four bytes, JSON with spaces and BIN with zeros.

Mesh: glTF knows neither faces nor face corners, so corners that differ in normal, UV or baked material become separate
vertices. Vertex attributes are _HNF_TOKEN (index into the palette, −1 untouched), _HNF_ROUGHNESS (m RMS),
_HNF_CONFIDENCE (0–1) and _HNF_VERTEX (vertex of the mesh in Blender), all floats, since glTF has no other type for −1
and large numbers. The palette is in extras.hnf of the mesh. The stroke's WAV is stored byte for byte in a buffer view
that extras.hnf of the asset names, since glTF has no place for a vibration that is not .hmpg.

Baked touch: the extension MPEG_haptic_material (ISO/IEC 23090-14, 2nd edition; public page and schemas in
github.com/KhronosGroup/glTF, extensions/2.0/Vendor/MPEG_haptic_material). The file lists materials; a mesh names one by
hapticMaterialIndex; a material has arrays of textures {texture, type} by property. The page defines what a property
means but not how pixels are scaled. So each texture has its range, unit and exact values in extras, and one texel per
baked material: a row of pixels that a separate UV map points at. This way values are not averaged across seams of the
artist's UV map, and a mesh without UVs works too. Left out because nothing is baked for them: temperature, vibration,
custom. Left out because they need binary haptic media (.hmpg), which this project does not write: haptic, and textures
of type Reference.
"""

from __future__ import annotations

import json
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import __version__
from ..errors import FileError, UsageError, make_damaged_error
from ..files import write_bytes
from ..json_io import read_limited_bytes
from ..material.palette import Palette
from ..material.token import LEVELS, TOKEN_NAMES
from ..signal import Signal
from .options import ExportOptions, ImportOptions
from .touched_surface import UNTOUCHED, TouchedSurface
from .wav import decode_wav, encode_wav

_MAGIC, _JSON, _BIN = b"glTF", 0x4E4F534A, 0x004E4942
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
_FLOAT, _UINT32 = 5126, 5125
_ACCESSOR_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
_MAX_GLB_BYTES = 2**32 - 1


class BufferBuilder:
    """Binary buffer of a glTF file, with its buffer views and accessors, which grows as data is appended."""

    def __init__(self) -> None:
        self._data = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    @property
    def data(self) -> bytes:
        return bytes(self._data)

    def add_bytes(self, data: bytes, target: int | None = None) -> int:
        """Append bytes, aligned to four, as a new buffer view; return its index.

        `target` is glTF's code for vertex or index data.
        """
        self._data.extend(b"\0" * (-len(self._data) % 4))
        view: dict[str, Any] = {"buffer": 0, "byteOffset": len(self._data), "byteLength": len(data)}
        if target is not None:
            view["target"] = target
        self._data.extend(data)
        self.views.append(view)
        return len(self.views) - 1

    def add_vertices(self, values: NDArray[np.float32]) -> int:
        """Append (N,) or (N, k) floats as a new accessor with bounds; return its index."""
        rows = np.ascontiguousarray(values.reshape(len(values), -1), dtype="<f4")
        bounds = {"min": [float(v) for v in rows.min(axis=0)], "max": [float(v) for v in rows.max(axis=0)]}
        view = self.add_bytes(rows.tobytes(), ARRAY_BUFFER)
        return self._add_accessor(view, _FLOAT, len(rows), _ACCESSOR_TYPES[rows.shape[1]], bounds)

    def add_indices(self, values: NDArray[np.uint32]) -> int:
        """Append vertex indices as a new accessor; return its index."""
        flat = np.ascontiguousarray(values.ravel(), dtype="<u4")
        bounds = {"min": [int(flat.min())], "max": [int(flat.max())]}
        view = self.add_bytes(flat.tobytes(), ELEMENT_ARRAY_BUFFER)
        return self._add_accessor(view, _UINT32, len(flat), "SCALAR", bounds)

    def _add_accessor(self, view: int, kind: int, count: int, shape: str, bounds: dict[str, Any]) -> int:
        self.accessors.append({"bufferView": view, "componentType": kind, "count": count, "type": shape, **bounds})
        return len(self.accessors) - 1


def encode_glb(tree: dict[str, Any], data: bytes, *, where: str = "glb") -> bytes:
    """Encode a JSON tree and its one buffer as GLB. Equal input gives equal bytes.

    Raises FileError above 4 GB.
    """
    tree = {**tree, "buffers": [{"byteLength": len(data)}]}
    text = json.dumps(tree, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    data += b"\0" * (-len(data) % 4)
    total = 12 + 8 + len(text) + 8 + len(data)
    if total > _MAX_GLB_BYTES:
        raise FileError("is more than a GLB can hold (4 GB).", where=where, remedy="Decimate the mesh.")
    head = struct.pack("<4sII", _MAGIC, 2, total)
    return b"".join([head, struct.pack("<II", len(text), _JSON), text, struct.pack("<II", len(data), _BIN), data])


def decode_glb(data: bytes, path: Path) -> tuple[dict[str, Any], bytes]:
    """Return the JSON tree and the buffer of a GLB. Raises FileError if it is damaged."""
    if len(data) < 20 or data[:4] != _MAGIC:
        raise make_damaged_error(path, "it does not begin like a binary glTF file")
    version, total = struct.unpack_from("<II", data, 4)
    if version != 2 or total > len(data):
        raise make_damaged_error(path, f"it is of version {version} and says {total} bytes, {len(data)} are there")
    tree, block, at = None, b"", 12
    while at + 8 <= total:
        size, kind = struct.unpack_from("<II", data, at)
        body = data[at + 8 : at + 8 + size]
        if len(body) < size:
            raise make_damaged_error(path, "it ends early")
        if kind == _JSON and tree is None:
            tree = _parse_json_chunk(body, path)
        elif kind == _BIN and not block:
            block = body
        at += 8 + size
    if tree is None:
        raise make_damaged_error(path, "it has no JSON")
    return tree, block


def get_view_bytes(tree: dict[str, Any], block: bytes, index: object, path: Path) -> bytes:
    """Return the bytes of a GLB's buffer view with an index. Raises FileError if it is missing or out of bounds.

    `tree` is the GLB's JSON, `block` its buffer.
    """
    try:
        view = tree["bufferViews"][index]
        start, length = int(view.get("byteOffset", 0)), int(view["byteLength"])
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        raise make_damaged_error(path, "a part that it names is missing") from error
    if start < 0 or length < 0 or start + length > len(block):
        raise make_damaged_error(path, "a part that it names lies beyond its end")
    return block[start : start + length]


def _parse_json_chunk(body: bytes, path: Path) -> dict[str, Any]:
    try:
        tree = json.loads(body.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise make_damaged_error(path, f"its JSON cannot be read ({error})") from error
    if not isinstance(tree, dict):
        raise make_damaged_error(path, "its JSON is no object")
    return tree


Float32 = NDArray[np.float32]

Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""Rotation from Blender's axes (z up) to glTF's (y up, right-handed; glTF 2.0, 3.4 "Coordinate System and Units")."""


@dataclass(frozen=True)
class VertexTable:
    """Table of N glTF vertices, each with one normal, UV and baked material, so that nothing is averaged between faces.

    Attributes
    ----------
    position : (N, 3) float32
        Positions [m], y up.
    normal : (N, 3) float32
        Unit normals.
    uv : (N, 2) float32 or None
        UVs with glTF's origin at the upper left.
    taxel : (N, 2) float32
        UVs of the face's material in the row of taxels.
    token, roughness, confidence : (N,) float32
        Baked values of the face.
    vertex : (N,) float32
        Index in the surface's own mesh.
    corner : (T, 3) uint32
        Rows of this table for the corners of each triangle.
    """

    position: Float32
    normal: Float32
    uv: Float32 | None
    taxel: Float32
    token: Float32
    roughness: Float32
    confidence: Float32
    vertex: Float32
    corner: NDArray[np.uint32]


def build_vertex_table(surface: TouchedSurface) -> VertexTable:
    """Make the vertices of a surface for glTF by merging equal face corners, in the order of the triangles."""
    mesh = surface.mesh
    count = len(mesh.triangles)
    normal = _normalise_rows(mesh.normals.reshape(-1, 3) @ Y_UP.T)
    faces = np.stack([surface.token.astype(np.float32), surface.roughness, surface.confidence], axis=1)
    columns = [mesh.triangles.reshape(-1, 1).astype(np.float32), normal, np.repeat(faces, 3, axis=0)]
    if mesh.uv is not None:
        columns.append(mesh.uv.reshape(-1, 2).astype(np.float32))
    # Vertex numbers of large meshes exceed the integers of float32, so their bits are stored instead.
    rows = np.ascontiguousarray(np.concatenate(columns, axis=1), dtype=np.float32) + np.float32(0.0)
    rows[:, 0] = mesh.triangles.reshape(-1).astype(np.int32).view(np.float32)
    first, inverse = find_distinct_rows(rows)
    distinct, vertex = rows[first], mesh.triangles.reshape(-1)[first]
    uv = None
    if mesh.uv is not None:
        uv = np.stack([distinct[:, 7], np.float32(1.0) - distinct[:, 8]], axis=1)
    return VertexTable(
        position=(mesh.vertices[vertex] @ Y_UP.T).astype(np.float32),
        normal=distinct[:, 1:4].copy(),
        uv=uv,
        taxel=compute_taxel_uv(distinct[:, 4].astype(np.int64), 0 if surface.palette is None else len(surface.palette)),
        token=distinct[:, 4].copy(),
        roughness=distinct[:, 5].copy(),
        confidence=distinct[:, 6].copy(),
        vertex=vertex.astype(np.float32),
        corner=inverse.reshape(count, 3).astype(np.uint32),
    )


def find_distinct_rows(rows: Float32) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the index of the first of each set of equal rows (n, k), in their order, and the set of each row (n,).

    Rows are compared bit by bit.
    """
    rows = np.ascontiguousarray(rows)
    row_bytes = rows.view(np.dtype((np.void, rows.strides[0]))).reshape(-1)
    _, first, inverse = np.unique(row_bytes, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    return first[order], rank[inverse.reshape(-1)]


def find_vertices_on_path(surface: TouchedSurface, table: VertexTable) -> NDArray[np.int32]:
    """Return the sorted vertices of `table` in the triangles that the stroke touches; empty if its path is unknown."""
    if surface.path is None:
        return np.zeros(0, dtype=np.int32)
    touched = np.unique(surface.path.triangle[surface.path.triangle > UNTOUCHED])
    return np.asarray(np.unique(table.corner[touched]), dtype=np.int32)


def compute_taxel_uv(token: NDArray[np.int64], entries: int) -> Float32:
    """Return UVs (…, 2) of each token's pixel center in the row of taxels.

    Taxels are the pixels of a texture with one pixel per baked material, after a first one for untouched surface.
    `entries` is the number of materials.
    """
    across = (token + 1 + 0.5) / compute_taxel_row_width(entries)
    return np.asarray(np.stack([across, np.full(across.shape, 0.5)], axis=-1), dtype=np.float32)


def compute_taxel_row_width(entries: int) -> int:
    """Return the width [pixels] of the texture with one pixel (taxel) per baked material and one for untouched surface.

    It is a power of two, which old renderers need; `entries` is the number of materials.
    """
    return 1 << entries.bit_length()


def encode_placement(placement: NDArray[np.float64]) -> list[float]:
    """Return a surface's world matrix (4, 4) in Blender's axes as glTF's 16 numbers, column by column."""
    rotation = np.eye(4)
    rotation[:3, :3] = Y_UP
    return [float(value) for value in (rotation @ placement @ rotation.T).T.ravel()]


def _normalise_rows(normals: NDArray[np.float64]) -> Float32:
    """Normalize normals (n, 3) to unit length in float32; a zero vector becomes +y, since glTF needs a direction."""
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    up = np.array([0.0, 1.0, 0.0])
    return np.where(length > 1e-12, normals / np.where(length > 1e-12, length, 1.0), up).astype(np.float32)


HAPTIC_EXTENSION = "MPEG_haptic_material"
_NEAREST, _CLAMP = 9728, 33071


def encode_haptic_material(palette: Palette, buffer: BufferBuilder, uv_map: int) -> dict[str, Any]:
    """Build glTF's samplers, images, textures and extensions for the baked materials of a palette.

    A property without a value in any material is left out. `uv_map` is the number of the TEXCOORD that points at the
    textures' pixels, one per material.
    """
    roughness = np.sqrt(np.sum(10.0 ** (2.0 * palette.tokens[:, LEVELS].astype(np.float64)), axis=1))
    columns: dict[str, tuple[str, str, str, list[float | None]]] = {
        "stiffness": ("High_Resolution", "contact stiffness at 1 N", "N/m", _get_mechanics(palette, "stiffness_n_m")),
        "friction": ("High_Resolution", "coefficient of friction", "1", _get_mechanics(palette, "friction")),
        "vibrotactileTexture": ("Other", "RMS height of the relief", "m", [float(value) for value in roughness]),
    }
    material: dict[str, Any] = {"name": "baked touch"}
    images: list[dict[str, Any]] = []
    for name, (kind, quantity, unit, values) in columns.items():
        largest = max((value for value in values if value is not None), default=0.0)
        if largest <= 0.0:
            continue
        images.append(
            {"name": name, "mimeType": "image/png", "bufferView": buffer.add_bytes(_encode_taxel_row(values, largest))}
        )
        meaning = {"quantity": quantity, "unit": unit, "minimum": 0.0, "maximum": largest, "values": values}
        texture = {"index": len(images) - 1, "texCoord": uv_map}
        material[name] = [{"texture": texture, "type": kind, "extras": {"hnf": meaning}}]
    return {
        "samplers": [{"magFilter": _NEAREST, "minFilter": _NEAREST, "wrapS": _CLAMP, "wrapT": _CLAMP}],
        "images": images,
        "textures": [{"sampler": 0, "source": index} for index in range(len(images))],
        "extensions": {HAPTIC_EXTENSION: {"materials": [material]}},
        "extensionsUsed": [HAPTIC_EXTENSION],
    }


def encode_palette(palette: Palette) -> dict[str, Any]:
    """Return the palette of baked materials as JSON values without loss, for glTF's extras."""
    return {
        "schema": palette.schema,
        "encoder": palette.encoder_id,
        "names": list(palette.names),
        "stiffness_n_m": _get_mechanics(palette, "stiffness_n_m"),
        "damping_ratio": _get_mechanics(palette, "damping_ratio"),
        "friction": _get_mechanics(palette, "friction"),
        "features": list(TOKEN_NAMES),
        "tokens": [[float(value) for value in token] for token in palette.tokens],
    }


def _get_mechanics(palette: Palette, name: str) -> list[float | None]:
    values = [getattr(mechanics, name) for mechanics in palette.mechanics]
    return [None if value is None else float(value) for value in values]


def _encode_taxel_row(values: list[float | None], largest: float) -> bytes:
    """Encode a property's values as a PNG of one row, a pixel (taxel) per material.

    A pixel is 0 for untouched or unknown, 255 for the value `largest`.
    """
    pixels: NDArray[np.uint8] = np.zeros((1, compute_taxel_row_width(len(values))), dtype=np.uint8)
    pixels[0, 1 : len(values) + 1] = [round(255.0 * (value or 0.0) / largest) for value in values]
    return encode_png(pixels)


def encode_png(pixels: NDArray[np.uint8]) -> bytes:
    """Encode gray values (H, W) or sRGB (H, W, 3), row by row from the top, as a PNG (W3C, 3rd edition).

    Equal pixels give equal bytes with one version of zlib.
    """
    height, width = pixels.shape[:2]
    # Each row starts with filter type 0, "None".
    rows = b"".join(b"\0" + row.tobytes() for row in np.ascontiguousarray(pixels))
    head = struct.pack(">IIBBBBB", width, height, 8, 2 if pixels.ndim == 3 else 0, 0, 0, 0)
    chunks = [(b"IHDR", head), (b"IDAT", zlib.compress(rows, 9)), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(_encode_png_chunk(tag, body) for tag, body in chunks)


def _encode_png_chunk(tag: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + tag + body + struct.pack(">I", zlib.crc32(tag + body))


MAX_READ_BYTES = 512 * 2**20
GENERATOR = "Haptic Neural Fields"
"""Beginning of the "generator" of files written here."""
_TRIANGLES = 4


def write_glb(path: Path, signal: Signal, options: ExportOptions) -> tuple[str, ...]:
    """Write the surface in `options` with the signal as GLB; return sentences on what was left out.

    Raises UsageError if `options` has no surface, FileError if the signal is not finite or the file cannot be written.
    """
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
    """Read the signal from a GLB that `write_glb` wrote, unchanged.

    Raises FileError if the file is damaged or holds no signal.
    """
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
    """Encode a surface and, if given, a stroke's signal on it as GLB. Equal input gives equal bytes."""
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
    maps = [
        coordinates
        for coordinates in (table.uv, None if surface.palette is None else table.taxel)
        if coordinates is not None
    ]
    attributes |= {f"TEXCOORD_{number}": buffer.add_vertices(coordinates) for number, coordinates in enumerate(maps)}
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
