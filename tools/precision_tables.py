"""How many digits each stage needs: the same numbers kept, or computed with, in narrower types against float64.

Rows for tools/check_numerics.py. Nothing of the product is changed for it: what goes into a stage is rounded to the
type and back, and F_Θ's layers are computed in the type by their torch twin.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from hnf_core.action.smooth import make_random_smooth_action
from hnf_core.actuators.limiter import Limiter
from hnf_core.actuators.profile import GENERIC
from hnf_core.field.blocks import render_block
from hnf_core.field.features import Inputs, build_inputs
from hnf_core.field.field import LOG_AMPLITUDE_CEILING, Emission, Field, accumulate
from hnf_core.field.linear_contact import Condition
from hnf_core.field.lines import LINE_GAIN_COUNT, compute_line_power
from hnf_core.field.prepared import prepare_stroke
from hnf_core.field.resampling import resample
from hnf_core.field.stroke import StrokeInput, uniform_stroke
from hnf_core.field.timeline import build_condition, resample_action
from hnf_core.material.contact import height_response
from hnf_core.material.encoder import describe
from hnf_core.material.library import load_library
from hnf_core.material.mechanics import Mechanics
from hnf_core.material.probe import PROBES
from hnf_core.material.token import LEVELS
from hnf_core.scene.mesh import TriangleMesh
from hnf_core.scene.raycast import ReferenceGeometry
from hnf_core.tactile.diffusion.network import build_unet
from hnf_core.tactile.diffusion.predict import predict_slopes
from hnf_core.tactile.diffusion.weights import load_map_weights
from hnf_core.tactile.height import tactile_map_from_height
from hnf_core.tactile.views import PITCHES_M, VIEW_PIXELS, AppearanceView
from hnf_core.training.model import FieldNetwork

Float = NDArray[np.float64]

NARROW_TYPES = (torch.float16, torch.bfloat16, torch.float32)
PRECISION_HEADER = (
    "stage",
    "kept or computed in the type",
    *(str(each).removeprefix("torch.") for each in NARROW_TYPES),
)


def round_to_type(values: Float, dtype: torch.dtype) -> Float:
    """Values rounded to the type once; still float64."""
    return torch.tensor(np.asarray(values), dtype=torch.float64).to(dtype).double().numpy()


def compute_error_db(found: Float, exact: Float) -> float:
    """Power of the difference over that of exact."""
    with np.errstate(divide="ignore"):
        return float(10.0 * np.log10(np.sum(np.square(found - exact)) / np.sum(np.square(exact))))


def measure_precision(field: Field) -> Iterator[tuple[str, ...]]:
    """One row a stage, cells as in HEAD."""
    stroke = make_example_stroke()
    yield "ray cast", "vertices, origins, directions; 1 m", *(measure_ray_error(dtype) for dtype in NARROW_TYPES)
    yield "E", "the sensor image", *(measure_token_error(dtype) for dtype in NARROW_TYPES)
    for what in ("its picture", "its weights"):
        yield "D_φ", what, *(measure_map_error(dtype, what) for dtype in NARROW_TYPES)
    yield (
        "linear contact",
        "stiffness, damping, force, frequency",
        *(measure_contact_error(dtype) for dtype in NARROW_TYPES),
    )
    exact = evaluate_in_type(field, stroke, torch.float64)
    whole = synthesise_emission(field, stroke, exact)
    found = [evaluate_in_type(field, stroke, dtype) for dtype in NARROW_TYPES]
    yield "F_Θ", "layers and heads computed", *(f"{compute_error_db(each.alpha, exact.alpha):.0f} dB" for each in found)
    played = [synthesise_emission(field, stroke, each) for each in found]
    yield (
        "synthesis, end to end",
        "layers and heads computed",
        *(f"{compute_error_db(each, whole):.0f} dB" for each in played),
    )
    coarse = [replace(stroke, tokens=round_to_type(stroke.tokens, dtype).astype(np.float32)) for dtype in NARROW_TYPES]
    played = [synthesise_emission(field, each, evaluate_in_type(field, each, torch.float64)) for each in coarse]
    off = [compute_error_db(each, whole) for each in played]
    yield "synthesis, end to end", "the token", *(format_db(x) for x in off)
    yield (
        "resampler, 10 to 48 kHz",
        "the signal",
        *(format_db(measure_resampling_error(whole, dtype)) for dtype in NARROW_TYPES),
    )
    yield "limiter, generic coil", "the signal", *(measure_counts_error(whole, dtype) for dtype in NARROW_TYPES)


def format_db(off_db: float) -> str:
    return f"{off_db:.0f} dB" if off_db > -np.inf else "what it is"


def make_example_stroke(seconds: float = 2.0) -> StrokeInput:
    """A wandering stroke on the library's first material."""
    entry = load_library()[0]
    action = make_random_smooth_action(seconds, 0, speed_m_s=(0.03, 0.3), force_n=(0.3, 2.0))
    return uniform_stroke(action, entry.token, entry.mechanics)


def evaluate_in_type(field: Field, stroke: StrokeInput, dtype: torch.dtype) -> Emission:
    """F_Θ at every state of a stroke, its layers and heads in the type, the rest in float64."""
    config, condition = field.config, build_condition(stroke, *resample_action(stroke))
    inputs = build_field_inputs(field, condition)
    network = FieldNetwork(config, field.parameters).to(dtype)
    with torch.no_grad():
        head, sigma_dt = network.evaluate_heads(torch.tensor(inputs.x).to(dtype))
    return Emission(compute_amplitudes(field, head.double().numpy(), inputs), sigma_dt.double().numpy())


def compute_amplitudes(field: Field, alpha: Float, inputs: Inputs) -> Float:
    """(n, heads, K) of the α head (n, heads, outputs), in float64 as field.evaluate has it."""
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
    """The signal (n,) of a stroke whose field emits this."""
    prepared = prepare_stroke(field, stroke, seed=1)
    prepared = replace(prepared, amplitude=accumulate(field.config, emission))
    return render_block(prepared, 0, prepared.count)


def measure_ray_error(dtype: torch.dtype) -> str:
    """On a bumpy plate of 1 m: largest difference in distance, and rays that meet another triangle."""
    side = np.linspace(-0.5, 0.5, 25)
    x, y = np.meshgrid(side, side)
    vertices = np.stack([x, y, 0.05 * np.sin(9.0 * x) * np.cos(7.0 * y)], axis=-1).reshape(-1, 3)
    index = np.arange(len(vertices)).reshape(x.shape)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]))
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)
    places = np.random.default_rng(0).uniform(-0.4, 0.4, (400, 2))
    origins = np.concatenate([places, np.ones((400, 1))], axis=1)
    directions = np.tile([0.02, 0.01, -1.0], (400, 1))

    def cast(*arrays: Float):
        number = np.arange(len(triangles), dtype=np.int32)
        mesh = TriangleMesh(arrays[0], triangles, number, 0 * number, np.zeros((len(triangles), 3, 3)))
        return ReferenceGeometry(mesh).cast(*arrays[1:])

    exact, found = (
        cast(vertices, origins, directions),
        cast(*(round_to_type(x, dtype) for x in (vertices, origins, directions))),
    )
    off = np.abs(found.distance - exact.distance).max()
    return f"{off:.0e} m; {np.mean(found.triangle != exact.triangle):.1%} elsewhere"


def measure_token_error(dtype: torch.dtype) -> str:
    """Of a rough relief: largest difference of a band's level."""
    relief = 1e-5 * np.cumsum(np.random.default_rng(0).standard_normal((128, 128)), axis=1) / 8.0
    pitch = 20e-3 / 128
    plain = tactile_map_from_height(relief, None, pitch, 2.0 * pitch)
    exact = describe(plain)
    found = describe(replace(plain, image=round_to_type(plain.image, dtype).astype(np.float32)))
    known = exact.known[LEVELS]
    off = 20.0 * np.abs(found.values[LEVELS] - exact.values[LEVELS])[known].max()
    return "what it is" if off == 0.0 else f"{off:.0e} dB in a band"


def measure_map_error(dtype: torch.dtype, what: str) -> str:
    """Of the slopes that D_φ predicts of a rough grey picture, in dB."""
    weights, rng = load_map_weights(), np.random.default_rng(0)
    grey = np.clip(0.5 + 0.05 * np.cumsum(rng.standard_normal((VIEW_PIXELS, VIEW_PIXELS, 1)), axis=1), 0.0, 1.0)
    rgb = np.repeat(grey, 3, axis=2).astype(np.float32)
    view = AppearanceView(rgb, np.zeros((VIEW_PIXELS, VIEW_PIXELS), np.float32), False, PITCHES_M[0])
    sensor = weights.config.sensors[0]
    exact = predict_slopes(weights, view, sensor, 0)
    if what == "its picture":
        view = replace(view, rgb=round_to_type(rgb, dtype).astype(np.float32))
    else:
        kept = weights.network.parameters
        narrow = {name: round_to_type(value, dtype).astype(np.float32) for name, value in kept.items()}
        weights = replace(weights, network=build_unet(weights.config, narrow))
    return format_db(
        compute_error_db(predict_slopes(weights, view, sensor, 0).astype(np.float64), exact.astype(np.float64))
    )


def measure_resampling_error(signal: Float, dtype: torch.dtype) -> float:
    exact, _ = resample(signal, 10_000.0, 48_000.0)
    return compute_error_db(resample(round_to_type(signal, dtype), 10_000.0, 48_000.0)[0], exact)


def measure_counts_error(signal: Float, dtype: torch.dtype) -> str:
    """Largest difference of what a wire would get."""
    exact, found = (
        Limiter(GENERIC.limits, 10_000.0, 1).process(each[:, None]).astype(np.int64)
        for each in (signal, round_to_type(signal, dtype))
    )
    off = int(np.abs(found - exact).max())
    return f"{off} of 32767 counts" if off else "what it is"


def measure_contact_error(dtype: torch.dtype) -> str:
    """|H| of height over stiffness, force and frequency, over the largest |H| at that stiffness and force."""
    stiffness, force = np.geomspace(1e3, 1e6, 7), np.geomspace(0.05, 20.0, 7)
    frequency = np.geomspace(20.0, 1000.0, 60)
    worst = 0.0
    for value in stiffness:
        exact, found = (
            height_response(f[:, None], Mechanics(k, z, 0.3), PROBES["pen"], n[None])
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
