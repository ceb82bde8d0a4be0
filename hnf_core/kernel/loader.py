"""Find and load the compiled kernel, the package `hnf_kernel` that tools/build_kernel.py builds from source/.

`load_kernel` returns the ctypes library, or None where none is installed, it has another version, or HNF_KERNEL=off
disables it; the callers then compute the same in numpy. The other functions turn numpy arrays into the addresses that C
functions take. `hnf bench` reports which implementation ran.
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

ABI = 12
"""HNF_ABI of hnf_kernel.h; a library of another version has other functions."""
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
    "hnf_contact_motion": (_Pointer, _Pointer, _Integer, _Integer, _Pointer, _Pointer, _Pointer),
    "hnf_tap": (_Pointer, _Pointer, _Integer, _Pointer, _Integer, _Integer, _Pointer, _Pointer),
    "hnf_tones": (_Pointer, _Pointer, _Pointer, _Pointer, _Integer, _Integer, _Pointer),
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
    "hnf_take_tones": (_Pointer, _Pointer, _Pointer, _Pointer, _Pointer, _Integer, _Pointer),
    "hnf_gather_sidebands": (_Pointer, _Pointer, _Integer, _Pointer, _Pointer, _Pointer),
    "hnf_force_noise": (_Pointer, _Pointer, _Pointer, _Integer, _Integer, _Integer, _Pointer, _Pointer),
    "hnf_body_gains": (_Pointer, _Pointer, _Integer, _Pointer),
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
    """Return the compiled library, or None where numpy is used instead."""
    return None if getattr(_thread_override, "disabled", False) else _find_library()[0]


def why_unavailable() -> str:
    """Return the reason why there is no kernel; empty if there is one."""
    return _find_library()[1]


def get_build_id() -> str:
    """Return the version of the kernel in use, "" for numpy.

    The version contains the hash of the sources that the kernel was built from, and is the same on every platform.
    """
    from importlib.metadata import PackageNotFoundError, version  # Takes 20 ms, which synthesis does not need.

    if why_unavailable():
        return ""
    try:
        return version("hnf-kernel")
    except PackageNotFoundError:  # The folder is importable, but was not installed as a distribution.
        return f"of version {ABI}"


@contextmanager
def without_kernel() -> Iterator[None]:
    """Disable the kernel in this thread, for comparisons of the kernel with numpy."""
    before, _thread_override.disabled = getattr(_thread_override, "disabled", False), True
    try:
        yield
    finally:
        _thread_override.disabled = before


def single_blas_thread_without_kernel() -> AbstractContextManager[None]:
    """Limit BLAS to one thread where numpy replaces the kernel; do nothing otherwise, since the kernel uses no BLAS."""
    return single_blas_thread() if load_kernel() is None else nullcontext()


def get_address(array: NDArray[Any], dtype: Any, *, writable: bool = False) -> int:
    """Return the address of an array's first element.

    Parameters
    ----------
    array
        C-contiguous array.
    dtype
        The type that the C function reads or writes.
    writable
        True if the C function writes into the array.

    Raises
    ------
    TypeError
        If the array has another type, is not contiguous, or is read-only where C would write.
    """
    if writable and not array.flags.writeable:
        raise TypeError("the kernel would write into an array that is read-only")
    if array.dtype != dtype or not array.flags.c_contiguous:
        raise TypeError(f"the kernel takes contiguous {np.dtype(dtype)}, not {array.dtype} of strides {array.strides}")
    return int(array.__array_interface__["data"][0])


def pack_pointers(addresses: Sequence[int]) -> bytes:
    """Pack addresses into a table of C pointers, valid as long as the returned bytes live.

    A ctypes array would create a class for every length, which only the garbage collector frees.
    """
    return struct.pack(f"{len(addresses)}P", *addresses)


def get_row_layout(array: NDArray[np.float32]) -> tuple[int, int]:
    """Return the address and row stride (in elements) of a float32 table (m, K) with contiguous rows.

    Raises TypeError for another type or for rows that are not contiguous.
    """
    if array.dtype != np.float32 or array.strides[1] != array.itemsize:
        raise TypeError(f"the kernel takes rows of float32, not {array.dtype} of strides {array.strides}")
    return int(array.__array_interface__["data"][0]), array.strides[0] // array.itemsize


@lru_cache(maxsize=1)
def _find_library() -> tuple[ctypes.CDLL | None, str]:
    """Load the library once; return it, or None and the reason."""
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
    except (OSError, AttributeError) as error:  # It is no library, or lacks one of the functions.
        return None, str(error)
    return library, ""


def _load_library(path: Path) -> ctypes.CDLL:
    """Load one library and declare its functions. Raises OSError if it cannot be loaded or has another version."""
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
