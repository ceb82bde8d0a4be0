"""`hnf synth`: synthesise one stroke on one material, without a scene, and write it as WAV.

Long strokes, and high sample rates, are written while they are computed, within the memory of about one minute of
signal.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..action.action import read_action_csv
from ..action.parse_stroke import parse_stroke
from ..action.primitive_path import make_primitive_action
from ..action.primitives import PRIMITIVES
from ..errors import UsageError
from ..export.wav import write_wav, write_wav_stream
from ..field.carriers import MODEL_RATE_HZ
from ..field.field import Field
from ..field.prepare import supports_tolerance
from ..field.range_check import check_ceiling, check_ranges
from ..field.render import CHUNK_SAMPLES, RenderedChunk, render_chunks
from ..field.resampling import (
    MAX_RATE_HZ,
    MIN_RATE_HZ,
    check_rates,
    count_outputs,
    rate_warnings,
    resample_stream,
)
from ..field.stroke import StrokeInput, resample_action, sample_count, uniform_stroke
from ..field.synthesis import synthesise, tolerance_warning
from ..field.weights import load_field, load_field_for_encoders, load_material_field, read_trained_material
from ..material.hnf_file import HNF_SUFFIX, read_hnf, with_library_defaults
from ..material.library import LibraryMaterial
from ..material.probe import PROBES
from ..material.ranking import find_material
from ..material.token import split_encoders
from ..progress import Progress, ProgressBar
from ..signal import Signal
from .commands import HELP, parse_seed

MAX_IN_MEMORY_S = 120.0
"""Longest duration of a signal that is computed in one piece [s]."""
MAX_IN_MEMORY_SAMPLES = 2**24
"""Most output samples of a signal that is computed in one piece, which takes a few hundred MB at most."""


@dataclass(frozen=True)
class WrittenSignal:
    """Summary of a written signal; fields as `hnf synth --json` names them."""

    sample_rate: float
    duration_s: float
    rms: float
    peak: float
    confidence: float
    warnings: tuple[str, ...]


def is_long(duration_s: float, rate: float) -> bool:
    """Return whether a signal of this duration at `rate` Hz is to be written while it is computed."""
    return duration_s > MAX_IN_MEMORY_S or duration_s * rate > MAX_IN_MEMORY_SAMPLES


class _SignalMeter:
    """Running statistics of a signal that is computed in chunks."""

    def __init__(self) -> None:
        self.max_amplitude, self.max_residual, self.square, self.peak = 0.0, 0.0, 0.0, 0.0

    def iterate_samples(self, chunks: Iterator[RenderedChunk], total: int) -> Iterator[NDArray[np.float64]]:
        """Yield the samples of each chunk, record its largest amplitude and evaluation error, and show the progress."""
        progress_bar, done = ProgressBar(), 0
        for chunk in chunks:
            self.max_amplitude, self.max_residual = (
                max(self.max_amplitude, chunk.loudest),
                max(self.max_residual, chunk.residual_power),
            )
            yield chunk.samples
            done += len(chunk.samples)
            progress_bar.show(
                Progress("of the signal is written", done // int(MODEL_RATE_HZ), total // int(MODEL_RATE_HZ))
            )
        progress_bar.close()

    def convert_blocks(self, blocks: Iterator[NDArray[np.float64]]) -> Iterator[NDArray[np.float32]]:
        """Yield blocks as float32 and record their power and peak."""
        for block in blocks:
            out = block.astype(np.float32)
            self.square += float(np.sum(np.square(out, dtype=np.float64)))
            self.peak = max(self.peak, float(np.max(np.abs(out), initial=0.0)))
            yield out


def write_in_chunks(
    path: Path, field: Field, stroke: StrokeInput, *, seed: int, rate: float, facts: Mapping[str, str],
    tolerance: float | None = None, chunk_samples: int = CHUNK_SAMPLES,
) -> WrittenSignal:  # fmt: skip
    """Synthesise a stroke chunk by chunk into a WAV.

    The samples equal those of `synthesise` within 1e-6 of their RMS or, with a tolerance, approximate those of the
    field to within it.

    Parameters
    ----------
    path : Path
        File to write; an earlier file is unharmed if writing fails.
    field : Field
        The field.
    stroke : StrokeInput
        Action and material.
    seed : int
        Seed of the noise.
    rate : float
        Output sample rate [Hz].
    facts : mapping of str to str
        Further facts for the WAV's provenance, by name.
    tolerance : float or None
        Largest relative RMS error of evaluating the field at fewer samples; None for exact evaluation.
    chunk_samples : int
        Samples computed at once.

    Returns
    -------
    WrittenSignal
        Summary of the signal.

    Raises
    ------
    HnfError
        As `synthesise` and `write_wav`; for a signal that is too long for a WAV before anything is computed.
    """
    action, _ = resample_action(stroke)
    check_rates(MODEL_RATE_HZ, rate)
    total, meter = sample_count(action), _SignalMeter()
    model_samples = meter.iterate_samples(
        render_chunks(field, stroke, seed=seed, length=chunk_samples, tolerance=tolerance), total
    )
    count = count_outputs(total, MODEL_RATE_HZ, rate)
    origin = {"probe": action.probe, "field": field.identity, "model_rate_hz": f"{MODEL_RATE_HZ:g}"}
    template = Signal(np.zeros(0, dtype=np.float32), rate, seed, {**origin, **facts})
    write_wav_stream(
        path, template, count, meter.convert_blocks(resample_stream(model_samples, total, MODEL_RATE_HZ, rate))
    )
    confidence, warnings = check_ranges(field, stroke, action)
    warnings += (
        *check_ceiling(field.config, meter.max_amplitude),
        *rate_warnings(rate),
        *tolerance_warning(meter.max_residual, tolerance),
    )
    rms = float(np.sqrt(meter.square / count)) if count else 0.0
    return WrittenSignal(rate, count / rate, rms, meter.peak, confidence, warnings)


_NEGATIVE_NUMBER = re.compile(r"^-(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?$|^-(inf|nan)$", re.IGNORECASE)
"""Pattern for argparse, whose own takes -1e1 for an unknown option."""
MAX_TOLERANCE_DB, MIN_TOLERANCE_DB = -10.0, -45.0
"""Accepted tolerances [dB]; below the lower one even the reference deviates in single samples."""


def add_parser(verbs: Any) -> argparse.ArgumentParser:
    """Add `hnf synth`."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        "synth",
        help=HELP["synth"],
        description="Synthesise the vibration of a stroke on a library material, on one kept as a file (.hnf), or on "
        "the one that a weights file was trained for, and write it as float32 WAV in m/s². Needs no Blender.",
    )
    material = parser.add_mutually_exclusive_group(required=True)
    material.add_argument(
        "--material",
        metavar="NAME|FILE.hnf",
        help="a library material, see `hnf materials`, or words that name one; or one kept as a file",
    )
    material.add_argument("--weights", type=Path, metavar="FILE", help="a field trained for one material")
    stroke = parser.add_mutually_exclusive_group(required=True)
    stroke.add_argument(
        "--stroke", type=parse_stroke, metavar="WORDS",
        help=f"{', '.join(PRIMITIVES)}; or in words: 'scrape right to left, 1.5 N, 80 mm/s'",
    )  # fmt: skip
    stroke.add_argument(
        "--action", type=Path, metavar="FILE.csv", help="a table time_s,direction_rad,speed_m_s,force_n; any time grid"
    )
    parser.add_argument("--rate", type=float, default=MODEL_RATE_HZ, metavar="HZ", help="sample rate (default 10000)")
    parser.add_argument(
        "--tolerance", type=float, metavar="DB",
        help=f"evaluate the field where the stroke asks for it, to within {MAX_TOLERANCE_DB:g} to "
        f"{MIN_TOLERANCE_DB:g} dB of the "
        "model taken literally (default: 200 times a second, whatever that gives)",
    )  # fmt: skip
    parser._negative_number_matcher = _NEGATIVE_NUMBER
    parser.add_argument(
        "--seed", type=parse_seed, default=0, metavar="N", help="another seed, another draw of the same touch"
    )
    parser.add_argument("--probe", choices=sorted(PROBES), default="pen", help="what touches (default pen)")
    parser.add_argument("--out", type=Path, required=True, metavar="X.wav", help="file to write")
    parser.add_argument("--json", action="store_true", help="print the result as one JSON object")
    return parser


def run(arguments: argparse.Namespace) -> int:
    """Run `hnf synth`; return the exit code. Raises HnfError."""
    if not MIN_RATE_HZ <= arguments.rate <= MAX_RATE_HZ:
        raise UsageError(
            f"--rate {arguments.rate:.10g}: not within {MIN_RATE_HZ:.0f} to {MAX_RATE_HZ:.0f} Hz.",
            remedy="Give e.g. 10000.",
        )
    if arguments.rate != round(arguments.rate):
        raise UsageError(f"--rate {arguments.rate:.10g}: a WAV needs a whole number of Hz.", remedy="Give e.g. 10000.")
    tolerance = _db_to_ratio(arguments.tolerance)
    field, material, notes = _load_field_and_material(arguments.material, arguments.weights)
    action_warnings = [*notes]
    if arguments.action is not None:
        action = read_action_csv(arguments.action, arguments.probe, warn=action_warnings.append)
        stroke_name = arguments.action.name
    else:
        action = replace(make_primitive_action(arguments.stroke, seed=arguments.seed), probe=arguments.probe)
        stroke_name = arguments.stroke.name
    stroke = uniform_stroke(action, material.token, material.mechanics)
    if tolerance is not None and not supports_tolerance(field, stroke):
        raise UsageError(
            "--tolerance has no say over these weights: their heads lag one another, and are heard at every state.",
            remedy="Leave it out, or train with --accumulation past.",
        )
    facts = {"stroke": stroke_name, "material": material.name}
    write = write_in_chunks if is_long(action.duration_s, arguments.rate) else _write_in_memory
    written = write(
        arguments.out, field, stroke, seed=arguments.seed, rate=arguments.rate, facts=facts, tolerance=tolerance
    )
    warnings = (*action_warnings, *written.warnings)
    for warning in warnings:
        print(f"hnf: {warning}", file=sys.stderr)
    record = {
        "wav": str(arguments.out),
        "material": material.name,
        "stroke": stroke_name,
        "probe": arguments.probe,
        "seed": arguments.seed,
        "sample_rate_hz": written.sample_rate,
        "duration_s": written.duration_s,
        "rms_m_s2": written.rms,
        "peak_m_s2": written.peak,
        "confidence": written.confidence,
        "warnings": list(warnings),
    }
    if arguments.json:
        print(json.dumps(record, indent=1))
    else:
        print(
            f"{arguments.out}: {stroke_name} on {material.name}, {written.duration_s:.2f} s, {written.rms:.3g} m/s² RMS"
        )
    return 0


def _write_in_memory(
    path: Path, field: Field, stroke: StrokeInput, *, seed: int, rate: float, facts: Mapping[str, str],
    tolerance: float | None,
) -> WrittenSignal:  # fmt: skip
    result = synthesise(field, stroke, seed=seed, sample_rate=rate, tolerance=tolerance)
    signal = replace(result.signal, provenance={**result.signal.provenance, **facts})
    write_wav(path, signal)
    peak = float(np.max(np.abs(signal.samples), initial=0.0))
    return WrittenSignal(signal.sample_rate, signal.duration_s, signal.rms, peak, result.confidence, result.warnings)


def _db_to_ratio(tolerance_db: float | None) -> float | None:
    if tolerance_db is None:
        return None
    if not MIN_TOLERANCE_DB <= tolerance_db <= MAX_TOLERANCE_DB:
        raise UsageError(
            f"--tolerance {tolerance_db:g}: not within {MAX_TOLERANCE_DB:g} to {MIN_TOLERANCE_DB:g} dB.",
            remedy="Give e.g. -40.",
        )
    return float(10.0 ** (tolerance_db / 20.0))


def _load_field_and_material(
    material: str | None, weights: Path | None
) -> tuple[Field, LibraryMaterial, tuple[str, ...]]:
    """Return the field, a material that it knows (from the library, a `.hnf` file, or its own), and notes."""
    if material is None:
        field = load_field(weights)
        return field, read_trained_material(field, str(weights)), ()
    if material.lower().endswith(HNF_SUFFIX):
        described = read_hnf(Path(material))
        learned = load_material_field(described)
        if learned is not None:
            return learned, read_trained_material(learned, material), ()
        return load_field_for_encoders(split_encoders(described.encoder)), with_library_defaults(described), ()
    found, suggestion = find_material(material)
    if suggestion is None:
        return load_field(), found, ()
    note = f"no library material is called {material!r}: {found.name} is taken, {suggestion.probability:.0%} likely "
    return load_field(), found, (f"{note}by its words ({suggestion.reason}).",)
