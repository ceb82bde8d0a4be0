"""Patches (squares of surface under a stroke) → records with height or unlit image, token and appearance.

A record is read from the cache or made from a close-up render. Where a shader has no relief, the network D_φ predicts
tactile maps (images of a touch sensor) from the unlit image, and the encoder E turns them into a token
(`ReliefPredictor`). The networks are loaded when they are first needed.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core import __version__
from hnf_core.errors import SceneError
from hnf_core.field.weights import load_field, read_encoders
from hnf_core.files import content_hash, hash_file
from hnf_core.material.encoder_registry import Encoder, describe_views, get_default_encoder, get_encoder
from hnf_core.material.fuse import BAND_COUNT, FusedToken, fuse, fuse_measured_over_predicted
from hnf_core.material.hnf_file import MaterialFile
from hnf_core.material.library import Appearance
from hnf_core.material.token import BAND_FEATURES, Token, band_slice
from hnf_core.progress import Progress, ProgressCallback, ignore_progress
from hnf_core.scene.camera import Patch
from hnf_core.tactile.diffusion import DEFAULT_STEPS, predict_tactile_maps
from hnf_core.tactile.height import tactile_map_from_height
from hnf_core.tactile.optics import get_sensor, render_sensor_image
from hnf_core.tactile.tactile_map import Route, TactileMap
from hnf_core.tactile.unet import MapWeights, find_map_weights, load_map_weights
from hnf_core.tactile.views import PITCHES_M, AppearanceView, cut_views, measure_contrast
from hnf_core.threads import single_blas_thread

from ..bridge.closeup import CloseUp, CloseUpRenderer
from ..bridge.cycles import MAX_READABLE_WAVELENGTH_M, UnlitImage
from ..bridge.scene.meshes import Surface
from ..bridge.splat_cloud import get_cloud
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

SHARPEST_WAVELENGTH_M = 2.0 * PITCHES_M[0]
"""Shortest wavelength [m] that the widest view given to D_φ can show: two of its pixels."""
MIN_CONTRAST = 1.0 / 255.0
"""Minimum contrast (`measure_contrast`) of a view given to D_φ: one step of an 8-bit image. One in a hundred training
views has less. A uniform color contains no information, and D_φ, which was not trained on any, would invent a pattern.
`MIN_COLOUR_STD_CODES` is the same limit for an entire patch."""


class ReliefPredictor:
    """Networks of one run that predict a relief: D_φ (image → tactile map) and the encoder E (tactile map → token).

    Parameters
    ----------
    encoder : str, optional
        Name or file of the encoder for all maps; "" uses the default of each route.
    sensor : str, optional
        Touch sensor of all maps.
    tactile_map : str, optional
        Word or file of D_φ (`find_map_weights`); "" uses the default.

    Raises
    ------
    UsageError, FileError, WeightsError, MaterialError
        If the encoder, or a chosen D_φ, cannot be used.
    """

    def __init__(self, encoder: str = "", sensor: str = "gelsight", tactile_map: str = "") -> None:
        self.sensor = get_sensor(sensor).name
        self._path = find_map_weights(tactile_map)
        if tactile_map:
            _ = _load_weights(self._path, self.weights_hash).token_error  # raises now, not at the first picture
        chosen = get_encoder(encoder) if encoder else None
        field_encoders = read_encoders(load_field().metadata)
        self.measured_encoder: Encoder = chosen or get_default_encoder(Route.MEASURED, field_encoders)
        self.predicted_encoder: Encoder = chosen or get_default_encoder(Route.PREDICTED, field_encoders)

    @property
    def weights_hash(self) -> str:
        """Hash of the weights of D_φ, computed without loading the network; "" if there are no weights."""
        try:
            stat = self._path.stat()
        except OSError:
            return ""
        return _hash_file(self._path, stat.st_mtime_ns, stat.st_size)

    @property
    def content_id(self) -> str:
        """Hash of everything that a prediction depends on besides the image: the weights of both networks."""
        return content_hash(
            self.weights_hash, self.predicted_encoder.content_id, f"{self.sensor} {DEFAULT_STEPS} {MIN_CONTRAST:g}"
        )

    @property
    def missing_reason(self) -> str:
        """Reason why no relief can be predicted in this installation, "" if it can."""
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
        """Cut the views (square crops at fixed scales) that D_φ takes as input out of a patch's unlit image.

        `mask` (H, W) is the patch's own surface. The result is empty if the image is too coarse or uniform, or too
        little of the surface is visible.
        """
        resolved = unlit.resolved_wavelength_m
        if SHARPEST_WAVELENGTH_M < resolved <= MAX_READABLE_WAVELENGTH_M:
            resolved = SHARPEST_WAVELENGTH_M
        views = cut_views(unlit.linear, unlit.depth_m, mask, metres_per_pixel, resolved)
        return tuple(view for view in views if measure_contrast(view.rgb) >= MIN_CONTRAST)

    def predict(self, unlit: UnlitImage, views: tuple[AppearanceView, ...], seed: int) -> Prediction:
        """Predict tactile maps from all views of a patch in one call of D_φ, and encode them to a token.

        Equal inputs give equal bytes. `seed` is that of the patch; if D_φ is a diffusion model, each view has its own
        noise. Raises FileError or WeightsError if the weights cannot be used.
        """
        weights = _load_weights(self._path, self.weights_hash)
        with single_blas_thread():
            predicted = predict_tactile_maps(weights, views, self.sensor, seed=range(seed, seed + len(views)))
        maps = [
            replace(tactile, resolved_wavelength_m=max(tactile.resolved_wavelength_m, unlit.resolved_wavelength_m))
            for tactile in predicted
        ]
        token = describe_views(self.predicted_encoder, maps)
        return Prediction(
            images=np.stack([tactile.image for tactile in maps]).astype(np.float16),
            pitch_m=np.array([tactile.metres_per_pixel for tactile in maps]),
            resolved_wavelength_m=unlit.resolved_wavelength_m,
            token=Token(token.values, token.known, weights.token_error),
            sensor=self.sensor,
            encoder=self.predicted_encoder.name,
            weights=weights.fingerprint,
        )


def make_predicted_maps(prediction: Prediction) -> tuple[TactileMap, ...]:
    """Return the predicted tactile maps of a patch, the widest first, without heights."""
    mask = np.ones(prediction.images.shape[1:3], dtype=bool)
    return tuple(
        TactileMap(
            image.astype(np.float32), None, mask, float(pitch), prediction.sensor,
            max(2.0 * float(pitch), prediction.resolved_wavelength_m), Route.PREDICTED, "D_φ",
        )
        for image, pitch in zip(prediction.images, prediction.pitch_m, strict=True)
    )  # fmt: skip


def is_too_coarse(unlit: UnlitImage) -> bool:
    """Return True if an unlit image shows no wavelength short enough for a relief to be predicted from it."""
    return unlit.resolved_wavelength_m > MAX_READABLE_WAVELENGTH_M


def explain_skipped(unlit: UnlitImage) -> str:
    """Explain why no relief is predicted from an unlit image."""
    if is_too_coarse(unlit):
        return (
            f"its picture ({unlit.source}) shows no wave below {unlit.resolved_wavelength_m * 1e3:.2g} mm, and "
            f"{MAX_READABLE_WAVELENGTH_M * 1e3:g} mm is needed to estimate relief from it; its name and look decide"
        )
    return (
        "its picture is of one color there, or too little of it is seen in one piece, to estimate relief from it; its "
        "name and look decide"
    )


@lru_cache(maxsize=2)
def _load_weights(path: Path, content: str) -> MapWeights:
    return load_map_weights(path)


@lru_cache(maxsize=4)
def _hash_file(path: Path, modified_ns: int, size: int) -> str:
    return hash_file(path)


PATCH_PIXELS = 512
"""Side of a patch's image [pixels]: 39 µm per pixel on 20 mm, so that two pixels resolve a token's finest band (0.125
mm)."""
FIRST_PASS_PIXELS = 128
"""Side of a first pass if all detail is in images [pixels]: enough for texels of 0.5 mm, in a fifth of the time."""
CACHE_FOLDER_NAME = "cache"
"""Folder of cached patches next to a run's results."""
CLOSEUP_STAGE = "close-ups"
"""Name of the stage in which patches are rendered and described."""


@dataclass(frozen=True)
class TouchedObject:
    """An object with everything that strokes need of it: surface, hashes, and the materials the user chose.

    Attributes
    ----------
    obj : bpy.types.Object
    surface : Surface
    shape_hash : str
        Hash of its geometry.
    shader_hashes : tuple of str
        Hash of each slot's shader.
    owner_hash : str
        Other data of the object that its shaders read, as text; "" for none.
    metres_per_unit : float
        Length of a Blender unit [m].
    artist_choices : tuple of str or MaterialFile
        Choice of each slot's Blender material: library material or definition, "" for none.
    texture_names : tuple of tuple of str
        Names of the textures of each slot's shader.
    splat_source : str
        Name of the file of its splats, "" for none.
    has_relief : tuple of bool
        True if a slot's shader has a relief.
    view_layer : bpy.types.ViewLayer
        View layer in which it is touched; it may be in other scenes too.
    heights_as_authored : tuple of bool
        True if a slot's relief is meant to be as high as its shader makes it.
    """

    obj: Any
    surface: Surface
    shape_hash: str
    shader_hashes: tuple[str, ...]
    owner_hash: str
    metres_per_unit: float
    artist_choices: tuple[str | MaterialFile, ...] = ()
    texture_names: tuple[tuple[str, ...], ...] = ()
    splat_source: str = ""
    has_relief: tuple[bool, ...] = ()
    view_layer: Any = None
    heights_as_authored: tuple[bool, ...] = ()

    def uses_splats(self, slot: int) -> bool:
        """Return True if a slot is rendered from splats; a relief of its shader takes precedence."""
        return bool(self.splat_source) and not self.has_relief_at(slot)

    def has_relief_at(self, slot: int) -> bool:
        """Return True if the shader of a slot has nodes for a relief, whether it can be read or not."""
        return slot < len(self.has_relief) and self.has_relief[slot]


def compute_patch_key(touched: TouchedObject, patch: Patch, predictor: ReliefPredictor) -> str:
    """Return the cache key of a patch: a hash of geometry, shader, place, and settings of the close-up.

    The add-on's version and the names in a record's notes count too, and the `predictor`'s sensor and its encoder of
    maps measured from a shader's relief.
    """
    shader = touched.shader_hashes[patch.slot] if patch.slot < len(touched.shader_hashes) else ""
    place = np.round(np.concatenate([patch.centre, patch.x_axis, patch.normal]), 7) + 0.0
    slot = slice(patch.slot, patch.slot + 1)
    names = repr((touched.surface.materials[slot], touched.texture_names[slot]))
    return content_hash(
        names, touched.shape_hash, shader, touched.owner_hash, place.tobytes(), f"{patch.slot} {patch.size_m:.9g}",
        f"{__version__} {PATCH_PIXELS} {FIRST_PASS_PIXELS} {predictor.sensor} "
        f"{predictor.measured_encoder.content_id} {PATCH_VERSION} None",  # as it was when a frame could stand here
    )  # fmt: skip


def bake_patches(
    touched: TouchedObject,
    patches: Sequence[Patch],
    folder: Path,
    counts: Counts,
    predictor: ReliefPredictor,
    chosen_slots: Collection[int] = (),
    progress: ProgressCallback = ignore_progress,
) -> tuple[PatchRecord, ...]:
    """Return one record (height or unlit image, token, appearance) per patch, from the cache or a close-up render.

    Close-ups are rendered in one temporary scene. Where the relief is unknown and the color varies, it is predicted,
    once per patch. Each patch is encoded and saved while the next one's rays are cast, so that a stopped run loses at
    most one.

    Parameters
    ----------
    touched : TouchedObject
        Touched object.
    patches : sequence of Patch
        Patches.
    folder : Path
        Folder of the cache.
    counts : Counts
        Counters, which are incremented.
    predictor : ReliefPredictor
        Networks.
    chosen_slots : collection of int, optional
        Slots whose material the user chose; nothing is predicted for them.
    progress : ProgressCallback, optional
        Called after each patch; no thread is running then.

    Returns
    -------
    tuple of PatchRecord

    Raises
    ------
    SceneError
        If a texture is missing.
    """
    keys = [compute_patch_key(touched, patch, predictor) for patch in patches]
    patch_by_key = dict(zip(keys, patches, strict=True))
    records = {key: record for key in patch_by_key if (record := load_patch(folder, key)) is not None}
    missing = {key: patch for key, patch in patch_by_key.items() if key not in records}

    def describe(key: str, closeup: CloseUp | None) -> None:
        patch = patch_by_key[key]
        if closeup is not None:
            records[key] = _make_record(closeup, touched.surface, predictor, counts)
            if not closeup.is_incomplete:  # else the missing texture would stay unnoticed
                save_patch(folder, key, records[key])
        if patch.slot not in chosen_slots:
            seed = compute_noise_seed(touched, patch)
            records[key] = _add_prediction(records[key], key, seed, folder, predictor, counts)

    with ThreadPoolExecutor(1) as executor:
        pending: list[Future[None]] = []

        def wait_for_descriptions() -> None:
            while pending:
                pending.pop().result()

        with _open_renderer(touched, list(missing.values()), wait_for_descriptions, chosen_slots) as render_closeup:
            for done, key in enumerate(patch_by_key):
                closeup = render_closeup(missing[key]) if key in missing else None
                wait_for_descriptions()
                if closeup is not None:
                    counts.add("close_ups")
                    counts.add("renders", closeup.renders)
                    counts.add("rays", closeup.rays)
                progress(Progress(CLOSEUP_STAGE, done, len(patch_by_key)))
                pending.append(executor.submit(describe, key, closeup))
            wait_for_descriptions()
    progress(Progress(CLOSEUP_STAGE, len(patch_by_key), len(patch_by_key)))
    return tuple(records[key] for key in keys)


@contextmanager
def _open_renderer(
    touched: TouchedObject,
    patches: Sequence[Patch],
    wait_for_threads: Callable[[], None],
    chosen_slots: Collection[int],
) -> Iterator[Callable[[Patch], CloseUp]]:
    """Provide a function that renders any of the patches, from splats for a reconstructed surface, else by its shader.

    `wait_for_threads` is called before Blender is used. Temporary data is removed at the end of the with block.
    """
    splat_patches = [patch for patch in patches if touched.uses_splats(patch.slot)]
    shader_patches = [patch for patch in patches if not touched.uses_splats(patch.slot)]
    shader_renderer = CloseUpRenderer(
        touched.obj,
        shader_patches,
        surface=touched.surface,
        pixels=PATCH_PIXELS,
        metres_per_unit=touched.metres_per_unit,
        view_layer=touched.view_layer,
        first_pass_pixels=FIRST_PASS_PIXELS,
        wait_for_threads=wait_for_threads,
        chosen_slots=chosen_slots,
    )
    with shader_renderer:
        if not splat_patches:
            yield shader_renderer.render
            return
        from ..bridge.splat_closeup import SplatCloseUpRenderer

        cloud = get_cloud(touched.obj)
        splat_renderer = SplatCloseUpRenderer(
            touched.obj, cloud, splat_patches, surface=touched.surface, pixels=PATCH_PIXELS
        )
        with splat_renderer:
            yield lambda patch: (splat_renderer if touched.uses_splats(patch.slot) else shader_renderer).render(patch)


def compute_noise_seed(touched: TouchedObject, patch: Patch) -> int:
    """Return the seed of the noise of a patch's prediction, from its material and its place to a millimeter.

    The patch's cache key includes every digit of its place, but moving a scene changes the rounding, and must not
    change the prediction.
    """
    shader = touched.shader_hashes[patch.slot] if patch.slot < len(touched.shader_hashes) else ""
    # Off the grid: people like round numbers, which would lie on its borders.
    place = np.floor(patch.centre * 1e3 + 0.317).astype(int)
    return int(content_hash(shader, repr(place.tolist()))[:15], 16)


def _add_prediction(
    record: PatchRecord, key: str, seed: int, folder: Path, predictor: ReliefPredictor, counts: Counts
) -> PatchRecord:
    """Return a patch's record with its predicted relief, from the cache or by one call of D_φ.

    `key` is the patch's cache key, `folder` that of the cache; `counts` is incremented.
    """
    if record.unlit is None or predictor.missing_reason:
        return record
    name = content_hash(key, predictor.content_id)
    prediction = load_prediction(folder, name)
    if prediction is None:
        views = predictor.make_views(record.unlit, record.mask, record.metres_per_pixel)
        if not views:
            return record
        prediction = predictor.predict(record.unlit, views, seed)
        counts.add("diffusion_calls")
        counts.add("tokens")
        save_prediction(folder, name, prediction)
    return replace(record, predicted=prediction)


def get_measured_map(record: PatchRecord) -> TactileMap | None:
    """Return the tactile map computed from a patch's own height; None if neither shader nor mesh gave one."""
    if record.height is None:
        return None
    image = render_sensor_image(record.height, record.metres_per_pixel, get_sensor(record.sensor))
    return TactileMap(
        image, record.height, record.mask, record.metres_per_pixel, record.sensor, record.resolved_wavelength_m,
        Route.MEASURED, record.height_source,
    )  # fmt: skip


def scale_height(record: PatchRecord, gain: float, source: str, encoder: Encoder) -> PatchRecord:
    """Return a record with its height multiplied by `gain`, described anew; `source` tells where the height is from."""
    if record.height is None:
        return record
    scaled = replace(
        record,
        height=record.height * np.float32(gain),
        height_source=source,
        height_peak_to_peak_m=record.height_peak_to_peak_m * gain,
    )
    tactile = get_measured_map(scaled)
    assert tactile is not None
    token = encoder.describe(tactile)
    return replace(scaled, token=token.values, known=token.known, encoder=encoder.name)


def get_widest_map(record: PatchRecord) -> TactileMap | None:
    """Return the tactile map of a patch to show: the measured one, else the widest predicted view; None without."""
    if record.height is None and record.predicted is not None:
        return make_predicted_maps(record.predicted)[0]
    return get_measured_map(record)


def get_token(record: PatchRecord) -> Token | None:
    """Return the token of a patch's tactile map, measured or predicted; None without a map."""
    if record.token is not None and record.known is not None:
        return Token(record.token, record.known)
    return None if record.predicted is None else record.predicted.token


def get_shader_token(record: PatchRecord) -> Token | None:
    """Return the token of a patch without the bands that come from its mesh; None if no other is known."""
    token = get_token(record)
    if token is None or not any(record.mesh_bands):
        return token
    known = token.known.copy()
    for band in np.flatnonzero(record.mesh_bands):
        known[band_slice(int(band))] = False
    known[BAND_COUNT * len(BAND_FEATURES) :] = False
    return replace(token, known=known) if known.any() else None


def fuse_patch(record: PatchRecord, material: Token | NDArray[np.float32], confidence: float) -> FusedToken:
    """Complete the token of a patch from its maps and a library material's token of the given confidence."""
    prior = material.values if isinstance(material, Token) else material
    measured = get_token(record)
    if record.predicted is not None and measured is not None and record.route is Route.MEASURED:
        return fuse_measured_over_predicted(measured, record.predicted.token, prior, confidence)
    return fuse(measured, prior, confidence, record.route)


def get_resolved_wavelength(record: PatchRecord) -> float:
    """Return the shortest wavelength that a patch's tactile map resolves [m]; inf without a map."""
    if record.predicted is None or record.route is Route.MEASURED:
        return record.resolved_wavelength_m
    return record.predicted.resolved_wavelength_m


def get_map_source(record: PatchRecord) -> str:
    """Describe what a patch's tactile map was made from, such as an image; "" without a map."""
    if record.predicted is None or record.unlit is None:
        return record.height_source
    estimate = f"estimated from {record.unlit.source}"
    return f"{record.height_source}; the rest {estimate}" if record.height_source else estimate


def get_encoder_name(record: PatchRecord) -> str:
    """Return the name of the encoder that made a patch's token from its tactile map; "" without a map."""
    return record.encoder if record.predicted is None or record.encoder else record.predicted.encoder


def compute_mean_appearance(records: Sequence[PatchRecord]) -> Appearance:
    """Return the mean shading values of several patches of a material; patches without a value do not count for it."""
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


def _make_record(closeup: CloseUp, surface: Surface, predictor: ReliefPredictor, counts: Counts) -> PatchRecord:
    """Make the record of a patch from its close-up; a token is encoded only if there is a height."""
    tactile, token, encoder = None, None, predictor.measured_encoder
    if closeup.height is not None:
        try:
            tactile = tactile_map_from_height(
                closeup.height,
                closeup.mask,
                closeup.metres_per_pixel,
                closeup.resolved_wavelength_m,
                sensor=predictor.sensor,
                height_source=closeup.height_source,
            )
        except SceneError as error:
            raise SceneError(error.what, where=f"object '{surface.object_name}'", remedy=error.remedy) from None
        token = encoder.describe(tactile)
        for band in np.flatnonzero(closeup.empty_bands):
            token.known[band_slice(int(band))] = False
        counts.add("tokens")
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
        mesh_bands=closeup.mesh_bands,
        sensor=predictor.sensor,
    )
