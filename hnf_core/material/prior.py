"""The prior route: from shading values and names to a ranked list of library materials.

Naive Bayes over the library. Prior: how common a category is in scenes, within it from the usual to the special.
Words: a word that names a material makes it WORD_ODDS times likelier, less where the word belongs to several
categories or stands in a less telling name. Shading values: truncated normals around the library's typical value,
mixed with a uniform one (artists do as they like) and tempered (values hang together). The confidence of a suggestion
is its expected aptness: 1 where it is right, ALIKE where another material of its category is.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..errors import MaterialError
from .material import Appearance, LibraryMaterial
from .words import CATEGORY_WORDS, OBJECT_WORDS, STOP_WORDS, singulars, split_words

WORD_ODDS = 300.0
NAME_WEIGHTS = (1.0, 0.6, 0.35)
"""Exponents of WORD_ODDS for a word in the first name (the material's), the second (the object's), any other."""
OBJECT_WORD_WEIGHT = 0.55
"""For words of things and finishes, not stuffs: a lens is mostly glass, satin is often metal."""
NAME_PART_WEIGHT = 0.4
"""For parts of a library material's own name: "coarse" says something of coarse-carpet, not much."""
RELATED_WEIGHT = 0.7
"""For the others of a category where one of them bears the very word: velvet is also a fabric, but not denim."""
COMMON = {"plastic": 1.6, "wood": 1.3, "metal": 1.3, "fabric": 1.3, "carpet": 0.7, "foam": 0.5}
"""How often scenes hold a category, against the others' 1: all that is left where nothing else tells."""
DEFAULT_GREY, DEFAULT_ROUGHNESS = 0.8, 0.5
"""Of a new Principled BSDF."""
TEMPER = 0.6
UNIFORM_FLOOR = 0.03
ALIKE = 0.85
REASON_WORDS = 3
SPREAD = {"roughness": 0.18, "metallic": 0.12, "sheen": 0.25, "transmission": 0.2}
DOUBT = {"roughness": 0.2, "metallic": 0.1, "sheen": 0.2, "transmission": 0.1}
"""Share of the uniform part: how often a value says nothing."""
COLOR_SPREAD = {
    "wood": (0.2, 0.06),
    "metal": (0.2, 0.06),
    "stone": (0.2, 0.06),
    "paper": (0.2, 0.08),
    "rubber": (0.15, 0.08),
    "leather": (0.25, 0.1),
    "tile": (0.25, 0.1),
    "glass": (0.3, 0.1),
}
"""Of lightness and of chroma, in cube roots of linear values."""
DYED_SPREAD = (0.35, 0.2)
"""Of everything that is dyed or painted at will."""
ANY_CHROMA = 0.25
"""Chroma spread of all materials together, which a material's own is held against."""
COLOR_DOUBT = 0.3


@dataclass(frozen=True)
class Suggestion:
    """name: of a library material. confidence: 0–1. reason: for the report, one line."""

    name: str
    confidence: float
    reason: str


def rank(library: Sequence[LibraryMaterial], appearance: Appearance, names: Sequence[str]) -> tuple[Suggestion, ...]:
    """All library materials, the most apt first.

    appearance: shading values, None = not known (says nothing). names: the material's name first ("" where it has
    none), then the object's, then those of textures and collections. library: within a category, the usual first.
    Equal input gives equal order; ties keep the library's. Raises MaterialError on an empty library.
    """
    if not library:
        raise MaterialError("the material library is empty.", remedy="Install the package with its data files.")
    hits = _word_hits(library, names)
    appearance = _chosen(appearance)
    score = _log_prior(library)
    looks = [_appearance_log_odds(material, appearance) for material in library]
    for i, material in enumerate(library):
        score[i] += TEMPER * sum(looks[i].values())
        score[i] += math.log(WORD_ODDS) * sum(weight for weight, _ in hits[material.name].values())
    probability = np.exp(score - score.max())
    probability = (1.0 - UNIFORM_FLOOR) * probability / probability.sum() + UNIFORM_FLOOR / len(library)
    same = np.array([[a.category == b.category for b in library] for a in library])
    aptness = (1.0 - ALIKE) * probability + ALIKE * (same @ probability)
    usual = {field: float(np.median([look.get(field, 0.0) for look in looks])) for look in looks for field in look}
    # Within a category aptness differs by the material's own probability alone, so the order is the posterior's.
    order = np.argsort(-aptness, kind="stable")
    return tuple(
        Suggestion(library[i].name, float(aptness[i]), _reason(hits[library[i].name], looks[i], usual, appearance))
        for i in order
    )


def _log_prior(library: Sequence[LibraryMaterial]) -> NDArray[np.float64]:
    """Within a category the k-th entry weighs 1/√k: a plain metal before a knurled one. Not normalised."""
    places: dict[str, int] = {}
    weights = []
    for material in library:
        places[material.category] = places.get(material.category, 0) + 1
        weights.append(1.0 / math.sqrt(places[material.category]))
    totals = {c: sum(w for m, w in zip(library, weights, strict=True) if m.category == c) for c in places}
    return np.array(
        [
            math.log(COMMON.get(material.category, 1.0) * weight / totals[material.category])
            for material, weight in zip(library, weights, strict=True)
        ]
    )


def _vocabulary(library: Sequence[LibraryMaterial]) -> dict[str, dict[str, float]]:
    """word (phrases joined by spaces, and run together) → {material name: weight}."""
    owned = {form for material in library for word in material.words for form in _forms(word)}
    stuffs = {form for words in CATEGORY_WORDS.values() for word in words.split() for form in _forms(word)}
    vocabulary: dict[str, dict[str, float]] = {}
    for material in library:
        weighted: dict[str, float] = {}

        def add(words: Iterable[str], weight: float, into: dict[str, float] = weighted) -> None:
            for form in (form for word in words for form in _forms(word)):
                into[form] = max(into.get(form, 0.0), weight)

        related = CATEGORY_WORDS.get(material.category, "").split()
        add((word for word in related if word not in owned), 1.0)
        add(related, RELATED_WEIGHT)
        add((thing for thing, made_of in OBJECT_WORDS.items() if material.category in made_of), OBJECT_WORD_WEIGHT)
        add(material.name.split("-"), NAME_PART_WEIGHT)
        add(material.words, OBJECT_WORD_WEIGHT)
        add((word for word in material.words if _forms(word) & stuffs), 1.0)
        add((material.category, material.name), 1.0)
        for form, weight in weighted.items():
            vocabulary.setdefault(form, {})[material.name] = weight
    return vocabulary


def _forms(word: str) -> set[str]:
    parts = split_words(word)
    return {" ".join(parts), "".join(parts)} - STOP_WORDS - {""}


def _word_hits(library: Sequence[LibraryMaterial], names: Sequence[str]) -> dict[str, dict[str, tuple[float, str]]]:
    """material name → {matched word: (weight, the name it stood in)}; a word told twice counts once."""
    vocabulary = _vocabulary(library)
    category = {material.name: material.category for material in library}
    count = len(set(category.values()))
    hits: dict[str, dict[str, tuple[float, str]]] = {material.name: {} for material in library}
    for place, name in enumerate(names):
        telling = NAME_WEIGHTS[min(place, len(NAME_WEIGHTS) - 1)]
        for word in _matches(name, vocabulary):
            spread = len({category[material] for material in vocabulary[word]})
            special = 1.0 if count < 2 else 1.0 - math.log(spread) / math.log(count)
            for material, weight in vocabulary[word].items():
                total = telling * special * weight
                if total > hits[material].get(word, (0.0, ""))[0]:
                    hits[material][word] = (total, name)
    return hits


def _matches(name: str, vocabulary: Mapping[str, object]) -> list[str]:
    """Whole words and phrases of up to three words of the vocabulary that stand in the name."""
    words = [word for word in split_words(name) if word not in STOP_WORDS]
    found: list[str] = []
    for length in (1, 2, 3):
        for start in range(len(words) - length + 1):
            head = " ".join(words[start : start + length - 1])
            for last in singulars(words[start + length - 1]):
                phrase = f"{head} {last}".strip()
                if phrase in vocabulary:
                    found.append(phrase)
                    break
    return found


def _chosen(appearance: Appearance) -> Appearance:
    """Less the base colour and roughness that every new material is born with: nobody chose them."""
    color, roughness = appearance.base_color, appearance.roughness
    if color is not None and all(abs(channel - DEFAULT_GREY) < 1e-3 for channel in color):
        color = None
    if roughness is not None and abs(roughness - DEFAULT_ROUGHNESS) < 1e-3:
        roughness = None
    return replace(appearance, base_color=color, roughness=roughness)


def _appearance_log_odds(material: LibraryMaterial, appearance: Appearance) -> dict[str, float]:
    """shading value → log of its density under the material over that of no knowledge (uniform)."""
    odds: dict[str, float] = {}
    for field, spread in SPREAD.items():
        value, typical = getattr(appearance, field), getattr(material.appearance, field)
        if value is not None and typical is not None and math.isfinite(value):
            density = _truncated_normal(min(max(value, 0.0), 1.0), typical, spread)
            odds[field] = math.log((1.0 - DOUBT[field]) * density + DOUBT[field])
    color, typical_color = appearance.base_color, material.appearance.base_color
    if color is not None and typical_color is not None and all(math.isfinite(c) for c in color):
        spread_light, spread_chroma = COLOR_SPREAD.get(material.category, DYED_SPREAD)
        (light, *chroma), (typical_light, *typical_chroma) = _light_chroma(color), _light_chroma(typical_color)
        density = _truncated_normal(light, typical_light, spread_light)
        for value, typical in zip(chroma, typical_chroma, strict=True):
            density *= _normal(value, typical, spread_chroma) / _normal(value, 0.0, ANY_CHROMA)
        odds["colour"] = math.log((1.0 - COLOR_DOUBT) * density + COLOR_DOUBT)
    return odds


def _light_chroma(color: Sequence[float]) -> tuple[float, float, float]:
    """Mean and two differences of the channels' cube roots: near to what is seen, where linear values would call
    every dark colour alike."""
    red, green, blue = (math.cbrt(min(max(channel, 0.0), 1.0)) for channel in color)
    return (red + green + blue) / 3.0, red - green, green - blue


def _normal(value: float, mean: float, spread: float) -> float:
    return math.exp(-0.5 * ((value - mean) / spread) ** 2) / (spread * math.sqrt(2.0 * math.pi))


def _truncated_normal(value: float, mean: float, spread: float) -> float:
    """Density on [0, 1] of a normal cut to it."""
    root = spread * math.sqrt(2.0)
    inside = 0.5 * (math.erf((1.0 - mean) / root) + math.erf(mean / root))
    return _normal(value, mean, spread) / inside


def _reason(
    hits: Mapping[str, tuple[float, str]],
    looks: Mapping[str, float],
    usual: Mapping[str, float],
    appearance: Appearance,
) -> str:
    """The words found, then the values that fit better than they fit half of the library, and those that clash."""
    parts = [f"'{word}' in '{name}'" for word, (_, name) in sorted(hits.items(), key=lambda item: -item[1][0])]
    del parts[REASON_WORDS:]
    for verdict, chosen in (
        ("fits", [field for field, odds in looks.items() if odds > max(usual[field] + 0.2, 0.0)]),
        ("does not fit", [field for field, odds in looks.items() if odds < -0.7]),
    ):
        parts += [f"{_value_text(field, appearance)} {verdict}" for field in chosen]
    return "; ".join(parts) or "nothing in the scene tells"


def _value_text(field: str, appearance: Appearance) -> str:
    return "colour" if field == "colour" else f"{field} {getattr(appearance, field):.2f}"
