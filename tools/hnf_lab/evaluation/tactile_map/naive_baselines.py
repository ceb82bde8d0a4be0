"""What the simple stand-ins take from the training set: the most similar view, the mean of a class, grey as height."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.datasets.pair_generation import PairSizes, list_tile_requests, make_tile
from hnf_core.datasets.tactile_pairs import PAIR_SENSORS, TRAIN, Pairs, concatenate_pairs, get_shard_path, load_shard
from hnf_core.errors import FileError
from hnf_core.tactile.optics import gel_gradients, get_sensor
from hnf_core.tactile.views import PITCHES_M, VIEW_PIXELS, AppearanceView

Float = NDArray[np.float64]
Single = NDArray[np.float32]

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Of linear RGB, ITU-R BT.709."""
GREY_HEIGHT_M = 1e-5
"""Height of the whole grey scale before the factor that is fitted."""
TOKENS_PER_CLASS = 8
OCTAVES = 4
POWER_FLOOR = 1e-7
DEPTH_FLOOR = 1e-2


@dataclass(frozen=True)
class NaiveBaselines:
    """neighbours: (q, 2, 64, 64) true slopes of the first sensor in the training view that is most like each query.
    tokens: (m, TOKEN_DIM) of training tiles, class_name: (m,). grey_m: metres of the whole grey scale, the geometric
    mean of what would have given each training view its RMS slope. views: how many training views were compared."""

    neighbours: Single
    tokens: Single
    class_name: tuple[str, ...]
    grey_m: float
    views: int


def load_training_shards(folder: Path) -> Iterator[Pairs]:
    """One shard after the other. Raises FileError where there is none or one is damaged."""
    paths = sorted(get_shard_path(folder, TRAIN, 0).parent.glob("[0-9]*.safetensors"))
    if not paths:
        raise FileError("no training pairs here.", where=str(folder), remedy="Make them: tools/make_tactile_pairs.py.")
    for path in paths:
        yield load_shard(path)[0]


def make_shards(tiles: int, seed: int = 0) -> Iterator[Pairs]:
    """A small training set made on the fly, of named classes alone."""
    named = [order for order in list_tile_requests(TRAIN, PairSizes(train=2 * tiles), seed) if order.class_name]
    yield concatenate_pairs([make_tile(order) for order in named[:tiles]])


def fit_naive_baselines(shards: Iterable[Pairs], queries: Sequence[AppearanceView]) -> NaiveBaselines:
    """One pass over the training set. Features are scaled by their spread over the first shard, and grey is fitted on
    it; of each class the first TOKENS_OF_CLASS tokens are kept."""
    asked = np.stack([compute_features(np.sqrt(view.rgb), view.depth_m / view.pitch_m) for view in queries])
    asked_pitch = np.array([int(np.argmin(np.abs(np.log(np.array(PITCHES_M) / view.pitch_m)))) for view in queries])
    best = np.full(len(queries), np.inf)
    slopes = np.zeros((len(queries), 2, VIEW_PIXELS, VIEW_PIXELS), dtype=np.float32)
    tokens: dict[str, list[Single]] = {}
    scale: Float | None = None
    grey_m, views = 0.0, 0
    for pairs in shards:
        known = np.stack(
            [
                compute_features(rgb / np.float32(255.0), depth)
                for rgb, depth in zip(pairs.rgb, pairs.depth, strict=True)
            ]
        )
        if scale is None:
            scale, grey_m = known.std(axis=0) + 1e-6, fit_grey_m(pairs)
        distance = np.square((asked[:, None] - known[None]) / scale).sum(axis=2)
        distance[asked_pitch[:, None] != pairs.pitch_index[None]] = np.inf
        nearest = np.argmin(distance, axis=1)
        for query in np.flatnonzero(distance[np.arange(len(asked)), nearest] < best):
            best[query] = distance[query, nearest[query]]
            slopes[query] = pairs.slopes[nearest[query], 0]
        for name, token in zip(pairs.class_name, pairs.token, strict=True):
            if name and len(tokens.setdefault(name, [])) < TOKENS_PER_CLASS:
                tokens[name].append(token)
        views += len(pairs)
    if scale is None or not tokens:
        raise FileError("the training set is empty.", remedy="Make pairs: tools/make_tactile_pairs.py.")
    names = tuple(name for name, own in tokens.items() for _ in own)
    return NaiveBaselines(slopes, np.stack([token for own in tokens.values() for token in own]), names, grey_m, views)


def compute_features(encoded: NDArray[Any], depth: NDArray[Any]) -> Float:
    """(12,) what a look is compared by: mean colour, log power of its luminance in four octaves along x and along y,
    log RMS of its depth. encoded: (64, 64, 3) square root of linear colour. depth: (64, 64) in pixels."""
    plain = np.asarray(encoded, dtype=np.float64)
    level = np.asarray(depth, dtype=np.float64)
    bands = _compute_octave_powers(plain @ LUMINANCE)
    return np.concatenate(
        [3.0 * plain.mean(axis=(0, 1)), np.log10(bands + POWER_FLOOR).ravel(), [np.log10(level.std() + DEPTH_FLOOR)]]
    )


def compute_grey_slopes(view: AppearanceView, grey_m: float) -> Single:
    """(2, 64, 64) slopes of the first sensor's membrane where height = grey_m × luminance."""
    sensor = get_sensor(PAIR_SENSORS[0])
    # Linear in the height: the slope limit of the gel is applied when the map is made.
    slopes = gel_gradients(GREY_HEIGHT_M * (view.rgb.astype(np.float64) @ LUMINANCE), view.pitch_m, sensor)
    return np.asarray(np.stack(slopes) * (grey_m / GREY_HEIGHT_M), dtype=np.float32)


def fit_grey_m(pairs: Pairs) -> float:
    """Learned.grey_m of these pairs."""
    logs = []
    for row in range(len(pairs)):
        rgb = np.square(pairs.rgb[row].astype(np.float32) / np.float32(255.0))
        view = AppearanceView(rgb, np.zeros(rgb.shape[:2], dtype=np.float32), False, float(pairs.pitch_m[row]))
        grey = float(np.sqrt(np.mean(np.square(compute_grey_slopes(view, GREY_HEIGHT_M)))))
        true = float(np.sqrt(np.mean(np.square(pairs.slopes[row, 0].astype(np.float64)))))
        if grey > 0.0 and true > 0.0:
            logs.append(np.log(true / grey))
    return float(GREY_HEIGHT_M * np.exp(np.mean(logs)))


def _compute_octave_powers(luminance: Float) -> Float:
    """(4, 2) share-free power in octaves about 25.6, 12.8, 6.4 and 3.2 pixels, waves nearer to x and nearer to y."""
    size = luminance.shape[0]
    hann = 0.5 - 0.5 * np.cos(2.0 * np.pi * (np.arange(size) + 0.5) / size)
    spectrum = np.abs(np.fft.rfft2((luminance - luminance.mean()) * np.outer(hann, hann))) ** 2 / size**4
    across, down = np.fft.rfftfreq(size)[None, :], np.abs(np.fft.fftfreq(size))[:, None]
    octave = np.log2(np.maximum(np.hypot(across, down), 1e-9) * 25.6)
    sides = (across >= down, across < down)
    return np.array(
        [
            [spectrum[(octave >= band - 0.5) & (octave < band + 0.5) & side].sum() for side in sides]
            for band in range(OCTAVES)
        ]
    )
