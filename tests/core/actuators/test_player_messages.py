"""Lines to and from the player: what is said is what is read, and nothing else is."""

from __future__ import annotations

import json
from contextlib import suppress
from typing import get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hnf_core.actuators.player_messages import (
    Command,
    Move,
    OutputSpec,
    Play,
    Report,
    Status,
    decode_command,
    decode_report,
    encode,
)
from hnf_core.errors import UsageError

finite = st.floats(allow_nan=False, allow_infinity=False)
st.register_type_strategy(float, finite)
commands = st.one_of(*(st.from_type(kind) for kind in get_args(Command)))
reports = st.one_of(*(st.from_type(kind) for kind in get_args(Report)))


@given(commands)
def test_a_command_is_read_as_it_was_said(command: Command) -> None:
    line = encode(command)
    assert "\n" not in line
    assert decode_command(line) == command


@given(reports)
def test_a_report_is_read_as_it_was_said(report: Report) -> None:
    assert decode_report(encode(report)) == report


@given(commands, reports)
def test_commands_are_no_reports(command: Command, report: Report) -> None:
    with pytest.raises(UsageError):
        decode_report(encode(command))
    with pytest.raises(UsageError):
        decode_command(encode(report))


PLAY = json.loads(encode(Play(1, "x.wav", OutputSpec("virtual", "own", (0.0, 20.0, 500.0)))))


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({**PLAY, "volume": 3}, "no field 'volume'"),
        ({key: value for key, value in PLAY.items() if key != "file"}, "needs 'file'"),
        ({**PLAY, "loop": 1}, "Play.loop is no bool"),
        ({**PLAY, "play": 1.0}, "Play.play is no int"),
        ({**PLAY, "play": True}, "Play.play is no int"),
        ({**PLAY, "gain_db": "3"}, "Play.gain_db is no float"),
        ({**PLAY, "where": "virtual"}, "Play.where is no OutputSpec"),
        ({**PLAY, "where": {"target": "virtual"}}, "OutputSpec needs 'profile'"),
        ({**PLAY, "where": {**PLAY["where"], "own": [1, "x"]}}, "OutputSpec.own is no float"),
        ({**PLAY, "is": "play"}, '"is" is none of Play'),
        ({**PLAY, "is": ["Play"]}, '"is" is none of'),
        ([], "no object"),
        (None, "no object"),
    ],
)
def test_what_is_not_right_is_refused_in_one_line(changed: object, why: str) -> None:
    with pytest.raises(UsageError) as problem:
        decode_command(json.dumps(changed))
    assert why in str(problem.value)
    assert "\n" not in str(problem.value)


@pytest.mark.parametrize(
    "line", ["", "{", "{}", '{"is":"Seek","position_s":NaN}', '{"is":"Seek","position_s":1e999}', "[" * 100_000]
)
def test_what_is_no_json_or_no_number_is_refused(line: str) -> None:
    with pytest.raises(UsageError, match="cannot be read"):
        decode_command(line)


@given(st.text(max_size=200))
def test_any_text_is_read_or_refused(text: str) -> None:
    with suppress(UsageError):
        decode_command(text)


def test_whole_numbers_do_for_real_ones_and_none_where_it_may_be() -> None:
    assert decode_command('{"is":"Move","time_s":1,"x_m":0,"y_m":0,"force_n":2}') == Move(1.0, 0.0, 0.0, 2.0)
    status = Status(1, "playing", 0.0, 0.0, 0.0, 0, 0, 0, 0.0, 0.0, None, "")
    assert decode_report(encode(status)) == status
