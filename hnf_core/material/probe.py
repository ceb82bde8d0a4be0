"""Probes: the contacting tips, pen and finger, with their mass, radius and stiffness."""

from __future__ import annotations

from typing import NamedTuple


class Probe(NamedTuple):
    """A contacting tip.

    Attributes
    ----------
    name : str
        "pen" or "finger".
    mass_kg : float
        Moving mass at the tip [kg].
    tip_radius_m : float
        Radius of curvature [m].
    stiffness_n_m : float
        Stiffness of the probe, in series with the surface's [N/m].
    soft_tip : bool
        True if the probe's compliance is at the contact and widens it (a fingertip's pad); else it is in the shaft.
    """

    name: str
    mass_kg: float
    tip_radius_m: float
    stiffness_n_m: float
    soft_tip: bool = False


PROBES = {
    "pen": Probe("pen", mass_kg=0.035, tip_radius_m=0.5e-3, stiffness_n_m=4.0e5),
    "finger": Probe("finger", mass_kg=0.006, tip_radius_m=8.0e-3, stiffness_n_m=1.2e3, soft_tip=True),
}
"""Probes by name."""
