"""Tokens of a stroke in words: text → words, phrases, quantities and separators, each with what it says.

The vocabulary is in tables: words, phrases and what each means. Signs, abbreviations and numbers in words are first
rewritten. What depends on its neighbours is settled here: "very" of a level, "3" of taps, "to" of a level, a pause
between repeats. `parse_stroke.py` makes steps of the tokens.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..errors import UsageError
from .primitives import HARD_N, RUB_N, SCRAPE_SPEED_M_S, SOFT_N, SPEED_LEVELS

Meaning = tuple[tuple[str, float | str | bool], ...]

LEVELS = {"force": (0.2, SOFT_N, RUB_N, HARD_N, 4.0), "speed": tuple(SPEED_LEVELS.values())}
"""Five levels each, from very soft to very hard [N] and from very slow to very fast [m/s]."""
SLOW_M_S, FAST_M_S = LEVELS["speed"][1], LEVELS["speed"][3]
SMALL, LARGE = 0.4, 2.0
"""Factors of size."""

_VERBS = {
    "move": "move go went run ran draw drew trace make made do did line gave give travel movement motion pass"
    " unidirectional perform execute carry proceed continue keep work take took",
    "touch": "touch contact apply push shove exert",
    "line": "scrape stroke drag slide slid swipe wipe brush scratch glide sweep swept pull skim scan graze trail skate"
    " pet streak smear rake comb scuff traverse skid strum flick translate caress guide tug haul"
    " swish slither rasp swoop",
    "wander": "rub polish massage buff",
    "feel": "feel felt",
    "hold": "hold held rest dwell",
}
"""A stroke may not say two of them; "move", "touch", "feel" and "hold" say no more than that there is one, and a touch
that goes nowhere is a press."""
_SHAPES = {
    "wander": "random randomly freely explore wander scribble roam doodle meander",
    "back-and-forth": "scrub reciprocate oscillate oscillation alternate wiggle wobble shake saw sand scour rock sway"
    " swing shuttle waggle",
    "zigzag": "zigzag",
    "wave": "wave wavy wiggly sinusoidal squiggle squiggly undulate snake weave curvy",
    "circle": "circle circular round loop ring swirl circ orbit rotate rotation twirl whirl lap revolution spin revolve"
    " turn circuit",
    "spiral": "spiral",
    "square": "square sq",
    "triangle": "triangle triangular",
    "press": "press squeeze lean squish squash indent indentation compress depress static mash flatten",
    "tap": "tap knock poke hit pat prod rap strike struck bump thump dab jab peck bang bounce hammer pound beat",
    "drum": "drum patter",
    "stop-and-go": "jerk jerky jerkily intermittent intermittently stutter",
    "pause": "pause wait stop halt break silence nothing freeze delay idle",
    "lift": "lift release raise retract withdraw",
}
"""Words that say the kind by themselves."""
_FILLER = (
    "a an the with at in of by for on over along around during until till about under upon within via as and or so"
    " but both through onto into ok okay alright right first now also there here can could should would will must"
    " might may need needs let lets i we he she they it its this that these those them him his her their our your you"
    " my me us who which participant participants observer observers subject subjects user users person people child"
    " player character robot some someone somebody being has have had having maybe perhaps immediately instantly"
    " suddenly directly linearly nearly much see d s ll re ve following gimme gotta simulate imitate produce create"
    " generate show add record please just simply quite pretty rather fairly bit force pressure load weight speed"
    " velocity pace rate tempo frequency rhythm duration amount level intensity value direction heading sense angular"
    " side sides edge corner border hand hands finger fingers fingertip fingertips index thumb pad nail fingernail"
    " palm knuckle pen stylus tip probe tool indenter begin get constant steady straight linear way time times use"
    " using while centre center middle still lateral laterally f fn fz v vel t dur len nice nicely smooth smoothly"
    " even evenly uniform regular careful carefully comfortable comfortably natural naturally controlled clean"
    " distinct separate individual successive consecutive want wants wanted wish like love try mind sure asked told"
    " instructed trial approximately exactly precisely uh um er hmm well oh hey yeah kind sort somewhat relatively"
    " reasonably slightly lasting lasts total altogether overall peak mean average target thanks own per whole full"
    " distance path track course outline shape pattern form step thing things moving together style continuous"
    " continuously trajectory place put position positioned bring reach reaching maintain maintaining going gonna"
    " wanna only proper properly simple plain normally repetition gesture action interaction"
)
_SURFACES = (
    "surface sample object material table stimulus specimen fabric cloth texture textile wood leather paper plate"
    " panel skin metal steel stone brick tile glass plastic rubber ceramic cotton silk velvet denim linen wool felt"
    " fur foam cork cardboard carpet rug desk block board ball"
)
_WORDS: tuple[tuple[str, float | str | bool, str], ...] = (
    *(("verb", kind, words) for kind, words in _VERBS.items()),
    *(("kind", kind, words) for kind, words in _SHAPES.items()),
    ("force", SOFT_N, "soft softly light lightly gentle gently delicate delicately weak weakly faint faintly mild"
     " mildly tenderly subtle subtly"),
    ("force", RUB_N, "medium moderate moderately normal"),
    ("force", HARD_N, "hard firm firmly strong strongly heavy heavily forceful forcefully powerful powerfully vigorous"
     " vigorously intense intensely solid solidly aggressively deep deeply"),
    ("speed", SLOW_M_S, "slow slowly leisurely lazy lazily calmly sluggish sluggishly unhurried"),
    ("speed", FAST_M_S, "fast quick quickly rapid rapidly swift swiftly brisk briskly speedy speedily"),
    ("force_change", 1, "harder stronger firmer heavier"), ("force_change", -1, "softer lighter weaker gentler"),
    ("speed_change", 1, "faster quicker speeding quickening accelerate accelerates accelerating"),
    ("speed_change", -1, "slower slowing decelerate decelerates decelerating"),
    ("degree", "very", "very really super extremely extra"), ("degree", "more", "more increasingly"),
    ("degree", "less", "less"), ("gradual", True, "getting becoming gradually progressively growing"),
    ("phase", "start", "start starts starting started begins beginning initially"),
    ("phase", "end", "end ends ending finish finishes finishing"), ("direction", "from", "from"),
    ("direction", "to", "to towards toward →"), ("direction", "left", "left l ←"), ("direction", "right", "right r"),
    ("direction", "top", "top upper"), ("direction", "bottom", "bottom lower"),
    ("direction", "leftward", "leftward leftwards west"), ("direction", "rightward", "rightward rightwards east"),
    ("direction", "up", "up upward upwards north ↑"), ("direction", "down", "down downward downwards south ↓"),
    ("direction", "diagonal", "diagonal diagonally diag"), ("axis", 0.0, "horizontal horizontally sideways"),
    ("axis", 270.0, "vertical vertically"), ("angle", 90.0, "forward forwards"), ("angle", 270.0, "backward backwards"),
    ("clockwise", True, "clockwise cw"), ("clockwise", False, "anticlockwise counterclockwise ccw"),
    ("inwards", True, "inward inwards"), ("inwards", False, "outward outwards out"),
    ("size", SMALL, "small little tiny teeny wee short tight narrow"),
    ("size", LARGE, "large big long wide huge broad giant"),
    ("brief", True, "brief briefly"), ("marker", "radius", "radius"), ("marker", "across", "diameter across dia width"),
    ("marker", "length", "length"), ("repeats", 1, "single"), ("again", True, "again another"),
    ("pronoun", True, "ones"), ("back", True, "back other opposite reverse return returns returning"),
    ("each", True, "each"),
    ("loop", True, "repeat repeats repeated repeating everything"), ("every", True, "every"),
    ("between", True, "between gap gaps"), ("apart", True, "apart interval intervals"), ("surface", True, _SURFACES),
    ("is", True, "is are was were be feels looks"),
)  # fmt: skip

_NOUNS = {"force": "(?:force|pressure|load)", "speed": "(?:speed|velocity|pace)"}
_AMOUNTS = (
    "(?:minimum|minimal|very (?:low|little|small)|almost no|nearly no)", "(?:low|small|little|less|slight)",
    "(?:medium|moderate|average)", "(?:high|big|great|large|much|more|(?:a )?lots? of)",
    "(?:full|maximum|maximal|very (?:high|much|large)|top)",
)  # fmt: skip
_RISE = "(?:(?:increas|rais|ris)(?:es?|ed|ing)|(?:grow|build|ramp|climb)(?:s|ing)?)(?: up)?"
_FALL = (
    "(?:(?:decreas|reduc|eas)(?:es?|ed|ing)|(?:fall|drop|taper)(?:s|p?ing)?|lower(?:s|ing)|ramp(?:s|ing)? down)"
    "(?: (?:off|out|away))?"
)
_PLACE = r"(?:(?:the|its) )?(?:very |far )?(?:left|right|top|bottom|upper|lower)\b"
_MOST = "as (?:{}) as (?:you can|possible)"
_GRAIN = "(?:grain|fib(?:re|er)s?|grooves?|ridges?|weave|nap|pile)"
_TAPS = r"(?=(?:tap|knock|pat|poke|press|prod)(?:e?s)?\b)"
_MIDDLE = "(?:centre|center|middle)"
_SHUTTLE: Meaning = (("kind", "back-and-forth"),)

_SAYINGS: tuple[tuple[str, float | str | bool, str], ...] = (
    ("kind", "stop-and-go", "stop and go|start and stop|starting and stopping|stopping and starting"),
    ("kind", "zigzag", "zig zag(?:s|ging)?"), ("kind", "figure-eight", "fig(?:ure)?s? (?:of )?8s?"),
    ("kind", "press", "(?:press|push|squash|hold|lean|bear)(?:ing)? (?:(?:it|this|that|your finger"
     "|the (?:finger|pen|tip)) )?(?:down|in)(?: on)?|push(?:ing)? (?:on|against|into)"),
    ("kind", "lift", "let (?:it )?go|(?:break(?:ing)?|no) contact"
     "|(?:lift|take) (?:(?:it|your finger|the (?:finger|pen)) )?(?:off|up|away)"),
    ("kind", "pause", "do(?:ing)? nothing"),
    ("kind", "halfway", "(?:stop|paus|halt)(?:s|e|es|ing|ping)? (?:briefly )?(?:halfway|half way|midway)"),
    ("verb", "touch", f"ramp {_NOUNS['force']}|(?:make|put|exert)(?:s|ing)? (?:some )?pressure"),
    ("repeats", 2, f"double {_TAPS}"), ("repeats", 3, f"triple {_TAPS}"), ("force", SOFT_N, f"little {_TAPS}"),
    ("force", 0.2, "(?:hardly|barely|scarcely) (?:any|touch(?:ing)?|press(?:ing)?)(?: force| pressure)?"
     "|(?:light as a )?feathery?(?: light)?|" + _MOST.format("softly|lightly|gently")),
    ("force", SOFT_N, r"a (?:little bit|little|bit)(?=\s*(?:$|[,;.!?]|then|and|for))"),
    ("force", 4.0, "with all (?:your|its|my) (?:might|strength|weight|force)|"
     + _MOST.format("hard|firmly|strongly")),
    ("speed", SCRAPE_SPEED_M_S, "normal speed"), ("speed", 0.02, _MOST.format("slow|slowly")),
    ("speed", 0.3, _MOST.format("fast|quick|quickly")),
    *((name, level, f"{amount} {noun}") for name, noun in _NOUNS.items()
      for level, amount in zip(LEVELS[name], _AMOUNTS, strict=True)),
    *((f"{name}_change", sign, f"{change} (?:(?:the|in|your|its) )?{noun}|{noun} {change}")
      for name, noun in _NOUNS.items()
      for sign, change in ((1, f"(?:{_RISE}|more and more)"), (-1, f"(?:{_FALL}|less and less)"))),
    ("force_change", 1, "harder and harder"), ("speed_change", 1, "speed(?:s|ing)? up|faster and faster"),
    ("force_change", -1, "softer and softer|fad(?:es?|ing)(?: (?:out|away))?"),
    ("speed_change", -1, "slow(?:s|ing)? down|slower and slower|to a (?:stop|halt)"),
    ("degree", "not", "not (?:too|so|very|that)"), ("degree", "very", "really really|very very"),
    ("degree", "more", "more and more"), ("degree", "less", "less and less"),
    ("ramp", 1, _RISE), ("ramp", -1, _FALL),
    ("gradual", True, f"(?:slowly|steadily) (?=(?:{_RISE}|{_FALL}|getting|speed))"),
    ("phase", "start", "(?:start|begin)(?:s|ing)? (?:off|out|with)|at (?:first|the (?:start|beginning))"
     "|to (?:begin|start) with|in the beginning"),
    ("phase", "end", "(?:end|finish)(?:s|ing)? (?:up|off|with)|(?:at|by|in) the (?:very )?end"),
    ("direction", "from", f"(?:start|begin)(?:s|ing|ning)?(?: (?:at|from|on|in))? (?={_PLACE})"),
    ("direction", "to", f"(?:end|finish|stop)(?:s|ing|ping)?(?: up)?(?: (?:at|on|in))? (?={_PLACE})"),
    *(("direction", way, f"{hour} o'?clock")
      for hour, way in ((12, "top"), (3, "right"), (6, "bottom"), (9, "left"))),
    *(("angle", (90.0 - 30.0 * hour) % 360.0, f"{hour} o'?clock") for hour in (1, 2, 4, 5, 7, 8, 10, 11)),
    ("direction", "up right", "north ?east"), ("direction", "up left", "north ?west"),
    ("direction", "down right", "south ?east"), ("direction", "down left", "south ?west"),
    ("clockwise", False, "(?:anti|counter) clockwise"),
    ("inwards", True, r"spiral(?:s|l?ing)? in(?!to| to)|in(?=\s*$|\s*[,;.])|from the outside in"
     f"|in to the {_MIDDLE}"),
    ("inwards", False, f"(?:out )?from the {_MIDDLE}(?: out(?:wards?)?)?|from the inside out"),
    ("angle", 0.0, f"(?:along|with) the {_GRAIN}"), ("angle", 180.0, f"against (?:the {_GRAIN}|it)"),
    ("angle", 90.0, f"(?:across|perpendicular to) the {_GRAIN}|away from (?:me|you|yourself)"),
    ("angle", 270.0, "towards? (?:me|you|yourself)"), ("marker", "across", "in diameter"),
    ("between", True, r"with (?=(?:an?|[0-9.]+ ?\w+) (?:\w+ )?(?:pause|break|rest)s?\b)|in between"
     "|between (?:them|each|taps|presses|strokes)"), ("motionless", True, "without moving"),
    ("loop", True, "(?:1 times|one) more(?: time)?|(?:do )?all (?:of )?(?:that|this|it)"
     "|(?:do )?(?:that|this|it) all|the (?:whole|entire) (?:thing|sequence)|same again|do (?:that|this|it) again"),
    ("refused", "it does not touch", "wav(?:e|es|ing) (?:(?:your|a|the|my|his|her) )?(?:hand|finger)s?"),
    ("refused", "it names a place", rf"(?:on|at|in|near|along|across|around|over) {_PLACE}(?: \w+)?|on top(?: of)?"
     "|(?:up|down) the (?:left|right)(?: hand)? (?:side|edge)"),
    ("refused", "it is a question", "^(?:what|which|who|how|why|where|when|is|are|was|were|does|did"
     "|do (?:you|we|they|people)|(?:can|may|should) (?:i|it))"),
    ("refused", "it goes two ways", r"in and out|out and in|alternat\w+ directions?"),
    ("refused", "no hand has it", "speed of (?:light|sound)"), ("refused", "it says not when", "now and then"),
    ("refused", "it says not how much", r"as (?:long|many|much|often) as"
     r"|(?:[0-9.]+ times|half|double) (?:as \w+(?! as (?:you|poss))|the (?:speed|force|pressure|size))"
     "|(?:up to|at (?:least|most)|no more than|below|above) (?=[0-9])"),
)  # fmt: skip
_PHRASES: tuple[tuple[Meaning, str], ...] = (
    (_SHUTTLE, "back and forth|forth and back|to and fro|there and back|in both directions|both ways"
     "|and back(?: again)?|(?:forwards?|fwd)(?: and |/| )back(?:wards?)?|backwards?(?: and | )forwards?"),
    ((*_SHUTTLE, ("axis", 90.0)), "up and down|down and up"),
    ((*_SHUTTLE, ("axis", 0.0)), "left and right|right and left|(?:from )?side to side"),
    *((((quantity, value),), pattern) for quantity, value, pattern in _SAYINGS),
    ((), r"[0-9]+ (?:things|steps|actions|parts)|across (?:it|the (?:surface|sample|object))|towards the end|as you go"
     r"|all over|all the way|a (?:little bit|little|bit) (?=\w+er|more|less)|a good|in a row|in succession|on the spot"
     "|in place|roughly (?=[0-9]|one|half)|edge to edge|end to end|from one (?:side|end|edge) to the other"
     "(?: (?:side|end|edge))?|(?:how|what) about|against (?=(?:the|a|your) )|(?:left|right|other) hand"
     "|right (?:away|now)|carry on|keep going|carr(?:y|ied) out|stroke length|without (?:stopping|pausing|lifting)"
     "|if (?:possible|you (?:can|like|please|would))"
     "|(?:pressing|contact|normal|tapping|stroking|sliding|constant|steady|peak|mean)"
     " (?:force|speed|velocity|pressure|load)"),
)  # fmt: skip
"""Patterns of several words; a blank stands for blanks or hyphens."""
EXAMPLES = (
    "scrape left to right, hard", "rub slowly in circles", "back and forth three times", "zigzag, slow", "figure eight",
    "press hard for two seconds", "tap twice, then rub in circles", "drum for 2 seconds", "stop and go to the left",
    "drag 5 cm at 80 mm/s with 1 N", "stroke along the grain", "spiral outwards, slowly", "square with sides of 3 cm",
)  # fmt: skip
"""Phrasings that are understood, of which the nearest is offered for one that is not."""


def _list_forms(verb: str) -> tuple[str, ...]:
    stem, doubled = verb.removesuffix("e"), f"{verb}{verb[-1]}"
    return verb, f"{verb}s", f"{verb}es", f"{verb}ing", f"{stem}ing", f"{doubled}ing", f"{stem}ed", f"{doubled}ed"


def _build_vocabulary() -> dict[str, Meaning]:
    """Return a mapping from every known single word to its meaning, empty for filler words."""
    meanings: dict[str, Meaning] = dict.fromkeys(_FILLER.split(), ())
    for quantity, value, words in _WORDS:
        for word in words.split():
            meaning = ((quantity, value),) if word != "caress" else ((quantity, value), ("force", SOFT_N))
            meanings.update(dict.fromkeys(_list_forms(word) if quantity in ("verb", "kind") else (word,), meaning))
    return meanings


VOCABULARY = _build_vocabulary()
KNOWN_WORDS = sorted({word for quantity, _, words in _WORDS for word in words.split() if quantity != "surface"})
"""Words that are offered for a mistyped one."""
PHRASES = [
    (
        re.compile(rf"(?<!\w)(?:{pattern.replace(' ', '[ -]+')})(?:\b|(?<=[ -]))".replace("[ -]+?", "[ -]*"), re.I),
        meaning,
    )
    for meaning, pattern in _PHRASES
]


BRIEF_S, LONG_S, GAP_S = 0.5, 2.0, 1.0
"""Durations of a brief and of a long press or pause, and of a pause between repeats [s]."""
NO_MOTION = "it says no motion", "Begin with scrape or rub, or give a direction: left to right."
_ARTICLES = {"a", "an", "the", "its", "my", "your"}

_DIGITS = r"(?:[0-9]+(?:\.[0-9]+)?|\.[0-9]+)(?:e[-+]?[0-9]+)?"
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
        levels = {"force", "speed", "size", "kind"} & set(dict(token.meaning))
        adjective = levels and token.text not in ("press", "tap", "feel")
        described = (adjective or token.text.endswith("ed")) and not token.text.endswith("ly")
        describes = following.get("surface") and described
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
            sides = (itertools.takewhile(lambda each: each.text != "→", some) for some in (settled, rest))
            says = [any(each.motion for each in side) for side in sides]
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
