"""Frequency response of an actuator from requested and measured acceleration, with a fitted resonator, and profiles.

Profiles are made from a data sheet's figures or from a measured response. Both give a response relative to its median
level within the usable range; full scale is the acceleration at that median.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import UsageError
from ...metrics.spectra import hann_window
from ..profile import ActuatorProfile

Float = NDArray[np.float64]

MIN_GAIN_DB = -200.0
"""Lowest gain of a response [dB]."""


@dataclass(frozen=True, eq=False)  # comparing arrays gives no single bool
class FrequencyResponse:
    """Ratio of measured to requested acceleration of an actuator, over frequency.

    Attributes
    ----------
    frequency_hz : (n,) array
        Ascending frequencies above 0 [Hz].
    gain_db : (n,) array
        Gain [dB].
    phase_rad : (n,) array
        Unwrapped phase without the delay [rad].
    coherence : (n,) array
        Fraction of the measured power that is linearly related to the request, 0–1 (Bendat and Piersol); 1 from a data
        sheet.
    delay_s : float
        Delay of the measurement [s].

    Raises
    ------
    UsageError
        If the arrays are anything else.
    """

    frequency_hz: Float
    gain_db: Float
    phase_rad: Float
    coherence: Float
    delay_s: float = 0.0

    def __post_init__(self) -> None:
        columns = (self.frequency_hz, self.gain_db, self.phase_rad, self.coherence)
        if not (
            self.frequency_hz.ndim == 1
            and len(self.frequency_hz) >= 2
            and all(column.shape == self.frequency_hz.shape and np.isfinite(column).all() for column in columns)
            and self.frequency_hz[0] > 0.0
            and (np.diff(self.frequency_hz) > 0.0).all()
            and (np.abs(self.gain_db) <= -MIN_GAIN_DB).all()
            and self.coherence.min() >= 0.0
            and self.coherence.max() <= 1.0
            and np.isfinite(self.delay_s)
        ):
            raise UsageError(
                "this is no frequency response.",
                remedy="Give at least two ascending frequencies above 0 Hz, each with gain, phase and coherence.",
            )

    def gain_db_at(self, frequency_hz: ArrayLike) -> Float:
        """Interpolate the gain [dB] at frequencies [Hz], linearly over log frequency and constant beyond the ends."""
        clamped = np.maximum(np.asarray(frequency_hz, dtype=np.float64), self.frequency_hz[0])
        return np.asarray(np.interp(np.log(clamped), np.log(self.frequency_hz), self.gain_db))


MIN_WINDOW_S, MAX_WINDOW_S, WINDOW_COUNT = 0.4, 1.6, 8
"""Shortest and longest analysis window [s], and number of windows in the recording.

A longer window resolves a narrower resonance (2.5 Hz with 0.4 s); several are needed for a meaningful coherence.
"""
POINTS_PER_OCTAVE = 24
"""Frequencies per octave of an estimated response."""
MIN_COHERENCE = 0.5
"""Coherence below which a frequency shows the noise rather than the actuator."""


def estimate_response(
    requested: ArrayLike, measured: ArrayLike, rate_hz: float, low_hz: float, high_hz: float
) -> FrequencyResponse:
    """Estimate the frequency response between `low_hz` and `high_hz`.

    The delay is found by correlation and removed.

    Parameters
    ----------
    requested : (n,) array_like
        Requested acceleration [m/s²].
    measured : (m,) array_like
        Measured acceleration [m/s²]; it may begin earlier or later.
    rate_hz : float
        Sample rate of both [Hz].
    low_hz, high_hz : float
        Frequency range [Hz].

    Raises
    ------
    UsageError
        If a signal is too short or silent, less than half of the frequencies are coherent, or the range is empty.

    Notes
    -----
    H1 = Σ A* G / Σ |A|² over Hann windows that overlap by three quarters. Noise in the measured signal does not bias it
    (J. S. Bendat and A. G. Piersol, Random Data, ch. 6). Bins are averaged to `POINTS_PER_OCTAVE`.
    """
    if not 0.0 < low_hz < high_hz:
        raise UsageError(
            f"there is no range from {low_hz:g} to {high_hz:g} Hz.", remedy="Give ascending frequencies above 0."
        )
    request, measurement = (np.asarray(values, dtype=np.float64) for values in (requested, measured))
    if not (request.any() and measurement.any() and np.isfinite(request).all() and np.isfinite(measurement).all()):
        raise UsageError(
            "nothing came back, or nothing was asked for.",
            remedy="Check that the actuator moves and the accelerometer is recorded.",
        )
    delay = find_delay_frames(request, measurement)
    before, after = _align(request, measurement, delay)
    window = round(min(max(len(before) / WINDOW_COUNT, MIN_WINDOW_S * rate_hz), MAX_WINDOW_S * rate_hz))
    if len(before) < 2 * window:
        raise UsageError(
            f"a response cannot be read from less than {2 * MIN_WINDOW_S:g} s.",
            remedy="Play a longer sweep, and record all of it.",
        )
    cross, power, output_power = _compute_spectra(before, after, window)
    frequency, gain, coherence = _average_bins(cross, power, output_power, rate_hz, window, low_hz, high_hz)
    if np.count_nonzero(coherence >= MIN_COHERENCE) < 0.5 * len(coherence):
        raise UsageError(
            f"what came back does not follow from what was asked for (coherence {np.median(coherence):.2f}).",
            remedy="Play louder, keep the sensor still on the actuator, and record the very same sweep.",
        )
    level = np.maximum(20.0 * np.log10(np.maximum(np.abs(gain), 1e-12)), MIN_GAIN_DB)
    return FrequencyResponse(frequency, level, np.unwrap(np.angle(gain)), coherence, delay / rate_hz)


def find_delay_frames(requested: Float, measured: Float) -> int:
    """Return the frames by which `measured` lags `requested` (negative if it leads).

    This is the maximum of the envelope of their correlation, because a resonance turns the phase and moves the
    correlation's own peak by part of a period.
    """
    size = 1 << (len(requested) + len(measured)).bit_length()
    product = np.conj(np.fft.fft(requested, size)) * np.fft.fft(measured, size)
    product[size // 2 + 1 :] = 0.0
    product[1 : size // 2] *= 2.0
    lag = int(np.argmax(np.abs(np.fft.ifft(product))))
    return lag if lag < size - len(requested) else lag - size


def _align(requested: Float, measured: Float, delay: int) -> tuple[Float, Float]:
    before, after = (requested, measured[delay:]) if delay >= 0 else (requested[-delay:], measured)
    count = min(len(before), len(after))
    return before[:count], after[:count]


def _compute_spectra(before: Float, after: Float, window: int) -> tuple[NDArray[np.complex128], Float, Float]:
    """Sum cross spectrum A* G and powers |A|² and |G|² over Hann windows, (window // 2 + 1,) each.

    A is the spectrum of `before` (requested), G that of `after` (measured).
    """
    taper, hop = hann_window(window), window // 4
    frames = (np.lib.stride_tricks.sliding_window_view(values, window)[::hop] for values in (before, after))
    input_spectra, output_spectra = (np.fft.rfft(frame * taper, axis=1) for frame in frames)
    return (
        np.asarray((np.conj(input_spectra) * output_spectra).sum(axis=0)),
        np.asarray(np.square(np.abs(input_spectra)).sum(axis=0)),
        np.asarray(np.square(np.abs(output_spectra)).sum(axis=0)),
    )


def _average_bins(
    cross: NDArray[np.complex128],
    power: Float,
    output_power: Float,
    rate_hz: float,
    window: int,
    low_hz: float,
    high_hz: float,
) -> tuple[Float, NDArray[np.complex128], Float]:
    """Average DFT bins in steps of 1 / `POINTS_PER_OCTAVE` octave.

    Returns frequency [Hz], complex gain and coherence, (k,) each.
    """
    frequency = np.arange(len(power)) * rate_hz / window
    steps = np.round(POINTS_PER_OCTAVE * np.log2(np.maximum(frequency, 1e-9) / low_hz))
    inside = (frequency >= low_hz) & (frequency <= high_hz) & (power > 1e-9 * power.max())
    points: list[tuple[float, complex, float]] = []
    for step in np.unique(steps[inside]):
        rows = inside & (steps == step)
        weight = float(power[rows].sum())
        # Bins of one step lie within 3 % of frequency, where level and phase hardly differ. So their gains are
        # averaged, weighted by the requested power.
        gain = complex(cross[rows].sum() / weight)
        coherence = float(np.sum(np.square(np.abs(cross[rows])) / np.maximum(output_power[rows], 1e-300)) / weight)
        points.append((float(np.average(frequency[rows], weights=power[rows])), gain, min(coherence, 1.0)))
    columns = tuple(zip(*points, strict=True)) if points else ((), (), ())
    return np.array(columns[0]), np.array(columns[1], dtype=np.complex128), np.array(columns[2])


_MAX_ITERATIONS = 100
_DIFFERENCE_STEP = 1e-5


@dataclass(frozen=True)
class Resonator:
    """Acceleration of a mass on a spring driven by a force: H = gain · s² / (s² + 2 damping ω₀ s + ω₀²).

    Here s = 2πif and ω₀ = 2π `resonance_hz`. `gain` applies far above the resonance; `error_db` is the
    coherence-weighted RMS error of the level after a fit.
    """

    resonance_hz: float
    damping: float
    gain: float
    error_db: float = 0.0

    def evaluate(self, frequency_hz: ArrayLike) -> NDArray[np.complex128]:
        """Return the complex response at each frequency."""
        ratio = np.asarray(frequency_hz, dtype=np.float64) / self.resonance_hz
        return np.asarray(-self.gain * ratio**2 / (1.0 - ratio**2 + 2j * self.damping * ratio))


def fit_resonance(response: FrequencyResponse) -> Resonator:
    """Fit a resonator to the level of a response, by least squares in dB weighted by coherence².

    The start is the best of a grid over resonance and damping. Gauss–Newton iterations with Levenberg's damping then
    refine the logarithms of the three parameters.
    """
    frequency, level, weight = response.frequency_hz, response.gain_db, response.coherence
    low, high = np.log(frequency[0] / 4.0), np.log(frequency[-1] * 4.0)
    starts = [
        np.array([centre, np.log(damping), 0.0])
        for centre in np.linspace(low, high, 60)
        for damping in (0.02, 0.07, 0.2, 0.6)
    ]
    for start in starts:  # resonance and damping determine the best gain
        start[2] = np.average(level - _compute_level_db(start, frequency), weights=weight**2) * np.log(10.0) / 20.0
    best = min(starts, key=lambda start: _compute_error_db(start, frequency, level, weight))
    levenberg = 1e-2
    for _ in range(_MAX_ITERATIONS):
        residual = weight * (level - _compute_level_db(best, frequency))
        steps = _DIFFERENCE_STEP * np.eye(len(best))
        differences = [
            _compute_level_db(best + step, frequency) - _compute_level_db(best - step, frequency) for step in steps
        ]
        jacobian = np.stack(differences, axis=1) * (weight / (2.0 * _DIFFERENCE_STEP))[:, None]
        normal = jacobian.T @ jacobian
        update = np.linalg.solve(normal + levenberg * np.diag(np.diag(normal) + 1e-12), jacobian.T @ residual)
        update = np.clip(update, -1.0, 1.0)
        if _compute_error_db(best + update, frequency, level, weight) < _compute_error_db(
            best, frequency, level, weight
        ):
            best, levenberg = best + update, max(levenberg / 10.0, 1e-9)
        elif levenberg > 1e6:
            break
        else:
            levenberg *= 10.0
    parameters = np.exp(best)
    return Resonator(
        float(parameters[0]),
        float(parameters[1]),
        float(parameters[2]),
        _compute_error_db(best, frequency, level, weight),
    )


def _compute_level_db(logs: Float, frequency: Float) -> Float:
    resonance, damping, gain = np.exp(np.clip(logs, -60.0, 60.0))
    return np.asarray(
        20.0 * np.log10(np.maximum(np.abs(Resonator(resonance, damping, gain).evaluate(frequency)), 1e-30))
    )


def _compute_error_db(logs: Float, frequency: Float, level: Float, weight: Float) -> float:
    return float(np.sqrt(np.average(np.square(level - _compute_level_db(logs, frequency)), weights=weight**2 + 1e-12)))


LOWEST_HZ, HIGHEST_HZ = 10.0, 1000.0
"""Frequency range of a data-sheet response [Hz]."""
GRID_POINTS_PER_OCTAVE = 24
"""Frequencies per octave of a data-sheet response, apart from extra ones at the resonance."""
DATASHEET_USABLE_DB = 20.0
"""Level below the resonance at which the range ends [dB]; an inverse filter could not restore less."""
MIN_Q, MAX_Q = 0.1, 1000.0
"""Range of plausible quality factors."""


def make_datasheet_profile(
    title: str,
    source: str,
    *,
    resonance_hz: float,
    quality: float,
    peak_m_s2: float | None,
    range_hz: tuple[float, float] | None = None,
    sustained: float | None = None,
    thermal_s: float | None = None,
) -> ActuatorProfile:
    """Make a profile from a maker's figures, with the response of a mass on a spring.

    Parameters
    ----------
    title : str
        Name of the device.
    source : str
        Document that the figures are from.
    resonance_hz : float
        Resonance frequency [Hz].
    quality : float
        Quality factor: resonance divided by the width between the half-power points.
    peak_m_s2 : float or None
        Amplitude at the resonance, at full drive, on the load that the sheet names [m/s²]; None if not stated.
    range_hz : tuple of float or None
        Usable range [Hz]; None means within `DATASHEET_USABLE_DB` of the resonance.
    sustained, thermal_s : float or None
        See `ActuatorProfile`.

    Raises
    ------
    UsageError
        If no tactile actuator has such figures.
    """
    if not (LOWEST_HZ <= resonance_hz <= HIGHEST_HZ and MIN_Q <= quality <= MAX_Q):
        raise UsageError(
            f"a resonance of {resonance_hz:g} Hz with a Q of {quality:g} is no actuator for touch.",
            remedy=f"Give {LOWEST_HZ:g} to {HIGHEST_HZ:g} Hz, and a Q of {MIN_Q:g} to {MAX_Q:g}.",
        )
    octaves = math.log2(HIGHEST_HZ / LOWEST_HZ)
    grid = np.geomspace(LOWEST_HZ, HIGHEST_HZ, round(octaves * GRID_POINTS_PER_OCTAVE) + 1)
    around_resonance = resonance_hz * 2.0 ** np.linspace(-1.0, 1.0, 401) ** 3  # dense at the resonance
    frequency = np.unique(
        np.concatenate([grid, around_resonance[(around_resonance > LOWEST_HZ) & (around_resonance < HIGHEST_HZ)]])
    )
    model = Resonator(resonance_hz, 0.5 / quality, 1.0)
    values = model.evaluate(frequency)
    level = 20.0 * np.log10(np.abs(values) / abs(complex(model.evaluate(resonance_hz))))
    band = range_hz or _find_range_around_peak(frequency, level)
    if not band[0] < HIGHEST_HZ or not band[1] > LOWEST_HZ:
        raise UsageError(f"no frequency of touch lies from {band[0]:g} to {band[1]:g} Hz.", remedy="Check the range.")
    within = np.geomspace(max(band[0], LOWEST_HZ), min(band[1], HIGHEST_HZ), 101)
    median = float(np.median(np.interp(np.log(within), np.log(frequency), level)))
    response = FrequencyResponse(frequency, level - median, np.unwrap(np.angle(values)), np.ones_like(frequency))
    return ActuatorProfile(
        "described",
        title,
        source,
        range_hz=band,
        peak_m_s2=None if peak_m_s2 is None else peak_m_s2 * 10.0 ** (median / 20.0),
        sustained=sustained,
        thermal_s=thermal_s,
        response=response,
    )


def _find_range_around_peak(frequency: Float, level: Float) -> tuple[float, float]:
    """Find the ends [Hz] of the contiguous range around the peak of `level` (n,) [dB].

    All of it is within `DATASHEET_USABLE_DB` of the peak; `frequency` (n,) is in Hz.
    """
    usable = level >= float(level.max()) - DATASHEET_USABLE_DB
    first = last = int(level.argmax())
    while first > 0 and usable[first - 1]:
        first -= 1
    while last < len(level) - 1 and usable[last + 1]:
        last += 1
    return float(frequency[first]), float(frequency[last])


MEASURED_USABLE_DB = 20.0
"""Level below the median at which the range ends [dB]; an inverse filter could not restore less."""

MIN_PEAK_M_S2, MAX_PEAK_M_S2 = 1e-3, 1e5
"""Plausible full scales [m/s²]; outside this range a unit was mistaken."""


@dataclass(frozen=True)
class MeasuredProfile:
    """A profile made from a measurement.

    Attributes
    ----------
    profile : ActuatorProfile
        Profile whose response is relative to its median level in the usable range.
    gain_db : float
        That median, measured over requested acceleration [dB].
    resonator : Resonator
        Fit to the response.
    """

    profile: ActuatorProfile
    gain_db: float
    resonator: Resonator


def make_measured_profile(
    base: ActuatorProfile,
    response: FrequencyResponse,
    *,
    title: str,
    calibrated: bool,
    range_hz: tuple[float, float] | None = None,
) -> MeasuredProfile:
    """Make a profile from a base profile and a response measured with it.

    Parameters
    ----------
    base : ActuatorProfile
        Profile used during the measurement.
    response : FrequencyResponse
        Measured response.
    title : str
        Name of the new profile.
    calibrated : bool
        Whether the sensor's m/s² are absolute. If so, full scale is the acceleration at the median level instead of the
        base's.
    range_hz : tuple of float or None
        Usable range [Hz]; None means that of `find_usable_range`.

    Raises
    ------
    UsageError
        If no actuator could have such a full scale.
    """
    band = range_hz or find_usable_range(response)
    inside = (response.frequency_hz >= band[0]) & (response.frequency_hz <= band[1])
    median = float(np.median(response.gain_db[inside] if inside.any() else response.gain_db))
    relative = replace(response, gain_db=response.gain_db - median)
    peak = base.limits.full_scale_m_s2
    source = f"measured as {'its' if calibrated else 'a share of its'} acceleration; before: {base.source}"
    if calibrated:
        peak *= 10.0 ** (median / 20.0)
        if not MIN_PEAK_M_S2 <= peak <= MAX_PEAK_M_S2:
            raise UsageError(
                f"at full scale the actuator would give {peak:.3g} m/s².",
                remedy="Check --sensitivity: m/s² at full scale of the recording; a file in m/s² needs none.",
            )
    profile = replace(
        base,
        name="measured",
        title=title,
        source=source,
        range_hz=band,
        peak_m_s2=peak if calibrated else base.peak_m_s2,
        response=relative,
    )
    return MeasuredProfile(profile, median, fit_resonance(relative))


def find_usable_range(response: FrequencyResponse) -> tuple[float, float]:
    """Find the ends [Hz] of the longest range in which a response is coherent and near its median level.

    Near is within `MEASURED_USABLE_DB`.
    """
    median = np.median(response.gain_db[response.coherence >= MIN_COHERENCE])
    usable = (response.coherence >= MIN_COHERENCE) & (response.gain_db >= median - MEASURED_USABLE_DB)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], usable, [False]]).astype(np.int8)))
    starts, ends = edges[::2], edges[1::2] - 1
    longest = int(np.argmax(ends - starts))
    return float(response.frequency_hz[starts[longest]]), float(response.frequency_hz[ends[longest]])
