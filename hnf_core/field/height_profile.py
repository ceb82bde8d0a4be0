"""The surface's own height under the path as one more carrier, without counting anything twice.

F_Θ predicts the whole power S(f; m, u). The profile, sent through the same linear contact, has the expected power S_p.
Per arc-length band its amplitude is scaled by g, g² = min(1, S / S_p), and the noise carriers keep
max(S − g² S_p, 0) / S of their power: the sum is S again. S_p is the profile's *stationary* spectrum, read where
nothing special happens, so that a seam is not mistaken for texture and stays.

The surface's own height under p(t): one profile along the path, stitched from the patches' tactile maps.
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
    from ..scene.patch import Patch
    from ..tactile.tactile_map import HeightMap

Float = NDArray[np.float64]

SEAM_RATIO = 6.0
"""A stretch with more than this times the median power of its octave is an event, not texture."""
_MIN_SEGMENTS = 8
_MAX_EVENTS = 0.15


@dataclass(frozen=True)
class ProfileBands:
    """The profile split into the arc-length bands.

    waves: per octave (24, m_o) float32 metres on the octave's spatial grid. first: per octave the grid index of the
    first sample. power: (Ka,) m² stationary power per band. octaves: how many are resolved; above, nothing.
    """

    waves: tuple[NDArray[np.float32], ...]
    first: tuple[int, ...]
    power: Float

    def read_bands(self, octave: int, start: int, count: int) -> Float:
        """An ArcSource: zero outside the profile."""
        out = np.zeros((ARC_PER_OCTAVE, count))
        if octave < len(self.waves):
            wave, first = self.waves[octave], self.first[octave]
            low, high = max(start, first), min(start + count, first + wave.shape[1])
            if low < high:
                out[:, low - start : high - start] = wave[:, low - first : high - first]
        return out


@dataclass(frozen=True)
class PowerShares:
    """What each excitation keeps. profile: (n, Ka) factor g on the height. arc: (n, Ka), time: (n, Kt) factors on the
    noise carriers' amplitudes."""

    profile: Float
    arc: Float
    time: Float


def split_profile(profile: HeightProfile, carriers: Carriers) -> ProfileBands:
    """Band-pass the profile by FFT; the straight line through its ends is removed, being no texture."""
    finest = 1.0 / max(profile.resolved_wavelength_m, 2.0 * profile.step_m)
    edges = carriers.arc_edges()
    octaves = int(np.sum(edges[:-1:ARC_PER_OCTAVE] < finest))
    power = np.zeros(carriers.arc_count)
    length = (len(profile.height) - 1) * profile.step_m
    if octaves == 0 or len(profile.height) < 4:
        return ProfileBands((), (), power)
    step = carriers.arc_step_m(octaves - 1)
    first = int(np.ceil(profile.origin_m / step))
    place = (np.arange(first, int(np.floor((profile.origin_m + length) / step)) + 1) * step - profile.origin_m) / step
    if len(place) < 4:
        return ProfileBands((), (), power)  # shorter than four samples of the finest octave: nothing to feel
    height = interpolate_cubic(np.asarray(profile.height, dtype=np.float64), place * step / profile.step_m)
    height = height - np.linspace(height[0], height[-1], len(height))
    # Room for the ringing of the narrowest band, so that one end does not reach round to the other.
    size = 1 << int(np.ceil(np.log2(len(height) + 0.02 / step)))
    spectrum = np.fft.rfft(height, size)
    kappa = np.fft.rfftfreq(size, step)
    spectrum[kappa > finest] = 0.0
    waves, firsts = [], []
    for octave in range(octaves):
        factor = 2 ** (octaves - 1 - octave)
        band_edges = edges[octave * ARC_PER_OCTAVE : (octave + 1) * ARC_PER_OCTAVE + 1]
        coarse = size // factor
        # Grid points of this octave are every factor-th of the finest: align by a phase.
        origin = -(-first // factor)
        shift = np.exp(2j * np.pi * kappa * (origin * factor - first) * step)[: coarse // 2 + 1]
        shifted = spectrum[: coarse // 2 + 1] * shift
        borders = np.searchsorted(kappa[: coarse // 2 + 1], band_edges)
        count = len(height) // factor
        wave = np.empty((ARC_PER_OCTAVE, count), dtype=np.float32)
        total, level, alone = np.zeros(count), np.empty(ARC_PER_OCTAVE), np.zeros_like(shifted)
        for band in range(ARC_PER_OCTAVE):  # one by one: all at once take a gigabyte for a minute of stroke
            bins = slice(borders[band], borders[band + 1])
            alone[bins] = shifted[bins] / factor
            one = np.fft.irfft(alone, coarse)[:count]
            alone[bins] = 0.0
            wave[band] = one
            total += one
            level[band] = np.mean(np.square(one)) if count else 0.0
        waves.append(wave)
        firsts.append(origin)
        power[octave * ARC_PER_OCTAVE : (octave + 1) * ARC_PER_OCTAVE] = _stationary_power(total, level, band_edges)
    return ProfileBands(tuple(waves), tuple(firsts), power)


def _stationary_power(total: Float, level: Float, band_edges: Float) -> Float:
    """Mean power (24,) of an octave's bands over the stretches in which no event happens. total: (m,) their sum.
    level: (24,) their mean power with all events."""
    if len(total) == 0:
        return level
    step = 1.0 / (16.0 * band_edges[-1])
    stretch = max(round(4.0 / float(band_edges[0]) / step), 1)
    count = len(total) // stretch
    keep = np.ones(len(total))
    if count >= _MIN_SEGMENTS:
        local = np.mean(np.square(total[: count * stretch].reshape(count, stretch)), axis=1)
        event = local > SEAM_RATIO * np.median(local)
        event[1:] |= event[:-1].copy()
        event[:-1] |= event[1:].copy()
        if 0 < event.sum() <= max(_MAX_EVENTS * count, 3):
            keep[: count * stretch] = np.repeat(~event, stretch)
    if keep.all():
        return level
    ramp = np.hanning(max(stretch // 2, 3))
    mask = np.minimum(np.convolve(keep, ramp / ramp.sum(), mode="same"), keep)
    size = 1 << int(np.ceil(np.log2(len(total))))
    spectrum = np.square(np.abs(np.fft.rfft(total * mask, size)))
    owner = np.searchsorted(band_edges, np.fft.rfftfreq(size, step), side="right") - 1
    inside = (owner >= 0) & (owner < ARC_PER_OCTAVE)
    energy = np.bincount(owner[inside], spectrum[inside], ARC_PER_OCTAVE)
    return np.asarray(2.0 * energy / size / np.square(mask).sum())


def share_power(amplitude: Float, bands: ProfileBands, condition: Condition, carriers: Carriers) -> PowerShares:
    """Divide the field's power between profile and noise at every state; amplitude (n, K) as accumulated."""
    arc_amplitude, time_amplitude = amplitude[:, carriers.arc_slice], amplitude[:, carriers.time_slice]
    speed = np.maximum(condition.speed, SPEED_FLOOR_M_S)
    edges = carriers.arc_edges()
    total = np.square(arc_amplitude)
    if carriers.time_count:
        # Power density of the time carriers at f = κ v, over the band's width in Hz.
        time_edges = carriers.time_edges()
        centres = speed[:, None] * carriers.arc_centres()
        owner = np.searchsorted(time_edges, centres, side="right") - 1
        inside = (owner >= 0) & (owner < carriers.time_count)
        density = np.square(time_amplitude) / np.diff(time_edges)
        rows = np.arange(len(speed))[:, None]
        at_band = np.where(inside, density[rows, np.clip(owner, 0, carriers.time_count - 1)], 0.0)
        total = total + at_band * speed[:, None] * np.diff(edges)
    profile_power = profile_band_power(bands.power, condition, carriers)
    present = profile_power > 0.0
    gain2 = np.divide(total, profile_power, out=np.ones_like(total), where=profile_power > total)
    taken = np.minimum(gain2 * profile_power, total)
    left = 1.0 - np.divide(taken, total, out=np.zeros_like(total), where=total > 0.0)
    time_left = np.ones_like(time_amplitude)
    if carriers.time_count:
        width_hz = np.where(inside, np.diff(edges) * speed[:, None], 0.0)
        cell = rows * carriers.time_count + np.clip(owner, 0, carriers.time_count - 1)

        def over_time_bands(values: Float) -> Float:
            """(n, Ka) summed into the time carrier that each arc carrier's tone falls on, (n, Kt)."""
            summed = np.bincount(cell.ravel(), weights=values.ravel(), minlength=time_left.size)
            return np.asarray(summed, dtype=np.float64).reshape(time_left.shape)

        covered = np.maximum(over_time_bands(width_hz), np.diff(time_edges))
        time_left = 1.0 - over_time_bands(width_hz * (1.0 - left)) / covered
    return PowerShares(np.where(present, np.sqrt(gain2), 1.0), np.sqrt(left), np.sqrt(time_left))


OVERLAP_M = 1.5e-3
"""Neighbouring patches fade into each other over this length: each has its own mean plane, and a step between planes
would be felt as an edge that is not there."""
SAMPLES_PER_WAVELENGTH = 4.0
MIN_STEP_M, MAX_STEP_M = 20e-6, 0.5e-3
MAX_SAMPLES = 2**23
"""168 m at the finest step, 1.3 km at that of a usual map: its bands take 200 bytes a sample."""


def build_stroke_profile(
    position: Float,
    point: Float,
    patch_index: NDArray[np.int32],
    patches: Sequence[Patch],
    maps: Sequence[HeightMap | None],
) -> HeightProfile | None:
    """Height along the path, or None where no touched patch has one or the hand never moves.

    position: (n,) m, place along the path of each action sample (may run backward). point: (n, 3) contact points in
    the surface frame. patch_index: (n,) which patch, −1 off the surface. maps: per patch; where it is None, holds no
    height or resolves no finite wavelength, nothing was measured (flat there). The profile resolves what the coarsest
    measured map resolves. Raises StrokeError for a path that takes more than MOST_SAMPLES.
    """
    # Every synthesis imports this module; only a stroke over relief needs maps.
    from ..tactile.height import sample_height

    measured = [
        tactile.resolved_wavelength_m for tactile in maps if tactile is not None and _has_resolved_height(tactile)
    ]
    touched = np.flatnonzero(patch_index >= 0)
    if not measured or len(touched) < 2:
        return None
    places, first = np.unique(position[touched], return_index=True)
    if places[-1] - places[0] < MIN_STEP_M:
        return None
    step = float(np.clip(min(measured) / SAMPLES_PER_WAVELENGTH, MIN_STEP_M, MAX_STEP_M))
    length = float(places[-1] - places[0])
    if length > MAX_SAMPLES * step:
        raise StrokeError(
            f"its path over relief is {length:.3g} m long, and {MAX_SAMPLES * step:.3g} m is the most.",
            remedy="Check the scene's unit scale, or draw a shorter path.",
        )
    grid = np.arange(places[0], places[-1] + step, step)
    points = np.stack([np.interp(grid, places, point[touched[first], axis]) for axis in range(3)], axis=-1)
    owner = _find_owner(grid, position, patch_index)
    height = np.zeros(len(grid))
    for index in np.unique(owner[owner >= 0]):
        tactile = maps[index]
        if tactile is None or not _has_resolved_height(tactile):
            continue
        weight = _smooth_indicator((owner == index).astype(np.float64), OVERLAP_M / step)
        inside = weight > 0.0
        height[inside] += weight[inside] * sample_height(tactile, patches[index].to_plane(points[inside]))
    return HeightProfile(step, float(grid[0]), height, max(measured))


def _has_resolved_height(tactile: HeightMap) -> bool:
    """A map whose texels are collapsed (UVs projected from the side) has a height, and an infinite wavelength."""
    return tactile.height is not None and bool(np.isfinite(tactile.resolved_wavelength_m))


def _find_owner(grid: Float, position: Float, patch_index: NDArray[np.int32]) -> NDArray[np.int32]:
    """Patch of the action sample nearest to each place; samples off the surface own their places too."""
    places, first = np.unique(position, return_index=True)
    right = np.clip(np.searchsorted(places, grid), 1, len(places) - 1)
    nearest = np.where(grid - places[right - 1] < places[right] - grid, right - 1, right)
    return np.asarray(patch_index[first[nearest]], dtype=np.int32)


def _smooth_indicator(indicator: Float, length: float) -> Float:
    """Smooth a 0/1 track with a raised cosine. Smoothed indicators of a partition still sum to 1."""
    half = max(1, round(length))
    kernel = 1.0 + np.cos(np.pi * np.arange(-half, half + 1) / (half + 1))
    padded = np.pad(indicator, half, mode="edge")
    return np.convolve(padded, kernel / kernel.sum(), mode="valid")
