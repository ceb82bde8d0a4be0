"""README and docs: links lead somewhere, pictures are there and small, commands are what the programs take."""

from __future__ import annotations

import argparse
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest

from hnf_core.cli.main import build_parser

ROOT = Path(__file__).resolve().parents[2]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
PICTURE_BYTES, SCREENS_BYTES, ALL_BYTES = 200_000, 1_700_000, 2_500_000
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)\s]+)\)")
INLINE = re.compile(r"(?<!`)`([^`\n]+)`(?!`)")
HNF = re.compile(r"(?:^|\s)(?:\.venv/bin/hnf|--command hnf|hnf)\s+(.*)$")


def prose(page: Path) -> str:
    """The text without its blocks of code."""
    return FENCE.sub("", page.read_text(encoding="utf-8"))


def commands(page: Path) -> Iterator[str]:
    """Lines of the blocks for a shell, continued ones joined, without their comments."""
    for language, block in FENCE.findall(page.read_text(encoding="utf-8")):
        if language in ("", "bash", "sh"):
            for line in block.replace("\\\n", " ").splitlines():
                spoken = re.sub(r"(^|\s)#.*$", "", line)
                yield from (each.strip() for each in spoken.split("&&") if each.strip())


def program_file(word: str) -> Path | None:
    """Of a program of the repository, named as a file or as a module of the laboratory; None for another word."""
    if word.startswith("hnf_lab."):
        return ROOT / "tools" / f"{word.replace('.', '/')}.py"
    return ROOT / word if word.startswith(("tools/", "tests/")) else None


def find_lost_paths(text: str) -> list[str]:
    """Paths of the packages that a text names in backticks and that are not there; * stands for any name."""
    named = [word for word in INLINE.findall(text) if re.fullmatch(r"hnf_(core|blender)/[\w./*-]*", word)]
    return [word for word in named if not any(ROOT.glob(word.rstrip("/")))]


def anchors(page: Path) -> set[str]:
    """Of its headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", FENCE.sub("", page.read_text(encoding="utf-8")), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CONTRIBUTING.md"], ids=lambda page: page.name)
def test_named_files_of_the_packages_are_there(page: Path) -> None:
    assert find_lost_paths("`hnf_core/none.py`, `hnf_core/files.py`, `hnf_core/*.py`") == ["hnf_core/none.py"]
    assert find_lost_paths(prose(page)) == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    for target in LINK.findall(prose(page)):
        if target.startswith(("http://", "https://")):
            continue
        name, _, anchor = target.partition("#")
        place = (page.parent / name).resolve() if name else page
        assert place.exists(), f"{page.name}: {target}"
        assert place.is_relative_to(ROOT), f"{page.name}: {target}"
        assert not anchor or anchor in anchors(place), f"{page.name}: {target}"


def test_pictures_are_small_and_used() -> None:
    shown = {(page.parent / target).resolve() for page in PAGES for target in LINK.findall(prose(page))}
    pictures = sorted((ROOT / "docs" / "images").rglob("*.*"))
    assert [str(path.relative_to(ROOT)) for path in pictures if path not in shown] == []
    screens = [path for path in pictures if path.parent.name == "ui"]
    assert screens
    assert [path.name for path in screens if path.stat().st_size > PICTURE_BYTES] == []
    assert sum(path.stat().st_size for path in screens) < SCREENS_BYTES
    assert sum(path.stat().st_size for path in pictures) < ALL_BYTES


def parser() -> argparse.ArgumentParser:
    return build_parser(lambda _arguments: 0)


def options() -> dict[str, set[str]]:
    """Verb → all its options, those of its own verbs too."""

    def below(one: argparse.ArgumentParser) -> set[str]:
        found: set[str] = set()
        for action in one._actions:
            found |= set(action.option_strings)
            if isinstance(action, argparse._SubParsersAction):
                for each in action.choices.values():
                    found |= below(each)
        return found

    verbs = next(each for each in parser()._actions if isinstance(each, argparse._SubParsersAction))
    return {verb: below(one) for verb, one in verbs.choices.items()}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_are_taken(page: Path) -> None:
    targets = re.findall(r"^([a-z][a-z-]*):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    for line in commands(page):
        words = shlex.split(line)
        if words[0] == "make":
            assert [word for word in words[1:] if "=" not in word and word not in targets] == [], line
        elif match := HNF.search(line):
            try:
                parser().parse_args(shlex.split(match[1]))
            except SystemExit:
                pytest.fail(f"{page.name}: hnf does not take: {line}")
        for word in words:
            source = program_file(word)
            if source is not None:
                assert source.is_file(), line
                text = source.read_text(encoding="utf-8")
                assert [flag for flag in words if flag.startswith("--") and f'"{flag}"' not in text] == [], line


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_words_in_the_text_are_words_of_the_programs(page: Path) -> None:
    known = options()
    targets = re.findall(r"^([a-z][a-z-]*):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    for code in INLINE.findall(prose(page)):
        words = code.split()
        sources = {word: program_file(word) for word in words if "*" not in word}
        assert [word for word, source in sources.items() if source is not None and not source.exists()] == [], code
        if words[0] == "make" and len(words) > 1:
            assert words[1] in targets, code
        if words[0] == "hnf" and len(words) > 1 and words[1].isalpha() and words[1].islower():
            assert words[1] in known, code
            assert {word for word in words if word.startswith("--")} <= known[words[1]], code


PLACEHOLDER = re.compile(r"@@\w+@@|\{\{\s*\w+\s*\}\}|\bTO" r"DO\b|\bFIX" r"ME\b|\bTBD\b")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_no_page_waits_for_its_figures(page: Path) -> None:
    assert PLACEHOLDER.findall(prose(page)) == []


def test_the_checks_see_something() -> None:
    assert len(PLACEHOLDER.findall("@@TABLES@@ {{ value }} TBD")) == 3
    lines = [line for page in PAGES for line in commands(page)]
    assert sum(HNF.search(line) is not None for line in lines) > 12
    assert "make demo" in [line.split("  ")[0].strip() for line in lines]
    assert {"touch", "synth", "train", "eval", "materials"} <= set(options())
