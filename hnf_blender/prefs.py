"""Preferences of the add-on."""

from __future__ import annotations


def register() -> None: ...


def unregister() -> None: ...
