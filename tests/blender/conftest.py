"""Every test here starts from an empty Blender file."""

from __future__ import annotations

import pytest

bpy = pytest.importorskip("bpy", reason="needs the bpy wheel of the matching Python")


@pytest.fixture(autouse=True, scope="session")
def stroke_properties() -> None:
    """As with the add-on switched on. Registered classes outlive files and factory settings."""
    from hnf_blender import props

    if not hasattr(bpy.types.Object, "hnf_stroke"):
        props.register()


@pytest.fixture(scope="session")
def operators(stroke_properties: None) -> None:
    """The add-on's operators, for tests that press its buttons."""
    from hnf_blender import ops

    if not hasattr(bpy.types, "HNF_OT_import_material"):
        ops.register()


@pytest.fixture(autouse=True)
def empty_file() -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
