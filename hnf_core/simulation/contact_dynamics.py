"""Friction of the simulated contact: LuGre, with plain Coulomb beside it for comparison.

LuGre (C. Canudas de Wit, H. Olsson, K. J. Åström & P. Lischinsky 1995, "A new model for control of systems with
friction", IEEE Trans. Autom. Control 40): bristles that bend elastically and slip at the Stribeck curve,
dw/dt = σ0 (v − |v| w / g(v)), force per load f = w + (σ1/σ0) dw/dt, g = μ (1 + (s − 1) exp(−(v/v_s)²)), where w = σ0 z
is the bristles' share of the load. Scaled by the load N and in two dimensions as in tyres (C. Canudas de Wit et al.
2003, Vehicle System Dynamics 39; E. Velenis, P. Tsiotras & C. Canudas de Wit 2005, ibid. 43). Bristles let go where
contact is lost. Viscous σ2 is left out: the contacts are dry.

No constant is fitted here: bristles are the contact's own tangential stiffness and damping.

The contact's equations of motion, one step after another, for many contacts side by side.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..material.contact_model import Mechanics, contact_stiffness, surface_stiffness_at_1n, with_defaults
from ..material.probe import Probe

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]

STATIC_OVER_KINETIC = 1.5
"""F_S / F_C of Canudas de Wit et al. 1995, table I (1.5 N over 1 N)."""
STRIBECK_SPEED_M_S = 1e-3
"""v_s, ibid. A stroke at 100 mm/s is a hundred times faster: it meets the kinetic μ of the material table."""
TANGENTIAL_OVER_NORMAL = 2.0 * (1.0 - 0.3) / (2.0 - 0.3)
"""Tangential over normal stiffness of a Hertzian contact at ν = 0.3 (R. D. Mindlin 1949, J. Appl. Mech. 16)."""
CREEP_SPEED_M_S = 2e-3
"""Plain Coulomb: sliding speed at which friction reaches 1/√2 of its value (S. Andersson, A. Söderberg & S. Björklund
2007, Tribology International 40)."""


@dataclass(frozen=True)
class Bristles:
    """Constants per row, each (B,). stiffness: σ0 [1/m], at 1 N. damping: σ1 [s/m] at rest, fading with the Stribeck
    curve so that bristles never drive the probe (Olsson et al. 1998, Eur. J. Control 4)."""

    friction: Float
    stiffness: Float
    damping: Float


def derive_bristles(mechanics: Sequence[Mechanics], probe: Probe) -> Bristles:
    """σ0 = Mindlin's share of the contact's normal stiffness at 1 N, σ1 its damping ratio ζ as along the normal."""
    normal = [
        float(contact_stiffness(each, probe, 1.0)) if probe.soft_tip else surface_stiffness_at_1n(each, probe)
        for each in mechanics
    ]
    known = [with_defaults(each) for each in mechanics]
    stiffness = TANGENTIAL_OVER_NORMAL * np.array(normal)
    damping = 2.0 * np.array([each.damping_ratio for each in known]) * np.sqrt(stiffness * probe.mass_kg)
    return Bristles(np.array([each.friction for each in known]), stiffness, damping)


class FrictionLaw(Protocol):
    """Friction of B contacts as the integrator asks for it; see LuGre for the arguments."""

    force: Float

    def __init__(self, bristles: Bristles, velocity: Float, dt: float) -> None: ...

    def linearise(
        self, sliding: Float, flank_friction: Float, surface_slope: Float, touching: Mask
    ) -> tuple[Float, Float]: ...

    def update(self, sliding: Float) -> None: ...


class LuGre:
    """Bristles of B contacts: w (2, B) is their force per load."""

    def __init__(self, bristles: Bristles, velocity: Float, dt: float) -> None:
        """velocity: (2, B) of the first step, at which the bristles are taken as settled."""
        self._friction, self._dt = bristles.friction, dt
        self._step = bristles.stiffness * dt
        self._damping = bristles.damping / self._step
        pace = np.hypot(*velocity)
        level = bristles.friction * (1.0 + (STATIC_OVER_KINETIC - 1.0) * np.exp(-np.square(pace / STRIBECK_SPEED_M_S)))
        self.force = level * velocity / np.maximum(pace, 1e-9)
        self._damped, self._velocity_gain = np.zeros_like(pace), np.ones_like(pace)

    def linearise(
        self, sliding: Float, flank_friction: Float, surface_slope: Float, touching: Mask
    ) -> tuple[Float, Float]:
        """Friction of this step as a + b v_new per unit of load: a (2, B), b (B,) [s/m].

        sliding: (2, B) velocity over the surface before the step. leaning: (B,) rise of μ per unit of slope against
        the motion. surface_slope: (2, B). touching: (B,) bool, in contact. Backward Euler in w and v; |v| and
        g are those before the step. Call settle(v_new) afterwards.
        """
        squared = sliding[0] * sliding[0]
        squared += sliding[1] * sliding[1]
        squared += 1e-14
        pace = np.sqrt(squared)
        flank = surface_slope[0] * sliding[0]
        flank += surface_slope[1] * sliding[1]
        flank *= flank_friction
        flank /= pace
        squared *= -1.0 / STRIBECK_SPEED_M_S**2
        stribeck = np.exp(squared)
        level = (STATIC_OVER_KINETIC - 1.0) * stribeck
        level += 1.0
        level *= self._friction
        level += flank
        np.maximum(level, 1e-6, out=level)
        self.force *= touching
        self._velocity_gain = self._step / (1.0 + self._step * pace / level)
        # (w + σ0 dt v) / D, D = 1 + σ0 dt |v| / g
        self._predicted_force = self.force * (self._velocity_gain / self._step)
        self._damped = self._damping * stribeck
        gain = 1.0 + self._damped
        return gain * self._predicted_force - self._damped * self.force, gain * self._velocity_gain

    def update(self, sliding: Float) -> None:
        """Bend the bristles by the velocity (2, B) that the step has led to."""
        self.force = self._predicted_force + self._velocity_gain * sliding


class Coulomb:
    """Kinetic friction regularised at creep speed: no memory, no stiction."""

    def __init__(self, bristles: Bristles, velocity: Float, dt: float) -> None:
        del dt
        self._friction = bristles.friction
        self.force = bristles.friction * velocity / np.sqrt(np.square(velocity).sum(axis=0) + CREEP_SPEED_M_S**2)

    def linearise(
        self, sliding: Float, flank_friction: Float, surface_slope: Float, touching: Mask
    ) -> tuple[Float, Float]:
        """As LuGre.slope, with a = 0."""
        del touching
        pace = np.sqrt(np.square(sliding).sum(axis=0) + CREEP_SPEED_M_S**2)
        flank = (surface_slope * sliding).sum(axis=0) * flank_friction / pace
        return np.zeros_like(sliding), np.maximum(self._friction + flank, 0.0) / pace

    def update(self, sliding: Float) -> None:
        """Nothing is remembered."""


FRICTION_LAWS: dict[str, type[FrictionLaw]] = {"lugre": LuGre, "coulomb": Coulomb}


HAND_STIFFNESS_N_M = 500.0
HAND_DAMPING_RATIO = 0.4
"""Lateral impedance of a hand that holds a tool (A. Z. Hajian & R. D. Howe 1997, J. Biomech. Eng. 119)."""
HAND_DRAG_PER_S = 10.0
"""Along the normal the hand only bleeds off free flight (drag / mass); far below the contact's own damping."""


@dataclass(frozen=True)
class Physics:
    """What is modelled; the default is everything, the rest is for ablations.

    friction: "lugre", or "coulomb" (no bristles, no Stribeck curve). unilateral: contact only pushes (N ≥ 0); without
    it the spring also pulls and the probe never leaves the surface.
    """

    friction: str = "lugre"
    unilateral: bool = True

    def __post_init__(self) -> None:
        if self.friction not in FRICTION_LAWS:
            raise ValueError(f"friction {self.friction!r}: one of {', '.join(sorted(FRICTION_LAWS))}.")


@dataclass(frozen=True)
class ContactMotion:
    """What happened at every integration step. acceleration: (steps, 3, B) m/s². normal_n: (steps, B) N, 0 = no
    contact. sliding_m_s: (steps, 2, B) velocity of the tip over the surface."""

    acceleration: Float
    normal_n: Float
    sliding_m_s: Float


DRIVE_COUNT = 7
"""Height [m], slopes along x and y, the hand's velocity x and y [m/s], force [N], rise of friction with slope."""


def integrate_contact(
    blocks: Iterable[Float], mechanics: Sequence[Mechanics], probe: Probe, dt: float, physics: Physics
) -> Iterator[ContactMotion]:
    """Semi-implicit Euler from static equilibrium; one Motion per block of drives (DRIVES, steps + 2, B), the first and
    last step of each being its neighbours'.

    Friction is implicit, being stiff near rest; the contact is not, its resonance lying far below 1/dt.
    """
    known = [with_defaults(each) for each in mechanics]
    damping = 2.0 * np.array([each.damping_ratio for each in known]) * np.sqrt(probe.mass_kg)
    # δ = b s² + s³/k_probe with s = N^(1/3): Hertz in series with the probe's own spring
    b = 1.5 / np.array([surface_stiffness_at_1n(each, probe) for each in mechanics])
    inverse_mass = 1.0 / probe.mass_kg
    hand_spring = HAND_STIFFNESS_N_M * inverse_mass
    hand_damper = 2.0 * HAND_DAMPING_RATIO * np.sqrt(hand_spring)
    law: FrictionLaw | None = None
    for drives in blocks:
        height, slope, velocity = drives[0, 1:-1], drives[1:3, 1:-1], drives[3:5, 1:-1]
        force, leaning = np.maximum(drives[5, 1:-1], 0.0), drives[6, 1:-1]  # the cubic undershoots at a sudden lift
        climb = (drives[0, 2:] - drives[0, :-2]) * (0.5 / dt)
        if law is None:
            load = np.cbrt(force[0])
            z, vz = height[0] - (b * load**2 + load**3 / probe.stiffness_n_m), climb[0].copy()
            law = FRICTION_LAWS[physics.friction](derive_bristles(mechanics, probe), velocity[:, 0], dt)
            lateral = -force[0] * law.force / HAND_STIFFNESS_N_M
            v_lateral = np.zeros_like(lateral)
        steps, rows = height.shape
        acceleration = np.empty((steps, 3, rows))
        normals, slidings = np.empty((steps, rows)), np.empty((steps, 2, rows))
        for i in range(steps):
            depth = height[i] - z
            if physics.unilateral:
                np.maximum(depth, 0.0, out=depth)
            normal, stiffness = compute_contact_force(np.abs(depth), b, probe.stiffness_n_m)
            damper = np.sqrt(stiffness)
            damper *= damping
            damper *= climb[i] - vz
            if not physics.unilateral:
                np.copysign(normal, depth, out=normal)
            normal += damper
            if physics.unilateral:
                np.maximum(normal, 0.0, out=normal)
            normals[i] = normal
            az = np.subtract(normal, force[i], out=acceleration[i, 2])
            az *= inverse_mass
            az -= HAND_DRAG_PER_S * vz
            vz += dt * az
            z += dt * vz

            pushed = np.maximum(normal, 0.0)
            touching = pushed > 0.0
            pushed *= dt * inverse_mass
            sliding = velocity[:, i] + v_lateral
            constant, linear = law.linearise(sliding, leaning[i], slope[:, i], touching)
            constant += slope[:, i]
            constant *= pushed
            linear *= pushed
            linear += 1.0
            moved = np.subtract(sliding, constant, out=slidings[i])
            moved -= (dt * hand_spring) * lateral
            moved -= (dt * hand_damper) * v_lateral
            moved /= linear
            law.update(moved)
            # seen from the hand, whose own velocity is not the probe's vibration
            change = moved - sliding
            v_lateral += change
            lateral += dt * v_lateral
            np.multiply(change, 1.0 / dt, out=acceleration[i, :2])
        yield ContactMotion(acceleration, normals, slidings)


def compute_contact_force(depth: Float, b: Float, probe_stiffness: float) -> tuple[Float, Float]:
    """Elastic force [N] and tangent stiffness [N/m] at a penetration ≥ 0 [m]: root of δ = b s² + s³/k, F = s³.

    s = sqrt(δ/b) / y with y³ = y + β, β = sqrt(δ/b) / (b k): three fixed-point steps, then Newton. Leaves less than
    1e-6 of F up to β = 30 (the pen), 2e-4 up to 3000, and 0.3 % where a fingertip strikes stone with 20 N.
    """
    x = depth / b
    np.sqrt(x, out=x)
    beta = x / b
    beta *= 1.0 / probe_stiffness
    y = np.sqrt(1.0 + beta)
    for _ in range(2):
        y = beta / y
        y += 1.0
        np.sqrt(y, out=y)
    for _ in range(3):
        square = y * y
        y *= square
        y *= 2.0
        y += beta
        square *= 3.0
        square -= 1.0
        y /= square
    s = x / y
    slope = (3.0 / probe_stiffness) * s
    slope += 2.0 * b
    force = s * s
    force *= s
    s *= 3.0
    s /= slope
    return force, s
