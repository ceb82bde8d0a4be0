"""Parsing of stream targets."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hnf_core.actuators.limits import FULL_SCALE_COUNTS, Limits, compute_limiter_params, compute_max_step
from hnf_core.actuators.profile import GENERIC
from hnf_core.actuators.serial_protocol import NO_SLEW_LIMIT, Start
from hnf_core.actuators.sinks.audio import AudioSink
from hnf_core.actuators.sinks.file import FileSink
from hnf_core.actuators.sinks.osc import OscSink
from hnf_core.actuators.sinks.serial import SerialSink, compute_device_slew
from hnf_core.actuators.stream_targets import (
    AudioTarget,
    FileTarget,
    OscTarget,
    SerialTarget,
    Target,
    VirtualTarget,
    list_devices,
    make_sink,
    parse_target,
)
from hnf_core.actuators.virtual_port import VirtualSink
from hnf_core.actuators.virtual_serial_device import PlayoutFormat
from hnf_core.errors import UsageError


@pytest.mark.parametrize(
    ("words", "target"),
    [
        ("virtual", VirtualTarget()),
        ("audio", AudioTarget()),
        ("audio:3", AudioTarget(3)),
        ("audio:USB DAC: Audio (hw:1,0), ALSA", AudioTarget("USB DAC: Audio (hw:1,0), ALSA")),
        ("serial:/dev/ttyACM0", SerialTarget("/dev/ttyACM0")),
        ("serial:COM3@115200", SerialTarget("COM3", 115200)),
        ("serial:/dev/serial/by-id/usb@1@3000000", SerialTarget("/dev/serial/by-id/usb@1", 3000000)),
        ("osc:127.0.0.1:9000", OscTarget("127.0.0.1", 9000)),
        ("osc:[::1]:9000", OscTarget("::1", 9000)),
        ("osc:quest.local:9000/avatar/parameters/hnf/", OscTarget("quest.local", 9000, "/avatar/parameters/hnf")),
        ("file:out/x.wav", FileTarget(Path("out/x.wav"))),
        ("file:C:\\x.wav", FileTarget(Path("C:\\x.wav"))),
        (" virtual ", VirtualTarget()),
    ],
)
def test_words_mean_a_target(words: str, target: Target) -> None:
    assert parse_target(words) == target


texts = st.text(st.characters(codec="ascii", exclude_characters="\n\r@"), min_size=1).filter(
    lambda text: text.strip() == text
)
targets = st.one_of(
    st.just(VirtualTarget()),
    st.builds(AudioTarget, st.one_of(st.none(), st.integers(0, 999), texts.filter(lambda text: not text.isdigit()))),
    st.builds(SerialTarget, texts, st.one_of(st.none(), st.integers(1, 10**8))),
    st.builds(
        OscTarget,
        st.from_regex(r"[a-z0-9.-]{1,20}", fullmatch=True) | st.just("fe80::1"),
        st.integers(1, 65535),
        st.from_regex(r"(/[a-zA-Z0-9_]{1,8}){1,3}", fullmatch=True),
    ),
    st.builds(FileTarget, texts.map(Path)),
)


@given(targets)
def test_a_target_is_found_again_by_its_words(target: Target) -> None:
    assert parse_target(target.text) == target


@pytest.mark.parametrize(
    "words",
    [
        *("", "foo", "virtual:1", "audio:", "file", "file:"),
        *("serial", "serial:", "serial:COM3@", "serial:COM3@fast", "serial:x@0"),
        *("osc", "osc:host", "osc:host:0", "osc:host:65536", "osc::9000", "osc:::1:9000", "osc:h:1/*"),
    ],
)
def test_what_is_no_target_names_the_form(words: str) -> None:
    with pytest.raises(UsageError) as problem:
        parse_target(words)
    assert f"'{words}'" in str(problem.value)
    assert words.partition(":")[0] in ("", "foo") or f"{words.partition(':')[0]}" in problem.value.remedy
    assert "Say " in problem.value.remedy


def test_every_target_has_its_sink(tmp_path: Path) -> None:
    limits = Limits(30.0)
    kinds = {"virtual": VirtualSink, "audio": AudioSink, "serial:COM9": SerialSink, "osc:h:1": OscSink}
    for words, kind in {**kinds, f"file:{tmp_path / 'x.wav'}": FileSink}.items():
        assert isinstance(make_sink(parse_target(words), 10_000.0, limits), kind)


@pytest.mark.parametrize("limits", [GENERIC.limits, Limits(30.0, peak=0.5, slew_per_s=900.0), Limits(30.0)])
def test_the_device_is_told_the_limits_that_hold_there(limits: Limits) -> None:
    """So that a frame that is lost on the way makes no step that the limiter would not have made."""
    sink = make_sink(parse_target("virtual"), 10_000.0, limits)
    assert isinstance(sink, VirtualSink)
    try:
        sink.open()
        assert sink._device is not None
        form, law = sink._device.device._playout.form, compute_limiter_params(limits, 10_000.0)
        assert form.peak == law.peak
        assert form.slew == (law.max_step if limits.slew_per_s < math.inf else NO_SLEW_LIMIT)
    finally:
        sink.close()


@given(st.floats(1e-3, 1e9), st.integers(1, FULL_SCALE_COUNTS), st.integers(1000, 192_000))
def test_the_device_slew_admits_any_output_of_the_limiter(slew: float, peak: int, rate: int):
    told, start = compute_device_slew(slew, peak, rate), Start(rate, 1, peak, 1)
    assert PlayoutFormat.from_start(start, 1).step <= told <= NO_SLEW_LIMIT
    assert told >= compute_max_step(slew, rate)


def test_devices_are_listed_or_it_is_said_why_not(monkeypatch: pytest.MonkeyPatch) -> None:
    found = list_devices()
    assert found.all == found.serial + found.audio
    for each in found.all:
        assert parse_target(each.target).text == each.target
        assert each.title
    for module in ("serial", "sounddevice"):
        monkeypatch.setitem(sys.modules, module, None)
    found = list_devices()
    assert found.all == ()
    assert [line.partition(":")[0] for line in found.missing] == ["serial ports", "sound outputs"]
    assert "pip install pyserial" in found.missing[0]
    assert "pip install sounddevice" in found.missing[1]


def test_without_portaudio_the_system_s_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As sounddevice itself says it."""
    (tmp_path / "sounddevice.py").write_text("raise OSError('PortAudio library not found')\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "sounddevice", raising=False)
    (line,) = (line for line in list_devices().missing if line.startswith("sound outputs"))
    assert "PortAudio library not found" in line
    assert "apt install libportaudio2" in line
