"""Strength, frequency and clicks of `.hjif` files: effects of VectorialWave bands, and keyframes of Transient ones.

Written is one wave whose keyframes are the control points of amplitude and frequency, and one transient per click, with
its strength and frequency. The reference software plays every transient as two periods of a sine within 22 ms, whatever
its frequency, and adds it to the wave; other formats replace the wave by 15 ms of the click's own frequency.

Read are files of one sine at a time as they are. Of curves, other waveforms and waves at the same time, strength and
frequency are measured on what they play; clicks are those of Transient bands all the same.
"""

from __future__ import annotations

import datetime
import json
import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileError
from ..json_io import write_json
from ..signal import Signal
from .envelope import (
    Emphasis,
    Envelope,
    Float,
    compute_envelope,
    select_control_points,
    select_frequency_points,
    separate_equal_times,
)
from .hjif import BAND_RENDERERS, TRANSIENT_S, EffectKeyframes, HjifChannel, encode_tree, is_sine, read_channel
from .options import DEFAULT_RANGE_HZ, ExportOptions, ImportOptions
from .provenance import EnvelopeFile, Provenance, make_rendered_provenance

TICKS_PER_S = 10_000
TRANSIENT_HZ = 2.0 / TRANSIENT_S
"""Frequency at which the reference software plays a transient [Hz]."""
EFFECT_S = 3.0
"""Duration of an effect [s]; two must stay within the 65,535 ticks that a keyframe's position may count."""
DIGITS = 9
CLICK_SHAPE = (
    f"Shape of clicks: each is two periods of {TRANSIENT_HZ:.0f} Hz ({1000 * TRANSIENT_S:.0f} ms) on top of the tone, "
    "up to 6 dB more than 15 ms of its own frequency; time, strength and frequency are kept."
)


def store_hjif(path: Path, envelope: Envelope, signal: Signal, options: ExportOptions) -> tuple[str, ...]:
    """Write an envelope as `.hjif`, with the origin of `signal`; return sentences on what the format cannot hold.

    Raises FileError if the file cannot be written.
    """
    full_scale = options.full_scale_m_s2
    peak = max([float(envelope.amplitude.max()), *(click.amplitude for click in envelope.emphases)])
    gain = max(1.0, peak / full_scale)
    bands = [_encode_wave(envelope, full_scale * gain, options)] if envelope.amplitude.any() else []
    if envelope.emphases:
        bands.append(_encode_clicks(envelope, full_scale * gain))
    end_s = max([envelope.duration_s, *(click.time_s + TRANSIENT_S for click in envelope.emphases)])
    tree = encode_tree(
        signal,
        options,
        bands,
        gain,
        rate=TICKS_PER_S,
        count=math.ceil(round(end_s * TICKS_PER_S, 3)),
        date=datetime.date.today().isoformat(),
        facts={"duration_s": round(envelope.duration_s, DIGITS)},
    )
    write_json(path, tree, indent=None)
    return (CLICK_SHAPE,) if envelope.emphases else ()


def _encode_wave(envelope: Envelope, unit: float, options: ExportOptions) -> dict[str, Any]:
    """Return a band of one sine; `unit` is the acceleration of an amplitude of 1 [m/s²]."""
    share, time = envelope.amplitude / unit, envelope.time
    pitched = select_frequency_points(envelope).tolist()
    required = {*pitched, *np.searchsorted(time, np.arange(EFFECT_S, float(time[-1]), EFFECT_S)).tolist()}
    points = [
        (round(float(time[index]) * TICKS_PER_S), float(share[index]), float(envelope.frequency[index]))
        for index in select_control_points(time, share, options.error * float(share.max()), required)
    ]
    parts = _split_points(points)
    cycles = 0.0
    effects = []
    for number, part in enumerate(parts):
        if number:  # one tick after the last of the part before, so that no sample is of both
            part = [(parts[number - 1][-1][0] + 1, *parts[number - 1][-1][1:]), *part]
        effects.append(_make_effect(part, 2.0 * math.pi * (cycles % 1.0)))
        tick, _, hertz = np.array(part).T
        cycles += float(np.sum(0.5 * (hertz[1:] + hertz[:-1]) * np.diff(tick))) / TICKS_PER_S
        cycles += float(hertz[-1]) / TICKS_PER_S
    return _make_band("VectorialWave", float(envelope.frequency.max()), effects)


def _encode_clicks(envelope: Envelope, unit: float) -> dict[str, Any]:
    """Return a band of one transient per click."""
    points = [
        (round(click.time_s * TICKS_PER_S), click.amplitude / unit, click.frequency_hz) for click in envelope.emphases
    ]
    highest = max(click.frequency_hz for click in envelope.emphases)
    return _make_band("Transient", highest, [_make_effect(part, 0.0) for part in _split_points(points)])


def _split_points(points: list[tuple[int, float, float]]) -> list[list[tuple[int, float, float]]]:
    """Split points (tick, amplitude, frequency) into parts that one effect can hold, of `EFFECT_S` each."""
    parts = [[points[0]]]
    for point in points[1:]:
        if point[0] - parts[-1][0][0] > EFFECT_S * TICKS_PER_S:
            parts.append([])
        parts[-1].append(point)
    return parts


def _make_effect(points: list[tuple[int, float, float]], phase: float) -> dict[str, Any]:
    start = points[0][0]
    keyframes = [
        {
            "relative_position": max(0, tick - start),
            "amplitude_modulation": float(f"{share:.{DIGITS}g}"),
            "frequency_modulation": float(f"{hertz:.{DIGITS}g}"),
        }
        for tick, share, hertz in points
    ]
    head = {"effect_type": "Basis", "position": start, "phase": round(phase, 6), "base_signal": "Sine"}
    return head | {"keyframes": keyframes}


def _make_band(kind: str, highest_hz: float, effects: list[dict[str, Any]]) -> dict[str, Any]:
    limits = {"lower_frequency_limit": 0, "upper_frequency_limit": max(1, math.ceil(highest_hz))}
    return {"band_type": kind, **limits, "effects": effects}


def load_hjif(path: Path, options: ImportOptions) -> EnvelopeFile:
    """Read strength, frequency and clicks of the file's one channel; raise FileError as `read_hjif`."""
    channel = read_channel(path, options)
    range_hz = _read_range(channel, options)
    waves = [effect for kind, effect in channel.effects if kind == "VectorialWave" and len(effect.position)]
    has_curves = any(kind == "Curve" and len(effect.position) for kind, effect in channel.effects)
    assumed = []
    if not channel.is_stated:
        assumed.append(channel.provenance["scale"])
    if has_curves or not _is_one_sine(waves):
        signal = channel.render(str(path), *(set(BAND_RENDERERS) - {"Transient"}))
        if not len(signal.samples):
            raise FileError("plays nothing.", where=str(path), remedy="Export it again.")
        envelope = compute_envelope(signal, range_hz, where=str(path))
        assumed.append("strength and frequency as measured on its curves and waves")
    else:
        envelope = _join_waves(waves, channel, sum(range_hz) / 2.0, path)
    clicks = sorted([*envelope.emphases, *_read_clicks(channel)], key=lambda click: click.time_s)
    envelope = Envelope(envelope.time, envelope.amplitude, envelope.frequency, tuple(clicks))
    facts = channel.provenance if channel.is_stated else {}
    origin = Provenance(channel.scale_m_s2, range_hz, channel.is_stated, facts)
    return EnvelopeFile(envelope, origin, make_rendered_provenance(origin, path.name, assumed=tuple(assumed)))


def _read_range(channel: HjifChannel, options: ImportOptions) -> tuple[float, float]:
    """Return the range of the file's device if this project wrote it, else that of the options."""
    try:
        device = channel.perception["reference_devices"][0]
        low, high = float(device["minimum_frequency"]), float(device["maximum_frequency"])
        if channel.is_stated and options.range_hz is None and 0.0 < low < high <= 1e5:
            return low, high
    except (KeyError, IndexError, TypeError, ValueError, OverflowError):
        pass
    return options.range_hz or DEFAULT_RANGE_HZ


def _is_one_sine(waves: list[EffectKeyframes]) -> bool:
    """Return True for sines of positive strength and frequency, one at a time, from 0 s on."""
    ordered = sorted(waves, key=lambda effect: effect.start)
    follow = all(second.start >= first.end for first, second in pairwise(ordered))
    return follow and all(
        effect.start >= 0
        and is_sine(effect.shape)
        and np.isfinite(effect.frequency).any()
        and not (effect.amplitude < 0.0).any()
        and not (np.clip(effect.frequency, effect.low_hz, effect.high_hz) <= 0.0).any()
        for effect in waves
    )


def _join_waves(waves: list[EffectKeyframes], channel: HjifChannel, middle_hz: float, path: Path) -> Envelope:
    """Return sines that follow each other as one envelope, silent between them and up to the end of the channel."""
    duration_s = _read_duration(channel)
    if duration_s <= 0.0:
        raise FileError("plays nothing.", where=str(path), remedy="Export it again.")
    rows: list[tuple[float, float, float]] = []
    for effect in sorted(waves, key=lambda effect: effect.start):
        strength = _fill(effect.position, effect.amplitude) if np.isfinite(effect.amplitude).any() else 1.0
        hertz = np.clip(_fill(effect.position, effect.frequency), effect.low_hz, effect.high_hz)
        time = (effect.start + effect.position) / channel.ticks.timescale
        part = np.broadcast_arrays(time, strength, hertz)
        end = rows[-1][0] if rows else 0.0
        # Effects that are one tick apart go on: that keeps a sample from being of both.
        if time[0] > end + (1.5 / channel.ticks.timescale if rows else 0.0):
            rows += [(end, 0.0, float(hertz[0])), (float(time[0]), 0.0, float(hertz[0]))]
        rows += zip(*(each.tolist() for each in part), strict=True)
    rows = rows or [(0.0, 0.0, middle_hz)]
    if rows[-1][0] < duration_s:
        rows += [(rows[-1][0], 0.0, rows[-1][2]), (duration_s, 0.0, rows[-1][2])]
    time, share, hertz = np.array(rows, dtype=np.float64).T
    time = separate_equal_times(time)
    kept = np.append(time[time < duration_s], duration_s)
    return Envelope(kept, np.interp(kept, time, share) * abs(channel.unit_m_s2), np.interp(kept, time, hertz))


def _fill(position: Float, values: Float) -> Float:
    """Return values of keyframes with those interpolated that are NaN; two at one position, a step, stay two."""
    known, position = np.isfinite(values), separate_equal_times(position)
    return np.where(known, values, np.interp(position, position[known], values[known]))


def _read_duration(channel: HjifChannel) -> float:
    """Return the duration that a file of this project states, else that of its samples [s]."""
    whole_s = channel.ticks.count / channel.ticks.rate
    try:
        stated = float(json.loads(channel.tree["description"])["duration_s"]) if channel.is_stated else whole_s
    except (KeyError, TypeError, ValueError, RecursionError):
        return whole_s
    return stated if 0.0 < stated <= whole_s else whole_s


def _read_clicks(channel: HjifChannel) -> list[Emphasis]:
    """Return the transients of a channel that begin before its end and are not silent."""
    clicks = []
    for kind, effect in channel.effects:
        if kind != "Transient":
            continue
        for position, share, hertz in zip(effect.position, effect.amplitude, effect.frequency, strict=True):
            time_s = float(effect.start + position) / channel.ticks.timescale
            if np.isfinite(share) and share != 0.0 and 0.0 <= time_s < channel.ticks.count / channel.ticks.rate:
                tone = float(hertz) if np.isfinite(hertz) and hertz > 0.0 else TRANSIENT_HZ
                clicks.append(Emphasis(time_s, abs(float(share) * channel.unit_m_s2), tone))
    return clicks
