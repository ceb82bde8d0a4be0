"""Interface of evaluated methods, the oracle, and recordings cut into segments of near-constant action.

A `Method` fits one material and renders actions; a `SharedMethod` fits many materials as one model. `OracleMethod`
renders the true process with another seed, the best possible natural signal. `cut_segments` prepares the data of
memoryless baselines.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.action import Action
from hnf_core.datasets.recording import Recording, TextureProcess
from hnf_core.errors import FileError
from hnf_core.material.contact_model import UNKNOWN_MECHANICS, Mechanics

Float = NDArray[np.float64]

Form = Literal["natural", "expected magnitude"]
"""Kind of signal a method gives.

natural: a signal to feel, one draw of a random process. expected magnitude: a signal whose |X_k| is the expected one in
every window, for benchmarks only. The two are never compared with each other.
"""


@dataclass(frozen=True)
class MaterialRecordings:
    """Recordings of one material, with the data that a method may use.

    Attributes
    ----------
    token
        (TOKEN_DIM,) E(I), or None without a sensor image.
    category
        Category, or "".
    """

    name: str
    recordings: tuple[Recording, ...]
    token: NDArray[np.float32] | None = None
    mechanics: Mechanics = UNKNOWN_MECHANICS
    category: str = ""


class FittedMaterial(Protocol):
    """A method fitted to one material."""

    def render(self, actions: Sequence[Action], seed: int) -> list[Float]:
        """Return a(t) [m/s²] at 10 kHz for each action, (round(duration_s · 10 000),) float64.

        Different seeds give different draws; the same seed gives the same bytes.
        """
        ...


class Method(Protocol):
    """A method that is fitted to recordings of one material."""

    @property
    def name(self) -> str:
        """Name in the tables; it states if the method is a reconstruction."""
        ...

    @property
    def form(self) -> Form: ...

    def fit(self, specimen: MaterialRecordings, seed: int) -> FittedMaterial:
        """Fit to specimen.recordings, all at one sample rate. Deterministic for a seed."""
        ...


class FittedSharedModel(Protocol):
    """One model of many materials."""

    def for_material(self, token: NDArray[np.float32], mechanics: Mechanics) -> FittedMaterial:
        """Return the model for one material, which need not be among the training materials."""
        ...


class SharedMethod(Protocol):
    """A method that is fitted to many materials at once, conditioned on the token."""

    @property
    def name(self) -> str: ...

    @property
    def form(self) -> Form: ...

    def fit(self, specimens: Sequence[MaterialRecordings], seed: int) -> FittedSharedModel: ...


def render_by_duration(actions: Sequence[Action], render: Callable[[list[Action], int], list[Float]]) -> list[Float]:
    """Call render(actions of one length, group number) for every length; results are in the order of `actions`.

    The group number must enter the seed, or the first action of every group would be the same draw.
    """
    groups: dict[int, list[int]] = {}
    for index, action in enumerate(actions):
        groups.setdefault(len(action.speed), []).append(index)
    rendered: list[Float] = [np.zeros(0)] * len(actions)
    for group, indices in enumerate(groups.values()):
        for index, samples in zip(indices, render([actions[i] for i in indices], group), strict=True):
            rendered[index] = samples
    return rendered


_SEED_OFFSET = 0x5EED_0000_0000
"""Offset far from any user's seed, so that the oracle is never the draw it is compared with."""


@dataclass(frozen=True)
class FittedProcess:
    """The true process."""

    process: TextureProcess

    def render(self, actions: Sequence[Action], seed: int) -> list[Float]:
        """Render with seeds that no recording uses."""
        first_seed = _SEED_OFFSET + 1000 * seed
        return render_by_duration(
            actions,
            lambda equal_actions, group: [r.samples for r in self.process.record(equal_actions, first_seed + group)],
        )


@dataclass(frozen=True)
class OracleMethod:
    """The process that made the recordings."""

    process: TextureProcess
    name: str = "oracle (true process, another seed)"
    form: Form = "natural"

    def fit(self, specimen: MaterialRecordings, seed: int) -> FittedMaterial:
        """Return the process; nothing is fitted."""
        del specimen, seed
        return FittedProcess(self.process)


SEGMENT_S = 0.05
"""Duration of a segment [s].

HaTT's segments are stationary by a test; a smooth hand hardly changes in 50 ms, and 500 samples determine 20
coefficients.
"""
MAX_RELATIVE_RANGE = 0.35
"""Largest range of speed and of force within a segment, relative to the mean."""
MIN_SPEED_M_S = 1e-3


@dataclass(frozen=True)
class Segments:
    """Segments of near-constant action.

    Attributes
    ----------
    speed, force
        (S,) means [m/s], [N].
    samples
        (S, lead + n); the first `lead` samples belong to the past, needed to predict the first sample.
    rate
        Sample rate [Hz].
    """

    speed: Float
    force: Float
    samples: Float
    lead: int
    rate: float

    @property
    def body(self) -> Float:
        """Samples without the past, (S, n)."""
        return self.samples[:, self.lead :]


def cut_segments(
    recordings: Sequence[Recording], lead: int, *, segment_s: float = SEGMENT_S, max_range: float = MAX_RELATIVE_RANGE
) -> Segments:
    """Return all segments in contact and in motion with near-constant speed and force.

    Parameters
    ----------
    recordings
        Recordings at one sample rate.
    lead
        Number of past samples to include.
    segment_s
        Duration of a segment [s].
    max_range
        Largest relative range of speed and of force.

    Raises
    ------
    FileError
        If there is no such segment, or the sample rates differ.
    """
    rates = {recording.sample_rate for recording in recordings}
    if len(rates) != 1:
        raise FileError(
            f"recordings of {len(rates)} sample rates cannot be pooled.",
            where=", ".join(sorted({recording.source for recording in recordings})) or "no recordings",
            remedy="Resample them to one rate.",
        )
    rate = rates.pop()
    speed, force, samples = [], [], []
    for recording in recordings:
        action = recording.action
        length = round(segment_s * rate)
        for start in range(lead, len(recording.samples) - length + 1, length):
            low, high = start / rate * action.rate, (start + length) / rate * action.rate
            states = slice(int(np.floor(low)), int(np.ceil(high)) + 1)
            v, f = action.speed[states], action.force[states]
            if (
                action.contact[states].all()
                and v.min() > MIN_SPEED_M_S
                and f.min() > 0.0
                and np.ptp(v) <= max_range * v.mean()
                and np.ptp(f) <= max_range * f.mean()
            ):
                speed.append(float(v.mean()))
                force.append(float(f.mean()))
                samples.append(recording.samples[start - lead : start + length])
    if not samples:
        raise FileError(
            f"no {segment_s * 1e3:g} ms of it have steady speed and force in contact.",
            where=recordings[0].source,
            remedy="Record longer or slower strokes.",
        )
    return Segments(np.array(speed), np.array(force), np.stack(samples), lead, rate)
