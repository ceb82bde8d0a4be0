"""Splats in SOG (PlayCanvas): pictures of one pixel a splat, and meta.json, in a zip archive or side by side.

A centre is 16 bits a coordinate, low and high byte in two pictures, between bounds of sign(x) ln(1 + |x|). A quaternion
is three bytes of ±1/√2 and, as 252 + index in w x y z, the largest component. Version 2 looks scales, colours and
harmonics up in tables of 256 values; version 1 takes them between bounds, and opacity as a logit. Higher harmonics are
those of a palette of 64 entries a row, to which a 16-bit label of each splat refers.
"""

from __future__ import annotations

import io
import json
import zipfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import FileError, make_damaged_error
from ..ply import make_unreadable_error
from .gaussians import Floats, RawSplats, SplatSource, UpAxis, complete_rotations
from .io_ply import sigmoid

Pixels = NDArray[np.uint8]
ImageDecoder = Callable[[bytes, str], Pixels]
"""Takes a picture's bytes and the file it is of, returns pixels (H, W, 4) from the top; ValueError if damaged."""
MAX_META_BYTES = 16 * 2**20
MAX_IMAGE_BYTES = 2**30
PICTURES = {"means": 2, "scales": 1, "quats": 1, "sh0": 1}
"""Entry of meta.json → number of its pictures."""
PALETTE_ROW = 64
COEFFICIENT_COUNTS = (3, 8, 15)
"""Number of harmonics above degree 0, of degree 1 … 3."""
FIRST_TAG = 252
TABLE_SIZE = 256
ZIP_ERRORS = (zipfile.BadZipFile, zlib.error, KeyError, EOFError, NotImplementedError, RuntimeError, ValueError)
"""Errors of the standard library for a damaged or encrypted archive."""


@dataclass(frozen=True)
class _Bundle:
    """A meta.json whose entries were checked, with the place of its pictures."""

    path: Path
    meta: dict[str, Any]
    folder: PurePosixPath | None

    @property
    def count(self) -> int:
        return int(self.meta["count"] if "count" in self.meta else self.meta["means"]["shape"][0])

    def read_picture(self, name: str, decode: ImageDecoder) -> Pixels:
        """Return the pixels (H, W, 4) of a picture."""
        try:
            return decode(self._read(name), str(self.path))
        except ValueError as error:
            raise make_damaged_error(self.path, f"its picture '{name}' cannot be read") from error

    def _read(self, name: str) -> bytes:
        if self.folder is None:
            file = self.path.parent / name
            if not file.is_file():
                raise FileError(
                    f"its picture '{name}' is missing.", where=str(self.path), remedy="Put it next to meta.json."
                )
            return file.read_bytes()
        with zipfile.ZipFile(self.path) as archive:
            return _read_member(archive, str(self.folder / name), MAX_IMAGE_BYTES)


def _read_member(archive: zipfile.ZipFile, name: str, limit: int) -> bytes:
    with archive.open(name) as stream:
        data = stream.read(limit + 1)
    if len(data) > limit:
        raise ValueError("a member of an archive is too long")
    return data


def open_sog(path: Path, decode_image: ImageDecoder | None = None) -> SplatSource:
    """Open a SOG archive or its meta.json; raise FileError if its entries show that it cannot be read.

    Parameters
    ----------
    path : Path
        The archive, or meta.json beside its pictures.
    decode_image : callable, optional
        Decodes the pictures at once, so that the source can be read in another thread; by default Pillow does, when the
        splats are read.

    Returns
    -------
    SplatSource
        The opened file.
    """
    bundle = _open_bundle(path)
    pictures = _read_pictures(bundle, decode_image) if decode_image is not None else None
    up = UpAxis("-y", "SOG keeps the frame of training, COLMAP's, with +y down")
    return SplatSource(bundle.count, up, lambda block: _iter_sog(bundle, pictures, block))


def _open_bundle(path: Path) -> _Bundle:
    try:
        with path.open("rb") as stream:
            is_archive = stream.read(2) == b"PK"
        if is_archive:
            with zipfile.ZipFile(path) as archive:
                names = [name for name in archive.namelist() if PurePosixPath(name).name == "meta.json"]
                if not names:
                    raise FileError(
                        "is a zip archive without meta.json, so no SOG.", where=str(path), remedy="Export it again."
                    )
                name = min(names, key=len)
                text = _read_member(archive, name, MAX_META_BYTES)
                folder: PurePosixPath | None = PurePosixPath(name).parent
        else:
            with path.open("rb") as stream:
                text, folder = stream.read(MAX_META_BYTES), None
        meta = json.loads(text)
    except OSError as error:
        raise make_unreadable_error(path, error) from error
    except (*ZIP_ERRORS, RecursionError) as error:
        raise make_damaged_error(path, "its archive or its meta.json cannot be read") from error
    _check_meta(path, meta)
    return _Bundle(path, meta, folder)


def _check_meta(path: Path, meta: Any) -> None:
    """Raise FileError unless meta.json has all entries, of the right types."""
    version = meta.get("version", 1) if isinstance(meta, dict) else None
    if version not in (1, 2):
        raise FileError(
            f"is SOG of version {str(version)[:20]}; versions 1 and 2 are read.",
            where=str(path),
            remedy="Convert it to .ply with SuperSplat or splat-transform.",
        )
    counts = dict(PICTURES, **({"shN": 2} if meta.get("shN") is not None else {}))
    for name, pictures in counts.items():
        entry = meta.get(name)
        files = entry.get("files") if isinstance(entry, dict) else None
        if not isinstance(files, list) or len(files) != pictures or not all(_is_file_name(each) for each in files):
            raise make_damaged_error(path, f"its meta.json names no {pictures} pictures of '{name}'")
    shape = meta["means"].get("shape")
    count = meta.get("count", shape[0] if isinstance(shape, list) and shape else None)
    if not isinstance(count, int) or isinstance(count, bool) or count < 1:
        raise make_damaged_error(path, "its meta.json says no number of splats")
    bounded = {"means": 3} if version == 2 else {"means": 3, "scales": 3, "sh0": 4}
    for name, length in bounded.items():
        if not all(_is_table(meta[name].get(key), length, length) for key in ("mins", "maxs")):
            raise make_damaged_error(path, f"its meta.json has no bounds of '{name}'")
    for name in [each for each in ("scales", "sh0", "shN") if version == 2 and each in counts]:
        if not _is_table(meta[name].get("codebook"), 1, TABLE_SIZE):
            raise make_damaged_error(path, f"its meta.json has no table of '{name}'")
    if version == 1 and "shN" in counts and not all(_is_number(meta["shN"].get(key)) for key in ("mins", "maxs")):
        raise make_damaged_error(path, "its meta.json has no bounds of 'shN'")


def _is_file_name(name: Any) -> bool:
    """Return True for a name inside the folder of meta.json."""
    if not isinstance(name, str) or not name or ":" in name or "\\" in name:
        return False
    return not PurePosixPath(name).is_absolute() and ".." not in PurePosixPath(name).parts


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e30


def _is_table(values: Any, least: int, most: int) -> bool:
    return isinstance(values, list) and least <= len(values) <= most and all(map(_is_number, values))


def decode_with_pillow(data: bytes, where: str) -> Pixels:
    """Decode a picture to pixels (H, W, 4); raise FileError without Pillow, ValueError for a damaged one."""
    try:
        import PIL.Image
    except ImportError as error:
        raise FileError(
            "its pictures are WebP, which needs Blender or Pillow.",
            where=where,
            remedy="Open it in Blender, install Pillow, or convert it to .ply with SuperSplat or splat-transform.",
        ) from error
    try:
        with PIL.Image.open(io.BytesIO(data)) as image:
            return np.asarray(image.convert("RGBA"))
    except (OSError, SyntaxError, MemoryError, PIL.Image.DecompressionBombError) as error:
        raise ValueError(str(error)) from error


def _read_pictures(bundle: _Bundle, decode: ImageDecoder) -> dict[str, Pixels]:
    """Return all pictures: rows (N, 4) of the splats, and the palette (H, W, 4) as it is."""
    pictures = {}
    try:
        for entry in (*PICTURES, *(["shN"] if bundle.meta.get("shN") is not None else [])):
            for number, name in enumerate(bundle.meta[entry]["files"]):
                pixels = bundle.read_picture(name, decode)
                is_palette = entry == "shN" and number == 0
                pictures[f"{entry}{number}"] = pixels if is_palette else pixels.reshape(-1, 4)[: bundle.count]
                if not is_palette and len(pictures[f"{entry}{number}"]) < bundle.count:
                    raise make_damaged_error(
                        bundle.path, f"its picture '{name}' has {pixels.size // 4} pixels for {bundle.count} splats"
                    )
    except OSError as error:
        raise make_unreadable_error(bundle.path, error) from error
    except ZIP_ERRORS as error:
        raise make_damaged_error(bundle.path, "its archive cannot be unpacked") from error
    return pictures


def _iter_sog(bundle: _Bundle, pictures: dict[str, Pixels] | None, block: int) -> Iterator[RawSplats]:
    """Yield splats; the decoded pictures, 20 to 24 bytes a splat, stay in memory."""
    pictures = _read_pictures(bundle, decode_with_pillow) if pictures is None else pictures
    palette = _read_palette(bundle, pictures)
    for first in range(0, bundle.count, block):
        part = {name: pixels[first : first + block] for name, pixels in pictures.items() if name != "shN0"}
        harmonics = _look_up(bundle, "sh0", part["sh00"])[:, None, :3]
        if palette is not None:
            labels = part["shN1"][:, 0].astype(np.intp) | part["shN1"][:, 1].astype(np.intp) << 8
            harmonics = np.concatenate([harmonics, palette[np.minimum(labels, len(palette) - 1)]], axis=1)
        opacities = part["sh00"][:, 3] / 255.0
        if bundle.meta.get("version", 1) == 1:
            opacities = sigmoid(_look_up(bundle, "sh0", part["sh00"])[:, 3])
        yield RawSplats(
            means=_unpack_centres(bundle, part["means0"], part["means1"]),
            log_scales=_look_up(bundle, "scales", part["scales0"])[:, :3],
            rotations=_unpack_rotations(part["quats0"]),
            opacities=opacities,
            harmonics=harmonics,
        )


def _look_up(bundle: _Bundle, name: str, pixels: Pixels) -> Floats:
    """Return the values of bytes (…, 4): from a table (the fourth as NaN where it has none), or between bounds."""
    entry = bundle.meta[name]
    if bundle.meta.get("version", 1) == 2:
        table = np.full(TABLE_SIZE, np.nan)
        table[: len(entry["codebook"])] = entry["codebook"]
        return np.asarray(table[pixels])
    low, high = (np.resize(np.asarray(entry[key], dtype=np.float64), 4) for key in ("mins", "maxs"))
    return np.asarray(low + (high - low) * (pixels / 255.0))


def _read_palette(bundle: _Bundle, pictures: dict[str, Pixels]) -> Floats | None:
    """Return the palette (P + 1, K − 1, 3) of higher harmonics; its last entry, for a label beyond it, is NaN."""
    if "shN0" not in pictures:
        return None
    height, width, _ = pictures["shN0"].shape
    harmonics, rest = divmod(width, PALETTE_ROW)
    if rest or harmonics not in COEFFICIENT_COUNTS:
        raise make_damaged_error(bundle.path, f"its palette of harmonics is {width} pixels wide, not 192, 512 or 960")
    values = _look_up(bundle, "shN", pictures["shN0"])[..., :3].reshape(height * PALETTE_ROW, harmonics, 3)
    return np.asarray(np.concatenate([values, np.full((1, harmonics, 3), np.nan)]))


def _unpack_centres(bundle: _Bundle, low: Pixels, high: Pixels) -> Floats:
    fractions = (low[:, :3] + 256.0 * high[:, :3]) / 65535.0
    least, most = (np.asarray(bundle.meta["means"][key], dtype=np.float64) for key in ("mins", "maxs"))
    logs = least + (most - least) * fractions
    with np.errstate(over="ignore"):
        return np.asarray(np.sign(logs) * np.expm1(np.abs(logs)))


def _unpack_rotations(pixels: Pixels) -> Floats:
    """Unpack quaternions (N, 4) w x y z; NaN where no component is named as the largest."""
    largest = pixels[:, 3].astype(np.intp) - FIRST_TAG
    rotations = complete_rotations((pixels[:, :3] / 127.5 - 1.0) * np.sqrt(0.5), np.maximum(largest, 0))
    rotations[largest < 0] = np.nan
    return rotations
