"""A look at one place, in the child process of a job: nothing in the file changes, the answer comes back as a file."""

from __future__ import annotations

import io
import json
from collections.abc import Generator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.archive import DAMAGED
from hnf_core.cli.probe import ProbePlace
from hnf_core.errors import FileError
from hnf_core.export.map_picture import stretched
from hnf_core.export.srgb import linear_to_srgb
from hnf_core.files import write_bytes
from hnf_core.material.fuse import routes_in_words
from hnf_core.material.prior import Suggestion
from hnf_core.material.token import Token
from hnf_core.tactile.tactile_map import Route

from ..state.icons import show
from ..state.probe import NearView, ProbeView, Relief
from ..state.session import STATE
from ..touch.bake import token_of
from ..touch.mapped import mapped
from ..touch.probe import Probed, map_source, probe_steps
from ..touch.report import Counts
from .messages import Began, Step

if TYPE_CHECKING:
    from ..touch.jobs import Session

ANSWER_NAME = "probe.npz"
PICTURE = "probe"
"""Name of the picture among the add-on's icons."""


def probe_work(session: Session, place: ProbePlace, cache: Path, folder: Path) -> Generator[Began | Step, None, int]:
    """Look at place; writes ANSWER_NAME to folder. Yields messages; returns how many close-ups were made.

    Raises HnfError where there is no such place.
    """
    yield Began(1, 0)
    counts = Counts()
    yield Step("close-up", 0, 1)
    probed = yield from mapped(probe_steps(session, place, cache, counts), lambda share: Step("close-up", 0, 1, share))
    write_bytes(folder / ANSWER_NAME, pack_probe(probed, session.scene.name))
    return counts.close_ups


def pack_probe(probed: Probed, scene_name: str) -> bytes:
    """What a panel shows of it, and the whole ranking; no pickle."""
    touched, slot = probed.touched, probed.place.patch.slot
    slots = touched.obj.material_slots
    material = slots[slot].material if slot < len(slots) else None
    told = {
        "object_name": touched.surface.object_name,
        "material": probed.material.shader,
        "material_full": "" if material is None else material.name_full,
        "library_material": probed.material.library.name,
        "confidence": probed.material.confidence,
        "reason": probed.material.reason,
        "roughness_m": float(np.sqrt(np.sum(probed.band_rms_m**2))),
        "seen_m": probed.told_rms_m,
        "friction": probed.friction.value,
        "friction_factor": probed.friction.factor,
        "stiffness_n_m": probed.stiffness.value,
        "stiffness_factor": probed.stiffness.factor,
        "routes": routes_in_words(probed.fused.routes),
        "source": map_source(probed),
        "notes": list(probed.notes),
        "scene": scene_name,
    }
    nearest = [
        [near.suggestion.name, near.suggestion.confidence, near.distance, near.suggestion.reason]
        for near in probed.nearest
    ]
    ranked = [[each.name, each.confidence, each.reason, each.probability] for each in probed.ranked]
    route = probed.record.route.value
    text = json.dumps({"told": told, "nearest": nearest, "ranked": ranked, "route": route})
    token = token_of(probed.record)
    values, known = ((), ()) if token is None else (token.values, token.known)
    picture = np.zeros((0, 0, 3), dtype=np.uint8) if probed.tactile is None else _shown(stretched(probed.tactile))
    packed = io.BytesIO()
    np.savez_compressed(
        packed,
        text=np.frombuffer(text.encode(), np.uint8),
        picture=picture,
        token=np.asarray(values, dtype=np.float32),
        known=np.asarray(known, dtype=bool),
    )
    return packed.getvalue()


def take_probe(folder: Path) -> ProbeView:
    """The answer in a job's folder → STATE.probe, and the suggestions of its material.

    Raises FileError where it is damaged.
    """
    try:
        with np.load(folder / ANSWER_NAME, allow_pickle=False) as arrays:
            record: dict[str, Any] = json.loads(arrays["text"].tobytes())
            picture, token = arrays["picture"], Token(arrays["token"], arrays["known"])
        told = {**record["told"], "notes": tuple(record["told"]["notes"])}
        nearest = tuple(NearView(*each) for each in record["nearest"])
        ranked = tuple(Suggestion(*each) for each in record["ranked"])
        relief = Relief(token, Route(record["route"]))
        view = ProbeView(**told, nearest=nearest, icon=show(PICTURE, rgba(picture)) if picture.size else 0)
    except DAMAGED as error:
        raise FileError(f"the answer is damaged ({error}).", where=ANSWER_NAME, remedy="Look again.") from error
    STATE.probe = view
    if view.material_full:
        STATE.suggestions[view.material_full] = ranked
        STATE.reliefs.pop(view.material_full, None)
        if token.values.size:
            STATE.reliefs[view.material_full] = relief
    return view


def rgba(picture: NDArray[np.uint8]) -> NDArray[np.float32]:
    """(H, W, 3) uint8 from the top → (H, W, 4) float32 0–1 from the bottom, as Blender's icons are."""
    shown = np.ones((*picture.shape[:2], 4), dtype=np.float32)
    shown[..., :3] = picture[::-1] / np.float32(255.0)
    return shown


def _shown(image: NDArray[np.float64]) -> NDArray[np.uint8]:
    return np.asarray(np.round(255.0 * linear_to_srgb(np.clip(image, 0.0, 1.0))), dtype=np.uint8)
