"""`hnf actuators`: list devices and profiles, and write profiles from measurements or data sheets."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ..actuators.measure.accelerometer import make_noise, make_sweep
from ..actuators.measure.build_profile import MeasuredProfile, make_datasheet_profile, make_measured_profile
from ..actuators.measure.frequency_response import estimate_response
from ..actuators.measure.inverse_filter import BandError, compute_band_errors, compute_rms_db, find_largest_errors_db
from ..actuators.output_prediction import DEFAULT_RANGE_HZ, compute_band_changes, simulate_output
from ..actuators.profile import GENERIC, PROFILES, ActuatorProfile, load_profile, write_profile
from ..actuators.sources import Acceleration, to_acceleration
from ..actuators.stream_targets import (
    AudioTarget,
    DeviceList,
    FileTarget,
    OscTarget,
    VirtualTarget,
    list_devices,
    make_sink,
    parse_target,
)
from ..errors import FileError, UsageError, pluralize
from ..export.wav import read_wav, write_wav
from ..field.carriers import MODEL_RATE_HZ
from ..signal import Signal
from ..units import STANDARD_GRAVITY
from .commands import HELP, parse_seed

BAND_ERROR_FIELDS = ("before_db", "after_db")


def add_describe(actions: Any) -> None:
    """Add `hnf actuators describe`, which makes a profile from the figures of a data sheet."""
    parser: argparse.ArgumentParser = actions.add_parser(
        "describe",
        help="write a profile from the figures of a data sheet",
        description="For a resonant actuator (LRA, voice coil, tactor) that you cannot measure: its resonance and how "
        "sharp it is, and how strong it gets. Its response is then that of a mass on a spring, which hnf stream "
        "corrects within its range. What the sheet does not say stays unknown. Measuring it says more: hnf actuators "
        "measure.",
    )
    parser.add_argument("--title", required=True, metavar="TEXT", help="its name for people")
    parser.add_argument("--source", required=True, metavar="TEXT", help="the document: maker, number, revision")
    parser.add_argument("--resonance", type=float, required=True, metavar="HZ", help="resonance frequency")
    sharp = parser.add_mutually_exclusive_group(required=True)
    sharp.add_argument("--q", type=float, metavar="Q", help="quality factor")
    sharp.add_argument("--bandwidth", type=float, metavar="HZ", help="instead: width at -3 dB")
    strong = parser.add_mutually_exclusive_group()
    strong.add_argument(
        "--peak", type=float, metavar="M_S2",
        help="amplitude at the resonance and the strongest drive, in m/s² (half of peak to peak, 1.41 × RMS)",
    )  # fmt: skip
    strong.add_argument("--peak-g", type=float, metavar="G", help="the same in g")
    parser.add_argument("--range", type=float, nargs=2, metavar=("LOW", "HIGH"), help="range in Hz, if it is stated")
    parser.add_argument("--sustained", type=float, metavar="SHARE", help="RMS that it bears for ever, of full scale")
    parser.add_argument("--thermal", type=float, metavar="S", help="seconds in which its coil warms")
    parser.add_argument("--out", type=Path, required=True, metavar="PROFILE.json", help="file to write")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=run_describe)


def run_describe(arguments: argparse.Namespace) -> int:
    """Run `hnf actuators describe`; return the exit code. Raises HnfError."""
    for name in ("q", "bandwidth", "peak", "peak_g", "sustained", "thermal"):
        value = getattr(arguments, name)
        if value is not None and not 0.0 < value < 1e6:
            raise UsageError(f"--{name.replace('_', '-')} {value:g} is not possible.", remedy="Give more than 0.")
    if arguments.sustained is not None and arguments.sustained > 1.0:
        raise UsageError("--sustained is a share of full scale.", remedy="Give at most 1.")
    if arguments.range is not None and not 0.0 < arguments.range[0] < arguments.range[1]:
        raise UsageError("--range goes from low to high.", remedy="Give e.g. --range 100 300.")
    peak = arguments.peak if arguments.peak_g is None else arguments.peak_g * STANDARD_GRAVITY
    profile = make_datasheet_profile(
        arguments.title,
        arguments.source,
        resonance_hz=arguments.resonance,
        quality=arguments.q or arguments.resonance / arguments.bandwidth,
        peak_m_s2=peak,
        range_hz=None if arguments.range is None else (arguments.range[0], arguments.range[1]),
        sustained=arguments.sustained,
        thermal_s=arguments.thermal,
    )
    assert profile.response is not None
    assert profile.range_hz is not None
    errors = compute_band_errors(profile.response, profile.range_hz, MODEL_RATE_HZ)
    write_profile(arguments.out, profile)
    # A range narrower than a third of an octave contains no band to report.
    before, after = (
        compute_rms_db([getattr(error, state) for error in errors]) if errors else None for state in BAND_ERROR_FIELDS
    )
    low, high = profile.range_hz
    full_scale_m_s2 = profile.limits.full_scale_m_s2
    if arguments.json:
        record = {
            "profile": str(arguments.out), "range_hz": [low, high], "full_scale_m_s2": full_scale_m_s2,
            "full_scale_assumed": profile.assumes_full_scale, "rms_error_before_db": before,
            "rms_error_after_db": after,
        }  # fmt: skip
        print(json.dumps(record, indent=1))
        return 0
    assumed = ", an assumption" if profile.assumes_full_scale else ""
    print(f"{arguments.out}: {low:.0f} to {high:.0f} Hz, {full_scale_m_s2:.3g} m/s² at full scale{assumed}")
    if before is not None and after is not None:
        print(
            f"off by {before:.1f} dB RMS per third of an octave; with its response corrected {after:.2f} dB, if the "
            "device is what its sheet says"
        )
    return 0


LOW_HZ, HIGH_HZ, SECONDS = 10.0, 1000.0, 8.0
LEVEL = 0.2
"""Level of an excitation as a fraction of full scale, low enough to meet no limit and to keep the coil cool."""
RATE_HZ = MODEL_RATE_HZ


def add_parser(verbs: Any) -> argparse.ArgumentParser:
    """Add `hnf actuators` and its actions."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        "actuators",
        help=HELP["actuators"],
        description="Without an action: list what is plugged in and the profiles there are.",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=run_list)
    actions = parser.add_subparsers(dest="action", metavar="ACTION")
    _add_sweep(actions)
    _add_measure(actions)
    add_describe(actions)
    _add_report(actions)
    return parser


def _add_sweep(actions: Any) -> None:
    parser = actions.add_parser(
        "sweep",
        help="write a sweep or noise to be played elsewhere",
        description="Write an exponential sine sweep, or noise, as a WAV in m/s². Play it on the actuator, record the "
        "accelerometer, and give both files to: hnf actuators measure --played … --response …",
    )
    _add_excitation_options(parser)
    parser.add_argument("--out", type=Path, required=True, metavar="F.wav", help="file to write")
    parser.set_defaults(run=run_sweep)


def _add_measure(actions: Any) -> None:
    parser = actions.add_parser(
        "measure",
        help="measure an actuator's response and write its profile",
        description="Play an excitation, record an accelerometer on the actuator (or take the two as files), and write "
        "a profile: limits, response, and with it the inverse filter (at most +20 dB) that hnf stream then applies. "
        "Prints the error per third of an octave without and with it.",
    )
    parser.add_argument("--to", metavar="TARGET", help="device to play on, as hnf stream takes it; or virtual")
    parser.add_argument("--input", metavar="audio[:DEVICE]", help="sound input that the accelerometer is on")
    parser.add_argument("--played", type=Path, metavar="F.wav", help="what was played, instead of --to")
    parser.add_argument("--response", type=Path, metavar="F.wav", help="what was recorded, instead of --input")
    parser.add_argument(
        "--sensitivity", type=float, metavar="M_S2",
        help="m/s² at full scale of the recording; without it the response is known, the level is not",
    )  # fmt: skip
    parser.add_argument(
        "--profile", default=GENERIC.name, metavar="NAME", help=f"what is known of it so far (default {GENERIC.name})"
    )
    parser.add_argument("--title", default="Measured Actuator", help="its name for people")
    parser.add_argument("--range", type=float, nargs=2, metavar=("LOW", "HIGH"), help="its range in Hz, if you know it")
    _add_excitation_options(parser)
    parser.add_argument("--out", type=Path, required=True, metavar="PROFILE.json", help="file to write")
    parser.set_defaults(run=run_measure)


def _add_report(actions: Any) -> None:
    parser = actions.add_parser(
        "report",
        help="what a signal is after an actuator, per band",
        description="Print how far the vibration that a skin gets is from the one asked for, per third of an octave, "
        "without and with compensation, limits included.",
    )
    parser.add_argument("file", type=Path, metavar="FILE.wav", help="a signal; which unit is taken is said")
    parser.add_argument("--profile", required=True, metavar="NAME|FILE.json", help="a profile; measured ones say more")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=run_report)


def _add_excitation_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--noise", action="store_true", help="pink noise instead of a sweep")
    parser.add_argument("--seconds", type=float, default=SECONDS, metavar="S", help=f"how long (default {SECONDS:g})")
    parser.add_argument("--low", type=float, default=LOW_HZ, metavar="HZ", help=f"from (default {LOW_HZ:g})")
    parser.add_argument("--high", type=float, default=HIGH_HZ, metavar="HZ", help=f"to (default {HIGH_HZ:g})")
    parser.add_argument("--level", type=float, default=LEVEL, metavar="SHARE", help=f"of full scale (default {LEVEL})")
    parser.add_argument("--rate", type=float, default=RATE_HZ, metavar="HZ", help=f"sample rate (default {RATE_HZ:g})")
    parser.add_argument("--seed", type=parse_seed, default=0, metavar="N", help="of the noise")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run_list(arguments: argparse.Namespace) -> int:
    """List audio devices and actuator profiles; return the exit code."""
    devices = list_devices()
    if arguments.json:
        print(json.dumps(_devices_to_json(devices), indent=1, ensure_ascii=False))
        return 0
    for device in devices.all:
        print(f"{device.target:<32}  {device.title}" + (f" ({device.facts})" if device.facts else ""))
    print(f"{'virtual':<32}  a simulated voice coil, reached as a serial device is")
    print(f"{'osc:HOST:PORT':<32}  envelopes, for a program that listens to OSC")
    print(f"{'file:PATH':<32}  a WAV of what would go on the wire")
    for kind, listed in (("serial port", devices.serial), ("sound output", devices.audio)):
        if not listed:
            print(f"no {kind} found")
    for line in devices.missing:
        print(f"not listed: {line}")
    print("\nprofiles:")
    for profile in PROFILES.values():
        print(f"{profile.name:<32}  {profile.title}: {_format_limits(profile)}")
    return 0


def _devices_to_json(found: DeviceList) -> dict[str, Any]:
    profiles = [
        {
            "name": profile.name, "title": profile.title, "source": profile.source, "range_hz": profile.range_hz,
            "peak_m_s2": profile.peak_m_s2, "full_scale_assumed": profile.assumes_full_scale,
            "limits": asdict(profile.limits),
        }
        for profile in PROFILES.values()
    ]  # fmt: skip
    listed = [asdict(device) for device in found.all]
    return {"devices": listed, "missing": list(found.missing), "profiles": profiles}


def _format_limits(profile: ActuatorProfile) -> str:
    low, high = profile.range_hz or (None, None)
    band = f"{low:g} to {high:g} Hz" if low is not None else "range not known"
    peak = f"{profile.peak_m_s2:g} m/s²" if profile.peak_m_s2 is not None else "largest acceleration not stated"
    return f"{band}, {peak}"


def make_excitation(arguments: argparse.Namespace, full_scale_m_s2: float) -> Signal:
    """Return the test signal, a sweep or noise as the options say. Raises UsageError if they are invalid."""
    if not 0.0 < arguments.level <= 1.0:
        raise UsageError(
            f"--level {arguments.level:g} is no share of full scale.", remedy="Give more than 0, at most 1."
        )
    peak = arguments.level * full_scale_m_s2
    shape = (arguments.rate, arguments.seconds, arguments.low, arguments.high, peak)
    return make_noise(*shape, seed=arguments.seed) if arguments.noise else make_sweep(*shape)


def run_sweep(arguments: argparse.Namespace) -> int:
    """Run `hnf actuators sweep`; return the exit code. Raises HnfError."""
    signal = make_excitation(arguments, GENERIC.limits.full_scale_m_s2)
    write_wav(arguments.out, signal)
    record = {"wav": str(arguments.out), "duration_s": signal.duration_s, "rms_m_s2": signal.rms, **signal.provenance}
    print(
        json.dumps(record) if arguments.json else f"{arguments.out}: {signal.duration_s:g} s, {signal.rms:.3g} m/s² RMS"
    )
    return 0


def run_measure(arguments: argparse.Namespace) -> int:
    """Run `hnf actuators measure`; return the exit code. Raises HnfError."""
    base = load_profile(arguments.profile)
    excitation, recording, calibrated = _get_excitation_and_recording(arguments, base)
    response = estimate_response(
        excitation.samples, recording.samples, excitation.sample_rate, arguments.low, arguments.high
    )
    range_hz = None if arguments.range is None else (arguments.range[0], arguments.range[1])
    measured = make_measured_profile(base, response, title=arguments.title, calibrated=calibrated, range_hz=range_hz)
    errors = compute_band_errors(get_response(measured), get_range(measured), excitation.sample_rate)
    write_profile(arguments.out, measured.profile)
    if arguments.json:
        print(
            json.dumps(_measurement_to_json(arguments.out, measured, errors, calibrated), indent=1, ensure_ascii=False)
        )
        return 0
    if not calibrated:
        print("hnf: without --sensitivity the level is not known; full scale stays as it was.", file=sys.stderr)
    print(_format_measurement(arguments.out, measured, errors))
    return 0


def get_response(found: MeasuredProfile) -> Any:
    """Return the frequency response of a measured profile, which always has one."""
    assert found.profile.response is not None
    return found.profile.response


def get_range(found: MeasuredProfile) -> tuple[float, float]:
    """Return the frequency range [Hz] of a measured profile, which always has one."""
    assert found.profile.range_hz is not None
    return found.profile.range_hz


def _get_excitation_and_recording(arguments: argparse.Namespace, base: ActuatorProfile) -> tuple[Signal, Signal, bool]:
    """Return the test signal and its recording at one rate, and whether the recording's m/s² are calibrated."""
    from ..actuators.measure.accelerometer import Accelerometer, measure_actuator, resample_signal, simulate_measurement

    if (arguments.played is None) != (arguments.response is None) or (arguments.to is None) == (
        arguments.played is None
    ):
        raise UsageError(
            "it takes either a device or two files.",
            remedy="Give --to TARGET with --input audio, --to virtual alone, or --played F.wav with --response F.wav.",
        )
    sensitivity = 1.0 if arguments.sensitivity is None else arguments.sensitivity
    if not 0.0 < sensitivity < 1e9:
        raise UsageError(f"--sensitivity {sensitivity:g} is no acceleration.", remedy="Give m/s² at full scale.")
    if arguments.played is not None:
        played, raw = read_wav(arguments.played), read_wav(arguments.response)
        stated = raw.provenance.get("units") is None
        if stated and arguments.sensitivity is not None:
            raise UsageError("it is in m/s² already.", where=str(arguments.response), remedy="Leave out --sensitivity.")
        calibrated = stated or arguments.sensitivity is not None
        recording = resample_signal(raw, played.sample_rate)
        return played, Signal(recording.samples * sensitivity, recording.sample_rate, 0), calibrated
    target, limits = parse_target(arguments.to), base.limits
    if isinstance(target, FileTarget | OscTarget):
        raise UsageError(f"nothing moves behind {arguments.to}.", remedy="Measure on serial, audio or virtual.")
    excitation = make_excitation(arguments, limits.full_scale_m_s2)
    if isinstance(target, VirtualTarget):
        return *simulate_measurement(excitation, limits), True
    sensor = Accelerometer(_parse_input(arguments.input), sensitivity)
    played, recording = measure_actuator(make_sink(target, arguments.rate, limits), sensor, excitation, limits)
    return played, recording, arguments.sensitivity is not None


def _parse_input(text: str | None) -> str | int | None:
    target = None if text is None else parse_target(text)
    if not isinstance(target, AudioTarget):
        raise UsageError("the accelerometer has no input.", remedy="Name its sound input: --input audio[:DEVICE].")
    return target.device


def _measurement_to_json(
    path: Path, found: MeasuredProfile, errors: tuple[BandError, ...], calibrated: bool
) -> dict[str, Any]:
    before, after = find_largest_errors_db(errors)
    return {
        "profile": str(path),
        "calibrated": calibrated,
        "gain_db": found.gain_db,
        "full_scale_m_s2": found.profile.limits.full_scale_m_s2,
        "range_hz": get_range(found),
        "delay_ms": 1e3 * get_response(found).delay_s,
        "resonator": asdict(found.resonator),
        "bands": [asdict(error) for error in errors],
        "largest_error_before_db": before,
        "largest_error_after_db": after,
    }


def _format_measurement(path: Path, found: MeasuredProfile, errors: tuple[BandError, ...]) -> str:
    resonator, (low, high) = found.resonator, get_range(found)
    model = (
        f"resonance {resonator.resonance_hz:.1f} Hz, damping {resonator.damping:.2f} (that model is off by "
        f"{resonator.error_db:.2f} dB RMS)"
        if low <= resonator.resonance_hz <= high
        else "no resonance in between"
    )
    lines = [
        f"{path}: {low:.0f} to {high:.0f} Hz, {model}",
        f"{'band':>9}  {'without':>9}  {'with compensation':>18}",
    ]
    lines += [
        f"{error.centre_hz:>6.0f} Hz  {error.before_db:>+6.1f} dB  {error.after_db:>+15.2f} dB" for error in errors
    ]
    rms = compute_rms_db([error.before_db for error in errors]), compute_rms_db([error.after_db for error in errors])
    return "\n".join([*lines, f"{'RMS':>9}  {rms[0]:>6.1f} dB  {rms[1]:>15.2f} dB"])


def run_report(arguments: argparse.Namespace) -> int:
    """Run `hnf actuators report`; return the exit code. Raises HnfError."""
    profile = load_profile(arguments.profile)
    acceleration = to_acceleration([read_wav(arguments.file)], profile.limits, str(arguments.file))
    signal = Signal(acceleration.samples[:, 0], acceleration.rate_hz, 0)
    plain, corrected = (simulate_output(signal, profile, compensate=compensate) for compensate in (False, True))
    without, compensated = (compute_band_changes(signal, output.signal, profile) for output in (plain, corrected))
    if not any(band.before > 0.0 for band in without):
        raise _make_empty_signal_error(acceleration, profile, str(arguments.file))
    rows = [
        {"low_hz": before.low_hz, "high_hz": before.high_hz, "before_db": before.change_db, "after_db": after.change_db}
        for before, after in zip(without, compensated, strict=True)
    ]
    if arguments.json:
        record = {
            "profile": profile.name,
            "unit": acceleration.unit,
            "measured": profile.response is not None,
            "limited_samples_before": plain.limited_samples,
            "limited_samples_after": corrected.limited_samples,
            "bands": rows,
        }
        print(json.dumps(record, indent=1))
        return 0
    if profile.response is None:
        print("hnf: this profile has no measured response: only its limits count here.", file=sys.stderr)
    for suffix, output in (("", plain), (" with compensation", corrected)):
        if output.limited_samples and (output is plain or profile.response is not None):
            print(
                f"hnf: its limits change {pluralize(output.limited_samples, 'sample')}{suffix}; a softer signal keeps "
                "its shape.",
                file=sys.stderr,
            )
    print(f"{arguments.file}: {acceleration.unit}, largest {acceleration.peak_m_s2:.3g} m/s²")
    print(f"{'band':>17}  {'without':>9}  {'with compensation':>18}")
    for row in rows:
        texts = ["–" if row[key] is None else f"{row[key]:+.2f} dB" for key in ("before_db", "after_db")]
        print(f"{row['low_hz']:>6.0f} – {row['high_hz']:>4.0f} Hz  {texts[0]:>9}  {texts[1]:>18}")
    return 0


def _make_empty_signal_error(found: Acceleration, profile: ActuatorProfile, where: str) -> FileError:
    """Return the error that explains why no frequency band of a signal can be compared."""
    if found.peak_m_s2 == 0.0:
        return FileError("is silent: there is nothing to report.", where=where, remedy="Give a file with a vibration.")
    low, high = profile.range_hz or DEFAULT_RANGE_HZ
    return FileError(
        f"has nothing from {low:g} to {high:g} Hz, or is too short ({pluralize(len(found.samples), 'sample')}): there "
        f"is "
        "nothing to report.",
        where=where,
        remedy="Give a longer file, or the profile of an actuator that it is made for.",
    )
