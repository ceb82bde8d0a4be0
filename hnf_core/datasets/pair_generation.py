"""One tile, photographed and touched: a piece of a material under one light → its four paired views.

Everything random comes from two seeds: the piece's (colour, gloss, how it lies) and the tile's (heights, light,
camera, object shape, where the views are cut), so that two patches of one piece are two photographs of one thing.

Tactile pairs written in shards: in parallel, from a seed, taken up again where a run was stopped.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import FileError, UsageError
from ..files import content_hash
from ..material.band_descriptor import describe
from ..material.contact_model import Mechanics
from ..simulation.appearance.albedo import compute_cavity_depth, render_albedo
from ..simulation.appearance.instance import SurfaceAppearance, sample_appearance
from ..simulation.appearance.macro_depth import centred_grid, interpolate_bilinear, sample_shape, simulate_macro_depth
from ..simulation.appearance.shading import compute_ambient_occlusion, sample_light, shade_surface
from ..simulation.material_classes import CLASS_ENTRIES, derive_seed, get_category, list_classes, sample_instance
from ..simulation.surface_recipe import TILE_PIXELS, TILE_SIZE_M, SurfaceRecipe, height_map, random_recipe, wavenumbers
from ..tactile.fourier_filters import frequencies, gaussian_mtf
from ..tactile.optics import SENSORS, Sensor, limit_slope, shade
from ..tactile.tactile_map import Route, TactileMap
from ..tactile.views import PASSBAND_SHARE, PITCHES_M, VIEW_PIXELS
from .tactile_pairs import (
    HELD_OUT_CLASSES,
    HELD_OUT_INSTANCES,
    PAIR_SENSORS,
    TRAIN,
    UNSEEN_CLASSES,
    Pairs,
    concatenate_pairs,
    encode_rgb,
    get_shard_path,
    load_shard,
    save_shard,
)

Float = NDArray[np.float64]
Single = NDArray[np.float32]
Complex = NDArray[np.complex128]

PITCH_M = TILE_SIZE_M / TILE_PIXELS
FACTORS = tuple(round(pitch / PITCH_M) for pitch in PITCHES_M)
RANDOM_TILE_INTERVAL = 5
"""Every fifth training tile is a random or fused surface with random looks."""
FIRST_SEED = {TRAIN: 1_000_000, HELD_OUT_INSTANCES: 2_000_000}
HELD_OUT_CLASSES_FIRST_SEED = 3_000_000
"""Instance seeds of the splits lie apart, and beyond those that fields are trained and judged on."""
PATCHES_PER_INSTANCE = 2
"""Tiles of each held-out instance; the second is the floor of the first."""
RANDOM_SCALE_DECADES = (-1.1, 0.3)
"""By how much a random surface is scaled, uniformly: recipes are rough, silk is 0.2 µm."""
CROSSOVER_WAVELENGTH_M = (0.2e-3, 6e-3)
"""Every second random surface is fused of two, because tokens in use are: measured long waves of a bake with a library
material's short waves."""
BLUR_PIXELS = (0.0, 0.6)
NOISE = (0.0, 0.012)
"""Of the camera, per view: standard deviations in view pixels, and of linear colour at white."""
EXPOSURE, BALANCE = 0.25, 0.06
"""Of a photograph under light: natural logarithms, half-widths."""


@dataclass(frozen=True)
class PairSizes:
    """train: tiles. instances: of each known class held out. unseen_instances: of each unseen class."""

    train: int = 5000
    instances: int = 5
    unseen_instances: int = 12


@dataclass(frozen=True)
class TileRequest:
    """Which tile to make. class_name: "" for a random surface, instance_seed −1 then."""

    class_name: str
    instance_seed: int
    tile_seed: int
    patch: int = 0


def list_tile_requests(split: str, sizes: PairSizes, seed: int) -> tuple[TileRequest, ...]:
    """All tiles of a split. No instance is in two splits, no class of held-out-classes in another."""
    known = tuple(name for name in list_classes() if name not in UNSEEN_CLASSES)
    if split != TRAIN:
        names, count = (
            (known, sizes.instances) if split == HELD_OUT_INSTANCES else (UNSEEN_CLASSES, sizes.unseen_instances)
        )
        first = FIRST_SEED.get(split, HELD_OUT_CLASSES_FIRST_SEED)
        return tuple(
            _make_request(name, first + number, seed, patch)
            for number in range(count)
            for name in names
            for patch in range(PATCHES_PER_INSTANCE)
        )
    made: list[TileRequest] = []
    for index in range(sizes.train):
        number, rest = divmod(index, RANDOM_TILE_INTERVAL)
        if rest == RANDOM_TILE_INTERVAL - 1:
            made.append(TileRequest("", -1, derive_seed(f"{seed}/random/{number}")))
        else:
            place = number * (RANDOM_TILE_INTERVAL - 1) + rest
            made.append(_make_request(known[place % len(known)], FIRST_SEED[TRAIN] + place // len(known), seed, 0))
    return tuple(made)


def _make_request(name: str, instance_seed: int, seed: int, patch: int) -> TileRequest:
    return TileRequest(name, instance_seed, derive_seed(f"{seed}/{name}/{instance_seed}") + patch, patch)


@dataclass(frozen=True)
class RenderedTile:
    """A whole tile under its light, before it is cut into views (native pitch PITCH_M, 512 × 512).

    height: (H, W) metres. membranes: (sensor, 2, H, W) slopes in the order of PAIR_SENSORS. photograph: (3, H, W)
    linear 0–1, without a camera's blur and noise. depth: (64, 64) macro depth in metres over the whole tile. rng: where
    its random numbers stand.
    """

    height: Single
    membranes: Single
    photograph: Single
    depth: Float
    token: Single
    mechanics: Mechanics | None
    turn: int
    unlit: bool
    rng: np.random.Generator


def make_tile(request: TileRequest) -> Pairs:
    """The four views of one tile. The same order gives the same bytes on the same numpy."""
    tile = render_tile(request)
    periodic = np.concatenate([tile.height[None], tile.membranes.reshape(-1, *tile.height.shape)])
    views = [_cut_view(periodic, tile.photograph, tile.depth, factor, tile.rng) for factor in FACTORS]
    return Pairs(
        rgb=np.stack([view.rgb for view in views]),
        depth=np.stack([view.depth for view in views]),
        height=np.stack([view.height for view in views]),
        slopes=np.stack([view.slopes for view in views]),
        pitch_index=np.arange(len(FACTORS)),
        tile_index=np.zeros(len(FACTORS), dtype=np.int64),
        class_name=(request.class_name,),
        instance_seed=np.array([request.instance_seed]),
        tile_seed=np.array([request.tile_seed]),
        patch=np.array([request.patch]),
        token=tile.token[None],
        mechanics=_pack_mechanics(tile.mechanics)[None],
        turn=np.array([tile.turn]),
        unlit=np.array([tile.unlit]),
    )


def render_tile(request: TileRequest) -> RenderedTile:
    """One tile, made, lit and touched."""
    recipe, mechanics, piece, turn = _sample_surface(request)
    rng = np.random.default_rng([1, request.tile_seed])
    height = _sample_random_height(request, recipe) if not request.class_name else height_map(recipe, request.tile_seed)
    spectrum = np.fft.rfft2(height)
    colour = rotate_tile(render_albedo(recipe, spectrum, piece, TILE_SIZE_M, rng), turn)
    height = rotate_tile(height, turn)
    spectrum = np.fft.rfft2(height)

    light, shape = sample_light(rng), sample_shape(rng)
    # Light meets the surface itself; only touch meets the gel.
    bare = compute_slopes(spectrum, TILE_PIXELS, PITCH_M, 0.0)
    bent = shape.slopes(*centred_grid(TILE_PIXELS, TILE_SIZE_M))
    seen = shade_surface(
        colour,
        bare[0] + bent[0],
        bare[1] + bent[1],
        light,
        roughness=piece.roughness,
        metallic=piece.metallic,
        occlusion=compute_ambient_occlusion(
            compute_cavity_depth(spectrum, TILE_PIXELS, TILE_SIZE_M, piece.reach_m), piece.reach_m
        ),
    )
    if not light.unlit:
        seen = seen * _sample_exposure(seen, rng)
    membranes = [compute_membrane_slopes(spectrum, TILE_PIXELS, PITCH_M, SENSORS[name]) for name in PAIR_SENSORS]
    height = np.asarray(height, dtype=np.float32)
    coarse = compute_decimation_matrix(FACTORS[0], True) @ height @ compute_decimation_matrix(FACTORS[0], True).T
    return RenderedTile(
        height=height,
        membranes=np.stack([np.stack(pair) for pair in membranes]).astype(np.float32),
        photograph=np.ascontiguousarray(np.moveaxis(np.clip(seen, 0.0, 1.0), -1, 0)),
        depth=simulate_macro_depth(coarse.astype(np.float64), shape, TILE_SIZE_M, rng),
        token=describe_tile(*membranes[0], SENSORS[PAIR_SENSORS[0]]),
        mechanics=mechanics,
        turn=turn,
        unlit=light.unlit,
        rng=rng,
    )


def _sample_exposure(image: Single, rng: np.random.Generator) -> Single:
    """(3,) factors of exposure and white balance; no photographer lets the bulk of a picture burn out."""
    factors = np.exp(rng.uniform(-EXPOSURE, EXPOSURE) + rng.uniform(-BALANCE, BALANCE, 3))
    sample = image[::8, ::8]
    bright = float(np.max((sample.mean(axis=(0, 1)) + 2.0 * sample.std(axis=(0, 1))) * factors))
    return np.asarray(factors * min(1.0, 0.95 / max(bright, 1e-6)), dtype=np.float32)


def _sample_surface(request: TileRequest) -> tuple[SurfaceRecipe, Mechanics | None, SurfaceAppearance, int]:
    """What does not change between photographs of one piece."""
    if request.class_name:
        rng = np.random.default_rng([2, derive_seed(request.class_name), request.instance_seed])
        recipe, mechanics = sample_instance(request.class_name, request.instance_seed)
        appearance, category = CLASS_ENTRIES[request.class_name].appearance, get_category(request.class_name)
        return recipe, mechanics, sample_appearance(appearance, category, rng), int(rng.integers(8))
    rng = np.random.default_rng([3, request.tile_seed])
    return random_recipe(rng), None, sample_appearance(None, "", rng), int(rng.integers(8))


def _sample_random_height(request: TileRequest, recipe: SurfaceRecipe) -> Single:
    rng = np.random.default_rng([4, request.tile_seed])
    height = height_map(recipe, request.tile_seed) * np.float32(10.0 ** rng.uniform(*RANDOM_SCALE_DECADES))
    if rng.random() < 0.5:
        return height
    other = height_map(random_recipe(rng), int(rng.integers(2**31))) * np.float32(
        10.0 ** rng.uniform(*RANDOM_SCALE_DECADES)
    )
    return splice_spectra(height, other, 1.0 / float(np.exp(rng.uniform(*np.log(CROSSOVER_WAVELENGTH_M)))))


def splice_spectra(low: Single, high: Single, crossover_per_m: float) -> Single:
    """Waves longer than 1 / border from one tile, shorter ones from another."""
    kx, ky = wavenumbers(low.shape[0], TILE_SIZE_M)
    keep = np.hypot(kx, ky) < crossover_per_m
    spectrum = np.where(keep, np.fft.rfft2(low), np.fft.rfft2(high))
    return np.fft.irfft2(spectrum, low.shape).astype(np.float32)


def rotate_tile(tile: Single, turn: int) -> Single:
    """(H, W, …) mirrored left to right where turn ≥ 4, then turn % 4 quarter turns counter-clockwise as seen."""
    mirrored = tile[:, ::-1] if turn >= 4 else tile
    return np.ascontiguousarray(np.rot90(mirrored, turn % 4))


def compute_slopes(spectrum: Complex, pixels: int, metres_per_pixel: float, sigma_m: float) -> tuple[Float, Float]:
    """∂h/∂x, ∂h/∂y (H, W) of a tile that repeats, under a Gaussian blur; spectrum: rfft2 of its height.

    optics.gel_gradients without its padding: a tile has no edge."""
    across, up = _compute_derivative_filters(pixels, metres_per_pixel, sigma_m)
    return (
        np.asarray(np.fft.irfft2(spectrum * across, s=(pixels, pixels))),
        np.asarray(np.fft.irfft2(spectrum * up, s=(pixels, pixels))),
    )


@lru_cache(maxsize=8)
def _compute_derivative_filters(pixels: int, metres_per_pixel: float, sigma_m: float) -> tuple[Complex, Complex]:
    fx, fy = frequencies((pixels, pixels), metres_per_pixel)
    blurred = 2j * np.pi * gaussian_mtf(np.hypot(fx, fy), sigma_m)
    # The derivative of a real signal has no Nyquist term on an even grid.
    keep_x, keep_y = (np.abs(f) * metres_per_pixel < 0.5 - 1e-9 for f in (fx, fy))
    return np.asarray(blurred * (fx * keep_x)), np.asarray(blurred * (fy * keep_y))


def compute_membrane_slopes(
    spectrum: Complex, pixels: int, metres_per_pixel: float, sensor: Sensor
) -> tuple[Float, Float]:
    """∂h/∂x, ∂h/∂y (H, W) of the sensor's membrane on a tile that repeats."""
    gx, gy = compute_slopes(spectrum, pixels, metres_per_pixel, sensor.gel_sigma_m)
    if max(float(np.abs(gx).max()), float(np.abs(gy).max())) < 0.7 * sensor.max_slope:
        return gx, gy
    return limit_slope(gx, gy, sensor.max_slope)


def describe_tile(gx: Float, gy: Float, sensor: Sensor) -> Single:
    """(TOKEN_DIM,) what the band descriptor says of the whole tile, from its membrane's slopes."""
    seen = np.ones(gx.shape, dtype=bool)
    return describe(
        TactileMap(shade(gx, gy, sensor), None, seen, PITCH_M, sensor.name, 2 * PITCH_M, Route.MEASURED)
    ).values


@lru_cache(maxsize=16)
def compute_decimation_matrix(factor: int, periodic: bool) -> Single:
    """(512/factor, 512) matrix D: D X Dᵀ is tactile.views.decimated_tile of X where the tile repeats; else X is
    continued by reflection at its edges (what is lit on a bent object does not repeat)."""
    size = TILE_PIXELS if periodic else 2 * TILE_PIXELS
    frequency = np.fft.rfftfreq(size)
    place = np.clip((2.0 * factor * frequency - PASSBAND_SHARE) / (1.0 - PASSBAND_SHARE), 0.0, 1.0)
    shift = np.exp(2j * np.pi * frequency * (factor - 1) / 2.0)
    response = (0.5 + 0.5 * np.cos(np.pi * place)) * shift if factor > 1 else np.ones_like(frequency)
    full = np.fft.irfft(np.fft.rfft(np.eye(size), axis=0) * response[:, None], size, axis=0)
    if not periodic:
        full = full[:, :TILE_PIXELS] + full[:, : TILE_PIXELS - 1 : -1]
    kept = np.ascontiguousarray(full[:TILE_PIXELS:factor], dtype=np.float32)
    kept.flags.writeable = False
    return kept


@dataclass(frozen=True)
class _View:
    rgb: NDArray[np.uint8]
    depth: NDArray[np.float16]
    height: NDArray[np.float16]
    slopes: NDArray[np.float16]


def _cut_view(periodic: Single, photograph: Single, depth: Float, factor: int, rng: np.random.Generator) -> _View:
    """One view at a random place (the widest is the whole tile), in units of its own pitch."""
    row, column = (int(start) for start in rng.integers(0, TILE_PIXELS // factor - VIEW_PIXELS + 1, 2))
    rows, columns = slice(row, row + VIEW_PIXELS), slice(column, column + VIEW_PIXELS)
    pitch = factor * PITCH_M
    height, *slopes = _decimate_window(periodic, factor, rows, columns, True)
    red_green_blue = _decimate_window(photograph, factor, rows, columns, False)
    centres = (np.arange(VIEW_PIXELS) + 0.5) * factor / FACTORS[0] - 0.5
    first = factor / FACTORS[0]
    near = interpolate_bilinear(depth, centres + row * first, centres + column * first) / pitch
    level = height / np.float32(pitch)
    return _View(
        rgb=encode_rgb(simulate_camera(red_green_blue, rng)),
        depth=(near - near.mean()).astype(np.float16),
        height=(level - level.mean()).astype(np.float16),
        slopes=np.reshape(slopes, (len(PAIR_SENSORS), 2, VIEW_PIXELS, VIEW_PIXELS)).astype(np.float16),
    )


def _decimate_window(layers: Single, factor: int, rows: slice, columns: slice, periodic: bool) -> Single:
    if factor == 1:
        return layers[:, rows, columns]
    matrix = compute_decimation_matrix(factor, periodic)
    return np.asarray(matrix[rows] @ layers @ matrix[columns].T)


def simulate_camera(layers: Single, rng: np.random.Generator) -> Single:
    """(3, n, n) light → (n, n, 3) picture: a little blur, and noise that grows with light as photons' does."""
    sigma, noise = rng.uniform(*BLUR_PIXELS), rng.uniform(*NOISE)
    place = np.arange(layers.shape[-1])
    kernel = np.exp(-0.5 * np.square((place[:, None] - place[None, :]) / max(sigma, 0.05)))
    blur = (kernel / kernel.sum(axis=1, keepdims=True)).astype(np.float32)
    seen = np.clip(blur @ layers @ blur.T, 0.0, 1.0)
    grain = rng.standard_normal(seen.shape, dtype=np.float32) * np.sqrt(0.1 + 0.9 * seen)
    return np.moveaxis(seen + np.float32(noise) * grain, 0, -1)


def _pack_mechanics(mechanics: Mechanics | None) -> Single:
    given = mechanics or Mechanics()
    values = (given.stiffness_n_m, given.damping_ratio, given.friction)
    return np.array([np.nan if value is None else value for value in values], dtype=np.float32)


TILES_PER_SHARD = 50
RECIPE_VERSION = 1
"""Counts changes of what a tile's order makes; shards of another recipe are made again."""
WRITE_ORDER = (HELD_OUT_INSTANCES, HELD_OUT_CLASSES, TRAIN)
"""What trainings check themselves against comes first: it is small."""


@dataclass(frozen=True)
class Shard:
    """One file's work. shards: how many its split has."""

    path: Path
    requests: tuple[TileRequest, ...]
    shard_count: int
    key: str


def compute_recipe_key(split: str, sizes: PairSizes, seed: int, tiles_per_shard: int = TILES_PER_SHARD) -> str:
    """Equal for shards that belong together."""
    return content_hash(repr((RECIPE_VERSION, split, sizes, seed, tiles_per_shard)))


def list_shards(
    folder: Path, split: str, sizes: PairSizes, seed: int, tiles_per_shard: int = TILES_PER_SHARD
) -> tuple[Shard, ...]:
    """The shards of a split, in order."""
    wanted = list_tile_requests(split, sizes, seed)
    starts = range(0, len(wanted), tiles_per_shard)
    key = compute_recipe_key(split, sizes, seed, tiles_per_shard)
    return tuple(
        Shard(get_shard_path(folder, split, index), wanted[start : start + tiles_per_shard], len(starts), key)
        for index, start in enumerate(starts)
    )


def is_complete(shard: Shard) -> bool:
    """Whether the file is there, whole, and of this recipe."""
    if not shard.path.is_file():
        return False
    try:
        pairs, shards, key = load_shard(shard.path)
    except FileError:
        return False
    return (pairs.tiles, shards, key) == (len(shard.requests), shard.shard_count, shard.key)


def write_shard(shard: Shard) -> Path:
    """Make the tiles and write the file atomically. The same shard gives the same bytes."""
    for left in shard.path.parent.glob(f".{shard.path.stem}-*"):
        left.unlink(missing_ok=True)  # of a run that was killed while it wrote
    save_shard(
        shard.path,
        concatenate_pairs([make_tile(order) for order in shard.requests]),
        shard_count=shard.shard_count,
        key=shard.key,
    )
    return shard.path


def write_pairs(
    folder: Path,
    sizes: PairSizes,
    seed: int,
    workers: int = 1,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
    tiles_per_shard: int = TILES_PER_SHARD,
) -> int:
    """Write whatever of the three splits is not there yet; returns how many shards were written.

    Bytes do not depend on workers, nor on how often the run was stopped. told(done, total): after every shard.
    Raises UsageError where a split's folder holds shards beyond those of this recipe, FileError where the disk refuses.
    """
    everything = [shard for split in WRITE_ORDER for shard in list_shards(folder, split, sizes, seed, tiles_per_shard)]
    _reject_foreign_shards(everything)
    missing = [shard for shard in everything if not is_complete(shard)]
    done = len(everything) - len(missing)
    on_progress(done, len(everything))
    for _ in _write_shards(missing, workers):
        done += 1
        on_progress(done, len(everything))
    return len(missing)


def _write_shards(shards: Sequence[Shard], workers: int) -> Iterator[Path]:
    if workers <= 1:
        yield from map(write_shard, shards)
        return
    # One thread each: BLAS threads of several processes only get in each other's way.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        for future in as_completed([pool.submit(write_shard, shard) for shard in shards]):
            yield future.result()


def _reject_foreign_shards(shards: Sequence[Shard]) -> None:
    expected = {shard.path for shard in shards}
    for folder in sorted({shard.path.parent for shard in shards}):
        strangers = sorted(set(folder.glob("[0-9]*.safetensors")) - expected)
        if strangers:
            raise UsageError(
                f"{len(strangers)} shards of another recipe ({strangers[0].name}).",
                where=str(folder),
                remedy="Empty the folder, or choose another one.",
            )
