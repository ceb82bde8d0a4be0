"""Encoder E as a band descriptor ("band-descriptor-1"): from tactile map to material token, by spectra in octave bands.

The sensor image is decoded to slopes and divided by the gel's transfer function, so that any sensor of `tactile.optics`
gives the same token. The height spectrum follows from the windowed slopes, P = |κ·G|² / κ⁴ (the curl-free part; Frankot
& Chellappa 1988), band by band. `token.py` has the layout.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import UsageError
from ..tactile.fourier_filters import evaluate_plane, fit_plane, frequencies, gaussian_mtf
from ..tactile.optics import decode_gradients, get_sensor
from ..tactile.tactile_map import TactileMap
from .token import (
    BAND_FEATURES,
    BAND_WAVELENGTHS_M,
    CLEAR_PEAK_SHARE,
    SHAPE_FEATURES,
    SMOOTH_LEVEL,
    TOKEN_DIM,
    Token,
    band_slice,
)

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]

BAND_COUNT = len(BAND_WAVELENGTHS_M)
BAND_EDGE_RATIO = np.sqrt(2.0)
"""Ratio of a band's edge to its centre."""
MIN_PERIODS = 2.0
"""Least number of periods of a band's centre wavelength in the patch."""
MIN_SHAPE_BANDS = 3
"""Least number of known bands at which skewness and kurtosis count as known: fewer octaves do not show pits and
grains."""
FLOOR_M2 = (10.0**SMOOTH_LEVEL) ** 2
"""Mean square height of a smooth band [m²]."""
FEATHER_M = 0.4e-3
"""Distance over which the window falls to zero at the border of the mask [m]."""


@dataclass(frozen=True)
class _Grid:
    """Quantities of the rfft2 bins (H, W//2 + 1) of a map that depend only on its size, cached.

    `fx`, `fy` and `square` cover all bins, the others only the n active ones, those within the wavelength bands.

    Attributes
    ----------
    fx, fy, square : ndarray
        Frequencies along both axes [cycles/m], and fx² + fy².
    active : ndarray of int
        Flat indices of the bins within the bands.
    frequency : ndarray
        Frequency of each active bin [cycles/m].
    mirror : ndarray
        2 for bins that also stand for their mirror image, else 1.
    lower, upper : ndarray of int
        Indices of the one or two bands that a bin belongs to, BAND_COUNT for none.
    lower_share : ndarray
        Fraction of a bin that belongs to band `lower`; the rest belongs to `upper`.
    harmonics : ndarray, shape (4, n)
        cos 2θ, sin 2θ, cos 4θ, sin 4θ of the bins' wave-vector angle θ.
    """

    fx: Float
    fy: Float
    square: Float
    active: NDArray[np.intp]
    frequency: Float
    mirror: Float
    lower: NDArray[np.intp]
    upper: NDArray[np.intp]
    lower_share: Float
    harmonics: Float


@lru_cache(maxsize=4)
def _grid(shape: tuple[int, int], metres_per_pixel: float) -> _Grid:
    fx, fy = frequencies(shape, metres_per_pixel)
    square = fx**2 + fy**2
    radius = np.sqrt(square)
    bin_width = 1.0 / (min(shape) * metres_per_pixel)
    edges = band_edges_per_metre()
    flat = radius.ravel()
    active = np.flatnonzero((flat > edges[0] - bin_width) & (flat < edges[-1] + bin_width))
    frequency = flat[active]
    # Bins near a band's edge count partly on both sides, because hard edges on a square grid favour some directions.
    fractions_above = np.clip((frequency[None, :] - edges[:, None]) / bin_width + 0.5, 0.0, 1.0)
    above = fractions_above.sum(axis=0)
    band = np.minimum(np.floor(above).astype(np.intp), BAND_COUNT + 1)
    fraction = above - band
    lower, upper = np.where(band >= 1, np.minimum(band - 1, BAND_COUNT), BAND_COUNT), np.minimum(band, BAND_COUNT)
    theta = np.arctan2(
        np.broadcast_to(fy, square.shape).ravel()[active], np.broadcast_to(fx, square.shape).ravel()[active]
    )
    columns = np.broadcast_to(np.arange(square.shape[1])[None, :], square.shape).ravel()[active]
    single = (columns == 0) | ((shape[1] % 2 == 0) & (columns == square.shape[1] - 1))
    return _Grid(
        fx,
        fy,
        square,
        active,
        frequency,
        np.where(single, 1.0, 2.0),
        lower,
        upper,
        1.0 - fraction,
        np.stack([np.cos(2 * theta), np.sin(2 * theta), np.cos(4 * theta), np.sin(4 * theta)]),
    )


def band_edges_per_metre() -> Float:
    """Return the ascending frequencies of the wavelength bands' edges (BAND_COUNT + 1,) [cycles/m]."""
    centres = 1.0 / BAND_WAVELENGTHS_M
    return np.concatenate([centres / BAND_EDGE_RATIO, centres[-1:] * BAND_EDGE_RATIO])


def find_resolved_bands(size_m: float, metres_per_pixel: float, resolved_wavelength_m: float) -> NDArray[np.bool_]:
    """Return a mask (BAND_COUNT,) of the wavelength bands that a patch of side `size_m` resolves.

    The source must resolve a band's shortest wavelength, and the patch must hold `MIN_PERIODS` periods of its centre
    wavelength.
    """
    shortest = BAND_WAVELENGTHS_M / BAND_EDGE_RATIO * (1.0 + 1e-6)
    finest = max(resolved_wavelength_m, 2.0 * metres_per_pixel)
    return np.asarray((finest <= shortest) & (size_m * (1.0 + 1e-6) >= MIN_PERIODS * BAND_WAVELENGTHS_M))


def measure_octave_heights(
    height: NDArray[np.floating[Any]], mask: NDArray[np.bool_], metres_per_pixel: float
) -> Float:
    """Return the RMS heights (BAND_COUNT + 1,) [m] of a height map (H, W) in octaves of wavelength, longest first.

    The first is of everything longer than the token's bands, less the mean plane; the last includes everything finer.
    Unlike a token's levels they come from the heights themselves, which no sensor's range limits.
    """
    window = compute_window(mask, metres_per_pixel)
    if not window.any():
        return np.zeros(BAND_COUNT + 1)
    values = np.where(mask, np.asarray(height, dtype=np.float64), 0.0)
    level = (values - evaluate_plane((values.shape[0], values.shape[1]), fit_plane(values, window))) * window
    grid = _grid((values.shape[0], values.shape[1]), metres_per_pixel)
    power = np.square(np.abs(np.fft.rfft2(level)))
    power[:, 1 : (values.shape[1] + 1) // 2] *= 2.0  # bins that also stand for their mirror image
    octave = np.searchsorted(band_edges_per_metre()[:-1], np.sqrt(grid.square))
    total = np.bincount(octave.ravel(), power.ravel(), BAND_COUNT + 1)
    return np.asarray(np.sqrt(total / (values.size * np.square(window).sum())))


NOISE_MARGIN = 3.0
"""Power over that of the noise below which waves are not told from it. Steps of a slope too even to be dithered have
all their noise in one line; a relief of one step that comes and goes has three times its power."""


def find_noise_cutoff(octaves: ArrayLike, noise: float) -> float:
    """Return the wavelength [m] below which everything together is no more than noise, at an edge of a band.

    Parameters
    ----------
    octaves : array_like, shape (BAND_COUNT + 1,)
        RMS heights (or slopes) of the octaves, longest first, as from `measure_octave_heights`.
    noise : float
        RMS of the noise, in their unit.

    Returns
    -------
    float
        The wavelength: 0 if the finest octave shows more than noise, inf if none does.
    """
    power = np.square(np.asarray(octaves, dtype=np.float64))
    finer = np.cumsum(power[::-1])[::-1]
    significant = np.flatnonzero(finer > NOISE_MARGIN * noise**2)
    if len(significant) == 0:
        return float("inf")
    last = int(significant[-1])
    return 0.0 if last == BAND_COUNT else float(1.0 / band_edges_per_metre()[last])


def get_smooth_token_values() -> NDArray[np.float32]:
    """Return the token (TOKEN_DIM,) of a perfectly smooth surface: each band's level at its 1 nm floor, all else 0."""
    values = np.zeros(TOKEN_DIM, dtype=np.float32)
    for band in range(BAND_COUNT):
        values[band_slice(band)][0] = SMOOTH_LEVEL
    return values


def describe(tactile_map: TactileMap) -> Token:
    """Describe a tactile map by a token, from its spectrum in octave bands of wavelength.

    Bands that the map does not resolve, or with too few periods in the patch, are marked unknown and hold the values of
    a smooth surface. Pixels outside the mask are ignored.

    Parameters
    ----------
    tactile_map : TactileMap
        The map.

    Returns
    -------
    Token
        The token.

    Raises
    ------
    UsageError
        If image and mask do not fit together, or a pixel inside the mask is not finite.

    Notes
    -----
    In noise, the token's peak and offset features describe a chance maximum. If one wave dominates a band, offset gives
    its wavelength within 0.1 % (2 % in a band with fewer than four periods in the patch).
    """
    image, mask = tactile_map.image, tactile_map.mask
    if image.ndim != 3 or image.shape[2] != 3 or mask.shape != image.shape[:2]:
        raise UsageError(f"a tactile map's image {image.shape} and mask {mask.shape} do not fit together.")
    shape, pitch = (image.shape[0], image.shape[1]), float(tactile_map.metres_per_pixel)
    bands = find_resolved_bands(min(shape) * pitch, pitch, tactile_map.resolved_wavelength_m)
    values = get_smooth_token_values()
    known = np.zeros(TOKEN_DIM, dtype=bool)
    for band in np.flatnonzero(bands):
        known[band_slice(band)] = True
    shape_known = int(bands.sum()) >= MIN_SHAPE_BANDS
    known[-len(SHAPE_FEATURES) :] = shape_known
    window = compute_window(mask, pitch)
    if not bands.any() or not window.any():
        return Token(values, known & bool(window.any()))
    sensor = get_sensor(tactile_map.sensor)
    finite = np.isfinite(image).all(axis=2)
    if not finite[mask].all():
        raise UsageError(
            f"{int((mask & ~finite).sum())} seen pixels of the tactile map are not numbers.",
            remedy="Mask them, or make the map again.",
        )
    if not finite.all():
        image = np.where(finite[..., None], image, sensor.background)
    gx, gy = decode_gradients(image, sensor)
    spectrum, slope = _compute_spectra(gx, gy, window, pitch, sensor.gel_sigma_m)
    for band, features in enumerate(_compute_band_features(spectrum, slope, window, shape, pitch)):
        if bands[band]:
            values[band_slice(band)] = features
    if shape_known:
        edges = band_edges_per_metre()
        lowest, highest = edges[:-1][bands].min(), edges[1:][bands].max()
        values[-len(SHAPE_FEATURES) :] = _compute_shape_features(spectrum, window, shape, pitch, lowest, highest)
    return Token(values, known)


def compute_window(mask: NDArray[np.bool_], metres_per_pixel: float) -> Float:
    """Return the analysis window (H, W): Hann along both axes, falling smoothly to zero at the border of the mask."""
    rows, columns = mask.shape
    window = np.asarray(np.outer(_hann(rows), _hann(columns)))
    if mask.all():
        return window
    blur = min(FEATHER_M, min(rows, columns) * metres_per_pixel / 16)
    fx, fy = frequencies((rows, columns), metres_per_pixel)
    smooth = np.fft.irfft2(
        np.fft.rfft2(mask.astype(np.float64)) * gaussian_mtf(np.hypot(fx, fy), blur), s=(rows, columns)
    )
    coverage = np.clip(2.0 * smooth - 1.0, 0.0, 1.0)
    return np.asarray(window * coverage**2 * (3.0 - 2.0 * coverage))


def _hann(size: int) -> Float:
    return np.asarray(0.5 - 0.5 * np.cos(2.0 * np.pi * (np.arange(size) + 0.5) / size))


def _detrend(g: Float, window: Float) -> Float:
    """Subtract from slopes `g` their window-weighted fit of 1, x, y: tilt and curvature of the object, no texture."""
    rows = np.linspace(-1.0, 1.0, g.shape[0])
    columns = np.linspace(-1.0, 1.0, g.shape[1])
    wr, wc = window.sum(axis=1), window.sum(axis=0)
    cross = float(rows @ window @ columns)
    gram = np.array(
        [
            [wr.sum(), columns @ wc, rows @ wr],
            [columns @ wc, columns**2 @ wc, cross],
            [rows @ wr, cross, rows**2 @ wr],
        ]
    )
    weighted = window * g
    column_sums, row_sums = weighted.sum(axis=0), weighted.sum(axis=1)
    a, b, c = np.linalg.lstsq(gram, np.array([column_sums.sum(), column_sums @ columns, row_sums @ rows]), rcond=1e-9)[
        0
    ]
    return np.asarray(g - (a + b * columns[None, :] + c * rows[:, None]))


def _compute_spectra(gx: Float, gy: Float, window: Float, pitch: float, gel_sigma_m: float) -> tuple[Complex, Float]:
    """Return rfft2 of window × height and |rfft2| of window × slopes, both corrected for the gel's transfer."""
    shape = (gx.shape[0], gx.shape[1])
    grid = _grid(shape, pitch)
    weighted_x = np.fft.rfft2(window * _detrend(gx, window))
    weighted_y = np.fft.rfft2(window * _detrend(gy, window))
    # The transfer is limited to exp(-3): dividing by less would only amplify rounding noise.
    mtf = np.maximum(gaussian_mtf(np.sqrt(grid.square), gel_sigma_m), np.exp(-3.0))
    inverse = 1.0 / (2.0 * np.pi * np.maximum(grid.square, 1e-300) * mtf)
    inverse[0, 0] = 0.0
    height = -1j * (grid.fx * weighted_x + grid.fy * weighted_y) * inverse
    slope = np.sqrt(weighted_x.real**2 + weighted_x.imag**2 + weighted_y.real**2 + weighted_y.imag**2) / mtf
    return height, slope


def _compute_band_features(
    spectrum: Complex, slope: Float, window: Float, shape: tuple[int, int], pitch: float
) -> Float:
    """Return the token's features (BAND_COUNT, 7), in the order of BAND_FEATURES, from spectra of height and slopes."""
    grid = _grid(shape, pitch)
    active = spectrum.ravel()[grid.active]
    density = active.real**2 + active.imag**2
    # Parseval with the window's energy: the sum over a band is its mean square height in m².
    power = density * grid.mirror / (window.size * np.sum(window**2))
    sums = np.stack([_sum_per_band(power * factor, grid) for factor in (np.ones_like(power), *grid.harmonics)])
    total = sums[0]
    features = np.zeros((BAND_COUNT, len(BAND_FEATURES)))
    features[:, 0] = 0.5 * np.log10(total + FLOOR_M2)
    features[:, 1:5] = (sums[1:] / (total + FLOOR_M2)).T
    # A pure wave of mean square m gives |X|² = m (Σw)² / 2 at its own frequency.
    per_wave = 2.0 / np.sum(window) ** 2
    nearest = np.where(grid.lower_share >= 0.5, grid.lower, grid.upper)
    for band in range(BAND_COUNT):
        inside = np.flatnonzero(nearest == band)
        if inside.size == 0 or total[band] <= 0.0:
            continue
        peak_bin = int(grid.active[inside[np.argmax(density[inside])]])
        frequency, wave_slope = _refine_peak(slope, peak_bin, shape, pitch)
        wave_power = per_wave * (wave_slope / (2.0 * np.pi * frequency)) ** 2
        certainty = total[band] / (total[band] + FLOOR_M2)
        fraction = min(wave_power / total[band], 1.0) * certainty
        features[band, 5] = fraction
        # The offset of a weak peak is chance, so it is scaled down: similar surfaces keep similar tokens.
        octaves = np.clip(np.log2(frequency * BAND_WAVELENGTHS_M[band]), -0.5, 0.5)
        features[band, 6] = octaves * min(fraction / CLEAR_PEAK_SHARE, 1.0)
    return features


def _sum_per_band(power: Float, grid: _Grid) -> Float:
    lower = np.bincount(grid.lower, power * grid.lower_share, BAND_COUNT + 1)
    upper = np.bincount(grid.upper, power * (1.0 - grid.lower_share), BAND_COUNT + 1)
    return np.asarray((lower + upper)[:BAND_COUNT])


def _refine_peak(slope: Float, index: int, shape: tuple[int, int], pitch: float) -> tuple[float, float]:
    """Return frequency [cycles/m] and |rfft2| of window × slope of the plane wave behind a local maximum at a bin.

    Slopes are used, since one wave is exactly one Hann lobe there (in the height, 1/f would tilt it). Along each axis
    the two-bin ratio a gives the offset (2a − 1)/(a + 1) (Grandke 1983), and the shape of the lobe gives the amplitude
    loss at the bin (scalloping loss).
    """
    rows, columns = shape
    last_column = slope.shape[1] - 1
    row, column = divmod(index, slope.shape[1])
    centre = float(slope[row, column])
    row_shift, row_loss = _estimate_hann_offset(
        slope[(row - 1) % rows, column], centre, slope[(row + 1) % rows, column]
    )
    # rfft2 stores half the plane, so the neighbour across its border is the mirror image of a stored bin.
    left = slope[row, column - 1] if column > 0 else slope[-row % rows, 1]
    right = slope[row, column + 1] if column < last_column else slope[-row % rows, (columns - column - 1) % columns]
    column_shift, column_loss = _estimate_hann_offset(left, centre, right)
    signed_row = row - rows if row > rows // 2 else row
    frequency = np.hypot((column + column_shift) / columns, (signed_row + row_shift) / rows) / pitch
    return float(frequency), centre / (row_loss * column_loss)


def _estimate_hann_offset(before: float, here: float, after: float) -> tuple[float, float]:
    """Return a wave's offset from the largest bin of its Hann lobe [bins, −1 … 1], and the amplitude share there."""
    neighbour, sign = (after, 1.0) if after >= before else (before, -1.0)
    ratio = neighbour / max(here, 1e-300)
    shift = float(np.clip((2.0 * ratio - 1.0) / (ratio + 1.0), 0.0, 0.99))
    return sign * shift, float(np.sinc(shift) / (1.0 - shift**2))


def _compute_shape_features(
    spectrum: Complex, window: Float, shape: tuple[int, int], pitch: float, lowest: float, highest: float
) -> NDArray[np.float32]:
    """Return skewness and log10(kurtosis / 3) of the heights, band-passed between `lowest` and `highest` [cycles/m]."""
    square = _grid(shape, pitch).square
    height = np.fft.irfft2(np.where((square >= lowest**2) & (square <= highest**2), spectrum, 0.0), s=shape)
    # The height includes the window, so each moment is divided by the same power of the window.
    squared = height**2
    second = squared.sum() / np.sum(window**2)
    if second <= 0.0:
        return np.zeros(2, dtype=np.float32)
    third = np.vdot(squared, height) / np.sum(window**3)
    fourth = np.vdot(squared, squared) / np.sum(window**4)
    certainty = second / (second + FLOOR_M2)
    skewness = third / second**1.5
    kurtosis = fourth / second**2
    return np.asarray([skewness * certainty, np.log10(max(kurtosis, 1e-3) / 3.0) * certainty], dtype=np.float32)
