"""How long Blender spends inside the add-on's own Python: operators, panels, overlays, handlers, timers, whatever."""

import sys
import threading
import time

from .addon import MODULE

WATCH = sys.monitoring
TOOL = WATCH.PROFILER_ID
FOLDER = MODULE.rpartition(".")[2]


class Spent:
    """Context manager. calls: function that Blender called → seconds of every call; only the outermost one counts.
    undisturbed: the same without the time that its thread was ready to run and the kernel ran others on its core;
    whatever the call itself waited for is in it.

    It sees every function of the add-on on the main thread, so that nothing can be forgotten; what Blender does
    itself on our behalf (saving a copy, drawing our labels) is included where it happens inside such a call.
    """

    def __init__(self) -> None:
        self.calls: dict[str, list[float]] = {}
        self.undisturbed: dict[str, list[float]] = {}
        self._depth, self._since, self._queued, self._name = 0, 0.0, 0.0, ""
        self._thread = threading.get_ident()

    def __enter__(self):
        events = WATCH.events
        WATCH.use_tool_id(TOOL, "hnf tests")
        for event in (events.PY_START, events.PY_RESUME):
            WATCH.register_callback(TOOL, event, self._enter)
        for event in (events.PY_RETURN, events.PY_YIELD):
            WATCH.register_callback(TOOL, event, self._leave)
        WATCH.register_callback(TOOL, events.PY_THROW, self._thrown_into)
        WATCH.register_callback(TOOL, events.PY_UNWIND, self._unwound)
        WATCH.set_events(
            TOOL,
            events.PY_START
            | events.PY_RESUME
            | events.PY_RETURN
            | events.PY_YIELD
            | events.PY_THROW
            | events.PY_UNWIND,
        )
        return self

    def __exit__(self, *_):
        WATCH.set_events(TOOL, 0)
        WATCH.free_tool_id(TOOL)

    @property
    def longest(self) -> float:
        return max((max(times) for times in self.calls.values()), default=0.0)

    @property
    def longest_name(self) -> str:
        return max(self.calls, key=lambda name: max(self.calls[name]), default="")

    def _enter(self, code, _offset):
        if not is_ours(code):
            return WATCH.DISABLE
        if threading.get_ident() == self._thread:
            if self._depth == 0:
                self._queued, self._name = queued_s(), code.co_qualname
                self._since = time.perf_counter()
            self._depth += 1
        return None

    def _leave(self, code, _offset, _value):
        if not is_ours(code):
            return WATCH.DISABLE
        self._left()
        return None

    def _thrown_into(self, code, offset, _error):
        if is_ours(code):
            self._enter(code, offset)

    def _unwound(self, code, _offset, _error):
        if is_ours(code):
            self._left()

    def _left(self) -> None:
        if threading.get_ident() != self._thread or self._depth == 0:  # entered before the watch began
            return
        self._depth -= 1
        if self._depth == 0:
            took = time.perf_counter() - self._since
            self.calls.setdefault(self._name, []).append(took)
            self.undisturbed.setdefault(self._name, []).append(took - (queued_s() - self._queued))


def queued_s() -> float:
    """How long this thread has been ready to run without a core, since it began. proc(5): schedstat's second number."""
    with open("/proc/thread-self/schedstat", encoding="ascii") as file:
        return float(file.read().split()[1]) * 1e-9


def is_ours(code) -> bool:
    return f"/{FOLDER}/" in code.co_filename and "/extensions/" in code.co_filename
