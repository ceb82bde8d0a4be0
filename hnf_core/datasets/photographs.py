"""Photographs, touch images and depth arrays of unknown origin → arrays, nothing in them trusted.

Pillow decodes; it comes with matplotlib, and is asked for only when a picture is read.
"""

from __future__ import annotations

from pathlib import Path
from tokenize import TokenError
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..errors import FileError
from ..units import srgb_to_linear

if TYPE_CHECKING:
    from PIL.Image import Image

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
