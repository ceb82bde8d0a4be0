"""Which names Blender still knows: for each one alone it goes through all its datablocks."""

from __future__ import annotations

from collections.abc import Set
from typing import Any

FEW_NAMES = 8
"""Names that are looked for one by one."""


def find_absent_names(names: Set[str], kind: Any) -> set[str]:
    """Those of the names that no datablock of a kind (bpy.data.objects, …) has."""
    if len(names) > FEW_NAMES:
        return set(names).difference(kind.keys())
    return {name for name in names if name not in kind}
