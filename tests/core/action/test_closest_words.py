"""What a person probably meant, the nearest first, and nothing that only shares a few letters."""

from __future__ import annotations

import pytest

from hnf_core.action.parse_stroke import parse_stroke
from hnf_core.errors import MaterialError, UsageError, close_matches, format_choices
from hnf_core.material.library import get_material

THINGS = ["Bowl", "Cushion", "Lemon", "Notebook", "Table", "Tile", "Tin"]


@pytest.mark.parametrize(
    ("word", "names", "near"),
    [
        ("Cusion", THINGS, ["Cushion"]),
        ("cushion", THINGS, ["Cushion"]),
        ("note", THINGS, ["Notebook"]),
        ("Helmet", ["Hose_low", "LeatherParts_low"], []),
        ("leather", ["Hose_low", "Suede leather", "LeatherParts_low"], ["Suede leather", "LeatherParts_low"]),
        ("oak", ["cork", "oak-wood", "soap"], ["oak-wood"]),
        ("", THINGS, []),
    ],
)
def test_the_nearest_come_first_and_the_rest_not_at_all(word, names, near) -> None:
    assert close_matches(word, names) == near


def test_a_material_named_by_half_its_name_is_the_first_offer() -> None:
    with pytest.raises(MaterialError, match=r"Did you mean oak-wood"):
        get_material("Oak")


def test_a_word_that_is_like_none_is_answered_with_what_there_is() -> None:
    with pytest.raises(UsageError, match="Choose one of left-right-soft"):
        parse_stroke("tickle")


def test_a_long_list_is_cut_and_says_so() -> None:
    assert format_choices(["a", "b"]) == "'a', 'b'"
    assert format_choices(THINGS, 2) == "'Bowl', 'Cushion' and 5 more"
    assert format_choices([]) == ""
