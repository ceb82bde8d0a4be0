"""A program of its own that plays: `play` on its standard input starts a stream, whose end it tells as a JSON line."""

from __future__ import annotations

import json
import sys

import numpy as np

from ..actuators.sinks.serial import SerialSink
from ..actuators.sources.recorded import BufferSource
from ..actuators.stream import Stream
from ..errors import HnfError
from .faults_rig import LIMITER, LIMITS, RATE_HZ, make_noise


def main(port: str) -> None:
    """Until standard input ends."""
    samples = make_noise(np.random.default_rng(0), 1)
    for _ in sys.stdin:
        sink = SerialSink(port, rate_hz=RATE_HZ, peak=LIMITER.peak, slew_per_s=LIMITS.slew_per_s)
        try:
            with Stream(BufferSource(samples, RATE_HZ, loop=True), sink, LIMITS) as stream:
                stream.start()
                print(json.dumps({"playing": True}), flush=True)
                stream.wait()
                print(json.dumps({"problem": stream.report.problem}), flush=True)
        except HnfError as error:
            print(json.dumps({"problem": str(error)}), flush=True)


if __name__ == "__main__":
    main(sys.argv[1])
