"""From a patch's picture to its token: D_φ, then E, each read when the first patch asks for it."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hnf_core.blas import single_blas_thread
from hnf_core.field.weights import load_field, read_encoders
from hnf_core.files import content_hash
from hnf_core.material.encoders import Encoder, describe_views, get_default_encoder, get_encoder
from hnf_core.material.token import Token
from hnf_core.tactile.diffusion.predict import DEFAULT_STEPS, predict_tactile_maps
from hnf_core.tactile.diffusion.weights import DEFAULT_WEIGHTS, MapWeights, load_map_weights
from hnf_core.tactile.tactile_map import Route, TactileMap
from hnf_core.tactile.views import PITCHES_M, AppearanceView, cut_views, measure_contrast

from ..bridge.look import MAX_READABLE_WAVELENGTH_M, UnlitImage
from .store import Prediction

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
