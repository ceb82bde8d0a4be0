"""Libraries that only some ways to a device need: asked for when they are, missed in words of the next step.

The interpreter's own pauses, kept short while anything streams.

Measured beside a busy thread that makes garbage in a heap of 2 million objects, 10 kHz, 5 s: no underrun; without the
freeze 50 (a collection stops everything for 150 … 300 ms), without the shorter switch 40.

First on the processor, where the system grants it.

A real-time thread runs as soon as it wakes, whatever ordinary programs compute meanwhile: so only for threads that
sleep on a device's clock. Linux: sched(7); root may, others as far as RLIMIT_RTPRIO goes.
"""

from __future__ import annotations

import gc
import importlib
import os
import sys
import threading
from typing import Any

from ..errors import DeviceError

PIP_PACKAGES = {"serial": "pyserial", "sounddevice": "sounddevice", "pythonosc.udp_client": "python-osc"}


def import_optional(module: str) -> Any:
    """The module, imported. Raises DeviceError where it, or a system library below it, is not there."""
    package = PIP_PACKAGES[module]
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise DeviceError(
            f"the Python package '{package}' is not installed.",
            remedy=f"Install it: pip install {package} (all of them: pip install 'hnf[device]').",
        ) from error
    except OSError as error:  # sounddevice without PortAudio
        raise DeviceError(
            f"'{package}' cannot be loaded: {error}.",
            remedy="Install the PortAudio library; on Debian and Ubuntu: apt install libportaudio2.",
        ) from error


SWITCH_INTERVAL_S = 0.0005
"""A busy thread hands the interpreter on after that long; Python's own 5 ms are a whole block."""

_low_latency_lock = threading.Lock()
_low_latency_users = 0
_saved_switch_interval_s = 0.0
_gc_frozen = False


def enter_low_latency() -> None:
    """From the first holder on: threads change places every SWITCH_S, and garbage collection leaves alone what is
    there now. To be undone by release(), once for each."""
    global _low_latency_users, _saved_switch_interval_s, _gc_frozen
    with _low_latency_lock:
        _low_latency_users += 1
        if _low_latency_users == 1:
            _saved_switch_interval_s = sys.getswitchinterval()
            sys.setswitchinterval(min(SWITCH_INTERVAL_S, _saved_switch_interval_s))
            _gc_frozen = gc.get_freeze_count() == 0  # somebody else's is theirs to undo
            if _gc_frozen:
                gc.freeze()


def exit_low_latency() -> None:
    """With the last holder everything is as it was."""
    global _low_latency_users, _gc_frozen
    with _low_latency_lock:
        _low_latency_users -= 1
        if _low_latency_users == 0:
            sys.setswitchinterval(_saved_switch_interval_s)
            if _gc_frozen:
                gc.unfreeze()
            _gc_frozen = False


REALTIME_PRIORITY = 10
"""1 … 99: above all ordinary programs, below the kernel's own interrupt threads at 50."""


def request_realtime_priority() -> bool:
    """Whether the calling thread is a real-time thread from now on (SCHED_RR, until it ends). What it starts is not."""
    if not hasattr(os, "sched_setscheduler"):
        return False
    try:
        os.sched_setscheduler(0, os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(REALTIME_PRIORITY))
    except OSError:
        return False
    return True
