"""A study as one HTML page that needs no network: its plan, its stimuli and a small program, with responses as CSV.

The page presents the same trials in the same order as `hnf study run`, and writes the same CSV. Its content security
policy allows the page's own script and style alone, by their hashes.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
from dataclasses import asdict
from pathlib import Path

import numpy as np

from ..errors import FileError, UsageError
from ..export.wav import LISTEN_PEAK_DBFS, read_wav
from ..files import write_text
from .plan import Plan, find_stimulus
from .responses import COLUMNS

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
