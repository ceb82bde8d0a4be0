"""Patches of a stroke → height, token, shading values: from the store where they are fresh, from a close-up else."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hnf_core.files import content_hash
from hnf_core.material.encoder import describe
from hnf_core.material.hnf_file import MaterialFile
from hnf_core.material.material import Appearance
from hnf_core.material.token import ENCODER_ID, Token
from hnf_core.scene.patch import Patch
from hnf_core.tactile.height import tactile_map_from_height
from hnf_core.tactile.optics import render_sensor_image, sensor_by_name
from hnf_core.tactile.tactile_map import Route, TactileMap

from ..bridge.closeup import CloseUp, iter_closeups
from ..bridge.meshes import Surface, ray_caster
from .report import Counts
from .store import STORE_VERSION, PatchRecord, load_patch, save_patch

PATCH_PIXELS = 512
"""39 µm a pixel on 20 mm: two pixels resolve the finest band of a token (0.125 mm)."""
SENSOR = "gelsight"


@dataclass(frozen=True)
class TouchedObject:
    """An object as strokes of this run meet it. shape_hash: of its geometry. shader_hashes: by material slot.
    place_hash: where its shaders look at the world, of its place in it, else "". frame: scene frame, None = still.
    chosen: what the artist said on the materials themselves, by slot: library material, definition, "" = nothing."""

    obj: Any
    surface: Surface
    shape_hash: str
    shader_hashes: tuple[str, ...]
    place_hash: str
    metres_per_unit: float
    frame: float | None = None
    chosen: tuple[str | MaterialFile, ...] = ()


def patch_key(touched: TouchedObject, patch: Patch) -> str:
    """Name of a patch's content: geometry, shader, place on the surface, and the way it is looked at."""
    shader = touched.shader_hashes[patch.slot] if patch.slot < len(touched.shader_hashes) else ""
    place = np.round(np.concatenate([patch.centre, patch.x_axis, patch.normal]), 7) + 0.0
    return content_hash(
        touched.shape_hash, shader, touched.place_hash, place.tobytes(), f"{patch.slot} {patch.size_m:.9g}",
        f"{PATCH_PIXELS} {SENSOR} {ENCODER_ID} {STORE_VERSION} {touched.frame}",
    )  # fmt: skip


def bake_patches(
    touched: TouchedObject, patches: Sequence[Patch], folder: Path, counts: Counts
) -> Generator[float, None, tuple[PatchRecord, ...]]:
    """One record a patch; only what the store lacks is rendered, all of it on one stage.

    Yields after each render which share of them is done; each is stored at once, so that a run that is stopped has
    not lost it. Raises SceneError where a texture is missing. counts grows by the work done.
    """
    keys = [patch_key(touched, patch) for patch in patches]
    found = {key: record for key in dict.fromkeys(keys) if (record := load_patch(folder, key)) is not None}
    missing = {key: patch for key, patch in zip(keys, patches, strict=True) if key not in found}
    if missing:
        closeups = iter_closeups(
            touched.obj,
            list(missing.values()),
            surface=touched.surface,
            caster=ray_caster(touched.surface.mesh),
            pixels=PATCH_PIXELS,
            metres_per_unit=touched.metres_per_unit,
            frame=touched.frame,
        )
        with closing(closeups):
            for done, (key, closeup) in enumerate(zip(missing, closeups, strict=True), 1):
                counts.renders += closeup.renders
                counts.rays += closeup.rays
                found[key] = _record(closeup, touched.surface, counts)
                save_patch(folder, key, found[key])
                yield done / len(missing)
    return tuple(found[key] for key in keys)


def tactile_map_of(record: PatchRecord) -> TactileMap | None:
    """The tactile map a record was described from; None where nothing was measured."""
    if record.height is None:
        return None
    image = render_sensor_image(record.height, record.metres_per_pixel, sensor_by_name(SENSOR))
    return TactileMap(
        image, record.height, record.mask, record.metres_per_pixel, SENSOR, record.resolved_wavelength_m,
        Route.MEASURED, record.height_source,
    )  # fmt: skip


def token_of(record: PatchRecord) -> Token | None:
    return None if record.token is None or record.known is None else Token(record.token, record.known)


def mean_appearance(records: Sequence[PatchRecord]) -> Appearance:
    """Shading values of several patches of one material, each averaged over the patches that know it."""
    colours = [record.appearance.base_color for record in records if record.appearance.base_color is not None]
    red, green, blue = np.mean(colours, axis=0) if colours else (0.0, 0.0, 0.0)
    return Appearance(
        None if not colours else (float(red), float(green), float(blue)),
        *(_mean([getattr(record.appearance, name) for record in records])
          for name in ("roughness", "metallic", "sheen", "transmission")),
    )  # fmt: skip


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def _record(closeup: CloseUp, surface: Surface, counts: Counts) -> PatchRecord:
    """E is called only where the shader has micro-geometry: a flat map has nothing to describe."""
    tactile, token = None, None
    if closeup.height is not None:
        tactile = tactile_map_from_height(
            closeup.height,
            closeup.mask,
            closeup.metres_per_pixel,
            closeup.resolved_wavelength_m,
            sensor=SENSOR,
            height_source=closeup.height_source,
        )
        token = describe(tactile)
        counts.tokens += 1
    faces = closeup.faces if surface.source_face is None else surface.source_face[closeup.faces]
    return PatchRecord(
        height=None if tactile is None else tactile.height,
        mask=closeup.mask,
        metres_per_pixel=closeup.metres_per_pixel,
        resolved_wavelength_m=closeup.resolved_wavelength_m,
        height_source=closeup.height_source,
        height_peak_to_peak_m=0.0 if closeup.height is None else float(np.ptp(closeup.height[closeup.mask])),
        token=None if token is None else token.values,
        known=None if token is None else token.known,
        appearance=closeup.appearance,
        faces=np.unique(faces[faces >= 0]).astype(np.int32),
        notes=closeup.notes,
    )
