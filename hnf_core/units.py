"""All unit conversions of the project, which works in m, s, N, m/s², Hz and rad.

Also the sRGB transfer function.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

STANDARD_GRAVITY = 9.80665
"""Standard gravity [m/s²]."""


def srgb_to_linear(code: ArrayLike) -> NDArray[np.float64]:
    """Convert sRGB values (0 to 1) to linear ones (IEC 61966-2-1)."""
    code = np.asarray(code, dtype=np.float64)
    return np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)


def mm_to_m(value: float) -> float:
    """Convert mm to m, or mm/s to m/s."""
    return value * 1e-3


def m_to_mm(value: float) -> float:
    """Convert m to mm, or m/s to mm/s."""
    return value * 1e3


def power_to_db(power: ArrayLike) -> NDArray[np.float64]:
    """Convert a power ratio to dB, 10 log10; zero power gives -inf without a warning."""
    with np.errstate(divide="ignore"):
        return np.asarray(10.0 * np.log10(np.asarray(power, dtype=np.float64)))


def frame_to_seconds(frame: float, start: float, fps: float, fps_base: float) -> float:
    """Return the time of a (fractional) Blender frame since the stroke's start frame [s]."""
    return (frame - start) * fps_base / fps


def seconds_to_frame(seconds: float, start: float, fps: float, fps_base: float) -> float:
    """Return the (fractional) Blender frame at a time since the stroke's start frame [s]."""
    return start + seconds * fps / fps_base


def linear_to_srgb(rgb: NDArray[Any]) -> NDArray[np.float64]:
    """Convert linear values to sRGB (IEC 61966-2-1); values out of range are clipped, NaN becomes 0."""
    linear = np.clip(np.nan_to_num(np.asarray(rgb, dtype=np.float64), nan=0.0, posinf=1.0, neginf=0.0), 0.0, 1.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
