"""Linear probe: multinomial logistic regression on embeddings of frozen encoders."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Rows = NDArray[np.int64]
MAX_ITERATIONS = 300
RIDGE_PENALTIES = (1e-4, 1e-3, 1e-2)


@dataclass(frozen=True)
class LinearProbe:
    """logits = ((x − mean) / scale) · weight + bias. weight: (d, classes). bias: (classes,). mean, scale: (d,)."""

    weight: Float
    bias: Float
    mean: Float
    scale: Float

    def compute_logits(self, x: NDArray[Any]) -> Float:
        return np.asarray((x - self.mean) / self.scale @ self.weight + self.bias)

    def predict(self, x: NDArray[Any]) -> Rows:
        return np.asarray(self.compute_logits(x).argmax(axis=1))


def fit_linear_probe(x: NDArray[Any], label: Rows, classes: int, ridge: float) -> LinearProbe:
    """Least cross-entropy plus ridge / 2 · |weight|², a convex problem, by L-BFGS. x: (n, d); label: (n,) < classes."""
    from scipy.optimize import minimize

    mean, scale = x.mean(axis=0, dtype=np.float64), np.maximum(x.std(axis=0, dtype=np.float64), 1e-8)
    inputs = (x - mean) / scale
    truth = np.eye(classes)[label]

    def cost(flat: Float) -> tuple[float, Float]:
        value, weight, bias = _compute_loss(inputs, truth, flat.reshape(-1, classes), ridge)
        return value, np.concatenate([weight, bias[None]]).ravel()

    start = np.zeros((inputs.shape[1] + 1) * classes)
    flat = minimize(cost, start, jac=True, method="L-BFGS-B", options={"maxiter": MAX_ITERATIONS, "gtol": 1e-6}).x
    solved = flat.reshape(-1, classes)
    return LinearProbe(solved[:-1], solved[-1], mean, scale)


def choose_linear_probe(
    x: NDArray[Any],
    label: Rows,
    group: Rows,
    classes: int,
    ridges: Sequence[float] = RIDGE_PENALTIES,
) -> tuple[LinearProbe, float]:
    """Probe and ridge: the ridge that does best on every tenth group (of places), then fitted to all."""
    held = group % 10 == 0
    if held.all() or not held.any():
        held = np.arange(len(label)) % 10 == 0
    scores = [
        float(np.mean(fit_linear_probe(x[~held], label[~held], classes, ridge).predict(x[held]) == label[held]))
        for ridge in ridges
    ]
    ridge = ridges[int(np.argmax(scores))]
    return fit_linear_probe(x, label, classes, ridge), ridge


def _compute_loss(inputs: Float, truth: Float, parameters: Float, ridge: float) -> tuple[float, Float, Float]:
    """Value, gradient of the weight (d, classes), gradient of the bias (classes,)."""
    weight, bias = parameters[:-1], parameters[-1]
    logits = inputs @ weight + bias
    logits -= logits.max(axis=1, keepdims=True)
    partition = np.log(np.exp(logits).sum(axis=1, keepdims=True))
    value = -np.sum(truth * (logits - partition)) / len(inputs) + 0.5 * ridge * np.sum(weight**2)
    error = (np.exp(logits - partition) - truth) / len(inputs)
    return float(value), inputs.T @ error + ridge * weight, error.sum(axis=0)
