"""How many of a thing, for people."""

from __future__ import annotations


def counted(number: int, one: str) -> str:
    """one: the thing in the singular, whose plural ends in s: 1 block, 2 blocks."""
    return f"{number} {one}" if number == 1 else f"{number} {one}s"
