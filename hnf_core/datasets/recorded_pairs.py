"""Recorded pairs of photograph and touch as the views that train D_φ, from three kinds of data sets.

Touch images are decoded to slopes by the nominal optics of their sensor, except where a height was recorded. No data
set states how large its photographs are: each is taken to show what the touch image shows.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from ..errors import FileError, SceneError, UsageError
from ..material.token import TOKEN_DIM
from ..tactile.height import integrate_gradients
from ..tactile.optics import decode_gradients, get_sensor
from ..tactile.photometric_stereo import decode_touch_image, get_nominal_calibration
from ..tactile.views import PITCHES_M, VIEW_PIXELS, antialias, extract_view
from .tactile_pairs import PAIR_SENSORS, Pairs, concatenate_pairs, encode_rgb
from .tarf import TarfFolder
from .touch_and_go import TouchAndGoFolder
from .vision_touch import FilePairs, VisionTouchPair, crop_centre_square, read_array, read_photograph, split_by_location

Float = NDArray[np.float64]

BILLET_PIXEL_M = 0.063e-3
"""Pixel size of the billets' depth, whose unit is one pixel [m]: as their authors' sensor, not verified."""
MAX_VIEWS_ACROSS = 2
"""Largest number of views of one pitch along a side of a touch image."""
LICENCES: Mapping[str, str] = MappingProxyType({
    "tarf": "trained on Tactile-Augmented Radiance Fields: its own terms apply",
    "touch-and-go": "trained on Touch and Go: its own terms apply",
    "billets": "trained on gelsight-contrastive-learning's steel billets (GPL-3.0)",
})  # fmt: skip
"""Licence statement of weights trained on each kind of recorded pairs."""


@dataclass(frozen=True)
class TouchedPlace:
    """A place that was photographed and touched.

    Attributes
    ----------
    rgb : ndarray, shape (H, W, 3)
        Linear colour of the square that was touched.
    slopes : ndarray, shape (2, h, w)
        Slopes ∂h/∂x, ∂h/∂y of the membrane.
    depth_m : ndarray, shape (H, W), or None
        Depth of the photograph [m].
    width_m : float
        Side of the square [m].
    sensor : str
        Name in `PAIR_SENSORS`.
    label, where : str
        Material in the data set's words, "" if unknown, and location.
    """

    rgb: Float
    slopes: Float
    depth_m: Float | None
    width_m: float
    sensor: str
    label: str
    where: str


def load_recorded_pairs(kind: str, folder: Path, seed: int = 0) -> tuple[Pairs, Pairs, tuple[str, ...]]:
    """Load the views of a recorded data set, a fifth of its locations held out.

    Parameters
    ----------
    kind : str
        One of `LICENCES`.
    folder : Path
        Folder of the data set.
    seed : int
        Seed of which locations are held out.

    Returns
    -------
    train, held_out : Pairs
        The views; of a sensor that was not used, slopes are NaN.
    notes : tuple of str
        What was assumed and left out.

    Raises
    ------
    UsageError
        For an unknown kind, or data of a single location.
    FileError
        If the folder holds no such data, or a file is damaged.
    """
    if kind not in LICENCES:
        raise UsageError(f"{kind!r} is no data set of pairs.", remedy=f"Known are {', '.join(LICENCES)}.")
    left_out: Counter[str] = Counter()
    shares = {"train": 0.8, "held out": 0.2}
    if kind == "billets":
        billets = _list_billets(folder)
        is_held_out = _draw_held_out([where for where, _ in billets], seed)
        parts = {
            name: [stem for where, stem in billets if (where in is_held_out) == (name != "train")] for name in shares
        }
        places: dict[str, Iterator[TouchedPlace]] = {name: map(_read_billet, stems) for name, stems in parts.items()}
        notes: tuple[str, ...] = (f"heights are taken as pixels of {1e3 * BILLET_PIXEL_M:g} mm",)
    else:
        splits = _split_files(kind, folder, seed, shares)
        notes = splits["train"].notes
        places = {name: _decode_all(part, left_out) for name, part in splits.items()}
    train, held_out = (_cut_all(places[name], f"{kind}: {name}", folder) for name in shares)
    notes = (
        *notes,
        "a photograph is taken to show what its touch image shows",
        *(f"{n} {why}" for why, n in left_out.items()),
    )
    return train, held_out, notes


def _split_files(kind: str, folder: Path, seed: int, shares: Mapping[str, float]) -> dict[str, FilePairs]:
    """Return the files of each split: as published where the data set has splits, else by location."""
    if kind == "tarf":
        tarf = TarfFolder(folder)
        return {name: tarf.split(published) for name, published in zip(shares, ("train", "test"), strict=True)}
    return split_by_location(TouchAndGoFolder(folder).pairs, seed, shares)


def _draw_held_out(locations: list[str], seed: int) -> set[str]:
    names = sorted(set(locations))
    if len(names) < 2:
        raise UsageError("all pairs are of one location, so none can be held out.", remedy="Add another location.")
    order = np.random.default_rng(seed).permutation(len(names))
    return {names[index] for index in order[: max(1, round(len(names) / 5))]}


def _list_billets(folder: Path) -> list[tuple[str, Path]]:
    """List the billets' places: location (kind and number of the billet) and common start of the files' names."""
    found = sorted(folder.glob("*_depth.npy"))
    stems = [path.with_name(path.name.removesuffix("_depth.npy")) for path in found]
    if not stems:
        raise FileError(
            "no place of a billet (NAME_depth.npy) is there.", where=str(folder), remedy="Check the folder."
        )
    return [(stem.name.rpartition("_")[0], stem) for stem in stems]


def _read_billet(stem: Path) -> TouchedPlace:
    """Read a billet's place: its phone photograph, and the slopes of its depth."""
    where = stem.name.rpartition("_")[0]
    height = read_array(stem.with_name(f"{stem.name}_depth.npy"))
    if height.ndim != 2 or height.dtype.kind != "f" or not np.isfinite(height).all() or min(height.shape) < VIEW_PIXELS:
        raise FileError(
            f"holds {height.dtype} {height.shape}, no heights.", where=f"{stem}_depth.npy", remedy="Get it anew."
        )
    square = np.asarray(crop_centre_square(height.astype(np.float32)), dtype=np.float64)
    down, right = np.gradient(square)
    return TouchedPlace(
        np.asarray(crop_centre_square(read_photograph(stem.with_name(f"{stem.name}_phone.jpg"))), dtype=np.float64),
        np.stack([right, -down]), None, BILLET_PIXEL_M * len(square), "gelsight", where.partition("_")[0], where,
    )  # fmt: skip


def _decode_all(pairs: FilePairs, left_out: Counter[str]) -> Iterator[TouchedPlace]:
    for pair in pairs:
        try:
            yield decode_place(pair)
        except SceneError as error:
            left_out[f"left out: {error.what}"] += 1


def decode_place(pair: VisionTouchPair) -> TouchedPlace:
    """Decode a pair's touch image by nominal optics; raise SceneError if it shows no contact or is overexposed."""
    rows, columns = pair.touch.shape[:2]
    pixel_m = get_nominal_calibration(pair.sensor, rows, columns).metres_per_pixel
    decoded = decode_touch_image(pair.touch, pair.background, sensor=pair.sensor, metres_per_pixel=pixel_m)
    slopes = np.stack(decode_gradients(decoded.tactile_map.image, get_sensor(pair.sensor)))
    return TouchedPlace(
        pair.rgb.astype(np.float64), slopes, None if pair.depth_m is None else pair.depth_m.astype(np.float64),
        pixel_m * columns, pair.sensor, pair.label or "", pair.where,
    )  # fmt: skip


def _cut_all(places: Iterator[TouchedPlace], what: str, folder: Path) -> Pairs:
    cut = [pairs for place in places if (pairs := cut_place(place)) is not None]
    if not cut:
        raise FileError(f"no view can be cut ({what}).", where=str(folder), remedy="Add places, or another location.")
    return concatenate_pairs(cut)


def cut_place(place: TouchedPlace) -> Pairs | None:
    """Cut the views of a place at all pitches that fit and that its touch image resolves; None if there is none."""
    pixel_m = place.width_m / place.slopes.shape[-1]
    corners = [
        (index, row, column)
        for index, pitch in enumerate(PITCHES_M)
        if pitch >= 0.99 * pixel_m and VIEW_PIXELS * pitch <= place.width_m
        for row in _spread(place.width_m, pitch)
        for column in _spread(place.width_m, pitch)
    ]
    if not corners:
        return None
    count, size = len(corners), (VIEW_PIXELS, VIEW_PIXELS)
    rgb, depth = np.zeros((count, *size, 3), dtype=np.uint8), np.zeros((count, *size), dtype=np.float16)
    slopes = np.full((count, len(PAIR_SENSORS), 2, *size), np.nan, dtype=np.float16)
    height = np.zeros((count, *size), dtype=np.float16)
    sensor = PAIR_SENSORS.index(place.sensor)
    cuts: dict[int, list[Callable[[float, float], Float]]] = {}
    layers = [*np.moveaxis(place.rgb, -1, 0), *place.slopes, *(() if place.depth_m is None else (place.depth_m,))]
    for number, (index, row, column) in enumerate(corners):
        pitch = PITCHES_M[index]
        if index not in cuts:
            cuts[index] = [_make_cutter(layer, place.width_m, pitch) for layer in layers]
        red, green, blue, gx, gy, *deep = (cut(row, column) for cut in cuts[index])
        rgb[number] = encode_rgb(np.stack([red, green, blue], axis=-1))
        slopes[number, sensor] = np.stack([gx, gy])
        height[number] = integrate_gradients(gx, gy, 1.0)
        if deep:
            depth[number] = (deep[0] - deep[0].mean()) / pitch
    nothing = np.zeros(1, dtype=np.int64)
    return Pairs(
        rgb, depth, height, slopes, np.array([index for index, *_ in corners]), np.zeros(count, dtype=np.int64),
        (place.label,), nothing - 1, nothing, nothing, np.full((1, TOKEN_DIM), np.nan, dtype=np.float32),
        np.full((1, 3), np.nan, dtype=np.float32), nothing, np.zeros(1, dtype=bool),
    )  # fmt: skip


def _spread(width_m: float, pitch_m: float) -> Float:
    """Return the starts of views spread evenly along a side [m]."""
    side = VIEW_PIXELS * pitch_m
    count = min(int(width_m / side), MAX_VIEWS_ACROSS)
    return np.array([(width_m - side) / 2.0]) if count == 1 else np.linspace(0.0, width_m - side, count)


def _make_cutter(layer: Float, width_m: float, pitch_m: float) -> Callable[[float, float], Float]:
    """Return the function that cuts a view at an upper left corner [m] out of a layer (H, W)."""
    pixel_m = width_m / layer.shape[1]
    factor = pitch_m / pixel_m
    smooth = antialias(layer, factor)
    return lambda row, column: extract_view(smooth, factor, np.rint(np.array([row, column]) / pixel_m).astype(np.intp))
