"""Reader of ball-press calibrations of camera-based touch sensors, as published by Taxim and ObjectFolder.

Z. Si & W. Yuan (2022), "Taxim: an example-based simulation model for GelSight tactile sensors", RA-L 7(2); R. Gao et
al. (2022), "ObjectFolder 2.0", CVPR. dataPack.npz: f0 (H, W, 3) the untouched sensor, imgs (n, H, W, 3), both 8-bit in
OpenCV's order blue, green, red; touch_center (n, 2) column and row, touch_radius (n,), measured by hand. polycalib.npz:
bins, grad_r, grad_g, grad_b (bins, bins, 6), in the same channel order despite their names. The ball's radius and the
pixel pitch are not in the files but in the published programs (Basics/sensorParams.py).
"""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FileError
from ..files import NPZ_ERRORS

Float = NDArray[np.float64]

BALL_RADIUS_M = 2e-3
"""Radius of the ball [m]."""
PIXEL_PITCH_M = {"objectfolder": 0.1245e-3, "taxim": 0.0295e-3}
"""Pixel pitch by data set [m]."""
MAX_UNPACKED_BYTES = 512 * 2**20
"""Largest accepted archive, unpacked [bytes]."""
_REMEDY = "Get the file again from the calibration's own repository."


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
class PolynomialTable:
    """Taxim's optics: change of colour against the background by the membrane's normal, as polynomials of the position.

    Attributes
    ----------
    coefficients : ndarray, shape (bins, bins, 3, 6)
        By the normal's tilt (0 to π/2) and direction (−π to π), for red, green, blue: coefficients of x², y², xy, x, y
        and 1 [pixels], in code values / 255.
    """

    coefficients: Float


def read_ball_presses(path: Path, ball_radius_px: float) -> BallPresses:
    """Read ball presses from a dataPack.npz, without pickle; raise FileError if it cannot be used."""
    arrays = _read_npz(path, ("f0", "imgs", "touch_center"))
    background, frames, centre = arrays["f0"], arrays["imgs"], arrays["touch_center"]
    if frames.ndim != 4 or frames.shape[1:] != background.shape or frames.shape[3] != 3 or not len(frames):
        raise FileError(f"frames {frames.shape}, background {background.shape}.", where=str(path), remedy=_REMEDY)
    if frames.dtype != np.uint8 or background.dtype != np.uint8:
        raise FileError(f"frames are {frames.dtype}, expected 8 bits.", where=str(path), remedy=_REMEDY)
    size = frames.shape[2], frames.shape[1]
    if centre.shape != (len(frames), 2) or not ((centre >= 0) & (centre < size)).all():
        raise FileError("a ball's centre is outside its frame.", where=str(path), remedy=_REMEDY)
    return BallPresses(
        frames[..., ::-1] / 255.0, background[..., ::-1] / 255.0, centre.astype(np.float64), ball_radius_px
    )


def read_polynomial_table(path: Path) -> PolynomialTable:
    """Read the colour table from a polycalib.npz, without pickle; raise FileError if it cannot be used."""
    names = ("grad_r", "grad_g", "grad_b")
    channels = list(_read_npz(path, names).values())
    shape = channels[0].shape
    if len(shape) != 3 or shape[0] != shape[1] or shape[2] != 6 or any(channel.shape != shape for channel in channels):
        raise FileError(
            f"{', '.join(names)} are {[channel.shape for channel in channels]}.", where=str(path), remedy=_REMEDY
        )
    values = np.stack(channels[::-1], axis=2).astype(np.float64)
    if not np.isfinite(values).all():
        raise FileError("a coefficient is not finite.", where=str(path), remedy=_REMEDY)
    return PolynomialTable(values / 255.0)


def _read_npz(path: Path, names: tuple[str, ...]) -> dict[str, NDArray[Any]]:
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
        if size > MAX_UNPACKED_BYTES:
            raise FileError(f"{size / 2**20:.0f} MB unpacked are too much.", where=str(path), remedy=_REMEDY)
        with np.load(path, allow_pickle=False) as archive:
            missing = [name for name in names if name not in archive]
            if missing:
                raise FileError(f"{', '.join(missing)} are missing.", where=str(path), remedy=_REMEDY)
            arrays = {name: np.asarray(archive[name]) for name in names}
    except NPZ_ERRORS as error:
        raise FileError(
            f"is no archive of plain arrays ({error}). Pickled ones are not read.", where=str(path), remedy=_REMEDY
        ) from error
    if any(array.dtype.kind not in "fiu" for array in arrays.values()):
        raise FileError("holds something else than numbers.", where=str(path), remedy=_REMEDY)
    return arrays
