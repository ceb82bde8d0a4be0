"""Reference for the virtual serial device: checksum bit by bit, playout tick by tick, transducer sample by sample.

hnf_core.actuators.serial_protocol, virtual.serial_device and virtual.transducer must equal it.
"""

from __future__ import annotations

import numpy as np

from hnf_core.actuators.serial_protocol import CRC_POLYNOMIAL, CRC_START
from hnf_core.actuators.sink import Counts
from hnf_core.actuators.virtual_serial_device import Playout, PlayoutPhase
from hnf_core.actuators.virtual_transducer import (
    Floats,
    Motion,
    StateSpace,
    Transducer,
    TransducerState,
    make_mechanical_system,
    make_motion,
    make_rest_state,
    make_thermal_system,
    simulate_with_stops,
)


def crc16_reference(data: bytes) -> int:
    """Return the CRC-16 of data, bit by bit, as firmware without a table computes it."""
    crc = CRC_START
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1) ^ CRC_POLYNOMIAL if crc & 0x8000 else crc << 1
            crc &= 0xFFFF
    return crc


class ReferencePlayout(Playout):
    """Playout that advances tick by tick."""

    def advance(self, frames: int) -> Counts:
        """Return the next frames that are output, (frames, channels)."""
        out: Counts = np.zeros((frames, self.form.channels), dtype=np.int16)
        for frame in range(frames):
            self._update_phase()
            if self.phase is PlayoutPhase.SOUNDING:
                self._play(out[frame : frame + 1])
            elif self.phase is PlayoutPhase.FADING:
                self._fade(out[frame : frame + 1])
        return out


def simulate_reference(system: StateSpace, start: Floats, inputs: Floats) -> Floats:
    """Simulate a linear system one sample at a time, as the reference for StateSpace.simulate."""
    states = [start]
    for value in inputs:
        states.append(system.transition @ states[-1] + np.outer(system.input_vector, value))
    return np.asarray(states)


def simulate_motion_reference(
    transducer: Transducer, drive: Floats, rate_hz: float, start: TransducerState | None = None
) -> Motion:
    """Simulate a transducer one sample at a time with end stops always checked; reference for simulate_motion."""
    start = make_rest_state(transducer, drive.shape[1]) if start is None else start
    force = transducer.compute_force(drive)
    first = np.stack([start.position, start.velocity])
    states = simulate_with_stops(make_mechanical_system(transducer, rate_hz), first, force, transducer.stroke_m)
    start_excess = (start.temperature - transducer.ambient_c)[None]
    thermal = make_thermal_system(transducer, rate_hz)
    temperature_excess = simulate_reference(thermal, start_excess, transducer.compute_power(drive))[:, 0]
    return make_motion(transducer, states, force, temperature_excess + transducer.ambient_c)
