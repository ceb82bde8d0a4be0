"""Touch every model under a folder by the product's own command, one process each, and tell what became of each.

A model is touched, refused in one line, out of time, or at fault: with a traceback, killed, or with a result that no
line explains. Silence and level are measured on the WAVs; what was skipped and why is what report.json says.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

import hnf_core
from hnf_core.errors import FileError, SceneError
from hnf_core.export.wav import read_wav_with_units
from hnf_core.progress import Progress, ProgressCallback, ignore_progress

COMMAND = (sys.executable, "-c", "import sys; from hnf_blender.cli import main; sys.exit(main(sys.argv[1:]))")
"""`hnf`, with the Python that runs this."""
JSON_SCENES = ("transforms.json", "meta.json")
"""Files of JSON that are scenes by their name; other JSON is no model."""
MAX_SILENCE = 0.05
"""Largest silent fraction of a stroke's time that needs no line."""
MAX_RMS_M_S2 = 100.0
"""Largest RMS that is believed of a touched surface [m/s²]."""
SILENT_M_S2 = 1e-4
"""Acceleration below which a frame counts as silent [m/s²]."""
FRAME_S = 0.01
Runner = Callable[[Sequence[str], float], tuple[int | None, str]]
"""Runs words within seconds; returns the exit code, None if time was up, and what it printed as errors."""


@dataclass(frozen=True)
class Outcome:
    """Result of touching one model.

    Attributes
    ----------
    file : str
        Path inside the folder.
    kind : str
        "touched", "refused", "out of time" or "at fault".
    why : str
        The refusal, or what is at fault; "" for a touched one.
    strokes : int
        Number of strokes.
    skipped : list of str
        What was not touched, with its reason.
    silence : float
        Largest silent fraction of a stroke's time.
    rms_m_s2 : float
        Largest RMS of a stroke [m/s²].
    seconds : float
        Time of the process [s].
    """

    file: str
    kind: str
    why: str = ""
    strokes: int = 0
    skipped: list[str] = field(default_factory=list)
    silence: float = 0.0
    rms_m_s2: float = 0.0
    seconds: float = 0.0


def find_models(folder: Path) -> list[Path]:
    """Return the scene files under a folder, sorted; raise FileError if there is none."""
    from hnf_blender.bridge.importers import SCENE_SUFFIXES

    found = [
        path
        for path in sorted(folder.rglob("*"))
        if path.suffix.lower() in SCENE_SUFFIXES
        and path.is_file()
        and (path.suffix.lower() != ".json" or path.name in JSON_SCENES)
        and not any(part.startswith(".") for part in path.relative_to(folder).parts)
    ]
    if not found:
        raise FileError("holds no model.", where=str(folder), remedy="Give a folder of .glb, .usd, .fbx … files.")
    return found


def run_command(words: Sequence[str], limit_s: float) -> tuple[int | None, str]:
    """Run a command; return its exit code, None if it was killed after `limit_s`, and its error output."""
    checkout = str(Path(hnf_core.__file__).parents[1])
    paths = filter(None, [checkout, os.environ.get("PYTHONPATH")])
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    try:
        done = subprocess.run(
            words, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, timeout=limit_s, check=False
        )
    except subprocess.TimeoutExpired as error:
        return None, (error.stderr or b"").decode(errors="replace")
    return done.returncode, done.stderr.decode(errors="replace")


def measure_corpus(
    folder: Path,
    out: Path,
    *,
    limit_s: float = 600.0,
    words: Sequence[str] = (),
    run: Runner = run_command,
    progress: ProgressCallback = ignore_progress,
) -> list[Outcome]:
    """Touch every model under `folder`.

    Parameters
    ----------
    folder, out : Path
        Folder of models, and the one that gets a folder of results for each.
    limit_s : float
        Longest time of one model [s].
    words : sequence of str
        Further options of `hnf touch`.
    run : callable
        Runs the command.
    progress : callable
        Called before each model.

    Returns
    -------
    list of Outcome
        One for each, in the order of `find_models`.
    """
    models, outcomes = find_models(folder), []
    for number, path in enumerate(models):
        progress(Progress(path.name, number, len(models)))
        name = str(path.relative_to(folder))
        target = out / "touched" / name.replace(os.sep, "__")
        begin = time.monotonic()
        code, errors = run([*COMMAND, "touch", str(path), "--out", str(target), *words], limit_s)
        outcomes.append(judge_run(name, target, code, errors, time.monotonic() - begin))
    return outcomes


def judge_run(name: str, folder: Path, code: int | None, errors: str, seconds: float) -> Outcome:
    """Return what became of a model, from the exit code, the error output and the files of its run."""
    lines = [line for line in errors.splitlines() if line.strip()]
    if "Traceback (most recent call last)" in errors:
        return Outcome(name, "at fault", f"a traceback: {lines[-1][:200]}", seconds=seconds)
    if code is None:
        return Outcome(name, "out of time", seconds=seconds)
    if code < 0:
        return Outcome(name, "at fault", f"killed by signal {-code}", seconds=seconds)
    report_path = folder / "report.json"
    if not report_path.is_file():
        refusals = [line.removeprefix("hnf: ") for line in lines if not line.startswith("note:")]
        if code and len(refusals) == 1:
            return Outcome(name, "refused", refusals[0], seconds=seconds)
        why = "; ".join(refusals)[:200] or "no word"
        return Outcome(name, "at fault", f"exit code {code} and {len(refusals)} lines: {why}", seconds=seconds)
    report = json.loads(report_path.read_text())
    faults, levels, silences = [], [0.0], [0.0]
    for stroke in report["strokes"]:
        silence, rms = measure_wav(folder / stroke["wav"])
        silences.append(silence)
        levels.append(rms)
        if silence > MAX_SILENCE and not any(f"'{stroke['name']}'" in line for line in lines):
            faults.append(f"{stroke['name']}: silent for {silence:.0%} of its time, and no line says so")
        if not rms <= MAX_RMS_M_S2:
            faults.append(f"{stroke['name']}: {rms:.0f} m/s² RMS")
    failed = [str(each.get("why", each)) for each in report["failed"]]
    if not report["strokes"] and not failed:
        faults.append("no stroke, and no line says why")
    kind = "at fault" if faults else "touched" if report["strokes"] else "refused"
    return Outcome(
        file=name,
        kind=kind,
        why="; ".join(faults or failed),
        strokes=len(report["strokes"]),
        skipped=[describe_skipped(each) for each in report["skipped"]],
        silence=max(silences),
        rms_m_s2=max(levels),
        seconds=seconds,
    )


def describe_skipped(entry: Any) -> str:
    """Return an entry of `skipped` in report.json as one text."""
    return ": ".join(str(value) for value in entry.values()) if isinstance(entry, dict) else str(entry)


def measure_wav(path: Path) -> tuple[float, float]:
    """Return the silent fraction of a signal's frames, and its RMS [m/s²]; raise SceneError if it is empty."""
    signal = read_wav_with_units(path)
    samples = signal.samples.astype(np.float64)
    size = max(1, round(FRAME_S * signal.sample_rate))
    frames = samples[: len(samples) // size * size].reshape(-1, size)
    if not len(frames):
        raise SceneError("is shorter than a frame.", where=str(path))
    return float(np.mean(np.abs(frames).max(axis=1) < SILENT_M_S2)), float(np.sqrt(np.mean(np.square(samples))))


def format_corpus(outcomes: list[Outcome]) -> str:
    """Format the counts, a table of all models, and what was skipped for which reason, as Markdown."""
    kinds = ("touched", "refused", "out of time", "at fault")
    counts = ", ".join(f"{sum(each.kind == kind for each in outcomes)} {kind}" for kind in kinds)
    lines = [f"# {len(outcomes)} models: {counts}", ""]
    lines += [
        "| model | | strokes | skipped | silent | RMS [m/s²] | time [s] | why |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for each in outcomes:
        why = each.why.replace("|", "\\|")
        lines.append(
            f"| {each.file} | {each.kind} | {each.strokes} | {len(each.skipped)} | {each.silence:.0%} | "
            f"{each.rms_m_s2:.3g} | {each.seconds:.0f} | {why} |"
        )
    if any(each.skipped for each in outcomes):
        lines += ["", "## Skipped", ""]
        lines += [f"* {each.file}: {reason}" for each in outcomes for reason in each.skipped]
    return "\n".join(lines)


def to_json(outcomes: list[Outcome]) -> list[dict[str, Any]]:
    """Return the outcomes as JSON values."""
    return [asdict(each) for each in outcomes]
