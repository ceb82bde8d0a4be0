"""The contact simulator: a probe pressed by the hand and dragged over a height map → three axes of acceleration.

Along the normal: a mass on a Hertzian contact in series with the probe's own spring, a damper that grows with the
tangent stiffness (Tsuji et al. 1992), and nothing that pulls: N ≥ 0, so a light stroke on a rough surface hops.
Linearised about a constant load it is exactly material.contact. Tangentially: Coulomb friction, regularised at creep
speed (S. Andersson, A. Söderberg & S. Björklund 2007, Tribology International 40), and the normal force's own slope
component −N ∇h, on the same mass held by the hand's spring and damper (A. Z. Hajian & R. D. Howe 1997, J. Biomech.
Eng. 119: some hundred N/m, a few N·s/m).

Left out in this version: the tip follows the hand's path (its lateral wobble does not move it over the texture), the
sensor's noise, the hand's own macroscopic acceleration, and resonances of the probe's body.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..material.contact import contact_radius, surface_stiffness_at_1n, with_defaults
from ..material.mechanics import PROBES, Mechanics, Probe
from .sampling import SmoothedMaps

Float = NDArray[np.float64]

SAMPLE_RATE_HZ = 10_000.0
HAND_STIFFNESS_N_M = 500.0
HAND_DAMPING_RATIO = 0.4
HAND_DRAG_PER_S = 10.0
"""Along the normal the hand only bleeds off free flight (drag / mass); far below the contact's own damping."""
CREEP_SPEED_M_S = 2e-3
"""Sliding speed at which friction reaches 1/√2 of Coulomb's value."""
ASPERITY_SHARE = 0.5
"""Radius of the spots that really carry the load and meet the slopes, over the Hertz radius: the real area of contact
is a fraction of the nominal one (F. P. Bowden & D. Tabor 1950; J. F. Archard 1957)."""
FLANK_FRICTION = 3.0
"""Rise of the friction coefficient per unit of slope against the motion: a sliding tip leans on the flanks it climbs
(Bowden & Tabor's interlocking), the less the more its contact of radius a conforms: times (1 − a/R)². Fitted, with
the form of that factor, ASPERITY_SHARE and the pen's tip radius: with them speed and force tell about as much as they
do in recorded textures (HaTT). They are one choice for all materials, and were not checked on held-out ones."""


@dataclass(frozen=True)
class Stroke:
    """What the hand does, sampled at SAMPLE_RATE_HZ. position: (n, 2) m on the map. force: (n,) N ≥ 0."""

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
    """A stroke of constant direction, speed and force."""
    n = round(duration_s * SAMPLE_RATE_HZ)
    distance = np.arange(n) * (speed_m_s / SAMPLE_RATE_HZ)
    direction = np.array([np.cos(angle_rad), np.sin(angle_rad)])
    return Stroke(np.asarray(start_m) + distance[:, None] * direction, np.full(n, force_n))


def simulate_batch(
    maps: Sequence[SmoothedMaps],
    strokes: Sequence[Stroke],
    mechanics: Sequence[Mechanics],
    probe: Probe = PROBES["pen"],
    *,
    oversample: int = 2,
) -> Float:
    """Acceleration (B, n, 3) [m/s²] of the probe at SAMPLE_RATE_HZ, axes x, y, normal of the maps' frame.

    One map, stroke and mechanics per row; all strokes equally long. The same SmoothedMaps may stand in many rows (put
    them side by side: what it has smoothed it remembers). oversample: integration steps per sample. The batch is
    what makes it fast: a Python step costs the same for 1 row as for 100. Every row starts in static equilibrium.
    Raises ValueError where lengths do not match.
    """
    _check(maps, strokes, mechanics, oversample)
    drives = np.array([_under_path(*row, probe) for row in zip(maps, strokes, mechanics, strict=True)])  # (B, 7, n)
    drives = np.ascontiguousarray(_finer(np.moveaxis(drives, -1, 0), oversample))
    return _decimate(_integrate(drives, mechanics, probe, 1.0 / (SAMPLE_RATE_HZ * oversample)), oversample)


def simulate(
    surface: SmoothedMaps,
    stroke: Stroke,
    mechanics: Mechanics,
    probe: Probe = PROBES["pen"],
    *,
    oversample: int = 2,
) -> Float:
    """One stroke: (n, 3); see simulate_batch."""
    return np.asarray(simulate_batch([surface], [stroke], [mechanics], probe, oversample=oversample)[0])


def _check(
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


def _under_path(surface: SmoothedMaps, stroke: Stroke, mechanics: Mechanics, probe: Probe) -> Float:
    """What the probe meets, (7, n): height [m], slopes along x and y, the hand's velocity x and y [m/s], force [N],
    and how much friction rises with slope."""
    position = np.asarray(stroke.position, dtype=np.float64)
    force = np.maximum(np.asarray(stroke.force, dtype=np.float64), 0.0)
    velocity = np.gradient(position, 1.0 / SAMPLE_RATE_HZ, axis=0)
    radius = contact_radius(mechanics, probe, force)
    height = _at_radius(surface, position, radius)[0]
    slopes = _at_radius(surface, position, ASPERITY_SHARE * radius)[1:]
    leaning = FLANK_FRICTION * np.square(1.0 - radius / probe.tip_radius_m)
    return np.stack([height, *slopes, *velocity.T, force, leaning])


def _at_radius(surface: SmoothedMaps, position: Float, radius: Float) -> Float:
    """(3, n) height and slopes under a contact of varying radius (n,): blended between smoothed maps."""
    largest = float(radius.max())
    # a ∝ F^(1/3): an eightfold range of force is a twofold range of radius; lighter than that hardly sounds
    smallest = max(float(radius.min()), 0.5 * largest)
    if smallest >= 0.9 * largest:
        return np.stack(surface.sample(position, largest))
    nodes = np.geomspace(smallest, largest, 3)
    sampled = np.array([surface.sample(position, float(node)) for node in nodes])  # (node, 3, n)
    place = np.clip(np.log(np.maximum(radius, smallest) / smallest) / np.log(nodes[1] / smallest), 0.0, 2.0)
    weights = np.maximum(1.0 - np.abs(place - np.arange(3)[:, None]), 0.0)
    return np.asarray(np.einsum("kcn,kn->cn", sampled, weights))


def _integrate(drives: Float, mechanics: Sequence[Mechanics], probe: Probe, dt: float) -> Float:
    """Semi-implicit Euler over drives (steps, B, 7) as in _under_path → (steps, B, 3) acceleration.

    Friction is implicit, being stiff near creep; the contact is not, its resonance lying far below 1/dt.
    """
    height, slope, velocity, force = drives[:, :, 0], drives[:, :, 1:3], drives[:, :, 3:5], drives[:, :, 5]
    leaning = drives[:, :, 6]
    known = [with_defaults(each) for each in mechanics]
    friction = np.array([each.friction for each in known])
    damping = 2.0 * np.array([each.damping_ratio for each in known]) * np.sqrt(probe.mass_kg)
    # δ = b s² + s³/k_probe with s = N^(1/3): Hertz in series with the probe's own spring
    b = 1.5 / np.array([surface_stiffness_at_1n(each, probe) for each in mechanics])
    inverse_mass = 1.0 / probe.mass_kg
    hand_spring = HAND_STIFFNESS_N_M * inverse_mass
    hand_damper = 2.0 * HAND_DAMPING_RATIO * np.sqrt(hand_spring)
    climb = np.gradient(height, dt, axis=0)

    force = np.maximum(force, 0.0)  # the cubic may undershoot at a sudden lift
    load = np.cbrt(force[0])
    z = height[0] - (b * load**2 + load**3 / probe.stiffness_n_m)
    vz = climb[0].copy()
    pace = np.sqrt(np.square(velocity[0]).sum(axis=-1) + CREEP_SPEED_M_S**2)
    pull = -force[0][:, None] * (friction / pace)[:, None] * velocity[0]
    lateral = pull / HAND_STIFFNESS_N_M
    v_lateral = np.zeros_like(lateral)

    out = np.empty((*height.shape, 3))
    for i in range(len(height)):
        depth = np.maximum(height[i] - z, 0.0)
        normal, stiffness = _contact_force(depth, b, probe.stiffness_n_m)
        normal = np.maximum(normal + damping * np.sqrt(stiffness) * (climb[i] - vz), 0.0)
        az = (normal - force[i]) * inverse_mass - HAND_DRAG_PER_S * vz
        vz += dt * az
        z += dt * vz

        pushed = normal * inverse_mass
        before = v_lateral
        sliding = velocity[i] + before
        pace = np.sqrt(sliding[:, 0] ** 2 + sliding[:, 1] ** 2 + CREEP_SPEED_M_S**2)
        flank = (slope[i, :, 0] * sliding[:, 0] + slope[i, :, 1] * sliding[:, 1]) / pace
        resistance = np.maximum(friction + leaning[i] * flank, 0.0) * pushed / pace
        held = pushed[:, None] * slope[i] + hand_spring * lateral + hand_damper * before
        v_lateral = (sliding - dt * held) / (1.0 + dt * resistance)[:, None] - velocity[i]
        lateral = lateral + dt * v_lateral
        out[i, :, :2] = (v_lateral - before) / dt
        out[i, :, 2] = az
    return out


def _contact_force(depth: Float, b: Float, probe_stiffness: float) -> tuple[Float, Float]:
    """Elastic force [N] and tangent stiffness [N/m] at a penetration [m]: root of δ = b s² + s³/k, F = s³.

    Newton from above on a convex function, so that it never overshoots; three steps leave less than 1e-5 of F.
    """
    s = np.minimum(np.sqrt(depth / b), np.cbrt(depth * probe_stiffness)) + 1e-12
    cube = 1.0 / probe_stiffness
    for _ in range(3):
        s = s - (s * s * (b + cube * s) - depth) / (s * (2.0 * b + 3.0 * cube * s))
    s2 = s * s
    return s * s2, 3.0 * s2 / (s * (2.0 * b + 3.0 * cube * s))


def _finer(values: Float, factor: int) -> Float:
    """(n, …) → (n·factor, …) by cubic (Catmull–Rom) interpolation, the ends extrapolated linearly."""
    if factor == 1:
        return values
    first, last = 2 * values[:1] - values[1:2], 2 * values[-1:] - values[-2:-1]
    padded = np.concatenate([first, values, last, 2 * last - values[-1:]])
    a, b, c, d = padded[:-3], padded[1:-2], padded[2:-1], padded[3:]
    out = np.empty((len(values), factor, *values.shape[1:]))
    for k in range(factor):
        t = k / factor
        out[:, k] = b + 0.5 * t * (c - a + t * (2 * a - 5 * b + 4 * c - d + t * (3 * (b - c) + d - a)))
    return out.reshape(-1, *values.shape[1:])


def _decimate(fine: Float, factor: int) -> Float:
    """(n·factor, B, 3) → (B, n, 3) through a zero-phase windowed-sinc low-pass, so that impacts do not alias."""
    if factor > 1:
        half = 16 * factor
        taps = np.sinc(np.arange(-half, half + 1) / factor) * np.kaiser(2 * half + 1, 6.0)
        taps /= taps.sum()
        n = len(fine)
        padded = np.concatenate([np.repeat(fine[:1], half, axis=0), fine, np.repeat(fine[-1:], half, axis=0)])
        size = 1 << int(np.ceil(np.log2(len(padded) + len(taps))))
        spectrum = np.fft.rfft(padded, size, axis=0) * np.fft.rfft(taps, size)[:, None, None]
        fine = np.fft.irfft(spectrum, size, axis=0)[2 * half : 2 * half + n : factor]
    return np.ascontiguousarray(np.moveaxis(fine, 1, 0))
