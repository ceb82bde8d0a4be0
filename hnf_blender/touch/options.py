"""Words of the command line: what notes ask to be done in the Touch tab, as options."""

from __future__ import annotations

OPTION_FOR_TAB_PLACE = {
    "Units in the Touch tab": "--scale METRES_PER_UNIT",
    "Feels in the Touch tab": "--material OBJECT[:SLOT]=NAME",
}
"""A place in the tab, as notes name it → the option that says the same."""


def add_option_hint(note: str) -> str:
    """The note, and the option that does what it asks for, where there is one."""
    options = [option for place, option in OPTION_FOR_TAB_PLACE.items() if place in note]
    return f"{note} Here: {', '.join(options)}." if options else note
