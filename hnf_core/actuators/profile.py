"""Actuator profiles: what a vibrotactile transducer can do, as far as its maker or its owner states it.

A profile's file is JSON: `{"schema": 1, "name": …, "title": …, "source": …, "range_hz": [low, high], "peak_m_s2": …,
"sustained": …, "thermal_s": …, "response": …}`. A figure that is null or absent is unknown. `response` holds what `hnf
actuators measure` writes: `{"frequency_hz": […], "gain_db": […], "phase_rad": […], "coherence": […], "delay_s": …}`.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import FileError, UsageError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .limits import Limits
    from .measure.frequency_response import FrequencyResponse


@dataclass(frozen=True)
class ActuatorProfile:
    """Figures of one transducer; None means that the source does not state it.

    Attributes
    ----------
    name : str
        Identifier in files and settings.
    title : str
        Name shown to people.
    source : str
        Where the figures come from.
    range_hz : tuple of float or None
        Frequency band that it is made for [Hz].
    peak_m_s2 : float or None
        Largest acceleration within that band [m/s²].
    sustained : float or None
        RMS level that the coil can carry indefinitely, as a fraction of full scale.
    thermal_s : float or None
        Time constant of the coil's warming [s].
    response : FrequencyResponse or None
        Measured ratio of output to requested acceleration.
    """

    name: str
    title: str
    source: str
    range_hz: tuple[float, float] | None = None
    peak_m_s2: float | None = None
    sustained: float | None = None
    thermal_s: float | None = None
    response: FrequencyResponse | None = None

    @property
    def assumes_full_scale(self) -> bool:
        """True if full scale is the generic voice coil's, for lack of a stated or measured figure."""
        return self.peak_m_s2 is None or self.name == GENERIC.name

    @property
    def limits(self) -> Limits:
        """Limits that the limiter enforces for this transducer.

        Defaults for unknown figures: full scale of the generic voice coil, half of it sustained, 10 s to warm. The slew
        is that of a full-scale sine at the top of the band.
        """
        # Imported here because the add-on's panels list the profiles and never need the limiter.
        from .limits import Limits

        full_scale = self.peak_m_s2 or GENERIC_PEAK_M_S2
        highest = self.range_hz[1] if self.range_hz is not None else 1000.0
        return Limits(
            full_scale,
            slew_per_s=2.0 * math.pi * highest,
            sustained=self.sustained or 0.5,
            thermal_s=self.thermal_s or 10.0,
        )


GENERIC_PEAK_M_S2 = 30.0
"""Assumed full scale of an unknown voice coil [m/s²]."""

GENERIC = ActuatorProfile(
    "generic-voice-coil",
    "Generic Voice Coil",
    "an assumption, no device: 30 m/s² from 20 Hz to 1 kHz, about what small voice coils reach on a fingertip's load",
    range_hz=(20.0, 1000.0),
    peak_m_s2=GENERIC_PEAK_M_S2,
)

PROFILES: dict[str, ActuatorProfile] = {
    profile.name: profile
    for profile in (
        GENERIC,
        ActuatorProfile(
            "eai-c-mf",
            "EAI C-MF Tactor",
            "Engineering Acoustics, C-MF product data sheet Rev. 2, 2021: 180–280 Hz; 0.25 A RMS, "
            "0.5 A at most, for less than a tenth of the time",
            range_hz=(180.0, 280.0),
            # Full scale is the peak of a sine of 0.5 A RMS; 0.25 A for a tenth of the time is 0.079 A RMS sustained.
            sustained=0.11,
        ),
    )
}
"""Devices whose maker's own document was read, by name; `make_user_profile` describes any other device."""

USER_PROFILE_NAME = "own"


def make_user_profile(peak_m_s2: float, lowest_hz: float, highest_hz: float) -> ActuatorProfile:
    """Make a profile from figures that the device's owner gives.

    Parameters
    ----------
    peak_m_s2 : float
        Largest acceleration [m/s²]; 0 if unknown.
    lowest_hz, highest_hz : float
        Ends of the frequency band [Hz], in either order.

    Raises
    ------
    UsageError
        If a figure is negative or a frequency is not above 0.
    """
    if not (peak_m_s2 >= 0.0 and lowest_hz > 0.0 and highest_hz > 0.0):
        raise UsageError(
            f"an actuator of {peak_m_s2:g} m/s² from {lowest_hz:g} to {highest_hz:g} Hz does not exist.",
            remedy="Give an acceleration of 0 (not known) or more and frequencies above 0.",
        )
    return ActuatorProfile(
        USER_PROFILE_NAME,
        "My Actuator",
        "figures of its owner",
        range_hz=(min(lowest_hz, highest_hz), max(lowest_hz, highest_hz)),
        peak_m_s2=peak_m_s2 or None,
    )


def get_profile(name: str) -> ActuatorProfile:
    """Return the built-in profile of that name; raise UsageError with the known names otherwise."""
    if name not in PROFILES:
        raise UsageError(f"there is no actuator '{name}'.", remedy=f"Known: {', '.join(PROFILES)}.")
    return PROFILES[name]


SCHEMA = 1
"""Version of the file's layout."""

MAX_BYTES = 4_000_000
"""Largest file that is read [bytes]."""

DECIMALS = 5
"""Decimal places of a written frequency response."""

_COLUMNS = ("frequency_hz", "gain_db", "phase_rad", "coherence")


def load_profile(name_or_path: str) -> ActuatorProfile:
    """Return a built-in profile by name, or read one from a file.

    Parameters
    ----------
    name_or_path : str
        A key of `PROFILES`, or a path that ends in ".json".

    Raises
    ------
    UsageError
        If there is no built-in profile of that name.
    FileError
        If the file cannot be read or holds no valid profile.
    """
    return read_profile(Path(name_or_path)) if name_or_path.lower().endswith(".json") else get_profile(name_or_path)


def write_profile(path: Path, profile: ActuatorProfile) -> None:
    """Write a profile for `read_profile`, its response rounded to `DECIMALS` places.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    from ..files import write_bytes

    record = {"schema": SCHEMA} | asdict(profile)
    if profile.response is not None:
        columns = {name: np.round(getattr(profile.response, name), DECIMALS).tolist() for name in _COLUMNS}
        record["response"] = columns | {"delay_s": profile.response.delay_s}
    write_bytes(path, (json.dumps(record, indent=1, ensure_ascii=False) + "\n").encode("utf-8"))


def read_profile(path: Path) -> ActuatorProfile:
    """Read a profile from a JSON file.

    Raises
    ------
    FileError
        If the file is missing or too large, or holds no profile of a possible device.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise ValueError(f"it has more than {MAX_BYTES // 1_000_000} MB")
        record = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(record, dict) or record.pop("schema", None) != SCHEMA:
            raise ValueError(f'no object with "schema": {SCHEMA}')
        unknown = set(record) - {field.name for field in fields(ActuatorProfile)}
        if unknown:
            raise ValueError(f"unknown: {', '.join(sorted(unknown))}")
        profile = ActuatorProfile(
            _read_text(record, "name"),
            _read_text(record, "title"),
            _read_text(record, "source"),
            range_hz=_parse_range(record.get("range_hz")),
            peak_m_s2=_read_positive(record, "peak_m_s2"),
            sustained=_read_positive(record, "sustained"),
            thermal_s=_read_positive(record, "thermal_s"),
            response=_parse_response(record.get("response")),
        )
        _ = profile.limits
    except OSError as error:
        raise FileError(
            f"cannot be read ({error.strerror or error}).", where=str(path), remedy="Check the file's path."
        ) from error
    except (ValueError, RecursionError, UsageError) as error:
        raise FileError(
            f"is no actuator's profile ({error}).", where=str(path), remedy="See docs/streaming.md, Profiles."
        ) from error
    return profile


def _read_text(record: dict[str, Any], name: str) -> str:
    value = record.get(name)
    if not isinstance(value, str) or not value.strip():
        raise ValueError(f"{name} is no text")
    return value


def _read_positive(record: dict[str, Any], name: str) -> float | None:
    value = record.get(name)
    return None if value is None else _check_number(value, name, 1e-9, 1e9)


def _check_number(value: Any, name: str, low: float, high: float) -> float:
    if type(value) not in (int, float) or not low <= value <= high:
        raise ValueError(f"{name} is no number from {low:g} to {high:g}")
    return float(value)


def _parse_range(value: Any) -> tuple[float, float] | None:
    if value is None:
        return None
    if not isinstance(value, list) or len(value) != 2:
        raise ValueError("range_hz is no [low, high]")
    low, high = (_check_number(edge, "range_hz", 1e-9, 1e9) for edge in value)
    if low >= high:
        raise ValueError("range_hz is no [low, high]")
    return low, high


def _parse_response(value: Any) -> FrequencyResponse | None:
    if value is None:
        return None
    if not isinstance(value, dict) or set(value) != {*_COLUMNS, "delay_s"}:
        raise ValueError(f"a response has {', '.join(_COLUMNS)} and delay_s")
    # Imported here because the add-on's panels list the profiles and never need a response.
    from .measure.frequency_response import FrequencyResponse

    frequency, gain, phase, coherence = (_parse_column(value[name], name) for name in _COLUMNS)
    return FrequencyResponse(frequency, gain, phase, coherence, _check_number(value["delay_s"], "delay_s", -1e3, 1e3))


def _parse_column(values: Any, name: str) -> NDArray[np.float64]:
    if not isinstance(values, list):
        raise ValueError(f"{name} is no list of numbers")
    return np.array([_check_number(value, name, -1e9, 1e9) for value in values], dtype=np.float64)
