"""Action words: "scrape left to right, hard" → a primitive.

A small grammar of English. Upper or lower case, commas, hyphens and the order of the parts do not matter:

verb        scrape, stroke, drag, slide, swipe, … : a straight scrape. rub, or random: a wandering rub
direction   left to right, bottom to top, top left to bottom right, to the right, down, diagonal up, 30 degrees
force       soft, medium, hard, or 1.5 N, 300 mN
speed       slow, fast, or 80 mm/s, 8 cm/s, 0.1 m/s

What is left out: left to right, 1 N, 100 mm/s. What is not understood, or says two things, is refused.
"""

from __future__ import annotations

import re

import numpy as np

from ..closest import closest
from ..errors import UsageError
from .primitives import HARD_N, PRIMITIVES, RUB_N, SCRAPE_SPEED_M_S, SOFT_N, Primitive

_SCRAPES = "scrape stroke drag slide swipe wipe brush scratch glide sweep draw pull push"
_RUBS = "rub random randomly scrub"
_FORCES = {
    SOFT_N: "soft softly light lightly gentle gently delicate delicately",
    RUB_N: "medium moderate moderately normal",
    HARD_N: "hard firm firmly strong strongly heavy heavily",
}
_SPEEDS = {
    PRIMITIVES["rub-slow"].speed: "slow slowly",
    PRIMITIVES["rub-fast"].speed: "fast quick quickly rapid rapidly",
}
_PLACES = {"left": (-1, 0), "right": (1, 0), "top": (0, 1), "bottom": (0, -1), "upper": (0, 1), "lower": (0, -1)}
_HEADINGS = {
    **{f"{way}{end}": _PLACES[way] for way in ("left", "right") for end in ("ward", "wards")},
    **dict.fromkeys(("up", "upward", "upwards"), (0, 1)),
    **dict.fromkeys(("down", "downward", "downwards"), (0, -1)),
}
_DIAGONAL = ("diagonal", "diagonally")
_AIMS = ("to", "towards", "toward")
_FILLERS = "a an the with at in of by and force pressure speed direction side edge corner hand"
_NOUNS = {"kind": "kind of motion", "force": "force", "speed": "speed", "angle": "direction"}

Way = tuple[int, int]
_ANGLES: dict[Way, int] = {
    (1, 0): 0, (1, 1): 45, (0, 1): 90, (-1, 1): 135, (-1, 0): 180, (-1, -1): 225, (0, -1): 270, (1, -1): 315,
}  # fmt: skip
_ENDS = {-1: ("right", "left"), 1: ("left", "right")}, {-1: ("top", "bottom"), 1: ("bottom", "top")}

FORCE_LIMITS_N = (0.01, 20.0)
SPEED_LIMITS_M_S = (1e-3, 1.0)
"""Beyond these, which a stroke object holds and a hand can do, words are a slip of the pen: refused, not clamped."""

_NUMBER = r"(?<![\w.])(?<![0-9],)(?P<sign>(?<!\S)[-−+])?(?P<number>[0-9]+(?:\.[0-9]+)?|\.[0-9]+)\s*-?\s*"
_QUANTITY = re.compile(
    _NUMBER + r"(?P<unit>(?:mm|cm|m|(?:milli|centi)?met(?:er|re)s?)\s*(?:/|-|per)\s*(?:seconds?|sec|s)"
    r"|mn|n|(?:milli)?newtons?|°|deg|degrees?)(?![\w/])",
    re.IGNORECASE,
)
_MEDIUM_SPEED = re.compile(r"\b(?:medium|moderate|normal)\s+speed\b")
_FACTORS: tuple[tuple[str, str, float], ...] = (
    ("mn", "force", 1e3), ("millin", "force", 1e3), ("n", "force", 1.0),
    ("mm", "speed", 1e3), ("milli", "speed", 1e3), ("c", "speed", 1e2), ("m", "speed", 1.0),
    ("d", "angle", 1.0), ("°", "angle", 1.0),
)  # fmt: skip
"""How a unit begins, what it measures, and how many make one SI unit (an angle stays in degrees)."""


def primitive_of(words: str) -> Primitive:
    """The primitive that words describe; its name is plain (letters, digits, points, hyphens) and is understood here
    as the same primitive. Words for one of the eight give exactly that one, so do their names.

    Raises UsageError naming the word that is unknown (with near ones) or the two that contradict each other.
    """
    said = _Said(words)
    rest = _QUANTITY.sub(said.quantity, words).lower()
    rest = _MEDIUM_SPEED.sub(lambda match: said.noted("speed", SCRAPE_SPEED_M_S, match.group()), rest)
    places: list[str] = []
    for word in re.split(r"[\s,;:_\-–—\"'/]+", re.sub("→|->", " to ", rest)):
        if word and (not said.word(word) or (word == "and" and places)):
            places.append(word)
    kind = str(said.value("kind", "scrape" if places or "angle" in said.found else ""))
    if not kind:
        raise said.refused("it says no motion", "Begin with scrape or rub, or give a direction: left to right.")
    force, speed = float(said.value("force", RUB_N)), float(said.value("speed", SCRAPE_SPEED_M_S))
    for value, (low, high), unit in ((force, FORCE_LIMITS_N, "N"), (speed, SPEED_LIMITS_M_S, "m/s")):
        if not low <= value <= high:
            raise said.refused(f"{value:g} {unit} is no stroke", f"Give {low:g} to {high:g} {unit}.")
    if kind == "rub" and (places or "angle" in said.found):
        which = " ".join(places) or said.found["angle"][1]
        raise said.refused(f"a rub goes every way, '{which}' only one", "Say scrape, or leave the direction out.")
    angle = 0.0 if kind == "rub" else _angle(said, places)
    return _named(Primitive("", kind, _unit(angle), force, speed), angle)


class _Said:
    """What has been understood so far: quantity → (value, the words that said so)."""

    def __init__(self, words: str) -> None:
        self.words = words
        self.found: dict[str, tuple[float | str, str]] = {}

    def refused(self, what: str, remedy: str) -> UsageError:
        return UsageError(f"{what}.", where=f"stroke '{self.words}'", remedy=remedy)

    def value(self, quantity: str, default: float | str) -> float | str:
        return self.found.get(quantity, (default, ""))[0]

    def noted(self, quantity: str, value: float | str, word: str) -> str:
        """Take it in and leave a space in its place. Raises UsageError where something else was said before."""
        known = self.found.setdefault(quantity, (value, word))
        if known[0] != value:
            raise self.refused(f"'{known[1]}' and '{word}' contradict each other", f"Give one {_NOUNS[quantity]}.")
        return " "

    def quantity(self, match: re.Match[str]) -> str:
        text, unit = match.group().strip(), match["unit"].lower()
        quantity, per_si = next((what, factor) for start, what, factor in _FACTORS if unit.startswith(start))
        value = float(match["number"]) / per_si
        if match["sign"] in ("-", "−"):
            if quantity != "angle":
                raise self.refused(f"'{text}' is negative", f"Give a positive {quantity}.")
            value = -value
        if not np.isfinite(value):
            raise self.refused(f"'{text}' is no number of a stroke", f"Give a smaller {quantity}.")
        value = round(value % 360.0, 6) % 360.0 if quantity == "angle" else float(f"{value:.9g}")
        return self.noted(quantity, value, text)

    def word(self, word: str) -> bool:
        """Take in one word; False where it belongs to the direction."""
        if word in _DIRECTION_WORDS:
            return False
        if word not in _MEANINGS:
            if word[0].isdigit():
                raise self.refused(f"'{word}' has no unit", "Write 1.5 N, 80 mm/s or 30 degrees, with a decimal point.")
            near = closest(word, _BASES)
            offer = f"Did you mean {' or '.join(repr(each) for each in near)}?"
            listed = f"Choose one of {', '.join(PRIMITIVES)}, or say e.g. 'scrape left to right, hard'."
            raise self.refused(f"the word '{word}' is unknown", offer if near else listed)
        meaning = _MEANINGS[word]
        if meaning is not None:
            self.noted(*meaning, word)
        return True


def _angle(said: _Said, places: list[str]) -> float:
    """Degrees anticlockwise from left → right."""
    ways = [word for word in places if word in _PLACES or word in _HEADINGS]
    for before, word, after in zip(places, places[1:], places[2:], strict=False):
        if word == "and" and any(a * b < 0 for a, b in zip(_way(before), _way(after), strict=True)):
            raise said.refused(
                f"'{before}' and '{after}' contradict each other", "Give one direction; rub goes every way."
            )
    diagonal = any(word in _DIAGONAL for word in places)
    if "angle" in said.found:
        if places:
            raise said.refused(
                f"'{said.found['angle'][1]}' and '{' '.join(places)}' contradict each other", "Give one direction."
            )
        return float(said.found["angle"][0])
    if not ways:
        if places and not diagonal:
            raise said.refused(f"'{places[0]}' leads nowhere", "Example: left to right.")
        return float(_ANGLES[(1, -1)] if diagonal else 0)
    x, y = (_along(said, places, axis) for axis in (0, 1))
    if diagonal:
        x, y = x or 1, y or -1
    if (x, y) == (0, 0):
        raise said.refused(f"'{' '.join(places)}' goes nowhere", "Give two different sides.")
    return float(_ANGLES[(x, y)])


def _along(said: _Said, places: list[str], axis: int) -> int:
    """−1, 0 or 1: the way along one axis. A side named before "to", after "from" or first of two is the start."""
    source: list[tuple[int, str]] = []
    target: list[tuple[int, str]] = []
    coming, aims = False, [index for index, word in enumerate(places) if word in _AIMS]
    for index, word in enumerate(places):
        if word in _AIMS or word == "from":
            coming = word == "from"
            continue
        sign = _way(word)[axis]
        if sign == 0:
            continue
        starts = coming or (word in _PLACES and any(aim > index for aim in aims))
        (source if starts else target).append((sign, word))
    if not source and len(target) == 2 and target[0][1] in _PLACES:
        source, target = target[:1], target[1:]
    for group in (source, target):
        if len({sign for sign, _ in group}) > 1:
            raise said.refused(
                f"'{group[0][1]}' and '{group[1][1]}' contradict each other", "Give one direction; rub goes every way."
            )
    if source and not target and aims:
        raise said.refused(f"'{source[0][1]}' has no other side", "Name both corners: top left to bottom right.")
    if source and target and source[0][0] == target[0][0]:
        return 0
    if target and aims and not source and any(word in _PLACES for word in places[: aims[0]]):
        raise said.refused(f"'{target[0][1]}' has no other side", "Name both corners: top left to bottom right.")
    return target[0][0] if target else -source[0][0] if source else 0


def _way(word: str) -> Way:
    return _PLACES.get(word) or _HEADINGS.get(word) or (0, 0)


def _unit(angle: float) -> tuple[float, float]:
    named = {degrees: way for way, degrees in _ANGLES.items()}
    if angle in named:
        x, y = named[int(angle)]
        half = 2**-0.5 if x and y else 1.0
        return half * x, half * y
    return float(np.cos(np.radians(angle))), float(np.sin(np.radians(angle)))


def _named(primitive: Primitive, angle: float) -> Primitive:
    for fixed in PRIMITIVES.values():
        if (fixed.kind, fixed.direction, fixed.force, fixed.speed) == (
            primitive.kind, primitive.direction, primitive.force, primitive.speed,
        ):  # fmt: skip
            return fixed
    parts = ["rub" if primitive.kind == "rub" else _direction_name(angle)]
    parts += [f"{primitive.force:.9g}n", f"{primitive.speed * 1e3:.9g}mm-s"]
    return Primitive("-".join(parts), primitive.kind, primitive.direction, primitive.force, primitive.speed)


def _direction_name(angle: float) -> str:
    named = {degrees: way for way, degrees in _ANGLES.items()}
    if angle not in named:
        return f"{angle:.9g}deg"
    ends = [_ENDS[axis][sign] for axis, sign in ((1, named[int(angle)][1]), (0, named[int(angle)][0])) if sign]
    return "-".join([*(start for start, _ in ends), *(end for _, end in ends)])


def _meanings() -> dict[str, tuple[str, float | str] | None]:
    """Word → what it says (quantity, value), or None where it says nothing."""
    meanings: dict[str, tuple[str, float | str] | None] = dict.fromkeys(_FILLERS.split())
    for kind, verbs in (("scrape", _SCRAPES), ("rub", _RUBS)):
        for verb in verbs.split():
            for form in (verb, f"{verb}s", f"{verb}ing", f"{verb.removesuffix('e')}ing", f"{verb}{verb[-1]}ing"):
                meanings[form] = ("kind", kind)
    for quantity, table in (("force", _FORCES), ("speed", _SPEEDS)):
        for value, synonyms in table.items():
            meanings.update((word, (quantity, value)) for word in synonyms.split())
    return meanings


_MEANINGS = _meanings()
_DIRECTION_WORDS = {*_PLACES, *_HEADINGS, *_DIAGONAL, *_AIMS, "from"}
_BASES = sorted(
    {*_SCRAPES.split(), *_RUBS.split(), *_DIRECTION_WORDS, *" ".join([*_FORCES.values(), *_SPEEDS.values()]).split()}
)
