"""`.hjif` → Signal: what `hjif.py` writes, and of other files bands of the types Curve, VectorialWave and Transient.

Rendered as the reference software's synthesiser does (MPEGGroup/HapticReferenceSoftware: Types/src/Band.cpp,
Types/src/Effect.cpp), with a chirp's phase as the exact integral of its frequency.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..signal import Signal
from .hjif_bands import BANDS, TRANSIENT_S, EffectKeys, Float, Ticks
from .json_files import Reading, read_json
from .options import FULL_SCALE_M_S2, LARGEST_SCALE, SMALLEST_SCALE, ImportOptions
from .wav import UNITS

DEFAULT_TIMESCALE = 1000
MOST_TICKS = 2**31 - 1
MOST_SAMPLES = 20_000_000
LARGEST_GAIN = 1e45
"""The largest float32 over the smallest full scale."""
_REFERENCE = "Render it with MPEG's reference software, and import the WAV."


@dataclass(frozen=True)
class _Scale:
    """full_scale: m/s² that 1 stands for. told: whether the file says so. seed: as told, else of the options."""

    full_scale: float
    told: bool
    seed: int


def read_hjif(path: Path, options: ImportOptions) -> Signal:
    """The file's one channel in m/s², at the rate that it states, else that of options.

    A texture is played at the speed that the file's timescale stands for. Raises FileError where the file breaks the
    format, has several channels, or bands of another type.
    """
    tree, reading = read_json(path), Reading(path)
    perceptions = [
        (each, reading.rows(_table(reading, each), "channels")) for each in reading.rows(tree, "perceptions")
    ]
    filled = [(perception, channel) for perception, channels in perceptions for channel in channels]
    if len(filled) != 1:
        raise reading.wrong(f"has {len(filled)} channels, and a vibration has one")
    perception, channel = filled[0][0], _table(reading, filled[0][1])
    timescale = _whole(reading, tree, "timescale", 1, 10**6, DEFAULT_TIMESCALE)
    rate = _whole(reading, channel, "frequency_sampling", 1, 10**6, int(options.rate_hz))
    library = {_whole(reading, each, "id", -1, MOST_TICKS): each for each in reading.rows(perception, "effect_library")}
    parts = list(_parts(reading, channel, library, timescale))
    last = int(max((part.end for _, part in parts), default=-1.0) * rate // timescale)
    count = _whole(reading, channel, "sample_count", 0, MOST_TICKS, max(last + 1, 0))
    if count > MOST_SAMPLES:
        raise reading.wrong(f"lasts {count / rate:.0f} s, more than can be held")
    ticks = Ticks(count, rate, timescale)
    shares = np.zeros(count)
    for band, part in parts:
        first, values = BANDS[band](part, ticks)
        shares[first : first + len(values)] += values
    exponent = _whole(reading, perception, "perception_unit_exponent", -128, 127, 0)
    gain = reading.number(channel, "gain", -LARGEST_GAIN, LARGEST_GAIN) * 10.0**exponent
    scale = _scale(tree.get("description"), options)
    with np.errstate(over="ignore"):
        samples = np.asarray(shares * (gain * scale.full_scale), dtype=np.float32)
    if not np.isfinite(samples).all():
        raise reading.wrong("some samples are beyond all measure")
    return Signal(samples, float(rate), scale.seed, _facts(path, perception, scale))


def _parts(
    reading: Reading, channel: dict[str, Any], library: dict[int, dict[str, Any]], timescale: int
) -> Iterator[tuple[str, EffectKeys]]:
    """(band type, effect) of everything in a channel."""
    for row in reading.rows(channel, "bands"):
        band = _table(reading, row)
        kind = band.get("band_type")
        if not isinstance(kind, str) or kind not in BANDS:
            error = reading.wrong(f"holds a band of type '{kind}', and only {', '.join(BANDS)} can be read")
            error.remedy = _REFERENCE
            raise error
        curve = band.get("curve_type", "Cubic")
        if kind == "Curve" and curve not in ("Cubic", "Linear"):
            raise reading.wrong(f"holds a curve of type '{curve}', and only Cubic and Linear can be read")
        low = reading.number(band, "lower_frequency_limit", 0.0, 1e6)
        high = reading.number(band, "upper_frequency_limit", 0.0, 1e6)
        effects = sorted(
            (_effect(reading, _table(reading, each), library) for each in reading.rows(band, "effects")),
            key=lambda effect: effect.start,
        )
        for number, effect in enumerate(effects):
            joined = number + 1 < len(effects) and effects[number + 1].start == effect.end
            tail = TRANSIENT_S * timescale if kind == "Transient" else 0.0
            yield kind, replace(effect, low_hz=low, high_hz=high, linear=curve == "Linear", joined=joined, tail=tail)


def _effect(reading: Reading, row: dict[str, Any], library: dict[int, dict[str, Any]]) -> EffectKeys:
    kind, start = row.get("effect_type"), _whole(reading, row, "position", -MOST_TICKS, MOST_TICKS)
    if kind == "Reference":
        row = library.get(_whole(reading, row, "id", -1, MOST_TICKS), {})
        kind = row.get("effect_type")
    if kind != "Basis":
        raise reading.wrong(f"holds an effect of type '{kind}', and only Basis and Reference can be read")
    keyframes = [_table(reading, each) for each in reading.rows(row, "keyframes")]
    place = np.array([_whole(reading, each, "relative_position", 0, MOST_TICKS, 0) for each in keyframes], dtype=float)
    if np.any(np.diff(place) < 0.0):
        raise reading.wrong("the places of its keyframes fall")
    signal = row.get("base_signal")
    return EffectKeys(
        start=start,
        place=place,
        amplitude=_values(reading, keyframes, "amplitude_modulation", 1e6),
        frequency=_values(reading, keyframes, "frequency_modulation", 1e6),
        phase=reading.number(row, "phase", -1e6, 1e6),
        shape=signal if isinstance(signal, str) else "Sine",
    )


def _values(reading: Reading, keyframes: list[dict[str, Any]], name: str, largest: float) -> Float:
    """NaN where a keyframe has none."""
    return np.array([reading.number(each, name, -largest, largest) if name in each else np.nan for each in keyframes])


def _table(reading: Reading, value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise reading.wrong("a part of it is no object")
    return value


def _whole(reading: Reading, owner: Any, name: str, low: int, high: int, default: int | None = None) -> int:
    if default is not None and isinstance(owner, dict) and name not in owner:
        return default
    return round(reading.number(owner, name, low, high))


def _scale(text: object, options: ImportOptions) -> _Scale:
    """What the file's description states, else what options say. Text of others states nothing."""
    try:
        record = json.loads(text) if isinstance(text, str) else {}
        scale, seed = float(record["full_scale"]), int(record["seed"])
        if record["units"] == UNITS and SMALLEST_SCALE <= scale <= LARGEST_SCALE:
            return _Scale(scale, True, seed)
    except (ValueError, KeyError, TypeError, RecursionError, OverflowError):
        pass
    return _Scale(options.full_scale_m_s2 or FULL_SCALE_M_S2, False, options.seed)


def _facts(path: Path, perception: dict[str, Any], scale: _Scale) -> dict[str, str]:
    """Provenance: as it was told, and where not, what was assumed."""
    if not scale.told:
        said = f"1 = {scale.full_scale:g} m/s² (the file states none)"
        return {"source": path.name, "scale": said, "modality": str(perception.get("perception_modality"))}
    try:
        told = json.loads(str(perception.get("description")))
        return {str(name): str(value) for name, value in told.items()}
    except (ValueError, AttributeError, RecursionError):
        return {"source": path.name}
