"""How long Blender spends inside the add-on's own calls: modal operators, draw methods, handlers."""

import time
from functools import wraps

import bpy

from .addon import MODULE

METHODS = {
    bpy.types.Operator: ("invoke", "modal", "execute", "poll"),
    bpy.types.Panel: ("draw", "draw_header", "poll"),
    bpy.types.UIList: ("draw_item", "filter_items"),
    bpy.types.Menu: ("draw",),
}
HANDLERS = [name for name in dir(bpy.app.handlers) if isinstance(getattr(bpy.app.handlers, name), list)]


class Spent:
    """Context manager. calls: name → seconds of every call; longest, longest_name: of the longest single one.

    What GPU draw handlers take is part of the window's gaps, not of these calls: Blender keeps them to itself.
    """

    def __init__(self) -> None:
        self.calls: dict[str, list[float]] = {}
        self._restore: list = []

    def __enter__(self):
        for base, methods in METHODS.items():
            for kind in base.__subclasses__():
                if kind.__module__.startswith(MODULE):
                    self._wrap_class(kind, methods)
        for name in HANDLERS:
            handlers = getattr(bpy.app.handlers, name)
            for place, handler in enumerate(handlers):
                if getattr(handler, "__module__", "").startswith(MODULE):
                    handlers[place] = self._timed(f"{name}: {handler.__name__}", handler)
                    self._restore.append(lambda handlers=handlers, place=place, own=handler: restore(handlers, own))
        return self

    def __exit__(self, *_):
        for undo in reversed(self._restore):
            undo()

    @property
    def longest(self) -> float:
        return max((max(times) for times in self.calls.values()), default=0.0)

    @property
    def longest_name(self) -> str:
        return max(self.calls, key=lambda name: max(self.calls[name]), default="")

    def _wrap_class(self, kind, methods) -> None:
        for method in methods:
            own = kind.__dict__.get(method)
            if callable(own):
                setattr(kind, method, self._timed(f"{kind.__name__}.{method}", own))
                self._restore.append(lambda kind=kind, method=method, own=own: setattr(kind, method, own))

    def _timed(self, name, function):
        @wraps(function)
        def timed(*args, **kwargs):
            started = time.perf_counter()
            try:
                return function(*args, **kwargs)
            finally:
                self.calls.setdefault(name, []).append(time.perf_counter() - started)

        return timed


def restore(handlers, own) -> None:
    """Put a handler back in the place of its timed twin, wherever that stands now."""
    for place, handler in enumerate(handlers):
        if getattr(handler, "__wrapped__", None) is own:
            handlers[place] = own
