"""Pairs of one look and one touch of the same place, and what every set of them can be asked."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Literal, Protocol, overload

import numpy as np
from numpy.typing import NDArray

from ..errors import FileError, UsageError

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
