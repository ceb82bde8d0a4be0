"""Session of one run: the strokes to compute, and hashes of everything that their signals depend on.

A `Session` caches the surfaces of a scene; `gather_jobs` lists the strokes as `StrokeJob`. The hash of a job's inputs
(`InputHashes`) is kept in parts, so that a change can be named. `resolve_target` finds an object and material slot
given as OBJECT[:SLOT] on the command line.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from hnf_core import __version__
from hnf_core.action.primitives import DEFAULT_PRIMITIVE, Primitive
from hnf_core.errors import HnfError, SceneError, close_matches, format_choices
from hnf_core.field.weights import load_field_for_encoders, read_material_file
from hnf_core.files import content_hash, hash_file
from hnf_core.material.fuse import HEIGHT_LIMITS_M
from hnf_core.material.hnf_file import HNF_SUFFIX, MaterialFile
from hnf_core.material.library import LIBRARY_PATH, get_material, load_library
from hnf_core.material.name_matching import match_names
from hnf_core.touch_request import TouchRequest

from ..bridge.importers import IMPORT_NOTES
from ..bridge.scene.material_definition import get_artist_choice, is_height_authored
from ..bridge.scene.meshes import (
    Surface,
    compute_surface_frame,
    flush_edits,
    get_slot_materials,
    hash_mesh,
    read_surface,
)
from ..bridge.scene.object_size import (
    describe_neighbours,
    filter_visible,
    get_metres_per_unit,
    get_size_warning,
    is_visible,
)
from ..bridge.scene.scene_names import find_object, get_named_objects, get_scene_name
from ..bridge.scene.touchable import describe_instances, explain_untouchable, is_surface
from ..bridge.shader.closures import ReliefSource, find_relief_source, get_stated_height, is_direct_image
from ..bridge.shader.images import list_texture_names
from ..bridge.shader.object_inputs import find_shader_inputs, format_object_inputs
from ..bridge.shader.shader_hash import hash_material
from ..bridge.splat_cloud import get_cloud, get_cloud_source, get_reconstruction_notes, hash_cloud, is_cloud
from ..bridge.stroke.place_primitive import choose_default_slots, place_primitive, shorten_name
from ..bridge.stroke.read_stroke import SceneStroke, hash_path, hash_touch, list_strokes, read_stroke
from .bake_patches import FIRST_PASS_PIXELS, PATCH_PIXELS, ReliefPredictor, TouchedObject
from .patch_cache import PATCH_VERSION
from .report import Counts, Failed, Skipped

MAX_NAMES = 12
"""Maximum number of names in a message."""


@dataclass(frozen=True)
class Target:
    """A mesh object of the scene by its name (`get_scene_name`), and a material slot, None for any."""

    object_name: str
    slot: int | None


def resolve_target(scene: Any, text: str) -> Target:
    """Find the object and material slot of the text OBJECT[:SLOT].

    Names may contain colons: the longest existing name wins. Case counts only if it distinguishes two names. Raises
    SceneError that lists the existing names.
    """
    meshes = {name: obj for name, obj in get_named_objects(scene).items() if is_surface(obj)}
    exact_name = _match_name(text, meshes)
    if exact_name is not None:
        return Target(exact_name, None)
    before, colon, slot_text = text.rpartition(":")
    name = _match_name(before, meshes) if colon else None
    if name is not None:
        return Target(name, _find_slot(meshes[name], slot_text))
    obj = scene.objects.get(text)
    if obj is not None:
        parts = sorted(name for name, child in meshes.items() if child.parent == obj)
        raise SceneError(
            f"it is of type {obj.type.lower()} and has no surface to touch.",
            where=f"object '{text}'",
            remedy=f"Name one of its parts: {format_choices(parts, MAX_NAMES)}."
            if parts
            else "Name a mesh object, or convert this one to a mesh (Object > Convert > Mesh).",
        )
    object_name = before if colon else text
    remedy = _suggest_objects(object_name, meshes)
    raise SceneError("there is no such object in the scene.", where=f"object '{object_name}'", remedy=remedy)


def _match_name(text: str, names: Iterable[str]) -> str | None:
    """Return the name equal to `text`, or the only one that differs in case alone; None if there is none."""
    names = list(names)
    if text in names:
        return text
    matches = [name for name in names if name.casefold() == text.casefold()]
    return matches[0] if len(matches) == 1 else None


def _find_slot(obj: Any, text: str) -> int:
    """Return the index of a slot given by its material's name or its number. Raises SceneError."""
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
    """List the objects with faces, after those with similar names."""
    touchable = sorted(
        name for name, obj in meshes.items() if (obj.type != "MESH" or len(obj.data.polygons)) and not is_cloud(obj)
    )
    similar = close_matches(text, touchable)
    guess = f"Did you mean {' or '.join(repr(name) for name in similar)}? " if similar else ""
    return (
        f"{guess}Objects here: {format_choices(touchable, MAX_NAMES)}."
        if touchable
        else "The scene holds no mesh with faces."
    )


TOUCH_FIELD, PATH_FIELD, NAMES_FIELD = "touch", "path", "names"
CHANGE_DESCRIPTIONS = {
    "made_by": "the add-on, its library or its field",
    "scale": "the scene's unit scale",
    "shape": "the shape of the surface",
    "shading": "the materials of the surface",
    "sight": "the networks that estimate relief from pictures",
    "choices": "a material choice",
    PATH_FIELD: "path or timing",
    TOUCH_FIELD: "force, seed or probe",
}
"""Description of each input, for messages; names are left out, since a bake that was made with others still holds."""


@dataclass(frozen=True)
class InputHashes:
    """Hashes of the inputs of a stroke's signal, by kind, so that a change can be named.

    Attributes
    ----------
    made_by : str
        Software, library and field.
    scale : str
        Meters per unit.
    shape : str
        Geometry of the surface.
    shading : str
        Its shaders with their pixels.
    sight : str
        Networks that predict relief, "" if no prediction is needed.
    choices : str
        Library materials chosen by the user.
    path : str
        Path, timing and object.
    touch : str
        Force, seed and probe.
    names : str
        What the names of object, materials and textures say of the material, if it is guessed. Other names change
        nothing that is felt before a bake guesses anew.
    """

    made_by: str
    scale: str
    shape: str
    shading: str
    sight: str
    choices: str
    path: str
    touch: str
    names: str = ""

    @property
    def key(self) -> str:
        """Hash of all inputs; equal keys give equal signals."""
        return content_hash(*(asdict(self)[field.name] for field in fields(self)))

    @property
    def path_key(self) -> str:
        """Hash of all but force, seed, probe and names; while it is equal, a bake still holds."""
        return content_hash(*self._iter_without(TOUCH_FIELD, NAMES_FIELD))

    @property
    def surface_key(self) -> str:
        """Hash of everything that the tokens on the mesh depend on, apart from strokes and names."""
        return content_hash(*self._iter_without(TOUCH_FIELD, PATH_FIELD, NAMES_FIELD))

    def describe_changes(self, previous: InputHashes) -> tuple[str, ...]:
        """Describe in words the inputs that differ from those of an earlier bake."""
        return tuple(
            description
            for name, description in CHANGE_DESCRIPTIONS.items()
            if getattr(self, name) != getattr(previous, name)
        )

    def to_text(self) -> str:
        """Return the hashes as JSON."""
        return json.dumps(asdict(self), sort_keys=True)

    @classmethod
    def from_text(cls, text: object) -> InputHashes | None:
        """Parse JSON from `to_text`; None for anything else."""
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
    """One stroke to compute in a run: a curve of the scene, or a primitive that is still to be placed.

    Attributes
    ----------
    name, object_name : str
        Names of the stroke and of its surface.
    inputs : InputHashes
    seed : int
    curve_name : str
        Name of the stroke object, "" if it is not placed yet.
    primitive : Primitive or None
    slot : int or None
        Primitive to place, and the material slot to place it on.
    stroke : SceneStroke or None
        The stroke, if it was read from the scene.
    """

    name: str
    object_name: str
    inputs: InputHashes
    seed: int
    curve_name: str = ""
    primitive: Primitive | None = None
    slot: int | None = None
    stroke: SceneStroke | None = None

    @property
    def object_names(self) -> tuple[str, ...]:
        """Names of all objects that it touches, its own surface first."""
        crossed = () if self.stroke is None else self.stroke.crossed
        return (self.object_name, *(each.name for each in crossed))

    @property
    def key(self) -> str:
        """Hash of all inputs of the stroke's signal."""
        return self.inputs.key

    @property
    def path_key(self) -> str:
        """Hash of all but force, seed and probe."""
        return self.inputs.path_key


@dataclass(frozen=True)
class SurfaceFacts:
    """Facts about an object that are known without reading its triangles: materials, hashes, sources of relief.

    Attributes
    ----------
    materials : tuple of str
        Material names by slot.
    relief_sources : tuple of ReliefSource
        Source of each slot's relief: its shader or splats.
    direct_images : tuple of bool
        True if that relief is read from images directly.
    stated_heights_m : tuple of float
        Height that each slot's shader states and that is not believed if it is true (`is_too_high`), unless the user
        insists; 0 for any other [m].
    clues : tuple of str
        What names say of each slot's material.
    artist_choices, shape_hash, shader_hashes, owner_hash, texture_names, splat_source, heights_as_authored
        See TouchedObject.
    """

    materials: tuple[str, ...]
    artist_choices: tuple[str | MaterialFile, ...]
    shape_hash: str
    shader_hashes: tuple[str, ...]
    owner_hash: str
    relief_sources: tuple[ReliefSource, ...]
    direct_images: tuple[bool, ...]
    texture_names: tuple[tuple[str, ...], ...]
    splat_source: str = ""
    heights_as_authored: tuple[bool, ...] = ()
    stated_heights_m: tuple[float, ...] = ()
    clues: tuple[str, ...] = ()


@dataclass
class GatheredJobs:
    """Strokes of a run (jobs), with the objects skipped, the strokes that failed, and notes for the user."""

    jobs: list[StrokeJob] = field(default_factory=list)
    skipped: list[Skipped] = field(default_factory=list)
    failed: list[Failed] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


class Session:
    """One scene during one run; its surfaces and hashes are computed once, by the objects' names.

    Parameters
    ----------
    scene : bpy.types.Scene
        Scene of the strokes.
    view_layer : bpy.types.ViewLayer
        View layer that is evaluated.
    metres_per_unit : float
        Length of a Blender unit [m].
    request : TouchRequest
        Options of the run.
    """

    def __init__(self, scene: Any, view_layer: Any, metres_per_unit: float, request: TouchRequest) -> None:
        self.scene, self.view_layer, self.metres_per_unit, self.request = scene, view_layer, metres_per_unit, request
        self._surfaces: dict[str, Surface] = {}
        self._touched: dict[str, TouchedObject] = {}
        self._facts: dict[str, SurfaceFacts] = {}
        self._choices = [
            (resolve_target(scene, choice.target), _resolve_choice(choice.material)) for choice in request.choices
        ]
        library = hash_file(LIBRARY_PATH)
        self.predictor = ReliefPredictor(request.encoder, request.sensor, request.tactile_map)
        self.field = load_field_for_encoders(
            (self.predictor.measured_encoder.name, self.predictor.predicted_encoder.name)
        )
        made_by = f"{__version__} {PATCH_PIXELS} {FIRST_PASS_PIXELS} {self.predictor.sensor} {PATCH_VERSION}"
        self._made_by = content_hash(self.field.identity, library, self.predictor.measured_encoder.content_id, made_by)

    @property
    def depsgraph(self) -> Any:
        """Dependency graph, evaluated now, since placing strokes changes the scene during a run."""
        self.view_layer.update()
        return self.view_layer.depsgraph

    def get_surface(self, obj: Any) -> Surface:
        """Return the surface of an object."""
        name = get_scene_name(self.scene, obj)
        if name not in self._surfaces:
            surface = read_surface(obj, self.depsgraph, self.metres_per_unit)
            self._surfaces[name] = replace(surface, notes=(*surface.notes, *self.get_splat_notes(obj)))
        return self._surfaces[name]

    def get_splat_notes(self, obj: Any) -> tuple[str, ...]:
        """Return notes for a surface reconstructed from splats: those of its reconstruction, and if it has no scale.

        Empty for any other object.
        """
        if get_cloud(obj) is None:
            return ()
        units = self.scene.unit_settings
        scale_given = self.request.metres_per_unit is not None or self.scene.hnf.metres_per_unit > 0.0
        if scale_given or (units.system != "NONE" and units.scale_length != 1.0):
            return get_reconstruction_notes(obj)
        return (
            *get_reconstruction_notes(obj),
            f"object '{obj.name}' {NO_SCALE_NOTE.format(metres=self.metres_per_unit)}",
        )

    def get_touched_object(self, obj: Any) -> TouchedObject:
        """Return an object with its surface. Raises SceneError if it is hidden or has no surface."""
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
                has_relief=tuple(source is ReliefSource.RELIEF for source in facts.relief_sources),
                view_layer=self.view_layer,
                heights_as_authored=facts.heights_as_authored,
            )
        return self._touched[name]

    def get_facts(self, obj: Any) -> SurfaceFacts:
        """Return materials, hashes and relief sources of an object.

        Raises SceneError if it is hidden or has no surface.
        """
        name = get_scene_name(self.scene, obj)
        if name not in self._facts:
            if not is_visible(obj, self.view_layer):
                raise SceneError(
                    "it is hidden.", where=f"object '{obj.name}'", remedy="Show it in the viewport and in renders."
                )
            flush_edits(obj)
            slots = get_slot_materials(obj, self.depsgraph)
            inputs = find_shader_inputs(obj, slots)
            cloud = get_cloud(obj)
            cloud_hash = "" if cloud is None else hash_cloud(obj, cloud)
            relief_sources = tuple(find_relief_source(material) for material in slots)
            authored = tuple(self.request.height_as_authored or is_height_authored(material) for material in slots)
            stated_m = [
                0.0 if insists or source is not ReliefSource.RELIEF else get_stated_height(each) * self.metres_per_unit
                for each, insists, source in zip(slots, authored, relief_sources, strict=True)
            ]
            materials = tuple("" if material is None else material.name for material in slots)
            texture_names = tuple(list_texture_names(material) for material in slots)
            self._facts[name] = SurfaceFacts(
                materials=materials,
                artist_choices=tuple("" if material is None else get_artist_choice(material) for material in slots),
                shape_hash=hash_mesh(obj, self.depsgraph, self.metres_per_unit, inputs.layers),
                shader_hashes=tuple(hash_material(material, self.scene.frame_current) for material in slots),
                owner_hash=format_object_inputs(obj, self.view_layer, slots, inputs) + cloud_hash,
                relief_sources=relief_sources
                if cloud is None
                else tuple(_with_splats(source) for source in relief_sources),
                direct_images=tuple(is_direct_image(material) for material in slots),
                texture_names=texture_names,
                splat_source="" if cloud is None else get_cloud_source(cloud),
                heights_as_authored=authored,
                # A wave of this height is too high in whatever band it lies.
                stated_heights_m=tuple(height if height > 2.0 * HEIGHT_LIMITS_M.max() else 0.0 for height in stated_m),
                clues=tuple(
                    _find_clues([material, obj.name, obj.data.name], textures)
                    for material, textures in zip(materials or ("",), texture_names or ((),), strict=True)
                ),
            )
        return self._facts[name]

    def has_facts(self, obj: Any) -> bool:
        """Return True if `get_facts` of an object is cached."""
        return get_scene_name(self.scene, obj) in self._facts

    @property
    def known_names(self) -> set[str]:
        """Names of the objects whose surfaces or facts are cached."""
        return {*self._facts, *self._surfaces}

    def invalidate(self, names: set[str]) -> None:
        """Remove all that is cached about the named objects, which have changed."""
        for cache in (self._surfaces, self._touched, self._facts):
            for name in names & cache.keys():
                del cache[name]

    def get_choices(self, object_name: str) -> dict[int | None, str | MaterialFile]:
        """Return slot (None for any) → material chosen for an object on the command line; the last counts.

        Raises the error of a file that could not be read.
        """
        choices: dict[int | None, str | MaterialFile] = {}
        for target, material in self._choices:
            if target.object_name == object_name:
                if isinstance(material, HnfError):
                    raise material
                choices[target.slot] = material
        return choices

    def get_unused_errors(self, failed: Iterable[Failed]) -> list[str]:
        """Return the errors of files, given for objects on the command line, that no failed stroke tells of."""
        told = {each.why for each in failed}
        return [str(choice) for _, choice in self._choices if isinstance(choice, HnfError) and str(choice) not in told]

    def get_relief_outlook(self, obj: Any, material: str = "") -> list[tuple[ReliefSource, bool]]:
        """Return for each slot of an object (what its relief can be read from, whether the user chose its material).

        `material` is the library material set on the stroke, "" for none.
        """
        facts, choices = self.get_facts(obj), self.get_choices(get_scene_name(self.scene, obj))
        is_chosen = [
            bool(material or choices.get(slot) or choices.get(None) or choice)
            for slot, choice in enumerate(facts.artist_choices)
        ]
        return list(zip(facts.relief_sources, is_chosen, strict=True))

    def compute_surface_key(self, obj: Any) -> str:
        """Hash everything that the tokens on an object depend on, apart from single strokes."""
        return self._hash_inputs(get_scene_name(self.scene, obj), "", "", "").surface_key

    def choose_seed(self, stroke_seed: int) -> int:
        """Return the seed given for the entire run if there is one, else the stroke's."""
        return stroke_seed if self.request.seed is None else self.request.seed

    def read_stroke(self, curve: Any) -> SceneStroke:
        """Read a stroke object of the scene: its curve, motion, force and surface."""
        return read_stroke(curve, self.scene, self.depsgraph, self.metres_per_unit, surfaces=self.get_surface)

    def place_stroke(self, obj: Any, job: StrokeJob, counts: Counts) -> Any:
        """Create the job's primitive as a stroke object of the scene."""
        placed = place_primitive(
            self.scene, obj, job.slot, job.primitive or DEFAULT_PRIMITIVE, self.metres_per_unit, self.depsgraph,
            seed=job.seed, name=job.name, surfaces=self.get_surface,
        )  # fmt: skip
        counts.add("rays", placed.rays)
        return placed.curve

    def make_curve_job(self, curve: Any) -> StrokeJob:
        """Make the job of a stroke object that exists in the scene."""
        stroke = self.read_stroke(curve)
        seed = self.choose_seed(stroke.seed)
        path, touch = hash_path(stroke), hash_touch(stroke, seed)
        inputs = self._hash_inputs(stroke.object_name, stroke.material, path, touch)
        for crossed in stroke.crossed:
            inputs = _join_inputs(inputs, self._hash_inputs(crossed.name, stroke.material, path, touch))
        return StrokeJob(stroke.name, stroke.object_name, inputs, seed, curve_name=stroke.name, stroke=stroke)

    def make_placement_job(self, name: str, target: Target, primitive: Primitive) -> StrokeJob:
        """Make the job of a primitive (predefined stroke) that is still to be placed on `target`."""
        obj, seed = find_object(self.scene, target.object_name), self.choose_seed(0)
        neighbourhood = describe_neighbours(obj, self.scene, self.depsgraph, self.metres_per_unit)
        world = obj.evaluated_get(self.depsgraph).matrix_world
        rigid, _ = compute_surface_frame(world, self.metres_per_unit, f"object '{obj.name}'")
        # The upwards direction matters, since undersides are avoided.
        neighbourhood.append(repr((np.round(rigid[2, :3], 3) + 0.0).tolist()))
        path = content_hash("placed", primitive.name, str(target.slot), *neighbourhood)
        inputs = self._hash_inputs(target.object_name, "", path, content_hash(str(seed)))
        return StrokeJob(name, target.object_name, inputs, seed, primitive=primitive, slot=target.slot)

    def _hash_inputs(self, object_name: str, material: str, path: str, touch: str) -> InputHashes:
        """Hash the inputs of a stroke; `material` is the library material set on it."""
        obj = find_object(self.scene, object_name)
        facts = self.get_facts(obj)
        given = [
            (slot, choice if isinstance(choice, str) else content_hash(choice.to_bytes()))
            for slot, choice in self.get_choices(object_name).items()
        ]
        choices = repr(sorted(given, key=repr))
        if any(facts.heights_as_authored):
            choices += repr(facts.heights_as_authored)
        needs_prediction = any(
            source is ReliefSource.VARYING_COLOUR and not chosen
            for source, chosen in self.get_relief_outlook(obj, material)
        )
        needs_prediction = needs_prediction or bool(facts.splat_source and not facts.relief_sources)
        is_chosen = [chosen for _, chosen in self.get_relief_outlook(obj, material)] or [bool(material)]
        clues = [clue for clue, chosen in zip(facts.clues, is_chosen, strict=True) if not chosen]
        return InputHashes(
            made_by=self._made_by,
            scale=repr(self.metres_per_unit),
            shape=facts.shape_hash,
            shading=content_hash(facts.owner_hash, *facts.shader_hashes),
            sight=self.predictor.content_id if needs_prediction else "",
            choices=content_hash(choices, material, *(_to_hashable(choice) for choice in facts.artist_choices)),
            path=path,
            touch=touch,
            names=content_hash(*clues),
        )


def _join_inputs(first: InputHashes, other: InputHashes) -> InputHashes:
    """Join the inputs of one stroke on two objects; what is no matter of an object stays."""
    shared = {TOUCH_FIELD, PATH_FIELD, "made_by", "scale"}
    joined = {
        each.name: content_hash(getattr(first, each.name), getattr(other, each.name))
        for each in fields(InputHashes)
        if each.name not in shared
    }
    return replace(first, **joined)


def make_scene_session(scene: Any, view_layer: Any, folder: Path) -> Session:
    """Make the session of a bake in Blender: the scene's own scale, no options; results go to `folder`."""
    request = TouchRequest(scene=None, out=folder)
    return Session(scene, view_layer, get_metres_per_unit(scene), request)


def _with_splats(source: ReliefSource) -> ReliefSource:
    """Return the relief source of a slot of a reconstructed surface, whose splats always show a color."""
    return ReliefSource.RELIEF if source is ReliefSource.RELIEF else ReliefSource.VARYING_COLOUR


def _resolve_choice(text: str) -> str | MaterialFile | HnfError:
    """Return the library's name for a material, or the content of its file; the error of a file that is not usable.

    Such a file fails the strokes on its object alone. Raises MaterialError for an unknown name.
    """
    if Path(text).suffix.lower() not in (HNF_SUFFIX, ".safetensors"):
        return get_material(text).name
    try:
        return read_material_file(Path(text))
    except HnfError as error:
        return error


def _find_clues(names: Sequence[str], texture_names: Sequence[str]) -> str:
    """Return as text what the names of a material, its object and its mesh, and of textures, say of a material.

    Numbers that Blender appends to copies, and words that name no material, say nothing.
    """
    hits = match_names(load_library(), names, texture_names)
    weights = {name: sorted((word, weight) for word, (weight, _) in words.items()) for name, words in hits.items()}
    return repr({name: words for name, words in weights.items() if words})


def _to_hashable(choice: str | MaterialFile) -> str | bytes:
    return choice if isinstance(choice, str) else choice.to_bytes()


def gather_jobs(session: Session) -> GatheredJobs:
    """Return jobs of the scene's strokes and of those requested; with neither, one per touchable material.

    A job is one stroke to compute. A stroke that cannot be read is listed as failed. Raises SceneError if the scene
    shows nothing to touch.
    """
    request, scene = session.request, session.scene
    gathered = gather_curve_jobs(session, list_strokes(scene))
    for placement in request.strokes:
        name = _make_unique_name(f"{shorten_name(placement.primitive.name)} on {placement.target}", gathered)
        _add_job(
            gathered, name,
            lambda placement=placement, name=name: session.make_placement_job(
                name, resolve_target(scene, placement.target), placement.primitive),
        )  # fmt: skip
    if not gathered.jobs and not gathered.failed:
        gathered.notes.append(
            "no stroke in the scene and none asked for: one default stroke (left to right, 100 mm/s, 1 N) per material."
        )
        for obj, slot, material in choose_default_slots(scene, session.depsgraph):
            name = _make_unique_name(f"{DEFAULT_PRIMITIVE.name} on {material or obj.name}", gathered)
            _add_job(
                gathered, name,
                lambda obj=obj, slot=slot, name=name: session.make_placement_job(
                    name, Target(get_scene_name(scene, obj), slot), DEFAULT_PRIMITIVE),
            )  # fmt: skip
        if not gathered.jobs and not gathered.failed:
            reasons = [
                f"{each.what}: {each.why}" for each in _iter_skipped(session, set()) if each.why != HIDDEN_REASON
            ]
            raise SceneError(
                "it shows no mesh with faces." if not reasons else f"nothing in it can be touched: {reasons[0]}",
                where=f"scene '{scene.name}'",
                remedy="" if reasons else "Unhide or add one to touch.",
            )
    add_scene_notes(session, gathered)
    return gathered


def gather_curve_jobs(session: Session, curves: Iterable[Any]) -> GatheredJobs:
    """Return the jobs (strokes to compute) of stroke objects."""
    gathered = GatheredJobs()
    for curve in curves:
        _add_job(gathered, get_scene_name(session.scene, curve), lambda curve=curve: session.make_curve_job(curve))
    return gathered


def add_scene_notes(session: Session, gathered: GatheredJobs) -> None:
    """Add notes on objects that no stroke touches, and warnings about surfaces of implausible size."""
    gathered.notes += [*session.get_unused_errors(gathered.failed), *session.scene.get(IMPORT_NOTES, "").splitlines()]
    touched = dict.fromkeys(name for job in gathered.jobs for name in job.object_names)
    gathered.skipped += list(_iter_skipped(session, set(touched)))
    for name in touched:
        obj = find_object(session.scene, name)
        warning = get_size_warning(obj, session.metres_per_unit)
        gathered.notes += [*([warning] if warning else []), *session.get_splat_notes(obj)]


def _add_job(gathered: GatheredJobs, name: str, make: Any) -> None:
    """Append the job that the function `make` returns, or a failure if it raises an error; `name` is the stroke's."""
    try:
        gathered.jobs.append(make())
    except HnfError as error:
        gathered.failed.append(Failed(name, str(error)))


def _make_unique_name(name: str, gathered: GatheredJobs) -> str:
    used = {job.name for job in gathered.jobs} | {failure.stroke for failure in gathered.failed}
    if name not in used:
        return name
    return next(text for number in range(2, len(used) + 3) if (text := f"{name} {number}") not in used)


HIDDEN_REASON = "hidden"


def _iter_skipped(session: Session, touched: set[str]) -> Iterator[Skipped]:
    """Yield everything visible that no stroke touches (names not in `touched`), with the reason.

    Long lists of the same reason are shortened.
    """
    named, depsgraph = get_named_objects(session.scene), session.depsgraph
    names = {obj: name for name, obj in named.items()}
    others = {
        obj: name
        for name, obj in named.items()
        if name not in touched and not is_cloud(obj) and not obj.hnf_stroke.is_stroke
    }
    groups: dict[tuple[str, str], list[str]] = {}
    visible = filter_visible(others, session.view_layer)
    for obj in visible:
        why = explain_untouchable(obj, depsgraph) or ("no stroke touches it" if is_surface(obj) else "")
        if why:
            groups.setdefault((KIND_NAMES.get(obj.type, "object"), why), []).append(others[obj])
    for obj, why in describe_instances(depsgraph):
        if obj in names:
            groups.setdefault(("instances of" if "instance" in why else "hair on", why), []).append(names[obj])
    hidden = {name for obj, name in others.items() if is_surface(obj)}.difference(others[obj] for obj in visible)
    groups["object", HIDDEN_REASON] = sorted(hidden)
    groups["stroke", "muted"] = [
        name for name, obj in named.items() if obj.hnf_stroke.is_stroke and obj.hnf_stroke.mute
    ]
    for (kind, why), members in groups.items():
        if len(members) > 8:
            yield Skipped(f"{len(members)} {kind}s ({', '.join(members[:3])}, …)", why)
        else:
            yield from (Skipped(f"{kind} '{name}'", why) for name in members)


KIND_NAMES = {
    "FONT": "text", "CURVE": "curve", "META": "metaball", "CURVES": "hair", "POINTCLOUD": "point cloud",
    "VOLUME": "volume",
}  # fmt: skip
"""Type of object → its name in messages; "object" for any other."""
