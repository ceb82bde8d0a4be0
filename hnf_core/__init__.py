"""Haptic Neural Fields: from 3-D scenes and strokes to vibrotactile acceleration.

The names below are loaded when they are used: importing this package imports no torch, no scipy, and never bpy.
`docs/python.md` has examples.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

__version__ = "0.2.0"

if TYPE_CHECKING:
    from . import metrics
    from .api import (
        Action,
        Material,
        OutputStream,
        Recording,
        export,
        list_devices,
        list_materials,
        load_field,
        load_material,
        material,
        open_stream,
        parse_stroke,
        read_action,
        read_signal,
        save_field,
        synthesise,
        touch,
        train,
        write_wav,
    )
    from .errors import HnfError
    from .signal import Signal

_MODULES = {
    "HnfError": ".errors",
    "Signal": ".signal",
    **dict.fromkeys(
        (
            "Action", "Material", "OutputStream", "Recording", "export", "list_devices", "list_materials", "load_field",
            "load_material", "material", "open_stream", "parse_stroke", "read_action", "read_signal", "save_field",
            "synthesise", "touch", "train", "write_wav",
        ),
        ".api",
    ),
}  # fmt: skip

__all__ = [
    "Action",
    "HnfError",
    "Material",
    "OutputStream",
    "Recording",
    "Signal",
    "__version__",
    "export",
    "list_devices",
    "list_materials",
    "load_field",
    "load_material",
    "material",
    "metrics",
    "open_stream",
    "parse_stroke",
    "read_action",
    "read_signal",
    "save_field",
    "synthesise",
    "touch",
    "train",
    "write_wav",
]


class _FrontDoor(ModuleType):
    """Module type of hnf_core that keeps its functions `export` and `material` from being hidden by sub-packages.

    Python sets a sub-package as an attribute of its parent when it is first imported, which would replace the function
    of that name; `from hnf_core.export.wav import …` works without that attribute.
    """

    def __setattr__(self, name: str, value: object) -> None:
        if not (name in _MODULES and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _FrontDoor


def __getattr__(name: str) -> Any:
    """Import a public name of the package when it is first used."""
    from importlib import import_module

    if name == "metrics":
        return import_module(".metrics", __name__)
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(_MODULES[name], __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
