"""Evaluation of a session's log: a check passes only if it completed with all expected results."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from .session import Finished, Played, read_played

GOOD = [
    {"event": "blender", "check": "", "version": "5.2.2 LTS"},
    {"event": "begin", "check": "a"},
    {"event": "expect", "check": "a", "what": "it is so", "ok": True, "detail": ""},
    {"event": "end", "check": "a", "error": "", "seconds": 1.0},
    {"event": "finished", "check": ""},
]


def played(folder: Path, lines: list[dict[str, object]], code: int = 0, output: str = "Blender quit") -> Played:
    (folder / "results.jsonl").write_text("\n".join(map(json.dumps, lines)) + "\n", encoding="utf-8")
    return read_played("any", folder, Finished(code, output))


def test_a_whole_session_passes(tmp_path: Path) -> None:
    found = played(tmp_path, GOOD)
    found.assert_passed("a")
    found.assert_quiet()
    assert found.version == "5.2.2 LTS"


@pytest.mark.parametrize(
    ("lines", "why"),
    [
        (GOOD[:1], "never begun"),
        (GOOD[:3], "ended inside it"),
        ([*GOOD[:2], *GOOD[3:]], "expected nothing"),
        ([*GOOD[:2], GOOD[2] | {"ok": False}, *GOOD[3:]], "it is so"),
        ([*GOOD[:3], GOOD[3] | {"error": "KeyError: 'b'"}, GOOD[4]], "KeyError"),
    ],
)
def test_anything_less_fails_and_says_why(tmp_path: Path, lines: list[dict[str, object]], why: str) -> None:
    with pytest.raises(AssertionError, match=why):
        played(tmp_path, lines, code=-9, output="its last words").assert_passed("a")


def test_a_check_after_a_blender_crash_shows_the_last_output(tmp_path: Path) -> None:
    with pytest.raises(AssertionError, match="its last words"):
        played(tmp_path, GOOD[:2], code=139, output="its last words").assert_passed("a")


@pytest.mark.parametrize(
    ("lines", "code", "output"),
    [
        (GOOD[:4], 0, "Blender quit"),
        (GOOD, 1, "Blender quit"),
        (GOOD, 0, "Traceback (most recent call last):\n  File …"),
        (GOOD, 0, "rna_uiItemR: property not found: HnfScene.gone"),
    ],
)
def test_a_bad_end_or_a_complaint_is_no_quiet_session(
    tmp_path: Path, lines: list[dict[str, object]], code: int, output: str
) -> None:
    with pytest.raises(AssertionError):
        played(tmp_path, lines, code, output).assert_quiet()
