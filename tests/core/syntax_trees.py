"""Syntax trees of the project's files, parsed and walked once for all tests that hold files to rules."""

from __future__ import annotations

import ast
import gc
from functools import cache
from pathlib import Path


@cache
def python_files(*folders: Path) -> tuple[Path, ...]:
    return tuple(sorted(path for folder in folders for path in folder.rglob("*.py") if "__pycache__" not in path.parts))


@cache
def read(path: Path) -> str:
    return path.read_text(encoding="utf-8")


@cache
def parse(source: str) -> ast.Module:
    is_collecting = gc.isenabled()
    gc.disable()  # a tree is many objects and no garbage, at which the collector would look again and again
    try:
        return ast.parse(source)
    finally:
        if is_collecting:
            gc.enable()


@cache
def walk(tree: ast.Module) -> tuple[ast.AST, ...]:
    return tuple(ast.walk(tree))


def drop_trees() -> None:
    """Free the memory of all trees, 400 MB."""
    for cached in (parse, walk, read, python_files):
        cached.cache_clear()
