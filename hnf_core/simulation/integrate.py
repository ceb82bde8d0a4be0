"""The contact's equations of motion, one step after another, for many contacts side by side."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..material.contact import surface_stiffness_at_1n, with_defaults
from ..material.mechanics import Mechanics
from ..material.probe import Probe
from .friction import FRICTION_LAWS, FrictionLaw, derive_bristles

Float = NDArray[np.float64]

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
