"""The whole report: which tiles, which methods, in which order."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path

import numpy as np

from ...datasets.pair_tiles import PairSizes, orders
from ...datasets.tactile_pairs import HELD_OUT_CLASSES, HELD_OUT_INSTANCES, PAIR_SENSORS, Pairs
from ...field.field import Field
from ...field.weights import load_field
from ...material.encoders import Encoder, default_encoder
from ...simulation.classes import classes
from ...tactile.diffusion.predict import DEFAULT_STEPS
from ...tactile.diffusion.weights import MapWeights
from ...tactile.tactile_map import Route
from ...tactile.views import LookView
from . import judge
from .judge import Maps, Picture, TileResult, judge_pictures, judge_spectra
from .kept import Arrays, Kept
from .learned import Learned, grey_slopes, learn, made_shards, training_shards
from .networks import Network, diffusion_of, networks_of
from .predictions import Asked, predicted
from .tiles import TOKEN_VIEWS, JudgedTile, judged_tiles

SPLITS = (HELD_OUT_INSTANCES, HELD_OUT_CLASSES)
Watch = Callable[[str, int, int], None]
"""(what is being done, how much of it is done, of how many)."""


@dataclass(frozen=True)
class Sizes:
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


QUICK = Sizes(
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
class Setup:
    """weights: what is judged. beside: another network to compare, None = none. data: folder of pairs, None = a few
    training tiles are made."""

    weights: MapWeights
    beside: MapWeights | None = None
    data: Path | None = None
    sizes: Sizes = field(default_factory=Sizes)
    seed: int = 0
    cache: Path | None = None

    @property
    def networks(self) -> tuple[Network, ...]:
        """The main one first. Raises UsageError where both are one network."""
        return networks_of(self.weights, self.beside, self.sizes.steps)


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

    tile: JudgedTile
    slopes: Maps


@dataclass(frozen=True)
class Measured:
    """results, pictures: split → …; curve: empty without a diffusion; seconds: of a patch, by method."""

    results: Mapping[str, tuple[TileResult, ...]]
    pictures: Mapping[str, tuple[Picture, ...]]
    curve: tuple[CurvePoint, ...]
    seconds: Mapping[str, float]
    examples: tuple[Example, ...]
    training_views: int
    grey_m: float
    encoder: str


def measure(setup: Setup, watch: Watch = lambda what, done, total: None) -> Measured:
    """Deterministic: the same setup gives the same figures on the same numpy, times apart. Raises FileError where pairs
    or the cache cannot be read, UsageError where both networks are one."""
    networks, kept, sizes = setup.networks, Kept(setup.cache), setup.sizes
    tiles: dict[str, list[JudgedTile]] = {}
    for split in SPLITS:
        watch(f"tiles, {split}", len(tiles), len(SPLITS))
        count = sizes.classes if split == HELD_OUT_CLASSES else sizes.instances
        tiles[split] = judged_tiles(orders(split, PairSizes(), setup.seed), count, kept)
    every = list(chain.from_iterable(tiles.values()))
    watch("training set", 0, 1)
    learned = _learned(setup, every, kept)
    field_weights, encoder = load_field(), default_encoder(Route.PREDICTED)
    results: dict[str, list[TileResult]] = {split: [] for split in SPLITS}
    pictures: dict[str, list[Picture]] = {split: [] for split in SPLITS}
    seconds: dict[str, list[float]] = {}
    examples: list[Example] = []
    done = 0
    for split in SPLITS:
        for place, tile in enumerate(tiles[split]):
            watch(split, done, len(every))
            maps = _maps(setup, tile, place, learned.neighbours[_rows(done)], learned.grey_m, kept, seconds)
            results[split].append(judge_spectra(field_weights, encoder, tile, maps, learned, networks[0].name))
            pictures[split] += judge_pictures(tile, maps)
            examples.append(Example(tile, maps))
            done += 1
    curve = _curve(setup, tiles[HELD_OUT_CLASSES][: sizes.curve], field_weights, encoder, kept, watch)
    return Measured(
        {split: tuple(own) for split, own in results.items()},
        {split: tuple(own) for split, own in pictures.items()},
        curve,
        {name: float(np.mean(values)) for name, values in seconds.items()},
        tuple(examples[len(tiles[HELD_OUT_INSTANCES]) :]),
        learned.views,
        learned.grey_m,
        encoder.name,
    )


def _maps(
    setup: Setup,
    tile: JudgedTile,
    place: int,
    neighbours: judge.Single,
    grey_m: float,
    kept: Kept,
    seconds: dict[str, list[float]],
) -> Maps:
    first, second = PAIR_SENSORS
    sizes, plain = setup.sizes, Asked(steps=setup.sizes.steps)
    networks = {each.name: each.weights for each in setup.networks}
    asked = {name: (weights, plain) for name, weights in networks.items()}
    if place < sizes.varied:
        asked[judge.NO_DEPTH] = (setup.weights, replace(plain, depth=False))
        asked[judge.NO_COLOUR] = (setup.weights, replace(plain, colour=False))
        asked[judge.DIGIT] = (setup.weights, replace(plain, sensor=second))
    maps: dict[str, tuple[str, judge.Single]] = {}
    for name, (weights, each) in asked.items():
        answer = predicted(weights, tile, each, setup.seed, kept)
        maps[name] = (each.sensor, answer.slopes)
        seconds.setdefault(name, []).append(answer.seconds)
    shown = TOKEN_VIEWS
    if place < sizes.all_pitches:
        shown, rest = len(tile.views), replace(plain, views=(TOKEN_VIEWS, len(tile.views)))
        for name, weights in networks.items():
            between = predicted(weights, tile, rest, setup.seed, kept)
            maps[name] = (first, np.concatenate([maps[name][1], between.slopes]))
    maps[judge.NEIGHBOUR] = (first, neighbours[:shown])
    maps[judge.GREY] = (first, np.stack([grey_slopes(view, grey_m) for view in tile.views[:shown]]))
    maps[judge.FLAT] = (first, np.zeros((shown, *tile.slopes.shape[2:]), dtype=np.float32))
    return maps


def _rows(tile: int) -> slice:
    return slice(tile * _VIEWS, (tile + 1) * _VIEWS)


_VIEWS = TOKEN_VIEWS + 2


def _learned(setup: Setup, tiles: Sequence[JudgedTile], kept: Kept) -> Learned:
    queries: list[LookView] = [view for tile in tiles for view in tile.views]
    shards: Iterable[Pairs]
    if setup.data is None:
        shards, source = made_shards(setup.sizes.made, setup.seed), f"{setup.sizes.made} made, seed {setup.seed}"
    else:
        shards, source = training_shards(setup.data), f"{len(list(setup.data.rglob('*.safetensors')))} shards"
    known = classes()

    def make() -> Arrays:
        found = learn(shards, queries)
        return {
            "neighbours": found.neighbours,
            "tokens": found.tokens,
            "classes": np.array([known.index(name) for name in found.class_name]),
            "numbers": np.array([found.grey_m, found.views], dtype=np.float64),
        }

    arrays = kept.get(f"learned {source} {[tile.order for tile in tiles]}", make)
    grey_m, views = arrays["numbers"]
    names = tuple(known[index] for index in arrays["classes"])
    return Learned(arrays["neighbours"], arrays["tokens"], names, float(grey_m), int(views))


def _curve(
    setup: Setup, tiles: Sequence[JudgedTile], field_weights: Field, encoder: Encoder, kept: Kept, watch: Watch
) -> tuple[CurvePoint, ...]:
    network = diffusion_of(setup.networks)
    if network is None:
        return ()
    wanted = [(steps, 1.0) for steps in setup.sizes.curve_steps]
    wanted += [(setup.sizes.steps, each) for each in setup.sizes.guidance if each != 1.0]
    points = []
    for done, (steps, guidance) in enumerate(wanted):
        watch("steps and guidance", done, len(wanted))
        results, seconds, angles = [], [], []
        for tile in tiles:
            answer = predicted(network.weights, tile, Asked(steps=steps, guidance=guidance), setup.seed, kept)
            maps: Maps = {judge.PREDICTED: (PAIR_SENSORS[0], answer.slopes)}
            results.append(judge_spectra(field_weights, encoder, tile, maps, None))
            seconds.append(answer.seconds)
            angles += [each.angle_deg for each in judge_pictures(tile, maps)]
        points.append(CurvePoint(steps, guidance, tuple(results), float(np.mean(seconds)), float(np.mean(angles))))
    return tuple(points)
