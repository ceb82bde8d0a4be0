"""Height profile under the path: the measured relief, and the noise that F_Θ is left to add beside it.

`build_stroke_profile` joins the tactile maps (height maps) of the surface patches to one profile along the path, which
`contact_motion` takes through the whole contact. F_Θ predicts the power of the complete surface, S(f; m, u), which
already contains that relief. Per arc band (a band of wavenumbers along the path) the share of the linear contact's
power that the profile explains is therefore taken from the noise: all of it where the profile is the surface, some
where waves across the path tilt the tip too, none where the profile is not resolved. Friction's own force noise stays
whole. The profile's power is its *stationary* power, measured without single events such as a seam, which would
otherwise be taken for texture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..errors import StrokeError
from .carriers import ARC_PER_OCTAVE, Carriers
from .linear_contact import (
    SPEED_FLOOR_M_S,
    Condition,
    compute_linear_contact,
    compute_relief_power,
    time_band_power,
)
from .stroke import HeightProfile

if TYPE_CHECKING:
    from ..action.crossing import Seam
    from ..scene.camera import Patch
    from ..tactile.tactile_map import HeightMap

Float = NDArray[np.float64]

SEAM_RATIO = 6.0
"""Power relative to the median of its octave above which a segment is an event and not texture."""
_MIN_SEGMENTS = 8
"""Fewest segments in which events are searched."""
_MAX_EVENTS = 0.15
"""Largest fraction of segments that may be events."""


NEAR_BANDS, FAR_BANDS, FAR_WEIGHT = 4, 24, 1e-3
"""Arc bands on either side over which powers are compared, and the weight of those farther than the first.

A tone lies between two of the token's bands and in one of the profile's; and where neither has power, at a tone's
harmonics, the octave around them tells whether the profile holds the surface.
"""


@dataclass(frozen=True)
class ExplainedPower:
    """Shares of F_Θ's amplitudes that are left to noise beside a height profile: factors on the carriers.

    arc: (n, Ka), time: (n, Kt), on the power without friction's force noise.
    """

    arc: Float
    time: Float


def compute_profile_power(profile: HeightProfile, carriers: Carriers) -> Float:
    """Compute the height power (Ka,) of a profile per arc band [m²], without single events such as seams.

    The straight line through its ends counts for nothing, and neither do waves that the profile does not resolve, nor
    seams between objects.
    """
    finest = find_finest(profile)
    edges, power = carriers.arc_edges(), np.zeros(carriers.arc_count)
    octaves = int(np.sum(edges[:-1:ARC_PER_OCTAVE] < finest))
    if octaves == 0 or (len(profile.height) - 1) * profile.step_m < 4.0 * carriers.arc_step_m(octaves - 1):
        return power  # Shorter than four samples of the finest octave.
    count = len(profile.height)
    texture = profile.height if profile.seam is None else profile.height - profile.seam
    height = texture - np.linspace(texture[0], texture[-1], count)
    # Padding for the ringing of the narrowest band, so that one end does not wrap around to the other.
    size = 1 << int(np.ceil(np.log2(count + 0.02 / profile.step_m)))
    kappa = np.fft.rfftfreq(size, profile.step_m)
    spectrum = np.where(kappa <= finest, np.fft.rfft(height, size), 0.0)
    # Without a window a tone would leak into the bands beside its own.
    window = np.hanning(count)
    tapered = np.where(kappa <= finest, np.fft.rfft(window * height, size), 0.0)
    energy = np.square(np.abs(tapered)) * (2.0 / (size * np.square(window).sum()))
    for octave in range(octaves):
        bands = slice(octave * ARC_PER_OCTAVE, (octave + 1) * ARC_PER_OCTAVE)
        band_edges = edges[bands.start : bands.stop + 1]
        borders = np.searchsorted(kappa, band_edges)
        inside = slice(int(borders[0]), int(borders[-1]))
        if inside.start == inside.stop:
            continue
        cumulative = np.concatenate([[0.0], np.cumsum(energy[inside])])
        level = np.diff(cumulative[borders - inside.start])
        octave_spectrum = np.zeros_like(spectrum)
        # Cut in two at the octave's edge, a tone would be loudest at the profile's ends, as an event is.
        around = slice(*np.searchsorted(kappa, (band_edges[0] / MARGIN_RATIO, band_edges[-1] * MARGIN_RATIO)))
        octave_spectrum[around] = spectrum[around]
        wave = np.fft.irfft(octave_spectrum, size)[:count]
        power[bands] = _stationary_power(wave, level, band_edges, profile.step_m)
    return power


def find_finest(profile: HeightProfile) -> float:
    """Return the largest wavenumber that a profile resolves [cycles/m]."""
    return 1.0 / max(profile.resolved_wavelength_m, 2.0 * profile.step_m)


MARGIN_RATIO = 2.0 ** (2.0 / ARC_PER_OCTAVE)
"""Margin on either side of an octave within which events are looked for: two bands."""


def _stationary_power(total: Float, level: Float, band_edges: Float, step: float) -> Float:
    """Compute the mean power (24,) of an octave's bands over those parts of the profile without events such as seams.

    total: (m,) height summed over the bands and those beside them, every `step` [m]. level: (24,) the bands' mean power
    with all events.
    """
    if len(total) == 0:
        return level
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


def explain_power(
    profile_power: Float,
    finest: float,
    amplitude: Float,
    noise: Float,
    body: Float,
    condition: Condition,
    carriers: Carriers,
) -> ExplainedPower:
    """Find how much of F_Θ's amplitudes is left to noise beside a height profile, at each of n states.

    Parameters
    ----------
    profile_power
        (Ka,) height power of the profile per arc band [m²].
    finest
        Largest wavenumber that it resolves [cycles/m].
    amplitude
        (n, K) of the carriers, as field.accumulate gives it.
    noise
        (n, K) power of friction's force noise in it.
    body
        (n, K) power gain of the probe's body in it.
    condition
        The n states.
    carriers
        Carriers of the field.
    """
    known = compute_relief_power(profile_power, condition, carriers)
    expected = compute_linear_contact(condition, carriers).power
    near, everything = _pool(known), _pool(expected)
    explained = np.minimum(np.divide(near, everything, out=np.zeros_like(near), where=everything > LEAST_POWER), 1.0)
    resolved = carriers.arc_centres() <= finest
    explained[explained > HELD_SHARE] = 1.0
    explained[:, ~resolved] = 0.0
    arc, time = (np.square(amplitude[:, columns]) for columns in (carriers.arc_slice, carriers.time_slice))
    arc_noise, time_noise = (
        np.minimum(noise[:, columns], power)
        for columns, power in ((carriers.arc_slice, arc), (carriers.time_slice, time))
    )
    # Hopping is the profile's; waves across the path only tilt the tip, as the linear contact says.
    contact = np.where(resolved, np.minimum(arc - arc_noise, expected * body[:, carriers.arc_slice]), arc - arc_noise)
    in_time = _sort_into_time_bands(explained, condition.speed, carriers)
    return ExplainedPower(
        _divide_amplitudes((1.0 - explained) * contact + arc_noise, arc),
        _divide_amplitudes((1.0 - in_time) * (time - time_noise) + time_noise, time),
    )


def _divide_amplitudes(power: Float, whole: Float) -> Float:
    """Return the amplitudes' ratio of two powers, 1 where the second vanishes."""
    return np.asarray(np.sqrt(np.divide(power, whole, out=np.ones_like(whole), where=whole > LEAST_POWER)))


HELD_SHARE = 0.9
"""Share of the power from which on a profile is the surface: the rest is how the two spectra were measured."""
LEAST_POWER = 1e-30
"""Power below which there is nothing to share [(m/s²)²]."""


def _pool(power: Float) -> Float:
    """Sum powers (n, Ka) over the arc bands around each: NEAR_BANDS on either side, and a little of the octave."""
    kernel = np.full(2 * FAR_BANDS + 1, FAR_WEIGHT)
    kernel[FAR_BANDS - NEAR_BANDS : FAR_BANDS + NEAR_BANDS + 1] = 1.0
    size = power.shape[1] + 2 * FAR_BANDS
    spectrum = np.fft.rfft(power, size, axis=1) * np.fft.rfft(kernel, size)
    pooled = np.fft.irfft(spectrum, size, axis=1)[:, FAR_BANDS : FAR_BANDS + power.shape[1]]
    return np.asarray(np.maximum(pooled, 0.0))


def _sort_into_time_bands(share: Float, speed: Float, carriers: Carriers) -> Float:
    """Return the mean share (n, Kt) in each time band, of shares (n, Ka) of the arc bands at the frequencies κ v.

    Where no arc band reaches, the share is 0.
    """
    width = np.diff(carriers.arc_edges())
    hertz = np.maximum(speed, SPEED_FLOOR_M_S)[:, None]
    covered = time_band_power(np.broadcast_to(width, share.shape) * hertz, speed, carriers)
    taken = time_band_power(share * width * hertz, speed, carriers)
    return np.asarray(np.minimum(taken / np.maximum(covered, np.diff(carriers.time_edges())), 1.0))


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
SEAM_RADIUS_M = 0.5e-3
"""Radius with which an edge is climbed [m]: that of the pen's tip. What a larger tip smooths, the contact smooths."""
SEAM_GRID_M, SEAM_WAVELENGTH_M = 25e-6, 0.1e-3
"""Step of a profile of seams alone, and the wavelength that it resolves [m]."""


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


def add_seams(profile: HeightProfile | None, seams: Sequence[Seam], position: Float) -> HeightProfile | None:
    """Add the steps at seams to the height under a path.

    Parameters
    ----------
    profile : HeightProfile or None
        Measured height; None if there is none, and the path is level but for its seams.
    seams : sequence of Seam
        The seams.
    position : ndarray, shape (n,)
        Positions of the path's samples [m].

    Returns
    -------
    HeightProfile or None
        With the steps as its `seam`; unchanged without seams.

    Notes
    -----
    A tip of radius R that is pushed over an edge of height h begins to climb √(2 R h) before it. The step is as wide to
    either side.
    """
    if not seams:
        return profile
    if profile is None:
        start, end = float(position.min()), float(position.max())
        step = max(SEAM_GRID_M, (end - start) / (MAX_SAMPLES - 1))
        count = int(np.ceil((end - start) / step)) + 1
        profile = HeightProfile(step, start, np.zeros(count), SEAM_WAVELENGTH_M)
    place = profile.origin_m + profile.step_m * np.arange(len(profile.height))
    steps = np.zeros(len(place))
    for seam in seams:
        reach = max(float(np.sqrt(2.0 * SEAM_RADIUS_M * abs(seam.step_m))), 2.0 * profile.step_m)
        way = np.clip((place - seam.position_m) / (2.0 * reach) + 0.5, 0.0, 1.0)
        steps += seam.step_m * np.square(way) * (3.0 - 2.0 * way)
    return replace(profile, height=profile.height + steps, seam=steps)
