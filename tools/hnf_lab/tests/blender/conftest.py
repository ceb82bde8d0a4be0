"""The fixtures of tests/blender: every test starts from an empty Blender file."""

import importlib.util
from pathlib import Path

_SPEC = importlib.util.spec_from_file_location(
    "blender_conftest", Path(__file__).resolve().parents[4] / "tests" / "blender" / "conftest.py"
)
assert _SPEC is not None
assert _SPEC.loader is not None
_MODULE = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(_MODULE)

stroke_properties = _MODULE.stroke_properties
operators = _MODULE.operators
empty_file = _MODULE.empty_file
lone_bake = _MODULE.lone_bake
rendered_plate = _MODULE.rendered_plate
warm_bake = _MODULE.warm_bake
