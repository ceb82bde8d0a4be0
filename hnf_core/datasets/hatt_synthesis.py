"""HaTT's synthesis rule: the filter at a speed and force, its exact spectrum, and its signal.

The Delaunay triangle around (speed, force) gives barycentric weights; line spectral frequencies, excitation variance
and gain are interpolated with them (never coefficients, since the filter might not be stable). Then y[n] = Σ_j b_j e[n
− j] · gain − Σ_i a_i y[n − i], e ~ N(0, variance). H. Culbertson, J. Unwin & K. J. Kuchenbecker (2014), "Modeling and
rendering realistic textures from unconstrained tool–surface interactions", IEEE Transactions on Haptics 7(3), sec. 4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..action.action import ACTION_RATE_HZ, Action
from ..errors import UsageError
from ..field.resampling import resample
from .hatt_models import TextureModel, polynomial_from_lsf
from .recording import Recording

Float = NDArray[np.float64]

PROCESS_RATE_HZ = 10_000.0
"""Sample rate of recordings of a model [Hz]."""
CLAMP_MARGIN = 0.01
"""Margin of the toolkit's own clamp: to the maximum less 0.01 mm/s or 0.01 N."""
SILENCE_THRESHOLD, SILENCE_VALUE = 0.05, 1e-4
"""Threshold of the toolkit, 0.05 mm/s or 0.05 N, below which it uses 1e-4 of the unit: practically silence."""
WARM_UP_S = 0.4
"""Duration of the discarded start [s], in which the slowest pole of the hundred models (0.9986 at 10 kHz) decays to 0.4
%."""
_TOLERANCE = 1e-9
_CHUNK_POINTS = 8192


@dataclass(frozen=True)
class LocalFilters:
    """Filters of a texture model, interpolated at n pairs of speed and force.

    Attributes
    ----------
    triangle : ndarray of int64, shape (n,)
        Triangle around each point, a row of the model's triangles.
    weights : ndarray, shape (n, 3)
        Barycentric weights of the triangle's corners.
    ar_lsf : ndarray, shape (n, p)
        Line spectral frequencies of the autoregressive part.
    ma_lsf : ndarray, shape (n, q)
        Line spectral frequencies of the moving average.
    variance : ndarray, shape (n,)
        Variance of the excitation [(m/s²)²].
    gain : ndarray, shape (n,)
        Gain of the excitation.
    clamped_speed, clamped_force : ndarray of bool, shape (n,)
        True if the requested speed or force was outside the model's range.
    """

    triangle: NDArray[np.int64]
    weights: Float
    ar_lsf: Float
    ma_lsf: Float
    variance: Float
    gain: Float
    clamped_speed: NDArray[np.bool_]
    clamped_force: NDArray[np.bool_]


def interpolate_filters(model: TextureModel, speed_m_s: ArrayLike, force_n: ArrayLike) -> LocalFilters:
    """Interpolate a model at speeds (n,) [m/s] and forces (n,) [N]; outside its hull, at the nearest point of it."""
    requested_speed, requested_force = np.broadcast_arrays(
        np.atleast_1d(np.asarray(speed_m_s, dtype=np.float64)), np.atleast_1d(np.asarray(force_n, dtype=np.float64))
    )
    speed, above_speed = _clamp(requested_speed, model.max_speed, 1e-3)
    force, above_force = _clamp(requested_force, model.max_force, 1.0)
    triangle, weights = np.zeros(len(speed), np.int64), np.zeros((len(speed), 3))
    for start in range(0, len(speed), _CHUNK_POINTS):
        chunk = slice(start, start + _CHUNK_POINTS)
        triangle[chunk], weights[chunk] = _find_triangles(model, speed[chunk], force[chunk])
    # A hull need not fill its box: points with a negative weight are outside, and are moved to the triangle's edge.
    is_outside = weights.min(axis=1) < -_TOLERANCE
    weights = np.maximum(weights, 0.0)
    weights /= weights.sum(axis=1, keepdims=True)
    corners = model.triangles[triangle]

    def interpolate(values: Float) -> Float:
        return np.asarray(np.einsum("nk,nk...->n...", weights, values[corners]))

    return LocalFilters(
        triangle, weights, interpolate(model.ar_lsf), interpolate(model.ma_lsf), interpolate(model.variances),
        interpolate(model.gains), above_speed | is_outside, above_force | is_outside,
    )  # fmt: skip


def _clamp(values: Float, largest: float, unit: float) -> tuple[Float, NDArray[np.bool_]]:
    high = values > largest * (1.0 + _TOLERANCE)
    clamped = np.where(high, largest - CLAMP_MARGIN * unit, values)
    return np.where(clamped < SILENCE_THRESHOLD * unit, SILENCE_VALUE * unit, clamped), high


def _find_triangles(model: TextureModel, speed: Float, force: Float) -> tuple[NDArray[np.int64], Float]:
    """Return the model's triangle around each (speed, force), and the barycentric weights of its corners."""
    corner = np.stack([model.speeds / model.max_speed, model.forces / model.max_force], axis=1)[model.triangles]
    a, b, c = corner[:, 0], corner[:, 1], corner[:, 2]
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    x, y = (speed / model.max_speed)[:, None], (force / model.max_force)[:, None]
    second = ((x - a[:, 0]) * (c[:, 1] - a[:, 1]) - (y - a[:, 1]) * (c[:, 0] - a[:, 0])) / area
    third = ((b[:, 0] - a[:, 0]) * (y - a[:, 1]) - (b[:, 1] - a[:, 1]) * (x - a[:, 0])) / area
    weights = np.stack([1.0 - second - third, second, third], axis=-1)  # (n, T, 3)
    triangle = np.argmax(weights.min(axis=-1), axis=1)
    return triangle, np.asarray(weights[np.arange(len(speed)), triangle])


@dataclass(frozen=True)
class HattProcess:
    """A texture model as a source of recordings: isotropic, one axis, 10 kHz (resampled, and noted, if needed)."""

    model: TextureModel

    @property
    def name(self) -> str:
        """Name of the material."""
        return self.model.material

    def record(self, actions: Sequence[Action], seed: int) -> list[Recording]:
        """Synthesise one recording per action; action i depends on (seed, i) only.

        A model has no direction. The filter of every 5 ms is that of the action at its middle. Signals start as if the
        hand had already been moving; without contact there is no excitation. Raises UsageError if the actions are not
        equally long.
        """
        rate = self.model.sample_rate
        states = _build_states(self.model, actions)
        noise = np.stack(
            [_draw_noise(seed, index, states.samples + states.warm_up) for index in range(len(actions))], 1
        )
        signals = synthesise_autoregressive(states, noise)
        recordings = []
        for index, action in enumerate(actions):
            samples, notes = signals[:, index].copy(), list(states.notes[index])
            if rate != PROCESS_RATE_HZ:
                samples = resample(samples, rate, PROCESS_RATE_HZ)[0]
                notes.append(f"the model's {rate:g} Hz resampled to 10 kHz: nothing above {rate / 2:g} Hz")
            recordings.append(
                Recording(
                    action=action,
                    samples=samples,
                    sample_rate=PROCESS_RATE_HZ,
                    material=self.name,
                    source=f"{self.model.source}, seed {seed}, action {index}",
                    known=frozenset({"speed", "force"}),
                    notes=tuple(notes),
                )
            )
        return recordings


@dataclass(frozen=True)
class FilterStates:
    """Filter coefficients for B actions, constant within each of K blocks of 5 ms.

    Attributes
    ----------
    ar : ndarray, shape (K, p, B)
        Autoregressive coefficients without the leading 1.
    ma : ndarray, shape (K, q + 1, B)
        Moving-average coefficients times gain.
    deviation : ndarray, shape (K, B)
        Standard deviation of the excitation.
    block_samples : int
        Length of a block [samples].
    samples : int
        Number of samples to synthesise.
    warm_up : int
        Number of samples synthesised before them and discarded.
    notes : tuple of tuple of str
        Notes for each action, such as speeds beyond the model.
    """

    ar: Float
    ma: Float
    deviation: Float
    block_samples: int
    samples: int
    warm_up: int
    notes: tuple[tuple[str, ...], ...]


def _build_states(model: TextureModel, actions: Sequence[Action]) -> FilterStates:
    lengths = {round(action.duration_s * model.sample_rate) for action in actions}
    if len(lengths) != 1 or min(lengths) < 1:
        raise UsageError("the actions of one call must be equally long, and longer than nothing.")
    samples, block = lengths.pop(), round(model.sample_rate / ACTION_RATE_HZ)
    count = -(-samples // block)
    block_centres = (np.arange(count) + 0.5) * block / model.sample_rate
    speed, force, touching = (np.zeros((count, len(actions))) for _ in range(3))
    for index, action in enumerate(actions):
        speed[:, index] = np.interp(block_centres, action.time, action.speed)
        force[:, index] = np.interp(block_centres, action.time, action.force)
        nearest = np.minimum(np.round(block_centres * action.rate).astype(int), len(action.contact) - 1)
        touching[:, index] = action.contact[nearest]
    local = interpolate_filters(model, speed.ravel(), force.ravel())
    shape = speed.shape
    ar = polynomial_from_lsf(local.ar_lsf)[:, 1:].reshape(*shape, -1)
    ma = (local.gain[:, None] * polynomial_from_lsf(local.ma_lsf)).reshape(*shape, -1)
    clamped = local.clamped_speed.reshape(shape), local.clamped_force.reshape(shape)
    notes = tuple(
        tuple(
            f"{quantity} above {limit:.3g} {unit} taken as that, {100.0 * mask[:, index].mean():.1f} % of the time"
            for quantity, mask, limit, unit in (
                ("speed", clamped[0], model.max_speed, "m/s"), ("force", clamped[1], model.max_force, "N"),
            )
            if mask[:, index].any()
        )
        for index in range(len(actions))
    )  # fmt: skip
    return FilterStates(
        ar=np.ascontiguousarray(np.moveaxis(ar, -1, 1)),
        ma=np.ascontiguousarray(np.moveaxis(ma, -1, 1)),
        deviation=np.sqrt(local.variance.reshape(shape)) * touching,
        block_samples=block,
        samples=samples,
        warm_up=block * round(WARM_UP_S * ACTION_RATE_HZ),
        notes=notes,
    )


def _draw_noise(seed: int, index: int, count: int) -> Float:
    sequence = np.random.SeedSequence(seed, spawn_key=(index,))
    return np.random.Generator(np.random.Philox(sequence)).standard_normal(count)


def synthesise_autoregressive(states: FilterStates, noise: Float) -> Float:
    """Filter unit noise (warm_up + samples, B) to signals (samples, B) [m/s²], for all B actions in one time loop."""
    order, width = states.ar.shape[1], noise.shape[1]
    excitation = _filter_moving_average(states, noise)
    total = len(noise)
    signal = np.zeros((order + total, width))
    scratch, step = np.empty((order, width)), np.empty(width)
    for start in range(0, total, states.block_samples):
        # The latest sample is the last of the history, so the coefficients are reversed.
        reverse = np.ascontiguousarray(states.ar[get_block_index(states, start), ::-1])
        for n in range(start, min(start + states.block_samples, total)):
            np.multiply(reverse, signal[n : n + order], out=scratch)
            np.add.reduce(scratch, axis=0, out=step)
            np.subtract(excitation[n], step, out=signal[n + order])
    return signal[order + states.warm_up :]


def _filter_moving_average(states: FilterStates, noise: Float) -> Float:
    rows = np.maximum(np.arange(len(noise)) - states.warm_up, 0) // states.block_samples
    excitation = noise * states.deviation[rows]
    filtered = excitation * states.ma[rows, 0]
    for delay in range(1, states.ma.shape[1]):
        filtered[delay:] += excitation[:-delay] * states.ma[rows[delay:], delay]
    return np.asarray(filtered)


def get_block_index(states: FilterStates, sample: int) -> int:
    """Return the index of the 5 ms block whose filter a sample gets, counted with the warm-up samples."""
    return max(sample - states.warm_up, 0) // states.block_samples
