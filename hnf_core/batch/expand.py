"""Jobs from the words of one command: a job for each scene, or for each combination of what is named several times."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path

from ..errors import UsageError
from .job import Job, make_folder_name, make_job, reject_duplicates

FILE_OPTIONS = ("--weights", "--action")
NUMBERED_OPTIONS = ("--seed",)
"""Part of a name only where there are several, and with the option's own word."""


def make_scene_jobs(scenes: Sequence[str], arguments: Sequence[str]) -> tuple[Job, ...]:
    """`hnf touch SCENE rest…` for each scene, named after its file. Raises UsageError."""
    if not scenes:
        raise UsageError("no scene is named.", remedy="Example: hnf batch touch cup.blend bowl.gltf --out result")
    jobs = tuple(make_job(_make_job_name(Path(scene).stem, "scene"), ["touch", scene, *arguments]) for scene in scenes)
    reject_duplicates(jobs)
    return jobs


def make_combined_jobs(
    command: Sequence[str], varied: Mapping[str, Sequence[str]], arguments: Sequence[str], suffix: str
) -> tuple[Job, ...]:
    """`hnf head… --option value… rest…` for each combination of the values, named after them.

    varied: option → its values; those without any are left out. suffix: of the file that a job writes, under the job's
    name; "" = it writes a folder. Raises UsageError.
    """
    options = [option for option, values in varied.items() if values]
    jobs = []
    for values in itertools.product(*(varied[option] for option in options)):
        chosen = dict(zip(options, values, strict=True))
        parts = [_format_name_token(option, value) for option, value in chosen.items()
                 if option not in NUMBERED_OPTIONS or len(varied[option]) > 1]  # fmt: skip
        name = _make_job_name("-".join(parts or command), "name")
        words = [*command, *(word for pair in chosen.items() for word in pair), *arguments]
        jobs.append(make_job(name, [*words, "--out", f"{name}{suffix}" if suffix else "."]))
    reject_duplicates(jobs)
    return tuple(jobs)


def _format_name_token(option: str, value: str) -> str:
    if option in NUMBERED_OPTIONS:
        return f"{option.strip('-')}-{value}"
    return Path(value).stem if option in FILE_OPTIONS else value


def _make_job_name(text: str, what: str) -> str:
    name = make_folder_name(text)
    if not name:
        raise UsageError(
            f"{text!r} is no {what} that a folder can be named after.", remedy="Use a jobs file (docs/batch.md)."
        )
    return name
