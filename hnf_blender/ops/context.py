"""Context of operators: reasons for disabled buttons, the active stroke, its surface, and the default probe."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any

from hnf_core.errors import HnfError

from ..props.object_cache import ChangeCache
from ..props.scene_settings import find_index
from ..state.addon_settings import get_settings
from ..translations import tr


def fail_poll(operator: Any, reason: str) -> bool:
    """Return False for poll(), with a translated reason: Blender shows the text of poll_message_set() as it is."""
    operator.poll_message_set(tr(reason))
    return False


DEFAULT_PROBE = "AS_SET"
"""Value of an operator's probe that stands for the probe of the preferences."""
LAYER_MEMBERSHIP = ChangeCache()
"""Cache of whether a view layer contains an object, by scene, view layer and object."""


def make_active(context: Any, stroke: Any) -> None:
    """Select this stroke alone and make it active, in the view layer and in the list."""
    layer = context.view_layer
    layer.update()  # A new collection is not in the view layer before an update.
    for selected in tuple(layer.objects.selected):
        selected.select_set(False, view_layer=layer)
    if find_index(layer.objects, stroke) >= 0:
        stroke.select_set(True, view_layer=layer)
        layer.objects.active = stroke
    context.scene.hnf.stroke_index = max(0, find_index(context.scene.objects, stroke))


def make_active_and_visible(context: Any, stroke: Any) -> str:
    """Make a new stroke active and show its collection; return a remark if the collection was hidden."""
    from ..bridge.stroke.new_stroke import STROKE_COLLECTION, unhide_collection

    hidden = unhide_collection(stroke, context.view_layer)
    make_active(context, stroke)
    return (
        tr("; the collection '{name}' was hidden and is shown again").format(name=STROKE_COLLECTION) if hidden else ""
    )


def get_surface_in_layer(context: Any, stroke: Any) -> Any:
    """Return the surface object chosen for a stroke, or None if there is none in the view layer.

    A deleted object may survive in another scene or in the stroke's setting alone. The result is cached, since buttons
    query it at each redraw.
    """
    surface, layer = stroke.hnf_stroke.surface, context.view_layer
    if surface is None:
        return None
    key = context.scene.session_uid, layer.name, surface.session_uid
    return surface if LAYER_MEMBERSHIP.get(key, lambda: find_index(layer.objects, surface) >= 0) else None


def resolve_probe(context: Any, choice: str) -> str:
    """Return the probe (pen or finger) of a new stroke: the operator's choice, or that of the preferences."""
    return str(get_settings(context).default_probe) if choice == DEFAULT_PROBE else choice


def format_error(error: HnfError) -> str:
    """Format an error's problem, location and remedy for Blender's report."""
    text = str(error)
    return text[:1].upper() + text[1:]


Execute = Callable[[Any, Any], set[str]]


def report_errors(level: str = "ERROR", text: Callable[[HnfError], str] = format_error) -> Callable[[Execute], Execute]:
    """Decorate an operator's execute: an HnfError is reported at a level, and the operator is cancelled."""

    def decorate(execute: Execute) -> Execute:
        @wraps(execute)
        def run(self: Any, context: Any) -> set[str]:
            try:
                return execute(self, context)
            except HnfError as error:
                self.report({level}, text(error))
                return {"CANCELLED"}

        return run

    return decorate
