"""The file sink keeps what would have gone on the wire."""

from __future__ import annotations

import wave
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from stream_builders import comes

from hnf_core.actuators.limits import Limits
from hnf_core.actuators.signal_chain import SignalChain, render_counts
from hnf_core.actuators.sinks.file import FileSink
from hnf_core.actuators.sources import BufferSource
from hnf_core.actuators.stream import Stream
from hnf_core.errors import DeviceError, UsageError
from hnf_core.export.wav import read_wav

LIMITS = Limits(20.0, peak=0.8, slew_per_s=4000.0, sustained=0.4, thermal_s=0.5)


def stored(path: Path) -> np.ndarray:
    with wave.open(str(path)) as file:
        assert file.getsampwidth() == 2
        return np.frombuffer(file.readframes(file.getnframes()), "<i2").reshape(-1, file.getnchannels())


@given(st.lists(st.lists(st.integers(-32767, 32767), max_size=20), max_size=6), st.floats(0.01, 1e4))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60)
def test_counts_come_back_as_counts_and_as_accelerations(
    tmp_path: Path, pieces: list[list[int]], full_scale: float
) -> None:
    path = tmp_path / "x.wav"
    sink = FileSink(path, 8000.0, full_scale_m_s2=full_scale)
    assert sink.open().rate_hz == 8000.0
    for piece in pieces:
        assert sink.wait(0.0) >= len(piece)
        sink.write(np.array(piece, dtype=np.int16)[:, None])
    sink.finish(1.0)
    whole = np.array([value for piece in pieces for value in piece], dtype=np.int16)
    assert (stored(path)[:, 0] == whole).all()
    signal = read_wav(path)
    assert signal.provenance["made by"] == "hnf stream"
    assert np.allclose(signal.samples, whole / 32767.0 * full_scale, rtol=1e-6, atol=0.0)
    assert sink.status().played == len(whole)


def test_a_stream_into_a_file_is_what_any_device_would_get(tmp_path: Path) -> None:
    """Far beyond every limit, with samples that are none."""
    samples = np.random.default_rng(3).normal(0.0, 40.0, (30_000, 1)).astype(np.float32)
    samples[777] = np.nan
    sink = FileSink(tmp_path / "x.wav", 10_000.0)
    with Stream(BufferSource(samples, 10_000.0), sink, LIMITS) as stream:
        device = stream.start()
        assert stream.wait(30.0)
        report = stream.report
    assert report.problem == ""
    expected = render_counts(BufferSource(samples, 10_000.0), device, LIMITS)
    assert (stored(tmp_path / "x.wav") == expected).all()
    assert np.abs(stored(tmp_path / "x.wav").astype(int)).max() <= LIMITS.peak_counts
    assert report.limited_samples > 1000
    assert report.nonfinite_samples == 1


def test_channels_lie_side_by_side(tmp_path: Path) -> None:
    counts = np.arange(12, dtype=np.int16).reshape(4, 3)
    sink = FileSink(tmp_path / "x.wav", 1000.0, channels=3)
    sink.open()
    sink.write(counts)
    sink.finish(1.0)
    assert (stored(tmp_path / "x.wav") == counts).all()


def test_a_file_is_there_when_it_is_whole_and_not_before(tmp_path: Path) -> None:
    path = tmp_path / "x.wav"
    path.write_bytes(b"earlier")
    sink = FileSink(path, 1000.0)
    sink.open()
    sink.write(np.ones((5, 1), np.int16))
    assert path.read_bytes() == b"earlier"
    sink.stop()
    sink.close()
    assert len(stored(path)) == 5
    sink.close()
    assert [each.name for each in tmp_path.iterdir()] == ["x.wav"]
    with pytest.raises(DeviceError, match="closed"):
        sink.write(np.ones((5, 1), np.int16))
    sink.open()
    sink.close()
    assert len(stored(path)) == 5, "what was given up before it began takes nobody's place"
    sink.open()
    sink.finish(1.0)
    assert len(stored(path)) == 0


def test_what_cannot_be_written_is_told_and_harms_nothing(tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match="folder"):
        FileSink(tmp_path, 1000.0).open()
    with pytest.raises(UsageError, match="whole sample rate"):
        FileSink(tmp_path / "x.wav", 1000.5)
    (tmp_path / "file").write_bytes(b"")
    sink = FileSink(tmp_path / "file" / "x.wav", 1000.0)
    with pytest.raises(DeviceError, match=r"x\.wav: cannot write here"):
        sink.open()  # and not after all was played
    (tmp_path / "file").unlink()
    sink.open()
    assert list((tmp_path / "file").iterdir()) == [], "to look leaves nothing behind"
    _taken_away(tmp_path / "file")
    with pytest.raises(DeviceError, match=r"x\.wav: cannot write here"):
        sink.finish(1.0)
    assert "cannot write here" in sink.status().problem
    (tmp_path / "file").unlink()
    sink.open()
    sink.write(np.ones((5, 1), np.int16))
    _taken_away(tmp_path / "file")
    sink.close()
    assert "cannot write here" in sink.status().problem


def _taken_away(folder: Path) -> None:
    folder.rmdir()
    folder.write_bytes(b"")


def test_a_stream_into_a_file_that_is_stopped_ends_softly(tmp_path: Path) -> None:
    """As a device would have played it: all that was made, and the limiter's own way down."""
    samples = np.random.default_rng(3).normal(0.0, 6.0, (30_000, 1)).astype(np.float32)
    stream = Stream(BufferSource(samples, 10_000.0, loop=True), FileSink(tmp_path / "x.wav", 10_000.0), LIMITS)
    device = stream.start()
    assert comes(lambda: stream.report.frames >= 1000)
    stream.stop()
    assert stream.report.problem == ""
    chain = SignalChain(BufferSource(samples, 10_000.0, loop=True), device, LIMITS)
    blocks = [chain.render_block(50) for _ in range(stream.report.blocks)]
    release = chain.limiter.flush()
    assert len(release) > 30
    assert release[-1] == 0
    assert (stored(tmp_path / "x.wav") == np.concatenate([*blocks, release])).all()
