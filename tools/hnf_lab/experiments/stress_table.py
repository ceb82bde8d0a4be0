"""Print the table of stress cases in docs/numerics.md from the docstrings of the tests.

Usage: python -m hnf_lab.experiments.stress_table
"""

from __future__ import annotations

import ast
import sys
from pathlib import Path

from hnf_lab import ROOT

ARROW = " → "


def list_stress_files() -> list[Path]:
    """Return the stress test files of the core and of Blender."""
    return [
        *sorted((ROOT / "tests" / "core").rglob("test_stress_*.py"), key=lambda path: path.name),
        ROOT / "tests" / "blender" / "test_stress.py",
    ]


def read_cases(path: Path) -> list[tuple[str, str]]:
    """Return (case, result) of every test in a file. Raises ValueError if a docstring has another form."""
    cases = []
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
            case, arrow, result = (ast.get_docstring(node) or "").partition(ARROW)
            if not arrow or "\n" in result or "|" in case + result:
                raise ValueError(
                    f"{path.name}, {node.name}: its docstring is not 'case{ARROW}what happens' in one line."
                )
            cases.append((case, result))
    return cases


def format_stress_table() -> str:
    """Format the table as Markdown."""
    lines = ["| stress | what happens |", "|---|---|"]
    for path in list_stress_files():
        lines += [f"| {case} | {result} |" for case, result in read_cases(path)]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.stdout.write(format_stress_table() + "\n")
