"""Read Gaussian splats of every supported layout: one table of formats, told by their bytes, and one validation.

The layouts themselves are in `io_ply.py`, `io_packed.py` (.splat, .spz, .ksplat), `io_sog.py` and `io_gltf.py`. Damaged
files raise FileError; a few unusable splats are dropped and counted.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from ...errors import FileError, make_damaged_error
from ..file_kind import identify, read_head
from .gaussians import Box, Single, Splats, SplatSource, ValidatedSplats, validate_splats
from .io_gltf import open_gltf
from .io_packed import open_ksplat, open_splat, open_spz
from .io_ply import make_no_splats_error, open_ply
from .io_sog import ImageDecoder, open_sog

OPENERS: dict[str, Callable[[Path], SplatSource]] = {
    ".ply": open_ply,
    ".splat": open_splat,
    ".spz": open_spz,
    ".ksplat": open_ksplat,
    ".sog": open_sog,
    ".glb": open_gltf,
    ".gltf": open_gltf,
}
"""Ending of a layout → what opens it."""
SPLAT_SUFFIXES = (".splat", ".spz", ".ksplat", ".sog")
"""Endings that hold splats alone."""
# 32,768 splats of degree 3 are 8 MB in the file.
ROWS_PER_BLOCK = 1 << 15
# Training leaves a few broken splats; with more than this fraction, the file is damaged.
MAX_DROPPED_SHARE = 0.1


def read_splats(path: Path, *, within: Box | None = None, source: SplatSource | None = None) -> Splats:
    """Read the usable Gaussians of a file in their order.

    Parameters
    ----------
    path : Path
        A splat file of any layout in `OPENERS`.
    within : Box or None
        Keep only splats whose centre lies in this box.
    source : SplatSource, optional
        The file if it was opened already.

    Returns
    -------
    Splats
        The splats.

    Raises
    ------
    FileError
        If the file is missing, cut short, damaged, of another kind, without splats, or more than a tenth of its splats
        cannot be used.
    """
    return read_validated_splats(path, within=within, source=source).splats


def read_validated_splats(
    path: Path, *, within: Box | None = None, source: SplatSource | None = None
) -> ValidatedSplats:
    """Read the usable Gaussians of a file, with the number of dropped ones.

    The counts are of the whole file, even if only splats inside the box `within` are kept. Raises FileError for a file
    that cannot be used, as `read_splats` does.
    """
    path = Path(path)
    source = open_splat_file(path) if source is None else source
    # Where a count cannot be checked beforehand, no memory is reserved for it.
    accumulator = _SplatAccumulator(source.count if within is None and source.is_complete else None)
    total, thickened = 0, 0
    dropped: Counter[str] = Counter()
    for block in iter_validated_splats(path, source, ROWS_PER_BLOCK):
        splats = block.splats
        accumulator.add(splats if within is None else splats.take(within.contains(splats.means)))
        total, thickened = total + block.total, thickened + block.thickened
        dropped.update(block.dropped)
    return ValidatedSplats(accumulator.to_splats(), total, dict(dropped), thickened)


def open_splat_file(path: Path, decode_image: ImageDecoder | None = None) -> SplatSource:
    """Open a splat file of any layout, told by its first bytes and, where those tell nothing, by its name.

    Parameters
    ----------
    path : Path
        The file.
    decode_image : callable, optional
        Decodes the pictures of a .sog, which is done at once; by default Pillow does, when they are read.

    Returns
    -------
    SplatSource
        The opened file.

    Raises
    ------
    FileError
        If its kind, header or length shows that it cannot be read.
    """
    path = Path(path)
    kind = identify(read_head(path))
    if kind is not None and not kind.suffix:
        raise FileError(f"is {kind.what}.", where=str(path), remedy=kind.remedy)
    suffix = kind.suffix if kind is not None else path.suffix.lower()
    if suffix == ".sog":
        return open_sog(path, decode_image)
    if suffix not in OPENERS:
        raise make_no_splats_error(path)
    return OPENERS[suffix](path)


def iter_validated_splats(path: Path, source: SplatSource, chunk: int) -> Iterator[ValidatedSplats]:
    """Read and validate splats in blocks.

    Parameters
    ----------
    path : Path
        The file.
    source : SplatSource
        The opened file, from `open_splat_file`.
    chunk : int
        Splats in one block.

    Yields
    ------
    ValidatedSplats
        The splats of one block.

    Raises
    ------
    FileError
        If a file whose header does not tell its length ends early, or (at the end) more than a tenth of the splats
        cannot be used.
    """
    dropped = 0
    for raw in source.iter_raw(chunk):
        validated = validate_splats(raw)
        dropped += sum(validated.dropped.values())
        yield validated
    if dropped > MAX_DROPPED_SHARE * source.count:
        raise make_damaged_error(path, f"{dropped} of its {source.count} splats cannot be used")


class _SplatAccumulator:
    """Splats concatenated block by block; arrays are preallocated if `capacity`, the number of splats, is given."""

    def __init__(self, capacity: int | None) -> None:
        self._capacity, self._count = capacity, 0
        self._fields: tuple[Single, ...] = ()
        self._blocks: list[tuple[Single, ...]] = []

    def add(self, splats: Splats) -> None:
        block = (splats.means, splats.scales, splats.rotations, splats.opacities, splats.harmonics)
        if self._capacity is None:
            self._blocks.append(block)
            return
        if not self._fields:
            self._fields = tuple(np.empty((self._capacity, *part.shape[1:]), dtype=np.float32) for part in block)
        for field, part in zip(self._fields, block, strict=True):
            field[self._count : self._count + len(part)] = part
        self._count += len(splats)

    def to_splats(self) -> Splats:
        if self._capacity is None:
            return Splats(*map(np.concatenate, zip(*self._blocks, strict=True)))
        return Splats(*(field[: self._count] for field in self._fields))
