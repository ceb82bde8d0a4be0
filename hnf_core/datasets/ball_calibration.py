"""Presses of a ball on a camera-based touch sensor: reading of a folder of them, and calibration of the sensor.

A ball of known size gives the true normal of every pixel under it (W. Yuan, S. Dong & E. Adelson 2017, "GelSight:
high-resolution robot tactile sensors", Sensors 17(12)). A folder holds pictures, or the presses that Taxim and
ObjectFolder publish:

Z. Si & W. Yuan (2022), "Taxim: an example-based simulation model for GelSight tactile sensors", RA-L 7(2); R. Gao et
al. (2022), "ObjectFolder 2.0", CVPR. dataPack.npz: f0 (H, W, 3) the untouched sensor, imgs (n, H, W, 3), both 8-bit in
OpenCV's order blue, green, red; touch_center (n, 2) column and row, measured by hand. The ball's radius and the pixel
pitch are not in the files but in the published programs (Basics/sensorParams.py).
"""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FileError, UsageError
from ..files import NPZ_ERRORS
from ..tactile.optics import get_sensor
from ..tactile.photometric_stereo import (
    MAX_PIXELS,
    TouchCalibration,
    compute_terms,
    decode_normals,
    fit_coefficients,
)
from .data_files import find_files
from .vision_touch import IMAGE_SUFFIXES, read_touch_image

Float = NDArray[np.float64]

BALL_RADIUS_M = 2e-3
"""Radius of the ball [m]."""
MAX_UNPACKED_BYTES = 512 * 2**20
"""Largest accepted archive, unpacked [bytes]."""
BACKGROUND_NAMES = ("background", "bg", "flat", "untouched")
"""Names of the picture of the untouched sensor in a folder of presses."""
MIN_BALL_CHANGE = 10.0 / 255.0
"""Least largest change of colour under a ball."""
MIN_PRESSES = 4
"""Least number of presses of a calibration; a dozen, spread over the window, are better."""
MIN_BALL_RADIUS_PX = 4.0
"""Least radius of a ball [pixels]."""
MIN_CONTACT_RADIUS_SHARE = 0.3
"""Least radius of the contact that is used, relative to the ball's."""
REMEDY = "Get the file again from the calibration's own repository."


@dataclass(frozen=True, eq=False)
class BallPresses:
    """A ball pressed at n positions; code values / 255 in the order red, green, blue, not linearised.

    Attributes
    ----------
    frames : ndarray, shape (n, H, W, 3)
        Images of the presses.
    background : ndarray, shape (H, W, 3)
        Image of the untouched sensor.
    centre_px : ndarray, shape (n, 2)
        Column and row of the ball's centre [pixels].
    ball_radius_px : float
        Radius of the ball, not of the contact [pixels].
    """

    frames: Float
    background: Float
    centre_px: Float
    ball_radius_px: float


@dataclass(frozen=True, eq=False)
class BallPixels:
    """The m pixels under balls: unit normals (m, 3), colours (m, 3), positions (m,) and press numbers (m,)."""

    normal: Float
    colour: Float
    background: Float
    column: Float
    row: Float
    press: NDArray[np.int64]

    def select(self, wanted: NDArray[np.bool_]) -> BallPixels:
        return BallPixels(*(getattr(self, name)[wanted] for name in self.__dataclass_fields__))

    @property
    def tilt(self) -> Float:
        """Angle between normal and gel, (m,) [rad]."""
        return np.asarray(np.arccos(np.clip(self.normal[:, 2], -1.0, 1.0)))


def find_contact_radius_px(presses: BallPresses) -> float:
    """Return the radius [pixels] at which frames differ most from the background.

    The difference is averaged over presses and directions. Under a ball the slope grows outwards; beyond the contact's
    edge the membrane leaves the ball and flattens.
    """
    change = np.abs(presses.frames - presses.background).mean(axis=-1)
    distance = np.hypot(*compute_offsets_px(presses))
    rings = [change[(distance >= r - 0.5) & (distance < r + 0.5)] for r in range(1, int(presses.ball_radius_px) + 1)]
    return 1.0 + float(np.argmax([ring.mean() if ring.size else 0.0 for ring in rings]))


def select_pixels_under(presses: BallPresses, radius_px: float) -> BallPixels:
    """Select the pixels less than `radius_px` from a ball's centre. Raises UsageError if the ball is smaller."""
    if not 0.0 < radius_px < presses.ball_radius_px:
        raise UsageError(f"{radius_px:g} pixels are no part of a ball of {presses.ball_radius_px:g}.")
    x, y = compute_offsets_px(presses)
    press, row, column = np.nonzero(np.hypot(x, y) < radius_px)
    flat = np.stack([x[press, row, column], y[press, row, column]], axis=1) / presses.ball_radius_px
    return BallPixels(
        normal=np.concatenate([flat, np.sqrt(1.0 - np.sum(flat**2, axis=1, keepdims=True))], axis=1),
        colour=presses.frames[press, row, column],
        background=presses.background[row, column],
        column=column.astype(np.float64),
        row=row.astype(np.float64),
        press=press,
    )


def compute_offsets_px(presses: BallPresses) -> tuple[Float, Float]:
    """Return the offsets of all pixels to the right of and above a ball's centre, (n, H, W) each."""
    rows, columns = presses.background.shape[:2]
    x = np.arange(columns)[None, None, :] - presses.centre_px[:, 0, None, None]
    y = presses.centre_px[:, 1, None, None] - np.arange(rows)[None, :, None]
    full_x, full_y = np.broadcast_arrays(x, y)
    return full_x, full_y


def read_ball_presses(path: Path, ball_radius_px: float) -> BallPresses:
    """Read ball presses from a dataPack.npz, without pickle; raise FileError if it cannot be used."""
    arrays = read_npz_arrays(path, ("f0", "imgs", "touch_center"))
    background, frames, centre = arrays["f0"], arrays["imgs"], arrays["touch_center"]
    if frames.ndim != 4 or frames.shape[1:] != background.shape or frames.shape[3] != 3 or not len(frames):
        raise FileError(f"frames {frames.shape}, background {background.shape}.", where=str(path), remedy=REMEDY)
    if frames.dtype != np.uint8 or background.dtype != np.uint8:
        raise FileError(f"frames are {frames.dtype}, expected 8 bits.", where=str(path), remedy=REMEDY)
    size = frames.shape[2], frames.shape[1]
    if centre.shape != (len(frames), 2) or not ((centre >= 0) & (centre < size)).all():
        raise FileError("a ball's center is outside its frame.", where=str(path), remedy=REMEDY)
    return BallPresses(
        frames[..., ::-1] / 255.0, background[..., ::-1] / 255.0, centre.astype(np.float64), ball_radius_px
    )


def read_press_folder(folder: Path, ball_radius_px: float, background: Path | None = None) -> BallPresses:
    """Read the presses in a folder: a dataPack.npz, or pictures of one size and a background among them.

    The ball's centres in pictures are found (`find_ball_centres`). `background` may name a picture elsewhere. Raises
    FileError if a file cannot be used, or there are fewer than `MIN_PRESSES`.
    """
    packs = [path for path in find_files(folder, (".npz",)) if path.name == "dataPack.npz"]
    if packs:
        return read_ball_presses(packs[0], ball_radius_px)
    paths = find_files(folder, IMAGE_SUFFIXES)
    flat = background or next((path for path in paths if path.stem.lower() in BACKGROUND_NAMES), None)
    if flat is None:
        raise FileError(
            "no picture of the untouched sensor is there.",
            where=str(folder),
            remedy="Call it background.png, or give it by --background.",
        )
    presses = [path for path in paths if path.resolve() != flat.resolve()]
    if len(presses) < MIN_PRESSES:
        raise FileError(
            f"{len(presses)} pictures of presses are too few.",
            where=str(folder),
            remedy=f"Press the ball at {MIN_PRESSES} places at least; a dozen over the window is better.",
        )
    untouched = read_touch_image(flat)
    if untouched.shape[0] * untouched.shape[1] > MAX_PIXELS:
        raise FileError(
            f"has {untouched.shape[1]} × {untouched.shape[0]} pixels, more than a calibration needs.",
            where=str(flat),
            remedy="Scale all pictures down to 640 pixels; the calibration then serves frames of any size.",
        )
    frames = [read_touch_image(path) for path in presses]
    for path, frame in zip(presses, frames, strict=True):
        if frame.shape != untouched.shape:
            raise FileError("has not the background's size.", where=str(path), remedy="Take both with one setting.")
        if np.sqrt(np.mean(np.square(frame - untouched), axis=-1)).max() < MIN_BALL_CHANGE:
            raise FileError("no ball is pressed in it.", where=str(path), remedy="Leave it out.")
    stack = np.stack(frames).astype(np.float64)
    centre = find_ball_centres(stack - untouched)
    return BallPresses(stack, untouched.astype(np.float64), centre, ball_radius_px)


def find_ball_centres(change: Float) -> Float:
    """Find the column and row (n, 2) of a ball [pixels] in changes (n, H, W, 3) against the background, to half pixels.

    A slope towards a lamp brightens as much as one away from it darkens: the centre c is the point about which the
    change is most antisymmetric, the minimum of its self-convolution at 2c.
    """
    shape = 2 * change.shape[1] - 1, 2 * change.shape[2] - 1
    centres = []
    for frame in change:
        spectra = np.fft.rfft2(np.moveaxis(frame, -1, 0), shape)
        row, column = np.unravel_index(np.argmin(np.fft.irfft2(np.sum(spectra**2, axis=0), shape)), shape)
        centres.append((0.5 * column, 0.5 * row))
    return np.array(centres)


def calibrate(presses: BallPresses, sensor: str, metres_per_pixel: float) -> TouchCalibration:
    """Calibrate a sensor by presses of a ball; the error is that of every other press, judged by the rest.

    Raises UsageError for fewer than `MIN_PRESSES`, or an unknown sensor.
    """
    max_slope = get_sensor(sensor).max_slope
    if len(presses.frames) < MIN_PRESSES:
        raise UsageError(f"{len(presses.frames)} presses are too few.", remedy=f"Give {MIN_PRESSES} or more.")
    rows, columns = presses.background.shape[:2]
    if not MIN_BALL_RADIUS_PX <= presses.ball_radius_px <= max(rows, columns):
        raise UsageError(
            f"the ball's radius is {presses.ball_radius_px:.3g} pixels of a frame of {columns} × {rows}.",
            remedy="Check --ball-mm and --mm-per-pixel.",
        )
    radius_px = max(find_contact_radius_px(presses), MIN_CONTACT_RADIUS_SHARE * presses.ball_radius_px)
    pixels = select_pixels_under(presses, min(radius_px, 0.99 * presses.ball_radius_px))
    terms = compute_terms(
        pixels.colour,
        pixels.background,
        2.0 * (pixels.column + 0.5) / columns - 1.0,
        2.0 * (pixels.row + 0.5) / rows - 1.0,
    )
    angle_deg = np.empty(len(terms))
    for parity in (0, 1):
        judged = pixels.press % 2 == parity
        gx, gy = decode_normals(terms[judged], fit_coefficients(terms[~judged], pixels.normal[~judged]), max_slope)
        cosine = np.sum(pixels.normal[judged] * np.stack([-gx, -gy, np.ones_like(gx)], axis=1), axis=1)
        cosine /= np.sqrt(1.0 + gx**2 + gy**2)
        angle_deg[judged] = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    coefficients = tuple(map(tuple, fit_coefficients(terms, pixels.normal).tolist()))
    return TouchCalibration(sensor, coefficients, rows, columns, metres_per_pixel, float(angle_deg.mean()))


def read_npz_arrays(path: Path, names: tuple[str, ...]) -> dict[str, NDArray[Any]]:
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
        if size > MAX_UNPACKED_BYTES:
            raise FileError(f"{size / 2**20:.0f} MB unpacked are too much.", where=str(path), remedy=REMEDY)
        with np.load(path, allow_pickle=False) as archive:
            missing = [name for name in names if name not in archive]
            if missing:
                raise FileError(f"{', '.join(missing)} are missing.", where=str(path), remedy=REMEDY)
            arrays = {name: np.asarray(archive[name]) for name in names}
    except NPZ_ERRORS as error:
        raise FileError(
            f"is no archive of plain arrays ({error}). Pickled ones are not read.", where=str(path), remedy=REMEDY
        ) from error
    if any(array.dtype.kind not in "fiu" for array in arrays.values()):
        raise FileError("holds something else than numbers.", where=str(path), remedy=REMEDY)
    return arrays
