"""What the field expects window by window, and a signal whose every window shows just that. For benchmarks only.

The second, the *expected-magnitude form*, is no signal to feel: it repeats every 50 ms. Against one recording of a
random texture it scores a smaller spectral MSE than the texture itself could, and is compared with its own kind only.

Our own field as a method: trained on one material, or one field for all by its token; natural and for benchmarks.

Who takes part: every method by a short key, what it learns from, and on how many materials it is affordable.
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
LINE_HZ = 2.0 * BIN_HZ
"""Lines at 15, 35, 55 … Hz lie midway between bins: each is the strongest in the two bins beside it, and the next ones
are down by 14 dB there, so a window hardly shows where it starts."""
LINE_COUNT = BIN_COUNT // 2
_STATE_STRIDE = 4
"""States from one that is asked to the next, 20 ms."""
_CELL_HZ = 1.0
_REACH_HZ = 4.0 * BIN_HZ
"""Beyond four bins a Hann window passes less than 1e-5 of a band's power."""


def compute_expected_densities(field: Field, stroke: StrokeInput, every: int = 1) -> Float:
    """(n, 100) one-sided power density [(m/s²)²/Hz] that a Hann window of 0.1 s at 10 kHz is expected to show at
    10, 20 … 1000 Hz, for every `every`-th action state, as if that state lasted.

    The texture term: constant carriers have no density and are left out.
    """
    action, token_index = resample_action(stroke)
    amplitude = accumulate(field.config, evaluate(field, build_condition(stroke, action, token_index)))
    return compute_window_densities(
        field.config.carriers, np.square(amplitude.sum(axis=1))[::every], action.speed[::every]
    )


def compute_window_densities(carriers: Carriers, power: Float, speed: Float) -> Float:
    """(n, 100) density that a Hann window of 0.1 s shows at 10 … 1000 Hz of carriers of power (n, K) at speed (n,)."""
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
    """(count,) m/s² at 10 kHz: lines at 15, 35 … 995 Hz with phases 2π n² / n_tot, so loud that |X_k| of a Hann window
    of 1000 samples is sqrt(π S_k) / 2, what a Gaussian texture of density S is expected to show, wherever it starts.

    density: (n, 100) as from expected_densities, at even steps, read linearly between and held beyond the last.
    lasting: steps that the signal lasts, n − 1 where nothing is said.
    """
    states = np.asarray(density, dtype=np.float64)
    window = hann_window(WINDOW_SAMPLES)
    squared = states * (0.5 * MODEL_RATE_HZ * float(np.sum(np.square(window))))  # one-sided density → E |X_k|²
    magnitude = 0.5 * np.sqrt(np.pi * squared)
    at_half_a_bin = 0.5 * float(window.sum()) * float(np.sinc(0.5)) / 0.75
    level = magnitude.reshape(len(states), LINE_COUNT, 2).mean(axis=2) / at_half_a_bin
    end = len(states) - 1.0
    place = np.minimum(np.linspace(0.0, end if lasting is None else lasting, count), end)
    low = np.minimum(place.astype(np.intp), max(len(states) - 2, 0))
    high, share = np.minimum(low + 1, len(states) - 1), place - low
    time, out = np.arange(count) / MODEL_RATE_HZ, np.zeros(count)
    for line in range(LINE_COUNT):
        envelope = (1.0 - share) * level[low, line] + share * level[high, line]
        out += envelope * np.cos(2.0 * np.pi * ((1.5 * BIN_HZ + LINE_HZ * line) * time + line**2 / LINE_COUNT))
    return out


def synthesise_expected_magnitude(field: Field, stroke: StrokeInput) -> Float:
    """The stroke's texture in expected-magnitude form, (count,) m/s² at 10 kHz; there is no seed to it."""
    action, _ = resample_action(stroke)
    lasting = (len(action.speed) - 1) / _STATE_STRIDE
    return make_expected_magnitude_signal(
        compute_expected_densities(field, stroke, _STATE_STRIDE), sample_count(action), lasting
    )


def _make_cell_edges() -> Float:
    return np.arange(0.0, BIN_COUNT * BIN_HZ + _REACH_HZ + _CELL_HZ, _CELL_HZ)


def _compute_band_shares(edges: Float) -> Float:
    """(B, cells) share of each band's power that falls into each cell of 1 Hz."""
    reached = np.clip((_make_cell_edges()[None, :] - edges[:-1, None]) / np.diff(edges)[:, None], 0.0, 1.0)
    return np.asarray(np.diff(reached, axis=1))


def _compute_window_kernel() -> Float:
    """(cells, 100) density that unit power in a cell shows in each bin, its image at negative frequencies included."""
    centre = _make_cell_edges()[:-1] + 0.5 * _CELL_HZ
    bins = np.arange(1, BIN_COUNT + 1) * BIN_HZ
    near, mirrored = (_compute_window_power((bins[None, :] - sign * centre[:, None]) / BIN_HZ) for sign in (1.0, -1.0))
    return np.asarray((near + mirrored) / (1.5 * BIN_HZ))


def _compute_window_power(offset: Float) -> Float:
    """|W|² of a Hann window at an offset in bins, 1 at its middle; its integral is 1.5 bins."""
    wide = np.where(np.abs(np.abs(offset) - 1.0) < 1e-9, np.abs(offset) + 1e-6, offset)
    return np.asarray(np.square(np.sinc(wide) / (1.0 - np.square(wide))))


_SEEDS_PER_CALL = 1000


@dataclass(frozen=True)
class FittedField:
    """A field and the material it is asked about."""

    field: Field
    token: NDArray[np.float32]
    mechanics: Mechanics
    form: Form = "natural"

    def render(self, actions: Sequence[Action], seed: int) -> list[Float]:
        """By the product's own synthesis; action i of a call has a seed of its own."""
        strokes = [uniform_stroke(action, self.token, self.mechanics) for action in actions]
        if self.form == "expected magnitude":
            return [synthesise_expected_magnitude(self.field, stroke) for stroke in strokes]
        first = _SEEDS_PER_CALL * seed
        made = [synthesise(self.field, stroke, seed=seed) for seed, stroke in enumerate(strokes, first)]
        return [synthesis.signal.samples.astype(np.float64) for synthesis in made]


@dataclass(frozen=True)
class TrainedField:
    """Method: the field trained on one material's recordings, as `hnf train field` does. epochs: None = the trainer's
    own schedule."""

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
    """Method: one field for all materials, given this one's token and mechanics only. It learns nothing from the
    recordings, and may or may not have met the material in training: its weights say."""

    field: Field
    name: str = "field, shared"
    form: Form = "natural"

    def fit(self, specimen: MaterialRecordings, seed: int) -> FittedMaterial:
        """Raises UsageError for a material without a token."""
        del seed
        if specimen.token is None:
            raise UsageError(
                f"'{specimen.name}' has no token.", remedy="The shared field needs one; leave it out here."
            )
        return FittedField(self.field, specimen.token, specimen.mechanics, self.form)


@dataclass(frozen=True)
class Budget:
    """epochs, steps: of the methods trained by gradient, None = their own. weights: of the shared field."""

    epochs: int | None = None
    steps: int | None = None
    weights: Path | None = None


@dataclass(frozen=True)
class MethodEntry:
    """key: for --methods. diet: what it learns from. make: the method itself (imports torch only then). most: materials
    of a run on which it takes part; None = all. learns: False where recordings are not needed. shows: key of the
    entry whose fit this one shows in another form, so that it is trained once."""

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
    """The entries of these keys, all for None. Raises UsageError that lists the keys."""
    every = {entry.key: entry for entry in list_entries()}
    unknown = [key for key in keys or () if key not in every]
    if unknown:
        raise UsageError(f"no method is called {', '.join(unknown)}.", remedy=f"Choose among {', '.join(every)}.")
    return tuple(every[key] for key in dict.fromkeys(keys or every))


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
