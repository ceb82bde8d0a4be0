"""`hnf stream`, run as a person does."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
import wave
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from osc_receiver import receiver
from ptys import needs_pty

from hnf_core.actuators.profile import GENERIC, write_profile
from hnf_core.actuators.signal_chain import render_counts
from hnf_core.actuators.sink import SinkFormat
from hnf_core.actuators.sources import BufferSource
from hnf_core.actuators.stream import StreamReport
from hnf_core.actuators.virtual_port import VirtualPort
from hnf_core.actuators.virtual_serial_device import Capabilities
from hnf_core.cli.main import main
from hnf_core.cli.stream import LevelMeter, format_meter
from hnf_core.errors import pluralize
from hnf_core.export.wav import write_wav
from hnf_core.signal import Signal

ROOT = Path(__file__).resolve().parents[3]
HNF = [sys.executable, "-c", "import sys; from hnf_core.cli.main import main; sys.exit(main(sys.argv[1:], None))"]
FULL = GENERIC.limits.full_scale_m_s2


def hnf(*words: object) -> int:
    return main(["stream", *map(str, words)], lambda _: 0)


def stored(path: Path) -> np.ndarray:
    with wave.open(str(path)) as file:
        return np.frombuffer(file.readframes(file.getnframes()), "<i2")


@pytest.fixture
def noise(tmp_path: Path) -> Path:
    """Two seconds of 6 m/s² RMS at 10 kHz."""
    samples = np.random.default_rng(4).normal(0.0, 6.0, 20_000).astype(np.float32)
    write_wav(tmp_path / "noise.wav", Signal(samples, 10_000.0, 4))
    return tmp_path / "noise.wav"


def test_a_file_gets_what_the_chain_makes_and_the_report_is_json(
    noise: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out.wav"
    assert hnf(noise, "--to", f"file:{out}", "--gain", 3, "--json") == 0
    report = json.loads(capsys.readouterr().out)
    assert {"blocks", "underruns", "compute_p99_ms", "peak", "limited_samples"} <= set(report)
    assert (report["target"], report["profile"], report["problem"]) == (f"file:{out}", GENERIC.name, "")
    samples = np.random.default_rng(4).normal(0.0, 6.0, 20_000).astype(np.float32)[:, None]
    source = BufferSource(samples * np.float32(10.0 ** (3 / 20)), 10_000.0)
    expected = render_counts(source, SinkFormat(10_000.0, 1, 1000, ""), GENERIC.limits)
    assert (stored(out) == expected[:, 0]).all()
    assert report["peak"] == pytest.approx(np.abs(expected).max() / 32767)
    assert report["limited_samples"] > 0


def test_it_says_what_will_happen_and_warns_of_what_is_too_loud(
    noise: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert hnf(noise, "--to", f"file:{tmp_path / 'out.wav'}", "--gain", 12) == 0
    told = capsys.readouterr()
    first, second, last = told.out.splitlines()
    assert "2.00 s at 10000 Hz, in m/s²" in first
    assert "gain 12 dB; at most 30 m/s², an assumption (Generic Voice Coil)" in second
    assert re.search(
        r"2\.00 s played: \d+ blocks, .*ms, 0 underruns; peak \d+% of full scale, [1-9]\d* samples limited", last
    )
    warning = re.search(r"is more than the 30 m/s².*of the samples are limited\. --gain (-?[\d.]+) fits", told.err)
    assert warning is not None
    assert hnf(noise, "--to", f"file:{tmp_path / 'out.wav'}", "--gain", warning[1]) == 0
    assert "is more than" not in capsys.readouterr().err


def test_seconds_end_a_loop_and_a_file(noise: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.wav"
    for words, seconds in ((("--loop", "--seconds", 5), 5.0), (("--seconds", 0.5), 0.5), (("--seconds", 9), 2.0)):
        assert hnf(noise, "--to", f"file:{out}", *words) == 0
        assert len(stored(out)) == pytest.approx(seconds * 10_000, abs=60)
        assert stored(out)[:10_000:100].any()


def test_a_wav_without_a_unit_plays_its_full_scale(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with wave.open(str(tmp_path / "a.wav"), "wb") as file:
        file.setparams((1, 2, 8000, 0, "NONE", ""))
        file.writeframes((np.sin(np.arange(8000) / 20.0) * 16384).astype("<i2").tobytes())
    assert hnf(tmp_path / "a.wav", "--to", f"file:{tmp_path / 'out.wav'}", "--json") == 0
    assert json.loads(capsys.readouterr().out)["peak"] == pytest.approx(0.5, abs=0.001)
    assert hnf(tmp_path / "a.wav", "--to", f"file:{tmp_path / 'out.wav'}") == 0
    assert "without a unit: its 1.0 is played as 30 m/s², full scale" in capsys.readouterr().out


def test_a_full_scale_that_nobody_stated_is_called_an_assumption(
    noise: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The maker of the EAI C-MF states no acceleration, so ours is not to be taken for his."""
    measured = tmp_path / "mine.json"
    write_profile(measured, replace(GENERIC, name="mine", title="Mine", peak_m_s2=12.0))
    for profile, assumed in (("eai-c-mf", True), (GENERIC.name, True), (measured, False)):
        words = (noise, "--to", f"file:{tmp_path / 'out.wav'}", "--profile", profile)
        assert hnf(*words) == 0
        second = capsys.readouterr().out.splitlines()[1]
        assert ("30 m/s², an assumption: 'EAI C-MF Tactor' does not state" in second) == (profile == "eai-c-mf")
        assert hnf(*words, "--json") == 0
        report = json.loads(capsys.readouterr().out)
        assert (report["full_scale_m_s2"], report["full_scale_assumed"]) == (30.0 if assumed else 12.0, assumed)


def stereo(path: Path, left: np.ndarray, right: np.ndarray, rate: int = 10_000) -> Path:
    with wave.open(str(path), "wb") as file:
        file.setparams((2, 2, rate, 0, "NONE", ""))
        file.writeframes(np.stack([left, right], axis=1).astype("<i2").tobytes())
    return path


def test_channels_and_files_play_beside_each_other(
    noise: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wave_form = (np.sin(np.arange(10_000) / 9.0) * 8000).astype(np.int16)
    both = stereo(tmp_path / "both.wav", wave_form, -wave_form)
    out = tmp_path / "out.wav"
    assert hnf(noise, both, "--to", f"file:{out}") == 0
    assert "2.00 s at 10000 Hz on 3 channels, in m/s²; without a unit" in capsys.readouterr().out
    played = stored(out).reshape(-1, 3).astype(int)
    assert hnf(noise, "--to", f"file:{tmp_path / 'alone.wav'}") == 0
    alone = stored(tmp_path / "alone.wav")
    assert (played[: len(alone), 0] == alone).all()
    assert np.abs(played[:, 1]).max() == pytest.approx(8000 / 32768 * 32767, rel=0.02)
    assert (played[:, 1] == -played[:, 2]).all()
    assert not played[10_100:, 1].any()  # silent where its file has ended
    assert hnf(noise, both, "--to", f"file:{both}") == 2
    assert "is the file that is read" in capsys.readouterr().err
    assert hnf(noise, stereo(tmp_path / "slow.wav", wave_form, wave_form, 8000), "--to", f"file:{out}") == 2
    assert "files of 8000 and 10000 Hz" in capsys.readouterr().err


@needs_pty
def test_two_strokes_are_felt_on_two_channels(noise: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert hnf(noise, noise, "--to", "virtual", "--seconds", 0.3, "--json") == 0
    report = json.loads(capsys.readouterr().out)
    assert report["problem"] == ""
    assert report["played_s"] == pytest.approx(0.3, abs=0.02)
    assert report["wav"] == f"{noise}, {noise}"


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (("--to", "nowhere"), 2, "no place to stream to"),
        (("--to", "virtual", "--gain", "900"), 2, "gain of 900"),
        (("--to", "virtual", "--gain", "nan"), 2, "gain of nan"),
        (("--to", "virtual", "--seconds", "0"), 2, "no time to play"),
        (("--to", "virtual", "--seconds", "nan"), 2, "no time to play"),
        (("--to", "virtual", "--block", "0"), 2, "blocks of 0 ms"),
        (("--to", "virtual", "--profile", "none"), 2, "no actuator 'none'"),
        (("--to", "virtual", "--profile", "none.json"), 1, "none.json: cannot be read"),
        (("--to", "file:x.wav", "--loop"), 2, "never ends"),
        (("--to", "serial:/dev/no-such-port"), 1, "/dev/no-such-port"),
        (("--to", "osc:no.such.host.invalid:9"), 1, "cannot be reached"),
        ((), 2, "--to"),
    ],
)
def test_what_does_not_work_is_one_line(
    noise: Path, words: tuple[str, ...], code: int, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert hnf(noise, *words) == code
    told = capsys.readouterr()
    assert said in told.err
    assert len([line for line in told.err.splitlines() if line.startswith("hnf: ")]) == (1 if words else 0)


def test_the_file_that_is_read_is_not_written_over(noise: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = noise.read_bytes()
    assert hnf(noise, "--to", f"file:{noise.parent / '..' / noise.parent.name / noise.name}") == 2
    assert "is the file that is read" in capsys.readouterr().err
    assert noise.read_bytes() == before


def test_a_wav_without_samples_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_wav(tmp_path / "empty.wav", Signal(np.zeros(0, np.float32), 8000.0, 0))
    assert hnf(tmp_path / "empty.wav", "--to", f"file:{tmp_path / 'out.wav'}") == 1
    assert "empty.wav: has no samples" in capsys.readouterr().err


def test_who_reads_no_further_gets_no_traceback(noise: Path, tmp_path: Path) -> None:
    words = [*HNF, "stream", str(noise), "--to", f"file:{tmp_path / 'out.wav'}"]
    with subprocess.Popen(words, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as running:
        assert running.stdout is not None
        running.stdout.close()
        assert running.stderr is not None
        assert running.stderr.read() == b""
    assert running.returncode == 1


def test_a_terminal_that_knows_no_square_gets_its_code(noise: Path, tmp_path: Path) -> None:
    words = [*HNF, "stream", str(noise), "--to", f"file:{tmp_path / 'out.wav'}"]
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    run = subprocess.run(words, cwd=ROOT, env=environment, capture_output=True, timeout=60)
    assert run.returncode == 0
    assert rb"m/s\xb2" in run.stdout


def test_a_missing_file_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert hnf(tmp_path / "no.wav", "--to", "virtual") == 1
    assert "no.wav: cannot be read" in capsys.readouterr().err


@needs_pty
def test_the_virtual_actuator_plays(noise: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("serial", reason="pyserial is not installed")
    hnf(noise, "--to", "virtual", "--seconds", "0.3", "--block", "20", "--json")
    report = json.loads(capsys.readouterr().out)
    assert report["device"] == "virtual actuator"
    assert report["frames"] > 0
    assert 0.0 < report["peak"] <= 1.0


@needs_pty
def test_a_device_s_own_peak_is_kept_and_told(noise: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("serial", reason="pyserial is not installed")
    with VirtualPort(Capabilities(peak=8000)) as port:
        target = f"serial:{port.path}"
        assert hnf(noise, "--to", target, "--seconds", 0.3, "--gain", 12) == 0
        told = capsys.readouterr()
        assert "at most 7.324 m/s², the device's own limit, its full scale an assumption (Generic" in told.out
        assert hnf(noise, "--to", target, "--seconds", 0.3, "--gain", 12, "--json") == 0
        report = json.loads(capsys.readouterr().out)
    assert report["peak"] == 8000 / 32767
    assert report["limited_samples"] > 100
    if report["underruns"] == 0:  # after one, the device's own fades may meet its slew
        assert report["device_limited_samples"] == 0


@pytest.fixture
def ctrl_c_is_heard() -> Iterator[None]:
    """By children too: tests that a shell runs in the background inherit that it is not."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_stops_softly_and_reports(noise: Path, how: signal.Signals, ctrl_c_is_heard: None) -> None:
    pytest.importorskip("pythonosc", reason="python-osc is not installed")
    with receiver() as ear:
        words = [*HNF, "stream", str(noise), "--to", ear.target, "--loop", "--json"]
        with subprocess.Popen(words, cwd=ROOT, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
            ear.wait_for(10, "/hnf/1/amplitude", 30.0)
            process.send_signal(how)
            out, error = process.communicate(timeout=20)
        assert process.returncode == 0, error
        assert error == ""
        report = json.loads(out)
        assert report["state"] == "ended"
        assert report["frames"] > 0
        ear.settled()
        assert ear.values("/hnf/1/amplitude")[-1] == 0.0


@needs_pty
def test_the_meter_redraws_one_line_on_a_terminal(noise: Path) -> None:
    pytest.importorskip("pythonosc", reason="python-osc is not installed")
    ours, theirs = os.openpty()
    with receiver() as ear:
        words = [*HNF, "stream", str(noise), "--to", ear.target, "--seconds", "0.4"]
        with subprocess.Popen(words, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=theirs) as process:
            os.close(theirs)
            said = b""
            while True:
                try:
                    said += os.read(ours, 4096)
                except OSError:  # the other end is closed
                    break
            assert process.wait(20) == 0
    os.close(ours)
    lines = said.decode().split("\r\x1b[K")
    assert len(lines) > 3
    assert "\n" not in said.decode()
    assert lines[-1] == ""
    assert re.search(r"of 0\.4 s  [█·]{12} .* m/s²  underruns \d+  limited \d+", lines[-2])


def test_what_is_counted_is_counted_in_words() -> None:
    assert [pluralize(number, "block") for number in (0, 1, 2)] == ["0 blocks", "1 block", "2 blocks"]


def test_one_block_is_no_blocks(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_wav(tmp_path / "x.wav", Signal(np.ones(20, np.float32), 10_000.0, 0))
    assert hnf(tmp_path / "x.wav", "--to", f"file:{tmp_path / 'out.wav'}") == 0
    assert " s played: 1 block, " in capsys.readouterr().out


def test_a_meter_shows_the_level_against_the_limit() -> None:
    def bar(level: float) -> str:
        return format_meter(StreamReport(level_m_s2=level, underruns=3, limited_samples=7), 30.0, None)

    assert "█" * 12 + "    0 dB  30.00 m/s²  underruns 3  limited 7" in bar(30.0)
    assert "█" * 8 + "·" * 4 + "  -20 dB   3.00 m/s²" in bar(3.0)
    assert "·" * 12 + "  silent   0.00 m/s²" in bar(0.0)
    assert "·" * 12 + "  silent" in bar(1e-9)
    assert len(format_meter(StreamReport(played_s=599.9, level_m_s2=30.0, limited_samples=12345), 30.0, 600.0)) < 80


def test_elsewhere_the_meter_is_plain(tmp_path: Path) -> None:
    with (tmp_path / "log").open("w+") as log:
        meter = LevelMeter(30.0, 10.0, log)
        meter.show(StreamReport())
        meter._next_s = time.monotonic()
        meter.show(StreamReport(played_s=5.0))
        meter.close()
        log.seek(0)
        lines = log.read().splitlines()
    assert len(lines) == 1
    assert "5.0 of 10.0 s" in lines[0]
    assert "\x1b" not in lines[0]
