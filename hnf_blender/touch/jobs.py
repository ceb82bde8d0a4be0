"""Which strokes this run is about, and the key of each: a hash of everything its signal follows from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from hnf_core import __version__
from hnf_core.action.primitives import DEFAULT_PRIMITIVE, Primitive
from hnf_core.cli.touch import TouchRequest
from hnf_core.errors import HnfError, SceneError
from hnf_core.files import content_hash
from hnf_core.material.library import LIBRARY_PATH, find
from hnf_core.material.token import ENCODER_ID

from ..bridge.boxes import is_visible, neighbours_hash_parts
from ..bridge.hashes import material_hash
from ..bridge.importers import size_warning
from ..bridge.meshes import Surface, mesh_hash, surface_mesh
from ..bridge.placement import default_slots, place_primitive
from ..bridge.stage import looks_at_world
from ..bridge.strokes import SceneStroke, read_stroke, stroke_hash, stroke_objects
from .bake import PATCH_PIXELS, SENSOR, TouchedObject
from .report import Counts, Failed, Skipped
from .store import STORE_VERSION
from .targets import Target, resolve_target


@dataclass(frozen=True)
class Job:
    """One stroke of this run. curve_name: the stroke object in the scene, "" while it is not placed yet.
    primitive, slot: what to place, and where. stroke: read already, for curves of the scene."""

    name: str
    object_name: str
    key: str
    seed: int
    curve_name: str = ""
    primitive: Primitive | None = None
    slot: int | None = None
    stroke: SceneStroke | None = None


@dataclass
class Gathered:
    """Everything the plan is made from."""

    jobs: list[Job] = field(default_factory=list)
    skipped: list[Skipped] = field(default_factory=list)
    failed: list[Failed] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


class Session:
    """One scene during one run: its surfaces and hashes, each made once, by object name."""

    def __init__(
        self, scene: Any, view_layer: Any, metres_per_unit: float, request: TouchRequest, field_id: str
    ) -> None:
        self.scene, self.view_layer, self.metres_per_unit, self.request = scene, view_layer, metres_per_unit, request
        self._surfaces: dict[str, Surface] = {}
        self._touched: dict[str, TouchedObject] = {}
        self._choices = [
            (resolve_target(scene, choice.target), find(choice.material).name) for choice in request.choices
        ]
        library = content_hash(LIBRARY_PATH.read_bytes())
        made_by = f"{__version__} {PATCH_PIXELS} {SENSOR} {STORE_VERSION}"
        self._common = content_hash(field_id, library, ENCODER_ID, made_by)

    @property
    def depsgraph(self) -> Any:
        """Evaluated now: placing strokes changes the scene during a run."""
        self.view_layer.update()
        return self.view_layer.depsgraph

    def surface(self, obj: Any) -> Surface:
        if obj.name not in self._surfaces:
            self._surfaces[obj.name] = surface_mesh(obj, self.depsgraph, self.metres_per_unit)
        return self._surfaces[obj.name]

    def touched(self, obj: Any) -> TouchedObject:
        """Raises SceneError where obj is hidden or has no surface."""
        if obj.name not in self._touched:
            if not is_visible(obj, self.view_layer):
                raise SceneError(
                    "it is hidden.", where=f"object '{obj.name}'", remedy="Show it in the viewport and in renders."
                )
            surface = self.surface(obj)
            slots = [slot.material for slot in obj.material_slots]
            worldly = looks_at_world(obj, [material for material in slots if material is not None])
            place = repr([list(row) for row in obj.matrix_world]) if worldly else ""
            self._touched[obj.name] = TouchedObject(
                obj=obj,
                surface=surface,
                shape_hash=mesh_hash(obj, self.depsgraph, self.metres_per_unit),
                shader_hashes=tuple(material_hash(material) for material in slots),
                place_hash=place,
                metres_per_unit=self.metres_per_unit,
            )
        return self._touched[obj.name]

    def choices(self, object_name: str) -> dict[int | None, str]:
        """Slot (None = whole object) → the artist's library material, the last word winning."""
        return {target.slot: material for target, material in self._choices if target.object_name == object_name}

    def seed(self, own: int) -> int:
        return own if self.request.seed is None else self.request.seed

    def read(self, curve: Any) -> SceneStroke:
        return read_stroke(curve, self.scene, self.depsgraph, self.metres_per_unit, surfaces=self.surface)

    def place(self, obj: Any, job: Job, counts: Counts) -> Any:
        """The job's primitive as a stroke object of the scene, like one drawn by hand."""
        placed = place_primitive(
            self.scene, obj, job.slot, job.primitive or DEFAULT_PRIMITIVE, self.metres_per_unit, self.depsgraph,
            seed=job.seed, name=job.name, surfaces=self.surface,
        )  # fmt: skip
        counts.rays += placed.rays
        return placed.curve

    def job_of_curve(self, curve: Any) -> Job:
        stroke = self.read(curve)
        touched = self.touched(self.scene.objects[stroke.object_name])
        seed = self.seed(stroke.seed)
        key = self._key(touched, "curve", stroke_hash(stroke), str(seed))
        return Job(curve.name, stroke.object_name, key, seed, curve_name=curve.name, stroke=stroke)

    def job_to_place(self, name: str, target: Target, primitive: Primitive) -> Job:
        touched = self.touched(self.scene.objects[target.object_name])
        seed = self.seed(0)
        around = neighbours_hash_parts(touched.obj, self.scene, self.depsgraph, self.metres_per_unit)
        key = self._key(touched, "placed", f"{primitive.name} {target.slot} {seed}", *around)
        return Job(name, target.object_name, key, seed, primitive=primitive, slot=target.slot)

    def _key(self, touched: TouchedObject, *parts: str) -> str:
        surface = touched.surface
        choices = repr(sorted(self.choices(surface.object_name).items(), key=repr))
        return content_hash(
            self._common, f"{self.metres_per_unit!r}", touched.shape_hash, *touched.shader_hashes, touched.place_hash,
            surface.object_name, touched.obj.data.name, *surface.materials, choices, *parts,
        )  # fmt: skip


def gather(session: Session) -> Gathered:
    """The scene's own strokes and those asked for; with neither, one on every touchable material. One stroke that
    cannot be read does not lose the others."""
    found = Gathered()
    request, scene = session.request, session.scene
    for curve in stroke_objects(scene):
        _try(found, curve.name, lambda curve=curve: session.job_of_curve(curve))
    for placement in request.placements:
        name = _unique(f"{placement.primitive.name} on {placement.target}", found)
        _try(
            found, name,
            lambda placement=placement, name=name: session.job_to_place(
                name, resolve_target(scene, placement.target), placement.primitive),
        )  # fmt: skip
    if not found.jobs and not found.failed:
        found.notes.append(
            "no stroke in the scene and none asked for: one default stroke (left to right, 100 mm/s, 1 N) per material."
        )
        for obj, slot, material in default_slots(scene, session.depsgraph):
            name = _unique(f"{DEFAULT_PRIMITIVE.name} on {material or obj.name}", found)
            _try(
                found, name,
                lambda obj=obj, slot=slot, name=name: session.job_to_place(
                    name, Target(obj.name, slot), DEFAULT_PRIMITIVE),
            )  # fmt: skip
        if not found.jobs and not found.failed:
            raise SceneError(
                "it shows no mesh with faces.", where=f"scene '{scene.name}'", remedy="Unhide or add one to touch."
            )
    found.skipped += list(_left_out(session, {job.object_name for job in found.jobs}))
    for name in dict.fromkeys(job.object_name for job in found.jobs):
        warning = size_warning(scene.objects[name], session.metres_per_unit)
        found.notes += [warning] if warning else []
    return found


def _try(found: Gathered, name: str, make: Any) -> None:
    try:
        found.jobs.append(make())
    except HnfError as error:
        found.failed.append(Failed(name, str(error)))


def _unique(name: str, found: Gathered) -> str:
    taken = {job.name for job in found.jobs} | {failure.stroke for failure in found.failed}
    if name not in taken:
        return name
    return next(text for number in range(2, len(taken) + 3) if (text := f"{name} {number}") not in taken)


def _left_out(session: Session, touched: set[str]) -> Iterator[Skipped]:
    """What the strokes do not need: counted, not listed, where it is much."""
    others = [obj for obj in session.scene.objects if obj.type == "MESH" and obj.name not in touched]
    hidden = [obj.name for obj in others if not is_visible(obj, session.view_layer)]
    free = [obj.name for obj in others if obj.name not in set(hidden)]
    muted = [obj.name for obj in session.scene.objects if obj.hnf_stroke.is_stroke and obj.hnf_stroke.mute]
    for names, kind, why in (
        (free, "object", "no stroke touches it"),
        (hidden, "object", "hidden"),
        (muted, "stroke", "muted"),
    ):
        if len(names) > 8:
            yield Skipped(f"{len(names)} {kind}s ({', '.join(names[:3])}, …)", why)
        else:
            yield from (Skipped(f"{kind} '{name}'", why) for name in names)
