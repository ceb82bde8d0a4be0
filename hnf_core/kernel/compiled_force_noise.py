"""Compiled force noise: friction's fluctuations and the response of the probe's body, added to amplitudes in place.

The numpy implementation of the same, and what the tables hold, are in field/force_noise.py.
"""

from __future__ import annotations

import ctypes
import struct

import numpy as np
from numpy.typing import NDArray

from .loader import get_address

Float = NDArray[np.float64]
Integers = NDArray[np.int64]

_COUNTS = ("time_bands", "arc_bands", "rows", "step", "loads", "size")
_NUMBERS = (
    "per_octave", "log_least_speed", "log_first_hz", "loads_per_octave", "log_least_force", "force_exponent",
    "exponent", "time_start",
)  # fmt: skip
_ARRAYS = ("gain", "body", "time_gain", "time_body", "bands", "time_power", "log_loads")
RUBBING_COLUMNS = ("speed", "force", "scale")
"""Columns of a state: speed [m/s], force [N] and the factor on the noise's power."""
_RUBBING_PACKER = struct.Struct(f"{len(RUBBING_COLUMNS)}d")


class _FrictionStruct(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_int64) for name in _COUNTS),
        *((name, ctypes.c_double) for name in _NUMBERS),
        *((name, ctypes.c_void_p) for name in _ARRAYS),
    )


class FrictionTables:
    """Tables of force noise in the form the C functions read, the struct hnf_friction of hnf_kernel.h.

    The object owns the arrays that the C structure points to, and the buffers of `add_to_state`.

    Parameters
    ----------
    rows, step
        Number of rows of the arc bands' tables, and entries from one arc band to the next in each.
    gain, body
        (size,) power gains of a force and of a motion, in even steps of log frequency.
    time_gain, time_body
        (Kt,) the same of the time bands.
    bands
        (Ka,) power of the force per arc band under a stiff tip at 1 N.
    time_power
        (Kt + 1,) whose differences are its power per time band at 1 m/s.
    log_loads
        (loads, Ka) log power under a pad; (0, Ka) for a stiff tip.
    **numbers
        The other numbers of the struct by their names.

    Raises
    ------
    ValueError
        If these do not fit together.
    """

    def __init__(
        self, *, rows: int, step: int, gain: Float, body: Float, time_gain: Float, time_body: Float, bands: Float,
        time_power: Float, log_loads: Float, **numbers: float,
    ) -> None:  # fmt: skip
        times, arcs = len(time_gain), len(bands)
        shapes = gain.shape, time_body.shape, time_power.shape, log_loads.shape[1:]
        if shapes != (body.shape, (times,), (times + 1,), (arcs,)) or rows + (arcs - 1) * step > len(gain):
            raise ValueError(f"tables of {shapes} for {times} time bands and {arcs} arc bands in {rows} rows")
        self.carriers = times + arcs
        arrays = gain, body, time_gain, time_body, bands, time_power, log_loads
        self._arrays = [np.ascontiguousarray(array, dtype=np.float64) for array in arrays]
        self._struct = _FrictionStruct(
            times, arcs, rows, step, len(log_loads), len(gain), *(numbers[name] for name in _NUMBERS),
            *(get_address(array, np.float64) for array in self._arrays),
        )  # fmt: skip
        self._reference = ctypes.byref(self._struct)
        self._rubbing, self._row, self._scratch = np.ones((1, 3)), np.zeros(1, np.int64), np.empty(2 * self.carriers)
        self._state = (
            self._reference, get_address(self._rubbing, np.float64), get_address(self._row, np.int64), 1, 1,
            self.carriers, get_address(self._scratch, np.float64),
        )  # fmt: skip

    def add(self, kernel: ctypes.CDLL, alpha: Float, rows: Integers, rubbing: Float) -> None:
        """Add the noise to amplitudes (n, heads, K + tones), in place, and apply the body's gain.

        rows: (m,) states that rub. rubbing: (m, 3) of them, the columns RUBBING_COLUMNS. Raises ValueError if shapes do
        not fit.
        """
        if rubbing.shape != (len(rows), len(RUBBING_COLUMNS)) or alpha.shape[2] < self.carriers:
            raise ValueError(f"{rubbing.shape} of {len(rows)} states for amplitudes of {alpha.shape}")
        if rows.size and not 0 <= rows.min() <= rows.max() < len(alpha):
            raise ValueError(f"states {rows.min()} to {rows.max()} of {len(alpha)}")
        scratch = np.empty(2 * self.carriers)
        kernel.hnf_force_noise(
            self._reference, get_address(rubbing, np.float64), get_address(rows, np.int64), len(rows), alpha.shape[1],
            alpha.shape[2], get_address(scratch, np.float64), get_address(alpha, np.float64, writable=True),
        )  # fmt: skip

    def add_to_state(self, kernel: ctypes.CDLL, alpha: Float, speed: float, force: float, scale: float) -> None:
        """Add the noise of one state to amplitudes (K,), in place; for one thread at a time."""
        _RUBBING_PACKER.pack_into(self._rubbing.data, 0, speed, force, scale)
        kernel.hnf_force_noise(*self._state, get_address(alpha, np.float64, writable=True))

    def compute_body_gains(self, kernel: ctypes.CDLL, frequency: Float) -> Float:
        """Compute the body's gain at frequencies [Hz], in an array of their shape."""
        out = np.empty_like(frequency)
        kernel.hnf_body_gains(
            self._reference, get_address(frequency, np.float64), frequency.size, get_address(out, np.float64)
        )
        return out
