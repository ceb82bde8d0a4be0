"""What the benches of this room cannot do without."""

from __future__ import annotations

import importlib.util

from hnf_core.errors import HnfError


def require_bpy(name: str) -> None:
    """Raises HnfError where this Python has no bpy."""
    if importlib.util.find_spec("bpy") is None:
        raise HnfError(
            f"the bench '{name}' needs Blender, and this Python has no bpy.",
            remedy="Install it: pip install -e '.[scene]' (Python 3.11).",
        )
