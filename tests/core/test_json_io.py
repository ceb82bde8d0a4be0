"""Dataclasses come back from their JSON; what is incomplete, unknown or of another type is refused."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hnf_core.json_io import encode_json, load_json, parse_record


@dataclass(frozen=True)
class Point:
    x_m: float
    name: str = ""


@dataclass(frozen=True)
class Path:
    points: tuple[Point, ...]
    closed: bool = False
    start: int | None = None


NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
POINTS = st.builds(Point, NUMBERS, st.text())
PATHS = st.builds(Path, st.lists(POINTS, max_size=3).map(tuple), st.booleans(), st.none() | st.integers())


@given(PATHS, st.booleans())
def test_a_record_comes_back(path: Path, complete: bool) -> None:
    assert parse_record(Path, load_json(encode_json(path)), complete=complete) == path


def test_fields_with_a_default_may_lack_unless_all_are_required() -> None:
    assert parse_record(Path, {"points": [{"x_m": 1}]}) == Path((Point(1.0),))
    for values in ({"points": []}, {"points": [{"x_m": 1}], "closed": False, "start": None}):
        with pytest.raises(ValueError, match="needs"):
            parse_record(Path, values, complete=True)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[]", "Path is no object"),
        ("{}", "needs 'points'"),
        ('{"points":[],"more":1}', "no field 'more'"),
        ('{"points":[{"x_m":"1"}]}', "Point.x_m is no float"),
        ('{"points":[{"x_m":true}]}', "Point.x_m is no float"),
        ('{"points":[],"closed":1}', "Path.closed is no bool"),
        ('{"points":[{"x_m":1e999}]}', "not finite"),
        ('{"points":[{"x_m":NaN}]}', "NaN is no number"),
    ],
)
def test_anything_else_is_refused_by_name(text: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        parse_record(Path, load_json(text))
