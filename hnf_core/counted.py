"""How many of a thing, for people."""

from __future__ import annotations


def pluralize(count: int, singular: str) -> str:
    """one: the thing in the singular, whose plural ends in s: 1 block, 2 blocks."""
    return f"{count} {singular}" if count == 1 else f"{count} {singular}s"
