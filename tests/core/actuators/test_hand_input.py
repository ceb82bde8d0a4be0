"""A hand from outside: lines and OSC messages to moves of a live touch."""

from __future__ import annotations

import json
import math
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hnf_core.actuators.hand_input import (
    LOCAL_HOST,
    HandInput,
    Slide,
    Touch,
    parse_input,
    parse_line,
    parse_osc,
    read_lines,
    receive_osc,
)
from hnf_core.cli.main import main
from hnf_core.errors import DeviceError, UsageError

ROOT = Path(__file__).resolve().parents[3]
HNF = [sys.executable, "-c", "import sys; from hnf_core.cli.main import main; sys.exit(main(sys.argv[1:], None))"]
NUMBER = st.floats(-10.0, 10.0)


class Moves:
    """What a live touch with ten materials would be told, within 100 m; and a clock that is set by hand."""

    def __init__(self) -> None:
        self.now_s, self.got, self.problems = 0.0, [], []
        self.hand = HandInput(self, self.problems.append, lambda: self.now_s)

    def move(self, time_s, position_m, force_n, material=0) -> bool:
        is_taken = force_n >= 0.0 and material < 10 and max(map(abs, position_m)) <= 100.0
        if is_taken:
            self.got.append((time_s, position_m, force_n, material))
        return is_taken


@given(NUMBER, NUMBER, st.floats(0.0, 20.0), st.integers(0, 9), st.sampled_from([" ", ", ", ";", "\t"]))
def test_numbers_json_and_osc_say_the_same(x, y, force, material, separator):
    told = Touch(x, y, force, material)
    assert parse_line(separator.join(map(repr, (x, y, force, material))) + "  # a place") == told
    assert parse_line(json.dumps({"x": x, "y": y, "force": force, "material": material})) == told
    assert parse_osc("/hnf/touch", [x, y, force, material]) == told
    slide = Slide(x, force, y, material)
    assert parse_line(json.dumps({"speed": x, "force": force, "angle": y, "material": material})) == slide
    assert parse_osc("/hnf/slide", [x, force, y, material]) == slide


@given(st.text(max_size=40) | st.recursive(st.none() | st.booleans() | st.floats() | st.text(max_size=3), st.lists).map(
    lambda value: json.dumps({"x": value, "y": 0, "force": 1, "speed": value} if value else {"x": value})
))  # fmt: skip
def test_any_line_is_taken_or_refused(line):
    moves = Moves()
    moves.hand.take_line(line)
    assert len(moves.got) + moves.hand.refused <= 1
    assert len(moves.problems) == moves.hand.refused
    for _, position, force, _ in moves.got:
        assert all(map(math.isfinite, (*position, force)))


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("1 2", "x, y, force"), ("1 2 nan", "'nan' is no number"), ("1 2 three", "'three' is no number"),
        ('{"x": 1, "force": 2}', "'y' is missing"), ("{1", "no JSON object"), ("1 2 3 0.5", "number of a material"),
        ("1 2 3 10", "no such material"), ("1 2 -3", "none of a hand"), ("1e9 2 3", "none of a hand"),
        ('{"speed": 1e308, "force": 1}', "none of a hand"),
        ('{"speed": 1, "force": 1, "material": 10}', "no such material"),
        ('{"speed": 0.1}', "'force' is missing"), ('{"speed": true, "force": 1}', "True is no number"),
    ],
)  # fmt: skip
def test_the_first_refused_line_is_told(line, said):
    moves = Moves()
    moves.hand.take_line(line)
    moves.hand.take_line(line)
    assert moves.hand.refused == 2
    assert len(moves.problems) == 1
    assert said in moves.problems[0]
    assert line[:40] in moves.problems[0]


def test_a_slide_goes_on_until_it_is_told_otherwise():
    moves = Moves()
    moves.hand.take_line("0.01 0.02 1")
    moves.hand.take_osc("/hnf/slide", 0.1, 2.0, math.pi / 2)
    for step in range(1, 101):
        moves.now_s = 0.005 * step
        moves.hand.advance()
    time_s, (x, y), force, _ = moves.got[-1]
    assert (time_s, force) == (0.5, 2.0)
    assert x == pytest.approx(0.01)
    assert y == pytest.approx(0.02 + 0.05)
    moves.hand.take_osc("/hnf/lift")
    moves.now_s = 1.0
    moves.hand.advance()
    assert moves.got[-1][0] == 0.5
    assert moves.got[-1][2] == 0.0


def test_a_slide_ends_where_no_surface_can_be():
    moves = Moves()
    moves.hand.take_osc("/hnf/slide", 50.0, 2.0)
    for step in range(1, 1001):
        moves.now_s = 0.005 * step
        moves.hand.advance()
    assert moves.hand.refused == 0
    assert 99.0 < moves.got[-1][1][0] <= 100.0
    moves.hand.take_osc("/hnf/slide", -1.0, 2.0)
    moves.now_s += 1.0
    moves.hand.advance()
    assert moves.got[-1][1][0] < 99.5


def test_osc_comes_through_a_real_socket():
    client = pytest.importorskip("pythonosc.udp_client")
    moves = Moves()
    with receive_osc(moves.hand, LOCAL_HOST, 0) as port:
        sender = client.SimpleUDPClient(LOCAL_HOST, port)
        until = time.monotonic() + 10.0
        while len(moves.got) < 3 and time.monotonic() < until:
            sender.send_message("/hnf/touch", [0.5, 0.25, 1.5, 1])
            sender.send_message("/other", "word")
            time.sleep(0.01)
        assert moves.got[0][1:] == ((0.5, 0.25), 1.5, 1)
        assert len(moves.problems) == 1
        with pytest.raises(DeviceError, match="cannot be received"), receive_osc(moves.hand, LOCAL_HOST, port):
            pass


def test_the_end_of_the_lines_lifts():
    moves, ended = Moves(), []
    with read_lines(moves.hand, ["0 0 1\n", "\n", "0.1 0 1\n"], lambda: ended.append(True)):
        until = time.monotonic() + 10.0
        while not ended and time.monotonic() < until:
            time.sleep(0.005)
    assert [force for _, _, force, _ in moves.got] == [1.0, 1.0, 0.0]


def test_inputs_are_told_apart():
    assert parse_input("-") is None
    assert parse_input("osc:9000") == (LOCAL_HOST, 9000)
    assert parse_input("osc:0.0.0.0:9000") == ("0.0.0.0", 9000)
    for wrong in ("", "osc", "osc:", "osc:0", "osc:70000", "udp:9000", "osc:a:b"):
        with pytest.raises(UsageError, match="is no input"):
            parse_input(wrong)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "nothing to play"), (("--input", "-"), "needs something to touch"),
        (("--material", "denim"), "--material goes with --input"),
        (("a.wav", "--input", "-", "--material", "denim"), "plays no WAV"),
        (("--input", "serial:1", "--material", "denim"), "is no input"),
        (("--input", "-", "--material", "nobody-knows-it"), "no library material"),
    ],
)  # fmt: skip
def test_what_does_not_fit_together_is_told(words, said, capsys):
    assert main(["stream", "--to", "virtual", *words], lambda _: 0) != 0
    assert said in capsys.readouterr().err


def test_lines_of_another_program_are_felt():
    words = ["stream", "--input", "-", "--material", "sandpaper", "--material", "denim", "--to", "virtual"]
    process = subprocess.Popen(
        [*HNF, *words], cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdin is not None
    assert process.stdout is not None
    assert process.stderr is not None
    assert process.stdout.readline() == "sandpaper, denim under standard input\n"
    for step in range(60):
        print(0.001 * step, 0.0, 1.0, step // 30, file=process.stdin, flush=True)
        time.sleep(0.01)
    print("nothing", file=process.stdin, flush=True)
    process.stdin.close()
    report, told = process.stdout.read(), process.stderr.read()
    assert process.wait(timeout=60) == 0
    assert "60 messages, 1 refused" in report
    found = re.search(r"peak (\d+)% of full scale", report)
    assert found is not None
    assert int(found[1]) > 0
    assert "'nothing' was left out" in told


def test_it_ends_while_standard_input_stays_open():
    words = ["stream", "--input", "-", "--material", "denim", "--to", "virtual", "--seconds", "0.3"]
    with subprocess.Popen(
        [*HNF, *words], cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stderr is not None
        assert process.wait(timeout=60) == 0, process.stderr.read()
