"""Compiled: linear contact, and rows read between rows (the twins in numpy are in field/linear_contact.py
and field/adaptive_sampling.py).

Compiled: the layers and heads of F_Θ (the twin in numpy is heads in field/field.py).

What a state gives follows from that state alone, to the last bit: not from how many are asked for at once, nor from the
number of cores. And weights that lie in the order in which they are used make a state cheaper than a BLAS that puts
them in order at every call: at H = 256 1.3 times with a hundred states at once, twice with sixteen.

Compiled: from states to what F_Θ takes, and from what it answers to amplitudes (the twins in numpy are build_inputs
in field/features.py and _in_numpy in field/field.py).
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
"""Columns of what is known of each state, as in hnf_kernel.h. load_square: (F / m)² [m²/s⁴]; rubbed: 1 + μ²; flank:
(1 + FLANK_FRICTION · (1 − a / R)²)² − 1, a the contact's radius and R the tip's."""
TOKEN_FEATURES = ("level", "peak", "offset", "cos2", "sin2", "cos4", "sin4")
"""Of a token's bands, that are asked for."""


_TABLE_COUNTS = ("bands", "token_bands", "features", "angles")
_TABLE_ARRAYS = ("kappa", "below", "share", "nearest_end", "wavelength", "turn", "shift")
_SIMD_WIDTH = 4
"""Numbers at once, as in contact.c."""
_TABLE_NUMBERS = ("per_octave", "concentration", "bump_mean", "least_left", "hand", "hand_damping")


class _TablesStruct(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_int64) for name in (*_TABLE_COUNTS, *TOKEN_FEATURES)),
        *((name, ctypes.c_void_p) for name in _TABLE_ARRAYS),
        *((name, ctypes.c_double) for name in _TABLE_NUMBERS),
    )


class ContactTables:
    """What no state changes, as hnf_tables in hnf_kernel.h; its arrays stay where they are.

    features: names of a band's features in a token, in order. kappa, below, share: (K,); wavelength, nearest_end: (T,);
    turn: (A, 4); shift: (A,); scalars by their names. Raises ValueError where they do not fit together.
    """

    def __init__(
        self, *, features: Sequence[str], kappa: Float, share: Float, wavelength: Float, turn: Float, below: Integers,
        nearest_end: Integers, shift: Integers, **numbers: float,
    ) -> None:  # fmt: skip
        self.bands, self.token_bands, self.angles = len(kappa), len(wavelength), len(shift)
        inside = below.min() >= 0 and below.max() < self.token_bands - 1
        inside &= shift.min() >= 0 and nearest_end.max() == self.bands and len(nearest_end) == self.token_bands
        if not (inside and len(share) == len(below) == self.bands and turn.shape == (len(shift), 4)):
            raise ValueError(f"tables of {self.bands} bands, {self.token_bands} of a token and {self.angles} angles")
        self.token_size = self.token_bands * len(features)
        row = self.bands + int(shift.max()) + _SIMD_WIDTH
        self.scratch_size = 6 * self.bands + 21 * (self.token_bands + _SIMD_WIDTH - 1) + (3 + self.angles) * row
        self._arrays = [
            np.ascontiguousarray(array, dtype=np.float64 if array.dtype.kind == "f" else np.int64)
            for array in (kappa, below, share, nearest_end, wavelength, turn, shift)
        ]
        self.struct = _TablesStruct(
            self.bands, self.token_bands, len(features), self.angles,
            *(list(features).index(n) for n in TOKEN_FEATURES),
            *(each.__array_interface__["data"][0] for each in self._arrays),
            *(numbers[name] for name in _TABLE_NUMBERS),
        )  # fmt: skip


class ContactArrays(NamedTuple):
    """As field.linear_contact.LinearContact: power, noise (n, K); normal (n,); lines (2, n, 2T) and low (n, 2T)."""

    power: Float
    noise: Float
    normal: Float
    lines: Float
    low: Integers


def compute_linear_contact(kernel: ctypes.CDLL, tables: ContactTables, tokens: Float, touch: Float) -> ContactArrays:
    """tokens: (n, at least T · features). touch: (n, 9) columns TOUCH. Raises ValueError where shapes do not fit."""
    states, lines = len(tokens), 2 * tables.token_bands
    if touch.shape != (states, len(CONTACT_COLUMNS)) or tokens.shape[1] < tables.token_size:
        raise ValueError(f"contact of {touch.shape} states with tokens of {tokens.shape}")
    found = ContactArrays(
        np.empty((states, tables.bands)), np.empty((states, tables.bands)), np.empty(states),
        np.empty((2, states, lines)), np.empty((states, lines), dtype=np.int64),
    )  # fmt: skip
    scratch = np.empty(tables.scratch_size)
    out = pack_pointers([each.__array_interface__["data"][0] for each in found])
    kernel.hnf_linear_contact(
        ctypes.byref(tables.struct), get_address(tokens, np.float64), tokens.shape[1], get_address(touch, np.float64),
        states,
        get_address(scratch, np.float64), out,
    )  # fmt: skip
    return found


def blend_rows(kernel: ctypes.CDLL, values: Float32, row: Integers, share: Float, factor: Float) -> Float32:
    """(n, K) Σ over terms of factor times what lies share of the way from a row of values (m, K) to the next; row,
    share, factor: (n, terms). Raises ValueError where there is no such row."""
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
"""Outputs whose weights lie side by side, as in layers.c."""
STATES_PER_CALL = 96
"""States whose numbers on the way stay near the processor."""
MIN_MULTIPLICATIONS_PER_THREAD = 1 << 24
"""Multiplications: about a third of a millisecond."""


class Layers:
    """weights (outputs, inputs) and biases (outputs,) float32: the ReLU layers in their order, then the heads of α and
    of σ. Raises ValueError where these do not follow from one another, TypeError for other numbers."""

    def __init__(self, weights: Sequence[Float32], biases: Sequence[Float32]) -> None:
        shapes = [each.shape for each in weights]
        if len(weights) != len(biases) or len(weights) < 2:
            raise ValueError(f"{len(weights)} layers and heads with {len(biases)} biases")
        hidden = shapes[-3][0] if len(shapes) > 2 else shapes[0][1]
        fits = all(one[0] == other[1] for one, other in pairwise(shapes[:-2]))
        fits = fits and shapes[-1][1] == shapes[-2][1] == hidden
        if not fits or any(len(bias) != shape[0] for bias, shape in zip(biases, shapes, strict=True)):
            raise ValueError(f"layers of {shapes} do not follow from one another")
        if any(each.dtype != np.float32 for each in (*weights, *biases)):
            raise TypeError("the kernel takes layers of float32")
        self.inputs, self.outputs, self.densities = shapes[0][1], shapes[-2][0], shapes[-1][0]
        self.widths = np.array([shapes[0][1], *(shape[0] for shape in shapes)], dtype=np.int64)
        self.panels, self.biases = [_pack_panels(each) for each in weights], [_pad_rows(each) for each in biases]
        self._scratch_size = 2 * int(self.widths[:-2].max())
        self._min_states = max(MIN_MULTIPLICATIONS_PER_THREAD // sum(each.size for each in self.panels), 1)

    def evaluate(self, kernel: ctypes.CDLL, x: Float32) -> tuple[Float32, Float32]:
        """What the α head and the σ head say of inputs x (n, D), (n, …) each. Raises ValueError for another D."""
        if x.ndim != 2 or x.shape[1] != self.inputs:
            raise ValueError(f"inputs of {x.shape} for layers that take {self.inputs}")
        head, sigma = (np.empty((len(x), count), dtype=np.float32) for count in (self.outputs, self.densities))

        def part(low: int, high: int) -> None:
            room = self.allocate_scratch(min(high - low, STATES_PER_CALL))
            for at in range(low, high, STATES_PER_CALL):
                rows = slice(at, min(at + STATES_PER_CALL, high))
                kernel.hnf_layers(*self.make_arguments(x[rows], room, head[rows], sigma[rows]))

        parallel_for(part, len(x), self._min_states)
        return head, sigma

    def allocate_scratch(self, states: int) -> Float32:
        """What so many states at once are worked out in."""
        return np.empty(states * self._scratch_size, dtype=np.float32)

    def make_arguments(self, x: Float32, scratch: Float32, head: Float32, sigma: Float32) -> tuple[object, ...]:
        """What hnf_layers is called with; all of it is to be kept for as long as that."""
        addresses = (
            pack_pointers([each.__array_interface__["data"][0] for each in some]) for some in (self.panels, self.biases)
        )
        return (
            *addresses, get_address(self.widths, np.int64), len(self.panels) - 2, get_address(x, np.float32), len(x),
            get_address(scratch, np.float32), get_address(head, np.float32), get_address(sigma, np.float32),
        )  # fmt: skip


def _pack_panels(weight: Float32) -> Float32:
    """Weights (outputs, inputs) as (panels, inputs, PANEL)."""
    inputs = weight.shape[1]
    return np.ascontiguousarray(_pad_rows(weight).reshape(-1, PANEL_WIDTH, inputs).transpose(0, 2, 1))


def _pad_rows(values: Float32) -> Float32:
    """Rows of 0 after the last, to a whole number of panels."""
    filled = np.zeros((-(-len(values) // PANEL_WIDTH) * PANEL_WIDTH, *values.shape[1:]), dtype=np.float32)
    filled[: len(values)] = values
    return filled


MOTION_COLUMNS = ("x", "y", "speed", "force", "mass", "resonance", "moving")
"""Columns of what is known of each state besides TOUCH, as in hnf_kernel.h."""

_EMISSION_COUNTS = (
    "inputs", "token_size", "fixed_at", "fixed", "direction_at", "time_bands", "carriers", "outputs", "harmonics",
    "stroke_frame", "directed", "line_gains",
)  # fmt: skip
_EMISSION_NUMBERS = ("quiet_power", "quiet_line_power", "time_share", "ceiling", "pace", "pitch")
_EMISSION_ARRAYS = (
    "token_shift", "token_scale", "time_edge", "skip", "knot", "knot_share", "harmonic_shift", "harmonic_start",
)  # fmt: skip
MIN_STATES_PER_THREAD = 128
"""States."""
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
    """What no state changes, as hnf_emitter in hnf_kernel.h; its arrays stay where they are.

    tables: of linear contact. token_shift, token_scale: (T,); time_edge: (Kt + 1,); skip: (K,); knot, knot_share:
    (Ka,); harmonic_shift, harmonic_start: (H,); scalars by their names. Raises ValueError where they do not fit.
    """

    def __init__(
        self, tables: ContactTables, *, token_shift: Float, token_scale: Float, time_edge: Float, skip: Float,
        knot: Integers,
        knot_share: Float, harmonic_shift: Integers, harmonic_start: Float, **numbers: float,
    ) -> None:  # fmt: skip
        arrays = (token_shift, token_scale, time_edge, skip, knot, knot_share, harmonic_shift, harmonic_start)
        self._arrays = [
            np.ascontiguousarray(each, dtype=np.float64 if each.dtype.kind == "f" else np.int64) for each in arrays
        ]
        self.tables, self.lines = tables, 2 * tables.token_bands
        counts = {
            "token_size": len(token_shift), "time_bands": len(time_edge) - 1, "carriers": len(skip),
            "harmonics": len(harmonic_shift), **numbers,
        }  # fmt: skip
        self.inputs, self.fixed, self.outputs = (int(counts[name]) for name in ("inputs", "fixed", "outputs"))
        self.carriers, self.token_size, time_bands = len(skip), len(token_shift), len(time_edge) - 1
        gains = int(counts["line_gains"]) * len(harmonic_shift) * self.lines
        after = int(counts["direction_at"]) + _ACTION_INPUT_COUNT + time_bands + _SCALAR_INPUT_COUNT
        reach = knot + (knot_share > 0.0)
        fits = self.carriers == time_bands + tables.bands and self.inputs == after
        # One after another: what lies between them would stay as the memory was.
        fits &= tables.token_size <= self.token_size == counts["fixed_at"] == counts["direction_at"] - self.fixed
        fits &= len(knot) == len(knot_share) == tables.bands and len(token_scale) == self.token_size
        fits &= bool(knot.min() >= 0 and time_bands + reach.max() + gains < self.outputs)
        fits &= len(harmonic_start) == len(harmonic_shift)
        if not fits:
            raise ValueError(f"a field of {self.inputs} inputs, {self.carriers} carriers and {self.outputs} outputs")
        self.struct = _EmissionStruct(
            *(int(counts[name]) for name in _EMISSION_COUNTS), *(numbers[name] for name in _EMISSION_NUMBERS),
            *(each.__array_interface__["data"][0] for each in self._arrays),
        )  # fmt: skip
        self.scratch_size = tables.scratch_size + 3 * tables.bands + time_bands + 1 + 2 * self.lines
        self.decode_scratch_size = 2 * tables.bands + 2 * self.lines


@dataclass(frozen=True)
class ContactPrior:
    """What linear contact expects of n states: prior (n, K) log amplitudes; line (n, 2, L) powers in the two arc bands
    about each tone, low (n, L) the lower one."""

    prior: Float
    line: Float
    low: Integers

    @staticmethod
    def empty(states: int, emitter: EmissionTables) -> ContactPrior:
        return ContactPrior(
            np.empty((states, emitter.carriers)), np.empty((states, 2, emitter.lines)),
            np.empty((states, emitter.lines), dtype=np.int64),
        )  # fmt: skip

    def select(self, states: slice) -> ContactPrior:
        return ContactPrior(self.prior[states], self.line[states], self.low[states])

    def to_struct(self, states: int, emitter: EmissionTables) -> _ContactPriorStruct:
        wanted = (states, emitter.carriers), (states, 2, emitter.lines), (states, emitter.lines)
        if (self.prior.shape, self.line.shape, self.low.shape) != wanted:
            raise ValueError(f"{self.prior.shape} and {self.line.shape} expected of {states} states")
        return _ContactPriorStruct(
            get_address(self.prior, np.float64), get_address(self.line, np.float64), get_address(self.low, np.int64)
        )


def compute_inputs(
    kernel: ctypes.CDLL, emitter: EmissionTables, tokens: Float, fixed: Float, motion: Float, touch: Float
) -> tuple[Float32, ContactPrior]:
    """(n, D) network inputs, and what contact expects.

    tokens: (n, TOKEN_DIM). fixed: (n, F) inputs as they are. motion: (n, 7) columns MOTION, speed and force not below
    their floors; touch: (n, 9) columns TOUCH. Raises ValueError where shapes do not fit.
    """
    states = len(tokens)
    _check_state_shapes(emitter, tokens, fixed, motion, touch)
    x, expected = np.empty((states, emitter.inputs), dtype=np.float32), ContactPrior.empty(states, emitter)

    def part(low: int, high: int) -> None:
        rows, scratch = slice(low, high), np.empty(emitter.scratch_size)
        kernel.hnf_inputs(
            ctypes.byref(emitter.tables.struct), ctypes.byref(emitter.struct), get_address(tokens[rows], np.float64),
            tokens.shape[1], get_address(fixed[rows], np.float64), get_address(motion[rows], np.float64),
            get_address(touch[rows], np.float64), high - low, get_address(scratch, np.float64), get_address(x[rows],
            np.float32),
            ctypes.byref(expected.select(rows).to_struct(high - low, emitter)),
        )  # fmt: skip

    parallel_for(part, states, MIN_STATES_PER_THREAD)
    return x, expected


def decode_head(
    kernel: ctypes.CDLL, emitter: EmissionTables, head: Float32, motion: Float, prior: ContactPrior
) -> Float:
    """(n, K) amplitudes of what the head answers (n, outputs); 0 where nothing moves. Raises ValueError as inputs()."""
    states = len(head)
    _check_head(emitter, head, motion)
    prior.to_struct(states, emitter)
    alpha = np.empty((states, emitter.carriers))

    def part(low: int, high: int) -> None:
        rows, scratch = slice(low, high), np.empty(emitter.decode_scratch_size)
        kernel.hnf_emitted(
            ctypes.byref(emitter.tables.struct), ctypes.byref(emitter.struct), get_address(head[rows], np.float32),
            get_address(motion[rows], np.float64), ctypes.byref(prior.select(rows).to_struct(high - low, emitter)),
            high - low,
            get_address(scratch, np.float64), get_address(alpha[rows], np.float64),
        )  # fmt: skip

    parallel_for(part, states, MIN_STATES_PER_THREAD)
    return alpha


def decode_known_head(
    kernel: ctypes.CDLL, emitter: EmissionTables, tokens: Float, motion: Float, touch: Float, head: Float32
) -> Float:
    """emitted() of a head (n, outputs) that has answered without being asked: no inputs are made. The rest as of
    inputs()."""
    states = len(tokens)
    _check_state_shapes(emitter, tokens, None, motion, touch)
    _check_head(emitter, head, motion)
    alpha = np.empty((states, emitter.carriers))

    def part(low: int, high: int) -> None:
        rows, expected = slice(low, high), ContactPrior.empty(high - low, emitter)
        scratch, told = (
            np.empty(max(emitter.scratch_size, emitter.decode_scratch_size)),
            expected.to_struct(high - low, emitter),
        )
        tables, own = ctypes.byref(emitter.tables.struct), ctypes.byref(emitter.struct)
        kernel.hnf_inputs(
            tables, own, get_address(tokens[rows], np.float64), tokens.shape[1], None, get_address(motion[rows],
            np.float64),
            get_address(touch[rows], np.float64), high - low, get_address(scratch, np.float64), None,
            ctypes.byref(told),
        )  # fmt: skip
        kernel.hnf_emitted(
            tables, own, get_address(head[rows], np.float32), get_address(motion[rows], np.float64), ctypes.byref(told),
            high - low, get_address(scratch, np.float64), get_address(alpha[rows], np.float64),
        )  # fmt: skip

    parallel_for(part, states, MIN_STATES_PER_THREAD)
    return alpha


def _check_head(emitter: EmissionTables, head: Float32, motion: Float) -> None:
    if head.shape[1] != emitter.outputs or motion.shape != (len(head), len(MOTION_COLUMNS)):
        raise ValueError(f"{head.shape} answers for {motion.shape} states")


_MOTION_PACKER, _CONTACT_PACKER = (struct.Struct(f"{len(names)}d") for names in (MOTION_COLUMNS, CONTACT_COLUMNS))


class StateEvaluator:
    """F_Θ of one state after another on one material: what it is worked out in is set up once.

    layers: of the field. token: (1, TOKEN_DIM); fixed: (1, F). Raises ValueError where these do not fit.
    """

    def __init__(self, emitter: EmissionTables, layers: Layers, token: Float, fixed: Float) -> None:
        if (layers.inputs, layers.outputs) != (emitter.inputs, emitter.outputs):
            raise ValueError(
                f"layers from {layers.inputs} to {layers.outputs} numbers for {emitter.inputs} inputs and "
                f"{emitter.outputs} outputs"
            )
        self._motion, self._touch = np.ones((1, len(MOTION_COLUMNS))), np.ones((1, len(CONTACT_COLUMNS)))
        _check_state_shapes(emitter, token, fixed, self._motion, self._touch)
        x, expected = np.empty((1, emitter.inputs), dtype=np.float32), ContactPrior.empty(1, emitter)
        room, layers_room = np.empty(max(emitter.scratch_size, emitter.decode_scratch_size)), layers.allocate_scratch(1)
        head, self._sigma = (np.empty((1, n), dtype=np.float32) for n in (layers.outputs, layers.densities))
        self._alpha, told = np.empty(emitter.carriers), expected.to_struct(1, emitter)
        tables, own = ctypes.byref(emitter.tables.struct), ctypes.byref(emitter.struct)
        scratch, motion = get_address(room, np.float64), get_address(self._motion, np.float64)
        self._inputs = (
            tables, own, get_address(token, np.float64), token.shape[1], get_address(fixed, np.float64), motion,
            get_address(self._touch, np.float64), 1, scratch, get_address(x, np.float32), ctypes.byref(told),
        )  # fmt: skip
        self._layers = layers.make_arguments(x, layers_room, head, self._sigma)
        self._emitted = (
            tables, own, get_address(head, np.float32), motion, ctypes.byref(told), 1, scratch,
            get_address(self._alpha, np.float64),
        )  # fmt: skip
        self._buffers = (emitter, layers, token, fixed, x, expected, told, room, layers_room, head)

    def evaluate(self, kernel: ctypes.CDLL, motion: Sequence[float], touch: Sequence[float]) -> tuple[Float, Float32]:
        """α (K,) of a state, 0 where nothing moves, and what the σ head answers (N,): both are overwritten by the next
        call. motion, touch: numbers in the order of MOTION and TOUCH."""
        _MOTION_PACKER.pack_into(self._motion.data, 0, *motion)
        _CONTACT_PACKER.pack_into(self._touch.data, 0, *touch)
        kernel.hnf_inputs(*self._inputs)
        kernel.hnf_layers(*self._layers)
        kernel.hnf_emitted(*self._emitted)
        return self._alpha, self._sigma[0]


def _check_state_shapes(
    emitter: EmissionTables, tokens: Float, fixed: Float | None, motion: Float, touch: Float
) -> None:
    states = len(tokens)
    shapes = (states, emitter.fixed) if fixed is None else fixed.shape, motion.shape, touch.shape
    if shapes != ((states, emitter.fixed), (states, len(MOTION_COLUMNS)), (states, len(CONTACT_COLUMNS))):
        raise ValueError(f"{states} tokens with {shapes}")
    if tokens.shape[1] < emitter.token_size:
        raise ValueError(f"tokens of {tokens.shape[1]} numbers, of which {emitter.token_size} are read")
