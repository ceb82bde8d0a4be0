"""Stimuli from a data set: pieces of recordings, and the same strokes on library materials, as WAVs side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..action.action import Action, write_action_csv
from ..datasets.recording import DataSet, Recording, normalise_name
from ..datasets.registry import get_training_recordings
from ..errors import UsageError
from ..export.wav import write_wav
from ..field.carriers import MODEL_RATE_HZ
from ..field.resampling import resample
from ..field.stroke import uniform_stroke
from ..field.synthesis import synthesise
from ..field.weights import load_field
from ..material.ranking import find_material
from ..signal import Signal

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
