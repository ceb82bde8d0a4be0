"""Simple baselines fitted to the training set: most similar view, mean of a class, and grey level as height."""

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
"""Luminance weights of linear RGB, ITU-R BT.709."""
GREY_HEIGHT_M = 1e-5
"""Height of the full grey scale before the fitted factor [m]."""
TOKENS_PER_CLASS = 8
"""Number of tokens stored per class."""
OCTAVES = 4
"""Number of octave bands of the luminance feature."""
POWER_FLOOR = 1e-7
DEPTH_FLOOR = 1e-2


@dataclass(frozen=True)
class NaiveBaselines:
    """Baselines fitted to the training set.

    Attributes
    ----------
    neighbours
        (q, 2, 64, 64) true slopes of the first sensor in the training view most similar to each query.
    tokens
        (m, TOKEN_DIM) tokens of training tiles.
    class_name
        Class of each token, (m,).
    grey_m
        Height of the full grey scale [m]: geometric mean of the values that match each training view's RMS slope.
    views
        Number of training views compared.
    """

    neighbours: Single
    tokens: Single
    class_name: tuple[str, ...]
    grey_m: float
    views: int


def load_training_shards(folder: Path) -> Iterator[Pairs]:
    """Yield the training shards. Raises FileError if there are none or one is damaged."""
    paths = sorted(get_shard_path(folder, TRAIN, 0).parent.glob("[0-9]*.safetensors"))
    if not paths:
        raise FileError("no training pairs here.", where=str(folder), remedy="Make them: tools/make_tactile_pairs.py.")
    for path in paths:
        yield load_shard(path)[0]


def make_shards(tiles: int, seed: int = 0) -> Iterator[Pairs]:
    """Generate a small training set of named classes."""
    named = [order for order in list_tile_requests(TRAIN, PairSizes(train=2 * tiles), seed) if order.class_name]
    yield concatenate_pairs([make_tile(order) for order in named[:tiles]])


def fit_naive_baselines(shards: Iterable[Pairs], queries: Sequence[AppearanceView]) -> NaiveBaselines:
    """Fit the baselines in one pass over the training set.

    The first shard gives the scale of the features and the height of the grey scale. The first TOKENS_PER_CLASS tokens
    of each class are stored.

    Parameters
    ----------
    shards
        Training pairs.
    queries
        Views whose nearest neighbours are searched.

    Raises
    ------
    FileError
        If the training set is empty.
    """
    query_features = np.stack([compute_features(np.sqrt(view.rgb), view.depth_m / view.pitch_m) for view in queries])
    query_pitch = np.array([int(np.argmin(np.abs(np.log(np.array(PITCHES_M) / view.pitch_m)))) for view in queries])
    best = np.full(len(queries), np.inf)
    slopes = np.zeros((len(queries), 2, VIEW_PIXELS, VIEW_PIXELS), dtype=np.float32)
    tokens: dict[str, list[Single]] = {}
    scale: Float | None = None
    grey_m, views = 0.0, 0
    for pairs in shards:
        shard_features = np.stack(
            [
                compute_features(rgb / np.float32(255.0), depth)
                for rgb, depth in zip(pairs.rgb, pairs.depth, strict=True)
            ]
        )
        if scale is None:
            scale, grey_m = shard_features.std(axis=0) + 1e-6, fit_grey_m(pairs)
        distance = np.square((query_features[:, None] - shard_features[None]) / scale).sum(axis=2)
        distance[query_pitch[:, None] != pairs.pitch_index[None]] = np.inf
        nearest = np.argmin(distance, axis=1)
        for query in np.flatnonzero(distance[np.arange(len(query_features)), nearest] < best):
            best[query] = distance[query, nearest[query]]
            slopes[query] = pairs.slopes[nearest[query], 0]
        for name, token in zip(pairs.class_name, pairs.token, strict=True):
            if name and len(tokens.setdefault(name, [])) < TOKENS_PER_CLASS:
                tokens[name].append(token)
        views += len(pairs)
    if scale is None or not tokens:
        raise FileError("the training set is empty.", remedy="Make pairs: tools/make_tactile_pairs.py.")
    names = tuple(name for name, class_tokens in tokens.items() for _ in class_tokens)
    return NaiveBaselines(
        slopes, np.stack([token for class_tokens in tokens.values() for token in class_tokens]), names, grey_m, views
    )


def compute_features(encoded: NDArray[Any], depth: NDArray[Any]) -> Float:
    """Compute the (12,) features by which views are compared.

    They are mean colour, log power of the luminance in four octaves along x and along y, and log RMS of the depth.

    Parameters
    ----------
    encoded
        (64, 64, 3) square root of linear colour.
    depth
        (64, 64) depth [pixels].
    """
    colour = np.asarray(encoded, dtype=np.float64)
    depth_px = np.asarray(depth, dtype=np.float64)
    bands = _compute_octave_powers(colour @ LUMINANCE)
    return np.concatenate(
        [
            3.0 * colour.mean(axis=(0, 1)),
            np.log10(bands + POWER_FLOOR).ravel(),
            [np.log10(depth_px.std() + DEPTH_FLOOR)],
        ]
    )


def compute_grey_slopes(view: AppearanceView, grey_m: float) -> Single:
    """Compute (2, 64, 64) membrane slopes of the first sensor for height = grey_m × luminance."""
    sensor = get_sensor(PAIR_SENSORS[0])
    # Linear in the height, since the gel's slope limit is applied when the map is made.
    slopes = gel_gradients(GREY_HEIGHT_M * (view.rgb.astype(np.float64) @ LUMINANCE), view.pitch_m, sensor)
    return np.asarray(np.stack(slopes) * (grey_m / GREY_HEIGHT_M), dtype=np.float32)


def fit_grey_m(pairs: Pairs) -> float:
    """Return NaiveBaselines.grey_m of these pairs [m]."""
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
    """Return the (4, 2) power in octaves about 25.6, 12.8, 6.4 and 3.2 pixels.

    The second axis separates waves nearer to x and nearer to y.
    """
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
