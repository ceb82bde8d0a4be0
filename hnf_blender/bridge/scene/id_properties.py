"""Properties of a datablock that come back as they were given, from a library override too.

An override saves no ID property that holds bytes or is new on it; it does save registered text. So on a stroke that is
an override, everything goes into one of those: Object.hnf_stroke.kept, JSON of text and of bytes in base 85.
"""

from __future__ import annotations

import base64
import json
from typing import Any


def set_property(block: Any, name: str, value: bytes | str | int) -> None:
    """Set property name of a datablock to value.

    The old value goes first: over bytes Blender writes only what comes before the first zero (4.2, 4.5, 5.0).
    """
    if _is_override(block):
        encoded = {"bytes": base64.b85encode(value).decode()} if isinstance(value, bytes) else value
        block.hnf_stroke.kept = json.dumps({**_read_override(block), name: encoded})
        return
    if name in block:
        del block[name]
    block[name] = value


def get_property(block: Any, name: str) -> Any:
    """What keep set; None where there is nothing, b"" where an override's bytes are damaged."""
    own = _read_override(block) if _is_override(block) else {}
    if name not in own:
        return block.get(name)
    value = own[name]
    if not isinstance(value, dict):
        return value
    try:
        return base64.b85decode(value["bytes"])
    except (ValueError, KeyError, TypeError):
        return b""


def has_property(block: Any, name: str) -> bool:
    """Is there something that kept would return? For what is asked at every draw: nothing is decoded."""
    own = _read_override(block) if _is_override(block) else {}
    return own[name] is not None if name in own else name in block


def delete_property(block: Any, name: str) -> None:
    """Take property name off a datablock. On an override, what the linked original holds stays hidden."""
    if _is_override(block):
        block.hnf_stroke.kept = json.dumps({**_read_override(block), name: None})
    elif name in block:
        del block[name]


def _is_override(block: Any) -> bool:
    return block.override_library is not None and hasattr(block, "hnf_stroke")


def _read_override(block: Any) -> dict[str, Any]:
    """What the override itself holds; {} where its text is damaged: the original's shows then."""
    try:
        return dict(json.loads(block.hnf_stroke.kept or "{}"))
    except (ValueError, TypeError):
        return {}
