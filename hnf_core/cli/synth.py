"""`hnf synth`: a material and a stroke, without any scene → WAV."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..action.action import Action
from ..action.primitive_path import primitive_action
from ..action.primitives import PRIMITIVES
from ..action.table import read_action_csv
from ..action.words import primitive_of
from ..errors import UsageError
from ..export.wav import write_wav
from ..field.carriers import MODEL_RATE_HZ
from ..field.field import Field
from ..field.stroke import Synthesis, uniform_stroke
from ..field.synthesis import synthesise
from ..field.weights import load_field, own_material
from ..material.library import find
from ..material.material import LibraryMaterial
from ..material.mechanics import PROBES


def add_parser(verbs: Any) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = verbs.add_parser(
        "synth",
        help="write what one stroke on one material feels like as a WAV file",
        description="Synthesise the vibration of a stroke on a library material (or on the one that a weights file was "
        "trained for) and write it as float32 WAV in m/s². Needs no Blender.",
    )
    material = parser.add_mutually_exclusive_group(required=True)
    material.add_argument("--material", metavar="NAME", help="a library material, see `hnf materials`")
    material.add_argument("--weights", type=Path, metavar="FILE", help="a field trained for one material")
    stroke = parser.add_mutually_exclusive_group(required=True)
    stroke.add_argument(
        "--stroke", type=primitive_of, metavar="WORDS",
        help=f"{', '.join(PRIMITIVES)}; or in words: 'scrape right to left, 1.5 N, 80 mm/s'",
    )  # fmt: skip
    stroke.add_argument(
        "--action", type=Path, metavar="FILE.csv", help="a table time_s,direction_rad,speed_m_s,force_n; any time grid"
    )
    parser.add_argument("--rate", type=float, default=MODEL_RATE_HZ, metavar="HZ", help="sample rate (default 10000)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="another seed, another draw of the same touch")
    parser.add_argument("--probe", choices=sorted(PROBES), default="pen", help="what touches (default pen)")
    parser.add_argument("--out", type=Path, required=True, metavar="X.wav", help="file to write")
    parser.add_argument("--json", action="store_true", help="print the result as one JSON object")
    return parser


def run(arguments: argparse.Namespace) -> int:
    """Raises HnfError; returns the exit code."""
    if not 1.0 <= arguments.rate <= 1e7 or arguments.rate != round(arguments.rate):
        raise UsageError(f"--rate {arguments.rate:g}: a WAV needs a whole number of Hz.", remedy="Give e.g. 10000.")
    field = load_field(arguments.weights)
    material = find(arguments.material) if arguments.weights is None else own_material(field, str(arguments.weights))
    if arguments.action is not None:
        action, stroke_name = read_action_csv(arguments.action, arguments.probe), arguments.action.name
    else:
        action = replace(primitive_action(arguments.stroke, seed=arguments.seed), probe=arguments.probe)
        stroke_name = arguments.stroke.name
    result = _synthesise(field, material, action, arguments.seed, arguments.rate, stroke_name)
    write_wav(arguments.out, result.signal)
    for warning in result.warnings:
        print(f"hnf: {warning}", file=sys.stderr)
    record = {
        "wav": str(arguments.out),
        "material": material.name,
        "stroke": stroke_name,
        "probe": arguments.probe,
        "seed": arguments.seed,
        "sample_rate_hz": result.signal.sample_rate,
        "duration_s": result.signal.duration_s,
        "rms_m_s2": result.signal.rms,
        "peak_m_s2": float(np.max(np.abs(result.signal.samples), initial=0.0)),
        "confidence": result.confidence,
        "warnings": list(result.warnings),
    }
    if arguments.json:
        print(json.dumps(record, indent=1))
    else:
        print(
            f"{arguments.out}: {stroke_name} on {material.name}, {result.signal.duration_s:.2f} s, "
            f"{result.signal.rms:.3g} m/s² RMS"
        )
    return 0


def _synthesise(
    field: Field, material: LibraryMaterial, action: Action, seed: int, rate: float, stroke_name: str
) -> Synthesis:
    result = synthesise(field, uniform_stroke(action, material.token, material.mechanics), seed=seed, sample_rate=rate)
    provenance = {**result.signal.provenance, "stroke": stroke_name, "material": material.name}
    return replace(result, signal=replace(result.signal, provenance=provenance))
