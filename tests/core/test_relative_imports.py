"""The extension build rewrites `from hnf_core.x import y` into relative imports and changes nothing else."""

from __future__ import annotations

import ast

import pytest
from build_extension import ImportRewriteError, rewrite_imports
from hypothesis import given
from hypothesis import strategies as st

NAMES = st.from_regex(r"[a-z][a-z0-9_]{0,8}", fullmatch=True).filter(lambda name: not _is_keyword(name))


def _is_keyword(name: str) -> bool:
    try:
        ast.parse(f"{name} = 1")
    except SyntaxError:
        return True
    return False


@pytest.mark.parametrize(
    ("source", "level", "expected"),
    [
        ("from hnf_core.units import G\n", 1, "from .hnf_core.units import G\n"),
        ("from hnf_core import __version__\n", 1, "from .hnf_core import __version__\n"),
        ("from hnf_core.a.b import (\n    c,\n    d,\n)\n", 2, "from ..hnf_core.a.b import (\n    c,\n    d,\n)\n"),
        ("def f():\n    from hnf_core.a import b\n", 3, "def f():\n    from ...hnf_core.a import b\n"),
        ("x = 'é'; from hnf_core.a import b\n", 1, "x = 'é'; from .hnf_core.a import b\n"),
        ("from hnf_core_extra import b\n", 1, "from hnf_core_extra import b\n"),
        ("# from hnf_core.a import b\n", 1, "# from hnf_core.a import b\n"),
        ('"""from hnf_core.a import b"""\n', 1, '"""from hnf_core.a import b"""\n'),
        ("from .bridge import mesh\nimport bpy\n", 2, "from .bridge import mesh\nimport bpy\n"),
    ],
)
def test_known_forms(source: str, level: int, expected: str) -> None:
    assert rewrite_imports(source, level, "x.py") == expected


@pytest.mark.parametrize(
    "source",
    [
        "import hnf_core",
        "import hnf_core.units as units",
        "from hnf_blender.bridge import mesh",
        "import_module('hnf_core.units')",
        "run([python, '-m', 'hnf_blender.cli'])",
        "from \\\n hnf_core.units import G",
    ],
)
def test_unresolvable_imports_are_refused_with_file_and_line(source: str) -> None:
    with pytest.raises(ImportRewriteError, match=r"^bridge/x\.py:2: "):
        rewrite_imports("\n" + source, 2, "bridge/x.py")


@given(st.lists(NAMES, min_size=0, max_size=4), NAMES, st.integers(1, 5))
def test_the_target_named_stays_the_same(path: list[str], name: str, level: int) -> None:
    """Law: seen from a file `level` deep, the rewritten import names the same module and the same name."""
    module = ".".join(["hnf_core", *path])
    (before,) = ast.parse(f"from {module} import {name}").body
    (after,) = ast.parse(rewrite_imports(f"from {module} import {name}", level, "x.py")).body
    assert isinstance(before, ast.ImportFrom)
    assert isinstance(after, ast.ImportFrom)
    assert (after.module, [alias.name for alias in after.names]) == (before.module, [name])
    assert after.level == level


@given(st.lists(st.sampled_from(["from hnf_core.a import b", "x = 1", "# hnf_core", "from . import c"]), max_size=8))
def test_a_second_rewrite_changes_nothing(lines: list[str]) -> None:
    once = rewrite_imports("\n".join(lines), 2, "x.py")
    assert rewrite_imports(once, 2, "x.py") == once
