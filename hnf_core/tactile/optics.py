"""The touch sensor's eye: a gel pressed on a height field, lit by coloured lamps, seen by a camera, and read back.

Photometric stereo (Woodham 1980) as in GelSight (Johnson & Adelson 2009): a matte membrane over the surface, three
directional lamps, one colour each with some cross-talk. With n the unit normal of the membrane,

    I = ambient + S n,    S = crosstalk · diag(intensity) · lamp directions,

so that three channels give n back by one linear solve, exact wherever every lamp reaches the membrane.

Frame: column → +x, row → −y; gradients are ∂h/∂x and ∂h/∂y with y up.

Sensors of one make differ: the same gel under other lamps, so that no network learns one lamp's colours.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import UsageError
from .fourier_filters import apply_filters, frequencies, gaussian_mtf

Float = NDArray[np.float64]


@dataclass(frozen=True)
class Sensor:
    """A vision-based touch sensor.

    azimuth_deg: three lamps, the direction each shines from in the tangent plane (0 = +x, 90 = +y).
    elevation_deg: of the lamps above the plane. intensity: of each lamp. crosstalk: (3, 3), row = camera channel,
    column = lamp. ambient: (3,) light that does not depend on the normal. gel_sigma_m: the membrane follows the
    surface with the Gaussian transfer exp(−2π²σ²f²). max_slope: the membrane tents over steeper walls: the length of
    the gradient is limited to this, its direction kept. Every lamp must reach that slope: max_slope < tan(elevation).
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
        """S: (3, 3), unit normal → channel values above ambient."""
        azimuth, elevation = np.radians(self.azimuth_deg), np.radians(self.elevation_deg)
        lamps = np.stack(
            [np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.full(3, np.sin(elevation))],
            axis=1,
        )
        return np.asarray(np.asarray(self.crosstalk) @ (np.asarray(self.intensity)[:, None] * lamps))

    @property
    def background(self) -> Float:
        """(3,) colour of a flat surface."""
        return np.asarray(np.asarray(self.ambient) + self.shading[:, 2])


SENSORS = MappingProxyType(
    {
        # Red from the top, green and blue from lower left and lower right: a mirrored surface swaps green and blue.
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
        # Lamps on three sides of a rectangular window, unequal, with stronger cross-talk; a stiffer gel.
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
    """The sensor of that name. Raises UsageError for an unknown one."""
    try:
        return SENSORS[name]
    except KeyError:
        raise UsageError(
            f"no touch sensor is called '{name}'.", remedy=f"Choose one of {', '.join(SENSORS)}."
        ) from None


def gel_gradients(height_m: ArrayLike, metres_per_pixel: float, sensor: Sensor) -> tuple[Float, Float]:
    """Slopes (∂h/∂x, ∂h/∂y), (H, W) each, of the membrane lying on a height field.

    Gaussian-smoothed height, differentiated in the Fourier domain (exact up to the pixel grid's own limit), the
    slope limited to sensor.max_slope.
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
    """Gradients no longer than max_slope, directions kept."""
    scale = np.minimum(1.0, max_slope / np.maximum(np.hypot(gx, gy), 1e-30))
    return gx * scale, gy * scale


def shade(gx: ArrayLike, gy: ArrayLike, sensor: Sensor) -> NDArray[np.float32]:
    """(H, W, 3) float32 linear picture of a membrane with these slopes."""
    gx, gy = np.asarray(gx, dtype=np.float64), np.asarray(gy, dtype=np.float64)
    normal = np.stack([-gx, -gy, np.ones_like(gx)], axis=-1) / np.sqrt(1.0 + gx**2 + gy**2)[..., None]
    return np.asarray(normal @ sensor.shading.T + np.asarray(sensor.ambient), dtype=np.float32)


def render_sensor_image(height_m: ArrayLike, metres_per_pixel: float, sensor: Sensor) -> NDArray[np.float32]:
    """(H, W, 3) float32 linear sensor image of a height field (H, W) in metres.

    A flat or evenly raised surface gives sensor.background; small slopes change the picture linearly.
    Raises UsageError on a height field that is not a finite two-dimensional array.
    """
    height = np.asarray(height_m, dtype=np.float64)
    if height.ndim != 2 or min(height.shape) < 2 or not np.isfinite(height).all():
        raise UsageError(
            f"a height field must be a finite (H, W) array, not {height.shape}.",
            remedy="Fill or mask missing pixels first.",
        )
    return shade(*gel_gradients(height, metres_per_pixel, sensor), sensor)


def decode_gradients(image: ArrayLike, sensor: Sensor) -> tuple[Float, Float]:
    """Slopes (∂h/∂x, ∂h/∂y), (H, W) each, from a linear sensor image (H, W, 3).

    Exact (to the image's precision) for slopes up to sensor.max_slope. Steeper normals, which only a damaged or
    foreign image holds, come back limited to that slope; overall brightness cancels out.
    """
    pixels = np.asarray(image, dtype=np.float64)
    normal = (pixels - np.asarray(sensor.ambient)) @ np.linalg.inv(sensor.shading).T
    # A normal on or below the horizon has no finite slope: hold it at a grazing one and let the limit act.
    upward = np.maximum(normal[..., 2], 1e-6)
    return limit_slope(-normal[..., 0] / upward, -normal[..., 1] / upward, sensor.max_slope)


AZIMUTH_SCATTER_DEG = 8.0
ELEVATION_SCATTER_DEG = (-3.0, 6.0)
INTENSITY_SCATTER = 0.15
CROSSTALK_SCATTER = 0.05
AMBIENT_SCATTER = 0.03
"""Half-widths of uniform scatter. Elevation leans upwards: lower lamps would leave the steepest slopes dark."""


def perturb_sensor(sensor: Sensor, rng: np.random.Generator) -> Sensor:
    """Another piece of the same sensor: lamps turned and lifted, brighter or darker, more or less cross-talk and
    ambient light. Its gel (sigma, slope limit) and name stay, and every lamp reaches the slope limit still."""
    lowest = float(np.degrees(np.arctan(sensor.max_slope))) + 0.5
    off_diagonal = 1.0 - np.eye(3)
    scatter = rng.uniform(-CROSSTALK_SCATTER, CROSSTALK_SCATTER, (3, 3)) * off_diagonal
    crosstalk = np.clip(np.asarray(sensor.crosstalk) + scatter, 0.0, None)
    return replace(
        sensor,
        azimuth_deg=_to_triple(
            np.asarray(sensor.azimuth_deg) + rng.uniform(-AZIMUTH_SCATTER_DEG, AZIMUTH_SCATTER_DEG, 3)
        ),
        elevation_deg=max(lowest, sensor.elevation_deg + float(rng.uniform(*ELEVATION_SCATTER_DEG))),
        intensity=_to_triple(
            np.asarray(sensor.intensity) * (1.0 + rng.uniform(-INTENSITY_SCATTER, INTENSITY_SCATTER, 3))
        ),
        crosstalk=tuple(_to_triple(row) for row in crosstalk),
        ambient=_to_triple(
            np.clip(np.asarray(sensor.ambient) + rng.uniform(-AMBIENT_SCATTER, AMBIENT_SCATTER, 3), 0.0, None)
        ),
    )


def _to_triple(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
