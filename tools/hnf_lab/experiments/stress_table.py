"""The table of stress cases in docs/numerics.md, from the first lines of the tests that hold them.

Usage: python -m hnf_lab.experiments.stress_table
"""

from __future__ import annotations

import ast
import sys
from pathlib import Path

from hnf_lab import ROOT

ARROW = " → "


def list_stress_files() -> list[Path]:
    """The suite: of the core, then of Blender."""
    return [*sorted((ROOT / "tests" / "core").glob("test_stress_*.py")), ROOT / "tests" / "blender" / "test_stress.py"]


def read_cases(path: Path) -> list[tuple[str, str]]:
    """(case, what happens) of every test in a file. Raises ValueError where a test does not say so."""
    found = []
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
            case, arrow, happens = (ast.get_docstring(node) or "").partition(ARROW)
            if not arrow or "\n" in happens or "|" in case + happens:
                raise ValueError(
                    f"{path.name}, {node.name}: its docstring is not 'case{ARROW}what happens' in one line."
                )
            found.append((case, happens))
    return found


def format_stress_table() -> str:
    """Markdown."""
    lines = ["| stress | what happens |", "|---|---|"]
    for path in list_stress_files():
        lines += [f"| {case} | {happens} |" for case, happens in read_cases(path)]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.stdout.write(format_stress_table() + "\n")
