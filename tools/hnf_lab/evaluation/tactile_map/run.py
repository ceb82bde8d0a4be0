"""Run the comparison of tactile map networks and baselines on held-out tiles.

`MapSetup` names the networks, data and sizes; `measure_maps` returns a `Measurement` with scores by split and method,
times, example maps, and a curve over steps and guidance for a diffusion network.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path

import numpy as np

from hnf_core.datasets.pair_generation import PairSizes, list_tile_requests
from hnf_core.datasets.tactile_pairs import HELD_OUT_CLASSES, HELD_OUT_INSTANCES, PAIR_SENSORS, Pairs
from hnf_core.errors import UsageError
from hnf_core.field.field import Field
from hnf_core.field.weights import load_field
from hnf_core.material.encoder_registry import Encoder, get_default_encoder
from hnf_core.simulation.material_classes import list_classes
from hnf_core.tactile.diffusion import DEFAULT_STEPS
from hnf_core.tactile.tactile_map import Route
from hnf_core.tactile.unet import DIFFUSION, MapConfig, MapWeights
from hnf_core.tactile.views import AppearanceView

from . import score
from .naive_baselines import NaiveBaselines, compute_grey_slopes, fit_naive_baselines, load_training_shards, make_shards
from .score import PREDICTED, ImageScore, Maps, TileResult, score_images, score_spectra
from .tiles import TOKEN_VIEWS, ArrayCache, Arrays, HeldOutTile, Query, load_tiles, predict_tile


@dataclass(frozen=True)
class NetworkEntry:
    """A network under test. name: row of the tables. short_name: title in plots."""

    name: str
    short_name: str
    weights: MapWeights

    @property
    def is_diffusion(self) -> bool:
        return self.weights.config.objective == DIFFUSION


def make_network_entries(main: MapWeights, comparison: MapWeights | None, steps: int) -> tuple[NetworkEntry, ...]:
    """Return the main network and the comparison network, if any, under different names.

    `steps` appears in the names of diffusion networks.

    Raises
    ------
    UsageError
        If both are the same network.
    """
    first = NetworkEntry(_make_name(main.config, steps), main.config.objective, main)
    if comparison is None:
        return (first,)
    if _is_same(main, comparison):
        raise UsageError(
            "both files hold the same weights: there is nothing to compare.",
            remedy="Name another file with --beside, or leave it out.",
        )
    second = NetworkEntry(_make_name(comparison.config, steps), comparison.config.objective, comparison)
    if second.name == first.name:
        second = NetworkEntry(f"{first.name}, other weights", "other weights", comparison)
    return (first, second)


def find_diffusion(entries: Sequence[NetworkEntry]) -> NetworkEntry | None:
    """Return the first network that has steps and guidance, or None."""
    return next((entry for entry in entries if entry.is_diffusion), None)


def _make_name(config: MapConfig, steps: int) -> str:
    return f"{PREDICTED} ({config.objective}{f', {steps} steps' if config.objective == DIFFUSION else ''})"


def _is_same(first: MapWeights, second: MapWeights) -> bool:
    """Return True if both networks have the same configuration and parameters, whatever else the files contain."""
    first_parameters, second_parameters = first.network.parameters, second.network.parameters
    return first.config == second.config and all(
        np.array_equal(first_parameters[name], second_parameters[name]) for name in first_parameters
    )


SPLITS = (HELD_OUT_INSTANCES, HELD_OUT_CLASSES)
ProgressCallback = Callable[[str, int, int], None]
"""Arguments: name of the current step, number of items done, total number."""


@dataclass(frozen=True)
class MapSizes:
    """Sizes of a comparison.

    Attributes
    ----------
    instances, classes
        Number of tiles of held-out instances and of held-out classes.
    varied
        Tiles of each split that are also predicted without depth, without colour and with the other sensor.
    all_pitches
        Tiles of each split whose two intermediate pitches are scored as images too.
    curve
        Tiles of held-out classes for the curve over steps and guidance.
    made
        Number of generated training tiles if there are no stored pairs.
    """

    instances: int = 24
    classes: int = 36
    varied: int = 6
    all_pitches: int = 6
    curve: int = 6
    steps: int = DEFAULT_STEPS
    curve_steps: tuple[int, ...] = (1, 2, 4, 8, 12, 20, 50)
    guidance: tuple[float, ...] = (1.0, 1.5, 2.0)
    made: int = 62


QUICK_SIZES = MapSizes(
    instances=2,
    classes=3,
    varied=1,
    all_pitches=1,
    curve=1,
    steps=8,
    curve_steps=(1, 2, 4, 8),
    guidance=(1.0, 2.0),
    made=12,
)


@dataclass(frozen=True)
class MapSetup:
    """Networks, data and sizes of a comparison.

    Attributes
    ----------
    weights
        Network under test.
    comparison
        Second network, or None.
    data
        Folder of training pairs; None generates a few tiles.
    cache
        Folder of cached arrays, or None.
    """

    weights: MapWeights
    comparison: MapWeights | None = None
    data: Path | None = None
    sizes: MapSizes = field(default_factory=MapSizes)
    seed: int = 0
    cache: Path | None = None

    @property
    def networks(self) -> tuple[NetworkEntry, ...]:
        """Networks under test, the main one first. Raises UsageError if both are the same network."""
        return make_network_entries(self.weights, self.comparison, self.sizes.steps)


@dataclass(frozen=True)
class CurvePoint:
    """Results at one number of steps and one guidance.

    Attributes
    ----------
    results
        Results of the tiles, under score.PREDICTED.
    seconds
        Processor time per patch [s].
    angle_deg
        Mean angle between normals over the views [degrees].
    """

    steps: int
    guidance: float
    results: tuple[TileResult, ...]
    seconds: float
    angle_deg: float


@dataclass(frozen=True)
class Example:
    """A tile to plot, with slopes (views, 2, 64, 64) by method."""

    tile: HeldOutTile
    slopes: Maps


@dataclass(frozen=True)
class Measurement:
    """All results of a comparison.

    Attributes
    ----------
    results, images
        Split → scores.
    curve
        Results over steps and guidance; empty without a diffusion network.
    seconds
        Method → processor time per patch [s].
    training_views
        Number of training views behind the baselines.
    grey_m
        Fitted height of the full grey scale [m].
    """

    results: Mapping[str, tuple[TileResult, ...]]
    images: Mapping[str, tuple[ImageScore, ...]]
    curve: tuple[CurvePoint, ...]
    seconds: Mapping[str, float]
    examples: tuple[Example, ...]
    training_views: int
    grey_m: float
    encoder: str


def measure_maps(setup: MapSetup, watch: ProgressCallback = lambda what, done, total: None) -> Measurement:
    """Compare the networks and baselines on all held-out tiles.

    The same setup gives the same results with the same numpy, except for times.

    Parameters
    ----------
    setup
        Networks, data and sizes.
    watch
        Progress callback.

    Raises
    ------
    FileError
        If pairs or the cache cannot be read.
    UsageError
        If both networks are the same.
    """
    networks, cache, sizes = setup.networks, ArrayCache(setup.cache), setup.sizes
    tiles: dict[str, list[HeldOutTile]] = {}
    for split in SPLITS:
        watch(f"tiles, {split}", len(tiles), len(SPLITS))
        count = sizes.classes if split == HELD_OUT_CLASSES else sizes.instances
        tiles[split] = load_tiles(list_tile_requests(split, PairSizes(), setup.seed), count, cache)
    all_tiles = list(chain.from_iterable(tiles.values()))
    watch("training set", 0, 1)
    baselines = _fit_baselines(setup, all_tiles, cache)
    field_weights, encoder = load_field(), get_default_encoder(Route.PREDICTED)
    results: dict[str, list[TileResult]] = {split: [] for split in SPLITS}
    images: dict[str, list[ImageScore]] = {split: [] for split in SPLITS}
    seconds: dict[str, list[float]] = {}
    examples: list[Example] = []
    done = 0
    for split in SPLITS:
        for index, tile in enumerate(tiles[split]):
            watch(split, done, len(all_tiles))
            maps = _make_maps(
                setup, tile, index, baselines.neighbours[_get_query_rows(done)], baselines.grey_m, cache, seconds
            )
            results[split].append(score_spectra(field_weights, encoder, tile, maps, baselines, networks[0].name))
            images[split] += score_images(tile, maps)
            examples.append(Example(tile, maps))
            done += 1
    curve = _measure_curve(setup, tiles[HELD_OUT_CLASSES][: sizes.curve], field_weights, encoder, cache, watch)
    return Measurement(
        {split: tuple(items) for split, items in results.items()},
        {split: tuple(items) for split, items in images.items()},
        curve,
        {name: float(np.mean(values)) for name, values in seconds.items()},
        tuple(examples[len(tiles[HELD_OUT_INSTANCES]) :]),
        baselines.views,
        baselines.grey_m,
        encoder.name,
    )


def _make_maps(
    setup: MapSetup,
    tile: HeldOutTile,
    index: int,
    neighbours: score.Single,
    grey_m: float,
    cache: ArrayCache,
    seconds: dict[str, list[float]],
) -> Maps:
    first, second = PAIR_SENSORS
    sizes, plain = setup.sizes, Query(steps=setup.sizes.steps)
    networks = {query.name: query.weights for query in setup.networks}
    queries = {name: (weights, plain) for name, weights in networks.items()}
    if index < sizes.varied:
        queries[score.NO_DEPTH] = (setup.weights, replace(plain, depth=False))
        queries[score.NO_COLOUR] = (setup.weights, replace(plain, colour=False))
        queries[score.DIGIT] = (setup.weights, replace(plain, sensor=second))
    maps: dict[str, tuple[str, score.Single]] = {}
    for name, (weights, query) in queries.items():
        prediction = predict_tile(weights, tile, query, setup.seed, cache)
        maps[name] = (query.sensor, prediction.slopes)
        seconds.setdefault(name, []).append(prediction.seconds)
    view_count = TOKEN_VIEWS
    if index < sizes.all_pitches:
        view_count, intermediate_query = len(tile.views), replace(plain, views=(TOKEN_VIEWS, len(tile.views)))
        for name, weights in networks.items():
            intermediate = predict_tile(weights, tile, intermediate_query, setup.seed, cache)
            maps[name] = (first, np.concatenate([maps[name][1], intermediate.slopes]))
    maps[score.NEIGHBOUR] = (first, neighbours[:view_count])
    maps[score.GREY] = (first, np.stack([compute_grey_slopes(view, grey_m) for view in tile.views[:view_count]]))
    maps[score.FLAT] = (first, np.zeros((view_count, *tile.slopes.shape[2:]), dtype=np.float32))
    return maps


def _get_query_rows(tile: int) -> slice:
    return slice(tile * _VIEWS_PER_TILE, (tile + 1) * _VIEWS_PER_TILE)


_VIEWS_PER_TILE = TOKEN_VIEWS + 2


def _fit_baselines(setup: MapSetup, tiles: Sequence[HeldOutTile], cache: ArrayCache) -> NaiveBaselines:
    queries: list[AppearanceView] = [view for tile in tiles for view in tile.views]
    shards: Iterable[Pairs]
    if setup.data is None:
        shards, source = make_shards(setup.sizes.made, setup.seed), f"{setup.sizes.made} made, seed {setup.seed}"
    else:
        shards, source = load_training_shards(setup.data), f"{len(list(setup.data.rglob('*.safetensors')))} shards"
    class_names = list_classes()

    def compute_arrays() -> Arrays:
        baselines = fit_naive_baselines(shards, queries)
        return {
            "neighbours": baselines.neighbours,
            "tokens": baselines.tokens,
            "classes": np.array([class_names.index(name) for name in baselines.class_name]),
            "numbers": np.array([baselines.grey_m, baselines.views], dtype=np.float64),
        }

    arrays = cache.get_or_make(f"learned {source} {[tile.order for tile in tiles]}", compute_arrays)
    grey_m, views = arrays["numbers"]
    names = tuple(class_names[index] for index in arrays["classes"])
    return NaiveBaselines(arrays["neighbours"], arrays["tokens"], names, float(grey_m), int(views))


def _measure_curve(
    setup: MapSetup,
    tiles: Sequence[HeldOutTile],
    field_weights: Field,
    encoder: Encoder,
    cache: ArrayCache,
    watch: ProgressCallback,
) -> tuple[CurvePoint, ...]:
    network = find_diffusion(setup.networks)
    if network is None:
        return ()
    settings = [(steps, 1.0) for steps in setup.sizes.curve_steps]
    settings += [(setup.sizes.steps, each) for each in setup.sizes.guidance if each != 1.0]
    points = []
    for done, (steps, guidance) in enumerate(settings):
        watch("steps and guidance", done, len(settings))
        results, seconds, angles = [], [], []
        for tile in tiles:
            prediction = predict_tile(network.weights, tile, Query(steps=steps, guidance=guidance), setup.seed, cache)
            maps: Maps = {score.PREDICTED: (PAIR_SENSORS[0], prediction.slopes)}
            results.append(score_spectra(field_weights, encoder, tile, maps, None))
            seconds.append(prediction.seconds)
            angles += [each.angle_deg for each in score_images(tile, maps)]
        points.append(CurvePoint(steps, guidance, tuple(results), float(np.mean(seconds)), float(np.mean(angles))))
    return tuple(points)
