"""Tones of regular surfaces: a weave, a knurl or a grating of the library as lines that keep their phase.

F_Θ has an output for each line of a token and its harmonics. As noise in two arc carriers such a line would come and
go, with another level for every seed; a real lattice sounds at κ v with its phase in arc length. So a line of the token
(`lattice_lines.find_lines`) is rendered as one tone of the power that F_Θ gives it, and so are its harmonics.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from ..kernel.compiled_carriers import ToneRenderer
from ..kernel.loader import load_kernel
from ..material.contact_model import Mechanics
from .contact.lattice_lines import HARMONICS, LINE_COUNT, Lines, find_lines
from .linear_contact import BAND_END_HZ
from .stroke import SAMPLES_PER_STATE

Float = NDArray[np.float64]

GOLDEN_TURN = 0.6180339887498949
"""Phase between the tones of one band and the next at the stroke's begin, so that no crests coincide [turns]."""
QUADRATURE = 0.25
"""Phase of the tones across a band's axis against those along it [turns], so that their powers add where both have one
pitch along the path (a knurl stroked along its diagonal)."""
SCATTER_LENGTH_M = 3e-3
"""Length L over which threads and ribs are displaced together, with the correlation exp(−(π x / L)²); a test
holds it to the simulator's lattices."""
SCATTER_STEP_M = 0.25e-3
"""Distance of the places where the displacement is computed; linear in between [m]."""
SCATTER_WAVES = 16
"""Waves that a displacement is the sum of."""
SCATTER_MARGIN = 64
"""Places computed beyond those asked for, so that a hand that goes on finds them."""


def count_turns(wavenumber: Float, position: Float) -> Float:
    """Return the phase (n, L) of each line at n states [turns], from 0 at the first; position: (n,) along the path [m].

    Between two states a line has the mean of their wavenumbers.
    """
    turns = np.zeros_like(wavenumber)
    np.cumsum(mean_wavenumber(wavenumber) * np.diff(position)[:, None], axis=0, out=turns[1:])
    return turns


def mean_wavenumber(wavenumber: Float) -> Float:
    """Return the wavenumbers (n − 1, L) between n states."""
    return np.asarray(0.5 * (wavenumber[:-1] + wavenumber[1:]))


def compute_tone_offsets(lines: Lines) -> Float:
    """Return the phases (L · harmonics,) of the tones where the path begins [turns]."""
    band, bands = lines.column % (LINE_COUNT // 2), lines.column // (LINE_COUNT // 2)
    number = len(HARMONICS) * band[:, None] + np.arange(len(HARMONICS))
    return np.asarray((GOLDEN_TURN * (number + 1) + QUADRATURE * bands[:, None]).ravel())


def render_line(turns: Float, amplitude: Float, offsets: Float) -> Float:
    """Render a line with its harmonics: Σ √2 A_h sin 2π(h φ + offset_h), (count,) [m/s²].

    turns: (count,) its phase φ [turns]. amplitude: (count, harmonics) RMS. offsets: (harmonics,) [turns].
    """
    out = np.zeros(len(turns))
    for order, (harmonic, offset) in enumerate(zip(HARMONICS, offsets.tolist(), strict=True)):
        phase = harmonic * turns + offset
        wave = np.sin((2.0 * np.pi * (phase - np.floor(phase))).astype(np.float32))
        out += np.sqrt(2.0) * amplitude[:, order] * wave
    return out


class PitchScatter:
    """Displacement of a lattice's threads or ribs from their even places, along both axes, by place on the path.

    A sum of waves of random phase, whose wavenumbers are spread as the power of the correlation asks. It depends on the
    place alone, so that a stroke back meets the same threads.

    Parameters
    ----------
    seed
        Seed of the displacement.
    """

    def __init__(self, seed: int) -> None:
        self._wavenumber, self._phase = _draw_scatter_waves(seed)
        self._table, self._reach = (np.zeros((2, 0)), 0.0, 1.0), (0, -1)

    def tabulate(self, position: Float) -> tuple[Float, float, float]:
        """Return the displacement (2, points), RMS 1, at even places that span positions (count,) along the path [m].

        Also the first of the places [m], and their number per metre.
        """
        low, high = math.floor(position.min() / SCATTER_STEP_M), math.ceil(position.max() / SCATTER_STEP_M) + 1
        if self._reach[0] <= low and high <= self._reach[1]:
            return self._table
        low, high = low - SCATTER_MARGIN, high + SCATTER_MARGIN
        steps = np.arange(low, high + 1)
        turns = self._wavenumber[:, :, None] * (steps * SCATTER_STEP_M) + self._phase[:, :, None]
        waves = np.cos((2.0 * np.pi * (turns - np.floor(turns))).astype(np.float32))
        grid = math.sqrt(2.0 / SCATTER_WAVES) * waves.sum(axis=1, dtype=np.float64)
        self._table, self._reach = (grid, low * SCATTER_STEP_M, 1.0 / SCATTER_STEP_M), (low, high)
        return self._table

    def evaluate(self, position: Float) -> Float:
        """Return the displacement (2, count), RMS 1, at positions (count,) along the path [m]."""
        grid, first, per_m = self.tabulate(position)
        place = (position - first) * per_m
        return np.stack([np.interp(place, np.arange(grid.shape[1]), axis) for axis in grid])


@lru_cache(maxsize=16)
def _draw_scatter_waves(seed: int) -> tuple[Float, Float]:
    """Draw wavenumbers [cycles/m] and phases [turns], (2, waves) each, of the sines that displace the threads."""
    draw = np.random.Generator(np.random.Philox(key=seed)).random((2, 2, SCATTER_WAVES))
    share = 0.5 + 0.5 * (np.arange(SCATTER_WAVES) + draw[0]) / SCATTER_WAVES
    # exp(−(π x / L)²) is the transform of a normal distribution of wavenumbers with deviation 1 / (√2 L).
    normal = NormalDist(sigma=1.0 / (np.sqrt(2.0) * SCATTER_LENGTH_M))
    return np.array([[normal.inv_cdf(each) for each in axis] for axis in share.tolist()]), draw[1]


@dataclass(frozen=True)
class LineCourse:
    """Lines along the path of a stroke, at its n states.

    Attributes
    ----------
    lines : Lines
        Lines of the stroke's materials.
    wavenumber : ndarray, shape (n, L)
        Of the lines along the path [cycles/m].
    turns : ndarray, shape (n, L)
        Phase of even lines [turns].
    scatter : ndarray, shape (n, 2, L)
        Phase by which a displacement of 1 along either axis shifts the lines [turns].
    displacement : PitchScatter or None
        Displacement of the lines; None if they are all even.
    """

    lines: Lines
    wavenumber: Float
    turns: Float
    scatter: Float
    displacement: PitchScatter | None = None

    @property
    def tone_count(self) -> int:
        """Number of tones: of all lines with their harmonics."""
        return self.lines.tone_count

    def rows(self, rows: slice) -> LineCourse:
        """Return the course at some of the states."""
        return LineCourse(
            self.lines, self.wavenumber[rows], self.turns[rows], self.scatter[rows], self.displacement
        )  # fmt: skip

    def silence_others(self, amplitude: Float, sample: NDArray[np.int64], speed: Float) -> None:
        """Silence the tones (m, L · harmonics) at samples (m,), in place, where they would not be heard.

        Past states still give a line that the material touched at present does not have, and the frequency is that of
        the fastest motion nearby. speed: (n,) that motion at the states [m/s].
        """
        state = np.clip(np.rint(sample / SAMPLES_PER_STATE).astype(np.intp), 0, len(self.wavenumber) - 1)
        wavenumber = (self.wavenumber[state][:, :, None] * np.array(HARMONICS)).reshape(len(state), -1)
        amplitude *= (wavenumber > 0.0) & (wavenumber * speed[state, None] < BAND_END_HZ)

    def render(self, action: Action, knots: NDArray[np.int64], amplitude: Float, start: int, position: Float) -> Float:
        """Render the tones at samples start … start + count − 1 of the model rate, (count,) [m/s²].

        action: the stroke's at its states. knots: (m,) samples of the amplitudes (m, L · harmonics), linear in between.
        position: (count,) along the path [m].
        """
        sample, last = start + np.arange(len(position)), len(self.turns) - 1
        state = np.clip(sample // SAMPLES_PER_STATE, 0, max(last - 1, 0))
        way = position - action.position[state]
        kernel = load_kernel()
        if kernel is None:
            displacement = None if self.displacement is None else self.displacement.evaluate(position)
            return self._render_numpy(state, way, displacement, knots, amplitude, sample)
        renderer = make_renderer(self.lines, self.turns, self._between, self.scatter, knots, amplitude)
        table = None if self.displacement is None else self.displacement.tabulate(position)
        return renderer.render(kernel, way, position, start, table)

    @property
    def _between(self) -> Float:
        """Wavenumbers between the states, one row at least."""
        return mean_wavenumber(self.wavenumber) if len(self.wavenumber) > 1 else self.wavenumber

    def _render_numpy(
        self,
        state: NDArray[np.int64],
        way: Float,
        displacement: Float | None,
        knots: NDArray[np.int64],
        amplitude: Float,
        sample: NDArray[np.int64],
    ) -> Float:
        """Render the tones as the kernel does. state, way: state before each sample, and the path from there [m]."""
        between, offsets, out = self._between, compute_tone_offsets(self.lines), np.zeros(len(sample))
        low = np.clip(np.searchsorted(knots, sample, side="right") - 1, 0, max(len(knots) - 2, 0))
        high = np.minimum(low + 1, len(knots) - 1)
        share = np.clip((sample - knots[low]) / np.maximum(knots[high] - knots[low], 1), 0.0, 1.0)
        for line in range(self.turns.shape[1]):
            columns = slice(line * len(HARMONICS), (line + 1) * len(HARMONICS))
            strength = amplitude[low, columns] + share[:, None] * (amplitude[high, columns] - amplitude[low, columns])
            if strength.any():
                turns = self.turns[state, line] + between[state, line] * way
                if displacement is not None:
                    turns += (self.scatter[state, :, line] * displacement.T).sum(axis=1)
                out += render_line(turns, strength, offsets[columns])
        return out


def make_renderer(
    lines: Lines, turns: Float, between: Float, scatter: Float, knots: NDArray[np.int64], amplitude: Float
) -> ToneRenderer:
    """Make the kernel's renderer of lines; see ToneRenderer."""
    return ToneRenderer(
        np.ascontiguousarray(turns), np.ascontiguousarray(between), np.ascontiguousarray(scatter),
        np.ascontiguousarray(knots, dtype=np.int64), np.ascontiguousarray(amplitude, dtype=np.float64), len(HARMONICS),
        compute_tone_offsets(lines), SAMPLES_PER_STATE,
    )  # fmt: skip


def make_scatter(lines: Lines, mechanics: Sequence[Mechanics]) -> Float:
    """Return the phases (M, 2, L) by which a displacement of 1 along either axis shifts M materials' lines [turns]."""
    scatter = np.array([properties.pitch_scatter_m or 0.0 for properties in mechanics])
    along_axes = np.stack([np.cos(lines.angle), np.sin(lines.angle)], axis=1)
    return np.asarray(along_axes * lines.wavenumber[:, None, :] * scatter[:, None, None])


def follow_lines(
    tokens: NDArray[np.float32],
    mechanics: Sequence[Mechanics],
    action: Action,
    token_index: NDArray[np.int32],
    seed: int,
) -> LineCourse | None:
    """Follow the lines of a stroke's materials along its path; None if no material has any.

    tokens: (M, TOKEN_DIM), with their mechanics. action, token_index: from resample_action. seed: of the scatter.
    """
    lines = find_lines(tokens)
    if not lines.count:
        return None
    angle = np.arctan2(action.direction[:, 1], action.direction[:, 0])[:, None]
    wavenumber = lines.wavenumber[token_index] * np.abs(np.cos(lines.angle[token_index] - angle))
    scatter = make_scatter(lines, mechanics)
    displacement = PitchScatter(seed) if scatter.any() else None
    turns = count_turns(wavenumber, action.position)
    return LineCourse(lines, wavenumber, turns, scatter[token_index], displacement)
