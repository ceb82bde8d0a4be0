"""Merge JUnit files of several pytest runs into one summary in pytest's own form, its totals on the last line.

python tools/merge_summary.py build/test/*.xml
"""

from __future__ import annotations

import sys
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

OUTCOMES = ("failed", "passed", "skipped", "error")


@dataclass(frozen=True)
class Case:
    """Result of one test in one environment: an outcome from OUTCOMES and its one-line reason."""

    environment: str
    name: str
    outcome: str
    reason: str


def read_cases(path: Path) -> list[Case]:
    """Read the tests of one JUnit file, whose name is the environment. Raises ParseError where it is no XML."""
    cases = []
    for element in ElementTree.parse(path).iter("testcase"):
        outcome, reason = "passed", ""
        for tag, word in (("skipped", "skipped"), ("failure", "failed"), ("error", "error")):
            child = element.find(tag)
            if child is not None:
                outcome, reason = word, " ".join(get_reason(child).split())
        name = f"{element.get('classname', '')}::{element.get('name', '')}".removeprefix("::")
        cases.append(Case(path.stem, name, outcome, reason))
    return cases


def get_reason(element: ElementTree.Element) -> str:
    """Return the reason for which a test was skipped or failed.

    A module skipped as a whole has its reason in the element's text, after `Skipped: `.
    """
    message = element.get("message") or ""
    if message == "collection skipped":
        return (element.text or message).rpartition("Skipped: ")[2].rstrip("'\")\n")
    return message


def write_cases(path: Path, cases: list[Case]) -> None:
    """Save cases as a JUnit file that `read_cases` reads back, for checks other than pytest."""
    suite = ElementTree.Element("testsuite", name=path.stem)
    tags = {"skipped": "skipped", "failed": "failure", "error": "error"}
    for case in cases:
        element = ElementTree.SubElement(suite, "testcase", name=case.name)
        if case.outcome in tags:
            ElementTree.SubElement(element, tags[case.outcome], message=case.reason)
    ElementTree.ElementTree(suite).write(path, encoding="utf-8", xml_declaration=True)


def read_seconds(path: Path) -> float:
    """Sum the run times in one JUnit file [s]."""
    return sum(float(suite.get("time") or 0.0) for suite in ElementTree.parse(path).iter("testsuite"))


def read_properties(path: Path) -> list[str]:
    """Read a JUnit file's own properties, such as its Blender version, as lines `NAME: property value`.

    Statistics, which Hypothesis writes for every test, are left out.
    """
    elements = ElementTree.parse(path).iterfind("./testsuite/properties/property")
    found = [(element.get("name", ""), element.get("value", "")) for element in elements]
    return [f"{path.stem}: {name} {value}" for name, value in found if not name.startswith("hypothesis-statistics")]


def format_totals(cases: list[Case], seconds: float) -> str:
    """Format totals as pytest does: `==== 1 failed, 2 passed, 3 skipped in 4.00s ====`."""
    count = Counter(case.outcome for case in cases)
    plural = {"error": "errors"}
    words = [
        f"{count[word]} {plural.get(word, word) if count[word] > 1 else word}" for word in OUTCOMES if count[word] > 0
    ]
    return f"==== {', '.join(words) or 'no tests ran'} in {seconds:.2f}s ===="


def format_summary(cases: list[Case], seconds: float, properties: Iterable[str] = ()) -> str:
    """Format the properties, skipped tests grouped by reason, each failed test by name, and the totals last."""
    lines = ["==== merged summary ====", *properties]
    skipped = Counter((case.environment, case.reason) for case in cases if case.outcome == "skipped")
    lines += [f"SKIPPED [{n}] {environment}: {reason}" for (environment, reason), n in sorted(skipped.items())]
    for word in ("failed", "error"):
        lines += [
            f"{word.upper()} {case.environment}: {case.name} - {case.reason[:200]}"
            for case in cases
            if case.outcome == word
        ]
    return "\n".join([*lines, format_totals(cases, seconds)])


def has_failed(cases: list[Case]) -> bool:
    """Return True if a test failed or none ran."""
    return not cases or any(case.outcome in ("failed", "error") for case in cases)


def main(arguments: list[str]) -> int:
    """Print the merged summary of the files; returns 1 if any failed, was unreadable or no test ran."""
    cases: list[Case] = []
    seconds = 0.0
    properties: list[str] = []
    for path in map(Path, arguments):
        try:
            cases += read_cases(path)
            seconds += read_seconds(path)
            properties += read_properties(path)
        except (OSError, ElementTree.ParseError) as error:
            cases.append(Case(path.stem, str(path), "error", f"no readable result: {error}"))
    print(format_summary(cases, seconds, properties))
    return int(has_failed(cases))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
