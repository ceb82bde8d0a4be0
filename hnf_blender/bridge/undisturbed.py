"""Looking at other frames without leaving a trace: Blender writes animated values back to the objects themselves."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

CHANNELS = ("location", "rotation_euler", "rotation_quaternion", "rotation_axis_angle", "scale")
GROUP = ("force", "progress")


@contextmanager
def undisturbed(scene: Any, *objects: Any) -> Iterator[None]:
    """Afterwards the objects and their parents hold the values they had before, unkeyed changes included, and
    whatever else was animated stands at scene's current frame again. scene must not be the temporary one."""
    chain = {member.name_full: member for obj in objects for member in lineage(obj)}
    before = {name: _values(member) for name, member in chain.items()}
    try:
        yield
    finally:
        from .temporary import Temporary

        with Temporary() as temporary:  # its frame 1 would stay in dependencies that are animated
            for obj in objects:
                temporary.link(obj)
            temporary.evaluate(scene.frame_current_final)
        for name, member in chain.items():
            _restore(member, before[name])


def lineage(obj: Any) -> list[Any]:
    """The object and its parents."""
    chain = []
    while obj is not None:
        chain.append(obj)
        obj = obj.parent
    return chain


def _values(obj: Any) -> dict[str, Any]:
    values = {name: tuple(getattr(obj, name)) for name in CHANNELS}
    values.update({name: getattr(obj.hnf_stroke, name) for name in GROUP})
    return values


def _restore(obj: Any, values: dict[str, Any]) -> None:
    for name, value in values.items():
        owner = obj.hnf_stroke if name in GROUP else obj
        now = getattr(owner, name)
        if (now if name in GROUP else tuple(now)) != value:
            setattr(owner, name, value)
