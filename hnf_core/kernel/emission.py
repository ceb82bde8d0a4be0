"""Compiled: from states to what F_Θ takes, and from what it answers to amplitudes (the twins in numpy are build_inputs
in field/features.py and _in_numpy in field/field.py)."""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..cores import in_parts
from .contact import TOUCH, Tables
from .layers import Layers
from .library import address

Float = NDArray[np.float64]
Float32 = NDArray[np.float32]
Integers = NDArray[np.int64]

MOTION = ("x", "y", "speed", "force", "mass", "resonance", "moving")
"""Columns of what is known of each state besides TOUCH, as in hnf_kernel.h."""

_COUNTS = (
    "inputs", "token_size", "fixed_at", "fixed", "direction_at", "time_bands", "carriers", "outputs", "harmonics",
    "stroke_frame", "directed", "line_gains",
)  # fmt: skip
_NUMBERS = ("quiet_power", "quiet_line_power", "time_share", "ceiling", "pace", "pitch")
_ARRAYS = (
    "token_shift", "token_scale", "time_edge", "skip", "knot", "knot_share", "harmonic_shift", "harmonic_start",
)  # fmt: skip
WORTH_A_CORE = 128
"""States."""
_SCALARS = 3
_ACTION = 4


class _Struct(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_int64) for name in _COUNTS),
        *((name, ctypes.c_double) for name in _NUMBERS),
        *((name, ctypes.c_void_p) for name in _ARRAYS),
    )


class _Expected(ctypes.Structure):
    _fields_ = (("prior", ctypes.c_void_p), ("line", ctypes.c_void_p), ("low", ctypes.c_void_p))


class Emitter:
    """What no state changes, as hnf_emitter in hnf_kernel.h; its arrays stay where they are.

    tables: of linear contact. token_shift, token_scale: (T,); time_edge: (Kt + 1,); skip: (K,); knot, knot_share:
    (Ka,); harmonic_shift, harmonic_start: (H,); scalars by their names. Raises ValueError where they do not fit.
    """

    def __init__(
        self, tables: Tables, *, token_shift: Float, token_scale: Float, time_edge: Float, skip: Float, knot: Integers,
        knot_share: Float, harmonic_shift: Integers, harmonic_start: Float, **numbers: float,
    ) -> None:  # fmt: skip
        arrays = (token_shift, token_scale, time_edge, skip, knot, knot_share, harmonic_shift, harmonic_start)
        self._kept = [
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
        after = int(counts["direction_at"]) + _ACTION + time_bands + _SCALARS
        reach = knot + (knot_share > 0.0)
        fits = self.carriers == time_bands + tables.bands and self.inputs == after
        # One after another: what lies between them would stay as the memory was.
        fits &= tables.token_size <= self.token_size == counts["fixed_at"] == counts["direction_at"] - self.fixed
        fits &= len(knot) == len(knot_share) == tables.bands and len(token_scale) == self.token_size
        fits &= bool(knot.min() >= 0 and time_bands + reach.max() + gains < self.outputs)
        fits &= len(harmonic_start) == len(harmonic_shift)
        if not fits:
            raise ValueError(f"a field of {self.inputs} inputs, {self.carriers} carriers and {self.outputs} outputs")
        self.struct = _Struct(
            *(int(counts[name]) for name in _COUNTS), *(numbers[name] for name in _NUMBERS),
            *(each.__array_interface__["data"][0] for each in self._kept),
        )  # fmt: skip
        self.room = tables.room + 3 * tables.bands + time_bands + 1 + 2 * self.lines
        self.emitted_room = 2 * tables.bands + 2 * self.lines


@dataclass(frozen=True)
class Expected:
    """What linear contact expects of n states: prior (n, K) log amplitudes; line (n, 2, L) powers in the two arc bands
    about each tone, low (n, L) the lower one."""

    prior: Float
    line: Float
    low: Integers

    @staticmethod
    def empty(states: int, emitter: Emitter) -> Expected:
        return Expected(
            np.empty((states, emitter.carriers)), np.empty((states, 2, emitter.lines)),
            np.empty((states, emitter.lines), dtype=np.int64),
        )  # fmt: skip

    def of(self, states: slice) -> Expected:
        return Expected(self.prior[states], self.line[states], self.low[states])

    def struct(self, states: int, emitter: Emitter) -> _Expected:
        wanted = (states, emitter.carriers), (states, 2, emitter.lines), (states, emitter.lines)
        if (self.prior.shape, self.line.shape, self.low.shape) != wanted:
            raise ValueError(f"{self.prior.shape} and {self.line.shape} expected of {states} states")
        return _Expected(address(self.prior, np.float64), address(self.line, np.float64), address(self.low, np.int64))


def inputs(
    kernel: ctypes.CDLL, emitter: Emitter, tokens: Float, fixed: Float, motion: Float, touch: Float
) -> tuple[Float32, Expected]:
    """(n, D) network inputs, and what contact expects.

    tokens: (n, TOKEN_DIM). fixed: (n, F) inputs as they are. motion: (n, 7) columns MOTION, speed and force not below
    their floors; touch: (n, 9) columns TOUCH. Raises ValueError where shapes do not fit.
    """
    states = len(tokens)
    _check(emitter, tokens, fixed, motion, touch)
    x, expected = np.empty((states, emitter.inputs), dtype=np.float32), Expected.empty(states, emitter)

    def part(low: int, high: int) -> None:
        rows, scratch = slice(low, high), np.empty(emitter.room)
        kernel.hnf_inputs(
            ctypes.byref(emitter.tables.struct), ctypes.byref(emitter.struct), address(tokens[rows], np.float64),
            tokens.shape[1], address(fixed[rows], np.float64), address(motion[rows], np.float64),
            address(touch[rows], np.float64), high - low, address(scratch, np.float64), address(x[rows], np.float32),
            ctypes.byref(expected.of(rows).struct(high - low, emitter)),
        )  # fmt: skip

    in_parts(part, states, WORTH_A_CORE)
    return x, expected


def emitted(kernel: ctypes.CDLL, emitter: Emitter, head: Float32, motion: Float, expected: Expected) -> Float:
    """(n, K) amplitudes of what the head answers (n, outputs); 0 where nothing moves. Raises ValueError as inputs()."""
    states = len(head)
    _check_answers(emitter, head, motion)
    expected.struct(states, emitter)
    alpha = np.empty((states, emitter.carriers))

    def part(low: int, high: int) -> None:
        rows, scratch = slice(low, high), np.empty(emitter.emitted_room)
        kernel.hnf_emitted(
            ctypes.byref(emitter.tables.struct), ctypes.byref(emitter.struct), address(head[rows], np.float32),
            address(motion[rows], np.float64), ctypes.byref(expected.of(rows).struct(high - low, emitter)), high - low,
            address(scratch, np.float64), address(alpha[rows], np.float64),
        )  # fmt: skip

    in_parts(part, states, WORTH_A_CORE)
    return alpha


def answered(kernel: ctypes.CDLL, emitter: Emitter, tokens: Float, motion: Float, touch: Float, head: Float32) -> Float:
    """emitted() of a head (n, outputs) that has answered without being asked: no inputs are made. The rest as of
    inputs()."""
    states = len(tokens)
    _check(emitter, tokens, None, motion, touch)
    _check_answers(emitter, head, motion)
    alpha = np.empty((states, emitter.carriers))

    def part(low: int, high: int) -> None:
        rows, expected = slice(low, high), Expected.empty(high - low, emitter)
        scratch, told = np.empty(max(emitter.room, emitter.emitted_room)), expected.struct(high - low, emitter)
        tables, own = ctypes.byref(emitter.tables.struct), ctypes.byref(emitter.struct)
        kernel.hnf_inputs(
            tables, own, address(tokens[rows], np.float64), tokens.shape[1], None, address(motion[rows], np.float64),
            address(touch[rows], np.float64), high - low, address(scratch, np.float64), None, ctypes.byref(told),
        )  # fmt: skip
        kernel.hnf_emitted(
            tables, own, address(head[rows], np.float32), address(motion[rows], np.float64), ctypes.byref(told),
            high - low, address(scratch, np.float64), address(alpha[rows], np.float64),
        )  # fmt: skip

    in_parts(part, states, WORTH_A_CORE)
    return alpha


def _check_answers(emitter: Emitter, head: Float32, motion: Float) -> None:
    if head.shape[1] != emitter.outputs or motion.shape != (len(head), len(MOTION)):
        raise ValueError(f"{head.shape} answers for {motion.shape} states")


_MOTION, _TOUCH = (struct.Struct(f"{len(names)}d") for names in (MOTION, TOUCH))


class OneState:
    """F_Θ of one state after another on one material: what it is worked out in is set up once.

    layers: of the field. token: (1, TOKEN_DIM); fixed: (1, F). Raises ValueError where these do not fit.
    """

    def __init__(self, emitter: Emitter, layers: Layers, token: Float, fixed: Float) -> None:
        if (layers.inputs, layers.outputs) != (emitter.inputs, emitter.outputs):
            raise ValueError(
                f"layers from {layers.inputs} to {layers.outputs} numbers for {emitter.inputs} inputs and "
                f"{emitter.outputs} outputs"
            )
        self._motion, self._touch = np.ones((1, len(MOTION))), np.ones((1, len(TOUCH)))
        _check(emitter, token, fixed, self._motion, self._touch)
        x, expected = np.empty((1, emitter.inputs), dtype=np.float32), Expected.empty(1, emitter)
        room, layers_room = np.empty(max(emitter.room, emitter.emitted_room)), layers.room(1)
        head, self._sigma = (np.empty((1, n), dtype=np.float32) for n in (layers.outputs, layers.densities))
        self._alpha, told = np.empty(emitter.carriers), expected.struct(1, emitter)
        tables, own = ctypes.byref(emitter.tables.struct), ctypes.byref(emitter.struct)
        scratch, motion = address(room, np.float64), address(self._motion, np.float64)
        self._inputs = (
            tables, own, address(token, np.float64), token.shape[1], address(fixed, np.float64), motion,
            address(self._touch, np.float64), 1, scratch, address(x, np.float32), ctypes.byref(told),
        )  # fmt: skip
        self._layers = layers.call(x, layers_room, head, self._sigma)
        self._emitted = (
            tables, own, address(head, np.float32), motion, ctypes.byref(told), 1, scratch,
            address(self._alpha, np.float64),
        )  # fmt: skip
        self._kept = (emitter, layers, token, fixed, x, expected, told, room, layers_room, head)

    def at(self, kernel: ctypes.CDLL, motion: Sequence[float], touch: Sequence[float]) -> tuple[Float, Float32]:
        """α (K,) of a state, 0 where nothing moves, and what the σ head answers (N,): both are overwritten by the next
        call. motion, touch: numbers in the order of MOTION and TOUCH."""
        _MOTION.pack_into(self._motion.data, 0, *motion)
        _TOUCH.pack_into(self._touch.data, 0, *touch)
        kernel.hnf_inputs(*self._inputs)
        kernel.hnf_layers(*self._layers)
        kernel.hnf_emitted(*self._emitted)
        return self._alpha, self._sigma[0]


def _check(emitter: Emitter, tokens: Float, fixed: Float | None, motion: Float, touch: Float) -> None:
    states = len(tokens)
    shapes = (states, emitter.fixed) if fixed is None else fixed.shape, motion.shape, touch.shape
    if shapes != ((states, emitter.fixed), (states, len(MOTION)), (states, len(TOUCH))):
        raise ValueError(f"{states} tokens with {shapes}")
    if tokens.shape[1] < emitter.token_size:
        raise ValueError(f"tokens of {tokens.shape[1]} numbers, of which {emitter.token_size} are read")
