"""Parser of strokes in words: "scrape left to right, hard", "tap twice, then rub slowly in circles" → a primitive.

A small grammar of English. Text becomes tokens (`stroke_tokens.py`), tokens become clauses, and each clause with a
motion of its own becomes a `Step`. Case, hyphens and the order of the words in a clause do not matter; "then" begins a
new step, a comma or "and" where another motion follows. What is not said follows from the rest (`primitive_path.py`).
Unknown words, contradictions, and what says nothing of a motion, raise UsageError.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..errors import UsageError, close_matches
from .primitives import (
    ALLOWED,
    GRID_ANGLES,
    PRIMITIVES,
    RUB_N,
    SCRAPE_SPEED_M_S,
    STILL,
    Primitive,
    Step,
    make_primitive,
)
from .stroke_tokens import BRIEF_S, EXAMPLES, KNOWN_WORDS, LARGE, LEVELS, LONG_S, NO_MOTION, Token, make_error, tokenize

_SIDES = {"left": (-1, 0), "right": (1, 0), "top": (0, 1), "bottom": (0, -1)}
_HEADINGS = {"leftward": (-1, 0), "rightward": (1, 0), "up": (0, 1), "down": (0, -1)}
_GRID = {**_SIDES, **_HEADINGS}
_NAMES = {
    "kind": "kind of motion, or say 'then' between them", "repeats": "number of times", "angle": "direction",
    "clockwise": "sense of rotation", "inwards": "way", "across": "width",
}  # fmt: skip
FORCE_LIMITS_N = (0.01, 20.0)
"""Accepted forces [N]."""
SPEED_LIMITS_M_S = (1e-3, 1.0)
"""Accepted speeds [m/s]. These limits are those of stroke objects and hands; values beyond are mistakes, so they raise
an error instead of being clamped."""
_LIMITS = {
    "force": (*FORCE_LIMITS_N, "N"), "speed": (*SPEED_LIMITS_M_S, "m/s"), "duration": (0.05, 120.0, "s"),
    "length": (1e-3, 0.5, "m"), "across": (1e-3, 0.3, "m"), "rate": (0.1, 16.0, "Hz"), "repeats": (1, 100, "times"),
}  # fmt: skip
MAX_STEPS = 100
_WEAK = ("move", "touch", "feel", "hold")
_AUXILIARIES = {"do", "did", "doing", "make", "made", "making", "give", "gave", "take", "took", "keep", "work"}


def parse_stroke(words: str) -> Primitive:
    """Parse a stroke in words.

    Parameters
    ----------
    words : str
        Description of a stroke, for example ``"scrape left to right, 1.5 N, 80 mm/s"``, or its name (``"rub-slow"``).

    Returns
    -------
    Primitive
        The stroke. Words or a name for one of the eight named primitives give exactly that one. Any other stroke gets a
        name (letters, digits, points, hyphens), which parses to the same stroke again.

    Raises
    ------
    UsageError
        Names the unknown word, with close ones, or the two that contradict each other.

    Examples
    --------
    >>> import hnf_core as hnf
    >>> hnf.parse_stroke("scrape left to right, 1.5 N, 80 mm/s").speed
    0.08
    """
    primitive = make_primitive(parse_steps(words))
    if primitive.steps:
        from .primitive_path import plan_steps  # imported here because lists of strokes need no curves

        try:
            plan_steps(primitive.steps)
        except UsageError as error:
            raise make_error(words, error.what.removesuffix("."), error.remedy) from error
    return primitive


def parse_steps(words: str) -> tuple[Step, ...]:
    """Parse a stroke in words to its steps; see `parse_stroke`."""
    tokens, unknown = tokenize(words)
    if unknown:
        raise _refuse_unknown(words, unknown)
    steps: list[Step] = []
    said: list[Token] = []
    repeats = 1
    for joint, clause in [*_split_clauses(tokens), ("then", [])]:
        count = _count_loops(clause)
        begins = bool(count) or (not _continues_change(said, clause) if joint == "then" else False)
        if said and (begins or (joint != "then" and _begins_step(words, said, clause, joint, steps))):
            if not steps and all(name in LEVELS for token in said for name, _ in token.meaning):
                said += [token for token in clause if token.motion][:1]
            steps += _ParsedStep(words, said).build(steps)
            said = []
        if count and steps:
            steps = _repeat_steps(words, steps, count, next((token.get("between") for token in clause), None))
        elif count:
            repeats = count
        else:
            said += [*[Token("and", (("direction", "and"),))] * (joint == "and" and bool(said)), *clause]
    if not steps:
        raise make_error(words, *NO_MOTION)
    if all(step.kind in ("pause", "lift") for step in steps):
        remedy = "Say what comes before or after: press, then wait 1 s, then tap."
        raise make_error(words, "it touches nothing", remedy)
    steps = _repeat_steps(words, steps, repeats)
    total = sum(step.duration_s or 0.0 for step in steps)
    if total > _LIMITS["duration"][1]:
        raise make_error(words, f"{total:g} s is no stroke", f"Give at most {_LIMITS['duration'][1]:g} s in all.")
    return tuple(steps)


def _refuse_unknown(words: str, unknown: list[str]) -> UsageError:
    """Return the error that names unknown words, with the nearest phrasing that is understood."""
    listed = ", ".join(f"'{word}'" for word in unknown)
    what = f"the word {listed} is unknown" if len(unknown) == 1 else f"the words {listed} are unknown"
    matches = [next(iter(close_matches(word, KNOWN_WORDS)), "") for word in unknown]
    corrected = words.lower()
    for word, match in zip(unknown, matches, strict=True):
        corrected = re.sub(rf"(?<!\w){re.escape(word)}(?!\w)", match, corrected)
    if all(matches) and corrected != words.lower():
        try:
            parse_steps(corrected)
        except (UsageError, RecursionError):
            corrected = ""
        meant = " and ".join(f"'{match}'" for match in matches)
        return make_error(words, what, f"Did you mean {meant}?" + (f" Say: {corrected.strip()}" if corrected else ""))
    said = set(re.findall(r"[a-z]+", words.lower()))
    nearest = max(EXAMPLES, key=lambda example: len(said & set(re.findall(r"[a-z]{2,}", example))))
    return make_error(words, what, f"Choose one of {', '.join(PRIMITIVES)}, or say e.g. '{nearest}'.")


def _split_clauses(tokens: Sequence[Token]) -> list[tuple[str, list[Token]]]:
    """Split tokens at separators into clauses that say something, each with the separator before it."""
    clauses: list[tuple[str, list[Token]]] = [("", [])]
    for token in tokens:
        separator, (joint, clause) = token.get("separator"), clauses[-1]
        if separator is None:
            clause.append(token)
        elif any(each.meaning for each in clause):
            clauses.append((separator, []))
        elif separator == "then" or not joint:
            clauses[-1] = (separator, clause)
    return [each for each in clauses if any(token.meaning for token in each[1])]


def _gather(tokens: Sequence[Token]) -> dict[str, Any]:
    return {quantity: value for token in tokens for quantity, value in token.meaning}


def _count_loops(clause: Sequence[Token]) -> int:
    """Return how often a clause like "repeat three times" wants the others; 0 if it says a motion of its own."""
    said = _gather(clause)
    if not said.get("loop") or set(said) - {"loop", "repeats", "again", "between", "pronoun"}:
        return 0
    return max(2, int(said.get("repeats", 2)))


def _repeat_steps(words: str, steps: list[Step], count: int, gap_s: float | None = None) -> list[Step]:
    """Repeat steps: a single one by its number, others one after the other, with a pause between if that was said."""
    if count * len(steps) > MAX_STEPS:
        raise make_error(words, f"{count * len(steps)} steps are too many", f"Say at most {MAX_STEPS} in all.")
    first = steps[0]
    counted = len(steps) == 1 and not (first.repeats or first.duration_s or gap_s) and "repeats" in ALLOWED[first.kind]
    if count > 1 and counted:
        return [first._replace(repeats=count)]
    return [*steps, *[*[Step("pause", duration_s=gap_s)] * bool(gap_s), *steps] * (count - 1)]


def _continues_change(step: Sequence[Token], clause: Sequence[Token]) -> bool:
    """Return whether a clause says how the step goes on that began so: gently at first, then harder."""
    said, levels = set(_gather(clause)), {*LEVELS, "force_change", "speed_change"}
    begun = any(token.get("phase") == "start" for token in step)
    motions = set() if any(token.motion for token in step) else {"kind", "verb"}
    return begun and bool(said & levels) and said <= {*levels, *motions, "aim", "gradual", "ramp", "phase"}


def _find_headings(tokens: Sequence[Token]) -> list[str]:
    """Return the sides and headings among some tokens."""
    return [word for token in tokens for word in str(token.get("direction") or "").split() if word in _GRID]


def _begins_step(words: str, step: list[Token], clause: list[Token], joint: str, steps: Sequence[Step]) -> bool:
    """Return whether a clause after a comma or "and" is a step of its own, and says no more of the one before."""
    said, saying = _gather(step), _gather(clause)
    before, after = (each.get("kind", each.get("verb", "")) for each in (said, saying))
    headed = bool(_find_headings(step) and _find_headings(clause))
    shared = {"repeats", "duration", "length"} & set(said) & set(saying)
    pauses = bool({before, after} & {"pause", "lift"})
    if _drop_pressing([*step, *clause]) != [*step, *clause] or "halfway" in (before, after):
        return False
    if (before and "pronoun" in saying) or (pauses and (after or headed or {"length", "direction"} & set(saying))):
        return True
    if not (before and after):
        listed = (
            joint == "comma"
            and set(saying) == {"direction"}
            and not {"to", "from"} & {t.get("direction") for t in [*step, *clause]}
        )
        return headed and ("repeats" in shared or "back" in saying or (not after and listed))
    ends = next(token for token in clause if token.meaning).get("phase") == "end"
    if ends or pauses or headed or {"again", "back"} & set(saying):
        return True
    if after == "hold":
        return before not in ("press", *_WEAK)
    weak = {before, after} & {*_WEAK} - {"hold"}
    if not weak and (shared or (joint == "comma" and before != after and {before, after} & STILL)):
        return True
    if joint == "and" and not ({"repeats", "duration", "length", "direction"} & set(said) or steps):
        return False
    return _cannot_be(words, [*step, *clause], steps) and not _cannot_be(words, clause, steps)


def _drop_pressing(tokens: Sequence[Token]) -> list[Token]:
    """Return tokens without "pressing" where it says no more than the force of a stroke: slide, pressing hard."""
    slides = any(token.motion and token.motion not in (*STILL, *_WEAK) for token in tokens)
    drops = slides and {"force", "force_change"} & set(_gather(tokens))
    return [Token(each.text) if drops and each.text in ("pressing", "pushing") else each for each in tokens]


def _cannot_be(words: str, tokens: list[Token], steps: Sequence[Step]) -> bool:
    """Return whether some tokens contradict each other as one step."""
    try:
        _ParsedStep(words, tokens).build(steps)
    except UsageError:
        return True
    return False


class _ParsedStep:
    """Quantities that were said in one step, each with its value and the words that gave it."""

    def __init__(self, words: str, tokens: Sequence[Token]) -> None:
        self.words = words
        self.found: dict[str, tuple[Any, str]] = {}
        self.verbs: list[tuple[str, str]] = []
        self.directions: list[str] = []
        self.said = _gather(tokens)
        self.tokens = self._take_changes(_drop_pressing(tokens))
        for token in sorted(self.tokens, key=lambda token: not token.measured):
            for quantity, value in token.meaning:
                if quantity == "direction":
                    self.directions += str(value).split() if value != "and" or self.directions else []
                elif quantity == "verb":
                    self.verbs.append((str(value), token.text))
                elif quantity == "length":
                    self.record(*self._name_length(token, float(value)))
                elif quantity not in _SILENT:
                    self.record(quantity, value, token.text)

    def refuse(self, what: str, remedy: str) -> UsageError:
        return make_error(self.words, what, remedy)

    def contradict(self, one: str, two: str, remedy: str = "Give one direction.") -> UsageError:
        return self.refuse(f"'{one}' and '{two}' contradict each other", remedy)

    def get(self, quantity: str) -> Any:
        return self.found.get(quantity, (None, ""))[0]

    def record(self, quantity: str, value: Any, word: str) -> None:
        """Record the value of a quantity; raise UsageError if another value was recorded before."""
        known = self.found.setdefault(quantity, (value, word))
        if known[0] != value:
            raise self.contradict(known[1], word, f"Give one {_NAMES.get(quantity, quantity)}.")

    def _take_changes(self, tokens: list[Token]) -> list[Token]:
        """Take out the two values of a force or speed that changes: "from A to B", "A at first, B at the end"."""
        phases = [phase for token in tokens if (phase := token.get("phase"))]
        ramps = [token for token in tokens if token.get("ramp")]
        for quantity, usual in (("force", RUB_N), ("speed", SCRAPE_SPEED_M_S)):
            values = [token for token in tokens if token.get(quantity) is not None]
            changes = bool(ramps) or f"{quantity}_change" in self.said
            alone = changes and len(values) == 1 and values[0].get("aim") == "to"
            if alone or (len(values) == 2 and (phases or changes or values[1].get("aim") == "to")):
                first, last = (values[-1], values[0]) if phases[:1] == ["end"] else (values[0], values[-1])
                start, end = usual if alone else first.get(quantity), last.get(quantity)
                if any((end - start) * ramp.get("ramp") < 0 for ramp in ramps):
                    raise self.contradict(ramps[0].text, last.text, "Leave one out.")
                self.record(quantity, start, first.text)
                self.record(f"end_{quantity}", end, last.text)
                return self._take_changes([token for token in tokens if token not in values and token not in ramps])
            if len(values) == 1 and phases == ["end"]:
                raise self.refuse(f"'{values[0].text}' says only how it ends", "Say: soft at first, then hard.")
        if ramps:
            raise self.refuse(f"'{ramps[0].text}' says not what", "Say: with increasing force, or: from 1 N to 3 N.")
        return tokens

    def _name_length(self, token: Token, value: float) -> tuple[str, float, str]:
        """Return the quantity that a length gives, by the word beside it: "5 cm across", "radius of 15 mm"."""
        index = next(i for i, each in enumerate(self.tokens) if each is token)
        telling = [each for each in self.tokens[index + 1 :] if each.meaning or each.text != "in"][:1]
        telling += [each for each in reversed(self.tokens[:index]) if each.meaning][:1]
        marked = next((each for each in telling if each.get("marker")), Token(""))
        marker = marked.get("marker")
        if marker in (None, "length"):
            rounded = {"circle", "spiral", "figure-eight", "wander"} & {each.get("kind") for each in self.tokens}
            return ("across" if rounded and not marker else "length"), value, token.text
        return "across", 2.0 * value if marker == "radius" else value, f"{marked.text} {token.text}"

    def build(self, earlier: Sequence[Step]) -> list[Step]:
        """Build the step, given those before it; several if each has a duration, or pauses lie between repeats."""
        moves = [step for step in earlier if step.kind not in ("pause", "lift")]
        angle = _compute_angle(self)
        kind = self._find_kind(angle, moves)
        same = next((step for step in reversed(moves) if step.kind == kind), None)
        if kind == "halfway":
            if "duration" in self.found:
                raise self.refuse("'halfway' has no duration of its own", "Say: slide, pause for 1 s, slide.")
            kind, self.found["repeats"] = "stop-and-go", (2, "halfway")
        if self.get("back") and same and "clockwise" in ALLOWED[kind]:
            self.record("clockwise", not same.clockwise, "back")
        elif self.get("back"):
            last = next((step for step in reversed(moves) if step.kind not in STILL), Step("line"))
            opposite = ((last.angle_deg or 0.0) + 180.0) % 360.0
            if not moves or angle not in (None, opposite):
                raise self.refuse("'back' has nothing to go back from", "Give a direction: to the left.")
            angle = opposite
        if kind in ("press", "lift") and set(self.directions) <= {"down", "up", "and"}:
            angle = None
        self._record_ends(moves, kind)
        size = self.found.pop("size", self.found.pop("brief", None)) if kind in ("press", "pause") else None
        if size and "duration" not in self.found:
            self.found["duration"] = (LONG_S if size[0] == LARGE else BRIEF_S), size[1]
        if self.get("apart") and kind in ("tap", "drum"):
            self.record("rate", float(f"{1 / self.get('apart'):.9g}"), self.found.pop("apart")[1])
        names = [name for name in Step._fields if name not in ("kind", "angle_deg")]
        step = Step(kind, angle, **{name: self.get(re.sub("_(m|hz|s)$", "", name)) for name in names})
        self._check(step)
        if self.get("again") or ("loop" in self.said and same):
            if same is None:
                raise self.refuse("'again' has nothing to repeat", "Say the stroke first.")
            said_before = {name: getattr(same, name) for name in names if getattr(step, name) is None}
            step = step._replace(**said_before, angle_deg=same.angle_deg if angle is None else angle)
        gap_s, each = self.said.get("between"), bool(step.repeats and step.duration_s and self._has_each())
        if gap_s and not step.repeats:
            raise self.refuse("the pause lies between nothing", "Say how often: tap 3 times with 1 s between.")
        if gap_s or (each and kind == "press"):
            whole = step._replace(repeats=None)
            return _repeat_steps(self.words, [whole], step.repeats or 1, gap_s)
        return [step._replace(duration_s=(step.duration_s or 0.0) * (step.repeats or 1)) if each else step]

    def _has_each(self) -> bool:
        """Return whether the duration is that of each repeat: "2 s each", "of one second each", "three 2 s presses"."""
        padded = [Token(""), Token(""), *self.tokens, Token(""), Token("")]
        index = next((i for i, token in enumerate(padded) if token.get("duration")), 2)
        beside = any(token.get("each") for token in padded[index - 2 : index + 3])
        return beside or bool(padded[index + 1].motion and {"repeats", *LEVELS} & set(dict(padded[index - 1].meaning)))

    def _find_kind(self, angle: float | None, moves: Sequence[Step]) -> str:
        """Find the kind of motion; a shape outweighs a verb, unless they are different motions."""
        said = [token for token in self.tokens if token.meaning and token.text != "and"]
        run = list(itertools.takewhile(lambda token: token.text == said[0].text, said))
        if len(run) > 1 and run[0].motion and (run[0].get("axis") is not None or " " not in run[0].text):
            self.found.setdefault("repeats", (len(run), " ".join(token.text for token in run)))
        kind = self.get("kind")
        verbs = [(verb, text) for verb, text in self.verbs if verb not in _WEAK]
        for verb, text in verbs:
            excluded = kind in STILL or (kind == "wander" and verb == "line")
            if excluded or (not kind and verb != verbs[0][0]):
                other = self.found["kind"][1] if excluded else verbs[0][1]
                one, two = sorted((other, text), key=self.words.lower().find)
                raise self.contradict(one, two, f"Give one {_NAMES['kind']}.")
        weak = {verb for verb, _ in self.verbs}
        verb = verbs[0][0] if verbs else "hold" if "hold" in weak else ""
        if kind:
            return str(kind)
        if verb == "hold":
            return "pause" if moves and moves[-1].kind not in STILL else "press"
        if self.get("inwards") is not None or self.get("clockwise") is not None:
            return "circle" if self.get("inwards") is None else "spiral"
        if not weak and moves:
            return moves[-1].kind
        if self.get("rate") is not None or (verb == "wander" and (angle is not None or self.get("repeats"))):
            return "back-and-forth"
        named = any(text not in _AUXILIARIES for _, text in self.verbs)
        if not (named or angle is not None or set(self.found) - {"repeats", "size", "brief", "duration"}):
            raise self.refuse(*NO_MOTION)
        stays = (angle is None or set(self.directions) == {"down"}) and not {"length", "speed", "repeats"} & set(
            self.found
        )
        return verb or ("line" if not stays else "wander" if "feel" in weak else "press" if "touch" in weak else "line")

    def _record_ends(self, moves: Sequence[Step], kind: str) -> None:
        """Record force and speed at both ends where they change on the way; "then harder" compares instead."""
        motionless = not self.verbs and "kind" not in self.found
        compares = bool(moves) and "gradual" not in self.said and (motionless or bool(self.get("again")))
        for quantity, levels in LEVELS.items():
            change, known = self.get(f"{quantity}_change"), self.get(quantity)
            if not change:
                continue
            text, start, end = self.found[f"{quantity}_change"][1], levels[2 - change], levels[2 + change]
            if compares and known is None:
                ended = getattr(moves[-1], f"end_{quantity}")
                last = ended or getattr(moves[-1], quantity) or levels[2]
                reached = next((each for each in (end, levels[2 + 2 * change]) if (each - last) * change > 0), None)
                if reached is None:
                    raise self.refuse(f"'{text}' than that is no level", "Say how much: 5 N, 300 mm/s.")
                self.record(quantity, ended or reached, text)
                self.found |= {f"end_{quantity}": (reached, text)} if ended else {}
            elif f"end_{quantity}" not in self.found:
                self.record(quantity, start if known is None else known, text)
                self.record(f"end_{quantity}", float(f"{(known or start) * end / start:.9g}"), text)
            elif (self.get(f"end_{quantity}") - (known or 0.0)) * change < 0:
                raise self.refuse(f"'{text}' contradicts the rest", f"Give one {quantity}.")

    def _check(self, step: Step) -> None:
        allowed = [*ALLOWED[step.kind].split(), *["motionless"] * (step.kind in STILL)]
        if step.angle_deg is not None and "angle" not in allowed:
            text = " ".join(self.directions) or self.found.get("angle", self.found.get("axis", ("", "back")))[1]
            if step.kind == "wander":
                raise self.refuse(f"a rub goes every way, '{text}' only one", "Say scrape, or leave the direction out.")
            raise self.refuse(f"'{text}' says nothing of a {step.kind}", "Leave the direction out.")
        for quantity, (value, text) in self.found.items():
            name = quantity.removeprefix("end_").removesuffix("_change")
            if name in ("kind", "again", "back", "axis", "each"):
                continue
            measured_speed = name == "speed" and step.kind in STILL and any(letter.isdigit() for letter in text)
            changes = f"end_{name}" in self.found and step.kind in ("tap", "drum", *["press"] * (name == "speed"))
            leads_nowhere = step.kind == "tap" and name == "length" and step.angle_deg is None
            if name not in allowed or measured_speed or changes or leads_nowhere:
                raise self.refuse(f"'{text}' says nothing of a {step.kind}", "Leave it out, or say another motion.")
            low, high, unit = _LIMITS.get(name, (-np.inf, np.inf, ""))
            if not (low <= value <= high or quantity.endswith("_change")):
                raise self.refuse(f"{value:g} {unit} is no stroke", f"Give {low:g} to {high:g} {unit}.")


_SILENT = {"marker", "gradual", "phase", "surface", "is", "pronoun", "loop", "between", "aim"}
"""Quantities of tokens that a step does not record."""


def _compute_angle(parsed: _ParsedStep) -> float | None:
    """Return the angle in degrees, anticlockwise from left to right; None if none was said."""
    words, axis, angle = parsed.directions, parsed.get("axis"), parsed.get("angle")
    named, diagonal = [word for word in words if word in _GRID], "diagonal" in words
    if angle is not None:
        if set(words) - {"to"}:
            raise parsed.contradict(parsed.found["angle"][1], " ".join(words))
        return float(angle)
    sides = [word for word in words if word != "to"] if "from" not in words else words
    for before, word, after in zip(sides, sides[1:], sides[2:], strict=False):
        opposed = [a * b for a, b in zip(_GRID.get(before, (0, 0)), _GRID.get(after, (0, 0)), strict=True)]
        if word == "and" and min(opposed) < 0:
            raise parsed.contradict(before, after)
    if not named:
        if any(word != "and" for word in words) and not diagonal:
            raise parsed.refuse(f"'{words[0]}' leads nowhere", "Example: left to right.")
        return float(GRID_ANGLES[(1, -1)]) if diagonal else axis
    x, y = (_find_axis_sign(parsed, words, index) for index in (0, 1))
    if diagonal:
        x, y = x or 1, y or -1
    if (x, y) == (0, 0):
        raise parsed.refuse(f"'{' '.join(words)}' goes nowhere", "Give two different sides.")
    found = float(GRID_ANGLES[(x, y)])
    if axis is not None and (found - axis) % 180.0:
        raise parsed.contradict(parsed.found["axis"][1], " ".join(words))
    return found


def _find_axis_sign(parsed: _ParsedStep, words: list[str], axis: int) -> int:
    """Return the direction along one axis: −1, 0 or 1.

    A side named before "to", after "from" or as the first of two is the start.
    """
    source: list[tuple[int, str]] = []
    target: list[tuple[int, str]] = []
    aims, after_from = [index for index, word in enumerate(words) if word == "to"], False
    for index, word in enumerate(words):
        after_from = word == "from" if word in ("to", "from") else after_from
        if sign := _GRID.get(word, (0, 0))[axis]:
            starts = (after_from and (word in _SIDES or words[index - 1] == "from")) or (
                word in _SIDES and any(aim > index for aim in aims)
            )
            (source if starts else target).append((sign, word))
    if not source and len(target) == 2 and target[0][1] in _SIDES:
        source, target = target[:1], target[1:]
    for group in (source, target):
        if len({sign for sign, _ in group}) > 1:
            raise parsed.contradict(group[0][1], group[1][1])
    starts_at_side = any(word in _SIDES for word in words[: (aims or [0])[0]])
    lonely = source if not target else target if not source and starts_at_side else []
    if lonely and aims:
        raise parsed.refuse(f"'{lonely[0][1]}' has no other side", "Name both corners: top left to bottom right.")
    if source and target and source[0][0] == target[0][0]:
        return 0
    return target[0][0] if target else -source[0][0] if source else 0
