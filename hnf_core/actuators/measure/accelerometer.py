"""Play an excitation on an actuator while an accelerometer on a sound input records it.

Gives the requested and the measured acceleration [m/s²] at the device's rate, for `estimate_response`. The virtual
actuator is simulated instead.
"""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import DeviceError, UsageError
from ...field.resampling import resample
from ...signal import Signal
from ..limits import FULL_SCALE_COUNTS, Limits
from ..runtime import import_optional
from ..signal_chain import render_counts
from ..sink import Sink, SinkFormat
from ..sinks.audio import OPEN_STREAMS, explain_error
from ..sources import BufferSource
from ..stream import Stream
from ..virtual_transducer import GENERIC_TRANSDUCER, counts_to_drive, simulate_motion

EXCITATION_FADE_S = 0.05
"""Length of the fades at the ends of an excitation [s]."""


def make_sweep(rate_hz: float, seconds: float, low_hz: float, high_hz: float, peak_m_s2: float) -> Signal:
    """Make an exponential sine sweep with equal time in every octave, faded at its ends.

    Parameters
    ----------
    rate_hz : float
        Sample rate [Hz].
    seconds : float
        Length [s].
    low_hz, high_hz : float
        First and last frequency [Hz].
    peak_m_s2 : float
        Amplitude [m/s²].

    Raises
    ------
    UsageError
        If low, high and half the rate are not ascending, or the length is not within 0.5–600 s.

    Notes
    -----
    A. Farina, "Simultaneous measurement of impulse response and distortion with a swept-sine technique", AES 108, 2000,
    equation of the exponential sweep.
    """
    _check_excitation(rate_hz, seconds, low_hz, high_hz, peak_m_s2)
    time_s = np.arange(round(rate_hz * seconds)) / rate_hz
    octaves = np.log(high_hz / low_hz)
    phase = 2.0 * np.pi * low_hz * seconds / octaves * np.expm1(time_s / seconds * octaves)
    facts = {"excitation": "sweep", "low_hz": f"{low_hz:g}", "high_hz": f"{high_hz:g}"}
    return Signal(_fade_ends(peak_m_s2 * np.sin(phase), rate_hz), rate_hz, 0, facts)


def make_noise(rate_hz: float, seconds: float, low_hz: float, high_hz: float, peak_m_s2: float, seed: int) -> Signal:
    """Make pink noise between `low_hz` and `high_hz` with peak `peak_m_s2` [m/s²], faded at its ends.

    `rate_hz` is the sample rate, `seconds` the length, `seed` selects the noise. Raises UsageError if low, high and
    half the rate are not ascending, or the length is not within 0.5–600 s.
    """
    _check_excitation(rate_hz, seconds, low_hz, high_hz, peak_m_s2)
    count = round(rate_hz * seconds)
    frequency = np.fft.rfftfreq(count, 1.0 / rate_hz)
    inside = (frequency >= low_hz) & (frequency <= high_hz)
    level = np.where(inside, 1.0 / np.sqrt(np.maximum(frequency, low_hz)), 0.0)
    phase = np.random.Generator(np.random.Philox(key=seed)).uniform(0.0, 2.0 * np.pi, len(frequency))
    samples = np.fft.irfft(level * np.exp(1j * phase), count)
    facts = {"excitation": "noise", "low_hz": f"{low_hz:g}", "high_hz": f"{high_hz:g}"}
    scaled = samples / np.abs(samples).max() * peak_m_s2
    return Signal(_fade_ends(scaled, rate_hz), rate_hz, seed, facts)


def _check_excitation(rate_hz: float, seconds: float, low_hz: float, high_hz: float, peak_m_s2: float) -> None:
    if not (0.0 < low_hz < high_hz <= 0.5 * rate_hz and 0.5 <= seconds <= 600.0 and peak_m_s2 > 0.0):
        raise UsageError(
            f"there is no such excitation: {seconds:g} s from {low_hz:g} to {high_hz:g} Hz, {peak_m_s2:g} m/s², at "
            f"{rate_hz:g} Hz.",
            remedy="Give 0.5 to 600 s, ascending frequencies up to half the rate, and a level above 0.",
        )


def _fade_ends(excitation: ArrayLike, rate_hz: float) -> NDArray[np.float32]:
    samples = np.asarray(excitation, dtype=np.float64)
    frames = min(round(EXCITATION_FADE_S * rate_hz), len(samples) // 4)
    envelope = np.ones(len(samples))
    ramp = 0.5 - 0.5 * np.cos(np.pi * (np.arange(frames) + 0.5) / frames)
    envelope[:frames], envelope[len(samples) - frames :] = ramp, ramp[::-1]
    return np.asarray(samples * envelope, dtype=np.float32)


TAIL_S = 0.3
"""Recording time after the last sample, for the sound system's delay and the ringing [s]."""


class Accelerometer:
    """Accelerometer on the first channel of a sound input; records as a context manager, once.

    Parameters
    ----------
    device : str, int or None
        Part of the input's name, its index, or None for the default.
    sensitivity : float
        Acceleration at full scale of the input [m/s²].
    """

    def __init__(self, device: str | int | None, sensitivity: float) -> None:
        self._device, self._sensitivity = device, sensitivity
        self._stream: Any = None
        self._blocks: list[NDArray[np.float32]] = []
        self._lock = threading.Lock()
        self._overflows = 0

    def __enter__(self) -> Accelerometer:
        """Start recording; raise DeviceError if the input cannot be opened."""
        sounddevice = import_optional("sounddevice")
        try:
            self._stream = sounddevice.InputStream(device=self._device, channels=1, callback=self._on_block)
            self._stream.start()
        except (sounddevice.PortAudioError, ValueError) as error:
            raise DeviceError(
                f"the accelerometer's sound input cannot be opened ({explain_error(error, 'input')}).",
                remedy=_describe_inputs(sounddevice),
            ) from error
        OPEN_STREAMS.add(id(self))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stream.close()
        OPEN_STREAMS.discard(id(self))

    def get_signal(self) -> Signal:
        """Return the recorded acceleration [m/s²] after recording has ended; raise DeviceError if samples were lost."""
        if self._overflows:
            raise DeviceError(
                "the sound input lost samples while it recorded.", remedy="Close other programs and measure again."
            )
        with self._lock:
            samples = np.concatenate(self._blocks) if self._blocks else np.zeros(0, dtype=np.float32)
        rate = float(self._stream.samplerate)
        return Signal(np.asarray(samples * self._sensitivity, dtype=np.float32), rate, 0)

    def _on_block(self, block: Any, _frames: int, _time: Any, status: Any) -> None:
        if status.input_overflow:
            self._overflows += 1
        with self._lock:
            self._blocks.append(np.array(block[:, 0], dtype=np.float32))


def _describe_inputs(sounddevice: Any) -> str:
    """Return a remedy that names the sound inputs."""
    names = [str(device["name"]) for device in sounddevice.query_devices() if device["max_input_channels"] > 0]
    if not names:
        return "Plug one in; on Linux the sound server must run for you."
    return f"Say --input audio:DEVICE with one of these: {', '.join(dict.fromkeys(names))}."


def measure_actuator(sink: Sink, sensor: Accelerometer, excitation: Signal, limits: Limits) -> tuple[Signal, Signal]:
    """Play an excitation and record it; return requested and measured acceleration at the device's rate.

    Parameters
    ----------
    sink : Sink
        Device to measure.
    sensor : Accelerometer
        Sensor on it.
    excitation : Signal
        Acceleration to play [m/s²].
    limits : Limits
        Limits of the actuator.

    Raises
    ------
    DeviceError
        If the device fails or has underruns.
    UsageError
        If the limits change the excitation.
    """
    source = BufferSource(np.asarray(excitation.samples).reshape(-1, 1), excitation.sample_rate)
    with sensor:
        with Stream(source, sink, limits) as stream:
            device = stream.start()
            ended = stream.wait(excitation.duration_s + 10.0)
            report = stream.report
        time.sleep(TAIL_S)
    measured = sensor.get_signal()
    if report.problem or not ended:
        raise DeviceError(report.problem or "the device did not play the excitation to its end.")
    if report.underruns:
        raise DeviceError(
            f"the device ran out of samples{'' if report.underruns == 1 else f' {report.underruns} times'}.",
            remedy="Close what computes beside it, and measure again.",
        )
    if limited := report.limited_samples + report.device_limited_samples:
        raise UsageError(f"{limited} samples were beyond the device's limits.", remedy="Measure with a lower --level.")
    requested = render_requested(excitation, replace(device, channels=1), limits)
    return requested, resample_signal(measured, device.rate_hz)


def simulate_measurement(excitation: Signal, limits: Limits) -> tuple[Signal, Signal]:
    """Compute requested and measured acceleration [m/s²] of the virtual actuator's transducer, without playing."""
    device = SinkFormat(excitation.sample_rate, 1, 1, "virtual")
    requested = render_requested(excitation, device, limits)
    drive = counts_to_drive(
        np.rint(requested.samples[:, None] * (FULL_SCALE_COUNTS / limits.full_scale_m_s2)).astype(np.int16)
    )
    acceleration = simulate_motion(GENERIC_TRANSDUCER, drive, device.rate_hz).acceleration[:, 0]
    return requested, replace(requested, samples=acceleration.astype(np.float32))


def render_requested(excitation: Signal, device: SinkFormat, limits: Limits) -> Signal:
    """Render the acceleration [m/s²] that the limiter lets through to the device, at the device's rate."""
    source = BufferSource(np.asarray(excitation.samples).reshape(-1, 1), excitation.sample_rate)
    counts = render_counts(source, device, limits)[:, 0]
    return Signal(
        (counts * (limits.full_scale_m_s2 / FULL_SCALE_COUNTS)).astype(np.float32), device.rate_hz, excitation.seed
    )


def resample_signal(signal: Signal, rate_hz: float) -> Signal:
    """Resample a signal to `rate_hz`, if it has another rate."""
    samples, _ = resample(np.asarray(signal.samples, dtype=np.float64), signal.sample_rate, rate_hz)
    return replace(signal, samples=samples.astype(np.float32), sample_rate=rate_hz)
