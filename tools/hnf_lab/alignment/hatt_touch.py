"""Reader of HaTT photographs paired with GelSight images of the same textures, in any arrangement of folders.

N. Heravi, W. Yuan, A. M. Okamura & J. Bohg (2020), "Learning an action-conditional model for haptic texture
generation", ICRA, pressed a GelSight on the textures of the Penn Haptic Texture Toolkit. No layout of such images is
published: each is identified by its folder's name or the start of its own, and notes list the assumptions.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING

from hnf_core.datasets.data_files import find_files
from hnf_core.datasets.recording import normalise_name
from hnf_core.datasets.vision_touch import (
    IMAGE_SUFFIXES,
    FilePairs,
    PairFiles,
    VisionTouchPair,
    crop_centre_square,
    format_left_out,
    get_split,
    read_photograph,
    read_touch_image,
    resize_by_area,
)
from hnf_core.errors import FileError

if TYPE_CHECKING:
    pass

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    pass

PHOTO_SIDE_M = 1024 / 15e3
"""Side of a HaTT photograph [m]: 1024 pixels at 15 per millimetre."""
IMAGE_SIDE = 256
"""Default side of the touch images [pixels]."""
BACKGROUND_NAMES = ("background", "bg", "blank", "flat", "reference", "nocontact", "notouch")
"""Names of images of the untouched sensor."""
_TAKE_SUFFIX = re.compile(r"(\d|gelsight|tactile|touch|img|image|frame|take|square|crop)*")


@dataclass(frozen=True)
class HattTouchFolder:
    """Folders of photographs and of GelSight images of the same textures, read as pairs.

    Attributes
    ----------
    photographs : Path
        The toolkit's TextureImages, or a folder around it.
    touch : Path
        GelSight images, <material>/<any name> or <material>_<take>. An image called background, in the same folder or
        at the top, is the untouched sensor.
    side : int
        Side of the touch images, a centred square [pixels]; photographs keep their pixels, since their scale is known.
    """

    photographs: Path
    touch: Path
    side: int = IMAGE_SIDE

    @cached_property
    def pairs(self) -> FilePairs:
        """One pair for every touch image of a photographed material, ordered by material and file.

        Notes list the assumptions and count what was left out. Raises FileError if a folder is missing, or nothing
        matches.
        """
        photos = self._photographs_by_material
        photo_paths, names_by_key = set(photos.values()), {normalise_name(name): name for name in photos}
        left_out: Counter[str] = Counter()
        touches, backgrounds = [], dict[Path, Path]()
        for path in find_files(self.touch, IMAGE_SUFFIXES):
            if path in photo_paths:
                continue
            if normalise_name(re.sub(r"\d+$", "", path.stem)) in BACKGROUND_NAMES:
                backgrounds.setdefault(path.parent, path)
                continue
            material = self._match_material(path, names_by_key)
            if material is None:
                left_out["touch images of no photographed material"] += 1
            else:
                touches.append((material, path))
        unpaired = set(photos) - {material for material, _ in touches}
        left_out["photographs without touch image"] += len(unpaired)
        entries = tuple(
            PairFiles(photos[material], path, material, material,
                      background=backgrounds.get(path.parent) or backgrounds.get(self.touch))
            for material, path in sorted(touches)
        )  # fmt: skip
        if not entries:
            raise FileError(
                "no touch image is called as a photograph is.",
                where=str(self.touch),
                remedy=f"Name folders or files after the materials, such as {', '.join(sorted(photos)[:3])}.",
            )
        without_background = sum(entry.background is None for entry in entries)
        notes = (
            f"photographs are taken as {1e3 * PHOTO_SIDE_M:.1f} mm wide and sRGB, touch images as a GelSight's",
            "a touch image is of the material that its folder or the beginning of its name says; numbers are takes",
            "photograph and touch show the same texture, not the same place of it",
            *((f"{without_background} have no background",) if without_background else ()),
            *format_left_out(left_out),
        )
        return FilePairs(entries, partial(read_pair, side=self.side), notes)

    def split(self, name: str, seed: int = 0) -> FilePairs:
        """Return the train, val or test split by texture (`vision_touch.get_split`); raise FileError as `pairs` too."""
        return get_split(self.pairs, name, seed, str(self.touch))

    @cached_property
    def _photographs_by_material(self) -> dict[str, Path]:
        """Photograph of each material; if some are called <material>_square, as in the toolkit, others are ignored."""
        candidates = [
            path
            for path in find_files(self.photographs, IMAGE_SUFFIXES)
            if not path.is_relative_to(self.touch) or self.photographs.is_relative_to(self.touch)
        ]
        square = [path for path in candidates if path.stem.lower().endswith("square")]
        photographs: dict[str, Path] = {}
        for path in square or candidates:
            name = " ".join(re.sub(r"(?i)[_ ]*square$", "", path.stem).replace("_", " ").split())
            if name and normalise_name(name) not in map(normalise_name, photographs):
                photographs[name] = path
        if not photographs:
            raise FileError(
                "no photographs are in it.",
                where=str(self.photographs),
                remedy="Give the toolkit's TextureImages, with <material>_square.bmp.",
            )
        return photographs

    def _match_material(self, path: Path, named: dict[str, str]) -> str | None:
        """Match a touch image by the nearest folder named as a material, else by the start of its own name.

        Names are compared word by word, so that "Brick 1_2" is "Brick 1" even if there is a "Brick 12"; then without
        spaces.
        """
        for part in reversed(path.relative_to(self.touch).parts[:-1]):
            if normalise_name(part) in named:
                return named[normalise_name(part)]
        words = _split_words(path.stem)
        full_matches = [name for name in named.values() if words[: len(_split_words(name))] == _split_words(name)]
        joined_matches = [
            named[start] for count in range(1, len(words) + 1) if (start := "".join(words[:count])) in named
        ]
        for name in (*sorted(full_matches, key=len, reverse=True), *joined_matches):
            remainder = "".join(words)[len(normalise_name(name)) :]
            if _TAKE_SUFFIX.fullmatch(remainder):
                return name
        return None


def _split_words(name: str) -> list[str]:
    return [normalise_name(word) for word in re.split(r"[\W_]+", name) if word]


def read_pair(files: PairFiles, side: int) -> VisionTouchPair:
    """Read a photograph with its touch image and sensor background, the latter two resized to side × side pixels.

    Raises FileError if a file is damaged, or touch and background differ in size.
    """
    rgb, touch = read_photograph(files.rgb), read_touch_image(files.touch)
    background = None if files.background is None else read_touch_image(files.background)
    if background is not None and background.shape != touch.shape:
        raise FileError(
            f"is {background.shape[:2]}, the touch image {files.touch.name} {touch.shape[:2]}.",
            where=str(files.background),
            remedy="Give the background of the same sensor and resolution, or take it away.",
        )
    return VisionTouchPair(
        rgb=rgb,
        depth_m=None,
        touch=resize_by_area(crop_centre_square(touch), side),
        background=None if background is None else resize_by_area(crop_centre_square(background), side),
        sensor="gelsight",
        label=files.label,
        where=files.where,
        metres_per_pixel=PHOTO_SIDE_M / rgb.shape[1] if rgb.shape[0] == rgb.shape[1] else None,
    )


def iterate_readable(pairs: VisionTouchPairs, skipped: list[FileError]) -> Iterator[VisionTouchPair]:
    """Yield the pairs whose files can be used, in order; append the errors of the others to `skipped`.

    One damaged image among thousands should neither end a training nor go unnoticed.
    """
    for index in range(len(pairs)):
        try:
            pair = pairs[index]
        except FileError as error:
            skipped.append(error)
            continue
        yield pair


class VisionTouchPairs(Protocol):
    """Interface of lazy sequences of photograph and touch pairs: labels and places are known without opening images."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> VisionTouchPair:
        """Read one pair; raise FileError if one of its files cannot be used."""
        ...

    @property
    def labels(self) -> tuple[str | None, ...]:
        """Material label of each pair, None if unknown."""
        ...

    @property
    def locations(self) -> tuple[str, ...]:
        """Location (scene, recording or texture) of each pair, its `where`."""
        ...

    @property
    def notes(self) -> tuple[str, ...]:
        """Assumptions of the reader, and counts of the pairs that were left out, in words."""
        ...
