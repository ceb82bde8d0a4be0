"""Looking at other frames without leaving a trace: Blender writes animated values back to the objects themselves."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

TRANSFORM_CHANNELS = ("location", "rotation_euler", "rotation_quaternion", "rotation_axis_angle", "scale")
STROKE_CHANNELS = ("force", "progress")


@contextmanager
def preserve_animated_values(scene: Any, *objects: Any) -> Iterator[None]:
    """Afterwards the objects and their parents hold the values they had before, unkeyed changes included, and
    whatever else was animated stands at scene's current frame again. scene must not be the temporary one."""
    chain = {member.name_full: member for obj in objects for member in get_parent_chain(obj)}
    before = {name: _read_values(member) for name, member in chain.items()}
    try:
        yield
    finally:
        from .temporary import TemporaryScene

        with TemporaryScene() as temporary:  # its frame 1 would stay in dependencies that are animated
            for obj in objects:
                temporary.link(obj)
            temporary.evaluate(scene.frame_current_final)
        for name, member in chain.items():
            _restore_values(member, before[name])


def get_parent_chain(obj: Any) -> list[Any]:
    """The object and its parents."""
    chain = []
    while obj is not None:
        chain.append(obj)
        obj = obj.parent
    return chain


def _read_values(obj: Any) -> dict[str, Any]:
    values = {name: tuple(getattr(obj, name)) for name in TRANSFORM_CHANNELS}
    values.update({name: getattr(obj.hnf_stroke, name) for name in STROKE_CHANNELS})
    return values


def _restore_values(obj: Any, values: dict[str, Any]) -> None:
    for name, value in values.items():
        owner = obj.hnf_stroke if name in STROKE_CHANNELS else obj
        now = getattr(owner, name)
        if (now if name in STROKE_CHANNELS else tuple(now)) != value:
            setattr(owner, name, value)
