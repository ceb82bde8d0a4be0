"""Force noise of friction, and the response of the probe's body: linear parts of the emission, in closed form.

A stiff tip is one junction, whose friction fluctuates along the path (`contact_model.friction_noise_power`). A
fingertip is a pad of ridges: each ridge cell is a junction of its own under its part of the load, so that fine weaves
and grits are felt that a smooth pad of its size would average away. The fluctuations of N junctions add in power; each
junction's is limited by the friction it has, filtered by its own size and by the ridges that follow each other over the
same place, and by what the surface's loose fibres bend before they slip. Threads and ribs also modulate the load of
every junction. The force moves a light, strongly damped skin.

Sources: J. Scheibert, S. Leurent, A. Prevost & G. Debrégeas (2009), Science 323, and A. Prevost et al. (2009) (ridges
filter at f = v / spacing). M. Wiertlewski & V. Hayward (2012), J. Biomech. 45 (impedance of the fingertip). M. J. Adams
et al. (2013), J. R. Soc. Interface 10 (contact area ∝ F^0.5). C. M. van Wyk (1946), J. Textile Inst. 37 (compression of
fibres, p ∝ T⁻³ − T₀⁻³). P. R. Dahl (1968) (pre-sliding). F. T. Peirce (1937), J. Textile Inst. 28 (geometry of cloth).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..kernel.compiled_force_noise import FrictionTables
from ..kernel.loader import load_kernel
from ..material.contact_model import (
    FRICTION_NOISE_FORCE_EXPONENT,
    FRICTION_NOISE_WAVENUMBER,
    KnownMechanics,
    Mechanics,
    body_response,
    friction_noise_power,
    integrate_power_law,
    with_defaults,
)
from ..material.probe import Pad, Probe, get_probe
from .carriers import ARC_PER_OCTAVE, Carriers
from .contact.lattice_lines import HARMONICS, PathLines
from .linear_contact import (
    FORCE_FLOOR_N,
    SPEED_FLOOR_M_S,
    Condition,
    arc_gain,
    fade_frequency,
    lateral_hand_impedance,
    upper_fade,
)

Float = NDArray[np.float64]

TANGENTIAL_OVER_NORMAL = 0.82
"""Tangential over normal stiffness of a Hertzian contact at ν = 0.3 (R. D. Mindlin 1949, J. Appl. Mech. 16)."""
SPOT_SHARE = 0.5
"""Radius of the spots that carry a junction's load over the junction's own (J. F. Archard 1957)."""
LEAST_RUBBING_N = 1e-12
"""Least friction of a junction [N], so that a surface without friction has a limit."""
LEAST_THREAD_M = 1e-9
"""Spacing below which threads are none: a junction averages them away by far [m]."""
THREAD_RELIEF = 0.1
"""RMS relief of threads and ribs under a finger, relative to their spacing: crimp of cloth (Peirce 1937), rough."""
THREAD_HARMONIC = 0.35
"""Amplitude of the second harmonic of that relief relative to the first."""
THREAD_ORDERS = 2
"""Harmonics of it that count."""
THREAD_TOLERANCE = 0.06
"""Relative difference of a line's pitch up to which it is the threads of a material."""
PILE_PRESSURE_PA, PILE_LEFT = 5e3, 0.5
"""Pressure [Pa], and the depth of a pile under it relative to its free depth. That of a light finger; the depth is
assumed: 4 kPa crush a pile, so that its thickness is measured under 0.7 kPa (ASTM D1777)."""


def lateral_mobility(frequency_hz: Float, probe: Probe) -> Float:
    """Return |acceleration / force|² sideways [1/kg²] of a probe's mass in the hand, or of a fingertip's skin."""
    square = np.square(2.0 * np.pi * np.asarray(frequency_hz, dtype=np.float64))
    if probe.pad is not None:
        mass, spring, damper = probe.pad.skin_mass_kg, probe.pad.skin_stiffness_n_m, probe.pad.skin_damping_n_s_m
        return np.asarray(np.square(square) / (np.square(spring - mass * square) + np.square(damper) * square))
    stiffness, damping = lateral_hand_impedance(probe)
    response = np.square(square) / (np.square(stiffness - square) + damping * square)
    return np.asarray(response / probe.mass_kg**2)


def pad_force_power(
    low_cycles_m: Float, high_cycles_m: Float, mechanics: Mechanics, pad: Pad, force_n: ArrayLike
) -> Float:
    """Compute the power [N²] of the tangential force on a fingertip between two wavenumbers; arguments broadcast.

    Parameters
    ----------
    low_cycles_m, high_cycles_m
        Wavenumbers along the path, above 0 [cycles/m].
    mechanics
        Mechanics of the material.
    pad
        The fingertip's pad.
    force_n
        Normal force [N].

    Returns
    -------
    ndarray
        Power of the force along the path.
    """
    known, force = with_defaults(mechanics), np.asarray(force_n, dtype=np.float64)
    area = pad.contact_area_m2 * np.sqrt(force)
    junctions = area / pad.ridge_spacing_m**2
    load = force / junctions
    longest, shortest = 1.0 / (2.0 * np.sqrt(area / np.pi)), 1.0 / (2.0 * pad.junction_radius_m)
    fibres = _pile_compliance(known.pile_m, force, area)
    kappa = np.sqrt(low_cycles_m * high_cycles_m)
    ridges = ridge_gain(kappa, pad) * _presliding_gain(kappa, known, force, fibres)
    half = np.sqrt(2.0)
    slope, centre = known.friction_noise_slope, FRICTION_NOISE_WAVENUMBER
    density = np.square(known.friction_noise_n * load**FRICTION_NOISE_FORCE_EXPONENT) / integrate_power_law(
        centre / half, centre * half, slope
    )
    # A junction cannot fluctuate by more than it rubs.
    rubbing = np.square(np.maximum(known.friction * load, LEAST_RUBBING_N))
    limit = 1.0 + density * integrate_power_law(longest, shortest, slope) / rubbing
    noise = junctions * density / limit * integrate_power_law(low_cycles_m, high_cycles_m, slope)
    noise = noise * spot_gain(kappa, SPOT_SHARE * pad.junction_radius_m)
    if known.thread_spacing_m > LEAST_THREAD_M:
        noise = noise + _thread_power(low_cycles_m, high_cycles_m, known, pad, force, junctions, fibres)
    return np.asarray(noise * ridges)


def _pile_compliance(depth_m: float, force: Float, area: Float) -> Float:
    """Return the compliance [m/N] of a pile under a finger's pressure p = K (T⁻³ − T₀⁻³), T₀ its free depth."""
    left = np.cbrt(1.0 / (1.0 + (PILE_LEFT**-3 - 1.0) * force / (area * PILE_PRESSURE_PA)))
    return np.asarray(depth_m * left * (1.0 - left**3) / (3.0 * force))


def _presliding_gain(kappa: Float, known: KnownMechanics, force: Float, fibres: Float) -> Float:
    """Return the power gain of wavenumbers by what the surface's fibres bend before they slip (Dahl 1968)."""
    bend = known.friction * force * fibres / TANGENTIAL_OVER_NORMAL
    return np.asarray(1.0 / (1.0 + np.square(2.0 * np.pi * kappa * bend)))


def _thread_power(
    low: Float, high: Float, known: KnownMechanics, pad: Pad, force: Float, junctions: Float, fibres: Float
) -> Float:
    """Return the power [N²] per band of the friction of junctions whose load threads or ribs modulate."""
    power = np.zeros(np.broadcast_shapes(np.shape(low), np.shape(force)))
    for order in range(1, THREAD_ORDERS + 1):
        wavenumber = order / known.thread_spacing_m
        line = _thread_line_power(order, known, pad, force, junctions, fibres)
        power += np.where((low <= wavenumber) & (wavenumber < high), line, 0.0)
    return power


def _thread_line_power(
    order: int, known: KnownMechanics, pad: Pad, force: Float, junctions: Float, fibres: Float
) -> Float:
    """Return the power [N²] of one harmonic of the friction that threads or ribs modulate."""
    crests = 2.0 * junctions * pad.ridge_modulus_pa * pad.junction_radius_m
    compression = force * (1.0 / crests + fibres)
    relief = np.square(THREAD_RELIEF * known.thread_spacing_m) / (1.0 + THREAD_HARMONIC**2)
    total = relief * (1.0 + THREAD_HARMONIC**2)
    amplitude = 1.0 if order == 1 else THREAD_HARMONIC
    share = relief * amplitude**2 / (total + np.square(compression))
    line = 0.5 * np.square(known.friction * force) / junctions * share
    return np.asarray(line * spot_gain(np.asarray(order / known.thread_spacing_m), pad.junction_radius_m))


def find_thread_lines(lines: PathLines, mechanics: Mechanics, probe: Probe) -> NDArray[np.bool_]:
    """Find which lines (n, L) of a lattice are the threads or ribs that a fingertip's ridges catch on.

    None under a stiff tip, which has no ridges.
    """
    spacing = mechanics.thread_spacing_m or 0.0
    if probe.pad is None or spacing <= LEAST_THREAD_M:
        return np.zeros(lines.wavenumber.shape, dtype=bool)
    return np.asarray(np.abs(lines.pitch_wavenumber * spacing - 1.0) < THREAD_TOLERANCE)


def compute_thread_tones(
    lines: PathLines, is_thread: NDArray[np.bool_], speed: Float, force: Float, mechanics: Mechanics, probe: Probe
) -> Float:
    """Compute the acceleration power (n, L · harmonics) of threads and ribs under a fingertip, as tones.

    It is what `pad_force_power` has of them, divided among the lines that are threads. is_thread: (n, L) from
    find_thread_lines. speed, force: (n,), not below their floors.
    """
    out = np.zeros((*is_thread.shape, len(HARMONICS)))
    if probe.pad is not None and is_thread.any():
        known, pad = with_defaults(mechanics), probe.pad
        area = pad.contact_area_m2 * np.sqrt(force)
        junctions, fibres = area / pad.ridge_spacing_m**2, _pile_compliance(known.pile_m, force, area)
        share = is_thread / np.maximum(is_thread.sum(axis=1, keepdims=True), 1)
        for order in range(1, THREAD_ORDERS + 1):
            line = _thread_line_power(order, known, pad, force, junctions, fibres)
            along = order * lines.wavenumber
            ridges = ridge_gain(along, pad) * _presliding_gain(along, known, force[:, None], fibres[:, None])
            hertz = np.maximum(along * speed[:, None], 1e-9)
            gain = lateral_mobility(hertz, probe) * np.square(fade_frequency(hertz))
            out[:, :, order - 1] = share * line[:, None] * ridges * gain
    return out.reshape(len(out), -1)


def ridge_gain(wavenumber_cycles_m: Float, pad: Pad) -> Float:
    """Return the power gain of wavenumbers by ridges that follow each other over the same place.

    Their spacing jitters, so the peaks at its multiples fade (structure factor of a chain; R. Hosemann 1950).
    """
    phase = 2.0 * np.pi * np.asarray(wavenumber_cycles_m) * pad.ridge_spacing_m
    coherence = pad.ridge_coherence * np.exp(-0.5 * np.square(phase * pad.ridge_jitter))
    return np.asarray((1.0 - coherence**2) / (1.0 + coherence**2 - 2.0 * coherence * np.cos(phase)))


def spot_gain(wavenumber_cycles_m: Float, radius_m: float) -> Float:
    """Return the mean power gain, 0 to 1, of wavenumbers under Hertzian spots of a radius [m].

    |3 (sin q − q cos q) / q³|² without its lobes, q = 2πκa: 1 − q²/5 for long waves, 9 / (2 q⁴) for short ones.
    """
    square = np.square(2.0 * np.pi * np.asarray(wavenumber_cycles_m) * radius_m)
    return np.asarray(1.0 / (1.0 + square / 5.0 + 2.0 / 9.0 * np.square(square)))


def add_force_noise(alpha: Float, condition: Condition, carriers: Carriers) -> Float:
    """Add friction's force noise to the amplitudes of n states, then apply the response of the probe's body.

    Parameters
    ----------
    alpha
        (n, heads, K + tones) amplitudes of the contact along the normal, and of the slopes [m/s²].
    condition
        The n states.
    carriers
        Carriers of the amplitudes.

    Returns
    -------
    ndarray
        As alpha; what is 0 at rest and out of contact stays 0.

    Notes
    -----
    Both are linear and independent of the relief, so powers add and the network need not learn them. Waves along the
    path that are shorter than the arc carriers go to the time carriers.
    """
    kernel, alpha = load_kernel(), np.array(alpha, dtype=np.float64, order="C")
    speed, force, moving = _get_rubbing(condition)
    scale = _compute_scale(condition, moving)
    for rows, tables in _iterate_materials(condition, moving, carriers):
        if kernel is not None and tables.compiled is not None:
            rubbing = np.stack([speed[rows], force[rows], scale[rows]], axis=1)
            tables.compiled.add(kernel, alpha, rows, rubbing)
        else:
            noise = tables.compute_power(speed[rows], force[rows]) * scale[rows, None]
            power = np.square(alpha[rows, :, : carriers.count]) + noise[:, None, :]
            power *= tables.compute_body_power(speed[rows])[:, None, :]
            alpha[rows, :, : carriers.count] = np.sqrt(power, out=power)
    if condition.lines is not None and alpha.shape[2] > carriers.count:
        tones = alpha[:, :, carriers.count :]
        for rows, power in _iterate_thread_tones(condition):
            tones[rows] = np.sqrt(np.square(tones[rows]) + power[:, None, :])
        if get_probe(condition.probe).body_modes:
            tables = get_force_noise(condition.mechanics[0], condition.probe, carriers)
            frequency = condition.lines.compute_tone_wavenumbers() * condition.speed[:, None]
            tones *= tables.compute_body_gain(frequency)[:, None, :]
    return alpha


def compute_force_noise_power(condition: Condition, carriers: Carriers) -> tuple[Float, Float]:
    """Compute the power (n, K) of friction's force noise as the probe's body moves, and the body's power gain."""
    power, gain = np.zeros((len(condition.speed), carriers.count)), np.ones((len(condition.speed), carriers.count))
    speed, force, moving = _get_rubbing(condition)
    scale = _compute_scale(condition, moving)
    for rows, tables in _iterate_materials(condition, moving, carriers):
        gain[rows] = tables.compute_body_power(speed[rows])
        power[rows] = tables.compute_power(speed[rows], force[rows]) * scale[rows, None] * gain[rows]
    return power, gain


def _iterate_materials(
    condition: Condition, moving: Float, carriers: Carriers
) -> Iterator[tuple[NDArray[np.intp], ForceNoise]]:
    """Yield the states (m,) of each material that move, by `moving` (n,), and its tables."""
    for index, mechanics in enumerate(condition.mechanics):
        of_material = np.flatnonzero((condition.material == index) & (moving > 0.0))
        for rows, rest in _separate_threads(condition, of_material, mechanics):
            yield rows, get_force_noise(rest, condition.probe, carriers)


def _get_rubbing(condition: Condition) -> tuple[Float, Float, Float]:
    """Return speed and force (n,), not below their floors, and the factor on power, 0 at rest and in the air to 1."""
    sliding = np.clip(condition.speed / SPEED_FLOOR_M_S, 0.0, 1.0) * np.clip(condition.force / FORCE_FLOOR_N, 0.0, 1.0)
    moving = np.square(np.where(condition.contact, sliding, 0.0))
    return np.maximum(condition.speed, SPEED_FLOOR_M_S), np.maximum(condition.force, FORCE_FLOOR_N), moving


def _compute_scale(condition: Condition, moving: Float) -> Float:
    """Return the factor (n,) on the noise's power: `moving`, and the share that stick–slip leaves along the path."""
    return moving if condition.along_share is None else moving * condition.along_share


def _separate_threads(
    condition: Condition, rows: NDArray[np.intp], mechanics: Mechanics
) -> Iterator[tuple[NDArray[np.intp], Mechanics]]:
    """Yield states of one material with the mechanics for their noise, split by how a finger feels the cloth's threads.

    Where the threads are a tone (`find_thread_lines`), the mechanics have no threads; elsewhere they are part of the
    noise. rows: (n,) states on the material.
    """
    lines, probe = condition.lines, get_probe(condition.probe)
    has_tones = np.zeros(len(rows), dtype=bool)
    if lines is not None and probe.pad is not None and len(rows):
        has_tones = find_thread_lines(lines[rows], mechanics, probe).any(axis=1)
    for chosen, rest in ((rows[~has_tones], mechanics), (rows[has_tones], replace(mechanics, thread_spacing_m=0.0))):
        if len(chosen):
            yield chosen, rest


def _iterate_thread_tones(condition: Condition) -> Iterator[tuple[NDArray[np.intp], Float]]:
    """Yield the moving states (m,) of each material whose threads are tones, and their power (m, L · harmonics)."""
    lines, probe = condition.lines, get_probe(condition.probe)
    if lines is None or probe.pad is None:
        return
    speed, force, moving = _get_rubbing(condition)
    scale = _compute_scale(condition, moving)
    for index, mechanics in enumerate(condition.mechanics):
        rows = np.flatnonzero((condition.material == index) & (moving > 0.0))
        is_thread = find_thread_lines(lines[rows], mechanics, probe)
        if is_thread.any():
            power = compute_thread_tones(lines[rows], is_thread, speed[rows], force[rows], mechanics, probe)
            yield rows, power * scale[rows, None]


STEPS_PER_BAND = 8
"""Frequencies of the tables per arc band: the nearest is within 0.2 % of the one looked up."""
TABLE_OCTAVES = 14
"""Octaves of speed above its floor that the tables cover, up to 16 m/s; faster ones take the last value."""
LOADS_PER_OCTAVE = 8
"""Loads per octave in a pad's table, between which its logarithm is interpolated."""


class ForceNoise:
    """Tables of force noise and body of one material under one probe, for many states at once or for one.

    They hold what `force_noise_bands` and `body_gains` compute: gains follow from frequency alone, which steps evenly
    in log f from one arc carrier to the next.

    Parameters
    ----------
    mechanics
        Mechanics of the material.
    probe
        The probe.
    carriers
        Carriers of the amplitudes, with arc carriers.
    """

    def __init__(self, mechanics: Mechanics, probe: Probe, carriers: Carriers) -> None:
        self._carriers, self._mechanics, self._probe = carriers, mechanics, probe
        count, step = carriers.arc_count, STEPS_PER_BAND
        self._per_octave = ARC_PER_OCTAVE * step
        size = TABLE_OCTAVES * self._per_octave + count * step
        self._first_hz = carriers.arc_centres()[0] * SPEED_FLOOR_M_S
        frequency = self._first_hz * np.exp2(np.arange(size) / self._per_octave)
        # arc_gain takes wavenumber times speed, which here is the frequency itself.
        gain = lateral_mobility(frequency, probe) * np.square(arc_gain(frequency, np.ones(1))[0])
        self._body = np.square(np.abs(body_response(frequency, probe)))
        edges, limits = carriers.arc_edges(), carriers.time_edges()
        # Row i of these views is the tables at the frequencies of all arc carriers, if the first is the table's i-th.
        self._arc_gain, self._arc_body = (
            np.lib.stride_tricks.sliding_window_view(table, count * step)[:, ::step] for table in (gain, self._body)
        )
        middle = np.sqrt(limits[:-1] * limits[1:])
        self._time_gain = lateral_mobility(middle, probe) * np.square(upper_fade(middle))
        self._time_body = np.square(np.abs(body_response(middle, probe)))
        self._bands = _force_power(edges[:-1], edges[1:], mechanics, probe, np.ones(1))
        known = with_defaults(mechanics)
        self._exponent = 1.0 - known.friction_noise_slope
        if abs(self._exponent) < 1e-3:
            self._exponent = 1e-3
        scale = friction_noise_power(edges[-2], edges[-1], mechanics, 1.0)
        unit = edges[-1] ** self._exponent - edges[-2] ** self._exponent
        # The power between two wavenumbers is a difference of these, at κ = f / v.
        self._time_power = (scale / unit) * limits**self._exponent
        self._time_start = float(scale / unit * edges[-1] ** self._exponent)
        self._log_loads = np.zeros((0, count))
        if probe.pad is not None:
            loads = FORCE_FLOOR_N * np.exp2(np.arange(LOAD_OCTAVES * LOADS_PER_OCTAVE + 1) / LOADS_PER_OCTAVE)
            power = _force_power(edges[:-1], edges[1:], mechanics, probe, loads[:, None])
            self._log_loads = np.log(np.maximum(power, 1e-60))
        self._gain = gain

    @cached_property
    def compiled(self) -> FrictionTables | None:
        """Tables for the kernel; None for carriers of the published form, which it does not have."""
        if self._carriers.constant:
            return None
        return FrictionTables(
            rows=TABLE_OCTAVES * self._per_octave, step=STEPS_PER_BAND, gain=self._gain, body=self._body,
            time_gain=self._time_gain, time_body=self._time_body, bands=self._bands, time_power=self._time_power,
            log_loads=self._log_loads, per_octave=self._per_octave, log_least_speed=math.log(SPEED_FLOOR_M_S),
            log_first_hz=math.log(self._first_hz), loads_per_octave=LOADS_PER_OCTAVE,
            log_least_force=math.log(FORCE_FLOOR_N), force_exponent=2.0 * FRICTION_NOISE_FORCE_EXPONENT,
            exponent=self._exponent, time_start=self._time_start,
        )  # fmt: skip

    def compute_power(self, speed: Float, force: Float) -> Float:
        """Compute the acceleration power (n, K) of the force noise; speed, force: (n,), not below their floors."""
        carriers = self._carriers
        power = np.zeros((len(speed), carriers.count))
        if self._probe.pad is not None:
            position = np.minimum(LOADS_PER_OCTAVE * np.log2(force / FORCE_FLOOR_N), len(self._log_loads) - 1.0)
            low = np.minimum(position.astype(np.intp), len(self._log_loads) - 2)
            share = (position - low)[:, None]
            bands = np.exp(self._log_loads[low] * (1.0 - share) + self._log_loads[low + 1] * share)
            power[:, carriers.arc_slice] = bands * self._arc_gain[self._find_rows(speed)]
            return power
        load = (force ** (2.0 * FRICTION_NOISE_FORCE_EXPONENT))[:, None]
        power[:, carriers.arc_slice] = (load * self._bands) * self._arc_gain[self._find_rows(speed)]
        integral = np.maximum(self._time_power * (speed[:, None] ** -self._exponent), self._time_start)
        power[:, carriers.time_slice] = np.diff(integral, axis=1) * load * self._time_gain
        return power

    def compute_body_power(self, speed: Float) -> Float:
        """Compute the body's power gain (n, K) for speeds (n,) not below their floor [m/s]."""
        carriers = self._carriers
        gains = np.empty((len(speed), carriers.count))
        gains[:, carriers.time_slice] = self._time_body
        gains[:, carriers.arc_slice] = self._arc_body[self._find_rows(speed)]
        return gains

    def add_to_state(self, alpha: Float, speed: float, force: float, moving: float) -> None:
        """Add force noise and body to the amplitudes (K,) of one state, in place; see add_force_noise.

        speed [m/s] and force [N] are not below their floors; moving is 0 at rest to 1.
        """
        kernel, scale = load_kernel(), moving * moving
        if kernel is not None and self.compiled is not None:
            self.compiled.add_to_state(kernel, alpha, speed, force, scale)
            return
        at = np.array([speed])
        power = np.square(alpha) + scale * self.compute_power(at, np.array([force]))[0]
        np.sqrt(power * self.compute_body_power(at)[0], out=alpha)

    def compute_body_gain(self, frequency: Float) -> Float:
        """Return the body's gain at frequencies [Hz], interpolated in the table, as arrays of their shape."""
        kernel = load_kernel()
        if kernel is not None and self.compiled is not None:
            return self.compiled.compute_body_gains(kernel, frequency)
        octaves = np.log2(np.maximum(frequency, 1e-9) / self._first_hz)
        place = np.minimum(np.maximum(self._per_octave * octaves, 0.0), len(self._body) - 1.001)
        row = place.astype(np.intp)
        return np.asarray(np.sqrt(self._body[row] + (place - row) * (self._body[row + 1] - self._body[row])))

    def _find_rows(self, speed: Float) -> NDArray[np.intp]:
        """Return the rows (n,) of the tables of all arc carriers at speeds (n,)."""
        row = np.rint(self._per_octave * np.log2(speed / SPEED_FLOOR_M_S)).astype(np.intp)
        return np.asarray(np.minimum(row, TABLE_OCTAVES * self._per_octave - 1))


LOAD_OCTAVES = 12
"""Octaves of load above its floor in a pad's table, up to 82 N."""


@lru_cache(maxsize=256)
def get_force_noise(mechanics: Mechanics, probe: str, carriers: Carriers) -> ForceNoise:
    """Return the tables of a material under a probe, cached."""
    return ForceNoise(mechanics, get_probe(probe), carriers)


def force_noise_bands(speed: Float, force: Float, mechanics: Mechanics, probe: Probe, carriers: Carriers) -> Float:
    """Compute the acceleration power (n, K) per carrier that friction's force noise causes at n states.

    speed, force: (n,) [m/s] and [N], not below their floors.
    """
    pace, load = speed[:, None], force[:, None]
    noise, edges = np.zeros((len(speed), carriers.count)), carriers.arc_edges()
    centres = carriers.arc_centres()
    gain = lateral_mobility(centres * pace, probe) * np.square(arc_gain(centres, speed))
    noise[:, carriers.arc_slice] = _force_power(edges[:-1], edges[1:], mechanics, probe, load) * gain
    if carriers.time_count and carriers.arc_count:
        limits = carriers.time_edges()
        low, high = (np.maximum(limit / pace, edges[-1]) for limit in (limits[:-1], limits[1:]))
        middle = np.sqrt(limits[:-1] * limits[1:])
        gain = lateral_mobility(middle, probe) * np.square(upper_fade(middle))
        noise[:, carriers.time_slice] = _force_power(low, high, mechanics, probe, load) * gain
    return noise


def _force_power(low: Float, high: Float, mechanics: Mechanics, probe: Probe, force: Float) -> Float:
    """Return the power [N²] of the force noise between wavenumbers, for a stiff tip or a pad."""
    if probe.pad is None:
        return friction_noise_power(low, high, mechanics, force)
    return pad_force_power(low, high, mechanics, probe.pad, force)


def body_gains(speed: Float, probe: Probe, carriers: Carriers) -> Float:
    """Return |body_response| (n, K) at the frequency of each carrier, for speeds (n,) not below their floor [m/s]."""
    gains = np.ones((len(speed), carriers.count))
    if probe.body_modes:
        edges = carriers.time_edges()
        gains[:, carriers.time_slice] = np.abs(body_response(np.sqrt(edges[:-1] * edges[1:]), probe))
        gains[:, carriers.arc_slice] = np.abs(body_response(carriers.arc_centres() * speed[:, None], probe))
    return gains
