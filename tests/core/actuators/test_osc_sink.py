"""Envelopes over OSC, received by a real UDP socket."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from osc_receiver import receiver

from hnf_core.actuators.sinks.osc import RATE_HZ, SILENCE_SLOTS, SLOT_S, OscSink, compute_amplitude, compute_centroid_hz
from hnf_core.errors import DeviceError

pytest.importorskip("pythonosc", reason="python-osc is not installed")

LOUD, PITCH = "/hnf/1/amplitude", "/hnf/1/frequency"


def sine(share: float, hz: float, seconds: float) -> NDArray[np.int16]:
    time_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    return np.rint(share * 32767 * np.sin(2 * np.pi * hz * time_s)).astype(np.int16)[:, None]


def play(sink: OscSink, counts: NDArray[np.int16]) -> None:
    at = 0
    while at < len(counts):
        room = sink.wait(0.5)
        sink.write(counts[at : at + room])
        at += room


@given(st.floats(0.01, 1.0), st.floats(100.0, 1000.0))
def test_a_sine_has_its_own_amplitude_and_frequency(share: float, hz: float) -> None:
    counts = sine(share, hz, 0.02)
    assert compute_amplitude(counts)[0] == pytest.approx(share, rel=0.08)
    assert compute_centroid_hz(counts, RATE_HZ)[0] == pytest.approx(hz, abs=3.0)


@given(st.lists(st.integers(-32767, 32767), min_size=2, max_size=80), st.integers(-32767, 32767))
def test_an_envelope_is_a_share_and_no_pitch_is_no_number(values: list[int], level: int) -> None:
    counts = np.array(values, dtype=np.int16)[:, None]
    assert 0.0 <= compute_amplitude(counts)[0] <= 1.0
    found = compute_centroid_hz(counts, RATE_HZ)[0]
    assert np.isnan(found) or 0.0 <= found <= RATE_HZ / 2
    assert np.isnan(compute_centroid_hz(np.full((80, 1), level, np.int16), RATE_HZ)[0])


def test_osc_sends_one_message_per_slot_and_silence_at_the_end() -> None:
    with receiver() as ear:
        sink = OscSink("127.0.0.1", ear.port)
        form = sink.open()
        assert form.queue_frames <= 0.015 * form.rate_hz
        counts = np.concatenate([sine(0.5, 200.0, 0.4), sine(0.25, 400.0, 0.4)])
        play(sink, counts)
        sink.finish(2.0)
        assert sink.status().played == len(counts)
        ear.wait_for(80 + SILENCE_SLOTS, LOUD)
        sink.close()
        ear.settled()
        loud, pitch = ear.values(LOUD), ear.values(PITCH)
    steady = loud[4:36], pitch[4:36], loud[44:76], pitch[44:76]
    underruns = sink.status().underruns
    if underruns == 0:  # each slot is where it belongs
        assert steady[0] == pytest.approx([0.5] * 32, rel=0.01)
        assert steady[1] == pytest.approx([200.0] * 32, abs=2.0)
        assert steady[2] == pytest.approx([0.25] * 32, rel=0.01)
        assert steady[3] == pytest.approx([400.0] * 32, abs=2.0)
        assert sum(value > 0.0 for value in loud) == pytest.approx(0.8 / SLOT_S, abs=1)
    assert max(loud) <= 0.51
    assert loud[-SILENCE_SLOTS:] == [0.0] * SILENCE_SLOTS
    assert len(loud) == len(pitch)


def test_stop_is_a_half_and_then_nothing() -> None:
    with receiver() as ear:
        sink = OscSink("localhost", ear.port, "/avatar/parameters/hnf")
        sink.open()
        play(sink, sine(0.8, 250.0, 0.2))
        before = len(ear.values("/avatar/parameters/hnf/1/amplitude"))
        sink.stop()
        sink.close()
        ear.settled()
        loud = ear.values("/avatar/parameters/hnf/1/amplitude")
        assert before >= 10
        ending = next(at for at, value in enumerate(loud) if at >= before and value < 0.5)
        assert loud[ending] == pytest.approx(0.4, rel=0.05)
        assert loud[ending + 1 :] == [0.0] * len(loud[ending + 1 :])
        assert len(loud) - ending > SILENCE_SLOTS


def test_who_falls_silent_is_told_as_silent() -> None:
    """Nobody calls any more: the sender's own clock goes on, what is owed sounds, then zeros come."""
    with receiver() as ear:
        sink = OscSink("127.0.0.1", ear.port)
        sink.open()
        play(sink, sine(0.8, 250.0, 0.2))
        ear.wait_for(20 + SILENCE_SLOTS // 2, LOUD)
        ear.settled()
        loud = ear.values(LOUD)
        # Each underrun, of a busy machine too, costs a fade and splits a slot.
        assert sum(value > 0.0 for value in loud) * SLOT_S <= 0.2 + 0.02 + 0.01 * sink.status().underruns
        assert loud[-SILENCE_SLOTS:] == [0.0] * SILENCE_SLOTS
        assert sink.status().underruns >= 1
        play(sink, sine(0.3, 250.0, 0.1))
        sink.finish(1.0)
        sink.close()
        assert max(ear.values(LOUD)[len(loud) :]) == pytest.approx(0.3, abs=0.02)


def test_every_channel_has_its_address() -> None:
    with receiver() as ear:
        sink = OscSink("127.0.0.1", ear.port, channels=2)
        sink.open()
        play(sink, np.concatenate([sine(0.5, 200.0, 0.2), sine(0.1, 400.0, 0.2)], axis=1))
        sink.finish(1.0)
        sink.close()
        ear.settled()
        assert max(ear.values("/hnf/1/amplitude")) == pytest.approx(0.5, rel=0.05)
        assert max(ear.values("/hnf/2/amplitude")) == pytest.approx(0.1, rel=0.05)
        assert {name for _, name, _ in ear.got} == {
            f"/hnf/{c}/{what}" for c in (1, 2) for what in ("amplitude", "frequency")
        }


def test_a_closed_sink_says_so_and_opens_again() -> None:
    with receiver() as ear:
        sink = OscSink("127.0.0.1", ear.port)
        for _ in range(2):
            sink.open()
            play(sink, sine(0.5, 100.0, 0.05))
            sink.close()
            sink.close()
            with pytest.raises(DeviceError, match="closed"):
                sink.wait(0.0)
            ear.settled()
            assert ear.values(LOUD)[-SILENCE_SLOTS:] == [0.0] * SILENCE_SLOTS  # a lost datagram is not for ever


def test_what_cannot_be_reached_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(DeviceError, match=r"OSC receiver no\.such\.host\.invalid:9000: cannot be reached"):
        OscSink("no.such.host.invalid", 9000).open()
    sink = OscSink("255.255.255.255", 9000)  # may not be sent to without asking for it
    sink.open()
    with pytest.raises(DeviceError, match="cannot be reached any more"):
        play(sink, sine(0.5, 100.0, 5.0))
    sink.close()
    monkeypatch.setitem(sys.modules, "pythonosc.udp_client", None)
    with pytest.raises(DeviceError, match="pip install python-osc"):
        OscSink("127.0.0.1", 9000).open()


def test_any_fault_of_the_sender_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    with receiver() as got:
        sink = OscSink("127.0.0.1", got.port)
        sink.open()
        monkeypatch.setattr(sink, "_send_levels", lambda level, pitch: [][0])
        with pytest.raises(DeviceError, match="index out of range"):
            play(sink, sine(0.5, 100.0, 5.0))
        sink.close()
