"""Finds and loads the compiled kernel (package hnf_kernel, which tools/build_kernel.py makes from source/).

Everything it does has a twin in numpy that takes over where there is no kernel, or where HNF_KERNEL=off asks for it.
`hnf bench` says which of the two was at work.
"""

from __future__ import annotations

import ctypes
import os
import struct
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..threads import single_blas_thread

ABI = 7
"""hnf_kernel.h's HNF_ABI: another one has other functions."""
SWITCH_VARIABLE = "HNF_KERNEL"
LIBRARY_SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")

_Integer, _Word, _Number, _Pointer = ctypes.c_int64, ctypes.c_uint64, ctypes.c_double, ctypes.c_void_p
_SIGNATURES = {
    "hnf_hops": (
        _Pointer, _Pointer, _Integer, _Integer, _Pointer, _Pointer, _Pointer, _Pointer, _Pointer, _Pointer, _Pointer,
    ),
    "hnf_plan_hops": (_Pointer, _Pointer, _Integer, _Integer, _Pointer, _Integer, _Pointer, _Pointer),
    "hnf_press": (
        _Pointer, _Integer, _Pointer, _Integer, _Pointer, _Pointer, _Integer, _Integer, _Integer, _Integer, _Pointer,
    ),
    "hnf_place": (_Pointer, _Integer, _Integer, _Integer, _Integer, _Pointer),
    "hnf_read_arcs": (
        _Pointer, _Pointer, _Integer, _Pointer, _Pointer, _Integer, _Pointer, _Pointer, _Pointer, _Integer, _Pointer,
        _Pointer,
    ),
    "hnf_linear_contact": (_Pointer, _Pointer, _Integer, _Pointer, _Integer, _Pointer, _Pointer),
    "hnf_inputs": (
        _Pointer, _Pointer, _Pointer, _Integer, _Pointer, _Pointer, _Pointer, _Integer, _Pointer, _Pointer, _Pointer,
    ),
    "hnf_emitted": (_Pointer, _Pointer, _Pointer, _Pointer, _Pointer, _Integer, _Pointer, _Pointer),
    "hnf_layers": (
        _Pointer, _Pointer, _Pointer, _Integer, _Pointer, _Integer, _Pointer, _Pointer, _Pointer,
    ),
    "hnf_between_rows": (_Pointer, _Integer, _Pointer, _Pointer, _Pointer, _Integer, _Integer, _Pointer),
    "hnf_bends": (_Pointer, _Integer, _Integer, _Number, _Pointer),
    "hnf_bins": (_Word, _Word, _Word, _Integer, _Integer, _Integer, _Pointer, _Pointer),
    "hnf_real_waves": (
        _Pointer, _Pointer, _Pointer, _Integer, _Integer, _Integer, _Pointer, _Pointer, _Pointer, _Pointer, _Pointer,
    ),
    "hnf_complex_waves": (
        _Pointer, _Pointer, _Integer, _Integer, _Integer, _Pointer, _Pointer, _Pointer, _Pointer, _Pointer,
    ),
}  # fmt: skip
_thread_override = threading.local()


def load_kernel() -> ctypes.CDLL | None:
    """The compiled functions, or None where numpy does their work."""
    return None if getattr(_thread_override, "disabled", False) else _find_library()[0]


def why_unavailable() -> str:
    """Why there is no kernel; empty where there is one."""
    return _find_library()[1]


def get_build_id() -> str:
    """Which build of it is at work: its version, which holds the hash of the sources it was made from, whatever machine
    it was made for; "" where numpy does its work."""
    from importlib.metadata import PackageNotFoundError, version  # 20 ms that no synthesis needs

    if why_unavailable():
        return ""
    try:
        return version("hnf-kernel")
    except PackageNotFoundError:  # only its folder was put there
        return f"of version {ABI}"


@contextmanager
def without_kernel() -> Iterator[None]:
    """Numpy alone, in this thread: what the kernel is measured and tested against."""
    before, _thread_override.disabled = getattr(_thread_override, "disabled", False), True
    try:
        yield
    finally:
        _thread_override.disabled = before


def single_blas_thread_without_kernel() -> AbstractContextManager[None]:
    """one_blas_thread() where numpy does the kernel's work; the kernel asks no BLAS."""
    return single_blas_thread() if load_kernel() is None else nullcontext()


def get_address(array: NDArray[Any], dtype: Any, *, writable: bool = False) -> int:
    """Where an array's numbers begin. Raises TypeError where they are of another type or not one piece of memory: C
    would read something else; and where C is to write and nobody may."""
    if writable and not array.flags.writeable:
        raise TypeError("the kernel would write into an array that is read-only")
    if array.dtype != dtype or not array.flags.c_contiguous:
        raise TypeError(f"the kernel takes contiguous {np.dtype(dtype)}, not {array.dtype} of strides {array.strides}")
    return int(array.__array_interface__["data"][0])


def pack_pointers(addresses: Sequence[int]) -> bytes:
    """A table of them, for as long as the call that it is given to takes. (A ctypes array has a class of its own for
    every length, which waits for the garbage collector.)"""
    return struct.pack(f"{len(addresses)}P", *addresses)


def get_row_layout(array: NDArray[np.float32]) -> tuple[int, int]:
    """Where a table (m, K) of float32 begins, and the numbers between its rows; each row is one piece."""
    if array.dtype != np.float32 or array.strides[1] != array.itemsize:
        raise TypeError(f"the kernel takes rows of float32, not {array.dtype} of strides {array.strides}")
    return int(array.__array_interface__["data"][0]), array.strides[0] // array.itemsize


@lru_cache(maxsize=1)
def _find_library() -> tuple[ctypes.CDLL | None, str]:
    if os.environ.get(SWITCH_VARIABLE, "").lower() in ("off", "0"):
        return None, f"switched off by {SWITCH_VARIABLE}"
    try:
        import hnf_kernel
    except ImportError:
        return None, "not installed"
    folder = Path(hnf_kernel.__file__).parent
    try:
        library = _load_library(folder / f"hnf_kernel{LIBRARY_SUFFIX}")
        wide = folder / f"hnf_kernel_wide{LIBRARY_SUFFIX}"
        if library.hnf_has_wide_vectors() and wide.is_file():
            library = _load_library(wide)
    except (OSError, AttributeError) as error:  # not a library, or one without our functions
        return None, str(error)
    return library, ""


def _load_library(path: Path) -> ctypes.CDLL:
    """Raises OSError where it cannot be loaded or is another version."""
    library = ctypes.CDLL(str(path))
    for name in ("hnf_abi", "hnf_has_wide_vectors"):
        function = getattr(library, name)
        function.restype, function.argtypes = _Integer, ()
    if library.hnf_abi() != ABI:
        raise OSError(f"{path.name} is of version {library.hnf_abi()} where {ABI} is wanted: build and install it anew")
    for name, arguments in _SIGNATURES.items():
        function = getattr(library, name)
        function.restype, function.argtypes = None, arguments
    library.hnf_plan_hops.restype = _Integer
    return library
