"""Pairs of photograph and touch image of the same location: their interface, splits, and reading of image files.

Files are untrusted: nothing in them is executed or assumed valid. Pillow, which comes with matplotlib, decodes images
and is imported only when one is read.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal, overload

import numpy as np
from numpy.typing import NDArray

from ..errors import FileError, UsageError
from ..files import NPZ_ERRORS
from ..units import srgb_to_linear

if TYPE_CHECKING:
    from PIL.Image import Image

ImageArray = NDArray[np.float32]
SensorName = Literal["gelsight", "digit"]
SPLIT_SHARES: Mapping[str, float] = MappingProxyType({"train": 0.8, "val": 0.1, "test": 0.1})
"""Fractions of the splits."""


@dataclass(frozen=True, eq=False)
class VisionTouchPair:
    """Images of a camera and a touch sensor of one location.

    Attributes
    ----------
    rgb : ndarray of float32, shape (H, W, 3)
        Linear colour, 0 to 1.
    depth_m : ndarray of float32, shape (H, W), or None
        Depth of the same pixels [m]; None if not recorded.
    touch : ndarray of float32, shape (h, w, 3)
        Touch image, the sensor's values as they are, 0 to 1 (`read_touch_image`).
    background : ndarray of float32, shape (h, w, 3), or None
        Image of the untouched sensor; None if not recorded.
    sensor : {"gelsight", "digit"}
        Sensor of the touch image.
    label : str or None
        Material in the data set's own words.
    where : str
        Scene, recording or texture; a split keeps pairs of the same one together, since they look alike.
    metres_per_pixel : float or None
        Scale of `rgb` [m per pixel]; None if unknown.
    """

    rgb: ImageArray
    depth_m: ImageArray | None
    touch: ImageArray
    background: ImageArray | None
    sensor: SensorName
    label: str | None
    where: str
    metres_per_pixel: float | None

    def __post_init__(self) -> None:
        for name, image, channels in (
            ("rgb", self.rgb, 3),
            ("touch", self.touch, 3),
            ("background", self.background, 3),
            ("depth_m", self.depth_m, None),
        ):
            if image is not None and (
                image.dtype != np.float32 or image.shape[2:] != ((channels,) if channels else ())
            ):
                raise UsageError(f"{name} is {image.dtype} {image.shape}.", where=self.where, remedy="See above.")
        if self.depth_m is not None and self.depth_m.shape != self.rgb.shape[:2]:
            raise UsageError("depth and picture have different pixels.", where=self.where, remedy="Resample one.")
        if self.background is not None and self.background.shape != self.touch.shape:
            raise UsageError("touch and background have different pixels.", where=self.where, remedy="Resample one.")


@dataclass(frozen=True)
class PairFiles:
    """Paths of the files of one photograph and touch pair; fields as in `VisionTouchPair`."""

    rgb: Path
    touch: Path
    where: str
    label: str | None = None
    depth: Path | None = None
    background: Path | None = None


@dataclass(frozen=True)
class FilePairs(Sequence[VisionTouchPair]):
    """Photograph and touch pairs in files, each read when accessed and not cached; `read` converts files to a pair."""

    entries: tuple[PairFiles, ...]
    read: Callable[[PairFiles], VisionTouchPair]
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.entries)

    @overload
    def __getitem__(self, index: int, /) -> VisionTouchPair: ...
    @overload
    def __getitem__(self, index: slice, /) -> FilePairs: ...
    def __getitem__(self, index: int | slice, /) -> VisionTouchPair | FilePairs:
        if isinstance(index, slice):
            return FilePairs(self.entries[index], self.read, self.notes)
        return self.read(self.entries[index])

    @property
    def labels(self) -> tuple[str | None, ...]:
        """Material label of each pair, None if unknown."""
        return tuple(entry.label for entry in self.entries)

    @property
    def locations(self) -> tuple[str, ...]:
        """Location (scene, recording or texture) of each pair, its `where`."""
        return tuple(entry.where for entry in self.entries)


def split_by_location(pairs: FilePairs, seed: int, shares: Mapping[str, float] = SPLIT_SHARES) -> dict[str, FilePairs]:
    """Split pairs by location (recording, scene, texture), so that no location is in two splits.

    Parameters
    ----------
    pairs : FilePairs
        The pairs.
    seed : int
        Seed of the order in which locations are assigned.
    shares : mapping of str to float
        Fraction of the pairs for each split, by its name.

    Returns
    -------
    dict of str to FilePairs
        The splits; a small one may be empty if there are few locations.

    Raises
    ------
    UsageError
        For fractions that are not positive.

    Notes
    -----
    Locations come in an order derived from their names and the seed; each is assigned to the split that lacks the most
    pairs.
    """
    if not shares or min(shares.values()) <= 0.0:
        raise UsageError(f"shares {dict(shares)} are not all above 0.", remedy="Leave out a split that is not wanted.")
    size = Counter(pairs.locations)
    total = sum(shares.values())
    deficit = {name: fraction / total * len(pairs) for name, fraction in shares.items()}
    split_of = {}
    for location in sorted(size, key=lambda location: hashlib.sha256(f"{seed}\0{location}".encode()).digest()):
        split_of[location] = max(deficit, key=lambda name: deficit[name])
        deficit[split_of[location]] -= size[location]
    return {
        name: FilePairs(
            tuple(entry for entry in pairs.entries if split_of[entry.where] == name), pairs.read, pairs.notes
        )
        for name in shares
    }


def get_split(pairs: FilePairs, name: str, seed: int, where: str) -> FilePairs:
    """Return one split (train, val or test) of pairs, with no location in two splits (`split_by_location`).

    `where` names the folder in messages. Raises UsageError for an unknown split, FileError if there are too few
    locations.
    """
    if name not in SPLIT_SHARES:
        raise UsageError(f"{name!r} is no split.", remedy=f"There are {', '.join(SPLIT_SHARES)}.")
    split = split_by_location(pairs, seed)[name]
    if not split:
        raise FileError(
            f"{len(set(pairs.locations))} places are too few for a split {name!r}.",
            where=where,
            remedy="Get more of them, or split them yourself with split_by_place.",
        )
    return split


def format_left_out(left_out: Counter[str]) -> tuple[str, ...]:
    """Format reasons why pairs were left out, with counts, the most frequent first: "3 left out: no touch image"."""
    return tuple(f"{count} left out: {reason}" for reason, count in left_out.most_common() if count)


Float32 = NDArray[np.float32]

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp")
IMAGE_FORMATS = ("JPEG", "PNG", "BMP")
IMAGE_MODES = ("1", "L", "LA", "P", "RGB", "RGBA", "CMYK", "YCbCr")
"""Pillow's modes with 8 bits a channel; it would clip deeper ones silently."""
MAX_PIXELS = 50_000_000
"""Largest accepted number of pixels of an image."""
MIN_SIDE = 16
"""Least side of an image [pixels]."""
MAX_ARRAY_BYTES = 256 * 2**20
"""Largest accepted array [bytes]."""
_IMAGE_REMEDY = "Get the file again from the data set, or leave it out."


def read_photograph(path: Path) -> Float32:
    """Read a photograph as linear colour (H, W, 3), 0 to 1: JPEG, PNG or BMP, 8 bits a channel in sRGB.

    Grey becomes three equal channels, transparency is dropped. Raises FileError if it is no such image, cut short,
    larger than `MAX_PIXELS` or smaller than `MIN_SIDE`, or if Pillow is missing.
    """
    return np.asarray(_SRGB_TO_LINEAR[_read_code_values(path)])


def read_touch_image(path: Path) -> Float32:
    """Read a touch sensor's image as code values / 255 (H, W, 3), not linearised, from JPEG, PNG or BMP.

    Measured on a real GelSight (docs/optics.md), code values are closer to linear in the membrane's normal than decoded
    ones. Raises FileError as `read_photograph`.
    """
    return np.asarray(_read_code_values(path) / np.float32(255.0))


def _read_code_values(path: Path) -> NDArray[np.uint8]:
    try:
        import PIL.Image
    except ImportError as error:
        raise FileError(f"pictures need Pillow ({error}).", where=str(path), remedy="Install it.") from error
    try:
        with PIL.Image.open(path, formats=IMAGE_FORMATS) as image:
            _check_mode(image, path)
            return np.asarray(image.convert("RGB"), dtype=np.uint8)
    # A damaged file can make Pillow raise nearly anything: SyntaxError, struct.error, OverflowError, …
    except (OSError, ValueError, SyntaxError, EOFError, ArithmeticError, LookupError, TypeError, AttributeError,
            MemoryError, PIL.Image.DecompressionBombError) as error:  # fmt: skip
        raise FileError(f"cannot be read as a picture ({error}).", where=str(path), remedy=_IMAGE_REMEDY) from error


def _check_mode(image: Image, path: Path) -> None:
    if image.mode not in IMAGE_MODES:
        raise FileError(f"is of the kind {image.mode}, not of 8 bits.", where=str(path), remedy="Convert it to PNG.")
    width, height = image.size
    if width * height > MAX_PIXELS or min(width, height) < MIN_SIDE:
        raise FileError(f"has {width} × {height} pixels.", where=str(path), remedy=_IMAGE_REMEDY)


def read_array(path: Path) -> NDArray[np.generic]:
    """Read the array of a .npy file into memory.

    Pickled objects, and headers that promise more than the file holds, raise FileError.
    """
    try:
        mapped = np.load(path, mmap_mode="r", allow_pickle=False)
        if not isinstance(mapped, np.ndarray):
            mapped.close()
            raise ValueError("several arrays")
        if mapped.nbytes > MAX_ARRAY_BYTES:
            raise ValueError(f"{mapped.nbytes / 2**20:.0f} MB are too much")
        return np.array(mapped)
    except NPZ_ERRORS as error:
        raise FileError(f"is no array of numbers ({error}).", where=str(path), remedy=_IMAGE_REMEDY) from error


def read_depth(path: Path, max_m: float) -> Float32:
    """Read depth (H, W) [m] from a .npy file of (H, W) or (H, W, 1), clipped to [0, max_m].

    Raises FileError for another shape or type, or NaN.
    """
    values = read_array(path)
    if values.ndim == 3 and values.shape[2] == 1:
        values = values[:, :, 0]
    if values.ndim != 2 or min(values.shape) < MIN_SIDE or values.dtype.kind not in "fiu":
        raise FileError(f"holds {values.dtype} {values.shape}, no depth image.", where=str(path), remedy=_IMAGE_REMEDY)
    depth = values.astype(np.float64)
    if np.isnan(depth).any():
        raise FileError("has pixels that are not a number.", where=str(path), remedy=_IMAGE_REMEDY)
    return np.asarray(np.clip(depth, 0.0, max_m), dtype=np.float32)


def crop_centre_square(values: Float32) -> Float32:
    """Return the largest centred square of an image (H, W[, C])."""
    side = min(values.shape[:2])
    row, column = (values.shape[0] - side) // 2, (values.shape[1] - side) // 2
    return values[row : row + side, column : column + side]


def resize_by_area(values: Float32, side: int) -> Float32:
    """Resize (H, W[, C]) to (side, side[, C]); each pixel is the mean of the area it covers (enlarged: the nearest).

    Means of linear light preserve brightness. Raises FileError if Pillow is missing.
    """
    if values.shape[:2] == (side, side):
        return values
    try:
        import PIL.Image
    except ImportError as error:
        raise FileError(f"resizing needs Pillow ({error}).", remedy="Install it.") from error
    box = PIL.Image.Resampling.BOX

    def resize(channel: Float32) -> Float32:
        return np.asarray(PIL.Image.fromarray(np.ascontiguousarray(channel)).resize((side, side), box))

    if values.ndim == 2:
        return resize(values)
    return np.stack([resize(values[..., channel_index]) for channel_index in range(values.shape[2])], axis=-1)


_SRGB_TO_LINEAR = srgb_to_linear(np.arange(256) / 255.0).astype(np.float32)
