"""Turn `from hnf_core.x import y` into a relative import, for code that moves into a Blender extension.

An extension is the package `bl_ext.REPOSITORY.hnf`, and Blender warns of any module it puts outside that name.
"""

from __future__ import annotations

import ast
import re
from pathlib import Path
from typing import TypeGuard

CORE, BRIDGE = "hnf_core", "hnf_blender"
MODULE_NAME = re.compile(rf"({CORE}|{BRIDGE})(\.\w+)+")


class ImportRewriteError(Exception):
    """An import that cannot be made relative; the message names file and line."""


def rewrite_imports(text: str, level: int, name: str) -> str:
    """Source `text` with its hnf_core imports made relative, `level` dots deep; every other byte stays.

    Raises ImportRewriteError (naming `name` and the line) for `import hnf_core`, for an absolute import of
    hnf_blender, and for a string that names a module of either: at run time none of them would be found.
    """
    lines = text.splitlines(keepends=True)
    for node in ast.walk(ast.parse(text)):
        if _is_core_import(node):
            row, column = node.lineno - 1, _to_character_column(lines[node.lineno - 1], node.col_offset)
            head, tail = lines[row][:column], lines[row][column:]
            lines[row] = head + re.sub(rf"^from\s+{CORE}\b", f"from {'.' * level}{CORE}", tail)
        elif _is_absolute_reference(node):
            raise ImportRewriteError(
                f"{name}:{getattr(node, 'lineno', 0)}: only `from {CORE}.x import y` and relative imports can move "
                "into the extension. Write it so."
            )
    new = "".join(lines)
    left = [node.lineno for node in ast.walk(ast.parse(new)) if _is_core_import(node)]
    if left:
        raise ImportRewriteError(f"{name}:{left[0]}: `from` and `{CORE}` stand on different lines. Join them.")
    return new


def rewrite_file(path: Path, extension_root: Path) -> None:
    """Rewrite one file of a laid-out extension in place; its depth decides the number of dots."""
    relative = path.relative_to(extension_root)
    text = path.read_text(encoding="utf-8")
    if relative.parts[0] == CORE:
        # hnf_core moves as a whole and is relative inside already: anything to rewrite there is a mistake.
        new = rewrite_imports(text, len(relative.parts), str(relative))
        if new != text:
            raise ImportRewriteError(f"{relative}: inside {CORE} imports are relative. Write it so.")
        return
    new = rewrite_imports(text, len(relative.parts), f"{BRIDGE}/{relative}")
    if new != text:
        path.write_text(new, encoding="utf-8")


def _is_core_import(node: ast.AST) -> TypeGuard[ast.ImportFrom]:
    return isinstance(node, ast.ImportFrom) and node.level == 0 and _get_top_package(node.module) == CORE


def _get_top_package(module: str | None) -> str:
    return (module or "").partition(".")[0]


def _to_character_column(line: str, byte_column: int) -> int:
    return len(line.encode("utf-8")[:byte_column].decode("utf-8"))


def _is_absolute_reference(node: ast.AST) -> bool:
    if isinstance(node, ast.Import):
        return any(_get_top_package(alias.name) in (CORE, BRIDGE) for alias in node.names)
    if isinstance(node, ast.ImportFrom):
        return node.level == 0 and _get_top_package(node.module) == BRIDGE
    return isinstance(node, ast.Constant) and isinstance(node.value, str) and bool(MODULE_NAME.fullmatch(node.value))
