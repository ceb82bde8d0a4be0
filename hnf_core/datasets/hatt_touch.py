"""HaTT's photographs beside GelSight images of the same textures, in whatever arrangement a user has them.

N. Heravi, W. Yuan, A. M. Okamura & J. Bohg (2020), "Learning an action-conditional model for haptic texture
generation", ICRA, pressed a GelSight on the Penn Haptic Texture Toolkit's textures. No layout of such images is
published: each is known by its folder's name or the beginning of its own, and notes say what was assumed.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

from ..errors import FileError
from .data_files import find_files
from .recording import normalise_name
from .vision_touch import (
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

PHOTO_SIDE_M = 1024 / 15e3
"""A HaTT photograph is square, 1024 pixels at 15 a millimetre."""
IMAGE_SIDE = 256
BACKGROUND_NAMES = ("background", "bg", "blank", "flat", "reference", "nocontact", "notouch")
_TAKE_SUFFIX = re.compile(r"(\d|gelsight|tactile|touch|img|image|frame|take|square|crop)*")


@dataclass(frozen=True)
class HattTouchFolder:
    """photographs: the toolkit's TextureImages (or what holds it). touch: GelSight images, <material>/<any name> or
    <material>_<take>; one called background, in the same folder or at the top, is the sensor untouched.
    side: pixels of the touch images, a centred square. Photographs stay as they are: their scale is known."""

    photographs: Path
    touch: Path
    side: int = IMAGE_SIDE

    @cached_property
    def pairs(self) -> FilePairs:
        """One pair for every touch image whose material has a photograph, ordered by material and file.

        Notes say what was assumed, and count what was left out. Raises FileError where a folder is none, or nothing in
        them goes together.
        """
        photos = self._photographs_by_material
        taken, named = set(photos.values()), {normalise_name(name): name for name in photos}
        left_out: Counter[str] = Counter()
        touches, backgrounds = [], dict[Path, Path]()
        for path in find_files(self.touch, IMAGE_SUFFIXES):
            if path in taken:
                continue
            if normalise_name(re.sub(r"\d+$", "", path.stem)) in BACKGROUND_NAMES:
                backgrounds.setdefault(path.parent, path)
                continue
            material = self._match_material(path, named)
            if material is None:
                left_out["touch images of no photographed material"] += 1
            else:
                touches.append((material, path))
        without = set(photos) - {material for material, _ in touches}
        left_out["photographs without touch image"] += len(without)
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
        bare = sum(entry.background is None for entry in entries)
        notes = (
            f"photographs are taken as {1e3 * PHOTO_SIDE_M:.1f} mm wide and sRGB, touch images as a GelSight's",
            "a touch image is of the material that its folder or the beginning of its name says; numbers are takes",
            "photograph and touch show the same texture, not the same place of it",
            *((f"{bare} have no background",) if bare else ()),
            *format_left_out(left_out),
        )
        return FilePairs(entries, partial(read_pair, side=self.side), notes)

    def split(self, name: str, seed: int = 0) -> FilePairs:
        """train, val or test by texture (vision_touch.named_split). Raises FileError as pairs does, too."""
        return get_split(self.pairs, name, seed, str(self.touch))

    @cached_property
    def _photographs_by_material(self) -> dict[str, Path]:
        """Material → photograph. Where some are called <material>_square, as in the toolkit, only those count."""
        found = [path for path in find_files(self.photographs, IMAGE_SUFFIXES) if not path.is_relative_to(self.touch)
                 or self.photographs.is_relative_to(self.touch)]  # fmt: skip
        square = [path for path in found if path.stem.lower().endswith("square")]
        out: dict[str, Path] = {}
        for path in square or found:
            name = " ".join(re.sub(r"(?i)[_ ]*square$", "", path.stem).replace("_", " ").split())
            if name and normalise_name(name) not in map(normalise_name, out):
                out[name] = path
        if not out:
            raise FileError(
                "no photographs are in it.",
                where=str(self.photographs),
                remedy="Give the toolkit's TextureImages, with <material>_square.bmp.",
            )
        return out

    def _match_material(self, path: Path, named: dict[str, str]) -> str | None:
        """By the nearest folder that is called as a material, else by how the file's own name begins: word by word, so
        that Brick 1_2 is Brick 1 where there is a Brick 12; or with words run together."""
        for part in reversed(path.relative_to(self.touch).parts[:-1]):
            if normalise_name(part) in named:
                return named[normalise_name(part)]
        words = _split_words(path.stem)
        whole = [name for name in named.values() if words[: len(_split_words(name))] == _split_words(name)]
        glued = [named[start] for count in range(1, len(words) + 1) if (start := "".join(words[:count])) in named]
        for name in (*sorted(whole, key=len, reverse=True), *glued):
            rest = "".join(words)[len(normalise_name(name)) :]
            if _TAKE_SUFFIX.fullmatch(rest):
                return name
        return None


def _split_words(name: str) -> list[str]:
    return [normalise_name(word) for word in re.split(r"[\W_]+", name) if word]


def read_pair(files: PairFiles, side: int) -> VisionTouchPair:
    """The photograph as it is, touch and background at side × side pixels. Raises FileError where a file is damaged, or
    touch and background differ in size."""
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
