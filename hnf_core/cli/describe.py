"""`hnf describe`: decode a real touch sensor's image to height, token and nearest materials; calibrate a sensor.

`hnf synth --touch` decodes by the same options.
"""

from __future__ import annotations

import argparse
import io
import json
import sys
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..datasets.ball_calibration import BALL_RADIUS_M, calibrate, read_press_folder
from ..datasets.vision_touch import read_photograph, read_touch_image
from ..errors import HnfError, UsageError
from ..files import write_bytes
from ..material.band_descriptor import describe
from ..material.fuse import find_significant_bands
from ..material.library import Appearance, load_library
from ..material.ranking import Suggestion, rank
from ..material.shared_space import SpaceMatch, find_look, find_touch, load_space
from ..material.token import BAND_WAVELENGTHS_M, LEVELS, TOKEN_NAMES, Token
from ..scene.rgbd_view import write_exr
from ..tactile.optics import SENSORS
from ..tactile.photometric_stereo import DecodedTouch, decode_touch_image, load_calibration, save_calibration
from ..tactile.tactile_map import Route
from .commands import HELP

SHOWN_MATERIALS = 5
"""Number of nearest materials that are printed."""
HEIGHT_SUFFIXES = (".exr", ".npy")
TOUCH_OPTIONS = {
    name: f"--{name.replace('_', '-')}" for name in ("sensor", "background", "calibration", "mm_per_pixel", "space")
}
"""Options of `add_touch_options`, by their names in the parsed arguments."""


CAMERA = "camera"
"""Value of --sensor for a photograph, which is looked up in a space of looks and touch."""


@dataclass(frozen=True)
class TouchDescription:
    """Description of a touch image: how it was decoded, its token, the library ranked by it, and what --space holds."""

    decoded: DecodedTouch
    token: Token
    ranked: tuple[Suggestion, ...]
    match: SpaceMatch | None = None


def add_touch_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that say how a touch image is decoded."""
    parser.add_argument(
        "--sensor", metavar="KIND",
        help=f"{' or '.join(SENSORS)} (default: the calibration's, else gelsight); or {CAMERA}: a photograph, for "
        "--space",
    )  # fmt: skip
    parser.add_argument("--background", type=Path, metavar="IMAGE", help="picture of the untouched sensor")
    parser.add_argument(
        "--calibration", type=Path, metavar="FILE.json", help="of this sensor, by `hnf describe --calibrate`"
    )
    parser.add_argument(
        "--mm-per-pixel", type=float, metavar="MM", help="scale of the picture (default: the calibration's)"
    )
    parser.add_argument(
        "--space", type=Path, metavar="FILE",
        help="space.safetensors of `hnf train alignment`: find the GelSight tuples that are nearest to the picture",
    )  # fmt: skip


def add_parser(verbs: Any) -> argparse.ArgumentParser:
    """Add `hnf describe`."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        "describe",
        help=HELP["describe"],
        description="Decode a picture of a camera-based touch sensor by photometric stereo. Best with a picture of the "
        "untouched sensor and a calibration; without them the result is a rough guess, and says so.",
    )
    parser.add_argument("image", nargs="?", type=Path, metavar="IMAGE", help="picture of the pressed sensor")
    add_touch_options(parser)
    parser.add_argument("--height", type=Path, metavar="FILE.exr|.npy", help="write the height in meters")
    parser.add_argument("--picture", type=Path, metavar="FILE.png", help="draw the tactile map")
    parser.add_argument("--json", action="store_true", help="print the result as one JSON object")
    parser.add_argument(
        "--calibrate", type=Path, metavar="FOLDER",
        help="calibrate a sensor by pictures of a ball pressed at several places, and one called background",
    )  # fmt: skip
    parser.add_argument(
        "--ball-mm", type=float, default=2e3 * BALL_RADIUS_M, metavar="MM", help="the ball's diameter (default 4)"
    )
    parser.add_argument("--out", type=Path, metavar="FILE.json", help="where --calibrate writes")
    return parser


def run(arguments: argparse.Namespace) -> int:
    """Run `hnf describe`; return the exit code. Raises HnfError."""
    if (arguments.image is None) == (arguments.calibrate is None):
        raise UsageError("one picture, or --calibrate FOLDER, is needed.", remedy="Example: hnf describe press.png")
    if arguments.calibrate is not None:
        return _calibrate(arguments)
    if arguments.height is not None and arguments.height.suffix not in HEIGHT_SUFFIXES:
        raise UsageError(f"--height {arguments.height.name}: heights are .exr or .npy.", remedy="Name it so.")
    if arguments.sensor == CAMERA:
        if arguments.height is not None or arguments.picture is not None:
            raise UsageError("a photograph has no height: --height and --picture are for touch.", remedy="Leave them.")
        space = _make_match_record(describe_look(arguments.image, arguments))
        record = {"image": str(arguments.image), "sensor": CAMERA, "space": space}
        print(json.dumps(record, indent=1, ensure_ascii=False) if arguments.json else _format_match(space))
        return 0
    described = describe_touch_image(arguments.image, arguments)
    tactile_map = described.decoded.tactile_map
    if arguments.height is not None and tactile_map.height is not None:
        _write_height(arguments.height, tactile_map.height)
    record = make_record(described)
    if arguments.picture is not None:
        from ..export.figure import write_tactile_map_figure  # its imports are slow

        nearest = described.ranked[0]
        write_tactile_map_figure(
            arguments.picture, tactile_map, arguments.image.name,
            (f"nearest: {nearest.name}, {nearest.confidence:.0%}", *described.decoded.notes),
        )  # fmt: skip
    if arguments.json:
        print(json.dumps({"image": str(arguments.image), **record}, indent=1, ensure_ascii=False))
        return 0
    for note in described.decoded.notes:
        print(f"hnf: {note}.", file=sys.stderr)
    print(_format_table(arguments.image, record))
    return 0


def describe_touch_image(path: Path, arguments: argparse.Namespace) -> TouchDescription:
    """Decode the touch image at `path` by the options of `add_touch_options`, and describe it.

    Raises HnfError.
    """
    calibration = None if arguments.calibration is None else load_calibration(arguments.calibration)
    if calibration is not None and arguments.sensor not in (None, calibration.sensor):
        raise UsageError(
            f"--sensor {arguments.sensor}: the calibration is a {calibration.sensor}'s.",
            remedy="Leave one of them out.",
        )
    pixel_m = _get_pixel_m(arguments)
    frame = read_touch_image(path)
    background = None if arguments.background is None else read_touch_image(arguments.background)
    try:
        decoded = decode_touch_image(
            frame,
            background,
            calibration,
            sensor=arguments.sensor or "gelsight",
            metres_per_pixel=pixel_m,
        )
    except HnfError as error:
        raise type(error)(error.what, where=error.where or str(path), remedy=error.remedy) from error
    match = None if arguments.space is None else find_touch(load_space(arguments.space), decoded.tactile_map)
    token = describe(decoded.tactile_map)
    ranked = rank(load_library(), Appearance(), [""], token=token, route=decoded.tactile_map.route)
    if not any(find_significant_bands(token)):
        note = "no band of wavelengths stands above the noise: nothing but habit speaks for the materials below"
        decoded = replace(decoded, notes=(*decoded.notes, note))
    return TouchDescription(decoded, token, ranked, match)


def describe_look(path: Path, arguments: argparse.Namespace) -> SpaceMatch:
    """Find the touch of the photograph at `path` in the space of --space; raise HnfError."""
    pixel_m = _get_pixel_m(arguments)
    if arguments.space is None or pixel_m is None:
        raise UsageError(
            f"--sensor {CAMERA} needs --space FILE and --mm-per-pixel.",
            remedy="A space is made by `hnf train alignment`.",
        )
    if arguments.background is not None or arguments.calibration is not None:
        raise UsageError("--background and --calibration are for touch sensors.", remedy="Leave them out.")
    return find_look(load_space(arguments.space), read_photograph(path), pixel_m)


def _make_match_record(match: SpaceMatch) -> dict[str, Any]:
    return {
        "views": match.views,
        "materials": [{"name": name, "share": round(share, 4)} for name, share in match.materials],
        "tuples": [
            {"material": name, "mm_per_pixel": 1e3 * pitch, "cosine": round(cosine, 4)}
            for name, pitch, cosine in match.tuples
        ],
        "token": dict(zip(TOKEN_NAMES, map(float, match.token.values), strict=True)),
    }


def _format_match(record: dict[str, Any]) -> str:
    return "\n".join(
        [f"{len(record['tuples'])} GelSight tuples are nearest to {record['views']} view(s); by material:"]
        + [f"{each['name']:<20}  {each['share']:4.0%}" for each in record["materials"][:SHOWN_MATERIALS]]
    )


def make_record(described: TouchDescription) -> dict[str, Any]:
    """Return a description as an object for JSON: height, bands, token, and nearest materials."""
    tactile_map, token = described.decoded.tactile_map, described.token
    height = np.asarray(tactile_map.height)[tactile_map.mask]
    resolved = tactile_map.resolved_wavelength_m
    category = {material.name: material.category for material in load_library()}
    values = [float(value) if known else None for value, known in zip(token.values, token.known, strict=True)]
    return {
        "sensor": tactile_map.sensor,
        "decoded_by": tactile_map.height_source,
        "calibrated": tactile_map.route is Route.MEASURED,
        "mm_per_pixel": 1e3 * tactile_map.metres_per_pixel,
        "contact_share": float(tactile_map.mask.mean()),
        "integrability_db": round(described.decoded.integrability_db, 2),
        "resolved_wavelength_mm": 1e3 * resolved if np.isfinite(resolved) else None,
        "height_rms_um": 1e6 * float(height.std()),
        "height_range_um": 1e6 * float(np.ptp(height)),
        "bands": [
            {"wavelength_mm": 1e3 * float(wave), "rms_um": None if level is None else 10.0 ** (level + 6.0)}
            for wave, level in zip(BAND_WAVELENGTHS_M, values[LEVELS], strict=True)
        ],
        "token": dict(zip(TOKEN_NAMES, values, strict=True)),
        "materials": [{**asdict(each), "category": category[each.name]} for each in described.ranked],
        "notes": list(described.decoded.notes),
        **({} if described.match is None else {"space": _make_match_record(described.match)}),
    }


def _format_table(image: Path, record: dict[str, Any]) -> str:
    resolved = record["resolved_wavelength_mm"]
    lines = [
        f"{image}: {record['sensor']}, {record['decoded_by']}, {record['mm_per_pixel']:.4g} mm a pixel",
        f"contact  {record['contact_share']:.0%} of the frame; height {record['height_rms_um']:.3g} µm RMS, "
        f"{record['height_range_um']:.3g} µm in all",
        f"slopes   fit together to {record['integrability_db']:.1f} dB; "
        + (f"waves from {resolved:.2g} mm are resolved" if resolved else "no wave is resolved"),
        "bands    " + "  ".join(
            f"{band['wavelength_mm']:g} mm: " + ("–" if band["rms_um"] is None else f"{band['rms_um']:.2g} µm")
            for band in record["bands"]
        ),
    ]  # fmt: skip
    for each in record["materials"][:SHOWN_MATERIALS]:
        lines.append(f"{each['name']:<20}  {each['category']:<8}  {each['confidence']:4.0%}  {each['reason']}")
    return "\n".join([*lines, *([_format_match(record["space"])] if "space" in record else [])])


def _write_height(path: Path, height: NDArray[np.float32]) -> None:
    if path.suffix == ".npy":
        buffer = io.BytesIO()
        np.save(buffer, height, allow_pickle=False)
        write_bytes(path, buffer.getvalue())
        return
    write_exr(path, {"Y": height})


def _get_pixel_m(arguments: argparse.Namespace) -> float | None:
    if arguments.mm_per_pixel is None:
        return None
    if not 1e-4 <= arguments.mm_per_pixel <= 10.0:
        raise UsageError(f"--mm-per-pixel {arguments.mm_per_pixel:g}: not within 0.0001 to 10.", remedy="E.g. 0.06.")
    return float(1e-3 * arguments.mm_per_pixel)


def _calibrate(arguments: argparse.Namespace) -> int:
    pixel_m = _get_pixel_m(arguments)
    if arguments.out is None or arguments.out.suffix != ".json" or pixel_m is None:
        raise UsageError(
            "--calibrate needs --out FILE.json and --mm-per-pixel.",
            remedy="A GelSight Mini seen in 320 pixels has 0.063 mm a pixel, a DIGIT 0.059.",
        )
    if not 0.1 <= arguments.ball_mm <= 100.0:
        raise UsageError(f"--ball-mm {arguments.ball_mm:g}: not within 0.1 to 100.", remedy="Give its diameter.")
    radius_px = 0.5e-3 * arguments.ball_mm / pixel_m
    presses = read_press_folder(arguments.calibrate, radius_px, arguments.background)
    calibration = calibrate(presses, arguments.sensor or "gelsight", pixel_m)
    save_calibration(arguments.out, calibration)
    count = len(presses.frames)
    print(f"{arguments.out}: {count} presses; normals of left-out ones within {calibration.error_deg:.1f}°")
    return 0
