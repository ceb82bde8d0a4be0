"""Splat files → Gaussians, whole or a block at a time; a damaged file is refused, a few unusable splats are dropped."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ...errors import FileError
from ..ply_header import PlyHeader, read_ply_header
from ..ply_rows import count_complete_rows, make_truncated_error
from .box import Box
from .cloud import Single, Splats
from .compressed import check_compressed, iter_compressed
from .inria import check_inria, iter_inria
from .usable import RawSplats, ValidatedSplats, validate_splats

UNSUPPORTED_SUFFIXES = (".spz", ".splat", ".ksplat", ".sog")
# 32,768 splats of degree 3 are 8 MB in the file.
ROWS_PER_BLOCK = 1 << 15
# Training leaves a few broken splats; where more than these are, the file is what is broken.
MAX_DROPPED_SHARE = 0.1


def read_splats(path: Path, *, within: Box | None = None) -> Splats:
    """The usable Gaussians of a file in their order; within: only those whose centre it holds. Raises as read_whole."""
    return read_validated_splats(path, within=within).splats


def read_validated_splats(path: Path, *, within: Box | None = None) -> ValidatedSplats:
    """read_splats with what was dropped; total and dropped count the whole file, with or without a box.

    Raises FileError where the file is missing, cut short, damaged, of another kind, without splats, or where more than
    a tenth of its splats cannot be used.
    """
    path = Path(path)
    header = check_splat_file(path)
    # The count of an ascii file cannot be checked beforehand, so it gets no room.
    kept = _SplatAccumulator(header.count("vertex") if within is None and header.format != "ascii" else None)
    total, thickened = 0, 0
    dropped: Counter[str] = Counter()
    for reading in _iter_blocks(path, header, ROWS_PER_BLOCK):
        splats = reading.splats
        kept.add(splats if within is None else splats.take(within.contains(splats.means)))
        total, thickened = total + reading.total, thickened + reading.thickened
        dropped.update(reading.dropped)
    return ValidatedSplats(kept.to_splats(), total, dict(dropped), thickened)


def iter_validated_splats(path: Path, chunk: int = ROWS_PER_BLOCK) -> Iterator[ValidatedSplats]:
    """One Reading for each chunk of rows; memory follows chunk, not the file.

    Raises FileError as read_whole does: at the call for whatever the head and the length of the file tell, and while
    reading for what only the numbers tell (at the end, for too many unusable splats; an ascii file's end).
    """
    path = Path(path)
    return _iter_blocks(path, check_splat_file(path), chunk)


def check_splat_file(path: Path) -> PlyHeader:
    """The header of a file whose splats can be read. Raises FileError where its kind, header or length forbid it."""
    path = Path(path)
    if path.suffix.lower() in UNSUPPORTED_SUFFIXES:
        raise FileError(
            f"splats of kind '{path.suffix.lower()}' are not read.",
            where=str(path),
            remedy="Convert it to .ply with SuperSplat or splat-transform.",
        )
    header = read_ply_header(path)
    if not header.is_splat:
        raise FileError(
            "holds no Gaussian splats.", where=str(path), remedy="Give a .ply in INRIA's or PlayCanvas's layout."
        )
    count = header.count("vertex")
    if count == 0:
        raise FileError("holds no splats: it is empty.", where=str(path), remedy="Export it again.")
    (check_compressed if header.is_compressed else check_inria)(path, header)
    there = min(count_complete_rows(path, header, name) for name in ("vertex", "sh") if header.count(name))
    if there < count:
        raise make_truncated_error(path, "vertex", there, count)
    return header


def _iter_blocks(path: Path, header: PlyHeader, chunk: int) -> Iterator[ValidatedSplats]:
    blocks: Iterator[RawSplats] = (iter_compressed if header.is_compressed else iter_inria)(path, header, chunk)
    dropped = 0
    for raw in blocks:
        reading = validate_splats(raw)
        dropped += sum(reading.dropped.values())
        yield reading
    count = header.count("vertex")
    if dropped > MAX_DROPPED_SHARE * count:
        raise FileError(
            f"is damaged: {dropped} of its {count} splats cannot be used.",
            where=str(path),
            remedy="Export or download it again.",
        )


class _SplatAccumulator:
    """Blocks put together. room: splats at most, where it is to be taken at once, so that nothing is held twice."""

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
