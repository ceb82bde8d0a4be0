"""Register and unregister modules, classes and handlers with Blender.

Registration is all or nothing: if one item fails, those before it are unregistered and the error is raised.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable, Sequence
from typing import Any

Handlers = Sequence[tuple[str, Callable[..., None]]]
"""Pairs of the name of a list in bpy.app.handlers and the function to add to it."""


def register_modules(modules: Iterable[Any], registered: list[Any]) -> None:
    """Call `register()` of each module, in order, and append it to `registered`.

    If one fails, those before it are unregistered and the error is raised.
    """
    try:
        for module in modules:
            module.register()
            registered.append(module)
    except Exception:
        unregister_modules(registered)
        raise


def unregister_modules(registered: list[Any]) -> None:
    """Call `unregister()` of each module, the last first, and empty the list."""
    while registered:
        registered.pop().unregister()


def collect_classes(package: str, modules: Iterable[str]) -> tuple[Any, ...]:
    """Return the entries of CLASSES of a package's sub-modules, in order; all are imported before any is registered."""
    return tuple(cls for name in modules for cls in importlib.import_module(f".{name}", package).CLASSES)


def register_classes(classes: Sequence[Any]) -> None:
    """Register classes with Blender; if one is refused, unregister those before it and raise the error."""
    import bpy

    done: list[Any] = []
    try:
        for cls in classes:
            bpy.utils.register_class(cls)
            done.append(cls)
    except Exception:
        unregister_classes(done)
        raise


def unregister_classes(classes: Sequence[Any]) -> None:
    """Unregister classes, the last first."""
    import bpy

    for cls in reversed(classes):
        bpy.utils.unregister_class(cls)


def add_handlers(handlers: Handlers, tick: Callable[[], float] | None = None, first_interval_s: float = 0.0) -> None:
    """Add application handlers, and optionally a timer, that persist when another file is loaded.

    Parameters
    ----------
    handlers : Handlers
        Pairs of a list of bpy.app.handlers and a function.
    tick : callable, optional
        Timer function; it returns the delay to its next call [s].
    first_interval_s : float, optional
        Delay to the first call of `tick` [s].
    """
    import bpy

    for name, handler in handlers:
        getattr(bpy.app.handlers, name).append(bpy.app.handlers.persistent(handler))
    if tick is not None:
        bpy.app.timers.register(tick, first_interval=first_interval_s, persistent=True)


def remove_handlers(handlers: Handlers, tick: Callable[[], Any] | None = None) -> None:
    """Remove application handlers and a timer, if they are registered."""
    import bpy

    for name, handler in handlers:
        listed = getattr(bpy.app.handlers, name)
        if handler in listed:
            listed.remove(handler)
    if tick is not None and bpy.app.timers.is_registered(tick):
        bpy.app.timers.unregister(tick)
