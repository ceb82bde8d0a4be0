"""Optics of a vision-based touch sensor: from height field to sensor image, and from image back to slopes.

Photometric stereo (Woodham 1980) as in GelSight (Johnson & Adelson 2009): a matte membrane over the surface, three
directional lamps, one colour each with some cross-talk. With n the unit normal of the membrane,

    I = ambient + S n,    S = crosstalk · diag(intensity) · lamp directions,

so that three channels give n by one linear solve, exact wherever every lamp reaches the membrane.

Frame: column → +x, row → −y; gradients are ∂h/∂x and ∂h/∂y with y up.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import UsageError
from ..progress import add_work
from .fourier_filters import apply_filters, frequencies, gaussian_mtf

Float = NDArray[np.float64]


@dataclass(frozen=True)
class Sensor:
    """A vision-based touch sensor.

    Attributes
    ----------
    name : str
        Name in `SENSORS`.
    azimuth_deg : tuple of 3 floats
        Direction of each lamp in the tangent plane [°]; 0 = +x, 90 = +y.
    elevation_deg : float
        Elevation of the lamps above the plane [°].
    intensity : tuple of 3 floats
        Intensity of each lamp.
    crosstalk : tuple, shape (3, 3)
        Response of each camera channel (row) to each lamp (column).
    ambient : tuple of 3 floats
        Light that does not depend on the normal.
    gel_sigma_m : float
        σ of the gel's Gaussian transfer exp(−2π²σ²f²) from surface to membrane [m].
    max_slope : float
        Limit of the membrane's slope, since it tents over steeper walls; the direction is preserved. Every lamp must
        reach it: max_slope < tan(elevation).
    """

    name: str
    azimuth_deg: tuple[float, float, float]
    elevation_deg: float
    intensity: tuple[float, float, float]
    crosstalk: tuple[tuple[float, float, float], ...]
    ambient: tuple[float, float, float]
    gel_sigma_m: float
    max_slope: float

    @property
    def shading(self) -> Float:
        """Matrix S (3, 3) from unit normal to channel values above ambient."""
        azimuth, elevation = np.radians(self.azimuth_deg), np.radians(self.elevation_deg)
        lamps = np.stack(
            [np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.full(3, np.sin(elevation))],
            axis=1,
        )
        return np.asarray(np.asarray(self.crosstalk) @ (np.asarray(self.intensity)[:, None] * lamps))

    @property
    def background(self) -> Float:
        """Color (3,) of the sensor image of a flat surface."""
        return np.asarray(np.asarray(self.ambient) + self.shading[:, 2])


SENSORS = MappingProxyType(
    {
        # Red shines from the top, green and blue from lower left and lower right; a mirrored surface swaps these two.
        "gelsight": Sensor(
            name="gelsight",
            azimuth_deg=(90.0, 210.0, 330.0),
            elevation_deg=60.0,
            intensity=(0.5, 0.5, 0.5),
            crosstalk=((1.0, 0.08, 0.08), (0.08, 1.0, 0.08), (0.08, 0.08, 1.0)),
            ambient=(0.04, 0.04, 0.04),
            gel_sigma_m=12e-6,
            max_slope=1.6,
        ),
        # Unequal lamps on three sides of a rectangular window, with stronger cross-talk, and a stiffer gel.
        "digit": Sensor(
            name="digit",
            azimuth_deg=(180.0, 90.0, 0.0),
            elevation_deg=58.0,
            intensity=(0.55, 0.45, 0.6),
            crosstalk=((1.0, 0.15, 0.05), (0.12, 1.0, 0.12), (0.05, 0.15, 1.0)),
            ambient=(0.06, 0.05, 0.07),
            gel_sigma_m=18e-6,
            max_slope=1.5,
        ),
    }
)


def get_sensor(name: str) -> Sensor:
    """Return a sensor by its name; raise UsageError for an unknown one."""
    try:
        return SENSORS[name]
    except KeyError:
        raise UsageError(
            f"no touch sensor is called '{name}'.", remedy=f"Choose one of {', '.join(SENSORS)}."
        ) from None


def gel_gradients(height_m: ArrayLike, metres_per_pixel: float, sensor: Sensor) -> tuple[Float, Float]:
    """Return the slopes (∂h/∂x, ∂h/∂y), (H, W) each, of the sensor's gel membrane pressed on a height field.

    The height is smoothed by a Gaussian and differentiated in the Fourier domain (exact up to the limit of the pixel
    grid); slopes are limited to `sensor.max_slope`.
    """
    height = np.asarray(height_m, dtype=np.float64)

    def responses(shape: tuple[int, int]) -> list[NDArray[np.complex128]]:
        fx, fy = frequencies(shape, metres_per_pixel)
        mtf = gaussian_mtf(np.hypot(fx, fy), sensor.gel_sigma_m)
        # The derivative of a real signal has no Nyquist term on an even grid.
        keep_x = np.abs(fx) * metres_per_pixel < 0.5 - 1e-9
        keep_y = np.abs(fy) * metres_per_pixel < 0.5 - 1e-9
        return [2j * np.pi * fx * keep_x * mtf, 2j * np.pi * fy * keep_y * mtf]

    (gx, gy), (slope_x, slope_y) = apply_filters(height, metres_per_pixel, responses, "odd", 6.0 * sensor.gel_sigma_m)
    return limit_slope(gx + slope_x, gy + slope_y, sensor.max_slope)


def limit_slope(gx: Float, gy: Float, max_slope: float) -> tuple[Float, Float]:
    """Limit the length of gradients to `max_slope`; directions are preserved."""
    scale = np.minimum(1.0, max_slope / np.maximum(np.hypot(gx, gy), 1e-30))
    return gx * scale, gy * scale


def shade(gx: ArrayLike, gy: ArrayLike, sensor: Sensor) -> NDArray[np.float32]:
    """Return the linear sensor image (H, W, 3), float32, of a gel membrane with slopes `gx`, `gy` (H, W)."""
    gx, gy = np.asarray(gx, dtype=np.float64), np.asarray(gy, dtype=np.float64)
    normal = np.stack([-gx, -gy, np.ones_like(gx)], axis=-1) / np.sqrt(1.0 + gx**2 + gy**2)[..., None]
    return np.asarray(normal @ sensor.shading.T + np.asarray(sensor.ambient), dtype=np.float32)


def render_sensor_image(height_m: ArrayLike, metres_per_pixel: float, sensor: Sensor) -> NDArray[np.float32]:
    """Render the linear sensor image of a height field.

    Parameters
    ----------
    height_m : array_like, shape (H, W)
        Heights [m].
    metres_per_pixel : float
        Pixel size [m].
    sensor : Sensor
        The sensor.

    Returns
    -------
    ndarray of float32, shape (H, W, 3)
        The image. A flat surface gives `sensor.background`; small slopes change the image linearly.

    Raises
    ------
    UsageError
        For a height field that is not a finite two-dimensional array.
    """
    add_work("sensor_images")
    height = np.asarray(height_m, dtype=np.float64)
    if height.ndim != 2 or min(height.shape) < 2 or not np.isfinite(height).all():
        raise UsageError(
            f"a height field must be a finite (H, W) array, not {height.shape}.",
            remedy="Fill or mask missing pixels first.",
        )
    return shade(*gel_gradients(height, metres_per_pixel, sensor), sensor)


def decode_gradients(image: ArrayLike, sensor: Sensor) -> tuple[Float, Float]:
    """Decode the membrane's slopes from a linear sensor image, by photometric stereo.

    Parameters
    ----------
    image : array_like, shape (H, W, 3)
        Linear sensor image.
    sensor : Sensor
        The sensor.

    Returns
    -------
    tuple of ndarray, shape (H, W) each
        Slopes ∂h/∂x and ∂h/∂y. Exact up to `sensor.max_slope`; steeper normals, which only a damaged or foreign image
        has, are limited to it. Overall brightness cancels out.
    """
    pixels = np.asarray(image, dtype=np.float64)
    normal = (pixels - np.asarray(sensor.ambient)) @ np.linalg.inv(sensor.shading).T
    # A normal on or below the horizon has no finite slope, so it is clamped to a grazing one before the limit.
    upward = np.maximum(normal[..., 2], 1e-6)
    return limit_slope(-normal[..., 0] / upward, -normal[..., 1] / upward, sensor.max_slope)


AZIMUTH_SCATTER_DEG = 8.0
"""Half-width of the uniform scatter of a lamp's azimuth [°]."""
ELEVATION_SCATTER_DEG = (-3.0, 6.0)
"""Range of the scatter of elevation [°]; mostly upwards, since lower lamps would leave the steepest slopes dark."""
INTENSITY_SCATTER = 0.15
"""Half-width of the relative scatter of a lamp's intensity."""
CROSSTALK_SCATTER = 0.05
"""Half-width of the scatter of cross-talk."""
AMBIENT_SCATTER = 0.03
"""Half-width of the scatter of ambient light."""
