"""What a player plays now, and how it is doing."""

from __future__ import annotations

from dataclasses import dataclass

from .player_messages import OutputSpec, Status
from .sink import SinkFormat
from .sources.live import LiveSource
from .sources.recorded import BufferSource
from .stream import Stream


@dataclass(frozen=True, eq=False)
class Playback:
    """gain: that was multiplied into the source's samples beforehand. ahead_s: made ahead of the sink."""

    play: int
    stream: Stream
    source: BufferSource | LiveSource
    device: SinkFormat
    where: OutputSpec
    gain: float
    ahead_s: float
    note: str

    @property
    def has_ended(self) -> bool:
        return self.stream.wait(0.0)

    def status(self) -> Status:
        report = self.stream.report
        made, latency_ms = 0.0, report.latency_p99_ms
        if isinstance(self.source, LiveSource):
            latency_ms += self.source.latency_p99_ms
        else:
            owed_s = min(max(report.frames / self.device.rate_hz - report.played_s, 0.0), self._queue_s)
            made = self.source.position_s - (owed_s + self.ahead_s if report.state == "playing" else 0.0)
        return Status(
            self.play,
            "paused" if report.state == "paused" else "ended" if report.state == "ended" else "playing",
            max(made, 0.0),
            report.level_m_s2,
            report.peak,
            report.underruns,
            report.limited_samples + report.device_limited_samples,
            report.nonfinite_samples,
            report.played_s,
            latency_ms,
            report.temperature_c,
            " ".join(report.problem.split()),
        )

    @property
    def _queue_s(self) -> float:
        return self.device.queue_frames / self.device.rate_hz
