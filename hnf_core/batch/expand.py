"""Jobs from the words of one command: a job for each scene, or for each combination of what is named several times."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path

from ..errors import UsageError
from .job import Job, folder_name, job_from, refuse_twins

FILE_OPTIONS = ("--weights", "--action")
NUMBERED = ("--seed",)
"""Part of a name only where there are several, and with the option's own word."""


def scene_jobs(scenes: Sequence[str], rest: Sequence[str]) -> tuple[Job, ...]:
    """`hnf touch SCENE rest…` for each scene, named after its file. Raises UsageError."""
    if not scenes:
        raise UsageError("no scene is named.", remedy="Example: hnf batch touch cup.blend bowl.gltf --out result")
    jobs = tuple(job_from(_named(Path(scene).stem, "scene"), ["touch", scene, *rest]) for scene in scenes)
    refuse_twins(jobs)
    return jobs


def combined_jobs(
    head: Sequence[str], varied: Mapping[str, Sequence[str]], rest: Sequence[str], suffix: str
) -> tuple[Job, ...]:
    """`hnf head… --option value… rest…` for each combination of the values, named after them.

    varied: option → its values; those without any are left out. suffix: of the file that a job writes, under the job's
    name; "" = it writes a folder. Raises UsageError.
    """
    options = [option for option, values in varied.items() if values]
    jobs = []
    for values in itertools.product(*(varied[option] for option in options)):
        chosen = dict(zip(options, values, strict=True))
        parts = [_part(option, value) for option, value in chosen.items()
                 if option not in NUMBERED or len(varied[option]) > 1]  # fmt: skip
        name = _named("-".join(parts or head), "name")
        words = [*head, *(word for pair in chosen.items() for word in pair), *rest]
        jobs.append(job_from(name, [*words, "--out", f"{name}{suffix}" if suffix else "."]))
    refuse_twins(jobs)
    return tuple(jobs)


def _part(option: str, value: str) -> str:
    if option in NUMBERED:
        return f"{option.strip('-')}-{value}"
    return Path(value).stem if option in FILE_OPTIONS else value


def _named(text: str, what: str) -> str:
    name = folder_name(text)
    if not name:
        raise UsageError(
            f"{text!r} is no {what} that a folder can be named after.", remedy="Use a jobs file (docs/batch.md)."
        )
    return name
