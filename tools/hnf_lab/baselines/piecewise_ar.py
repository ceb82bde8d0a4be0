"""Baseline: HaTT's piecewise autoregression, fitted to recordings and rendered by HaTT's own rule.

AR models lie on a grid of speed and force and are interpolated with barycentric weights. Burg's method over the
segments nearest to each vertex gives a stable start. Then all vertices together maximise the likelihood of all segments
*through* the interpolation, so that no vertex has to represent segments recorded elsewhere; a weak prior makes
neighbours similar. The order is chosen by the corrected Akaike criterion, the grid by the likelihood of every tenth
segment. HaTT itself fits each segment alone and places the models at the segments (Culbertson et al. 2014), so this fit
favours it. The method is isotropic: it uses speed and force, not direction.

A polynomial a = (1, a_1 … a_p) means x[n] = e[n] − Σ a_i x[n − i], with e of variance V.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import Delaunay
from torch import Tensor

from hnf_core.action.action import Action
from hnf_core.datasets.hatt_models import (
    HattProcess,
    TextureModel,
    interpolate_filters,
    lsf_from_polynomial,
    polynomial_from_lsf,
)
from hnf_core.errors import FileError

from .interface import Form, MaterialRecordings, Segments, cut_segments, render_by_duration

Float = NDArray[np.float64]


@dataclass(frozen=True)
class Prediction:
    """Linear prediction by Burg's method.

    Attributes
    ----------
    reflection
        (p,) coefficients within ±1, so that every order's polynomial is stable.
    error
        (p + 1,) residual variance of orders 0 … p.
    """

    reflection: Float
    error: Float

    def get_polynomial(self, order: int) -> Float:
        """Return the (order + 1,) AR coefficients, first 1 (Levinson's recursion)."""
        a = np.ones(1)
        for k in self.reflection[:order]:
            padded = np.append(a, 0.0)
            a = padded + k * padded[::-1]
        return a


def fit_burg(segments: ArrayLike, order: int, weight: ArrayLike | None = None) -> Prediction:
    """Fit AR coefficients by Burg's method (J. P. Burg 1975) over segments (S, n) of one process.

    Each reflection coefficient minimises the summed forward and backward errors.

    Parameters
    ----------
    segments
        (S, n) samples.
    order
        AR order.
    weight
        (S,) weights of the segments' errors, 1 by default.

    Raises
    ------
    ValueError
        If a segment is not longer than the order, or all are silent.
    """
    x = np.atleast_2d(np.asarray(segments, dtype=np.float64))
    w = np.ones(len(x)) if weight is None else np.asarray(weight, dtype=np.float64)
    if x.shape[1] <= order:
        raise ValueError(f"order {order} needs pieces of more than {order} samples, not {x.shape[1]}.")
    power = float(w @ np.mean(np.square(x), axis=1)) / float(w.sum())
    if not power > 0.0:
        raise ValueError("silent pieces have no prediction.")
    forward, backward = x[:, 1:], x[:, :-1]
    reflection, error = np.zeros(order), np.full(order + 1, power)
    for m in range(order):
        cross = float(w @ np.einsum("sn,sn->s", forward, backward))
        energy = float(w @ (np.einsum("sn,sn->s", forward, forward) + np.einsum("sn,sn->s", backward, backward)))
        k = -2.0 * cross / energy
        reflection[m], error[m + 1] = k, error[m] * (1.0 - k * k)
        forward, backward = (forward + k * backward)[:, 1:], (backward + k * forward)[:, :-1]
    return Prediction(reflection, error)


def compute_ar_density(polynomial: ArrayLike, variance: float, frequency_hz: ArrayLike, rate: float) -> Float:
    """Return the one-sided power density V · 2 / rate / |A|² at each frequency."""
    a = np.asarray(polynomial, dtype=np.float64)
    phase = np.exp(-2j * np.pi * np.asarray(frequency_hz, dtype=np.float64)[..., None] / rate * np.arange(len(a)))
    return np.asarray(2.0 * variance / rate / np.square(np.abs(phase @ a)))


Index = NDArray[np.int64]

MAX_ORDER = 24
GRIDS = ((2, 1), (3, 2), (5, 3), (7, 4), (10, 6), (14, 9), (18, 12), (22, 15))
"""Candidate grids, speeds × forces, without the axes."""
START_SEGMENTS = 100
SEGMENTS_PER_MODEL = (8, 250)
"""Range of segments per model: fewer do not suffice, with more a finer grid is better (both seen on HaTT)."""
TEST_SEGMENT_INTERVAL = 10
ITERATIONS = 60
TRIAL_ITERATIONS = 30
SILENCE_RATIO = 1e-4
"""Power relative to the median below which a segment is silent.

HaTT's own models are silent where nothing was recorded; without a floor the likelihood would be dominated by silence.
"""
POLE_RADII = (0.9998, 0.999, 0.995, 0.98)
"""Radii by which the poles of a start are scaled; the first that works is used.

A pure tone would put a pole on the unit circle, where LSFs coincide.
"""
LEVEL_STEP, GAP_STEP = 1.0, 0.2
"""Prior standard deviations of differences between neighbours, for log variance and log gaps between LSFs.

The prior is weak; a vertex without segments follows its neighbours.
"""


@dataclass(frozen=True)
class VertexGrid:
    """Grid of models.

    Attributes
    ----------
    models
        (M, 2) speed [m/s] and force [N] of each model.
    points
        (V, 2) position of every vertex, including the axes.
    model_index
        (V,) model of each vertex.
    silent
        (V,) vertices on the axes: variance 0 as in HaTT, with the shape of their neighbour.
    triangles
        (T, 3) vertices.
    """

    models: Float
    points: Float
    model_index: Index
    silent: NDArray[np.bool_]
    triangles: Index


def make_grid(segments: Segments, speeds: int, forces: int) -> VertexGrid:
    """Make a grid even in the roots of speed and force over the segments' range, with silence on the axes."""
    v, f = (
        _compute_grid_levels(values, count) for values, count in ((segments.speed, speeds), (segments.force, forces))
    )
    models = np.stack(np.meshgrid(v, f, indexing="ij"), axis=-1).reshape(-1, 2)
    rows, columns = np.meshgrid(np.arange(len(v) + 1), np.arange(len(f) + 1), indexing="ij")
    rows, columns = rows.ravel(), columns.ravel()
    points = np.stack([np.append(0.0, v)[rows], np.append(0.0, f)[columns]], axis=1)
    model_index = np.maximum(rows - 1, 0) * len(f) + np.maximum(columns - 1, 0)
    triangles = Delaunay(points / points.max(axis=0)).simplices.astype(np.int64)
    return VertexGrid(models, points, model_index, (rows == 0) | (columns == 0), triangles)


def make_texture_model(
    grid: VertexGrid, lsf: Float, variance: Float, segments: Segments, material: str
) -> TextureModel:
    """Convert to HaTT's own form. lsf: (M, p), variance: (M,) of the grid's models."""
    return TextureModel(
        material=material,
        source="piecewise AR fitted to recordings",
        sample_rate=segments.rate,
        speeds=grid.points[:, 0],
        forces=grid.points[:, 1],
        triangles=grid.triangles,
        ar_lsf=lsf[grid.model_index],
        ma_lsf=np.zeros((len(grid.points), 0)),
        variances=np.where(grid.silent, 0.0, variance[grid.model_index]),
        gains=np.ones(len(grid.points)),
        friction=None,
        max_speed=float(grid.points[:, 0].max()),
        max_force=float(grid.points[:, 1].max()),
    )


def compute_covariances(segments: Segments) -> Float:
    """Return (S, lead + 1, lead + 1) Σ_n x[n − i] x[n − j], sufficient for the likelihood under any AR model."""
    length = segments.body.shape[1]
    lagged = np.lib.stride_tricks.sliding_window_view(segments.samples, length, axis=1)[:, ::-1]
    return np.stack([windows @ windows.T for windows in lagged])


def fit_start_models(segments: Segments, grid: VertexGrid, order: int) -> list[Prediction]:
    """Fit Burg at each model over the segments nearest in log speed and log force, scaled to its level."""
    log = np.log(np.stack([segments.speed, segments.force], axis=1))
    spread = np.maximum(log.std(axis=0), 1e-3)
    power = np.mean(np.square(segments.body), axis=1)
    sounding = np.flatnonzero(power > SILENCE_RATIO * np.median(power))
    predictions = []
    for model in np.log(grid.models):
        distance = np.sum(np.square((log[sounding] - model) / spread), axis=1)
        nearest = sounding[np.argsort(distance)[:START_SEGMENTS]]
        level = float(np.exp(np.mean(np.log(power[nearest]))))
        predictions.append(fit_burg(segments.body[nearest], order, level / (power[nearest] + 1e-3 * level)))
    return predictions


def choose_order(predictions: list[Prediction], samples: int) -> int:
    """Return the order with the least corrected Akaike criterion (Hurvich & Tsai 1989), summed over models."""
    error = np.array([prediction.error for prediction in predictions])
    k = np.arange(error.shape[1]) + 1.0
    criterion = (samples * np.log(error)).mean(axis=0) + 2.0 * k * samples / (samples - k - 1.0)
    return max(int(np.argmin(criterion)), 2)


@dataclass(frozen=True)
class GridFit:
    """Line spectral frequencies (M, p), variances (M,), and negative log-likelihood per held-out sample."""

    grid: VertexGrid
    lsf: Float
    variance: Float
    loss: float


def fit_best_grid(segments: Segments, grids: Sequence[tuple[int, int]] = GRIDS) -> GridFit:
    """Choose the best grid by held-out likelihood and fit it to all segments. Deterministic.

    Raises
    ------
    FileError
        If all segments are silent or no grid can be fitted.
    """
    if not segments.body.any():
        raise FileError("every steady piece is silent.", where="recordings", remedy="Look at the sensor's channel.")
    torch.set_num_threads(1)
    covariance = torch.from_numpy(compute_covariances(segments))
    held_out = np.arange(len(segments.speed)) % TEST_SEGMENT_INTERVAL == TEST_SEGMENT_INTERVAL - 1
    fits: list[GridFit] = []
    fewest, most = (len(segments.speed) / per_model for per_model in reversed(SEGMENTS_PER_MODEL))
    suitable = [grid for grid in grids if fewest <= grid[0] * grid[1] <= most]
    if not suitable:
        suitable = [min(grids, key=lambda grid: abs(np.log(grid[0] * grid[1] / fewest)))]
    for speeds, forces in suitable:
        grid = make_grid(segments, speeds, forces)
        fits.append(fit_grid(segments, covariance, grid, ~held_out, TRIAL_ITERATIONS))
        if len(fits) > 2 and min(fits[-1].loss, fits[-2].loss) > fits[-3].loss:
            break
    finite = [fit for fit in fits if np.isfinite(fit.loss)]
    if not finite:
        raise FileError("no autoregressive model fits it.", where="recordings", remedy="Look for silence or clipping.")
    best = min(finite, key=lambda fit: fit.loss)
    return fit_grid(segments, covariance, best.grid, np.ones(len(held_out), dtype=np.bool_))


def fit_grid(
    segments: Segments, covariance: Tensor, grid: VertexGrid, train: NDArray[np.bool_], iterations: int = ITERATIONS
) -> GridFit:
    """Maximise the posterior given the segments in `train`; the loss is that of the others."""
    predictions = fit_start_models(segments, grid, segments.lead)
    order = choose_order(predictions, min(START_SEGMENTS, len(segments.speed)) * segments.body.shape[1])
    lsf = np.stack([compute_start_lsf(prediction.get_polynomial(order)) for prediction in predictions])
    gaps = np.diff(np.concatenate([np.zeros((len(lsf), 1)), lsf, np.full((len(lsf), 1), np.pi)], axis=1), axis=1)
    shape = torch.tensor(np.log(gaps), requires_grad=True)
    level = torch.tensor(np.log([prediction.error[order] for prediction in predictions]), requires_grad=True)
    unfitted = make_texture_model(grid, lsf, np.ones(len(lsf)), segments, "")
    local = interpolate_filters(unfitted, segments.speed, segments.force)
    vertices, weights = grid.triangles[local.triangle], local.weights
    models = torch.from_numpy(grid.model_index[vertices])
    shares = torch.from_numpy(weights)
    sounding = torch.from_numpy(weights * ~grid.silent[vertices])
    length = segments.body.shape[1]
    covariance = covariance[:, : order + 1, : order + 1]
    floor = SILENCE_RATIO * float(np.median([prediction.error[order] for prediction in predictions]))

    def loss(rows: Tensor) -> Tensor:
        angles = torch.cumsum(torch.softmax(shape, dim=1), dim=1)[:, :-1] * torch.pi
        interpolated = (angles[models[rows]] * shares[rows][..., None]).sum(dim=1)
        variance = (torch.exp(level)[models[rows]] * sounding[rows]).sum(dim=1) + floor
        a = lsf_to_polynomial(interpolated)
        residual = torch.einsum("si,sij,sj->s", a, covariance[rows], a)
        return 0.5 * (torch.log(variance) + (residual / length + floor) / variance).mean()

    rows = torch.from_numpy(np.flatnonzero(train))
    optimiser = torch.optim.LBFGS([shape, level], max_iter=iterations, history_size=20, line_search_fn="strong_wolfe")

    edges = torch.from_numpy(find_neighbours(grid))

    def roughness() -> Tensor:
        level_step = level[edges[:, 0]] - level[edges[:, 1]]
        log_gaps = torch.log_softmax(shape, dim=1)
        gap_step = log_gaps[edges[:, 0]] - log_gaps[edges[:, 1]]
        return 0.5 * ((level_step / LEVEL_STEP).square().sum() + (gap_step / GAP_STEP).square().sum())

    def closure() -> Tensor:
        optimiser.zero_grad()
        value = loss(rows) + roughness() / (len(rows) * length)
        value.backward()  # type: ignore[no-untyped-call]
        return value

    optimiser.step(closure)  # type: ignore[no-untyped-call]
    with torch.no_grad():
        test_rows = torch.from_numpy(np.flatnonzero(~train))
        angles = torch.cumsum(torch.softmax(shape, dim=1), dim=1)[:, :-1] * torch.pi
        test_loss = float(loss(test_rows)) if len(test_rows) else float(loss(rows))
        return GridFit(grid, angles.numpy().copy(), torch.exp(level).numpy().copy(), test_loss)


def compute_start_lsf(polynomial: Float) -> Float:
    """Return the LSFs of the polynomial with scaled poles. Raises FileError if no radius of POLE_RADII works."""
    for radius in POLE_RADII:
        try:
            return lsf_from_polynomial(radius ** np.arange(len(polynomial)) * polynomial)
        except ValueError:
            continue
    raise FileError("it is too pure a tone for an autoregressive model.", where="recordings", remedy="Leave AR out.")


def find_neighbours(grid: VertexGrid) -> Index:
    """Return (E, 2) pairs of models that share an edge of a triangle."""
    pairs = np.sort(grid.model_index[grid.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)], axis=1)
    return np.asarray(np.unique(pairs[pairs[:, 0] != pairs[:, 1]], axis=0))


def lsf_to_polynomial(lsf: Tensor) -> Tensor:
    """Convert LSFs (S, p) to polynomials (S, p + 1), with gradients."""
    cosines = torch.cos(lsf)
    order = lsf.shape[1]
    symmetric, antisymmetric = _multiply_factors(cosines[:, 0::2]), _multiply_factors(cosines[:, 1::2])
    if order % 2 == 0:
        symmetric = _pad(symmetric, 0, 1) + _pad(symmetric, 1, 0)
        antisymmetric = _pad(antisymmetric, 0, 1) - _pad(antisymmetric, 1, 0)
    else:
        antisymmetric = _pad(antisymmetric, 0, 2) - _pad(antisymmetric, 2, 0)
    return 0.5 * (symmetric + antisymmetric)[:, : order + 1]


def _multiply_factors(cosines: Tensor) -> Tensor:
    product = torch.ones((len(cosines), 1), dtype=cosines.dtype)
    for column in range(cosines.shape[1]):
        product = (
            _pad(product, 0, 2) - 2.0 * cosines[:, column : column + 1] * _pad(product, 1, 1) + _pad(product, 2, 0)
        )
    return product


def _pad(value: Tensor, before: int, after: int) -> Tensor:
    return torch.nn.functional.pad(value, (before, after))


def _compute_grid_levels(values: Float, count: int) -> Float:
    low, high = float(values.min()), float(values.max())
    if high < 1.05 * low:
        return np.array([high])
    if count == 1:
        return np.array([np.sqrt(low * high)])
    return np.asarray(np.square(np.linspace(np.sqrt(low), np.sqrt(high), count)))


_SEEDS_PER_CALL = 1000


@dataclass(frozen=True)
class FittedPiecewiseAr:
    """The model of one material, in HaTT's own form."""

    model: TextureModel

    def render(self, actions: Sequence[Action], seed: int) -> list[Float]:
        """Render by HattProcess; actions outside the recorded range are clamped, as HaTT does."""
        process = HattProcess(self.model)
        return render_by_duration(
            actions,
            lambda equal_actions, group: [
                r.samples for r in process.record(equal_actions, _SEEDS_PER_CALL * seed + group)
            ],
        )


@dataclass(frozen=True)
class PiecewiseAr:
    """Piecewise AR: HaTT's model class with our own fit. grids: candidates, speeds × forces."""

    name: str = "piecewise AR (HaTT)"
    form: Form = "natural"
    grids: tuple[tuple[int, int], ...] = GRIDS

    def fit(self, specimen: MaterialRecordings, seed: int) -> FittedPiecewiseAr:
        """Fit without randomness. Raises FileError if no segment is steady and in contact."""
        del seed
        segments = cut_segments(specimen.recordings, MAX_ORDER)
        fitted = fit_best_grid(segments, self.grids)
        return FittedPiecewiseAr(make_texture_model(fitted.grid, fitted.lsf, fitted.variance, segments, specimen.name))


def compute_power_spectrum(model: TextureModel, speed_m_s: float, force_n: float, frequency_hz: ArrayLike) -> Float:
    """Compute the exact one-sided power density [(m/s²)²/Hz] of a texture model at one speed and force.

    Parameters
    ----------
    model : TextureModel
        The model.
    speed_m_s, force_n : float
        Speed [m/s] and force [N].
    frequency_hz : array_like
        Frequencies [Hz]; the density is zero above half the model's rate.

    Returns
    -------
    ndarray
        The power density at each frequency.
    """
    frequency = np.asarray(frequency_hz, dtype=np.float64)
    local = interpolate_filters(model, speed_m_s, force_n)
    z_inverse = np.exp(-2j * np.pi * frequency / model.sample_rate)
    transfer = _evaluate_polynomial(polynomial_from_lsf(local.ma_lsf)[0], z_inverse) / _evaluate_polynomial(
        polynomial_from_lsf(local.ar_lsf)[0], z_inverse
    )
    density = 2.0 * local.variance[0] * np.square(local.gain[0] * np.abs(transfer)) / model.sample_rate
    return np.where(frequency <= 0.5 * model.sample_rate, density, 0.0)


def _evaluate_polynomial(coefficients: Float, turn: NDArray[np.complex128]) -> NDArray[np.complex128]:
    value = np.zeros_like(turn)
    for coefficient in coefficients[::-1]:
        value = value * turn + coefficient
    return value
