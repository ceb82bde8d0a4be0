"""WAV export: what is read back is what was written, and damage is named."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from hnf_core.errors import FileError
from hnf_core.export.wav import encode_wav, read_wav, write_wav
from hnf_core.signal import Signal

TEXT = st.text(max_size=40)
SIGNALS = st.builds(
    Signal,
    hnp.arrays(np.float32, st.integers(0, 300), elements=st.floats(-1e6, 1e6, width=32)),
    st.integers(1, 200_000).map(float),
    st.integers(-(2**63), 2**63),
    st.dictionaries(st.sampled_from(["stroke", "material", "probe", "model"]) | TEXT, TEXT, max_size=6),
)


def parse(data: bytes) -> dict[bytes, bytes]:
    """Chunks of a RIFF file, read without the code under test."""
    assert data[:4] == b"RIFF"
    assert struct.unpack("<I", data[4:8])[0] == len(data) - 8
    chunks, at = {}, 12
    while at < len(data):
        tag, size = data[at : at + 4], struct.unpack("<I", data[at + 4 : at + 8])[0]
        chunks[tag] = data[at + 8 : at + 8 + size]
        at += 8 + size + size % 2
    assert at == len(data)
    return chunks


def tone(n: int = 400) -> Signal:
    samples = (20 * np.sin(np.arange(n) * 0.3)).astype(np.float32)
    return Signal(samples, 8000.0, 7, {"stroke": "Stroke", "material": "Grès ☕", "probe": "pen", "model": "abc"})


def plain(form: bytes, data: bytes) -> bytes:
    body = b"WAVEfmt " + struct.pack("<I", len(form)) + form + b"data" + struct.pack("<I", len(data)) + data
    return b"RIFF" + struct.pack("<I", len(body)) + body


@settings(deadline=None)
@given(signal=SIGNALS)
def test_round_trip(signal: Signal, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.getbasetemp() / "round.wav"
    write_wav(path, signal)
    back = read_wav(path)
    assert back.samples.tobytes() == signal.samples.tobytes()
    assert (back.sample_rate, back.seed, dict(back.provenance)) == (
        signal.sample_rate,
        signal.seed,
        dict(signal.provenance),
    )
    assert path.read_bytes() == encode_wav(signal)


@settings(deadline=None)
@given(signal=SIGNALS)
def test_layout_is_ieee_float_with_fact_and_info(signal: Signal) -> None:
    chunks = parse(encode_wav(signal))
    kind, channels, rate, byte_rate, block, bits, extra = struct.unpack("<HHIIHHH", chunks[b"fmt "])
    assert (kind, channels, block, bits, extra) == (3, 1, 4, 32, 0)
    assert (rate, byte_rate) == (int(signal.sample_rate), 4 * int(signal.sample_rate))
    assert struct.unpack("<I", chunks[b"fact"]) == (len(signal.samples),)
    assert chunks[b"data"] == signal.samples.astype("<f4").tobytes()
    assert chunks[b"LIST"].startswith(b"INFOISFT")
    assert b'"units": "m/s^2"' in chunks[b"LIST"]
    assert b"Haptic Neural Fields" in chunks[b"LIST"]


@pytest.mark.parametrize("name", ["a", "ab"])
def test_odd_and_even_texts_keep_chunks_aligned(name: str) -> None:
    signal = Signal(tone().samples, 8000.0, 1, {"stroke": name})
    info = parse(encode_wav(signal))[b"LIST"]
    at = info.index(b"INAM")
    assert at % 2 == 0
    assert struct.unpack("<I", info[at + 4 : at + 8])[0] == len(name) + 1


def test_scipy_reads_the_samples_in_m_s2(tmp_path: Path) -> None:
    wavfile = pytest.importorskip("scipy.io.wavfile")
    write_wav(tmp_path / "a.wav", tone())
    rate, samples = wavfile.read(tmp_path / "a.wav")
    assert rate == 8000
    assert samples.dtype == np.float32
    np.testing.assert_array_equal(samples, tone().samples)


@pytest.mark.parametrize("dtype", ["uint8", "int16", "int32", "float32", "float64"])
def test_reads_plain_files_written_by_scipy(tmp_path: Path, dtype: str) -> None:
    wavfile = pytest.importorskip("scipy.io.wavfile")
    wave = 0.5 * np.sin(np.arange(301) * 0.1)
    full = {"uint8": 128, "int16": 2**15, "int32": 2**31}.get(dtype, 1)
    stored = (
        (np.round(wave * full) + (128 if dtype == "uint8" else 0)).astype(dtype) if full > 1 else wave.astype(dtype)
    )
    wavfile.write(tmp_path / "a.wav", 22050, stored)
    back = read_wav(tmp_path / "a.wav")
    assert back.sample_rate == 22050
    np.testing.assert_allclose(back.samples, wave, atol=0.5 / full if full > 1 else 1e-7, rtol=1e-6)
    assert back.provenance["units"] == "as stored"


def test_reads_24_bit_and_extensible(tmp_path: Path) -> None:
    values = [0, 1, -1, 2**23 - 1, -(2**23)]
    data = b"".join(v.to_bytes(3, "little", signed=True) for v in values)
    guid = struct.pack("<HHIIHHHHIH", 0xFFFE, 1, 48000, 144000, 3, 24, 22, 24, 0, 1) + bytes(14)
    path = tmp_path / "a.wav"
    path.write_bytes(plain(guid, data))
    np.testing.assert_array_equal(read_wav(path).samples, np.float32(np.array(values) / 2**23))


@pytest.mark.parametrize("missing", [0, 1, 4])
def test_what_was_written_into_a_pipe_is_read_to_its_end(tmp_path: Path, missing: int) -> None:
    """Who could not go back to fill in the size leaves the largest there is."""
    values = [0, 1000, -1000, 32767]
    data = struct.pack("<4h", *values)
    whole = plain(struct.pack("<HHIIHH", 1, 1, 8000, 16000, 2, 16), data)
    at = whole.index(b"data") + 4
    untold = whole[:at] + b"\xff\xff\xff\xff" + whole[at + 4 :]
    path = tmp_path / "a.wav"
    path.write_bytes(untold[: len(untold) - 2 * missing])
    expected = np.float32(np.array(values[: 4 - missing]) / 2**15)
    np.testing.assert_array_equal(read_wav(path).samples, expected)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_non_finite_samples_are_refused_and_the_old_file_stays(tmp_path: Path, bad: float) -> None:
    path = tmp_path / "a.wav"
    write_wav(path, tone())
    before = path.read_bytes()
    samples = tone().samples.copy()
    samples[3] = bad
    with pytest.raises(FileError, match="1 of 400 samples are not finite"):
        write_wav(path, Signal(samples, 8000.0, 0))
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["a.wav"]


@pytest.mark.parametrize("rate", [0.0, -1.0, 2333.5, np.inf, np.nan, 2.0**31])
def test_rates_a_wav_cannot_hold_are_refused(rate: float) -> None:
    with pytest.raises(FileError, match="sample rate"):
        encode_wav(Signal(tone().samples, rate, 0))


@settings(max_examples=200, deadline=None)
@given(data=st.data())
def test_damage_gives_a_file_error_or_a_finite_signal(
    data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    whole = bytearray(encode_wav(tone(20)))
    cut = data.draw(st.integers(0, len(whole)))
    for _ in range(data.draw(st.integers(0, 4))):
        whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.getbasetemp() / "damaged.wav"
    path.write_bytes(bytes(whole[:cut]))
    try:
        signal = read_wav(path)
    except FileError:
        return
    assert np.isfinite(signal.samples).all()


def test_every_truncation_is_noticed(tmp_path: Path) -> None:
    whole = encode_wav(tone(20))
    path = tmp_path / "cut.wav"
    for cut in range(0, len(whole)):
        path.write_bytes(whole[:cut])
        with pytest.raises(FileError):
            read_wav(path)


@pytest.mark.parametrize(
    ("form", "data", "why"),
    [
        (struct.pack("<HHIIHH", 3, 1, 8000, 64000, 8, 64), b"\x01\0\0\0\0\0\xf0\x7f", "not finite"),  # signalling
        (struct.pack("<HHIIHH", 1, 2, 8000, 32000, 4, 16), bytes(8), "2 channels"),
        (struct.pack("<HHIIHH", 1, 0, 8000, 16000, 2, 16), bytes(8), "no channel"),
        (struct.pack("<HHIIHH", 1, 2, 8000, 32000, 4, 16), bytes(6), "whole samples"),
        (struct.pack("<HHIIHH", 1, 3, 8000, 32000, 4, 16), bytes(12), "whole samples"),
        (struct.pack("<HHIIHH", 1, 1, 0, 0, 2, 16), bytes(8), "sample rate is 0"),
        (struct.pack("<HHIIHH", 2, 1, 8000, 0, 1, 4), bytes(8), "encoding"),
        (struct.pack("<HHIIHH", 1, 1, 8000, 16000, 2, 16), bytes(7), "whole samples"),
        (struct.pack("<HHIIHH", 3, 1, 8000, 32000, 4, 32), struct.pack("<f", np.nan), "not finite"),
        (b"\x01\x00", bytes(8), "too short"),
    ],
)
def test_unusable_files_say_why(tmp_path: Path, form: bytes, data: bytes, why: str) -> None:
    path = tmp_path / "a.wav"
    path.write_bytes(plain(form, data))
    with pytest.raises(FileError, match=why):
        read_wav(path)


def test_missing_and_foreign_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"gone\.wav"):
        read_wav(tmp_path / "gone.wav")
    (tmp_path / "song.wav").write_bytes(b"ID3\x03" + bytes(100))
    with pytest.raises(FileError, match=r"song\.wav: is not a RIFF"):
        read_wav(tmp_path / "song.wav")


def test_full_device_fails_and_stays_a_device(tmp_path: Path) -> None:
    if not Path("/dev/full").is_char_device():
        pytest.skip("no /dev/full on this system")
    link = tmp_path / "a.wav"
    link.symlink_to("/dev/full")
    for path in (link, Path("/dev/full")):
        with pytest.raises(FileError, match="could not be written"):
            write_wav(path, tone())
    assert Path("/dev/full").is_char_device()
    assert link.is_symlink()


def test_a_disk_that_fills_up_leaves_the_old_file(tmp_path: Path) -> None:
    pytest.importorskip("resource")
    path = tmp_path / "a.wav"
    write_wav(path, tone())
    before = path.read_bytes()
    code = (
        "import resource, sys, numpy as np\n"
        "from hnf_core.export.wav import write_wav\n"
        "from hnf_core.signal import Signal\n"
        "from hnf_core.errors import FileError\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (5000, 5000))\n"
        "try:\n"
        "    write_wav(sys.argv[1], Signal(np.ones(10_000, np.float32), 8000.0, 0))\n"
        "except FileError:\n"
        "    sys.exit(3)\n"
    )
    assert subprocess.run([sys.executable, "-c", code, str(path)], timeout=60).returncode == 3
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["a.wav"]


def test_an_output_path_below_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(FileError, match="cannot write here"):
        write_wav(tmp_path / "file" / "a.wav", tone())
