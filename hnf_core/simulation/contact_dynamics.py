"""Equations of motion of a probe on a surface, integrated for many contacts at once, with LuGre or Coulomb friction.

LuGre (C. Canudas de Wit, H. Olsson, K. J. Åström & P. Lischinsky 1995, "A new model for control of systems with
friction", IEEE Trans. Autom. Control 40): bristles that bend elastically and slip at the Stribeck curve, dw/dt = σ0 (v
− |v| w / g(v)), force per load f = w + (σ1/σ0) dw/dt, g = μ (1 + (s − 1) exp(−(v/v_s)²)), where w = σ0 z is the
bristles' force per load. Scaled by the load N and in two dimensions as in tyres (C. Canudas de Wit et al. 2003, Vehicle
System Dynamics 39; E. Velenis, P. Tsiotras & C. Canudas de Wit 2005, ibid. 43). The bristles' deflection is reset where
contact is lost. Viscous σ2 is left out, since the contacts are dry. No constant is fitted: bristles have the contact's
own tangential stiffness and damping.

`SmoothedMaps` gives heights and slopes of a periodic map under a path, by cubic B-splines on maps that are smoothed by
the tip's contact.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..material.contact_model import (
    STATIC_OVER_KINETIC,
    STRIBECK_SPEED_M_S,
    Mechanics,
    compute_bristles,
    surface_stiffness_at_1n,
    with_defaults,
)
from ..material.probe import Probe
from .surface_recipe import TILE_SIZE_M, wavenumbers

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]

LEAST_FRICTION = 1e-6
"""Friction below which there is none, so that nothing is divided by it."""
CREEP_SPEED_M_S = 2e-3
"""Sliding speed at which regularised Coulomb friction reaches 1/√2 of its value [m/s] (S. Andersson, A. Söderberg & S.
Björklund 2007, Tribology International 40)."""


@dataclass(frozen=True)
class Bristles:
    """Constants of LuGre's bristles (elastic friction state) for B contacts, each (B,).

    Attributes
    ----------
    friction : ndarray
        Coulomb μ.
    stiffness : ndarray
        Bristle stiffness σ0 per load, at 1 N [1/m].
    damping : ndarray
        Bristle damping σ1 per load at rest [s/m]; it fades with the Stribeck curve so that bristles never drive the
        probe (Olsson et al. 1998, Eur. J. Control 4).
    """

    friction: Float
    stiffness: Float
    damping: Float


def derive_bristles(mechanics: Sequence[Mechanics], probe: Probe) -> Bristles:
    """Derive the constants of each contact; see contact_model.compute_bristles."""
    stiffness, damping = np.array([compute_bristles(entry, probe) for entry in mechanics]).T
    return Bristles(np.array([with_defaults(entry).friction for entry in mechanics]), stiffness, damping)


class FrictionLaw(Protocol):
    """Interface of friction laws of B contacts, as the integrator calls it at every time step."""

    force: Float

    def __init__(self, bristles: Bristles, velocity: Float, dt: float) -> None: ...

    def linearise(
        self, sliding: Float, flank_friction: Float, surface_slope: Float, touching: Mask
    ) -> tuple[Float, Float]:
        """Return a (2, B), b (B,) [s/m] of the friction force per load a + b v_new; see `LuGre.linearise`."""
        ...

    def measure_grip(self, fluctuation: Float, touching: Mask) -> Float:
        """Return the load (B,) [N] that a fluctuation of the friction force (B,) [N] is worth; after `linearise`."""
        ...

    def update(self, sliding: Float) -> None:
        """Update the state of the law by the new sliding velocity (2, B) [m/s]."""
        ...


class LuGre:
    """LuGre friction of B contacts; its state `force` (2, B) is the force of the bristles per load."""

    def __init__(self, bristles: Bristles, velocity: Float, dt: float) -> None:
        """Start with bristles settled at steady sliding with the velocity (2, B) of the first step [m/s]."""
        self._friction, self._dt = bristles.friction, dt
        self._step = bristles.stiffness * dt
        self._damping = bristles.damping / self._step
        speed = np.hypot(*velocity)
        level = bristles.friction * (1.0 + (STATIC_OVER_KINETIC - 1.0) * np.exp(-np.square(speed / STRIBECK_SPEED_M_S)))
        self.force = level * velocity / np.maximum(speed, 1e-9)
        self._damped, self._velocity_gain = np.zeros_like(speed), np.ones_like(speed)

    def linearise(
        self, sliding: Float, flank_friction: Float, surface_slope: Float, touching: Mask
    ) -> tuple[Float, Float]:
        """Linearise this step's friction force per unit of load as a + b v_new, v_new the sliding velocity after it.

        Parameters
        ----------
        sliding : ndarray, shape (2, B)
            Velocity over the surface before the step [m/s].
        flank_friction : ndarray, shape (B,)
            Rise of μ per unit of slope that the tip climbs.
        surface_slope : ndarray, shape (2, B)
            Slope of the surface, ∂h/∂x and ∂h/∂y.
        touching : ndarray of bool, shape (B,)
            True in contact.

        Returns
        -------
        a : ndarray, shape (2, B)
            Constant part.
        b : ndarray, shape (B,)
            Linear part [s/m].

        Notes
        -----
        Backward Euler in the bristles' force w and the velocity v; |v| and the Stribeck curve g are those before the
        step. Call `update` with v_new afterwards.
        """
        squared = sliding[0] * sliding[0]
        squared += sliding[1] * sliding[1]
        squared += 1e-14
        speed = np.sqrt(squared)
        flank = surface_slope[0] * sliding[0]
        flank += surface_slope[1] * sliding[1]
        flank *= flank_friction
        flank /= speed
        squared *= -1.0 / STRIBECK_SPEED_M_S**2
        stribeck = np.exp(squared)
        level = (STATIC_OVER_KINETIC - 1.0) * stribeck
        level += 1.0
        level *= self._friction
        level += flank
        np.maximum(level, 1e-6, out=level)
        self.force *= touching
        self._velocity_gain = self._step / (1.0 + self._step * speed / level)
        # The new w is (w + σ0 dt v) / D with D = 1 + σ0 dt |v| / g.
        self._predicted_force = self.force * (self._velocity_gain / self._step)
        self._damped = self._damping * stribeck
        gain = 1.0 + self._damped
        return gain * self._predicted_force - self._damped * self.force, gain * self._velocity_gain

    def measure_grip(self, fluctuation: Float, touching: Mask) -> Float:
        """Return the load (B,) [N] that a fluctuation of the friction force (B,) [N] is worth; after `linearise`.

        While the tip slides, the friction force grows by the fluctuation itself. While it sticks, the bristles' spring
        grows in proportion, so that a fluctuation never drives a tip at rest, as a force along its velocity would.
        """
        bent = self.force[0] * self.force[0]
        bent += self.force[1] * self.force[1]
        np.sqrt(bent, out=bent)
        np.maximum(bent, np.maximum(self._friction, LEAST_FRICTION), out=bent)
        return np.asarray(fluctuation * touching / bent)

    def update(self, sliding: Float) -> None:
        """Update the bristles by the new sliding velocity (2, B) [m/s]."""
        self.force = self._predicted_force + self._velocity_gain * sliding


class Coulomb:
    """Kinetic Coulomb friction, regularised below a creep speed, without memory or stiction."""

    def __init__(self, bristles: Bristles, velocity: Float, dt: float) -> None:
        del dt
        self._friction = bristles.friction
        self.force = bristles.friction * velocity / np.sqrt(np.square(velocity).sum(axis=0) + CREEP_SPEED_M_S**2)

    def linearise(
        self, sliding: Float, flank_friction: Float, surface_slope: Float, touching: Mask
    ) -> tuple[Float, Float]:
        """Return a = 0 and b (B,) [s/m] of the friction force per load a + b v_new; arguments of `LuGre.linearise`."""
        del touching
        speed = np.sqrt(np.square(sliding).sum(axis=0) + CREEP_SPEED_M_S**2)
        flank = (surface_slope * sliding).sum(axis=0) * flank_friction / speed
        return np.zeros_like(sliding), np.maximum(self._friction + flank, 0.0) / speed

    def measure_grip(self, fluctuation: Float, touching: Mask) -> Float:
        """Return the load (B,) [N] that a fluctuation of the friction force (B,) [N] is worth."""
        return np.asarray(fluctuation * touching / np.maximum(self._friction, LEAST_FRICTION))

    def update(self, sliding: Float) -> None:
        """Do nothing, since this law has no state."""


FRICTION_LAWS: dict[str, type[FrictionLaw]] = {"lugre": LuGre, "coulomb": Coulomb}
"""Friction laws by name."""


HAND_DRAG_PER_S = 10.0
"""Drag of the hand along the normal, per mass [1/s]: it only slows free flight, far below the contact's own damping."""


@dataclass(frozen=True)
class Physics:
    """Physical effects that the simulation models; the default is all of them, other values are for ablations.

    Attributes
    ----------
    friction : {"lugre", "coulomb"}
        Friction law; Coulomb has no bristles and no Stribeck curve.
    unilateral : bool
        True if the contact only pushes (N ≥ 0); else the spring also pulls, and the probe never leaves the surface.
    friction_noise : bool
        True if the friction force fluctuates by itself.
    body : bool
        True if the probe's body has its resonances; else it is rigid.
    """

    friction: str = "lugre"
    unilateral: bool = True
    friction_noise: bool = True
    body: bool = True

    def __post_init__(self) -> None:
        if self.friction not in FRICTION_LAWS:
            raise ValueError(f"friction {self.friction!r}: one of {', '.join(sorted(FRICTION_LAWS))}.")


@dataclass(frozen=True)
class ContactMotion:
    """Motion of B contacts at every integration step.

    Attributes
    ----------
    acceleration : ndarray, shape (steps, 3, B)
        Acceleration [m/s²].
    normal_n : ndarray, shape (steps, B)
        Normal force, 0 without contact [N].
    sliding_m_s : ndarray, shape (steps, 2, B)
        Velocity of the tip over the surface [m/s].
    """

    acceleration: Float
    normal_n: Float
    sliding_m_s: Float


DRIVE_COUNT = 8
"""Number of inputs of the contact simulation (drives), in this order: height [m], slopes along x and y, the hand's
velocity x and y [m/s], force [N], rise of friction with slope, fluctuation of the friction force [N]."""


def integrate_contact(
    blocks: Iterable[Float], mechanics: Sequence[Mechanics], probe: Probe, dt: float, physics: Physics
) -> Iterator[ContactMotion]:
    """Integrate the motion of a probe at B contacts by semi-implicit Euler from static equilibrium.

    Parameters
    ----------
    blocks : iterable of ndarray, shape (DRIVE_COUNT, steps + 2, B)
        Inputs over time, in the order of `DRIVE_COUNT`; the first and last step of a block repeat the adjacent blocks'
        steps.
    mechanics : sequence of Mechanics
        Mechanics of each contact.
    probe : Probe
        The probe.
    dt : float
        Time step [s].
    physics : Physics
        Physical effects to model.

    Yields
    ------
    ContactMotion
        Motion of one block.

    Notes
    -----
    Friction is implicit, since it is stiff near rest; the normal contact is explicit, since its resonance is far below
    1/dt.
    """
    known = [with_defaults(entry) for entry in mechanics]
    damping = 2.0 * np.array([entry.damping_ratio for entry in known]) * np.sqrt(probe.mass_kg)
    # Hertz in series with the probe's own spring: δ = b s² + s³/k_probe with s = N^(1/3).
    b = 1.5 / np.array([surface_stiffness_at_1n(entry, probe) for entry in mechanics])
    inverse_mass = 1.0 / probe.mass_kg
    hand_spring = probe.hand_stiffness_n_m * inverse_mass
    hand_damper = 2.0 * probe.hand_damping_ratio * np.sqrt(hand_spring)
    friction: FrictionLaw | None = None
    for drives in blocks:
        height, slope, velocity = drives[0, 1:-1], drives[1:3, 1:-1], drives[3:5, 1:-1]
        force, flank_friction = (
            np.maximum(drives[5, 1:-1], 0.0),
            drives[6, 1:-1],
        )  # cubic interpolation undershoots at a sudden lift
        climb = (drives[0, 2:] - drives[0, :-2]) * (0.5 / dt)
        if friction is None:
            load = np.cbrt(force[0])
            z, vz = height[0] - (b * load**2 + load**3 / probe.stiffness_n_m), climb[0].copy()
            friction = FRICTION_LAWS[physics.friction](derive_bristles(mechanics, probe), velocity[:, 0], dt)
            lateral = -force[0] * friction.force / probe.hand_stiffness_n_m
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

            impulse = np.maximum(normal, 0.0)
            touching = impulse > 0.0
            impulse *= dt * inverse_mass
            sliding = velocity[:, i] + v_lateral
            constant, linear = friction.linearise(sliding, flank_friction[i], slope[:, i], touching)
            grip = friction.measure_grip(drives[7, i + 1], touching)
            grip *= dt * inverse_mass
            np.maximum(grip, -impulse, out=grip)
            fluctuation = constant * grip
            constant += slope[:, i]
            constant *= impulse
            constant += fluctuation
            impulse += grip
            linear *= impulse
            linear += 1.0
            new_sliding = np.subtract(sliding, constant, out=slidings[i])
            new_sliding -= (dt * hand_spring) * lateral
            new_sliding -= (dt * hand_damper) * v_lateral
            new_sliding /= linear
            friction.update(new_sliding)
            # Acceleration is relative to the hand, whose own motion is no vibration of the probe.
            change = new_sliding - sliding
            v_lateral += change
            lateral += dt * v_lateral
            np.multiply(change, 1.0 / dt, out=acceleration[i, :2])
        yield ContactMotion(acceleration, normals, slidings)


def compute_contact_force(depth: Float, b: Float, probe_stiffness: float) -> tuple[Float, Float]:
    """Return elastic force [N] and tangent stiffness [N/m] at a penetration δ ≥ 0 [m] of a Hertzian contact and spring.

    Solves δ = b s² + s³/k, F = s³: b is the surface's Hertzian compliance, k the stiffness of the probe in series. With
    s = sqrt(δ/b) / y, y³ = y + β, β = sqrt(δ/b) / (b k): three fixed-point steps, then Newton. The error of F is below
    1e-6 up to β = 30 (the pen), 2e-4 up to 3000, and 0.3 % for a fingertip that strikes stone with 20 N.
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


RADIUS_STEP = 1.03
"""Ratio of consecutive contact radii for which maps are smoothed; where κ · 2π · radius = 3, the low-pass is off by 3 %
at most."""


@dataclass
class SmoothedMaps:
    """One height map as B-spline coefficients, smoothed for several contact radii; the latest `cache_size` are cached.

    Attributes
    ----------
    height : ndarray of float32, shape (H, W)
        One period of the map [m], column → +x, row → −y.
    size_m : float
        Side of the square tile [m].
    cache_size : int
        Number of radii in the cache.
    """

    height: NDArray[np.float32]
    size_m: float = TILE_SIZE_M
    cache_size: int = 8
    _spectrum: NDArray[np.complex128] | None = None
    _cache: OrderedDict[int, NDArray[np.float32]] = field(default_factory=OrderedDict)

    def coefficients(self, radius_m: float) -> NDArray[np.float32]:
        """Return B-spline coefficients (H, W) of the map smoothed by a contact of this radius [m]."""
        level = round(float(np.log(max(radius_m, 1e-7)) / np.log(RADIUS_STEP)))
        if level not in self._cache:
            self._cache[level] = self._compute_coefficients(RADIUS_STEP**level)
            if len(self._cache) > self.cache_size:
                self._cache.popitem(last=False)
        self._cache.move_to_end(level)
        return self._cache[level]

    def _compute_coefficients(self, radius_m: float) -> NDArray[np.float32]:
        rows, columns = self.height.shape
        if self._spectrum is None:
            spectrum = np.fft.rfft2(self.height)
            # B-spline interpolation is an exact division on a periodic grid (Unser 1999, IEEE Sig. Proc. Mag. 16).
            spectrum /= _spline_gain(np.fft.fftfreq(rows))[:, None] * _spline_gain(np.fft.rfftfreq(columns))[None, :]
            self._spectrum = spectrum
        kx, ky = wavenumbers(rows, self.size_m)
        scale = -0.1 * (2.0 * np.pi * radius_m) ** 2
        gain = np.exp(scale * np.square(ky)) * np.exp(scale * np.square(kx))
        return np.fft.irfft2(self._spectrum * gain, (rows, columns)).astype(np.float32)

    def sample(self, position: Float, radius_m: float) -> tuple[Float, Float, Float]:
        """Return height [m], ∂h/∂x and ∂h/∂y, (n,) each, at positions (n, 2) [m, +y up] for a contact radius [m]."""
        coefficients = self.coefficients(radius_m)
        rows, columns = coefficients.shape
        pixel = self.size_m / columns
        u, v = position[:, 0] / pixel, -position[:, 1] / pixel
        column, row = np.floor(u), np.floor(v)
        wx, dx = _spline_weights(u - column)
        wy, dy = _spline_weights(v - row)
        taps = np.arange(-1, 3)
        xs = (column[:, None].astype(np.int64) + taps) % columns
        ys = (row[:, None].astype(np.int64) + taps) % rows
        patch = np.take(coefficients.ravel(), ys[:, :, None] * columns + xs[:, None, :])  # (n, 4, 4)
        across = np.einsum("nyx,nx->ny", patch, wx)
        slope = np.einsum("nyx,nx->ny", patch, dx)
        height = np.einsum("ny,ny->n", across, wy)
        slope_x = np.einsum("ny,ny->n", slope, wy) / pixel
        slope_y = -np.einsum("ny,ny->n", across, dy) / pixel
        return height.astype(np.float64), slope_x.astype(np.float64), slope_y.astype(np.float64)


def _spline_gain(frequency: Float) -> Float:
    """Return the frequency response of cubic B-spline samples at f [cycles/pixel], (4 + 2 cos 2πf) / 6."""
    return np.asarray((2.0 + np.cos(2.0 * np.pi * frequency)) / 3.0)


def _spline_weights(t: Float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return cubic B-spline weights (n, 4) of the four samples around fractions t, 0 … 1, and derivatives by t."""
    s = 1.0 - t
    weights = np.stack([s**3, 3 * t**3 - 6 * t**2 + 4, 3 * s**3 - 6 * s**2 + 4, t**3], axis=-1) / 6.0
    slopes = np.stack([-(s**2), 3 * t**2 - 4 * t, -3 * s**2 + 4 * s, t**2], axis=-1) / 2.0
    return weights.astype(np.float32), slopes.astype(np.float32)
