"""Linear probes on embeddings of frozen encoders, and accuracies with 95 % bootstrap intervals.

A probe is a multinomial logistic regression. Views of one material instance are not independent, so the bootstrap
resamples instances and not views. `evaluate_probes` fits and tests probes of both encoders on every sensor.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..bootstrap import bootstrap_ratio

Float = NDArray[np.float64]


@dataclass(frozen=True)
class Hits:
    """Correctness of each item, (n,) bool, and its group, (n,): items of one group are not independent."""

    correct: NDArray[np.bool_]
    group: NDArray[np.int64]


@dataclass(frozen=True)
class Estimate:
    """Value with its 95 % interval from `low` to `high`, and the numbers of items and of groups."""

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
    """Estimate the fraction of hits, with an interval by resampling groups."""
    hit_count, size = _count_by_group(hits, hits.group)
    interval = bootstrap_ratio(hit_count, size, seed)
    return Estimate(interval.value, interval.low, interval.high, len(hits.correct), len(size))


def estimate_ratio(first: Hits, second: Hits, seed: int = 0) -> Estimate:
    """Estimate the ratio of two accuracies on the same items; the same groups are drawn for both.

    The value is not finite if the second has no hit.
    """
    if not np.array_equal(first.group, second.group):
        raise ValueError("a ratio is of the same items")
    first_hits, size = _count_by_group(first, first.group)
    second_hits, _ = _count_by_group(second, first.group)
    interval = bootstrap_ratio(first_hits, second_hits, seed)
    return Estimate(interval.value, interval.low, interval.high, len(first.correct), len(size))


def _count_by_group(hits: Hits, group: NDArray[np.int64]) -> tuple[Float, Float]:
    """Return the number of hits and of items of each group."""
    _, index = np.unique(group, return_inverse=True)
    return np.bincount(index, weights=hits.correct).astype(np.float64), np.bincount(index).astype(np.float64)


Rows = NDArray[np.int64]
MAX_ITERATIONS = 300
RIDGE_PENALTIES = (1e-2, 1e-1)
"""Candidate weights of the ridge penalty."""


@dataclass(frozen=True)
class LinearProbe:
    """Affine classifier on standardised inputs: logits = ((x − mean) / scale) · weight + bias.

    Shapes: weight (d, classes), bias (classes,), mean and scale (d,).
    """

    weight: Float
    bias: Float
    mean: Float
    scale: Float

    def compute_logits(self, x: NDArray[Any]) -> Float:
        return np.asarray((x - self.mean) / self.scale @ self.weight + self.bias)

    def predict(self, x: NDArray[Any]) -> Rows:
        return np.asarray(self.compute_logits(x).argmax(axis=1))


def fit_linear_probe(x: NDArray[Any], label: Rows, classes: int, ridge: float) -> LinearProbe:
    """Minimise cross-entropy plus ridge / 2 · |weight|², a convex problem, by L-BFGS.

    x: (n, d) inputs. label: (n,) class indices below `classes`.
    """
    from scipy.optimize import minimize

    mean, scale = x.mean(axis=0, dtype=np.float64), np.maximum(x.std(axis=0, dtype=np.float64), 1e-8)
    inputs = (x - mean) / scale
    one_hot = np.eye(classes)[label]

    def cost(flat: Float) -> tuple[float, Float]:
        value, weight, bias = _compute_loss(inputs, one_hot, flat.reshape(-1, classes), ridge)
        return value, np.concatenate([weight, bias[None]]).ravel()

    start = np.zeros((inputs.shape[1] + 1) * classes)
    flat = minimize(cost, start, jac=True, method="L-BFGS-B", options={"maxiter": MAX_ITERATIONS, "gtol": 1e-6}).x
    solution = flat.reshape(-1, classes)
    return LinearProbe(solution[:-1], solution[-1], mean, scale)


def choose_linear_probe(
    x: NDArray[Any],
    label: Rows,
    group: Rows,
    classes: int,
    ridges: Sequence[float] = RIDGE_PENALTIES,
) -> tuple[LinearProbe, float]:
    """Return the probe with the ridge penalty that is best on every tenth group, refitted to all, and that ridge."""
    is_validation = group % 10 == 0
    if is_validation.all() or not is_validation.any():
        is_validation = np.arange(len(label)) % 10 == 0
    scores = [
        float(
            np.mean(
                fit_linear_probe(x[~is_validation], label[~is_validation], classes, ridge).predict(x[is_validation])
                == label[is_validation]
            )
        )
        for ridge in ridges
    ]
    ridge = ridges[int(np.argmax(scores))]
    return fit_linear_probe(x, label, classes, ridge), ridge


def _compute_loss(inputs: Float, truth: Float, parameters: Float, ridge: float) -> tuple[float, Float, Float]:
    """Return the loss and its gradients with respect to the weight (d, classes) and the bias (classes,)."""
    weight, bias = parameters[:-1], parameters[-1]
    logits = inputs @ weight + bias
    logits -= logits.max(axis=1, keepdims=True)
    partition = np.log(np.exp(logits).sum(axis=1, keepdims=True))
    value = -np.sum(truth * (logits - partition)) / len(inputs) + 0.5 * ridge * np.sum(weight**2)
    error = (np.exp(logits - partition) - truth) / len(inputs)
    return float(value), inputs.T @ error + ridge * weight, error.sum(axis=0)


Float32 = NDArray[np.float32]
Cell = tuple[str, str]
"""Encoder head, and the input it is tested on."""

VISION, TOUCH, REFITTED = HEADS = ("vision", "touch", "touch, probe of the tested sensor")
IMAGES = "looks"
FOLD_COUNT = 4
"""Number of folds of the cross-validation."""


@dataclass(frozen=True)
class ProbeInput:
    """Embeddings of n labelled tuples.

    Attributes
    ----------
    image, touch
        (n, d) embeddings.
    label, group
        (n,) see Tuples.
    classes
        Number of classes.
    """

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
    """Concatenate the inputs."""
    return ProbeInput(
        np.concatenate([item.image for item in inputs]),
        np.concatenate([item.touch for item in inputs]),
        np.concatenate([item.label for item in inputs]),
        np.concatenate([item.group for item in inputs]),
        inputs[0].classes,
    )


def evaluate_probes(
    fitted: Mapping[str, ProbeInput], tested: Mapping[str, ProbeInput], trained_on: Sequence[str]
) -> dict[Cell, Hits]:
    """Return hits by head and sensor.

    The vision probe and the touch probe are fitted to the tuples of all sensors that the encoders were trained on.
    REFITTED is a touch probe fitted to the tested sensor alone: it separates errors of the encoders from errors of the
    probe.

    Parameters
    ----------
    fitted
        Sensor → tuples to fit to.
    tested
        Sensor → tuples to test on.
    trained_on
        Sensors that the encoders were trained on.
    """
    known = concatenate_inputs([fitted[name] for name in trained_on])
    first = next(iter(tested.values()))
    vision = _fit_probe(known.image, known)
    hits = {(VISION, IMAGES): Hits(vision.predict(first.image) == first.label, first.group)}
    touch = _fit_probe(known.touch, known)
    for name, probe_input in tested.items():
        refitted = touch if list(trained_on) == [name] else _fit_probe(fitted[name].touch, fitted[name])
        for head, probe in ((TOUCH, touch), (REFITTED, refitted)):
            hits[head, name] = Hits(probe.predict(probe_input.touch) == probe_input.label, probe_input.group)
    return hits


def cross_validate_probes(tested: Mapping[str, ProbeInput], trained_on: Sequence[str]) -> dict[Cell, Hits]:
    """Return hits on classes that the encoders were not trained on, by cross-validation over instances.

    tested: sensor → tuples, the same tuples under every sensor.
    """
    first = next(iter(tested.values()))
    fold = _assign_folds(first.label, first.group)
    correct_by_cell: dict[Cell, NDArray[np.bool_]] = {}
    for fold_index in range(FOLD_COUNT):
        is_tested = fold == fold_index
        rest = {name: probe_input.select(~is_tested) for name, probe_input in tested.items()}
        hits = evaluate_probes(
            rest, {name: probe_input.select(is_tested) for name, probe_input in tested.items()}, trained_on
        )
        for cell, hit in hits.items():
            correct_by_cell.setdefault(cell, np.zeros(len(fold), dtype=bool))[is_tested] = hit.correct
    return {cell: Hits(correct, first.group) for cell, correct in correct_by_cell.items()}


def _fit_probe(x: NDArray[np.float32], probe_input: ProbeInput) -> LinearProbe:
    return choose_linear_probe(x, probe_input.label, probe_input.group, probe_input.classes)[0]


def _assign_folds(label: Rows, group: Rows) -> Rows:
    """Return the fold of each tuple; the instances of every class are distributed over the folds in turn."""
    folds = np.zeros(len(label), dtype=np.int64)
    for class_index in np.unique(label):
        of_class = label == class_index
        folds[of_class] = np.unique(group[of_class], return_inverse=True)[1] % FOLD_COUNT
    return folds
