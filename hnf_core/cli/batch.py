"""`hnf batch`: run many `hnf` commands on many workers, each in its own process and folder."""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import HnfError, UsageError
from ..progress import Progress, ProgressBar
from ..threads import available_cpus

if TYPE_CHECKING:
    from ..batch.attempt import Outcome
    from ..batch.jobs import Job
    from ..batch.runner import BatchSummary

DIRECT_COMMANDS = ("touch", "synth", "train")
VARIED_OPTIONS = {
    "touch": (),
    "synth": ("--material", "--weights", "--stroke", "--action", "--seed"),
    "train": ("--material", "--seed"),
}
"""Options with a job for each of their values; `hnf touch` has a job for each scene instead."""
RETRIES = 2
NON_INPUT_ARGUMENTS = ("out", "verb", "what", "run")
"""Attributes of a parsed command that are not inputs."""


def add_parser(verbs: Any) -> argparse.ArgumentParser:
    """Add `hnf batch`."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        "batch",
        help="run many of these commands on many workers; what is finished is not run again",
        usage="hnf batch JOBS.toml|JOBS.json --out DIR [options]\n"
        "       hnf batch touch SCENE… --out DIR [options, and those of hnf touch]\n"
        "       hnf batch synth --material NAME… --stroke WORDS… --out DIR [options, and those of hnf synth]\n"
        "       hnf batch train field --material NAME… --out DIR [options, and those of hnf train]",
        description="Each job runs in a process of its own and writes a folder of its own in DIR. What --material, "
        "--weights, --stroke, --action and --seed name several times makes a job for each combination. The same "
        "command again resumes where it was. Needs the extra [batch].",
    )
    parser.add_argument("what", metavar="JOBS|VERB", help="a file of jobs (docs/batch.md), or touch, synth, train")
    _add_options(parser)
    parser.add_argument("words", nargs=argparse.REMAINDER, metavar="…", help="of the command, and the options above")
    return parser


def _add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for the results (needed)")
    parser.add_argument("--workers", type=int, metavar="N", help="processes on this machine (default: its cores)")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="use the workers of this one instead: tcp://HOST:8786")
    parser.add_argument(
        "--retries", type=int, default=RETRIES, metavar="N",
        help=f"how often a job is tried again after an accident (default {RETRIES}); its own errors are final",
    )  # fmt: skip
    parser.add_argument("--json", action="store_true", help="print one JSON object at the end")


def run(arguments: argparse.Namespace) -> int:
    """Run `hnf batch`; return the exit code. Raises HnfError."""
    try:
        from ..batch.runner import BatchOptions, check_address, run_batch
    except ImportError as error:
        raise HnfError(
            f"batch is no part of the extension, and needs Linux or macOS ({error}).",
            remedy="Run it from the source: pip install -e '.[batch]', then hnf batch.",
        ) from error
    jobs, base = _read_jobs(arguments)
    if arguments.out is None:
        raise UsageError("a batch writes into a folder.", remedy="Say where: --out DIR.")
    if arguments.retries < 0 or (arguments.workers is not None and arguments.workers < 1):
        raise UsageError("--workers must be at least 1, --retries 0.")
    if arguments.scheduler is not None:
        if arguments.workers is not None:
            raise UsageError("--workers are those of this machine, --scheduler names others.", remedy="Give one.")
        check_address(arguments.scheduler)
    options = BatchOptions(arguments.scheduler, arguments.workers or available_cpus(), arguments.retries)
    folder = Path(os.path.abspath(arguments.out))
    inputs = {job.name: _find_inputs(job, base, folder / job.name) for job in jobs}
    bar = ProgressBar()

    def watch(outcome: Outcome, retried: bool, summary: BatchSummary) -> None:
        bar.close()
        _report_outcome(outcome, retried, folder, arguments.json)
        done = summary.skipped + summary.finished + len(summary.failed)
        bar.show(Progress(f"after {outcome.name}", done, summary.jobs))

    bar.show(Progress("starting", 0, len(jobs)))
    try:
        summary = run_batch(jobs, inputs, base, folder, options, watch)
    finally:
        bar.close()
    return _report_summary(summary, folder, arguments.json)


def _read_jobs(arguments: argparse.Namespace) -> tuple[tuple[Job, ...], Path]:
    """Return the jobs and the folder that their paths are relative to.

    Also removes the batch's own options from the words of the command.
    """
    from ..batch.jobs import SUFFIXES, make_combined_jobs, make_scene_jobs, read_jobs

    what = arguments.what
    option_parser = argparse.ArgumentParser(
        prog=f"hnf batch {what}", allow_abbrev=False, epilog="Other options are those of the command itself."
    )
    _add_options(option_parser)
    for option in VARIED_OPTIONS.get(what, ()):
        option_parser.add_argument(
            option, action="append", default=[], dest=option, metavar="VALUE", help="again for more jobs"
        )
    _, rest = option_parser.parse_known_args(arguments.words, arguments)
    varied = {option: getattr(arguments, option) for option in VARIED_OPTIONS.get(what, ())}
    if what == "touch":
        option_start = next((index for index, word in enumerate(rest) if word.startswith("-")), len(rest))
        return make_scene_jobs(rest[:option_start], rest[option_start:]), Path.cwd()
    if what == "synth":
        return make_combined_jobs(["synth"], varied, rest, ".wav"), Path.cwd()
    if what == "train":
        if not rest or rest[0].startswith("-"):
            raise UsageError("what is to be trained?", remedy="Example: hnf batch train field --data simulated …")
        suffix = "" if rest[0] == "alignment" else ".safetensors"
        return make_combined_jobs(["train", rest[0]], varied, rest[1:], suffix), Path.cwd()
    if Path(what).suffix.lower() not in SUFFIXES:
        raise UsageError(
            f"{what!r} is neither a file of jobs ({', '.join(SUFFIXES)}) nor one of {', '.join(DIRECT_COMMANDS)}.",
            remedy="See: hnf batch --help",
        )
    if rest:
        raise UsageError(f"a file of jobs takes no other words: {' '.join(rest)}", remedy="See: hnf batch --help")
    path = Path(os.path.abspath(what))
    return read_jobs(path), path.parent


def _find_inputs(job: Job, base: Path, job_folder: Path) -> tuple[str, ...]:
    """Return the absolute paths of the files and folders that a job names.

    Raises UsageError if hnf does not accept its command or a declared input is missing.
    """
    from ..batch.staging import find_named_files

    parsed = _parse_job(job)
    for path in job.inputs:
        if not find_named_files([path], base):
            raise UsageError(f"its input {path} is not there.", where=f"job {job.name}", remedy="Check the path.")
    values = [value for name, value in vars(parsed).items() if name not in NON_INPUT_ARGUMENTS]
    return find_named_files([values, *job.inputs], base, job_folder)


def _parse_job(job: Job) -> argparse.Namespace:
    from .main import build_parser
    from .synth import check_arguments

    output = io.StringIO()
    try:
        with contextlib.redirect_stderr(output), contextlib.redirect_stdout(output):
            verb, subject = (*job.words, "")[:2]
            parsed = build_parser(lambda _arguments: 0, only=verb, subject=subject).parse_args(list(job.command))
    except SystemExit as stop:
        last_line = (output.getvalue().strip().splitlines() or ["it asks for nothing"])[-1]
        raise UsageError(
            f"hnf does not take its command: {last_line if stop.code else 'it asks for help'}",
            where=f"job {job.name}",
            remedy=f"Try it alone: hnf {' '.join(job.command)}",
        ) from stop
    if verb == "synth":
        check_arguments(parsed)
    return parsed


def _report_outcome(outcome: Outcome, retried: bool, folder: Path, as_json: bool) -> None:
    """Print one line per attempt: a result to stdout, the reason for another attempt to stderr."""
    from ..batch.attempt import State

    reasons: Sequence[str] = (*outcome.earlier, outcome.why) if retried else outcome.earlier
    if retried or (reasons and outcome.state is State.DONE):
        ending = "it is tried again" if retried else "another has done it"
        print(f"hnf: {outcome.name}: {reasons[-1]}; {ending}.", file=sys.stderr, flush=True)
    if outcome.state is State.DONE and not as_json:
        print(f"{outcome.name}: {outcome.seconds:.1f} s → {folder / outcome.name}", flush=True)


def _report_summary(summary: BatchSummary, folder: Path, as_json: bool) -> int:
    """Print counts to stdout and advice on failures to stderr; return the exit code."""
    from ..batch.attempt import State

    for outcome in summary.failed:
        record = folder / f"{outcome.name}.failed" / "batch.json"
        details = f" All of it: {record}" if record.is_file() else ""
        print(f"hnf: {outcome.name} failed: {outcome.why.rstrip('.')}.{details}", file=sys.stderr)
    if summary.failed:
        accidents = any(outcome.state is State.ACCIDENT for outcome in summary.failed)
        hint = " Where processes died, look at the machine's memory, or give fewer --workers." if accidents else ""
        print(
            f"hnf: correct what is named and give the same command again: only what failed is run.{hint}",
            file=sys.stderr,
        )
    counts = {
        "jobs": summary.jobs,
        "finished": summary.finished,
        "skipped": summary.skipped,
        "failed": len(summary.failed),
        "retried": summary.retried,
        "seconds": round(summary.seconds, 3),
        "workers": summary.workers,
    }
    if as_json:
        print(json.dumps(counts))
    else:
        print(
            f"{summary.jobs} jobs: {summary.finished} done, {summary.skipped} already there, {len(summary.failed)} "
            f"failed, {summary.retried} tried again; {summary.seconds:.1f} s on {summary.workers} workers → {folder}"
        )
    return 1 if summary.failed else 0
