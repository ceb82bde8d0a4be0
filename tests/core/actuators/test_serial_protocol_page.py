"""docs/serial-protocol.md is what the codec does: every example, every table."""

from __future__ import annotations

import ast
import re
import struct
from pathlib import Path

import pytest

from hnf_core.actuators import serial_protocol
from hnf_core.actuators.serial_protocol import (
    FROM_DEVICE,
    FROM_HOST,
    Credit,
    ErrorCode,
    Message,
    State,
    crc16,
    frames_per_message,
)

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "serial-protocol.md").read_text(encoding="utf-8")
EXAMPLE = re.compile(r"^# (\w+)\((.*)\), sequence (\d+)\n((?:[0-9A-F]{2}[ \n])+)", re.MULTILINE)
SIZES = {"u8": 1, "u16": 2, "u32": 4, "i16": 2, "utf-8": 0, "i16 …": 0}
KINDS = {**FROM_HOST, **FROM_DEVICE}


def example_message(name: str, arguments: str) -> Message:
    call = ast.parse(f"f({arguments})", mode="eval").body
    assert isinstance(call, ast.Call)
    values = {str(word.arg): ast.literal_eval(word.value) for word in call.keywords}
    found: Message = getattr(serial_protocol, name)(**values)
    return found


def section(title: str) -> str:
    return re.split(r"^#{2,3} ", PAGE.split(f" {title}\n", 1)[1], maxsplit=1, flags=re.MULTILINE)[0]


def rows(title: str) -> list[list[str]]:
    """Cells of the tables of a section, without their heads."""
    found = [line.strip("| ").split(" | ") for line in section(title).splitlines() if line.startswith("|")]
    return [row for row in found if not set(row[0]) <= set("-|") and row[0] not in ("offset", "code", "state")]


EXAMPLES = EXAMPLE.findall(PAGE)


@pytest.mark.parametrize(("name", "arguments", "sequence", "listing"), EXAMPLES)
def test_the_example_is_what_the_codec_says(name: str, arguments: str, sequence: str, listing: str) -> None:
    message, data = example_message(name, arguments), bytes.fromhex(listing)
    assert serial_protocol.encode_frame(message, int(sequence)) == data
    kinds = FROM_HOST if message.TYPE < 0x80 else FROM_DEVICE
    assert serial_protocol.Decoder(kinds).feed(data) == [message]


def test_every_message_has_an_example_and_a_section() -> None:
    assert {name for name, *_ in EXAMPLES} == {kind.__name__ for kind in KINDS.values()}
    assert {(kind.__name__.upper(), kind.TYPE) for kind in KINDS.values()} == {
        (name, int(number, 16)) for name, number in re.findall(r"^### (\w+) (0x[0-9A-F]{2})$", PAGE, re.MULTILINE)
    }


@pytest.mark.parametrize("kind", KINDS.values(), ids=lambda kind: kind.__name__)
def test_the_offsets_are_those_of_the_codec(kind: type[Message]) -> None:
    table = [row for row in rows(f"{kind.__name__.upper()} 0x{kind.TYPE:02X}") if row[1] in SIZES]
    layout = getattr(kind, "LAYOUT", None) or getattr(kind, "HEAD", struct.Struct("<B"))
    at = 0
    letters = ""
    for offset, form, *_ in table:
        assert int(offset) == at
        at += SIZES[form]
        letters += {"u8": "B", "u16": "H", "u32": "I", "i16": "h"}.get(form, "")
    assert letters == layout.format.strip("<")
    assert at == layout.size == kind.SIZES[0]


def test_the_codes_and_states_are_those_of_the_codec() -> None:
    codes = {int(row[0]): row[1] for row in rows("ERROR 0x85") if row[0].isdigit() and row[1].isupper()}
    assert codes == {code.value: code.name for code in ErrorCode}
    states = {int(row[0]): row[1] for row in rows("The device") if row[0].isdigit()}
    assert states == {state.value: state.name for state in State}


def test_the_arithmetic_of_credit_is_that_of_the_codec() -> None:
    table = [[int(cell) for cell in row] for row in rows("Flow control") if row[0].isdigit()]
    assert len(table) >= 5
    for sent, played, queue, room in table:
        assert Credit(1, played, queue, 0, State.PLAYING).compute_sendable_frames(sent) == room


def test_the_bandwidths_are_right() -> None:
    table = [row for row in rows("Is the line fast enough?") if row[0].isdigit()]
    assert len(table) >= 7
    for cells in table:
        channels, rate, count, per_second, baud, line = map(int, cells[:6])
        assert count <= frames_per_message(channels)
        bytes_each = serial_protocol.FRAME_OVERHEAD_BYTES + 6 + 2 * channels * count
        assert per_second == round(rate / count * bytes_each)
        assert baud == pytest.approx(rate / count * bytes_each * 10, abs=1)
        assert baud < line
        assert cells[6] == f"{100 * baud / line:.1f} %"
    assert frames_per_message(16) == 63


def test_the_words_about_limits_are_right() -> None:
    assert crc16(b"123456789") == 0x29B1 == int(re.findall(r'"123456789"`: (0x\w+)', PAGE)[0], 16)
    longest = {
        side: max(kind.SIZES[1] for kind in kinds.values()) for side, kinds in (("h", FROM_HOST), ("d", FROM_DEVICE))
    }
    assert f"to the device: at most {longest['h']} bytes. Payloads to the host: at most {longest['d']} bytes" in PAGE
