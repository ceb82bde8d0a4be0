"""The process that plays, driven over its pipes; what it plays is heard over OSC or read from files."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
import wave
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from osc_receiver import Receiver, receiver
from player_process import ROOT, player
from ptys import needs_pty
from responses import of_gains

from hnf_core.actuators.limits import FULL_SCALE_COUNTS
from hnf_core.actuators.measure.inverse_filter import make_compensation
from hnf_core.actuators.player_messages import (
    VERSION,
    Began,
    Gain,
    LiveBegin,
    Loop,
    Move,
    OutputSpec,
    Pause,
    Play,
    Quit,
    Ready,
    Refused,
    Resume,
    Seek,
    Status,
    Stop,
    Swap,
    encode,
)
from hnf_core.actuators.profile import GENERIC, make_user_profile, read_profile, write_profile
from hnf_core.actuators.signal_chain import render_counts
from hnf_core.actuators.sink import SinkFormat
from hnf_core.actuators.sources import BufferSource, read_acceleration
from hnf_core.actuators.virtual_port import VirtualPort
from hnf_core.export.wav import write_wav
from hnf_core.signal import Signal

pytest.importorskip("pythonosc", reason="python-osc is not installed")

LOUD = "/hnf/1/amplitude"
FULL = GENERIC.limits.full_scale_m_s2


def wav(path: Path, share: float, seconds: float = 30.0, hz: float = 200.0) -> str:
    """A sine of so much of full scale."""
    time_s = np.arange(round(seconds * 10_000)) / 10_000
    write_wav(path, Signal((share * FULL * np.sin(2 * np.pi * hz * time_s)).astype(np.float32), 10_000.0, 0))
    return str(path)


def where(ear: Receiver) -> OutputSpec:
    return OutputSpec(ear.target, GENERIC.name)


def comes_to(ear: Receiver, share: float) -> bool:
    """Will its latest amplitude be this?"""
    until = time.monotonic() + 60.0  # a bound alone: a busy machine takes seconds to start a process
    while time.monotonic() < until:
        if ear.values(LOUD)[-1:] == [pytest.approx(share, abs=0.02)]:
            return True
        time.sleep(0.01)
    return False


def test_a_file_is_played_as_its_chain_makes_it(tmp_path: Path) -> None:
    out, profile = tmp_path / "out.wav", make_user_profile(12.0, 40.0, 800.0)
    rng = np.random.default_rng(5)
    write_wav(tmp_path / "a.wav", Signal(rng.normal(0, 5, 9000).astype(np.float32), 10_000.0, 0))
    with player() as it:
        it.say(Play(7, str(tmp_path / "a.wav"), OutputSpec(f"file:{out}", "own", (12.0, 40.0, 800.0)), gain_db=6.0))
        began = it.wait_for(lambda each: isinstance(each, Began))
        status = it.status(7, "ended")
        it.say(Quit())
        assert it.process.wait(30) == 0
    assert it.reports[0] == Ready(VERSION)
    assert isinstance(began, Began)
    assert (began.play, began.rate_hz) == (7, 10_000.0)
    assert "m/s²" in began.note
    assert status.problem == ""
    samples = rng_again() * np.float32(10.0 ** (6.0 / 20.0))
    expected = render_counts(BufferSource(samples, 10_000.0), SinkFormat(10_000.0, 1, 1000, ""), profile.limits)
    with wave.open(str(out)) as file:
        assert (np.frombuffer(file.readframes(file.getnframes()), "<i2") == expected[:, 0]).all()
    assert status.limited > 0
    assert status.peak == pytest.approx(np.abs(expected).max() / FULL_SCALE_COUNTS)


def rng_again() -> np.ndarray:
    return np.random.default_rng(5).normal(0, 5, 9000).astype(np.float32)[:, None]


def test_a_measured_response_is_made_up_for(tmp_path: Path) -> None:
    """Only that the profile's inverse filter is in the way; what it does is told by its own tests."""
    frequency = np.geomspace(20.0, 1000.0, 50)
    measured = replace(GENERIC, name="mine", response=of_gains(frequency, 1.0 / (1.0 + 1j * frequency / 100.0)))
    write_profile(tmp_path / "mine.json", measured)
    one, out = wav(tmp_path / "one.wav", 0.1, seconds=0.5, hz=400.0), tmp_path / "out.wav"
    with player() as it:
        it.say(Play(1, one, OutputSpec(f"file:{out}", str(tmp_path / "mine.json"))))
        began = it.wait_for(lambda each: isinstance(each, Began))
        assert it.status(1, "ended").problem == ""
    assert isinstance(began, Began)
    assert "its response corrected" in began.note
    profile = read_profile(tmp_path / "mine.json")
    source = BufferSource(read_acceleration(Path(one), profile.limits).samples, 10_000.0)
    stages = make_compensation(profile, 10_000.0, 1)
    expected = render_counts(source, SinkFormat(10_000.0, 1, 1000, ""), profile.limits, stages)
    with wave.open(str(out)) as file:
        assert (np.frombuffer(file.readframes(file.getnframes()), "<i2") == expected[:, 0]).all()
    assert np.abs(expected).max() > 2.0 * 0.1 * FULL_SCALE_COUNTS


def test_pause_seek_gain_swap_loop_and_stop_are_heard(tmp_path: Path) -> None:
    one, other = wav(tmp_path / "one.wav", 0.5), wav(tmp_path / "other.wav", 0.3)
    with receiver() as ear, player() as it:
        it.say(Play(1, one, where(ear), start_s=2.0))
        assert comes_to(ear, 0.5)
        assert 2.0 <= it.status(1, "playing").position_s < 20.0
        it.say(Pause())
        assert comes_to(ear, 0.0)
        it.status(1, "paused")
        place = it.last.position_s
        it.say(Seek(20.0), Resume())
        assert comes_to(ear, 0.5)
        it.wait_for(lambda each: isinstance(each, Status) and 20.0 <= each.position_s < 30.0)
        assert place < 20.0
        it.say(Gain(-6.0206))
        assert comes_to(ear, 0.25)
        it.say(Swap(other))
        assert comes_to(ear, 0.15)
        it.say(Loop(True), Seek(29.9))
        it.wait_for(lambda each: isinstance(each, Status) and 0.0 < each.position_s < 2.0)
        assert comes_to(ear, 0.15)
        it.say(Stop())
        assert it.status(1, "ended").problem == ""
        assert comes_to(ear, 0.0)
        it.say(Play(2, other, where(ear)))
        assert comes_to(ear, 0.3)
        assert it.end() == 0
        assert comes_to(ear, 0.0)


def test_what_cannot_be_done_is_refused_and_all_else_goes_on(tmp_path: Path) -> None:
    one = wav(tmp_path / "one.wav", 0.5)
    write_wav(tmp_path / "slow.wav", Signal(np.zeros(10, np.float32), 8000.0, 0))
    with receiver() as ear, player() as it:
        here = where(ear)
        it.say("hallo", Pause(), Play(1, one, here), '{"is":"Seek"}', Move(0.0, 0.0, 0.0, 1.0))
        it.say(Play(2, str(tmp_path / "none.wav"), here), Play(3, one, OutputSpec("foo", GENERIC.name)))
        it.say(Play(4, one, OutputSpec(ear.target, "none")), Play(5, one, OutputSpec(ear.target, "own", (1.0,))))
        it.say(Play(6, one, OutputSpec("file:x.wav", GENERIC.name), loop=True), LiveBegin(7, "no such stuff", here))
        it.say(Swap(str(tmp_path / "slow.wav")), Gain(1000.0))
        it.wait_for(lambda each: isinstance(each, Refused) and "gain of 1000" in each.why)
        assert comes_to(ear, 0.5)
        refused = [each for each in it.reports if isinstance(each, Refused)]
        assert it.end() == 0
    assert [each.play for each in refused] == [-1, -1, -1, 2, 3, 4, 5, 6, 7, -1, -1]
    for each, why in zip(
        refused,
        [
            *("cannot be read", "nothing plays", "needs 'position_s'", "none.wav", "no place to stream to"),
            *("no actuator 'none'", "three figures", "never ends", "no such stuff", "8000 Hz", "1000 dB"),
        ],
        strict=True,
    ):
        assert why in each.why
        assert "\n" not in each.why
    assert not any(isinstance(each, Status) and each.state == "ended" and each.problem for each in it.reports)


def test_a_hand_is_felt_and_may_change_what_it_touches() -> None:
    with receiver() as ear, player() as it:
        it.say(LiveBegin(1, "oak-wood", where(ear)))
        it.wait_for(lambda each: isinstance(each, Began))
        before = len(ear.values(LOUD))
        begun = time.monotonic()
        for step in range(600):
            now = time.monotonic() - begun
            it.say(Move(now, 0.1 * now, 0.0, 1.0))
            if step == 100:
                it.say(LiveBegin(2, "glazed-tile", where(ear)))
            time.sleep(0.005)
            if step > 120 and max(ear.values(LOUD)[before:], default=0.0) > 0.0 and it.last.play == 2:
                break
        assert max(ear.values(LOUD)[before:]) > 0.0
        began = [each for each in it.reports if isinstance(each, Began)]
        assert [each.play for each in began] == [1, 2]
        assert it.last.play == 2
        told = [each for each in it.reports if isinstance(each, Status)]
        played = [each.played_s for each in told]
        assert played == sorted(played)  # the same stream
        assert {each.state for each in told} == {"playing"}
        it.say(Pause(), Resume(), Seek(1.0), Stop())
        it.wait_for(lambda each: isinstance(each, Refused) and "takes no Seek" in each.why)
        assert it.status(2, "ended").problem == ""
        assert comes_to(ear, 0.0)


@pytest.mark.parametrize("end", ["input ends", "terminated"])
def test_it_leaves_softly(tmp_path: Path, end: str) -> None:
    one = wav(tmp_path / "one.wav", 0.5)
    for _ in range(4):  # on a busy machine it may starve in that very moment
        with receiver() as ear, player() as it:
            it.say(Play(1, one, where(ear), loop=True))
            assert comes_to(ear, 0.5)
            if end == "input ends":
                assert it.end() == 0
            else:
                it.process.send_signal(signal.SIGINT)  # a terminal's Ctrl C is its parent's
                it.process.send_signal(signal.SIGTERM)
                assert it.process.wait(30) == 0
            assert comes_to(ear, 0.0)
            loud = ear.values(LOUD)
        last = max(at for at, value in enumerate(loud) if value > 0.0)
        assert set(loud[last + 1 :]) == {0.0}
        if loud[last] == pytest.approx(0.25, abs=0.03):
            break
    assert loud[last] == pytest.approx(0.25, abs=0.03)


@needs_pty
def test_a_player_that_is_killed_is_silent_within_20_ms(tmp_path: Path) -> None:
    """By the device's own sample clock: it had at most 15 ms, and fades."""
    pytest.importorskip("serial", reason="pyserial is not installed")
    one = wav(tmp_path / "one.wav", 0.5)
    for _ in range(3):
        with VirtualPort() as port, player() as it:
            it.say(Play(1, one, OutputSpec(f"serial:{port.path}", GENERIC.name), loop=True))
            it.wait_for(lambda each: isinstance(each, Status) and each.played_s > 0.1)
            with port.freeze_clock() as device:
                struck = device.clock
                it.process.kill()
                it.process.wait(10)
            time.sleep(0.1)
            assert device.clock - struck > 0.02 * device.rate_hz
            assert device.last_sound_clock - struck <= 0.02 * device.rate_hz


def test_it_leaves_when_its_parent_is_killed(tmp_path: Path) -> None:
    """A parent that holds the pipe dies without a word."""
    with receiver() as ear:
        line = Play(1, wav(tmp_path / "one.wav", 0.5), where(ear), loop=True)
        code = (
            "import subprocess, sys, time\n"
            "from hnf_core.actuators.player_messages import *\n"
            f"child = subprocess.Popen([sys.executable, '-m', 'hnf_core.actuators.player'], stdin=subprocess.PIPE)\n"
            f"child.stdin.write((encode({line!r}) + '\\n').encode()); child.stdin.flush()\n"
            "time.sleep(60)\n"
        )
        parent = subprocess.Popen([sys.executable, "-c", code], cwd=ROOT, stdout=subprocess.DEVNULL)
        try:
            assert comes_to(ear, 0.5)
        finally:
            parent.kill()
            parent.wait(10)
        assert comes_to(ear, 0.0)


def test_a_parent_who_does_not_read_holds_up_nothing(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "hnf_core.actuators.player"]
    pipes = subprocess.Popen(words, cwd=ROOT, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    with receiver() as ear, pipes as process:
        assert process.stdin is not None
        process.stdin.writelines("what?\n" for _ in range(5000))  # each is answered: far more than a pipe holds
        process.stdin.write(encode(Play(1, wav(tmp_path / "one.wav", 0.5), where(ear))) + "\n")
        process.stdin.flush()
        assert comes_to(ear, 0.5)
        process.stdin.close()
        assert comes_to(ear, 0.0)
        assert process.wait(30) == 0


def test_numpy_alone_is_enough(tmp_path: Path) -> None:
    """Without any library for devices and without safetensors: a file can be played."""
    code = (
        "import sys\n"
        "for name in ('serial', 'sounddevice', 'pythonosc', 'safetensors', 'torch'): sys.modules[name] = None\n"
        "from hnf_core.actuators.player import main\n"
        "sys.exit(main())\n"
    )
    one = wav(tmp_path / "one.wav", 0.5, seconds=0.1)
    with player([sys.executable, "-c", code]) as it:
        it.say(Play(1, one, OutputSpec("osc:127.0.0.1:9", GENERIC.name)))
        it.say(Play(2, one, OutputSpec(f"file:{tmp_path / 'out.wav'}", GENERIC.name)))
        assert it.status(2, "ended").problem == ""
        assert it.end() == 0
    refused = next(each for each in it.reports if isinstance(each, Refused))
    assert "pip install python-osc" in refused.why
    assert (tmp_path / "out.wav").is_file()
