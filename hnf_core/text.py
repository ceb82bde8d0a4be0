"""What a person probably meant: names that are near to a word.

How many of a thing, for people.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

MIN_SIMILARITY = 0.7
"""Share of equal letters, in order, below which two words have nothing to do with each other."""
PREFIX_SIMILARITY = 0.9
"""What a name is worth that begins with the word, or holds it as a word of its own: less than a slip of one letter."""
MIN_PREFIX_LETTERS = 3
"""A shorter word begins too many names."""


def close_matches(word: str, names: Iterable[str], limit: int = 3) -> list[str]:
    """At most so many of the names, the nearest first; case does not count. Empty where none is near."""
    ranked = sorted(((-_similarity(word.lower(), name.lower()), name) for name in names), key=lambda each: each[0])
    return [name for nearness, name in ranked[:limit] if -nearness >= MIN_SIMILARITY]


def _similarity(word: str, name: str) -> float:
    """0–1."""
    from difflib import SequenceMatcher  # here: who makes no mistake needs no guesses

    parts = re.split(r"[^a-z0-9]+", name)
    if len(word) >= MIN_PREFIX_LETTERS and (word in parts or name.startswith(word)):
        return PREFIX_SIMILARITY + (1.0 - PREFIX_SIMILARITY) * len(word) / len(name)
    return SequenceMatcher(None, word, name).ratio()


def format_choices(names: Iterable[str], limit: int = 12) -> str:
    """'a', 'b', 'c' …: so many of them, and how many more there are; "" for none."""
    known = list(names)
    more = f" and {len(known) - limit} more" if len(known) > limit else ""
    return ", ".join(f"'{name}'" for name in known[:limit]) + more


def pluralize(count: int, singular: str) -> str:
    """one: the thing in the singular, whose plural ends in s: 1 block, 2 blocks."""
    return f"{count} {singular}" if count == 1 else f"{count} {singular}s"
