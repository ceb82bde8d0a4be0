"""Touch query (what is felt at one point) in the child process of a job: point → result file → contents of the panel.

The scene is not changed. `run_query_job` runs in the child, `load_query_result` in the parent.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.errors import FileError
from hnf_core.export.figure import stretch_contrast
from hnf_core.files import NPZ_ERRORS, write_bytes
from hnf_core.material.fuse import format_routes
from hnf_core.material.ranking import Suggestion
from hnf_core.material.token import Token
from hnf_core.tactile.tactile_map import Route
from hnf_core.touch_request import TouchQuery
from hnf_core.units import linear_to_srgb

from ..state.interface import set_icon
from ..state.job_results import NearestMaterial, QueryView, Relief
from ..state.session_state import STATE
from ..touch.bake_patches import get_token
from ..touch.material_choice import format_likely
from ..touch.query import QueryResult, describe_map_source, query_surface
from ..touch.report import Counts
from .child_job import Started, Step

if TYPE_CHECKING:
    from ..touch.session import Session

QUERY_RESULT_NAME = "probe.npz"
"""File name of the result in the job's folder."""
QUERY_ICON = "probe"
"""Name of the image among the add-on's icons."""


def run_query_job(
    session: Session, query: TouchQuery, cache: Path, folder: Path, send: Callable[[Started | Step], None]
) -> int:
    """Evaluate a touch query and write its result to `folder`; return the number of close-ups rendered.

    Parameters
    ----------
    session : Session
        Session of the opened scene.
    query : TouchQuery
        Point to be examined.
    cache : Path
        Folder of cached close-ups.
    folder : Path
        Folder of the job.
    send : callable
        Called with each message on the job's progress.

    Raises
    ------
    HnfError
        If there is no such point.
    """
    send(Started(1, 0))
    counts = Counts()
    send(Step("close-up", 0, 1))
    result = query_surface(
        session, query, cache, counts, lambda progress: send(Step("close-up", 0, 1, progress.fraction))
    )
    write_bytes(folder / QUERY_RESULT_NAME, pack_query_result(result, session.scene.name))
    return counts.close_ups


def pack_query_result(result: QueryResult, scene_name: str) -> bytes:
    """Pack a touch query's result, as the panel shows it, and the ranking of all materials as NPZ bytes."""
    touched, slot = result.touched, result.point.patch.slot
    slots = touched.obj.material_slots
    material = slots[slot].material if slot < len(slots) else None
    facts = {
        "object_name": touched.surface.object_name,
        "material": result.material.shader,
        "material_full": "" if material is None else material.name_full,
        "library_material": result.material.library.name,
        "confidence": result.material.confidence,
        "reason": result.material.reason,
        "likely": format_likely(result.material),
        "roughness_m": float(np.sqrt(np.sum(result.band_rms_m**2))),
        "seen_m": result.observed_rms_m,
        "friction": result.friction.value,
        "friction_factor": result.friction.factor,
        "stiffness_n_m": result.stiffness.value,
        "stiffness_factor": result.stiffness.factor,
        "routes": format_routes(result.fused.routes, result.record.mesh_bands),
        "source": describe_map_source(result),
        "notes": list(result.notes),
        "is_height_doubted": bool(result.material.doubt),
        "scene": scene_name,
    }
    nearest = [
        [match.suggestion.name, match.suggestion.confidence, match.distance, match.suggestion.reason]
        for match in result.nearest
    ]
    ranked = [
        [suggestion.name, suggestion.confidence, suggestion.reason, suggestion.probability]
        for suggestion in result.ranked
    ]
    route = result.record.route.value
    text = json.dumps({"told": facts, "nearest": nearest, "ranked": ranked, "route": route})
    token = get_token(result.record)
    values, known = ((), ()) if token is None else (token.values, token.known)
    image = (
        np.zeros((0, 0, 3), dtype=np.uint8)
        if result.tactile is None
        else _to_srgb_bytes(stretch_contrast(result.tactile))
    )
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        text=np.frombuffer(text.encode(), np.uint8),
        picture=image,
        token=np.asarray(values, dtype=np.float32),
        known=np.asarray(known, dtype=bool),
    )
    return buffer.getvalue()


def load_query_result(folder: Path) -> QueryView:
    """Load a touch query's result from a job's folder into STATE.query_view and the suggestions of its material.

    Raises FileError if it is damaged.
    """
    try:
        with np.load(folder / QUERY_RESULT_NAME, allow_pickle=False) as arrays:
            record: dict[str, Any] = json.loads(arrays["text"].tobytes())
            image, token = arrays["picture"], Token(arrays["token"], arrays["known"])
        facts = {**record["told"], "notes": tuple(record["told"]["notes"])}
        nearest = tuple(NearestMaterial(*fields) for fields in record["nearest"])
        ranked = tuple(Suggestion(*fields) for fields in record["ranked"])
        relief = Relief(token, Route(record["route"]))
        view = QueryView(
            **facts, nearest=nearest, icon=set_icon(QUERY_ICON, to_icon_pixels(image)) if image.size else 0
        )
    except NPZ_ERRORS as error:
        raise FileError(f"the answer is damaged ({error}).", where=QUERY_RESULT_NAME, remedy="Look again.") from error
    STATE.query_view = view
    if view.material_full:
        STATE.suggestions[view.material_full] = ranked
        STATE.reliefs.pop(view.material_full, None)
        if token.values.size:
            STATE.reliefs[view.material_full] = relief
    return view


def to_icon_pixels(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Convert (H, W, 3) uint8, top row first, to (H, W, 4) float32 in 0–1, bottom row first, as Blender's icons are."""
    pixels = np.ones((*image.shape[:2], 4), dtype=np.float32)
    pixels[..., :3] = image[::-1] / np.float32(255.0)
    return pixels


def _to_srgb_bytes(image: NDArray[np.float64]) -> NDArray[np.uint8]:
    return np.asarray(np.round(255.0 * linear_to_srgb(np.clip(image, 0.0, 1.0))), dtype=np.uint8)
