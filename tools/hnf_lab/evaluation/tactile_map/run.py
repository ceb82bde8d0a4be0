"""The networks that are judged, and what they are called: the main one, and another beside it.

The whole report: which tiles, which methods, in which order.
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
from hnf_core.tactile.diffusion.predict import DEFAULT_STEPS
from hnf_core.tactile.diffusion.unet import DIFFUSION, MapConfig
from hnf_core.tactile.diffusion.weights import MapWeights
from hnf_core.tactile.tactile_map import Route
from hnf_core.tactile.views import AppearanceView

from . import score
from .naive_baselines import NaiveBaselines, compute_grey_slopes, fit_naive_baselines, load_training_shards, make_shards
from .score import PREDICTED, ImageScore, Maps, TileResult, score_images, score_spectra
from .tiles import TOKEN_VIEWS, ArrayCache, Arrays, HeldOutTile, Query, load_tiles, predict_tile


@dataclass(frozen=True)
class NetworkEntry:
    """name: of its row. short: the same above a picture."""

    name: str
    short_name: str
    weights: MapWeights

    @property
    def is_diffusion(self) -> bool:
        return self.weights.config.objective == DIFFUSION


def make_network_entries(main: MapWeights, comparison: MapWeights | None, steps: int) -> tuple[NetworkEntry, ...]:
    """Both under different names, the main one first. beside: None = none. steps: of those that are a diffusion.

    Raises UsageError where both are one network.
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
    """The first that has steps and guidance."""
    return next((each for each in entries if each.is_diffusion), None)


def _make_name(config: MapConfig, steps: int) -> str:
    return f"{PREDICTED} ({config.objective}{f', {steps} steps' if config.objective == DIFFUSION else ''})"


def _is_same(first: MapWeights, second: MapWeights) -> bool:
    """By what they compute, whatever else is in the files."""
    ours, theirs = first.network.parameters, second.network.parameters
    return first.config == second.config and all(np.array_equal(ours[name], theirs[name]) for name in ours)


SPLITS = (HELD_OUT_INSTANCES, HELD_OUT_CLASSES)
ProgressCallback = Callable[[str, int, int], None]
"""(what is being done, how much of it is done, of how many)."""


@dataclass(frozen=True)
class MapSizes:
    """instances, classes: tiles of held-out instances and of held-out classes. varied: of each, how many with depth or
    colour withheld and with the other sensor. all_pitches: of each, judged as pictures in the two pitches between as
    well. curve: of the held-out classes, over steps and guidance of a diffusion. made: training tiles made on the fly
    where there are no pairs."""

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
    """weights: what is judged. beside: another network to compare, None = none. data: folder of pairs, None = a few
    training tiles are made."""

    weights: MapWeights
    comparison: MapWeights | None = None
    data: Path | None = None
    sizes: MapSizes = field(default_factory=MapSizes)
    seed: int = 0
    cache: Path | None = None

    @property
    def networks(self) -> tuple[NetworkEntry, ...]:
        """The main one first. Raises UsageError where both are one network."""
        return make_network_entries(self.weights, self.comparison, self.sizes.steps)


@dataclass(frozen=True)
class CurvePoint:
    """results: of the tiles, under judge.PREDICTED. seconds: of processor time a patch. angle_deg: mean over views."""

    steps: int
    guidance: float
    results: tuple[TileResult, ...]
    seconds: float
    angle_deg: float


@dataclass(frozen=True)
class Example:
    """One tile as pictures: what was seen, and slopes (views, 2, 64, 64) by method, the truth among them."""

    tile: HeldOutTile
    slopes: Maps


@dataclass(frozen=True)
class Measurement:
    """results, pictures: split → …; curve: empty without a diffusion; seconds: of a patch, by method."""

    results: Mapping[str, tuple[TileResult, ...]]
    images: Mapping[str, tuple[ImageScore, ...]]
    curve: tuple[CurvePoint, ...]
    seconds: Mapping[str, float]
    examples: tuple[Example, ...]
    training_views: int
    grey_m: float
    encoder: str


def measure_maps(setup: MapSetup, watch: ProgressCallback = lambda what, done, total: None) -> Measurement:
    """Deterministic: the same setup gives the same figures on the same numpy, times apart. Raises FileError where pairs
    or the cache cannot be read, UsageError where both networks are one."""
    networks, kept, sizes = setup.networks, ArrayCache(setup.cache), setup.sizes
    tiles: dict[str, list[HeldOutTile]] = {}
    for split in SPLITS:
        watch(f"tiles, {split}", len(tiles), len(SPLITS))
        count = sizes.classes if split == HELD_OUT_CLASSES else sizes.instances
        tiles[split] = load_tiles(list_tile_requests(split, PairSizes(), setup.seed), count, kept)
    every = list(chain.from_iterable(tiles.values()))
    watch("training set", 0, 1)
    learned = _fit_baselines(setup, every, kept)
    field_weights, encoder = load_field(), get_default_encoder(Route.PREDICTED)
    results: dict[str, list[TileResult]] = {split: [] for split in SPLITS}
    pictures: dict[str, list[ImageScore]] = {split: [] for split in SPLITS}
    seconds: dict[str, list[float]] = {}
    examples: list[Example] = []
    done = 0
    for split in SPLITS:
        for place, tile in enumerate(tiles[split]):
            watch(split, done, len(every))
            maps = _make_maps(
                setup, tile, place, learned.neighbours[_get_query_rows(done)], learned.grey_m, kept, seconds
            )
            results[split].append(score_spectra(field_weights, encoder, tile, maps, learned, networks[0].name))
            pictures[split] += score_images(tile, maps)
            examples.append(Example(tile, maps))
            done += 1
    curve = _measure_curve(setup, tiles[HELD_OUT_CLASSES][: sizes.curve], field_weights, encoder, kept, watch)
    return Measurement(
        {split: tuple(own) for split, own in results.items()},
        {split: tuple(own) for split, own in pictures.items()},
        curve,
        {name: float(np.mean(values)) for name, values in seconds.items()},
        tuple(examples[len(tiles[HELD_OUT_INSTANCES]) :]),
        learned.views,
        learned.grey_m,
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
    networks = {each.name: each.weights for each in setup.networks}
    asked = {name: (weights, plain) for name, weights in networks.items()}
    if index < sizes.varied:
        asked[score.NO_DEPTH] = (setup.weights, replace(plain, depth=False))
        asked[score.NO_COLOUR] = (setup.weights, replace(plain, colour=False))
        asked[score.DIGIT] = (setup.weights, replace(plain, sensor=second))
    maps: dict[str, tuple[str, score.Single]] = {}
    for name, (weights, each) in asked.items():
        answer = predict_tile(weights, tile, each, setup.seed, cache)
        maps[name] = (each.sensor, answer.slopes)
        seconds.setdefault(name, []).append(answer.seconds)
    shown = TOKEN_VIEWS
    if index < sizes.all_pitches:
        shown, rest = len(tile.views), replace(plain, views=(TOKEN_VIEWS, len(tile.views)))
        for name, weights in networks.items():
            between = predict_tile(weights, tile, rest, setup.seed, cache)
            maps[name] = (first, np.concatenate([maps[name][1], between.slopes]))
    maps[score.NEIGHBOUR] = (first, neighbours[:shown])
    maps[score.GREY] = (first, np.stack([compute_grey_slopes(view, grey_m) for view in tile.views[:shown]]))
    maps[score.FLAT] = (first, np.zeros((shown, *tile.slopes.shape[2:]), dtype=np.float32))
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
    known = list_classes()

    def make() -> Arrays:
        found = fit_naive_baselines(shards, queries)
        return {
            "neighbours": found.neighbours,
            "tokens": found.tokens,
            "classes": np.array([known.index(name) for name in found.class_name]),
            "numbers": np.array([found.grey_m, found.views], dtype=np.float64),
        }

    arrays = cache.get_or_make(f"learned {source} {[tile.order for tile in tiles]}", make)
    grey_m, views = arrays["numbers"]
    names = tuple(known[index] for index in arrays["classes"])
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
    wanted = [(steps, 1.0) for steps in setup.sizes.curve_steps]
    wanted += [(setup.sizes.steps, each) for each in setup.sizes.guidance if each != 1.0]
    points = []
    for done, (steps, guidance) in enumerate(wanted):
        watch("steps and guidance", done, len(wanted))
        results, seconds, angles = [], [], []
        for tile in tiles:
            answer = predict_tile(network.weights, tile, Query(steps=steps, guidance=guidance), setup.seed, cache)
            maps: Maps = {score.PREDICTED: (PAIR_SENSORS[0], answer.slopes)}
            results.append(score_spectra(field_weights, encoder, tile, maps, None))
            seconds.append(answer.seconds)
            angles += [each.angle_deg for each in score_images(tile, maps)]
        points.append(CurvePoint(steps, guidance, tuple(results), float(np.mean(seconds)), float(np.mean(angles))))
    return tuple(points)
