"""How many of a thing, in words."""

from __future__ import annotations

from hnf_core.errors import pluralize


def test_one_is_singular() -> None:
    assert (pluralize(1, "stroke"), pluralize(2, "stroke"), pluralize(0, "stroke")) == (
        "1 stroke",
        "2 strokes",
        "0 strokes",
    )
