"""One space for looks and the touch of two sensors: texture statistics, two small heads, and tuples to find in it.

A view of 64 pixels, a photograph's or a touch sensor's, becomes `STATISTICS_COUNT` numbers that do not depend on where
in the view a texture lies: powers in bands of frequency and direction, how channels agree, lines, moments, and how the
energies of octaves go together (as in the texture model of Portilla & Simoncelli 2000). A head of three layers takes
them to a unit vector; heads are trained by contrast (`hnf train alignment`), so that a look, a GelSight's and a DIGIT's
picture of one surface become neighbors. A file holds both heads and GelSight tuples of the training data, with their
materials and tokens: what a picture finds among them is its *bridged* token.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError, UsageError
from ..files import write_bytes
from ..safetensors_io import WeightsKind, dump_tensors, read_weights
from ..tactile.optics import get_sensor
from ..tactile.tactile_map import TactileMap
from ..tactile.views import PITCHES_M, VIEW_PIXELS, cut_views
from .alexnet_encoder import cut_map_views
from .fuse import merge_tokens
from .token import TOKEN_DIM, Token

Single = NDArray[np.float32]
Rows = NDArray[np.int64]

SECTOR_COUNT = 8
"""Number of directions of waves over half a circle."""
BAND_COUNT = 10
"""Number of bands of frequency, half an octave each, up to the Nyquist frequency."""
OCTAVE_COUNT = 4
"""Number of octaves whose energies are compared."""
CHANNEL_PAIRS = ((0, 1), (0, 2), (1, 2))
STATISTICS_COUNT = (
    3 * (4 + BAND_COUNT * SECTOR_COUNT)
    + 2 * len(CHANNEL_PAIRS) * BAND_COUNT
    + BAND_COUNT
    + VIEW_PIXELS // 2
    + 2 * OCTAVE_COUNT
    + OCTAVE_COUNT * (OCTAVE_COUNT + 1) // 2
)
"""Number of statistics of a view."""
LOOK_FLOOR, TOUCH_FLOOR = 0.02, 0.001
"""Contrast that counts as none, of the square root of colour and of a touch image less its background."""


@dataclass(frozen=True)
class _Bands:
    """Weights of the bins (P · (P/2 + 1),) of a half spectrum in each band, window and octave filters."""

    cells: Single
    rings: Single
    circles: Single
    members: NDArray[np.bool_]
    window: Single
    octaves: Single


def compute_texture_statistics(images: Single, floor: float) -> Single:
    """Compute the statistics (n, STATISTICS_COUNT) of views (n, 64, 64, 3), float32.

    images: square root of linear colour, or touch images less their background. floor: `LOOK_FLOOR` or `TOUCH_FLOOR`.
    """
    count = len(images)
    bands = _get_bands()
    channels = np.ascontiguousarray(np.moveaxis(images, -1, 1), dtype=np.float32)
    mean = channels.mean(axis=(2, 3))
    centred = channels - mean[:, :, None, None]
    square = centred * centred
    deviation = np.sqrt(square.mean(axis=(2, 3))) + np.float32(0.1 * floor)
    skewness = (square * centred).mean(axis=(2, 3)) / deviation**3
    square *= square
    kurtosis = np.log(square.mean(axis=(2, 3)) / deviation**4 + 1e-3)

    spectrum = np.fft.rfft2(centred * bands.window).astype(np.complex64) / np.float32(VIEW_PIXELS)
    flat = spectrum.reshape(count, 3, -1)
    power = flat.real**2 + flat.imag**2
    least = np.float32(0.05 * floor**2)
    cells = np.log(power @ bands.cells + least).reshape(count, -1)
    rings = power @ bands.rings + np.float32(0.2) * least
    agreement = []
    for first, second in CHANNEL_PAIRS:
        product, size = flat[:, first] * np.conj(flat[:, second]), np.sqrt(rings[:, first] * rings[:, second])
        agreement += [(product.real @ bands.rings) / size, (product.imag @ bands.rings) / size]
    total = power.sum(axis=1)
    strongest = np.stack([total[:, member].max(axis=1) for member in bands.members], axis=1)
    lines = np.log(strongest + least) - np.log(total @ bands.rings + least)
    circles = np.log(total @ bands.circles + least)

    grey, shape, energies = spectrum.sum(axis=1), [], []
    for octave in bands.octaves:
        wave = np.fft.irfft2(grey * octave, s=(VIEW_PIXELS, VIEW_PIXELS)).astype(np.float32)
        square = wave * wave
        variance = square.mean(axis=(1, 2)) + np.float32(0.2) * least
        shape += [(square * wave).mean(axis=(1, 2)) / variance**1.5]
        shape += [np.log((square * square).mean(axis=(1, 2)) / variance**2 + np.float32(0.1))]
        energies.append(np.log(square + np.float32(0.1) * variance[:, None, None]).reshape(count, -1))
    energy = np.stack(energies, axis=1)
    energy -= energy.mean(axis=2, keepdims=True)
    together = (energy @ energy.transpose(0, 2, 1) / energy.shape[2])[:, *np.triu_indices(OCTAVE_COUNT)]
    parts = [mean, np.log(deviation), skewness, kurtosis, cells, *agreement, lines, circles, np.stack(shape, 1)]
    return np.asarray(np.concatenate([*parts, together], axis=1), dtype=np.float32)


@lru_cache(maxsize=1)
def _get_bands() -> _Bands:
    size = VIEW_PIXELS
    fy, fx = np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None, :]
    frequency, angle = np.hypot(fx, fy), np.mod(np.arctan2(-fy + 0.0 * fx, fx + 0.0 * fy), np.pi)
    # The half spectrum holds a wave and its conjugate once, but both of them on its first and last column.
    weight = np.where((fx == 0.0) | (fx == 0.5), 0.5, 1.0) * np.ones_like(frequency)
    octave = np.log2(np.maximum(frequency, 1e-9))
    centres = np.log2(0.5) - 0.5 * np.arange(BAND_COUNT)[::-1]
    rings = np.stack([np.clip(1.0 - 2.0 * np.abs(octave - centre), 0.0, 1.0) for centre in centres])
    rings[-1][octave > centres[-1]] = 1.0
    rings *= weight
    step = np.pi / SECTOR_COUNT
    turned = np.mod(angle[None] - step * np.arange(SECTOR_COUNT)[:, None, None] + np.pi / 2.0, np.pi) - np.pi / 2.0
    cells = rings[:, None] * np.clip(1.0 - np.abs(turned) / step, 0.0, 1.0)[None]
    circles = np.stack([(np.abs(frequency * size - k) < 0.5) * weight for k in range(1, size // 2 + 1)])
    middles = np.log2(0.5) - 0.5 - np.arange(OCTAVE_COUNT)
    octaves = np.stack([np.sqrt(np.clip(1.0 - np.abs(octave - middle), 0.0, 1.0)) for middle in middles])
    hann = np.hanning(size + 2)[1:-1]
    window = np.outer(hann, hann)

    def normalise(bins: NDArray[np.float64]) -> Single:
        table = bins.reshape(-1, frequency.size)
        return np.ascontiguousarray((table / np.maximum(table.sum(axis=1, keepdims=True), 1e-9)).T, dtype=np.float32)

    return _Bands(
        normalise(cells), normalise(rings), normalise(circles), (rings > 0.3).reshape(BAND_COUNT, -1),
        (window / np.sqrt(np.mean(window**2))).astype(np.float32), octaves.astype(np.float32),
    )  # fmt: skip


EMBEDDING_SIZE = 128
"""Dimensions of the space."""
LARGEST_STATISTIC = 6.0
"""Limit of a standardised statistic, in standard deviations."""
LAYERS = ("0", "1", "2")


@dataclass(frozen=True)
class Head:
    """Three layers from statistics to a unit vector.

    tensors: "mean" and "scale" (STATISTICS_COUNT,) of the statistics, and of layers 0, 1 and 2 the "weight" (outputs,
    inputs) and "bias" (outputs,).
    """

    tensors: Mapping[str, Single]

    def embed(self, statistics: Single) -> Single:
        """Return the unit vectors (n, EMBEDDING_SIZE) of statistics (n, STATISTICS_COUNT)."""
        x = np.clip((statistics - self.tensors["mean"]) / self.tensors["scale"], -LARGEST_STATISTIC, LARGEST_STATISTIC)
        for layer in LAYERS:
            x = x @ self.tensors[f"{layer}.weight"].T + self.tensors[f"{layer}.bias"]
            if layer != LAYERS[-1]:
                x = np.maximum(x, 0.0)
        return np.asarray(x / np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-12), dtype=np.float32)


HEADS = ("vision", "touch")


@dataclass(frozen=True)
class SharedSpace:
    """Heads of looks and of touch, and the GelSight tuples that are found.

    Attributes
    ----------
    heads
        Of "vision" and "touch".
    points
        (n, EMBEDDING_SIZE) touch embeddings of the tuples.
    pitch_index, tile_index
        (n,) scale of each tuple, in PITCHES_M, and its tile.
    tokens
        (t, TOKEN_DIM) of the tiles.
    materials
        Name of each tile's material, length t.
    """

    heads: Mapping[str, Head]
    points: Single = field(repr=False)
    pitch_index: Rows = field(repr=False)
    tile_index: Rows = field(repr=False)
    tokens: Single = field(repr=False)
    materials: tuple[str, ...] = field(repr=False)
    metadata: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))


SPACE_FORMAT = "hnf-shared-space-1"
_SPACE_KIND = WeightsKind(
    "the shared space", SPACE_FORMAT, "this is no space of looks and touch", "Make one: hnf train alignment."
)


def save_space(path: Path, space: SharedSpace) -> None:
    """Write a space in half precision, atomically; raise FileError if that fails."""
    tensors = {
        f"{name}.{key}": value.astype(np.float32 if key in ("mean", "scale") else np.float16)
        for name, head in space.heads.items()
        for key, value in head.tensors.items()
    }
    tensors |= {
        "points": space.points.astype(np.float16), "tokens": space.tokens.astype(np.float32),
        "pitch_index": space.pitch_index.astype(np.float16), "tile_index": space.tile_index.astype(np.float32),
    }  # fmt: skip
    metadata = {**space.metadata, "format": SPACE_FORMAT, "materials": json.dumps(space.materials)}
    write_bytes(path, dump_tensors({name: np.ascontiguousarray(value) for name, value in tensors.items()}, metadata))


def load_space(path: Path) -> SharedSpace:
    """Load a space.

    Raises
    ------
    FileError
        If there is no such file.
    WeightsError
        If it is damaged or of another format.
    """
    file = read_weights(path, _SPACE_KIND)

    def read_materials(metadata: Mapping[str, str]) -> tuple[str, ...]:
        return tuple(str(name) for name in json.loads(metadata["materials"]))

    materials = file.parse_metadata(read_materials)
    stored = {name: value.shape for name, value in file.tensors.items()}
    count, hidden = (stored.get(name, (0,))[0] for name in ("points", "vision.0.bias"))
    sizes = (STATISTICS_COUNT, hidden, hidden, EMBEDDING_SIZE)
    shapes: dict[str, tuple[int, ...]] = {
        "points": (count, EMBEDDING_SIZE), "pitch_index": (count,), "tile_index": (count,),
        "tokens": (len(materials), TOKEN_DIM),
    }  # fmt: skip
    for head in HEADS:
        shapes |= {f"{head}.{key}": (STATISTICS_COUNT,) for key in ("mean", "scale")}
        for index, layer in enumerate(LAYERS):
            shapes[f"{head}.{layer}.weight"] = (sizes[index + 1], sizes[index])
            shapes[f"{head}.{layer}.bias"] = (sizes[index + 1],)
    tensors = file.check_parameters(shapes)
    pitch, tile = (tensors[name].astype(np.int64) for name in ("pitch_index", "tile_index"))
    if not count or not _is_index(pitch, len(PITCHES_M)) or not _is_index(tile, len(materials)):
        raise file.make_error("its tuples are not numbered right.")
    heads = {
        head: Head(
            {key.removeprefix(f"{head}."): value for key, value in tensors.items() if key.startswith(f"{head}.")}
        )
        for head in HEADS
    }
    if any((head.tensors["scale"] <= 0.0).any() for head in heads.values()):
        raise file.make_error("a scale is not positive.")
    return SharedSpace(heads, tensors["points"], pitch, tile, tensors["tokens"], materials, file.metadata)


def _is_index(values: Rows, size: int) -> bool:
    return bool(((values >= 0) & (values < size)).all())


NEIGHBOURS = 10
"""Number of tuples that each view of a picture finds."""
NEIGHBOUR_TEMPERATURE = 0.07
"""Divisor of the cosines in the weights of what is found, as in training."""
FINE_VIEWS = 16
"""Largest number of views at the finest scale that a picture is cut into."""


@dataclass(frozen=True)
class SpaceMatch:
    """Tuples that a picture finds in a space.

    Attributes
    ----------
    views
        Number of views that were looked up.
    materials
        (name, share) of the found tuples, the largest share first; shares sum to 1.
    tuples
        (material, pitch [m], cosine) of the nearest tuples, the nearest first.
    token
        Bridged token: mean over the found tuples.
    """

    views: int
    materials: tuple[tuple[str, float], ...]
    tuples: tuple[tuple[str, float, float], ...]
    token: Token


def find_touch(space: SharedSpace, tactile_map: TactileMap) -> SpaceMatch:
    """Find the GelSight tuples nearest to a touch map of either sensor; raise SceneError if it has no view."""
    views = cut_map_views(tactile_map, FINE_VIEWS)
    background = get_sensor(tactile_map.sensor).background
    images = [np.asarray(view.image - background, dtype=np.float32) for view in views]
    return _find(space, "touch", images, [view.metres_per_pixel for view in views], TOUCH_FLOOR)


def find_look(space: SharedSpace, rgb: Single, metres_per_pixel: float) -> SpaceMatch:
    """Find the GelSight tuples nearest to a photograph (H, W, 3), linear colour; raise SceneError if it has no view."""
    views = cut_views(rgb, None, None, metres_per_pixel, 2.0 * metres_per_pixel, fine_count=FINE_VIEWS)
    images = [np.sqrt(np.clip(view.rgb, 0.0, 1.0), dtype=np.float32) for view in views]
    return _find(space, "vision", images, [view.pitch_m for view in views], LOOK_FLOOR)


def _find(
    space: SharedSpace, head: str, images: Sequence[Single], pitches_m: Sequence[float], floor: float
) -> SpaceMatch:
    if not images:
        raise SceneError(
            "the picture holds no view that the space knows.",
            remedy=f"It needs {1e3 * VIEW_PIXELS * PITCHES_M[-1]:g} mm of surface, at {1e3 * PITCHES_M[0]:.2g} mm a "
            "pixel or finer.",
        )
    queries = space.heads[head].embed(compute_texture_statistics(np.stack(images), floor))
    pitch_index = [int(np.argmin(np.abs(np.log(np.asarray(PITCHES_M) / pitch)))) for pitch in pitches_m]
    found: list[tuple[float, float, int]] = []
    for query, pitch in zip(queries, pitch_index, strict=True):
        rows = np.flatnonzero(space.pitch_index == pitch)
        if not len(rows):
            continue
        cosines = space.points[rows] @ query
        nearest = np.argsort(-cosines, kind="stable")[:NEIGHBOURS]
        weights = np.exp((cosines[nearest] - cosines[nearest[0]]) / NEIGHBOUR_TEMPERATURE)
        weights /= weights.sum()
        found += [(float(cosines[i]), float(w), int(rows[i])) for i, w in zip(nearest, weights, strict=True)]
    if not found:
        raise UsageError("the space has no tuples of the picture's scale.", remedy="Train one on all scales.")
    shares: dict[str, float] = {}
    weight_of_tile: dict[int, float] = {}
    for _, weight, row in found:
        tile = int(space.tile_index[row])
        weight_of_tile[tile] = weight_of_tile.get(tile, 0.0) + weight
        name = space.materials[tile]
        shares[name] = shares.get(name, 0.0) + weight / len(queries)
    known = np.ones(TOKEN_DIM, dtype=bool)
    token = merge_tokens([Token(space.tokens[tile], known) for tile in weight_of_tile], [*weight_of_tile.values()])
    nearest_tuples = sorted(found, reverse=True)[:NEIGHBOURS]
    return SpaceMatch(
        len(images),
        tuple(sorted(shares.items(), key=lambda item: -item[1])),
        tuple(
            (space.materials[space.tile_index[row]], PITCHES_M[space.pitch_index[row]], cosine)
            for cosine, _, row in nearest_tuples
        ),
        token,
    )
