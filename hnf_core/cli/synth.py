"""`hnf synth`: synthesise one stroke on one material, without a scene, and write it as WAV.

Long strokes, and high sample rates, are written while they are computed, within the memory of about one minute of
signal.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..action.action import ACTION_RATE_HZ, read_action_csv, write_action_csv
from ..action.primitive_path import make_primitive_action
from ..action.primitives import PRIMITIVES, Primitive
from ..errors import UsageError
from ..export.wav import write_wav, write_wav_channels, write_wav_stream
from ..field.adaptive_sampling import DEFAULT_TOLERANCE
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
from ..field.synthesis import AXES, synthesise, synthesise_axes, tolerance_warning
from ..field.weights import load_field, read_trained_material, resolve_material_field
from ..material.fuse import ROUTE_CONFIDENCE, fuse, fuse_measured_over_predicted
from ..material.hnf_file import HNF_SUFFIX, read_hnf
from ..material.library import LibraryMaterial
from ..material.probe import PROBE_NAMES, get_probe
from ..material.ranking import find_material
from ..progress import Progress, ProgressBar
from ..signal import Signal
from ..tactile.tactile_map import Route
from .commands import HELP, parse_seed
from .describe import CAMERA, TOUCH_OPTIONS, add_touch_options, describe_look, describe_touch_image
from .export import check_output

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

    The samples equal those of `synthesise` within 1e-6 of their RMS.

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
        As in `synthesise`.
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


def _read_stroke(words: str) -> Primitive:
    """Parse --stroke. Its 200 patterns are compiled when they are asked for: a table of an action needs none."""
    from ..action.parse_stroke import parse_stroke

    return parse_stroke(words)


_DEFAULT_TOLERANCE_DB = 20.0 * math.log10(DEFAULT_TOLERANCE)
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
        "the one that a weights file was trained for, or on what a picture of a touch sensor shows, and write it as "
        "float32 WAV in m/s². Needs no Blender.",
    )
    parser.add_argument(
        "--touch", type=Path, metavar="IMAGE",
        help="a picture of a GelSight or DIGIT: its relief is felt; mechanics and the rest are the nearest "
        "material's, or --material's",
    )  # fmt: skip
    add_touch_options(parser)
    material = parser.add_mutually_exclusive_group()
    material.add_argument(
        "--material",
        metavar="NAME|FILE.hnf",
        help="a library material, see `hnf materials`, or words that name one; or one kept as a file",
    )
    material.add_argument("--weights", type=Path, metavar="FILE", help="a field trained for one material")
    stroke = parser.add_mutually_exclusive_group(required=True)
    stroke.add_argument(
        "--stroke", type=_read_stroke, metavar="WORDS",
        help=f"{', '.join(PRIMITIVES)}; or in words: 'scrape right to left, 1.5 N, 80 mm/s', 'tap twice, then rub "
        "slowly in circles'",
    )  # fmt: skip
    stroke.add_argument(
        "--action", type=Path, metavar="FILE.csv", help="a table time_s,direction_rad,speed_m_s,force_n; any time grid"
    )
    parser.add_argument(
        "--write-action", type=Path, metavar="FILE.csv", help="write the stroke as a table that --action reads, too"
    )
    parser.add_argument("--rate", type=float, default=MODEL_RATE_HZ, metavar="HZ", help="sample rate (default 10000)")
    parser.add_argument(
        "--tolerance", type=float, metavar="DB",
        help=f"how near to the exact model, {MAX_TOLERANCE_DB:g} to {MIN_TOLERANCE_DB:g} dB (default "
        f"{_DEFAULT_TOLERANCE_DB:g}); a warning says where it is not reached",
    )  # fmt: skip
    parser._negative_number_matcher = _NEGATIVE_NUMBER
    parser.add_argument(
        "--seed", type=parse_seed, default=0, metavar="N", help="another seed, another draw of the same touch"
    )
    parser.add_argument(
        "--probe",
        default="pen",
        metavar="PROBE",
        help=f"what touches: {', '.join(PROBE_NAMES)}, or a probe file (.toml); default pen",
    )
    parser.add_argument(
        "--axes", action="store_true", help="three channels: along the stroke, across it, along the surface's normal"
    )
    parser.add_argument("--out", type=Path, required=True, metavar="X.wav", help="file to write")
    parser.add_argument("--json", action="store_true", help="print the result as one JSON object")
    return parser


def check_arguments(arguments: argparse.Namespace) -> None:
    """Check that a material is given and that the options of a touch image have one; raise UsageError otherwise."""
    material, touch = arguments.material, arguments.touch
    if material is None and arguments.weights is None and touch is None:
        raise UsageError("a material is needed.", remedy="Give --material NAME, --touch IMAGE or --weights FILE.")
    if touch is None and any(getattr(arguments, name) is not None for name in TOUCH_OPTIONS):
        raise UsageError("--sensor, --background and the like say how --touch is decoded.", remedy="Give --touch.")
    if touch is not None and (arguments.weights or (material or "").lower().endswith(HNF_SUFFIX)):
        raise UsageError("--touch goes with a library material.", remedy="Leave out --weights, or name a material.")


def run(arguments: argparse.Namespace) -> int:
    """Run `hnf synth`; return the exit code. Raises HnfError."""
    check_arguments(arguments)
    if not MIN_RATE_HZ <= arguments.rate <= MAX_RATE_HZ:
        raise UsageError(
            f"--rate {arguments.rate:.10g}: not within {MIN_RATE_HZ:.0f} to {MAX_RATE_HZ:.0f} Hz.",
            remedy="Give e.g. 10000.",
        )
    if arguments.rate != round(arguments.rate):
        raise UsageError(f"--rate {arguments.rate:.10g}: a WAV needs a whole number of Hz.", remedy="Give e.g. 10000.")
    if arguments.write_action is not None:
        if arguments.action is not None:
            raise UsageError("--write-action with --action: the table is there.", remedy="Leave out one of them.")
        check_output(arguments.write_action, ".csv", arguments.out, "--write-action")
    get_probe(arguments.probe)  # Raises what is wrong with it before anything is computed.
    tolerance = _db_to_ratio(arguments.tolerance)
    if arguments.touch is None:
        field, material, notes = _load_field_and_material(arguments.material, arguments.weights)
        facts = {"material": material.name}
    else:
        field, material, notes, facts = _load_touch(arguments)
    action_warnings = [*notes]
    if arguments.action is not None:
        rate = MODEL_RATE_HZ if field.metadata.get("actions") == "raw" else ACTION_RATE_HZ
        action = read_action_csv(arguments.action, arguments.probe, rate, warn=action_warnings.append)
        stroke_name = arguments.action.name
    else:
        action = replace(make_primitive_action(arguments.stroke, seed=arguments.seed), probe=arguments.probe)
        stroke_name = arguments.stroke.name
        if arguments.write_action is not None:
            write_action_csv(arguments.write_action, action)
    stroke = uniform_stroke(action, material.token, material.mechanics)
    if tolerance is not None and not supports_tolerance(field):
        raise UsageError(
            "--tolerance has no say over these weights, which are evaluated at every state.",
            remedy="Leave it out, or train with --accumulation past.",
        )
    facts = {"stroke": stroke_name, **facts}
    if arguments.axes and (tolerance is not None or is_long(action.duration_s, arguments.rate)):
        raise UsageError(
            f"--axes works for strokes of up to {MAX_IN_MEMORY_S:.0f} s, without --tolerance.",
            remedy="Shorten the stroke, or leave one of them out.",
        )
    write = write_in_chunks if is_long(action.duration_s, arguments.rate) else _write_in_memory
    if arguments.axes:
        written = _write_axes(arguments.out, field, stroke, arguments.seed, arguments.rate, facts)
    else:
        written = write(
            arguments.out, field, stroke, seed=arguments.seed, rate=arguments.rate, facts=facts, tolerance=tolerance
        )
    warnings = (*action_warnings, *written.warnings)
    for warning in warnings:
        print(f"hnf: {warning}", file=sys.stderr)
    record = {
        "wav": str(arguments.out),
        "action": None if arguments.write_action is None else str(arguments.write_action),
        **facts,
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


def _write_axes(
    path: Path, field: Field, stroke: StrokeInput, seed: int, rate: float, facts: Mapping[str, str]
) -> WrittenSignal:
    """Write the three axes of a stroke as channels; RMS and peak are of all axes together."""
    results = synthesise_axes(field, stroke, seed=seed, sample_rate=rate)
    named = {**facts, "channels": ", ".join(AXES)}
    signals = [replace(each.signal, provenance={**each.signal.provenance, **named}) for each in results]
    write_wav_channels(path, signals)
    power = np.sum([np.square(each.samples, dtype=np.float64) for each in signals], axis=0)
    first, warnings = signals[0], tuple(dict.fromkeys(text for each in results for text in each.warnings))
    rms, peak = float(np.sqrt(power.mean())), float(np.sqrt(power.max(initial=0.0)))
    return WrittenSignal(first.sample_rate, first.duration_s, rms, peak, results[0].confidence, warnings)


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
        return *resolve_material_field(read_hnf(Path(material)), material), ()
    found, suggestion = find_material(material)
    if suggestion is None:
        return load_field(), found, ()
    note = f"no library material is called {material!r}: {found.name} is taken, {suggestion.probability:.0%} likely "
    return load_field(), found, (f"{note}by its words ({suggestion.reason}).",)


def _load_touch(arguments: argparse.Namespace) -> tuple[Field, LibraryMaterial, tuple[str, ...], dict[str, str]]:
    """Return the field, the material of a touch image or look, notes, and facts for the provenance."""
    named, is_look = arguments.material, arguments.sensor == CAMERA
    described = None if is_look else describe_touch_image(arguments.touch, arguments)
    match = describe_look(arguments.touch, arguments) if described is None else described.match
    notes = [] if described is None else [f"{note}." for note in described.decoded.notes]
    found = [] if match is None else [*match.materials]
    if described is not None and not found:
        found = [(each.name, each.confidence) for each in described.ranked]
    nearest, aptness = found[0]
    material, suggestion = find_material(nearest if named is None else named)
    confidence = aptness if named is None else 1.0 if suggestion is None else suggestion.confidence
    if named is None:
        notes.append(f"{nearest} is the nearest material, {aptness:.0%} apt: its mechanics are taken.")
    sensor, source, prior = CAMERA, "the space of --space", material.token
    if match is not None:
        bridged = fuse(match.token, prior, confidence, Route.PREDICTED)
    if described is None:
        fused = bridged
    else:
        tactile_map = described.decoded.tactile_map
        sensor, source, route = tactile_map.sensor, tactile_map.height_source, tactile_map.route
        if match is None:
            fused = fuse(described.token, prior, confidence, route)
        elif route is Route.MEASURED:
            fused = fuse_measured_over_predicted(described.token, match.token, prior, confidence)
        else:
            fused = bridged
    facts = {
        "material": material.name,
        "touch": arguments.touch.name,
        "touch_sensor": sensor,
        "touch_decoded_by": source,
        "touch_bands": " ".join(route.value for route in fused.routes),
        "touch_confidence": f"{np.mean([ROUTE_CONFIDENCE.get(route, 0.0) for route in fused.routes]):.2f}",
        **({} if match is None else {"touch_space": arguments.space.name}),
    }
    return load_field(), replace(material, token=fused.values), tuple(notes), facts
