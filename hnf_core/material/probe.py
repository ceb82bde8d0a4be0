"""Probes: the contacting tips, read from small data files (TOML), so that anybody can describe her own pen.

Built in are the recorded stylus ("pen"), a fingertip ("finger"), and the stylus without modes of its body
("rigid-tip"); a path to a file of the same form is a probe, too. Every constant is named by its unit.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from ..errors import UsageError

PROBE_NAMES = ("pen", "finger", "rigid-tip")
"""Names of the built-in probes."""
PROBE_SUFFIX = ".toml"
"""Suffix of probe files; a probe that ends in it is read from the file."""
_FOLDER = Path(__file__).resolve().parents[1] / "data" / "probes"


class BodyMode(NamedTuple):
    """Resonance of the probe's body, between its tip and where its acceleration is measured.

    Attributes
    ----------
    frequency_hz : float
        Undamped frequency [Hz].
    damping_ratio : float
        Damping ratio.
    gain : float
        Modal gain g in 1 + g r² / (1 − r² + 2iζr), r = f / frequency_hz.
    """

    frequency_hz: float
    damping_ratio: float
    gain: float


class Pad(NamedTuple):
    """Pad of a fingertip: ridges, each a junction with the surface, on a damped skin.

    Attributes
    ----------
    skin_mass_kg, skin_stiffness_n_m, skin_damping_n_s_m : float
        Skin that moves sideways [kg], [N/m], [N s/m].
    contact_area_m2 : float
        Gross contact area at 1 N; it grows as F^0.5 [m²].
    ridge_spacing_m : float
        Spacing of the fingerprint's ridges, one junction per square of it [m].
    ridge_jitter : float
        Standard deviation of that spacing, relative.
    ridge_coherence : float
        Likeness of what successive ridges meet at one place, 0 to 1.
    junction_radius_m : float
        Radius of a junction [m].
    ridge_modulus_pa : float
        Contact modulus of a ridge [Pa].
    """

    skin_mass_kg: float
    skin_stiffness_n_m: float
    skin_damping_n_s_m: float
    contact_area_m2: float
    ridge_spacing_m: float
    ridge_jitter: float
    ridge_coherence: float
    junction_radius_m: float
    ridge_modulus_pa: float


class Probe(NamedTuple):
    """A contacting tip.

    Attributes
    ----------
    name : str
        "pen", "finger", or the name in a probe file.
    mass_kg : float
        Moving mass at the tip [kg].
    tip_radius_m : float
        Radius of curvature [m].
    stiffness_n_m : float
        Stiffness of the probe, in series with the surface's [N/m].
    soft_tip : bool
        True if the probe's compliance is at the contact and widens it (a fingertip's pad); else it is in the shaft.
    hand_stiffness_n_m : float
        Lateral stiffness of the hand that holds the probe [N/m].
    hand_damping_ratio : float
        Lateral damping ratio of the probe's mass in that hand.
    pad : Pad or None
        Pad of a fingertip; a stiff tip has none.
    body_modes : tuple of BodyMode
        Resonances of the probe's body.
    """

    name: str
    mass_kg: float
    tip_radius_m: float
    stiffness_n_m: float
    soft_tip: bool = False
    hand_stiffness_n_m: float = 200.0
    hand_damping_ratio: float = 2.8
    pad: Pad | None = None
    body_modes: tuple[BodyMode, ...] = ()

    @property
    def kind(self) -> str:
        """Built-in probe that it resembles: "finger" with a soft tip, else "pen"."""
        return "finger" if self.soft_tip else "pen"


_LIMITS = {
    "mass_kg": (1e-5, 10.0),
    "tip_radius_m": (1e-6, 0.1),
    "stiffness_n_m": (1.0, 1e9),
    "hand.stiffness_n_m": (0.0, 1e6),
    "hand.damping_ratio": (0.0, 100.0),
    "pad.skin_mass_kg": (1e-6, 1.0),
    "pad.skin_stiffness_n_m": (1.0, 1e6),
    "pad.skin_damping_n_s_m": (1e-3, 1e3),
    "pad.contact_area_m2": (1e-8, 1e-1),
    "pad.ridge_spacing_m": (1e-5, 1e-1),
    "pad.ridge_jitter": (0.0, 1.0),
    "pad.ridge_coherence": (0.0, 0.99),
    "pad.junction_radius_m": (1e-6, 1e-2),
    "pad.ridge_modulus_pa": (1e2, 1e11),
    "body_modes.frequency_hz": (10.0, 1e5),
    "body_modes.damping_ratio": (1e-3, 10.0),
    "body_modes.gain": (-10.0, 10.0),
}
"""Accepted range of every number of a probe file, in SI units."""


@lru_cache(maxsize=32)
def get_probe(name: str) -> Probe:
    """Return a probe by its name or file.

    Parameters
    ----------
    name : str
        One of `PROBE_NAMES`, or the path of a file of the same form that ends in ".toml".

    Returns
    -------
    Probe
        The probe, read once.

    Raises
    ------
    UsageError
        If there is no such probe or file, or the file holds impossible constants.
    """
    if name not in PROBE_NAMES and not name.endswith(PROBE_SUFFIX):
        raise UsageError(
            f"there is no probe {name!r}.",
            remedy=f"Take {', '.join(PROBE_NAMES)}, or a file that ends in {PROBE_SUFFIX}.",
        )
    path = _FOLDER / f"{name}{PROBE_SUFFIX}" if name in PROBE_NAMES else Path(name)
    try:
        record = tomllib.loads(path.read_text(encoding="utf-8"))
        return _parse_probe(record)
    except OSError as error:
        raise UsageError(
            f"the probe file cannot be read ({error.strerror}).", where=str(path), remedy="Check the path."
        ) from error
    except (ValueError, TypeError, KeyError) as error:
        problem = f"{error} is missing" if isinstance(error, KeyError) else str(error)
        raise UsageError(
            f"this is no probe: {problem}.", where=str(path), remedy=f"See {_FOLDER / 'pen.toml'} for the form."
        ) from error


def is_probe(name: str) -> bool:
    """Return whether `get_probe` finds a probe of this name or file."""
    try:
        get_probe(name)
    except UsageError:
        return False
    return True


def _parse_probe(record: Mapping[str, Any]) -> Probe:
    """Build a probe from the record of its file; raise ValueError, TypeError or KeyError if that is not valid."""
    _check_table(record, {"name", "mass_kg", "tip_radius_m", "stiffness_n_m", "soft_tip", "pad", "hand", "body_modes"})
    hand, modes, soft_tip = record.get("hand", {}), record.get("body_modes", []), record.get("soft_tip", False)
    _check_table(hand, {"stiffness_n_m", "damping_ratio"}, "hand.")
    if not isinstance(modes, list):
        raise TypeError("body_modes must be tables in [[body_modes]]")
    for mode in modes:
        _check_table(mode, BodyMode._fields, "body_modes.")
    if "pad" in record:
        _check_table(record["pad"], Pad._fields, "pad.")
    if not isinstance(soft_tip, bool):
        raise TypeError(f"soft_tip must be true or false, not {soft_tip!r}")
    return Probe(
        str(record["name"]),
        _read_number(record, "mass_kg"),
        _read_number(record, "tip_radius_m"),
        _read_number(record, "stiffness_n_m"),
        soft_tip,
        _read_number(hand, "stiffness_n_m", "hand."),
        _read_number(hand, "damping_ratio", "hand."),
        Pad(*(_read_number(record["pad"], name, "pad.") for name in Pad._fields)) if "pad" in record else None,
        tuple(BodyMode(*(_read_number(mode, name, "body_modes.") for name in BodyMode._fields)) for mode in modes),
    )


def _check_table(table: object, entries: Iterable[str], prefix: str = "") -> None:
    """Raise TypeError if this is no table of a probe file, ValueError if it holds an entry that is not known."""
    if not isinstance(table, dict):
        raise TypeError(f"{prefix[:-1]} must be a table")
    unknown = sorted(set(table) - set(entries))
    if unknown:
        raise ValueError(f"unknown entry {prefix + unknown[0]!r}")


def _read_number(record: Mapping[str, Any], name: str, table: str = "") -> float:
    """Return a number of a record; raise KeyError if it is missing, ValueError if it is outside _LIMITS."""
    if name not in record:
        raise KeyError(table + name)
    value = record[name]
    low, high = _LIMITS[table + name]
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise ValueError(f"{table}{name} must be a number from {low:g} to {high:g}, not {value!r}")
    return float(value)
