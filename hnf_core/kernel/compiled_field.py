"""Compiled evaluation of the field F_Θ: linear contact, network inputs, layers and heads, decoding to amplitudes.

The numpy implementations of the same are in field/linear_contact.py, field/features.py, field/field.py and, for
interpolation between rows, field/adaptive_sampling.py. The result of a state of the hand depends on that state alone,
to the last bit: not on the batch it is in, nor on the number of cores. Weights are stored in the order in which they
are used, which a BLAS would rearrange at every call: at H = 256 this is 1.3 times faster for a hundred states at once,
twice for sixteen.
"""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..threads import parallel_for
from .loader import get_address, pack_pointers

Float = NDArray[np.float64]
Float32 = NDArray[np.float32]
Integers = NDArray[np.int64]

CONTACT_COLUMNS = ("angle", "speed", "radius", "stiffness", "damping", "mass", "load_square", "rubbed", "flank")
"""Columns of the contact parameters of each state, as in hnf_kernel.h.

load_square: (F / m)² [m²/s⁴]. rubbed: 1 + μ². flank: (1 + FLANK_FRICTION · (1 − a / R)²)² − 1, with the contact's
radius a and the tip's radius R.
"""
TOKEN_FEATURES = ("level", "peak", "offset", "cos2", "sin2", "cos4", "sin4")
"""Features of a token's bands that the kernel reads."""


_TABLE_COUNTS = ("bands", "token_bands", "features", "angles")
_TABLE_ARRAYS = ("kappa", "below", "share", "nearest_end", "wavelength", "line_share", "turn", "shift")
_SIMD_WIDTH = 4
"""Numbers per vector, as in contact.c."""
_TABLE_NUMBERS = (
    "per_octave", "concentration", "bump_mean", "least_left", "hand", "hand_damping", "least_across", "clear_peak",
    "least_offset_scale",
)  # fmt: skip


class _TablesStruct(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_int64) for name in (*_TABLE_COUNTS, *TOKEN_FEATURES)),
        *((name, ctypes.c_void_p) for name in _TABLE_ARRAYS),
        *((name, ctypes.c_double) for name in _TABLE_NUMBERS),
    )


class ContactTables:
    """Constants of the linear contact model in the form the C functions read, the struct hnf_tables of hnf_kernel.h.

    The object owns the arrays that the C structure points to.

    Parameters
    ----------
    features
        Names of the features that a material token has per octave band, in order.
    kappa, below, share
        (K,) wavenumber of each arc band (band along the path), the token's octave band below it, and the fraction of
        the way to the next.
    wavelength, nearest_end
        (T,) wavelength of each token band, and the index after the last arc band that it is nearest to.
    line_share
        (T,) share of a token band's power from which on its strongest wave is a line.
    turn, shift
        (A, 4) cosines and sines of twice and four times each angle of a wave to the stroke; (A,) arc bands by which the
        angle lowers the wave along the stroke.
    **numbers
        The other numbers of the struct by their names.

    Raises
    ------
    ValueError
        If these do not fit together.
    """

    def __init__(
        self, *, features: Sequence[str], kappa: Float, share: Float, wavelength: Float, line_share: Float, turn: Float,
        below: Integers, nearest_end: Integers, shift: Integers, **numbers: float,
    ) -> None:  # fmt: skip
        self.bands, self.token_bands, self.angles = len(kappa), len(wavelength), len(shift)
        is_valid = below.min() >= 0 and below.max() < self.token_bands - 1
        is_valid &= shift.min() >= 0 and nearest_end.max() == self.bands and len(nearest_end) == self.token_bands
        is_valid &= len(line_share) == self.token_bands
        if not (is_valid and len(share) == len(below) == self.bands and turn.shape == (len(shift), 4)):
            raise ValueError(f"tables of {self.bands} bands, {self.token_bands} of a token and {self.angles} angles")
        self.token_size = self.token_bands * len(features)
        row = self.bands + int(shift.max()) + _SIMD_WIDTH
        self.scratch_size = 6 * self.bands + 22 * (self.token_bands + _SIMD_WIDTH - 1) + (3 + self.angles) * row
        self._arrays = [
            np.ascontiguousarray(array, dtype=np.float64 if array.dtype.kind == "f" else np.int64)
            for array in (kappa, below, share, nearest_end, wavelength, line_share, turn, shift)
        ]
        self.struct = _TablesStruct(
            self.bands, self.token_bands, len(features), self.angles,
            *(list(features).index(feature) for feature in TOKEN_FEATURES),
            *(values.__array_interface__["data"][0] for values in self._arrays),
            *(numbers[name] for name in _TABLE_NUMBERS),
        )  # fmt: skip


class ContactArrays(NamedTuple):
    """Vibration power that the linear contact predicts at n states, as field.linear_contact.LinearContact.

    power, noise: (n, K) per arc band, with and without tones. normal: (n,) of the normal axis. lines: (2, n, 2T) of
    tones, in the two arc bands about each. low: (n, 2T) index of the lower of the two.
    """

    power: Float
    noise: Float
    normal: Float
    lines: Float
    low: Integers


def compute_linear_contact(kernel: ctypes.CDLL, tables: ContactTables, tokens: Float, touch: Float) -> ContactArrays:
    """Compute the vibration power that the linear contact predicts at n states.

    tokens: (n, at least T · features) of the materials. touch: (n, 9) contact parameters, the columns CONTACT_COLUMNS.
    Raises ValueError if shapes do not fit.
    """
    states, lines = len(tokens), 2 * tables.token_bands
    if touch.shape != (states, len(CONTACT_COLUMNS)) or tokens.shape[1] < tables.token_size:
        raise ValueError(f"contact of {touch.shape} states with tokens of {tokens.shape}")
    result = ContactArrays(
        np.empty((states, tables.bands)), np.empty((states, tables.bands)), np.empty(states),
        np.empty((2, states, lines)), np.empty((states, lines), dtype=np.int64),
    )  # fmt: skip
    scratch = np.empty(tables.scratch_size)
    out = pack_pointers([array.__array_interface__["data"][0] for array in result])
    kernel.hnf_linear_contact(
        ctypes.byref(tables.struct), get_address(tokens, np.float64), tokens.shape[1], get_address(touch, np.float64),
        states,
        get_address(scratch, np.float64), out,
    )  # fmt: skip
    return result


def blend_rows(kernel: ctypes.CDLL, values: Float32, row: Integers, share: Float, factor: Float) -> Float32:
    """Sum interpolated rows of a table: (n, K) Σ_t factor · ((1 − share) · values[row] + share · values[row + 1]).

    values: (m, K) table. row, share, factor: (n, terms) row before, fraction of the way to the next, and weight of each
    term. Raises ValueError if a row is out of range.
    """
    if not row.shape == share.shape == factor.shape or row.ndim != 2:
        raise ValueError(f"rows {row.shape} with shares {share.shape} and factors {factor.shape}")
    if row.size and not 0 <= row.min() <= row.max() <= len(values) - 2:
        raise ValueError(f"rows {row.min()} to {row.max() + 1} of {len(values)}")
    out = np.empty((len(row), values.shape[1]), dtype=np.float32)
    kernel.hnf_between_rows(
        get_address(values, np.float32), values.shape[1], get_address(row, np.int64), get_address(share, np.float64),
        get_address(factor, np.float64), row.shape[1], len(row), get_address(out, np.float32),
    )  # fmt: skip
    return out


PANEL_WIDTH = 32
"""Outputs whose weights are interleaved, as in layers.c."""
STATES_PER_CALL = 96
"""States per call of the C function, few enough that their activations stay in the cache."""
MIN_MULTIPLICATIONS_PER_THREAD = 1 << 24
"""Fewest multiplications for which another thread pays: about a third of a millisecond."""


class Layers:
    """ReLU layers and both heads of F_Θ, with weights packed in the order in which the C code reads them.

    Parameters
    ----------
    weights, biases
        (outputs, inputs) and (outputs,) float32 of the layers in their order, then of the α head and the σ head.

    Raises
    ------
    ValueError
        If the shapes of successive layers do not match.
    TypeError
        If the numbers are not float32.
    """

    def __init__(self, weights: Sequence[Float32], biases: Sequence[Float32]) -> None:
        shapes = [array.shape for array in weights]
        if len(weights) != len(biases) or len(weights) < 2:
            raise ValueError(f"{len(weights)} layers and heads with {len(biases)} biases")
        hidden = shapes[-3][0] if len(shapes) > 2 else shapes[0][1]
        is_valid = all(first[0] == second[1] for first, second in pairwise(shapes[:-2]))
        is_valid = is_valid and shapes[-1][1] == shapes[-2][1] == hidden
        if not is_valid or any(len(bias) != shape[0] for bias, shape in zip(biases, shapes, strict=True)):
            raise ValueError(f"layers of {shapes} do not follow from one another")
        if any(array.dtype != np.float32 for array in (*weights, *biases)):
            raise TypeError("the kernel takes layers of float32")
        self.inputs, self.outputs, self.densities = shapes[0][1], shapes[-2][0], shapes[-1][0]
        self.widths = np.array([shapes[0][1], *(shape[0] for shape in shapes)], dtype=np.int64)
        self.panels, self.biases = [_pack_panels(array) for array in weights], [_pad_rows(array) for array in biases]
        self._scratch_size = 2 * int(self.widths[:-2].max())
        self._min_states = max(MIN_MULTIPLICATIONS_PER_THREAD // sum(array.size for array in self.panels), 1)

    def evaluate(self, kernel: ctypes.CDLL, x: Float32) -> tuple[Float32, Float32]:
        """Return the outputs of the α head and of the σ head, (n, …) each, for inputs x (n, D).

        Raises ValueError for another D.
        """
        if x.ndim != 2 or x.shape[1] != self.inputs:
            raise ValueError(f"inputs of {x.shape} for layers that take {self.inputs}")
        head, sigma = (np.empty((len(x), count), dtype=np.float32) for count in (self.outputs, self.densities))

        def evaluate_part(low: int, high: int) -> None:
            scratch = self.allocate_scratch(min(high - low, STATES_PER_CALL))
            for start in range(low, high, STATES_PER_CALL):
                rows = slice(start, min(start + STATES_PER_CALL, high))
                kernel.hnf_layers(*self.make_arguments(x[rows], scratch, head[rows], sigma[rows]))

        parallel_for(evaluate_part, len(x), self._min_states)
        return head, sigma

    def allocate_scratch(self, states: int) -> Float32:
        """Allocate the scratch memory for this many states at once."""
        return np.empty(states * self._scratch_size, dtype=np.float32)

    def make_arguments(self, x: Float32, scratch: Float32, head: Float32, sigma: Float32) -> tuple[object, ...]:
        """Return the arguments of hnf_layers; the caller must keep these and the arrays alive during the call."""
        addresses = (
            pack_pointers([array.__array_interface__["data"][0] for array in arrays])
            for arrays in (self.panels, self.biases)
        )
        return (
            *addresses, get_address(self.widths, np.int64), len(self.panels) - 2, get_address(x, np.float32), len(x),
            get_address(scratch, np.float32), get_address(head, np.float32), get_address(sigma, np.float32),
        )  # fmt: skip


def _pack_panels(weight: Float32) -> Float32:
    """Rearrange weights (outputs, inputs) as (panels, inputs, PANEL_WIDTH): panels of PANEL_WIDTH outputs."""
    inputs = weight.shape[1]
    return np.ascontiguousarray(_pad_rows(weight).reshape(-1, PANEL_WIDTH, inputs).transpose(0, 2, 1))


def _pad_rows(values: Float32) -> Float32:
    """Append rows of zeros up to a multiple of PANEL_WIDTH."""
    filled = np.zeros((-(-len(values) // PANEL_WIDTH) * PANEL_WIDTH, *values.shape[1:]), dtype=np.float32)
    filled[: len(values)] = values
    return filled


MOTION_COLUMNS = ("x", "y", "speed", "force", "mass", "resonance", "moving")
"""Columns of a state besides CONTACT_COLUMNS, as in hnf_kernel.h."""

_EMISSION_COUNTS = (
    "inputs", "token_size", "fixed_at", "fixed", "direction_at", "time_bands", "carriers", "outputs", "harmonics",
    "stroke_frame", "directed", "line_gains",
)  # fmt: skip
_EMISSION_NUMBERS = ("quiet_power", "quiet_line_power", "time_share", "ceiling", "pace", "pitch")
_EMISSION_ARRAYS = (
    "token_shift", "token_scale", "time_edge", "skip", "knot", "knot_share", "harmonic_shift", "harmonic_start",
)  # fmt: skip
MIN_STATES_PER_THREAD = 128
"""Fewest states for which another thread pays."""
_SCALAR_INPUT_COUNT = 3
_ACTION_INPUT_COUNT = 4


class _EmissionStruct(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_int64) for name in _EMISSION_COUNTS),
        *((name, ctypes.c_double) for name in _EMISSION_NUMBERS),
        *((name, ctypes.c_void_p) for name in _EMISSION_ARRAYS),
    )


class _ContactPriorStruct(ctypes.Structure):
    _fields_ = (("prior", ctypes.c_void_p), ("line", ctypes.c_void_p), ("low", ctypes.c_void_p))


class EmissionTables:
    """Constants of a field's inputs and outputs in the form C reads, the struct hnf_emitter of hnf_kernel.h.

    The object owns the arrays that the C structure points to.

    Parameters
    ----------
    tables
        Constants of the linear contact.
    token_shift, token_scale
        (T,) normalisation of the material token.
    time_edge
        (Kt + 1,) edges of the time bands, as fractional arc-band indices at 1 m/s.
    skip
        (K,) weight of the linear contact in the log amplitude.
    knot, knot_share
        (Ka,) for each arc carrier the α head output below it, and the fraction of the way to the next, by which it is
        interpolated.
    harmonic_shift, harmonic_start
        (H,) of each harmonic of a tone, its shift [arc bands] and initial log gain.
    **numbers
        The other numbers of the struct by their names.

    Raises
    ------
    ValueError
        If these do not fit together.
    """

    def __init__(
        self, tables: ContactTables, *, token_shift: Float, token_scale: Float, time_edge: Float, skip: Float,
        knot: Integers,
        knot_share: Float, harmonic_shift: Integers, harmonic_start: Float, **numbers: float,
    ) -> None:  # fmt: skip
        arrays = (token_shift, token_scale, time_edge, skip, knot, knot_share, harmonic_shift, harmonic_start)
        self._arrays = [
            np.ascontiguousarray(array, dtype=np.float64 if array.dtype.kind == "f" else np.int64) for array in arrays
        ]
        self.tables, self.lines = tables, 2 * tables.token_bands
        counts = {
            "token_size": len(token_shift), "time_bands": len(time_edge) - 1, "carriers": len(skip),
            "harmonics": len(harmonic_shift), **numbers,
        }  # fmt: skip
        self.inputs, self.fixed, self.outputs = (int(counts[name]) for name in ("inputs", "fixed", "outputs"))
        self.has_line_gains, self.harmonics = bool(counts["line_gains"]), len(harmonic_shift)
        self.carriers, self.token_size, time_bands = len(skip), len(token_shift), len(time_edge) - 1
        gain_count = int(counts["line_gains"]) * len(harmonic_shift) * self.lines
        end = int(counts["direction_at"]) + _ACTION_INPUT_COUNT + time_bands + _SCALAR_INPUT_COUNT
        last_knot = knot + (knot_share > 0.0)
        is_valid = self.carriers == time_bands + tables.bands and self.inputs == end
        # The inputs must be adjacent: memory between them would stay uninitialised.
        is_valid &= tables.token_size <= self.token_size == counts["fixed_at"] == counts["direction_at"] - self.fixed
        is_valid &= len(knot) == len(knot_share) == tables.bands and len(token_scale) == self.token_size
        is_valid &= bool(knot.min() >= 0 and time_bands + last_knot.max() + gain_count < self.outputs)
        is_valid &= len(harmonic_start) == len(harmonic_shift)
        if not is_valid:
            raise ValueError(f"a field of {self.inputs} inputs, {self.carriers} carriers and {self.outputs} outputs")
        self.struct = _EmissionStruct(
            *(int(counts[name]) for name in _EMISSION_COUNTS), *(numbers[name] for name in _EMISSION_NUMBERS),
            *(array.__array_interface__["data"][0] for array in self._arrays),
        )  # fmt: skip
        self.scratch_size = tables.scratch_size + 3 * tables.bands + time_bands + 1 + 2 * self.lines
        self.decode_scratch_size = 2 * tables.bands + 2 * self.lines


@dataclass(frozen=True)
class ContactPrior:
    """Prediction of the linear contact for n states, to which the network's output is a correction.

    prior: (n, K) log amplitude per carrier. line: (n, 2, L) powers in the two arc bands about each tone. low: (n, L)
    index of the lower of the two.
    """

    prior: Float
    line: Float
    low: Integers

    @staticmethod
    def empty(states: int, emitter: EmissionTables) -> ContactPrior:
        """Allocate the arrays for this many states."""
        return ContactPrior(
            np.empty((states, emitter.carriers)), np.empty((states, 2, emitter.lines)),
            np.empty((states, emitter.lines), dtype=np.int64),
        )  # fmt: skip

    def select(self, states: slice) -> ContactPrior:
        """Return the rows of some states, as views."""
        return ContactPrior(self.prior[states], self.line[states], self.low[states])

    def to_struct(self, states: int, emitter: EmissionTables) -> _ContactPriorStruct:
        """Return the C structure that points to the arrays. Raises ValueError if shapes do not fit."""
        expected = (states, emitter.carriers), (states, 2, emitter.lines), (states, emitter.lines)
        if (self.prior.shape, self.line.shape, self.low.shape) != expected:
            raise ValueError(f"{self.prior.shape} and {self.line.shape} expected of {states} states")
        return _ContactPriorStruct(
            get_address(self.prior, np.float64), get_address(self.line, np.float64), get_address(self.low, np.int64)
        )


def compute_inputs(
    kernel: ctypes.CDLL, emitter: EmissionTables, tokens: Float, fixed: Float, motion: Float, touch: Float
) -> tuple[Float32, ContactPrior]:
    """Compute the network inputs of n states, and what the linear contact predicts for them.

    Parameters
    ----------
    kernel
        Library of `load_kernel`.
    emitter
        Constants of the field.
    tokens
        (n, TOKEN_DIM) of the materials.
    fixed
        (n, F) inputs of mechanics and probe, which are copied as they are.
    motion
        (n, 7) motion of the hand, the columns MOTION_COLUMNS; speed and force not below their floors.
    touch
        (n, 9) contact parameters, the columns CONTACT_COLUMNS.

    Returns
    -------
    tuple
        (n, D) float32 inputs, and the linear contact's prediction.

    Raises
    ------
    ValueError
        If shapes do not fit.
    """
    states = len(tokens)
    _check_state_shapes(emitter, tokens, fixed, motion, touch)
    x, prior = np.empty((states, emitter.inputs), dtype=np.float32), ContactPrior.empty(states, emitter)

    def compute_part(low: int, high: int) -> None:
        rows, scratch = slice(low, high), np.empty(emitter.scratch_size)
        kernel.hnf_inputs(
            ctypes.byref(emitter.tables.struct), ctypes.byref(emitter.struct), get_address(tokens[rows], np.float64),
            tokens.shape[1], get_address(fixed[rows], np.float64), get_address(motion[rows], np.float64),
            get_address(touch[rows], np.float64), high - low, get_address(scratch, np.float64),
            get_address(x[rows], np.float32), ctypes.byref(prior.select(rows).to_struct(high - low, emitter)),
        )  # fmt: skip

    parallel_for(compute_part, states, MIN_STATES_PER_THREAD)
    return x, prior


def decode_head(
    kernel: ctypes.CDLL, emitter: EmissionTables, head: Float32, motion: Float, prior: ContactPrior
) -> Float:
    """Compute (n, K) amplitudes from the α head's outputs (n, outputs); 0 where nothing moves.

    motion: (n, 7), the columns MOTION_COLUMNS. prior: from compute_inputs. Raises ValueError if shapes do not fit.
    """
    states = len(head)
    _check_head(emitter, head, motion)
    prior.to_struct(states, emitter)
    alpha = np.empty((states, emitter.carriers))

    def decode_part(low: int, high: int) -> None:
        rows, scratch = slice(low, high), np.empty(emitter.decode_scratch_size)
        kernel.hnf_emitted(
            ctypes.byref(emitter.tables.struct), ctypes.byref(emitter.struct), get_address(head[rows], np.float32),
            get_address(motion[rows], np.float64), ctypes.byref(prior.select(rows).to_struct(high - low, emitter)),
            high - low,
            get_address(scratch, np.float64), get_address(alpha[rows], np.float64),
        )  # fmt: skip

    parallel_for(decode_part, states, MIN_STATES_PER_THREAD)
    return alpha


class _PathLinesStruct(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("column", "pitch", "along", "scatter", "tones")),
        ("count", ctypes.c_int64),
    )


class ToneArrays:
    """Lines along the path at n states whose tones are apart from the carriers, and the tones (n, L · harmonics).

    Parameters
    ----------
    emitter
        Constants of the field.
    column
        (n, L) which of the linear contact's lines these are.
    pitch
        (n, L) wavenumbers across the crests [cycles/m]; 0 where there is no such line.
    along
        (n, L) wavenumbers along the path [cycles/m].
    scatter
        (n,) RMS displacement of the lattice [m].

    Raises
    ------
    ValueError
        If these do not fit together, or name lines that no token has.
    """

    def __init__(self, emitter: EmissionTables, column: Integers, pitch: Float, along: Float, scatter: Float) -> None:
        shapes, count = {column.shape, pitch.shape, along.shape}, column.shape[-1]
        is_valid = not column.size or (int(column.min()) >= 0 and int(column.max()) < emitter.lines)
        if shapes != {(len(scatter), count)} or not is_valid or not emitter.has_line_gains:
            raise ValueError(f"{shapes} wavenumbers of {count} lines at {len(scatter)} states")
        self.states, self.along, self.column = len(scatter), along, column
        self.tones = np.empty((self.states, count * emitter.harmonics))
        arrays = pitch, along, scatter, self.tones
        self._arrays = column, *arrays
        self.struct = _PathLinesStruct(
            get_address(column, np.int64), *(get_address(array, np.float64) for array in arrays), count
        )


def take_tones(
    kernel: ctypes.CDLL, emitter: EmissionTables, head: Float32, motion: Float, prior: ContactPrior, lines: ToneArrays
) -> None:
    """Take the tones of lines out of the contact's prediction, in place, before decode_head; they are in lines.tones.

    Other parameters and errors as of decode_head.
    """
    _check_head(emitter, head, motion)
    if len(head) != lines.states:
        raise ValueError(f"lines at {lines.states} states for {len(head)}")
    kernel.hnf_take_tones(
        ctypes.byref(emitter.tables.struct), ctypes.byref(emitter.struct), get_address(head, np.float32),
        get_address(motion, np.float64), ctypes.byref(prior.to_struct(len(head), emitter)), len(head),
        ctypes.byref(lines.struct),
    )  # fmt: skip


def gather_sidebands(kernel: ctypes.CDLL, emitter: EmissionTables, lines: ToneArrays, alpha: Float) -> None:
    """Give the tones what the scatter of their pitch spreads about them, from alpha (n, K), in place."""
    if alpha.shape != (lines.states, emitter.carriers):
        raise ValueError(f"amplitudes {alpha.shape} for lines at {lines.states} states")
    scratch = np.empty(2 * emitter.tables.bands + lines.column.shape[1])
    kernel.hnf_gather_sidebands(
        ctypes.byref(emitter.tables.struct), ctypes.byref(emitter.struct), lines.states, ctypes.byref(lines.struct),
        get_address(scratch, np.float64), get_address(alpha, np.float64, writable=True),
    )  # fmt: skip


def decode_known_head(
    kernel: ctypes.CDLL, emitter: EmissionTables, tokens: Float, motion: Float, touch: Float, head: Float32
) -> Float:
    """Compute (n, K) amplitudes from known outputs of the α head (n, outputs), without evaluating the network.

    The linear contact's prediction is computed, but no network inputs. Other parameters and errors as of
    compute_inputs.
    """
    states = len(tokens)
    _check_state_shapes(emitter, tokens, None, motion, touch)
    _check_head(emitter, head, motion)
    alpha = np.empty((states, emitter.carriers))

    def decode_part(low: int, high: int) -> None:
        rows, prior = slice(low, high), ContactPrior.empty(high - low, emitter)
        scratch, prior_struct = (
            np.empty(max(emitter.scratch_size, emitter.decode_scratch_size)),
            prior.to_struct(high - low, emitter),
        )
        tables, emitter_struct = ctypes.byref(emitter.tables.struct), ctypes.byref(emitter.struct)
        kernel.hnf_inputs(
            tables, emitter_struct, get_address(tokens[rows], np.float64), tokens.shape[1], None,
            get_address(motion[rows], np.float64), get_address(touch[rows], np.float64), high - low,
            get_address(scratch, np.float64), None, ctypes.byref(prior_struct),
        )  # fmt: skip
        kernel.hnf_emitted(
            tables, emitter_struct, get_address(head[rows], np.float32), get_address(motion[rows], np.float64),
            ctypes.byref(prior_struct), high - low, get_address(scratch, np.float64),
            get_address(alpha[rows], np.float64),
        )  # fmt: skip

    parallel_for(decode_part, states, MIN_STATES_PER_THREAD)
    return alpha


def _check_head(emitter: EmissionTables, head: Float32, motion: Float) -> None:
    """Raise ValueError if head and motion do not fit the field."""
    if head.shape[1] != emitter.outputs or motion.shape != (len(head), len(MOTION_COLUMNS)):
        raise ValueError(f"{head.shape} answers for {motion.shape} states")


_MOTION_PACKER, _CONTACT_PACKER = (struct.Struct(f"{len(names)}d") for names in (MOTION_COLUMNS, CONTACT_COLUMNS))


class StateEvaluator:
    """Evaluator of F_Θ on one material, state by state; its buffers are allocated once and reused.

    Parameters
    ----------
    emitter
        Constants of the field.
    layers
        Layers of the field.
    token
        (1, TOKEN_DIM) of the material.
    fixed
        (1, F) inputs of mechanics and probe, the same for every state.

    Raises
    ------
    ValueError
        If these do not fit together.
    """

    def __init__(self, emitter: EmissionTables, layers: Layers, token: Float, fixed: Float) -> None:
        if (layers.inputs, layers.outputs) != (emitter.inputs, emitter.outputs):
            raise ValueError(
                f"layers from {layers.inputs} to {layers.outputs} numbers for {emitter.inputs} inputs and "
                f"{emitter.outputs} outputs"
            )
        self._motion, self._touch = np.ones((1, len(MOTION_COLUMNS))), np.ones((1, len(CONTACT_COLUMNS)))
        _check_state_shapes(emitter, token, fixed, self._motion, self._touch)
        x, prior = np.empty((1, emitter.inputs), dtype=np.float32), ContactPrior.empty(1, emitter)
        buffer, layer_buffer = (
            np.empty(max(emitter.scratch_size, emitter.decode_scratch_size)),
            layers.allocate_scratch(1),
        )
        head, self._sigma = (np.empty((1, n), dtype=np.float32) for n in (layers.outputs, layers.densities))
        self._alpha, prior_struct = np.empty(emitter.carriers), prior.to_struct(1, emitter)
        tables, emitter_struct = ctypes.byref(emitter.tables.struct), ctypes.byref(emitter.struct)
        scratch, motion = get_address(buffer, np.float64), get_address(self._motion, np.float64)
        self._inputs = (
            tables, emitter_struct, get_address(token, np.float64), token.shape[1], get_address(fixed, np.float64),
            motion, get_address(self._touch, np.float64), 1, scratch, get_address(x, np.float32),
            ctypes.byref(prior_struct),
        )  # fmt: skip
        self._layers = layers.make_arguments(x, layer_buffer, head, self._sigma)
        self._emitted = (
            tables, emitter_struct, get_address(head, np.float32), motion, ctypes.byref(prior_struct), 1, scratch,
            get_address(self._alpha, np.float64),
        )  # fmt: skip
        self._buffers = (emitter, layers, token, fixed, x, prior, prior_struct, buffer, layer_buffer, head)

    def evaluate(
        self,
        kernel: ctypes.CDLL,
        motion: Sequence[float],
        touch: Sequence[float],
        lines: ToneArrays | None = None,
    ) -> tuple[Float, Float32]:
        """Return amplitudes α (K,), 0 if nothing moves, and the σ head's outputs (N,); the next call overwrites both.

        motion, touch: values in the order of MOTION_COLUMNS and CONTACT_COLUMNS. lines: lines at this state, whose
        tones are to be apart from α.
        """
        _MOTION_PACKER.pack_into(self._motion.data, 0, *motion)
        _CONTACT_PACKER.pack_into(self._touch.data, 0, *touch)
        kernel.hnf_inputs(*self._inputs)
        kernel.hnf_layers(*self._layers)
        if lines is None:
            kernel.hnf_emitted(*self._emitted)
            return self._alpha, self._sigma[0]
        reference = ctypes.byref(lines.struct)
        kernel.hnf_take_tones(*self._emitted[:6], reference)
        kernel.hnf_emitted(*self._emitted)
        kernel.hnf_gather_sidebands(*self._emitted[:2], 1, reference, *self._emitted[6:])
        return self._alpha, self._sigma[0]


def _check_state_shapes(
    emitter: EmissionTables, tokens: Float, fixed: Float | None, motion: Float, touch: Float
) -> None:
    """Raise ValueError if the arrays of a batch of states do not fit the field."""
    states = len(tokens)
    shapes = (states, emitter.fixed) if fixed is None else fixed.shape, motion.shape, touch.shape
    if shapes != ((states, emitter.fixed), (states, len(MOTION_COLUMNS)), (states, len(CONTACT_COLUMNS))):
        raise ValueError(f"{states} tokens with {shapes}")
    if tokens.shape[1] < emitter.token_size:
        raise ValueError(f"tokens of {tokens.shape[1]} numbers, of which {emitter.token_size} are read")
