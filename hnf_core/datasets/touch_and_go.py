"""Reader of Touch and Go: walks through buildings and parks with a camera and a GelSight, 20 classes of material.

F. Yang, C. Ma, J. Zhang, J. Zhu, W. Yuan & A. Owens (2022), "Touch and Go: learning from human-collected vision and
touch", NeurIPS Datasets and Benchmarks. Layout: dataset/<YYYYMMDD_HHMMSS>/{video_frame,gelsight_frame}/<ten
digits>.jpg, one number per moment; label.txt with lines 20220601_182052/0000033833.jpg,3; category_reference.txt with
lines name:3. The published train and test lists draw single frames, so that one press is in both; here a recording is
in one split only.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

from ..errors import FileError
from .data_files import is_safe_name, list_file_names
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

CLASS_COUNT = 20
"""Number of classes."""
UNDECIDED_LABEL = -1
"""Label of frames whose material the annotators could not determine."""
IMAGE_SIDE = 256
"""Default side of the images [pixels]."""
LABEL_FILE = "label.txt"
CATEGORY_FILES = ("category_reference.txt", "category.txt", "categories.txt")
MAX_TEXT_BYTES = 256 * 2**20
"""Largest accepted text file [bytes]."""
VIEW_FOLDER, TOUCH_FOLDER = "video_frame", "gelsight_frame"
_LABEL_LINE = re.compile(r"([^/\\,]+)[/\\]([^/\\,]+)\.(?:jpe?g|png)\s*,\s*(-?\d{1,9})", re.IGNORECASE)
_CATEGORY_LINE = re.compile(r"\s*(\S.*?)\s*:\s*(\d{1,9})\b.*")


@dataclass(frozen=True)
class TouchAndGoFolder:
    """A folder of the Touch and Go data set.

    Attributes
    ----------
    folder : Path
        The folder with label.txt and dataset, or dataset itself (then there are no labels).
    side : int
        Side of every image, a centred square [pixels].
    """

    folder: Path
    side: int = IMAGE_SIDE

    @cached_property
    def recordings(self) -> tuple[str, ...]:
        """Sorted names of recordings with extracted frames; raises FileError if there are none."""
        names, videos = [], 0
        for child in sorted(self._root.iterdir()) if self._root.is_dir() else []:
            if (child / VIEW_FOLDER).is_dir() or (child / TOUCH_FOLDER).is_dir():
                names.append(child.name)
            elif any((child / video).is_file() for video in ("video.mp4", "gelsight.mp4")):
                videos += 1
        if not names:
            raise FileError(
                f"{videos} recordings have videos, none has frames." if videos else "no recordings are in it.",
                where=str(self.folder),
                remedy=f"Extract {VIEW_FOLDER} and {TOUCH_FOLDER} with the data set's own script."
                if videos
                else f"Give the folder with dataset/<recording>/{VIEW_FOLDER} and {TOUCH_FOLDER}.",
            )
        return tuple(names)

    @cached_property
    def pairs(self) -> FilePairs:
        """Pairs of camera and touch frames of one moment, ordered by recording; only labelled ones if labels exist.

        Notes count what was left out. Raises FileError if there are none, or label.txt is another kind of file.
        """
        left_out: Counter[str] = Counter()
        labels = self._labels(left_out)
        names = self._class_names()
        labelled: dict[str, list[str]] = {}
        for recording, stem in labels or ():
            labelled.setdefault(recording, []).append(stem)
        entries = []
        for recording in self.recordings:
            views, touches = (
                _list_images_by_stem(self._root / recording / kind) for kind in (VIEW_FOLDER, TOUCH_FOLDER)
            )
            for stem in sorted(labelled.pop(recording, ()) if labels is not None else {*views, *touches}):
                if stem not in views or stem not in touches:
                    left_out[f"no {VIEW_FOLDER}" if stem not in views else f"no {TOUCH_FOLDER}"] += 1
                    continue
                number = UNDECIDED_LABEL if labels is None else labels[recording, stem]
                label = None if number == UNDECIDED_LABEL else names.get(number, f"class {number}")
                entries.append(PairFiles(views[stem], touches[stem], recording, label))
        left_out["their recording is not there"] += sum(map(len, labelled.values()))
        if not entries:
            raise FileError(
                f"no moment has both frames ({'; '.join(format_left_out(left_out))}).",
                where=str(self.folder),
                remedy=f"Check {VIEW_FOLDER} and {TOUCH_FOLDER}, or get them again.",
            )
        unlabelled = sum(entry.label is None for entry in entries)
        notes = (
            "views are taken as sRGB, touch images as they are; their scale is unknown; no background was recorded",
            *((f"no {LABEL_FILE}: no pair has a label",) if labels is None else ()),
            *((f"{unlabelled} are labeled as undecided",) if labels is not None and unlabelled else ()),
            *format_left_out(left_out),
        )
        return FilePairs(tuple(entries), partial(read_pair, side=self.side), notes)

    def split(self, name: str, seed: int = 0) -> FilePairs:
        """Return the train, val or test split by recording (`vision_touch.get_split`); raise FileError as `pairs`."""
        return get_split(self.pairs, name, seed, str(self.folder))

    @property
    def _root(self) -> Path:
        return self.folder / "dataset" if (self.folder / "dataset").is_dir() else self.folder

    def _labels(self, left_out: Counter[str]) -> dict[tuple[str, str], int] | None:
        path = self.folder / LABEL_FILE
        return read_labels(path, left_out) if path.is_file() else None

    def _class_names(self) -> dict[int, str]:
        path = next((self.folder / name for name in CATEGORY_FILES if (self.folder / name).is_file()), None)
        if path is None:
            return {}
        matches = (match for line in _read_lines(path) if (match := _CATEGORY_LINE.fullmatch(line)))
        return {int(match[2]): match[1] for match in matches}


def read_labels(path: Path, left_out: Counter[str]) -> dict[tuple[str, str], int]:
    """Read the material class, 0 to 19 or `UNDECIDED_LABEL`, of each (recording, frame number).

    Unusable lines are counted in `left_out`, by reason. Raises FileError if the file cannot be read, a line leads out
    of the folder, or most lines are no labels.
    """
    labels: dict[tuple[str, str], int] = {}
    ambiguous: set[tuple[str, str]] = set()
    line_count = invalid_count = 0
    for number, line in enumerate(map(str.strip, _read_lines(path)), 1):
        if not line:
            continue
        line_count += 1
        match = _LABEL_LINE.fullmatch(line)
        if match is None or not is_safe_name(match[1]) or not is_safe_name(match[2]):
            if line.startswith(("/", "\\")) or ".." in re.split(r"[/\\]", line):
                raise FileError(
                    f"line {number} leads out of the folder.", where=str(path), remedy="Get the file again."
                )
            invalid_count += 1
            continue
        key, label = (match[1], match[2]), int(match[3])
        if not UNDECIDED_LABEL <= label < CLASS_COUNT:
            left_out[f"a class beyond 0 to {CLASS_COUNT - 1}"] += 1
        elif key in ambiguous or labels.get(key, label) != label:
            left_out["labeled as two classes"] += 1 + (key not in ambiguous)
            ambiguous.add(key)
            labels.pop(key, None)
        elif key in labels:
            left_out["named twice"] += 1
        else:
            labels[key] = label
    if 2 * invalid_count >= line_count:
        raise FileError(
            f"{invalid_count} of its {line_count} lines are no labels.",
            where=str(path),
            remedy="Expected lines such as 20220601_182052/0000033833.jpg,3.",
        )
    left_out[f"lines of {path.name} that are no label"] += invalid_count
    return labels


def read_pair(files: PairFiles, side: int) -> VisionTouchPair:
    """Read one pair of camera and touch frame at side × side pixels; raise FileError if a file is damaged."""
    return VisionTouchPair(
        rgb=resize_by_area(crop_centre_square(read_photograph(files.rgb)), side),
        depth_m=None,
        touch=resize_by_area(crop_centre_square(read_touch_image(files.touch)), side),
        background=None,
        sensor="gelsight",
        label=files.label,
        where=files.where,
        metres_per_pixel=None,
    )


def _list_images_by_stem(folder: Path) -> dict[str, Path]:
    """List a folder's images by file stem; of two formats of one name the .jpg is used, as in the published lists."""
    names = sorted(
        list_file_names(folder), key=lambda name: (not name.lower().endswith((".jpg", ".jpeg")), name), reverse=True
    )
    return {Path(name).stem: folder / name for name in names if Path(name).suffix.lower() in IMAGE_SUFFIXES}


def _read_lines(path: Path) -> list[str]:
    try:
        if path.stat().st_size > MAX_TEXT_BYTES:
            raise ValueError("it is too large")
        return path.read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError) as error:
        raise FileError(f"cannot be read as text ({error}).", where=str(path), remedy="Get it again.") from error
