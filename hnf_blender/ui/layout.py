"""How panels are put together: where they stand, labels that wrap, hints."""

from __future__ import annotations

from typing import Any

from ..state.texts import CHARACTER_PX, MARGIN_PX, shortened, wrapped

NARROW = 26
"""Characters in a line below which buttons stand under each other."""


class TouchPanel:
    """Every panel of the Touch tab."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Touch"


def line_px(context: Any) -> float:
    """Width of a line in the region, at resolution scale 1."""
    return float(context.region.width / context.preferences.system.ui_scale - MARGIN_PX)


def characters(context: Any) -> int:
    """How many characters fit in a line of the region."""
    return max(12, int(line_px(context) / CHARACTER_PX))


def paragraph(layout: Any, context: Any, text: str, icon: str = "NONE", indent: int = 0) -> None:
    """A label of as many lines as it takes. text: translated already."""
    column = layout.column(align=True)
    column.scale_y = 0.8
    for place, line in enumerate(wrapped(text, characters(context) - indent)):
        column.label(text=line, icon=icon if place == 0 or icon == "NONE" else "BLANK1", translate=False)


def side_by_side(layout: Any, context: Any) -> Any:
    """A row for a few buttons; a column where the region is too narrow to read them beside each other."""
    return layout.column(align=True) if characters(context) < NARROW else layout.row(align=True)


def hint(layout: Any, context: Any, text: str) -> None:
    """What to do in a panel that has nothing to show yet."""
    paragraph(layout.box(), context, text, icon="INFO")


def named(context: Any, text: str, taken: int = 0) -> str:
    """A name cut to a line of which `taken` characters are used for something else."""
    return shortened(text, max(8, characters(context) - taken))
