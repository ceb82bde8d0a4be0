"""What glTF 2.0 and MPEG_haptic_material ask of a file, as far as ours could break it.

Khronos, "glTF 2.0 Specification", 3.6 (buffers, accessors: bounds, alignment), 3.7.2 (meshes) and 4.4 (GLB); the
extension's public schemas in github.com/KhronosGroup/glTF, extensions/2.0/Vendor/MPEG_haptic_material/schema.
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np

WIDTH = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
TEXTURE_TYPES = {"High_Resolution", "Low_Resolution", "Reference", "Other"}
PROPERTIES = {"stiffness", "friction", "vibrotactileTexture", "temperature", "vibration", "custom"}


def chunks(data: bytes) -> list[tuple[int, bytes]]:
    """The chunks of a GLB, read without the code under test."""
    magic, version, total = struct.unpack_from("<4sII", data)
    assert (magic, version, total) == (b"glTF", 2, len(data))
    found, at = [], 12
    while at < total:
        size, kind = struct.unpack_from("<II", data, at)
        assert size % 4 == 0
        found.append((kind, data[at + 8 : at + 8 + size]))
        at += 8 + size
    assert at == total
    return found


def read_accessor(tree: dict[str, Any], block: bytes, index: int) -> np.ndarray:
    accessor = tree["accessors"][index]
    view = tree["bufferViews"][accessor["bufferView"]]
    kind = {5125: "<u4", 5126: "<f4"}[accessor["componentType"]]
    count = accessor["count"] * WIDTH[accessor["type"]]
    assert view["byteOffset"] % 4 == 0
    assert view["byteLength"] == 4 * count
    values = np.frombuffer(block, kind, count, view["byteOffset"]).reshape(accessor["count"], -1)
    assert accessor["min"] == values.min(axis=0).tolist()
    assert accessor["max"] == values.max(axis=0).tolist()
    return values


def check_gltf(tree: dict[str, Any], block: bytes) -> None:
    """Raises AssertionError at the first rule that is broken."""
    assert tree["asset"]["version"] == "2.0"
    assert 0 <= len(block) - tree["buffers"][0]["byteLength"] < 4
    for view in tree["bufferViews"]:
        assert view["byteLength"] > 0
        assert view["byteOffset"] + view["byteLength"] <= tree["buffers"][0]["byteLength"]
    for mesh in tree["meshes"]:
        for primitive in mesh["primitives"]:
            _primitive(tree, block, primitive)
    assert tree["nodes"][tree["scenes"][tree["scene"]]["nodes"][0]]["mesh"] == 0
    used = {name for part in (tree, *tree["meshes"]) for name in part.get("extensions", {})}
    assert used == set(tree.get("extensionsUsed", []))
    assert "extensionsRequired" not in tree
    if "MPEG_haptic_material" in used:
        _haptic(tree)


def _primitive(tree: dict[str, Any], block: bytes, primitive: dict[str, Any]) -> None:
    names = primitive["attributes"]
    counts = {len(read_accessor(tree, block, index)) for index in names.values()}
    assert len(counts) == 1
    assert read_accessor(tree, block, primitive["indices"]).max() < counts.pop()
    maps = sorted(name for name in names if name.startswith("TEXCOORD_"))
    assert maps == [f"TEXCOORD_{number}" for number in range(len(maps))]
    assert all(name in ("POSITION", "NORMAL") or name.startswith(("TEXCOORD_", "_")) for name in names)
    for name, index in names.items():
        assert tree["accessors"][index]["componentType"] == 5126, name  # unsigned int is for indices alone
        assert np.isfinite(read_accessor(tree, block, index)).all()
    np.testing.assert_allclose(np.linalg.norm(read_accessor(tree, block, names["NORMAL"]), axis=1), 1.0, atol=5e-4)
    assert 0 <= primitive["material"] < len(tree["materials"])


def _haptic(tree: dict[str, Any]) -> None:
    materials = tree["extensions"]["MPEG_haptic_material"]["materials"]
    assert len(materials) >= 1
    for mesh in tree["meshes"]:
        assert 0 <= mesh["extensions"]["MPEG_haptic_material"]["hapticMaterialIndex"] < len(materials)
    for material in materials:
        assert set(material) <= PROPERTIES | {"haptic", "name", "extensions", "extras"}
        for name in PROPERTIES & set(material):
            for entry in material[name]:
                assert set(entry) <= {"texture", "type", "extensions", "extras"}
                assert entry["type"] in TEXTURE_TYPES
                image = tree["textures"][entry["texture"]["index"]]["source"]
                assert tree["images"][image]["mimeType"] == "image/png"
                for mesh in tree["meshes"]:
                    for primitive in mesh["primitives"]:
                        assert f"TEXCOORD_{entry['texture']['texCoord']}" in primitive["attributes"]
