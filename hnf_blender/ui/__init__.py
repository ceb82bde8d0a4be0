"""Panels, lists and overlays. They draw what is cached and compute nothing."""

from __future__ import annotations


def register() -> None: ...


def unregister() -> None: ...
