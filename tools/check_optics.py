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
    PITCH_M,
    read_ball_presses,
    read_polynomial_table,
)
from hnf_core.datasets.folders import files_below  # noqa: E402
from hnf_core.errors import HnfError  # noqa: E402
from hnf_core.evaluation.ball_press import fit_linear, pixels_under  # noqa: E402
from hnf_core.evaluation.optics_check import (  # noqa: E402
    check_presses,
    check_table,
    lamps_of,
    markdown,
    tables_markdown,
)
from hnf_core.evaluation.optics_picture import presses_picture, response_picture  # noqa: E402
from hnf_core.tactile.optics import SENSORS  # noqa: E402

# Frames' width and height: basics/sensorParams.py of ObjectFolder, Basics/sensorParams.py and the DIGIT's
# renderer/config_digit.py of Taxim, Isaac Lab's GELSIGHT_R15_CFG. The first word that a folder's name holds counts.
KINDS = {
    "objectfolder": ("GelSight (ObjectFolder)", (160, 120), "gelsight"),
    "r1.5": ("GelSight R1.5 (Taxim)", (240, 320), "gelsight"),
    "digit": ("DIGIT (Taxim)", (240, 320), "digit"),
    "taxim": ("GelSight (Taxim)", (640, 480), "gelsight"),
}
SHOWN = (1, 10, 35)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--picture", type=Path, help="real frames beside predicted ones")
    parser.add_argument("--response", type=Path, help="change of colour over tilt")
    given = parser.parse_args()
    try:
        report(given.folder, given.picture, given.response)
    except HnfError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


def report(folder: Path, picture: Path | None, response: Path | None) -> None:
    tables = {}
    for path in files_below(folder, (".npz",)):
        where = str(path.relative_to(folder.parent)).lower()
        kind = next((kind for kind in KINDS if kind in where), None)
        if path.name == "polycalib.npz" and kind is not None:
            tables[kind] = read_polynomial_table(path)
    published = tables.get("objectfolder")
    for path in files_below(folder, (".npz",)):
        if path.name == "dataPack.npz":
            presses = read_ball_presses(path, BALL_RADIUS_M / PITCH_M["objectfolder"])
            check = check_presses(presses, published)
            print(
                f"{check.presses} presses, {check.pixels:,} pixels under the ball up to {check.contact_px:g} pixels "
                f"({check.steepest_deg:.0f}°); far from it frames differ by {check.noise_codes:.1f} codes.\n"
            )
            print(markdown(check))
            fitted = fit_linear(pixels_under(presses, check.contact_px), "difference").sensor
            for channel, (azimuth, elevation, strength) in zip(("red", "green", "blue"), lamps_of(fitted), strict=True):
                print(f"{channel}: lit from {azimuth:.0f}°, {elevation:.0f}° above the gel, strength {strength:.2f}")
            if picture is not None and published is not None:
                presses_picture(picture, presses, published, [each for each in SHOWN if each < check.presses])
            if response is not None and published is not None:
                response_picture(response, presses, published)
    print()
    print(tables_markdown([check_table(KINDS[kind][0], table, KINDS[kind][1], SENSORS[KINDS[kind][2]])
                           for kind, table in sorted(tables.items())]))  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
