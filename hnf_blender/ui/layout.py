"""How panels are put together: where they stand, labels that wrap, hints."""

from __future__ import annotations

from typing import Any

from ..state.labels import CHARACTER_PX, MARGIN_PX, shorten_text, wrap_text

NARROW_CHARACTERS = 26
"""Characters in a line below which buttons stand under each other."""


class TouchPanel:
    """Every panel of the Touch tab."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Touch"


def compute_line_width(context: Any) -> float:
    """Width of a line in the region, at resolution scale 1."""
    return float(context.region.width / context.preferences.system.ui_scale - MARGIN_PX)


def count_line_characters(context: Any) -> int:
    """How many characters fit in a line of the region."""
    return max(12, int(compute_line_width(context) / CHARACTER_PX))


def draw_paragraph(layout: Any, context: Any, text: str, icon: str = "NONE", indent: int = 0) -> None:
    """A label of as many lines as it takes. text: translated already."""
    column = layout.column(align=True)
    column.scale_y = 0.8
    for place, line in enumerate(wrap_text(text, count_line_characters(context) - indent)):
        column.label(text=line, icon=icon if place == 0 or icon == "NONE" else "BLANK1", translate=False)


def make_button_row(layout: Any, context: Any) -> Any:
    """A row for a few buttons; a column where the region is too narrow to read them beside each other."""
    return layout.column(align=True) if count_line_characters(context) < NARROW_CHARACTERS else layout.row(align=True)


def draw_hint(layout: Any, context: Any, text: str) -> None:
    """What to do in a panel that has nothing to show yet."""
    draw_paragraph(layout.box(), context, text, icon="INFO")


def shorten_name(context: Any, text: str, reserved: int = 0) -> str:
    """A name cut to a line of which `taken` characters are used for something else."""
    return shorten_text(text, max(8, count_line_characters(context) - reserved))
