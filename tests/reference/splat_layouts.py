"""Plain writers of the splat layouts that others publish, one splat after the other, as their formats say."""

from __future__ import annotations

import gzip
import io
import json
import math
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from hnf_core.scene.splats.gaussians import Splats

C0 = 0.28209479177387814
EXTENSION = "KHR_gaussian_splatting"


def write_splat(path: Path, splats: Splats) -> Path:
    """antimatter15: 32 bytes a splat, no header, no harmonics."""
    rows = b""
    for mean, scale, turn, opacity, harmonics in _each(splats):
        rows += struct.pack("<6f", *mean, *scale)
        rows += bytes([*_colour(harmonics[0]), _byte(255.0 * opacity)])
        rows += bytes(_byte(128.0 * part + 128.0) for part in turn)
    path.write_bytes(rows)
    return path


def write_spz(path: Path, splats: Splats, version: int = 3, bits: int = 12) -> Path:
    """Niantic: one attribute of all splats after the other."""
    parts = [b""] * 6
    for mean, scale, (w, x, y, z), opacity, harmonics in _each(splats):
        parts[0] += b"".join((round(each * 2**bits) & 0xFFFFFF).to_bytes(3, "little") for each in mean)
        parts[1] += bytes([_byte(255.0 * opacity)])
        parts[2] += bytes(_byte(255.0 * (0.15 * each + 0.5)) for each in harmonics[0])
        parts[3] += bytes(_byte(16.0 * (math.log(each) + 10.0)) for each in scale)
        if version == 2:
            sign = -1.0 if w < 0.0 else 1.0
            parts[4] += bytes(_byte(127.5 * (sign * part + 1.0)) for part in (x, y, z))
        else:
            parts[4] += struct.pack("<I", _spz_word([x, y, z, w]))
        parts[5] += bytes(_byte(128.0 * each + 128.0) for row in harmonics[1:] for each in row)
    degree = splats.degree
    header = struct.pack("<4sIIBBBB", b"NGSP", version, len(splats), degree, bits, 0, 0)
    if version < 4:
        path.write_bytes(gzip.compress(header + b"".join(parts), mtime=0))
        return path
    import zstandard

    parts = parts[: 6 if degree else 5]
    packed = [zstandard.ZstdCompressor().compress(part) for part in parts]
    table = b"".join(struct.pack("<QQ", len(small), len(part)) for small, part in zip(packed, parts, strict=True))
    head = header[:-1] + bytes([len(parts)]) + struct.pack("<I12x", 40)
    path.write_bytes(head + b"an extra" + table + b"".join(packed))  # the table need not follow the header at once
    return path


def write_ksplat(path: Path, splats: Splats, level: int = 1, bucket: int = 4, sections: int = 2) -> Path:
    """mkkellogg: sections of rows; above level 0 centres lie in buckets of `bucket` splats, the last partly full."""
    per = -(-len(splats) // sections)
    headers, bodies = b"", b""
    for first in range(0, len(splats), per):
        rows = [*_each(splats)][first : first + per]
        groups = [rows[at : at + bucket] for at in range(0, len(rows), bucket)] if level else []
        full = sum(len(group) == bucket for group in groups)
        size = 2.0 * max((float(np.abs(_off(group)).max()) for group in groups), default=0.0) + 1e-3
        headers += struct.pack(
            "<4IfHxxIIIIH", len(rows), len(rows), bucket if level else 0, len(groups), size, 12 if level else 0,
            32767 if level else 0, 0, full, len(groups) - full, splats.degree,
        ).ljust(1024, b"\0")  # fmt: skip
        bodies += b"".join(struct.pack("<I", len(group)) for group in groups[full:])
        bodies += b"".join(struct.pack("<3f", *_middle(group)) for group in groups)
        for number, (mean, scale, turn, opacity, harmonics) in enumerate(rows):
            if level:
                middle = np.float32(_middle(groups[number // bucket]))
                bodies += struct.pack("<3H", *(round(each / (size / 2.0) * 32767) + 32767 for each in mean - middle))
            else:
                bodies += struct.pack("<3f", *mean)
            bodies += struct.pack("<7e" if level else "<7f", *scale, *turn)
            bodies += bytes([*_colour(harmonics[0]), _byte(255.0 * opacity)])
            for begin, end in ((1, 4), (4, 9), (9, 16)):
                for channel in range(3 if len(harmonics) >= end else 0):
                    for each in harmonics[begin:end, channel]:
                        byte = bytes([min(max(math.floor((each + 1.5) / 3.0 * 255.0), 0), 255)])
                        bodies += byte if level == 2 else struct.pack("<e" if level else "<f", each)
    count = len(headers) // 1024
    head = struct.pack("<4B4IHxx5f", 0, 1, 0, 0, count, count, len(splats), len(splats), level, 0, 0, 0, -1.5, 1.5)
    path.write_bytes(head.ljust(4096, b"\0") + headers + bodies)
    return path


def encode_webp(pixels: np.ndarray) -> bytes:
    import PIL.Image

    stream = io.BytesIO()
    PIL.Image.fromarray(pixels).save(stream, "WEBP", lossless=True, exact=True)
    return stream.getvalue()


def write_sog(
    path: Path, splats: Splats, version: int = 2, encode: Callable[[np.ndarray], bytes] = encode_webp
) -> Path:
    """PlayCanvas: a zip archive, or meta.json with its pictures beside it where the path ends so. Version 1 or 2."""
    count = len(splats)
    width = max(4, math.isqrt(count) + 1)
    height = -(-count // width) + 1
    names = ["means_l", "means_u", "scales", "quats", "sh0", "shN_labels"]
    pictures = {name: np.zeros((height * width, 4), dtype=np.uint8) for name in names}
    logs = np.sign(splats.means) * np.log1p(np.abs(splats.means.astype(np.float64)))
    tables = {"scales": np.log(splats.scales.astype(np.float64)), "sh0": splats.harmonics[:, 0].astype(np.float64)}
    opacities = splats.opacities.astype(np.float64)
    if version == 1:
        tables["sh0"] = np.concatenate([tables["sh0"], np.log(opacities / (1.0 - opacities))[:, None]], axis=1)
    meta: dict = {"version": 2, "asset": {"generator": "a test"}, "count": count} if version == 2 else {}
    meta["means"] = {"mins": logs.min(axis=0).tolist(), "maxs": logs.max(axis=0).tolist()}
    for name, table in tables.items():
        low, high = (table.min(), table.max()) if version == 2 else (table.min(axis=0), table.max(axis=0))
        if version == 2:
            meta[name] = {"codebook": np.linspace(low, high, 256).tolist()}
        else:
            meta[name] = {"mins": low.tolist(), "maxs": high.tolist()}
        pictures[name][:count, : table.shape[1]] = np.rint(255.0 * (table - low) / np.maximum(high - low, 1e-12))
    for number, (_, _, turn, opacity, _) in enumerate(_each(splats)):
        low, high = np.array(meta["means"]["mins"]), np.array(meta["means"]["maxs"])
        for axis, part in enumerate(
            np.rint(65535.0 * (logs[number] - low) / np.maximum(high - low, 1e-12)).astype(int)
        ):
            pictures["means_l"][number, axis], pictures["means_u"][number, axis] = part % 256, part // 256
        largest = max(range(4), key=lambda part: abs(turn[part]))
        sign = -1.0 if turn[largest] < 0.0 else 1.0
        rest = [sign * turn[part] * 2.0**0.5 for part in range(4) if part != largest]
        pictures["quats"][number] = [*(_byte(127.5 * each + 127.5) for each in rest), 252 + largest]
        if version == 2:
            pictures["sh0"][number, 3] = _byte(255.0 * opacity)
        pictures["shN_labels"][number, :2] = number % 256, number // 256
    pictures["means_l"][:, 3] = pictures["means_u"][:, 3] = pictures["scales"][:, 3] = 255
    pictures["shN_labels"][:, 3] = 255
    meta["means"]["files"] = ["means_l.webp", "means_u.webp"]
    for name in ("scales", "quats", "sh0"):
        meta.setdefault(name, {})["files"] = [f"{name}.webp"]
    if version == 1:
        meta["means"]["shape"] = [count, 3]
    files = {f"{name}.webp": encode(each.reshape(height, width, 4)) for name, each in pictures.items()}
    higher = splats.harmonics[:, 1:].astype(np.float64)
    if higher.shape[1]:
        palette = np.zeros((-(-count // 64) * 64, higher.shape[1], 4), dtype=np.uint8)
        palette[:count, :, :3], palette[..., 3] = np.rint(127.5 * (higher + 1.0)), 255
        files["shN_centroids.webp"] = encode(palette.reshape(-1, 64 * higher.shape[1], 4))
        meta["shN"] = {"files": ["shN_centroids.webp", "shN_labels.webp"]}
        if version == 2:
            table = np.linspace(-1.0, 1.0, 256).tolist()
            meta["shN"] |= {"count": count, "bands": splats.degree, "codebook": table}
        else:
            meta["shN"] |= {"mins": -1.0, "maxs": 1.0}
    else:
        del files["shN_labels.webp"]
    files["meta.json"] = json.dumps(meta).encode()
    if path.suffix == ".json":
        for name, data in files.items():
            path.with_name(name).write_bytes(data)
        return path.with_name("meta.json")
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return path


def write_gltf(
    path: Path, splats: Splats, *, small: bool = False, extension: dict | None = None, nodes: list | None = None
) -> Path:
    """KHR_gaussian_splatting; `small`: rotation as normalised shorts, opacity as normalised bytes, interleaved."""
    count = len(splats)
    columns = {"POSITION": ("f4", splats.means, 5126, "VEC3")}
    columns["SCALE"] = ("f4", splats.scales, 5126, "VEC3")
    turns = splats.rotations[:, [1, 2, 3, 0]]
    columns["ROTATION"] = ("i2", np.rint(32767 * turns), 5122, "VEC4") if small else ("f4", turns, 5126, "VEC4")
    opacity = splats.opacities
    columns["OPACITY"] = ("u1", np.rint(255 * opacity), 5121, "SCALAR") if small else ("f4", opacity, 5126, "SCALAR")
    number = 0
    for level in range(splats.degree + 1):
        for order in range(2 * level + 1):
            columns[f"SH_DEGREE_{level}_COEF_{order}"] = ("f4", splats.harmonics[:, number], 5126, "VEC3")
            number += 1
    widths = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
    row = np.dtype({
        "names": [*columns], "formats": [("<" + code, (widths[kind],)) for code, _, _, kind in columns.values()],
        "offsets": [16 * place for place in range(len(columns))], "itemsize": 16 * len(columns),
    }) if small else None  # fmt: skip
    data, views, accessors, attributes = b"", [], [], {}
    if row is not None:
        table = np.zeros(count, dtype=row)
        for name, (_, values, _, _) in columns.items():
            table[name] = values.reshape(table[name].shape)
        data = table.tobytes()
        views.append({"buffer": 0, "byteLength": len(data), "byteStride": row.itemsize})
    for place, (name, (code, values, component, kind)) in enumerate(columns.items()):
        accessor = {"componentType": component, "count": count, "type": kind, "bufferView": 0}
        if row is not None:
            accessor["byteOffset"] = 16 * place
        else:
            packed = np.ascontiguousarray(values, dtype="<" + code).tobytes()
            accessor["bufferView"] = len(views)
            views.append({"buffer": 0, "byteOffset": len(data), "byteLength": len(packed)})
            data += packed
        if component in (5121, 5122):
            accessor["normalized"] = True
        attributes[name if name == "POSITION" else f"{EXTENSION}:{name}"] = len(accessors)
        accessors.append(accessor)
    what = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"} if extension is None else extension
    document = {
        "asset": {"version": "2.0"}, "extensionsUsed": [EXTENSION], "extensionsRequired": [EXTENSION], "scene": 0,
        "scenes": [{"nodes": [0]}], "nodes": nodes or [{"mesh": 0}], "accessors": accessors, "bufferViews": views,
        "meshes": [{"primitives": [{"mode": 0, "attributes": attributes, "extensions": {EXTENSION: what}}]}],
        "buffers": [{"byteLength": len(data)}],
    }  # fmt: skip
    if path.suffix == ".gltf":
        document["buffers"][0]["uri"] = "splats.bin"
        path.with_name("splats.bin").write_bytes(data)
        path.write_text(json.dumps(document))
        return path
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    data += bytes(-len(data) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
    return path


WRITERS: dict[str, Callable[[Path, Splats], Path]] = {
    "splat": write_splat,
    "spz2": lambda path, splats: write_spz(path, splats, 2),
    "spz3": lambda path, splats: write_spz(path, splats, 3),
    "spz4": lambda path, splats: write_spz(path, splats, 4),
    "ksplat0": lambda path, splats: write_ksplat(path, splats, 0),
    "ksplat1": lambda path, splats: write_ksplat(path, splats, 1),
    "ksplat2": lambda path, splats: write_ksplat(path, splats, 2),
    "sog1": lambda path, splats: write_sog(path, splats, 1),
    "sog2": lambda path, splats: write_sog(path, splats, 2),
    "glb": write_gltf,
    "glb-small": lambda path, splats: write_gltf(path, splats, small=True),
}
"""Name of a layout → what writes it and returns its path."""


def get_suffix(layout: str) -> str:
    """Return the ending of a layout's files."""
    return "." + layout.rstrip("01234").removesuffix("-small")


def _each(splats: Splats):
    parts = (splats.means, splats.scales, splats.rotations, splats.opacities, splats.harmonics)
    return zip(*(part.astype(np.float64) for part in parts), strict=True)


def _byte(value: float) -> int:
    return min(max(round(value), 0), 255)


def _colour(constant: np.ndarray) -> list[int]:
    return [_byte(255.0 * (0.5 + C0 * each)) for each in constant]


def _middle(rows: list) -> np.ndarray:
    means = np.array([row[0] for row in rows])
    return (means.min(axis=0) + means.max(axis=0)) / 2.0


def _off(rows: list) -> np.ndarray:
    return np.array([row[0] for row in rows]) - np.float32(_middle(rows))


def _spz_word(turn: list[float]) -> int:
    """x y z w → the index of the largest, and of the others a sign and 9 bits each."""
    largest = max(range(4), key=lambda part: abs(turn[part]))
    sign = -1.0 if turn[largest] < 0.0 else 1.0
    word = largest
    for part in range(4):
        if part != largest:
            word = word << 10 | (512 if sign * turn[part] < 0.0 else 0) | round(511 * abs(turn[part]) * 2**0.5)
    return word
