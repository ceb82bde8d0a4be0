"""Slow loading of materials or opening of devices delays neither a stop nor the hand."""

from __future__ import annotations

import io
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from stream_sink import ClockSink

from hnf_core.actuators import player as player_module
from hnf_core.actuators.live_source import LiveSource
from hnf_core.actuators.player import main
from hnf_core.actuators.player_messages import (
    Began,
    Command,
    LiveBegin,
    Move,
    OutputSpec,
    Play,
    Quit,
    Refused,
    Report,
    Status,
    Stop,
    decode_report,
    encode,
)
from hnf_core.actuators.sink import SinkFormat
from hnf_core.actuators.sources import Acceleration

WHERE = OutputSpec("virtual", "generic-voice-coil")


def comes(condition: Callable[[], bool]) -> bool:
    until = time.monotonic() + 60.0
    while not condition() and time.monotonic() < until:
        time.sleep(0.002)
    return condition()


class Slow(ClockSink):
    """Its open() waits for leave, and it takes its time to close."""

    def __init__(self, leave: threading.Event) -> None:
        super().__init__()
        self.leave, self.opening = leave, threading.Event()

    def open(self) -> SinkFormat:
        self.opening.set()
        assert self.leave.wait(60.0)
        return super().open()

    def close(self) -> None:
        time.sleep(0.1)
        super().close()


class Rig:
    """main() in this process, with clocks for devices. sinks: of the plays, in order."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, sinks: list[ClockSink]) -> None:
        self.sinks, left = sinks, list(sinks)
        self.loading, self.loaded = threading.Event(), threading.Event()
        self.loaded.set()
        load = player_module.create_live_synthesis

        def slowly(*words: Any, **more: Any) -> Any:
            self.loading.set()
            assert self.loaded.wait(60.0)
            return load(*words, **more)

        tone = Acceleration(np.full((200_000, 1), 5.0, np.float32), 10_000.0, "in m/s²")
        monkeypatch.setattr(player_module, "create_live_synthesis", slowly)
        monkeypatch.setattr(player_module, "read_acceleration", lambda *words: tone)
        monkeypatch.setattr(player_module, "make_sink", lambda *words: left.pop(0))
        reader, self._writer = os.pipe()
        self._out = io.BytesIO()
        self._stdin = os.fdopen(reader, "rb")
        self._thread = threading.Thread(target=main, args=((), self._stdin, self._out))
        self._thread.start()

    def say(self, *commands: Command) -> None:
        os.write(self._writer, "".join(encode(each) + "\n" for each in commands).encode())

    @property
    def reports(self) -> list[Report]:
        lines = self._out.getvalue().decode().split("\n")[:-1]
        return [decode_report(line) for line in lines]

    def began(self) -> list[int]:
        return [each.play for each in self.reports if isinstance(each, Began)]

    def over(self, play: int) -> bool:
        """Has it been told that this one has ended, and of no problem?"""
        told = [each for each in self.reports if isinstance(each, Status) and each.play == play]
        return bool(told) and told[-1].state == "ended" and told[-1].problem == ""

    def ends(self) -> bool:
        """Its standard input ends; does it?"""
        os.close(self._writer)
        self._writer = -1
        self._thread.join(60.0)
        return not self._thread.is_alive()

    def close(self) -> None:
        self.loaded.set()
        for sink in self.sinks:
            if isinstance(sink, Slow):
                sink.leave.set()
        if self._writer >= 0:
            assert self.ends()
        self._stdin.close()


@contextmanager
def rig(monkeypatch: pytest.MonkeyPatch, *sinks: ClockSink) -> Iterator[Rig]:
    made = Rig(monkeypatch, list(sinks))
    try:
        yield made
    finally:
        made.close()


def test_a_stop_does_not_wait_for_the_material_before_it(monkeypatch: pytest.MonkeyPatch) -> None:
    sink, after = ClockSink(), ClockSink()
    with rig(monkeypatch, sink, after) as it:
        it.say(Play(1, "x.wav", WHERE))
        assert comes(lambda: len(sink.counts) > 100)
        it.loaded.clear()
        it.say(LiveBegin(2, "oak-wood", WHERE), Stop())
        assert comes(lambda: "close" in sink.calls), "silent while it still loads"
        assert it.loading.wait(60.0)
        assert not it.loaded.is_set()
        it.loaded.set()
        assert comes(lambda: it.over(2)), "what was stopped before it began has ended"
        assert it.began() == [1]
        assert after.calls == [], "its device was not even asked for"
        it.say(Play(3, "x.wav", WHERE))
        assert comes(lambda: it.began() == [1, 3]), "what is said after the stop begins"


def test_a_stop_cancels_what_is_just_being_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    leave = threading.Event()
    sink = Slow(leave)
    with rig(monkeypatch, sink) as it:
        it.say(Play(1, "x.wav", WHERE))
        assert sink.opening.wait(60.0)
        it.say(Stop())
        time.sleep(0.05)  # that it is heard first; either way the same must come of it
        leave.set()
        assert comes(lambda: it.over(1))
        assert it.began() == []
        assert len(sink.counts) == 0
        assert sink.calls[-1] == "close", "it is given back before that is told: the next may ask for the same device"
        assert not any(isinstance(each, Refused) for each in it.reports)


def test_a_hand_is_felt_while_another_material_loads(monkeypatch: pytest.MonkeyPatch) -> None:
    moved: list[tuple[float, float]] = []
    move = LiveSource.move
    monkeypatch.setattr(LiveSource, "move", lambda self, *words: moved.append(words[1]) or move(self, *words))
    with rig(monkeypatch, ClockSink()) as it:
        it.say(LiveBegin(1, "oak-wood", WHERE))
        assert comes(lambda: it.began() == [1])
        it.loaded.clear()
        it.loading.clear()
        it.say(LiveBegin(2, "glazed-tile", WHERE), Move(0.0, 0.25, 0.0, 1.0))
        assert comes(lambda: moved == [(0.25, 0.0)])
        assert it.loading.wait(60.0)
        it.loaded.set()
        assert comes(lambda: it.began() == [1, 2])
    assert moved == [(0.25, 0.0)]


def test_moves_before_the_device_opens_apply_once_it_is_open(monkeypatch: pytest.MonkeyPatch) -> None:
    """It may rest from then on, and send nothing more. But it does not haunt what begins after a stop, or after a
    recording, however late its last word comes."""
    moved: list[tuple[LiveSource, tuple[float, float]]] = []
    move = LiveSource.move
    monkeypatch.setattr(LiveSource, "move", lambda self, *words: moved.append((self, words[1])) or move(self, *words))
    leave = threading.Event()
    sink = Slow(leave)
    with rig(monkeypatch, sink, ClockSink(), ClockSink(), ClockSink()) as it:
        it.say(LiveBegin(1, "oak-wood", WHERE), Move(0.0, 0.1, 0.0, 1.0), Move(0.01, 0.2, 0.0, 1.0))
        assert sink.opening.wait(60.0)
        leave.set()
        assert comes(lambda: [each for _, each in moved] == [(0.2, 0.0)])
        it.say(Stop(), Move(0.02, 0.3, 0.0, 8.0), LiveBegin(2, "oak-wood", WHERE))
        assert comes(lambda: it.began() == [1, 2])
        it.say(Play(3, "x.wav", WHERE))
        assert comes(lambda: it.began() == [1, 2, 3])
        it.say(Move(0.03, 0.4, 0.0, 8.0), LiveBegin(4, "oak-wood", WHERE))
        assert comes(lambda: it.began() == [1, 2, 3, 4])
    assert {source for source, _ in moved} == {moved[0][0]}


@pytest.mark.parametrize("quits", [True, False])
def test_it_leaves_while_something_loads(quits: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    sink = ClockSink()
    monkeypatch.setattr(player_module, "CLOSE_TIMEOUT_S", 0.05)
    with rig(monkeypatch, sink) as it:
        it.say(Play(1, "x.wav", WHERE))
        assert comes(lambda: len(sink.counts) > 100)
        it.loaded.clear()
        it.say(LiveBegin(2, "oak-wood", WHERE))
        assert it.loading.wait(60.0)
        if quits:
            it.say(Quit())
        assert it.ends()
        assert sink.calls[-1] == "close"
        assert not it.loaded.is_set()
