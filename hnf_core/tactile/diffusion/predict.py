"""From looks to tactile maps: D_φ at run time, in numpy.

From noise to slopes: the loop around the network, for numpy arrays and torch tensors alike.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import UsageError
from ...threads import available_cpus
from ..height import integrate_gradients
from ..optics import get_sensor, limit_slope, shade
from ..tactile_map import Route, TactileMap
from ..views import VIEW_PIXELS, AppearanceView
from .conditioning import NormalisedAppearance, build_condition, get_pitch_index, normalise_view
from .schedule import ddim_step, log_snr, sampling_steps
from .unet import REGRESSION, forward
from .weights import MapWeights

Velocity = Callable[[Any, Any, float], tuple[Any, Any]]
"""(noisy slopes, noisy level, log-SNR) → v of both."""


def denoise(velocity: Velocity, slopes: Any, level: Any, steps: int) -> tuple[Any, Any]:
    """DDIM (η = 0) from unit noise in slopes and level to a sample of both. Raises UsageError for impossible steps."""
    for before, after in sampling_steps(steps):
        v_slopes, v_level = velocity(slopes, level, float(log_snr(before)))
        slopes = ddim_step(slopes, v_slopes, before, after)
        level = ddim_step(level, v_level, before, after)
    return slopes, level


def apply_guidance(conditional: tuple[Any, Any], unconditional: tuple[Any, Any], guidance: float) -> tuple[Any, Any]:
    """Classifier-free guidance (Ho & Salimans 2022): from what the network says without the look's colour to what it
    says with it, `guidance` times as far."""
    return (
        unconditional[0] + guidance * (conditional[0] - unconditional[0]),
        unconditional[1] + guidance * (conditional[1] - unconditional[1]),
    )


Array = NDArray[np.float32]

DEFAULT_STEPS = 20
"""Of a diffusion; a regression takes one pass."""


def predict_tactile_maps(
    weights: MapWeights,
    views: Sequence[AppearanceView],
    sensor: str,
    *,
    seed: int | Sequence[int],
    steps: int = DEFAULT_STEPS,
    guidance: float = 1.0,
) -> tuple[TactileMap, ...]:
    """The tactile map of every view: what the sensor would show (route PREDICTED).

    Neither a view's neighbours in the batch nor their order matter, equal views give equal maps, and views that differ
    by rounding give maps that differ as little. Weights of a regression, such as the shipped ones, give the conditional
    mean in one pass; seed and steps change nothing. Those of a diffusion give a sample in so many steps: the noise of a
    view is drawn from its seed alone (seed: one for all views, or one each), and the pattern is one of many that suit
    the look; the level starts from the middle of its noise, 0, which DDIM carries to the median of the levels that suit
    it. guidance: 1 = the plain conditional model. height is integrated from the predicted slopes of the membrane (tilt
    and anything longer than the view is not in it). Raises UsageError for an unknown sensor, one that the weights were
    not trained for, a view of another shape or pitch, seeds that are not as many as the views, or impossible steps.
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
    # One view a thread: numpy lets go of the interpreter in its loops and products.
    with ThreadPoolExecutor(min(len(views), available_cpus())) as pool:
        found = list(
            pool.map(lambda view, own: predict_slopes(weights, view, sensor, own, steps, guidance), views, seeds)
        )
    return tuple(_build_tactile_map(slopes, view.pitch_m, sensor) for slopes, view in zip(found, views, strict=True))


def predict_slopes(
    weights: MapWeights,
    view: AppearanceView,
    sensor: str,
    seed: int,
    steps: int = DEFAULT_STEPS,
    guidance: float = 1.0,
    rgb_known: bool = True,
) -> Array:
    """(2, 64, 64) predicted slopes ∂h/∂x, ∂h/∂y of the membrane in one view. rgb_known: False withholds the colours."""
    config = weights.config
    look = normalise_view(view, rgb_known)
    free = normalise_view(view, rgb_known=False) if guidance != 1.0 else None
    pitch, which = np.array([get_pitch_index(view.pitch_m)]), np.array([config.sensors.index(sensor)])

    def once(of: NormalisedAppearance, slopes: Array, level: Array, snr: float) -> tuple[Array, Array]:
        told = build_condition(np.array([snr]), level, pitch, which, len(config.sensors), of.scalars)
        v, v_level = forward(weights.network, np.concatenate([slopes, of.images[0]]), told[0])
        return v, np.array([v_level])

    def velocity(slopes: Array, level: Array, snr: float) -> tuple[Array, Array]:
        # A Python float times float32 stays float32 on numpy 1 and 2 alike; this guards the promise.
        slopes, level = slopes.astype(np.float32, copy=False), level.astype(np.float32, copy=False)
        conditional = once(look, slopes, level, snr)
        return conditional if free is None else apply_guidance(conditional, once(free, slopes, level, snr), guidance)

    if config.objective == REGRESSION:
        empty = np.zeros((2, VIEW_PIXELS, VIEW_PIXELS), dtype=np.float32)
        slopes, level = velocity(empty, np.zeros(1, dtype=np.float32), float(log_snr(0.5)))
    else:
        rng = np.random.default_rng(seed)
        noise = rng.standard_normal((2, VIEW_PIXELS, VIEW_PIXELS), dtype=np.float32)
        slopes, level = denoise(velocity, noise, np.zeros(1, dtype=np.float32), steps)
    # The level holds the scale by definition; what the pattern lost or won on the way is error.
    rms = max(float(np.sqrt(np.mean(slopes**2))), 1e-6)
    return np.asarray(slopes * (10.0 ** (config.level_mean + config.level_scale * float(level[0])) / rms), np.float32)


def _build_tactile_map(slopes: Array, pitch_m: float, sensor: str) -> TactileMap:
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
