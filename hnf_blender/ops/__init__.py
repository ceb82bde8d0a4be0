"""Operators: what buttons, keys and menus call."""

from __future__ import annotations


def register() -> None: ...


def unregister() -> None: ...
