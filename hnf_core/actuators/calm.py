"""The interpreter's own pauses, kept short while anything streams.

Measured beside a busy thread that makes garbage in a heap of 2 million objects, 10 kHz, 5 s: no underrun; without the
freeze 50 (a collection stops everything for 150 … 300 ms), without the shorter switch 40.
"""

from __future__ import annotations

import gc
import sys
import threading

SWITCH_S = 0.0005
"""A busy thread hands the interpreter on after that long; Python's own 5 ms are a whole block."""

_lock = threading.Lock()
_holders = 0
_switch_s = 0.0
_frozen = False


def hold() -> None:
    """From the first holder on: threads change places every SWITCH_S, and garbage collection leaves alone what is
    there now. To be undone by release(), once for each."""
    global _holders, _switch_s, _frozen
    with _lock:
        _holders += 1
        if _holders == 1:
            _switch_s = sys.getswitchinterval()
            sys.setswitchinterval(min(SWITCH_S, _switch_s))
            _frozen = gc.get_freeze_count() == 0  # somebody else's is theirs to undo
            if _frozen:
                gc.freeze()


def release() -> None:
    """With the last holder everything is as it was."""
    global _holders, _frozen
    with _lock:
        _holders -= 1
        if _holders == 0:
            sys.setswitchinterval(_switch_s)
            if _frozen:
                gc.unfreeze()
            _frozen = False
