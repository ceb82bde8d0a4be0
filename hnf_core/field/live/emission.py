"""Evaluation of F_Θ for a single state of the hand, in a fraction of its 5 ms, by the compiled kernel or in numpy.

Everything that depends on token, mechanics and probe alone is computed once per material, and all angles of the
surface's spectrum are evaluated at once. The same formulas, for many states at once, are in field.evaluate,
linear_contact.py; results differ by float32 rounding.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from ctypes import CDLL
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...errors import UsageError
from ...kernel.compiled_field import StateEvaluator, ToneArrays
from ...kernel.loader import load_kernel
from ...material.contact_model import (
    Mechanics,
    power_gain,
    surface_stiffness_at_1n,
    with_defaults,
)
from ...material.probe import Probe, get_probe
from ...material.token import BAND_FEATURES, BAND_WAVELENGTHS_M
from ...progress import add_work
from ..carriers import ARC_PER_OCTAVE, Carriers
from ..contact.lattice_lines import (
    HARMONIC_SHIFTS,
    HARMONIC_START_LOG,
    HARMONICS,
    LINE_COUNT,
    LINE_FLOOR_M_S2,
    LINE_GAIN_COUNT,
    Lines,
    PathLines,
    compute_line_shares,
    gather_sidebands,
    split_bands,
    take_tones,
)
from ..features import (
    AMPLITUDE_FLOOR_M_S2,
    DIRECTION_COLUMN,
    MECHANICS_COLUMN,
    REFERENCE_RESONANCE_HZ,
    REFERENCE_SPEED_M_S,
    TIME_SHARE_DB,
    encode_action,
    log_amplitude,
    normalise_tokens,
)
from ..field import LOG_AMPLITUDE_CEILING, Field, encode_fixed_inputs, get_emitter, kernel_supports
from ..force_noise import compute_thread_tones, find_thread_lines, get_force_noise
from ..linear_contact import (
    ANGLES,
    FLANK_FRICTION,
    FORCE_FLOOR_N,
    GRID_ANGLES,
    LINE_CONCENTRATION,
    ORIENTED_DENSITY_MEAN,
    SPEED_FLOOR_M_S,
    arc_gain,
    compute_surface_spectrum,
    fade_frequency,
    lateral_hand_impedance,
    noise_remainder,
    time_edges_in_arc_bands,
)

Float = NDArray[np.float64]

_HALF = ANGLES // 2
_ANGLE = GRID_ANGLES[:, None]
_TWO, _FOUR = np.exp(-2j * _ANGLE) * (4.0 / 3.0), np.exp(-4j * _ANGLE) * (2.0 / 3.0)
_ROTATION_EXPONENTS = np.array([[-2j], [-4j]])
_TAPS = np.arange(2)[:, None]


@dataclass(frozen=True)
class ProjectedSpectrum:
    """Power along a stroke of one surface, under three weightings of its waves.

    noise: (3, Ka) per arc band (band of wavenumber). lines: (3, 2, lines) of tones, in the two arc bands about each.
    low: (lines,) index of the lower of the two, which may lie outside 0 … Ka − 1.
    """

    noise: Float
    lines: Float
    low: NDArray[np.intp]


class LiveSurfaceSpectrum:
    """Height spectrum of one material, from its token (TOKEN_DIM,), ready to be projected onto any stroke direction."""

    def __init__(self, token: Float, carriers: Carriers) -> None:
        bands, count = len(BAND_WAVELENGTHS_M), carriers.arc_count
        feature = {name: values[0] for name, values in split_bands(np.asarray(token)[None]).items()}
        self._moments = np.stack([feature["cos2"] + 1j * feature["sin2"], feature["cos4"] + 1j * feature["sin4"]])
        self._peak, self._power = feature["peak"].copy(), 10.0 ** (2.0 * feature["level"])
        reference = compute_surface_spectrum(np.asarray(token)[None], np.array([[1.0, 0.0]]), carriers)
        self._octaves = ARC_PER_OCTAVE * np.log2(np.tile(reference.line_wavenumber[0], 2) / carriers.arc_centres()[0])
        position = np.log2(carriers.arc_centres() * BAND_WAVELENGTHS_M[0])
        self._below = np.clip(np.floor(position).astype(int), 0, bands - 2)
        self._share = np.clip(position - self._below, 0.0, 1.0)
        self._line_at = np.clip(np.rint(self._octaves[:bands]).astype(int), 0, count - 1)
        shift = np.rint(-ARC_PER_OCTAVE * np.log2(np.abs(np.cos(_ANGLE[:_HALF, 0])))).astype(int)
        source = np.arange(count)[None, :] + shift[:, None]
        self._source = np.where(source < count, source, count)
        self._density_at = (np.arange(_HALF) * bands)[:, None] + np.append(reference.band, 0)[self._source]
        self._weighted, self._moved = np.zeros((3, count + 1)), np.empty((3, *self._source.shape))

    def project(self, angle: float, weight: Float) -> ProjectedSpectrum:
        """Compute the power along a stroke at `angle` [rad], under three weightings of the surface's waves.

        weight: (3, Ka) factors on the power of waves per band of their wavenumber |κ|.
        """
        two, four = self._moments * np.exp(angle * _ROTATION_EXPONENTS)
        axis = 0.25 * np.arctan2(four.imag, four.real)
        along = 0.5 * (1.0 + (two * np.exp(-2j * axis)).real)
        along = np.minimum(np.maximum(along, 0.0), 1.0)
        tones = compute_line_shares(self._peak, along, np.abs(four))
        density = self._density(two, four, axis, along)
        np.multiply(
            weight, self._spread_over_wavenumbers(self._power * noise_remainder(tones)), out=self._weighted[:, :-1]
        )
        np.take(self._weighted, self._source, axis=1, out=self._moved, mode="clip")
        noise = np.einsum("waj,aj->wj", self._moved, density.take(self._density_at))
        power = (weight[:, None, self._line_at] * (self._power * tones)).reshape(3, -1)
        cosine = np.abs(np.concatenate([np.cos(axis), np.sin(axis)]))
        # This floor corresponds to the reference's 1e-9 cycles/m, where a wave has no length along the stroke.
        position = np.maximum(self._octaves + ARC_PER_OCTAVE * np.log2(np.maximum(cosine, 1e-300)), -1e3)
        low = np.floor(position)
        fraction = position - low
        return ProjectedSpectrum(
            noise / ANGLES, np.stack([power * (1.0 - fraction), power * fraction], axis=1), low.astype(np.intp)
        )

    def _spread_over_wavenumbers(self, power: Float) -> Float:
        """Spread powers (bands,) per octave band of the token over the finer arc bands (Ka,)."""
        level = np.log(np.maximum(power, 1e-30) / ARC_PER_OCTAVE)
        return np.asarray(np.exp(level[self._below] * (1.0 - self._share) + level[self._below + 1] * self._share))

    def _density(self, two: NDArray[np.complex128], four: NDArray[np.complex128], axis: Float, along: Float) -> Float:
        """Return the angular density of waves at angle δ to the stroke plus that at π − δ, (ANGLES / 2, bands).

        Both have the same wavenumber along the stroke.
        """
        oriented = np.minimum(np.square(four.real) + np.square(four.imag), 1.0)
        series = 1.0 + two.real * _TWO.real - two.imag * _TWO.imag + four.real * _FOUR.real - four.imag * _FOUR.imag
        turned = np.cos(2.0 * (_ANGLE - axis))
        line = along * np.exp(LINE_CONCENTRATION * (turned - 1.0)) + (1.0 - along) * np.exp(
            -LINE_CONCENTRATION * (turned + 1.0)
        )
        density = np.maximum((1.0 - oriented) * series + oriented * line / ORIENTED_DENSITY_MEAN, 0.0)
        return np.asarray(density[:_HALF] + density[: _HALF - 1 : -1])


@dataclass(frozen=True)
class LinearState:
    """Prediction of the linear contact for one state of the hand, as LinearContact for many.

    power, noise: (Ka,) per arc band. normal, resonance: numbers. lines: (2, lines) tone power. low: (lines,). gain:
    (Ka,) fade at the limits of the audible band, arc_gain at its speed.
    """

    power: Float
    noise: Float
    normal: float
    resonance: float
    lines: Float
    low: NDArray[np.intp]
    gain: Float


class LiveLinearContact:
    """Response of one probe's mass on the spring and damper of one material's contact, evaluated state by state."""

    def __init__(self, token: Float, mechanics: Mechanics, probe: Probe, carriers: Carriers) -> None:
        self._of = token, carriers
        self._kappa = carriers.arc_centres()
        self._wave = np.square(2.0 * np.pi * self._kappa)
        self._known, self._probe = with_defaults(mechanics), probe
        self._surface = surface_stiffness_at_1n(mechanics, probe)
        self._weight = np.empty((3, len(self._kappa)))

    @cached_property
    def _spectrum(self) -> LiveSurfaceSpectrum:
        """Height spectrum of the surface; built lazily because only `evaluate` needs it."""
        return LiveSurfaceSpectrum(*self._of)

    def contact_columns(self, angle: float, speed: float, force: float) -> tuple[tuple[float, ...], float]:
        """Return a state's contact parameters in the order of CONTACT_COLUMNS, and the contact's resonance [Hz].

        angle: direction of the stroke [rad]. speed: [m/s] and force: [N], not below their floors.
        """
        probe, tip_radius = self._probe, self._probe.tip_radius_m
        surface = self._surface * force ** (1.0 / 3.0)
        stiffness = surface * probe.stiffness_n_m / (surface + probe.stiffness_n_m)
        radius = min(math.sqrt(1.5 * force * tip_radius / (stiffness if probe.soft_tip else surface)), tip_radius)
        damping = 4.0 * self._known.damping_ratio**2 * stiffness * probe.mass_kg
        rubbed = 1.0 + self._known.friction**2
        flank = (1.0 + FLANK_FRICTION * (1.0 - radius / tip_radius) ** 2) ** 2 - 1.0
        resonance = math.sqrt(stiffness / probe.mass_kg) / (2.0 * math.pi)
        leaning = (force / probe.mass_kg) ** 2
        return (angle, speed, radius, stiffness, damping, probe.mass_kg, leaning, rubbed, flank), resonance

    def evaluate(self, angle: float, speed: float, force: float) -> LinearState:
        """Compute the linear contact of a state in numpy.

        angle: direction of the stroke [rad]. speed: [m/s] and force: [N], not below their floors.
        """
        touch, resonance = self.contact_columns(angle, speed, force)
        radius, stiffness, damping, mass, leaning, rubbed, flank = touch[2:]
        gain, wave = arc_gain(self._kappa, np.array([speed]))[0], self._wave
        # These are the squares of tip_gain at κ, and at half of it because the bearing spots are half as large.
        reach_square = wave * radius**2
        tip_power, slope_power, spot_power = weight = self._weight
        np.exp(reach_square * (-1.0 / 5.0), out=tip_power)
        np.exp(reach_square * (-1.0 / 20.0), out=spot_power)
        np.multiply(spot_power, wave, out=slope_power)
        angular_square, fade = wave * speed**2, np.square(gain)
        hand, hand_damping = lateral_hand_impedance(self._probe)
        lateral = np.square(angular_square) / (np.square(hand - angular_square) + hand_damping * angular_square)
        normal_gain, lateral_gain = (
            power_gain(angular_square, stiffness, damping, mass) * fade,
            lateral * leaning * fade,
        )
        projection = self._spectrum.project(angle, weight)
        normal_noise = projection.noise[0] * normal_gain
        noise = normal_noise * rubbed + (projection.noise[1] + flank * wave * projection.noise[2]) * lateral_gain
        count = len(wave)
        carrier = projection.low + _TAPS
        clipped = np.minimum(np.maximum(carrier, 0), count - 1)
        tone_power = projection.lines[0] * normal_gain[clipped]
        lines = (
            tone_power * rubbed
            + (projection.lines[1] + flank * wave[clipped] * projection.lines[2]) * lateral_gain[clipped]
        )
        inside = carrier == clipped
        power = noise + np.bincount(clipped.ravel(), (lines * inside).ravel(), count)
        normal = float(normal_noise.sum() + (tone_power * inside).sum())
        return LinearState(power, noise, normal, resonance, lines, projection.low, gain)


class TimeBandPower:
    """Conversion of power per arc band to power per time band, for one state at a time."""

    def __init__(self, carriers: Carriers) -> None:
        self._edges = time_edges_in_arc_bands(carriers)
        self._sum = np.zeros(carriers.arc_count + 1)

    def to_time_bands(self, power: Float, speed: float) -> Float:
        """Convert power per arc band (Ka,), at a speed not below its floor, to power per time band (Kt,)."""
        np.cumsum(power, out=self._sum[1:])
        position = np.minimum(np.maximum(self._edges - ARC_PER_OCTAVE * math.log2(speed), 0.0), len(power))
        low = np.minimum(position.astype(int), len(power) - 1)
        start = self._sum[low]
        edges = start + (position - low) * (self._sum[low + 1] - start)
        return np.asarray(edges[1:] - edges[:-1])


Single = NDArray[np.float32]
Direction = Sequence[float] | Float

_START, _SHIFT = np.asarray(HARMONIC_START_LOG)[:, None, None], np.asarray(HARMONIC_SHIFTS)[:, None, None]
_LINE_OFFSETS = _SHIFT + np.arange(2)[:, None]
_BANDS, _WIDTH = len(BAND_WAVELENGTHS_M), len(BAND_FEATURES)
_RIGHT_ANGLE, _HALF_ROOT = 0.5 * math.pi, math.sqrt(0.5)
_MOMENT_COLUMNS = np.concatenate([np.arange(_BANDS) * _WIDTH + BAND_FEATURES.index(name) for name in ("cos2", "cos4")])
_SYMMETRY_ORDERS = np.repeat([2.0, 4.0], _BANDS)


class LiveEmission:
    """Evaluator of F_Θ on one material, state by state, by the kernel if it supports the field, else in numpy.

    Parameters
    ----------
    field
        The field.
    token
        (TOKEN_DIM,) descriptor of the material.
    mechanics
        Its stiffness, damping and friction.
    probe
        Name of the probe.
    lines
        Lines of this one material whose tones are to be apart from the carriers; None leaves them there.

    Raises
    ------
    UsageError
        If the field has a linear contact but no arc carriers; no such field is made.
    """

    def __init__(
        self, field: Field, token: Float, mechanics: Mechanics, probe: str, lines: Lines | None = None
    ) -> None:
        config = field.config
        if config.physics and not config.carriers.arc_count:
            raise UsageError("this field has no arc-length carriers to be felt live with.", remedy="Use another field.")
        self._of = field, np.array(token, dtype=np.float64)[None], mechanics, probe, lines
        self._lines, self._has_modes = lines, bool(get_probe(probe).body_modes)
        self._force_noise, self._is_thread = None, np.zeros((1, 0), dtype=bool)
        if config.force_noise:
            if lines is not None:
                straight = lines.project(np.zeros(1, np.int32), np.array([[1.0, 0.0]]))
                self._is_thread = find_thread_lines(straight, mechanics, get_probe(probe))
            rest = replace(mechanics, thread_spacing_m=0.0) if self._is_thread.any() else mechanics
            self._force_noise = get_force_noise(rest, probe, config.carriers)
        self._has_threads = bool(self._is_thread.any())
        self.evaluate((1.0, 0.0), 0.0, 0.0, contact=False)  # Builds the evaluator now, so that no touch waits for it.

    def evaluate(self, direction: Direction, speed: float, force: float, contact: bool) -> tuple[Float, Float]:
        """Return the amplitudes α (K + tones,), 0 at rest and in the air, and σΔt (N,); overwritten by the next call.

        direction: unit vector. speed: [m/s]. force: [N].
        """
        add_work("states")
        angle = math.atan2(direction[1], direction[0])
        floored_speed, floored_force = max(speed, SPEED_FLOOR_M_S), max(force, FORCE_FLOOR_N)
        moving = min(speed / SPEED_FLOOR_M_S, 1.0) * min(max(force, 0.0) / FORCE_FLOOR_N, 1.0) if contact else 0.0
        kernel = load_kernel()
        if kernel is not None and kernel_supports(self._of[0].config):
            part: CompiledEmission | NumpyEmission = self._compiled
            alpha, sigma = self._compiled.evaluate(kernel, direction, angle, floored_speed, floored_force, moving)
        else:
            part = self._numpy
            alpha, sigma = self._numpy.evaluate(direction, angle, floored_speed, floored_force, moving)
        if self._force_noise is not None and moving > 0.0:
            self._force_noise.add_to_state(alpha, floored_speed, floored_force, moving)
        if part.tones is None:
            return alpha, sigma
        tones = part.tones
        if self._has_threads and moving > 0.0:
            tones = self._add_threads(tones, part.along, floored_speed, floored_force, moving)
        if self._force_noise is not None and self._has_modes and moving > 0.0:
            frequency = np.multiply.outer(part.along, floored_speed * _HARMONICS).ravel()
            tones = tones * self._force_noise.compute_body_gain(frequency)
        return np.concatenate([alpha, tones]), sigma

    def _add_threads(self, tones: Float, along: Float, speed: float, force: float, moving: float) -> Float:
        """Return the tones (L · harmonics,) with those of threads under a fingertip.

        along: (L,) wavenumbers along the path [cycles/m]. speed [m/s] and force [N] are not below their floors.
        """
        lines, (_, _, mechanics, probe, _) = self._lines, self._of
        assert lines is not None
        here = PathLines(lines.column[None], lines.wavenumber, along[None])
        state = np.array([speed]), np.array([force])
        power = compute_thread_tones(here, self._is_thread, *state, mechanics, get_probe(probe))[0]
        return np.asarray(np.sqrt(np.square(tones) + power * moving**2))

    @cached_property
    def _compiled(self) -> CompiledEmission:
        """Evaluator by the kernel."""
        return CompiledEmission(*self._of)

    @cached_property
    def _numpy(self) -> NumpyEmission:
        """Evaluator in numpy."""
        return NumpyEmission(*self._of)


class NumpyEmission:
    """Evaluator of F_Θ on one material in numpy, state by state. token: (1, TOKEN_DIM)."""

    def __init__(
        self, field: Field, token: Float, mechanics: Mechanics, probe: str, lines: Lines | None = None
    ) -> None:
        config, carriers = field.config, field.config.carriers
        self._lines, self._scatter = lines, np.array([mechanics.pitch_scatter_m or 0.0])
        self.tones: Float | None = None
        self.along = np.zeros(0)
        self._config, self._carriers, self._kappa = config, carriers, carriers.arc_centres()
        # Products use einsum, because BLAS would start threads for so small a product, and wait for them.
        self._layers = [_transpose_layer(field, f"layer{index}") for index in range(config.layers)]
        self._alpha, self._sigma = _transpose_layer(field, "alpha"), _transpose_layer(field, "sigma")
        expansion = config.expansion()
        self._expansion = None if expansion is None else expansion.astype(np.float64)
        self._prior = np.zeros(carriers.count)
        self._x = np.zeros(len(self._layers[0][0]), dtype=np.float32)
        self._x[:MECHANICS_COLUMN] = normalise_tokens(token)[0]
        # normalise_tokens leaves direction moments unchanged, so rotating these equals features.rotate_to_stroke_frame.
        self._moments = token[0, _MOMENT_COLUMNS] + 1j * token[0, _MOMENT_COLUMNS + 1]
        self._x[MECHANICS_COLUMN:DIRECTION_COLUMN] = encode_fixed_inputs(mechanics, probe)
        self._linear: LiveLinearContact | None = None
        if config.physics:
            self._linear = LiveLinearContact(token[0], mechanics, get_probe(probe), carriers)
            self._time, self._skip = TimeBandPower(carriers), field.parameters["skip"].astype(np.float64)
        self._mass = get_probe(probe).mass_kg

    def evaluate(
        self, direction: Direction, angle: float, pace: float, load: float, moving: float
    ) -> tuple[Float, Float]:
        """Return the amplitudes α (K,) and σΔt (N,) of one state.

        angle: of `direction` [rad]. pace, load: speed [m/s] and force [N], not below their floors. moving: factor on α,
        0 at rest to 1.
        """
        carriers, lines = self._carriers, None
        if self._lines is not None:
            lines = self._lines.project(np.zeros(1, np.int32), np.array([[math.cos(angle), math.sin(angle)]]))
            self.along, self.tones = lines.wavenumber[0], np.zeros(self._lines.tone_count)
        linear = None if self._linear is None else self._linear.evaluate(angle, pace, load)
        time_power = None if linear is None else self._time.to_time_bands(linear.power, pace)
        hidden = self._fill_inputs(direction, angle, pace, load, linear, time_power)
        for weight, bias in self._layers:
            hidden = np.maximum(_multiply(weight, hidden) + bias, 0.0)
        sigma = np.logaddexp(0.0, (_multiply(self._sigma[0], hidden) + self._sigma[1]).astype(np.float64))
        if moving == 0.0:
            return np.zeros(carriers.count), sigma
        alpha = self._decode(
            (_multiply(self._alpha[0], hidden) + self._alpha[1]).astype(np.float64), linear, time_power, lines
        )
        alpha *= moving
        if carriers.arc_count:
            gain = arc_gain(self._kappa, np.array([pace]))[0] if linear is None else linear.gain
            alpha[carriers.arc_slice] *= gain
        if lines is not None and self.tones is not None:
            tones = self.tones[None] * (moving * fade_frequency(pace * lines.compute_tone_wavenumbers()))
            gather_sidebands(alpha[None, carriers.arc_slice], tones, lines, self._scatter, carriers)
            self.tones = tones[0]
        return alpha, sigma

    def _fill_inputs(
        self,
        direction: Direction,
        angle: float,
        pace: float,
        load: float,
        linear: LinearState | None,
        time_power: Float | None,
    ) -> Single:
        """Fill and return the network inputs (D,)."""
        config, x = self._config, self._x
        if config.stroke_frame:
            moments = np.exp(-1j * angle * _SYMMETRY_ORDERS) * self._moments
            x[_MOMENT_COLUMNS], x[_MOMENT_COLUMNS + 1] = moments.real, moments.imag
        elif config.directed:
            x[DIRECTION_COLUMN : DIRECTION_COLUMN + 2] = direction
        column = DIRECTION_COLUMN + 4
        x[column - 2 : column] = math.log(pace / REFERENCE_SPEED_M_S), math.log(load)
        if config.action_octaves:
            action = np.array([direction], dtype=np.float64), np.array([pace]), np.array([load])
            encoded = encode_action(*action, config.action_octaves, config.directed)
            x[column : column + encoded.shape[1]] = encoded[0]
            column += encoded.shape[1]
        if linear is not None and time_power is not None:
            count = len(time_power)
            x[column : column + count] = (log_amplitude(time_power) + 5.0) / 3.0
            bounce = self._mass * math.sqrt(linear.normal) / load
            x[column + count :] = (
                0.25 * math.log(float(linear.power.sum()) + AMPLITUDE_FLOOR_M_S2**2),
                0.5 * math.log(bounce + 1e-3),
                math.log(linear.resonance / REFERENCE_RESONANCE_HZ),
            )
        return x

    def _decode(
        self, head: Float, linear: LinearState | None, time_power: Float | None, lines: PathLines | None
    ) -> Float:
        """Return the carriers' amplitudes (K,) [m/s²] of one state, from what the network's α head returns for it.

        linear is the state of the linear contact, time_power its power in the time bands [(m/s²)²], lines the regular
        lines along the path; None where the field or the material has none. Rest and lift-off are applied later.
        """
        config, carriers = self._config, self._carriers
        gains = head[-LINE_GAIN_COUNT:] if config.line_gains else None
        alpha = head[:-LINE_GAIN_COUNT] if config.line_gains else head
        if self._expansion is not None:
            first = carriers.arc_slice.start
            alpha = np.concatenate([alpha[:first], self._expansion @ alpha[first:]])
        if linear is not None and time_power is not None:
            prior = self._prior
            prior[carriers.time_slice] = log_amplitude(time_power * 10.0 ** (TIME_SHARE_DB / 10.0))
            prior[carriers.arc_slice] = log_amplitude(linear.noise if gains is not None else linear.power)
            alpha = alpha + self._skip * prior
        if config.emission == "log":
            alpha = np.exp(np.minimum(alpha, LOG_AMPLITUDE_CEILING))
        if gains is not None and linear is not None:
            arc, level = alpha[carriers.arc_slice], linear.lines + LINE_FLOOR_M_S2**2
            if lines is not None:
                self.tones = take_tones(
                    gains[None], level[None], linear.low[None], lines, len(arc), LOG_AMPLITUDE_CEILING
                )[0]
            alpha[carriers.arc_slice] = np.sqrt(
                np.square(arc) + _compute_line_power(gains, level, linear.low, len(arc))
            )
        return np.asarray(alpha)


class CompiledEmission:
    """Evaluator of F_Θ on one material by the kernel, state by state. token: (1, TOKEN_DIM)."""

    def __init__(
        self, field: Field, token: Float, mechanics: Mechanics, probe: str, lines: Lines | None = None
    ) -> None:
        skip = np.asarray(field.parameters["skip"], dtype=np.float32)
        emitter = get_emitter(field.config, skip.tobytes(), probe, LOG_AMPLITUDE_CEILING)
        self._state = StateEvaluator(emitter, field.layers, token, np.array([encode_fixed_inputs(mechanics, probe)]))
        self._linear = LiveLinearContact(token[0], mechanics, get_probe(probe), field.config.carriers)
        self._mass = get_probe(probe).mass_kg
        self._arrays, self.along = None, np.zeros(0)
        self._each_line: list[tuple[float, float, int, bool]] = []
        if lines is not None:
            band, is_across = (lines.column % _BANDS).tolist(), (lines.column >= _BANDS).tolist()
            places = lines.wavenumber[0].tolist(), lines.angle[0].tolist()
            self._each_line = list(zip(*places, band, is_across, strict=True))
            scatter = np.array([mechanics.pitch_scatter_m or 0.0])
            self._arrays = ToneArrays(
                emitter, lines.column[None].astype(np.int64), lines.wavenumber, np.zeros_like(lines.wavenumber), scatter
            )  # fmt: skip
            self.along = self._arrays.along[0]

    @property
    def tones(self) -> Float | None:
        """RMS of the tones of the last state (L · harmonics,), None without lines; the next call overwrites them."""
        return None if self._arrays is None else self._arrays.tones[0]

    def evaluate(
        self, kernel: CDLL, direction: Direction, angle: float, pace: float, load: float, moving: float
    ) -> tuple[Float, Float]:
        """Return the amplitudes α (K,) and σΔt (N,) of one state; the next call overwrites α.

        Arguments as of NumpyEmission.evaluate.
        """
        touch, resonance = self._linear.contact_columns(angle, pace, load)
        if self._arrays is not None:
            # As Lines.project, which for so few lines is mostly the overhead of arrays.
            along, columns = [], []
            for wavenumber, axis, band, is_across in self._each_line:
                off = axis - angle
                along.append(wavenumber * abs(math.cos(off)))
                is_turned = abs(math.cos(off - _RIGHT_ANGLE if is_across else off)) < _HALF_ROOT
                columns.append(band + _BANDS if is_across != is_turned else band)
            self.along[:], self._arrays.column[0] = along, columns
        motion = (*direction, pace, load, self._mass, resonance, moving)
        alpha, sigma = self._state.evaluate(kernel, motion, touch, self._arrays)
        return alpha, np.logaddexp(0.0, sigma, dtype=np.float64)


def _transpose_layer(field: Field, name: str) -> tuple[Single, Single]:
    """Return weights (inputs, outputs) and bias of a layer."""
    return np.ascontiguousarray(field.parameters[f"{name}.weight"].T), field.parameters[f"{name}.bias"]


def _multiply(weight: Single, hidden: Single) -> Single:
    """Return the product of weights (inputs, outputs) and hidden (inputs,)."""
    return np.asarray(np.einsum("ji,j->i", weight, hidden))


_MOST_POWER = math.exp(2.0 * LOG_AMPLITUDE_CEILING)


def _compute_line_power(gains: Float, level: Float, low: NDArray[np.intp], count: int) -> Float:
    """Compute the power of tones per arc carrier for one state, (count,), as linear_contact.compute_line_power.

    level: (2, LINE_COUNT) power of the lines in the two carriers about each. low: (LINE_COUNT,) the lower one.
    """
    louder = np.exp(2.0 * (gains.reshape(len(HARMONICS), 1, LINE_COUNT) + _START))
    power = np.minimum(louder * level, _MOST_POWER)
    # Indices outside are clipped into one extra bin at either end.
    index = np.minimum(np.maximum(low + _LINE_OFFSETS, -1), count) + 1
    return np.asarray(np.bincount(index.ravel(), power.ravel(), count + 2)[1:-1], dtype=np.float64)


_HARMONICS = np.array(HARMONICS, dtype=np.float64)
