"""Decoding of real touch images (hnf_core.tactile.photometric_stereo), held against what is known of their heights.

Usage: python -m hnf_lab.experiments.touch_images DATA

DATA holds, at any depth, ObjectFolder's dataPack.npz (presses of a ball of known size), GelSight Mini frames of steel
NAME_gelsight.png beside NAME_depth.npy [pixels] (gelsight-contrastive-learning; the depths are another program's
decoding), Taxim's digit/polycalib.npz, and TrueMap heights (.tmd). Prints a Markdown table for each that is there:

- balls: radius and height of a press that the calibration has not seen;
- lamps: direction and contrast of red, green and blue, from which the nominal calibrations are;
- steel: height and level by octave of frames decoded with nominal optics, of places that gave no lamp;
- maps: level by octave of heights drawn as frames of 8 bits and decoded by a calibration from drawn balls.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hnf_core.datasets.ball_calibration import (
    BALL_RADIUS_M,
    BallPixels,
    BallPresses,
    calibrate,
    find_ball_centres,
    find_contact_radius_px,
    read_ball_presses,
)
from hnf_core.datasets.data_files import find_files
from hnf_core.datasets.vision_touch import read_touch_image
from hnf_core.errors import HnfError
from hnf_core.material.band_descriptor import describe, measure_octave_heights
from hnf_core.material.token import BAND_WAVELENGTHS_M, LEVELS
from hnf_core.tactile.height import fill_masked, remove_plane, tactile_map_from_height
from hnf_core.tactile.optics import SENSORS, render_sensor_image
from hnf_core.tactile.photometric_stereo import TouchCalibration, decode_touch_image

from .heights import read_tmd
from .optics_models import PIXEL_PITCH_M, compute_polynomial_change, read_polynomial_table

Float = NDArray[np.float64]

MINI_PIXEL_M = 63.4e-6
"""Pixel size of the GelSight Mini's frames of 320 × 240 pixels [m]."""
MIN_TILT = 0.05
"""Least sine of the tilt of pixels that lamps are fitted to."""
DRAWN_SHAPE, DRAWN_PIXEL_M = (480, 640), 30e-6
"""Rows and columns of drawn frames of a ball, and their pixel size [m]."""
OCTAVES = [f"{1e3 * wave:g} mm" for wave in BAND_WAVELENGTHS_M]


def fit_sphere(height_px: Float, centre_px: Float, radius_px: float) -> float:
    """Return the radius [pixels] of the sphere that fits heights within `radius_px` of a centre."""
    row, column = np.indices(height_px.shape)
    x, y = column - centre_px[0], row - centre_px[1]
    inside = np.hypot(x, y) < radius_px
    points = np.stack([x[inside], y[inside], height_px[inside] - height_px[inside].max()], axis=1)
    terms = np.concatenate([points, np.ones((len(points), 1))], axis=1)
    solution = np.linalg.lstsq(terms, np.sum(points**2, axis=1), rcond=None)[0]
    return float(np.sqrt(solution[3] + np.sum((0.5 * solution[:3]) ** 2)))


def judge_balls(presses: BallPresses, pixel_m: float) -> list[str]:
    """Return a Markdown table of errors of each press, decoded by a calibration from the others."""
    contact = find_contact_radius_px(presses)
    found = find_ball_centres(presses.frames - presses.background)
    offset = found - presses.centre_px
    error_deg = calibrate(presses, "gelsight", pixel_m).error_deg
    rows = [
        f"{len(presses.frames)} presses, {contact:g} pixels of contact; normals of every other press are off by "
        f"{error_deg:.1f}°. Found centers are {np.hypot(*offset.T).mean():.1f} pixels from the marked ones, "
        f"{np.hypot(*offset.mean(axis=0)):.1f} of them the same for all. Median over presses (90 % are better).",
        "",
        "| | radius off by [%] | amount [%] | height off by [µm RMS] | slopes fit together [dB] |",
        "|---|---:|---:|---:|---:|",
    ]
    sources = {
        "calibrated, centers marked by hand": presses.centre_px,
        "calibrated, centers found": found,
        "nominal": None,
    }
    for name, centres in sources.items():
        results = []
        for index, frame in enumerate(presses.frames):
            calibration = None
            if centres is not None:
                others = np.arange(len(presses.frames)) != index
                calibration = calibrate(
                    BallPresses(presses.frames[others], presses.background, centres[others], presses.ball_radius_px),
                    "gelsight",
                    pixel_m,
                )
            decoded = decode_touch_image(frame, presses.background, calibration, metres_per_pixel=pixel_m)
            height = np.asarray(decoded.tactile_map.height, dtype=np.float64) / pixel_m
            radius = fit_sphere(height, presses.centre_px[index], contact)
            row, column = np.indices(height.shape)
            x, y = column - presses.centre_px[index, 0], row - presses.centre_px[index, 1]
            inside = np.hypot(x, y) < contact
            true = np.sqrt(np.maximum(presses.ball_radius_px**2 - x**2 - y**2, 0.0))
            error = remove_plane(height - true, inside)[inside]
            results.append(
                (radius / presses.ball_radius_px - 1.0, 1e6 * pixel_m * error.std(), decoded.integrability_db)
            )
        off, micrometres, together = np.transpose(results)
        rows.append(
            f"| {name} | {100 * np.median(off):+.1f} | {100 * np.median(np.abs(off)):.1f} "
            f"({100 * np.percentile(np.abs(off), 90):.1f}) | {np.median(micrometres):.0f} "
            f"({np.percentile(micrometres, 90):.0f}) | {np.median(together):.1f} |"
        )
    return rows


def fit_lamps(normals: Float, change: Float) -> list[tuple[float, float]]:
    """Return direction [°] and contrast of three channels from unit normals (n, 3) and relative changes (n, 3)."""
    steep = np.hypot(normals[:, 0], normals[:, 1]) > MIN_TILT
    lamps = np.linalg.lstsq(normals[steep, :2], change[steep], rcond=None)[0].T
    return [(float(np.degrees(np.arctan2(y, x)) % 360.0), float(np.hypot(x, y))) for x, y in lamps]


def compute_digit_response(path: Path) -> tuple[Float, Float]:
    """Return normals and relative changes of Taxim's DIGIT, at 15 places, up to 52°, on a background of half."""
    grid = np.array(list(product((48, 84, 120, 156, 192), (80, 160, 240), range(2, 53, 5), range(3, 363, 6))), float)
    tilt, towards = np.radians(grid[:, 2]), np.radians(grid[:, 3])
    normal = np.stack([np.sin(tilt) * np.cos(towards), np.sin(tilt) * np.sin(towards), np.cos(tilt)], axis=1)
    grey = np.full((len(grid), 3), 0.5)
    pixels = BallPixels(normal, grey, grey, grid[:, 0], grid[:, 1], np.zeros(len(grid), dtype=np.int64))
    return normal, compute_polynomial_change(read_polynomial_table(path), pixels) / 0.5


def read_steel(folder: Path) -> tuple[Float, Float]:
    """Return the frames (n, H, W, 3) and depths (n, H, W) [pixels] of the steel in a folder, by name."""
    paths = [path for path in find_files(folder, (".png",)) if path.stem.endswith("_gelsight")]
    depths = [np.load(path.with_name(path.name.replace("_gelsight.png", "_depth.npy"))) for path in paths]
    return np.array([read_touch_image(path) for path in paths], float), np.array(depths, float)


def compute_depth_normals(depth: Float) -> Float:
    """Return the unit normals (…, H, W, 3) of depths (…, H, W) [pixels]."""
    down, right = np.gradient(depth, axis=(-2, -1))
    return np.stack([-right, down, np.ones_like(depth)], axis=-1) / np.sqrt(1.0 + down**2 + right**2)[..., None]


def judge_steel(frames: Float, depths: Float, background: Float) -> list[str]:
    """Return a Markdown table of errors of frames (n, H, W, 3) against depths (n, H, W), by nominal optics."""
    rows = [
        f"| | height off by [of its RMS] | correlation | {' | '.join(OCTAVES[1:])} | slopes fit together [dB] |",
        "|---|---:|---:|" + "---:|" * len(OCTAVES),
    ]
    for name, flat in (("background given", background), ("none", None)):
        results = []
        for frame, depth in zip(frames, depths, strict=True):
            decoded = decode_touch_image(frame, flat, metres_per_pixel=MINI_PIXEL_M)
            ours = remove_plane(np.asarray(decoded.tactile_map.height, dtype=np.float64))
            true = remove_plane(depth * MINI_PIXEL_M)
            whole = np.ones(true.shape, dtype=bool)
            levels = [measure_octave_heights(each, whole, MINI_PIXEL_M)[2:] for each in (ours, true)]
            results.append(
                (
                    (ours - true).std() / true.std(), np.mean(ours * true) / (ours.std() * true.std()),
                    *(20.0 * np.log10(levels[0] / levels[1])), decoded.integrability_db,
                )
            )  # fmt: skip
        off, correlation, *levels, together = np.median(results, axis=0)
        cells = " | ".join(f"{level:+.1f}" for level in levels)
        rows.append(f"| {name} | {off:.2f} | {correlation:.2f} | {cells} | {together:.1f} |")
    return rows


def quantize(image: NDArray[np.floating], rng: np.random.Generator, noise: float) -> Float:
    """Return an image as a camera of 8 bits would, with noise of a standard deviation [codes]."""
    return np.clip(np.rint(255.0 * image + noise * rng.standard_normal(image.shape)), 0, 255) / 255.0


def draw_presses(sensor: str, rng: np.random.Generator, noise: float) -> BallPresses:
    """Draw a ball of 4 mm pressed at twelve places on the nominal sensor."""
    y, x = np.indices(DRAWN_SHAPE).astype(float)
    optics, frames, centres = SENSORS[sensor], [], []
    for column, row in product(np.linspace(0.2, 0.8, 4), np.linspace(0.25, 0.75, 3)):
        centre = column * DRAWN_SHAPE[1], row * DRAWN_SHAPE[0]
        radius_px = BALL_RADIUS_M / DRAWN_PIXEL_M
        distance = np.hypot(x - centre[0], y - centre[1])
        ball = np.maximum(np.sqrt(np.maximum(radius_px**2 - distance**2, 0.0)) - 0.75 * radius_px, 0.0)
        frames.append(quantize(render_sensor_image(ball * DRAWN_PIXEL_M, DRAWN_PIXEL_M, optics), rng, noise))
        centres.append(centre)
    flat = quantize(np.broadcast_to(optics.background, (*DRAWN_SHAPE, 3)), rng, 0.0)
    return BallPresses(np.stack(frames), flat, np.array(centres), BALL_RADIUS_M / DRAWN_PIXEL_M)


def judge_map(name: str, path: Path, calibrations: dict[str, TouchCalibration], rng: np.random.Generator) -> list[str]:
    """Return rows of a Markdown table: level of a map by octave, decoded from a drawn frame, less the true one."""
    height, (pixel_m, _) = read_tmd(path)
    height = remove_plane(fill_masked(height, np.isfinite(height)))
    rows = []
    for sensor, calibration in calibrations.items():
        true = describe(tactile_map_from_height(height, None, pixel_m, 2.0 * pixel_m, sensor))
        frame = quantize(render_sensor_image(height, pixel_m, SENSORS[sensor]), rng, 1.0)
        flat = quantize(np.broadcast_to(SENSORS[sensor].background, frame.shape), rng, 0.0)
        # The drawn light is the same everywhere, so that a map of any shape stands for a piece of a frame.
        fitting = TouchCalibration(
            sensor, calibration.coefficients, *height.shape, calibration.metres_per_pixel, calibration.error_deg
        )
        decoded = describe(decode_touch_image(frame, flat, fitting, metres_per_pixel=pixel_m).tactile_map)
        both = true.known[LEVELS] & decoded.known[LEVELS]
        off = 20.0 * (decoded.values - true.values)[LEVELS]
        cells = [f"{each:+.1f}" if known else "–" for each, known in zip(off, both, strict=True)]
        rows.append(f"| {name} | {sensor} | {' | '.join(cells)} |")
    return rows


def main(words: Sequence[str] | None = None) -> int:
    """Print the tables; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, metavar="DATA")
    try:
        tables = make_tables(parser.parse_args(words).folder)
    except (HnfError, ValueError) as error:
        print(error, file=sys.stderr)
        return 1
    if not tables:
        print("Nothing measured is there. Give a folder with dataPack.npz, *_gelsight.png or *.tmd.", file=sys.stderr)
        return 1
    print("\n\n".join("\n".join(table) for table in tables))
    return 0


def make_tables(folder: Path) -> list[list[str]]:
    """Return the tables of what is in a folder."""
    tables, rng = [], np.random.default_rng(0)
    lamps = ["| | red | green | blue |", "|---|---:|---:|---:|"]
    for path in find_files(folder, (".npz",)):
        if path.name == "dataPack.npz":
            pixel_m = PIXEL_PITCH_M["objectfolder"]
            tables.append(judge_balls(read_ball_presses(path, BALL_RADIUS_M / pixel_m), pixel_m))
        elif path.parent.name == "digit":
            lamps.append(_format_lamps("DIGIT (Taxim's table)", *compute_digit_response(path)))
    frames, depths = read_steel(folder)
    if len(frames) >= 4:
        background = np.median(frames, axis=0)
        normals = compute_depth_normals(depths[::2]).reshape(-1, 3)
        change = (frames[::2] / np.maximum(background, 8.0 / 255.0) - 1.0).reshape(-1, 3)
        lamps.append(_format_lamps("GelSight Mini (every second place of the steel)", normals, change))
        tables.append(judge_steel(frames[1::2], depths[1::2], background))
    tables += [lamps] if len(lamps) > 2 else []
    maps = [path for path in find_files(folder, (".tmd",)) if path.stem in ("money", "paper", "gelsight_groove")]
    if maps:
        calibrations = {
            sensor: calibrate(draw_presses(sensor, rng, 1.0), sensor, DRAWN_PIXEL_M) for sensor in ("gelsight", "digit")
        }
        errors = ", ".join(f"{name} {each.error_deg:.1f}°" for name, each in calibrations.items())
        tables.append([f"Calibrations from drawn balls: {errors}.", "",
                       f"| map | sensor | {' | '.join(OCTAVES)} |", "|---|---|" + "---:|" * len(OCTAVES),
                       *(row for path in maps for row in judge_map(path.stem, path, calibrations, rng))])  # fmt: skip
    return tables


def _format_lamps(name: str, normals: Float, change: Float) -> str:
    cells = [f"{towards:.0f}°, {contrast:.2f}" for towards, contrast in fit_lamps(normals, change)]
    return f"| {name} | {' | '.join(cells)} |"


if __name__ == "__main__":
    raise SystemExit(main())
