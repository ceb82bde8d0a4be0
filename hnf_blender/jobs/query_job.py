"""A look at one place, in the child process of a job: nothing in the file changes, the answer comes back as a file."""

from __future__ import annotations

import io
import json
from collections.abc import Generator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.errors import FileError
from hnf_core.export.plots.tactile_map_figure import stretch_contrast
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
from ..touch.query import QueryResult, describe_map_source, query_steps
from ..touch.report import Counts
from ..touch.synthesise import map_steps
from .child_job import Started, Step

if TYPE_CHECKING:
    from ..touch.session import Session

QUERY_RESULT_NAME = "probe.npz"
QUERY_ICON = "probe"
"""Name of the picture among the add-on's icons."""


def query_job_steps(
    session: Session, point: TouchQuery, cache: Path, folder: Path
) -> Generator[Started | Step, None, int]:
    """Look at place; writes ANSWER_NAME to folder. Yields messages; returns how many close-ups were made.

    Raises HnfError where there is no such place.
    """
    yield Started(1, 0)
    counts = Counts()
    yield Step("close-up", 0, 1)
    probed = yield from map_steps(
        query_steps(session, point, cache, counts), lambda share: Step("close-up", 0, 1, share)
    )
    write_bytes(folder / QUERY_RESULT_NAME, pack_query_result(probed, session.scene.name))
    return counts.close_ups


def pack_query_result(result: QueryResult, scene_name: str) -> bytes:
    """What a panel shows of it, and the whole ranking; no pickle."""
    touched, slot = result.touched, result.point.patch.slot
    slots = touched.obj.material_slots
    material = slots[slot].material if slot < len(slots) else None
    told = {
        "object_name": touched.surface.object_name,
        "material": result.material.shader,
        "material_full": "" if material is None else material.name_full,
        "library_material": result.material.library.name,
        "confidence": result.material.confidence,
        "reason": result.material.reason,
        "roughness_m": float(np.sqrt(np.sum(result.band_rms_m**2))),
        "seen_m": result.observed_rms_m,
        "friction": result.friction.value,
        "friction_factor": result.friction.factor,
        "stiffness_n_m": result.stiffness.value,
        "stiffness_factor": result.stiffness.factor,
        "routes": format_routes(result.fused.routes),
        "source": describe_map_source(result),
        "notes": list(result.notes),
        "scene": scene_name,
    }
    nearest = [
        [near.suggestion.name, near.suggestion.confidence, near.distance, near.suggestion.reason]
        for near in result.nearest
    ]
    ranked = [[each.name, each.confidence, each.reason, each.probability] for each in result.ranked]
    route = result.record.route.value
    text = json.dumps({"told": told, "nearest": nearest, "ranked": ranked, "route": route})
    token = get_token(result.record)
    values, known = ((), ()) if token is None else (token.values, token.known)
    picture = (
        np.zeros((0, 0, 3), dtype=np.uint8)
        if result.tactile is None
        else _to_srgb_bytes(stretch_contrast(result.tactile))
    )
    packed = io.BytesIO()
    np.savez_compressed(
        packed,
        text=np.frombuffer(text.encode(), np.uint8),
        picture=picture,
        token=np.asarray(values, dtype=np.float32),
        known=np.asarray(known, dtype=bool),
    )
    return packed.getvalue()


def load_query_result(folder: Path) -> QueryView:
    """The answer in a job's folder → STATE.probe, and the suggestions of its material.

    Raises FileError where it is damaged.
    """
    try:
        with np.load(folder / QUERY_RESULT_NAME, allow_pickle=False) as arrays:
            record: dict[str, Any] = json.loads(arrays["text"].tobytes())
            picture, token = arrays["picture"], Token(arrays["token"], arrays["known"])
        told = {**record["told"], "notes": tuple(record["told"]["notes"])}
        nearest = tuple(NearestMaterial(*each) for each in record["nearest"])
        ranked = tuple(Suggestion(*each) for each in record["ranked"])
        relief = Relief(token, Route(record["route"]))
        view = QueryView(
            **told, nearest=nearest, icon=set_icon(QUERY_ICON, to_icon_pixels(picture)) if picture.size else 0
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
    """(H, W, 3) uint8 from the top → (H, W, 4) float32 0–1 from the bottom, as Blender's icons are."""
    shown = np.ones((*image.shape[:2], 4), dtype=np.float32)
    shown[..., :3] = image[::-1] / np.float32(255.0)
    return shown


def _to_srgb_bytes(image: NDArray[np.float64]) -> NDArray[np.uint8]:
    return np.asarray(np.round(255.0 * linear_to_srgb(np.clip(image, 0.0, 1.0))), dtype=np.uint8)
