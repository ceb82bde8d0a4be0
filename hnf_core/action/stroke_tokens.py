"""Tokens of a stroke in words: text → words, phrases, quantities and separators, each with what it says.

Signs, abbreviations and numbers in words are first rewritten. What depends on its neighbours is settled here: "very" of
a level, "3" of taps, "to" of a level, a pause between repeats. `parse_stroke.py` makes steps of the tokens.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..errors import UsageError
from .stroke_words import LARGE, LEVELS, PHRASES, VOCABULARY, Meaning

BRIEF_S, LONG_S, GAP_S = 0.5, 2.0, 1.0
"""Durations of a brief and of a long press or pause, and of a pause between repeats [s]."""
NO_MOTION = "it says no motion", "Begin with scrape or rub, or give a direction: left to right."
_ARTICLES = {"a", "an", "the", "its", "my", "your"}

_DIGITS = r"(?:[0-9]+(?:\.[0-9]+)?|\.[0-9]+)"
_S = "(?:s|secs?|seconds?)"
_LENGTHS = (
    ("mm|milli ?met(?:er|re)s?", 1e3), ("cm|centi ?met(?:er|re)s?", 1e2), ("m|met(?:er|re)s?", 1.0),
    ("inch(?:es)?", 1 / 0.0254),
)  # fmt: skip
_UNITS = (
    *((rf"(?:{unit})\s*(?:/|-|per\b|an?\b|each\b)\s*{_S}", "speed", per_si) for unit, per_si in _LENGTHS),
    ("mn|milli ?newtons?", "force", 1e3), ("n|newtons?", "force", 1.0), ("kg|kilos?|kilograms?", "force", 1 / 9.80665),
    ("g|gf|grams?|gram[- ]force", "force", 1e3 / 9.80665), ("°|deg|degrees?", "angle", 1.0),
    ("ms|milli ?seconds?", "duration", 1e3), (_S, "duration", 1.0), ("min|minutes?", "duration", 1 / 60),
    ("hz|hertz", "rate", 1.0), ("bpm|beats per minute", "rate", 60.0),
    ("times?|x|repetitions?|reps|cycles?", "repeats", 1.0), *((unit, "length", per_si) for unit, per_si in _LENGTHS),
)  # fmt: skip
"""Unit, the quantity it measures, and its number per SI unit (an angle stays in degrees; a gram weighs 9.8 mN)."""
_QUANTITIES = [
    (re.compile(rf"(?<![\w.])(?<![0-9],)(?P<sign>(?<!\S)[-−+])?(?P<number>{_DIGITS}|one\b)\s*-?\s*(?:{unit})"
                r"(?!\w|/(?!\d))", re.I), quantity, per_si)
    for unit, quantity, per_si in _UNITS
]  # fmt: skip
_ANY_UNIT, _ANY_LENGTH = ("|".join(unit for unit, *_ in units) for units in (_UNITS, _LENGTHS))
_NUMBER_WORDS = {
    "(?:a )?half a dozen": 6, "(?:a )?dozen": 12, "(?:a )?couple(?: of)?": 2, "a pair of": 2, "a few|several": 3,
    "zero": 0, "two": 2, "three": 3, "four": 4, "five": 5, "six": 6, "seven": 7, "eight": 8, "nine": 9, "ten": 10,
    "eleven": 11, "twelve": 12, "fifteen": 15, "twenty": 20, "thirty": 30, "forty": 40, "fifty": 50, "hundred": 100,
    "once": "1 times", "twice": "2 times", "thrice": "3 times",
}  # fmt: skip
_NAMED = r"(?=(?:milli)?(?:second|sec|newton|minute)|(?:milli|centi)?met(?:er|re)|inch)"
_REWRITES = [
    (re.compile(pattern, re.I), replacement)
    for pattern, replacement in (
        # signs, lists and abbreviations
        (r"(?:^|(?<=[\n;,.:]))\s*(?:step\s*)?\(?(?:[0-9]+|one)[.):](?=\s)|\s\(?[0-9]\)(?=\s)|\n\s*[-*•]?", " then "),
        (rf"\s(?:/|\+|>|\|)\s(?!\s*{_S}\b)", " then "), (r"->|→|⇒|=>", " → "), (r"→\s*(?=$|[,;.])", "right"),
        (r"[×✕]", "x"), (r"\bb ?(?:&|/|and) ?f\b", "back and forth"), (r"&", " and "), (r"\bw/", "with "),
        (r"[~≈@]|\bapprox\.|\bca\.|\bafter(?=\s*(?:[.,;]|$))", " "), (r"ø|\bd\s*=", " diameter "),
        (r"\br\s*=", "radius "),
        (r"\.{2,}|…|\s[-–—](?=\s)", ", "), (r"o['’]clock", "o'clock"), (r"n['’]t\b", " not"), (r"\bminus\s+", " -"),
        (rf"\b(?:n\s*=|x)\s?(\d+)\b(?!\s*(?:{_ANY_UNIT})\b)|\*\s*(\d+)\b", r" \1\2 times"),
        (r"\bas (?:if|though)\b", "like"),
        (r"\b(turns|rounds|taps|strokes|cycles|reps|repeats|presses|passes|times)\s*[=:]\s*(\d+)", r"\2 \1"),
        # numbers and units
        *((rf"\b(?:{word})\b", str(number)) for word, number in _NUMBER_WORDS.items()),
        (rf"({_ANY_LENGTH})\s+(?:an?|per|each|every)\s+{_S}\b", r"\1/s"), (r"(?<=m)[\s·]?s\s?(?:\^?-1|⁻¹)", "/s"),
        (r"^\s*(\d+\s*(?:times|x))\s*:", r"repeat \1:"),
        (rf"(?<=\d)\s*(?:times?|taps|strokes|circles|beats|x)?\s*(?:/|\b(?:per|an?|each|every)\b)\s*{_S}\b", " Hz"),
        (r"(?<=\d)\s+and\s+a\s+half\b", ".5"), (r"\bone and a half\b", "1.5"),
        (r"\b(?:an?|one)\s+(second|minute)\s+and\s+a\s+half\b", r"1.5 \1"), (rf"\bhalf\s+(?:an?\s+)?{_NAMED}", "0.5 "),
        (rf"\b(?:a\s+)?quarter\s+(?:of\s+)?(?:an?\s+)?{_NAMED}", "0.25 "),
        (r"\bfor (?:a|one) (?:brief |short |quick )?(?:moment|bit|instant)\b", " briefly "),
        (rf"\b(every|each)\s+{_NAMED}", r"\1 1 "), (rf"\ban?\s+{_NAMED}", "1 "),
        (rf"\b(?:after\s+({_DIGITS}\s*{_S})|({_DIGITS}\s*{_S})\s+later)\b", r" then pause \1\2 then "),
        (rf"\b({_DIGITS}) ?(?:x|by|times) ?(?=\1 ?(?:mm|cm|m)\b)", ""),
        (rf"\b(from\s+{_DIGITS}\s*(?:{_ANY_UNIT})?) up to\b", r"\1 to"),
        (rf"(?<![\w.-])({_DIGITS})\s*(?:to|-|–)\s*(?={_DIGITS}\s*({_ANY_UNIT})(?![\w/]))", r"\1 \2 to "),
    )
]  # fmt: skip
_COUNT = re.compile(r"(?:(?<!\S)[-−])?[0-9]+(?![\w.,]|\s*-)|one\b", re.I)
_SEPARATOR = re.compile(
    r"(?P<then>(?:[\s,;.-]|\band\b)*\b(?:then|(?:and )?after (?:that|which)|(?<=and )after|afterwards?|next|finally"
    r"|lastly|(?:and )?follow(?:s|ed)? (?:(?:it|that|this) )?(?:up )?(?:with|by))\b)"
    r"|(?P<comma>\s*[,;:.](?!\d))|(?P<and>\s*\band\b(?!\s+back\b(?!\s+(?:to|from|and)\b)))", re.I,
)  # fmt: skip
_BREAK = re.compile(r"[\s,;:_\-–—\"'/!?().=]")
_WORD = re.compile(r"[^\s,;:_\-–—\"'/!?()=]+?(?=\.?(?:[\s,;:_\-–—\"'/!?()=]|$))")
_SIMILE = re.compile(r"(?<!would )(?<!['’]d )\blike (?:an?|the|your|you|someone|\w+ing)\b[^,;.:]*$", re.I)
"""A comparison, whose words need not be known: like petting a cat."""


@dataclass(frozen=True)
class Token:
    """A word, phrase, quantity or separator, with what it means: (quantity, value) pairs."""

    text: str
    meaning: Meaning = ()
    measured: bool = False

    def get(self, quantity: str) -> Any:
        """Return the value of a quantity that it says, or None."""
        return dict(self.meaning).get(quantity)

    @property
    def motion(self) -> Any:
        """Its kind of motion, or verb; None if it says none."""
        return self.get("kind") or self.get("verb")


def make_error(words: str, what: str, remedy: str) -> UsageError:
    """Return the error of a stroke in words."""
    return UsageError(f"{what}.", where=f"stroke '{words}'", remedy=remedy)


def tokenize(words: str) -> tuple[list[Token], list[str]]:
    """Convert text to tokens that say what they do without those beside them.

    Parameters
    ----------
    words : str
        The text.

    Returns
    -------
    tokens : list of Token
        The tokens; empty if a word is unknown.
    unknown : list of str
        The unknown words.

    Raises
    ------
    UsageError
        If a number has no unit, or the sentence is no stroke.
    """
    text, position, tokens, unknown = words, 0, [], []
    for pattern, replacement in _REWRITES:
        text = pattern.sub(replacement, text)
    text = text.strip()
    while position < len(text):
        found = [(match, meaning) for pattern, meaning in PHRASES if (match := pattern.match(text, position))]
        phrase, meaning = max(found, key=lambda each: each[0].end(), default=(None, ()))
        units = ((pattern.match(text, position), quantity, per_si) for pattern, quantity, per_si in _QUANTITIES)
        match, quantity, per_si = next((each for each in units if each[0]), (None, "", 1.0))
        if match and not (phrase and phrase.end() > match.end()):
            tokens.append(_parse_quantity(words, match, quantity, per_si))
        elif match := _SEPARATOR.match(text, position):
            tokens.append(Token(match.group().strip(), (("separator", match.lastgroup or ""),)))
        elif match := phrase:
            tokens.append(Token(match.group().strip(), meaning))
        elif match := _COUNT.match(text, position):
            tokens.append(Token(match.group(), (("count", match.group()),)))
        elif match := _BREAK.match(text, position):
            pass
        elif match := _WORD.match(text, position):
            word = match.group().lower()
            number = word if word[0].isdigit() else tokens[-1].get("count") if tokens and len(word) < 3 else None
            if word in VOCABULARY:
                tokens.append(Token(word, VOCABULARY[word]))
            elif number:
                raise _refuse_number(words, number)
            elif not _SIMILE.search(text[: match.end()]):
                unknown.append(word)
        else:
            unknown.append(text[position:])
            break
        position = match.end()
    if unknown:
        return [], list(dict.fromkeys(unknown))
    _check_sentence(words, tokens)
    return _join_gaps(_settle(words, tokens)), []


def _parse_quantity(words: str, match: re.Match[str], quantity: str, per_si: float) -> Token:
    text, number = match.group().strip(), match["number"].lower()
    value = (1.0 if number == "one" else float(number)) / per_si
    if match["sign"] in ("-", "−"):
        if quantity != "angle":
            raise make_error(words, f"'{text}' is negative", f"Give a positive {quantity}.")
        value = -value
    if not np.isfinite(value):
        raise make_error(words, f"'{text}' is no number of a stroke", f"Give a smaller {quantity}.")
    if quantity == "repeats" and value != int(value):
        raise make_error(words, f"'{text}' is no whole number", "Say how often: 3 times.")
    value = round(value % 360.0, 6) % 360.0 if quantity == "angle" else float(f"{value:.9g}")
    return Token(text, ((quantity, int(value) if quantity == "repeats" else value),), True)


def _refuse_number(words: str, number: str) -> UsageError:
    if number[0] in "-−":
        return make_error(words, f"'{number}' is negative", "Give a positive number.")
    return make_error(words, f"'{number}' has no unit", "Write 1.5 N, 80 mm/s or 30 degrees, with a decimal point.")


def _check_sentence(words: str, tokens: Sequence[Token]) -> None:
    """Raise UsageError for what is refused by name, and for words on how a surface is (soft leather, it is round)."""
    surfaces = any(token.get("surface") for token in tokens)
    for token, following in itertools.pairwise([*tokens, Token("")]):
        if reason := token.get("refused"):
            raise make_error(words, f"'{token.text}': {reason}", "Say a motion: stroke left to right, tap twice.")
        adjective = {"force", "speed", "size", "kind"} & set(dict(token.meaning)) and token.text not in (
            "press",
            "tap",
            "feel",
        )
        describes = (
            following.get("surface") and (adjective or token.text.endswith("ed")) and not token.text.endswith("ly")
        )
        if describes or (surfaces and token.get("is") and following.get("kind") and not following.text.endswith("ed")):
            said = f"'{token.text} {following.text}' says how it is, not how it is touched"
            raise make_error(words, said, "Say: press the leather softly, rub in circles.")
    says_motion = any(token.motion or token.get("direction") or token.measured for token in tokens)
    if not says_motion and any(token.get("surface") or token.get("is") for token in tokens):
        raise make_error(words, *NO_MOTION)


def _settle(words: str, tokens: list[Token]) -> list[Token]:
    """Settle what depends on the tokens beside it: "very" of a level, "3" of taps, "to" of a level or an infinitive."""
    settled: list[Token] = []
    degree: Token | None = None
    for index, token in enumerate(tokens):
        before, rest = settled[-1] if settled else Token(""), tokens[index + 1 :]
        following = rest[0] if rest else Token("")
        quantity = next((name for name in LEVELS if token.get(name) is not None), "")
        level = token.get(quantity) if token.get(quantity) in LEVELS.get(quantity, ()) else None
        if token.get("degree"):
            degree = degree if token.get("degree") != "very" and before.get("repeats") else token
            continue
        if level and not degree and before.text.split()[-1:] == [token.text]:  # hard, hard, hard
            degree = Token(settled.pop().text, (("degree", "very"),))
        if degree and level:
            token, degree = _grade(degree, token, quantity, level), None
        elif token.get("separator") or token.motion:
            if degree and degree.get("degree") != "very":
                raise make_error(words, f"'{degree.text}' says not of what", "Say: harder, softer, faster or slower.")
            degree = None
        if token.text == "to" and (
            following.motion or (rest and not following.meaning and following.text not in _ARTICLES)
        ):
            continue
        if token.text == "→":
            says = [any(each.motion for each in itertools.takewhile(_is_no_arrow, some)) for some in (settled, rest)]
            aims = following.get("direction") or {*LEVELS} & set(dict(following.meaning)) or before.measured or not rest
            token = Token("→", (("separator", "then"),) if all(says) else (("direction", "to" if aims else "right"),))
        if quantity:
            aim = next((each for each in reversed(settled) if each.meaning), Token(""))
            if aim.get("direction") in ("to", "from"):
                settled = [each for each in settled if each is not aim]
                token = replace(token, meaning=(*token.meaning, ("aim", aim.get("direction"))))
        if token.get("count"):
            token = _settle_count(words, token, before, rest)
        elif token.text in ("long", "wide") and (before.get("length") or before.get("duration")):
            token = Token(token.text, (("marker", "length" if token.text == "long" else "across"),))
        settled.append(token)
    return settled


def _is_no_arrow(token: Token) -> bool:
    return token.text != "→"


def _settle_count(words: str, token: Token, before: Token, rest: Sequence[Token]) -> Token:
    """Return the token of a bare number: repeats where a motion follows (three short, quick taps), else a pronoun."""
    window = list(itertools.takewhile(lambda each: each.get("separator") != "then", rest[:5]))
    between = list(itertools.takewhile(lambda each: not (each.motion or each.text == "ones"), window))
    listed = any(each.get("separator") for each in between)
    counted = len(between) < len(window) and not any(each.text.startswith(("finger", "hand")) for each in between)
    counted = counted and not (listed and (between[0].get("separator") or not all(each.meaning for each in between)))
    said = token.text.lower()
    if counted or before.get("loop"):
        if said[0] in "-−":
            raise _refuse_number(words, said)
        return Token(token.text, (("repeats", 1 if said == "one" else int(said)),), True)
    if said != "one":
        raise _refuse_number(words, said)
    return Token(token.text, (("pronoun", True),), True)


def _grade(degree: Token, token: Token, quantity: str, value: float) -> Token:
    """Return the token of a level with a degree before it: very hard, not too hard, more slowly."""
    text, said = f"{degree.text} {token.text}", degree.get("degree")
    side = int(np.sign(LEVELS[quantity].index(value) - 2))
    if said in ("more", "less"):
        return Token(text, ((f"{quantity}_change", side if said == "more" else -side),))
    graded = 2 * side if said == "very" else min(-side, 0)
    return Token(
        text, tuple((name, LEVELS[name][graded + 2] if name == quantity else each) for name, each in token.meaning)
    )


def _join_gaps(tokens: list[Token]) -> list[Token]:
    """Join "1 s pause between", "a second apart" and "every 2 s" to one token each."""
    for index, token in enumerate(tokens):
        name = next((each for each in ("between", "apart", "every") if token.get(each) is True), None)
        if not name:
            continue
        start = max((i + 1 for i in range(index) if tokens[i].get("separator")), default=0)
        end = next((i for i in range(index, len(tokens)) if tokens[i].get("separator")), len(tokens))
        near = [*range(index, start - 1, -1)] * (name != "every" and token.text != "with") + [*range(index, end)]
        timed = next((i for i in near if tokens[i].get("duration")), index)
        pauses = {i for i in range(start, end) if tokens[i].get("kind") == "pause" or tokens[i].get("verb") == "hold"}
        pauses = pauses if name == "between" else set()
        sizes = {i - 1 for i in pauses if i and (tokens[i - 1].get("size") or tokens[i - 1].get("brief"))}
        usual = None if not pauses else BRIEF_S if sizes and tokens[min(sizes)].get("size") != LARGE else GAP_S
        joined_before = any(isinstance(tokens[i].get(name), float) for i in range(start, end))
        gap = None if joined_before else tokens[timed].get("duration") or usual
        joined = Token(token.text, (("between" if name == "between" else "apart", gap),) if gap else (), bool(gap))
        dropped = ({*pauses, *sizes, timed} if gap else set()) - {index}
        return _join_gaps([joined if i == index else each for i, each in enumerate(tokens) if i not in dropped])
    return tokens
