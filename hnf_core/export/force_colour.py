"""The colour of a force, the same wherever a stroke is drawn: bright enough for dark and light backgrounds.

No stroke has a scale of its own: yellow is 2 N in every picture and every viewport.
"""

from __future__ import annotations

from bisect import bisect_right

Colour = tuple[float, float, float, float]

FORCE_COLOUR_STOPS: tuple[tuple[float, Colour], ...] = (
    (0.0, (0.62, 0.66, 0.72, 1.0)),
    (0.05, (0.20, 0.62, 1.00, 1.0)),
    (0.5, (0.10, 0.82, 0.95, 1.0)),
    (1.0, (0.30, 0.90, 0.35, 1.0)),
    (2.0, (1.00, 0.85, 0.10, 1.0)),
    (4.0, (1.00, 0.35, 0.10, 1.0)),
    (8.0, (1.00, 0.15, 0.45, 1.0)),
)
"""Newtons → RGBA: grey is no contact, blue light, green 1 N, yellow firm, red hard."""


def force_to_colour(newtons: float) -> Colour:
    """RGBA, 0 to 1 each, of a normal force; linear between the stops, held beyond them."""
    after = bisect_right([force for force, _ in FORCE_COLOUR_STOPS], newtons)
    if after == 0:
        return FORCE_COLOUR_STOPS[0][1]
    if after == len(FORCE_COLOUR_STOPS):
        return FORCE_COLOUR_STOPS[-1][1]
    (low, a), (high, b) = FORCE_COLOUR_STOPS[after - 1], FORCE_COLOUR_STOPS[after]
    share = (newtons - low) / (high - low)
    return (
        a[0] + share * (b[0] - a[0]),
        a[1] + share * (b[1] - a[1]),
        a[2] + share * (b[2] - a[2]),
        a[3] + share * (b[3] - a[3]),
    )
