"""From a patch's picture to its token: D_φ, then E, each read when the first patch asks for it.

Patches of a stroke → height or picture, token, shading values: from the store where they are fresh, from a close-up
and the networks else.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Generator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core import __version__
from hnf_core.field.weights import load_field, read_encoders
from hnf_core.files import content_hash
from hnf_core.material.encoder_registry import Encoder, describe_views, get_default_encoder, get_encoder
from hnf_core.material.hnf_file import MaterialFile
from hnf_core.material.library import Appearance
from hnf_core.material.token import Token
from hnf_core.scene.patch import Patch
from hnf_core.tactile.diffusion.predict import DEFAULT_STEPS, predict_tactile_maps
from hnf_core.tactile.diffusion.weights import DEFAULT_WEIGHTS, MapWeights, load_map_weights
from hnf_core.tactile.height import tactile_map_from_height
from hnf_core.tactile.optics import get_sensor, render_sensor_image
from hnf_core.tactile.tactile_map import Route, TactileMap
from hnf_core.tactile.views import PITCHES_M, AppearanceView, cut_views, measure_contrast
from hnf_core.threads import single_blas_thread

from ..bridge.render.closeup import CloseUp, iter_closeups
from ..bridge.render.unlit_image import MAX_READABLE_WAVELENGTH_M, UnlitImage
from ..bridge.scene.meshes import Surface
from ..bridge.splats.splat_cloud import get_cloud
from .patch_cache import (
    PATCH_VERSION,
    PatchRecord,
    Prediction,
    load_patch,
    load_prediction,
    save_patch,
    save_prediction,
)
from .report import Counts

SENSOR = "gelsight"
SHARPEST_WAVELENGTH_M = 2.0 * PITCHES_M[0]
"""The shortest wave of the widest view."""
MIN_CONTRAST = 1.0 / 255.0
"""Contrast of a view (tactile.views.contrast): one level of an eight-bit picture. One in a hundred training views is
fainter; a plain colour says nothing, and D_φ, which never met any, would make a pattern of it. bridge.look says the
same of a whole patch."""


class ReliefPredictor:
    """The networks of one run. encoder: name or file of a make of E for all maps, "" = each route's own default."""

    def __init__(self, encoder: str = "") -> None:
        """Raises UsageError, FileError, WeightsError or MaterialError where encoder cannot be used."""
        self._path = DEFAULT_WEIGHTS
        asked = get_encoder(encoder) if encoder else None
        known = read_encoders(load_field().metadata)
        self.measured_encoder: Encoder = asked or get_default_encoder(Route.MEASURED, known)
        self.predicted_encoder: Encoder = asked or get_default_encoder(Route.PREDICTED, known)

    @property
    def weights_hash(self) -> str:
        """Of D_φ's weights, without reading them into a network; "" where there are none."""
        try:
            stat = self._path.stat()
        except OSError:
            return ""
        return _hash_file(self._path, stat.st_mtime_ns, stat.st_size)

    @property
    def content_id(self) -> str:
        """Changes with everything that a prediction of an equal picture follows from."""
        return content_hash(
            self.weights_hash, self.predicted_encoder.content_id, f"{SENSOR} {DEFAULT_STEPS} {MIN_CONTRAST:g}"
        )

    @property
    def missing_reason(self) -> str:
        """Why no picture can be read, "" where it can."""
        if self.weights_hash:
            return ""
        return (
            "its relief could be estimated from its picture, but the weights for that are not there; its name and look "
            f"decide. Install the package with its data files, or run: hnf train tactile-map --data simulated --out "
            f"{self._path}"
        )

    def make_views(
        self, unlit: UnlitImage, mask: NDArray[np.bool_], metres_per_pixel: float
    ) -> tuple[AppearanceView, ...]:
        """What D_φ is shown of a patch; empty where the picture is too coarse, of one colour, or too little of it is
        seen."""
        resolved = unlit.resolved_wavelength_m
        soft = SHARPEST_WAVELENGTH_M < resolved <= MAX_READABLE_WAVELENGTH_M
        views = cut_views(
            unlit.linear, unlit.depth_m, mask, metres_per_pixel, SHARPEST_WAVELENGTH_M if soft else resolved
        )
        return tuple(view for view in views if measure_contrast(view.rgb) >= MIN_CONTRAST)

    def predict(self, unlit: UnlitImage, views: tuple[AppearanceView, ...], seed: int) -> Prediction:
        """One call of D_φ for all views of a patch, then E of each map, merged. Equal input gives equal bytes. seed: of
        the patch; where D_φ is a diffusion, each view has noise of its own.

        Raises FileError or WeightsError where the weights cannot be used.
        """
        weights = _load_weights(self._path, self.weights_hash)
        with single_blas_thread():
            found = predict_tactile_maps(weights, views, SENSOR, seed=range(seed, seed + len(views)))
        maps = [
            replace(each, resolved_wavelength_m=max(each.resolved_wavelength_m, unlit.resolved_wavelength_m))
            for each in found
        ]
        token = describe_views(self.predicted_encoder, maps)
        return Prediction(
            images=np.stack([each.image for each in maps]).astype(np.float16),
            pitch_m=np.array([each.metres_per_pixel for each in maps]),
            resolved_wavelength_m=unlit.resolved_wavelength_m,
            token=Token(token.values, token.known),
            encoder=self.predicted_encoder.name,
            weights=weights.fingerprint,
        )


def make_predicted_maps(prediction: Prediction) -> tuple[TactileMap, ...]:
    """The tactile maps that a token was made from, the widest first; without their heights."""
    mask = np.ones(prediction.images.shape[1:3], dtype=bool)
    return tuple(
        TactileMap(
            image.astype(np.float32), None, mask, float(pitch), SENSOR,
            max(2.0 * float(pitch), prediction.resolved_wavelength_m), Route.PREDICTED, "D_φ",
        )
        for image, pitch in zip(prediction.images, prediction.pitch_m, strict=True)
    )  # fmt: skip


def is_too_coarse(unlit: UnlitImage) -> bool:
    """Does a picture show no wave that is short enough to read it?"""
    return unlit.resolved_wavelength_m > MAX_READABLE_WAVELENGTH_M


def explain_skipped(unlit: UnlitImage) -> str:
    """What keeps a picture from being read, for the artist."""
    if is_too_coarse(unlit):
        return (
            f"its picture ({unlit.source}) shows no wave below {unlit.resolved_wavelength_m * 1e3:.2g} mm, and "
            f"{MAX_READABLE_WAVELENGTH_M * 1e3:g} mm is needed to estimate relief from it; its name and look decide"
        )
    return (
        "its picture is of one colour there, or too little of it is seen in one piece, to estimate relief from it; its "
        "name and look decide"
    )


@lru_cache(maxsize=2)
def _load_weights(path: Path, content: str) -> MapWeights:
    return load_map_weights(path)


@lru_cache(maxsize=4)
def _hash_file(path: Path, modified_ns: int, size: int) -> str:
    return content_hash(path.read_bytes())


PATCH_PIXELS = 512
"""39 µm a pixel on 20 mm: two pixels resolve the finest band of a token (0.125 mm)."""
FIRST_PASS_PIXELS = 128
"""Of a first look where all detail is in images: enough for texels of half a millimetre, at a fifth of the time."""


@dataclass(frozen=True)
class TouchedObject:
    """An object as strokes of this run meet it. shape_hash: of its geometry. shader_hashes: by material slot.
    owner_hash: of what its shaders read of the object beside its shape, "" = nothing. frame: scene frame, None = still.
    chosen: what the artist said on the materials themselves, by slot: library material, definition, "" = nothing.
    pictures: names of the textures that feed each slot's shader. splats: name of the file whose splats show the object,
    "" = none. reliefs: by slot, whether its shader has a relief. view_layer: that it is touched in, of a scene that may
    not be the only one it stands in."""

    obj: Any
    surface: Surface
    shape_hash: str
    shader_hashes: tuple[str, ...]
    owner_hash: str
    metres_per_unit: float
    frame: float | None = None
    artist_choices: tuple[str | MaterialFile, ...] = ()
    texture_names: tuple[tuple[str, ...], ...] = ()
    splat_source: str = ""
    has_relief: tuple[bool, ...] = ()
    view_layer: Any = None

    def uses_splats(self, slot: int) -> bool:
        """A relief that the artist gave the surface counts for more than what its splats look like."""
        return bool(self.splat_source) and not (slot < len(self.has_relief) and self.has_relief[slot])


def compute_patch_key(touched: TouchedObject, patch: Patch, encoder: str) -> str:
    """Name of a patch's content: geometry, shader, place on the surface, and the way it is looked at, the add-on's own
    version included; and the names that a record's notes say. encoder: content id of the E that describes what is
    measured."""
    shader = touched.shader_hashes[patch.slot] if patch.slot < len(touched.shader_hashes) else ""
    place = np.round(np.concatenate([patch.centre, patch.x_axis, patch.normal]), 7) + 0.0
    here = slice(patch.slot, patch.slot + 1)
    names = repr((touched.surface.materials[here], touched.texture_names[here]))
    return content_hash(
        names, touched.shape_hash, shader, touched.owner_hash, place.tobytes(), f"{patch.slot} {patch.size_m:.9g}",
        f"{__version__} {PATCH_PIXELS} {FIRST_PASS_PIXELS} {SENSOR} {encoder} {PATCH_VERSION} {touched.frame}",
    )  # fmt: skip


def bake_patches(
    touched: TouchedObject,
    patches: Sequence[Patch],
    folder: Path,
    counts: Counts,
    predictor: ReliefPredictor,
    chosen_slots: Collection[int] = (),
) -> Generator[float, None, tuple[PatchRecord, ...]]:
    """One record a patch. What the store lacks is rendered, all of it on one stage; where the relief is not known and
    the colour varies, it is estimated from the picture, once for each patch.

    seeing: the networks. chosen: slots of which the artist said what they are: their pictures are not read. Each is
    described and stored beside the rays of the next: a run that is stopped loses one at most. Yields which share of
    them is done, with nothing at work meanwhile. counts grows by the work done. Raises SceneError where a texture is
    missing.
    """
    keys = [compute_patch_key(touched, patch, predictor.measured_encoder.content_id) for patch in patches]
    wanted = dict(zip(keys, patches, strict=True))
    found = {key: record for key in wanted if (record := load_patch(folder, key)) is not None}
    missing = [patch for key, patch in wanted.items() if key not in found]

    def describe(key: str, closeup: CloseUp | None) -> None:
        patch = wanted[key]
        if closeup is not None:
            found[key] = _make_record(closeup, touched.surface, predictor.measured_encoder, counts)
            save_patch(folder, key, found[key])
        if patch.slot not in chosen_slots:
            found[key] = _add_prediction(found[key], key, compute_noise_seed(touched, patch), folder, predictor, counts)

    with ThreadPoolExecutor(1) as beside:
        describing: list[Future[None]] = []

        def alone() -> None:
            while describing:
                describing.pop().result()

        with closing(_iter_closeups(touched, missing, alone)) as closeups:
            for done, key in enumerate(wanted, 1):
                closeup = None if key in found else next(closeups)
                alone()
                if closeup is not None:
                    counts.close_ups += 1
                    counts.renders += closeup.renders
                    counts.rays += closeup.rays
                yield (done - 1) / len(wanted)
                describing.append(beside.submit(describe, key, closeup))
            alone()
    yield 1.0
    return tuple(found[key] for key in keys)


def _iter_closeups(
    touched: TouchedObject, patches: Sequence[Patch], wait_for_threads: Callable[[], None]
) -> Generator[CloseUp, None, None]:
    """One a patch, in their order: in the splats of a reconstructed surface, else by its shader. alone: see
    iter_closeups."""
    in_splats = [touched.uses_splats(patch.slot) for patch in patches]
    drawn = iter_closeups(
        touched.obj,
        [patch for patch, splats in zip(patches, in_splats, strict=True) if not splats],
        surface=touched.surface,
        pixels=PATCH_PIXELS,
        metres_per_unit=touched.metres_per_unit,
        frame=touched.frame,
        view_layer=touched.view_layer,
        first_pass_pixels=FIRST_PASS_PIXELS,
        wait_for_threads=wait_for_threads,
    )
    with closing(drawn):
        if not any(in_splats):
            yield from drawn
            return
        from ..bridge.splats.splat_closeup import iter_splat_closeups

        own = [patch for patch, splats in zip(patches, in_splats, strict=True) if splats]
        cloud = get_cloud(touched.obj)
        reconstructed = iter_splat_closeups(touched.obj, cloud, own, surface=touched.surface, pixels=PATCH_PIXELS)
        with closing(reconstructed):
            for splats in in_splats:
                yield next(reconstructed if splats else drawn)


def compute_noise_seed(touched: TouchedObject, patch: Patch) -> int:
    """Of a patch's prediction (a regression heeds none): of its material and its place on the surface to a millimetre.
    patch_key takes in every digit; a scene that is moved is rounded otherwise, and must feel as it did."""
    shader = touched.shader_hashes[patch.slot] if patch.slot < len(touched.shader_hashes) else ""
    # Off the grid: people like round numbers, which would lie on its borders.
    place = np.floor(patch.centre * 1e3 + 0.317).astype(int)
    return int(content_hash(shader, repr(place.tolist()))[:15], 16)


def _add_prediction(
    record: PatchRecord, key: str, seed: int, folder: Path, predictor: ReliefPredictor, counts: Counts
) -> PatchRecord:
    """record with what can be estimated from its picture: from the store, else by one call of D_φ."""
    if record.unlit is None or predictor.missing_reason:
        return record
    name = content_hash(key, predictor.content_id)
    prediction = load_prediction(folder, name)
    if prediction is None:
        views = predictor.make_views(record.unlit, record.mask, record.metres_per_pixel)
        if not views:
            return record
        prediction = predictor.predict(record.unlit, views, seed)
        counts.diffusion_calls += 1
        counts.tokens += 1
        save_prediction(folder, name, prediction)
    return replace(record, predicted=prediction)


def get_measured_map(record: PatchRecord) -> TactileMap | None:
    """The measured tactile map that a record was described from; None where nothing was measured."""
    if record.height is None:
        return None
    image = render_sensor_image(record.height, record.metres_per_pixel, get_sensor(SENSOR))
    return TactileMap(
        image, record.height, record.mask, record.metres_per_pixel, SENSOR, record.resolved_wavelength_m,
        Route.MEASURED, record.height_source,
    )  # fmt: skip


def get_widest_map(record: PatchRecord) -> TactileMap | None:
    """The tactile map to show of a patch, whatever its route; None where there is none."""
    return get_measured_map(record) if record.predicted is None else make_predicted_maps(record.predicted)[0]


def get_token(record: PatchRecord) -> Token | None:
    """E of the patch's map, measured or predicted; None where there is no map."""
    if record.predicted is not None:
        return record.predicted.token
    return None if record.token is None or record.known is None else Token(record.token, record.known)


def get_resolved_wavelength(record: PatchRecord) -> float:
    """Shortest wave that the source of the patch's map shows, in metres; inf where there is no map."""
    return record.resolved_wavelength_m if record.predicted is None else record.predicted.resolved_wavelength_m


def get_map_source(record: PatchRecord) -> str:
    """What the patch's map was made from, in words; "" where there is none."""
    if record.predicted is None or record.unlit is None:
        return record.height_source
    return f"estimated from {record.unlit.source}"


def get_encoder_name(record: PatchRecord) -> str:
    """The make of E that described the patch's map; "" where there is none."""
    return record.encoder if record.predicted is None else record.predicted.encoder


def compute_mean_appearance(records: Sequence[PatchRecord]) -> Appearance:
    """Shading values of several patches of one material, each averaged over the patches that know it."""
    colours = [record.appearance.base_color for record in records if record.appearance.base_color is not None]
    red, green, blue = np.mean(colours, axis=0) if colours else (0.0, 0.0, 0.0)
    return Appearance(
        None if not colours else (float(red), float(green), float(blue)),
        *(_average_known([getattr(record.appearance, name) for record in records])
          for name in ("roughness", "metallic", "sheen", "transmission")),
    )  # fmt: skip


def _average_known(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def _make_record(closeup: CloseUp, surface: Surface, encoder: Encoder, counts: Counts) -> PatchRecord:
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
        token = encoder.describe(tactile)
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
        unlit=closeup.unlit,
        encoder="" if token is None else encoder.name,
    )
