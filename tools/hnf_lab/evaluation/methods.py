"""Evaluated methods: the project's field in two forms, the registry of all methods, and expected-magnitude signals.

`list_entries` names every method with its key and training strokes. `TrainedField` is fitted to one material,
`SharedField` uses one field for all. `compute_expected_densities` returns the field's expected spectra;
`make_expected_magnitude_signal` makes a signal whose every window shows them. Such a signal repeats every 50 ms and is
for benchmarks only: against one recording of a random texture it has a smaller spectral MSE than the texture itself, so
it is compared only with its own kind.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hnf_core.action.action import Action
from hnf_core.errors import UsageError
from hnf_core.field.carriers import MODEL_RATE_HZ, Carriers
from hnf_core.field.field import Field, accumulate, evaluate
from hnf_core.field.stroke import StrokeInput, build_condition, resample_action, sample_count, uniform_stroke
from hnf_core.field.synthesis import synthesise
from hnf_core.field.weights import load_field
from hnf_core.material.contact_model import Mechanics
from hnf_core.material.token import TOKEN_DIM
from hnf_core.metrics.spectra import BIN_COUNT, WINDOW_SAMPLES, hann_window

from ..baselines.interface import FittedMaterial, Form, MaterialRecordings, Method
from .scoring import TrainingStrokes

Float = NDArray[np.float64]

BIN_HZ = MODEL_RATE_HZ / WINDOW_SAMPLES
"""Spacing of the DFT bins [Hz]."""
LINE_HZ = 2.0 * BIN_HZ
"""Spacing of the spectral lines [Hz].

Lines at 15, 35, 55 … Hz lie midway between bins. Each is the strongest in its two neighbouring bins, where the next
lines are 14 dB lower, so a window hardly depends on its start.
"""
LINE_COUNT = BIN_COUNT // 2
_STATE_STRIDE = 4
"""Action states between evaluated ones, 20 ms."""
_CELL_HZ = 1.0
_REACH_HZ = 4.0 * BIN_HZ
"""Reach of a band [Hz]: beyond four bins a Hann window passes less than 1e-5 of its power."""


def compute_expected_densities(field: Field, stroke: StrokeInput, every: int = 1) -> Float:
    """Return the (n, 100) one-sided power density [(m/s²)²/Hz] that the field expects at 10, 20 … 1000 Hz.

    It is the density that a Hann window of 0.1 s at 10 kHz shows for every `every`-th action state, as if that state
    lasted. Only the texture term counts: constant carriers have no density.

    Parameters
    ----------
    field
        The field.
    stroke
        The stroke.
    every
        Stride of the action states.
    """
    action, token_index = resample_action(stroke)
    amplitude = accumulate(field.config, evaluate(field, build_condition(stroke, action, token_index)))
    return compute_window_densities(
        field.config.carriers, np.square(amplitude.sum(axis=1))[::every], action.speed[::every]
    )


def compute_window_densities(carriers: Carriers, power: Float, speed: Float) -> Float:
    """Return the (n, 100) density that a Hann window of 0.1 s shows at 10 … 1000 Hz.

    power: (n, K) power of the carriers. speed: (n,) [m/s].
    """
    cells = np.zeros((len(power), len(_make_cell_edges()) - 1))
    if carriers.time_count:
        cells += power[:, carriers.time_slice] @ _compute_band_shares(carriers.time_edges())
    if carriers.arc_count:
        edges = carriers.arc_edges()
        for value in np.unique(speed[speed > 0.0]):
            rows = speed == value
            cells[rows] += power[rows, carriers.arc_slice] @ _compute_band_shares(edges * value)
    return np.asarray(cells @ _compute_window_kernel())


def make_expected_magnitude_signal(density: ArrayLike, count: int, lasting: float | None = None) -> Float:
    """Make a signal (count,) [m/s²] at 10 kHz whose windows show the expected magnitudes.

    Parameters
    ----------
    density
        (n, 100) as returned by compute_expected_densities, at even steps; interpolated linearly, constant beyond the
        last.
    count
        Number of samples.
    lasting
        Duration of the signal in steps, n − 1 by default.

    Notes
    -----
    The lines at 15, 35 … 995 Hz have phases 2π n² / n_tot and such levels that |X_k| of a Hann window of 1000 samples
    is
    sqrt(π S_k) / 2, the expectation for a Gaussian texture of density S, wherever the window starts.
    """
    states = np.asarray(density, dtype=np.float64)
    window = hann_window(WINDOW_SAMPLES)
    expected_power = states * (0.5 * MODEL_RATE_HZ * float(np.sum(np.square(window))))  # one-sided density → E |X_k|²
    magnitude = 0.5 * np.sqrt(np.pi * expected_power)
    half_bin_gain = 0.5 * float(window.sum()) * float(np.sinc(0.5)) / 0.75
    level = magnitude.reshape(len(states), LINE_COUNT, 2).mean(axis=2) / half_bin_gain
    last_step = len(states) - 1.0
    step = np.minimum(np.linspace(0.0, last_step if lasting is None else lasting, count), last_step)
    low = np.minimum(step.astype(np.intp), max(len(states) - 2, 0))
    high, fraction = np.minimum(low + 1, len(states) - 1), step - low
    time, out = np.arange(count) / MODEL_RATE_HZ, np.zeros(count)
    for line in range(LINE_COUNT):
        envelope = (1.0 - fraction) * level[low, line] + fraction * level[high, line]
        out += envelope * np.cos(2.0 * np.pi * ((1.5 * BIN_HZ + LINE_HZ * line) * time + line**2 / LINE_COUNT))
    return out


def synthesise_expected_magnitude(field: Field, stroke: StrokeInput) -> Float:
    """Return the stroke's texture in expected-magnitude form, (count,) [m/s²] at 10 kHz, without a seed."""
    action, _ = resample_action(stroke)
    lasting = (len(action.speed) - 1) / _STATE_STRIDE
    return make_expected_magnitude_signal(
        compute_expected_densities(field, stroke, _STATE_STRIDE), sample_count(action), lasting
    )


def _make_cell_edges() -> Float:
    return np.arange(0.0, BIN_COUNT * BIN_HZ + _REACH_HZ + _CELL_HZ, _CELL_HZ)


def _compute_band_shares(edges: Float) -> Float:
    """Return (B, cells): the fraction of each band's power in each cell of 1 Hz."""
    cumulative = np.clip((_make_cell_edges()[None, :] - edges[:-1, None]) / np.diff(edges)[:, None], 0.0, 1.0)
    return np.asarray(np.diff(cumulative, axis=1))


def _compute_window_kernel() -> Float:
    """Return (cells, 100): the density that unit power in a cell shows in each bin, with its negative image."""
    centre = _make_cell_edges()[:-1] + 0.5 * _CELL_HZ
    bins = np.arange(1, BIN_COUNT + 1) * BIN_HZ
    direct, mirrored = (
        _compute_window_power((bins[None, :] - sign * centre[:, None]) / BIN_HZ) for sign in (1.0, -1.0)
    )
    return np.asarray((direct + mirrored) / (1.5 * BIN_HZ))


def _compute_window_power(offset: Float) -> Float:
    """Return |W|² of a Hann window at an offset in bins, 1 at its centre; its integral is 1.5 bins."""
    shifted = np.where(np.abs(np.abs(offset) - 1.0) < 1e-9, np.abs(offset) + 1e-6, offset)
    return np.asarray(np.square(np.sinc(shifted) / (1.0 - np.square(shifted))))


_SEEDS_PER_CALL = 1000


@dataclass(frozen=True)
class FittedField:
    """A field with the token and mechanics of one material."""

    field: Field
    token: NDArray[np.float32]
    mechanics: Mechanics
    form: Form = "natural"

    def render(self, actions: Sequence[Action], seed: int) -> list[Float]:
        """Render by the product's synthesis; every action of a call has its own seed."""
        strokes = [uniform_stroke(action, self.token, self.mechanics) for action in actions]
        if self.form == "expected magnitude":
            return [synthesise_expected_magnitude(self.field, stroke) for stroke in strokes]
        first = _SEEDS_PER_CALL * seed
        results = [synthesise(self.field, stroke, seed=seed) for seed, stroke in enumerate(strokes, first)]
        return [synthesis.signal.samples.astype(np.float64) for synthesis in results]


@dataclass(frozen=True)
class TrainedField:
    """The field trained on one material's recordings, as by `hnf train field`. epochs: None = the default schedule."""

    name: str = "field, per material"
    form: Form = "natural"
    epochs: int | None = None

    def fit(self, specimen: MaterialRecordings, seed: int) -> FittedMaterial:
        from hnf_core.training.from_recordings import choose_config
        from hnf_core.training.train_material import Schedule, train_material

        recordings = list(specimen.recordings)
        config = choose_config(recordings, arc=specimen.token is not None, token_known=specimen.token is not None)
        schedule = Schedule() if self.epochs is None else Schedule(epochs=self.epochs)
        trained = train_material(
            recordings, config, seed, schedule=schedule, token=specimen.token, mechanics=specimen.mechanics
        )
        token = np.zeros(TOKEN_DIM, dtype=np.float32) if specimen.token is None else specimen.token
        return FittedField(trained.field, token, specimen.mechanics, self.form)


@dataclass(frozen=True)
class SharedField:
    """One field for all materials, with the material's token and mechanics only.

    It is not fitted to the recordings. Its weights state the materials it was trained on.
    """

    field: Field
    name: str = "field, shared"
    form: Form = "natural"

    def fit(self, specimen: MaterialRecordings, seed: int) -> FittedMaterial:
        """Return the field for this material. Raises UsageError for a material without a token."""
        del seed
        if specimen.token is None:
            raise UsageError(
                f"'{specimen.name}' has no token.", remedy="The shared field needs one; leave it out here."
            )
        return FittedField(self.field, specimen.token, specimen.mechanics, self.form)


@dataclass(frozen=True)
class Budget:
    """Epochs and steps of trained methods (None = their defaults), and weights of the shared field."""

    epochs: int | None = None
    steps: int | None = None
    weights: Path | None = None


@dataclass(frozen=True)
class MethodEntry:
    """A method in the registry.

    Attributes
    ----------
    key
        Name for --methods.
    training_strokes
        Kind of strokes it is trained on.
    build
        Function that makes the method; it imports torch only when called.
    max_materials
        Number of materials of a run on which it takes part; None = all.
    needs_recordings
        False if it is not fitted to recordings.
    needs_token
        True if it needs a token.
    reuses
        Key of the entry whose fit this one uses in another form, so that it is trained once.
    """

    key: str
    training_strokes: TrainingStrokes
    build: Callable[[Budget], Method]
    max_materials: int | None = None
    needs_recordings: bool = True
    needs_token: bool = False
    reuses: str = ""


def list_entries() -> tuple[MethodEntry, ...]:
    return (
        MethodEntry("field", "wandering", lambda budget: TrainedField(epochs=budget.epochs)),
        MethodEntry("shared", "wandering", lambda budget: _make_shared(budget, "natural"), needs_recordings=False,
        needs_token=True),
        MethodEntry("ar", "wandering", _make_piecewise_ar),
        MethodEntry("gacm", "wandering", lambda budget: _make_gacm(budget, False)),
        MethodEntry("gacm-improved", "wandering", lambda budget: _make_gacm(budget, True)),
        MethodEntry("playback", "wandering", _make_nearest_neighbour),
        MethodEntry(
            "hnf",
            "circular",
            lambda budget: TrainedField("HNF with carriers, circular strokes only", epochs=budget.epochs),
        ),
        MethodEntry(
            "hnf-plus",
            "circular and primitives",
            lambda budget: TrainedField("HNF+ with carriers, circles and eight primitives", epochs=budget.epochs),
        ),
        MethodEntry("hnf-literal", "circular", _make_published_hnf, max_materials=3),
        MethodEntry(
            "field-expected",
            "wandering",
            lambda budget: TrainedField("field, per material", "expected magnitude", budget.epochs),
            reuses="field",
        ),
        MethodEntry(
            "shared-expected", "wandering", lambda budget: _make_shared(budget, "expected magnitude"),
            needs_recordings=False,
            needs_token=True, reuses="shared",
        ),
    )  # fmt: skip


def select_entries(keys: Sequence[str] | None) -> tuple[MethodEntry, ...]:
    """Return the entries of these keys, all for None. Raises UsageError that lists the keys."""
    entry_by_key = {entry.key: entry for entry in list_entries()}
    unknown = [key for key in keys or () if key not in entry_by_key]
    if unknown:
        raise UsageError(
            f"no method is called {', '.join(unknown)}.", remedy=f"Choose among {', '.join(entry_by_key)}."
        )
    return tuple(entry_by_key[key] for key in dict.fromkeys(keys or entry_by_key))


@lru_cache(maxsize=4)
def _load_field_cached(path: Path | None):  # type: ignore[no-untyped-def]
    return load_field(path)


def _make_shared(budget: Budget, form: Form) -> Method:
    return SharedField(_load_field_cached(budget.weights), form=form)


def _make_piecewise_ar(budget: Budget) -> Method:
    from ..baselines.piecewise_ar import PiecewiseAr

    return PiecewiseAr()


def _make_nearest_neighbour(budget: Budget) -> Method:
    from ..baselines.nearest_neighbour import NearestNeighbour

    return NearestNeighbour()


def _make_gacm(budget: Budget, improved: bool) -> Method:
    from ..baselines.gacm import STEPS, GacmSingleMaterial

    return GacmSingleMaterial(improved, STEPS if budget.steps is None else budget.steps)


def _make_published_hnf(budget: Budget) -> Method:
    from ..baselines.published_hnf import PublishedHnf

    return PublishedHnf() if budget.epochs is None else PublishedHnf(epochs=budget.epochs)
