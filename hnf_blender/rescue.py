"""What is shown where the add-on itself cannot be loaded."""

from __future__ import annotations


def register(error: Exception) -> None:
    raise error


def unregister() -> None: ...
