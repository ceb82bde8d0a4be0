"""Where numpy does the compiled kernel's work."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext

from ..blas import one_blas_thread
from ..kernel.library import kernel


def one_blas_thread_in_numpy() -> AbstractContextManager[None]:
    """one_blas_thread() there; the kernel asks no BLAS."""
    return one_blas_thread() if kernel() is None else nullcontext()
