"""The virtual actuator as a sink of its own: a device, its port and the host's side of the wire in one."""

from __future__ import annotations

import math
import time

from ..limits import FULL_SCALE_COUNTS
from ..protocol.messages import State
from ..sink import SinkFormat
from ..sinks.serial import SerialSink
from .device import Capabilities
from .port import VirtualPort
from .recording import Recording
from .transducer import GENERIC_TRANSDUCER, Transducer

REST_TIMEOUT_S = 0.1


class VirtualSink(SerialSink):
    """See Sink. Every byte goes through a pty, as to a real device. A device lives from open() to close(); recording,
    what the last one played, stays."""

    def __init__(
        self,
        rate_hz: int | None = None,
        channels: int = 1,
        *,
        capabilities: Capabilities | None = None,
        transducer: Transducer = GENERIC_TRANSDUCER,
        peak: int = FULL_SCALE_COUNTS,
        slew_per_s: float = math.inf,
    ) -> None:
        """As SerialSink; abilities and transducer: of the device."""
        super().__init__("virtual", rate_hz=rate_hz, channels=channels, peak=peak, slew_per_s=slew_per_s)
        self._capabilities, self._transducer = capabilities, transducer
        self._device: VirtualPort | None = None
        self.recording = Recording(transducer)

    def open(self) -> SinkFormat:
        """See Sink. Raises DeviceError also where the system has no ptys."""
        self.close()
        self._device = VirtualPort(self._capabilities, self._transducer)
        self._port, self.recording = self._device.path, self._device.recording
        return self._connect()

    def close(self) -> None:
        """See Sink. The recording ends when all is silent."""
        super().close()
        port, self._device = self._device, None
        if port is None:
            return
        give_up = time.monotonic() + REST_TIMEOUT_S
        while port.device.state is not State.IDLE and time.monotonic() < give_up:
            time.sleep(0.001)
        port.close()
