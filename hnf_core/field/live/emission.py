"""F_Θ of one state, within a fraction of its 5 ms. field.evaluate is the reference; they differ by float32 rounding.

What a state does not change (token, mechanics, probe) is worked out once per material.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from ctypes import CDLL
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...errors import UsageError
from ...kernel.emission import StateEvaluator
from ...kernel.library import load_kernel
from ...material.mechanics import Mechanics
from ...material.probe import PROBES
from ...material.token import BAND_FEATURES, BAND_WAVELENGTHS_M
from ..emitter import encode_fixed_inputs, get_emitter, kernel_supports
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
from ..field import LOG_AMPLITUDE_CEILING, Field
from ..linear_contact import FORCE_FLOOR_N, SPEED_FLOOR_M_S, arc_gain
from ..lines import HARMONIC_SHIFTS, HARMONIC_START_LOG, HARMONICS, LINE_COUNT, LINE_FLOOR_M_S2, LINE_GAIN_COUNT
from .linear_contact import LinearState, LiveLinearContact, TimeBandPower

Float = NDArray[np.float64]
Single = NDArray[np.float32]
Direction = Sequence[float] | Float

_START, _SHIFT = np.asarray(HARMONIC_START_LOG)[:, None, None], np.asarray(HARMONIC_SHIFTS)[:, None, None]
_LINE_OFFSETS = _SHIFT + np.arange(2)[:, None]
_BANDS, _WIDTH = len(BAND_WAVELENGTHS_M), len(BAND_FEATURES)
_MOMENT_COLUMNS = np.concatenate([np.arange(_BANDS) * _WIDTH + BAND_FEATURES.index(name) for name in ("cos2", "cos4")])
_SYMMETRY_ORDERS = np.repeat([2.0, 4.0], _BANDS)


class LiveEmission:
    """F_Θ for one material: by the kernel, else by numpy.

    Raises UsageError for a field whose linear contact has no arc carriers to stand on: no such one is made.
    """

    def __init__(self, field: Field, token: Float, mechanics: Mechanics, probe: str) -> None:
        config = field.config
        if config.physics and not config.carriers.arc_count:
            raise UsageError("this field has no arc-length carriers to be felt live with.", remedy="Use another field.")
        self._of = field, np.array(token, dtype=np.float64)[None], mechanics, probe
        self.evaluate((1.0, 0.0), 0.0, 0.0, contact=False)  # the one that serves is made now: no touch waits for it

    def evaluate(self, direction: Direction, speed: float, force: float, contact: bool) -> tuple[Float, Float]:
        """α (K,), 0 at rest and out of contact, and σΔt (N,); the next call may overwrite both. direction: x, y; speed:
        m/s; force: N."""
        angle = math.atan2(direction[1], direction[0])
        pace, load = max(speed, SPEED_FLOOR_M_S), max(force, FORCE_FLOOR_N)
        moving = min(speed / SPEED_FLOOR_M_S, 1.0) * min(max(force, 0.0) / FORCE_FLOOR_N, 1.0) if contact else 0.0
        compiled = load_kernel()
        if compiled is not None and kernel_supports(self._of[0].config):
            return self._compiled.evaluate(compiled, direction, angle, pace, load, moving)
        return self._numpy.evaluate(direction, angle, pace, load, moving)

    @cached_property
    def _compiled(self) -> CompiledEmission:
        return CompiledEmission(*self._of)

    @cached_property
    def _numpy(self) -> NumpyEmission:
        return NumpyEmission(*self._of)


class NumpyEmission:
    """In numpy. token: (1, TOKEN_DIM)."""

    def __init__(self, field: Field, token: Float, mechanics: Mechanics, probe: str) -> None:
        config, carriers = field.config, field.config.carriers
        self._config, self._carriers, self._kappa = config, carriers, carriers.arc_centres()
        # Summed by einsum: BLAS would set threads to so small a product, and wait for them.
        self._layers = [_transpose_layer(field, f"layer{index}") for index in range(config.layers)]
        self._alpha, self._sigma = _transpose_layer(field, "alpha"), _transpose_layer(field, "sigma")
        expansion = config.expansion()
        self._expansion = None if expansion is None else expansion.astype(np.float64)
        self._prior = np.zeros(carriers.count)
        self._x = np.zeros(len(self._layers[0][0]), dtype=np.float32)
        self._x[:MECHANICS_COLUMN] = normalise_tokens(token)[0]
        # normalised_tokens leaves moments of direction as they are, so that turning them here is features.seen_from.
        self._moments = token[0, _MOMENT_COLUMNS] + 1j * token[0, _MOMENT_COLUMNS + 1]
        self._x[MECHANICS_COLUMN:DIRECTION_COLUMN] = encode_fixed_inputs(mechanics, probe)
        self._linear: LiveLinearContact | None = None
        if config.physics:
            self._linear = LiveLinearContact(token[0], mechanics, PROBES[probe], carriers)
            self._time, self._skip = TimeBandPower(carriers), field.parameters["skip"].astype(np.float64)
        self._mass = PROBES[probe].mass_kg

    def evaluate(
        self, direction: Direction, angle: float, pace: float, load: float, moving: float
    ) -> tuple[Float, Float]:
        """As LiveEmission.at, of a speed and a force that are not below their floors. moving: 0 … 1."""
        carriers = self._carriers
        linear = None if self._linear is None else self._linear.evaluate(angle, pace, load)
        time_power = None if linear is None else self._time.to_time_bands(linear.power, pace)
        hidden = self._fill_inputs(direction, angle, pace, load, linear, time_power)
        for weight, bias in self._layers:
            hidden = np.maximum(_multiply(weight, hidden) + bias, 0.0)
        sigma = np.logaddexp(0.0, (_multiply(self._sigma[0], hidden) + self._sigma[1]).astype(np.float64))
        if moving == 0.0:
            return np.zeros(carriers.count), sigma
        alpha = self._decode(
            (_multiply(self._alpha[0], hidden) + self._alpha[1]).astype(np.float64), linear, time_power
        )
        alpha *= moving
        if carriers.arc_count:
            gain = arc_gain(self._kappa, np.array([pace]))[0] if linear is None else linear.gain
            alpha[carriers.arc_slice] *= gain
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
        config, x = self._config, self._x
        if config.stroke_frame:
            turn = np.exp(-1j * angle * _SYMMETRY_ORDERS) * self._moments
            x[_MOMENT_COLUMNS], x[_MOMENT_COLUMNS + 1] = turn.real, turn.imag
        elif config.directed:
            x[DIRECTION_COLUMN : DIRECTION_COLUMN + 2] = direction
        at = DIRECTION_COLUMN + 4
        x[at - 2 : at] = math.log(pace / REFERENCE_SPEED_M_S), math.log(load)
        if config.action_octaves:
            told = np.array([direction], dtype=np.float64), np.array([pace]), np.array([load])
            encoded = encode_action(*told, config.action_octaves, config.directed)
            x[at : at + encoded.shape[1]] = encoded[0]
            at += encoded.shape[1]
        if linear is not None and time_power is not None:
            count = len(time_power)
            x[at : at + count] = (log_amplitude(time_power) + 5.0) / 3.0
            bounce = self._mass * math.sqrt(linear.normal) / load
            x[at + count :] = (
                0.25 * math.log(float(linear.power.sum()) + AMPLITUDE_FLOOR_M_S2**2),
                0.5 * math.log(bounce + 1e-3),
                math.log(linear.resonance / REFERENCE_RESONANCE_HZ),
            )
        return x

    def _decode(self, head: Float, linear: LinearState | None, time_power: Float | None) -> Float:
        """(K,) amplitudes before the gate."""
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
            arc = alpha[carriers.arc_slice]
            alpha[carriers.arc_slice] = np.sqrt(np.square(arc) + _compute_line_power(gains, linear, len(arc)))
        return np.asarray(alpha)


class CompiledEmission:
    """The same by the kernel."""

    def __init__(self, field: Field, token: Float, mechanics: Mechanics, probe: str) -> None:
        skip = np.asarray(field.parameters["skip"], dtype=np.float32)
        emitter = get_emitter(field.config, skip.tobytes(), probe, LOG_AMPLITUDE_CEILING)
        self._state = StateEvaluator(emitter, field.layers, token, np.array([encode_fixed_inputs(mechanics, probe)]))
        self._linear = LiveLinearContact(token[0], mechanics, PROBES[probe], field.config.carriers)
        self._mass = PROBES[probe].mass_kg

    def evaluate(
        self, kernel: CDLL, direction: Direction, angle: float, pace: float, load: float, moving: float
    ) -> tuple[Float, Float]:
        """As PlainEmission.at. α is overwritten by the next call."""
        touch, resonance = self._linear.contact_columns(angle, pace, load)
        motion = (*direction, pace, load, self._mass, resonance, moving)
        alpha, sigma = self._state.evaluate(kernel, motion, touch)
        return alpha, np.logaddexp(0.0, sigma, dtype=np.float64)


def _transpose_layer(field: Field, name: str) -> tuple[Single, Single]:
    """Weights (inputs, outputs) and bias of a layer."""
    return np.ascontiguousarray(field.parameters[f"{name}.weight"].T), field.parameters[f"{name}.bias"]


def _multiply(weight: Single, hidden: Single) -> Single:
    return np.asarray(np.einsum("ji,j->i", weight, hidden))


def _compute_line_power(gains: Float, linear: LinearState, count: int) -> Float:
    """lines.line_power of one state: (count,)."""
    level = 0.5 * np.log(linear.lines + LINE_FLOOR_M_S2**2)
    gain = gains.reshape(len(HARMONICS), 1, LINE_COUNT) + _START
    power = np.exp(2.0 * np.minimum(gain + level, LOG_AMPLITUDE_CEILING))
    # Everything outside falls into one bin at either end.
    place = np.minimum(np.maximum(linear.low + _LINE_OFFSETS, -1), count) + 1
    return np.asarray(np.bincount(place.ravel(), power.ravel(), count + 2)[1:-1], dtype=np.float64)
