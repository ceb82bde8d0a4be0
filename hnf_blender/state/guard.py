"""What the add-on changes by itself is no news to its own handlers."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from .session import STATE


@contextmanager
def own_changes(view_layer: Any) -> Iterator[None]:
    """Changes made in this block do not make anything dirty; those that a person made just before do."""
    view_layer.update()  # pending changes reach the handlers now, not in the block's own updates
    STATE.own += 1
    try:
        yield
        view_layer.update()
    finally:
        STATE.own -= 1
