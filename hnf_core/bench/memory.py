"""How much memory a process holds, other libraries' included, where the system tells."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

Result = TypeVar("Result")

STATUS_FILE, RESET_FILE, SYSTEM_FILE = Path("/proc/self/status"), Path("/proc/self/clear_refs"), Path("/proc/meminfo")
RESET_PEAK = "5"
"""Linux, proc(5): sets the peak of the resident memory back to what is resident now."""


def run_with_peak(function: Callable[[], Result]) -> tuple[Result, float | None]:
    """What function returns, and the megabytes that were resident at once beyond those before; None where the system
    does not tell. Memory that was given back to the allocator and not to the system is counted as there before."""
    before = _read_status_mb("VmRSS") if _reset_peak() else None
    result = function()
    after = None if before is None else _read_status_mb("VmHWM")
    return result, None if before is None or after is None else max(after - before, 0.0)


def read_available_mb() -> float | None:
    """Megabytes that may still be taken; None where the system does not tell."""
    return _read_field_mb(SYSTEM_FILE, "MemAvailable")


def _reset_peak() -> bool:
    try:
        RESET_FILE.write_text(RESET_PEAK, encoding="ascii")
    except OSError:
        return False
    return True


def _read_status_mb(name: str) -> float | None:
    return _read_field_mb(STATUS_FILE, name)


def _read_field_mb(path: Path, name: str) -> float | None:
    try:
        lines = path.read_text(encoding="ascii").splitlines()
    except OSError:
        return None
    found = next((line.split()[1] for line in lines if line.startswith(f"{name}:")), None)
    return None if found is None else float(found) * 1024.0 / 1e6
