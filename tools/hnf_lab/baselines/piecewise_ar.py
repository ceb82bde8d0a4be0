"""Linear prediction: AR coefficients by Burg's method over many pieces of one process.

A polynomial a = (1, a_1 … a_p) stands for x[n] = e[n] − Σ a_i x[n − i], e of variance V.

Fitting HaTT's model class to recordings: AR models on a grid of speed and force, barycentric weights between them.

Burg's method over the pieces nearest to each vertex gives a stable start. Then all vertices together are moved to the
greatest likelihood of all pieces *through* the interpolation, so that no vertex has to stand for pieces that were not
recorded at it; a weak prior keeps neighbours alike. Order by the corrected Akaike criterion, grid by the likelihood of
every tenth piece. HaTT itself fits each piece alone and places the models where they fell (Culbertson et al. 2014);
this is kinder to it.

Method: HaTT's piecewise autoregression, fitted to recordings and played by HaTT's own rule.

Isotropic by construction: it sees speed and force, never direction. See piecewise_ar_fit for how it is fitted.
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
from hnf_core.datasets.hatt_models import TextureModel, lsf_from_polynomial
from hnf_core.datasets.hatt_synthesis import HattProcess, interpolate_filters
from hnf_core.errors import FileError

from .interface import Form, MaterialRecordings, Segments, cut_segments, render_by_duration

Float = NDArray[np.float64]


@dataclass(frozen=True)
class Prediction:
    """reflection: (p,) each within ±1, so that every order's polynomial is stable. error: (p + 1,) variance of what
    orders 0 … p leave."""

    reflection: Float
    error: Float

    def get_polynomial(self, order: int) -> Float:
        """(order + 1,) AR coefficients, first 1 (Levinson's recursion)."""
        a = np.ones(1)
        for k in self.reflection[:order]:
            padded = np.append(a, 0.0)
            a = padded + k * padded[::-1]
        return a


def fit_burg(segments: ArrayLike, order: int, weight: ArrayLike | None = None) -> Prediction:
    """Burg's method (J. P. Burg 1975) over pieces (S, n) of one process, errors summed with weight (S,), 1 by default.

    Each reflection coefficient minimises the summed forward and backward errors. Raises ValueError where a piece is
    not longer than the order, or all of them are silent.
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
        across = float(w @ np.einsum("sn,sn->s", forward, backward))
        own = float(w @ (np.einsum("sn,sn->s", forward, forward) + np.einsum("sn,sn->s", backward, backward)))
        k = -2.0 * across / own
        reflection[m], error[m + 1] = k, error[m] * (1.0 - k * k)
        forward, backward = (forward + k * backward)[:, 1:], (backward + k * forward)[:, :-1]
    return Prediction(reflection, error)


def compute_ar_density(polynomial: ArrayLike, variance: float, frequency_hz: ArrayLike, rate: float) -> Float:
    """One-sided power density V · 2 / rate / |A|² at each frequency."""
    a = np.asarray(polynomial, dtype=np.float64)
    phase = np.exp(-2j * np.pi * np.asarray(frequency_hz, dtype=np.float64)[..., None] / rate * np.arange(len(a)))
    return np.asarray(2.0 * variance / rate / np.square(np.abs(phase @ a)))


Index = NDArray[np.int64]

MAX_ORDER = 24
GRIDS = ((2, 1), (3, 2), (5, 3), (7, 4), (10, 6), (14, 9), (18, 12), (22, 15))
"""Speeds × forces to choose from, beside the axes."""
START_SEGMENTS = 100
SEGMENTS_PER_MODEL = (8, 250)
"""Fewer cannot carry a model, with more a finer grid is better (both seen on HaTT): other grids are not tried."""
TEST_SEGMENT_INTERVAL = 10
ITERATIONS = 60
TRIAL_ITERATIONS = 30
SILENCE_RATIO = 1e-4
"""Of the median power: less is silence (HaTT's own models are silent where nobody recorded), of which a likelihood
without a floor would learn nothing but how silent."""
POLE_RADII = (0.9998, 0.999, 0.995, 0.98)
"""Radius by which every pole of a start is drawn in, the first that serves: a pure tone would put one on the circle,
where LSFs meet."""
LEVEL_STEP, GAP_STEP = 1.0, 0.2
"""What neighbours may differ by: standard deviation of log variance, and of the log of each gap between LSFs. Weak: a
vertex that no piece came near takes after its neighbours."""


@dataclass(frozen=True)
class VertexGrid:
    """models: (M, 2) speed [m/s] and force [N] of each model. place: (V, 2) of every vertex, the axes among them.
    own: (V,) which of the models it holds. silent: (V,) bool, the vertices on the axes: variance 0, as in HaTT, and the
    shape of their neighbour. triangles: (T, 3) vertices."""

    models: Float
    points: Float
    model_index: Index
    silent: NDArray[np.bool_]
    triangles: Index


def make_grid(segments: Segments, speeds: int, forces: int) -> VertexGrid:
    """Even in the roots of speed and force, from the least to the greatest piece, closed by silence on the axes."""
    v, f = (
        _compute_grid_levels(values, count) for values, count in ((segments.speed, speeds), (segments.force, forces))
    )
    models = np.stack(np.meshgrid(v, f, indexing="ij"), axis=-1).reshape(-1, 2)
    rows, columns = np.meshgrid(np.arange(len(v) + 1), np.arange(len(f) + 1), indexing="ij")
    rows, columns = rows.ravel(), columns.ravel()
    place = np.stack([np.append(0.0, v)[rows], np.append(0.0, f)[columns]], axis=1)
    own = np.maximum(rows - 1, 0) * len(f) + np.maximum(columns - 1, 0)
    triangles = Delaunay(place / place.max(axis=0)).simplices.astype(np.int64)
    return VertexGrid(models, place, own, (rows == 0) | (columns == 0), triangles)


def make_texture_model(
    grid: VertexGrid, lsf: Float, variance: Float, segments: Segments, material: str
) -> TextureModel:
    """HaTT's own form. lsf (M, p), variance (M,) of the grid's models."""
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
    """(S, lead + 1, lead + 1) Σ_n x[n − i] x[n − j]: all that the likelihood of a piece under any AR model needs."""
    length = segments.body.shape[1]
    lagged = np.lib.stride_tricks.sliding_window_view(segments.samples, length, axis=1)[:, ::-1]
    return np.stack([each @ each.T for each in lagged])


def fit_start_models(segments: Segments, grid: VertexGrid, order: int) -> list[Prediction]:
    """Burg at each model, over the pieces nearest to it in log speed and log force, each brought to the level there."""
    log = np.log(np.stack([segments.speed, segments.force], axis=1))
    spread = np.maximum(log.std(axis=0), 1e-3)
    power = np.mean(np.square(segments.body), axis=1)
    sounding = np.flatnonzero(power > SILENCE_RATIO * np.median(power))
    out = []
    for model in np.log(grid.models):
        distance = np.sum(np.square((log[sounding] - model) / spread), axis=1)
        nearest = sounding[np.argsort(distance)[:START_SEGMENTS]]
        level = float(np.exp(np.mean(np.log(power[nearest]))))
        out.append(fit_burg(segments.body[nearest], order, level / (power[nearest] + 1e-3 * level)))
    return out


def choose_order(predictions: list[Prediction], samples: int) -> int:
    """Least corrected Akaike criterion (C. M. Hurvich & C.-L. Tsai 1989), summed over models of `samples` samples."""
    error = np.array([prediction.error for prediction in predictions])
    k = np.arange(error.shape[1]) + 1.0
    criterion = (samples * np.log(error)).mean(axis=0) + 2.0 * k * samples / (samples - k - 1.0)
    return max(int(np.argmin(criterion)), 2)


@dataclass(frozen=True)
class GridFit:
    """lsf: (M, p). variance: (M,). loss: mean negative log-likelihood per sample of the pieces held out."""

    grid: VertexGrid
    lsf: Float
    variance: Float
    loss: float


def fit_best_grid(segments: Segments, grids: Sequence[tuple[int, int]] = GRIDS) -> GridFit:
    """The best of the grids that there are pieces for, fitted to all of them. Deterministic.

    Raises FileError where all pieces are silent or no grid can be fitted.
    """
    if not segments.body.any():
        raise FileError("every steady piece is silent.", where="recordings", remedy="Look at the sensor's channel.")
    torch.set_num_threads(1)
    covariance = torch.from_numpy(compute_covariances(segments))
    held_out = np.arange(len(segments.speed)) % TEST_SEGMENT_INTERVAL == TEST_SEGMENT_INTERVAL - 1
    tried: list[GridFit] = []
    fewest, most = (len(segments.speed) / share for share in reversed(SEGMENTS_PER_MODEL))
    suited = [grid for grid in grids if fewest <= grid[0] * grid[1] <= most]
    if not suited:
        suited = [min(grids, key=lambda grid: abs(np.log(grid[0] * grid[1] / fewest)))]
    for speeds, forces in suited:
        grid = make_grid(segments, speeds, forces)
        tried.append(fit_grid(segments, covariance, grid, ~held_out, TRIAL_ITERATIONS))
        if len(tried) > 2 and min(tried[-1].loss, tried[-2].loss) > tried[-3].loss:
            break
    finite = [each for each in tried if np.isfinite(each.loss)]
    if not finite:
        raise FileError("no autoregressive model fits it.", where="recordings", remedy="Look for silence or clipping.")
    best = min(finite, key=lambda each: each.loss)
    return fit_grid(segments, covariance, best.grid, np.ones(len(held_out), dtype=np.bool_))


def fit_grid(
    segments: Segments, covariance: Tensor, grid: VertexGrid, train: NDArray[np.bool_], iterations: int = ITERATIONS
) -> GridFit:
    """Greatest posterior given the pieces in `train`; loss of the others."""
    predictions = fit_start_models(segments, grid, segments.lead)
    order = choose_order(predictions, min(START_SEGMENTS, len(segments.speed)) * segments.body.shape[1])
    lsf = np.stack([compute_start_lsf(each.get_polynomial(order)) for each in predictions])
    gaps = np.diff(np.concatenate([np.zeros((len(lsf), 1)), lsf, np.full((len(lsf), 1), np.pi)], axis=1), axis=1)
    shape = torch.tensor(np.log(gaps), requires_grad=True)
    level = torch.tensor(np.log([each.error[order] for each in predictions]), requires_grad=True)
    unfitted = make_texture_model(grid, lsf, np.ones(len(lsf)), segments, "")
    local = interpolate_filters(unfitted, segments.speed, segments.force)
    vertices, weights = grid.triangles[local.triangle], local.weights
    own = torch.from_numpy(grid.model_index[vertices])
    share = torch.from_numpy(weights)
    sounding = torch.from_numpy(weights * ~grid.silent[vertices])
    length = segments.body.shape[1]
    covariance = covariance[:, : order + 1, : order + 1]
    floor = SILENCE_RATIO * float(np.median([each.error[order] for each in predictions]))

    def loss(rows: Tensor) -> Tensor:
        angles = torch.cumsum(torch.softmax(shape, dim=1), dim=1)[:, :-1] * torch.pi
        between = (angles[own[rows]] * share[rows][..., None]).sum(dim=1)
        variance = (torch.exp(level)[own[rows]] * sounding[rows]).sum(dim=1) + floor
        a = lsf_to_polynomial(between)
        residual = torch.einsum("si,sij,sj->s", a, covariance[rows], a)
        return 0.5 * (torch.log(variance) + (residual / length + floor) / variance).mean()

    rows = torch.from_numpy(np.flatnonzero(train))
    optimiser = torch.optim.LBFGS([shape, level], max_iter=iterations, history_size=20, line_search_fn="strong_wolfe")

    edges = torch.from_numpy(find_neighbours(grid))

    def roughness() -> Tensor:
        step = level[edges[:, 0]] - level[edges[:, 1]]
        turn = torch.log_softmax(shape, dim=1)
        bend = turn[edges[:, 0]] - turn[edges[:, 1]]
        return 0.5 * ((step / LEVEL_STEP).square().sum() + (bend / GAP_STEP).square().sum())

    def closure() -> Tensor:
        optimiser.zero_grad()
        value = loss(rows) + roughness() / (len(rows) * length)
        value.backward()  # type: ignore[no-untyped-call]
        return value

    optimiser.step(closure)  # type: ignore[no-untyped-call]
    with torch.no_grad():
        other = torch.from_numpy(np.flatnonzero(~train))
        angles = torch.cumsum(torch.softmax(shape, dim=1), dim=1)[:, :-1] * torch.pi
        held = float(loss(other)) if len(other) else float(loss(rows))
        return GridFit(grid, angles.numpy().copy(), torch.exp(level).numpy().copy(), held)


def compute_start_lsf(polynomial: Float) -> Float:
    """LSFs of the polynomial with its poles drawn in. Raises FileError where none of INWARD tells them apart."""
    for radius in POLE_RADII:
        try:
            return lsf_from_polynomial(radius ** np.arange(len(polynomial)) * polynomial)
        except ValueError:
            continue
    raise FileError("it is too pure a tone for an autoregressive model.", where="recordings", remedy="Leave AR out.")


def find_neighbours(grid: VertexGrid) -> Index:
    """(E, 2) pairs of models that share an edge of a triangle."""
    pairs = np.sort(grid.model_index[grid.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)], axis=1)
    return np.asarray(np.unique(pairs[pairs[:, 0] != pairs[:, 1]], axis=0))


def lsf_to_polynomial(lsf: Tensor) -> Tensor:
    """Twin of datasets.line_spectra.polynomial_from_lsf with gradients: (S, p) → (S, p + 1)."""
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
    out = torch.ones((len(cosines), 1), dtype=cosines.dtype)
    for column in range(cosines.shape[1]):
        out = _pad(out, 0, 2) - 2.0 * cosines[:, column : column + 1] * _pad(out, 1, 1) + _pad(out, 2, 0)
    return out


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
    """One material. model: in HaTT's own form."""

    model: TextureModel

    def render(self, actions: Sequence[Action], seed: int) -> list[Float]:
        """By datasets.autoregressive.HattProcess; outside the recorded speeds and forces as HaTT does, clamped."""
        process = HattProcess(self.model)
        return render_by_duration(
            actions, lambda same, group: [r.samples for r in process.record(same, _SEEDS_PER_CALL * seed + group)]
        )


@dataclass(frozen=True)
class PiecewiseAr:
    """Method: piecewise AR (HaTT's model class, our own fit). grids: speeds × forces to choose from."""

    name: str = "piecewise AR (HaTT)"
    form: Form = "natural"
    grids: tuple[tuple[int, int], ...] = GRIDS

    def fit(self, specimen: MaterialRecordings, seed: int) -> FittedPiecewiseAr:
        """Deterministic: nothing is drawn. Raises FileError where no piece of a recording is steady and in contact."""
        del seed
        pieces = cut_segments(specimen.recordings, MAX_ORDER)
        fitted = fit_best_grid(pieces, self.grids)
        return FittedPiecewiseAr(make_texture_model(fitted.grid, fitted.lsf, fitted.variance, pieces, specimen.name))
