"""Tables of the words of a stroke for `stroke_tokens.py`: what each word or phrase says, as (quantity, value) pairs.

The quantities are those of `primitives.Step`, and some that only the grammar uses: "verb", a weak kind, which a shape
("kind") outweighs; "direction", words of one; "axis", a direction without a sense; "degree", what becomes of the level
after it; "gradual", "ramp", "phase" and changes of force and speed, for what changes on the way; "again", "back",
"loop" and "pronoun", for what was said before; "each", "between", "apart" and "every", for repeats; "marker", what the
length beside it measures; "surface" and "is", which say no motion; "refused", the reason why it is no stroke.
"""

from __future__ import annotations

import re

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
