"""Reader of Tactile-Augmented Radiance Fields: rendered views with depth, registered to touches of a DIGIT.

Y. Dou, F. Yang, Y. Liu, A. Loquercio & A. Owens (2024), "Tactile-augmented radiance fields", CVPR. Layout:
vision/<scene>_<scale>/<index>.jpg, depth/<scene>_<scale>/<index>.npy (H, W, 1) in metres,
touch/<scene>_40_30/<index>.jpg, touch_bg/<scene>_40_30/bg.jpg; split_interval.json = {"train": [["<scene>_40_30",
"<index>"], …], "val": …, "test": …}. All images of a pair have the same orientation, so none is rotated here.
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
"""Scale in the names of touch folders."""
MAX_DEPTH_M = 5.0
"""Depth to which views are clipped [m]."""
IMAGE_SIDE = 256
"""Default side of the images [pixels]."""
MAX_SPLIT_BYTES = 64 * 2**20
"""Largest accepted split file [bytes]."""
_REMEDY = "Get the split file again from the data set."


@dataclass(frozen=True)
class TarfFolder:
    """A folder of the Tactile-Augmented Radiance Fields data set.

    Attributes
    ----------
    folder : Path
        The folder with vision, touch and split_interval.json, or the one above it.
    scale : str
        Scale of the views, as in the names of their folders.
    side : int
        Side of every image, a centred square as in the publication [pixels].
    """

    folder: Path
    scale: str = TOUCH_SCALE
    side: int = IMAGE_SIDE

    @cached_property
    def _root(self) -> Path:
        children = sorted(self.folder.iterdir()) if self.folder.is_dir() else []
        for candidate in (self.folder, *children):
            if (candidate / "vision").is_dir() and (candidate / "touch").is_dir():
                return candidate
        raise FileError(
            "the folders vision and touch are not in it.",
            where=str(self.folder),
            remedy="Give the folder that holds vision, depth, touch and touch_bg.",
        )

    @cached_property
    def _listed_splits(self) -> dict[str, list[tuple[str, str]]]:
        """Scene and index of the pairs of each split, as the split file lists them."""
        candidates = [self._root, self.folder, *sorted(folder for folder in self.folder.iterdir() if folder.is_dir())]
        path = next((folder / SPLIT_FILE for folder in candidates if (folder / SPLIT_FILE).is_file()), None)
        if path is None:
            raise FileError(f"{SPLIT_FILE} is not in it.", where=str(self.folder), remedy=_REMEDY)
        return read_split(path)

    @property
    def splits(self) -> tuple[str, ...]:
        """Names of the splits in file order; raises FileError if the folder or its split file cannot be used."""
        return tuple(self._listed_splits)

    def split(self, name: str) -> FilePairs:
        """Return the pairs of one split with both view and touch; a pair in two splits is in the first only.

        Notes count what was left out or has no depth or background. Raises UsageError for an unknown split, FileError
        if the folder or its split file cannot be used or no pair exists.
        """
        if name not in self._listed_splits:
            raise UsageError(f"{name!r} is no split of it.", remedy=f"There are {', '.join(self._listed_splits)}.")
        earlier = {pair for split in self.splits[: self.splits.index(name)] for pair in self._listed_splits[split]}
        left_out: Counter[str] = Counter()
        lacking: Counter[str] = Counter()
        entries, used, folders = [], set[tuple[str, str]](), _FolderListing(self._root, self.scale)
        for pair in self._listed_splits[name]:
            files = folders.get_pair_files(*pair)
            reason = (
                "named twice" if pair in used
                else "in an earlier split too" if pair in earlier
                else "no view (vision)" if files.rgb.name not in folders.list_names(files.rgb.parent)
                else "no touch image" if files.touch.name not in folders.list_names(files.touch.parent)
                else ""
            )  # fmt: skip
            used.add(pair)
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
            "views are taken as sRGB, touch images as they are, depth as meters; the views' scale is unknown",
            *format_left_out(left_out),
            *(f"{count} {problem}" for problem, count in lacking.items() if count),
        )
        return FilePairs(tuple(entries), partial(read_pair, side=self.side), notes)


class _FolderListing:
    """Cached listing of the data set's folders, to find the files of a pair."""

    def __init__(self, root: Path, scale: str) -> None:
        self._root, self._scale = root, scale
        self._names: dict[Path, frozenset[str]] = {}

    def list_names(self, folder: Path) -> frozenset[str]:
        if folder not in self._names:
            self._names[folder] = list_file_names(folder)
        return self._names[folder]

    def get_pair_files(self, scene: str, index: str) -> PairFiles:
        view_folder, touch_folder = f"{scene}_{self._scale}", f"{scene}_{TOUCH_SCALE}"
        depth = self._root / "depth" / view_folder / f"{index}.npy"
        background = self._root / "touch_bg" / touch_folder / "bg.jpg"
        return PairFiles(
            rgb=self._root / "vision" / view_folder / f"{index}.jpg",
            touch=self._root / "touch" / touch_folder / f"{index}.jpg",
            where=scene,
            depth=depth if depth.name in self.list_names(depth.parent) else None,
            background=background if background.name in self.list_names(background.parent) else None,
        )


def read_split(path: Path) -> dict[str, list[tuple[str, str]]]:
    """Read the (scene, index) of the pairs in each split from a split file.

    Raises FileError if it is no such JSON, or a name would lead out of the folder.
    """
    where = str(path)
    try:
        if path.stat().st_size > MAX_SPLIT_BYTES:
            raise ValueError("too large")
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise FileError(f"is no JSON text ({error}).", where=where, remedy=_REMEDY) from error
    if not isinstance(content, dict) or not content:
        raise FileError("is no list of splits.", where=where, remedy=_REMEDY)
    splits: dict[str, list[tuple[str, str]]] = {}
    for split, pairs in content.items():
        if not isinstance(pairs, list):
            raise FileError(f"the split {split!r} is no list.", where=where, remedy=_REMEDY)
        splits[split] = []
        for number, pair in enumerate(pairs, 1):
            if not (isinstance(pair, list) and len(pair) == 2 and all(isinstance(part, str) for part in pair)):
                raise FileError(f"{split}, pair {number}: expected [scene, index].", where=where, remedy=_REMEDY)
            if not all(is_safe_name(part) for part in pair):
                raise FileError(
                    f"{split}, pair {number}: {pair} are no names of files in it.", where=where, remedy=_REMEDY
                )
            splits[split].append((pair[0].removesuffix(f"_{TOUCH_SCALE}"), pair[1]))
    return splits


def read_pair(files: PairFiles, side: int) -> VisionTouchPair:
    """Read view, depth and touch of one pair at side × side pixels; raise FileError if a file is damaged or misfits."""
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

    def prepare(values: Float32) -> Float32:
        return resize_by_area(crop_centre_square(values), side)

    return VisionTouchPair(
        rgb=prepare(rgb),
        depth_m=None if depth is None else prepare(depth),
        touch=prepare(touch),
        background=None if background is None else prepare(background),
        sensor="digit",
        label=files.label,
        where=files.where,
        metres_per_pixel=None,
    )


def _has_same_aspect(depth: Float32, rgb: Float32) -> bool:
    """Return True if the aspect ratios of depth and view agree to a pixel; either may be stored smaller."""
    (rows, columns), (rgb_rows, rgb_columns) = depth.shape, rgb.shape[:2]
    return abs(rows * rgb_columns - columns * rgb_rows) <= max(rgb_columns, rgb_rows)
