"""What a person probably meant, the nearest first, and nothing that only shares a few letters."""

from __future__ import annotations

import pytest

from hnf_core.action.words import primitive_of
from hnf_core.closest import closest, listed
from hnf_core.errors import MaterialError, UsageError
from hnf_core.material.library import find

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
    assert closest(word, names) == near


def test_a_material_named_by_half_its_name_is_the_first_offer() -> None:
    with pytest.raises(MaterialError, match=r"Did you mean oak-wood"):
        find("Oak")


def test_a_word_that_is_like_none_is_answered_with_what_there_is() -> None:
    with pytest.raises(UsageError, match="Choose one of left-right-soft"):
        primitive_of("tickle")


def test_a_long_list_is_cut_and_says_so() -> None:
    assert listed(["a", "b"]) == "'a', 'b'"
    assert listed(THINGS, 2) == "'Bowl', 'Cushion' and 5 more"
    assert listed([]) == ""
