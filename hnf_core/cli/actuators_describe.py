"""`hnf actuators describe`: a data sheet's figures become a profile."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from ..actuators.measure.bands import compute_band_errors, compute_rms_db
from ..actuators.measure.described import make_datasheet_profile
from ..actuators.profile_file import write_profile
from ..errors import UsageError
from ..field.carriers import MODEL_RATE_HZ

STANDARD_GRAVITY_M_S2 = 9.80665
BAND_ERROR_FIELDS = ("before_db", "after_db")


def add_describe(actions: Any) -> None:
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
    """Raises HnfError; returns the exit code."""
    for name in ("q", "bandwidth", "peak", "peak_g", "sustained", "thermal"):
        value = getattr(arguments, name)
        if value is not None and not 0.0 < value < 1e6:
            raise UsageError(f"--{name.replace('_', '-')} {value:g} is not possible.", remedy="Give more than 0.")
    if arguments.sustained is not None and arguments.sustained > 1.0:
        raise UsageError("--sustained is a share of full scale.", remedy="Give at most 1.")
    if arguments.range is not None and not 0.0 < arguments.range[0] < arguments.range[1]:
        raise UsageError("--range goes from low to high.", remedy="Give e.g. --range 100 300.")
    peak = arguments.peak if arguments.peak_g is None else arguments.peak_g * STANDARD_GRAVITY_M_S2
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
    # Of a range narrower than a third of an octave there is no band to tell of.
    before, after = (
        compute_rms_db([getattr(each, when) for each in errors]) if errors else None for when in BAND_ERROR_FIELDS
    )
    low, high = profile.range_hz
    full = profile.limits.full_scale_m_s2
    if arguments.json:
        record = {
            "profile": str(arguments.out), "range_hz": [low, high], "full_scale_m_s2": full,
            "full_scale_assumed": profile.assumes_full_scale, "rms_error_before_db": before,
            "rms_error_after_db": after,
        }  # fmt: skip
        print(json.dumps(record, indent=1))
        return 0
    assumed = ", an assumption" if profile.assumes_full_scale else ""
    print(f"{arguments.out}: {low:.0f} to {high:.0f} Hz, {full:.3g} m/s² at full scale{assumed}")
    if before is not None and after is not None:
        print(
            f"off by {before:.1f} dB RMS per third of an octave; with its response corrected {after:.2f} dB, if the "
            "device is what its sheet says"
        )
    return 0
