"""Splats in glTF: point primitives with the extension KHR_gaussian_splatting, in a .glb or a .gltf with its buffers.

Attributes are those of the extension's release candidate (2026): POSITION, and with the prefix
`KHR_gaussian_splatting:` ROTATION (x y z w), SCALE (linear), OPACITY (0 … 1) and SH_DEGREE_l_COEF_n. Each node that
shows such a mesh places it; harmonics turn with it. Colours of `lin_rec709_display` become sRGB to the first order in
the harmonics above degree 0.
"""

from __future__ import annotations

import base64
import binascii
import io
import struct
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO
from urllib.parse import unquote, unquote_to_bytes

import numpy as np
from numpy.typing import NDArray

from ...errors import FileError, SceneError, make_damaged_error
from ..gltf_document import SPLAT_EXTENSION, UNREADABLE_EXTENSIONS, check_gltf
from ..ply import make_unreadable_error
from .gaussians import C0, Floats, RawSplats, SplatSource, UpAxis, evaluate_sh_basis, pad_harmonics

COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
"""Component type of an accessor → numpy type code."""
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
READ_EXTENSIONS = (SPLAT_EXTENSION, "KHR_mesh_quantization", "KHR_materials_unlit")
COLOUR_SPACES = ("srgb_rec709_display", "lin_rec709_display")
TURN_TOLERANCE = 1e-4
"""Largest difference from a rotation times one scale."""


@dataclass(frozen=True)
class _Accessor:
    """Values (count, width) in a buffer: a file, or bytes that were written in the document."""

    source: Path | bytes
    offset: int
    stride: int
    count: int
    width: int
    component: np.dtype[Any]
    is_normalized: bool

    def read(self, first: int, count: int) -> Floats:
        """Return rows as float64, normalised integers in [−1, 1]."""
        packed = self.width * self.component.itemsize
        with closing(self._open()) as stream:
            stream.seek(self.offset + first * self.stride)
            data = stream.read((count - 1) * self.stride + packed)
        if len(data) < (count - 1) * self.stride + packed:
            raise EOFError
        shape, strides = (count, self.width), (self.stride, self.component.itemsize)
        with np.errstate(invalid="ignore"):  # widening a signalling NaN warns
            values = np.ndarray(shape, self.component, data, 0, strides).astype(np.float64)
        if self.is_normalized:
            values = np.maximum(values / np.iinfo(self.component).max, -1.0)
        return values

    def _open(self) -> BinaryIO:
        return io.BytesIO(self.source) if isinstance(self.source, bytes) else self.source.open("rb")


@dataclass(frozen=True)
class _Cloud:
    """One primitive as one node shows it."""

    attributes: dict[str, _Accessor]
    degree: int
    is_linear: bool
    matrix: NDArray[np.float64]

    @property
    def count(self) -> int:
        return self.attributes["POSITION"].count


def open_gltf(path: Path) -> SplatSource:
    """Open the splats of a glTF file; raise FileError if it is damaged, SceneError if it holds more than splats."""
    document = check_gltf(path, frozenset(UNREADABLE_EXTENSIONS))
    required = document.get("extensionsRequired")
    for name in required if isinstance(required, list) else []:
        # gltfpack, which decompresses meshes, drops splats.
        if str(name) not in READ_EXTENSIONS:
            raise _make_unread_error(path, str(name))
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            clouds = list(_find_clouds(path, document))
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError, struct.error) as error:
        raise make_damaged_error(path, "its nodes, accessors and buffers do not fit together") from error
    except OSError as error:
        raise make_unreadable_error(path, error) from error
    count = sum(cloud.count for cloud in clouds)
    if count == 0:
        raise FileError("holds no splats that a node shows.", where=str(path), remedy="Export it again.")
    return SplatSource(count, UpAxis("y", "glTF has +y up"), lambda block: _iter_clouds(path, clouds, block))


def _make_unread_error(path: Path, what: str) -> FileError:
    return FileError(
        f"its splats need {what[:100]}, which is not read.",
        where=str(path),
        remedy="Export them uncompressed, with the kernel 'ellipse' and colors in sRGB, or as .ply or .spz.",
    )


def _find_clouds(path: Path, document: dict[str, Any]) -> Iterator[_Cloud]:
    """Yield every splat primitive of the active scene with the matrix of its node."""
    nodes = document.get("nodes", [])
    scenes = document.get("scenes")
    roots = scenes[document.get("scene", 0)].get("nodes", []) if scenes else range(len(nodes))
    stack = [(index, np.eye(4)) for index in roots]
    seen: set[int] = set()
    while stack:
        index, parent = stack.pop()
        if index in seen:
            raise ValueError("a node has two parents")
        seen.add(index)
        matrix = parent @ _get_matrix(nodes[index])
        stack += [(child, matrix) for child in nodes[index].get("children", [])]
        if "mesh" not in nodes[index]:
            continue
        for primitive in document["meshes"][nodes[index]["mesh"]]["primitives"]:
            yield _read_primitive(path, document, primitive, matrix)


def _get_matrix(node: dict[str, Any]) -> NDArray[np.float64]:
    """Return the matrix (4, 4) of a node in its parent."""
    if "matrix" in node:
        return np.asarray(node["matrix"], dtype=np.float64).reshape(4, 4).T
    matrix = np.eye(4)
    x, y, z, w = node.get("rotation", (0.0, 0.0, 0.0, 1.0))
    matrix[:3, :3] = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
    matrix[:3, :3] *= np.asarray(node.get("scale", (1.0, 1.0, 1.0)), dtype=np.float64).reshape(3)
    matrix[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return matrix


def _read_primitive(
    path: Path, document: dict[str, Any], primitive: dict[str, Any], matrix: NDArray[np.float64]
) -> _Cloud:
    extensions = primitive.get("extensions") or {}
    names = [name for name in extensions if name.startswith(SPLAT_EXTENSION)]
    if not names:
        raise SceneError(
            "holds both meshes and Gaussian splats.",
            where=str(path),
            remedy="Export the splats and the meshes into files of their own.",
        )
    extension = extensions.get(SPLAT_EXTENSION, {})
    inner = [*(extension.get("extensions") or {}), *(name for name in names if name != SPLAT_EXTENSION)]
    kernel, colours = extension.get("kernel", "ellipse"), extension.get("colorSpace", COLOUR_SPACES[0])
    if inner or kernel != "ellipse" or colours not in COLOUR_SPACES:
        raise _make_unread_error(path, next(iter(inner), f"the kernel '{kernel}' in the color space '{colours}'"))
    attributes = primitive["attributes"]
    prefix = f"{SPLAT_EXTENSION}:"
    degree = 0
    while degree < 3 and f"{prefix}SH_DEGREE_{degree + 1}_COEF_0" in attributes:
        degree += 1
    widths = {"POSITION": 3, "ROTATION": 4, "SCALE": 3, "OPACITY": 1}
    widths |= {f"SH_DEGREE_{level}_COEF_{n}": 3 for level in range(degree + 1) for n in range(2 * level + 1)}
    found = {}
    for name, width in widths.items():
        full = name if name == "POSITION" else prefix + name
        if full not in attributes:
            raise FileError(
                f"its Gaussian splats have no attribute '{full}': it is damaged, or of a draft of {SPLAT_EXTENSION}.",
                where=str(path),
                remedy="Export it with a current exporter, or as .ply or .spz.",
            )
        found[name] = _read_accessor(path, document, attributes[full])
        if found[name].width != width or found[name].count != found["POSITION"].count:
            raise make_damaged_error(path, f"its attribute '{full}' is of another shape")
    return _Cloud(found, degree, colours == COLOUR_SPACES[1], matrix)


def _read_accessor(path: Path, document: dict[str, Any], index: int) -> _Accessor:
    """Return an accessor that lies in its buffer; raise ValueError, FileError or an error of look-up otherwise."""
    accessor = document["accessors"][index]
    if "sparse" in accessor or "bufferView" not in accessor:
        raise FileError(
            "its splats are in sparse or empty accessors, which are not read.",
            where=str(path),
            remedy="Export them without sparse accessors, or as .ply or .spz.",
        )
    view = document["bufferViews"][accessor["bufferView"]]
    source, start, size = _find_buffer(path, document["buffers"], view["buffer"])
    component, width = np.dtype(COMPONENTS[accessor["componentType"]]), WIDTHS[accessor["type"]]
    stride, offset = view.get("byteStride", width * component.itemsize), accessor.get("byteOffset", 0)
    count, view_offset, length = accessor["count"], view.get("byteOffset", 0), view["byteLength"]
    if not all(isinstance(each, int) and each >= 0 for each in (stride, offset, count, view_offset, length)):
        raise ValueError("a length is no whole number")
    packed = width * component.itemsize
    if count < 1 or stride < packed or offset + (count - 1) * stride + packed > length:
        raise ValueError("an accessor is longer than its view")
    if view_offset + length > size:
        raise make_damaged_error(path, f"it is cut short: {size} of {view_offset + length} bytes of a buffer are there")
    is_normalized = bool(accessor.get("normalized", False)) and component.kind != "f"
    return _Accessor(source, start + view_offset + offset, stride, count, width, component, is_normalized)


def _find_buffer(path: Path, buffers: list[dict[str, Any]], index: int) -> tuple[Path | bytes, int, int]:
    """Return where a buffer is, the position of its first byte, and how many bytes are there."""
    uri = buffers[index].get("uri")
    if uri is None:
        if index != 0:
            raise ValueError("a buffer has no data")
        with path.open("rb") as stream:
            (length,) = struct.unpack("<I", stream.read(20)[12:16])
        return path, 20 + length + 8, max(0, path.stat().st_size - 20 - length - 8)
    if uri.startswith("data:"):
        header, _, text = uri.partition(",")
        try:
            data = base64.b64decode(text, validate=True) if header.endswith(";base64") else unquote_to_bytes(text)
        except binascii.Error as error:
            raise ValueError("a buffer is no base64") from error
        return data, 0, len(data)
    file = path.parent / unquote(uri)
    return file, 0, file.stat().st_size


def _iter_clouds(path: Path, clouds: list[_Cloud], block: int) -> Iterator[RawSplats]:
    harmonics = (max(cloud.degree for cloud in clouds) + 1) ** 2
    for cloud in clouds:
        scale, rotation = _split_matrix(path, cloud.matrix)
        turn, turn_harmonics = _find_quaternion(rotation), _rotate_harmonics(rotation, cloud.degree)
        for first in range(0, cloud.count, block):
            count = min(block, cloud.count - first)
            try:
                values = {name: accessor.read(first, count) for name, accessor in cloud.attributes.items()}
            except OSError as error:
                raise make_unreadable_error(path, error) from error
            except EOFError as error:
                raise make_damaged_error(path, "it is cut short") from error
            names = [name for name in values if name.startswith("SH_")]
            colours = np.stack([values[name] for name in names], axis=1)
            opacities = values["OPACITY"][:, 0]
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                yield RawSplats(
                    means=values["POSITION"] @ (scale * rotation).T + cloud.matrix[:3, 3],
                    log_scales=np.log(np.where(values["SCALE"] >= 0.0, scale * values["SCALE"], np.nan)),
                    rotations=_multiply_quaternions(turn, values["ROTATION"][:, [3, 0, 1, 2]]),
                    opacities=np.where((opacities >= 0.0) & (opacities <= 1.0), opacities, np.nan),
                    harmonics=pad_harmonics(
                        np.einsum("ij,njc->nic", turn_harmonics, _encode_srgb(colours) if cloud.is_linear else colours),
                        harmonics,
                    ),
                )


def _split_matrix(path: Path, matrix: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
    """Return the scale and the rotation (3, 3) of a node; raise SceneError if it stretches or mirrors."""
    linear = matrix[:3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        volume = float(np.linalg.det(linear)) if np.isfinite(matrix).all() else 0.0
    if 0.0 < volume < np.inf:
        scale = volume ** (1.0 / 3.0)
        rotation = np.asarray(linear / scale)
        if np.abs(rotation @ rotation.T - np.eye(3)).max() < TURN_TOLERANCE:
            return scale, rotation
    raise SceneError(
        "a node stretches or mirrors its splats.",
        where=str(path),
        remedy="Give the node one positive scale along all axes, and export it again.",
    )


def _find_quaternion(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the quaternion w x y z of a rotation matrix (Bar-Itzhack 2000: the largest eigenvector)."""
    (a, b, c), (d, e, f), (g, h, i) = rotation
    table = [[a + e + i, h - f, c - g, d - b], [h - f, a - e - i, b + d, c + g]]
    table += [[c - g, b + d, e - a - i, f + h], [d - b, c + g, f + h, i - a - e]]
    return np.asarray(np.linalg.eigh(np.array(table))[1][:, -1])


def _multiply_quaternions(left: NDArray[np.float64], right: Floats) -> Floats:
    """Return left · right of a quaternion (4,) and quaternions (N, 4), w x y z."""
    w, x, y, z = left
    table = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    return np.asarray(right @ table.T)


def _rotate_harmonics(rotation: NDArray[np.float64], degree: int) -> NDArray[np.float64]:
    """Return the matrix (K, K) that turns coefficients with their splats, fitted on more directions than harmonics."""
    directions = np.random.default_rng(0).normal(size=(64, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    to, of = (np.stack(evaluate_sh_basis(each, degree), axis=1) for each in (directions, directions @ rotation))
    return np.asarray(np.linalg.lstsq(to, of, rcond=None)[0])


def _encode_srgb(harmonics: Floats) -> Floats:
    """Return coefficients (N, K, 3) of sRGB from those of linear color: the mean color, and the rest by the slope."""
    mean = np.clip(0.5 + C0 * harmonics[:, 0], 0.0, None)
    powered = np.maximum(mean, 0.0031308)
    encoded = np.where(mean <= 0.0031308, 12.92 * mean, 1.055 * powered ** (1.0 / 2.4) - 0.055)
    slope = np.where(mean <= 0.0031308, 12.92, 1.055 / 2.4 * powered ** (1.0 / 2.4 - 1.0))
    return np.concatenate([((encoded - 0.5) / C0)[:, None], harmonics[:, 1:] * slope[:, None]], axis=1)
