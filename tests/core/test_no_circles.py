"""No file of the library or the add-on imports, directly or not, a file that imports it; and so for packages.

Imports inside functions and for types alone count as well, since a reader has to follow those too.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest
from syntax_trees import parse, read, walk

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("hnf_core", "hnf_blender")


def modules(root: Path) -> dict[str, str]:
    """Dotted name → source, of every file below the packages. A folder's own file goes by the folder's name."""
    return {
        ".".join(path.relative_to(root).with_suffix("").parts).removesuffix(".__init__"): read(path)
        for package in PACKAGES
        for path in (root / package).rglob("*.py")
    }


def needed(name: str, source: str, known: Mapping[str, str], *, is_folder: bool) -> Iterator[str]:
    """Modules among the known ones that a module imports anywhere in its text."""
    here = name.split(".") if is_folder else name.split(".")[:-1]
    for node in walk(parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)
        if isinstance(node, ast.ImportFrom):
            above = here[: len(here) - node.level + 1] if node.level else []
            base = ".".join([*above, *((node.module or "").split(".") if node.module else [])])
            for alias in node.names:
                below = f"{base}.{alias.name}"
                if below in known:
                    yield below
                elif base in known:
                    yield base


def circle(sources: Mapping[str, str]) -> list[str]:
    """Modules that need one another in turn, the first one again at the end; [] where there are none."""
    folders = {name for name in sources if any(other.startswith(f"{name}.") for other in sources)}
    graph = {
        # A face imports its package to switch it on, and everybody in the package reaches the face by its name alone.
        name: {each for each in needed(name, source, sources, is_folder=name in folders) if each not in folders}
        for name, source in sources.items()
        if name not in folders
    }
    return in_turn(graph)


def circle_of_packages(sources: Mapping[str, str]) -> list[str]:
    """The same of packages: the folders, and the single files, in a package."""

    def package(name: str) -> str:
        return ".".join(name.split(".")[:2])

    folders = {name for name in sources if any(other.startswith(f"{name}.") for other in sources)}
    graph: dict[str, set[str]] = {}
    for name, source in sources.items():
        found = {package(each) for each in needed(name, source, sources, is_folder=name in folders)}
        if name not in PACKAGES:
            graph.setdefault(package(name), set()).update(found - {package(name), *PACKAGES})
    return in_turn(graph)


def in_turn(graph: Mapping[str, set[str]]) -> list[str]:
    """Those that need one another in turn, the first one again at the end."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def test_nobody_needs_what_needs_it() -> None:
    sources = modules(ROOT)
    assert len(sources) > 300
    assert circle(sources) == []
    assert circle_of_packages(sources) == []


def test_a_circle_of_packages_is_seen_where_no_file_is_in_one() -> None:
    sources = {"hnf_core": "", "hnf_core.one": "", "hnf_core.one.a": "", "hnf_core.one.b": "from ..other.a import A"}
    sources |= {"hnf_core.other": "", "hnf_core.other.a": "", "hnf_core.other.b": "def f():\n    from ..one.a import A"}
    assert circle(sources) == []
    assert set(circle_of_packages(sources)) == {"hnf_core.one", "hnf_core.other"}


@pytest.mark.parametrize(
    "way_back",
    [
        "from .a import A",
        "def later():\n    from ..package.a import A",
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from hnf_core.package.a import A",
        "import hnf_core.package.a",
        "from . import a",
    ],
)
def test_a_circle_is_seen_however_it_is_written(way_back: str) -> None:
    sources = {"hnf_core": "", "hnf_core.package": "", "hnf_core.package.a": "from .b import B"}
    sources["hnf_core.package.b"] = way_back
    assert set(circle(sources)) == {"hnf_core.package.a", "hnf_core.package.b"}
    assert circle({**sources, "hnf_core.package.b": ""}) == []
