"""Height profile under the path: the measured relief, which shares the power that F_Θ predicts with the noise.

`build_stroke_profile` joins the tactile maps (height maps) of the surface patches to one profile along the path. F_Θ
predicts the total power S(f; m, u), which already contains the surface's height. The profile, sent through the same
linear contact, has the expected power S_p. Per arc band (a band of wavenumbers along the path) its amplitude is scaled
by g, g² = min(1, S / S_p), and the noise carriers have max(S − g² S_p, 0) / S of their power left, so that the sum is S
again. S_p is the profile's *stationary* power, measured without single events such as a seam, which would otherwise be
taken for texture and made inaudible.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..errors import StrokeError
from .carriers import ARC_PER_OCTAVE, Carriers
from .linear_contact import SPEED_FLOOR_M_S, Condition, profile_band_power
from .stroke import HeightProfile, interpolate_cubic

if TYPE_CHECKING:
    from ..scene.camera import Patch
    from ..tactile.tactile_map import HeightMap

Float = NDArray[np.float64]

SEAM_RATIO = 6.0
"""Power relative to the median of its octave above which a segment is an event and not texture."""
_MIN_SEGMENTS = 8
"""Fewest segments in which events are searched."""
_MAX_EVENTS = 0.15
"""Largest fraction of segments that may be events."""


@dataclass(frozen=True)
class ProfileBands:
    """Height profile split into the arc bands (bands of wavenumber), for the octaves that it resolves.

    waves: per octave (24, m_o) float32 [m] on the octave's spatial grid. first: per octave the grid index of the first
    sample. power: (Ka,) power per band without single events such as seams [m²].
    """

    waves: tuple[NDArray[np.float32], ...]
    first: tuple[int, ...]
    power: Float

    def read_bands(self, octave: int, start: int, count: int) -> Float:
        """Return an octave's bands (24, count) [m] at grid indices start, start + 1, …; 0 outside the profile."""
        out = np.zeros((ARC_PER_OCTAVE, count))
        if octave < len(self.waves):
            wave, first = self.waves[octave], self.first[octave]
            low, high = max(start, first), min(start + count, first + wave.shape[1])
            if low < high:
                out[:, low - start : high - start] = wave[:, low - first : high - first]
        return out


@dataclass(frozen=True)
class PowerShares:
    """Factors that divide the power of F_Θ between the height profile and the noise carriers.

    profile: (n, Ka) factor g on the profile's band heights. arc: (n, Ka), time: (n, Kt) factors on the noise carriers'
    amplitudes.
    """

    profile: Float
    arc: Float
    time: Float


def split_profile(profile: HeightProfile, carriers: Carriers) -> ProfileBands:
    """Split a profile into the arc bands (bands of wavenumber) by FFT, less the straight line through its ends."""
    finest = 1.0 / max(profile.resolved_wavelength_m, 2.0 * profile.step_m)
    edges = carriers.arc_edges()
    octaves = int(np.sum(edges[:-1:ARC_PER_OCTAVE] < finest))
    power = np.zeros(carriers.arc_count)
    length = (len(profile.height) - 1) * profile.step_m
    if octaves == 0 or len(profile.height) < 4:
        return ProfileBands((), (), power)
    step = carriers.arc_step_m(octaves - 1)
    first = int(np.ceil(profile.origin_m / step))
    positions = (
        np.arange(first, int(np.floor((profile.origin_m + length) / step)) + 1) * step - profile.origin_m
    ) / step
    if len(positions) < 4:
        return ProfileBands((), (), power)  # Shorter than four samples of the finest octave.
    height = interpolate_cubic(np.asarray(profile.height, dtype=np.float64), positions * step / profile.step_m)
    height = height - np.linspace(height[0], height[-1], len(height))
    # Padding for the ringing of the narrowest band, so that one end does not wrap around to the other.
    size = 1 << int(np.ceil(np.log2(len(height) + 0.02 / step)))
    spectrum = np.fft.rfft(height, size)
    kappa = np.fft.rfftfreq(size, step)
    spectrum[kappa > finest] = 0.0
    waves, firsts = [], []
    for octave in range(octaves):
        factor = 2 ** (octaves - 1 - octave)
        band_edges = edges[octave * ARC_PER_OCTAVE : (octave + 1) * ARC_PER_OCTAVE + 1]
        coarse = size // factor
        # Grid points of this octave are every factor-th of the finest grid, and a phase shift aligns the two.
        origin = -(-first // factor)
        shift = np.exp(2j * np.pi * kappa * (origin * factor - first) * step)[: coarse // 2 + 1]
        shifted = spectrum[: coarse // 2 + 1] * shift
        borders = np.searchsorted(kappa[: coarse // 2 + 1], band_edges)
        count = len(height) // factor
        wave = np.empty((ARC_PER_OCTAVE, count), dtype=np.float32)
        total, level, band_spectrum = np.zeros(count), np.empty(ARC_PER_OCTAVE), np.zeros_like(shifted)
        for band in range(ARC_PER_OCTAVE):  # All bands at once would take a gigabyte for a minute of stroke.
            bins = slice(borders[band], borders[band + 1])
            band_spectrum[bins] = shifted[bins] / factor
            band_wave = np.fft.irfft(band_spectrum, coarse)[:count]
            band_spectrum[bins] = 0.0
            wave[band] = band_wave
            total += band_wave
            level[band] = np.mean(np.square(band_wave)) if count else 0.0
        waves.append(wave)
        firsts.append(origin)
        power[octave * ARC_PER_OCTAVE : (octave + 1) * ARC_PER_OCTAVE] = _stationary_power(total, level, band_edges)
    return ProfileBands(tuple(waves), tuple(firsts), power)


def _stationary_power(total: Float, level: Float, band_edges: Float) -> Float:
    """Compute the mean power (24,) of an octave's bands over those parts of the profile without events such as seams.

    total: (m,) height summed over the bands. level: (24,) their mean power with all events.
    """
    if len(total) == 0:
        return level
    step = 1.0 / (16.0 * band_edges[-1])
    segment = max(round(4.0 / float(band_edges[0]) / step), 1)
    segments = len(total) // segment
    is_stationary = np.ones(len(total))
    if segments >= _MIN_SEGMENTS:
        segment_power = np.mean(np.square(total[: segments * segment].reshape(segments, segment)), axis=1)
        is_event = segment_power > SEAM_RATIO * np.median(segment_power)
        is_event[1:] |= is_event[:-1].copy()
        is_event[:-1] |= is_event[1:].copy()
        if 0 < is_event.sum() <= max(_MAX_EVENTS * segments, 3):
            is_stationary[: segments * segment] = np.repeat(~is_event, segment)
    if is_stationary.all():
        return level
    ramp = np.hanning(max(segment // 2, 3))
    mask = np.minimum(np.convolve(is_stationary, ramp / ramp.sum(), mode="same"), is_stationary)
    size = 1 << int(np.ceil(np.log2(len(total))))
    spectrum = np.square(np.abs(np.fft.rfft(total * mask, size)))
    band = np.searchsorted(band_edges, np.fft.rfftfreq(size, step), side="right") - 1
    inside = (band >= 0) & (band < ARC_PER_OCTAVE)
    energy = np.bincount(band[inside], spectrum[inside], ARC_PER_OCTAVE)
    return np.asarray(2.0 * energy / size / np.square(mask).sum())


def share_power(amplitude: Float, bands: ProfileBands, condition: Condition, carriers: Carriers) -> PowerShares:
    """Divide the power that the field predicts between height profile and noise at each of n states.

    amplitude: (n, K) of the carriers, as field.accumulate gives it.
    """
    arc_amplitude, time_amplitude = amplitude[:, carriers.arc_slice], amplitude[:, carriers.time_slice]
    speed = np.maximum(condition.speed, SPEED_FLOOR_M_S)
    edges = carriers.arc_edges()
    total = np.square(arc_amplitude)
    if carriers.time_count:
        # Power density of the time carriers at f = κ v, over the band's width in Hz.
        time_edges = carriers.time_edges()
        centres = speed[:, None] * carriers.arc_centres()
        time_band = np.searchsorted(time_edges, centres, side="right") - 1
        inside = (time_band >= 0) & (time_band < carriers.time_count)
        density = np.square(time_amplitude) / np.diff(time_edges)
        rows = np.arange(len(speed))[:, None]
        time_density = np.where(inside, density[rows, np.clip(time_band, 0, carriers.time_count - 1)], 0.0)
        total = total + time_density * speed[:, None] * np.diff(edges)
    profile_power = profile_band_power(bands.power, condition, carriers)
    has_profile = profile_power > 0.0
    gain_square = np.divide(total, profile_power, out=np.ones_like(total), where=profile_power > total)
    profile_part = np.minimum(gain_square * profile_power, total)
    noise_part = 1.0 - np.divide(profile_part, total, out=np.zeros_like(total), where=total > 0.0)
    time_part = np.ones_like(time_amplitude)
    if carriers.time_count:
        width_hz = np.where(inside, np.diff(edges) * speed[:, None], 0.0)
        cell = rows * carriers.time_count + np.clip(time_band, 0, carriers.time_count - 1)

        def sum_by_time_band(values: Float) -> Float:
            """Sum values (n, Ka) of arc carriers in the time band that the frequency κ v of each is in, (n, Kt)."""
            sums = np.bincount(cell.ravel(), weights=values.ravel(), minlength=time_part.size)
            return np.asarray(sums, dtype=np.float64).reshape(time_part.shape)

        covered = np.maximum(sum_by_time_band(width_hz), np.diff(time_edges))
        time_part = 1.0 - sum_by_time_band(width_hz * (1.0 - noise_part)) / covered
    return PowerShares(np.where(has_profile, np.sqrt(gain_square), 1.0), np.sqrt(noise_part), np.sqrt(time_part))


OVERLAP_M = 1.5e-3
"""Length over which adjacent patches are blended [m].

Each has its own mean plane, and a step between planes would be an edge that the surface does not have.
"""
SAMPLES_PER_WAVELENGTH = 4.0
"""Samples of the profile per resolved wavelength."""
MIN_STEP_M, MAX_STEP_M = 20e-6, 0.5e-3
MAX_SAMPLES = 2**23
"""Largest number of samples: 168 m at the finest step, 1.3 km at that of a usual map. The bands take 200 bytes a
sample."""


def build_stroke_profile(
    position: Float,
    point: Float,
    patch_index: NDArray[np.int32],
    patches: Sequence[Patch],
    maps: Sequence[HeightMap | None],
) -> HeightProfile | None:
    """Build the height profile along a path over patches with tactile maps.

    Parameters
    ----------
    position
        (n,) position along the path [m] of each action sample; may run backward.
    point
        (n, 3) contact points in the surface frame [m].
    patch_index
        (n,) patch of each sample, −1 off the surface.
    patches
        Patches of the surface.
    maps
        Tactile map of each patch. It is flat there if the map is None, holds no height or resolves no finite
        wavelength.

    Returns
    -------
    HeightProfile or None
        Its resolved wavelength is that of the coarsest measured map. None if no touched patch has a height, or the hand
        never moves.

    Raises
    ------
    StrokeError
        If the path takes more than MAX_SAMPLES.
    """
    # Imported here because every synthesis imports this module, but only a stroke over relief needs maps.
    from ..tactile.height import sample_height

    measured = [
        tactile.resolved_wavelength_m for tactile in maps if tactile is not None and _has_resolved_height(tactile)
    ]
    touched = np.flatnonzero(patch_index >= 0)
    if not measured or len(touched) < 2:
        return None
    positions, first = np.unique(position[touched], return_index=True)
    if positions[-1] - positions[0] < MIN_STEP_M:
        return None
    step = float(np.clip(min(measured) / SAMPLES_PER_WAVELENGTH, MIN_STEP_M, MAX_STEP_M))
    length = float(positions[-1] - positions[0])
    if length > MAX_SAMPLES * step:
        raise StrokeError(
            f"its path over relief is {length:.3g} m long, and {MAX_SAMPLES * step:.3g} m is the most.",
            remedy="Check the scene's unit scale, or draw a shorter path.",
        )
    grid = np.arange(positions[0], positions[-1] + step, step)
    points = np.stack([np.interp(grid, positions, point[touched[first], axis]) for axis in range(3)], axis=-1)
    patch_at = _find_owner(grid, position, patch_index)
    height = np.zeros(len(grid))
    for index in np.unique(patch_at[patch_at >= 0]):
        tactile = maps[index]
        if tactile is None or not _has_resolved_height(tactile):
            continue
        weight = _smooth_indicator((patch_at == index).astype(np.float64), OVERLAP_M / step)
        inside = weight > 0.0
        height[inside] += weight[inside] * sample_height(tactile, patches[index].to_plane(points[inside]))
    return HeightProfile(step, float(grid[0]), height, max(measured))


def _has_resolved_height(tactile: HeightMap) -> bool:
    """Return True if a map has a height with a finite resolved wavelength.

    Where UVs were projected from the side, texels are stretched without limit: such a map has heights, but its
    wavelength is infinite.
    """
    return tactile.height is not None and bool(np.isfinite(tactile.resolved_wavelength_m))


def _find_owner(grid: Float, position: Float, patch_index: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return the patch at each position of the profile's grid, that of the nearest action sample; −1 off the surface.

    position, patch_index: of the action samples.
    """
    positions, first = np.unique(position, return_index=True)
    right = np.clip(np.searchsorted(positions, grid), 1, len(positions) - 1)
    nearest = np.where(grid - positions[right - 1] < positions[right] - grid, right - 1, right)
    return np.asarray(patch_index[first[nearest]], dtype=np.int32)


def _smooth_indicator(indicator: Float, length: float) -> Float:
    """Smooth a 0/1 signal (one patch is touched or not) with a raised cosine of `length` samples."""
    half = max(1, round(length))
    kernel = 1.0 + np.cos(np.pi * np.arange(-half, half + 1) / (half + 1))
    padded = np.pad(indicator, half, mode="edge")
    return np.convolve(padded, kernel / kernel.sum(), mode="valid")
