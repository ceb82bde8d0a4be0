"""A stroke's bake: everything needed to synthesize it without rendering, stored as bytes on its curve object.

The signal synthesized from it equals, byte for byte, the one that `hnf touch` writes for the stroke.
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
from hnf_core.material.contact_model import MECHANICS_NAMES, Mechanics
from hnf_core.material.probe import is_probe

from ..bridge.scene.stored_data import delete_property, get_property, set_property
from ..bridge.stroke.read_stroke import PathTrace, trace_path

if TYPE_CHECKING:
    from hnf_core.field.field import Field

    from .baked_stroke import BakedStroke
    from .synthesise import SynthesisedStroke

BAKE_PROPERTY = "hnf_bake"
"""ID property of the stroke's curve object."""
SCHEMA = 1
"""Version of the format in which bakes are stored."""

Float = NDArray[np.float64]


@dataclass(frozen=True)
class StrokeBake:
    """One baked stroke: everything its signal is synthesized from, without the scene.

    Attributes
    ----------
    stroke : StrokeInput
        Input of the synthesis.
    patch_index : (n,) int32 array
        Token that each action sample touches, −1 off the surface or without force.
    on_surface : (n,) bool array
        True on the surface, also without force.
    shares : (M,) array
        Fraction of each token and its mechanics that is known, 0 to 1.
    seed : int
        Seed of the carriers.
    key, path_key : str
        Hash of all inputs of the signal, and the same without force, seed and probe.
    facts : Mapping[str, str]
        Provenance: object, material, library_material, routes, height_source.
    confidence : float
    warnings : tuple of str
        Confidence and warnings of the synthesis.
    notes : tuple of str
        Remarks of the bake for the user.
    doubts : tuple of str
        Those of them on reliefs that have the height of the library material.
    alternative : StrokeBake or None
        The same with the other heights, if another force may decide otherwise: of the two the one with the relief's
        own heights counts unless it is too loud (`LOUDEST_M_S2`).
    is_softened : bool
        True if this one is that for a force under which the relief's own heights are too loud.
    path : PathTrace or None
        Where the stroke was on its surface, to tell rounding from a change; None in bakes of earlier versions.
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
    doubts: tuple[str, ...] = ()
    alternative: StrokeBake | None = None
    is_softened: bool = False
    path: PathTrace | None = None

    def with_force(self, force: Float, probe: str | None = None) -> StrokeBake:
        """Return the bake with another force (n,) [N] at the same action samples.

        Raises StrokeError if the force presses where the bake had no contact, and therefore no token.
        """
        action = self.stroke.action
        if force.shape != action.force.shape:
            raise StrokeError(f"force has {len(force)} samples, the bake has {len(action.force)}.", remedy=_REMEDY)
        new_contact = (force > 0.0) & self.on_surface & (self.patch_index < 0)
        if new_contact.any():
            time_s = float(np.flatnonzero(new_contact)[0] / action.rate)
            raise StrokeError(
                f"it now presses where the bake had no contact ({time_s:.2f} s after its start).", remedy=_REMEDY
            )
        index = np.where(force > 0.0, self.patch_index, np.int32(-1))
        pressed = replace(action, force=force, contact=index >= 0, probe=probe or action.probe)
        other = None if self.alternative is None else self.alternative.with_force(force, probe)
        return replace(self, stroke=replace(self.stroke, action=pressed), patch_index=index, alternative=other)

    def to_bytes(self) -> bytes:
        """Serialise the bake: exact, compressed, without pickle; equal bakes give equal bytes."""
        action, profile = self.stroke.action, self.stroke.profile
        texts = {
            "key": self.key, "path_key": self.path_key, "facts": dict(self.facts), "warnings": list(self.warnings),
            "notes": list(self.notes), "seed": self.seed, "confidence": self.confidence, "probe": action.probe,
            "doubts": list(self.doubts), "is_softened": self.is_softened,
        }  # fmt: skip
        mechanics = [[getattr(properties, name) for name in MECHANICS_NAMES] for properties in self.stroke.mechanics]
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
            "mechanics": np.array(mechanics, dtype=np.float64).reshape(-1, len(MECHANICS_NAMES)),
            "token_index": self.stroke.token_index,
            "patch_index": self.patch_index,
            "on_surface": self.on_surface,
            "shares": self.shares,
        }
        if profile is not None:
            scale = (profile.step_m, profile.origin_m, profile.resolved_wavelength_m)
            arrays |= {"profile_scale": np.array(scale), "profile": _split_byte_planes(profile.height)}
            if profile.seam is not None:
                arrays["seam"] = _split_byte_planes(profile.seam)
        arrays |= _pack_fields(self.stroke)
        if self.path is not None:  # Second differences of a smooth motion are small numbers, which compress well.
            start = np.zeros((2, self.path.steps.shape[1]), dtype=np.int32)
            arrays["path"] = np.diff(self.path.steps, n=2, axis=0, prepend=start)
            arrays["path_rounding"] = np.array(self.path.rounding_m)
        if self.alternative is not None:
            arrays["alternative"] = np.frombuffer(self.alternative.to_bytes(), np.uint8)
        packed = io.BytesIO()
        np.savez_compressed(packed, **arrays)
        return packed.getvalue()

    @classmethod
    def from_bytes(cls, data: bytes, *, where: str = "stored bake") -> StrokeBake:
        """Parse a serialized bake. Raises FileError if it is damaged, or of another version."""
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
    """Make the bake of a synthesized stroke; `key` and `path_key` are those of its job."""
    from .material_choice import TOO_LOUD_DOUBT
    from .synthesise import compute_known_shares, get_signal_facts, make_stroke_input

    bake = StrokeBake(
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
        doubts=baked.doubt_notes,
        path=trace_path(baked.stroke),
    )
    other = baked.alternative
    if other is None:
        return bake
    is_softened = any(material.doubt == TOO_LOUD_DOUBT for material in baked.materials)
    alternative = replace(
        bake, stroke=make_stroke_input(other), shares=compute_known_shares(other), facts=get_signal_facts(other),
        notes=other.notes, doubts=other.doubt_notes, is_softened=not is_softened,
        path=None,
    )  # fmt: skip
    return replace(bake, alternative=alternative, is_softened=is_softened)


def store_bake(obj: Any, bake: StrokeBake) -> None:
    """Store a bake on a stroke's curve object. Raises SceneError for a linked object."""
    if obj.library is not None:
        raise SceneError(
            f"it is linked from {obj.library.filepath} and cannot be written.",
            where=f"stroke '{obj.name}'",
            remedy="Make it local (Object > Relations > Make Local) to keep its bake.",
        )
    set_property(obj, BAKE_PROPERTY, bake.to_bytes())


def load_bake(obj: Any) -> StrokeBake | None:
    """Load a stroke's bake, None if there is none. Raises FileError if it is damaged."""
    data = get_property(obj, BAKE_PROPERTY)
    if data is None:
        return None
    where = f"stroke '{obj.name}'"
    if not isinstance(data, bytes):
        raise FileError("its stored bake is not a bake.", where=where, remedy=_REMEDY)
    return StrokeBake.from_bytes(data, where=where)


def remove_bake(obj: Any) -> None:
    """Remove a stroke's bake, if it has one."""
    delete_property(obj, BAKE_PROPERTY)


_REMEDY = "Bake the stroke again."


_DAMAGE_ERRORS: tuple[type[Exception], ...] = (HnfError, *NPZ_ERRORS)


def _split_byte_planes(values: Float) -> NDArray[np.uint8]:
    """Split float64 values (…) into byte planes (8, …), or (4, …) if float32 represents them exactly.

    Plane k has the k-th byte of every value. Neighboring sign and exponent bytes compress well; those of digits do not.
    """
    short = values.astype("<f4")
    flat = np.ascontiguousarray(short if np.array_equal(short, values) else values.astype("<f8"))
    size = flat.dtype.itemsize
    return np.ascontiguousarray(np.moveaxis(flat.view(np.uint8).reshape(*flat.shape, size), -1, 0))


def _join_byte_planes(planes: NDArray[np.uint8]) -> Float:
    """Join the byte planes (8, …) or (4, …) of `_split_byte_planes` to float64 values (…)."""
    if planes.dtype != np.uint8 or planes.ndim < 2 or planes.shape[0] not in (4, 8):
        raise ValueError(f"an array of shape {planes.shape} is not one of byte planes")
    interleaved = np.ascontiguousarray(np.moveaxis(planes, 0, -1))
    return np.asarray(interleaved.view(f"<f{planes.shape[0]}")[..., 0], dtype=np.float64)


def _unpack(arrays: Mapping[str, NDArray[Any]]) -> StrokeBake:
    texts = json.loads(arrays["texts"].tobytes())
    if not is_probe(texts["probe"]):
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
    if action.direction.shape != (count, 2) or any(track.shape != (count,) for track in tracks):
        raise ValueError("its arrays differ in length")
    profile = None
    if "profile" in arrays:
        step, origin, resolved = (float(value) for value in arrays["profile_scale"])
        seam = _join_byte_planes(arrays["seam"]) if "seam" in arrays else None
        profile = HeightProfile(step, origin, _join_byte_planes(arrays["profile"]), resolved, seam)
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
        # Bakes of version 0.1 have none of these.
        doubts=tuple(str(text) for text in texts.get("doubts", ())),
        is_softened=bool(texts.get("is_softened", False)),
        alternative=StrokeBake.from_bytes(arrays["alternative"].tobytes()) if "alternative" in arrays else None,
        path=_unpack_path(arrays),
    )


def _unpack_path(arrays: Mapping[str, NDArray[Any]]) -> PathTrace | None:
    if "path" not in arrays:
        return None
    steps = np.cumsum(np.cumsum(arrays["path"].astype(np.int32), axis=0, dtype=np.int32), axis=0, dtype=np.int32)
    if steps.ndim != 2:
        raise ValueError(f"its path has the shape {steps.shape}")
    return PathTrace(steps, float(arrays["path_rounding"]))


def _pack_fields(stroke: StrokeInput) -> dict[str, NDArray[Any]]:
    """Pack the haptic fields (networks) that come with learned materials, each once.

    For each token there is the index of its field, −1 for none. Empty if no material has one.
    """
    fields = {field.identity: field for field in stroke.fields if field is not None}
    if not fields:
        return {}
    names = list(fields)
    index = [-1 if field is None else names.index(field.identity) for field in stroke.fields]
    weights = {
        f"field_{number}": np.frombuffer(serialise_field(fields[name]), np.uint8) for number, name in enumerate(names)
    }
    return {"field_index": np.array(index, dtype=np.int32), **weights}


def _unpack_fields(arrays: Mapping[str, NDArray[Any]]) -> tuple[Field | None, ...]:
    if "field_index" not in arrays:
        return ()
    index = [int(number) for number in arrays["field_index"]]
    fields = {number: parse_field(arrays[f"field_{number}"].tobytes(), "stored bake") for number in set(index) - {-1}}
    return tuple(fields.get(number) for number in index)
