"""Tactile-Augmented Radiance Fields: rendered views with depth, registered to touches of a DIGIT.

Y. Dou, F. Yang, Y. Liu, A. Loquercio & A. Owens (2024), "Tactile-augmented radiance fields", CVPR.
vision/<scene>_<scale>/<index>.jpg, depth/<scene>_<scale>/<index>.npy (H, W, 1) in metres, touch/<scene>_40_30/
<index>.jpg, touch_bg/<scene>_40_30/bg.jpg; split_interval.json = {"train": [["<scene>_40_30", "<index>"], …], "val": …,
"test": …}. All pictures of a pair are turned alike, so none is turned here.
"""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

from ..errors import FileError, UsageError
from .data_files import is_safe_name, list_file_names
from .vision_touch import (
    FilePairs,
    Float32,
    PairFiles,
    VisionTouchPair,
    crop_centre_square,
    format_left_out,
    read_depth,
    read_photograph,
    read_touch_image,
    resize_by_area,
)

SPLIT_FILE = "split_interval.json"
TOUCH_SCALE = "40_30"
MAX_DEPTH_M = 5.0
IMAGE_SIDE = 256
MAX_SPLIT_BYTES = 64 * 2**20
_REMEDY = "Get the split file again from the data set."


@dataclass(frozen=True)
class TarfFolder:
    """folder: the one with vision, touch and split_interval.json, or the one around it. scale: of the views, as their
    folders call it. side: pixels of every picture, a centred square as in the publication."""

    folder: Path
    scale: str = TOUCH_SCALE
    side: int = IMAGE_SIDE

    @cached_property
    def _root(self) -> Path:
        below = sorted(self.folder.iterdir()) if self.folder.is_dir() else []
        for place in (self.folder, *below):
            if (place / "vision").is_dir() and (place / "touch").is_dir():
                return place
        raise FileError(
            "the folders vision and touch are not in it.",
            where=str(self.folder),
            remedy="Give the folder that holds vision, depth, touch and touch_bg.",
        )

    @cached_property
    def _listed_splits(self) -> dict[str, list[tuple[str, str]]]:
        """Split → (scene, index), as the split file has them."""
        around = [self._root, self.folder, *sorted(each for each in self.folder.iterdir() if each.is_dir())]
        path = next((each / SPLIT_FILE for each in around if (each / SPLIT_FILE).is_file()), None)
        if path is None:
            raise FileError(f"{SPLIT_FILE} is not in it.", where=str(self.folder), remedy=_REMEDY)
        return read_split(path)

    @property
    def splits(self) -> tuple[str, ...]:
        """Names, as the split file orders them. Raises FileError where the folder or its split file cannot be used."""
        return tuple(self._listed_splits)

    def split(self, name: str) -> FilePairs:
        """The pairs of one split whose view and touch both exist. A pair that two splits name is in the first only.

        Notes count what was left out or lacks depth or background. Raises UsageError for an unknown split, FileError
        where the folder or its split file cannot be used or none of the pairs exists.
        """
        if name not in self._listed_splits:
            raise UsageError(f"{name!r} is no split of it.", remedy=f"There are {', '.join(self._listed_splits)}.")
        earlier = {pair for split in self.splits[: self.splits.index(name)] for pair in self._listed_splits[split]}
        left_out: Counter[str] = Counter()
        lacking: Counter[str] = Counter()
        entries, seen, folders = [], set[tuple[str, str]](), _FolderListing(self._root, self.scale)
        for pair in self._listed_splits[name]:
            files = folders.get_pair_files(*pair)
            reason = (
                "named twice" if pair in seen
                else "in an earlier split too" if pair in earlier
                else "no view (vision)" if files.rgb.name not in folders.list_names(files.rgb.parent)
                else "no touch image" if files.touch.name not in folders.list_names(files.touch.parent)
                else ""
            )  # fmt: skip
            seen.add(pair)
            if reason:
                left_out[reason] += 1
                continue
            lacking["have no depth"] += files.depth is None
            lacking["have no background (touch_bg)"] += files.background is None
            entries.append(files)
        if not entries:
            raise FileError(
                f"no pair of the split {name!r} is there ({'; '.join(format_left_out(left_out)) or 'it is empty'}).",
                where=str(self._root),
                remedy=f"Check that the view folders end in _{self.scale}.",
            )
        notes = (
            "views are taken as sRGB, touch images as they are, depth as metres; the views' scale is unknown",
            *format_left_out(left_out),
            *(f"{count} {what}" for what, count in lacking.items() if count),
        )
        return FilePairs(tuple(entries), partial(read_pair, side=self.side), notes)


class _FolderListing:
    """What lies where, each folder listed once."""

    def __init__(self, root: Path, scale: str) -> None:
        self._root, self._scale = root, scale
        self._names: dict[Path, frozenset[str]] = {}

    def list_names(self, folder: Path) -> frozenset[str]:
        if folder not in self._names:
            self._names[folder] = list_file_names(folder)
        return self._names[folder]

    def get_pair_files(self, scene: str, index: str) -> PairFiles:
        seen, touched = f"{scene}_{self._scale}", f"{scene}_{TOUCH_SCALE}"
        depth = self._root / "depth" / seen / f"{index}.npy"
        background = self._root / "touch_bg" / touched / "bg.jpg"
        return PairFiles(
            rgb=self._root / "vision" / seen / f"{index}.jpg",
            touch=self._root / "touch" / touched / f"{index}.jpg",
            where=scene,
            depth=depth if depth.name in self.list_names(depth.parent) else None,
            background=background if background.name in self.list_names(background.parent) else None,
        )


def read_split(path: Path) -> dict[str, list[tuple[str, str]]]:
    """Split → (scene, index). Raises FileError where it is no such JSON, or a name would lead out of the folder."""
    where = str(path)
    try:
        if path.stat().st_size > MAX_SPLIT_BYTES:
            raise ValueError("too large")
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise FileError(f"is no JSON text ({error}).", where=where, remedy=_REMEDY) from error
    if not isinstance(content, dict) or not content:
        raise FileError("is no list of splits.", where=where, remedy=_REMEDY)
    out: dict[str, list[tuple[str, str]]] = {}
    for split, pairs in content.items():
        if not isinstance(pairs, list):
            raise FileError(f"the split {split!r} is no list.", where=where, remedy=_REMEDY)
        out[split] = []
        for number, pair in enumerate(pairs, 1):
            if not (isinstance(pair, list) and len(pair) == 2 and all(isinstance(part, str) for part in pair)):
                raise FileError(f"{split}, pair {number}: expected [scene, index].", where=where, remedy=_REMEDY)
            if not all(is_safe_name(part) for part in pair):
                raise FileError(
                    f"{split}, pair {number}: {pair} are no names of files in it.", where=where, remedy=_REMEDY
                )
            out[split].append((pair[0].removesuffix(f"_{TOUCH_SCALE}"), pair[1]))
    return out


def read_pair(files: PairFiles, side: int) -> VisionTouchPair:
    """One pair at side × side pixels. Raises FileError where a file is damaged or two do not go together in shape."""
    rgb, touch = read_photograph(files.rgb), read_touch_image(files.touch)
    depth = None if files.depth is None else read_depth(files.depth, MAX_DEPTH_M)
    background = None if files.background is None else read_touch_image(files.background)
    if depth is not None and not _has_same_aspect(depth, rgb):
        raise FileError(
            f"is {depth.shape}, its view {rgb.shape[:2]}.", where=str(files.depth), remedy="Get both files again."
        )
    if background is not None and background.shape != touch.shape:
        raise FileError(
            f"is {background.shape[:2]}, the touch image {files.touch.name} {touch.shape[:2]}.",
            where=str(files.background),
            remedy="Get both files again.",
        )

    def prepared(values: Float32) -> Float32:
        return resize_by_area(crop_centre_square(values), side)

    return VisionTouchPair(
        rgb=prepared(rgb),
        depth_m=None if depth is None else prepared(depth),
        touch=prepared(touch),
        background=None if background is None else prepared(background),
        sensor="digit",
        label=files.label,
        where=files.where,
        metres_per_pixel=None,
    )


def _has_same_aspect(depth: Float32, rgb: Float32) -> bool:
    """Of one view, even where one was stored smaller: the sides' ratios agree to a pixel."""
    (rows, columns), (tall, wide) = depth.shape, rgb.shape[:2]
    return abs(rows * wide - columns * tall) <= max(wide, tall)
