"""Warnings of `hnf stream` about a signal that is too strong: cause, share, and the gain that fits."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from responses import of_gains

from hnf_core.actuators.profile import GENERIC, make_user_profile, write_profile
from hnf_core.cli.main import main
from hnf_core.cli.stream import MAX_CHECKED_S, compute_checked_duration
from hnf_core.export.wav import write_wav
from hnf_core.signal import Signal

RATE = 10_000


def tone(path: Path, peak: float, hz: float, seconds: float = 1.0) -> Path:
    time = np.arange(round(seconds * RATE)) / RATE
    write_wav(path, Signal((peak * np.sin(2.0 * np.pi * hz * time)).astype(np.float32), float(RATE), 0))
    return path


def played(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, int, str]:
    """Samples limited, frames sent, and what was said of it."""
    assert main(["stream", *map(str, words), "--json"], lambda _: 0) == 0
    told = capsys.readouterr()
    report = json.loads(told.out)
    return report["limited_samples"], report["frames"], told.err


def case_of(name: str, tmp_path: Path) -> tuple[list[object], str]:
    """Words of a stream that is too strong, and why it is."""
    profile = tmp_path / "p.json"
    if name == "peak":
        return [tone(tmp_path / "x.wav", 40.0, 250.0)], "40 m/s² is more than the 30 m/s² of 'Generic Voice Coil'"
    if name == "steep":
        write_profile(profile, make_user_profile(30.0, 30.0, 100.0))
        return [tone(tmp_path / "x.wav", 29.0, 1000.0), "--profile", profile], "changes faster than 'My Actuator'"
    if name == "hot":
        loop = ("--loop", "--seconds", 15)
        return [tone(tmp_path / "x.wav", 29.0, 200.0), *loop], "warms the coil of 'Generic Voice Coil'"
    # What is made up for is 20 dB stronger behind the inverse filter than in the file.
    frequency = np.geomspace(20.0, 1000.0, 50)
    weak = of_gains(frequency, np.where(frequency < 300.0, 0.05, 1.0).astype(complex))
    write_profile(profile, replace(GENERIC, name="weak", title="Weak", response=weak))
    words = [tone(tmp_path / "x.wav", 8.0, 100.0), "--profile", profile]
    return words, "with the response of 'Weak' corrected, it is more than its 30 m/s²"


@pytest.mark.parametrize("name", ["peak", "steep", "hot", "made up"])
@pytest.mark.parametrize("gain", [0.0, 2.57])
def test_it_says_why_and_how_much_and_the_gain_it_names_fits(
    name: str, gain: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words, why = case_of(name, tmp_path)
    words += ["--to", f"file:{tmp_path / 'out.wav'}"]
    limited, frames, said = played(capsys, *words, "--gain", gain)
    warning = re.search(r"hnf: .*: ([\d.]+)% of the samples are limited\. --gain (-?[\d.]+) fits\.", said)
    assert warning is not None
    assert why in said or gain
    assert float(warning[1]) == pytest.approx(100.0 * limited / frames, abs=0.5), "as it came, but for the last fade"
    fits = float(warning[2])
    assert played(capsys, *words, "--gain", fits)[::2] == (0, "")
    assert played(capsys, *words, "--gain", fits + 0.2)[0] > 0, "and nothing much louder does"


def test_what_no_gain_makes_fit_is_told_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = [tone(tmp_path / "x.wav", 1e30, 200.0), "--to", f"file:{tmp_path / 'out.wav'}"]
    assert "No --gain makes it fit: check the file's unit." in played(capsys, *words)[2]


def test_an_endless_loop_is_checked_until_the_coil_is_warm() -> None:
    """Once through, it may be harmless."""
    assert compute_checked_duration(1.0, None, loop=True, thermal_s=10.0) >= 50.0
    assert compute_checked_duration(1.0, 3.0, loop=True, thermal_s=10.0) == 3.0
    assert compute_checked_duration(1.0, 3.0, loop=False, thermal_s=10.0) == 1.0
    assert {compute_checked_duration(1e6, None, loop=loop, thermal_s=10.0) for loop in (False, True)} == {MAX_CHECKED_S}


def test_of_a_long_signal_the_strongest_place_is_looked_at(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Wherever it is, and the gain that fits there fits all of it."""
    monkeypatch.setattr("hnf_core.cli.stream.MAX_CHECKED_S", 0.5)
    time = np.arange(3 * RATE) / RATE
    envelope = np.where((time > 2.4) & (time < 2.5), 60.0, 5.0)
    write_wav(tmp_path / "x.wav", Signal((envelope * np.sin(2e3 * time)).astype(np.float32), float(RATE), 0))
    words = [tmp_path / "x.wav", "--to", f"file:{tmp_path / 'out.wav'}"]
    said = played(capsys, *words)[2]
    warning = re.search(r"60 m/s² is more.* about its strongest place .*--gain (-?[\d.]+) fits\.", said)
    assert warning is not None
    assert played(capsys, *words, "--gain", warning[1])[::2] == (0, "")


def test_what_fits_is_not_warned_of(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = [tone(tmp_path / "x.wav", 10.0, 200.0), "--to", f"file:{tmp_path / 'out.wav'}"]
    assert played(capsys, *words)[::2] == (0, "")
