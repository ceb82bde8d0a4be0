"""The prior route: from shading values and names to a ranked list of library materials.

Naive Bayes over the library. Prior: every category alike, its materials alike. Words: a word that names a material
makes it WORD_ODDS times likelier, less where the word belongs to several categories or stands in a less telling name.
Shading values: truncated normals around the library's typical value, mixed with a uniform one (artists do as they
like) and tempered (values are often left at their defaults, and hang together). The confidence of a suggestion is its
expected aptness: 1 where it is right, ALIKE where another material of its category is.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import MaterialError
from .material import Appearance, LibraryMaterial
from .words import CATEGORY_WORDS, OBJECT_WORDS, STOP_WORDS, singulars, split_words

WORD_ODDS = 300.0
NAME_WEIGHTS = (1.0, 0.6, 0.45)
"""Exponents of WORD_ODDS for a word in the first name (the material's), the second (the object's), any other."""
OBJECT_WORD_WEIGHT = 0.55
"""For words of things, not stuffs: a lens is mostly glass."""
NAME_PART_WEIGHT = 0.4
"""For parts of a library material's own name: "coarse" says something of coarse-carpet, not much."""
RELATED_WEIGHT = 0.7
"""For the others of a category where one of them bears the very word: velvet is also a fabric, but not denim."""
TEMPER = 0.6
UNIFORM_FLOOR = 0.03
ALIKE = 0.85
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
    none), then the object's, then those of textures and collections. Equal input gives equal order; ties keep the
    library's. Raises MaterialError on an empty library.
    """
    if not library:
        raise MaterialError("the material library is empty.", remedy="Install the package with its data files.")
    hits = _word_hits(library, names)
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
    categories = [material.category for material in library]
    return np.array([-math.log(len(set(categories)) * categories.count(c)) for c in categories])


def _vocabulary(library: Sequence[LibraryMaterial]) -> dict[str, dict[str, float]]:
    """word (phrases joined by spaces, and run together) → {material name: weight}."""
    owned = {form for material in library for word in material.words for form in _forms(word)}
    vocabulary: dict[str, dict[str, float]] = {}
    for material in library:
        related = set().union(*(_forms(word) for word in CATEGORY_WORDS.get(material.category, "").split()))
        weighted = {form: RELATED_WEIGHT if form in owned else 1.0 for form in related}
        parts = [form for word in material.name.split("-") for form in _forms(word)]
        things = [thing for thing, made_of in OBJECT_WORDS.items() if made_of == material.category]
        for forms, weight in ((parts, NAME_PART_WEIGHT), (things, OBJECT_WORD_WEIGHT)):
            for form in forms:
                weighted[form] = max(weighted.get(form, 0.0), weight)
        for word in (material.category, material.name, *material.words):
            weighted.update(dict.fromkeys(_forms(word), 1.0))
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
    for verdict, chosen in (
        ("fits", [field for field, odds in looks.items() if odds - usual[field] > 0.2]),
        ("does not fit", [field for field, odds in looks.items() if odds < -0.7]),
    ):
        parts += [f"{_value_text(field, appearance)} {verdict}" for field in chosen]
    return "; ".join(parts) or "nothing in the scene tells"


def _value_text(field: str, appearance: Appearance) -> str:
    return "colour" if field == "colour" else f"{field} {getattr(appearance, field):.2f}"
