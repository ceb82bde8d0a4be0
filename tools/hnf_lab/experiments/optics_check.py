"""Compare the project's optics (hnf_core.tactile.optics) with real touch sensors and published calibrations.

  Usage: python -m hnf_lab.experiments.optics_check DIR [--picture PNG] [--response PNG]

DIR holds ObjectFolder's dataPack.npz and polycalib.npz and Taxim's polycalib.npz files, in any arrangement whose folder
names identify them (objectfolder…, taxim…, digit, …r1.5). Prints Markdown tables; --picture plots real balls next to
the prediction of the fitted optics.

The question is how much of the response is linear in the surface normal. Ball presses: models are fitted to every other
press and tested on the rest, then the other way round. Published tables are tested on their own response, within the
range where they were calibrated.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, permutations, product
from pathlib import Path
from typing import TYPE_CHECKING

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np
from numpy.typing import NDArray

from hnf_core.datasets.ball_calibration import (
    BALL_RADIUS_M,
    BallPixels,
    BallPresses,
    compute_offsets_px,
    find_contact_radius_px,
    read_ball_presses,
    select_pixels_under,
)
from hnf_core.datasets.data_files import find_files
from hnf_core.errors import HnfError, UsageError
from hnf_core.export.figure import write_figure
from hnf_core.tactile.optics import SENSORS, Sensor
from hnf_core.tactile.photometric_stereo import SATURATION_VALUE
from hnf_core.units import linear_to_srgb, srgb_to_linear

from . import optics_models
from .optics_models import (
    PIXEL_PITCH_M,
    Form,
    LinearOptics,
    PolynomialTable,
    fit_linear_optics,
    make_sensor,
    mount_sensor,
    read_polynomial_table,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Float = NDArray[np.float64]

TILT_EDGES_DEG = (0.0, 15.0, 30.0, 45.0, 90.0)
REFIT_BINS = 40
DECODING_STRIDE = 16
"""Stride of the decoded pixels, since inverting a table tries every cell for every pixel."""
STEEPEST_DEG = 58.0
"""Largest tilt of the normals decoded from a table [degrees], the limit of the project's own decoding."""
FAR_DISTANCE_PX = 60.0
NOMINAL_SENSOR = SENSORS["gelsight"]
GRAZING_DEG = 20.0
LINEAR_NAMES: dict[Form, str] = {
    "frame": "ours, fitted to frames",
    "difference": "ours, fitted to frame − background",
    "ratio": "ours, fitted to frame / background",
}


@dataclass(frozen=True)
class OpticsRow:
    """Errors of one model.

    Attributes
    ----------
    numbers
        Number of fitted parameters.
    rms_codes
        Error of predicted pixels, in code values of 255.
    angle_deg
        Mean and median angle between true and decoded normal [degrees]; None if the model does not decode.
    by_tilt_codes
        RMS error per interval of TILT_EDGES_DEG.
    """

    name: str
    numbers: int
    rms_codes: float
    angle_deg: tuple[float, float] | None
    by_tilt_codes: tuple[float, ...]

    @property
    def psnr_db(self) -> float:
        return float(20.0 * np.log10(255.0 / self.rms_codes)) if self.rms_codes > 0.0 else float("inf")


@dataclass(frozen=True)
class BallCheck:
    """Results on ball presses. noise_codes: RMS change of pixels more than FAR_DISTANCE_PX from the ball."""

    presses: int
    pixels: int
    contact_px: float
    steepest_deg: float
    noise_codes: float
    rows: tuple[OpticsRow, ...]


@dataclass(frozen=True)
class TableCheck:
    """Results on a published table.

    Its change against the background (RMS, code values), and the residual after fitting twelve parameters, 72 that vary
    over the window, and the mounting and exposure of the nominal sensor.
    """

    name: str
    change_codes: float
    linear_codes: float
    varying_codes: float
    nominal_codes: float


@dataclass(frozen=True)
class _Prediction:
    colour: Float
    normal: Float | None
    sample: NDArray[np.bool_]


def check_presses(presses: BallPresses, published: PolynomialTable | None = None) -> BallCheck:
    """Test every model on every pixel under the balls.

    Parameters
    ----------
    presses
        Frames with balls of known size.
    published
        A table fitted to all presses, including those it is tested on: a lower bound rather than a fair comparison.

    Raises
    ------
    UsageError
        If there is only one press, or the presses do not span all normals.
    """
    if len(presses.frames) < 2:
        raise UsageError("one press can be fitted or judged, not both.", remedy="Give more presses.")
    contact = find_contact_radius_px(presses)
    pixels = select_pixels_under(presses, contact)
    methods: dict[str, tuple[int, Callable[[BallPixels, BallPixels], _Prediction]]] = {
        "untouched: the background": (
            0,
            lambda fit, judge: _Prediction(judge.background, None, _select_every(judge, 1)),
        ),
        "ours, nominal GelSight as it is": (
            0,
            lambda fit, judge: _predict_linear(_make_mounted_optics(NOMINAL_SENSOR.shading), judge),
        ),
        "ours, nominal GelSight, turned and exposed as fits best": (
            2,
            lambda fit, judge: _predict_linear(_fit_mount(fit, NOMINAL_SENSOR), judge),
        ),
        f"the same, its lamps {GRAZING_DEG:g}° above the gel instead of {NOMINAL_SENSOR.elevation_deg:g}°": (
            2,
            _predict_grazing,
        ),
        **{name: (12, _make_linear_predictor(form)) for form, name in LINEAR_NAMES.items()},
        "the same difference, code values decoded as sRGB first": (12, _predict_linearised),
        "linear in the normal, S a quadratic of the place": (72, _predict_varying),
        f"polynomials fitted anew ({REFIT_BINS} × {REFIT_BINS} cells)": (REFIT_BINS**2 * 18, _predict_refitted),
    }
    if published is not None:
        bins = len(published.coefficients)
        methods[f"published polynomials ({bins} × {bins} cells; saw every press)"] = (
            published.coefficients.size,
            lambda fit, judge: _predict_by_table(published, judge),
        )
    halves = [pixels.select(pixels.press % 2 == parity) for parity in (0, 1)]
    rows = []
    for name, (numbers, predict) in methods.items():
        predictions = [(judge, predict(fit, judge)) for fit, judge in (halves, halves[::-1])]
        rows.append(_make_row(name, numbers, predictions))
    far = (presses.frames - presses.background)[np.hypot(*compute_offsets_px(presses)) > FAR_DISTANCE_PX]
    return BallCheck(
        presses=len(presses.frames),
        pixels=len(pixels.press),
        contact_px=contact,
        steepest_deg=float(np.degrees(pixels.tilt.max())),
        noise_codes=255.0 * _compute_rms(far) if far.size else 0.0,
        rows=tuple(rows),
    )


def check_table(
    name: str, table: PolynomialTable, size_px: tuple[int, int], nominal: Sensor = NOMINAL_SENSOR
) -> TableCheck:
    """Test a published table at 15 positions in the middle 60 % of the frame, up to 52°.

    size_px: width and height of its frames. nominal: the project's sensor of that kind.
    """
    width, height = size_px
    directions, tilts = np.arange(0.0, 360.0, 6.0) + 3.0, np.arange(2.0, 53.0, 5.0)
    positions = [(x * width, y * height) for x, y in product((0.2, 0.35, 0.5, 0.65, 0.8), (0.25, 0.5, 0.75))]
    grid = np.array([(*position, tilt, towards) for position in positions for tilt in tilts for towards in directions])
    tilt, towards = np.radians(grid[:, 2]), np.radians(grid[:, 3])
    normal = np.stack([np.sin(tilt) * np.cos(towards), np.sin(tilt) * np.sin(towards), np.cos(tilt)], axis=1)
    grey = np.full((len(grid), 3), 0.5)
    flat_pixels = BallPixels(normal, grey, grey, grid[:, 0], grid[:, 1], np.zeros(len(grid), dtype=np.int64))
    change = optics_models.compute_polynomial_change(table, flat_pixels)
    pixels = BallPixels(normal, np.minimum(grey + change, 0.97), grey, grid[:, 0], grid[:, 1], flat_pixels.press)
    linear = fit_linear_optics(pixels, "difference").predict(pixels)
    mounted = _fit_mount(pixels, nominal).predict(pixels)
    residuals = (
        255.0 * _compute_rms(prediction - pixels.colour)
        for prediction in (linear, _predict_varying(pixels, pixels).colour, mounted)
    )
    return TableCheck(name, 255.0 * _compute_rms(change), *residuals)


def get_lamps(sensor: Sensor) -> list[tuple[float, float, float]]:
    """Return, per channel, azimuth and elevation of the light direction [degrees], and its strength."""
    lamps = []
    for x, y, z in sensor.shading:
        lamps.append((float(np.degrees(np.arctan2(y, x)) % 360.0), float(np.degrees(np.arctan2(z, np.hypot(x, y)))),
                    float(np.sqrt(x * x + y * y + z * z))))  # fmt: skip
    return lamps


def format_ball_check(check: BallCheck) -> str:
    """Format two tables: errors, and errors by tilt of the surface."""
    names = [f"{low:g}–{min(high, check.steepest_deg):.0f}°" for low, high in _list_tilt_ranges(check)]
    lines = [
        "| | numbers | RMS [codes] | PSNR [dB] | normal, mean (median) |",
        "|---|---:|---:|---:|---:|",
        *(
            f"| {row.name} | {row.numbers:,} | {row.rms_codes:.1f} | {row.psnr_db:.1f} | "
            + (f"{row.angle_deg[0]:.1f}° ({row.angle_deg[1]:.1f}°) |" if row.angle_deg else "– |")
            for row in check.rows
        ),
        "",
        f"| RMS [codes] where the ball is tilted by | {' | '.join(names)} |",
        "|---|" + "---:|" * len(names),
        *(
            f"| {row.name} | {' | '.join(f'{value:.1f}' for value in row.by_tilt_codes[: len(names)])} |"
            for row in check.rows
        ),
    ]
    return "\n".join(lines) + "\n"


def format_table_checks(checks: Sequence[TableCheck]) -> str:
    def left(each: TableCheck, codes: float) -> str:
        return f"{codes:.1f} ({100 * codes / each.change_codes:.0f} %)"

    lines = [
        "| published table | its change [codes] | twelve numbers leave | S a quadratic of the place | the nominal |",
        "|---|---:|---:|---:|---:|",
        *(
            f"| {each.name} | {each.change_codes:.1f} | {left(each, each.linear_codes)} | "
            f"{left(each, each.varying_codes)} | {left(each, each.nominal_codes)} |"
            for each in checks
        ),
    ]
    return "\n".join(lines) + "\n"


def _make_linear_predictor(form: Form) -> Callable[[BallPixels, BallPixels], _Prediction]:
    def predict(fit: BallPixels, judge: BallPixels) -> _Prediction:
        return _predict_linear(fit_linear_optics(fit, form), judge)

    return predict


def _predict_linear(optics: LinearOptics, test: BallPixels) -> _Prediction:
    return _Prediction(optics.predict(test), optics.decode(test), _select_every(test, 1))


def _predict_linearised(fit: BallPixels, test: BallPixels) -> _Prediction:
    """Predict with code values linearised like those of a photograph."""

    def linearise(pixels: BallPixels) -> BallPixels:
        return replace(pixels, colour=srgb_to_linear(pixels.colour), background=srgb_to_linear(pixels.background))

    prediction = _predict_linear(
        fit_linear_optics(linearise(fit.select((fit.colour < SATURATION_VALUE).all(axis=1))), "difference"),
        linearise(test),
    )
    return replace(prediction, colour=linear_to_srgb(prediction.colour))


def _predict_refitted(fit: BallPixels, test: BallPixels) -> _Prediction:
    return _predict_by_table(optics_models.fit_polynomial_table(fit, REFIT_BINS), test)


def _predict_by_table(table: PolynomialTable, test: BallPixels) -> _Prediction:
    sample = _select_every(test, DECODING_STRIDE)
    normal = optics_models.decode_polynomial(table, test.select(sample), np.radians(STEEPEST_DEG))
    return _Prediction(optics_models.predict_polynomial(table, test), normal, sample)


def _predict_grazing(fit: BallPixels, test: BallPixels) -> _Prediction:
    return _predict_linear(_fit_mount(fit, replace(NOMINAL_SENSOR, elevation_deg=GRAZING_DEG)), test)


def _predict_varying(fit: BallPixels, test: BallPixels) -> _Prediction:
    """Predict with ambient light and S each a quadratic of the position, for near lamps.

    This is not the project's model but the next more general one.
    """

    def terms(pixels: BallPixels, scale: Float) -> Float:
        x, y = pixels.column / scale[0], pixels.row / scale[1]
        return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)

    scale = np.array([fit.column.max(), fit.row.max()])
    light, known = fit.colour - fit.background, fit.colour < SATURATION_VALUE
    homogeneous = np.concatenate([fit.normal, np.ones((len(fit.normal), 1))], axis=1)
    columns = (homogeneous[:, :, None] * terms(fit, scale)[:, None, :]).reshape(len(homogeneous), -1)
    solved = [np.linalg.lstsq(columns[good], light[good, k], rcond=None)[0] for k, good in enumerate(known.T)]
    local_model = np.einsum("kit,mt->mki", np.reshape(solved, (3, 4, 6)), terms(test, scale))
    shading, ambient = local_model[:, :, :3], local_model[:, :, 3]
    colour = test.background + np.einsum("mki,mi->mk", shading, test.normal) + ambient
    normal = np.linalg.solve(shading, (test.colour - test.background - ambient)[:, :, None])[:, :, 0]
    normal *= np.sign(normal[:, 2:]) / np.linalg.norm(normal, axis=1, keepdims=True)
    return _Prediction(np.clip(colour, 0.0, 1.0), normal, _select_every(test, 1))


def _make_mounted_optics(shading: Float) -> LinearOptics:
    """Return a sensor's S as a change against a real background: 0 on the flat gel."""
    return LinearOptics(make_sensor(shading, -shading[:, 2]), "difference")


def _fit_mount(pixels: BallPixels, sensor: Sensor) -> LinearOptics:
    """Fit rotation (steps of 5°), reflection, channel order and exposure of a nominal sensor."""
    subset = pixels.select(_select_every(pixels, max(1, len(pixels.press) // 2000)))
    tilted, change = subset.normal - [0.0, 0.0, 1.0], subset.colour - subset.background
    best, least_error = sensor.shading, np.inf
    for angle, mirrored, order in product(np.arange(0.0, 360.0, 5.0), (False, True), permutations(range(3))):
        shading = mount_sensor(sensor, float(np.radians(angle)), mirrored, order).shading
        light = tilted @ shading.T
        exposure = max(0.0, float(np.sum(light * change) / np.sum(light * light)))
        error = _compute_rms(exposure * light - change)
        if error < least_error:
            best, least_error = exposure * shading, error
    return _make_mounted_optics(best)


def _select_every(pixels: BallPixels, step: int) -> NDArray[np.bool_]:
    return np.asarray(np.arange(len(pixels.press)) % step == 0)


def _make_row(name: str, numbers: int, results: Sequence[tuple[BallPixels, _Prediction]]) -> OpticsRow:
    error = np.concatenate([guess.colour - pixels.colour for pixels, guess in results])
    tilt = np.degrees(np.concatenate([pixels.tilt for pixels, _ in results]))
    bins = [error[(tilt >= low) & (tilt < high)] for low, high in pairwise(TILT_EDGES_DEG)]
    angles = [
        np.arccos(np.clip(np.sum(guess.normal * pixels.normal[guess.sample], axis=1), -1.0, 1.0))
        for pixels, guess in results
        if guess.normal is not None
    ]
    angle = np.degrees(np.concatenate(angles)) if angles else np.zeros(0)
    return OpticsRow(
        name=name,
        numbers=numbers,
        rms_codes=255.0 * _compute_rms(error),
        angle_deg=(float(angle.mean()), float(np.median(angle))) if angles else None,
        by_tilt_codes=tuple(255.0 * _compute_rms(each) if each.size else 0.0 for each in bins),
    )


def _list_tilt_ranges(check: BallCheck) -> list[tuple[float, float]]:
    return [(low, high) for low, high in pairwise(TILT_EDGES_DEG) if low < check.steepest_deg]


def _compute_rms(values: Float) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


CELL_PX, HEAD_PX, LEFT_PX, FOOT_PX = 150, 84, 96, 46
MARGIN_PX = 6
"""Margin of the frame shown around the contact [pixels]."""
MAX_SHOWN_CODES = 60.0
RESPONSE_PANEL_PX = (380, 340)
MAX_OFF_AXIS = 0.25
"""Largest component of the normal across a lamp's direction, of the pixels plotted along it."""


def plot_presses(path: Path, presses: BallPresses, published: PolynomialTable, press_numbers: Sequence[int]) -> None:
    """Plot presses with predictions and errors.

    Per press: the frame, the linear model fitted to the presses of other parity, the published polynomials, and the
    errors of both. Predictions cover the ball only; the real frame is around it.

    Raises
    ------
    FileError
        If matplotlib is missing or the file cannot be written.
    """
    radius = find_contact_radius_px(presses)
    pixels = select_pixels_under(presses, radius)
    rows = []
    for number in press_numbers:
        ours = fit_linear_optics(pixels.select(pixels.press % 2 != number % 2), "difference")
        press_pixels = pixels.select(pixels.press == number)
        pixel_index = press_pixels.row.astype(int), press_pixels.column.astype(int)
        frame = presses.frames[number]
        predictions = []
        for colour in (ours.predict(press_pixels), optics_models.predict_polynomial(published, press_pixels)):
            prediction = frame.copy()
            prediction[pixel_index] = colour
            predictions.append(prediction)
        column, row = presses.centre_px[number]
        reach = radius + MARGIN_PX
        window = (slice(max(0, round(row - reach)), round(row + reach)),
                  slice(max(0, round(column - reach)), round(column + reach)))  # fmt: skip
        rows.append([each[window] for each in (frame, *predictions)])
    titles = ("frame", "ours, 12 numbers", "polynomials, saw it", "error of ours", "of polynomials")
    size = (LEFT_PX + CELL_PX * len(titles) + 90, HEAD_PX + CELL_PX * len(rows) + FOOT_PX)

    def draw(figure: Figure) -> None:
        figure.text(0.02, 1.0 - 26 / size[1], "A 4 mm ball on a GelSight", fontsize=14, fontweight="bold")
        for line, (number, (frame, ours, polynomial)) in enumerate(zip(press_numbers, rows, strict=True)):
            errors = [255.0 * np.abs(each - frame).mean(axis=-1) for each in (ours, polynomial)]
            for column_index, values in enumerate((frame, ours, polynomial, *errors)):
                left = (LEFT_PX + CELL_PX * column_index) / size[0]
                bottom = 1.0 - (HEAD_PX + CELL_PX * (line + 1)) / size[1]
                axes = figure.add_axes((left, bottom, (CELL_PX - 8) / size[0], (CELL_PX - 8) / size[1]))
                axes.set_axis_off()
                image = axes.imshow(values, cmap="magma", vmin=0.0, vmax=MAX_SHOWN_CODES, interpolation="nearest")
                if line == 0:
                    axes.set_title(titles[column_index], fontsize=10.5, loc="left")
            figure.text(0.02, 1.0 - (HEAD_PX + CELL_PX * (line + 0.5)) / size[1], f"press {number + 1}", fontsize=10.5)
        bar = figure.add_axes(((LEFT_PX + CELL_PX * 5 + 6) / size[0], FOOT_PX / size[1], 12 / size[0], 0.5))
        figure.colorbar(image, cax=bar, label="codes of 255")

    write_figure(path, size, draw)


def plot_response(path: Path, presses: BallPresses, published: PolynomialTable) -> None:
    """Plot each channel's change over the tilt of the surface towards the lamp.

    Median and quartiles of every second press are shown with the linear model fitted to the others.

    Raises
    ------
    FileError
        If matplotlib is missing or the file cannot be written.
    """
    pixels = select_pixels_under(presses, find_contact_radius_px(presses))
    ours = fit_linear_optics(pixels.select(pixels.press % 2 == 0), "difference")
    test_pixels = pixels.select(pixels.press % 2 == 1)
    measured = 255.0 * (test_pixels.colour - test_pixels.background)
    predictions = {
        "ours, 12 numbers": ("#0072b2", ours.predict(test_pixels)),
        "polynomials, saw them": ("#d55e00", optics_models.predict_polynomial(published, test_pixels)),
    }
    size = (3 * RESPONSE_PANEL_PX[0], RESPONSE_PANEL_PX[1] + 66)

    def draw(figure: Figure) -> None:
        figure.text(0.02, 1.0 - 26 / size[1], "Colour of a real GelSight under a ball", fontsize=14, fontweight="bold")
        for channel, (name, lamp) in enumerate(zip(("red", "green", "blue"), get_lamps(ours.sensor), strict=True)):
            axes = figure.add_axes(((70 + channel * RESPONSE_PANEL_PX[0]) / size[0], 92 / size[1],
                                    (RESPONSE_PANEL_PX[0] - 90) / size[0],
                                    (RESPONSE_PANEL_PX[1] - 100) / size[1]))  # fmt: skip
            lamp_direction = np.array([np.cos(np.radians(lamp[0])), np.sin(np.radians(lamp[0]))])
            along = test_pixels.normal[:, :2] @ lamp_direction
            near = np.abs(test_pixels.normal[:, :2] @ [-lamp_direction[1], lamp_direction[0]]) < MAX_OFF_AXIS
            edges = np.linspace(-0.8, 0.8, 17)
            steps = [(0.5 * (a + b), near & (along >= a) & (along < b)) for a, b in pairwise(edges)]
            bins = [in_bin for _, in_bin in steps if in_bin.any()]
            tilt_deg = np.degrees(np.arcsin([middle for middle, in_bin in steps if in_bin.any()]))
            low, middle, high = np.transpose(
                [np.percentile(measured[in_bin, channel], [25, 50, 75]) for in_bin in bins]
            )
            axes.fill_between(tilt_deg, low, high, color="#1c2430", alpha=0.15, lw=0)
            axes.plot(
                tilt_deg,
                middle,
                color="#1c2430",
                lw=2.6,
                label=f"{len(np.unique(test_pixels.press))} real presses: median, quartiles",
            )
            for label, (colour, prediction) in predictions.items():
                change = 255.0 * (prediction - test_pixels.background)[:, channel]
                axes.plot(tilt_deg, [np.median(change[in_bin]) for in_bin in bins], color=colour, lw=1.6, label=label)
            axes.set_title(f"{name}, lit from {lamp[0]:.0f}°", fontsize=10.5, loc="left")
            axes.set_xlabel("tilt towards the lamp [°]")
            if channel == 0:
                axes.set_ylabel("frame − background [codes]")
        figure.legend(*axes.get_legend_handles_labels(), loc="lower center", ncol=3, frameon=False, fontsize=9.5)

    write_figure(path, size, draw)


# Width and height of the frames are from basics/sensorParams.py of ObjectFolder, Basics/sensorParams.py and
# renderer/config_digit.py of Taxim, and Isaac Lab's GELSIGHT_R15_CFG. The first key found in a path is used.
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
    parser.add_argument("--response", type=Path, help="change of color over tilt")
    arguments = parser.parse_args()
    try:
        print_report(arguments.folder, arguments.picture, arguments.response)
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
    print(format_table_checks([check_table(SENSOR_KINDS[kind][0], table, SENSOR_KINDS[kind][1],
    SENSORS[SENSOR_KINDS[kind][2]])
                           for kind, table in sorted(tables.items())]))  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
