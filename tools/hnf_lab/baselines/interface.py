"""What a rival and our own field have in common, so that one table can hold them all.

Processes take actions of one length at a time; whoever renders a mixed list groups them here.

The oracle: the true process itself with another seed. Nothing can be better in natural form.

Recordings cut into pieces of near-constant action: what every rival without memory is fitted on.
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
"""natural: a signal to feel, one draw of a random process. expected magnitude: a signal whose |X_k| is the expected
one in every window, for benchmarks only. The two are never compared with each other."""


@dataclass(frozen=True)
class MaterialRecordings:
    """One material as a method may see it: what was felt on it, and what a sensor image and the library say of it.

    token: (TOKEN_DIM,) E(I), None where there is no picture. category: its class, empty where there is none.
    """

    name: str
    recordings: tuple[Recording, ...]
    token: NDArray[np.float32] | None = None
    mechanics: Mechanics = UNKNOWN_MECHANICS
    category: str = ""


class FittedMaterial(Protocol):
    """One material, learned."""

    def render(self, actions: Sequence[Action], seed: int) -> list[Float]:
        """a(t) in m/s² at 10 kHz for each action, (round(duration_s · 10 000),) float64. Another seed, another draw;
        the same seed, the same bytes."""
        ...


class Method(Protocol):
    """A way to learn one material from recordings of it."""

    @property
    def name(self) -> str:
        """As the table prints it; a reconstruction of somebody else's method says so here."""
        ...

    @property
    def form(self) -> Form: ...

    def fit(self, specimen: MaterialRecordings, seed: int) -> FittedMaterial:
        """Learn from specimen.recordings (all at one sample rate). Deterministic with a seed."""
        ...


class FittedSharedModel(Protocol):
    """Many materials, learned as one model."""

    def for_material(self, token: NDArray[np.float32], mechanics: Mechanics) -> FittedMaterial:
        """The model's opinion of a material, which need not be among those it was fitted to."""
        ...


class SharedMethod(Protocol):
    """A way to learn many materials at once, with the token as condition."""

    @property
    def name(self) -> str: ...

    @property
    def form(self) -> Form: ...

    def fit(self, specimens: Sequence[MaterialRecordings], seed: int) -> FittedSharedModel: ...


def render_by_duration(actions: Sequence[Action], render: Callable[[list[Action], int], list[Float]]) -> list[Float]:
    """record(actions of one length, number of the group) for every length, in the order of `actions`.

    The number belongs into the seed, or the first of every group would be the same draw.
    """
    groups: dict[int, list[int]] = {}
    for index, action in enumerate(actions):
        groups.setdefault(len(action.speed), []).append(index)
    out: list[Float] = [np.zeros(0)] * len(actions)
    for group, indices in enumerate(groups.values()):
        for index, samples in zip(indices, render([actions[i] for i in indices], group), strict=True):
            out[index] = samples
    return out


_SEED_OFFSET = 0x5EED_0000_0000
"""Far from any seed a person gives, so that the oracle is never the very draw it is compared with."""


@dataclass(frozen=True)
class FittedProcess:
    """A process as it is."""

    process: TextureProcess

    def render(self, actions: Sequence[Action], seed: int) -> list[Float]:
        """A seed of this call is never that of a recording: it is moved into numbers of its own."""
        own = _SEED_OFFSET + 1000 * seed
        return render_by_duration(
            actions, lambda same, group: [r.samples for r in self.process.record(same, own + group)]
        )


@dataclass(frozen=True)
class OracleMethod:
    """Method: the process that made the recordings."""

    process: TextureProcess
    name: str = "oracle (true process, another seed)"
    form: Form = "natural"

    def fit(self, specimen: MaterialRecordings, seed: int) -> FittedMaterial:
        """Nothing is learned."""
        del specimen, seed
        return FittedProcess(self.process)


SEGMENT_S = 0.05
"""HaTT's pieces are stationary by test; a smooth hand hardly changes in 50 ms, and 500 samples tell 20 coefficients."""
MAX_RELATIVE_RANGE = 0.35
"""Largest range of speed and of force within a piece, over its mean."""
MIN_SPEED_M_S = 1e-3


@dataclass(frozen=True)
class Segments:
    """speed (S,) m/s and force (S,) N: means. samples: (S, lead + n), of which the first lead belong to the piece
    before: the past that a prediction of the first sample needs. lead, rate [Hz]."""

    speed: Float
    force: Float
    samples: Float
    lead: int
    rate: float

    @property
    def body(self) -> Float:
        """(S, n)"""
        return self.samples[:, self.lead :]


def cut_segments(
    recordings: Sequence[Recording], lead: int, *, segment_s: float = SEGMENT_S, max_range: float = MAX_RELATIVE_RANGE
) -> Segments:
    """All pieces in contact and in motion whose speed and force range by no more than `steady` of their mean.

    Raises FileError where there is no such piece, or where recordings differ in sample rate.
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
            inside = slice(int(np.floor(low)), int(np.ceil(high)) + 1)
            v, f = action.speed[inside], action.force[inside]
            if (
                action.contact[inside].all()
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
