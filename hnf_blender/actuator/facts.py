"""What a Link was told → what the panel says of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hnf_core.actuators.profile import ActuatorProfile

from ..translations import tr
from .state import ActuatorFacts, Phase

if TYPE_CHECKING:
    from .link import PlayerClient


def make_facts(client: PlayerClient, profile: ActuatorProfile) -> ActuatorFacts:
    """profile: whose limits the level is shown in."""
    phase = get_phase(client)
    heard = client.current_status
    if heard is None or phase is Phase.OFF:
        return ActuatorFacts(phase, problem=client.problem)
    status, limits = heard.status, profile.limits
    most = limits.full_scale_m_s2 * limits.peak
    level = status.level_m_s2 if phase in (Phase.PLAYING, Phase.LIVE) else 0.0
    return ActuatorFacts(phase, level, min(level / most, 1.0), describe_playback(client), client.problem)


def get_phase(client: PlayerClient) -> Phase:
    if not client.is_running:
        return Phase.OFF
    if not client.is_playing:
        return Phase.READY
    if client.current_status is None:
        return Phase.OPENING
    if client.is_live:
        return Phase.LIVE
    return Phase.PAUSED if client.is_paused else Phase.PLAYING


def describe_playback(client: PlayerClient) -> tuple[str, ...]:
    """What was told of the newest play, one thought a line; what is as it should be is not mentioned."""
    heard, began = client.current_status, client.began
    if heard is None:
        return ()
    status, lines = heard.status, []
    if began is not None and began.play == status.play:
        said = tr("{device}: {rate} Hz, delay up to {queue} ms")
        lines.append(said.format(device=began.device, rate=f"{began.rate_hz:g}", queue=f"{began.queue_ms:.0f}"))
    lines.append(tr("Highest so far: {share} of full scale").format(share=f"{status.peak:.0%}"))
    if status.temperature_c is not None:
        lines.append(tr("Coil at {temperature} °C").format(temperature=f"{status.temperature_c:.1f}"))
    if status.limited:
        lines.append(tr("{count} samples limited").format(count=status.limited))
    if status.nonfinite:
        lines.append(tr("{count} invalid samples (NaN) played as 0").format(count=status.nonfinite))
    if status.underruns:
        lines.append(tr("Samples came too late {count} times").format(count=status.underruns))
    if client.is_live and status.latency_p99_ms > 0.0:
        lines.append(tr("From the pen to the device: {latency} ms").format(latency=f"{status.latency_p99_ms:.0f}"))
    return tuple(lines)
