"""Motion of the probe over a measured relief, integrated in time through the whole contact.

Where the surface under the path is known, what is felt is that surface: the probe's mass on the Hertzian contact in
series with its own spring, Tsuji's damper, N ≥ 0, and along the path LuGre's friction, the slopes that it climbs and
the hand that holds it. These are the simulator's equations (`simulation.contact_dynamics`) in the plane of the stroke,
so that tones stand at v/λ with their phase in arc length, a seam is the blow that it is, and no seed has a say. The
force under which the hand presses is part of it; the linear contact of `contact_filter` has no part in such a stroke.

The two axes are fused as DFT321 fuses three, in short overlapping windows, so that a blow stays where it is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from ...action.action import Action, ForceCurve
from ...kernel.compiled_carriers import integrate_motion
from ...kernel.loader import load_kernel
from ...material.contact_model import (
    STATIC_OVER_KINETIC,
    STRIBECK_SPEED_M_S,
    Mechanics,
    body_response,
    compute_bristles,
    contact_radius,
    tip_gain,
    with_defaults,
)
from ...material.probe import Probe, get_probe
from ..carriers import ARC_PER_OCTAVE, MODEL_RATE_HZ, Carriers
from ..height_profile import find_finest
from ..linear_contact import (
    ASPERITY_SHARE,
    FLANK_FRICTION,
    SurfaceSpectrum,
    compute_surface_spectrum,
    project_spectrum,
    upper_fade,
)
from ..stroke import (
    SAMPLES_PER_STATE,
    HeightProfile,
    StrokeInput,
    catmull_rom_weights,
    evaluate_bspline,
    find_distinct_mechanics,
    interpolate_cubic,
    interpolate_position,
    sample_count,
)
from .taps import (
    LARGEST_STEP,
    MOST_STEPS,
    NormalContact,
    count_tap_steps,
    find_lifted_states,
    find_tap_spans,
    make_normal_contact,
)

Float = NDArray[np.float64]

FUSED_SAMPLES = 512
"""Samples of a window in which the two axes are fused: 51 ms."""
SPECTRUM_STATES = 32
"""States along a stroke whose height spectra tell how much waves across it are smoothed."""
UPSAMPLING = 4
"""Factor by which a profile's grid is refined before it is read between samples: 16 samples a wave or more."""
RADII_PER_OCTAVE = 2
"""Radii of contact per octave for which a profile is smoothed, as the simulator's at a load that varies."""
LEAST_RADIUS_M = 1e-6
"""Radius below which a contact smooths nothing [m]."""
GRID_M_S2 = 2.0**-23
"""Step to which the acceleration is rounded, so that a change of the force leaves no trace a second later [m/s²]."""
BODY_DECAY_S = 0.03
"""Time for which a blow rings in the probe's body at most [s]."""
DECIMATION_SAMPLES, FILTER_BLOCK = 16, 2048
"""Reach of the low-pass from integration steps to samples, and the block in which it is applied [samples]."""


@dataclass(frozen=True)
class MovingContact:
    """Constants of a probe and the surface that it is dragged over.

    Attributes
    ----------
    normal : NormalContact
        The contact along the normal.
    hand_spring, hand_damper : float
        Stiffness and damping of the hand along the path, per mass [1/s²], [1/s].
    friction, stiction, stribeck : float
        Coulomb μ, STATIC_OVER_KINETIC − 1, and STRIBECK_SPEED_M_S [m/s].
    bristle_stiffness, bristle_damping : float
        LuGre's σ0 and σ1 per load at 1 N [1/m], [s/m].
    """

    normal: NormalContact
    hand_spring: float
    hand_damper: float
    friction: float
    stiction: float
    stribeck: float
    bristle_stiffness: float
    bristle_damping: float

    @cached_property
    def columns(self) -> Float:
        """All constants in the order of hnf_moving_contact, (13,), as the kernel takes them."""
        along = [getattr(self, each.name) for each in fields(self) if each.name != "normal"]
        return np.concatenate([self.normal.columns[:-1], along, self.normal.columns[-1:]])


def count_steps(mechanics: Mechanics, probe: Probe) -> int:
    """Return the integration steps per 10 kHz sample that a contact takes, at most MOST_STEPS."""
    return count_tap_steps(mechanics, probe) or MOST_STEPS


def make_moving_contact(mechanics: Mechanics, probe: Probe, steps: int) -> MovingContact:
    """Make the constants of a material under a probe, at `steps` integration steps per 10 kHz sample.

    What would be unstable at so many steps is softened to what is stable, which `range_check.check_ranges` says.
    """
    stiffest = probe.mass_kg * (MODEL_RATE_HZ * steps * LARGEST_STEP) ** 2
    if probe.stiffness_n_m > stiffest:
        probe = probe._replace(stiffness_n_m=stiffest)
    known, (bristles, bristle_damping) = with_defaults(mechanics), compute_bristles(mechanics, probe)
    most = 0.5 * MODEL_RATE_HZ * steps * LARGEST_STEP / math.sqrt(probe.stiffness_n_m / probe.mass_kg)
    stable = replace(mechanics, damping_ratio=min(known.damping_ratio, most))
    hand = probe.hand_stiffness_n_m / probe.mass_kg
    return MovingContact(
        make_normal_contact(stable, probe, steps),
        hand,
        2.0 * probe.hand_damping_ratio * math.sqrt(hand),
        known.friction,
        STATIC_OVER_KINETIC - 1.0,
        STRIBECK_SPEED_M_S,
        bristles,
        bristle_damping,
    )


def integrate_numpy(contact: MovingContact, drives: Float, state: Float) -> tuple[Float, Float]:
    """Integrate as the kernel's hnf_contact_motion: semi-implicit Euler, friction implicit. See integrate_motion."""
    c, spring, dt = contact, contact.normal, contact.normal.dt
    z, vz, lateral, v_lateral, bristle = state.tolist()
    height, slope, velocity, load, flank_friction = (row.tolist() for row in drives)
    steps, bristle_step = len(height) - 2, contact.bristle_stiffness * dt
    bristle_damping = contact.bristle_damping / bristle_step
    normal_out, along_out = np.empty(steps), np.empty(steps)
    for i in range(1, steps + 1):
        depth, normal = height[i] - z, 0.0
        if depth > 0.0:
            normal, stiffness = spring.compute_force(depth)
            climb = (height[i + 1] - height[i - 1]) * (0.5 / dt)
            normal = max(normal + spring.damping * math.sqrt(stiffness) * (climb - vz), 0.0)
        az = (normal - load[i]) * spring.inverse_mass - spring.drag * vz
        vz += dt * az
        z += dt * vz
        normal_out[i - 1] = az
        sliding = velocity[i] + v_lateral
        square = sliding * sliding + 1e-14
        speed = math.sqrt(square)
        stribeck = math.exp(max(-square / c.stribeck**2, -700.0))
        level = c.friction * (1.0 + c.stiction * stribeck) + slope[i] * sliding * flank_friction[i] / speed
        level = max(level, 1e-6)
        if normal <= 0.0:
            bristle = 0.0
        divided = 1.0 / (1.0 + bristle_step * speed / level)
        predicted, damped, share = bristle * divided, bristle_damping * stribeck, bristle_step * divided
        gain, impulse = 1.0 + damped, normal * dt * spring.inverse_mass
        fixed = gain * predicted - damped * bristle + slope[i]
        following = sliding - impulse * fixed - dt * (c.hand_spring * lateral + c.hand_damper * v_lateral)
        following /= 1.0 + impulse * gain * share
        bristle = predicted + share * following
        along_out[i - 1] = (following - sliding) / dt
        v_lateral += following - sliding
        lateral += dt * v_lateral
    state[:] = z, vz, lateral, v_lateral, bristle
    return normal_out, along_out


def render_motion_axes(
    stroke: StrokeInput, action: Action, token_index: NDArray[np.int32], carriers: Carriers
) -> Float:
    """Render the motion of a probe over a measured relief, under the force on it, without noise.

    Parameters
    ----------
    stroke
        Stroke with a height profile.
    action
        Motion of the hand at the 200 Hz states, from resample_action.
    token_index
        (n,) index of the material at each state, from resample_action.
    carriers
        Carriers of the field, whose arc bands are those of the token's height spectrum.

    Returns
    -------
    ndarray
        (2, count) acceleration along the path and along the normal, at the model rate [m/s²].

    Raises
    ------
    ValueError
        If the stroke has no height profile.
    """
    if stroke.profile is None:
        raise ValueError("a stroke without a height profile has no relief to move over")
    force = np.where(action.contact, action.force, 0.0)
    mechanics, rows = find_distinct_mechanics(stroke.mechanics)
    material = rows[token_index]
    surface = _SmoothedProfile(stroke.profile, _describe_surface(stroke, action, token_index, carriers), carriers)
    probe, count = get_probe(action.probe), sample_count(action)
    touched = [int(index) for index in np.unique(material)]
    steps = max(count_steps(mechanics[index], probe) for index in touched)
    # Two samples before and three after the stroke, for the splines between samples.
    sample = np.arange(-2, count + 3)
    position = interpolate_position(action, -2, count + 5)
    load = _interpolate_load(force, action.force_curve, sample)
    velocity = np.gradient(position) * MODEL_RATE_HZ
    contacts = {index: make_moving_contact(mechanics[index], probe, steps) for index in touched}
    reliefs = {index: _read_relief(surface, position, load, mechanics[index], probe) for index in touched}
    axes, state, previous = np.zeros((2, count * steps)), None, contacts[touched[0]]
    lifted = find_lifted_states(force)
    # A touch begins at rest, before the splines of its force do.
    for ahead in (1, 2):
        lifted[:-ahead] &= force[ahead:] <= 0.0
    bounds = (np.flatnonzero((np.diff(material) != 0) | np.diff(lifted)) + 1).tolist()
    for first, last in zip([0, *bounds], [*bounds, len(material)], strict=True):
        begin, end = first * SAMPLES_PER_STATE, min(last * SAMPLES_PER_STATE, count)
        if begin >= end:
            break
        if lifted[first]:
            state = None
            continue
        contact = contacts[int(material[first])]
        height, slope, flank_friction = reliefs[int(material[first])]
        drives = np.stack([height, slope, velocity, load, flank_friction])[:, begin : end + 5]
        drives = _interpolate_drives(drives, steps)
        if state is None:
            state = _find_equilibrium(contact, drives)
        elif contact is not previous:
            _change_material(state, previous, contact, drives)
        previous = contact
        axes[:, begin * steps : end * steps] = integrate(contact, drives, state)
    return _decimate(axes[::-1], steps, probe)


def render_motion(stroke: StrokeInput, action: Action, token_index: NDArray[np.int32], carriers: Carriers) -> Float:
    """Render the acceleration (count,) [m/s²] of a tip that slides over a measured relief, its two axes as one signal.

    The relief moves the tip along its normal and along the stroke (`render_motion_axes`, with the same parameters);
    `fuse_axes` adds their powers, as DFT321 does.
    """
    return fuse_axes(render_motion_axes(stroke, action, token_index, carriers))


def integrate(contact: MovingContact, drives: Float, state: Float) -> tuple[Float, Float]:
    """Integrate the motion by the kernel, or in Python without it; state (5,) is continued. See integrate_motion."""
    kernel = load_kernel()
    if kernel is None:
        return integrate_numpy(contact, drives, state)
    return integrate_motion(kernel, contact.columns, np.ascontiguousarray(drives), state)


def _interpolate_load(force: Float, curve: ForceCurve | None, sample: NDArray[np.int64]) -> Float:
    """Return the load at samples (m,) ≥ 0 [N]: as taps have it where it changes fast, else as slow pressing has it."""
    state = np.asarray(sample / SAMPLES_PER_STATE, dtype=np.float64)
    load = evaluate_bspline(force, state)
    for begin, end in find_tap_spans(force, curve):
        rows = (state >= begin) & (state <= end)
        fast = (
            interpolate_cubic(force, np.asarray(state[rows]))
            if curve is None
            else curve.evaluate(sample[rows] / MODEL_RATE_HZ)
        )
        share = np.clip(np.minimum(state[rows] - begin, end - state[rows]), 0.0, 1.0)
        load[rows] += share * (fast - load[rows])
    return np.maximum(load, 0.0)


def _find_equilibrium(contact: MovingContact, drives: Float) -> Float:
    """Return the state (5,) in which a probe slides steadily as the first step's drives (5, …) say."""
    height, slope, velocity, load, _ = drives[:, 1].tolist()
    speed = abs(velocity)
    level = contact.friction * (1.0 + contact.stiction * math.exp(-min((speed / contact.stribeck) ** 2, 700.0)))
    bristle = level * velocity / max(speed, 1e-9)
    climb = (drives[0, 2] - drives[0, 0]) * (0.5 / contact.normal.dt)
    # The hand holds what the slope and the bristles push, also at rest on a flank.
    pushed = load * (bristle + slope) * contact.normal.inverse_mass
    lateral = -pushed / contact.hand_spring if contact.hand_spring else 0.0
    return np.array([height - contact.normal.compute_depth(load), climb, lateral, 0.0, bristle])


def _change_material(state: Float, before: MovingContact, contact: MovingContact, drives: Float) -> None:
    """Let another material take over at the same elastic force, since surfaces join without a step."""
    depth = float(drives[0, 1]) - float(state[0])
    if depth > 0.0:
        state[0] = float(drives[0, 1]) - contact.normal.compute_depth(before.normal.compute_force(depth)[0])


def _interpolate_drives(values: Float, factor: int) -> Float:
    """Interpolate rows (5, m + 5) to (5, m · factor + 2) by Catmull–Rom splines, with a fine step more on either side.

    The first of m samples is the third.
    """
    fraction = np.arange(factor) / factor
    a, b, c, d = (values[:, shift : values.shape[1] - 3 + shift, None] for shift in range(4))
    weights = catmull_rom_weights(fraction)
    fine = sum(weight * each for weight, each in zip(weights, (a, b, c, d), strict=True))
    rows = np.asarray(fine).reshape(len(values), -1)
    return np.ascontiguousarray(rows[:, factor - 1 : rows.shape[1] - factor + 1])


def _read_relief(
    surface: _SmoothedProfile, position: Float, load: Float, mechanics: Mechanics, probe: Probe
) -> tuple[Float, Float, Float]:
    """Return height [m], slope and rise of friction with slope (m,) under a contact whose radius follows the load.

    Slopes act on the spots that carry the load, and are smoothed less than heights, as in the simulator.
    """
    radius = np.asarray(contact_radius(mechanics, probe, load), dtype=np.float64)
    fastest = float(np.abs(np.diff(position)).max()) * MODEL_RATE_HZ
    place = RADII_PER_OCTAVE * np.log2(np.maximum(radius, LEAST_RADIUS_M))
    height, slope = np.zeros((2, len(position)))
    # The radii are the same for every stroke, so that pressing harder at one point changes nothing elsewhere.
    for node in range(math.floor(place.min()), math.floor(place.max()) + 2):
        weight = np.maximum(1.0 - np.abs(place - node), 0.0)
        if not weight.any():
            continue
        smoothing = 2.0 ** (node / RADII_PER_OCTAVE)
        height += weight * surface.read(position, smoothing, fastest, slope=False)
        slope += weight * surface.read(position, ASPERITY_SHARE * smoothing, fastest, slope=True)
    return height, slope, FLANK_FRICTION * np.square(np.maximum(1.0 - radius / probe.tip_radius_m, 0.0))


def _describe_surface(
    stroke: StrokeInput, action: Action, token_index: NDArray[np.int32], carriers: Carriers
) -> SurfaceSpectrum:
    """Return the height spectra of the surface at some states in contact, in the frame of the stroke."""
    touched = np.flatnonzero(action.contact) if action.contact.any() else np.arange(1)
    chosen = touched[np.linspace(0, len(touched) - 1, min(len(touched), SPECTRUM_STATES)).astype(int)]
    tokens = stroke.tokens[token_index[chosen]].astype(np.float64)
    return compute_surface_spectrum(tokens, action.direction[chosen], carriers)


class _SmoothedProfile:
    """A height profile that is read between its samples, smoothed by a contact of some radius.

    The contact averages over a disc, of which the profile is a line: a wave that crosses the path is shorter than it
    looks along it, and smoothed more. How much power is left of all waves that have one wavenumber along the path, the
    token's height spectrum says.
    """

    def __init__(self, profile: HeightProfile, spectrum: SurfaceSpectrum, carriers: Carriers) -> None:
        self._profile, self._spectrum, self._carriers = profile, spectrum, carriers
        count = len(profile.height)
        self._rise = (profile.height[-1] - profile.height[0]) / max(count - 1, 1)
        self._size = 1 << int(np.ceil(np.log2(2 * count)))
        self._wavenumber = np.fft.rfftfreq(self._size, profile.step_m)
        level = profile.height - profile.height[0] - self._rise * np.arange(count)
        resolved = self._wavenumber <= find_finest(profile)
        self._heights = np.fft.rfft(level, self._size) * resolved

    def read(self, position: Float, radius: float, fastest: float, *, slope: bool) -> Float:
        """Return the height [m], or the slope, at positions (m,) under a contact of a radius [m].

        Waves too short for the model rate at the speed `fastest` [m/s] are left out. Beyond its ends the profile is
        level.
        """
        count, profile = len(self._profile.height), self._profile
        spectrum = self._heights * self._compute_gain(radius) * upper_fade(self._wavenumber * fastest)
        if slope:
            spectrum = spectrum * (2j * np.pi * self._wavenumber)
        fine = UPSAMPLING * np.fft.irfft(spectrum, UPSAMPLING * self._size)[: UPSAMPLING * (count - 1) + 1]
        place: Float = (position - profile.origin_m) / profile.step_m
        inside = np.clip(place, 0.0, count - 1.0)
        values = interpolate_cubic(fine, np.asarray(UPSAMPLING * inside, dtype=np.float64))
        if slope:
            return np.where(inside == place, values + self._rise / profile.step_m, 0.0)
        return np.asarray(values + profile.height[0] + self._rise * inside)

    def _compute_gain(self, radius: float) -> Float:
        """Return the gain of the profile's waves (k,) under a contact of a radius [m]."""
        kappa = self._carriers.arc_centres()
        tip = np.repeat(np.square(tip_gain(kappa, np.asarray(radius)))[None], len(self._spectrum.noise), axis=0)
        left = project_spectrum(self._spectrum, tip, self._carriers).sum(axis=0)
        whole = project_spectrum(self._spectrum, np.ones_like(tip), self._carriers).sum(axis=0) * tip[0]
        # Beside a tone are its own sidelobes and scatter, which the token counts to the tone.
        octave = np.bartlett(2 * ARC_PER_OCTAVE + 1)
        left, whole = np.convolve(left, octave, "same"), np.convolve(whole, octave, "same")
        across = np.sqrt(np.clip(np.divide(left, whole, out=np.ones_like(left), where=whole > 1e-30), 0.0, 1.0))
        return tip_gain(self._wavenumber, np.asarray(radius)) * np.interp(self._wavenumber, kappa, across)


def _decimate(axes: Float, steps: int, probe: Probe) -> Float:
    """Return the axes (2, count · steps) at the model rate, (2, count), as the probe's resonant body moves.

    A finite filter in blocks, so that a sample depends on its neighbors alone.
    """
    impulse = _decimation_filter(probe, steps)
    ahead, block, count = DECIMATION_SAMPLES * steps, FILTER_BLOCK * steps, axes.shape[1]
    blocks = -(-count // block)
    size = 1 << int(np.ceil(np.log2(block + len(impulse))))
    padded = np.zeros((2, (blocks - 1) * block + size))
    begin = len(impulse) - 1 - ahead
    padded[:, begin : begin + count] = axes
    frames = sliding_window_view(padded, size, axis=1)[:, ::block]
    filtered = np.fft.irfft(np.fft.rfft(frames, axis=2) * np.fft.rfft(impulse, size), size, axis=2)
    valid = filtered[:, :, len(impulse) - 1 : len(impulse) - 1 + block : steps]
    return np.asarray(valid.reshape(2, -1)[:, : count // steps])


@lru_cache(maxsize=16)
def _decimation_filter(probe: Probe, steps: int) -> Float:
    """Return the low-pass at `steps` times the model rate together with the probe's body, as an impulse response.

    It begins DECIMATION_SAMPLES before its centre, and lasts until the body has decayed.
    """
    half = DECIMATION_SAMPLES * steps
    place = np.arange(-half, half + 1)
    low_pass = np.sinc(place / steps) * np.kaiser(2 * half + 1, 6.0)
    low_pass /= low_pass.sum()
    if not probe.body_modes:
        return np.asarray(low_pass)
    rate = MODEL_RATE_HZ * steps
    length = len(low_pass) + round(BODY_DECAY_S * rate)
    size = 1 << int(np.ceil(np.log2(4 * length)))
    response = np.fft.rfft(low_pass, size) * body_response(np.fft.rfftfreq(size, 1.0 / rate), probe)
    impulse = np.fft.irfft(response, size)[:length]
    impulse.setflags(write=False)
    return np.asarray(impulse)


def fuse_axes(axes: Float) -> Float:
    """Fuse the axes (2, n) of acceleration into one signal of the same spectral power, as DFT321, in short windows.

    The windows overlap by half, so that a single active axis is returned as it is.
    """
    hop, count = FUSED_SAMPLES // 2, axes.shape[1]
    blocks = count // hop + 2
    window = np.sin(np.pi * (np.arange(FUSED_SAMPLES) + 0.5) / FUSED_SAMPLES)
    padded = np.zeros((2, (blocks + 1) * hop))
    padded[:, hop : hop + count] = axes
    frames = sliding_window_view(padded, FUSED_SAMPLES, axis=1)[:, ::hop] * window
    spectra = np.fft.rfft(frames, axis=2)
    total = spectra.sum(axis=0)
    size, magnitude = np.abs(total), np.sqrt(np.square(np.abs(spectra)).sum(axis=0))
    phase = np.divide(total, size, out=np.ones_like(total), where=size > 1e-12 * magnitude)
    fused = np.fft.irfft(magnitude * phase, FUSED_SAMPLES, axis=1) * window
    out = np.zeros((blocks + 1, hop))
    out[:-1] += fused[:, :hop]
    out[1:] += fused[:, hop:]
    return np.asarray(np.rint(out.reshape(-1)[hop : hop + count] / GRID_M_S2) * GRID_M_S2)
