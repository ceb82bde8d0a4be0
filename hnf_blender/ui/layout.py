"""Layout helpers of the panels: the Touch tab, labels that wrap, hints, button rows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import bpy

from ..state.labels import CHARACTER_PX, MARGIN_PX, shorten_text, wrap_text
from ..translations import tr

NARROW_CHARACTERS = 26
"""Characters per line below which buttons are stacked."""


class TouchPanel:
    """Base of all panels of the Touch tab."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Touch"


class PopoverPanel:
    """Base of panels that a button of the tab opens; the sidebar does not list them."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "HEADER"
    bl_options = {"INSTANCED"}  # Blender reads a set
    bl_ui_units_x = 15


def compute_line_width(context: Any) -> float:
    """Return the width of a line in the region at resolution scale 1 [px]."""
    return float(context.region.width / context.preferences.system.ui_scale - MARGIN_PX)


def count_line_characters(context: Any) -> int:
    """Return the number of characters that fit in a line of the region."""
    return max(12, int(compute_line_width(context) / CHARACTER_PX))


def draw_paragraph(layout: Any, context: Any, text: str, icon: str = "NONE", indent: int = 0) -> None:
    """Draw a label over as many lines as it needs; `text` is already translated."""
    column = layout.column(align=True)
    column.scale_y = 0.8
    for index, line in enumerate(wrap_text(text, count_line_characters(context) - indent)):
        column.label(text=line, icon=icon if index == 0 or icon == "NONE" else "BLANK1", translate=False)


def draw_height_choices(layout: Any, context: Any, names: Sequence[str]) -> None:
    """Draw, for each material of a name whose relief's height is not believed, the option to insist on it."""
    for name in names:
        material = bpy.data.materials.get(name)
        if material is not None:
            text = f"{tr('Height as Authored')}: {shorten_name(context, name, reserved=22)}"
            layout.prop(material.hnf_touch, "height_as_authored", text=text, translate=False)


def make_button_row(layout: Any, context: Any) -> Any:
    """Return a row for a few buttons, or a column if the region is too narrow for a row."""
    return layout.column(align=True) if count_line_characters(context) < NARROW_CHARACTERS else layout.row(align=True)


ICON_CHARACTERS, BUTTON_CHARACTERS = 4, 2
"""Width of an icon with its gap, and of a button's borders, in characters."""


def draw_warning(layout: Any, text: str, button: str) -> Any:
    """Draw a warning, and return the rest of the line for the button that mends it.

    Each gets the room that its translated words need: Blender halves a line, and cuts the longer of them.
    """
    needed = len(text) + ICON_CHARACTERS
    split = layout.split(factor=needed / (needed + len(button) + BUTTON_CHARACTERS), align=True)
    split.label(text=text, icon="ERROR", translate=False)
    return split


def draw_hint(layout: Any, context: Any, text: str) -> None:
    """Draw a hint in a panel that has nothing to show yet."""
    draw_paragraph(layout.box(), context, text, icon="INFO")


def shorten_name(context: Any, text: str, reserved: int = 0) -> str:
    """Shorten a name to one line, of which `reserved` characters are used otherwise."""
    return shorten_text(text, max(8, count_line_characters(context) - reserved))
