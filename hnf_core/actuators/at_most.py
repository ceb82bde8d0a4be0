"""How strong a stream may become, in words."""

from __future__ import annotations

from .profile import ActuatorProfile
from .sink import SinkFormat


def describe_peak_limit(profile: ActuatorProfile, device: SinkFormat) -> str:
    """The largest acceleration that leaves for device with profile, in m/s², and whose limit that is."""
    limits = profile.limits
    within = limits.with_device_peak(device.peak)
    strongest = f"at most {within.peak * within.full_scale_m_s2:.4g} m/s²"
    assumed = "an assumption"
    if within.peak < limits.peak:
        strongest, assumed = f"{strongest}, the device's own limit", "its full scale an assumption"
    if profile.peak_m_s2 is None:
        return f"{strongest}, {assumed}: '{profile.title}' does not state its largest acceleration"
    if profile.assumes_full_scale:
        return f"{strongest}, {assumed} ({profile.title})"
    return f"{strongest} ({profile.title})"
