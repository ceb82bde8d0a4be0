"""The Arduino sketch of tools/firmware, built for each of its boards on this machine, with a made-up core."""

from __future__ import annotations

import struct
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from firmware_host import FIRMWARE, STRICT, find_sanitizers
from test_firmware_sources import compiler

from hnf_core.actuators.serial_protocol import (
    FROM_DEVICE,
    Bye,
    Caps,
    Credit,
    Decoder,
    Hello,
    Message,
    Samples,
    Start,
    State,
    encode_frame,
)

SKETCH = FIRMWARE / "arduino" / "hnf_arduino.ino"
CORE = """#pragma once
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <deque>
#include <map>
enum { LOW = 0, HIGH = 1, OUTPUT = 1 };
static std::map<int, uint32_t> pins;
static void (*isr)(void);
static uint32_t now_us;
static inline void pinMode(uint8_t, uint8_t) {}
static inline void digitalWrite(uint8_t pin, uint8_t value) { pins[pin] = value; }
static inline uint32_t micros(void) { return now_us; }
static struct Line {
    std::deque<uint8_t> in, out;
    void begin(uint32_t) {}
    size_t setRxBufferSize(size_t size) { return size; }
    size_t setTxBufferSize(size_t size) { return size; }
    int available(void) { return (int)in.size(); }
    int read(void) { int byte = in.front(); in.pop_front(); return byte; }
    int availableForWrite(void) { return 128; }
    size_t write(const uint8_t *bytes, size_t count) { out.insert(out.end(), bytes, bytes + count); return count; }
    operator bool() { return true; }
} Serial;
"""
BOARDS = {
    "ESP32": """struct hw_timer_t { uint32_t hz; uint64_t ticks; };
static inline hw_timer_t *timerBegin(uint32_t hz) { static hw_timer_t timer; timer.hz = hz; return &timer; }
static inline void timerAttachInterrupt(hw_timer_t *, void (*handle)(void)) { isr = handle; }
static inline void timerAlarm(hw_timer_t *timer, uint64_t ticks, bool, uint64_t) { timer->ticks = ticks; }
static inline bool ledcAttach(uint8_t, uint32_t, uint8_t) { return true; }
static inline bool ledcWrite(uint8_t pin, uint32_t duty) { pins[pin] = duty; return true; }
enum { LEFT = 25, RIGHT = 26, ENABLE = 27 };
""",
    "TEENSYDUINO": """struct IntervalTimer {
    bool begin(void (*handle)(void), float) { isr = handle; return true; }
    void end(void) { isr = nullptr; }
};
static inline void analogWriteResolution(uint32_t) {}
static inline void analogWriteFrequency(uint8_t, float) {}
static inline void analogWrite(uint8_t pin, int duty) { pins[pin] = (uint32_t)duty; }
enum { LEFT = 2, RIGHT = 3, ENABLE = 4 };
""",
}
"""What the sketch uses of the cores, copied by hand from their headers."""
MAIN = """
int main(void)
{
    struct { uint32_t ticks, count; } request;
    setup();
    while (fread(&request, sizeof request, 1, stdin) == 1) {
        while (request.count-- > 0) Serial.in.push_back((uint8_t)getchar());
        do loop(); while (Serial.available() > 0);
        for (uint32_t i = 0; i < request.ticks; i++) {
            if (isr) isr();
            now_us += 100;
            uint32_t levels[3] = { pins[LEFT], pins[RIGHT], pins[ENABLE] };
            fwrite(levels, sizeof levels, 1, stdout);
            loop();
        }
        uint32_t count = (uint32_t)Serial.out.size();
        fwrite(&count, sizeof count, 1, stdout);
        for (uint8_t byte : Serial.out) putchar(byte);
        Serial.out.clear();
        fflush(stdout);
    }
}
"""


class Board:
    """The sketch in a process: bytes in, ticks of its sample clock, then the levels of its pins and messages."""

    def __init__(self, program: Path) -> None:
        self._process = subprocess.Popen(
            [program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )
        self._decoder, self._sequence = Decoder(FROM_DEVICE), 0

    def __call__(self, *messages: Message, ticks: int = 0) -> tuple[np.ndarray, list[Message]]:
        data = b""
        for message in messages:
            data += encode_frame(message, self._sequence % 256)
            self._sequence += 1
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(struct.pack("=II", ticks, len(data)) + data)
        self._process.stdin.flush()
        levels = np.frombuffer(self._process.stdout.read(12 * ticks), np.uint32).reshape(ticks, 3)
        (count,) = struct.unpack("=I", self._process.stdout.read(4))
        return levels, list(self._decoder.feed(self._process.stdout.read(count)))

    def end(self) -> str:
        _, said = self._process.communicate(timeout=30)
        return said.decode()


@pytest.fixture(scope="module", params=sorted(BOARDS))
def program(request, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp(request.param)
    (folder / "Arduino.h").write_text(CORE + BOARDS[request.param], encoding="utf-8")
    (folder / "sketch.cpp").write_text(SKETCH.read_text(encoding="utf-8") + MAIN, encoding="utf-8")
    objects, sanitizers = [], find_sanitizers(compiler("cc"), folder)
    for source in sorted(FIRMWARE.glob("hnf_*.c")):
        objects.append(folder / f"{source.stem}.o")
        order = [compiler("cc"), *STRICT, *sanitizers, "-c", str(source), "-o", str(objects[-1])]
        done = subprocess.run(order, capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, done.stderr
    # As Arduino's builders have it: C++17, with warnings, and the core's headers first.
    order = [compiler("c++"), "-std=gnu++17", "-Wall", "-Wextra", "-Werror", "-g", *sanitizers, f"-D{request.param}"]
    order += [f"-I{folder}", f"-I{FIRMWARE}", str(folder / "sketch.cpp"), *map(str, objects)]
    done = subprocess.run([*order, "-o", str(folder / "sketch")], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return folder / "sketch"


@pytest.fixture
def board(program) -> Iterator[Board]:
    found = Board(program)
    yield found
    assert found.end() == ""


def to_level(count: int) -> int:
    return (count + 32768) >> 6


def test_it_rests_and_says_what_it_can(board) -> None:
    levels, answers = board(Hello(1, 1))
    assert len(levels) == 0
    (caps,) = [each for each in answers if isinstance(each, Caps)]
    assert (caps.channels, caps.bits, caps.highest_hz) == (2, 10, 16000)
    levels, _ = board(ticks=3)
    assert (levels[:, :2] == to_level(0)).all()
    assert (levels[:, 2] == 0).all()


def test_what_is_sent_is_on_the_pins_and_then_silence(board) -> None:
    board(Hello(1, 1))
    _, answers = board(Start(rate_hz=10_000, channels=2, peak=32767, slew=65535, queue=0, session=7))
    credit = next(each for each in answers if isinstance(each, Credit))
    assert credit.queue == 150
    sent = np.random.default_rng(0).integers(-32767, 32768, (150, 2)).astype("<i2")
    levels, answers = board(Samples(7, 0, sent.tobytes()), ticks=150)
    first = int(np.flatnonzero((levels[:, :2] != to_level(0)).any(axis=1))[0])
    assert first <= 1
    expected = (sent.astype(np.int32)[: 150 - first] + 32768) >> 6
    assert (levels[first:, :2] == expected).all()
    assert (levels[:, 2] == 1).all()
    assert any(isinstance(each, Credit) and each.state == State.PLAYING for each in answers)
    levels, _ = board(ticks=60)
    assert (levels[-1, :2] == to_level(0)).all()
    assert (np.abs(np.diff(levels[:, :2].astype(int), axis=0)) <= 512 // 40 + 1).all()  # 4 ms to silence
    board(Bye())
    levels, _ = board(ticks=50)
    assert (levels[-1] == [to_level(0), to_level(0), 0]).all()


@pytest.mark.parametrize("gcc", ["xtensa-esp32-elf-gcc", "riscv32-esp-elf-gcc", "cc"])
def test_the_core_compiles_for_32_bits(gcc, tmp_path) -> None:
    """The host's compiler, where it knows 32 bits, stands in for those of the boards."""
    (tmp_path / "string.h").write_text(
        "#include <stddef.h>\nvoid *memcpy(void *, const void *, size_t);\n"
        "void *memmove(void *, const void *, size_t);\n"
        "void *memset(void *, int, size_t); size_t strlen(const char *);\n"
    )
    flags = ["-m32", "-ffreestanding", "-fno-builtin"] if gcc == "cc" else []
    probe = [compiler(gcc), *flags, "-xc", "-fsyntax-only", "/dev/null"]
    if subprocess.run(probe, capture_output=True, timeout=60).returncode != 0:
        pytest.skip(f"{gcc} knows no 32 bits here")
    for source in sorted(FIRMWARE.glob("hnf_*.c")):
        order = [compiler(gcc), *STRICT, *flags, f"-isystem{tmp_path}", "-Os", "-c", str(source)]
        done = subprocess.run([*order, "-o", str(tmp_path / "core.o")], capture_output=True, text=True, timeout=60)
        assert done.returncode == 0, done.stderr
