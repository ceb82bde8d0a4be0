"""How many of a thing, in words."""

from __future__ import annotations

from hnf_core.counted import counted


def test_one_is_singular() -> None:
    assert (counted(1, "stroke"), counted(2, "stroke"), counted(0, "stroke")) == ("1 stroke", "2 strokes", "0 strokes")
