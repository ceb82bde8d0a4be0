"""Names as evidence of a material: which library materials the words of a name speak for, and how strongly."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple

from .material import LibraryMaterial
from .words import (
    CATEGORY_WORDS,
    COMPOUND_PARTS,
    OBJECT_WORDS,
    STOP_WORDS,
    list_singulars,
    split_image_name,
    split_words,
)

NAME_WEIGHTS = (1.0, 0.6, 0.35)
"""For a word in the first name (the material's), the second (the object's), any other."""
IMAGE_NAME_WEIGHT = 0.7
"""For a word in the name of a picture that feeds the shader: it was chosen for this surface, the object's was not."""
OBJECT_WORD_WEIGHT = 0.55
"""For words of things and finishes, not stuffs: a lens is mostly glass, satin is often metal."""
NAME_PART_WEIGHT = 0.4
"""For parts of a library material's own name: "coarse" says something of coarse-carpet, not much."""
RELATED_WEIGHT = 0.7
"""For the others of a category where one of them bears the very word: velvet is also a fabric, but not denim."""
MIN_HALF_LENGTH = 4
"""Letters of each half of a compound: shorter ones are found in words that mean something else."""
COMPOUND_LINKS = ("", "n", "s", "en", "es")
"""What German puts between the halves: Eiche-n-tisch."""

Vocabulary = Mapping[str, Mapping[str, float]]
"""Word or phrase (joined by spaces, and run together) → {material name: weight}."""
Hits = dict[str, dict[str, tuple[float, str]]]
"""Material name → {matched word: (weight, the name it stood in)}."""


def match_names(library: Sequence[LibraryMaterial], names: Sequence[str], image_names: Sequence[str] = ()) -> Hits:
    """What the names tell; a word told twice counts once, in its most telling place.

    names: the material's, the object's, any others. pictures: of textures, whose channel ("_Metalness") is no word of
    theirs. A word that belongs to several categories weighs less, one of all categories nothing.
    """
    words = build_vocabulary(library)
    category = {material.name: material.category for material in library}
    count = len(set(category.values()))
    told = [
        (name, split_words(name), NAME_WEIGHTS[min(place, len(NAME_WEIGHTS) - 1)]) for place, name in enumerate(names)
    ]
    told += [(name, split_image_name(name), IMAGE_NAME_WEIGHT) for name in image_names]
    hits: Hits = {material.name: {} for material in library}
    for name, parts, telling in told:
        for word in _find_matches(parts, words):
            spread = len({category[material] for material in words[word]})
            special = 1.0 if count < 2 else 1.0 - math.log(spread) / math.log(count)
            for material, weight in words[word].items():
                total = telling * special * weight
                if total > hits[material].get(word, (0.0, ""))[0]:
                    hits[material][word] = (total, name)
    return hits


def build_vocabulary(library: Sequence[LibraryMaterial]) -> Vocabulary:
    """Every word that speaks for a material of the library."""
    return _cached_vocabulary(
        tuple(_MaterialWords(material.name, material.category, tuple(material.words)) for material in library)
    )


class _MaterialWords(NamedTuple):
    """What of a library material its words follow from."""

    name: str
    category: str
    words: tuple[str, ...]


@lru_cache(maxsize=4)
def _cached_vocabulary(library: tuple[_MaterialWords, ...]) -> Vocabulary:
    """Made once for a library: it takes 13 ms, and every slot of every stroke asks."""
    owned = {form for material in library for word in material.words for form in _get_word_forms(word)}
    stuffs = {
        category: {form for word in words.split() for form in _get_word_forms(word)}
        for category, words in CATEGORY_WORDS.items()
    }
    found: dict[str, dict[str, float]] = {}
    for material in library:
        weighted: dict[str, float] = {}

        def add(words: Iterable[str], weight: float, into: dict[str, float] = weighted) -> None:
            for form in (form for word in words for form in _get_word_forms(word)):
                into[form] = max(into.get(form, 0.0), weight)

        related = CATEGORY_WORDS.get(material.category, "").split()
        own_stuffs = stuffs.get(material.category, set())
        add((word for word in related if word not in owned), 1.0)
        add(related, RELATED_WEIGHT)
        add((thing for thing, made_of in OBJECT_WORDS.items() if material.category in made_of), OBJECT_WORD_WEIGHT)
        add(material.name.split("-"), NAME_PART_WEIGHT)
        add(material.words, OBJECT_WORD_WEIGHT)
        add((word for word in material.words if _get_word_forms(word) & own_stuffs), 1.0)
        add((material.category, material.name), 1.0)
        for form, weight in weighted.items():
            found.setdefault(form, {})[material.name] = weight
    return found


@lru_cache(maxsize=4096)
def _get_word_forms(word: str) -> frozenset[str]:
    parts = split_words(word)
    return frozenset({" ".join(parts), "".join(parts)} - STOP_WORDS - {""})


def _find_matches(parts: Sequence[str], vocabulary: Vocabulary) -> list[str]:
    """Words, halves of compounds, and phrases of up to three words of the vocabulary among the words of a name."""
    words = [word for word in parts if word not in STOP_WORDS]
    found: list[str] = []
    for length in (1, 2, 3):
        for start in range(len(words) - length + 1):
            head = " ".join(words[start : start + length - 1])
            for last in list_singulars(words[start + length - 1]):
                phrase = f"{head} {last}".strip()
                if phrase in vocabulary:
                    found.append(phrase)
                    break
            else:
                found += split_compound(words[start], vocabulary) if length == 1 else []
    return found


def split_compound(word: str, vocabulary: Vocabulary) -> list[str]:
    """The parts of a compound that the vocabulary knows: "gummireifen" → gummi. Both halves must be words, one of
    them a stuff, so that nothing is found inside a word that means something else; else []."""
    for cut in range(MIN_HALF_LENGTH, len(word) - MIN_HALF_LENGTH + 1):
        last = next((form for form in list_singulars(word[cut:]) if _is_compound_half(form, vocabulary)), None)
        if last is None:
            continue
        for link in COMPOUND_LINKS:
            first = word[: cut - len(link)]
            if (
                not word[:cut].endswith(link)
                or len(first) < MIN_HALF_LENGTH
                or not _is_compound_half(first, vocabulary)
            ):
                continue
            if first in MATERIAL_WORDS or last in MATERIAL_WORDS:
                return [half for half in (first, last) if half in vocabulary]
    return []


MATERIAL_WORDS = frozenset(
    form for words in CATEGORY_WORDS.values() for word in words.split() for form in _get_word_forms(word)
)
_COMPOUND_FORMS = frozenset(form for word in COMPOUND_PARTS for form in _get_word_forms(word))


def _is_compound_half(word: str, vocabulary: Vocabulary) -> bool:
    return word in _COMPOUND_FORMS or word in MATERIAL_WORDS or (word in OBJECT_WORDS and word in vocabulary)
