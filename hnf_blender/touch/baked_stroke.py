"""A baked stroke: its contacts, patches and tokens on every object that it touches, and what a user is told of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.contacts import Contacts
from hnf_core.material.fuse import FusedToken
from hnf_core.scene.camera import Patch
from hnf_core.tactile.tactile_map import Route

from ..bridge.stroke.read_stroke import SceneStroke
from .bake_patches import TouchedObject
from .material_choice import SlotMaterial, format_doubt_note, format_guess_note
from .patch_cache import PatchRecord
from .report import format_lost_note

USUAL_HEIGHT_RANGE_M = (0.5e-6, 2e-3)
"""Usual peak-to-peak heights of a relief [m]; others are probably a mistake, or a bump made for its look."""
_BUMP_REMEDY = "the Distance, Strength or Scale of its bump"
_MESH_REMEDY = "the object's own ridges and modifiers, the Distance, Strength or Scale of a bump"
Place = tuple[int, int]
"""Index of an object that a stroke touches, and material slot."""


@dataclass(frozen=True)
class BakedStroke:
    """A stroke with everything the field (haptic network) needs; nothing is synthesized yet.

    Attributes
    ----------
    stroke : SceneStroke
    touched : TouchedObject
    contacts : Contacts
    patches : tuple of Patch
    patch_index : (n,) int32 array
        Patch of each action sample, −1 off the surface.
    records, fused : tuple
        PatchRecord and FusedToken of each patch.
    materials : tuple of SlotMaterial
        Material of each patch: of its slot, or of a reconstruction its own.
    skip_reasons : tuple of str
        Reasons why no relief was predicted from unlit images.
    authored_heights_m : Mapping[Place, float]
        Largest height of the relief of each place from top to bottom, as its shader gives it [m].
    alternative : BakedStroke or None
        The same with the other heights, those of the library if these are the relief's own, and the reverse, if another
        force may decide otherwise.
    others : tuple of TouchedObject
        Other objects that it touches, in the order of `stroke.crossed`; contacts and patches are in the frame of
        `touched`.
    owners : tuple of int
        Object of each patch: 0 for `touched`, k for `others[k − 1]`; () if `touched` is the only one.
    """

    stroke: SceneStroke
    touched: TouchedObject
    contacts: Contacts
    patches: tuple[Patch, ...]
    patch_index: NDArray[np.int32]
    records: tuple[PatchRecord, ...]
    fused: tuple[FusedToken, ...]
    materials: tuple[SlotMaterial, ...]
    skip_reasons: tuple[str, ...] = ()
    authored_heights_m: Mapping[Place, float] = field(default_factory=dict)
    alternative: BakedStroke | None = None
    others: tuple[TouchedObject, ...] = ()
    owners: tuple[int, ...] = ()

    @property
    def objects(self) -> tuple[TouchedObject, ...]:
        """All objects that it can touch, its own first."""
        return (self.touched, *self.others)

    @property
    def object_names(self) -> tuple[str, ...]:
        """Names of `objects`."""
        return (self.stroke.object_name, *(each.name for each in self.stroke.crossed))

    @property
    def sample_owners(self) -> NDArray[np.int32]:
        """Index (n,) of the object of each action sample, −1 off the surface."""
        owners = np.array([*(self.get_owner(patch) for patch in range(len(self.patches))), -1], dtype=np.int32)
        return np.asarray(owners[self.patch_index])

    def get_owner(self, patch: int) -> int:
        """Return the index in `objects` of a patch's object."""
        return self.owners[patch] if self.owners else 0

    def split_by_object(self) -> tuple[BakedStroke, ...]:
        """Return one baked stroke for each object that it touches, with that object's patches alone."""
        if not self.owners:
            return (self,)
        parts = []
        for number, (name, touched) in enumerate(zip(self.object_names, self.objects, strict=True)):
            mine = [patch for patch, owner in enumerate(self.owners) if owner == number]
            if not mine:
                continue
            place = np.full(len(self.patches) + 1, -1, dtype=np.int32)
            place[mine] = np.arange(len(mine))
            parts.append(replace(
                self,
                stroke=replace(self.stroke, object_name=name, crossed=()),
                touched=touched,
                patches=tuple(self.patches[patch] for patch in mine),
                patch_index=place[self.patch_index],
                records=tuple(self.records[patch] for patch in mine),
                fused=tuple(self.fused[patch] for patch in mine),
                materials=tuple(self.materials[patch] for patch in mine),
                others=(),
                owners=(),
                alternative=None,
            ))  # fmt: skip
        return tuple(parts)

    @property
    def main_patch(self) -> int:
        """Index of the patch that most action samples touch."""
        return int(np.bincount(self.patch_index[self.patch_index >= 0]).argmax())

    @property
    def main_material(self) -> SlotMaterial:
        """Library material of the patch that most action samples touch."""
        return self.materials[self.main_patch]

    @property
    def touched_materials(self) -> list[SlotMaterial]:
        """Every touched material, in the order in which the stroke meets them."""
        met = [self.materials[index] for index in dict.fromkeys(self.patch_index[self.patch_index >= 0].tolist())]
        return list({(material.shader, material.library.name): material for material in met}.values())

    @property
    def off_surface(self) -> float:
        """Fraction of the stroke's time that it presses beside its surface."""
        return float(np.mean(~self.contacts.on_surface & (self.contacts.force > 0.0)))

    @property
    def main_routes(self) -> tuple[Route, ...]:
        """Route of each wavelength band of that patch; learned for a material that has a field of its own."""
        return self.get_routes(self.main_patch)

    def get_routes(self, patch: int) -> tuple[Route, ...]:
        """Return the route of each wavelength band of a patch."""
        routes = tuple(self.fused[patch].routes)
        return routes if self.materials[patch].field is None else (Route.LEARNED,) * len(routes)

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks for the user, each once."""
        notes = list(self.stroke.notes) + [note for each in self.objects for note in each.surface.notes]
        for record in self.records:
            notes += record.notes
        notes += [*self._relief_notes(), *self._learned_notes(), *self._guess_notes(), *self.skip_reasons]
        off_fraction = float(np.mean(~self.contacts.on_surface))
        if lost := format_lost_note(self.stroke.name, self.stroke.object_name, self.off_surface):
            notes.append(lost)
        elif off_fraction > 0.0:
            notes.append(
                f"stroke '{self.stroke.name}': {off_fraction:.0%} of its time it is off the surface and silent."
            )
        without_uv = self.contacts.on_surface & ~self.contacts.uv_known
        touching = self.sample_owners if self.owners else np.zeros(len(without_uv), dtype=np.int32)
        for number, name in enumerate(self.object_names):
            if (without_uv & (touching == number)).any():
                notes.append(
                    f"object '{name}' has no usable UVs under stroke '{self.stroke.name}': directions are counted from "
                    "the object's own axes."
                )
        return tuple(dict.fromkeys(notes))

    @property
    def doubt_notes(self) -> tuple[str, ...]:
        """One note per material whose relief has the height of the library material."""
        return tuple(
            format_doubt_note(material, self.object_names[place[0]], self.authored_heights_m.get(place, height), height)
            for place, height in find_tallest(self._places, self.records).items()
            if (material := self._get_slot_material(place)).doubt
        )

    @property
    def _places(self) -> list[Place]:
        """(object, slot) of each patch."""
        return [(self.get_owner(index), patch.slot) for index, patch in enumerate(self.patches)]

    def _get_slot_material(self, place: Place) -> SlotMaterial:
        return self.materials[self._places.index(place)]

    def _guess_notes(self) -> list[str]:
        # Of patches that are taken for the same material, the least certain one speaks.
        named = [(self.object_names[self.get_owner(patch)], each) for patch, each in enumerate(self.materials)]
        by_name = {
            (name, each.shader, each.library.name): (each, name)
            for name, each in sorted(named, key=lambda pair: -pair[1].confidence)
        }
        notes = (format_guess_note(material, name) for material, name in by_name.values())
        return [note for note in notes if note]

    def _learned_notes(self) -> list[str]:
        return [
            f"material '{material.shader}' was learned ({material.field.metadata.get('licence', '')}): "
            "its shader's relief is not felt on top of it."
            for material in self.materials
            if material.field is not None
        ]

    def _relief_notes(self) -> list[str]:
        """Return one note per material whose relief is unusually high or low, about its tallest patch."""
        tallest: dict[str, float] = {}
        for place, height in find_tallest(self._places, self.records).items():
            shader, doubt = self._get_slot_material(place).shader, self._get_slot_material(place).doubt
            if not doubt:
                tallest[shader] = max(tallest.get(shader, 0.0), height)
        modelled = {
            material.shader
            for material, record in zip(self.materials, self.records, strict=True)
            if any(record.mesh_bands)
        }
        made_by = {shader: _BUMP_REMEDY if shader not in modelled else _MESH_REMEDY for shader in tallest}
        return [
            *self.doubt_notes,
            *(
                f"material '{shader}': its relief is {height * 1e3:.3g} mm from top to bottom; "
                f"{USUAL_HEIGHT_RANGE_M[0] * 1e3:g}–{USUAL_HEIGHT_RANGE_M[1] * 1e3:g} mm is usual. Check "
                f"{made_by[shader]}, and the scene's unit scale."
                for shader, height in tallest.items()
                if height > 0.0 and not USUAL_HEIGHT_RANGE_M[0] <= height <= USUAL_HEIGHT_RANGE_M[1]
            ),
        ]


def find_tallest(places: Sequence[Place], records: Sequence[PatchRecord]) -> dict[Place, float]:
    """Return place → largest height from top to bottom of its patches [m]; `places` are those of the records."""
    tallest: dict[Place, float] = {}
    for place, record in zip(places, records, strict=True):
        tallest[place] = max(tallest.get(place, 0.0), record.height_peak_to_peak_m)
    return tallest
