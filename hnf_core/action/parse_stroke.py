"""Parser of strokes in words: "scrape left to right, hard" → a primitive.

A small grammar of English. Case, commas, hyphens and the order of the parts do not matter:

verb        scrape, stroke, drag, slide, swipe, … : a straight scrape. rub, or random: a wandering rub
direction   left to right, bottom to top, top left to bottom right, to the right, down, diagonal up, 30 degrees
force       soft, medium, hard, or 1.5 N, 300 mN
speed       slow, fast, or 80 mm/s, 8 cm/s, 0.1 m/s

Defaults: left to right, 1 N, 100 mm/s. Unknown words and contradictions raise UsageError.
"""

from __future__ import annotations

import re

import numpy as np

from ..errors import UsageError
from ..text import close_matches
from .primitives import HARD_N, PRIMITIVES, RUB_N, SCRAPE_SPEED_M_S, SOFT_N, Primitive

_SCRAPE_VERBS = "scrape stroke drag slide swipe wipe brush scratch glide sweep draw pull push"
_RUB_VERBS = "rub random randomly scrub"
_FORCE_WORDS = {
    SOFT_N: "soft softly light lightly gentle gently delicate delicately",
    RUB_N: "medium moderate moderately normal",
    HARD_N: "hard firm firmly strong strongly heavy heavily",
}
_SPEED_WORDS = {
    PRIMITIVES["rub-slow"].speed: "slow slowly",
    PRIMITIVES["rub-fast"].speed: "fast quick quickly rapid rapidly",
}
_SIDES = {"left": (-1, 0), "right": (1, 0), "top": (0, 1), "bottom": (0, -1), "upper": (0, 1), "lower": (0, -1)}
_HEADINGS = {
    **{f"{way}{end}": _SIDES[way] for way in ("left", "right") for end in ("ward", "wards")},
    **dict.fromkeys(("up", "upward", "upwards"), (0, 1)),
    **dict.fromkeys(("down", "downward", "downwards"), (0, -1)),
}
_DIAGONAL = ("diagonal", "diagonally")
_DIRECTION_PREPOSITIONS = ("to", "towards", "toward")
_FILLER_WORDS = "a an the with at in of by and force pressure speed direction side edge corner hand"
_QUANTITY_NAMES = {"kind": "kind of motion", "force": "force", "speed": "speed", "angle": "direction"}

GridDirection = tuple[int, int]
_ANGLES: dict[GridDirection, int] = {
    (1, 0): 0, (1, 1): 45, (0, 1): 90, (-1, 1): 135, (-1, 0): 180, (-1, -1): 225, (0, -1): 270, (1, -1): 315,
}  # fmt: skip
_SIDE_NAMES = {-1: ("right", "left"), 1: ("left", "right")}, {-1: ("top", "bottom"), 1: ("bottom", "top")}

FORCE_LIMITS_N = (0.01, 20.0)
"""Accepted forces [N]."""
SPEED_LIMITS_M_S = (1e-3, 1.0)
"""Accepted speeds [m/s]. These limits are those of stroke objects and hands; values beyond are mistakes, so they raise
an error instead of being clamped."""

_NUMBER = r"(?<![\w.])(?<![0-9],)(?P<sign>(?<!\S)[-−+])?(?P<number>[0-9]+(?:\.[0-9]+)?|\.[0-9]+)\s*-?\s*"
_QUANTITY = re.compile(
    _NUMBER + r"(?P<unit>(?:mm|cm|m|(?:milli|centi)?met(?:er|re)s?)\s*(?:/|-|per)\s*(?:seconds?|sec|s)"
    r"|mn|n|(?:milli)?newtons?|°|deg|degrees?)(?![\w/])",
    re.IGNORECASE,
)
_MEDIUM_SPEED = re.compile(r"\b(?:medium|moderate|normal)\s+speed\b")
_UNIT_FACTORS: tuple[tuple[str, str, float], ...] = (
    ("mn", "force", 1e3), ("millin", "force", 1e3), ("n", "force", 1.0),
    ("mm", "speed", 1e3), ("milli", "speed", 1e3), ("c", "speed", 1e2), ("m", "speed", 1.0),
    ("d", "angle", 1.0), ("°", "angle", 1.0),
)  # fmt: skip
"""Start of a unit, the quantity it measures, and its number per SI unit (an angle stays in degrees)."""


def parse_stroke(words: str) -> Primitive:
    """Parse a stroke in words.

    Parameters
    ----------
    words : str
        Description, or name, of a stroke.

    Returns
    -------
    Primitive
        The stroke. Words or a name for one of the eight named primitives give exactly that one. Any other stroke gets a
        name (letters, digits, points, hyphens), which parses to the same stroke again.

    Raises
    ------
    UsageError
        Names the unknown word, with close ones, or the two that contradict each other.
    """
    parsed = _ParsedWords(words)
    remaining_text = _QUANTITY.sub(parsed.parse_quantity, words).lower()
    remaining_text = _MEDIUM_SPEED.sub(
        lambda match: parsed.record("speed", SCRAPE_SPEED_M_S, match.group()), remaining_text
    )
    direction_words: list[str] = []
    for word in re.split(r"[\s,;:_\-–—\"'/]+", re.sub("→|->", " to ", remaining_text)):
        if word and (not parsed.parse_word(word) or (word == "and" and direction_words)):
            direction_words.append(word)
    kind = str(parsed.get_value("kind", "scrape" if direction_words or "angle" in parsed.found else ""))
    if not kind:
        raise parsed.make_error("it says no motion", "Begin with scrape or rub, or give a direction: left to right.")
    force, speed = float(parsed.get_value("force", RUB_N)), float(parsed.get_value("speed", SCRAPE_SPEED_M_S))
    for value, (low, high), unit in ((force, FORCE_LIMITS_N, "N"), (speed, SPEED_LIMITS_M_S, "m/s")):
        if not low <= value <= high:
            raise parsed.make_error(f"{value:g} {unit} is no stroke", f"Give {low:g} to {high:g} {unit}.")
    if kind == "rub" and (direction_words or "angle" in parsed.found):
        direction_text = " ".join(direction_words) or parsed.found["angle"][1]
        raise parsed.make_error(
            f"a rub goes every way, '{direction_text}' only one", "Say scrape, or leave the direction out."
        )
    angle = 0.0 if kind == "rub" else _compute_angle(parsed, direction_words)
    return _name_primitive(Primitive("", kind, _to_unit_vector(angle), force, speed), angle)


class _ParsedWords:
    """Quantities (verb, direction, force, speed) parsed so far, each with its value and the words that gave it."""

    def __init__(self, words: str) -> None:
        self.words = words
        self.found: dict[str, tuple[float | str, str]] = {}

    def make_error(self, what: str, remedy: str) -> UsageError:
        return UsageError(f"{what}.", where=f"stroke '{self.words}'", remedy=remedy)

    def get_value(self, quantity: str, default: float | str) -> float | str:
        return self.found.get(quantity, (default, ""))[0]

    def record(self, quantity: str, value: float | str, word: str) -> str:
        """Record the value of a quantity; raise UsageError if another value was recorded before.

        Returns a space, which replaces the word in the text.
        """
        known = self.found.setdefault(quantity, (value, word))
        if known[0] != value:
            raise self.make_error(
                f"'{known[1]}' and '{word}' contradict each other", f"Give one {_QUANTITY_NAMES[quantity]}."
            )
        return " "

    def parse_quantity(self, match: re.Match[str]) -> str:
        text, unit = match.group().strip(), match["unit"].lower()
        quantity, per_si = next((name, factor) for start, name, factor in _UNIT_FACTORS if unit.startswith(start))
        value = float(match["number"]) / per_si
        if match["sign"] in ("-", "−"):
            if quantity != "angle":
                raise self.make_error(f"'{text}' is negative", f"Give a positive {quantity}.")
            value = -value
        if not np.isfinite(value):
            raise self.make_error(f"'{text}' is no number of a stroke", f"Give a smaller {quantity}.")
        value = round(value % 360.0, 6) % 360.0 if quantity == "angle" else float(f"{value:.9g}")
        return self.record(quantity, value, text)

    def parse_word(self, word: str) -> bool:
        """Parse one word; return False if it is a direction word, which is parsed later together with the others."""
        if word in _DIRECTION_WORDS:
            return False
        if word not in _VOCABULARY:
            if word[0].isdigit():
                raise self.make_error(
                    f"'{word}' has no unit", "Write 1.5 N, 80 mm/s or 30 degrees, with a decimal point."
                )
            matches = close_matches(word, _SUGGESTED_WORDS)
            suggestion = f"Did you mean {' or '.join(repr(match) for match in matches)}?"
            listed = f"Choose one of {', '.join(PRIMITIVES)}, or say e.g. 'scrape left to right, hard'."
            raise self.make_error(f"the word '{word}' is unknown", suggestion if matches else listed)
        meaning = _VOCABULARY[word]
        if meaning is not None:
            self.record(*meaning, word)
        return True


def _compute_angle(parsed: _ParsedWords, direction_words: list[str]) -> float:
    """Return the angle in degrees, anticlockwise from left to right."""
    heading_words = [word for word in direction_words if word in _SIDES or word in _HEADINGS]
    for before, word, after in zip(direction_words, direction_words[1:], direction_words[2:], strict=False):
        if word == "and" and any(
            a * b < 0 for a, b in zip(_get_grid_direction(before), _get_grid_direction(after), strict=True)
        ):
            raise parsed.make_error(
                f"'{before}' and '{after}' contradict each other", "Give one direction; rub goes every way."
            )
    diagonal = any(word in _DIAGONAL for word in direction_words)
    if "angle" in parsed.found:
        if direction_words:
            raise parsed.make_error(
                f"'{parsed.found['angle'][1]}' and '{' '.join(direction_words)}' contradict each other",
                "Give one direction.",
            )
        return float(parsed.found["angle"][0])
    if not heading_words:
        if direction_words and not diagonal:
            raise parsed.make_error(f"'{direction_words[0]}' leads nowhere", "Example: left to right.")
        return float(_ANGLES[(1, -1)] if diagonal else 0)
    x, y = (_find_axis_sign(parsed, direction_words, axis) for axis in (0, 1))
    if diagonal:
        x, y = x or 1, y or -1
    if (x, y) == (0, 0):
        raise parsed.make_error(f"'{' '.join(direction_words)}' goes nowhere", "Give two different sides.")
    return float(_ANGLES[(x, y)])


def _find_axis_sign(parsed: _ParsedWords, direction_words: list[str], axis: int) -> int:
    """Return the direction along one axis: −1, 0 or 1.

    A side named before "to", after "from" or as the first of two is the start.
    """
    source: list[tuple[int, str]] = []
    target: list[tuple[int, str]] = []
    after_from, to_indices = (
        False,
        [index for index, word in enumerate(direction_words) if word in _DIRECTION_PREPOSITIONS],
    )
    for index, word in enumerate(direction_words):
        if word in _DIRECTION_PREPOSITIONS or word == "from":
            after_from = word == "from"
            continue
        sign = _get_grid_direction(word)[axis]
        if sign == 0:
            continue
        starts = after_from or (word in _SIDES and any(aim > index for aim in to_indices))
        (source if starts else target).append((sign, word))
    if not source and len(target) == 2 and target[0][1] in _SIDES:
        source, target = target[:1], target[1:]
    for group in (source, target):
        if len({sign for sign, _ in group}) > 1:
            raise parsed.make_error(
                f"'{group[0][1]}' and '{group[1][1]}' contradict each other", "Give one direction; rub goes every way."
            )
    if source and not target and to_indices:
        raise parsed.make_error(f"'{source[0][1]}' has no other side", "Name both corners: top left to bottom right.")
    if source and target and source[0][0] == target[0][0]:
        return 0
    if target and to_indices and not source and any(word in _SIDES for word in direction_words[: to_indices[0]]):
        raise parsed.make_error(f"'{target[0][1]}' has no other side", "Name both corners: top left to bottom right.")
    return target[0][0] if target else -source[0][0] if source else 0


def _get_grid_direction(word: str) -> GridDirection:
    return _SIDES.get(word) or _HEADINGS.get(word) or (0, 0)


def _to_unit_vector(angle: float) -> tuple[float, float]:
    grid_directions = {degrees: grid_direction for grid_direction, degrees in _ANGLES.items()}
    if angle in grid_directions:
        x, y = grid_directions[int(angle)]
        half = 2**-0.5 if x and y else 1.0
        return half * x, half * y
    return float(np.cos(np.radians(angle))), float(np.sin(np.radians(angle)))


def _name_primitive(primitive: Primitive, angle: float) -> Primitive:
    for known in PRIMITIVES.values():
        if (known.kind, known.direction, known.force, known.speed) == (
            primitive.kind, primitive.direction, primitive.force, primitive.speed,
        ):  # fmt: skip
            return known
    parts = ["rub" if primitive.kind == "rub" else _format_direction(angle)]
    parts += [f"{primitive.force:.9g}n", f"{primitive.speed * 1e3:.9g}mm-s"]
    return Primitive("-".join(parts), primitive.kind, primitive.direction, primitive.force, primitive.speed)


def _format_direction(angle: float) -> str:
    grid_directions = {degrees: grid_direction for grid_direction, degrees in _ANGLES.items()}
    if angle not in grid_directions:
        return f"{angle:.9g}deg"
    ends = [
        _SIDE_NAMES[axis][sign]
        for axis, sign in ((1, grid_directions[int(angle)][1]), (0, grid_directions[int(angle)][0]))
        if sign
    ]
    return "-".join([*(start for start, _ in ends), *(end for _, end in ends)])


def _build_vocabulary() -> dict[str, tuple[str, float | str] | None]:
    """Return a mapping from every known word to (quantity, value), or to None for filler words."""
    meanings: dict[str, tuple[str, float | str] | None] = dict.fromkeys(_FILLER_WORDS.split())
    for kind, verbs in (("scrape", _SCRAPE_VERBS), ("rub", _RUB_VERBS)):
        for verb in verbs.split():
            for form in (verb, f"{verb}s", f"{verb}ing", f"{verb.removesuffix('e')}ing", f"{verb}{verb[-1]}ing"):
                meanings[form] = ("kind", kind)
    for quantity, table in (("force", _FORCE_WORDS), ("speed", _SPEED_WORDS)):
        for value, synonyms in table.items():
            meanings.update((word, (quantity, value)) for word in synonyms.split())
    return meanings


_VOCABULARY = _build_vocabulary()
_DIRECTION_WORDS = {*_SIDES, *_HEADINGS, *_DIAGONAL, *_DIRECTION_PREPOSITIONS, "from"}
_SUGGESTED_WORDS = sorted(
    {
        *_SCRAPE_VERBS.split(),
        *_RUB_VERBS.split(),
        *_DIRECTION_WORDS,
        *" ".join([*_FORCE_WORDS.values(), *_SPEED_WORDS.values()]).split(),
    }
)
