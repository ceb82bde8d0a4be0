"""The stroke tool of the 3-D view."""

from __future__ import annotations


def register() -> None: ...


def unregister() -> None: ...
