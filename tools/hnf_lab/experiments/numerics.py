"""Measure the table of docs/numerics.md: worst errors of temporal rendering, its gradients and long synthesis.

  Usage: python -m hnf_lab.experiments.numerics    (about 3 minutes on one core; needs the extras "train" and "test")

Every figure is computed here, against mpmath with 50 digits or an independent computation. Further rows show the
precision that each stage needs: numbers stored or computed in narrower types against float64. The product is not
changed: inputs of a stage are rounded to the type and back, and F_Θ's layers are computed in the type by their torch
twin.
"""

from __future__ import annotations

import argparse
import resource
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import mpmath as mp
import numpy as np
import torch
from numpy.typing import NDArray

from hnf_core.action.synthetic_actions import make_random_smooth_action, make_steady_action
from hnf_core.actuators.limiter import Limiter
from hnf_core.actuators.profile import GENERIC
from hnf_core.field.contact.lattice_lines import LINE_GAIN_COUNT, compute_line_power
from hnf_core.field.features import Inputs, build_inputs
from hnf_core.field.field import LOG_AMPLITUDE_CEILING, Emission, Field, accumulate
from hnf_core.field.linear_contact import Condition
from hnf_core.field.prepare import prepare_stroke
from hnf_core.field.render import render_block
from hnf_core.field.render_weights import render, render_weights
from hnf_core.field.resampling import resample
from hnf_core.field.stroke import StrokeInput, build_condition, resample_action, uniform_stroke
from hnf_core.field.synthesis import synthesise
from hnf_core.field.weights import load_field
from hnf_core.material.band_descriptor import describe
from hnf_core.material.contact_model import Mechanics, height_response
from hnf_core.material.library import load_library
from hnf_core.material.probe import get_probe
from hnf_core.material.token import LEVELS
from hnf_core.metrics.spectra import welch
from hnf_core.scene.mesh import TriangleMesh
from hnf_core.tactile.diffusion import predict_slopes
from hnf_core.tactile.height import tactile_map_from_height
from hnf_core.tactile.unet import build_unet, load_map_weights
from hnf_core.tactile.views import PITCHES_M, VIEW_PIXELS, AppearanceView
from hnf_core.training.model import FieldNetwork
from hnf_core.training.model import render_weights as twin
from reference.every_state import prepare_every_state
from reference.geometry import ReferenceGeometry
from reference.literal_synthesis import synthesise_reference

Float = NDArray[np.float64]

NARROW_TYPES = (torch.float16, torch.bfloat16, torch.float32)
PRECISION_HEADER = (
    "stage",
    "kept or computed in the type",
    *(str(each).removeprefix("torch.") for each in NARROW_TYPES),
)


def round_to_type(values: Float, dtype: torch.dtype) -> Float:
    """Round values to the type and return them as float64."""
    return torch.tensor(np.asarray(values), dtype=torch.float64).to(dtype).double().numpy()


def compute_error_db(found: Float, exact: Float) -> float:
    """Return the power of the difference over that of `exact` [dB]."""
    with np.errstate(divide="ignore"):
        return float(10.0 * np.log10(np.sum(np.square(found - exact)) / np.sum(np.square(exact))))


def measure_precision(field: Field) -> Iterator[tuple[str, ...]]:
    """Yield one row per stage, with cells as in PRECISION_HEADER."""
    stroke = make_example_stroke()
    yield "ray cast", "vertices, origins, directions; 1 m", *(measure_ray_error(dtype) for dtype in NARROW_TYPES)
    yield "E", "the sensor image", *(measure_token_error(dtype) for dtype in NARROW_TYPES)
    for rounded in ("its picture", "its weights"):
        yield "D_φ", rounded, *(measure_map_error(dtype, rounded) for dtype in NARROW_TYPES)
    yield (
        "linear contact",
        "stiffness, damping, force, frequency",
        *(measure_contact_error(dtype) for dtype in NARROW_TYPES),
    )
    exact = evaluate_in_type(field, stroke, torch.float64)
    signal = synthesise_emission(field, stroke, exact)
    emissions = [evaluate_in_type(field, stroke, dtype) for dtype in NARROW_TYPES]
    yield (
        "F_Θ",
        "layers and heads computed",
        *(f"{compute_error_db(item.alpha, exact.alpha):.0f} dB" for item in emissions),
    )
    signals = [synthesise_emission(field, stroke, item) for item in emissions]
    yield (
        "synthesis, end to end",
        "layers and heads computed",
        *(f"{compute_error_db(item, signal):.0f} dB" for item in signals),
    )
    coarse = [replace(stroke, tokens=round_to_type(stroke.tokens, dtype).astype(np.float32)) for dtype in NARROW_TYPES]
    signals = [synthesise_emission(field, item, evaluate_in_type(field, item, torch.float64)) for item in coarse]
    errors_db = [compute_error_db(item, signal) for item in signals]
    yield "synthesis, end to end", "the token", *(format_db(error_db) for error_db in errors_db)
    yield (
        "resampler, 10 to 48 kHz",
        "the signal",
        *(format_db(measure_resampling_error(signal, dtype)) for dtype in NARROW_TYPES),
    )
    yield "limiter, generic coil", "the signal", *(measure_counts_error(signal, dtype) for dtype in NARROW_TYPES)


def format_db(off_db: float) -> str:
    return f"{off_db:.0f} dB" if off_db > -np.inf else "what it is"


def make_example_stroke(seconds: float = 2.0) -> StrokeInput:
    """Make a wandering stroke on the library's first material."""
    entry = load_library()[0]
    action = make_random_smooth_action(seconds, 0, speed_m_s=(0.03, 0.3), force_n=(0.3, 2.0))
    return uniform_stroke(action, entry.token, entry.mechanics)


def evaluate_in_type(field: Field, stroke: StrokeInput, dtype: torch.dtype) -> Emission:
    """Evaluate F_Θ at every state of a stroke, with layers and heads in the type and the rest in float64."""
    config, condition = field.config, build_condition(stroke, *resample_action(stroke))
    inputs = build_field_inputs(field, condition)
    network = FieldNetwork(config, field.parameters).to(dtype)
    with torch.no_grad():
        head, sigma_dt = network.evaluate_heads(torch.tensor(inputs.x).to(dtype))
    return Emission(compute_amplitudes(field, head.double().numpy(), inputs), sigma_dt.double().numpy())


def compute_amplitudes(field: Field, alpha: Float, inputs: Inputs) -> Float:
    """Return amplitudes (n, heads, K) of the α head (n, heads, outputs) in float64, as field.evaluate does."""
    config, gains = field.config, None
    if config.line_gains:
        alpha, gains = alpha[..., :-LINE_GAIN_COUNT], alpha[:, 0, -LINE_GAIN_COUNT:]
    prior, tones = np.split(inputs.prior, [config.carriers.count], axis=1)
    expansion, first = config.expansion(), config.carriers.arc_slice.start
    if expansion is not None:
        alpha = np.concatenate([alpha[..., :first], alpha[..., first:] @ expansion.T], axis=-1)
    if config.physics:
        alpha = alpha + (field.parameters["skip"] * prior)[:, None, :]
    if config.emission == "log":
        alpha = np.exp(np.minimum(alpha, LOG_AMPLITUDE_CEILING))
    if gains is not None:
        ringing = compute_line_power(gains, tones, config.carriers.arc_count, LOG_AMPLITUDE_CEILING)
        arcs = config.carriers.arc_slice
        alpha[:, 0, arcs] = np.sqrt(np.square(alpha[:, 0, arcs]) + ringing)
    return alpha * inputs.gate[:, None, :]


def build_field_inputs(field: Field, condition: Condition) -> Inputs:
    config = field.config
    return build_inputs(
        condition, config.carriers, config.physics, config.action_octaves, config.directed, config.line_gains,
        config.stroke_frame,
    )  # fmt: skip


def synthesise_emission(field: Field, stroke: StrokeInput, emission: Emission) -> Float:
    """Return the signal (n,) of a stroke for a given field emission."""
    prepared = prepare_every_state(field, stroke, seed=1)
    prepared = replace(prepared, amplitude=accumulate(field.config, emission))
    return render_block(prepared, 0, prepared.count)


def measure_ray_error(dtype: torch.dtype) -> str:
    """Measure rays on a bumpy plate of 1 m: largest error in distance, and the rate of other triangles hit."""
    side = np.linspace(-0.5, 0.5, 25)
    x, y = np.meshgrid(side, side)
    vertices = np.stack([x, y, 0.05 * np.sin(9.0 * x) * np.cos(7.0 * y)], axis=-1).reshape(-1, 3)
    index = np.arange(len(vertices)).reshape(x.shape)
    a, b, c, d = (corner.ravel() for corner in (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]))
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)
    positions = np.random.default_rng(0).uniform(-0.4, 0.4, (400, 2))
    origins = np.concatenate([positions, np.ones((400, 1))], axis=1)
    directions = np.tile([0.02, 0.01, -1.0], (400, 1))

    def cast(*arrays: Float):
        number = np.arange(len(triangles), dtype=np.int32)
        mesh = TriangleMesh(arrays[0], triangles, number, 0 * number, np.zeros((len(triangles), 3, 3)))
        return ReferenceGeometry(mesh).cast(*arrays[1:])

    exact, found = (
        cast(vertices, origins, directions),
        cast(*(round_to_type(x, dtype) for x in (vertices, origins, directions))),
    )
    error_m = np.abs(found.distance - exact.distance).max()
    return f"{error_m:.0e} m; {np.mean(found.triangle != exact.triangle):.1%} elsewhere"


def measure_token_error(dtype: torch.dtype) -> str:
    """Return the largest level error of a band, on a rough relief."""
    relief = 1e-5 * np.cumsum(np.random.default_rng(0).standard_normal((128, 128)), axis=1) / 8.0
    pitch = 20e-3 / 128
    tactile_map = tactile_map_from_height(relief, None, pitch, 2.0 * pitch)
    exact = describe(tactile_map)
    found = describe(replace(tactile_map, image=round_to_type(tactile_map.image, dtype).astype(np.float32)))
    known = exact.known[LEVELS]
    error_db = 20.0 * np.abs(found.values[LEVELS] - exact.values[LEVELS])[known].max()
    return "what it is" if error_db == 0.0 else f"{error_db:.0e} dB in a band"


def measure_map_error(dtype: torch.dtype, what: str) -> str:
    """Return the error [dB] of the slopes that D_φ predicts from a rough grey image."""
    weights, rng = load_map_weights(), np.random.default_rng(0)
    grey = np.clip(0.5 + 0.05 * np.cumsum(rng.standard_normal((VIEW_PIXELS, VIEW_PIXELS, 1)), axis=1), 0.0, 1.0)
    rgb = np.repeat(grey, 3, axis=2).astype(np.float32)
    view = AppearanceView(rgb, np.zeros((VIEW_PIXELS, VIEW_PIXELS), np.float32), False, PITCHES_M[0])
    sensor = weights.config.sensors[0]
    exact = predict_slopes(weights, view, sensor, 0)
    if what == "its picture":
        view = replace(view, rgb=round_to_type(rgb, dtype).astype(np.float32))
    else:
        parameters = weights.network.parameters
        rounded = {name: round_to_type(value, dtype).astype(np.float32) for name, value in parameters.items()}
        weights = replace(weights, network=build_unet(weights.config, rounded))
    return format_db(
        compute_error_db(predict_slopes(weights, view, sensor, 0).astype(np.float64), exact.astype(np.float64))
    )


def measure_resampling_error(signal: Float, dtype: torch.dtype) -> float:
    exact, _ = resample(signal, 10_000.0, 48_000.0)
    return compute_error_db(resample(round_to_type(signal, dtype), 10_000.0, 48_000.0)[0], exact)


def measure_counts_error(signal: Float, dtype: torch.dtype) -> str:
    """Return the largest difference of the counts sent to a device."""
    exact, found = (
        Limiter(GENERIC.limits, 10_000.0, 1).process(version[:, None]).astype(np.int64)
        for version in (signal, round_to_type(signal, dtype))
    )
    error = int(np.abs(found - exact).max())
    return f"{error} of 32767 counts" if error else "what it is"


def measure_contact_error(dtype: torch.dtype) -> str:
    """Return the error of the height response |H| over the largest |H| at that stiffness and force."""
    stiffness, force = np.geomspace(1e3, 1e6, 7), np.geomspace(0.05, 20.0, 7)
    frequency = np.geomspace(20.0, 1000.0, 60)
    worst = 0.0
    for value in stiffness:
        exact, found = (
            height_response(f[:, None], Mechanics(k, z, 0.3), get_probe("pen"), n[None])
            for f, k, z, n in (
                (frequency, value, 0.15, force),
                (
                    round_to_type(frequency, dtype), float(round_to_type(np.array(value), dtype)),
                    float(round_to_type(np.array(0.15), dtype)), round_to_type(force, dtype),
                ),
            )
        )  # fmt: skip
        worst = max(worst, float((np.abs(found - exact) / np.abs(exact).max(axis=0)).max()))
    return "∞: 1e6 N/m is none" if not np.isfinite(worst) else f"{worst:.0e} of its peak"


DIGITS = 50
LENGTHS = (1, 5, 64, 4096)
TORCH_TYPES = (torch.float16, torch.bfloat16, torch.float32, torch.float64)
RATES = (2000.0, 2205.0, 4000.0, 8000.0, 11_025.0, 16_000.0, 22_050.0, 44_100.0, 48_000.0, 96_000.0, 192_000.0)
BLOCK_SIZES = (1, 7, 64, 1000)


@dataclass(frozen=True)
class WorstError:
    """Largest absolute error, and largest relative error.

    The relative error counts where the true value is in the type's normal range; `where` describes its location.
    """

    absolute: float
    relative: float
    where: str

    def max_with(self, other: WorstError) -> WorstError:
        larger = other if other.relative > self.relative else self
        return WorstError(max(self.absolute, other.absolute), larger.relative, larger.where)


NO_ERROR = WorstError(0.0, 0.0, "nowhere")


def make_density_cases(count: int, largest: float, smallest: float, seed: int = 0) -> dict[str, Float]:
    """Return named σΔt (count,) in float64 within the type's range.

    They include values a network gives and values it should never give.
    """
    rng = np.random.default_rng(seed)
    spread = np.exp(rng.uniform(np.log(smallest), np.log(largest), count))
    mixed = np.where(rng.random(count) < 0.5, np.minimum(spread, 80.0 / count), 0.0)
    last = np.full(count, 30.0 / count)
    last[count // 2 :] = np.inf
    return {
        "equal": np.full(count, 40.548 / count),
        "exponential": rng.exponential(60.0 / count, count),
        "ascending over the whole type": np.sort(spread),
        "any order over the whole type": np.minimum(spread, largest),
        "zeros and small": mixed,
        "least positive": np.full(count, smallest),
        "greatest": np.full(count, largest),
        "zero": np.zeros(count),
        "infinite half way": last,
    }


@mp.workdps(DIGITS)
def compute_exact_weights(sigma_dt: Sequence[float]) -> list[mp.mpf]:
    """Return the weights w_n of the given numbers to DIGITS digits."""
    depth, weights = mp.mpf(0), []
    for value in sigma_dt:
        density = mp.mpf(float(value))
        transmittance = mp.mpf(0) if mp.isinf(depth) else mp.exp(-depth)
        weights.append(transmittance * (mp.mpf(1) if mp.isinf(density) else -mp.expm1(-density)))
        depth += density
    return weights


@mp.workdps(DIGITS)
def compute_exact_gradient(sigma_dt: Sequence[float], upstream: Sequence[float]) -> tuple[list[mp.mpf], list[mp.mpf]]:
    """Return d/dσ_j of Σ g_n w_n = g_j T_{j+1} − Σ_{n>j} g_n w_n, and the same with absolute terms.

    Both lists have one entry per density.
    """
    weights, later_sum, later_magnitude = compute_exact_weights(sigma_dt), mp.mpf(0), mp.mpf(0)
    sums = [mp.mpf(0)]
    for value in sigma_dt:
        sums.append(sums[-1] + mp.mpf(float(value)))
    gradient, scale = [mp.mpf(0)] * len(weights), [mp.mpf(0)] * len(weights)
    for j in reversed(range(len(weights))):
        direct = mp.mpf(float(upstream[j])) * (mp.mpf(0) if mp.isinf(sums[j + 1]) else mp.exp(-sums[j + 1]))
        gradient[j], scale[j] = direct - later_sum, abs(direct) + later_magnitude
        later_sum += mp.mpf(float(upstream[j])) * weights[j]
        later_magnitude += abs(mp.mpf(float(upstream[j])) * weights[j])
    return gradient, scale


@mp.workdps(DIGITS)
def find_worst_error(
    found: Float, exact: Sequence[mp.mpf], least: float, name: str, scale: Sequence[mp.mpf] = ()
) -> WorstError:
    """Return the errors of `found` against `exact`.

    Relative errors are over `scale` (default: the exact value) where that is ≥ least. A value that is not finite counts
    as an infinite error.
    """
    worst = NO_ERROR
    for n, (value, truth) in enumerate(zip(found, exact, strict=True)):
        if not np.isfinite(value):
            return WorstError(np.inf, np.inf, f"{name}, n = {n}: {value}")
        error, divisor = abs(mp.mpf(float(value)) - truth), scale[n] if scale else abs(truth)
        relative = float(error / divisor) if divisor >= least else 0.0
        worst = worst.max_with(WorstError(float(error), relative, f"{name}, n = {n}"))
    return worst


@dataclass(frozen=True)
class NumberType:
    """A number type: unit roundoff, least normal, least positive and greatest number, and rounding function."""

    name: str
    epsilon: float
    normal: float
    least: float
    greatest: float
    round: Callable[[Float], torch.Tensor]


def describe_type(dtype: torch.dtype) -> NumberType:
    limits = torch.finfo(dtype)
    return NumberType(
        str(dtype).removeprefix("torch."), limits.eps, limits.tiny, limits.tiny * limits.eps, limits.max,
        lambda values: torch.tensor(values, dtype=torch.float64).to(dtype),
    )  # fmt: skip


def make_rounded_cases(dtype: torch.dtype, count: int) -> Iterator[tuple[str, torch.Tensor]]:
    kind = describe_type(dtype)
    for name, values in make_density_cases(count, kind.greatest, kind.least).items():
        yield name, kind.round(values)
    if kind.greatest > 1e30:
        span = np.geomspace(1e-30, 1e30, count) if count > 1 else np.array([1e30])
        yield "1e-30 … 1e30", kind.round(span)


def measure_weight_errors(dtype: torch.dtype, which: str, lengths: Sequence[int] = LENGTHS) -> WorstError:
    """Return the worst error of render_weights, "numpy" or "torch", over all cases."""
    worst = NO_ERROR
    with mp.workdps(DIGITS):
        for count in lengths:
            for name, densities in make_rounded_cases(dtype, count):
                found = torch.tensor(render_weights(densities.numpy())) if which == "numpy" else twin(densities)
                exact = compute_exact_weights(densities.double().tolist())
                worst = worst.max_with(
                    find_worst_error(found.double().numpy(), exact, describe_type(dtype).normal, f"{name}, N = {count}")
                )
    return worst


def measure_gradient_errors(dtype: torch.dtype, lengths: Sequence[int] = LENGTHS) -> WorstError:
    """Return the worst error of the torch twin's gradient.

    It is relative to the sum of the terms' absolute values, because they cancel.
    """
    worst = NO_ERROR
    with mp.workdps(DIGITS):
        for count in lengths:
            upstream = describe_type(dtype).round(np.random.default_rng(1).standard_normal(count))
            for name, densities in make_rounded_cases(dtype, count):
                leaf = densities.clone().requires_grad_()
                twin(leaf).backward(upstream)
                assert leaf.grad is not None
                exact, scale = compute_exact_gradient(densities.double().tolist(), upstream.double().tolist())
                found = leaf.grad.double().numpy()
                worst = worst.max_with(
                    find_worst_error(found, exact, describe_type(dtype).normal, f"{name}, N = {count}", scale)
                )
    return worst


def measure_emission_errors(dtype: torch.dtype, lengths: Sequence[int] = LENGTHS) -> WorstError:
    """Return the worst error of render() relative to Σ |w_n α_n|, with K = 3.

    α covers the type's range with both signs.
    """
    worst, kind = NO_ERROR, describe_type(dtype)
    # Below the normal range the result itself has few digits, whatever the terms.
    least = kind.normal / kind.epsilon
    with mp.workdps(DIGITS):
        for count in lengths:
            rng = np.random.default_rng(count)
            sign = rng.choice([-1.0, 1.0], count)
            spread = np.exp(rng.uniform(np.log(kind.least), np.log(kind.greatest), count))
            alpha = np.stack([np.full(count, kind.greatest), sign * kind.greatest, sign * spread], axis=1)
            alpha = np.clip(alpha, -kind.greatest, kind.greatest)
            alpha = kind.round(alpha).numpy()
            for name, densities in make_rounded_cases(dtype, count):
                weights = compute_exact_weights(densities.double().tolist())
                terms = [[w * mp.mpf(float(a)) for w, a in zip(weights, column, strict=True)] for column in alpha.T]
                exact, scale = [mp.fsum(column) for column in terms], [mp.fsum(map(abs, column)) for column in terms]
                found = render(densities.numpy(), alpha).astype(np.float64)
                worst = worst.max_with(find_worst_error(found, exact, least, f"{name}, N = {count}, K = 3", scale))
    return worst


def make_library_stroke(seconds: float, material: int = 0) -> StrokeInput:
    """Make a steady stroke, 0.1 m/s and 1 N, on a material of the library."""
    entry = load_library()[material]
    return uniform_stroke(make_steady_action(seconds, 0.1, 1.0), entry.token, entry.mechanics)


def make_wandering_stroke(seconds: float, seed: int = 0, material: int = 0) -> StrokeInput:
    """Make a stroke with varying speed, force and direction."""
    entry = load_library()[material]
    action = make_random_smooth_action(seconds, seed, speed_m_s=(0.03, 0.3), force_n=(0.3, 2.0))
    return uniform_stroke(action, entry.token, entry.mechanics)


def measure_block_errors(field: Field, stroke: StrokeInput, size: int, start: int, count: int) -> float:
    """Return the largest difference between one block of `count` samples and blocks of `size`, over the RMS."""
    prepared = prepare_stroke(field, stroke, seed=5)
    single_block = render_block(prepared, start, count)
    blocks = [
        render_block(prepared, first, min(size, start + count - first)) for first in range(start, start + count, size)
    ]
    return float(np.max(np.abs(np.concatenate(blocks) - single_block)) / np.sqrt(np.mean(np.square(single_block))))


def measure_rate_errors(
    field: Field, stroke: StrokeInput, rates: Sequence[float] = RATES
) -> Iterator[tuple[float, float]]:
    """Yield (rate, largest difference [dB]) of Welch spectra between each output rate and the model rate.

    Bins are 10 Hz wide (2.5 Hz if a tenth of a second is not an even number of samples), up to 1 kHz or 0.45 of the
    rate.
    """
    model = synthesise(field, stroke, seed=1).signal
    for rate in rates:
        other = synthesise(field, stroke, seed=1, sample_rate=rate).signal
        window_s = 0.1 if (rate / 20.0).is_integer() else 0.4
        (frequency, first), (_, second) = (
            welch(signal.samples, signal.sample_rate, round(window_s * signal.sample_rate)) for signal in (model, other)
        )
        inside = np.flatnonzero((frequency >= 10.0) & (frequency <= min(1000.0, 0.45 * rate)))
        yield rate, float(np.max(np.abs(10.0 * np.log10(second[inside] / first[inside]))))


def compute_correlation(samples: Float, least_lag: int, greatest_lag: int) -> float:
    """Return the largest |autocorrelation| between the lags, normalised by the overlap."""
    count = len(samples)
    spectrum = np.fft.rfft(samples, 1 << (2 * count - 1).bit_length())
    products = np.fft.irfft(np.square(np.abs(spectrum)))[: greatest_lag + 1]
    lags = np.arange(greatest_lag + 1)
    return float(np.max(np.abs(products / (count - lags) * count / products[0])[least_lag:]))


def compute_spread_db(power: Float, blocks_per_minute: int) -> tuple[float, float]:
    """Return the spread of mean power between minutes [dB], and that expected of independent blocks.

    power: (minutes · blocks,).
    """
    minutes = power.reshape(-1, blocks_per_minute)
    in_db = 10.0 / np.log(10.0) / power.mean()
    expected = np.sqrt(minutes.var(axis=1, ddof=1).mean() / blocks_per_minute)
    return float(minutes.mean(axis=1).std(ddof=1) * in_db), float(expected * in_db)


def measure_stream(field: Field, minutes: int) -> Iterator[tuple[str, str]]:
    """Yield (quantity, figure) of `minutes` of streaming, block by block."""
    stroke, started = make_library_stroke(60.0 * minutes), time.process_time()
    prepared = prepare_stroke(field, stroke, seed=7)
    yield (
        "preparing it",
        f"{time.process_time() - started:.0f} s of one core, peak memory {read_peak_mb():.0f} MB",
    )
    power, resident, blocks = [], [], []
    for start in range(0, prepared.count, 10_000):
        block = render_block(prepared, start, 10_000)
        power.append(float(np.mean(np.square(block))))
        blocks.append(block.astype(np.float32))
        if (start + 10_000) % 600_000 == 0:
            resident.append(read_resident_mb() - sum(array.nbytes for array in blocks) / 1e6)
    yield "resident memory less the signal, minute 1 and last", f"{resident[0]:.0f} MB, {resident[-1]:.0f} MB"
    block_power = np.array(power)
    block_power[0], block_power[-1] = (
        block_power[1],
        block_power[-2],
    )  # the impact of the touch and the lift are not part of the texture
    spread, expected = compute_spread_db(block_power, 60)
    yield "RMS by minute: spread, and what chance gives", f"{spread:.3f} dB, {expected:.3f} dB"
    minute = np.arange(minutes)
    slope = np.polyfit(minute, 10.0 * np.log10(block_power.reshape(minutes, 60).mean(axis=1)), 1)[0]
    chance = expected / np.sqrt(np.sum(np.square(minute - minute.mean())))
    yield "trend of the level, and what chance gives", f"{slope:+.4f} dB a minute, ± {chance:.4f}"
    signal = np.concatenate(blocks).astype(np.float64)[10_000:-10_000]
    least, greatest = 1000, len(signal) // 2
    yield (
        "largest autocorrelation, lags 0.1 s to half the length",
        f"{compute_correlation(signal, least, greatest):.4f}",
    )
    fresh = prepare_stroke(field, stroke, seed=7)
    last = prepared.count - 20_000
    recomputed = render_block(fresh, last, 10_000).astype(np.float32)
    yield (
        "a block of the last minute, computed anew and alone",
        ("the same bytes" if recomputed.tobytes() == blocks[last // 10_000].tobytes() else "differs"),
    )
    for start in (20_000, last):
        exact = synthesise_reference(field, stroke, seed=7, start=start, count=1000)
        found = render_block(prepared, start, 1000)
        error = 10.0 * np.log10(np.mean(np.square(found - exact)) / np.mean(np.square(exact)))
        yield f"fast path against Fourier sums, from {start / 1e4:g} s", f"{error:.1f} dB"


def read_peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def read_resident_mb() -> float:
    """Return the resident memory [MB]; Linux only."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize() / 1e6


def measure_rendering() -> Iterator[tuple[str, ...]]:
    span = "0 … ∞, N ≤ 4096"
    for dtype in TORCH_TYPES[:1] + TORCH_TYPES[2:]:
        yield format_row("weights, numpy", dtype, span, measure_weight_errors(dtype, "numpy"))
    for dtype in TORCH_TYPES:
        yield format_row("weights, torch", dtype, span, measure_weight_errors(dtype, "torch"))
    for dtype in TORCH_TYPES:
        yield format_row("gradient, torch", dtype, span, measure_gradient_errors(dtype))
    for dtype in TORCH_TYPES[:1] + TORCH_TYPES[2:]:
        worst = measure_emission_errors(dtype)
        yield format_row("Σ w α, numpy", dtype, span + "; α to ± greatest", replace(worst, absolute=np.nan))


def format_row(quantity: str, dtype: torch.dtype, span: str, worst: WorstError) -> tuple[str, ...]:
    absolute = "–" if np.isnan(worst.absolute) else f"{worst.absolute:.1e}"
    kind = describe_type(dtype)
    relative = f"{worst.relative:.1e} ({worst.relative / kind.epsilon:.2g} ε)"
    return quantity, kind.name, span, absolute, relative, worst.where


def print_table(head: Sequence[str], rows: Iterator[tuple[str, ...]]) -> None:
    print("| " + " | ".join(head) + " |\n|" + "---|" * len(head))
    for cells in rows:
        print("| " + " | ".join(cells) + " |", flush=True)
    print()


def main(arguments: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=int, default=10, help="of streaming; 0 leaves it out")
    parser.add_argument("--synthesis", action="store_true", help="leave out temporal rendering")
    options = parser.parse_args(arguments)
    torch.set_num_threads(1)
    if not options.synthesis:
        print_table(("quantity", "type", "range of σΔt", "absolute", "relative", "where"), measure_rendering())
    field = load_field()
    print_table(
        ("blocks of", "difference from the whole, over its RMS"),
        (
            (
                str(size),
                f"{measure_block_errors(field, make_wandering_stroke(3.0), size, 9000, min(64 * size, 4000)):.1e}",
            )
            for size in BLOCK_SIZES
        ),
    )
    print_table(
        ("output rate", "largest difference below 1 kHz (or 0.45 of the rate)"),
        ((f"{rate:g} Hz", f"{worst:.0e} dB") for rate, worst in measure_rate_errors(field, make_wandering_stroke(8.0))),
    )
    print_table(PRECISION_HEADER, measure_precision(field))
    if options.minutes:
        print_table(("streaming", "figure"), measure_stream(field, options.minutes))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
