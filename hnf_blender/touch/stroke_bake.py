"""What a stroke needs to be heard without rendering anything: kept as bytes on its curve object.

The signal synthesised from it is, byte for byte, the one that `hnf touch` writes for the same stroke.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.action import Action
from hnf_core.errors import FileError, HnfError, SceneError, StrokeError
from hnf_core.field.stroke import HeightProfile, StrokeInput
from hnf_core.field.weights import parse_field, serialise_field
from hnf_core.files import NPZ_ERRORS, read_npz
from hnf_core.material.contact_model import Mechanics
from hnf_core.material.probe import PROBES

from ..bridge.scene.id_properties import delete_property, get_property, set_property

if TYPE_CHECKING:
    from hnf_core.field.field import Field

    from .synthesise import BakedStroke, SynthesisedStroke

BAKE_PROPERTY = "hnf_bake"
"""ID property of the stroke's curve object."""
SCHEMA = 1
_MECHANICS = ("stiffness_n_m", "damping_ratio", "friction")

Float = NDArray[np.float64]


@dataclass(frozen=True)
class StrokeBake:
    """One stroke as it was baked.

    stroke: what synthesis is given. patch_index: (n,) int32, which of the stroke's tokens each action sample touches,
    −1 off the surface or without force. on_surface: (n,) bool, also where the hand does not press. shares: (M,) how
    far each token and its mechanics are known, 0–1. seed: of the carriers. key: hash of everything the signal follows
    from; path_key: the same without force, seed and probe. facts: what a WAV says of its origin (object, material,
    library_material, routes, height_source). confidence, warnings: of the synthesis as baked. notes: what the bake met
    that a person should know.
    """

    stroke: StrokeInput
    patch_index: NDArray[np.int32]
    on_surface: NDArray[np.bool_]
    shares: Float
    seed: int
    key: str
    path_key: str
    facts: Mapping[str, str]
    confidence: float
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def with_force(self, force: Float, probe: str | None = None) -> StrokeBake:
        """The same path pressed otherwise; force (n,) N at the same action samples.

        Raises StrokeError where force presses on a part that the bake did not touch: nothing is known of it.
        """
        action = self.stroke.action
        if force.shape != action.force.shape:
            raise StrokeError(f"force has {len(force)} samples, the bake has {len(action.force)}.", remedy=_REMEDY)
        fresh = (force > 0.0) & self.on_surface & (self.patch_index < 0)
        if fresh.any():
            at = float(np.flatnonzero(fresh)[0] / action.rate)
            raise StrokeError(
                f"it now presses where the bake had no contact ({at:.2f} s after its start).", remedy=_REMEDY
            )
        index = np.where(force > 0.0, self.patch_index, np.int32(-1))
        pressed = replace(action, force=force, contact=index >= 0, probe=probe or action.probe)
        return replace(self, stroke=replace(self.stroke, action=pressed), patch_index=index)

    def to_bytes(self) -> bytes:
        """Exact, compressed, without pickle; equal bakes give equal bytes."""
        action, profile = self.stroke.action, self.stroke.profile
        texts = {
            "key": self.key, "path_key": self.path_key, "facts": dict(self.facts), "warnings": list(self.warnings),
            "notes": list(self.notes), "seed": self.seed, "confidence": self.confidence, "probe": action.probe,
        }  # fmt: skip
        mechanics = [[getattr(each, name) for name in _MECHANICS] for each in self.stroke.mechanics]
        arrays = {
            "schema": np.array(SCHEMA),
            "texts": np.frombuffer(json.dumps(texts, sort_keys=True).encode(), np.uint8),
            "rate": np.array(action.rate),
            "direction": _split_byte_planes(action.direction),
            "speed": _split_byte_planes(action.speed),
            "force": _split_byte_planes(action.force),
            "position": _split_byte_planes(action.position),
            "contact": action.contact,
            "tokens": self.stroke.tokens,
            "mechanics": np.array(mechanics, dtype=np.float64).reshape(-1, len(_MECHANICS)),
            "token_index": self.stroke.token_index,
            "patch_index": self.patch_index,
            "on_surface": self.on_surface,
            "shares": self.shares,
        }
        if profile is not None:
            scale = (profile.step_m, profile.origin_m, profile.resolved_wavelength_m)
            arrays |= {"profile_scale": np.array(scale), "profile": _split_byte_planes(profile.height)}
        arrays |= _pack_fields(self.stroke)
        packed = io.BytesIO()
        np.savez_compressed(packed, **arrays)
        return packed.getvalue()

    @classmethod
    def from_bytes(cls, data: bytes, *, where: str = "stored bake") -> StrokeBake:
        """Raises FileError where data are damaged, or of another version."""
        try:
            arrays = read_npz(data)
            schema = int(arrays["schema"])
            if schema == SCHEMA:
                return _unpack(arrays)
        except _DAMAGE_ERRORS as error:
            raise FileError(f"its stored bake is damaged ({error}).", where=where, remedy=_REMEDY) from error
        raise FileError(
            f"its stored bake has format {schema}, this add-on reads {SCHEMA}.", where=where, remedy=_REMEDY
        )


def make_stroke_bake(baked: BakedStroke, synthesised: SynthesisedStroke, *, key: str, path_key: str) -> StrokeBake:
    """What to keep of a stroke that was baked and felt. key, path_key: of its job."""
    from .synthesise import compute_known_shares, get_signal_facts

    return StrokeBake(
        stroke=synthesised.stroke,
        patch_index=baked.patch_index,
        on_surface=baked.contacts.on_surface,
        shares=compute_known_shares(baked),
        seed=synthesised.signal.seed,
        key=key,
        path_key=path_key,
        facts=get_signal_facts(baked),
        confidence=synthesised.confidence,
        warnings=synthesised.warnings,
        notes=baked.notes,
    )


def store_bake(obj: Any, bake: StrokeBake) -> None:
    """Keep bake on a stroke's curve object. Raises SceneError for a linked object."""
    if obj.library is not None:
        raise SceneError(
            f"it is linked from {obj.library.filepath} and cannot be written.",
            where=f"stroke '{obj.name}'",
            remedy="Make it local (Object > Relations > Make Local) to keep its bake.",
        )
    set_property(obj, BAKE_PROPERTY, bake.to_bytes())


def load_bake(obj: Any) -> StrokeBake | None:
    """What store_bake kept, or None. Raises FileError where it is damaged."""
    data = get_property(obj, BAKE_PROPERTY)
    if data is None:
        return None
    where = f"stroke '{obj.name}'"
    if not isinstance(data, bytes):
        raise FileError("its stored bake is not a bake.", where=where, remedy=_REMEDY)
    return StrokeBake.from_bytes(data, where=where)


def remove_bake(obj: Any) -> None:
    """Forget the bake of a stroke, if it has one."""
    delete_property(obj, BAKE_PROPERTY)


_REMEDY = "Bake the stroke again."


_DAMAGE_ERRORS: tuple[type[Exception], ...] = (HnfError, *NPZ_ERRORS)


def _split_byte_planes(values: Float) -> NDArray[np.uint8]:
    """(…) float64 → (8, …) uint8, byte by byte: signs and exponents beside each other compress, digits do not.
    (4, …) where float32 holds the same values."""
    short = values.astype("<f4")
    flat = np.ascontiguousarray(short if np.array_equal(short, values) else values.astype("<f8"))
    size = flat.dtype.itemsize
    return np.ascontiguousarray(np.moveaxis(flat.view(np.uint8).reshape(*flat.shape, size), -1, 0))


def _join_byte_planes(planes: NDArray[np.uint8]) -> Float:
    """The values that _planes took apart."""
    if planes.dtype != np.uint8 or planes.ndim < 2 or planes.shape[0] not in (4, 8):
        raise ValueError(f"an array of shape {planes.shape} is not one of byte planes")
    whole = np.ascontiguousarray(np.moveaxis(planes, 0, -1))
    return np.asarray(whole.view(f"<f{planes.shape[0]}")[..., 0], dtype=np.float64)


def _unpack(arrays: Mapping[str, NDArray[Any]]) -> StrokeBake:
    texts = json.loads(arrays["texts"].tobytes())
    if texts["probe"] not in PROBES:
        raise ValueError(f"unknown probe '{texts['probe']}'")
    action = Action(
        rate=float(arrays["rate"]),
        direction=_join_byte_planes(arrays["direction"]),
        speed=_join_byte_planes(arrays["speed"]),
        force=_join_byte_planes(arrays["force"]),
        position=_join_byte_planes(arrays["position"]),
        contact=arrays["contact"].astype(bool),
        probe=str(texts["probe"]),
    )
    count = len(action.speed)
    tracks = (action.force, action.position, action.contact, arrays["patch_index"], arrays["on_surface"])
    if action.direction.shape != (count, 2) or any(each.shape != (count,) for each in tracks):
        raise ValueError("its arrays differ in length")
    profile = None
    if "profile" in arrays:
        step, origin, resolved = (float(value) for value in arrays["profile_scale"])
        profile = HeightProfile(step, origin, _join_byte_planes(arrays["profile"]), resolved)
    mechanics = tuple(
        Mechanics(*(None if np.isnan(value) else float(value) for value in row)) for row in arrays["mechanics"]
    )
    tokens, index = arrays["tokens"].astype(np.float32), arrays["patch_index"].astype(np.int32)
    if count == 0 or index.max() >= len(tokens) or arrays["shares"].shape != (len(tokens),):
        raise ValueError("its patches and tokens do not fit together")
    return StrokeBake(
        stroke=StrokeInput(
            action, tokens, mechanics, arrays["token_index"].astype(np.int32), profile, _unpack_fields(arrays)
        ),
        patch_index=index,
        on_surface=arrays["on_surface"].astype(bool),
        shares=arrays["shares"].astype(np.float64),
        seed=int(texts["seed"]),
        key=str(texts["key"]),
        path_key=str(texts["path_key"]),
        facts={str(name): str(value) for name, value in texts["facts"].items()},
        confidence=float(texts["confidence"]),
        warnings=tuple(str(text) for text in texts["warnings"]),
        notes=tuple(str(text) for text in texts["notes"]),
    )


def _pack_fields(stroke: StrokeInput) -> dict[str, NDArray[Any]]:
    """Each field that materials of the stroke bring, once, and which each token has, −1 = none; nothing where none
    brings one."""
    own = {each.identity: each for each in stroke.fields if each is not None}
    if not own:
        return {}
    names = list(own)
    index = [-1 if each is None else names.index(each.identity) for each in stroke.fields]
    weights = {f"field_{at}": np.frombuffer(serialise_field(own[name]), np.uint8) for at, name in enumerate(names)}
    return {"field_index": np.array(index, dtype=np.int32), **weights}


def _unpack_fields(arrays: Mapping[str, NDArray[Any]]) -> tuple[Field | None, ...]:
    if "field_index" not in arrays:
        return ()
    index = [int(at) for at in arrays["field_index"]]
    own = {at: parse_field(arrays[f"field_{at}"].tobytes(), "stored bake") for at in set(index) - {-1}}
    return tuple(own.get(at) for at in index)
