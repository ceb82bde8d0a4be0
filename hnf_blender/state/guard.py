"""What the add-on changes by itself is no news to its own handlers."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from .session import STATE


@contextmanager
def suppress_change_tracking(view_layer: Any) -> Iterator[None]:
    """Changes made in this block do not make anything dirty; those that a person made just before do."""
    view_layer.update()  # pending changes reach the handlers now, not in the block's own updates
    STATE.suppress_depth += 1
    try:
        yield
        view_layer.update()
    finally:
        STATE.suppress_depth -= 1
