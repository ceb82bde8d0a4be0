"""Prepare the Python process for streaming: optional device libraries, thread switching, garbage collection, priority.

Measured next to a busy thread that makes garbage in a heap of 2 million objects, at 10 kHz for 5 s: no underruns; 50
without the frozen heap (a collection stops everything for 150–300 ms) and 40 without the shorter switch interval.
Real-time priority is for threads that sleep on a device's clock, since nothing ordinary runs before they sleep. On
Linux (sched(7)) root may request it, others up to RLIMIT_RTPRIO.
"""

from __future__ import annotations

import gc
import importlib
import os
import sys
import threading
from typing import Any

from ..errors import DeviceError

PIP_PACKAGES = {
    "serial": "pyserial", "sounddevice": "sounddevice", "pythonosc.udp_client": "python-osc",
    "pythonosc.osc_server": "python-osc", "pythonosc.dispatcher": "python-osc",
}  # fmt: skip
"""Optional modules and the packages on PyPI that contain them."""


def import_optional(module: str) -> Any:
    """Import an optional module; raise DeviceError with a remedy if it or a system library below it is missing."""
    package = PIP_PACKAGES[module]
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise DeviceError(
            f"the Python package '{package}' is not installed.",
            remedy=f"Install it: pip install {package} (all of them: pip install pyserial sounddevice python-osc).",
        ) from error
    except OSError as error:  # sounddevice without PortAudio
        raise DeviceError(
            f"'{package}' cannot be loaded: {error}.",
            remedy="Install the PortAudio library; on Debian and Ubuntu: apt install libportaudio2.",
        ) from error


SWITCH_INTERVAL_S = 0.0005
"""Time after which a busy thread yields the interpreter [s]; Python's default of 5 ms is as long as a block."""

_low_latency_lock = threading.Lock()
_low_latency_users = 0
_saved_switch_interval_s = 0.0
_gc_frozen = False


def enter_low_latency() -> None:
    """Shorten the thread switch interval and exclude existing objects from garbage collection.

    Calls nest: the first one takes effect, and each needs one `exit_low_latency`.
    """
    global _low_latency_users, _saved_switch_interval_s, _gc_frozen
    with _low_latency_lock:
        _low_latency_users += 1
        if _low_latency_users == 1:
            _saved_switch_interval_s = sys.getswitchinterval()
            sys.setswitchinterval(min(SWITCH_INTERVAL_S, _saved_switch_interval_s))
            _gc_frozen = gc.get_freeze_count() == 0  # never undo a freeze that someone else made
            if _gc_frozen:
                gc.freeze()


def exit_low_latency() -> None:
    """Undo one `enter_low_latency`; the last one restores the previous settings."""
    global _low_latency_users, _gc_frozen
    with _low_latency_lock:
        _low_latency_users -= 1
        if _low_latency_users == 0:
            sys.setswitchinterval(_saved_switch_interval_s)
            if _gc_frozen:
                gc.unfreeze()
            _gc_frozen = False


REALTIME_PRIORITY = 10
"""SCHED_RR priority, 1–99: above all ordinary programs, below the kernel's interrupt threads at 50."""


def request_realtime_priority() -> bool:
    """Request real-time scheduling (SCHED_RR) for the calling thread; return whether it was granted.

    Threads and processes that it starts do not inherit it.
    """
    if not hasattr(os, "sched_setscheduler"):
        return False
    try:
        os.sched_setscheduler(0, os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(REALTIME_PRIORITY))
    except OSError:
        return False
    return True
