"""Jobs for the tests of `hnf batch`: short strokes, and one that waits in a pipe until the test lets it go on."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from hnf_core.batch.attempt import RUN_FILE_NAME, Request
from hnf_core.batch.staging import StagingMarker, compute_digest, compute_version, find_staging_folders, read_marker
from hnf_core.cli.main import main

T = TypeVar("T")
LONG_S = 60.0
TABLE = "time_s,direction_rad,speed_m_s,force_n\n0,0,0.1,1\n{seconds},0,0.1,{force}\n"
HALF_WRITTEN = (".*~*.part", ".*~*.old")


def table(path: Path, force: float = 1.0, seconds: float = 0.05) -> Path:
    """A stroke as hnf synth --action takes it."""
    path.write_text(TABLE.format(seconds=seconds, force=force))
    return path


def pipe(path: Path) -> Path:
    """The same, but whoever opens it waits for let_go()."""
    os.mkfifo(path)
    return path


def let_go(path: Path) -> None:
    """Every command that waits in the pipe reads its stroke and goes on."""
    path.write_text(TABLE.format(seconds=0.05, force=1.0))


def synth(action: Path | str, *more: str) -> list[str]:
    return ["synth", "--material", "oak-wood", "--action", str(action), *more]


def direct(words: Sequence[str], out: Path) -> bytes:
    """What the command writes without a batch."""
    assert main([*words, "--out", str(out)], lambda _arguments: 1) == 0
    return out.read_bytes()


def jobs_file(path: Path, **commands: Sequence[str]) -> Path:
    """A list of jobs, each writing x.wav."""
    jobs = [{"name": name, "command": [*words, "--out", "x.wav"]} for name, words in commands.items()]
    path.write_text(json.dumps({"schema": 1, "job": jobs}))
    return path


def order_for(
    folder: Path, name: str, words: Sequence[str], *inputs: Path, run: str = "r", retries: int = 2
) -> Request:
    """An order as a batch in folder gives it, and the folder says that run."""
    folder.mkdir(exist_ok=True)
    (folder / RUN_FILE_NAME).write_text(run)
    digests = {str(path): compute_digest(path) for path in inputs}
    return Request(
        name, tuple(words), "x.wav", digests, str(folder.parent), str(folder), compute_version(), run, retries
    )


def until(look: Callable[[], T], what: str) -> T:
    """What look() says once it is true. Fails where that never comes."""
    end = time.monotonic() + LONG_S
    while time.monotonic() < end:
        found = look()
        if found:
            return found
        time.sleep(0.02)
    raise AssertionError(f"it never came: {what}")


def at_work(folder: Path, name: str, attempt: int = 1) -> Callable[[], StagingMarker | None]:
    """Looks for that attempt at a job, which lives from the writing of its marker on."""

    def look() -> StagingMarker | None:
        markers = (read_marker(part) for part in find_staging_folders(folder, name))
        return next((each for each in markers if each is not None and len(each.earlier) == attempt - 1), None)

    return look


def half_written(folder: Path) -> list[Path]:
    return [path for pattern in HALF_WRITTEN for path in folder.glob(pattern)]


def processes_with(word: str) -> list[int]:
    """Of this machine, whose command line holds the word."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            words = (entry / "cmdline").read_bytes().decode("utf-8", "replace")
        except OSError:
            continue
        if word in words:
            found.append(int(entry.name))
    return found
