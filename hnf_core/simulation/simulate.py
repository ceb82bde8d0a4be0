"""Contact simulator: a probe, pressed and dragged by a hand over a height map → three axes of acceleration.

Along the normal: a mass on a Hertzian contact in series with the probe's own spring, a damper that grows with the
tangent stiffness (Tsuji et al. 1992), and no pull, N ≥ 0, so that a light stroke on a rough surface hops. Linearised
about a constant load it equals `material.contact_model`. Tangentially: friction (`contact_dynamics`) and the normal
force's slope component −N ∇h, on the same mass held by the hand's spring and damper (A. Z. Hajian & R. D. Howe 1997, J.
Biomech. Eng. 119: some hundred N/m, a few N·s/m). The friction force also fluctuates by itself along the path, a random
function of place with a power-law spectrum (`contact_model.friction_noise_power`). All axes pass through the resonances
of the probe's body.

Not modelled: the ridges of a fingertip and their force noise (`field.force_noise` has them in closed form), lateral
motion of the tip over the texture (it follows the hand's path), sensor noise, and the hand's own macroscopic
acceleration.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..material.contact_model import (
    FRICTION_NOISE_FORCE_EXPONENT,
    FRICTION_NOISE_WAVENUMBER,
    Mechanics,
    body_response,
    contact_radius,
    with_defaults,
)
from ..material.probe import BodyMode, Probe, get_probe
from .contact_dynamics import DRIVE_COUNT, ContactMotion, Physics, SmoothedMaps, integrate_contact
from .surface_recipe import Noise, SurfaceRecipe, height_map

Float = NDArray[np.float64]
BLOCK_SAMPLES = 128
"""Number of samples integrated in one block, so that large batches stay within the processor's cache."""
SAMPLE_RATE_HZ = 10_000.0
"""Sample rate of strokes and accelerations [Hz]."""
ASPERITY_SHARE = 0.5
"""Radius of the load-bearing asperities, which follow the slopes, over the Hertz radius: the real area of contact is a
fraction of the nominal one (F. P. Bowden & D. Tabor 1950; J. F. Archard 1957)."""
FLANK_FRICTION = 2.0
"""Rise of the friction coefficient per unit of slope against the motion: a sliding tip leans on the flanks that it
climbs (Bowden & Tabor's interlocking), less the more its contact of radius a conforms, by the factor (1 − a/R)². Fitted
together with the hand's damping, the pen's body and the force noise to 50 recorded textures (HaTT); the 95 % interval
over textures is 1.1 to 2.8."""
FULL_PHYSICS = Physics()
"""Simulation with all physical effects."""
LEARNED_PHYSICS = Physics(friction_noise=False, body=False)
"""Effects that F_Θ learns; the others are linear and have a closed form (`field.force_noise`)."""
PEN = get_probe("pen")
"""The recorded stylus."""
FRICTION_SEED = 20_13
"""Seed of the map of friction; its fluctuation is independent of the relief."""
FRICTION_TILE_M, FRICTION_PIXELS = 10e-3, 1024
"""Side of the map of friction [m], and its pixels: finer than the relief's, since force noise reaches the highest
frequencies of slow strokes."""
RING_LEVEL, MAX_RING_S = 1e-6, 10.0
"""Level to which resonances of the probe's body have decayed where they are cut off, but at most so late [s]."""


@dataclass(frozen=True)
class Stroke:
    """Motion of the hand, sampled at `SAMPLE_RATE_HZ`: position (n, 2) on the height map [m], force (n,) ≥ 0 [N]."""

    position: Float
    force: Float


def straight_stroke(
    speed_m_s: float,
    force_n: float,
    duration_s: float,
    *,
    angle_rad: float = 0.0,
    start_m: tuple[float, float] = (0.0, 0.0),
) -> Stroke:
    """Make a stroke of constant direction `angle_rad` (from +x), speed and force, from `start_m` on the map."""
    n = round(duration_s * SAMPLE_RATE_HZ)
    distance = np.arange(n) * (speed_m_s / SAMPLE_RATE_HZ)
    direction = np.array([np.cos(angle_rad), np.sin(angle_rad)])
    return Stroke(np.asarray(start_m) + distance[:, None] * direction, np.full(n, force_n))


def simulate_batch(
    maps: Sequence[SmoothedMaps],
    strokes: Sequence[Stroke],
    mechanics: Sequence[Mechanics],
    probe: Probe = PEN,
    *,
    oversample: int = 2,
    physics: Physics = FULL_PHYSICS,
) -> Float:
    """Simulate a batch of B strokes, each on its own surface.

    Parameters
    ----------
    maps : sequence of SmoothedMaps
        Height map of each stroke; one map may serve several, best adjacent ones, since it caches its smoothed versions.
    strokes : sequence of Stroke
        The strokes, all equally long.
    mechanics : sequence of Mechanics
        Stiffness, damping and friction of each stroke's surface.
    probe : Probe
        The probe.
    oversample : int
        Integration steps per sample.
    physics : Physics
        Physical effects to model.

    Returns
    -------
    ndarray, shape (B, n, 3)
        Acceleration of the probe at `SAMPLE_RATE_HZ` [m/s²], axes x, y of the height map and its normal.

    Raises
    ------
    ValueError
        If lengths do not match.

    Notes
    -----
    A time step costs about the same for 1 stroke as for 50, so batches are fast. Each starts in static equilibrium.
    """
    blocks = [
        motion.acceleration for motion in _integrate_strokes(maps, strokes, mechanics, probe, oversample, physics)
    ]
    acceleration = decimate(np.concatenate(blocks), oversample)
    return _filter_by_body(acceleration, probe) if physics.body and probe.body_modes else acceleration


def simulate_motion(
    maps: Sequence[SmoothedMaps],
    strokes: Sequence[Stroke],
    mechanics: Sequence[Mechanics],
    probe: Probe = PEN,
    *,
    physics: Physics = FULL_PHYSICS,
) -> ContactMotion:
    """Simulate a batch like `simulate_batch`, but return acceleration, force and sliding at every integration step."""
    blocks = list(_integrate_strokes(maps, strokes, mechanics, probe, 2, physics))
    return ContactMotion(
        np.concatenate([block.acceleration for block in blocks]),
        np.concatenate([block.normal_n for block in blocks]),
        np.concatenate([block.sliding_m_s for block in blocks]),
    )


def simulate(
    surface: SmoothedMaps,
    stroke: Stroke,
    mechanics: Mechanics,
    probe: Probe = PEN,
    *,
    oversample: int = 2,
    physics: Physics = FULL_PHYSICS,
) -> Float:
    """Simulate one stroke; return the acceleration (n, 3) [m/s²] along x, y and the normal (see `simulate_batch`)."""
    return np.asarray(
        simulate_batch([surface], [stroke], [mechanics], probe, oversample=oversample, physics=physics)[0]
    )


def _integrate_strokes(
    maps: Sequence[SmoothedMaps],
    strokes: Sequence[Stroke],
    mechanics: Sequence[Mechanics],
    probe: Probe,
    oversample: int,
    physics: Physics,
) -> Iterator[ContactMotion]:
    _validate_batch(maps, strokes, mechanics, oversample)
    drives = np.empty((DRIVE_COUNT, len(strokes[0].force), len(maps)))
    for index, row in enumerate(zip(maps, strokes, mechanics, strict=True)):
        drives[:, :, index] = _compute_drives(*row, probe, physics)
    dt = 1.0 / (SAMPLE_RATE_HZ * oversample)
    return integrate_contact(oversample_blocks(drives, oversample), mechanics, probe, dt, physics)


def _validate_batch(
    maps: Sequence[SmoothedMaps], strokes: Sequence[Stroke], mechanics: Sequence[Mechanics], oversample: int
) -> None:
    if not len(maps) == len(strokes) == len(mechanics) > 0:
        raise ValueError(f"{len(maps)} maps, {len(strokes)} strokes, {len(mechanics)} mechanics: one of each per row.")
    lengths = {array.shape[0] for stroke in strokes for array in (stroke.position, stroke.force)}
    if len(lengths) != 1 or min(lengths) < 4:
        raise ValueError(f"strokes of {sorted(lengths)} samples: all must be equally long, at least 4.")
    if oversample < 1:
        raise ValueError("oversample counts integration steps per sample: at least 1.")
    if not all(np.isfinite(stroke.position).all() and np.isfinite(stroke.force).all() for stroke in strokes):
        raise ValueError("a stroke's positions and forces must be finite.")


def _filter_by_body(acceleration: Float, probe: Probe) -> Float:
    """Return accelerations (B, n, 3) at `SAMPLE_RATE_HZ` as the resonant body of the probe moves."""
    decay_per_s = min(_compute_decay(mode) for mode in probe.body_modes)
    ringing_s = min(-np.log(RING_LEVEL) / decay_per_s, MAX_RING_S)
    count = acceleration.shape[1] + int(np.ceil(ringing_s * SAMPLE_RATE_HZ))
    response = body_response(np.fft.rfftfreq(count, 1.0 / SAMPLE_RATE_HZ), probe)
    spectrum = np.fft.rfft(acceleration, count, axis=1) * response[None, :, None]
    return np.asarray(np.fft.irfft(spectrum, count, axis=1)[:, : acceleration.shape[1]])


def _compute_decay(mode: BodyMode) -> float:
    """Return the decay rate of a resonance [1/s], of the slower part if it is overdamped."""
    slower = mode.damping_ratio - np.sqrt(max(mode.damping_ratio**2 - 1.0, 0.0))
    return float(2.0 * np.pi * mode.frequency_hz * slower)


@lru_cache(maxsize=16)
def make_friction_map(slope: float) -> SmoothedMaps:
    """Make a map of unit fluctuation: RMS 1 in the octave about `FRICTION_NOISE_WAVENUMBER` along any path.

    slope: exponent β of the spectrum κ^−β along a path. Its waves are 20 µm to 10 mm long.
    """
    noise = Noise(1.0, slope, rolloff_m=FRICTION_TILE_M, cutoff_m=0.0)
    fluctuation = height_map(SurfaceRecipe((noise,)), FRICTION_SEED, pixels=FRICTION_PIXELS, size_m=FRICTION_TILE_M)
    paths = np.concatenate([fluctuation, fluctuation.T]).astype(np.float64)
    power = np.mean(np.square(np.abs(np.fft.rfft(paths, axis=1))), axis=0) * 2.0 / FRICTION_PIXELS**2
    wavenumber = np.arange(len(power)) / FRICTION_TILE_M
    octave = np.abs(np.log2(np.maximum(wavenumber, 1e-9) / FRICTION_NOISE_WAVENUMBER)) <= 0.5
    return SmoothedMaps(fluctuation / np.float32(np.sqrt(power[octave].sum())), FRICTION_TILE_M)


def _friction_noise(position: Float, force: Float, mechanics: Mechanics) -> Float:
    """Return a stiff tip's fluctuation of friction (n,) [N] at positions (n, 2) [m], for forces (n,) [N]."""
    known = with_defaults(mechanics)
    unit = make_friction_map(round(known.friction_noise_slope, 2)).sample(position, 0.0)[0]
    return np.asarray(known.friction_noise_n * unit * force**FRICTION_NOISE_FORCE_EXPONENT)


def _compute_drives(
    surface: SmoothedMaps, stroke: Stroke, mechanics: Mechanics, probe: Probe, physics: Physics
) -> Float:
    """Compute the inputs (DRIVE_COUNT, n) of the contact simulation over one stroke: heights, slopes, velocity, force.

    Their order is that of `contact_dynamics.DRIVE_COUNT`.
    """
    position = np.asarray(stroke.position, dtype=np.float64)
    force = np.maximum(np.asarray(stroke.force, dtype=np.float64), 0.0)
    velocity = np.gradient(position, 1.0 / SAMPLE_RATE_HZ, axis=0)
    radius = contact_radius(mechanics, probe, force)
    height = _sample_at_radius(surface, position, radius)[0]
    slopes = _sample_at_radius(surface, position, ASPERITY_SHARE * radius)[1:]
    flank_friction = FLANK_FRICTION * np.square(1.0 - radius / probe.tip_radius_m)
    has_noise = physics.friction_noise and probe.pad is None
    noise = _friction_noise(position, force, mechanics) if has_noise else np.zeros_like(force)
    return np.stack([height, *slopes, *velocity.T, force, flank_friction, noise])


def _sample_at_radius(surface: SmoothedMaps, position: Float, radius: Float) -> Float:
    """Return height and slopes (3, n) under a contact of varying radius (n,), interpolated between smoothed maps."""
    largest = float(radius.max())
    # Since a ∝ F^(1/3), a twofold range of radius covers an eightfold range of force; lighter contact hardly sounds.
    smallest = max(float(radius.min()), 0.5 * largest)
    if smallest >= 0.9 * largest:
        return np.stack(surface.sample(position, largest))
    nodes = np.geomspace(smallest, largest, 3)
    sampled = np.array([surface.sample(position, float(node)) for node in nodes])  # (node, 3, n)
    node_position = np.clip(np.log(np.maximum(radius, smallest) / smallest) / np.log(nodes[1] / smallest), 0.0, 2.0)
    weights = np.maximum(1.0 - np.abs(node_position - np.arange(3)[:, None]), 0.0)
    return np.asarray(np.einsum("kcn,kn->cn", sampled, weights))


def oversample_blocks(drives: Float, factor: int) -> Iterator[Float]:
    """Interpolate D time series of B contacts, (D, n, B), by `factor`; yield them in blocks (D, steps + 2, B).

    A block overlaps the adjacent ones by one fine step on either side. Cubic (Catmull–Rom) interpolation; both ends of
    the series are extrapolated linearly.
    """
    first, last = drives[:, :1], drives[:, -1:]
    rise, fall = drives[:, 1:2] - first, last - drives[:, -2:-1]
    padded = np.concatenate([first - 2 * rise, first - rise, drives, last + fall, last + 2 * fall, last + 3 * fall], 1)
    n = drives.shape[1]
    for start in range(0, n, BLOCK_SAMPLES):
        stop = min(start + BLOCK_SAMPLES, n)
        fine = _interpolate_cubic(padded[:, start : stop + 5], factor)
        yield fine[:, factor - 1 : fine.shape[1] - factor + 1]


def _interpolate_cubic(values: Float, factor: int) -> Float:
    """Interpolate time series (D, m + 3, B) to (D, m · factor, B) by Catmull–Rom splines, from the second sample on."""
    a, b, c, d = values[:, :-3], values[:, 1:-2], values[:, 2:-1], values[:, 3:]
    fine = np.empty((b.shape[0], b.shape[1], factor, b.shape[2]))
    fine[:, :, 0] = b
    for k in range(1, factor):
        t = k / factor
        fine[:, :, k] = 0.5 * (2 * t**2 - t - t**3) * a
        fine[:, :, k] += (1.0 - 2.5 * t**2 + 1.5 * t**3) * b
        fine[:, :, k] += 0.5 * (t + 4 * t**2 - 3 * t**3) * c
        fine[:, :, k] += 0.5 * (t**3 - t**2) * d
    return fine.reshape(b.shape[0], -1, b.shape[2])


def decimate(fine: Float, factor: int) -> Float:
    """Decimate series (n · factor, C, B) to (B, n, C) by a zero-phase windowed-sinc low-pass against aliasing."""
    steps, channels, rows = fine.shape
    n = steps // factor
    samples = np.empty((rows, n, channels))
    if factor == 1:
        samples[:] = fine.transpose(2, 0, 1)
        return samples
    half = 16 * factor
    taps = np.sinc(np.arange(-half, half + 1) / factor) * np.kaiser(2 * half + 1, 6.0)
    taps /= taps.sum()
    band = np.zeros((BLOCK_SAMPLES, BLOCK_SAMPLES * factor + 2 * half))
    for row in range(BLOCK_SAMPLES):
        band[row, row * factor : row * factor + len(taps)] = taps
    fine = fine.reshape(steps, -1)
    for start in range(0, n, BLOCK_SAMPLES):
        stop = min(start + BLOCK_SAMPLES, n)
        around = np.clip(np.arange(start * factor - half, (stop - 1) * factor + half + 1), 0, steps - 1)
        filtered = band[: stop - start, : len(around)] @ fine[around]
        samples[:, start:stop] = filtered.reshape(-1, channels, rows).transpose(2, 0, 1)
    return samples
