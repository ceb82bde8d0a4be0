"""OBJECT[:SLOT] → an object of the scene and one of its material slots.

What a stroke's signal follows from, as hashes apart from each other, so that what changed has a name.

Which strokes this run is about, and the key of each: a hash of everything its signal follows from.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from hnf_core import __version__
from hnf_core.action.primitives import DEFAULT_PRIMITIVE, Primitive
from hnf_core.errors import HnfError, SceneError
from hnf_core.field.weights import load_field_for_encoders
from hnf_core.files import content_hash
from hnf_core.material.hnf_file import MaterialFile
from hnf_core.material.library import LIBRARY_PATH, get_material
from hnf_core.text import close_matches, format_choices
from hnf_core.touch_request import TouchRequest

from ..bridge.scene.bounding_boxes import describe_neighbours, filter_visible, is_visible
from ..bridge.scene.material_definition import get_artist_choice
from ..bridge.scene.meshes import (
    Surface,
    compute_surface_frame,
    flush_edits,
    get_slot_materials,
    hash_mesh,
    read_surface,
)
from ..bridge.scene.scene_names import find_object, get_named_objects, get_scene_name
from ..bridge.scene.unit_scale import get_metres_per_unit, get_size_warning
from ..bridge.shader.closures import ReliefSource, find_relief_source, is_direct_image
from ..bridge.shader.images import list_texture_names
from ..bridge.shader.object_inputs import find_shader_inputs, format_object_inputs
from ..bridge.shader.shader_hash import hash_material
from ..bridge.splats.splat_cloud import get_cloud, get_cloud_source, get_reconstruction_notes, hash_cloud, is_cloud
from ..bridge.stroke.place_primitive import choose_default_slots, place_primitive
from ..bridge.stroke.read_stroke import SceneStroke, hash_path, hash_touch, list_strokes, read_stroke
from .bake_patches import FIRST_PASS_PIXELS, PATCH_PIXELS, SENSOR, ReliefPredictor, TouchedObject
from .patch_cache import PATCH_VERSION
from .report import Counts, Failed, Skipped

MAX_NAMES = 12
"""Names in a message: more would not be read."""


@dataclass(frozen=True)
class Target:
    """object_name: a mesh object of the scene, as name_in calls it. slot: index of the material slot, None = the
    whole object."""

    object_name: str
    slot: int | None


def resolve_target(scene: Any, text: str) -> Target:
    """Object names may hold colons: the longest name that exists wins. Case counts only where it tells two names apart.

    Raises SceneError naming what is there instead.
    """
    meshes = {name: obj for name, obj in get_named_objects(scene).items() if obj.type == "MESH"}
    whole = _match_name(text, meshes)
    if whole is not None:
        return Target(whole, None)
    before, colon, slot_text = text.rpartition(":")
    name = _match_name(before, meshes) if colon else None
    if name is not None:
        return Target(name, _find_slot(meshes[name], slot_text))
    other = scene.objects.get(text)
    if other is not None:
        raise SceneError(
            f"it is a {other.type.lower()} object and has no surface to touch.",
            where=f"object '{text}'",
            remedy="Name a mesh object, or convert this one to a mesh (Object > Convert > Mesh).",
        )
    asked = before if colon else text
    raise SceneError(
        "there is no such object in the scene.", where=f"object '{asked}'", remedy=_suggest_objects(asked, meshes)
    )


def _match_name(text: str, names: Iterable[str]) -> str | None:
    """The name that text stands for: itself, or the only one that differs from it in case alone; None where none is."""
    known = list(names)
    if text in known:
        return text
    same = [name for name in known if name.casefold() == text.casefold()]
    return same[0] if len(same) == 1 else None


def _find_slot(obj: Any, text: str) -> int:
    names = [slot.material.name if slot.material else "" for slot in obj.material_slots]
    name = _match_name(text, names) if text else None
    if name is not None:
        return names.index(name)
    if text.isdecimal() and int(text) < max(1, len(names)):
        return int(text)
    slots = [f"{index} {name or '(empty)'}" for index, name in enumerate(names[:MAX_NAMES])]
    more = f" and {len(names) - MAX_NAMES} more" if len(names) > MAX_NAMES else ""
    raise SceneError(
        f"it has no material slot '{text}'.",
        where=f"object '{obj.name}'",
        remedy=f"Its slots: {', '.join(slots) or 'none'}{more}.",
    )


def _suggest_objects(text: str, meshes: Mapping[str, Any]) -> str:
    """The objects that could be meant: those with faces, those that are called like it first."""
    touchable = sorted(name for name, obj in meshes.items() if len(obj.data.polygons) and not is_cloud(obj))
    near = close_matches(text, touchable)
    guess = f"Did you mean {' or '.join(repr(name) for name in near)}? " if near else ""
    return (
        f"{guess}Objects here: {format_choices(touchable, MAX_NAMES)}."
        if touchable
        else "The scene holds no mesh with faces."
    )


TOUCH_FIELD, PATH_FIELD = "touch", "path"
CHANGE_DESCRIPTIONS = {
    "made_by": "the add-on, its library or its field",
    "scale": "the scene's unit scale",
    "shape": "the shape of the surface",
    "shading": "the materials of the surface",
    "sight": "the networks that estimate relief from pictures",
    "choices": "a material choice",
    PATH_FIELD: "path, timing or surface name",
    TOUCH_FIELD: "force, seed or probe",
}
PATH_ON_SAME_SURFACE = "path or timing"
"""What is left of PATH where the surface is called as it was."""


@dataclass(frozen=True)
class InputHashes:
    """Hashes of: made_by: software, library, field. scale: metres per unit. shape: the surface's geometry.
    shading: its shaders, their pixels, and the names that a material is guessed from. sight: the networks that read its
    pictures, "" where none is to be read. choices: library materials that the artist named. path: where the hand is and
    when, on which object. touch: force, seed, probe."""

    made_by: str
    scale: str
    shape: str
    shading: str
    sight: str
    choices: str
    path: str
    touch: str

    @property
    def key(self) -> str:
        """Equal keys, equal signals."""
        return content_hash(*(asdict(self)[field.name] for field in fields(self)))

    @property
    def path_key(self) -> str:
        """Of everything but force, seed and probe: while it is equal, the signal follows without a render."""
        return content_hash(*self._iter_without(TOUCH_FIELD))

    @property
    def surface_key(self) -> str:
        """Of everything that the tokens on the mesh follow from, whatever strokes led there."""
        return content_hash(*self._iter_without(TOUCH_FIELD, PATH_FIELD))

    def describe_changes(self, previous: InputHashes, *, same_surface: bool = False) -> tuple[str, ...]:
        """What differs from earlier, in words. same_surface: it is known that the surface is called as it was."""
        words = CHANGE_DESCRIPTIONS | {PATH_FIELD: PATH_ON_SAME_SURFACE} if same_surface else CHANGE_DESCRIPTIONS
        return tuple(word for name, word in words.items() if getattr(self, name) != getattr(previous, name))

    def to_text(self) -> str:
        return json.dumps(asdict(self), sort_keys=True)

    @classmethod
    def from_text(cls, text: object) -> InputHashes | None:
        """What to_text wrote; None for anything else."""
        try:
            record = json.loads(str(text))
            return cls(**{field.name: str(record[field.name]) for field in fields(cls)})
        except (ValueError, KeyError, TypeError):
            return None

    def _iter_without(self, *names: str) -> Iterator[str]:
        return (getattr(self, field.name) for field in fields(self) if field.name not in names)


NO_SCALE_NOTE = (
    "is a reconstruction, which has no real-world size: one unit is assumed to be {metres:g} m. Say how long something "
    "in it really is: Set Real Length under Units in the Touch tab."
)


@dataclass(frozen=True)
class StrokeJob:
    """One stroke of this run. curve_name: the stroke object in the scene, "" while it is not placed yet.
    primitive, slot: what to place, and where. stroke: read already, for curves of the scene."""

    name: str
    object_name: str
    inputs: InputHashes
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
    artist_choices: tuple[str | MaterialFile, ...]
    shape_hash: str
    shader_hashes: tuple[str, ...]
    owner_hash: str
    relief_sources: tuple[ReliefSource, ...]
    direct_images: tuple[bool, ...]
    texture_names: tuple[tuple[str, ...], ...]
    splat_source: str = ""


@dataclass
class GatheredJobs:
    """Everything the plan is made from."""

    jobs: list[StrokeJob] = field(default_factory=list)
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
            (resolve_target(scene, choice.target), get_material(choice.material).name) for choice in request.choices
        ]
        library = content_hash(LIBRARY_PATH.read_bytes())
        self.predictor = ReliefPredictor(request.encoder)
        self.field = load_field_for_encoders(
            (self.predictor.measured_encoder.name, self.predictor.predicted_encoder.name)
        )
        made_by = f"{__version__} {PATCH_PIXELS} {FIRST_PASS_PIXELS} {SENSOR} {PATCH_VERSION}"
        self._made_by = content_hash(self.field.identity, library, self.predictor.measured_encoder.content_id, made_by)

    @property
    def depsgraph(self) -> Any:
        """Evaluated now: placing strokes changes the scene during a run."""
        self.view_layer.update()
        return self.view_layer.depsgraph

    def get_surface(self, obj: Any) -> Surface:
        name = get_scene_name(self.scene, obj)
        if name not in self._surfaces:
            made = read_surface(obj, self.depsgraph, self.metres_per_unit)
            self._surfaces[name] = replace(made, notes=(*made.notes, *self.get_splat_notes(obj)))
        return self._surfaces[name]

    def get_splat_notes(self, obj: Any) -> tuple[str, ...]:
        """What to say of a reconstructed object: what its reconstruction left to say, and that no one gave it a scale;
        nothing of any other object."""
        if get_cloud(obj) is None:
            return ()
        units = self.scene.unit_settings
        told = self.request.metres_per_unit is not None or self.scene.hnf.metres_per_unit > 0.0
        if told or (units.system != "NONE" and units.scale_length != 1.0):
            return get_reconstruction_notes(obj)
        return (
            *get_reconstruction_notes(obj),
            f"object '{obj.name}' {NO_SCALE_NOTE.format(metres=self.metres_per_unit)}",
        )

    def get_touched_object(self, obj: Any) -> TouchedObject:
        """Raises SceneError where obj is hidden or has no surface."""
        name = get_scene_name(self.scene, obj)
        if name not in self._touched:
            facts = self.get_facts(obj)
            self._touched[name] = TouchedObject(
                obj=obj,
                surface=self.get_surface(obj),
                shape_hash=facts.shape_hash,
                shader_hashes=facts.shader_hashes,
                owner_hash=facts.owner_hash,
                metres_per_unit=self.metres_per_unit,
                artist_choices=facts.artist_choices,
                texture_names=facts.texture_names,
                splat_source=facts.splat_source,
                has_relief=tuple(shown is ReliefSource.RELIEF for shown in facts.relief_sources),
                view_layer=self.view_layer,
            )
        return self._touched[name]

    def get_facts(self, obj: Any) -> SurfaceFacts:
        """Raises SceneError where obj is hidden or has no surface."""
        name = get_scene_name(self.scene, obj)
        if name not in self._facts:
            if not is_visible(obj, self.view_layer):
                raise SceneError(
                    "it is hidden.", where=f"object '{obj.name}'", remedy="Show it in the viewport and in renders."
                )
            flush_edits(obj)
            slots = get_slot_materials(obj, self.depsgraph)
            reads = find_shader_inputs(obj, slots)
            cloud = get_cloud(obj)
            owned = "" if cloud is None else hash_cloud(obj, cloud)
            shown = tuple(find_relief_source(material) for material in slots)
            self._facts[name] = SurfaceFacts(
                materials=tuple("" if material is None else material.name for material in slots),
                artist_choices=tuple("" if material is None else get_artist_choice(material) for material in slots),
                shape_hash=hash_mesh(obj, self.depsgraph, self.metres_per_unit, reads.layers),
                shader_hashes=tuple(hash_material(material, self.scene.frame_current) for material in slots),
                owner_hash=format_object_inputs(obj, self.view_layer, slots, reads) + owned,
                relief_sources=shown if cloud is None else tuple(_with_splats(each) for each in shown),
                direct_images=tuple(is_direct_image(material) for material in slots),
                texture_names=tuple(list_texture_names(material) for material in slots),
                splat_source="" if cloud is None else get_cloud_source(cloud),
            )
        return self._facts[name]

    def has_facts(self, obj: Any) -> bool:
        """Are its facts there already?"""
        return get_scene_name(self.scene, obj) in self._facts

    @property
    def known_names(self) -> set[str]:
        """Names of the objects that were looked at."""
        return {*self._facts, *self._surfaces}

    def invalidate(self, names: set[str]) -> None:
        """These objects changed: look at them again."""
        for kept in (self._surfaces, self._touched, self._facts):
            for name in names & kept.keys():
                del kept[name]

    def get_choices(self, object_name: str) -> dict[int | None, str]:
        """Slot (None = whole object) → the artist's library material, the last word winning."""
        return {target.slot: material for target, material in self._choices if target.object_name == object_name}

    def get_relief_outlook(self, obj: Any, material: str = "") -> list[tuple[ReliefSource, bool]]:
        """Of each slot: what its shader can tell of its relief, and whether the artist said what it is. material: that
        a stroke itself asks for."""
        facts, choices = self.get_facts(obj), self.get_choices(get_scene_name(self.scene, obj))
        said = [
            bool(material or choices.get(slot) or choices.get(None) or own)
            for slot, own in enumerate(facts.artist_choices)
        ]
        return list(zip(facts.relief_sources, said, strict=True))

    def compute_surface_key(self, obj: Any) -> str:
        """Hash of all that tokens on obj follow from, apart from what single strokes ask for."""
        return self._hash_inputs(get_scene_name(self.scene, obj), "", "", "").surface_key

    def choose_seed(self, stroke_seed: int) -> int:
        return stroke_seed if self.request.seed is None else self.request.seed

    def read_stroke(self, curve: Any) -> SceneStroke:
        return read_stroke(curve, self.scene, self.depsgraph, self.metres_per_unit, surfaces=self.get_surface)

    def place_stroke(self, obj: Any, job: StrokeJob, counts: Counts) -> Any:
        """The job's primitive as a stroke object of the scene, like one drawn by hand."""
        placed = place_primitive(
            self.scene, obj, job.slot, job.primitive or DEFAULT_PRIMITIVE, self.metres_per_unit, self.depsgraph,
            seed=job.seed, name=job.name, surfaces=self.get_surface,
        )  # fmt: skip
        counts.rays += placed.rays
        return placed.curve

    def make_curve_job(self, curve: Any) -> StrokeJob:
        stroke = self.read_stroke(curve)
        seed = self.choose_seed(stroke.seed)
        inputs = self._hash_inputs(stroke.object_name, stroke.material, hash_path(stroke), hash_touch(stroke, seed))
        return StrokeJob(stroke.name, stroke.object_name, inputs, seed, curve_name=stroke.name, stroke=stroke)

    def make_placement_job(self, name: str, target: Target, primitive: Primitive) -> StrokeJob:
        obj, seed = find_object(self.scene, target.object_name), self.choose_seed(0)
        around = describe_neighbours(obj, self.scene, self.depsgraph, self.metres_per_unit)
        world = obj.evaluated_get(self.depsgraph).matrix_world
        rigid, _ = compute_surface_frame(world, self.metres_per_unit, f"object '{obj.name}'")
        around.append(repr((np.round(rigid[2, :3], 3) + 0.0).tolist()))  # which side is up: an underside is avoided
        path = content_hash("placed", primitive.name, str(target.slot), *around)
        inputs = self._hash_inputs(target.object_name, "", path, content_hash(str(seed)))
        return StrokeJob(name, target.object_name, inputs, seed, primitive=primitive, slot=target.slot)

    def _hash_inputs(self, object_name: str, material: str, path: str, touch: str) -> InputHashes:
        """material: that the stroke itself asks for."""
        obj = find_object(self.scene, object_name)
        facts = self.get_facts(obj)
        choices = repr(sorted(self.get_choices(object_name).items(), key=repr))
        reads = any(
            look is ReliefSource.VARYING_COLOUR and not chosen
            for look, chosen in self.get_relief_outlook(obj, material)
        )
        reads = reads or bool(facts.splat_source and not facts.relief_sources)
        pictures = (name for slot in facts.texture_names for name in slot)
        names = (object_name, obj.data.name, *facts.materials, *pictures)
        return InputHashes(
            made_by=self._made_by,
            scale=repr(self.metres_per_unit),
            shape=facts.shape_hash,
            shading=content_hash(facts.owner_hash, *facts.shader_hashes, *names),
            sight=self.predictor.content_id if reads else "",
            choices=content_hash(choices, material, *(_to_hashable(word) for word in facts.artist_choices)),
            path=path,
            touch=touch,
        )


def make_scene_session(scene: Any, view_layer: Any, folder: Path) -> Session:
    """The scene as a bake sees it: its own scale, no word from a command line. folder: for what it writes."""
    request = TouchRequest(scene=None, out=folder)
    return Session(scene, view_layer, get_metres_per_unit(scene), request)


def _with_splats(shown: ReliefSource) -> ReliefSource:
    """What a slot of a reconstructed surface can tell: its splats are a picture of it, whatever its shader's colour."""
    return ReliefSource.RELIEF if shown is ReliefSource.RELIEF else ReliefSource.VARYING_COLOUR


def _to_hashable(choice: str | MaterialFile) -> str | bytes:
    return choice if isinstance(choice, str) else choice.to_bytes()


def gather_jobs(session: Session) -> GatheredJobs:
    """The scene's own strokes and those asked for; with neither, one on every touchable material. One stroke that
    cannot be read does not lose the others."""
    request, scene = session.request, session.scene
    found = gather_curve_jobs(session, list_strokes(scene))
    for placement in request.strokes:
        name = _make_unique_name(f"{placement.primitive.name} on {placement.target}", found)
        _add_job(
            found, name,
            lambda placement=placement, name=name: session.make_placement_job(
                name, resolve_target(scene, placement.target), placement.primitive),
        )  # fmt: skip
    if not found.jobs and not found.failed:
        found.notes.append(
            "no stroke in the scene and none asked for: one default stroke (left to right, 100 mm/s, 1 N) per material."
        )
        for obj, slot, material in choose_default_slots(scene, session.depsgraph):
            name = _make_unique_name(f"{DEFAULT_PRIMITIVE.name} on {material or obj.name}", found)
            _add_job(
                found, name,
                lambda obj=obj, slot=slot, name=name: session.make_placement_job(
                    name, Target(get_scene_name(scene, obj), slot), DEFAULT_PRIMITIVE),
            )  # fmt: skip
        if not found.jobs and not found.failed:
            raise SceneError(
                "it shows no mesh with faces.", where=f"scene '{scene.name}'", remedy="Unhide or add one to touch."
            )
    add_scene_notes(session, found)
    return found


def gather_curve_jobs(session: Session, curves: Iterable[Any]) -> GatheredJobs:
    """Jobs of these stroke objects."""
    found = GatheredJobs()
    for curve in curves:
        _add_job(found, get_scene_name(session.scene, curve), lambda curve=curve: session.make_curve_job(curve))
    return found


def add_scene_notes(session: Session, found: GatheredJobs) -> None:
    """Say what the jobs leave out, and which of their surfaces have a size that no hand would meet."""
    found.skipped += list(_iter_skipped(session, {job.object_name for job in found.jobs}))
    for name in dict.fromkeys(job.object_name for job in found.jobs):
        obj = find_object(session.scene, name)
        warning = get_size_warning(obj, session.metres_per_unit)
        found.notes += [*([warning] if warning else []), *session.get_splat_notes(obj)]


def _add_job(found: GatheredJobs, name: str, make: Any) -> None:
    try:
        found.jobs.append(make())
    except HnfError as error:
        found.failed.append(Failed(name, str(error)))


def _make_unique_name(name: str, found: GatheredJobs) -> str:
    taken = {job.name for job in found.jobs} | {failure.stroke for failure in found.failed}
    if name not in taken:
        return name
    return next(text for number in range(2, len(taken) + 3) if (text := f"{name} {number}") not in taken)


def _iter_skipped(session: Session, touched: set[str]) -> Iterator[Skipped]:
    """What the strokes do not need: counted, not listed, where it is much."""
    named = get_named_objects(session.scene)
    others = {
        obj: name for name, obj in named.items() if obj.type == "MESH" and name not in touched and not is_cloud(obj)
    }
    free = [others[obj] for obj in filter_visible(others, session.view_layer)]
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
