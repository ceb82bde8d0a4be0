"""Which stroke the artist works on, and what a new one is touched with."""

from __future__ import annotations

from typing import Any

from hnf_core.errors import HnfError

from ..props.listed import Remembered
from ..props.scene import place_in
from ..state.settings import settings
from ..translations import tr

AS_SET = "AS_SET"
"""Value of an operator's probe: the one of the preferences."""
HELD = Remembered()
"""(scene, view layer, object) → does it hold that?"""


def make_active(context: Any, stroke: Any) -> None:
    """Select this stroke alone, make it the active object and the one picked in the list."""
    layer = context.view_layer
    layer.update()  # a collection made a moment ago is not in it yet
    for other in tuple(layer.objects.selected):
        other.select_set(False, view_layer=layer)
    if place_in(layer.objects, stroke) >= 0:
        stroke.select_set(True, view_layer=layer)
        layer.objects.active = stroke
    context.scene.hnf.stroke_index = max(0, place_in(context.scene.objects, stroke))


def make_shown(context: Any, stroke: Any) -> str:
    """make_active() a new stroke, its collection shown again where that was hidden; what is to be said of that."""
    from ..bridge.new_stroke import COLLECTION, show_collection

    hidden = show_collection(stroke, context.view_layer)
    make_active(context, stroke)
    return tr("; the collection '{name}' was hidden and is shown again").format(name=COLLECTION) if hidden else ""


def surface_here(context: Any, stroke: Any) -> Any:
    """The surface that was chosen for a stroke; None where there is none, or the view layer does not hold it: a deleted
    object may live on in another scene, or in the stroke alone. Buttons ask it in each redraw, of as many objects as
    there are."""
    chosen, layer = stroke.hnf_stroke.surface, context.view_layer
    if chosen is None:
        return None
    asked = context.scene.session_uid, layer.name, chosen.session_uid
    return chosen if HELD.answer(asked, lambda: place_in(layer.objects, chosen) >= 0) else None


def probe_of(context: Any, chosen: str) -> str:
    """The probe of a new stroke: as chosen in the operator, or as in the preferences."""
    return str(settings(context).default_probe) if chosen == AS_SET else chosen


def one_line(error: HnfError) -> str:
    """An error as a report shows it."""
    text = str(error)
    return text[:1].upper() + text[1:]
