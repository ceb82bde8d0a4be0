"""The probes that touch a surface."""

from __future__ import annotations

from typing import NamedTuple


class Probe(NamedTuple):
    """What touches the surface. mass_kg: moving mass at the tip. tip_radius_m: radius of curvature.
    stiffness_n_m: the probe's own compliance, in series with the surface's. soft_tip: that compliance sits at the
    contact and widens it (a fingertip's pad); otherwise in the shaft, and only the surface gives way."""

    name: str
    mass_kg: float
    tip_radius_m: float
    stiffness_n_m: float
    soft_tip: bool = False


PROBES = {
    "pen": Probe("pen", mass_kg=0.035, tip_radius_m=0.5e-3, stiffness_n_m=4.0e5),
    "finger": Probe("finger", mass_kg=0.006, tip_radius_m=8.0e-3, stiffness_n_m=1.2e3, soft_tip=True),
}
