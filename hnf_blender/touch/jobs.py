"""Which strokes this run is about, and the key of each: a hash of everything its signal follows from."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from hnf_core import __version__
from hnf_core.action.primitives import DEFAULT_PRIMITIVE, Primitive
from hnf_core.cli.touch import TouchRequest
from hnf_core.errors import HnfError, SceneError
from hnf_core.field.weights import field_for
from hnf_core.files import content_hash
from hnf_core.material.hnf_file import MaterialFile
from hnf_core.material.library import LIBRARY_PATH, find

from ..bridge.boxes import is_visible, neighbours_hash_parts, visible
from ..bridge.hashes import material_hash
from ..bridge.meshes import Surface, flush_edits, mesh_hash, slot_materials, surface_frame, surface_mesh
from ..bridge.metres import metres_per_unit, size_warning
from ..bridge.own_material import own_word
from ..bridge.owner import owner_text, reads_of
from ..bridge.picture_names import picture_names
from ..bridge.placement import default_slots, place_primitive
from ..bridge.scene_names import name_in, named_objects, object_in
from ..bridge.shader_colour import Shows, reads_plainly, shows
from ..bridge.splat_cloud import cloud_hash, cloud_of, is_cloud, notes_of, source_of
from ..bridge.strokes import SceneStroke, path_hash, read_stroke, stroke_objects, touch_hash
from .bake import FIRST_PIXELS, PATCH_PIXELS, TouchedObject
from .inputs import Inputs
from .report import Counts, Failed, Skipped
from .seeing import SENSOR, Seeing
from .store import STORE_VERSION
from .targets import Target, resolve_target

NO_SCALE = (
    "is a reconstruction, which has no real-world size: one unit is assumed to be {metres:g} m. Say how long something "
    "in it really is: Set Real Length under Units in the Touch tab."
)


@dataclass(frozen=True)
class Job:
    """One stroke of this run. curve_name: the stroke object in the scene, "" while it is not placed yet.
    primitive, slot: what to place, and where. stroke: read already, for curves of the scene."""

    name: str
    object_name: str
    inputs: Inputs
    seed: int
    curve_name: str = ""
    primitive: Primitive | None = None
    slot: int | None = None
    stroke: SceneStroke | None = None

    @property
    def key(self) -> str:
        return self.inputs.key

    @property
    def path_key(self) -> str:
        return self.inputs.path_key


@dataclass(frozen=True)
class SurfaceFacts:
    """What the plan knows of an object without a triangle of it. materials: names by slot. shows: what each slot's
    shader, or its splats, can tell of its relief. plainly: whether that is read off images as they are. chosen,
    shape_hash, shader_hashes, owner_hash, pictures, splats: see TouchedObject."""

    materials: tuple[str, ...]
    chosen: tuple[str | MaterialFile, ...]
    shape_hash: str
    shader_hashes: tuple[str, ...]
    owner_hash: str
    shows: tuple[Shows, ...]
    plainly: tuple[bool, ...]
    pictures: tuple[tuple[str, ...], ...]
    splats: str = ""


@dataclass
class Gathered:
    """Everything the plan is made from."""

    jobs: list[Job] = field(default_factory=list)
    skipped: list[Skipped] = field(default_factory=list)
    failed: list[Failed] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


class Session:
    """One scene during one run: its surfaces and hashes, each made once, by the objects' names (name_in)."""

    def __init__(self, scene: Any, view_layer: Any, metres_per_unit: float, request: TouchRequest) -> None:
        self.scene, self.view_layer, self.metres_per_unit, self.request = scene, view_layer, metres_per_unit, request
        self._surfaces: dict[str, Surface] = {}
        self._touched: dict[str, TouchedObject] = {}
        self._facts: dict[str, SurfaceFacts] = {}
        self._choices = [
            (resolve_target(scene, choice.target), find(choice.material).name) for choice in request.choices
        ]
        library = content_hash(LIBRARY_PATH.read_bytes())
        self.seeing = Seeing(request.encoder)
        self.field = field_for((self.seeing.measured.name, self.seeing.predicted.name))
        made_by = f"{__version__} {PATCH_PIXELS} {FIRST_PIXELS} {SENSOR} {STORE_VERSION}"
        self._made_by = content_hash(self.field.identity, library, self.seeing.measured.content_id, made_by)

    @property
    def depsgraph(self) -> Any:
        """Evaluated now: placing strokes changes the scene during a run."""
        self.view_layer.update()
        return self.view_layer.depsgraph

    def surface(self, obj: Any) -> Surface:
        name = name_in(self.scene, obj)
        if name not in self._surfaces:
            made = surface_mesh(obj, self.depsgraph, self.metres_per_unit)
            self._surfaces[name] = replace(made, notes=(*made.notes, *self.splat_notes(obj)))
        return self._surfaces[name]

    def splat_notes(self, obj: Any) -> tuple[str, ...]:
        """What to say of a reconstructed object: what its reconstruction left to say, and that no one gave it a scale;
        nothing of any other object."""
        if cloud_of(obj) is None:
            return ()
        units = self.scene.unit_settings
        told = self.request.metres_per_unit is not None or self.scene.hnf.metres_per_unit > 0.0
        if told or (units.system != "NONE" and units.scale_length != 1.0):
            return notes_of(obj)
        return (*notes_of(obj), f"object '{obj.name}' {NO_SCALE.format(metres=self.metres_per_unit)}")

    def touched(self, obj: Any) -> TouchedObject:
        """Raises SceneError where obj is hidden or has no surface."""
        name = name_in(self.scene, obj)
        if name not in self._touched:
            facts = self.facts(obj)
            self._touched[name] = TouchedObject(
                obj=obj,
                surface=self.surface(obj),
                shape_hash=facts.shape_hash,
                shader_hashes=facts.shader_hashes,
                owner_hash=facts.owner_hash,
                metres_per_unit=self.metres_per_unit,
                chosen=facts.chosen,
                pictures=facts.pictures,
                splats=facts.splats,
                reliefs=tuple(shown is Shows.RELIEF for shown in facts.shows),
                view_layer=self.view_layer,
            )
        return self._touched[name]

    def facts(self, obj: Any) -> SurfaceFacts:
        """Raises SceneError where obj is hidden or has no surface."""
        name = name_in(self.scene, obj)
        if name not in self._facts:
            if not is_visible(obj, self.view_layer):
                raise SceneError(
                    "it is hidden.", where=f"object '{obj.name}'", remedy="Show it in the viewport and in renders."
                )
            flush_edits(obj)
            slots = slot_materials(obj, self.depsgraph)
            reads = reads_of(obj, slots)
            cloud = cloud_of(obj)
            owned = "" if cloud is None else cloud_hash(obj, cloud)
            shown = tuple(shows(material) for material in slots)
            self._facts[name] = SurfaceFacts(
                materials=tuple("" if material is None else material.name for material in slots),
                chosen=tuple("" if material is None else own_word(material) for material in slots),
                shape_hash=mesh_hash(obj, self.depsgraph, self.metres_per_unit, reads.layers),
                shader_hashes=tuple(material_hash(material, self.scene.frame_current) for material in slots),
                owner_hash=owner_text(obj, self.view_layer, slots, reads) + owned,
                shows=shown if cloud is None else tuple(_in_splats(each) for each in shown),
                plainly=tuple(reads_plainly(material) for material in slots),
                pictures=tuple(picture_names(material) for material in slots),
                splats="" if cloud is None else source_of(cloud),
            )
        return self._facts[name]

    def knows(self, obj: Any) -> bool:
        """Are its facts there already?"""
        return name_in(self.scene, obj) in self._facts

    @property
    def known(self) -> set[str]:
        """Names of the objects that were looked at."""
        return {*self._facts, *self._surfaces}

    def forget(self, names: set[str]) -> None:
        """These objects changed: look at them again."""
        for kept in (self._surfaces, self._touched, self._facts):
            for name in names & kept.keys():
                del kept[name]

    def choices(self, object_name: str) -> dict[int | None, str]:
        """Slot (None = whole object) → the artist's library material, the last word winning."""
        return {target.slot: material for target, material in self._choices if target.object_name == object_name}

    def outlook(self, obj: Any, material: str = "") -> list[tuple[Shows, bool]]:
        """Of each slot: what its shader can tell of its relief, and whether the artist said what it is. material: that
        a stroke itself asks for."""
        facts, choices = self.facts(obj), self.choices(name_in(self.scene, obj))
        said = [
            bool(material or choices.get(slot) or choices.get(None) or own) for slot, own in enumerate(facts.chosen)
        ]
        return list(zip(facts.shows, said, strict=True))

    def surface_key(self, obj: Any) -> str:
        """Hash of all that tokens on obj follow from, apart from what single strokes ask for."""
        return self._inputs(name_in(self.scene, obj), "", "", "").surface_key

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
        seed = self.seed(stroke.seed)
        inputs = self._inputs(stroke.object_name, stroke.material, path_hash(stroke), touch_hash(stroke, seed))
        return Job(stroke.name, stroke.object_name, inputs, seed, curve_name=stroke.name, stroke=stroke)

    def job_to_place(self, name: str, target: Target, primitive: Primitive) -> Job:
        obj, seed = object_in(self.scene, target.object_name), self.seed(0)
        around = neighbours_hash_parts(obj, self.scene, self.depsgraph, self.metres_per_unit)
        world = obj.evaluated_get(self.depsgraph).matrix_world
        rigid, _ = surface_frame(world, self.metres_per_unit, f"object '{obj.name}'")
        around.append(repr((np.round(rigid[2, :3], 3) + 0.0).tolist()))  # which side is up: an underside is avoided
        path = content_hash("placed", primitive.name, str(target.slot), *around)
        inputs = self._inputs(target.object_name, "", path, content_hash(str(seed)))
        return Job(name, target.object_name, inputs, seed, primitive=primitive, slot=target.slot)

    def _inputs(self, object_name: str, material: str, path: str, touch: str) -> Inputs:
        """material: that the stroke itself asks for."""
        obj = object_in(self.scene, object_name)
        facts = self.facts(obj)
        choices = repr(sorted(self.choices(object_name).items(), key=repr))
        reads = any(look is Shows.PICTURE and not chosen for look, chosen in self.outlook(obj, material))
        reads = reads or bool(facts.splats and not facts.shows)
        pictures = (name for slot in facts.pictures for name in slot)
        names = (object_name, obj.data.name, *facts.materials, *pictures)
        return Inputs(
            made_by=self._made_by,
            scale=repr(self.metres_per_unit),
            shape=facts.shape_hash,
            shading=content_hash(facts.owner_hash, *facts.shader_hashes, *names),
            sight=self.seeing.content_id if reads else "",
            choices=content_hash(choices, material, *(_hashable(word) for word in facts.chosen)),
            path=path,
            touch=touch,
        )


def scene_session(scene: Any, view_layer: Any, folder: Path) -> Session:
    """The scene as a bake sees it: its own scale, no word from a command line. folder: for what it writes."""
    request = TouchRequest(scene=None, out=folder)
    return Session(scene, view_layer, metres_per_unit(scene), request)


def _in_splats(shown: Shows) -> Shows:
    """What a slot of a reconstructed surface can tell: its splats are a picture of it, whatever its shader's colour."""
    return Shows.RELIEF if shown is Shows.RELIEF else Shows.PICTURE


def _hashable(word: str | MaterialFile) -> str | bytes:
    return word if isinstance(word, str) else word.to_bytes()


def gather(session: Session) -> Gathered:
    """The scene's own strokes and those asked for; with neither, one on every touchable material. One stroke that
    cannot be read does not lose the others."""
    request, scene = session.request, session.scene
    found = gather_curves(session, stroke_objects(scene))
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
                    name, Target(name_in(scene, obj), slot), DEFAULT_PRIMITIVE),
            )  # fmt: skip
        if not found.jobs and not found.failed:
            raise SceneError(
                "it shows no mesh with faces.", where=f"scene '{scene.name}'", remedy="Unhide or add one to touch."
            )
    look_around(session, found)
    return found


def gather_curves(session: Session, curves: Iterable[Any]) -> Gathered:
    """Jobs of these stroke objects."""
    found = Gathered()
    for curve in curves:
        _try(found, name_in(session.scene, curve), lambda curve=curve: session.job_of_curve(curve))
    return found


def look_around(session: Session, found: Gathered) -> None:
    """Say what the jobs leave out, and which of their surfaces have a size that no hand would meet."""
    found.skipped += list(_left_out(session, {job.object_name for job in found.jobs}))
    for name in dict.fromkeys(job.object_name for job in found.jobs):
        obj = object_in(session.scene, name)
        warning = size_warning(obj, session.metres_per_unit)
        found.notes += [*([warning] if warning else []), *session.splat_notes(obj)]


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
    named = named_objects(session.scene)
    others = {
        obj: name for name, obj in named.items() if obj.type == "MESH" and name not in touched and not is_cloud(obj)
    }
    free = [others[obj] for obj in visible(others, session.view_layer)]
    hidden = sorted(set(others.values()).difference(free))
    muted = [name for name, obj in named.items() if obj.hnf_stroke.is_stroke and obj.hnf_stroke.mute]
    for names, kind, why in (
        (free, "object", "no stroke touches it"),
        (hidden, "object", "hidden"),
        (muted, "stroke", "muted"),
    ):
        if len(names) > 8:
            yield Skipped(f"{len(names)} {kind}s ({', '.join(names[:3])}, …)", why)
        else:
            yield from (Skipped(f"{kind} '{name}'", why) for name in names)
