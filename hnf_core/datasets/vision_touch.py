"""Pairs of one look and one touch of the same place, and what every set of them can be asked.

Photographs, touch images and depth arrays of unknown origin → arrays, nothing in them trusted.

Pillow decodes; it comes with matplotlib, and is asked for only when a picture is read.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tokenize import TokenError
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal, Protocol, overload

import numpy as np
from numpy.typing import NDArray

from ..errors import FileError, UsageError
from ..units import srgb_to_linear

if TYPE_CHECKING:
    from PIL.Image import Image

ImageArray = NDArray[np.float32]
SensorName = Literal["gelsight", "digit"]
SPLIT_SHARES: Mapping[str, float] = MappingProxyType({"train": 0.8, "val": 0.1, "test": 0.1})


@dataclass(frozen=True, eq=False)
class VisionTouchPair:
    """What a camera and a touch sensor saw of one place.

    rgb: (H, W, 3) linear, 0 to 1. depth_m: (H, W) of the same pixels, None where it was not recorded.
    touch: (h, w, 3), 0 to 1, the sensor's values as they are (photographs.read_touch). background: the sensor
    untouched, as touch; None where it was not recorded.
    sensor: whose optics the touch has. label: the material in the data set's own word, None where it has none.
    where: scene, recording or texture. Pairs of one where look alike: a split keeps them together.
    metres_per_pixel: of rgb, None where it is unknown.
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
        for name, picture, depth in (("rgb", self.rgb, 3), ("touch", self.touch, 3), ("background", self.background, 3),
                                     ("depth_m", self.depth_m, None)):  # fmt: skip
            if picture is not None and (
                picture.dtype != np.float32 or picture.shape[2:] != ((depth,) if depth else ())
            ):
                raise UsageError(f"{name} is {picture.dtype} {picture.shape}.", where=self.where, remedy="See above.")
        if self.depth_m is not None and self.depth_m.shape != self.rgb.shape[:2]:
            raise UsageError("depth and picture have different pixels.", where=self.where, remedy="Resample one.")
        if self.background is not None and self.background.shape != self.touch.shape:
            raise UsageError("touch and background have different pixels.", where=self.where, remedy="Resample one.")


class VisionTouchPairs(Protocol):
    """A lazy sequence: everything but an item is known without opening a picture."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> VisionTouchPair:
        """Decodes one pair. Raises FileError where a file of it cannot be used."""
        ...

    @property
    def labels(self) -> tuple[str | None, ...]: ...

    @property
    def locations(self) -> tuple[str, ...]:
        """`where` of each pair."""
        ...

    @property
    def notes(self) -> tuple[str, ...]:
        """What was assumed and what was left out, with counts."""
        ...


@dataclass(frozen=True)
class PairFiles:
    """Where the parts of one pair lie; the meaning is VisionTouchPair's."""

    rgb: Path
    touch: Path
    where: str
    label: str | None = None
    depth: Path | None = None
    background: Path | None = None


@dataclass(frozen=True)
class FilePairs(Sequence[VisionTouchPair]):
    """Pairs in files, each read when it is asked for and not kept. read: the data set's own way from files to pair."""

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
        return tuple(entry.label for entry in self.entries)

    @property
    def locations(self) -> tuple[str, ...]:
        return tuple(entry.where for entry in self.entries)


def split_by_location(pairs: FilePairs, seed: int, shares: Mapping[str, float] = SPLIT_SHARES) -> dict[str, FilePairs]:
    """Whole places (recordings, scenes, textures) dealt to named splits, so that no place is in two of them.

    Places come in an order drawn from their names and the seed; each goes to the split that lacks most of its share of
    the pairs. Where there are few places, a small split may stay empty. Raises UsageError for shares that are not
    positive.
    """
    if not shares or min(shares.values()) <= 0.0:
        raise UsageError(f"shares {dict(shares)} are not all above 0.", remedy="Leave out a split that is not wanted.")
    size = Counter(pairs.locations)
    whole = sum(shares.values())
    missing = {name: share / whole * len(pairs) for name, share in shares.items()}
    home = {}
    for place in sorted(size, key=lambda place: hashlib.sha256(f"{seed}\0{place}".encode()).digest()):
        home[place] = max(missing, key=lambda name: missing[name])
        missing[home[place]] -= size[place]
    return {
        name: FilePairs(tuple(entry for entry in pairs.entries if home[entry.where] == name), pairs.read, pairs.notes)
        for name in shares
    }


def get_split(pairs: FilePairs, name: str, seed: int, where: str) -> FilePairs:
    """One split of split_by_place with SHARES. Raises UsageError for a name that is none, FileError where there are too
    few places for it. where: the folder, for the message."""
    if name not in SPLIT_SHARES:
        raise UsageError(f"{name!r} is no split.", remedy=f"There are {', '.join(SPLIT_SHARES)}.")
    part = split_by_location(pairs, seed)[name]
    if not part:
        raise FileError(
            f"{len(set(pairs.locations))} places are too few for a split {name!r}.",
            where=where,
            remedy="Get more of them, or split them yourself with split_by_place.",
        )
    return part


def iterate_readable(pairs: VisionTouchPairs, skipped: list[FileError]) -> Iterator[VisionTouchPair]:
    """The pairs whose files can be used, in order; the errors of the others are appended to skipped.

    One damaged picture among thousands must not end a training, nor go unnoticed.
    """
    for index in range(len(pairs)):
        try:
            pair = pairs[index]
        except FileError as error:
            skipped.append(error)
            continue
        yield pair


def format_left_out(left_out: Counter[str]) -> tuple[str, ...]:
    """Reasons with their counts as notes, the most frequent first: "3 left out: no touch image"."""
    return tuple(f"{count} left out: {reason}" for reason, count in left_out.most_common() if count)


Float32 = NDArray[np.float32]

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp")
IMAGE_FORMATS = ("JPEG", "PNG", "BMP")
IMAGE_MODES = ("1", "L", "LA", "P", "RGB", "RGBA", "CMYK", "YCbCr")
"""Pillow's names of what has 8 bits a channel; it would clip deeper ones without a word."""
MAX_PIXELS = 50_000_000
MIN_SIDE = 16
MAX_ARRAY_BYTES = 256 * 2**20
_IMAGE_REMEDY = "Get the file again from the data set, or leave it out."


def read_photograph(path: Path) -> Float32:
    """(H, W, 3) linear, 0 to 1, of a photograph: a JPEG, PNG or BMP of 8 bits a channel in sRGB (IEC 61966-2-1).

    Grey becomes three equal channels, transparency is dropped. Raises FileError where it is no such picture, is cut
    off, has more than MOST_PIXELS or a side below SMALLEST_SIDE, or Pillow is missing.
    """
    return np.asarray(_SRGB_TO_LINEAR[_read_code_values(path)])


def read_touch_image(path: Path) -> Float32:
    """(H, W, 3) code values / 255 of a touch sensor's picture, in the files that read_picture takes.

    Measured on a real GelSight (docs/optics.md), code values as they are come nearer to linear in the membrane's normal
    than decoded ones do. Raises FileError as read_picture.
    """
    return np.asarray(_read_code_values(path) / np.float32(255.0))


def _read_code_values(path: Path) -> NDArray[np.uint8]:
    try:
        import PIL.Image
    except ImportError as error:
        raise FileError(f"pictures need Pillow ({error}).", where=str(path), remedy="Install it.") from error
    try:
        with PIL.Image.open(path, formats=IMAGE_FORMATS) as picture:
            _check_mode(picture, path)
            return np.asarray(picture.convert("RGB"), dtype=np.uint8)
    # A damaged file makes Pillow raise nearly anything: SyntaxError, struct.error, OverflowError, …
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
    """The array of a .npy file, in memory. Pickled objects are refused, and so is a header that promises more than the
    file holds. Raises FileError."""
    try:
        mapped = np.load(path, mmap_mode="r", allow_pickle=False)
        if not isinstance(mapped, np.ndarray):
            mapped.close()
            raise ValueError("several arrays")
        if mapped.nbytes > MAX_ARRAY_BYTES:
            raise ValueError(f"{mapped.nbytes / 2**20:.0f} MB are too much")
        return np.array(mapped)
    # numpy reads the header as Python's own literals, and lets its parser's errors through.
    except (OSError, ValueError, TypeError, EOFError, ArithmeticError, LookupError, MemoryError, RecursionError,
            SyntaxError, TokenError) as error:  # fmt: skip
        raise FileError(f"is no array of numbers ({error}).", where=str(path), remedy=_IMAGE_REMEDY) from error


def read_depth(path: Path, max_m: float) -> Float32:
    """(H, W) metres of a .npy file of (H, W) or (H, W, 1), clipped to [0, most_m].

    Raises FileError where it has another shape or type, or not-a-number.
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
    """The largest centred square of (H, W[, C])."""
    side = min(values.shape[:2])
    row, column = (values.shape[0] - side) // 2, (values.shape[1] - side) // 2
    return values[row : row + side, column : column + side]


def resize_by_area(values: Float32, side: int) -> Float32:
    """(H, W[, C]) → (side, side[, C]), each pixel the mean of the area it covers (larger: of its nearest ones).

    Means of linear light, so brightness stays what it was. Raises FileError where Pillow is missing.
    """
    if values.shape[:2] == (side, side):
        return values
    try:
        import PIL.Image
    except ImportError as error:
        raise FileError(f"resizing needs Pillow ({error}).", remedy="Install it.") from error
    box = PIL.Image.Resampling.BOX

    def one(channel: Float32) -> Float32:
        return np.asarray(PIL.Image.fromarray(np.ascontiguousarray(channel)).resize((side, side), box))

    if values.ndim == 2:
        return one(values)
    return np.stack([one(values[..., each]) for each in range(values.shape[2])], axis=-1)


_SRGB_TO_LINEAR = srgb_to_linear(np.arange(256) / 255.0).astype(np.float32)
