"""The Touch tab with every panel open. Python can neither open a panel nor learn where its header is."""

from contextlib import contextmanager

import bpy

from .addon import ours

CLOSED = "DEFAULT_CLOSED"


@contextmanager
def all_open(*names: str):
    """Inside, panels that begin closed (those of these names, if any) stand open; afterwards the tab is what it was."""
    panels = [each for each in ours("ui")._registered_classes if issubclass(each, bpy.types.Panel)]
    closed = [each for each in panels if CLOSED in getattr(each, "bl_options", ())]
    closed = [each for each in closed if not names or each.__name__ in names]
    replaced(panels, dict.fromkeys(closed, (set(), "_open")))
    try:
        yield
    finally:
        replaced(panels, dict.fromkeys(closed, ({CLOSED}, "")))


def replaced(panels, changed) -> None:
    """Registers all anew, in the same order: each stands behind those before it. changed: panel → its options, and
    what is added to its name, by which Blender remembers whether it is open."""
    for panel in reversed(panels):
        bpy.utils.unregister_class(panel)
    for panel, (options, added) in changed.items():
        panel.bl_options, panel.bl_idname = options, panel.__name__ + added
    names = {panel.__name__: panel.__name__ + added for panel, (_, added) in changed.items()}
    for panel in panels:
        parent = getattr(panel, "bl_parent_id", "").removesuffix("_open")
        if parent in names:
            panel.bl_parent_id = names[parent]
        bpy.utils.register_class(panel)
