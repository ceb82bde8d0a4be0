"""All properties of the add-on may be overridden: a stroke linked from another file can be felt otherwise here."""

from __future__ import annotations

OVERRIDABLE = {"LIBRARY_OVERRIDABLE"}
"""For `override=`. Without it Blender takes a change on a library override and forgets it with the next load."""
