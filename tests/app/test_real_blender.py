"""The installed extension in a real Blender: its commands, its command line, and exit codes."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from .session import COMPLAINTS, App, Finished


def assert_quiet(finished: Finished) -> None:
    assert not [word for word in COMPLAINTS if word in finished.output], finished.output


def only_line(finished: Finished, start: str) -> str:
    """The one line that `hnf` says; nothing else may look like an accident."""
    lines = [line for line in finished.output.splitlines() if line.startswith(start)]
    assert len(lines) == 1, finished.output
    assert "Traceback" not in finished.output, finished.output
    return lines[0]


def test_this_is_a_blender_with_extensions(bare_app: App) -> None:
    finished = bare_app.blender("--version")
    match = re.match(r"Blender (\d+)\.(\d+)", finished.output)
    assert match is not None, finished.output
    assert (int(match[1]), int(match[2])) >= (4, 2)


def test_it_accepts_the_zip(bare_app: App, archive: Path) -> None:
    finished = bare_app.blender("--command", "extension", "validate", f"/share/dist/{archive.name}")
    assert finished.code == 0, finished.output
    assert_quiet(finished)


def test_it_starts_with_the_extension_on(app: App) -> None:
    code = "import bpy; print('ON', 'bl_ext.user_default.hnf' in bpy.context.preferences.addons)"
    finished = app.blender("-b", "--python-exit-code", "9", "--python-expr", code)
    assert finished.code == 0, finished.output
    assert "ON True" in finished.output
    assert_quiet(finished)


def test_touch_on_the_opened_file(app: App, scene: str) -> None:
    finished = app.blender("-b", scene, "--command", "hnf", "touch", "--out", "/share/opened", timeout=280)
    assert finished.code == 0, finished.output
    assert_quiet(finished)
    assert_delivered(app.share / "opened")


def test_touch_on_a_named_file(app: App, scene: str) -> None:
    finished = app.blender("-b", "--command", "hnf", "touch", scene, "--out", "/share/named", timeout=280)
    assert finished.code == 0, finished.output
    assert_quiet(finished)
    assert_delivered(app.share / "named")


def assert_delivered(out: Path) -> None:
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    assert report["failed"] == []
    assert len(report["strokes"]) == 1
    assert (out / report["strokes"][0]["wav"]).stat().st_size > 1000
    assert len(list(out.glob("*.png"))) >= 1
    assert len(list(out.glob("*.blend"))) == 1


def test_a_missing_file_fails_without_using_the_start_up_scene(app: App) -> None:
    """Blender goes on with its start-up scene where a file cannot be opened; the command must not."""
    finished = app.blender("-b", "/share/no-such.blend", "--command", "hnf", "touch", "--out", "/share/missing")
    assert finished.code == 1, finished.output
    only_line(finished, "hnf: ")
    assert [path.name for path in (app.share / "missing").glob("*") if path.name != ".hnf-lock"] == []


def test_neither_a_file_nor_a_scene_fails(app: App) -> None:
    finished = app.blender("-b", "--command", "hnf", "touch", "--out", "/share/neither")
    assert finished.code == 1, finished.output
    only_line(finished, "hnf: ")
    assert [path.name for path in (app.share / "neither").glob("*") if path.name != ".hnf-lock"] == []


@pytest.mark.parametrize("words", [("touch",), ("no-such-verb",), ("touch", "--stroke", "wiggle", "--out", "/share/x")])
def test_wrong_usage(app: App, words: tuple[str, ...]) -> None:
    finished = app.blender("-b", "--command", "hnf", *words)
    assert finished.code == 2, finished.output
    assert "Traceback" not in finished.output


def test_help(app: App) -> None:
    finished = app.blender("-b", "--command", "hnf", "touch", "--help")
    assert finished.code == 0, finished.output
    assert "--stroke" in finished.output
