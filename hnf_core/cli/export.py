"""`hnf export`: write a signal in another file format and report what was lost."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..action.action import write_action_csv
from ..actuators.profile import GENERIC, PROFILES, load_profile
from ..errors import UsageError
from ..export.convert import ExportResult, convert_envelope, export_signal, import_signal
from ..export.formats import FORMATS, Format, Loader, find_loader, format_of
from ..export.options import (
    DEFAULT_FULL_SCALE_M_S2,
    DEFAULT_RANGE_HZ,
    MIN_FULL_SCALE_M_S2,
    ExportOptions,
    ImportOptions,
)
from ..export.touched_surface import TouchedSurface
from ..export.wav import read_wav_with_units
from ..signal import Signal
from .commands import HELP

ACTION_FORMAT = "action"
"""Name of the table of u(t), which is no signal and read from --scene alone."""

SceneReader = Callable[[Path, Mapping[str, str], str | None], TouchedSurface]


def add_parser(verbs: Any) -> argparse.ArgumentParser:
    """Add `hnf export`."""
    described = {form.word: form.what for form in FORMATS.values()} | {
        ACTION_FORMAT: "how it was touched, for --action"
    }
    listed = "\n".join(f"  {word:<8} {what}" for word, what in described.items())
    parser: argparse.ArgumentParser = verbs.add_parser(
        "export",
        help=HELP["export"],
        description="Write a signal in another format, with a .json beside it that says what its numbers stand for, "
        "read it back, and print what was lost.",
        epilog=f"formats:\n{listed}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "file", type=Path, metavar="FILE.wav", help="a signal of this project in m/s², or a haptic file"
    )
    parser.add_argument("--format", required=True, metavar="WORD", help="one of those below")
    parser.add_argument("--out", type=Path, required=True, metavar="F", help="file to write")
    parser.add_argument(
        "--scene", type=Path, metavar="BAKED.blend", help="what the stroke was drawn on, for hjif, glb and action"
    )
    parser.add_argument("--object", metavar="NAME", help="which mesh of --scene; default: as FILE.wav says")
    add_scale_options(parser)
    parser.add_argument("--fit", action="store_true", help="let 1 stand for the signal's own peak: loud on any device")
    parser.add_argument("--json", action="store_true", help="print the result as one JSON object")
    return parser


def add_scale_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that define which acceleration full scale, a sample of 1, stands for."""
    scale = parser.add_mutually_exclusive_group()
    scale.add_argument(
        "--profile", metavar="NAME", help=f"an actuator, for full scale and range: {', '.join(PROFILES)}, or FILE.json"
    )
    scale.add_argument(
        "--full-scale",
        type=float,
        metavar="M_S2",
        help=f"m/s² that 1.0 stands for (default {DEFAULT_FULL_SCALE_M_S2:g})",
    )
    low, high = DEFAULT_RANGE_HZ
    parser.add_argument(
        "--range", type=float, nargs=2, metavar=("LOW", "HIGH"),
        help=f"Hz that a frequency of 0 and of 1 stand for (default {low:g} {high:g})",
    )  # fmt: skip


def get_scale(arguments: argparse.Namespace) -> tuple[float | None, tuple[float, float] | None]:
    """Return full scale [m/s²] and frequency range [Hz] from options or actuator profile, None if not given.

    Raises UsageError if the profile is invalid.
    """
    full_scale, range_hz = arguments.full_scale, None
    if arguments.profile is not None:
        profile = load_profile(arguments.profile)
        full_scale = None if profile.assumes_full_scale else profile.peak_m_s2
        range_hz = profile.range_hz
    if arguments.range is not None:
        range_hz = (arguments.range[0], arguments.range[1])
    return full_scale, range_hz


def check_output(out: Path, suffix: str, source: Path, option: str = "--out") -> None:
    """Check the suffix of the output, and that it is not the input file. Raises UsageError."""
    if out.suffix.lower() != suffix:
        raise UsageError(f"{option} {out}: such a file ends in {suffix}.", remedy=f"Give {option} {out.stem}{suffix}")
    if out.exists() and source.exists() and out.samefile(source):
        raise UsageError(f"{option} {out} is the file that is read.", remedy="Give another name.")


def refuse_scene(scene: Path, provenance: Mapping[str, str], object_name: str | None) -> TouchedSurface:
    """Raise a UsageError; used for --scene where Blender, which alone can open a scene, is not running."""
    raise UsageError(
        f"{scene} can be opened with Blender alone, and this Python has no bpy.",
        remedy="Install it (pip install bpy, Python 3.11 or 3.13), or run: blender -b --command hnf export …",
    )


def run(arguments: argparse.Namespace, read_scene: SceneReader = refuse_scene) -> int:
    """Export a signal; return the exit code.

    Parameters
    ----------
    arguments : argparse.Namespace
        Parsed options.
    read_scene : callable
        Function (--scene, the WAV's provenance, --object) → the surface touched.

    Returns
    -------
    int
        Exit code.

    Raises
    ------
    HnfError
        If the export fails.
    """
    if arguments.format == ACTION_FORMAT:
        return _export_action(arguments, read_scene)
    form = format_of(arguments.format)
    check_output(arguments.out, form.suffix, arguments.file)
    if arguments.scene is not None and not form.surface:
        names = ", ".join(candidate.word for candidate in FORMATS.values() if candidate.surface)
        raise UsageError(f"the format '{form.word}' has no place for --scene.", remedy=f"Those that have: {names}.")
    if arguments.object is not None and arguments.scene is None:
        raise UsageError("--object without --scene.", remedy="Name the baked scene too: --scene BAKED.blend")
    full_scale, range_hz = get_scale(arguments)
    is_wav = arguments.file.suffix.lower() == ".wav"
    if arguments.fit and (full_scale is not None or not form.scaled):
        raise UsageError(
            f"--fit with {'another scale' if form.scaled else f'the format {form.word!r}, which keeps m/s²'}.",
            remedy="Leave one of them out.",
        )
    load = None if is_wav or arguments.scene is not None else find_loader(arguments.file)
    if load is not None and form.store is not None:
        return _convert(arguments, load, form, full_scale, range_hz)
    if not form.scaled and (arguments.full_scale is not None or arguments.range is not None):
        print(f"hnf: note: {form.word!r} keeps m/s², so --full-scale and --range have no say.", file=sys.stderr)
    if form.fit is not None and full_scale is not None:
        raise UsageError(
            f"the format '{form.word}' finds its full scale in the signal: --full-scale and --profile have no place.",
            remedy="Leave them out, or take --format wav48k.",
        )
    assumed = form.scaled and full_scale is None
    options = ExportOptions(
        DEFAULT_FULL_SCALE_M_S2 if full_scale is None else full_scale,
        range_hz or DEFAULT_RANGE_HZ,
        full_scale_assumed=assumed,
    )
    if is_wav:
        signal = read_wav_with_units(arguments.file)
    else:
        signal = import_signal(arguments.file, ImportOptions(full_scale, range_hz))
    if arguments.fit:
        options = fit_to_peak(signal, options)
        assumed = False
    if arguments.scene is not None:
        surface = read_scene(arguments.scene, signal.provenance, arguments.object)
        options = replace(options, surface=surface)
    exported = export_signal(signal, form, arguments.out, options)
    record = exported.to_json() | {"full_scale_assumed": assumed}
    print(json.dumps(record, indent=1) if arguments.json else exported.report())
    if exported.clipped:
        print("hnf: what was clipped fits a larger --full-scale, or a stronger actuator.", file=sys.stderr)
    elif not arguments.json and form.scaled and (line := describe_faint(exported)):
        print(line)
    if assumed and not exported.clipped and not arguments.json:
        print(f"- 1 is {DEFAULT_FULL_SCALE_M_S2:g} m/s², {_explain_assumption(arguments.profile)}")
    return 0


def _convert(
    arguments: argparse.Namespace,
    load: Loader,
    form: Format,
    full_scale: float | None,
    range_hz: tuple[float, float] | None,
) -> int:
    """Write the envelope of a haptic file in another such format; its own scale stays unless another is told."""
    clip = load(arguments.file, ImportOptions(full_scale, range_hz))
    options = ExportOptions(full_scale or clip.origin.full_scale_m_s2, range_hz or clip.origin.range_hz)
    if arguments.fit:
        envelope = clip.envelope
        peak = max([float(envelope.amplitude.max()), *(click.amplitude for click in envelope.emphases)])
        options = replace(options, full_scale_m_s2=peak) if peak > 0.0 else options
    exported = convert_envelope(clip, arguments.file, form, arguments.out, options)
    print(json.dumps(exported.to_json(), indent=1) if arguments.json else exported.report())
    if not arguments.json:
        for name in ("assumed", "ignored"):
            if name in clip.facts:
                print(f"- {name}: {clip.facts[name]}")
        if line := describe_faint(exported):
            print(line)
    return 0


FAINT_SHARE = 0.1
"""Largest peak, as a share of full scale, of a signal that is called faint."""


def describe_faint(exported: ExportResult) -> str:
    """Return one line if a signal uses only a few percent of its scale, else ""."""
    share = exported.loss.before.peak / exported.options.full_scale_m_s2
    if not 0.0 < share < FAINT_SHARE:
        return ""
    return (
        f"- Faint: its peak is {100.0 * share:.2g} % of full scale; --fit makes it use all, and says what 1 stands for."
    )


def fit_to_peak(signal: Signal, options: ExportOptions) -> ExportOptions:
    """Return options whose full scale is the signal's peak, so that the file uses all of the scale."""
    peak = float(np.abs(signal.samples).max(initial=0.0))
    return replace(options, full_scale_m_s2=peak, full_scale_assumed=False) if peak >= MIN_FULL_SCALE_M_S2 else options


def _export_action(arguments: argparse.Namespace, read_scene: SceneReader) -> int:
    """Write how the stroke of a signal touched its surface, as `hnf synth --action` reads it."""
    check_output(arguments.out, ".csv", arguments.file)
    if arguments.scene is None:
        raise UsageError("a signal does not say how it was touched.", remedy="Name its scene: --scene TOUCHED.blend")
    surface = read_scene(arguments.scene, read_wav_with_units(arguments.file).provenance, arguments.object)
    if surface.action is None:
        raise UsageError(
            f"'{surface.name}' in {arguments.scene} has no stroke of {arguments.file}.",
            remedy="Name the .blend that hnf touch wrote beside it.",
        )
    write_action_csv(arguments.out, surface.action)
    record = {"file": str(arguments.out), "format": ACTION_FORMAT, "duration_s": surface.action.duration_s}
    text = f"{arguments.out}: {surface.action.duration_s:.2f} s of u(t), for hnf synth --action"
    print(json.dumps(record, indent=1) if arguments.json else text)
    return 0


def _explain_assumption(profile: str | None) -> str:
    """Return a note that the default full scale was assumed, and how to change it."""
    if profile in (None, GENERIC.name):
        return "an assumption, the generic voice coil's: another --profile or --full-scale say otherwise."
    return f"an assumption: '{profile}' does not state its largest acceleration. If you know it, give --full-scale."
