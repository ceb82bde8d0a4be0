"""Application handlers: they note what changed, and nothing else."""

from __future__ import annotations


def register() -> None: ...


def unregister() -> None: ...
