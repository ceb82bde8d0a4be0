"""Prediction of tactile maps from images of a patch by the network D_φ, in one pass or by DDIM, with its schedule.

Its input are images of unit contrast, and a condition vector with the scales that were divided out; the same functions
serve training (batches of pairs) and inference (`AppearanceView`), in numpy.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import UsageError
from ..progress import add_work
from ..threads import available_cpus
from .height import integrate_gradients
from .optics import get_sensor, limit_slope, shade
from .tactile_map import Route, TactileMap
from .unet import LOG_SNR_FEATURES, REGRESSION, SCALAR_COUNT, MapWeights, forward
from .views import PITCHES_M, VIEW_PIXELS, AppearanceView

Array = NDArray[np.float32]

LOG_SNR_SCALES = np.geomspace(0.05, 1.5, LOG_SNR_FEATURES // 2)
"""Angular frequencies of the sines and cosines [rad per unit of log-SNR]."""
LOG_SNR_LIMIT = 12.0
"""Largest absolute log-SNR; others are clipped."""
CONTRAST_FLOOR = 1.0 / 1024.0
"""Least RMS contrast that colors are divided by, a quarter of a level of an 8-bit image."""
DEPTH_FLOOR = 1e-2
"""Least RMS depth that depth is divided by [pixels]."""


@dataclass(frozen=True)
class NormalisedAppearance:
    """Appearance (color and depth) of n views, normalized for the network.

    Attributes
    ----------
    images : ndarray of float32, shape (n, 4, 64, 64)
        Three colors (square root of linear) and depth; the colors together, and depth, are less their mean and divided
        by their RMS over the view.
    scalars : ndarray of float32, shape (n, SCALAR_COUNT)
        The means and RMS values that were removed, as logarithms where they are scales (`SCALAR_COUNT` lists them).
    """

    images: Array
    scalars: Array


def normalise_appearance(
    encoded_rgb: Array, depth: Array, depth_known: NDArray[np.bool_], rgb_known: NDArray[np.bool_]
) -> NormalisedAppearance:
    """Normalize the color and depth images of n views to zero mean and unit RMS.

    Parameters
    ----------
    encoded_rgb : ndarray, shape (n, 3, 64, 64)
        Square root of linear colour, 0 to 1.
    depth : ndarray, shape (n, 64, 64)
        Depth [pixels].
    depth_known, rgb_known : ndarray of bool, shape (n,)
        Views with depth and with colour; what is unknown counts as zero, whatever the arrays hold.

    Returns
    -------
    NormalisedAppearance
        The normalized images and the removed means and scales.
    """
    count = len(encoded_rgb)
    images = np.zeros((count, 4, *encoded_rgb.shape[2:]), dtype=np.float32)
    scalars = np.zeros((count, SCALAR_COUNT), dtype=np.float32)
    if rgb_known.any():
        colour = encoded_rgb[rgb_known]
        mean = colour.mean(axis=(2, 3), keepdims=True, dtype=np.float64)
        contrast = np.sqrt(((colour - mean) ** 2).mean(axis=(1, 2, 3), keepdims=True) + CONTRAST_FLOOR**2)
        images[rgb_known, :3] = (colour - mean) / contrast
        scalars[rgb_known, :3] = 2.0 * mean[:, :, 0, 0] - 1.0
        scalars[rgb_known, 3] = np.log10(contrast[:, 0, 0, 0]) + 1.5
        scalars[rgb_known, 6] = 1.0
    if depth_known.any():
        level = depth[depth_known] - depth[depth_known].mean(axis=(1, 2), keepdims=True, dtype=np.float64)
        scale = np.sqrt((level**2).mean(axis=(1, 2), keepdims=True) + DEPTH_FLOOR**2)
        images[depth_known, 3] = level / scale
        scalars[depth_known, 4] = np.log10(scale[:, 0, 0])
        scalars[depth_known, 5] = 1.0
    return NormalisedAppearance(images, scalars)


def normalise_view(view: AppearanceView, rgb_known: bool = True) -> NormalisedAppearance:
    """Normalize the color and depth images of one view; n = 1 in the result."""
    encoded = np.sqrt(np.clip(view.rgb, 0.0, 1.0)).transpose(2, 0, 1)[None].astype(np.float32)
    depth = (view.depth_m / np.float32(view.pitch_m))[None].astype(np.float32)
    return normalise_appearance(encoded, depth, np.array([view.depth_known]), np.array([rgb_known]))


def get_pitch_index(pitch_m: float) -> int:
    """Return the index of a pixel pitch [m] in `PITCHES_M`; raise UsageError for another pitch."""
    index = int(np.argmin(np.abs(np.log(np.asarray(PITCHES_M) / pitch_m)))) if pitch_m > 0 else 0
    if not np.isclose(PITCHES_M[index], pitch_m, rtol=1e-6, atol=0.0):
        raise UsageError(f"no view has a pitch of {pitch_m:g} m.", remedy="Cut views with tactile.views.cut_views.")
    return index


def build_condition(
    log_snr: NDArray[np.float64],
    level: Array,
    pitch_index: NDArray[np.int64],
    sensor_index: NDArray[np.int64],
    sensors: int,
    scalars: Array,
) -> Array:
    """Build the condition vectors of the network for n views.

    Parameters
    ----------
    log_snr : ndarray, shape (n,)
        Log signal-to-noise ratio of the diffusion step.
    level : ndarray of float32, shape (n,)
        Noisy level, the normalized log10 RMS slope.
    pitch_index, sensor_index : ndarray of int, shape (n,)
        Index of each view's pixel pitch in `PITCHES_M`, and of its sensor in the network's list.
    sensors : int
        Number of sensors that the network knows.
    scalars : ndarray of float32, shape (n, SCALAR_COUNT)
        Scalars from `normalise_appearance`.

    Returns
    -------
    ndarray of float32, shape (n, condition_size)
        Sines and cosines of the log-SNR, level, one-hot pitch and sensor, scalars.
    """
    angle = np.clip(log_snr, -LOG_SNR_LIMIT, LOG_SNR_LIMIT)[:, None] * LOG_SNR_SCALES
    features = (np.sin(angle), np.cos(angle), level[:, None], np.eye(len(PITCHES_M))[pitch_index],
             np.eye(sensors)[sensor_index], scalars)  # fmt: skip
    return np.concatenate(features, axis=1, dtype=np.float32)


Velocity = Callable[[Any, Any, float], tuple[Any, Any]]
"""Function from noisy slopes, noisy level (log10 RMS slope) and log-SNR to the predicted v of slopes and level."""


def denoise(velocity: Velocity, slopes: Any, level: Any, steps: int) -> tuple[Any, Any]:
    """Run DDIM (η = 0) from unit noise to a sample, for arrays and tensors alike.

    Parameters
    ----------
    velocity : callable
        Function from (slopes, level, log-SNR) to the predicted v of slopes and level.
    slopes, level : array or tensor
        Initial unit noise of the slopes, and of their level, the normalized log10 RMS slope.
    steps : int
        Number of steps.

    Returns
    -------
    slopes, level : array or tensor
        The denoised sample.

    Raises
    ------
    UsageError
        For an impossible number of steps.
    """
    for before, after in sampling_steps(steps):
        v_slopes, v_level = velocity(slopes, level, float(log_snr(before)))
        slopes = ddim_step(slopes, v_slopes, before, after)
        level = ddim_step(level, v_level, before, after)
    return slopes, level


def apply_guidance(conditional: tuple[Any, Any], unconditional: tuple[Any, Any], guidance: float) -> tuple[Any, Any]:
    """Combine two predictions (slopes, level) by classifier-free guidance (Ho & Salimans 2022).

    Returns the unconditional prediction (without the view's colour) plus `guidance` times the difference to the
    conditional one.
    """
    return (
        unconditional[0] + guidance * (conditional[0] - unconditional[0]),
        unconditional[1] + guidance * (conditional[1] - unconditional[1]),
    )


DEFAULT_STEPS = 20
"""Number of DDIM steps of a diffusion; a regression takes one pass."""


def predict_tactile_maps(
    weights: MapWeights,
    views: Sequence[AppearanceView],
    sensor: str,
    *,
    seed: int | Sequence[int],
    steps: int = DEFAULT_STEPS,
) -> tuple[TactileMap, ...]:
    """Predict the tactile map of every view, marked as Route.PREDICTED.

    Parameters
    ----------
    weights : MapWeights
        Weights of D_φ.
    views : sequence of AppearanceView
        Images of a patch, 64 × 64 pixels each.
    sensor : str
        Name of the sensor to predict.
    seed : int or sequence of int
        Seed of the noise for all views, or one each.
    steps : int
        Number of DDIM steps.

    Returns
    -------
    tuple of TactileMap
        One map per view; its height is integrated from the predicted slopes, without tilt and wavelengths longer than
        the view.

    Raises
    ------
    UsageError
        For an unknown sensor, one that the weights were not trained for, a view of another shape or pitch, a wrong
        number of seeds, or an impossible number of steps.

    Notes
    -----
    A map depends only on its view and seed, not on the other views or their order; views that differ by rounding give
    maps that differ as little. A regression, such as the shipped weights, gives the conditional mean in one pass; seed
    and steps have no effect. A diffusion gives a sample: a pattern that suits the view, one of many. The noise of its
    level (log10 RMS slope) is 0, the mean, which DDIM carries to the median of the suitable levels.
    """
    if get_sensor(sensor).name not in weights.config.sensors:
        raise UsageError(
            f"these weights know {', '.join(weights.config.sensors)}, not {sensor}.", remedy="Choose one of them."
        )
    sampling_steps(steps)
    for view in views:
        _validate_view(view)
    seeds = [seed] * len(views) if isinstance(seed, int) else list(seed)
    if len(seeds) != len(views):
        raise UsageError(f"{len(seeds)} seeds do not fit {len(views)} views.")
    if not views:
        return ()
    # Views run in threads, since numpy releases the interpreter lock in its loops and products.
    threads = min(len(views), available_cpus())
    add_work("threads", threads)
    with ThreadPoolExecutor(threads) as pool:
        predictions = list(
            pool.map(lambda view, view_seed: predict_slopes(weights, view, sensor, view_seed, steps), views, seeds)
        )
    return tuple(
        make_tactile_map(slopes, view.pitch_m, sensor) for slopes, view in zip(predictions, views, strict=True)
    )


def predict_slopes(
    weights: MapWeights,
    view: AppearanceView,
    sensor: str,
    seed: int,
    steps: int = DEFAULT_STEPS,
    guidance: float = 1.0,
    rgb_known: bool = True,
) -> Array:
    """Predict the membrane's slopes ∂h/∂x, ∂h/∂y in one view, (2, 64, 64).

    With `rgb_known=False` the network gets no colors, only depth. `seed` draws the noise, `steps` counts DDIM steps,
    and `guidance` is the strength of classifier-free guidance, 1 for none; a regression network ignores seed and steps.
    """
    config = weights.config
    with_colour = normalise_view(view, rgb_known)
    without_colour = normalise_view(view, rgb_known=False) if guidance != 1.0 else None
    pitch, sensor_index = np.array([get_pitch_index(view.pitch_m)]), np.array([config.sensors.index(sensor)])

    def evaluate(appearance: NormalisedAppearance, slopes: Array, level: Array, snr: float) -> tuple[Array, Array]:
        condition = build_condition(
            np.array([snr]), level, pitch, sensor_index, len(config.sensors), appearance.scalars
        )
        v, v_level = forward(weights.network, np.concatenate([slopes, appearance.images[0]]), condition[0])
        return v, np.array([v_level])

    def velocity(slopes: Array, level: Array, snr: float) -> tuple[Array, Array]:
        # A Python float times float32 stays float32 on numpy 1 and 2; the conversion guards against other input.
        slopes, level = slopes.astype(np.float32, copy=False), level.astype(np.float32, copy=False)
        conditional = evaluate(with_colour, slopes, level, snr)
        return (
            conditional
            if without_colour is None
            else apply_guidance(conditional, evaluate(without_colour, slopes, level, snr), guidance)
        )

    if config.objective == REGRESSION:
        empty = np.zeros((2, VIEW_PIXELS, VIEW_PIXELS), dtype=np.float32)
        slopes, level = velocity(empty, np.zeros(1, dtype=np.float32), float(log_snr(0.5)))
    else:
        rng = np.random.default_rng(seed)
        noise = rng.standard_normal((2, VIEW_PIXELS, VIEW_PIXELS), dtype=np.float32)
        slopes, level = denoise(velocity, noise, np.zeros(1, dtype=np.float32), steps)
    # The level defines the scale, so a change of the pattern's RMS during sampling is an error to be removed.
    rms = max(float(np.sqrt(np.mean(slopes**2))), 1e-6)
    return np.asarray(slopes * (10.0 ** (config.level_mean + config.level_scale * float(level[0])) / rms), np.float32)


def make_tactile_map(slopes: Array, pitch_m: float, sensor: str) -> TactileMap:
    """Make the tactile map of a membrane's slopes (2, H, W), with its height."""
    optics = get_sensor(sensor)
    gx, gy = limit_slope(slopes[0].astype(np.float64), slopes[1].astype(np.float64), optics.max_slope)
    height = integrate_gradients(gx, gy, pitch_m).astype(np.float32)
    mask = np.ones(height.shape, dtype=bool)
    return TactileMap(shade(gx, gy, optics), height, mask, pitch_m, sensor, 2.0 * pitch_m, Route.PREDICTED, "D_φ")


def _validate_view(view: AppearanceView) -> None:
    get_pitch_index(view.pitch_m)
    square = (VIEW_PIXELS, VIEW_PIXELS)
    if view.rgb.shape != (*square, 3) or view.depth_m.shape != square:
        raise UsageError(f"a view must be {square}, not {view.rgb.shape} with depth {view.depth_m.shape}.")
    if not (np.isfinite(view.rgb).all() and np.isfinite(view.depth_m).all()):
        raise UsageError("a view must be finite throughout.", remedy="Cut views with tactile.views.cut_views.")


Float = NDArray[np.float64]

TRAIN_STEPS = 1000
"""Number of noise steps of the schedule in training."""
OFFSET = 0.008
"""Offset s of the cosine schedule, as a fraction of its length (Nichol & Dhariwal 2021)."""
LARGEST_BETA = 0.999
"""Upper limit of β, the noise variance added in one step."""


@lru_cache(maxsize=1)
def alpha_bars() -> Float:
    """Return ᾱ (TRAIN_STEPS,), the fraction of the clean signal's power left after each step of adding noise."""
    progress = np.arange(TRAIN_STEPS + 1) / TRAIN_STEPS
    level = np.cos((progress + OFFSET) / (1.0 + OFFSET) * np.pi / 2.0) ** 2
    betas = np.minimum(1.0 - level[1:] / level[:-1], LARGEST_BETA)
    bars: Float = np.cumprod(1.0 - betas)
    bars.flags.writeable = False
    return bars


def log_snr(alpha_bar: Any) -> Float:
    """Return the log signal-to-noise ratio ln(ᾱ / (1 − ᾱ))."""
    bar = np.asarray(alpha_bar, dtype=np.float64)
    return np.asarray(np.log(bar) - np.log1p(-bar))


def sampling_steps(steps: int) -> tuple[tuple[float, float], ...]:
    """Return (ᾱ before, ᾱ after) of every DDIM step, from pure noise to pure signal (ᾱ = 1 after the last).

    Raises UsageError unless 1 ≤ steps ≤ TRAIN_STEPS.
    """
    if not 1 <= steps <= TRAIN_STEPS:
        raise UsageError(f"{steps} sampling steps.", remedy=f"Choose 1 to {TRAIN_STEPS}.")
    times = np.round(np.arange(TRAIN_STEPS, 0, -TRAIN_STEPS / steps)).astype(int)[:steps] - 1
    before = alpha_bars()[times]
    return tuple((float(a), float(b)) for a, b in zip(before, (*before[1:], 1.0), strict=True))


def noised(x: Any, noise: Any, alpha_bar: Any) -> Any:
    """Return the noisy sample √ᾱ x + √(1 − ᾱ) ε of clean x and unit noise ε, for arrays and tensors alike."""
    return alpha_bar**0.5 * x + (1.0 - alpha_bar) ** 0.5 * noise


def velocity(x: Any, noise: Any, alpha_bar: Any) -> Any:
    """Return the prediction target v = √ᾱ ε − √(1 − ᾱ) x of clean x and unit noise ε, for arrays and tensors alike."""
    return alpha_bar**0.5 * noise - (1.0 - alpha_bar) ** 0.5 * x


def ddim_step(noisy: Any, v: Any, before: float, after: float) -> Any:
    """Take one DDIM step (η = 0) of a noisy sample from ᾱ = before to ᾱ = after, given the predicted v."""
    x = before**0.5 * noisy - (1.0 - before) ** 0.5 * v
    noise = before**0.5 * v + (1.0 - before) ** 0.5 * noisy
    return after**0.5 * x + (1.0 - after) ** 0.5 * noise
