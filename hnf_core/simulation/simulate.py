"""The contact simulator: a probe pressed by the hand and dragged over a height map → three axes of acceleration.

Along the normal: a mass on a Hertzian contact in series with the probe's own spring, a damper that grows with the
tangent stiffness (Tsuji et al. 1992), and nothing that pulls: N ≥ 0, so a light stroke on a rough surface hops.
Linearised about a constant load it is exactly material.contact. Tangentially: LuGre friction (friction.py) and the
normal force's own slope component −N ∇h, on the same mass held by the hand's spring and damper (A. Z. Hajian & R. D.
Howe 1997, J. Biomech. Eng. 119: some hundred N/m, a few N·s/m).

Left out in this version: the tip follows the hand's path (its lateral wobble does not move it over the texture), the
sensor's noise, the hand's own macroscopic acceleration, and resonances of the probe's body.

Between the sample rate and the finer steps of integration.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..material.contact_model import Mechanics, contact_radius
from ..material.probe import PROBES, Probe
from .contact_dynamics import (
    DRIVE_COUNT,
    ContactMotion,
    Physics,
    integrate_contact,
)
from .height_sampling import SmoothedMaps

Float = NDArray[np.float64]
BLOCK_SAMPLES = 128
"""Samples handled together: large batches stay within the processor's cache."""
SAMPLE_RATE_HZ = 10_000.0
ASPERITY_SHARE = 0.5
"""Radius of the spots that really carry the load and meet the slopes, over the Hertz radius: the real area of contact
is a fraction of the nominal one (F. P. Bowden & D. Tabor 1950; J. F. Archard 1957)."""
FLANK_FRICTION = 3.0
"""Rise of the friction coefficient per unit of slope against the motion: a sliding tip leans on the flanks it climbs
(Bowden & Tabor's interlocking), the less the more its contact of radius a conforms: times (1 − a/R)². Fitted, with
the form of that factor, ASPERITY_SHARE and the pen's tip radius: with them speed and force tell about as much as they
do in recorded textures (HaTT). They are one choice for all materials, and were not checked on held-out ones."""
FULL_PHYSICS = Physics()


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
    physics: Physics = FULL_PHYSICS,
) -> Float:
    """Acceleration (B, n, 3) [m/s²] of the probe at SAMPLE_RATE_HZ, axes x, y, normal of the maps' frame.

    One map, stroke and mechanics per row; all strokes equally long. The same SmoothedMaps may stand in many rows (put
    them side by side: what it has smoothed it remembers). oversample: integration steps per sample. The batch is
    what makes it fast: a Python step costs the same for 1 row as for 50. Every row starts in static equilibrium.
    Raises ValueError where lengths do not match.
    """
    parts = [each.acceleration for each in _integrate_strokes(maps, strokes, mechanics, probe, oversample, physics)]
    return decimate(np.concatenate(parts), oversample)


def simulate_motion(
    maps: Sequence[SmoothedMaps],
    strokes: Sequence[Stroke],
    mechanics: Sequence[Mechanics],
    probe: Probe = PROBES["pen"],
    *,
    oversample: int = 2,
    physics: Physics = FULL_PHYSICS,
) -> ContactMotion:
    """As simulate_batch, but everything at every integration step: acceleration, normal force, sliding velocity."""
    parts = list(_integrate_strokes(maps, strokes, mechanics, probe, oversample, physics))
    return ContactMotion(
        np.concatenate([each.acceleration for each in parts]),
        np.concatenate([each.normal_n for each in parts]),
        np.concatenate([each.sliding_m_s for each in parts]),
    )


def simulate(
    surface: SmoothedMaps,
    stroke: Stroke,
    mechanics: Mechanics,
    probe: Probe = PROBES["pen"],
    *,
    oversample: int = 2,
    physics: Physics = FULL_PHYSICS,
) -> Float:
    """One stroke: (n, 3); see simulate_batch."""
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
        drives[:, :, index] = _compute_drives(*row, probe)
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


def _compute_drives(surface: SmoothedMaps, stroke: Stroke, mechanics: Mechanics, probe: Probe) -> Float:
    """What the probe meets, (7, n): height [m], slopes along x and y, the hand's velocity x and y [m/s], force [N],
    and how much friction rises with slope."""
    position = np.asarray(stroke.position, dtype=np.float64)
    force = np.maximum(np.asarray(stroke.force, dtype=np.float64), 0.0)
    velocity = np.gradient(position, 1.0 / SAMPLE_RATE_HZ, axis=0)
    radius = contact_radius(mechanics, probe, force)
    height = _sample_at_radius(surface, position, radius)[0]
    slopes = _sample_at_radius(surface, position, ASPERITY_SHARE * radius)[1:]
    leaning = FLANK_FRICTION * np.square(1.0 - radius / probe.tip_radius_m)
    return np.stack([height, *slopes, *velocity.T, force, leaning])


def _sample_at_radius(surface: SmoothedMaps, position: Float, radius: Float) -> Float:
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


def oversample_blocks(drives: Float, factor: int) -> Iterator[Float]:
    """(D, n, B) → blocks (D, ≤ BLOCK·factor + 2, B), one fine step of overlap at either side of each.

    Cubic (Catmull–Rom) interpolation, both ends extrapolated linearly.
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
    """(D, m + 3, B) → (D, m·factor, B): from the second value on, towards the next."""
    a, b, c, d = values[:, :-3], values[:, 1:-2], values[:, 2:-1], values[:, 3:]
    out = np.empty((b.shape[0], b.shape[1], factor, b.shape[2]))
    out[:, :, 0] = b
    for k in range(1, factor):
        t = k / factor
        out[:, :, k] = 0.5 * (2 * t**2 - t - t**3) * a
        out[:, :, k] += (1.0 - 2.5 * t**2 + 1.5 * t**3) * b
        out[:, :, k] += 0.5 * (t + 4 * t**2 - 3 * t**3) * c
        out[:, :, k] += 0.5 * (t**3 - t**2) * d
    return out.reshape(b.shape[0], -1, b.shape[2])


def decimate(fine: Float, factor: int) -> Float:
    """(n·factor, C, B) → (B, n, C) through a zero-phase windowed-sinc low-pass, so that impacts do not alias."""
    steps, channels, rows = fine.shape
    n = steps // factor
    out = np.empty((rows, n, channels))
    if factor == 1:
        out[:] = fine.transpose(2, 0, 1)
        return out
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
        part = band[: stop - start, : len(around)] @ fine[around]
        out[:, start:stop] = part.reshape(-1, channels, rows).transpose(2, 0, 1)
    return out
