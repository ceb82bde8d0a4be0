"""Presentation of a study: stimuli on an actuator with keys in a terminal, or one HTML page that needs no network.

The page presents the same trials in the same order as `hnf study run`, and writes the same CSV. Its content security
policy allows the page's own script and style alone, by their hashes.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
import os
import re
import sys
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TextIO

import numpy as np

from ..actuators.measure.inverse_filter import make_compensation
from ..actuators.profile import ActuatorProfile
from ..actuators.sources import Acceleration, BufferSource, db_to_gain, read_acceleration
from ..actuators.stream import Stream, StreamReport
from ..actuators.stream_targets import Target, make_sink
from ..errors import DeviceError, FileError, UsageError
from ..export.wav import LISTEN_PEAK_DBFS, read_wav
from ..files import write_text
from .plan import Plan, Trial, find_stimulus
from .results import (
    COLUMNS,
    FIRST,
    SECOND,
    Response,
    append_response,
    find_open_trials,
    get_responses_path,
    read_responses,
)

GAP_S = 0.5
"""Silence between two stimuli [s]."""
FIRST_KEY, SECOND_KEY, AGAIN_KEY, QUIT_KEY = "1", "2", "r", "q"


@dataclass(frozen=True)
class Output:
    """Output that stimuli are played on: a target of `hnf stream`, the actuator's profile, and one gain for all."""

    target: Target
    profile: ActuatorProfile
    gain_db: float = 0.0
    raw: bool = False

    def play(self, found: Acceleration) -> StreamReport:
        """Play a stimulus to its end; raise DeviceError if the device fails."""
        samples = found.samples * np.float32(db_to_gain(self.gain_db))
        stages = () if self.raw else make_compensation(self.profile, found.rate_hz, 1)
        sink = make_sink(self.target, found.rate_hz, self.profile.limits)
        source = BufferSource(samples, found.rate_hz)
        with Stream(source, sink, self.profile.limits, processors=stages, low_latency=False) as stream:
            stream.start()
            stream.wait()
        report = stream.report
        if report.problem:
            raise DeviceError(report.problem)
        return report


class Keyboard:
    """Single keys of a terminal, or the first letters of the lines of an input that is none."""

    def __init__(self) -> None:
        self._stream = sys.stdin

    def discard(self) -> None:
        """Forget the keys pressed until now in a terminal: those while a stimulus plays are no response to it."""
        if not self._stream.isatty():
            return
        try:
            import termios
        except ImportError:  # Windows
            import msvcrt

            while msvcrt.kbhit():  # type: ignore[attr-defined,unused-ignore]
                msvcrt.getwch()  # type: ignore[attr-defined,unused-ignore]
        else:
            termios.tcflush(self._stream, termios.TCIFLUSH)

    def read(self) -> str:
        """Return the next key; "" at the end of the input."""
        if not self._stream.isatty():
            line = self._stream.readline()
            return (line.strip() or " ")[0] if line else ""
        try:
            import termios
            import tty
        except ImportError:  # Windows
            import msvcrt

            return str(msvcrt.getwch())  # type: ignore[attr-defined,unused-ignore]
        settings = termios.tcgetattr(self._stream)
        try:
            tty.setcbreak(self._stream, termios.TCSANOW)
            return os.read(self._stream.fileno(), 1).decode("ascii", "replace")
        finally:
            termios.tcsetattr(self._stream, termios.TCSANOW, settings)


def find_max_gain_db(stimuli: Mapping[str, Acceleration], profile: ActuatorProfile) -> float:
    """Return the largest gain [dB] at which the peak of no stimulus exceeds what the profile allows."""
    largest = max(found.peak_m_s2 for found in stimuli.values())
    return float(20.0 * np.log10(profile.limits.peak * profile.limits.full_scale_m_s2 / largest))


def read_stimuli(folder: Path, plan: Plan, profile: ActuatorProfile) -> dict[str, Acceleration]:
    """Read all stimuli of a study, in m/s²."""
    return {
        stimulus.id: read_acceleration(find_stimulus(folder, stimulus.id), profile.limits) for stimulus in plan.stimuli
    }


def run_session(
    folder: Path, plan: Plan, participant: str, output: Output, stimuli: Mapping[str, Acceleration],
    keyboard: Keyboard, out: TextIO,
) -> int:  # fmt: skip
    """Run the open trials of a participant; return how many are still open, above 0 if the participant stopped.

    Every response is on the disk before the next trial begins.
    """
    path = get_responses_path(folder, participant)
    earlier = read_responses(path, plan) if path.exists() else []
    trials = find_open_trials(plan, participant, earlier)
    total = len(trials) + len(earlier)
    keys = f"{FIRST_KEY}: the first   {SECOND_KEY}: the second   {AGAIN_KEY}: again   {QUIT_KEY}: stop here"
    for index, trial in enumerate(trials):
        print(f"\nTrial {trial.number} of {total}", file=out)
        began, plays, reports = time.monotonic(), 0, []
        key = AGAIN_KEY
        while key == AGAIN_KEY:
            reports += _present(trial, output, stimuli, out)
            plays += 1
            keyboard.discard()
            print(f"{plan.question}   [{keys}]", file=out, flush=True)
            while (key := keyboard.read().lower()) not in (FIRST_KEY, SECOND_KEY, AGAIN_KEY, QUIT_KEY, ""):
                pass
        if key in (QUIT_KEY, ""):
            return len(trials) - index
        response = Response(
            plan.id, participant, trial.number, trial.pair, trial.repeat, trial.reference, trial.first, trial.second,
            FIRST if key == FIRST_KEY else SECOND, plays, round(time.monotonic() - began, 3),
            sum(report.limited_samples + report.device_limited_samples for report in reports),
            sum(report.underruns for report in reports), datetime.now(UTC).isoformat(timespec="seconds"),
        )  # fmt: skip
        append_response(path, plan, response)
    return 0


def _present(trial: Trial, output: Output, stimuli: Mapping[str, Acceleration], out: TextIO) -> list[StreamReport]:
    """Play the reference, the first and the second stimulus of a trial, with gaps."""
    named = (("reference", trial.reference), (FIRST, trial.first), (SECOND, trial.second))
    reports: list[StreamReport] = []
    for word, stimulus in named:
        if stimulus:
            if reports:
                time.sleep(GAP_S)
            print(f"  {word} …", file=out, flush=True)
            reports.append(output.play(stimuli[stimulus]))
    return reports


TEMPLATE = Path(__file__).parent / "data" / "page.html"
MIN_PAGE_RATE_HZ, MAX_PAGE_RATE_HZ = 8_000.0, 96_000.0
"""Sample rates that every browser plays [Hz] (Web Audio)."""


def write_page(path: Path, folder: Path, plan: Plan, full_scale_m_s2: float | None = None) -> float:
    """Write the page of a study.

    Parameters
    ----------
    path : Path
        HTML file to write.
    folder : Path
        Folder of the study.
    plan : Plan
        Its plan.
    full_scale_m_s2 : float or None
        Acceleration that the sound output's full scale stands for [m/s²]: one for all stimuli, so that their levels
        differ as recorded. None brings the strongest just below full scale.

    Returns
    -------
    float
        The full scale that was used [m/s²].

    Raises
    ------
    UsageError
        If the full scale would clip a stimulus, or a browser cannot play a stimulus' rate.
    FileError
        If a file cannot be read or written.
    """
    signals = {stimulus.id: read_wav(find_stimulus(folder, stimulus.id)) for stimulus in plan.stimuli}
    peak = max(float(np.abs(signal.samples).max(initial=0.0)) for signal in signals.values())
    full_scale = peak * 10.0 ** (-LISTEN_PEAK_DBFS / 20.0) if full_scale_m_s2 is None else full_scale_m_s2
    if not peak <= full_scale < np.inf:
        raise UsageError(
            f"--full-scale {full_scale:g} would clip a stimulus of {peak:.4g} m/s².",
            remedy=f"Give at least {peak:.4g}.",
        )
    for signal in signals.values():
        if not MIN_PAGE_RATE_HZ <= signal.sample_rate <= MAX_PAGE_RATE_HZ:
            raise UsageError(
                f"a browser does not play stimuli of {signal.sample_rate:g} Hz.",
                remedy=f"Make the study with WAVs of {MIN_PAGE_RATE_HZ:g} to {MAX_PAGE_RATE_HZ:g} Hz.",
            )
    record = {
        "study": plan.id,
        "question": plan.question,
        "repeats": plan.repeats,
        "pairs": [asdict(pair) for pair in plan.pairs],
        "columns": COLUMNS,
        "stimuli": {
            name: {
                "rate": signal.sample_rate,
                "samples": base64.b64encode((signal.samples / full_scale).astype("<f4").tobytes()).decode("ascii"),
            }
            for name, signal in signals.items()
        },
    }
    data = json.dumps(record, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    text = _fill_template({"question": html.escape(plan.question), "study": plan.id, "data": data})
    write_text(path, text)
    return full_scale


def _fill_template(values: dict[str, str]) -> str:
    """Return the template with its {{names}} replaced, among them the policy with the hashes of script and style."""
    try:
        text = TEMPLATE.read_text(encoding="utf-8")
    except OSError as error:
        raise FileError("is missing.", where=str(TEMPLATE), remedy="Install the package again.") from error
    sources = []
    for tag, directive in (("script", "script-src"), ("style", "style-src")):
        match = re.search(rf"<{tag}>(.*?)</{tag}>", text, re.DOTALL)
        assert match is not None
        digest = base64.b64encode(hashlib.sha256(match[1].encode("utf-8")).digest()).decode("ascii")
        sources.append(f"{directive} 'sha256-{digest}'")
    policy = "; ".join(["default-src 'none'", *sources, "base-uri 'none'", "form-action 'none'"])
    replaced = {**values, "policy": policy}
    return re.sub(r"\{\{(\w+)\}\}", lambda match: replaced[match[1]], text)
