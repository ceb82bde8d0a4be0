"""Every way to a device keeps the one contract that a stream relies on."""

from __future__ import annotations

import socket
from collections.abc import Callable
from pathlib import Path

import pytest
from ptys import why_not
from stream_sink import ClockSink, check_sink

from hnf_core.actuators.sink import Sink
from hnf_core.actuators.sinks.file import FileSink
from hnf_core.actuators.sinks.osc import OscSink
from hnf_core.actuators.virtual_port import VirtualSink


def osc(folder: Path) -> Sink:
    pytest.importorskip("pythonosc", reason="python-osc is not installed")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        return OscSink("127.0.0.1", int(free.getsockname()[1]))


def virtual(folder: Path) -> Sink:
    pytest.importorskip("serial", reason="pyserial is not installed")
    if why_not():
        pytest.skip(why_not())
    return VirtualSink(8000, 2)


@pytest.mark.parametrize(
    "make",
    [lambda folder: ClockSink(), lambda folder: FileSink(folder / "x.wav", 8000.0, 2), osc, virtual],
    ids=["clock", "file", "osc", "virtual"],
)
def test_a_sink_keeps_the_contract(make: Callable[[Path], Sink], tmp_path: Path) -> None:
    sink = make(tmp_path)
    try:
        check_sink(sink)
    finally:
        sink.close()
