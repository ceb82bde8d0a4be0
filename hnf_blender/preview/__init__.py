"""Hear and see a baked stroke: its stored bake, re-synthesis, playback, pictures."""

from __future__ import annotations


def register() -> None: ...


def unregister() -> None: ...
