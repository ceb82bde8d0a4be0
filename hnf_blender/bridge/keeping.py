"""ID properties that come back as they were given."""

from __future__ import annotations

from typing import Any


def keep(block: Any, name: str, value: Any) -> None:
    """Set ID property name of a datablock to value: text, bytes or a number.

    The old value goes first: over bytes Blender writes only what comes before the first zero (4.2, 4.5, 5.0). On a
    library override the property is marked as overridden, else the next load forgets it.
    """
    if name in block:
        del block[name]
    block[name] = value
    if block.override_library is not None:
        block.property_overridable_library_set(f'["{name}"]', True)
