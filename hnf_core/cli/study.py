"""`hnf study`: make a blinded two-alternative study, run it on an actuator or in a browser, and evaluate it."""

from __future__ import annotations

import argparse
import importlib.util
import json
import math
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ..errors import HnfError, UsageError, pluralize
from .commands import HELP, parse_seed

DEFAULT_DETECTED, DEFAULT_POWER = 65.0, 80.0
"""True share to detect, and the probability of it [%]."""


def add_parser(verbs: Any) -> argparse.ArgumentParser:
    """Add `hnf study` and its steps."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        "study",
        help=HELP["study"],
        description="Compare vibrations by people who do not know which is which: two at a time, one is chosen.",
    )
    steps = parser.add_subparsers(dest="step", metavar="STEP", required=True)
    _add_stimuli(steps)
    _add_make(steps)
    _add_run(steps)
    _add_page(steps)
    _add_evaluate(steps)
    return parser


def _add_stimuli(steps: Any) -> None:
    parser = steps.add_parser(
        "stimuli",
        help="cut pieces of recorded textures, and synthesize the same strokes",
        description="Write DIR/recorded and DIR/ours, a WAV per texture, and DIR/actions, the strokes as tables from "
        "which other methods can render theirs. Then: hnf study make.",
    )
    parser.add_argument("out", type=Path, metavar="DIR", help="folder to write")
    parser.add_argument(
        "--recordings", nargs=2, required=True, metavar=("KIND", "FOLDER"),
        help="your data set: own, hatt, cluster or lmt, and its folder",
    )  # fmt: skip
    parser.add_argument(
        "--textures", nargs="+", required=True, metavar="NAME[=MATERIAL]",
        help="its textures, and the library material that renders each (default: the one that the name suggests)",
    )  # fmt: skip
    parser.add_argument("--seconds", type=float, default=3.0, metavar="S", help="length of each (default 3)")
    parser.add_argument("--seed", type=parse_seed, default=0, metavar="N", help="of what is synthesized")
    parser.set_defaults(run_step=_run_stimuli)


def _add_make(steps: Any) -> None:
    parser = steps.add_parser(
        "make",
        help="make a study: stimuli under blinded names, a plan, and a key",
        description="Write DIR/study.json (the plan), DIR/key.json (what each stimulus is) and DIR/stimuli. Levels "
        "stay as they are, in m/s².",
    )
    parser.add_argument("folder", type=Path, metavar="DIR", help="folder of the study; it must hold no other one")
    parser.add_argument(
        "--pair", type=Path, nargs=2, action="append", default=[], metavar=("A.wav", "B.wav"), help="two of your files"
    )
    parser.add_argument(
        "--method", action="append", default=[], metavar="NAME=FOLDER",
        help="a method, and its WAVs: one per stimulus, of the same name for every method",
    )  # fmt: skip
    parser.add_argument("--against", default="", metavar="NAME,…", help="only pairs with one of these methods")
    parser.add_argument(
        "--reference", metavar="NAME|FILE.wav", help="each pair is compared with this method, or this file"
    )
    parser.add_argument("--abx", action="store_true", help="the reference is one of the pair: can they be told apart?")
    parser.add_argument("--question", default="", metavar="TEXT", help="what participants are asked")
    parser.add_argument("--repeats", type=int, default=2, metavar="N", help="trials of each pair (default 2)")
    parser.add_argument("--seed", type=parse_seed, default=0, metavar="N", help="of blinded names and orders")
    parser.add_argument(
        "--match-level", action="store_true", help="scale what is compared to one RMS; the plan says so"
    )
    parser.add_argument(
        "--full-scale", type=float, metavar="M_S2", help="what 1.0 stands for in files without a unit (m/s²)"
    )
    _add_power(parser)
    parser.set_defaults(run_step=_run_make)


def _add_run(steps: Any) -> None:
    from ..actuators.profile import GENERIC
    from ..actuators.stream_targets import TARGET_FORMS

    parser = steps.add_parser(
        "run",
        help="run a participant's trials on an actuator",
        description="Play every open trial of a participant and keep each response at once in DIR/responses. Stop with "
        "q or Ctrl C; the same command goes on there.",
    )
    parser.add_argument("folder", type=Path, metavar="DIR", help="folder of the study")
    parser.add_argument("--participant", required=True, metavar="ID", help="letters, digits, - and _: p01")
    parser.add_argument("--to", required=True, metavar="TARGET", help=TARGET_FORMS.replace(", file:PATH", ""))
    parser.add_argument(
        "--profile", default=GENERIC.name, metavar="NAME|FILE.json",
        help=f"what the actuator can do, see `hnf actuators` (default {GENERIC.name})",
    )  # fmt: skip
    parser.add_argument("--gain", type=float, default=0.0, metavar="DB", help="one gain for all stimuli")
    parser.add_argument("--raw", action="store_true", help="leave out the inverse filter of a measured profile")
    parser.set_defaults(run_step=_run_session)


def _add_page(steps: Any) -> None:
    parser = steps.add_parser(
        "page",
        help="write the study as one page for a browser",
        description="Write one HTML file with all stimuli in it, which needs no network. Its responses are downloaded "
        "as CSV; put them into DIR/responses.",
    )
    parser.add_argument("folder", type=Path, metavar="DIR", help="folder of the study")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.html", help="page to write")
    parser.add_argument(
        "--full-scale", type=float, metavar="M_S2",
        help="what the sound output's full scale stands for (m/s²; default: a little more than the strongest peak)",
    )  # fmt: skip
    parser.set_defaults(run_step=_run_page)


def _add_evaluate(steps: Any) -> None:
    parser = steps.add_parser(
        "evaluate",
        help="evaluate the responses",
        description="Count the choices of each pair with exact intervals and tests, fit Bradley–Terry scores, check "
        "for bias, and estimate the power.",
    )
    parser.add_argument("folder", type=Path, metavar="DIR", help="folder of the study")
    parser.add_argument("--key", type=Path, metavar="FILE.json", help="the key, if it is kept elsewhere")
    parser.add_argument("--json", action="store_true", help="print one JSON object, with every stimulus")
    _add_power(parser)
    parser.set_defaults(run_step=_run_evaluate)


def _add_power(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--detect", type=float, default=DEFAULT_DETECTED, metavar="PERCENT",
        help=f"true share of choices that is to be found (default {DEFAULT_DETECTED:g})",
    )  # fmt: skip
    parser.add_argument(
        "--power", type=float, default=DEFAULT_POWER, metavar="PERCENT",
        help=f"probability with which it is found (default {DEFAULT_POWER:g})",
    )  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Run a step of `hnf study`; return the exit code. Raises HnfError."""
    if importlib.util.find_spec(f"{__package__.rpartition('.')[0]}.study") is None:
        raise HnfError(
            "study is no part of the extension.", remedy="Run it from the source: pip install -e ., then hnf study."
        )
    return int(arguments.run_step(arguments))


def _run_stimuli(arguments: argparse.Namespace) -> int:
    """Run `hnf study stimuli`, which writes pieces of recorded textures and our synthesis of the same strokes as WAVs.

    Return the exit code. Raises HnfError.
    """
    from ..datasets.registry import open_dataset
    from ..study.plan import write_stimuli

    if not 0.1 <= arguments.seconds <= 60.0:
        raise UsageError(f"--seconds {arguments.seconds:g}: give 0.1 to 60.")
    kind, folder = arguments.recordings
    data = open_dataset(kind, Path(folder))
    for words in arguments.textures:
        texture, _, material = words.partition("=")
        written = write_stimuli(
            arguments.out, data, texture, material or texture, seconds=arguments.seconds, seed=arguments.seed
        )
        for note in written.notes:
            print(f"hnf: {note}", file=sys.stderr)
        print(
            f"{written.name}.wav: recorded {written.recorded_m_s2:.3g} m/s² RMS, {written.material} "
            f"{written.ours_m_s2:.3g} m/s²"
        )
    return 0


def _run_make(arguments: argparse.Namespace) -> int:
    """Run `hnf study make`; return the exit code. Raises HnfError."""
    from ..study.plan import compare_files, compare_methods, make_study
    from ..study.results import find_trial_count

    if bool(arguments.pair) == bool(arguments.method):
        raise UsageError("a study compares files or methods.", remedy="Give --pair A.wav B.wav, or --method twice.")
    needed = find_trial_count(arguments.detect / 100.0, arguments.power / 100.0, greater=arguments.abx)
    if arguments.pair:
        if arguments.against:
            raise UsageError("--against goes with --method.", remedy="Leave it out.")
        comparisons = compare_files(arguments.pair, Path(arguments.reference) if arguments.reference else None)
    else:
        against = [name for name in arguments.against.split(",") if name]
        comparisons = compare_methods(_parse_methods(arguments.method), against, arguments.reference)
    plan, notes = make_study(
        arguments.folder, comparisons, question=arguments.question, repeats=arguments.repeats, seed=arguments.seed,
        abx=arguments.abx, match_level=arguments.match_level, full_scale_m_s2=arguments.full_scale,
    )  # fmt: skip
    for note in notes:
        print(f"hnf: {note}", file=sys.stderr)
    methods = {frozenset((each.a.method, each.b.method)) for each in comparisons}
    trials = len(plan.pairs) * plan.repeats
    participants = math.ceil(needed * len(methods) / trials)
    print(
        f"{arguments.folder}: study {plan.id}, {len(plan.stimuli)} stimuli, {trials} trials a participant: "
        f"{plan.question}\n"
        f"To find a true {arguments.detect:g} % with a probability of {arguments.power:g} % takes {needed} trials of "
        f"each two methods: {pluralize(participants, 'participant')}, or more, since trials of one person are alike.\n"
        f"Keep {arguments.folder / 'key.json'} from participants. Next: hnf study run {arguments.folder} "
        "--participant p01 --to TARGET"
    )
    return 0


def _parse_methods(words: list[str]) -> dict[str, Path]:
    methods: dict[str, Path] = {}
    for word in words:
        name, _, folder = word.partition("=")
        if not name or not Path(folder).is_dir() or not folder:
            raise UsageError(f"--method {word}: no folder is called {folder!r}.", remedy="Say NAME=FOLDER.")
        if name in methods:
            raise UsageError(f"two methods are called {name!r}.", remedy="Name them differently.")
        methods[name] = Path(folder)
    return methods


def _run_session(arguments: argparse.Namespace) -> int:
    """Run `hnf study run`; return the exit code. Raises HnfError."""
    from ..actuators.profile import load_profile
    from ..actuators.stream_targets import FileTarget, parse_target
    from ..study.plan import load_plan
    from ..study.presentation import Keyboard, Output, find_max_gain_db, read_stimuli, run_session
    from ..study.results import check_participant

    participant, target = check_participant(arguments.participant), parse_target(arguments.to)
    if isinstance(target, FileTarget):
        raise UsageError("nobody feels a file.", remedy="Give a device, or virtual to try the study.")
    plan, profile = load_plan(arguments.folder), load_profile(arguments.profile)
    output = Output(target, profile, arguments.gain, arguments.raw)
    stimuli = read_stimuli(arguments.folder, plan, profile)
    fits_db = find_max_gain_db(stimuli, profile)
    if arguments.gain > fits_db:
        print(
            f"hnf: the strongest stimulus is more than '{profile.title}' may play and will be limited. "
            f"--gain {fits_db - 0.05:.1f} fits.",
            file=sys.stderr,
        )
    left = run_session(arguments.folder, plan, participant, output, stimuli, Keyboard(), sys.stdout)
    if left:
        print(f"{pluralize(left, 'trial')} left. The same command goes on there.")
    else:
        print(f"All trials of {participant} are done.")
    return 0


def _run_page(arguments: argparse.Namespace) -> int:
    """Run `hnf study page`; return the exit code. Raises HnfError."""
    from ..study.plan import load_plan
    from ..study.presentation import write_page
    from ..study.results import RESPONSES_NAME

    full_scale = write_page(arguments.out, arguments.folder, load_plan(arguments.folder), arguments.full_scale)
    print(
        f"{arguments.out}: full scale of the sound output stands for {full_scale:.4g} m/s². Open it in a browser; put "
        f"the CSVs that it gives into {arguments.folder / RESPONSES_NAME}"
    )
    return 0


def _run_evaluate(arguments: argparse.Namespace) -> int:
    """Run `hnf study evaluate`; return the exit code. Raises HnfError."""
    from ..study.plan import load_key, load_plan
    from ..study.results import evaluate_study, format_results, read_all_responses

    plan = load_plan(arguments.folder)
    key = load_key(arguments.folder, plan, arguments.key)
    results = evaluate_study(
        plan, key, read_all_responses(arguments.folder, plan),
        detected=arguments.detect / 100.0, wanted_power=arguments.power / 100.0,
    )  # fmt: skip
    print(json.dumps(asdict(results), indent=1, ensure_ascii=False) if arguments.json else format_results(results))
    return 0
