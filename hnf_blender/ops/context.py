"""Why a button is grey.

Which stroke the artist works on, and what a new one is touched with.
"""

from __future__ import annotations

from typing import Any

from hnf_core.errors import HnfError

from ..props.object_cache import ChangeCache
from ..props.scene_settings import find_index
from ..state.addon_settings import get_settings
from ..translations import tr


def fail_poll(operator: Any, reason: str) -> bool:
    """For poll(): False, and why is said in the language of the interface. Blender shows what poll_message_set() is
    given as it is, without looking it up."""
    operator.poll_message_set(tr(reason))
    return False


DEFAULT_PROBE = "AS_SET"
"""Value of an operator's probe: the one of the preferences."""
LAYER_MEMBERSHIP = ChangeCache()
"""(scene, view layer, object) → does it hold that?"""


def make_active(context: Any, stroke: Any) -> None:
    """Select this stroke alone, make it the active object and the one picked in the list."""
    layer = context.view_layer
    layer.update()  # a collection made a moment ago is not in it yet
    for other in tuple(layer.objects.selected):
        other.select_set(False, view_layer=layer)
    if find_index(layer.objects, stroke) >= 0:
        stroke.select_set(True, view_layer=layer)
        layer.objects.active = stroke
    context.scene.hnf.stroke_index = max(0, find_index(context.scene.objects, stroke))


def make_active_and_visible(context: Any, stroke: Any) -> str:
    """make_active() a new stroke, its collection shown again where that was hidden; what is to be said of that."""
    from ..bridge.stroke.new_stroke import STROKE_COLLECTION, unhide_collection

    hidden = unhide_collection(stroke, context.view_layer)
    make_active(context, stroke)
    return (
        tr("; the collection '{name}' was hidden and is shown again").format(name=STROKE_COLLECTION) if hidden else ""
    )


def get_surface_in_layer(context: Any, stroke: Any) -> Any:
    """The surface that was chosen for a stroke; None where there is none, or the view layer does not hold it: a deleted
    object may live on in another scene, or in the stroke alone. Buttons ask it in each redraw, of as many objects as
    there are."""
    chosen, layer = stroke.hnf_stroke.surface, context.view_layer
    if chosen is None:
        return None
    asked = context.scene.session_uid, layer.name, chosen.session_uid
    return chosen if LAYER_MEMBERSHIP.get(asked, lambda: find_index(layer.objects, chosen) >= 0) else None


def resolve_probe(context: Any, choice: str) -> str:
    """The probe of a new stroke: as chosen in the operator, or as in the preferences."""
    return str(get_settings(context).default_probe) if choice == DEFAULT_PROBE else choice


def format_error(error: HnfError) -> str:
    """An error as a report shows it."""
    text = str(error)
    return text[:1].upper() + text[1:]
