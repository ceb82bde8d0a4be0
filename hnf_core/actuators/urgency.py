"""First on the processor, where the system grants it.

A real-time thread runs as soon as it wakes, whatever ordinary programs compute meanwhile: so only for threads that
sleep on a device's clock. Linux: sched(7); root may, others as far as RLIMIT_RTPRIO goes.
"""

from __future__ import annotations

import os

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
