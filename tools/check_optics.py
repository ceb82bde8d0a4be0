"""The optics model against published calibrations of real touch sensors. Prints Markdown tables.

Usage: python tools/check_optics.py DIR [--picture PNG] [--response PNG]

DIR holds ObjectFolder's dataPack.npz and polycalib.npz and Taxim's polycalib.npz files, in any arrangement whose folder
names say which is which (objectfolder…, taxim…, digit, …r1.5).
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from hnf_core.datasets.ball_calibration import (  # noqa: E402
    BALL_RADIUS_M,
    PIXEL_PITCH_M,
    read_ball_presses,
    read_polynomial_table,
)
from hnf_core.datasets.folders import find_files  # noqa: E402
from hnf_core.errors import HnfError  # noqa: E402
from hnf_core.evaluation.ball_press import fit_linear_optics, select_pixels_under  # noqa: E402
from hnf_core.evaluation.optics_check import (  # noqa: E402
    check_presses,
    check_table,
    format_ball_check,
    format_table_checks,
    get_lamps,
)
from hnf_core.evaluation.optics_picture import plot_presses, plot_response  # noqa: E402
from hnf_core.tactile.optics import SENSORS  # noqa: E402

# Frames' width and height: basics/sensorParams.py of ObjectFolder, Basics/sensorParams.py and the DIGIT's
# renderer/config_digit.py of Taxim, Isaac Lab's GELSIGHT_R15_CFG. The first word that a folder's name holds counts.
SENSOR_KINDS = {
    "objectfolder": ("GelSight (ObjectFolder)", (160, 120), "gelsight"),
    "r1.5": ("GelSight R1.5 (Taxim)", (240, 320), "gelsight"),
    "digit": ("DIGIT (Taxim)", (240, 320), "digit"),
    "taxim": ("GelSight (Taxim)", (640, 480), "gelsight"),
}
SHOWN_PRESSES = (1, 10, 35)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--picture", type=Path, help="real frames beside predicted ones")
    parser.add_argument("--response", type=Path, help="change of colour over tilt")
    given = parser.parse_args()
    try:
        print_report(given.folder, given.picture, given.response)
    except HnfError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


def print_report(folder: Path, image_path: Path | None, response_path: Path | None) -> None:
    tables = {}
    for path in find_files(folder, (".npz",)):
        where = str(path.relative_to(folder.parent)).lower()
        kind = next((kind for kind in SENSOR_KINDS if kind in where), None)
        if path.name == "polycalib.npz" and kind is not None:
            tables[kind] = read_polynomial_table(path)
    published = tables.get("objectfolder")
    for path in find_files(folder, (".npz",)):
        if path.name == "dataPack.npz":
            presses = read_ball_presses(path, BALL_RADIUS_M / PIXEL_PITCH_M["objectfolder"])
            check = check_presses(presses, published)
            print(
                f"{check.presses} presses, {check.pixels:,} pixels under the ball up to {check.contact_px:g} pixels "
                f"({check.steepest_deg:.0f}°); far from it frames differ by {check.noise_codes:.1f} codes.\n"
            )
            print(format_ball_check(check))
            fitted = fit_linear_optics(select_pixels_under(presses, check.contact_px), "difference").sensor
            for channel, (azimuth, elevation, strength) in zip(
                ("red", "green", "blue"), get_lamps(fitted), strict=True
            ):
                print(f"{channel}: lit from {azimuth:.0f}°, {elevation:.0f}° above the gel, strength {strength:.2f}")
            if image_path is not None and published is not None:
                plot_presses(image_path, presses, published, [each for each in SHOWN_PRESSES if each < check.presses])
            if response_path is not None and published is not None:
                plot_response(response_path, presses, published)
    print()
    print(format_table_checks([check_table(SENSOR_KINDS[kind][0], table, SENSOR_KINDS[kind][1], SENSORS[SENSOR_KINDS[kind][2]])
                           for kind, table in sorted(tables.items())]))  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
