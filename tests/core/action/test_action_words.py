"""Action words: what is said is what is stroked; what cannot be meant is refused by name."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hnf_core.action.parse_stroke import FORCE_LIMITS_N, SPEED_LIMITS_M_S, parse_stroke
from hnf_core.action.primitive_path import make_primitive_action
from hnf_core.action.primitives import PRIMITIVE_NAMES, PRIMITIVES
from hnf_core.errors import UsageError

DIAGONAL = 2**-0.5
DIRECTIONS = {
    "left to right": (1.0, 0.0),
    "right to left": (-1.0, 0.0),
    "top to bottom": (0.0, -1.0),
    "bottom to top": (0.0, 1.0),
    "top left to bottom right": (DIAGONAL, -DIAGONAL),
    "bottom right to top left": (-DIAGONAL, DIAGONAL),
    "bottom left to top right": (DIAGONAL, DIAGONAL),
    "top right to bottom left": (-DIAGONAL, -DIAGONAL),
}
FORCES = {"soft": 0.5, "gently": 0.5, "medium": 1.0, "hard": 2.0, "firm": 2.0, "1.5 N": 1.5, "300 mN": 0.3}
SPEEDS = {"slow": 0.04, "fast": 0.15, "80 mm/s": 0.08, "0.1 m/s": 0.1, "7 cm/s": 0.07, "20 mm per second": 0.02}
SCRAPES = ("scrape", "stroke", "drag", "Sliding", "wipes", "dragging")


@pytest.mark.parametrize("name", PRIMITIVE_NAMES)
def test_the_eight_names_are_themselves(name):
    assert parse_stroke(name) is PRIMITIVES[name]
    assert parse_stroke(f" {name.upper().replace('-', ' ')},") is PRIMITIVES[name]


@pytest.mark.parametrize(
    ("words", "name"),
    [
        ("scrape left to right, hard", "left-right-hard"),
        ("Gently, from left to right", "left-right-soft"),
        ("drag top to bottom with a light hand", "top-bottom-soft"),
        ("scrape down, firmly", "top-bottom-hard"),
        ("diagonal scrape, hard", "diagonal-hard"),
        ("soft, from top left to the bottom right", "diagonal-soft"),
        ("random rub fast", "rub-fast"),
        ("rub slowly", "rub-slow"),
        ("scrape left → right with 2 N at 100 mm/s", "left-right-hard"),
    ],
)
def test_words_for_one_of_the_eight_are_that_one(words, name):
    assert parse_stroke(words) is PRIMITIVES[name]


parts = st.tuples(st.sampled_from(SCRAPES), *(st.sampled_from(sorted(each)) for each in (DIRECTIONS, FORCES, SPEEDS)))


@given(parts, st.permutations(range(4)), st.sampled_from([", ", " ", " and ", "; "]), st.booleans())
def test_order_case_and_commas_do_not_matter(said, order, between, loud):
    _, direction, force, speed = said
    words = between.join(said[index] for index in order)
    primitive = parse_stroke(words.upper() if loud else words)
    assert primitive == parse_stroke(", ".join(said))
    assert (primitive.kind, primitive.direction) == ("scrape", DIRECTIONS[direction])
    assert (primitive.force, primitive.speed) == (FORCES[force], SPEEDS[speed])


numbers = st.tuples(st.floats(*FORCE_LIMITS_N), st.floats(*SPEED_LIMITS_M_S), st.floats(-360.0, 360.0))


@given(
    numbers, st.sampled_from(["N", "mN", " newtons"]), st.sampled_from(["m/s", "cm/s", " mm/s", " metres per second"]),
    st.sampled_from([".12f", ".12e"]),
)  # fmt: skip
def test_numbers_and_units_are_what_they_say(values, force_unit, speed_unit, form):
    force, speed, angle = values
    per_n = 1e3 if "mN" in force_unit else 1.0
    per_m = {"m/s": 1.0, "cm/s": 1e2, " mm/s": 1e3, " metres per second": 1.0}[speed_unit]
    words = f"scrape {force * per_n:{form}}{force_unit}, {speed * per_m:{form}}{speed_unit}, {angle:.9f}°"
    primitive = parse_stroke(words)
    assert primitive.force == pytest.approx(force, rel=1e-8)
    assert primitive.speed == pytest.approx(speed, rel=1e-8)
    turned = np.radians(angle)
    np.testing.assert_allclose(primitive.direction, [np.cos(turned), np.sin(turned)], atol=1e-7)


@given(numbers, st.sampled_from([*DIRECTIONS, "rub", "angle"]))
def test_a_name_is_plain_and_means_the_same_stroke(values, motion):
    force, speed, angle = values
    motion = f"{angle:.9f} degrees" if motion == "angle" else motion
    primitive = parse_stroke(f"{motion}, {force:.12f} N, {speed:.12f} m/s")
    assert parse_stroke(primitive.name) == primitive
    assert set(primitive.name) <= set("abcdefghijklmnopqrstuvwxyz0123456789.-")


@pytest.mark.parametrize(
    ("words", "direction"),
    [
        ("slide up", (0, 1)),
        ("to the right", (1, 0)),
        ("from the right", (-1, 0)),
        ("drag leftwards", (-1, 0)),
        ("pull towards bottom", (0, -1)),
        ("top down", (0, -1)),
        ("down and left", (-DIAGONAL, -DIAGONAL)),
        ("diagonal, left to right", (DIAGONAL, -DIAGONAL)),
        ("diagonally up", (DIAGONAL, DIAGONAL)),
        ("top left to bottom left", (0, -1)),
        ("scrape", (1, 0)),
        ("scrape 270 degrees", (0, -1)),
        ("scrape, -90°", (0, -1)),
    ],
)
def test_directions(words, direction):
    primitive = parse_stroke(words)
    assert primitive.direction == pytest.approx(direction)
    np.testing.assert_allclose(make_primitive_action(primitive).direction, np.tile(direction, (161, 1)), atol=1e-12)


@pytest.mark.parametrize(
    ("words", "said", "remedy"),
    [
        ("scrap left to right", "the word 'scrap' is unknown", "Did you mean 'scrape'"),
        ("scrape left to rigth", "the word 'rigth' is unknown", "Did you mean 'right'"),
        ("scrape, hrad", "the word 'hrad' is unknown", "'hard'"),
        ("xylophone", "the word 'xylophone' is unknown", "Choose one of left-right-soft"),
        ("default", "the word 'default' is unknown", ""),
        ("scrape hard, soft", "'hard' and 'soft' contradict each other", "Give one force"),
        ("scrape hard, 1.5 N", "'1.5 N' and 'hard' contradict each other", "Give one force"),
        ("scrape fast, 80 mm/s", "'80 mm/s' and 'fast' contradict each other", "Give one speed"),
        ("scrape and rub", "'scrape' and 'rub' contradict each other", "Give one kind of motion"),
        ("random scrape", "'random' and 'scrape' contradict each other", "Give one kind of motion"),
        ("random rub left to right", "a rub goes every way, 'left to right' only one", "Say scrape"),
        ("random rub, 30 degrees", "a rub goes every way, '30 degrees' only one", "Say scrape"),
        ("scrape up and to the bottom", "'up' and 'bottom' contradict each other", "Give one direction"),
        ("left right left", "contradict each other", "Give one direction"),
        ("left to right, 30 degrees", "'30 degrees' and 'left to right' contradict each other", "Give one direction"),
        ("left to left", "'left to left' goes nowhere", ""),
        ("left to top", "'left' has no other side", "Name both corners"),
        ("top left to right", "'top' has no other side", "Name both corners"),
        ("scrape to", "'to' leads nowhere", ""),
        ("and", "it says no motion", "Begin with scrape or rub"),
        ("", "it says no motion", ""),
        ("scrape 80", "'80' has no unit", "Write 1.5 N"),
        ("scrape 1,5 N", "'1' has no unit", "decimal point"),
        ("scrape 2 kN", "'2' has no unit", ""),
        ("scrape -1 N", "'-1 N' is negative", "Give a positive force"),
        ("scrape 0 N", "0 N is no stroke", "Give 0.01 to 20 N"),
        ("scrape 1e-6 N", "1e-06 N is no stroke", "Give 0.01 to 20 N"),
        ("scrape 40 N", "40 N is no stroke", "Give 0.01 to 20 N"),
        ("scrape 3 m/s", "3 m/s is no stroke", "Give 0.001 to 1 m/s"),
        ("scrape " + "9" * 400 + " degrees", "is no number of a stroke", ""),
    ],
)
def test_what_cannot_be_meant_is_refused(words, said, remedy):
    with pytest.raises(UsageError) as refused:
        parse_stroke(words)
    assert said in refused.value.what
    assert remedy in refused.value.remedy


HEAP = "scrape rub left right top bottom up down to from and diagonal hard soft fast slow 1.5 N 80 mm/s - 30°"


@given(st.text(max_size=40) | st.lists(st.sampled_from(HEAP.split(" ")), max_size=7).map(" ".join))
def test_any_text_is_understood_or_refused(text):
    try:
        primitive = parse_stroke(text)
    except UsageError:
        return
    assert np.hypot(*primitive.direction) == pytest.approx(1.0)
    assert parse_stroke(primitive.name) == primitive


def test_eight_directions_have_eight_names():
    names = [parse_stroke(words).name for words in DIRECTIONS]
    assert len(set(names)) == 8
    for first, second in itertools.combinations(DIRECTIONS, 2):
        assert parse_stroke(first).direction != parse_stroke(second).direction
