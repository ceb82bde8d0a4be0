"""Plan of a blinded two-alternative study: stimuli under blinded names, pairs, and each participant's order of trials.

A study is a folder: `study.json` (the plan, which names no method), `stimuli/` (WAVs in m/s² without provenance),
`key.json` (what each stimulus is) and `responses/` (a CSV per participant). The study's id is a hash of the plan, and
the plan holds the SHA-256 of every stimulus, so that responses to anything else are noticed.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import TypeVar

import numpy as np

from ..action.action import Action, write_action_csv
from ..datasets.recording import DataSet, Recording, normalise_name
from ..datasets.registry import get_training_recordings
from ..errors import FileError, UsageError, format_choices, pluralize
from ..export.options import ImportOptions
from ..export.wav import encode_wav, read_wav_scaled, write_wav
from ..field.carriers import MODEL_RATE_HZ
from ..field.resampling import resample
from ..field.stroke import uniform_stroke
from ..field.synthesis import synthesise
from ..field.weights import load_field
from ..files import write_bytes, write_text
from ..json_io import encode_json, load_json, parse_record
from ..material.ranking import find_material
from ..progress import add_work
from ..signal import Signal

SCHEMA = 1
PLAN_NAME, KEY_NAME, STIMULI_NAME = "study.json", "key.json", "stimuli"
LEVEL_NOTE_DB = 3.0
"""Difference in RMS level within a pair from which on it is reported [dB]."""
DURATION_NOTE_SHARE = 0.05
"""Difference in duration within a pair from which on it is reported, as a share of the longer one."""
PREFERENCE, NEARER, SAME = (
    "Which one do you prefer?",
    "Which one is nearer to the reference?",
    "Which one is the same as the reference?",
)
"""Default questions without a reference, with one, and for ABX."""

Item = TypeVar("Item", bound=Hashable)


@dataclass(frozen=True)
class Stimulus:
    """A WAV of the study by its blinded name, with its SHA-256."""

    id: str
    sha256: str
    rate_hz: float
    duration_s: float


@dataclass(frozen=True)
class Pair:
    """Two stimuli to choose from, and the one that they are compared with; "" for none."""

    id: str
    a: str
    b: str
    reference: str


@dataclass(frozen=True)
class Plan:
    """Plan of a study; see the module. In an ABX study the reference of a pair is one of its two stimuli."""

    schema: int
    question: str
    abx: bool
    repeats: int
    seed: int
    level_matched: bool
    stimuli: tuple[Stimulus, ...]
    pairs: tuple[Pair, ...]

    @property
    def id(self) -> str:
        """The study's identity: the first 16 hexadecimal digits of the plan's SHA-256."""
        return hashlib.sha256(encode_json(self).encode("utf-8")).hexdigest()[:16]


@dataclass(frozen=True)
class KeyEntry:
    """Origin of one stimulus: the method that made it, the name that methods are compared under, and its level."""

    id: str
    method: str
    name: str
    source: str
    gain_db: float
    rms_m_s2: float


@dataclass(frozen=True)
class Key:
    """Key that unblinds the stimuli of a study."""

    study: str
    stimuli: tuple[KeyEntry, ...]


@dataclass(frozen=True)
class Trial:
    """One trial of a participant: two stimuli in the order in which they are presented, numbered from 1."""

    number: int
    pair: str
    repeat: int
    reference: str
    first: str
    second: str


@dataclass(frozen=True)
class Source:
    """WAV that a stimulus is made of, the method that made it and the name that methods are compared under."""

    method: str
    name: str
    path: Path


@dataclass(frozen=True)
class Comparison:
    """Two sources to compare, and the reference that both are compared with."""

    a: Source
    b: Source
    reference: Source | None = None


def compare_files(pairs: Sequence[Sequence[Path]], reference: Path | None) -> list[Comparison]:
    """Return the comparisons of named files; each file is a method of its own, called by its path."""
    common = None if reference is None else Source(str(reference), "", reference)
    for pair in pairs:
        if len({path.resolve() for path in (*pair, *([reference] if reference else []))}) < 2 + bool(reference):
            raise UsageError(
                f"--pair {pair[0]} {pair[1]}: a file would be compared with itself.", remedy="Give two different files."
            )
    return [Comparison(Source(str(a), "", a), Source(str(b), "", b), common) for a, b in pairs]


def compare_methods(
    folders: Mapping[str, Path], against: Sequence[str] = (), reference: str | None = None
) -> list[Comparison]:
    """Return the comparisons of methods, each a folder of WAVs, on every stimulus that they all have.

    Parameters
    ----------
    folders : mapping of str to Path
        Folder of each method; every one needs a WAV for every stimulus, of the same name.
    against : sequence of str
        Methods of which each pair has at least one; empty for all pairs.
    reference : str or None
        Method that the others are compared with; it is in no pair itself.

    Raises
    ------
    UsageError
        For an unknown method, or fewer than two to compare.
    FileError
        If a folder lacks a stimulus, or there are none.
    """
    for name in (*against, *([reference] if reference else [])):
        if name not in folders:
            raise UsageError(f"no method is called {name!r}.", remedy=f"There are {format_choices(folders)}.")
    compared = [name for name in folders if name != reference]
    pairs = [pair for pair in combinations(compared, 2) if not against or set(pair) & set(against)]
    if not pairs:
        raise UsageError("two methods are needed to compare.", remedy="Give --method NAME=FOLDER for each.")
    files = {
        name: {path.name: path for path in sorted(folder.glob("*.[wW][aA][vV]"))} for name, folder in folders.items()
    }
    every = sorted(set().union(*files.values()))
    for name, found in files.items():
        missing = [file for file in every if file not in found]
        if missing or not found:
            raise FileError(
                f"'{name}' lacks {format_choices(missing, 3)}." if missing else "there is no WAV in it.",
                where=str(folders[name]),
                remedy="Every method needs a WAV of the same name for each stimulus.",
            )
    sources = {(name, file): Source(name, Path(file).stem, files[name][file]) for name in folders for file in every}
    return [
        Comparison(sources[a, file], sources[b, file], sources[reference, file] if reference else None)
        for file in every
        for a, b in pairs
    ]


def make_study(
    folder: Path, comparisons: Sequence[Comparison], *, question: str = "", repeats: int = 2, seed: int = 0,
    abx: bool = False, match_level: bool = False, full_scale_m_s2: float | None = None,
) -> tuple[Plan, list[str]]:  # fmt: skip
    """Write a study: its plan, its key, and the stimuli under blinded names.

    Parameters
    ----------
    folder : Path
        Folder of the study; it may hold no other study.
    comparisons : sequence of Comparison
        Pairs to compare.
    question : str
        Question to the participant; "" for the default of this kind of study.
    repeats : int
        Trials of each pair for each participant; every second one has the opposite order.
    seed : int
        Seed of blinded names and orders.
    abx : bool
        Make each pair's reference one of its own stimuli, in turn.
    match_level : bool
        Scale all that are compared with each other to the RMS of their reference, or of the first of them.
    full_scale_m_s2 : float or None
        Acceleration of a sample of 1.0 in files that state no unit [m/s²].

    Returns
    -------
    tuple of Plan and list of str
        The plan, and notes on what may give a stimulus away.

    Raises
    ------
    HnfError
        For arguments that do not fit together, a WAV that cannot be used, or a folder that holds a study.
    """
    if (folder / PLAN_NAME).exists():
        raise FileError("there is a study here already.", where=str(folder), remedy="Give another folder.")
    if not 1 <= repeats <= 1000:
        raise UsageError(f"--repeats {repeats}: give 1 to 1000.")
    if abx and any(each.reference for each in comparisons):
        raise UsageError("an ABX study takes its references from the pairs.", remedy="Leave --reference or --abx out.")
    sources = list(dict.fromkeys(each for pair in comparisons for each in (pair.a, pair.b, pair.reference) if each))
    signals = {source: _read_signal(source.path, full_scale_m_s2) for source in sources}
    _check_rates(comparisons, signals)
    gains = _match_levels(comparisons, signals) if match_level else dict.fromkeys(sources, 1.0)
    notes = _describe_differences(comparisons, signals, gains)
    rng = np.random.default_rng(seed)
    ids = {sources[index]: f"s{number:03d}" for number, index in enumerate(rng.permutation(len(sources)), 1)}
    stimuli, entries = [], []
    for source, name in sorted(ids.items(), key=lambda item: item[1]):
        signal, gain = signals[source], gains[source]
        blinded = Signal((signal.samples * gain).astype(np.float32), signal.sample_rate, 0)  # without provenance
        data = encode_wav(blinded, where=str(source.path))
        write_bytes(folder / STIMULI_NAME / f"{name}.wav", data)
        digest = hashlib.sha256(data).hexdigest()
        stimuli.append(Stimulus(name, digest, signal.sample_rate, signal.duration_s))
        gain_db = float(20.0 * np.log10(gain))
        entries.append(KeyEntry(name, source.method, source.name, str(source.path), gain_db, blinded.rms))
    pairs: list[Pair] = []
    for index in rng.permutation(len(comparisons)):
        each = comparisons[index]
        a, b = rng.permutation([ids[each.a], ids[each.b]]).tolist()
        references = (a, b) if abx else (ids[each.reference] if each.reference else "",)
        pairs += [Pair(f"p{len(pairs) + offset:03d}", a, b, name) for offset, name in enumerate(references, 1)]
    question = question or (SAME if abx else NEARER if pairs[0].reference else PREFERENCE)
    plan = Plan(SCHEMA, question, abx, repeats, seed, match_level, tuple(stimuli), tuple(pairs))
    _write_record(folder / KEY_NAME, Key(plan.id, tuple(entries)))
    _write_record(folder / PLAN_NAME, plan)
    return plan, notes


def load_plan(folder: Path) -> Plan:
    """Read the plan of a study; raise FileError if it or a stimulus is missing, damaged or changed."""
    plan = _read_record(folder / PLAN_NAME, Plan, "Make one: hnf study make DIR --pair A.wav B.wav")
    if plan.schema != SCHEMA or not plan.pairs:
        raise FileError("is the plan of another version.", where=str(folder / PLAN_NAME), remedy="Make the study anew.")
    known = {stimulus.id for stimulus in plan.stimuli}
    used = {name for pair in plan.pairs for name in (pair.a, pair.b, pair.reference) if name}
    if not used <= known or not all(re.fullmatch(r"s\d+", name) for name in known):
        raise FileError("its pairs and stimuli do not match.", where=str(folder / PLAN_NAME), remedy=_CHANGED)
    for stimulus in plan.stimuli:
        path = find_stimulus(folder, stimulus.id)
        add_work("hashed_files", item=str(path))
        try:
            digest = hashlib.sha256(path.read_bytes()).hexdigest()
        except OSError as error:
            raise FileError(f"cannot be read ({error.strerror}).", where=str(path), remedy=_CHANGED) from error
        if digest != stimulus.sha256:
            raise FileError("is not the stimulus that the study was made with.", where=str(path), remedy=_CHANGED)
    return plan


def load_key(folder: Path, plan: Plan, path: Path | None = None) -> dict[str, KeyEntry]:
    """Read the key of a study, from `path` if it is kept elsewhere, by stimulus; raise FileError for another's."""
    path = path or folder / KEY_NAME
    key = _read_record(path, Key, "Put it back, or say where it is: --key FILE.json")
    entries = {entry.id: entry for entry in key.stimuli}
    if key.study != plan.id or entries.keys() != {stimulus.id for stimulus in plan.stimuli}:
        raise FileError("is the key of another study.", where=str(path), remedy=f"Give the key of {plan.id}.")
    return entries


def find_stimulus(folder: Path, stimulus: str) -> Path:
    """Return the path of a stimulus."""
    return folder / STIMULI_NAME / f"{stimulus}.wav"


def order_trials(plan: Plan, participant: str) -> list[Trial]:
    """Return the trials of a participant in their order; the page in a browser makes the same.

    Every repeat is a block with all pairs in random order. In a block half of the pairs are presented in each order
    (to one pair), and each pair in alternating order from block to block.
    """

    def shuffle(purpose: str) -> list[Pair]:
        return sorted(plan.pairs, key=lambda pair: (hash_text(f"{plan.id}/{participant}/{purpose}/{pair.id}"), pair.id))

    start = hash_text(f"{plan.id}/{participant}/start") % 2
    side = {pair.id: (index + start) % 2 for index, pair in enumerate(shuffle("side"))}
    trials: list[Trial] = []
    for repeat in range(plan.repeats):
        for pair in shuffle(f"order {repeat}"):
            swapped = (side[pair.id] + repeat) % 2
            first, second = (pair.b, pair.a) if swapped else (pair.a, pair.b)
            trials.append(Trial(len(trials) + 1, pair.id, repeat, pair.reference, first, second))
    return trials


def hash_text(text: str) -> int:
    """Return a 32-bit hash of a text: each byte is mixed in by the last step of MurmurHash3.

    It is short in JavaScript too, whose own SHA-256 does not exist in pages that come over plain HTTP.
    """
    value, mask = 0, 0xFFFFFFFF
    for byte in text.encode("utf-8"):
        value = ((value + byte + 1) * 0x9E3779B1) & mask
        value = ((value ^ (value >> 16)) * 0x85EBCA6B) & mask
        value = ((value ^ (value >> 13)) * 0xC2B2AE35) & mask
        value ^= value >> 16
    return value


def group_connected(edges: Iterable[tuple[Item, Item]]) -> list[set[Item]]:
    """Return the connected groups of items, given the pairs that connect them."""
    groups: list[set[Item]] = []
    for edge in edges:
        joined = [group for group in groups if group & set(edge)]
        groups = [group for group in groups if not group & set(edge)] + [set(edge).union(*joined)]
    return groups


_CHANGED = "Restore the study's folder from a copy, or make the study anew."
_Record = TypeVar("_Record")


def _read_record(path: Path, kind: type[_Record], remedy: str) -> _Record:
    try:
        return parse_record(kind, load_json(path.read_text(encoding="utf-8")), complete=True)
    except OSError as error:
        raise FileError(f"cannot be read ({error.strerror}).", where=str(path), remedy=remedy) from error
    except (ValueError, RecursionError) as error:
        raise FileError(f"is damaged ({error}).", where=str(path), remedy=_CHANGED) from error


def _write_record(path: Path, record: Plan | Key) -> None:
    write_text(path, json.dumps(asdict(record), indent=1, ensure_ascii=False, allow_nan=False) + "\n")


def _read_signal(path: Path, full_scale_m_s2: float | None) -> Signal:
    signal = read_wav_scaled(path, ImportOptions(full_scale_m_s2=full_scale_m_s2))
    if signal.rms == 0.0:
        raise FileError("is silent.", where=str(path), remedy="Leave it out, or make it again.")
    return signal


def _check_rates(comparisons: Iterable[Comparison], signals: Mapping[Source, Signal]) -> None:
    for each in comparisons:
        for other in (each.b, *([each.reference] if each.reference else [])):
            rates = signals[each.a].sample_rate, signals[other].sample_rate
            if rates[0] != rates[1]:
                raise UsageError(
                    f"{each.a.path} has {rates[0]:g} Hz and {other.path} {rates[1]:g} Hz: the rate would show which "
                    "is which.",
                    remedy="Export both at one rate: hnf export FILE --format wav8k --out COPY.wav",
                )


def _match_levels(comparisons: Sequence[Comparison], signals: Mapping[Source, Signal]) -> dict[Source, float]:
    """Return the gain of each source that brings it to the RMS of its group's reference, or of the group's first."""
    edges = [(each.a, other) for each in comparisons for other in (each.b, each.reference or each.b)]
    references = [each.reference for each in comparisons if each.reference]
    gains: dict[Source, float] = {}
    for group in group_connected(edges):
        target = next(source for source in (*references, *signals) if source in group)
        gains |= {source: signals[target].rms / signals[source].rms for source in group}
    return gains


def _describe_differences(
    comparisons: Sequence[Comparison], signals: Mapping[Source, Signal], gains: Mapping[Source, float]
) -> list[str]:
    """Return notes on differences within pairs that show which stimulus is which."""
    level_db, duration = [], []
    for each in comparisons:
        a, b = signals[each.a], signals[each.b]
        level_db.append(abs(20.0 * np.log10(a.rms * gains[each.a] / (b.rms * gains[each.b]))))
        duration.append(abs(a.duration_s - b.duration_s) / max(a.duration_s, b.duration_s))
    notes = []
    for values, limit, text, remedy in (
        (level_db, LEVEL_NOTE_DB, "{:.1f} dB in RMS level", "strength alone may decide; --match-level evens it out."),
        (duration, DURATION_NOTE_SHARE, "{:.0%} in duration", "the length may give them away; cut them alike."),
    ):
        count, worst = sum(value > limit for value in values), int(np.argmax(values))
        if count:
            names = f"{comparisons[worst].a.path}, {comparisons[worst].b.path}"
            notes.append(
                f"{count} of {pluralize(len(values), 'pair')} differ by up to {text.format(values[worst])} ({names}): "
                f"{remedy}"
            )
    return notes


RECORDED, OURS, ACTIONS = "recorded", "ours", "actions"
"""Folders that are written, two of which are methods of a study."""
SETTLE_S = 0.25
"""Time before a piece that is rendered too and cut off, since a recording does not begin with a contact [s]."""
MOVING_M_S = 0.01
"""Speed above which the tip counts as moving [m/s]."""
MODEL_STROKES_S = 30.0
"""Duration of strokes on the model of a texture without recordings [s]."""


@dataclass(frozen=True)
class WrittenStimulus:
    """A texture's stimulus: its file name, the library material that renders it, and their RMS levels [m/s²]."""

    name: str
    material: str
    recorded_m_s2: float
    ours_m_s2: float
    notes: tuple[str, ...]


def write_stimuli(
    folder: Path, data: DataSet, texture: str, material: str, *, seconds: float, seed: int
) -> WrittenStimulus:
    """Write one texture: a recorded piece, the same stroke on a library material, and its action as a table.

    Parameters
    ----------
    folder : Path
        Folder for `recorded/`, `ours/` and `actions/`.
    data : DataSet
        The data set.
    texture : str
        Name of the texture in the data set.
    material : str
        Library material, or words that name one.
    seconds : float
        Duration of the piece [s].
    seed : int
        Seed of the carriers, and of the strokes on a texture that has a model instead of recordings.

    Raises
    ------
    HnfError
        If the texture or material is unknown, or no recording is long enough.
    """
    found, suggestion = find_material(material)
    has_recordings = bool(data.recordings(texture))
    source = "recordings" if has_recordings else None
    recordings = get_training_recordings(data, texture, MODEL_STROKES_S, seed, source)
    recording, first = _find_longest_touch(recordings, seconds, texture)
    action = _cut_action(recording.action, first, seconds)
    field = load_field()
    rendered = synthesise(field, uniform_stroke(action, found.token, found.mechanics), seed=seed)
    start = round(first / recording.action.rate * recording.sample_rate) + round(SETTLE_S * recording.sample_rate)
    piece = recording.samples[start : start + round(seconds * recording.sample_rate)]
    piece = resample(piece - piece.mean(), recording.sample_rate, MODEL_RATE_HZ)[0]
    ours = rendered.signal.samples[round(SETTLE_S * MODEL_RATE_HZ) :][: len(piece)]
    name = normalise_name(texture)
    facts = {"material": texture, "source": Path(recording.source).name}
    recorded = Signal(piece[: len(ours)].astype(np.float32), MODEL_RATE_HZ, seed, facts)
    synthetic = replace(
        rendered.signal, samples=ours, provenance={**rendered.signal.provenance, "material": found.name}
    )
    write_wav(folder / RECORDED / f"{name}.wav", recorded)
    write_wav(folder / OURS / f"{name}.wav", synthetic)
    write_action_csv(folder / ACTIONS / f"{name}.csv", action)  # with SETTLE_S before the piece
    notes = [*recording.notes, *rendered.warnings]
    if not has_recordings:
        notes.insert(0, f"{texture}: there are no recordings, so the data set's model stands for them")
    if suggestion is not None:
        notes.insert(0, f"{texture}: {found.name} is taken, {suggestion.probability:.0%} likely by its words")
    return WrittenStimulus(name, found.name, recorded.rms, synthetic.rms, tuple(notes))


def _find_longest_touch(recordings: Sequence[Recording], seconds: float, texture: str) -> tuple[Recording, int]:
    """Return the recording and the action sample from which on the tip moves in contact the most; the first of equals.

    The piece, with SETTLE_S before it, lies within the recording.
    """
    best: tuple[float, Recording, int] | None = None
    for recording in recordings:
        action, count = recording.action, round((seconds + SETTLE_S) * recording.action.rate)
        moves = np.concatenate([[0], np.cumsum(action.contact & (action.speed > MOVING_M_S))])
        if len(moves) <= count:
            continue
        touching = moves[count:] - moves[:-count]
        place = int(touching.argmax())
        if best is None or touching[place] > best[0]:
            best = (float(touching[place]), recording, place)
    if best is None:
        raise UsageError(
            f"no recording of {texture!r} lasts {seconds + SETTLE_S:g} s.", remedy="Give a smaller --seconds."
        )
    return best[1], best[2]


def _cut_action(action: Action, first: int, seconds: float) -> Action:
    rows = slice(first, first + round((seconds + SETTLE_S) * action.rate) + 1)
    arrays = {name: getattr(action, name)[rows] for name in ("direction", "speed", "force", "position", "contact")}
    return replace(action, **arrays, force_curve=None)
