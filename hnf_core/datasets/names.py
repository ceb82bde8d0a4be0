"""Finding a material by a name that a person types."""

from __future__ import annotations

import re
from collections.abc import Iterable
from difflib import get_close_matches

from ..errors import MaterialError


def normalise_name(name: str) -> str:
    """Lower case, letters and digits only: "ABS_plastic" and "ABS Plastic" are one material."""
    return re.sub(r"[\W_]+", "", name.lower())


def match_name(name: str, materials: Iterable[str], where: str) -> str:
    """The material of that plain name. Raises MaterialError that lists near ones."""
    by_plain = {normalise_name(material): material for material in materials}
    found = by_plain.get(normalise_name(name))
    if found is not None:
        return found
    close = get_close_matches(normalise_name(name), by_plain, 5, 0.5)
    listed = [by_plain[each] for each in close] or sorted(by_plain.values())[:8]
    raise MaterialError(
        f"no material is called {name!r}.",
        where=where,
        remedy=f"{'Near ones' if close else 'There are'}: {', '.join(listed)}." if listed else "It has none.",
    )
