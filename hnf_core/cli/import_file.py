"""`hnf import`: convert a haptic file of another program to a WAV in m/s²."""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..export.convert import import_signal
from ..export.fidelity import (
    describe_sidecar_loss,
    format_level_table,
    format_loss_table,
    format_rendered_summary,
    measure_loss,
)
from ..export.formats import FOREIGN_LOADERS, SUFFIXES, format_of, format_of_file
from ..export.options import DEFAULT_RENDER_RATE_HZ, ImportOptions
from ..export.provenance import get_sidecar_path, read_sidecar_loss
from ..export.wav import read_wav_scaled, write_wav
from .commands import HELP, parse_seed
from .export import add_scale_options, check_output, get_scale

REPORTED_PROVENANCE = ("scale", "assumed", "carrier", "ignored", "modality", "doubt")
"""Entries of the provenance that are printed: what was assumed, synthesised and ignored."""


def add_parser(verbs: Any) -> argparse.ArgumentParser:
    """Add `hnf import`."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        "import",
        help=HELP["import"],
        description=f"Read {', '.join(SUFFIXES)} and write a float32 WAV in m/s². Formats that keep strength and "
        "frequency over time are rendered on a sine. What the file states of its scale counts more than the options.",
    )
    parser.add_argument("file", type=Path, metavar="FILE", help="what to read")
    parser.add_argument("--out", type=Path, required=True, metavar="X.wav", help="file to write")
    parser.add_argument("--format", metavar="WORD", help="where the file's name does not say (see `hnf export --help`)")
    add_scale_options(parser)
    parser.add_argument(
        "--rate", type=float, default=DEFAULT_RENDER_RATE_HZ, metavar="HZ",
        help=f"of what is rendered (default {DEFAULT_RENDER_RATE_HZ:g}); samples keep their own",
    )  # fmt: skip
    parser.add_argument(
        "--seed", type=parse_seed, default=0, metavar="N", help="draws where the sine starts (default 0)"
    )
    parser.add_argument("--channel", type=int, metavar="N", help="which channel of a file that has several, from 1")
    parser.add_argument("--json", action="store_true", help="print the result as one JSON object")
    return parser


def run(arguments: argparse.Namespace) -> int:
    """Run `hnf import`; return the exit code. Raises HnfError."""
    check_output(arguments.out, ".wav", arguments.file)
    is_foreign = arguments.format is None and arguments.file.suffix.lower() in FOREIGN_LOADERS
    form = None if is_foreign else format_of(arguments.format) if arguments.format else format_of_file(arguments.file)
    sampled = form is not None and form.sampled
    full_scale, range_hz = get_scale(arguments)
    options = ImportOptions(full_scale, range_hz, arguments.rate, arguments.seed, arguments.channel)
    signal = import_signal(arguments.file, options, form)
    write_wav(arguments.out, signal)
    notes = tuple(f"{name}: {signal.provenance[name]}" for name in REPORTED_PROVENANCE if name in signal.provenance)
    if (export_loss := read_sidecar_loss(arguments.file)) is not None:
        notes += describe_sidecar_loss(export_loss, get_sidecar_path(arguments.file).name)
    loss = measure_loss(signal, read_wav_scaled(arguments.out, replace(options, channel=None)), notes)
    # A rendered signal always equals itself, so exactness means nothing for a file without samples.
    loss = replace(loss, exact=loss.exact and sampled)
    record = {
        "wav": str(arguments.out),
        "source": str(arguments.file),
        "sample_rate_hz": signal.sample_rate,
        "duration_s": signal.duration_s,
        "rms_m_s2": signal.rms,
        "peak_m_s2": float(np.abs(signal.samples).max(initial=0.0)),
        "seed": signal.seed,
        "provenance": dict(signal.provenance),
        "waveform": "as stored" if sampled else "made up",
        "export_loss": export_loss,
        "loss": loss.to_json(),
    }
    if arguments.json:
        print(json.dumps(record, indent=1))
        return 0
    print(f"{arguments.out}: what {arguments.file} says, in m/s²")
    print(format_loss_table(loss) if sampled else format_rendered_summary(loss))
    print(format_level_table(loss.after, loss.bands))
    return 0
