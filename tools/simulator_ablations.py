"""What each part of the contact model is for: take it away, and one named statistic moves as the cited model says.

Used by tools/check_simulator.py for docs/simulator.md, and by tests/core/test_simulation_ablations.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hnf_core.material.mechanics import Mechanics
from hnf_core.material.probe import PROBES, Probe
from hnf_core.simulation.feel import compute_fused_spectra
from hnf_core.simulation.sampling import SmoothedMaps
from hnf_core.simulation.simulate import (
    SAMPLE_RATE_HZ,
    Physics,
    Stroke,
    simulate,
    simulate_batch,
    simulate_motion,
    straight_stroke,
)
from hnf_core.simulation.surface import Noise, SurfaceRecipe, height_map

Float = NDArray[np.float64]

PEN = PROBES["pen"]
WOOD_MECHANICS = Mechanics(1.0e5, 0.2, 0.3)
ROUGH_RECIPE = SurfaceRecipe(noise=(Noise(6e-6, slope=2.0),))
FLAT_SURFACE = SmoothedMaps(np.zeros((64, 64), np.float32))
ANGLES = (0.3, 1.1, 1.9, 2.7)


def simulate_over(recipe: SurfaceRecipe, force_n: float, probe: Probe, physics: Physics, speed_m_s: float) -> Float:
    """(4, n, 3): half a second in four directions, the first 50 ms left out."""
    surface = SmoothedMaps(height_map(recipe, 1))
    strokes = [straight_stroke(speed_m_s, force_n, 0.55, angle_rad=angle) for angle in ANGLES]
    count = len(strokes)
    acceleration = simulate_batch([surface] * count, strokes, [WOOD_MECHANICS] * count, probe, physics=physics)
    return acceleration[:, round(0.05 * SAMPLE_RATE_HZ) :]


def measure_centroid(radius_m: float) -> float:
    """Centroid [Hz] of the normal acceleration on a fine rough surface, 100 mm/s, 1 N, under a tip of this radius.

    Hertz: the contact is a ∝ R^(1/3) wide and averages shorter waves away, so it falls. The surface's stiffness is held
    (k ∝ R^(1/3) is divided out), so that the tip's low-pass alone is seen.
    """
    probe = PEN._replace(tip_radius_m=radius_m)
    held = replace(WOOD_MECHANICS, stiffness_n_m=1.0e5 * (PEN.tip_radius_m / radius_m) ** (1.0 / 3.0))
    surface = SmoothedMaps(height_map(ROUGH_RECIPE.scale_heights(0.05), 1))
    strokes = [straight_stroke(0.1, 1.0, 0.35, angle_rad=angle) for angle in ANGLES]
    acceleration = simulate_batch([surface] * 4, strokes, [held] * 4, probe)[:, 500:, 2]
    power = np.square(np.abs(np.fft.rfft(acceleration * np.hanning(acceleration.shape[1]), axis=1))).mean(axis=0)
    frequency = np.fft.rfftfreq(acceleration.shape[1], 1.0 / SAMPLE_RATE_HZ)
    return float((power * frequency)[frequency >= 10.0].sum() / power[frequency >= 10.0].sum())


def simulate_slow_pull(speeds_m_s: Sequence[float], friction: str, seconds: float = 1.6) -> Float:
    """Velocity (speeds, steps) of the pen's tip, pulled from rest over a flat surface at 1 N by the hand's spring; the
    second half of `seconds`."""
    n = round(seconds * SAMPLE_RATE_HZ)
    start = np.minimum(np.arange(n) / (0.05 * SAMPLE_RATE_HZ), 1.0)
    strokes = [
        Stroke(np.stack([np.cumsum(v * start) / SAMPLE_RATE_HZ, np.zeros(n)], axis=1), np.ones(n)) for v in speeds_m_s
    ]
    rows = len(strokes)
    motion = simulate_motion(
        [FLAT_SURFACE] * rows, strokes, [WOOD_MECHANICS] * rows, physics=Physics(friction=friction)
    )
    return motion.sliding_m_s[len(motion.sliding_m_s) // 2 :, 0].T


def compute_stuck_share(sliding: Float, speed_m_s: float) -> float:
    """Share of the time in which the tip moves at less than a fifth of the hand's speed."""
    return float(np.mean(np.abs(sliding) < 0.2 * speed_m_s))


def count_slips_per_second(sliding: Float, speed_m_s: float) -> float:
    """Times per second that the tip breaks away, from the first break to the last."""
    fast = sliding > 2.0 * speed_m_s
    breaks = np.flatnonzero(fast[1:] & ~fast[:-1])
    return float((len(breaks) - 1) / ((breaks[-1] - breaks[0]) / (2.0 * SAMPLE_RATE_HZ))) if len(breaks) > 1 else 0.0


def measure_level_db(friction: str) -> float:
    """Level of all three axes on a rough surface at 100 mm/s, 1 N, in dB of (m/s²)²."""
    power, _ = compute_fused_spectra(simulate_over(ROUGH_RECIPE, 1.0, PEN, Physics(friction=friction), 0.1))
    return float(10.0 * np.log10(power.sum(axis=1).mean()))


def measure_flight_and_skewness(unilateral: bool) -> tuple[float, float]:
    """Light stroke (0.3 N, 150 mm/s) on a rough surface: share of time in free fall, and skewness of the normal
    acceleration. A contact that cannot pull gives long falls at −F/m and short blows upwards; one that can gives
    neither."""
    force = 0.3
    normal = simulate_over(ROUGH_RECIPE, force, PEN, Physics(unilateral=unilateral), 0.15)[:, :, 2]
    falling = np.abs(normal + force / PEN.mass_kg) < 0.03 * force / PEN.mass_kg
    centred = normal - normal.mean()
    return float(falling.mean()), float(np.mean(centred**3) / np.mean(centred**2) ** 1.5)


def measure_ring_hz(mass_kg: float) -> float:
    """Frequency [Hz] at which the probe rings after a step of force from 1.0 to 1.1 N: sqrt(k/m) / 2π."""
    n = 2500
    force = np.where(np.arange(n) < 500, 1.0, 1.1)
    stroke = Stroke(np.zeros((n, 2)), force)
    normal = simulate(FLAT_SURFACE, stroke, replace(WOOD_MECHANICS, damping_ratio=0.03), PEN._replace(mass_kg=mass_kg))[
        520:, 2
    ]
    spectrum = np.abs(np.fft.rfft(normal * np.hanning(len(normal)), 1 << 16))
    return float(np.fft.rfftfreq(1 << 16, 1.0 / SAMPLE_RATE_HZ)[np.argmax(spectrum)])


def measure_ablations() -> list[tuple[str, str, str, str]]:
    """(part, statistic, figures, what the cited model says) for docs/simulator.md."""
    tips = [measure_centroid(r) for r in (0.25e-3, 0.5e-3, 1e-3, 2e-3)]
    slow, quick = (1e-3, 2e-3, 4e-3), (0.02, 0.1)
    pulled = simulate_slow_pull((*slow, *quick), "lugre", 2.4)
    stuck = [compute_stuck_share(pulled[1], 2e-3), compute_stuck_share(simulate_slow_pull([2e-3], "coulomb")[0], 2e-3)]
    slips = [count_slips_per_second(sliding, v) for sliding, v in zip(pulled, slow, strict=False)]
    fast = [compute_stuck_share(sliding, v) for sliding, v in zip(pulled[3:], quick, strict=True)]
    levels = [measure_level_db(law) for law in ("lugre", "coulomb")]
    loss = [measure_flight_and_skewness(unilateral) for unilateral in (True, False)]
    rings = [measure_ring_hz(m) for m in (0.0175, 0.035, 0.07, 0.14)]
    return [
        ("tip radius 0.25, 0.5, 1, 2 mm", "centroid of the normal axis",
         ", ".join(f"{c:.0f}" for c in tips) + " Hz", "falls: a wider contact averages short waves (Hertz)"),
        ("LuGre → Coulomb", "share of time stuck, pulled at 2 mm/s", f"{100 * stuck[0]:.0f} % → {100 * stuck[1]:.0f} %",
         "stick–slip needs stiction and the falling Stribeck branch (Canudas de Wit 1995)"),
        ("LuGre, pulled at 1, 2, 4 mm/s", "slips per second", ", ".join(f"{s:.1f}" for s in slips),
         "rises with speed: the spring must be wound up by 2 ΔF / k each time (Rabinowicz 1965)"),
        ("LuGre, pulled at 20, 100 mm/s", "share of time stuck", ", ".join(f"{100 * s:.0f} %" for s in fast),
         "none far above the Stribeck speed"),
        ("LuGre → Coulomb", "level at 100 mm/s on a rough surface", f"{levels[0]:.2f} → {levels[1]:.2f} dB",
         "unchanged far above the Stribeck speed"),
        ("contact loss → N < 0 allowed", "time in free fall; skewness of the normal axis",
         f"{100 * loss[0][0]:.0f} % → {100 * loss[1][0]:.0f} %; {loss[0][1]:+.2f} → {loss[1][1]:+.2f}",
         "falls at −F/m and blows upwards only where the surface cannot pull"),
        ("mass 17.5, 35, 70, 140 g", "ringing after a step of force", ", ".join(f"{r:.0f}" for r in rings) + " Hz",
         "∝ m^(−1/2) (contact resonance)"),
    ]  # fmt: skip
