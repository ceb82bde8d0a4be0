"""Names and files keep to docs/glossary.md: the field's words, one file name a meaning, no crowded folder, few crumbs.

Every rule is a function that returns what breaks it, and is first shown to catch a breach.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import pytest
from syntax_trees import parse, python_files, read, walk

ROOT = Path(__file__).resolve().parents[2]
PRODUCT = (ROOT / "hnf_core", ROOT / "hnf_blender")
LABORATORY = ROOT / "tools" / "hnf_lab"
TESTS = (ROOT / "tests", LABORATORY / "tests")

PRIVATE_WORDS = frozenset(
    re.findall(
        r"\w+",
        """tell tells told say says said ask asks asked answer answers answered keep keeps kept hold holds hear hears
        heard feel feels felt meet meeting met seen sight glance witness beside plainly foretell foretold room rooms
        twin crumb guest rescue thing things""",
    )
)
"""Verbs of speech and of the senses, and metaphors: the glossary has a standard word for each of their meanings."""
STORED_NAMES = frozenset(
    {
        "HnfStroke.kept",  # a property in .blend files
        "InputHashes.sight",  # a field of the stored inputs of a bake
        "QueryView.seen_m",  # a field of a stored query
        "PreviewFacts.has_kept",
        "compat.beside_the_file",  # one of Blender's own words for its relative paths
        "HNF_OT_rescue_copy",  # names of operators and panels are Blender's identifiers
        "HNF_PT_rescue",
        "Report.kept",  # a key of alignment.json
        "results.KEPT",
    }
)
"""Names that files, or Blender, know: they stay."""
SAME_MEANING = frozenset({"carriers", "contact_filter", "stream", "synthesis", "weights", "registry"})
"""File names that recur because both mean the same of two parents: offline and live, of a field and of a map."""
CROWDED = 20
SMALL_LINES, SMALL_SHARE = 60, 0.1
MAX_TEST_NAME = 60
DIALECT_STARTS = re.compile(r"(What|Of|Where|Those|That|Whether|How|Which|Whatever|Whoever)\b")


def split_name(name: str) -> list[str]:
    """Lower-case words of an identifier: `HTTPServer_name` → http, server, name."""
    return [word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name)]


def defined_names(tree: ast.Module, module: str) -> Iterator[tuple[int, str, str]]:
    """(line, qualified name, last part) of every function, class, constant and field."""

    def walk(body: list[ast.stmt], owner: str) -> Iterator[tuple[int, str, str]]:
        for node in body:
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                qualified = f"{owner}.{node.name}" if owner else node.name
                yield node.lineno, qualified, node.name
                if isinstance(node, ast.ClassDef):
                    yield from walk(node.body, node.name)
            elif isinstance(node, ast.Assign | ast.AnnAssign):
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                for target in targets:
                    if isinstance(target, ast.Name):
                        yield node.lineno, f"{owner or module}.{target.id}", target.id

    yield from walk(tree.body, "")


def private_words(tree: ast.Module, module: str) -> list[str]:
    found = []
    for line, qualified, name in defined_names(tree, module):
        words = set(split_name(name)) & PRIVATE_WORDS
        if words and not {qualified, name, f"{module}.{name}"} & STORED_NAMES:
            found.append(f"line {line}: {qualified} ({', '.join(sorted(words))})")
    if set(split_name(module)) & PRIVATE_WORDS:
        found.append(f"the file's own name: {module}")
    return found


def list_docstrings(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """(line, text) of every docstring, and of every note: a string below a constant or a field."""
    for node in walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield getattr(node, "lineno", 1), ast.get_docstring(node) or ""
        body = getattr(node, "body", None)
        for statement, note in pairwise(body if isinstance(body, list) else []):
            is_note = isinstance(note, ast.Expr) and isinstance(note.value, ast.Constant)
            if isinstance(statement, ast.Assign | ast.AnnAssign) and is_note and isinstance(note.value.value, str):
                yield note.lineno, note.value.value.strip()


def dialect_docstrings(tree: ast.Module, module: str) -> list[str]:
    return [
        f"line {line}: {text.splitlines()[0][:60]}"
        for line, text in list_docstrings(tree)
        if DIALECT_STARTS.match(text)
    ]


def recurring_names(paths: Sequence[Path]) -> list[str]:
    seen: dict[str, Path] = {}
    found = []
    for path in paths:
        if path.stem.startswith("__") or path.stem in SAME_MEANING:
            continue
        if path.stem in seen:
            found.append(f"{path.stem}: {seen[path.stem]} and {path}")
        seen.setdefault(path.stem, path)
    return found


def crowded_folders(paths: Sequence[Path]) -> list[str]:
    counts: dict[Path, int] = {}
    for path in paths:
        counts[path.parent] = counts.get(path.parent, 0) + (path.name != "__init__.py")
    return [f"{folder}: {count}" for folder, count in counts.items() if count > CROWDED]


def too_many_small_files(lines: dict[str, int]) -> list[str]:
    small = sorted(name for name, count in lines.items() if count < SMALL_LINES)
    return small if len(small) >= SMALL_SHARE * len(lines) else []


def long_test_names(tree: ast.Module) -> list[str]:
    return [
        f"line {node.lineno}: {node.name} ({len(node.name)} characters)"
        for node in walk(tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and node.name.startswith("test_")
        and len(node.name) > MAX_TEST_NAME
    ]


BRITISH = re.compile(
    r"(?<![\w{/.])(?:(?:centi|milli|kilo)?metres?|colours?|coloured|grey|centres?|centred|neighbour\w*|behaviour"
    r"|synthesise\w*|normalise\w*|recognise\w*|labelled|unlabelled|modelled|travelled|cancelled|artefacts?)\b(?![}=\w])"
)
WORD_LISTS = {"name_matching", "stroke_tokens", "material_classes"}
"""Words that people may use of materials and strokes, in any spelling."""


def british_messages(tree: ast.Module, module: str) -> list[str]:
    """Return British spellings in texts of more than a word that are no docstrings and no notes of constants."""
    notes = {id(node.value) for node in walk(tree) if isinstance(node, ast.Expr)}
    texts = (node for node in walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str))
    spoken = (node for node in texts if " " in node.value and id(node) not in notes and module not in WORD_LISTS)
    return [f"line {node.lineno}: {found[0]}" for node in spoken if (found := BRITISH.search(node.value))]


def breaches(rule) -> list[str]:
    files = python_files(*PRODUCT, LABORATORY)
    assert len(files) > 300
    return [
        f"{path.relative_to(ROOT)} {breach}"
        for path in files
        if "tests" not in path.relative_to(ROOT).parts
        for breach in rule(parse(read(path)), path.stem)
    ]


def test_names_are_in_the_fields_words() -> None:
    assert breaches(private_words) == []


def test_docstrings_begin_with_a_verb_or_a_noun() -> None:
    assert breaches(dialect_docstrings) == []


def test_messages_are_american() -> None:
    assert breaches(british_messages) == []


def test_no_file_name_has_two_meanings() -> None:
    assert recurring_names(python_files(*PRODUCT)) == []


def test_no_folder_is_crowded() -> None:
    assert crowded_folders(python_files(*PRODUCT, LABORATORY)) == []


def test_few_files_are_small() -> None:
    files = [path for path in python_files(*PRODUCT) if path.name != "__init__.py"]
    assert too_many_small_files({str(path): len(read(path).splitlines()) for path in files}) == []


def test_test_names_are_short() -> None:
    files = python_files(*TESTS)
    assert len(files) > 300
    found = {str(path.relative_to(ROOT)): long_test_names(parse(read(path))) for path in files}
    assert {path: names for path, names in found.items() if names} == {}


@pytest.mark.parametrize(
    ("rule", "source"),
    [
        (private_words, "def answered(question): ..."),
        (private_words, "KEPT_S = 1.0"),
        (private_words, "class Heard: ..."),
        (private_words, "class Device:\n    def tell(self): ..."),
        (private_words, "class Device:\n    beside: int = 0"),
        (dialect_docstrings, 'def f():\n    """What is there."""'),
        (dialect_docstrings, '"""Of files."""'),
        (dialect_docstrings, 'LIMIT = 3\n"""What is enough."""'),
        (dialect_docstrings, 'class A:\n    limit: int = 3\n    """Of files."""'),
        (dialect_docstrings, 'class A:\n    """Where it stands."""'),
        (british_messages, 'raise ValueError("its colour is unknown")'),
        (british_messages, 'f"{unit:g} metres per unit"'),
    ],
)
def test_a_breach_of_words_is_caught(rule, source) -> None:
    assert rule(ast.parse(source), "module") != []


def test_a_long_test_name_is_caught() -> None:
    name = "test_".ljust(MAX_TEST_NAME, "x")
    assert long_test_names(ast.parse(f"def {name}(): ...")) == []
    assert long_test_names(ast.parse(f"def {name}x(): ...")) != []
    assert long_test_names(ast.parse(f"class TestDevice:\n    async def {name}x(self): ...")) != []


def test_a_private_file_name_is_caught() -> None:
    assert private_words(ast.parse(""), "foretold") != []


def test_a_stored_name_stays() -> None:
    assert private_words(ast.parse("class HnfStroke:\n    kept: bool = False"), "stroke_settings") == []


def test_breaches_of_the_layout_are_caught() -> None:
    assert recurring_names([Path("a/report.py"), Path("b/report.py")]) != []
    assert recurring_names([Path("a/carriers.py"), Path("b/carriers.py"), Path("a/__init__.py")]) == []
    assert crowded_folders([Path(f"a/m{number}.py") for number in range(CROWDED + 1)]) != []
    assert crowded_folders([Path(f"a/m{number}.py") for number in range(CROWDED)]) == []
    assert too_many_small_files({"a": 59, **{str(number): 60 for number in range(9)}}) != []
    assert too_many_small_files({"a": 59, **{str(number): 60 for number in range(10)}}) == []
