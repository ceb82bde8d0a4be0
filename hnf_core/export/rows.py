"""Text of a picture, in rows: cut where there is no room, with a mark."""

from __future__ import annotations

import textwrap


def wrap_lines(lines: list[tuple[str, str]], width: int, max_rows: int) -> list[tuple[str, str]]:
    """(label, row) of each line, cut short only where together they are more than `most` rows; the longest first."""
    for each in range(max_rows, 0, -1):
        rows = [
            (label, row)
            for label, text in lines
            for row in textwrap.wrap(text, width, max_lines=each, placeholder=" …") or [""]
        ]
        if len(rows) <= max_rows:
            break
    return rows
