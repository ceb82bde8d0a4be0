"""A copy for ears: never clipped, always as loud, its gain on record, and m/s² again when it is read."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from export_signals import OPTIONS, signal_of, texture, tone
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.cli.main import main
from hnf_core.export.convert import export_signal
from hnf_core.export.formats import FORMATS
from hnf_core.export.wav import read_wav, write_wav

LISTEN = FORMATS["listen"]
LOUD = 10.0 ** (-1.0 / 20.0)


def counts_of(path: Path) -> np.ndarray:
    """What a player sees."""
    data = path.read_bytes()
    at = data.index(b"data")
    (size,) = struct.unpack_from("<I", data, at + 4)
    return np.frombuffer(data, "<i2", size // 2, at + 8)


def hnf(*words: object) -> int:
    def no_blender(arguments: object) -> int:
        raise AssertionError("this needs no Blender")

    return main([str(word) for word in words], no_blender)


@given(
    level=st.floats(1e-3, 1e4),
    seed=st.integers(0, 50),
    rate=st.sampled_from([8000.0, 10_000.0, 44_100.0, 48_000.0]),
)
@settings(max_examples=30, deadline=None)
def test_every_signal_comes_out_as_loud_and_none_is_clipped(level, seed, rate, tmp_path_factory) -> None:
    path, signal = tmp_path_factory.getbasetemp() / "listen.wav", texture(0.3, rate, seed, level)
    exported = export_signal(signal, LISTEN, path, OPTIONS)
    assert np.abs(counts_of(path)).max() == pytest.approx(32767 * LOUD, abs=1.0)
    assert exported.clipped == ""
    assert read_wav(path).rms == pytest.approx(signal.rms, rel=0.01)


def test_the_gain_is_in_the_file_beside_it_and_in_words(tmp_path: Path) -> None:
    path = tmp_path / "listen.wav"
    exported = export_signal(tone(160.0, 60.0), LISTEN, path, OPTIONS)
    scale = exported.options.full_scale_m_s2
    assert scale == pytest.approx(60.0 / LOUD, rel=0.01)
    assert json.loads((tmp_path / "listen.wav.json").read_text("utf-8"))["full_scale"] == scale
    assert exported.to_json()["full_scale_m_s2"] == scale
    assert f"1 stands for {scale:.3g} m/s²" in exported.dropped[0]
    assert "not for an actuator" in exported.dropped[0]
    assert np.abs(read_wav(path).samples).max() == pytest.approx(60.0, rel=0.01)


def test_silence_stays_silence(tmp_path: Path) -> None:
    export_signal(signal_of(np.zeros(500)), LISTEN, tmp_path / "x.wav", OPTIONS)
    assert not counts_of(tmp_path / "x.wav").any()


def test_by_its_word(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_wav(tmp_path / "in.wav", tone(160.0, 60.0))
    words = ("export", tmp_path / "in.wav", "--format", "listen", "--out", tmp_path / "x.wav")
    assert hnf(*words) == 0
    said = capsys.readouterr()
    assert "not for an actuator" in said.out
    assert "voice coil" not in said.out
    assert hnf(*words, "--full-scale", "20") == 2
    assert "finds its full scale in the signal" in capsys.readouterr().err
