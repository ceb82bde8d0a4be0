"""The application in the chroot, and what a scenario that was played in its window brought back."""

from __future__ import annotations

import ast
import json
import os
import shutil
import signal
import subprocess
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from . import lent_python

ROOT = Path(__file__).resolve().parents[2]
CHROOT = ROOT / "tools" / "chroot_blender.sh"
PICTURES = ROOT / "build" / "app"
SCENARIOS = Path(__file__).parent / "scenarios"
HERE = "/hnf/tests/app"  # this folder, seen from inside
COMPLAINTS = ("Traceback (most recent", "Error:", "Exception in module", "Segmentation fault", "rna_uiItemR")
TAIL_LINES = 40
PLAY_LIMIT_S = 400.0


@dataclass(frozen=True)
class Finished:
    """How a command in the chroot ended, and all it said."""

    code: int
    output: str


@dataclass(frozen=True)
class App:
    """The application with one profile. share: the host's folder that is /share inside; profile: a folder of it."""

    share: Path
    profile: str = "profile"

    def with_profile(self, name: str, *, installed: bool) -> App:
        """The same application for another person: with what this one has installed, or with an empty profile."""
        if installed:
            shutil.copytree(self.share / self.profile, self.share / name, symlinks=True)
        else:
            (self.share / name).mkdir()
        return replace(self, profile=name)

    def run(self, *command: str, timeout: float = 120.0) -> Finished:
        """Run a command inside; it and all it started are ended when it takes too long (code −9)."""
        # One for each: runs side by side have process numbers of their own, and go by those to tell whose folder it is.
        temporary = f"tmp-{self.profile}"
        (self.share / temporary).mkdir(exist_ok=True)
        places = ["HOME=/share/home", f"BLENDER_USER_RESOURCES=/share/{self.profile}", f"TMPDIR=/share/{temporary}"]
        inside = ["env", *places, *command]
        process = subprocess.Popen(
            [str(CHROOT), "run", *inside],
            env=os.environ
            | {"HNF_CHROOT_SHARE": str(self.share), "HNF_CHROOT_LENT": ":".join(map(str, lent_python.parts()))},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,
        )
        try:
            output, _ = process.communicate(timeout=timeout)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            output = process.communicate()[0] + f"\nended after {timeout:.0f} s"
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
        return Finished(process.returncode, output)

    def blender(self, *arguments: str, timeout: float = 120.0) -> Finished:
        """Run Blender with these arguments."""
        return self.run("blender", *arguments, timeout=timeout)

    def window(self, *arguments: str, screen: str = "1280x800", timeout: float = 180.0) -> Finished:
        """Run Blender in a window of this size on a screen of its own."""
        width, height = screen.split("x")
        display = ["xvfb-run", "-a", "-s", f"-screen 0 {screen}x24 +extension GLX +render -noreset"]
        blender = ["blender", "--enable-event-simulate", "-p", "0", "0", width, height, *arguments]
        # Sound devices that play to nowhere, in real time.
        silent = ["SDL_AUDIODRIVER=dummy", "ALSOFT_DRIVERS=null"]
        return self.run("env", "LIBGL_ALWAYS_SOFTWARE=1", *silent, *display, *blender, timeout=timeout)


@dataclass
class Check:
    """What one check of a scenario brought back. ended: it came to its end; error: its traceback."""

    begun: bool = False
    ended: bool = False
    error: str = ""
    seconds: float = 0.0
    expectations: list[dict[str, Any]] = field(default_factory=list)

    def complaint(self) -> str:
        """Why it is not passed; empty where it is."""
        missed = [f"{one['what']}: {one['detail']}" for one in self.expectations if not one["ok"]]
        return "\n".join([*missed, *([self.error] if self.error else [])])


@dataclass(frozen=True)
class Played:
    """One scenario, played to its end or to Blender's. folder: its pictures and files."""

    scenario: str
    folder: Path
    finished: Finished
    version: str
    checks: dict[str, Check]
    measured: list[dict[str, Any]]
    whole: bool

    def tail(self) -> str:
        """The end of Blender's log."""
        return "\n".join(self.finished.output.splitlines()[-TAIL_LINES:])

    def said_during(self, check: str) -> str:
        """What Blender printed while a check ran."""
        return self.finished.output.partition(f"==== {check}\n")[2].partition("==== ")[0]

    def assert_passed(self, check: str) -> None:
        """The check began, came to its end, expected something, and nothing it expected was missed."""
        found = self.checks.get(check, Check())
        assert found.begun, f"never begun; Blender ended with code {self.finished.code}:\n{self.tail()}"
        assert found.ended, f"Blender ended inside it, with code {self.finished.code}:\n{self.tail()}"
        assert found.expectations, "it expected nothing"
        assert not found.complaint(), f"{found.complaint()}\n{self.said_during(check)}"

    def assert_quiet(self) -> None:
        """Blender came to a good end and printed no complaint of its own or of any add-on."""
        assert self.whole, f"it did not come to its end:\n{self.tail()}"
        assert self.finished.code == 0, f"code {self.finished.code}:\n{self.tail()}"
        lines = self.finished.output.splitlines()
        bad = [i for i, line in enumerate(lines) if any(word in line for word in COMPLAINTS)]
        assert not bad, "\n".join(lines[max(0, bad[0] - 3) : bad[0] + 25])


def checks_of(scenario: str) -> list[str]:
    """The names of a scenario's checks, read from its source: it can only be imported inside Blender."""
    tree = ast.parse((SCENARIOS / f"{scenario}.py").read_text(encoding="utf-8"))
    names = [node.name for node in tree.body if isinstance(node, ast.FunctionDef)]
    return [name.removeprefix("check_") for name in names if name.startswith("check_")]


def constant_of(scenario: str, name: str, default: str) -> str:
    """A string constant at the top of a scenario, such as SCREEN = "1280x800"."""
    tree = ast.parse((SCENARIOS / f"{scenario}.py").read_text(encoding="utf-8"))
    for node in tree.body:
        if isinstance(node, ast.Assign) and [getattr(one, "id", "") for one in node.targets] == [name]:
            return str(ast.literal_eval(node.value))
    return default


def scenarios() -> list[str]:
    """All scenarios, by name."""
    return sorted(path.stem for path in SCENARIOS.glob("*.py") if path.stem != "__init__" and checks_of(path.stem))


def play(app: App, scenario: str) -> Played:
    """Play a scenario in a window and read what it wrote; its pictures are kept in build/app/SCENARIO."""
    folder = app.share / "played" / scenario
    folder.mkdir(parents=True)
    person = app.with_profile(f"profile-{scenario}", installed=constant_of(scenario, "INSTALLED", "yes") == "yes")
    finished = person.window(
        "--python",
        f"{HERE}/drive/begin.py",
        "--",
        scenario,
        f"/share/played/{scenario}",
        screen=constant_of(scenario, "SCREEN", "1280x800"),
        timeout=PLAY_LIMIT_S,
    )
    (folder / "blender.log").write_text(finished.output, encoding="utf-8")
    for report in (app.share / f"tmp-{person.profile}").glob("*.crash.txt"):
        report.rename(folder / "crash.txt")
    keep(folder, PICTURES / scenario)
    return read_played(scenario, folder, finished)


def keep(folder: Path, kept: Path) -> None:
    """Pictures, results and log of one play, for people to look at; those of an earlier one are replaced."""
    shutil.rmtree(kept, ignore_errors=True)
    kept.mkdir(parents=True)
    for path in folder.iterdir():
        if path.suffix in (".png", ".jsonl", ".log", ".txt"):
            shutil.copy2(path, kept / path.name)


def read_played(scenario: str, folder: Path, finished: Finished) -> Played:
    """What is in folder/results.jsonl, as far as it goes."""
    path = folder / "results.jsonl"
    lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
    checks: dict[str, Check] = {}
    measured, version, whole = [], "", False
    for line in map(json.loads, lines):
        check = checks.setdefault(line["check"], Check()) if line["check"] else Check()
        match line["event"]:
            case "blender":
                version = line["version"]
            case "begin":
                check.begun = True
            case "expect":
                check.expectations.append(line)
            case "measured":
                measured.append(line)
            case "end":
                check.ended, check.error, check.seconds = True, line["error"], line["seconds"]
            case "finished":
                whole = True
    return Played(scenario, folder, finished, version, checks, measured, whole)
