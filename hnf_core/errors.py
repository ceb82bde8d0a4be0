"""Exceptions of this project and text for their messages: each names the problem, its location and the remedy."""

from __future__ import annotations

import re
from collections.abc import Iterable
from operator import index
from pathlib import Path


class HnfError(Exception):
    """A problem that a user can solve; base class of this project's exceptions.

    Parameters
    ----------
    what : str
        The problem, one sentence.
    where : str
        The object, stroke or file concerned.
    remedy : str
        What the user should do next.
    """

    def __init__(self, what: str, *, where: str = "", remedy: str = "") -> None:
        self.what, self.where, self.remedy = what, where, remedy
        head = f"{where}: {what}" if where else what
        super().__init__(f"{head} {remedy}" if remedy else head)


class UsageError(HnfError):
    """Arguments of a command or call do not fit together (exit code 2)."""


class FileError(HnfError):
    """A file is missing, damaged, of the wrong kind, or cannot be written."""


def make_damaged_error(path: Path, why: str) -> FileError:
    """Return the error for a file whose content contradicts itself."""
    return FileError(f"is damaged: {why}.", where=str(path), remedy="Export or download it again.")


class SceneError(HnfError):
    """The scene, or an object in it, cannot be touched as it is."""


class StrokeError(HnfError):
    """A stroke's curve, keyframes or contact cannot be used."""


class MaterialError(HnfError):
    """A material is unknown, or its description cannot be used."""


class WeightsError(HnfError):
    """Weights of a network are damaged, or belong to another encoder or architecture."""


class DeviceError(HnfError):
    """An actuator, or the way to it, is missing, busy, of another version, or gone."""


MIN_SIMILARITY = 0.7
"""Least fraction of equal letters, in order, between a word and a suggested name."""
PREFIX_SIMILARITY = 0.9
"""Similarity of a name that begins with the word or contains it as a separate word; below that of a one-letter slip."""
MIN_PREFIX_LETTERS = 3
"""Shortest word that counts as a prefix."""


def close_matches(word: str, names: Iterable[str]) -> list[str]:
    """Return at most three of the names that resemble a word, the closest first; case does not count."""
    ranked = sorted(((-_similarity(word.lower(), name.lower()), name) for name in names), key=lambda scored: scored[0])
    return [name for negative_score, name in ranked[:3] if -negative_score >= MIN_SIMILARITY]


def _similarity(word: str, name: str) -> float:
    """Return the similarity of a mistyped word and a name, 0 to 1."""
    from difflib import SequenceMatcher  # imported here because only a mistyped name needs it

    parts = re.split(r"[^a-z0-9]+", name)
    if len(word) >= MIN_PREFIX_LETTERS and (word in parts or name.startswith(word)):
        return PREFIX_SIMILARITY + (1.0 - PREFIX_SIMILARITY) * len(word) / len(name)
    return SequenceMatcher(None, word, name).ratio()


def format_choices(names: Iterable[str], limit: int = 12) -> str:
    """Format at most `limit` names as "'a', 'b' and 3 more"; "" for none."""
    choices = list(names)
    more = f" and {len(choices) - limit} more" if len(choices) > limit else ""
    return ", ".join(f"'{name}'" for name in choices[:limit]) + more


def pluralize(count: int, singular: str) -> str:
    """Format a count with its noun, whose plural ends in s: "1 block", "2 blocks"."""
    return f"{count} {singular}" if count == 1 else f"{count} {singular}s"


SEED_LIMIT = 2**63
"""Seeds are whole numbers from 0 to below this."""


def check_seed(seed: object) -> None:
    """Raise UsageError unless a seed is a whole number from 0 to SEED_LIMIT − 1."""
    try:
        is_seed = type(seed).__name__ not in ("bool", "bool_") and 0 <= index(seed) < SEED_LIMIT  # type: ignore[arg-type]
    except TypeError:
        is_seed = False
    if not is_seed:
        raise UsageError(f"seed {seed!r:.40}: not a whole number from 0 to 2^63 − 1.", remedy="Give e.g. 0.")
