"""Custom properties of datablocks that survive saving, on library overrides too.

An override saves neither ID properties that hold bytes nor new ones; it does save registered text. On a stroke that is
an override, everything is therefore stored in one registered property, Object.hnf_stroke.kept, as JSON with bytes in
base 85.
"""

from __future__ import annotations

import base64
import json
from typing import Any


def set_property(block: Any, name: str, value: bytes | str | int) -> None:
    """Set a property of a datablock.

    The old value is deleted first: over bytes Blender writes only up to the first zero (4.2, 4.5, 5.0).
    """
    if _is_override(block):
        encoded = {"bytes": base64.b85encode(value).decode()} if isinstance(value, bytes) else value
        block.hnf_stroke.kept = json.dumps({**_read_override(block), name: encoded})
        return
    if name in block:
        del block[name]
    block[name] = value


def get_property(block: Any, name: str) -> Any:
    """Return a property written by `set_property`: None if missing, b"" if an override's bytes are damaged."""
    overridden = _read_override(block) if _is_override(block) else {}
    if name not in overridden:
        return block.get(name)
    value = overridden[name]
    if not isinstance(value, dict):
        return value
    try:
        return base64.b85decode(value["bytes"])
    except (ValueError, KeyError, TypeError):
        return b""


def has_property(block: Any, name: str) -> bool:
    """Return True if `get_property` would return a value; decodes nothing, as it is called at every redraw."""
    overridden = _read_override(block) if _is_override(block) else {}
    return overridden[name] is not None if name in overridden else name in block


def delete_property(block: Any, name: str) -> None:
    """Delete a property of a datablock; on an override, the linked original's value stays hidden."""
    if _is_override(block):
        block.hnf_stroke.kept = json.dumps({**_read_override(block), name: None})
    elif name in block:
        del block[name]


def _is_override(block: Any) -> bool:
    """Return True for a library override that has stroke settings."""
    return block.override_library is not None and hasattr(block, "hnf_stroke")


def _read_override(block: Any) -> dict[str, Any]:
    """Return the override's own properties; {} if its text is damaged, so that the original's are used."""
    try:
        return dict(json.loads(block.hnf_stroke.kept or "{}"))
    except (ValueError, TypeError):
        return {}
