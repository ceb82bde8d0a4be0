"""Relief of a mesh: how far the faces under a patch rise above their own smooth shape, in the waves that they hold.

A ray cast through every pixel of a patch gives the height of the mesh. Its smooth shape, waves longer than some 10 mm,
is subtracted. What is left is relief only in waves that span several faces: shorter ones are the facets of the mesh.
The number of faces on a wave is counted in the wave's own direction, since ridges are often strips of long faces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..progress import add_work
from ..scene.camera import CAMERA_DISTANCE_M
from ..scene.mesh import TriangleMesh
from .fourier_filters import apply_filters, evaluate_plane, fit_plane, frequencies
from .height import ROLL_OFF, low_pass

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]
Int = NDArray[np.int32]

TRIANGLES_PER_WAVE = 8.0
"""Fewest triangles that a path along a wave's direction crosses on one wave, for the wave to be relief: four quads."""
LONGEST_WAVE_M = 8e-3
"""Faces that hold no wave as short as this one, the longest band of a token, hold no relief [m]."""
SMOOTHING_M = 4e-3
"""Standard deviation of the Gaussian weights of the smooth shape [m]. As each fit is quadratic, less than 5 % of a wave
of 8 mm and half of one of 13 mm are taken for shape."""
TILT_SMOOTHING_M = 2e-3
"""The same of the planes whose tilt is that of the smooth shape [m]."""
TWO_SIDED_SHARES = (0.6, 0.9)
"""Shares of a fit's weights on the surface between which it fades in; at a straight border a half lies on it."""
MAX_TILT = float(np.tan(np.radians(30.0)))
"""Slope of the smooth shape against the patch beyond which the surface turns away, as at the edge of a box."""
SPACING_WINDOW_M = 4e-3
"""Side of the square in which the spacing of the faces is averaged [m]: three narrow faces of a bevel hold no wave."""
LONGEST_SPACING_M = 20e-3
"""Spacing at which longer ones are cut off, so that a mean of several is finite [m]: the side of a patch."""
SPACING_QUANTILE = 0.8
"""Share of the fine area whose faces are at least as fine as the spacing that counts for all of it."""
MIN_FINE_SHARE = 0.05
"""Least share of a patch with fine faces."""
MIN_HEIGHT_M = 1e-6
"""Least peak-to-peak height of a relief [m]; what a modeller makes by hand is higher."""
FLOAT32_STEPS = 30.0
"""Least peak-to-peak height in steps of the vertices' own float32 coordinates."""
MIN_SHARE_OF_SHAPE = 3e-3
"""Least peak-to-peak height over that of the smooth shape, whose fit has errors: 3 µm on a ball of 40 mm."""
MIN_WAVE_RATIO = 0.5
"""Least ratio of the waves that the faces hold to the shorter ones, facets, as RMS heights."""
LEAST_BAND_POWER = 1e-4
"""Power of a band over that of the strongest one below which the mesh has no waves in it: 40 dB, as the errors of eight
faces a wave and of pixels are 34 to 50 dB below it."""
GRID = 64
"""Side of the coarse grid on which shape and spacing are computed [cells]."""
ANGLE_COUNT = 16
"""Number of directions, over half a turn, in which faces are counted."""


@dataclass(frozen=True)
class MeshRelief:
    """Relief of a mesh under a patch.

    Attributes
    ----------
    height : ndarray of float64, shape (H, W)
        Height above the smooth shape [m]; 0 where the faces are too coarse.
    resolved_wavelength_m : float
        Shortest wave that the faces hold in the direction in which they are finest [m].
    """

    height: Float
    resolved_wavelength_m: float


@dataclass(frozen=True)
class FaceSpacing:
    """Spacing of the faces under a patch where they are fine enough for relief.

    Attributes
    ----------
    region : ndarray of bool, shape (GRID, GRID)
        Cells of the coarse grid with fine faces.
    wavelength_m : ndarray, shape (ANGLE_COUNT,)
        Shortest wave that they hold in each direction, counted from +x towards +y over half a turn [m].
    """

    region: Mask
    wavelength_m: Float

    @property
    def shortest_m(self) -> float:
        """Shortest wave in any direction [m]."""
        return float(self.wavelength_m.min())


def compute_spacing(corners: Float) -> Float:
    """Return the mean spacing (k, ANGLE_COUNT) [m] at which lines cross the edges of like triangles, by direction.

    Parameters
    ----------
    corners : ndarray, shape (k, 3, 2)
        Corners in the plane of the patch [m].

    Notes
    -----
    A line with direction u crosses a tiling by triangles of area A and edges e_i once every A / (½ Σ |e_i × u|), which
    is the mean length of a triangle's chords (Crofton).
    """
    edges = np.roll(corners, -1, axis=1) - corners
    angles = np.arange(ANGLE_COUNT) * np.pi / ANGLE_COUNT
    width = np.abs(edges[..., :1] * np.sin(angles) - edges[..., 1:] * np.cos(angles)).sum(axis=1) / 2.0
    area = np.abs(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0])[:, None] / 2.0
    return np.asarray(np.minimum(area / np.maximum(width, 1e-300), LONGEST_SPACING_M))


def find_fine_faces(
    mesh: TriangleMesh, triangle: Int, mask: Mask, axes: tuple[Float, Float], size_m: float
) -> FaceSpacing | None:
    """Find where the faces under a patch are fine enough to hold relief, from the lengths of their edges alone.

    Parameters
    ----------
    mesh : TriangleMesh
        The mesh.
    triangle : ndarray of int32, shape (H, W)
        Triangle at each pixel, −1 for none; H and W are multiples of `GRID`.
    mask : ndarray of bool, shape (H, W)
        The patch's own surface.
    axes : tuple of ndarray, shape (3,)
        Its x and y axes.
    size_m : float
        Its side [m].

    Returns
    -------
    FaceSpacing or None
        None if no face is fine enough, as on most surfaces.
    """
    step = triangle.shape[0] // GRID
    chosen = triangle[step // 2 :: step, step // 2 :: step][:GRID, :GRID]
    visible = mask[step // 2 :: step, step // 2 :: step][:GRID, :GRID] & (chosen >= 0)
    distinct, inverse = np.unique(chosen[visible], return_inverse=True)
    if len(distinct) < TRIANGLES_PER_WAVE:
        return None
    corners = mesh.vertices[mesh.triangles[distinct]] @ np.stack(axes, axis=1)
    spacing = np.zeros((GRID, GRID, ANGLE_COUNT))
    spacing[visible] = compute_spacing(corners)[inverse.reshape(-1)]
    mean = _average_around(spacing, visible, SPACING_WINDOW_M / size_m * GRID)
    fine = visible & (TRIANGLES_PER_WAVE * mean.min(axis=-1) <= LONGEST_WAVE_M)
    if fine.mean() < MIN_FINE_SHARE:
        return None
    wavelength = TRIANGLES_PER_WAVE * np.quantile(mean[fine], SPACING_QUANTILE, axis=0)
    return FaceSpacing(fine, wavelength) if wavelength.min() <= LONGEST_WAVE_M else None


def _average_around(values: Float, weight: Mask, side: float) -> Float:
    """Average values (n, n, k) over those cells of a square of `side` cells around each cell that have weight."""
    reach = max(round(side / 2.0), 1)
    offsets = np.arange(values.shape[0])
    window = (np.abs(offsets[:, None] - offsets[None, :]) <= reach).astype(np.float64)
    total = np.einsum("ab,bck,dc->adk", window, values, window, optimize=True)
    count = window @ weight.astype(np.float64) @ window.T
    return np.asarray(total / np.maximum(count, 1.0)[..., None])


def compute_mesh_relief(
    depth: Float, mask: Mask, spacing: FaceSpacing, size_m: float, *, rounding_m: float = 0.0, cut_facets: bool = True
) -> MeshRelief | None:
    """Compute the relief of a mesh from the depths at which rays meet it.

    Parameters
    ----------
    depth : ndarray, shape (H, W)
        Planar depth from the close-up camera [m].
    mask : ndarray of bool, shape (H, W)
        The patch's own surface.
    spacing : FaceSpacing
        Spacing of its faces.
    size_m : float
        Side of the patch [m].
    rounding_m : float
        Step of the vertices' coordinates [m], whose noise is no relief.
    cut_facets : bool
        False keeps the facets, as before it is known whether the pixels are fine enough to tell.

    Returns
    -------
    MeshRelief or None
        None if the surface is smooth in all waves that its faces hold.
    """
    add_work("mesh_reliefs")
    pixel_m, step = size_m / depth.shape[1], depth.shape[0] // GRID
    height = np.where(mask, CAMERA_DISTANCE_M - depth, 0.0)
    share = _average_blocks(mask.astype(np.float64), step)
    level = _average_blocks(height, step) / np.maximum(share, 1e-12)
    if _measure_span(height, mask) < MIN_HEIGHT_M:
        return None  # flat
    cell_m = size_m / GRID
    tilt = _fit_around(level, share, TILT_SMOOTHING_M / cell_m, _LINEAR)[0][..., 1:] / cell_m
    weight = np.where(np.hypot(tilt[..., 0], tilt[..., 1]) <= MAX_TILT, share, 0.0)
    region = (weight > 0.5) & spacing.region
    if region.mean() < MIN_FINE_SHARE:
        return None
    shape = _evaluate_shape(level, weight, step, SMOOTHING_M / cell_m)
    deviation = height - shape
    extent = np.kron(_feather(region), np.ones((step, step)))
    deviation = np.where(mask & np.kron(region, np.ones((step, step), dtype=bool)), deviation, 0.0) * extent
    if float(np.ptp(deviation)) < MIN_HEIGHT_M:
        return None
    held = low_pass_by_direction(deviation, pixel_m, spacing.wavelength_m) * extent if cut_facets else deviation
    inside = extent > 0.5
    if not inside.any():
        return None
    wave_rms, facet_rms = (float(np.sqrt(np.mean(part[inside] ** 2))) for part in (held, deviation - held))
    least = max(
        MIN_HEIGHT_M, FLOAT32_STEPS * rounding_m, MIN_SHARE_OF_SHAPE * _measure_span(shape[::step, ::step], region)
    )
    if float(np.ptp(held[inside])) < least or wave_rms < MIN_WAVE_RATIO * facet_rms:
        return None
    return MeshRelief(held, max(spacing.shortest_m, 2.0 * pixel_m))


def _measure_span(shape: Float, region: Mask) -> float:
    """Return the peak-to-peak height [m] of a shape (n, n) over its mean plane in a region."""
    if not region.any():
        return 0.0
    plane = fit_plane(shape, region.astype(np.float64))
    return float(np.ptp((shape - evaluate_plane((shape.shape[0], shape.shape[1]), plane))[region]))


def _average_blocks(values: Float, step: int) -> Float:
    side = step * GRID
    return np.asarray(values[:side, :side].reshape(GRID, step, GRID, step).mean(axis=(1, 3)))


def _feather(region: Mask) -> Float:
    """Return a window (n, n) that rises from 0 at the border of a region to 1 three cells inside."""
    inner = region.astype(np.float64)
    kernel = np.array([0.25, 0.5, 0.25])
    eroded = region.copy()
    for _ in range(2):
        padded = np.pad(eroded, 1, constant_values=True)
        eroded = eroded & padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
    inner = np.pad(eroded.astype(np.float64), 1, mode="edge")
    rows = sum(weight * inner[i : i + region.shape[0]] for i, weight in enumerate(kernel))
    return np.asarray(sum(weight * rows[:, i : i + region.shape[1]] for i, weight in enumerate(kernel)) * region)


_LINEAR = ((0, 0), (1, 0), (0, 1))
"""Exponents (of columns, of rows) of a plane."""
_QUADRATIC = (*_LINEAR, (2, 0), (1, 1), (0, 2))
_QUARTIC = tuple((i, j) for i in range(5) for j in range(5 - i))


def _fit_around(
    level: Float, weight: Float, sigma: float, exponents: tuple[tuple[int, int], ...] = _QUADRATIC
) -> tuple[Float, Float]:
    """Fit a polynomial around every cell of a map (n, n) with Gaussian weights.

    Returns the coefficients (n, n, k) of `exponents` of the distance in cells, and the share (n, n) of the Gaussian
    that lies on the map where it has weight. `sigma` is the standard deviation [cells].
    """
    offsets = np.arange(len(level))
    distance = (offsets[None, :] - offsets[:, None]).astype(np.float64)
    order = 2 * max(i for i, _ in exponents)
    kernels = [np.exp(-0.5 * (distance / sigma) ** 2) * distance**power for power in range(order + 1)]

    def moment(values: Float, power: tuple[int, int]) -> Float:
        return np.asarray(kernels[power[1]] @ values @ kernels[power[0]].T)

    moments = {(i, j): moment(weight, (i, j)) for i in range(order + 1) for j in range(order + 1 - i)}
    gram = np.stack(
        [np.stack([moments[a[0] + b[0], a[1] + b[1]] for b in exponents], axis=-1) for a in exponents], axis=-2
    )
    right = np.stack([moment(weight * level, power) for power in exponents], axis=-1)
    # The ridge keeps cells far from any weight solvable; it is far below the weights of those that count.
    scale = np.array([sigma ** (i + j) for i, j in exponents])
    ridge = 1e-9 * np.maximum(moments[0, 0], 1e-12)[..., None, None] * np.diag(scale**2)
    coefficients = np.linalg.solve(gram + ridge, right[..., None])[..., 0]
    return np.asarray(coefficients), moments[0, 0] / (2.0 * np.pi * sigma**2)


def _evaluate_shape(level: Float, weight: Float, step: int, sigma: float) -> Float:
    """Return the smooth shape at all pixels (H, W) from cell means (n, n): a quartic, and local quadratics of the rest.

    `step` is the number of pixels of a cell, `sigma` the standard deviation of the local fits [cells]. Both fits would
    bend towards a wave that ends at a border: the quartic's weights fall to 0 there, and local fits fade out where they
    have the surface on one side only.
    """
    side = step * GRID
    pixels = (np.arange(side) - (side - 1) / 2.0) / (side / 2.0)
    powers = [pixels**i for i in range(5)]
    means = [power.reshape(GRID, step).mean(axis=1) for power in powers]
    basis = np.stack([means[j][:, None] * means[i][None, :] for i, j in _QUARTIC], axis=-1)
    window = np.cos(0.5 * np.pi * means[1])
    root = np.sqrt(weight * window[:, None] * window[None, :])[..., None]
    coefficients = np.linalg.lstsq(
        (basis * root).reshape(-1, len(_QUARTIC)), (level * root[..., 0]).ravel(), rcond=1e-10
    )[0]
    shape = np.zeros((side, side))
    for coefficient, (i, j) in zip(coefficients, _QUARTIC, strict=True):
        shape += coefficient * powers[j][:, None] * powers[i][None, :]
    local, share = _fit_around(level - basis @ coefficients, weight, sigma)
    local *= np.clip((share - TWO_SIDED_SHARES[0]) / (TWO_SIDED_SHARES[1] - TWO_SIDED_SHARES[0]), 0.0, 1.0)[..., None]
    inside = (np.arange(step) - (step - 1) / 2.0) / step
    terms = np.stack([inside[:, None] ** j * inside[None, :] ** i for i, j in _QUADRATIC])
    rest = np.einsum("abp,prc->arbc", local, terms, optimize=True).reshape(side, side)
    return np.asarray(shape + rest)


def low_pass_by_direction(height: Float, metres_per_pixel: float, wavelength_m: Float) -> Float:
    """Remove waves from heights (H, W) below a wavelength that depends on their direction.

    Parameters
    ----------
    height : ndarray, shape (H, W)
        Heights [m].
    metres_per_pixel : float
        Size of a pixel [m].
    wavelength_m : ndarray, shape (k,)
        Shortest wave that passes [m], in k directions from +x towards +y over half a turn.

    Returns
    -------
    ndarray, shape (H, W)
        Heights with their mean plane [m]; the transition is that of `low_pass`.
    """
    values = np.asarray(height, dtype=np.float64)
    plane = evaluate_plane((values.shape[0], values.shape[1]), fit_plane(values))
    cut = np.maximum(np.append(wavelength_m, wavelength_m[0]), 2.0 * metres_per_pixel)

    def response(shape: tuple[int, int]) -> list[Float]:
        fx, fy = frequencies(shape, metres_per_pixel)
        turn = np.mod(np.arctan2(fy + 0.0 * fx, fx + 0.0 * fy), np.pi) / np.pi * len(wavelength_m)
        shortest = np.interp(turn, np.arange(len(cut)), cut)
        transition = np.clip((np.hypot(fx, fy) * shortest - 1.0) / (1.0 / ROLL_OFF - 1.0), 0.0, 1.0)
        return [np.asarray(0.5 + 0.5 * np.cos(np.pi * transition))]

    (filtered,), _ = apply_filters(values, metres_per_pixel, response, "even", 2.0 * float(np.min(wavelength_m)))
    return np.asarray(filtered + plane)


@dataclass(frozen=True)
class SummedHeight:
    """Height of a patch to which its mesh contributes.

    Attributes
    ----------
    height : ndarray of float64, shape (H, W)
        Relief of the mesh and height of the shader, with mean 0 under the mask [m].
    resolved_wavelength_m : float
        Shortest wave that either resolves [m].
    mesh_bands : tuple of bool
        For each wavelength band of a token, True if it comes from the mesh.
    empty_bands : tuple of bool
        True for bands in which neither has waves to speak of: what is found there are errors of facets and pixels.
    """

    height: Float
    resolved_wavelength_m: float
    mesh_bands: tuple[bool, ...]
    empty_bands: tuple[bool, ...]


def add_heights(
    shader: NDArray[np.float32] | None,
    shader_resolved_m: float,
    relief: MeshRelief,
    mask: Mask,
    metres_per_pixel: float,
    band_wavelengths_m: Float,
) -> SummedHeight:
    """Add the relief of the mesh to the height that the shader defines, each in the waves that its source holds.

    Parameters
    ----------
    shader : ndarray, shape (H, W), or None
        Height of the shader [m]; None without.
    shader_resolved_m : float
        Shortest wave that it resolves [m].
    relief : MeshRelief
        Relief of the mesh.
    mask : ndarray of bool, shape (H, W)
        The patch's own surface.
    metres_per_pixel : float
        Size of a pixel [m].
    band_wavelengths_m : ndarray, shape (k,)
        Middle of the bands of a token, an octave each, the longest first [m].

    Returns
    -------
    SummedHeight
    """
    total, resolved = relief.height, relief.resolved_wavelength_m
    shader_power, by_shader = np.zeros(len(band_wavelengths_m)), np.zeros(len(band_wavelengths_m), dtype=bool)
    if shader is not None and np.isfinite(shader_resolved_m):
        filtered = np.asarray(shader, dtype=np.float64)
        if shader_resolved_m > resolved:
            filtered = low_pass(filtered, metres_per_pixel, shader_resolved_m)
        shader_power = measure_band_power(filtered, metres_per_pixel, band_wavelengths_m)
        by_shader = band_wavelengths_m >= shader_resolved_m
        total, resolved = filtered + relief.height, min(resolved, shader_resolved_m)
    power = measure_band_power(relief.height, metres_per_pixel, band_wavelengths_m)
    by_mesh = (band_wavelengths_m >= relief.resolved_wavelength_m) & (power > LEAST_BAND_POWER * power.max())
    return SummedHeight(
        height=np.where(mask, total - total[mask].mean(), 0.0),
        resolved_wavelength_m=resolved,
        mesh_bands=tuple(bool(is_mesh) for is_mesh in by_mesh & (power > shader_power)),
        empty_bands=tuple(bool(is_empty) for is_empty in ~by_mesh & ~by_shader),
    )


def measure_band_power(height: Float, metres_per_pixel: float, band_wavelengths_m: Float) -> Float:
    """Return the power of heights (H, W) in each wavelength band (k,), an octave wide, up to a common factor."""
    level = height - evaluate_plane((height.shape[0], height.shape[1]), fit_plane(height))
    window = np.hanning(height.shape[0])[:, None] * np.hanning(height.shape[1])[None, :]
    spectrum = np.abs(np.fft.rfft2(level * window)) ** 2
    fx, fy = frequencies((height.shape[0], height.shape[1]), metres_per_pixel)
    octave = np.log2(np.maximum(np.hypot(fx, fy), 1e-12) * band_wavelengths_m[0])
    band = np.round(octave).astype(int)
    inside = (band >= 0) & (band < len(band_wavelengths_m))
    return np.asarray(np.bincount(band[inside], spectrum[inside], len(band_wavelengths_m)))


def describe_mesh_relief(object_name: str, relief: MeshRelief, shader_source: str = "") -> str:
    """Describe the sources of a height for the report: the shader's, if any, and the mesh."""
    mesh = f"mesh of '{object_name}', waves from {relief.resolved_wavelength_m * 1e3:.2g} mm"
    return f"{shader_source}; {mesh}" if shader_source else mesh
