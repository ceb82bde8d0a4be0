"""Generation of tactile pairs: simulated 20 mm tiles with photograph and touch, cut into views, written to files.

Everything random comes from two seeds: that of the instance, a simulated material (colour, gloss, orientation), and
that of the tile (heights, light, camera, object shape, positions of the views), so that two patches of one instance are
two photographs of the same object. Shards are written in parallel, and a stopped run continues.
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
from ..simulation.appearance import (
    SurfaceAppearance,
    centred_grid,
    compute_ambient_occlusion,
    compute_cavity_depth,
    interpolate_bilinear,
    render_albedo,
    sample_appearance,
    sample_light,
    sample_shape,
    shade_surface,
    simulate_macro_depth,
)
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
"""Pixel size of a tile [m]."""
FACTORS = tuple(round(pitch / PITCH_M) for pitch in PITCHES_M)
"""Decimation factor of each pitch."""
RANDOM_TILE_INTERVAL = 5
"""Interval of random or spliced surfaces with random appearance among the training tiles."""
FIRST_SEED = {TRAIN: 1_000_000, HELD_OUT_INSTANCES: 2_000_000}
"""First instance seed of each split; they are disjoint, and above those that fields are trained and evaluated on."""
HELD_OUT_CLASSES_FIRST_SEED = 3_000_000
"""First instance seed of held-out classes."""
PATCHES_PER_INSTANCE = 2
"""Number of tiles of each held-out instance; the second one gives the error floor of the first."""
RANDOM_SCALE_DECADES = (-1.1, 0.3)
"""Range of the scale of random surfaces [decades]: recipes are rough, silk has 0.2 µm."""
CROSSOVER_WAVELENGTH_M = (0.2e-3, 6e-3)
"""Range of the wavelength at which two random surfaces are spliced [m]. Every second one is, because tokens in use are:
long waves of a measured map with short waves of a library material."""
BLUR_PIXELS = (0.0, 0.6)
"""Range of the camera's blur, standard deviation [view pixels]."""
NOISE = (0.0, 0.012)
"""Range of the camera's noise, standard deviation of linear colour at white."""
EXPOSURE, BALANCE = 0.25, 0.06
"""Half-widths of exposure and white balance of a lit photograph, as natural logarithms."""


@dataclass(frozen=True)
class PairSizes:
    """Amounts of data.

    train: training tiles. instances: held-out materials per class that is trained on. unseen_instances: materials per
    class that is not.
    """

    train: int = 5000
    instances: int = 5
    unseen_instances: int = 12


@dataclass(frozen=True)
class TileRequest:
    """Tile to simulate; a random surface has the class name "" and the instance seed −1."""

    class_name: str
    instance_seed: int
    tile_seed: int
    patch: int = 0


def list_tile_requests(split: str, sizes: PairSizes, seed: int) -> tuple[TileRequest, ...]:
    """List the tiles of a split; no simulated material is in two splits, no held-out class in another split."""
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
    requests: list[TileRequest] = []
    for index in range(sizes.train):
        number, remainder = divmod(index, RANDOM_TILE_INTERVAL)
        if remainder == RANDOM_TILE_INTERVAL - 1:
            requests.append(TileRequest("", -1, derive_seed(f"{seed}/random/{number}")))
        else:
            index_of_class = number * (RANDOM_TILE_INTERVAL - 1) + remainder
            requests.append(
                _make_request(
                    known[index_of_class % len(known)], FIRST_SEED[TRAIN] + index_of_class // len(known), seed, 0
                )
            )
    return tuple(requests)


def _make_request(name: str, instance_seed: int, seed: int, patch: int) -> TileRequest:
    return TileRequest(name, instance_seed, derive_seed(f"{seed}/{name}/{instance_seed}") + patch, patch)


@dataclass(frozen=True)
class RenderedTile:
    """A complete tile under its light, before it is cut into views (512 × 512 pixels of `PITCH_M`).

    Attributes
    ----------
    height : ndarray of float32, shape (H, W)
        Heights [m].
    membranes : ndarray of float32, shape (sensor, 2, H, W)
        Slopes of each touch sensor's gel membrane, in the order of PAIR_SENSORS.
    photograph : ndarray of float32, shape (3, H, W)
        Linear colour, 0 to 1, without camera blur and noise.
    depth : ndarray, shape (64, 64)
        Depth of the object's coarse shape [m].
    token : ndarray of float32, shape (TOKEN_DIM,)
        Material token of the tile.
    mechanics : Mechanics or None
        Stiffness, damping and friction; None for a random surface.
    turn : int
        Orientation, as in `rotate_tile`.
    unlit : bool
        True for a base-colour texture without light.
    rng : numpy.random.Generator
        Random generator, from which views and camera are drawn next.
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
    """Simulate one tile and cut its four views; the same request gives the same bytes on the same numpy."""
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
    """Simulate one tile: its surface, its photograph and its touch."""
    recipe, mechanics, appearance, turn = _sample_surface(request)
    rng = np.random.default_rng([1, request.tile_seed])
    height = _sample_random_height(request, recipe) if not request.class_name else height_map(recipe, request.tile_seed)
    spectrum = np.fft.rfft2(height)
    colour = rotate_tile(render_albedo(recipe, spectrum, appearance, TILE_SIZE_M, rng), turn)
    height = rotate_tile(height, turn)
    spectrum = np.fft.rfft2(height)

    light, shape = sample_light(rng), sample_shape(rng)
    # Light is reflected by the bare surface; only touch is smoothed by the gel.
    surface_slopes = compute_slopes(spectrum, TILE_PIXELS, PITCH_M, 0.0)
    shape_slopes = shape.slopes(*centred_grid(TILE_PIXELS, TILE_SIZE_M))
    image = shade_surface(
        colour,
        surface_slopes[0] + shape_slopes[0],
        surface_slopes[1] + shape_slopes[1],
        light,
        roughness=appearance.roughness,
        metallic=appearance.metallic,
        occlusion=compute_ambient_occlusion(
            compute_cavity_depth(spectrum, TILE_PIXELS, TILE_SIZE_M, appearance.reach_m), appearance.reach_m
        ),
    )
    if not light.unlit:
        image = image * _sample_exposure(image, rng)
    membranes = [compute_membrane_slopes(spectrum, TILE_PIXELS, PITCH_M, SENSORS[name]) for name in PAIR_SENSORS]
    height = np.asarray(height, dtype=np.float32)
    coarse_height = compute_decimation_matrix(FACTORS[0], True) @ height @ compute_decimation_matrix(FACTORS[0], True).T
    return RenderedTile(
        height=height,
        membranes=np.stack([np.stack(pair) for pair in membranes]).astype(np.float32),
        photograph=np.ascontiguousarray(np.moveaxis(np.clip(image, 0.0, 1.0), -1, 0)),
        depth=simulate_macro_depth(coarse_height.astype(np.float64), shape, TILE_SIZE_M, rng),
        token=describe_tile(*membranes[0], SENSORS[PAIR_SENSORS[0]]),
        mechanics=mechanics,
        turn=turn,
        unlit=light.unlit,
        rng=rng,
    )


def _sample_exposure(image: Single, rng: np.random.Generator) -> Single:
    """Draw factors (3,) of exposure and white balance that leave most of the image below overexposure."""
    factors = np.exp(rng.uniform(-EXPOSURE, EXPOSURE) + rng.uniform(-BALANCE, BALANCE, 3))
    sample = image[::8, ::8]
    highlight = float(np.max((sample.mean(axis=(0, 1)) + 2.0 * sample.std(axis=(0, 1))) * factors))
    return np.asarray(factors * min(1.0, 0.95 / max(highlight, 1e-6)), dtype=np.float32)


def _sample_surface(request: TileRequest) -> tuple[SurfaceRecipe, Mechanics | None, SurfaceAppearance, int]:
    """Draw what all tiles of one simulated material share: recipe, mechanics, appearance and orientation."""
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
    second_height = height_map(random_recipe(rng), int(rng.integers(2**31))) * np.float32(
        10.0 ** rng.uniform(*RANDOM_SCALE_DECADES)
    )
    return splice_spectra(height, second_height, 1.0 / float(np.exp(rng.uniform(*np.log(CROSSOVER_WAVELENGTH_M)))))


def splice_spectra(low: Single, high: Single, crossover_per_m: float) -> Single:
    """Combine two height maps: wavelengths longer than 1 / `crossover_per_m` from `low`, shorter ones from `high`."""
    kx, ky = wavenumbers(low.shape[0], TILE_SIZE_M)
    is_long = np.hypot(kx, ky) < crossover_per_m
    spectrum = np.where(is_long, np.fft.rfft2(low), np.fft.rfft2(high))
    return np.fft.irfft2(spectrum, low.shape).astype(np.float32)


def rotate_tile(tile: Single, turn: int) -> Single:
    """Mirror a tile (H, W, …) left to right if turn ≥ 4, then rotate it by turn % 4 quarter turns counter-clockwise."""
    mirrored = tile[:, ::-1] if turn >= 4 else tile
    return np.ascontiguousarray(np.rot90(mirrored, turn % 4))


def compute_slopes(spectrum: Complex, pixels: int, metres_per_pixel: float, sigma_m: float) -> tuple[Float, Float]:
    """Compute ∂h/∂x, ∂h/∂y (H, W) of a periodic tile under a Gaussian blur, from rfft2 of its height.

    sigma_m: width of the blur. As `optics.gel_gradients` without padding, since a tile repeats periodically.
    """
    filter_x, filter_y = _compute_derivative_filters(pixels, metres_per_pixel, sigma_m)
    return (
        np.asarray(np.fft.irfft2(spectrum * filter_x, s=(pixels, pixels))),
        np.asarray(np.fft.irfft2(spectrum * filter_y, s=(pixels, pixels))),
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
    """Compute ∂h/∂x, ∂h/∂y (H, W) of a touch sensor's gel membrane pressed on a periodic height map."""
    gx, gy = compute_slopes(spectrum, pixels, metres_per_pixel, sensor.gel_sigma_m)
    if max(float(np.abs(gx).max()), float(np.abs(gy).max())) < 0.7 * sensor.max_slope:
        return gx, gy
    return limit_slope(gx, gy, sensor.max_slope)


def describe_tile(gx: Float, gy: Float, sensor: Sensor) -> Single:
    """Compute the material token (TOKEN_DIM,) of a tile by the band descriptor, from its membrane slopes."""
    mask = np.ones(gx.shape, dtype=bool)
    return describe(
        TactileMap(shade(gx, gy, sensor), None, mask, PITCH_M, sensor.name, 2 * PITCH_M, Route.MEASURED)
    ).values


@lru_cache(maxsize=16)
def compute_decimation_matrix(factor: int, periodic: bool) -> Single:
    """Return the matrix D (512/factor, 512) that low-passes and decimates the rows of an image by a factor.

    D X Dᵀ decimates an image X, as `tactile.views.decimate_tile`. If not `periodic`, X is continued by reflection at
    its edges (for a photograph; heights are periodic).
    """
    size = TILE_PIXELS if periodic else 2 * TILE_PIXELS
    frequency = np.fft.rfftfreq(size)
    transition = np.clip((2.0 * factor * frequency - PASSBAND_SHARE) / (1.0 - PASSBAND_SHARE), 0.0, 1.0)
    shift = np.exp(2j * np.pi * frequency * (factor - 1) / 2.0)
    response = (0.5 + 0.5 * np.cos(np.pi * transition)) * shift if factor > 1 else np.ones_like(frequency)
    unsampled = np.fft.irfft(np.fft.rfft(np.eye(size), axis=0) * response[:, None], size, axis=0)
    if not periodic:
        unsampled = unsampled[:, :TILE_PIXELS] + unsampled[:, : TILE_PIXELS - 1 : -1]
    matrix = np.ascontiguousarray(unsampled[:TILE_PIXELS:factor], dtype=np.float32)
    matrix.flags.writeable = False
    return matrix


@dataclass(frozen=True)
class _View:
    """One 64 × 64 view of a tile; arrays as in `Pairs`."""

    rgb: NDArray[np.uint8]
    depth: NDArray[np.float16]
    height: NDArray[np.float16]
    slopes: NDArray[np.float16]


def _cut_view(periodic: Single, photograph: Single, depth: Float, factor: int, rng: np.random.Generator) -> _View:
    """Cut a view of 64 × 64 pixels, decimated by `factor`, at a random position; lengths become pixels of the view."""
    row, column = (int(start) for start in rng.integers(0, TILE_PIXELS // factor - VIEW_PIXELS + 1, 2))
    rows, columns = slice(row, row + VIEW_PIXELS), slice(column, column + VIEW_PIXELS)
    pitch = factor * PITCH_M
    height, *slopes = _decimate_window(periodic, factor, rows, columns, True)
    red_green_blue = _decimate_window(photograph, factor, rows, columns, False)
    centres = (np.arange(VIEW_PIXELS) + 0.5) * factor / FACTORS[0] - 0.5
    step = factor / FACTORS[0]
    view_depth = interpolate_bilinear(depth, centres + row * step, centres + column * step) / pitch
    level = height / np.float32(pitch)
    return _View(
        rgb=encode_rgb(simulate_camera(red_green_blue, rng)),
        depth=(view_depth - view_depth.mean()).astype(np.float16),
        height=(level - level.mean()).astype(np.float16),
        slopes=np.reshape(slopes, (len(PAIR_SENSORS), 2, VIEW_PIXELS, VIEW_PIXELS)).astype(np.float16),
    )


def _decimate_window(layers: Single, factor: int, rows: slice, columns: slice, periodic: bool) -> Single:
    if factor == 1:
        return layers[:, rows, columns]
    matrix = compute_decimation_matrix(factor, periodic)
    return np.asarray(matrix[rows] @ layers @ matrix[columns].T)


def simulate_camera(layers: Single, rng: np.random.Generator) -> Single:
    """Convert linear light (3, n, n) to a camera image (n, n, 3), with slight blur and noise like shot noise."""
    sigma, noise = rng.uniform(*BLUR_PIXELS), rng.uniform(*NOISE)
    index = np.arange(layers.shape[-1])
    kernel = np.exp(-0.5 * np.square((index[:, None] - index[None, :]) / max(sigma, 0.05)))
    blur = (kernel / kernel.sum(axis=1, keepdims=True)).astype(np.float32)
    blurred = np.clip(blur @ layers @ blur.T, 0.0, 1.0)
    grain = rng.standard_normal(blurred.shape, dtype=np.float32) * np.sqrt(0.1 + 0.9 * blurred)
    return np.moveaxis(blurred + np.float32(noise) * grain, 0, -1)


def _pack_mechanics(mechanics: Mechanics | None) -> Single:
    known = mechanics or Mechanics()
    values = (known.stiffness_n_m, known.damping_ratio, known.friction)
    return np.array([np.nan if value is None else value for value in values], dtype=np.float32)


TILES_PER_SHARD = 50
"""Number of tiles in a shard."""
RECIPE_VERSION = 1
"""Version of the generation; shards of another version are made again."""
WRITE_ORDER = (HELD_OUT_INSTANCES, HELD_OUT_CLASSES, TRAIN)
"""Splits in the order of writing: the small ones that trainings are validated with come first."""


@dataclass(frozen=True)
class Shard:
    """Content of one file of pairs to write; `shard_count` is the number of such files in its split."""

    path: Path
    requests: tuple[TileRequest, ...]
    shard_count: int
    key: str


def compute_recipe_key(split: str, sizes: PairSizes, seed: int, tiles_per_shard: int = TILES_PER_SHARD) -> str:
    """Return a hash of all generation settings, the same for all shard files of one data set split."""
    return content_hash(repr((RECIPE_VERSION, split, sizes, seed, tiles_per_shard)))


def list_shards(
    folder: Path, split: str, sizes: PairSizes, seed: int, tiles_per_shard: int = TILES_PER_SHARD
) -> tuple[Shard, ...]:
    """List the shards (files of pairs) that make up a split, in order."""
    requests = list_tile_requests(split, sizes, seed)
    starts = range(0, len(requests), tiles_per_shard)
    key = compute_recipe_key(split, sizes, seed, tiles_per_shard)
    return tuple(
        Shard(get_shard_path(folder, split, index), requests[start : start + tiles_per_shard], len(starts), key)
        for index, start in enumerate(starts)
    )


def is_complete(shard: Shard) -> bool:
    """Return True if a shard's file exists, is complete, and was made with the same settings."""
    if not shard.path.is_file():
        return False
    try:
        pairs, shards, key = load_shard(shard.path)
    except FileError:
        return False
    return (pairs.tiles, shards, key) == (len(shard.requests), shard.shard_count, shard.key)


def write_shard(shard: Shard) -> Path:
    """Simulate the tiles of a shard and write its file atomically; the same shard gives the same bytes."""
    for leftover in shard.path.parent.glob(f".{shard.path.stem}-*"):
        leftover.unlink(missing_ok=True)  # of a run that was killed while writing
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
    """Simulate and write the shard files of all three splits (training, two held-out) that are not complete yet.

    Parameters
    ----------
    folder : Path
        Folder of the pairs.
    sizes : PairSizes
        Numbers of tiles.
    seed : int
        Seed of all tiles.
    workers : int
        Number of processes; the bytes do not depend on it, nor on interruptions.
    on_progress : callable
        Called with the finished and the total number of shards after every shard.
    tiles_per_shard : int
        Number of tiles in a shard.

    Returns
    -------
    int
        Number of shards written.

    Raises
    ------
    UsageError
        If a split's folder has shard files that these settings do not give.
    FileError
        If the disk refuses.
    """
    shards = [shard for split in WRITE_ORDER for shard in list_shards(folder, split, sizes, seed, tiles_per_shard)]
    _reject_foreign_shards(shards)
    missing = [shard for shard in shards if not is_complete(shard)]
    done = len(shards) - len(missing)
    on_progress(done, len(shards))
    for _ in _write_shards(missing, workers):
        done += 1
        on_progress(done, len(shards))
    return len(missing)


def _write_shards(shards: Sequence[Shard], workers: int) -> Iterator[Path]:
    if workers <= 1:
        yield from map(write_shard, shards)
        return
    # Each process gets one BLAS thread, because those of several processes would compete for the cores.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        for future in as_completed([pool.submit(write_shard, shard) for shard in shards]):
            yield future.result()


def _reject_foreign_shards(shards: Sequence[Shard]) -> None:
    expected = {shard.path for shard in shards}
    for folder in sorted({shard.path.parent for shard in shards}):
        foreign = sorted(set(folder.glob("[0-9]*.safetensors")) - expected)
        if foreign:
            raise UsageError(
                f"{len(foreign)} shards of another recipe ({foreign[0].name}).",
                where=str(folder),
                remedy="Empty the folder, or choose another one.",
            )
