"""Evaluate encoders E: errors of single-view tokens, stability of tokens, and the effect on the signal.

`evaluate_encoder` compares the token of one view with that of its complete tile. `describe_samples` and
`compute_stability` measure the change of tokens under shifts, noise, other lamps and another sensor.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.action import Action
from hnf_core.datasets.tactile_pairs import PAIR_SENSORS, Pairs
from hnf_core.field.features import normalise_tokens
from hnf_core.field.field import Field
from hnf_core.material.alexnet_encoder import cut_map_views
from hnf_core.material.contact_model import Mechanics
from hnf_core.material.encoder_registry import Encoder, describe_views
from hnf_core.material.fuse import SIGNIFICANT_DECADES
from hnf_core.material.token import BAND_FEATURES, BAND_WAVELENGTHS_M, LEVELS, SMOOTH_LEVEL, TOKEN_DIM, Token
from hnf_core.simulation.material_classes import derive_seed, sample_instance
from hnf_core.simulation.surface_recipe import TILE_PIXELS, TILE_SIZE_M, height_map
from hnf_core.tactile.optics import Sensor, decode_gradients, gel_gradients, get_sensor, shade
from hnf_core.tactile.tactile_map import Route, TactileMap
from hnf_core.tactile.views import PITCHES_M

from ..evaluation.held_out import KnownMaterial, compute_distance_db, predict_spectrum
from .variation import perturb_sensor

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]

BANDS, WIDTH = len(BAND_WAVELENGTHS_M), len(BAND_FEATURES)
DB_PER_DECADE = 20.0


@dataclass(frozen=True)
class TokenErrors:
    """Errors of tokens; NaN where no view knows a band.

    Attributes
    ----------
    level_db
        (7,) RMS error of the level per band, longest first [dB].
    two_fold, four_fold
        (7,) RMS error of (cos2, sin2) and (cos4, sin4), per component.
    peak, offset
        (7,) RMS error.
    median_level_db
        Median of |error| over all bands [dB].
    """

    level_db: Float
    two_fold: Float
    four_fold: Float
    peak: Float
    offset: Float
    median_level_db: float

    def compute_overall_db(self) -> float:
        """Return the RMS level error over the bands [dB]."""
        return float(np.sqrt(np.nanmean(np.square(self.level_db))))


def make_view_map(pairs: Pairs, row: int, sensor: str) -> TactileMap:
    """Make the tactile map of one view under a sensor's nominal lamps."""
    slopes = pairs.slopes[row, PAIR_SENSORS.index(sensor)].astype(np.float64)
    image = shade(slopes[0], slopes[1], get_sensor(sensor))
    pitch = PITCHES_M[int(pairs.pitch_index[row])]
    mask = np.ones(image.shape[:2], dtype=bool)
    return TactileMap(image, None, mask, pitch, sensor, 2.0 * pitch, Route.PREDICTED, "one view")


def describe_single_views(encoder: Encoder, pairs: Pairs, rows: Sequence[int], sensor: str) -> tuple[Float, Mask]:
    """Return the (n, TOKEN_DIM) tokens of single views, and the masks of their known components."""
    tokens = [encoder.describe(make_view_map(pairs, row, sensor)) for row in rows]
    return (
        np.array([token.values for token in tokens], dtype=np.float64).reshape(-1, TOKEN_DIM),
        np.array([token.known for token in tokens], dtype=bool).reshape(-1, TOKEN_DIM),
    )


def compute_token_errors(tokens: Float, known: Mask, expected: Float) -> TokenErrors:
    """Compare tokens (n, TOKEN_DIM) with those of complete tiles.

    Bands with negligible power in the tile (see fuse) are excluded, with their directions and peaks.
    """
    levels = expected[:, LEVELS]
    strongest = levels.max(axis=1, keepdims=True)
    counts = known[:, LEVELS] & (levels > np.maximum(strongest - SIGNIFICANT_DECADES, SMOOTH_LEVEL + 0.3))
    error = (tokens - expected)[:, : BANDS * WIDTH].reshape(-1, BANDS, WIDTH)
    level = DB_PER_DECADE * error[:, :, 0]

    def rms(values: Float) -> Float:
        total = np.where(counts, np.square(values), 0.0).sum(axis=0)
        number = counts.sum(axis=0)
        return np.asarray(np.sqrt(np.where(number > 0, total / np.maximum(number, 1), np.nan)))

    return TokenErrors(
        rms(level),
        rms(np.hypot(error[:, :, 1], error[:, :, 2]) / np.sqrt(2.0)),
        rms(np.hypot(error[:, :, 3], error[:, :, 4]) / np.sqrt(2.0)),
        rms(error[:, :, 5]),
        rms(error[:, :, 6]),
        float(np.median(np.abs(level[counts]))) if counts.any() else float("nan"),
    )


def evaluate_encoder(
    encoder: Encoder, pairs: Pairs, rows: Sequence[int] | None = None, sensor: str = "gelsight"
) -> TokenErrors:
    """Compute the errors of an encoder on single views.

    Parameters
    ----------
    encoder
        Encoder to test.
    pairs
        Views with true tokens.
    rows
        Views to use; None = all.
    sensor
        Sensor that renders the views.
    """
    chosen = range(len(pairs)) if rows is None else rows
    tokens, known = describe_single_views(encoder, pairs, chosen, sensor)
    return compute_token_errors(tokens, known, pairs.token[pairs.tile_index[np.asarray(chosen)]].astype(np.float64))


def format_errors(errors: TokenErrors) -> str:
    """Format the errors as one line for metadata and terminals."""
    bands = ", ".join(
        f"{wavelength * 1e3:g} mm {level:.1f}"
        for wavelength, level in zip(BAND_WAVELENGTHS_M, errors.level_db, strict=True)
    )
    return (
        f"level {errors.compute_overall_db():.2f} dB RMS (median {errors.median_level_db:.2f}; {bands}), two-fold "
        f"{_compute_rms(errors.two_fold):.3f}, four-fold {_compute_rms(errors.four_fold):.3f}, peak "
        f"{_compute_rms(errors.peak):.3f}, offset "
        f"{_compute_rms(errors.offset):.3f} octaves"
    )


def _compute_rms(values: Float) -> float:
    return float(np.sqrt(np.nanmean(np.square(values))))


PITCH_M = TILE_SIZE_M / TILE_PIXELS
NEAR_VIEWS = 4
"""Number of finest views of a patch, as of a predicted one."""
NOISE_LEVELS = (0.01, 0.02)


@dataclass(frozen=True)
class SurfaceSample:
    """A tile of one instance of a class. height: (512, 512) [m]."""

    name: str
    class_name: str
    mechanics: Mechanics
    height: NDArray[np.float32]


def make_sample(class_name: str, seed: int, patch: int = 0) -> SurfaceSample:
    """Make tile `patch` of instance `seed` of a class."""
    recipe, mechanics = sample_instance(class_name, seed)
    name = f"{class_name}/{seed}"
    return SurfaceSample(name, class_name, mechanics, height_map(recipe, derive_seed(name) + 500 + patch))


@dataclass(frozen=True)
class SensorView:
    """Conditions under which a sample is viewed.

    Attributes
    ----------
    shift_px
        Shift of the tile under the sensor [pixels].
    noise
        Standard deviation of each pixel, full scale 1.
    lamps
        Seed of perturbed lamps unknown to the encoder; None = nominal.
    near_views
        0 = the complete map, else number of near views as in prediction.
    """

    sensor: str = "gelsight"
    shift_px: int = 0
    noise: float = 0.0
    lamps: int | None = None
    near_views: int = 0


def render_maps(sample: SurfaceSample, view: SensorView) -> tuple[TactileMap, ...]:
    """Render the tactile maps of a view of a sample; the noise depends on the sample only.

    Views get their noise after decimation, on their own 64 pixels.
    """
    sensor = get_sensor(view.sensor)
    rng = np.random.default_rng([derive_seed(sample.name), view.lamps or 0])
    actual_sensor = sensor if view.lamps is None else perturb_sensor(sensor, rng)
    height = np.roll(sample.height, (view.shift_px, view.shift_px), axis=(0, 1))
    image = shade(*gel_gradients(height, PITCH_M, sensor), sensor)
    mask = np.ones(image.shape[:2], dtype=bool)
    complete_map = TactileMap(image, None, mask, PITCH_M, view.sensor, 2.0 * PITCH_M, Route.MEASURED, "")
    maps = cut_map_views(complete_map, view.near_views) if view.near_views else (complete_map,)
    return tuple(_perturb(tactile_map, actual_sensor, view.noise, rng) for tactile_map in maps)


def _perturb(tactile_map: TactileMap, actual_sensor: Sensor, noise: float, rng: np.random.Generator) -> TactileMap:
    sensor = get_sensor(tactile_map.sensor)
    image = (
        tactile_map.image
        if actual_sensor is sensor
        else shade(*decode_gradients(tactile_map.image, sensor), actual_sensor)
    )
    if noise:
        image = image + (noise * rng.standard_normal(image.shape)).astype(np.float32)
    return replace(tactile_map, image=image)


def compute_token_distance(first: Token, second: Token) -> float:
    """Return the Euclidean distance of normalised tokens over the components known to both."""
    both = first.known & second.known
    a, b = (normalise_tokens(token.values[None].astype(np.float64))[0] for token in (first, second))
    return float(np.linalg.norm((a - b)[both]))


def compute_level_change_db(first: Token, second: Token) -> float:
    """Return the RMS level difference over the bands known to both [dB]."""
    both = (first.known & second.known)[LEVELS]
    change = 20.0 * (first.values[LEVELS] - second.values[LEVELS])[both]
    return float(np.sqrt(np.mean(np.square(change))))


@dataclass(frozen=True)
class TokenStability:
    """Median token distance, and median RMS change of levels [dB]."""

    token: float
    level_db: float


def describe_samples(encoder: Encoder, samples: Sequence[SurfaceSample], view: SensorView) -> list[Token]:
    """Return the token of every sample in a view."""
    return [describe_views(encoder, render_maps(sample, view)) for sample in samples]


def compute_stability(first: Sequence[Token], second: Sequence[Token]) -> TokenStability:
    """Return the change of the samples' tokens from one view to another."""
    pairs = list(zip(first, second, strict=True))
    return TokenStability(
        float(np.median([compute_token_distance(a, b) for a, b in pairs])),
        float(np.median([compute_level_change_db(a, b) for a, b in pairs])),
    )


def compute_neighbour_distance(tokens: Sequence[Token], samples: Sequence[SurfaceSample]) -> float:
    """Return the median distance of a sample's token to the nearest one of another class."""
    nearest = [
        min(
            compute_token_distance(a, b)
            for b, other in zip(tokens, samples, strict=True)
            if other.class_name != sample.class_name
        )
        for a, sample in zip(tokens, samples, strict=True)
    ]
    return float(np.median(nearest))


def compute_signal_distances_db(
    field: Field,
    action: Action,
    samples: Sequence[SurfaceSample],
    truth: Callable[[SurfaceSample], Token],
    ours: Callable[[SurfaceSample], Token],
) -> Float:
    """Return (n,) average-spectrum distances [dB] expected with the encoder's token and the true one."""
    distances = []
    for sample in samples:
        densities = [
            predict_spectrum(field, KnownMaterial(sample.name, "", token.values, sample.mechanics, np.zeros(0)), action)
            for token in (ours(sample), truth(sample))
        ]
        distances.append(compute_distance_db(densities[0], np.concatenate([np.zeros(1), densities[1], np.zeros(400)])))
    return np.array(distances)
