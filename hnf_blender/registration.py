"""Switching rooms, and the classes of a room, on and off: all of them, or none; and what Blender is to call."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable, Sequence
from typing import Any

Handlers = Sequence[tuple[str, Callable[..., None]]]
"""Kinds of events as bpy.app.handlers names them, and what is called at each."""


def register_modules(modules: Iterable[Any], registered: list[Any]) -> None:
    """register() of each, in order; done grows with those that are on. Where one fails, those before it are taken back
    and the error is raised."""
    try:
        for room in modules:
            room.register()
            registered.append(room)
    except Exception:
        unregister_modules(registered)
        raise


def unregister_modules(registered: list[Any]) -> None:
    """unregister() of each, the last one first; done is empty then."""
    while registered:
        registered.pop().unregister()


def collect_classes(package: str, modules: Iterable[str]) -> tuple[Any, ...]:
    """CLASSES of the sub-modules, in order. All are imported before any is registered."""
    return tuple(each for name in modules for each in importlib.import_module(f".{name}", package).CLASSES)


def register_classes(classes: Sequence[Any]) -> None:
    """Register the classes. Where one is refused, those before it are taken back and the error is raised."""
    import bpy

    done: list[Any] = []
    try:
        for each in classes:
            bpy.utils.register_class(each)
            done.append(each)
    except Exception:
        unregister_classes(done)
        raise


def unregister_classes(classes: Sequence[Any]) -> None:
    """Unregister the classes, the last one first."""
    import bpy

    for each in reversed(classes):
        bpy.utils.unregister_class(each)


def add_handlers(handlers: Handlers, tick: Callable[[], float] | None = None, first_interval_s: float = 0.0) -> None:
    """Have Blender call the handlers, and tick for the first time in first_s, whatever file is opened later."""
    import bpy

    for name, handler in handlers:
        getattr(bpy.app.handlers, name).append(bpy.app.handlers.persistent(handler))
    if tick is not None:
        bpy.app.timers.register(tick, first_interval=first_interval_s, persistent=True)


def remove_handlers(handlers: Handlers, tick: Callable[[], Any] | None = None) -> None:
    """Have Blender call none of them any more; also where it never did."""
    import bpy

    for name, handler in handlers:
        listed = getattr(bpy.app.handlers, name)
        if handler in listed:
            listed.remove(handler)
    if tick is not None and bpy.app.timers.is_registered(tick):
        bpy.app.timers.unregister(tick)
