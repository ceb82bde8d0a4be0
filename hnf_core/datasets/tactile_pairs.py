"""Pairs of photograph and touch: views with colour and coarse depth, and their height and touch-sensor slopes.

The pairs train the network that predicts tactile maps. One tile (a 20 mm square of a simulated material, photographed
once) gives one view at each of the four pixel sizes of `tactile.views`; `pair_generation.py` makes and writes them to
files, the shards.
"""

from __future__ import annotations

import io
import json
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FileError, UsageError
from ..files import write_bytes
from ..safetensors_io import dump_tensors, load_tensors
from ..simulation.material_classes import get_category, list_classes
from ..tactile.views import PITCHES_M

FORMAT = "hnf-tactile-pairs-1"
TRAIN, HELD_OUT_INSTANCES, HELD_OUT_CLASSES = SPLITS = ("train", "held-out-instances", "held-out-classes")
"""Names of the splits."""
PAIR_SENSORS = ("gelsight", "digit")
"""Names in `tactile.optics.SENSORS` of the second axis of `Pairs.slopes`."""
UNSEEN_CLASSES = tuple({get_category(name): name for name in list_classes()}.values())
"""Last class of every category in the table; used in held-out-classes only, as by the field's held-out weights."""
_REMEDY = "Make the pairs again: tools/make_tactile_pairs.py continues where it stopped."


@dataclass(frozen=True)
class Pairs:
    """n views cut from t tiles (20 mm squares of a simulated surface); columns run along +x, rows along −y.

    Lengths are in units of the view's pitch (pixel size), so that one network serves all four pitches.

    Attributes
    ----------
    rgb : ndarray of uint8, shape (n, 64, 64, 3)
        round(255 √linear), for `decode_rgb`.
    depth : ndarray of float16, shape (n, 64, 64)
        Depth of the object's coarse shape less its mean, growing away from the viewer.
    height : ndarray of float16, shape (n, 64, 64)
        Height less its mean.
    slopes : ndarray of float16, shape (n, 2, 2, 64, 64)
        Slopes of a touch sensor's gel membrane [PAIR_SENSORS][∂h/∂x, ∂h/∂y] (y up); gel blur and slope limit are
        applied at the tile's full resolution, then decimated.
    pitch_index : ndarray of int64, shape (n,)
        Index in PITCHES_M.
    tile_index : ndarray of int64, shape (n,)
        Row of the tile's properties below.
    class_name : tuple of str, length t
        Material class, "" for a random surface.
    instance_seed : ndarray of int64, shape (t,)
        Seed of `material_classes.sample_instance`, −1 for a random surface.
    tile_seed : ndarray of int64, shape (t,)
        Seed of the heights.
    patch : ndarray of int64, shape (t,)
        0 or 1, number of the tile of one simulated material; the two differ by tile seed, light and camera only.
    token : ndarray of float32, shape (t, TOKEN_DIM)
        Material token of the complete tile, by the band descriptor (octave-band statistics).
    mechanics : ndarray of float32, shape (t, 3)
        Stiffness [N/m], damping ratio, friction; NaN if unknown.
    turn : ndarray of int64, shape (t,)
        0–7: quarter turns counter-clockwise, + 4 if mirrored (left to right) before.
    unlit : ndarray of bool, shape (t,)
        True for a base-colour texture without light.
    """

    rgb: NDArray[np.uint8]
    depth: NDArray[np.float16]
    height: NDArray[np.float16]
    slopes: NDArray[np.float16]
    pitch_index: NDArray[np.int64]
    tile_index: NDArray[np.int64]
    class_name: tuple[str, ...]
    instance_seed: NDArray[np.int64]
    tile_seed: NDArray[np.int64]
    patch: NDArray[np.int64]
    token: NDArray[np.float32]
    mechanics: NDArray[np.float32]
    turn: NDArray[np.int64]
    unlit: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.rgb)

    @property
    def tiles(self) -> int:
        """Number of tiles."""
        return len(self.class_name)

    @property
    def pitch_m(self) -> NDArray[np.float64]:
        """Pixel size (n,) of each view [m]."""
        return np.asarray(PITCHES_M)[self.pitch_index]


_ARRAYS = tuple(field.name for field in fields(Pairs) if field.name != "class_name")


def decode_rgb(encoded: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Decode `Pairs.rgb` to linear colour, 0 to 1."""
    return np.asarray(np.square(encoded.astype(np.float32) / np.float32(255.0)))


def encode_rgb(linear: NDArray[Any]) -> NDArray[np.uint8]:
    """Encode linear colour, clipped to 0 to 1, as `Pairs.rgb`."""
    return np.asarray(np.rint(255.0 * np.sqrt(np.clip(linear, 0.0, 1.0))), dtype=np.uint8)


PHOTOGRAPH_CHANCE = 0.8
"""Probability that a picture varies in any one of the ways of `vary_photograph`."""
LARGEST_ZOOM = 2.0**0.5
"""Largest factor by which a photograph's scale is misjudged, either way."""
JPEG_QUALITY = (25, 95)
"""Range of the quality of JPEG."""


def vary_photograph(views: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """Return views (n, h, w, 3) of one picture, encoded as `Pairs.rgb`, as another camera may have taken and kept it.

    Drawn once for all views, each with `PHOTOGRAPH_CHANCE`: a scale misjudged by up to `LARGEST_ZOOM`, exposure and
    white balance, saturation, tone curve, light that falls off to one side, blur, and JPEG. Not the touch: whatever
    varies here tells nothing of it.
    """
    layers = views.astype(np.float32) / np.float32(255.0)
    draws = iter(rng.random(7) < PHOTOGRAPH_CHANCE)
    if next(draws):
        layers = _zoom(layers, float(LARGEST_ZOOM ** rng.uniform(-1.0, 1.0)))
    if next(draws):  # Encoded colours are square roots, so the factors are too.
        layers = layers * np.exp(rng.uniform(-0.3, 0.15) + rng.uniform(-0.12, 0.12, 3)).astype(np.float32)
    if next(draws):
        grey = layers.mean(axis=-1, keepdims=True)
        layers = grey + np.float32(rng.uniform(0.3, 1.5)) * (layers - grey)
    if next(draws):
        layers = np.clip(layers, 0.0, 1.0) ** np.float32(np.exp(rng.uniform(-0.4, 0.4)))
    if next(draws):
        size = layers.shape[1:3]
        slope, angle = rng.uniform(0.0, 0.5), rng.uniform(0.0, 2.0 * np.pi)
        y, x = np.meshgrid(*(np.linspace(-1.0, 1.0, n) for n in size), indexing="ij")
        layers = layers * np.exp(slope * (np.cos(angle) * x + np.sin(angle) * y) / 2.0).astype(np.float32)[..., None]
    if next(draws):
        layers = _blur(layers, float(rng.uniform(0.2, 1.2)))
    encoded = np.rint(255.0 * np.clip(layers, 0.0, 1.0)).astype(np.uint8)
    if next(draws):
        quality = int(rng.integers(*JPEG_QUALITY))
        encoded = np.stack([_pass_through_jpeg(view, quality) for view in encoded])
    return np.asarray(encoded, dtype=np.uint8)


def _zoom(layers: NDArray[np.float32], factor: float) -> NDArray[np.float32]:
    """Enlarge images (n, h, w, c) about their centre by a factor; what is missing at their edges is mirrored."""
    for axis in (1, 2):
        size = layers.shape[axis]
        position = (np.arange(size) - (size - 1) / 2.0) / factor + (size - 1) / 2.0
        low = np.floor(position).astype(int)
        share = (position - low).astype(np.float32).reshape((-1,) + (1,) * (3 - axis))
        first, second = (np.take(layers, _mirror(index, size), axis=axis) for index in (low, low + 1))
        layers = (1.0 - share) * first + share * second
    return np.asarray(layers, dtype=np.float32)


def _mirror(index: NDArray[np.intp], size: int) -> NDArray[np.intp]:
    folded = np.abs(index) % (2 * size - 2)
    return np.minimum(folded, 2 * size - 2 - folded)


def _blur(layers: NDArray[np.float32], sigma: float) -> NDArray[np.float32]:
    """Blur images (n, h, w, c) by a Gaussian of `sigma` pixels."""
    kernels = []
    for size in layers.shape[1:3]:
        index = np.arange(size)
        kernel = np.exp(-0.5 * np.square((index[:, None] - index[None, :]) / sigma))
        kernels.append((kernel / kernel.sum(axis=1, keepdims=True)).astype(np.float32))
    blurred = np.einsum("ij,njkc,lk->nilc", kernels[0], layers, kernels[1], optimize=True)
    return np.asarray(blurred, dtype=np.float32)


def _pass_through_jpeg(image: NDArray[np.uint8], quality: int) -> NDArray[np.uint8]:
    try:
        import PIL.Image
    except ImportError as error:
        raise FileError(f"JPEG needs Pillow ({error}).", remedy="Install it.") from error
    buffer = io.BytesIO()
    PIL.Image.fromarray(image).save(buffer, "JPEG", quality=quality)
    return np.asarray(PIL.Image.open(buffer))


def concatenate_pairs(chunks: list[Pairs]) -> Pairs:
    """Concatenate pairs, with `tile_index` shifted; raise UsageError if there are none."""
    if not chunks:
        raise UsageError("there are no pairs to join.")
    arrays = {name: np.concatenate([getattr(chunk, name) for chunk in chunks]) for name in _ARRAYS}
    first = np.cumsum([0, *(chunk.tiles for chunk in chunks[:-1])])
    arrays["tile_index"] = arrays["tile_index"] + np.repeat(first, [len(chunk) for chunk in chunks])
    return Pairs(class_name=tuple(name for chunk in chunks for name in chunk.class_name), **arrays)


def get_shard_path(folder: Path, split: str, index: int) -> Path:
    """Return the path of a shard (a file with part of a split's pairs); raise UsageError for an unknown split."""
    if split not in SPLITS:
        raise UsageError(f"no split is called {split!r}.", remedy=f"Choose one of {', '.join(SPLITS)}.")
    return folder / split / f"{index:04d}.safetensors"


def save_shard(path: Path, pairs: Pairs, *, shard_count: int, key: str) -> None:
    """Write a shard (a file with part of a split's pairs) atomically; equal pairs give equal bytes.

    Parameters
    ----------
    path : Path
        The file.
    pairs : Pairs
        Its content.
    shard_count : int
        Number of shards in the split.
    key : str
        Hash of all generation settings (recipe), so that shards of different recipes are never mixed.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    metadata = {"format": FORMAT, "shards": str(shard_count), "key": key, "class_name": json.dumps(pairs.class_name)}
    tensors = {name: np.ascontiguousarray(getattr(pairs, name)) for name in _ARRAYS}
    write_bytes(path, dump_tensors(tensors, metadata))


def load_shard(path: Path) -> tuple[Pairs, int, str]:
    """Load a shard file: its pairs, the number of shards in its split, and the recipe's key; raise FileError."""
    try:
        tensors, metadata = load_tensors(path.read_bytes())
        if metadata.get("format") != FORMAT:
            raise ValueError(f"format {metadata.get('format')!r}, not {FORMAT!r}")
        arrays = {name: tensors[name] for name in _ARRAYS}
        pairs = Pairs(class_name=tuple(json.loads(metadata["class_name"])), **arrays)
        shards, key = int(metadata["shards"]), metadata["key"]
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise FileError(f"no readable shard of tactile pairs ({error}).", where=str(path), remedy=_REMEDY) from error
    return pairs, shards, key


def load_pairs(folder: Path, split: str, *, partial: bool = False) -> Pairs:
    """Load the pairs of a complete split (training or held-out) into memory, about 60 kB a view.

    Parameters
    ----------
    folder : Path
        Folder of the pairs.
    split : str
        Name of the split.
    partial : bool
        Accept an incomplete split.

    Returns
    -------
    Pairs
        The pairs.

    Raises
    ------
    FileError
        If shards are missing, damaged or of different recipes.
    UsageError
        For an unknown split.
    """
    paths = sorted(get_shard_path(folder, split, 0).parent.glob("[0-9]*.safetensors"))
    if not paths:
        raise FileError("no tactile pairs here.", where=str(folder / split), remedy=_REMEDY)
    loaded = [load_shard(path) for path in paths]
    recipes = {(shards, key) for _, shards, key in loaded}
    if len(recipes) > 1:
        raise FileError("shards of different recipes.", where=str(folder / split), remedy="Empty the folder first.")
    shards = loaded[0][1]
    if not partial and len(paths) != shards:
        raise FileError(f"{len(paths)} of {shards} shards.", where=str(folder / split), remedy=_REMEDY)
    return concatenate_pairs([pairs for pairs, _, _ in loaded])
