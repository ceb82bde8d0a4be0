"""`hnf train`: train a field for one material, or the network that predicts tactile maps.

`hnf train field` reads a data set or simulated recordings; `hnf train tactile-map` trains that network, D_φ, on pairs
of photograph and touch. Other packages register more subjects.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import UsageError
from ..field.weights import save_field
from ..progress import Progress, ProgressBar
from ..tactile.unet import DIFFUSION, REGRESSION, MapConfig, find_map_weights, refuse_package_data
from .commands import (
    HELP,
    LABORATORY_SUBJECTS,
    SUBJECT_GROUP,
    check_weights_name,
    find_plugins,
    make_laboratory_error,
    parse_seed,
    require_torch,
)

if TYPE_CHECKING:
    from ..datasets.recording import DataSet, Recording, TextureProcess
    from ..training.train_map import Distance
    from ..training.train_material import TrainingResult

SIMULATED_PAIRS = "simulated"
RECORDED_KINDS = ("tarf", "touch-and-go", "billets")
"""Recorded data sets of pairs, the keys of `datasets.recorded_pairs.LICENCES`."""
DEFAULT_MINUTES = 60.0
DEFAULT_SECONDS, PUBLISHED_SECONDS = 480.0, 20.0
"""Strokes that are synthesised from a model [s]; the published form's fill its C = 200 windows of 0.1 s."""


def _add_tactile_map(subjects: Any) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = subjects.add_parser(
        "tactile-map",
        help="the network that predicts tactile maps from a look",
        description="Train D_φ (color and depth → tactile map) on paired views and write its weights. A killed run "
        "resumes where it was when the same command is given again. Needs the extra [train].",
    )
    parser.add_argument(
        "--data", nargs="+", required=True, metavar=("KIND", "DIR"),
        help="tarf, touch-and-go or billets and the folder of the data set; or a folder of pairs alone "
        "(tools/make_tactile_pairs.py); or simulated: they are made first, beside FILE",
    )  # fmt: skip
    parser.add_argument(
        "--out", type=Path, required=True, metavar="FILE",
        help="weights to write (.safetensors), for hnf touch --tactile-map FILE",
    )  # fmt: skip
    parser.add_argument(
        "--start", metavar="NETWORK",
        help="weights to go on from: regression, diffusion or a file (default with KIND: the shipped ones of the "
        "objective; else none)",
    )  # fmt: skip
    parser.add_argument(
        "--minutes", type=float, default=DEFAULT_MINUTES, metavar="M", help=f"to train (default {DEFAULT_MINUTES:g})"
    )
    parser.add_argument("--seed", type=parse_seed, default=0, metavar="N", help="of batches, noise and initial weights")
    parser.add_argument(
        "--objective", choices=(REGRESSION, DIFFUSION), default=REGRESSION,
        help=f"{REGRESSION} (default; shipped): least squares, one pass; {DIFFUSION}: maps sampled from noise in steps",
    )  # fmt: skip
    parser.add_argument("--fresh", action="store_true", help="start anew even where a killed run could go on")
    parser.add_argument("--json", action="store_true", help="print the result as one JSON object")
    parser.set_defaults(run=_run_tactile_map)
    return parser


def _run_tactile_map(arguments: argparse.Namespace) -> int:
    """Run `hnf train tactile-map`; return the exit code. Raises HnfError."""
    check_weights_name(arguments.out)
    if not arguments.minutes > 0.0:
        raise UsageError("--minutes must be more than 0.")
    refuse_package_data(arguments.out)
    checkpoint = arguments.out.with_name(f"{arguments.out.name}.checkpoint")
    if arguments.fresh:
        checkpoint.unlink(missing_ok=True)
    record = _train_tactile_map(arguments, checkpoint)
    checkpoint.unlink(missing_ok=True)
    words = record.pop("in_words")
    text = f"{record['weights']}: {record['training_data']}; {record['views']} views seen; {words}"
    print(json.dumps(record, indent=1) if arguments.json else text)
    return 0


def _train_tactile_map(arguments: argparse.Namespace, checkpoint: Path) -> dict[str, Any]:
    with require_torch("training"):
        from ..training.train_map import LEARNING_RATES, MapTrainingPlan, train_map, train_on_pairs

    bar = ProgressBar()

    def watch(step: int, spent: float, loss: float, distances: Mapping[str, Distance]) -> None:
        bar.show(Progress(f"% loss {loss:.4f}", int(100 * spent), 100))
        for name, distance in distances.items():
            print(f"hnf: {step} steps, {name}: {distance.describe()}", file=sys.stderr)

    try:
        plan = MapTrainingPlan(minutes=arguments.minutes, seed=arguments.seed, rate=LEARNING_RATES[arguments.objective])
        config = MapConfig(objective=arguments.objective)
        if arguments.data[0] not in RECORDED_KINDS:
            folder = _find_pairs(arguments, bar)
            start = None if arguments.start is None else find_map_weights(arguments.start)
            return train_map(folder, plan, config, arguments.out, checkpoint, watch, start=start)
        from ..datasets.recorded_pairs import LICENCES, load_recorded_pairs

        kind, folder = arguments.data[0], Path(arguments.data[-1])
        if len(arguments.data) != 2:
            raise UsageError(f"--data takes {kind} and its folder, not {arguments.data}.", remedy=f"--data {kind} DIR")
        train, held_out, notes = load_recorded_pairs(kind, folder, arguments.seed)
        for note in notes:
            print(f"hnf: {note}.", file=sys.stderr)
        data = f"{len(train)} views of {train.tiles} recorded places ({kind})"
        start = find_map_weights(arguments.start or arguments.objective)
        return train_on_pairs(
            train, {"held out": held_out}, plan, config, arguments.out, checkpoint, watch,
            data=data, licence=LICENCES[kind], start=start,
        )  # fmt: skip
    finally:
        bar.close()


def _find_pairs(arguments: argparse.Namespace, bar: ProgressBar) -> Path:
    if len(arguments.data) != 1:
        kinds = ", ".join(RECORDED_KINDS)
        raise UsageError(f"{arguments.data[0]!r} is no data set of pairs.", remedy=f"Known are {kinds}.")
    if arguments.data[0] != SIMULATED_PAIRS:
        return Path(arguments.data[0])
    from ..datasets.pair_generation import PairSizes, write_pairs

    folder = arguments.out.with_name(f"{arguments.out.stem}-pairs")
    write_pairs(
        folder, PairSizes(), arguments.seed, on_progress=lambda done, total: bar.show(Progress("shards", done, total))
    )
    return Path(folder)


def add_parser(verbs: Any, subject: str = "") -> argparse.ArgumentParser:
    """Add `hnf train` and its subjects (what to train); those of other packages only if `subject` is not built in."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        "train",
        help=HELP["train"],
        description="Train one of the networks. Needs the extra [train].",
    )
    subjects = parser.add_subparsers(dest="what", metavar="WHAT", required=True)
    _add_field(subjects)
    _add_tactile_map(subjects)
    if subject not in subjects.choices:
        _add_registered_subjects(subjects)
    return parser


def _add_registered_subjects(subjects: Any) -> None:
    registered = find_plugins(SUBJECT_GROUP)
    for plugin in registered.values():
        plugin.load()(subjects)
    for subject in LABORATORY_SUBJECTS.keys() - registered.keys():
        # All words after the subject are accepted, options too, so that the error explains where the subject is.
        missing = subjects.add_parser(subject, add_help=False, prefix_chars="\0")
        missing.add_argument("words", nargs="*")
        missing.set_defaults(run=_refuse_laboratory_subject)


def _refuse_laboratory_subject(arguments: argparse.Namespace) -> int:
    raise make_laboratory_error(f"train {arguments.what}")


def _add_field(subjects: Any) -> None:
    parser = subjects.add_parser(
        "field",
        help="a field for one material",
        description="Train F_Θ for one material and write its weights for `hnf synth --weights`. Recordings are read "
        "from the folder; where a data set holds texture models, strokes are first synthesized from them. A killed run "
        "resumes where it was when the same command is given again. Needs the extra [train].",
    )
    parser.add_argument(
        "--data", nargs="+", required=True, metavar=("KIND", "DIR"),
        help="own, hatt, cluster or lmt and the folder of the recordings, or simulated",
    )  # fmt: skip
    parser.add_argument("--material", required=True, metavar="NAME", help="material, as the data set calls it")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="weights to write (.safetensors)")
    parser.add_argument(
        "--seconds", type=float, metavar="S",
        help="strokes to synthesize from a model (default 480; published form: 20, its 200 windows)",
    )  # fmt: skip
    parser.add_argument(
        "--source", choices=["model", "recordings"], help="where a data set has both (default: its model)"
    )
    parser.add_argument(
        "--form", choices=["carriers", "published"], default="carriers",
        help="published: the paper's literal model, with its loss and schedule; default: noise carriers",
    )  # fmt: skip
    parser.add_argument(
        "--actions", choices=["raw", "low-passed"], default="low-passed",
        help="for the published form: as the sensors recorded them, vibration and all, or as a hand moves (default)",
    )  # fmt: skip
    parser.add_argument("--hidden", type=int, metavar="H", help="units per layer (default: chosen by the data)")
    parser.add_argument("--layers", type=int, metavar="L", help="layers (default 4)")
    parser.add_argument(
        "--states", type=int, metavar="N", help="states accumulated (default: 1 or 5, whatever validates better)"
    )
    parser.add_argument(
        "--accumulation", choices=["past", "heads"], help="N past states, or N heads of one state as published"
    )
    parser.add_argument("--epochs", type=int, metavar="N", help="at most so many epochs")
    parser.add_argument(
        "--augment", action="store_true",
        help="add the eight primitives (HNF+) on a model, and for the published form; otherwise each recorded window "
        "backward, as if the hand had moved the other way",
    )  # fmt: skip
    parser.add_argument("--seed", type=parse_seed, default=0, metavar="N", help="of strokes, noise and initial weights")
    parser.add_argument("--fresh", action="store_true", help="start anew even where a killed run could go on")
    parser.add_argument("--json", action="store_true", help="print the result as one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Run `hnf train field`; return the exit code. Raises HnfError."""
    check_weights_name(arguments.out)
    from ..datasets.recording import find_doubts
    from ..datasets.registry import get_training_recordings

    kind, data = _open_data(arguments.data)
    published = arguments.form == "published"
    seconds = arguments.seconds
    if seconds is None:
        seconds = PUBLISHED_SECONDS if published else DEFAULT_SECONDS
    process = None if arguments.source == "recordings" else data.process(arguments.material)
    for is_wrong, what, remedy in (
        *((value is not None and value < 1, f"{option} must be at least 1.", "") for option, value in (
            ("--epochs", arguments.epochs), ("--hidden", arguments.hidden), ("--layers", arguments.layers),
            ("--states", arguments.states))),
        (arguments.source == "model" and process is None, f"there is no model of {arguments.material!r} here.",
         "Leave --source out to train on its recordings."),
        (arguments.seconds is not None and process is None, "--seconds is for strokes on a model: recordings are used "
         "whole.", "Leave it out, or give fewer recordings."),
        (published and arguments.accumulation == "past", "the published form has heads of one state, no past states.",
         "Leave --accumulation out."),
        (arguments.actions == "raw" and not published, "--actions raw is for --form published alone.",
         "Leave one out, or add the other."),
        (arguments.actions == "raw" and process is not None, "strokes on a model have no raw action.",
         "Give recordings, or leave --actions out."),
    ):  # fmt: skip
        if is_wrong:
            raise UsageError(what, remedy=remedy)
    recordings = get_training_recordings(data, arguments.material, seconds, arguments.seed, arguments.source)
    if process is None:
        for doubt in find_doubts(recordings):
            print(f"hnf: note: {doubt}", file=sys.stderr)
    trained, record = _train_field(arguments, kind, process, recordings)
    from ..export.figure import write_training_curve

    save_field(arguments.out, trained.field)
    curve = arguments.out.with_suffix(".curve.png")
    write_training_curve(curve, f"{record['material']}: {record['training_data']}", trained.history)
    record.update(weights=str(arguments.out), curve=str(curve))
    print(json.dumps(record, indent=1) if arguments.json else _format_record(record))
    return 0


def _open_data(words: list[str]) -> tuple[str, DataSet]:
    from ..datasets.registry import open_dataset

    if len(words) > 2:
        raise UsageError(f"--data takes a kind and a folder, not {words}.", remedy="Quote a path with blanks.")
    return words[0], open_dataset(words[0], Path(words[1]) if len(words) == 2 else None)


def _train_field(
    arguments: argparse.Namespace, kind: str, process: TextureProcess | None, recordings: list[Recording]
) -> tuple[TrainingResult, dict[str, Any]]:
    from ..datasets.registry import LICENCES

    with require_torch("training"):
        from ..training.from_recordings import TrainingOverrides, train_from_recordings
        from ..training.published_form import make_added_strokes
    checkpoint = arguments.out.with_name(f"{arguments.out.name}.checkpoint")
    if arguments.fresh:
        for path in checkpoint.parent.glob(f"{arguments.out.name}.*checkpoint"):
            path.unlink()
        checkpoint.unlink(missing_ok=True)
    found_checkpoint = checkpoint.exists()
    bar = ProgressBar()
    strokes_primitives = process is not None or arguments.form == "published"

    def watch(done: int, total: int, loss: float) -> None:
        if done == 1 and found_checkpoint:
            print(f"hnf: {checkpoint} is damaged or of another run: training began anew.", file=sys.stderr)
        bar.show(Progress(f"validation loss {loss:.4f}", done, total))

    overrides = TrainingOverrides(
        arguments.hidden, arguments.layers, arguments.states, arguments.accumulation, arguments.epochs, arguments.form,
        arguments.actions, arguments.augment and not strokes_primitives,
    )  # fmt: skip
    added = make_added_strokes(process, recordings, arguments.seed) if arguments.augment and strokes_primitives else ()
    try:
        return train_from_recordings(
            recordings, kind, LICENCES[kind], arguments.seed, overrides, checkpoint, watch, compare=process is None,
            added=added,
        )  # fmt: skip
    finally:
        bar.close()


def _format_record(record: dict[str, Any]) -> str:
    test = record["test"]
    held_out = (
        "too short to hold a test out"
        if test is None
        else (
            f"held-out spectrum {test['distance_db']:.2f} dB off (a perfect model: {test['scatter_db']:.2f}), "
            f"power {test['bias_db']:+.2f} dB"
        )
    )
    notes = f" ({'; '.join(record['notes'])})" if record["notes"] else ""
    text = (
        f"{record['weights']}: {record['material']}, {record['training_data']}{notes}; {record['settings']}; {held_out}"
    )
    return f"{text}\n{record['choice']}" if record["choice"] else text
