"""Shares of hits with 95 % intervals. Views of one piece are not independent: pieces are drawn, not views.

Linear probe: multinomial logistic regression on embeddings of frozen encoders.

Probes of both heads on every sensor: which tuples each is fitted to, and which it gets right.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
BOOTSTRAP_DRAWS = 2000
INTERVAL_PERCENTILES = (2.5, 97.5)


@dataclass(frozen=True)
class Hits:
    """correct: (n,) bool. group: (n,) which of them stand or fall together."""

    correct: NDArray[np.bool_]
    group: NDArray[np.int64]


@dataclass(frozen=True)
class Estimate:
    """value with its 95 % interval from `low` to `high`; items: of how many, groups: of how many pieces."""

    value: float
    low: float
    high: float
    items: int
    groups: int

    def to_json(self) -> Mapping[str, float]:
        return {
            "value": round(self.value, 4), "low": round(self.low, 4), "high": round(self.high, 4),
            "items": self.items, "groups": self.groups,
        }  # fmt: skip


def estimate_accuracy(hits: Hits, seed: int = 0) -> Estimate:
    """Share of hits, its interval by drawing groups with replacement (bootstrap, Efron 1979)."""
    found, size = _count_by_group(hits, hits.group)
    weight = _draw_group_weights(len(size), seed)
    low, high = np.percentile(weight @ found / (weight @ size), INTERVAL_PERCENTILES)
    return Estimate(float(hits.correct.mean()), float(low), float(high), len(hits.correct), len(size))


def estimate_ratio(first: Hits, second: Hits, seed: int = 0) -> Estimate:
    """Share of one over share of the other on the same items: the same groups are drawn for both. Not finite where
    the other has no hit."""
    if not np.array_equal(first.group, second.group):
        raise ValueError("a ratio is of the same items")
    found, size = _count_by_group(first, first.group)
    below, _ = _count_by_group(second, first.group)
    weight = _draw_group_weights(len(size), seed)
    with np.errstate(divide="ignore", invalid="ignore"):
        drawn = (weight @ found) / (weight @ below)
        value = found.sum() / below.sum()
    low, high = (
        np.percentile(drawn[np.isfinite(drawn)], INTERVAL_PERCENTILES) if np.isfinite(drawn).any() else (np.nan, np.nan)
    )
    return Estimate(float(value), float(low), float(high), len(first.correct), len(size))


def _count_by_group(hits: Hits, group: NDArray[np.int64]) -> tuple[Float, Float]:
    """Hits and items of each group."""
    _, index = np.unique(group, return_inverse=True)
    return np.bincount(index, weights=hits.correct).astype(np.float64), np.bincount(index).astype(np.float64)


def _draw_group_weights(groups: int, seed: int) -> Float:
    """(DRAWS, groups): how often each group is drawn."""
    rng = np.random.default_rng(seed)
    return rng.multinomial(groups, np.full(groups, 1.0 / groups), size=BOOTSTRAP_DRAWS).astype(np.float64)


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


Float32 = NDArray[np.float32]
Cell = tuple[str, str]
"""Head, and what it is tested on."""

VISION, TOUCH, REFITTED = HEADS = ("vision", "touch", "touch, probe of the tested sensor")
IMAGES = "looks"
FOLD_COUNT = 4


@dataclass(frozen=True)
class ProbeInput:
    """n labelled tuples as the encoders see them. look, touch: (n, d). label, group: (n,), see Tuples. classes: how
    many."""

    image: Float32
    touch: Float32
    label: Rows
    group: Rows
    classes: int

    def select(self, chosen: NDArray[np.generic]) -> ProbeInput:
        return ProbeInput(
            self.image[chosen], self.touch[chosen], self.label[chosen], self.group[chosen], self.classes
        )  # fmt: skip


def concatenate_inputs(inputs: Sequence[ProbeInput]) -> ProbeInput:
    """One after the other."""
    return ProbeInput(
        np.concatenate([part.image for part in inputs]),
        np.concatenate([part.touch for part in inputs]),
        np.concatenate([part.label for part in inputs]),
        np.concatenate([part.group for part in inputs]),
        inputs[0].classes,
    )


def evaluate_probes(
    fitted: Mapping[str, ProbeInput], tested: Mapping[str, ProbeInput], trained_on: Sequence[str]
) -> dict[Cell, Hits]:
    """Hits by head and sensor.

    fitted, tested: sensor → tuples. trained_on: the sensors that the encoders know. The vision probe and the touch
    probe are fitted to those sensors' tuples together; REFITTED is a touch probe fitted to the tested sensor alone,
    which tells what the encoders miss from what the probe misses.
    """
    known = concatenate_inputs([fitted[name] for name in trained_on])
    first = next(iter(tested.values()))
    vision = _fit_probe(known.image, known)
    out = {(VISION, IMAGES): Hits(vision.predict(first.image) == first.label, first.group)}
    touch = _fit_probe(known.touch, known)
    for name, each in tested.items():
        alone = touch if list(trained_on) == [name] else _fit_probe(fitted[name].touch, fitted[name])
        for head, probe in ((TOUCH, touch), (REFITTED, alone)):
            out[head, name] = Hits(probe.predict(each.touch) == each.label, each.group)
    return out


def cross_validate_probes(tested: Mapping[str, ProbeInput], trained_on: Sequence[str]) -> dict[Cell, Hits]:
    """For classes that encoders never met: every piece is judged by probes that were fitted to the other folds' pieces.

    tested: sensor → tuples, the same ones under every sensor.
    """
    first = next(iter(tested.values()))
    fold = _assign_folds(first.label, first.group)
    right: dict[Cell, NDArray[np.bool_]] = {}
    for number in range(FOLD_COUNT):
        inside = fold == number
        rest = {name: each.select(~inside) for name, each in tested.items()}
        hits = evaluate_probes(rest, {name: each.select(inside) for name, each in tested.items()}, trained_on)
        for cell, hit in hits.items():
            right.setdefault(cell, np.zeros(len(fold), dtype=bool))[inside] = hit.correct
    return {cell: Hits(correct, first.group) for cell, correct in right.items()}


def _fit_probe(x: NDArray[np.float32], probe_input: ProbeInput) -> LinearProbe:
    return choose_linear_probe(x, probe_input.label, probe_input.group, probe_input.classes)[0]


def _assign_folds(label: Rows, group: Rows) -> Rows:
    """Fold of each tuple: the pieces of every class go to the folds by turns."""
    out = np.zeros(len(label), dtype=np.int64)
    for each in np.unique(label):
        mine = label == each
        out[mine] = np.unique(group[mine], return_inverse=True)[1] % FOLD_COUNT
    return out
