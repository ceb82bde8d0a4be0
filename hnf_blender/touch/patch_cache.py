"""Cache of baked patches and predictions: .npz files named by the hash of their inputs, so that none is outdated.

A patch is a square of surface under a stroke, a prediction its relief guessed from a picture.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.files import NPZ_ERRORS, write_bytes
from hnf_core.material.library import Appearance
from hnf_core.material.token import Token
from hnf_core.progress import add_work
from hnf_core.tactile.tactile_map import Route

from ..bridge.cycles import UnlitImage

PATCH_VERSION = 6
"""Version of the files of patches; part of every key."""
PREDICTION_VERSION = 2
"""Version of the files of predictions."""

PATCHES_IN_MEMORY = 8
"""Number of records kept in memory, 2 MB each, 6 MB with an unlit image: more than a stroke of 10 cm crosses."""


@dataclass(frozen=True)
class Prediction:
    """Tactile maps (images of a touch sensor) predicted by D_φ from the unlit image of a patch.

    Attributes
    ----------
    images : (V, 64, 64, 3) float16 array
        Sensor images, the widest view first.
    pitch_m : (V,) array
        Size of their pixels [m].
    resolved_wavelength_m : float
        Shortest wavelength of the unlit image [m].
    token : Token
        Merged token of the maps, with its errors.
    sensor : str
        Touch sensor of the images.
    encoder : str
        Name of the encoder E.
    weights : str
        Hash of the weights of D_φ.
    """

    images: NDArray[np.float32]
    pitch_m: NDArray[np.float64]
    resolved_wavelength_m: float
    token: Token
    sensor: str
    encoder: str
    weights: str


@dataclass(frozen=True)
class PatchRecord:
    """Result of the close-up render of one patch (a square of surface): height or unlit image, token, appearance.

    Attributes
    ----------
    height : (H, W) float32 array or None
        Height [m]; None if neither shader nor mesh has micro-geometry.
    mask : (H, W) bool array
        Pixels of the patch's own surface.
    metres_per_pixel : float
        Size of a pixel [m].
    resolved_wavelength_m : float
        Shortest wavelength of the height [m], inf without height.
    height_source : str
        Description for the report.
    height_peak_to_peak_m : float
        Peak-to-peak of the height [m] before it is limited to what its sources resolve, 0 without.
    token, known : array or None
        Token of the measured tactile map and which of its values are known.
    appearance : Appearance
        Shading values averaged over the patch.
    faces : (k,) int32 array
        Faces of the object's own mesh that the patch covers.
    notes : tuple of str
        Warnings for the user.
    unlit : UnlitImage or None
        Unlit image, if the shader has no height and the color varies.
    encoder : str
        Name of the encoder E of `token`.
    predicted : Prediction or None
        Prediction from `unlit`, if wanted; stored in a file of its own.
    mesh_bands : tuple of bool
        For each wavelength band, True if the mesh gives most of the height; empty if it gives none.
    sensor : str
        Touch sensor of the measured map.
    """

    height: NDArray[np.float32] | None
    mask: NDArray[np.bool_]
    metres_per_pixel: float
    resolved_wavelength_m: float
    height_source: str
    height_peak_to_peak_m: float
    token: NDArray[np.float32] | None
    known: NDArray[np.bool_] | None
    appearance: Appearance
    faces: NDArray[np.int32]
    notes: tuple[str, ...]
    unlit: UnlitImage | None = None
    encoder: str = ""
    predicted: Prediction | None = None
    mesh_bands: tuple[bool, ...] = ()
    sensor: str = "gelsight"

    @property
    def route(self) -> Route:
        """Route by which the relief of this patch is known: measured, predicted or prior."""
        if self.height is not None:
            return Route.MEASURED
        return Route.PRIOR if self.predicted is None else Route.PREDICTED


_SCALARS: dict[str, Any] = {
    **dict.fromkeys(("metres_per_pixel", "resolved_wavelength_m", "height_peak_to_peak_m"), float),
    **dict.fromkeys(("height_source", "encoder", "sensor"), str),
}
"""Fields of a record that are numbers or texts, by name."""


def load_patch(folder: Path, key: str) -> PatchRecord | None:
    """Load the record of a patch by its cache key, its arrays read-only; None if it is missing or damaged.

    A damaged file is treated as missing, so that the patch is baked again.
    """
    path = folder / f"{key}.npz"
    try:
        stat = path.stat()
        return _read_patch(path, stat.st_mtime_ns, stat.st_size)
    except NPZ_ERRORS:
        return None


@lru_cache(maxsize=PATCHES_IN_MEMORY)
def _read_patch(path: Path, _written_ns: int, _bytes: int) -> PatchRecord | None:
    """Read a patch's record; raises NPZ_ERRORS.

    The last records stay in memory while the file's time and size (the other arguments) are unchanged: strokes of a
    scene often cross the same place, and unpacking takes longer than everything else that a stroke needs.
    """
    add_work("patch_files", item=str(path))
    with np.load(path, allow_pickle=False) as data:
        if int(data["version"]) != PATCH_VERSION:
            return None
        measured = bool(data["measured"])
        return PatchRecord(
            height=_set_read_only(data["height"]) if measured else None,
            mask=_set_read_only(data["mask"]),
            token=_set_read_only(data["token"]) if measured else None,
            known=_set_read_only(data["known"]) if measured else None,
            appearance=_unpack_appearance(data["appearance"]),
            faces=_set_read_only(data["faces"]),
            notes=tuple(str(note) for note in data["notes"]),
            unlit=_unpack_unlit_image(data) if bool(data["pictured"]) else None,
            mesh_bands=tuple(bool(is_mesh) for is_mesh in data["mesh_bands"]),
            **{name: kind(data[name]) for name, kind in _SCALARS.items()},
        )


def _set_read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Make an array read-only, since several records may share it."""
    array.setflags(write=False)
    return array


def save_patch(folder: Path, key: str, record: PatchRecord) -> None:
    """Save the record of a patch under its cache key."""
    empty = np.zeros(0, dtype=np.float32)
    arrays = {
        "version": np.array(PATCH_VERSION),
        "measured": np.array(record.height is not None),
        "height": empty if record.height is None else record.height,
        "mask": record.mask,
        "token": empty if record.token is None else record.token,
        "known": empty.astype(bool) if record.known is None else record.known,
        "appearance": _pack_appearance(record.appearance),
        "faces": record.faces,
        "notes": np.array(record.notes, dtype=np.str_),
        "pictured": np.array(record.unlit is not None),
        "mesh_bands": np.array(record.mesh_bands, dtype=np.bool_),
        **{name: np.array(getattr(record, name)) for name in _SCALARS},
    }
    if record.unlit is not None:
        arrays |= {
            "rgb": record.unlit.rgb,
            "depth": record.unlit.depth_m,
            "look_resolved": np.array(record.unlit.resolved_wavelength_m),
            "look_source": np.array(record.unlit.source),
        }
    _save_arrays(folder / f"{key}.npz", arrays)


def has_patch(folder: Path, key: str) -> bool:
    """Return True if the record of a patch is stored under its cache key; it is not opened."""
    return (folder / f"{key}.npz").is_file()


def load_prediction(folder: Path, key: str) -> Prediction | None:
    """Load a patch's predicted tactile maps by their cache key; None if they are missing or damaged."""
    path = folder / f"{key}.npz"
    add_work("patch_files", item=str(path))
    try:
        with np.load(path, allow_pickle=False) as data:
            if int(data["prediction"]) != PREDICTION_VERSION:
                return None
            return Prediction(
                images=data["images"],
                pitch_m=data["pitch_m"],
                resolved_wavelength_m=float(data["resolved_wavelength_m"]),
                token=Token(data["token"], data["known"], data["error"]),
                sensor=str(data["sensor"]),
                encoder=str(data["encoder"]),
                weights=str(data["weights"]),
            )
    except NPZ_ERRORS:
        return None


def save_prediction(folder: Path, key: str, prediction: Prediction) -> None:
    """Save a patch's predicted tactile maps, whose token has its errors, under their cache key."""
    assert prediction.token.error is not None
    arrays = {
        "prediction": np.array(PREDICTION_VERSION),
        "images": prediction.images,
        "pitch_m": prediction.pitch_m,
        "resolved_wavelength_m": np.array(prediction.resolved_wavelength_m),
        "token": prediction.token.values,
        "known": prediction.token.known,
        "error": prediction.token.error,
        "sensor": np.array(prediction.sensor),
        "encoder": np.array(prediction.encoder),
        "weights": np.array(prediction.weights),
    }
    _save_arrays(folder / f"{key}.npz", arrays)


def _save_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    # In memory first: on a full disk a partly written archive raises a second error when it is closed.
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for name, array in arrays.items():
            # A height is mostly noise: a tenth smaller at best, for most of the time.
            stored = zipfile.ZIP_STORED if name == "height" else zipfile.ZIP_DEFLATED
            member = zipfile.ZipInfo(f"{name}.npy")
            member.compress_type = stored
            with archive.open(member, "w", force_zip64=True) as stream:
                np.lib.format.write_array(stream, array, allow_pickle=False)  # type: ignore[no-untyped-call]
    write_bytes(path, packed.getvalue())


def _unpack_unlit_image(data: Mapping[str, NDArray[Any]]) -> UnlitImage:
    return UnlitImage(
        _set_read_only(data["rgb"]),
        _set_read_only(data["depth"]),
        float(data["look_resolved"]),
        str(data["look_source"]),
    )


def _pack_appearance(appearance: Appearance) -> NDArray[np.float64]:
    colour = appearance.base_color or (np.nan,) * 3
    rest = (appearance.roughness, appearance.metallic, appearance.sheen, appearance.transmission)
    return np.array([*colour, *(np.nan if value is None else value for value in rest)])


def _unpack_appearance(row: NDArray[np.float64]) -> Appearance:
    values = [None if np.isnan(value) else float(value) for value in row]
    red, green, blue = values[:3]
    colour = None if red is None or green is None or blue is None else (red, green, blue)
    return Appearance(colour, *values[3:])
