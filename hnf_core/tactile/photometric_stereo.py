"""Photometric stereo of a real touch image: frame and background → slopes of the membrane → height and tactile map.

A calibration gives the membrane's unit normal as a polynomial of frame / background − 1 in three channels, its
coefficients linear in the place, since lamps are near: 54 numbers, fitted to presses of a ball of known size
(`datasets.ball_calibration`; W. Yuan, S. Dong & E. Adelson 2017, "GelSight: high-resolution robot tactile sensors",
Sensors 17(12), use a look-up table of the same). No change of colour is no slope. Frame as in `optics`.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import FileError, SceneError, UsageError
from ..files import write_text
from ..json_io import encode_json, load_json, parse_record
from .fourier_filters import decimate, frequencies
from .height import height_from_slopes, low_pass
from .image_resolution import box_filter
from .optics import get_sensor, limit_slope, shade
from .tactile_map import Route, TactileMap

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]

FORMAT = "hnf-touch-calibration-1"
TERM_COUNT = 27
"""Number of terms of the polynomial: nine of colour, each times 1, x and y."""
RIDGE = 1e-6
"""Weight of the coefficients' squares in the fit, relative to the number of pixels."""
SATURATION_VALUE = 250.0 / 255.0
"""Code value from which a pixel counts as clipped."""
DARKEST_VALUE = 8.0 / 255.0
"""Smallest value of the background that a frame is divided by."""
MAX_CLIPPED_SHARE = 0.25
"""Largest accepted share of pixels with a channel that is clipped in the frame but not in the background."""
MIN_CHANGE = 1.0 / 255.0
"""Least smoothed change of colour (RMS of the channels) of a contact, beyond that of noise."""
NOISE_FACTOR = 1.5
"""Smoothed change of colour of pure noise, over its standard deviation, with a margin."""
CONTACT_SHARE = 0.2
"""Change of colour of a contact, relative to the frame's largest (98th percentile)."""
CONTACT_DETAIL_SHARE = 0.08
"""Shortest wavelength in the outline of a contact, relative to the frame's shorter side."""
CONTACT_GAP_SHARE = 0.3
"""Widest gap in a contact that is closed, relative to the frame's shorter side: level parts change no colour."""
MIN_CONTACT_SHARE = 0.002
"""Least share of the frame that a contact covers."""
MIN_INTEGRABILITY_DB = 10.0 * np.log10(3.0)
"""Power of the slopes' integrable part over that of their curl, from which an octave counts as resolved [dB]: noise
and wrong normals have as much of both, a surface has no curl."""
MAX_PIXELS = 1 << 20
"""Number of pixels to which larger frames are reduced."""


@dataclass(frozen=True)
class TouchCalibration:
    """Calibration of one touch sensor, for frames of any size and of the same aspect ratio.

    Attributes
    ----------
    sensor : str
        Name in `optics.SENSORS`: gel and nominal optics.
    coefficients : tuple, shape (TERM_COUNT, 2)
        From `compute_terms` to the x and y components of the membrane's unit normal.
    rows, columns : int
        Size of the calibrated frames [pixels].
    metres_per_pixel : float
        Their pixel size [m].
    error_deg : float or None
        Mean angle between true and decoded normals of presses that were left out [°]; None for nominal optics.
    """

    sensor: str
    coefficients: tuple[tuple[float, ...], ...]
    rows: int
    columns: int
    metres_per_pixel: float
    error_deg: float | None = None

    def __post_init__(self) -> None:
        get_sensor(self.sensor)
        if len(self.coefficients) != TERM_COUNT or any(len(row) != 2 for row in self.coefficients):
            raise ValueError(f"coefficients are not ({TERM_COUNT}, 2)")
        if min(self.rows, self.columns) < 8 or not self.metres_per_pixel > 0.0:
            raise ValueError("its frame has no size")


@dataclass(frozen=True)
class DecodedTouch:
    """A decoded touch image: its tactile map, the integrability of its slopes [dB], and notes in words."""

    tactile_map: TactileMap
    integrability_db: float
    notes: tuple[str, ...]


NOMINAL_LAMPS = {
    "gelsight": ((283.0, 352.0, 95.0), (1.09, 1.31, 1.68), 20.3e-3),
    "digit": ((5.0, 243.0, 165.0), (0.67, 0.41, 0.65), 19.0e-3),
}
"""Direction that red, green and blue shine from [°], relative change of each per component of the normal, and the
frame's longer side [m]: a GelSight Mini, and a DIGIT held upright (docs/touch-images.md)."""


def get_nominal_calibration(sensor: str, rows: int, columns: int) -> TouchCalibration:
    """Return the calibration of a typical sensor of a kind; raise UsageError for an unknown one."""
    get_sensor(sensor)
    azimuth_deg, contrast, side_m = NOMINAL_LAMPS[sensor]
    turn_deg = -90.0 if sensor == "digit" and columns > rows else 0.0
    azimuth = np.radians(np.asarray(azimuth_deg) + turn_deg)
    lamps = np.asarray(contrast)[:, None] * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    coefficients = np.zeros((TERM_COUNT, 2))
    coefficients[:3] = np.linalg.pinv(lamps).T
    return TouchCalibration(
        sensor, tuple(map(tuple, coefficients.tolist())), rows, columns, side_m / max(rows, columns)
    )


def save_calibration(path: Path, calibration: TouchCalibration) -> None:
    """Write a calibration as JSON, atomically; raise FileError if the disk refuses."""
    write_text(path, encode_json(calibration, format=FORMAT) + "\n")


def load_calibration(path: Path) -> TouchCalibration:
    """Read a calibration from JSON; raise FileError if it is missing or damaged."""
    try:
        record = load_json(path.read_text(encoding="utf-8"))
        if not isinstance(record, dict) or record.pop("format", None) != FORMAT:
            raise ValueError(f"its format is not {FORMAT}")
        return parse_record(TouchCalibration, record)
    except (OSError, ValueError, RecursionError, UsageError) as error:
        raise FileError(
            f"is no calibration of a touch sensor ({getattr(error, 'strerror', None) or error}).",
            where=str(path),
            remedy="Make one from presses of a ball: hnf describe --calibrate FOLDER --out FILE.json",
        ) from error


def compute_terms(colour: Float, background: Float, x: Float, y: Float) -> Float:
    """Return the polynomial's terms (…, TERM_COUNT) of colours (…, 3) and places −1 to 1 (…), rightwards and downwards.

    Colours are code values / 255, not linearized.
    """
    change = colour / np.maximum(background, DARKEST_VALUE) - 1.0
    products = [change[..., i] * change[..., j] for i, j in combinations_with_replacement(range(3), 2)]
    colours = np.concatenate([change, np.stack(products, axis=-1)], axis=-1)
    return np.concatenate([colours, colours * x[..., None], colours * y[..., None]], axis=-1)


def fit_coefficients(terms: Float, normals: Float) -> Float:
    """Fit coefficients (TERM_COUNT, 2) of terms (n, TERM_COUNT) to unit normals (n, 3), by ridge regression."""
    gram = terms.T @ terms + RIDGE * len(terms) * np.eye(TERM_COUNT)
    return np.asarray(np.linalg.solve(gram, terms.T @ normals[:, :2]))


def decode_normals(terms: Float, coefficients: ArrayLike, max_slope: float) -> tuple[Float, Float]:
    """Return the slopes ∂h/∂x and ∂h/∂y (…) of terms (…, TERM_COUNT), limited to `max_slope`."""
    lateral = terms @ np.asarray(coefficients)
    limit = max_slope / np.hypot(1.0, max_slope)
    lateral = lateral * np.minimum(1.0, limit / np.maximum(np.linalg.norm(lateral, axis=-1), 1e-30))[..., None]
    upward = np.sqrt(1.0 - np.sum(lateral**2, axis=-1))
    return limit_slope(-lateral[..., 0] / upward, -lateral[..., 1] / upward, max_slope)


def decode_touch_image(
    frame: ArrayLike,
    background: ArrayLike | None = None,
    calibration: TouchCalibration | None = None,
    *,
    sensor: str = "gelsight",
    metres_per_pixel: float | None = None,
) -> DecodedTouch:
    """Decode a frame of a real touch sensor to a tactile map, as the nominal sensor of its kind would show it.

    Parameters
    ----------
    frame : array_like, shape (H, W, 3)
        The frame: code values / 255, not linearized.
    background : array_like, shape (H, W, 3), or None
        Frame of the untouched sensor; None takes a smooth surface through the frame itself.
    calibration : TouchCalibration or None
        Calibration of this sensor; None takes nominal optics, and the map's route is then predicted.
    sensor : str
        Kind of sensor, without a calibration.
    metres_per_pixel : float or None
        Pixel size of the frame [m]; None takes the calibration's.

    Returns
    -------
    DecodedTouch
        Map (its mask is the contact), integrability and notes.

    Raises
    ------
    UsageError
        If sizes do not fit, or the sensor is unknown.
    SceneError
        If the frame is overexposed, or shows no contact.
    """
    colour = np.asarray(frame, dtype=np.float64)
    rows, columns = colour.shape[:2]
    notes = []
    if calibration is None:
        calibration = get_nominal_calibration(sensor, rows, columns)
        notes.append(f"no calibration: the lamps of a typical {sensor} are assumed, so heights are a rough guess")
    elif abs(rows * calibration.columns - columns * calibration.rows) > max(rows, columns, calibration.columns):
        raise UsageError(
            f"the frame has {columns} × {rows} pixels, the calibration's {calibration.columns} × {calibration.rows}.",
            remedy="Give an uncropped frame of the calibrated sensor.",
        )
    pixel_m = metres_per_pixel or calibration.metres_per_pixel * calibration.columns / columns
    row, column = (2.0 * (np.arange(size) + 0.5) / size - 1.0 for size in (rows, columns))
    if background is None:
        flat = _fit_smooth_background(colour, row, column)
        notes.append("no background: dirt and flaws of the gel count as relief; take a frame of the untouched sensor")
    else:
        flat = np.asarray(background, dtype=np.float64)
        if flat.shape != colour.shape:
            raise UsageError(
                f"the background has {flat.shape[1]} × {flat.shape[0]} pixels, the frame {columns} × {rows}.",
                remedy="Take both with the same settings of the camera.",
            )
    clipped = (colour >= SATURATION_VALUE) & (flat < SATURATION_VALUE)
    if clipped.any(axis=-1).mean() > MAX_CLIPPED_SHARE:
        raise SceneError(
            f"{clipped.any(axis=-1).mean():.0%} of the frame is overexposed.",
            remedy="Lower the camera's exposure or gain, and take the background again.",
        )
    if (factor := int(np.ceil(np.sqrt(rows * columns / MAX_PIXELS)))) > 1:
        colour, flat = (np.asarray(decimate(image, factor), dtype=np.float64) for image in (colour, flat))
        clipped, pixel_m = np.zeros(colour.shape, dtype=bool), pixel_m * factor
        row, column = (2.0 * (np.arange(size) + 0.5) / size - 1.0 for size in colour.shape[:2])
    contact = np.ones(colour.shape[:2], dtype=bool) if background is None else find_contact(colour, flat)
    y, x = np.meshgrid(row, column, indexing="ij")
    optics = get_sensor(calibration.sensor)
    gx, gy = decode_normals(compute_terms(colour, flat, x, y), calibration.coefficients, optics.max_slope)
    known = clipped.sum(axis=-1) < 2
    height = height_from_slopes(gx, gy, known, pixel_m)
    wavelength_m, integrability_db = measure_integrability(gx, gy, pixel_m)
    if integrability_db < MIN_INTEGRABILITY_DB:
        notes.append("the slopes hardly fit together: the calibration is another sensor's, or the frame is noise")
    route = Route.PREDICTED if calibration.error_deg is None else Route.MEASURED
    source = "nominal optics" if calibration.error_deg is None else f"calibration within {calibration.error_deg:.1f}°"
    tactile_map = TactileMap(
        shade(gx, gy, optics), height.astype(np.float32), contact & known, pixel_m, optics.name, wavelength_m, route,
        source,
    )  # fmt: skip
    return DecodedTouch(tactile_map, integrability_db, tuple(notes))


def find_contact(frame: Float, background: Float) -> Mask:
    """Return a mask (H, W) of the region where a frame differs from the background; raise SceneError if none does."""
    difference = frame - background
    change = np.sqrt(np.mean(np.square(difference), axis=-1))
    change = low_pass(change, 1.0, CONTACT_DETAIL_SHARE * min(change.shape))
    # Differences along both diagonals of 2 × 2 pixels hold the noise, and least of the relief (Donoho's estimate).
    diagonal = np.diff(np.diff(difference, axis=0), axis=1)
    noise = 0.5 * float(np.median(np.abs(diagonal))) / 0.6745
    limit = max(MIN_CHANGE + NOISE_FACTOR * noise, CONTACT_SHARE * float(np.percentile(change, 98.0)))
    seen = change > limit
    if seen.mean() < MIN_CONTACT_SHARE:
        raise SceneError(
            "nothing touches the sensor: the frame is like its background.",
            remedy="Give a frame of the pressed sensor, and the background of the same day.",
        )
    reach = max(1, round(0.5 * CONTACT_GAP_SHARE * min(seen.shape)))
    grown = box_filter(np.pad(seen, 2 * reach).astype(np.float64), reach) > 1e-9
    closed = box_filter((~grown).astype(np.float64), reach) < 1e-9
    inside = slice(2 * reach, -2 * reach)
    return np.asarray(closed[inside, inside])


def measure_integrability(gx: Float, gy: Float, metres_per_pixel: float) -> tuple[float, float]:
    """Return the shortest resolved wavelength [m], and the power of the slopes' integrable part over their curl [dB].

    Both are measured in octaves; the wavelength is that of the finest octave above `MIN_INTEGRABILITY_DB`, inf if none
    is.
    """
    window = np.outer(np.hanning(gx.shape[0] + 2)[1:-1], np.hanning(gx.shape[1] + 2)[1:-1])
    spectrum_x, spectrum_y = (np.fft.rfft2(window * (slope - slope.mean())) for slope in (gx, gy))
    fx, fy = frequencies((gx.shape[0], gx.shape[1]), metres_per_pixel)
    square = np.maximum(fx**2 + fy**2, 1e-300)
    octave = np.clip(np.floor(np.log2(0.5 / (np.sqrt(square) * metres_per_pixel))), -1, 15).astype(int) + 1
    along, across = (
        np.bincount(octave.ravel(), (np.abs(part) ** 2 / square).ravel(), 17)
        for part in (fx * spectrum_x + fy * spectrum_y, fx * spectrum_y - fy * spectrum_x)
    )
    ratio_db = 10.0 * np.log10(np.maximum(along, 1e-30) / np.maximum(across, 1e-30))
    longest = int(np.log2(min(gx.shape)))
    resolved = [i for i in range(1, longest) if ratio_db[i] >= MIN_INTEGRABILITY_DB]
    wavelength = 2.0 ** resolved[0] * metres_per_pixel if resolved else float("inf")
    total_db = 10.0 * np.log10(max(along[1:].sum(), 1e-30) / max(across[1:].sum(), 1e-30))
    return wavelength, float(total_db)


def _fit_smooth_background(frame: Float, row: Float, column: Float) -> Float:
    """Return a cubic surface (H, W, 3) through each channel of a frame."""
    down, right = np.vander(row, 4), np.vander(column, 4)
    smooth_rows, smooth_columns = down @ np.linalg.pinv(down), right @ np.linalg.pinv(right)
    return np.asarray(np.stack([smooth_rows @ channel @ smooth_columns for channel in np.moveaxis(frame, -1, 0)], -1))
