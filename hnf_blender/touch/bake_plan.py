"""Plan of a run, made before anything is rendered: strokes to bake, strokes still valid (fresh), and what is skipped.

It compares the jobs of a session with the report of an earlier run in the output folder (`PreviousRun`) and estimates
the cost. For each material slot it predicts whether the relief will be measured, predicted or prior (its route). The
scene's external files are listed and hashed here too.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from hnf_core.action.contacts import Contacts
from hnf_core.action.stroke_placement import sample_candidates, smooth_for_placement
from hnf_core.errors import HnfError, pluralize
from hnf_core.files import content_hash, hash_file
from hnf_core.material.hnf_file import MaterialFile
from hnf_core.progress import add_work
from hnf_core.scene.camera import Patch
from hnf_core.scene.mesh import has_fine_faces
from hnf_core.tactile.tactile_map import Route
from hnf_core.touch_request import TouchRequest

from ..bridge.closeup import crop_to_patches, find_mesh_relief
from ..bridge.cycles import MAX_READABLE_WAVELENGTH_M
from ..bridge.lit_render import is_lit
from ..bridge.scene.meshes import Surface, make_ray_caster
from ..bridge.scene.scene_names import find_object
from ..bridge.shader.closures import ReliefSource
from .bake_cost import (
    IMAGE_CLOSEUP_SECONDS,
    NO_WORK,
    PATTERN_CLOSEUP_SECONDS,
    PLACEMENT_SECONDS,
    PLAIN_CLOSEUP_SECONDS,
    PREDICTION_SECONDS,
    START_SECONDS,
    SYNTHESIS_SECONDS,
    TouchedPart,
    Work,
    estimate_pictures,
    find_touched_parts,
    measure_slowness,
)
from .bake_patches import CACHE_FOLDER_NAME, PATCH_PIXELS, compute_patch_key
from .material_choice import CHOSEN_BY_ARTIST, format_own_relief_note, format_stated_note
from .overview import MAX_STROKE_VIEWS, MIN_SHARING_STROKES, choose_cameras, count_views
from .patch_cache import has_patch
from .report import REPORT_NAME, SCHEMA, Failed, Skipped, StrokeReport, add_option_hint
from .session import GatheredJobs, Session, StrokeJob

COMPANION_SUFFIXES = {".gltf": (".bin",), ".obj": (".mtl",)}
"""Suffixes of files that importers read next to the scene without leaving a path; all in its folder are listed."""
TILE_PLACEHOLDERS = ("<UDIM>", "<UVTILE>")
"""Placeholders for tile numbers in image paths."""


def list_external_files(scene: Path) -> list[str]:
    """List the absolute paths of existing files that the open scene refers to, UDIM tiles one by one.

    Files packed into the .blend are not listed. `scene` is the file that was opened or imported.
    """
    import bpy

    referenced = [Path(path) for path in bpy.utils.blend_paths(absolute=True, packed=False, local=False)]
    paths = {path for name in referenced for path in _expand_tiles(name)}
    for suffix in COMPANION_SUFFIXES.get(scene.suffix.lower(), ()):
        paths |= {path for path in scene.absolute().parent.iterdir() if path.suffix.lower() == suffix}
    return sorted(str(path) for path in paths if path.is_file())


def hash_source_files(scene: Path, external_files: Iterable[str]) -> str:
    """Hash the scene file by content, and external files, which may be movies, by size and modification time.

    Returns "" if one of them cannot be read.
    """
    try:
        add_work("hashed_files", item=str(scene))
        with scene.open("rb") as stream:
            scene_hash = hashlib.file_digest(stream, lambda: hashlib.blake2b(digest_size=16)).hexdigest()
        stats = [(name, Path(name).stat()) for name in external_files]
    except OSError:
        return ""
    return content_hash(scene_hash, *(f"{name}\0{stat.st_size}\0{stat.st_mtime_ns}" for name, stat in stats))


def _expand_tiles(path: Path) -> list[Path]:
    """Return the files of a path with a UDIM placeholder, else the path itself."""
    for placeholder in TILE_PLACEHOLDERS:
        if placeholder in path.name:
            before, _, after = path.name.partition(placeholder)
            if not path.parent.is_dir():
                return []
            return [
                file for file in path.parent.iterdir() if file.name.startswith(before) and file.name.endswith(after)
            ]
    return [path]


class RerunReason(StrEnum):
    """Reason to write an earlier run's .blend again: unfinished, changed file, other strokes, no pictures, or none."""

    NOTHING = ""
    UNFINISHED = "unfinished"
    CHANGED = "changed"
    STROKES = "strokes"
    PICTURES = "pictures"


@dataclass(frozen=True)
class PreviousRun:
    """An earlier run in the same output folder, read from its report.json.

    Attributes
    ----------
    strokes : tuple of StrokeReport
    scene : str
        Name of the scene file.
    source : str
        Hash of the files its .blend was made from; "" if unknown, or there is no .blend.
    orphaned_files : tuple of str
        Files that belonged to no stroke even then.
    """

    strokes: tuple[StrokeReport, ...] = ()
    scene: str = ""
    source: str = ""
    orphaned_files: tuple[str, ...] = ()

    def find_fresh(self, jobs: Iterable[StrokeJob], folder: Path | None) -> dict[str, StrokeReport]:
        """Return job name → report entry of an earlier stroke that is still valid: same input hash, files intact.

        A job gets the entry of its own name, else one that no other job has, as after renaming: each file belongs to
        one stroke, or pictures would overwrite each other. `folder` is None if there are no earlier results.
        """
        if folder is None:
            return {}
        jobs = list(jobs)
        intact = [
            _forget_lost_picture(entry, folder)
            for entry in _separate_shared_wavs(self.strokes)
            if _is_intact(entry, folder)
        ]
        by_name = {(entry.key, entry.name): entry for entry in intact}
        fresh = {job.name: by_name[job.key, job.name] for job in jobs if (job.key, job.name) in by_name}
        claimed = {entry.name for entry in fresh.values()}
        unclaimed = [entry for entry in intact if entry.name not in claimed]
        for job in jobs:
            entry = next((candidate for candidate in unclaimed if candidate.key == job.key), None)
            if job.name not in fresh and entry is not None:
                fresh[job.name] = entry
                unclaimed.remove(entry)
        return fresh

    def has_name(self, name: str) -> bool:
        """Return True if the earlier run had a stroke of this name."""
        return any(stroke.name == name for stroke in self.strokes)

    def get_rerun_reason(
        self, jobs: Iterable[StrokeJob], source: str, blend: Path, pictured: Iterable[StrokeReport] = ()
    ) -> RerunReason:
        """Return why the baked .blend must be written again: NOTHING if the scene's files and strokes are the same.

        `source` is the hash of the scene's files now, `blend` the path of the baked .blend, and `pictured` are the
        fresh strokes of which each must have a picture.
        """
        if self.source == "" or not blend.is_file():
            return RerunReason.UNFINISHED
        if self.source != source:
            return RerunReason.CHANGED
        previous_strokes = {(stroke.key, stroke.name) for stroke in self.strokes}
        if previous_strokes != {(job.key, job.name) for job in jobs}:
            return RerunReason.STROKES
        return RerunReason.NOTHING if all(stroke.picture for stroke in pictured) else RerunReason.PICTURES


def read_previous_run(folder: Path | None) -> PreviousRun:
    """Read the report.json of an earlier run in a folder; an empty run if there is none, or it cannot be read."""
    if folder is None:
        return PreviousRun()
    try:
        record = json.loads((folder / REPORT_NAME).read_text(encoding="utf-8"))
        if record["schema"] != SCHEMA:
            return PreviousRun()
        return PreviousRun(
            tuple(StrokeReport(**entry) for entry in record["strokes"]),
            str(record["scene"]),
            str(record.get("source", "")),
            tuple(map(str, record.get("left_over", ()))),
        )
    except (OSError, ValueError, KeyError, TypeError):
        return PreviousRun()


def find_orphaned_files(
    previous: PreviousRun, folder: Path, scene: str, strokes: Iterable[StrokeReport], pending: Collection[str] = ()
) -> list[str]:
    """Return the files in a folder that an earlier run of this scene left and that belong to no stroke now.

    Parameters
    ----------
    previous : PreviousRun
        Earlier run.
    folder : Path
        Output folder.
    scene : str
        Name of the scene file.
    strokes : iterable of StrokeReport
        Strokes of this run.
    pending : collection of str, optional
        Names of strokes that are not written yet, or failed; their files are kept.

    Returns
    -------
    list of str
    """
    if previous.scene != scene:
        return []
    owned = {name for stroke in strokes for name in _get_file_names(stroke)}
    finished = [entry for entry in previous.strokes if entry.name not in pending]
    old_files = {*previous.orphaned_files, *(name for stroke in finished for name in _get_file_names(stroke))}
    pending_files = {name for stroke in previous.strokes if stroke.name in pending for name in _get_file_names(stroke)}
    return sorted(
        name for name in old_files - owned - pending_files if Path(name).name == name and (folder / name).is_file()
    )


def _separate_shared_wavs(strokes: Iterable[StrokeReport]) -> list[StrokeReport]:
    """Return the report entries so that no two share a WAV file.

    Older versions let equal strokes share a WAV and overwrite each other's pictures. The first keeps the files, and its
    picture is drawn again.
    """
    entries = list(strokes)
    count = Counter(entry.wav for entry in entries)
    first = {entry.wav: entry for entry in reversed(entries)}
    return [
        replace(entry, picture_key="") if count[entry.wav] > 1 else entry
        for entry in entries
        if first[entry.wav] is entry
    ]


def _get_file_names(stroke: StrokeReport) -> tuple[str, ...]:
    return (stroke.wav, stroke.picture) if stroke.picture else (stroke.wav,)


def _is_intact(entry: StrokeReport, folder: Path) -> bool:
    """Return True if a report entry's WAV still has the hash it was written with."""
    if Path(entry.wav).name != entry.wav:
        return False
    try:
        return hash_file(folder / entry.wav) == entry.wav_hash
    except OSError:
        return False


def _forget_lost_picture(entry: StrokeReport, folder: Path) -> StrokeReport:
    """Return a report entry that names no picture if the one it names is not there."""
    is_there = Path(entry.picture).name == entry.picture and (folder / entry.picture).is_file()
    return entry if is_there else replace(entry, picture="", picture_key="")


RENDERS_PER_CLOSEUP = 2
"""Maximum number of renders of a close-up; see `CloseUpRenderer`."""
TYPICAL_PATH_M, PATCH_PITCH_M = 60e-3, 10e-3
"""Assumed length of a stroke's path, and least distance between patches [m]."""
TYPICAL_PATCHES = 5
"""Number of patches of a placed stroke, mostly."""

RERUN_MESSAGES = {
    RerunReason.UNFINISHED: "The baked .blend is not there, or the earlier run did not finish it",
    RerunReason.CHANGED: "The scene's file has changed since",
    RerunReason.STROKES: "The earlier run had other strokes",
    RerunReason.PICTURES: "Some of them have no picture",
}


def estimate_max_patches(length_m: float) -> int:
    """Return an upper bound for the number of patches, and so of close-up renders, of a stroke of this length [m]."""
    return int(length_m / PATCH_PITCH_M) + 1


@dataclass(frozen=True)
class SlotPlan:
    """Expected route of a material slot's relief: measured from the shader, predicted from an image, or prior.

    Attributes
    ----------
    material : str
        Name of the Blender material.
    route : Route
    why : str
        Reason for the route.
    seconds : float
        Processor time of one close-up on the reference machine [s].
    unless : str
        Finding in the close-up that would make the route prior; "" for none.
    """

    material: str
    route: Route
    why: str
    seconds: float = PATTERN_CLOSEUP_SECONDS
    unless: str = ""


def estimate_closeup_seconds(slots: Iterable[SlotPlan]) -> float:
    """Estimate the processor time of one close-up on any of these slots [s]."""
    return max((slot.seconds for slot in slots), default=PATTERN_CLOSEUP_SECONDS)


@dataclass(frozen=True)
class PlannedBake:
    """One stroke that a run will bake, with the reason and an upper bound for the cost.

    Attributes
    ----------
    stroke, object, material : str
        Names.
    patches : int
        Upper bound for its close-ups.
    why : str
        Reason why it is not fresh.
    slots : tuple of SlotPlan
        Slots that it may touch.
    work : Work
        Estimated work of baking and synthesizing it, without close-ups that are cached or an earlier stroke's.
    """

    stroke: str
    object: str
    material: str
    patches: int
    why: str
    slots: tuple[SlotPlan, ...] = ()
    work: Work = NO_WORK

    @property
    def predictions(self) -> int:
        """Upper bound for the patches whose relief is predicted by D_φ."""
        return self.patches if any(slot.route is Route.PREDICTED for slot in self.slots) else 0


@dataclass(frozen=True)
class UpToDate:
    """One stroke whose signal exists and is still valid."""

    stroke: str
    object: str
    wav: str


@dataclass(frozen=True)
class PlannedQuery:
    """One touch query (what is felt at one place) that a run will evaluate.

    Attributes
    ----------
    name, object, material : str
        Names.
    close_ups : int
        1, or 0 if its patch is cached.
    slot : SlotPlan or None
        Expected route; None if the object has no slots.
    """

    name: str
    object: str
    material: str
    close_ups: int
    slot: SlotPlan | None = None

    @property
    def predictions(self) -> int:
        """Upper bound for the reliefs that are predicted by D_φ, 0 or 1."""
        return int(self.slot is not None and self.slot.route is Route.PREDICTED)


@dataclass(frozen=True)
class Plan:
    """Plan of a run: the strokes to bake, those still valid, and what is skipped or cannot be done.

    Attributes
    ----------
    needed : tuple of PlannedBake
    fresh : tuple of UpToDate
    skipped : tuple of Skipped
    failed : tuple of Failed
    notes : tuple of str
    probes : tuple of PlannedQuery
        Touch queries.
    redrawn_pictures : int
        Upper bound for the pictures of fresh strokes that are drawn again.
    again : RerunReason
        Reason why the .blend of an earlier run with fresh strokes is written again.
    with_pictures : bool
        False if no pictures are wanted.
    views : int
        Number of views in the pictures of the strokes to bake.
    is_lit : bool
        True if the scene has lights of its own, which take longer to render.
    slowness : float
        Time of a computation here over that on the reference machine.
    """

    needed: tuple[PlannedBake, ...]
    fresh: tuple[UpToDate, ...]
    skipped: tuple[Skipped, ...]
    failed: tuple[Failed, ...]
    notes: tuple[str, ...]
    probes: tuple[PlannedQuery, ...] = ()
    redrawn_pictures: int = 0
    again: RerunReason = RerunReason.NOTHING
    with_pictures: bool = True
    views: int = 0
    is_lit: bool = False
    slowness: float = 1.0

    @property
    def pictures(self) -> int:
        """Upper bound for the pictures of strokes that are drawn."""
        return len(self.needed) + self.redrawn_pictures if self.with_pictures else 0

    @property
    def renders(self) -> int:
        """Upper bound for the number of renders.

        Each close-up takes two, and each slot with a relief one more, which chooses the sampling. The views in the
        pictures are shared, but each stroke may need one of its own.
        """
        slots = [slot for entry in self.needed for slot in entry.slots]
        slots += [query.slot for query in self.probes if query.slot is not None and query.close_ups]
        picture_views = MAX_STROKE_VIEWS * self.pictures + min(1, self.pictures)
        picture_views += self.pictures // MIN_SHARING_STROKES
        looks = sum(slot.route is Route.MEASURED for slot in slots)
        return RENDERS_PER_CLOSEUP * self.close_ups + looks + picture_views

    @property
    def close_ups(self) -> int:
        """Upper bound for the number of patches that are rendered."""
        return sum(entry.patches for entry in self.needed) + sum(entry.close_ups for entry in self.probes)

    @property
    def predictions(self) -> int:
        """Upper bound for the patches whose relief is predicted by D_φ."""
        return sum(entry.predictions for entry in self.needed) + sum(entry.predictions for entry in self.probes)

    @property
    def seconds(self) -> float:
        """Estimated time of the run [s]."""
        return self.work.estimate_seconds(self.slowness)

    @property
    def work(self) -> Work:
        """Estimated work of the run, with its start unless there is nothing to do."""
        queries = sum(
            query.close_ups
            * (
                estimate_closeup_seconds(() if query.slot is None else (query.slot,))
                + PREDICTION_SECONDS * query.predictions
            )
            for query in self.probes
        )
        views = self.views + self.redrawn_pictures if self.with_pictures else 0
        drawing = estimate_pictures(self.pictures, views, is_lit=self.is_lit)
        work = sum((entry.work for entry in self.needed), Work(queries) + drawing)
        return work if work == NO_WORK else work + Work(single_s=START_SECONDS)

    def as_json(self) -> str:
        """Return the plan as JSON."""
        estimate = {
            "renders_at_most": self.renders,
            "predictions_at_most": self.predictions,
            "seconds": round(self.seconds, 1),
            "processor_seconds": round(self.slowness * (self.work.rendering_s + self.work.single_s), 1),
        }
        keys = {"redrawn_pictures": "pictures"}
        record = {keys.get(name, name): value for name, value in asdict(self).items()}
        return json.dumps({**record, "estimate": estimate}, indent=1, ensure_ascii=False)

    def _format_cost(self) -> str:
        """Format the upper bounds of close-ups, renders and predictions, and the estimated time."""
        parts = [pluralize(self.close_ups, "close-up")]
        if self.with_pictures:
            parts.append(pluralize(self.pictures, "picture"))
        if self.predictions:
            parts.append(f"{pluralize(self.predictions, 'relief')} estimated from pictures")
        listed = " and ".join(filter(None, [", ".join(parts[:-1]), parts[-1]]))
        return f"at most {listed}, about {self.seconds:.0f} s"

    def _format_picture_count(self) -> str:
        if not self.redrawn_pictures:
            return ""
        return f", and at most {pluralize(self.redrawn_pictures, 'picture')}, where what it shows is not what it showed"

    def as_text(self) -> str:
        """Return the plan as text."""
        lines = []
        if self.needed:
            lines.append("To bake:")
            for entry in self.needed:
                lines.append(
                    f"  {entry.stroke}: on {entry.object}, {entry.material or 'no material'}; "
                    f"at most {pluralize(entry.patches, 'close-up')} ({entry.why})"
                )
                lines += [_format_route(slot, entry.predictions) for slot in entry.slots]
            lines.append(f"  In all {self._format_cost()}.")
        if self.probes:
            lines.append("Probes:")
            for probe in self.probes:
                cost = "1 close-up" if probe.close_ups else "examined before, nothing to render"
                lines.append(f"  {probe.name}: on {probe.object}, {probe.material or 'no material'}; {cost}")
                lines += [_format_route(probe.slot, probe.predictions)] if probe.slot is not None else []
        lines += ["Up to date:", *(f"  {entry.stroke}: {entry.wav}" for entry in self.fresh)] if self.fresh else []
        if self.again:
            lines.append(
                f"  {RERUN_MESSAGES[self.again]}: the baked .blend is written anew{self._format_picture_count()}."
            )
        lines += ["Skipped:", *(f"  {entry.what}: {entry.why}" for entry in self.skipped)] if self.skipped else []
        lines += ["Problems:", *(f"  {entry.why}" for entry in self.failed)] if self.failed else []
        lines += ["Notes:", *(f"  {add_option_hint(note)}" for note in self.notes)] if self.notes else []
        return "\n".join(lines) or "Nothing to do."


def _format_route(slot: SlotPlan, predictions: int) -> str:
    cost = ""
    if slot.route is Route.PREDICTED:
        cost = f", at most {pluralize(predictions, 'close-up')}"
    unless = f"; prior if {slot.unless}" if slot.unless else ""
    return f"    {slot.material or 'no material'}: {slot.route.value} ({slot.why}{unless}){cost}"


TOO_COARSE_NOTE = f"its picture shows no waves below {MAX_READABLE_WAVELENGTH_M * 1e3:g} mm, or one color"
"""Finding of a close-up that makes the route of a slot prior, where the plan expected to predict its relief."""


MAX_EXAMINED_PATCHES = 12
"""Maximum number of patches of a stroke that a plan examines for relief of the mesh."""


def find_mesh_waves(session: Session, obj: Any, patches: Sequence[Patch]) -> dict[str, float]:
    """Return material → shortest wave [m] that its mesh shows under patches, by rays; nothing is rendered."""
    surface = session.get_surface(obj)
    fine = {slot for slot in {patch.slot for patch in patches} if has_fine_faces(surface.mesh, slot)}
    patches = [patch for patch in patches if patch.slot in fine]
    patches = patches[:: len(patches) // MAX_EXAMINED_PATCHES + 1]
    waves: dict[str, float] = {}
    if not patches or session.get_facts(obj).splat_source:
        return waves
    near = crop_to_patches(surface, patches)
    caster = make_ray_caster(near.mesh)
    for patch in patches:
        relief = find_mesh_relief(near, patch, caster, PATCH_PIXELS)
        if relief is not None:
            name = surface.materials[patch.slot] if patch.slot < len(surface.materials) else ""
            waves[name] = min(waves.get(name, np.inf), relief.resolved_wavelength_m)
    return waves


def estimate_stroke(
    session: Session, job: StrokeJob, parts: Sequence[TouchedPart], cache: Path | None, counted: set[str]
) -> Work:
    """Estimate the work of baking and synthesizing a job's stroke.

    Parameters
    ----------
    session : Session
        Session of the scene.
    job : StrokeJob
        The stroke.
    parts : sequence of TouchedPart
        Its parts (`find_touched_parts`).
    cache : Path or None
        Folder of cached patches, whose close-ups are not rendered again.
    counted : set of str
        Cache keys of the patches of other strokes; those of this one are added.

    Returns
    -------
    Work
    """
    if not parts:
        slots = plan_slots(session, job)
        predicted = any(slot.route is Route.PREDICTED for slot in slots)
        each = estimate_closeup_seconds(slots) + (PREDICTION_SECONDS if predicted else 0.0)
        return Work(TYPICAL_PATCHES * each, SYNTHESIS_SECONDS + (PLACEMENT_SECONDS if job.stroke is None else 0.0))
    seconds, material = 0.0, "" if job.stroke is None else job.stroke.material
    for part in parts:
        touched, slots = session.get_touched_object(part.obj), plan_object_slots(session, part.obj, material)
        for patch in part.patches:
            key = compute_patch_key(touched, patch, session.predictor)
            if key in counted or (cache is not None and has_patch(cache, key)):
                continue
            counted.add(key)
            own = slots[patch.slot : patch.slot + 1]
            predicted = any(slot.route is Route.PREDICTED for slot in own)
            seconds += estimate_closeup_seconds(own) + (PREDICTION_SECONDS if predicted else 0.0)
    return Work(seconds, SYNTHESIS_SECONDS)


def _find_mesh_waves(session: Session, job: StrokeJob, parts: Sequence[TouchedPart]) -> dict[str, float]:
    """Return `find_mesh_waves` under a job's stroke, or where it may be placed; {} if it cannot be read."""
    obj = find_object(session.scene, job.object_name)
    try:
        if job.stroke is not None:
            found: dict[str, float] = {}
            for part in reversed(parts):
                found |= find_mesh_waves(session, part.obj, part.patches)
            return found
        mesh = session.get_surface(obj).mesh
        slots = sorted(set(mesh.slot.tolist())) if job.slot is None else [job.slot]
        patches: list[Patch] = []
        for slot in slots:
            centre, x_axis, normal = sample_candidates(smooth_for_placement(mesh, slot) or mesh, slot)
            picked = range(0, len(centre), max(len(centre) // 4, 1))
            patches += [Patch(centre[i], x_axis[i], normal[i], slot) for i in picked]
        return find_mesh_waves(session, obj, patches)
    except HnfError:  # the bake will say so
        return {}


def add_mesh_relief(slots: Iterable[SlotPlan], waves: Mapping[str, float]) -> tuple[SlotPlan, ...]:
    """Return slot plans in which relief of the mesh is named; `waves` is material → its shortest wave [m]."""
    plans = []
    for slot in slots:
        if slot.material not in waves:
            plans.append(slot)
            continue
        ridges = f"ridges of its mesh, waves from {waves[slot.material] * 1e3:.2g} mm"
        if slot.route is Route.PRIOR:
            plans.append(replace(slot, route=Route.MEASURED, why=f"from {ridges}; other waves: {slot.why}"))
        else:
            plans.append(replace(slot, why=f"{slot.why}; {ridges}, are measured"))
    return tuple(plans)


def describe_stated_heights(session: Session, jobs: Iterable[StrokeJob]) -> list[str]:
    """Return a note on each material under strokes whose shader states a height that will not be believed."""
    names = dict.fromkeys(name for job in jobs for name in job.object_names)
    facts = [session.get_facts(find_object(session.scene, name)) for name in names]
    notes = [
        format_stated_note(name, height)
        for each in facts
        for name, height in zip(each.materials, each.stated_heights_m, strict=True)
        if height
    ]
    return list(dict.fromkeys(notes))


def plan_slots(session: Session, job: StrokeJob) -> tuple[SlotPlan, ...]:
    """Return the expected route of each slot that a job's stroke may touch.

    These are all slots of its objects, or the one on which it is to be placed. A route says where the relief comes
    from: measured, predicted or prior.
    """
    material = "" if job.stroke is None else job.stroke.material
    return tuple(
        plan
        for name in job.object_names
        for slot, plan in enumerate(plan_object_slots(session, find_object(session.scene, name), material))
        if job.slot in (None, slot)
    )


def plan_object_slots(session: Session, obj: Any, material: str = "") -> tuple[SlotPlan, ...]:
    """Return the expected route (measured, predicted or prior) of each slot of an object.

    `material` is the library material set on the stroke, which replaces the slots' own. A slot with a varying color may
    still turn out prior, if its image is too coarse or uniform.
    """
    facts = session.get_facts(obj)
    why = (
        f"no relief, but splats of {facts.splat_source} show it"
        if facts.splat_source
        else "no relief, but its color varies"
    )
    return tuple(
        _plan_slot(
            facts.materials[slot],
            relief_source,
            chosen,
            session.predictor.missing_reason,
            why,
            facts.direct_images[slot],
        )
        for slot, (relief_source, chosen) in enumerate(session.get_relief_outlook(obj, material))
    )


def _plan_slot(
    material: str, relief_source: ReliefSource, chosen: bool, missing: str, evidence: str, direct_image: bool
) -> SlotPlan:
    """Return the expected route of one material slot.

    `chosen` is true if the user chose its haptic material, `missing` says why nothing can be predicted ("" if it can),
    `evidence` is what a relief could be predicted from, and `direct_image` is true if its relief is read from images.
    """
    if relief_source is ReliefSource.RELIEF:
        seconds = IMAGE_CLOSEUP_SECONDS if direct_image else PATTERN_CLOSEUP_SECONDS
        return SlotPlan(material, Route.MEASURED, "from the bump, normal or displacement in its shader", seconds)
    if relief_source is ReliefSource.VARYING_COLOUR and not chosen:
        if missing:
            return SlotPlan(material, Route.PRIOR, missing, IMAGE_CLOSEUP_SECONDS)
        return SlotPlan(material, Route.PREDICTED, evidence, IMAGE_CLOSEUP_SECONDS, unless=TOO_COARSE_NOTE)
    if chosen:
        skipped = "; its picture is skipped" if relief_source is ReliefSource.VARYING_COLOUR else ""
        return SlotPlan(material, Route.PRIOR, f"{CHOSEN_BY_ARTIST}{skipped}", PLAIN_CLOSEUP_SECONDS)
    return SlotPlan(material, Route.PRIOR, "its shader has neither relief nor picture", PLAIN_CLOSEUP_SECONDS)


def describe_shader_reliefs(session: Session, gathered: GatheredJobs) -> list[str]:
    """Return notes on materials given on the command line for slots whose shader has a relief of its own.

    The shader's relief is used there; the notes say what remains of the material.
    """
    notes = []
    for name in dict.fromkeys(name for job in gathered.jobs for name in job.object_names):
        obj, choices = find_object(session.scene, name), session.get_choices(name)
        facts = session.get_facts(obj)
        for slot, (material, relief_source) in enumerate(zip(facts.materials, facts.relief_sources, strict=True)):
            choice = choices.get(slot) or choices.get(None)
            learned = isinstance(choice, MaterialFile) and choice.field
            if choice and relief_source is ReliefSource.RELIEF and not learned:
                library = choice.name if isinstance(choice, MaterialFile) else choice
                notes.append(format_own_relief_note(material, name, library))
    return notes


def make_plan(session: Session, gathered: GatheredJobs, previous: PreviousRun, source: str) -> Plan:
    """Make the plan of a run, without rendering; rays are cast.

    `previous` is the earlier run in the output folder, `source` the hash of the scene's files.
    """
    needed, fresh = [], []
    out = session.request.out
    fresh_entries, cache = previous.find_fresh(gathered.jobs, out), None if out is None else out / CACHE_FOLDER_NAME
    counted: set[str] = set()
    shown: list[tuple[str, Contacts, Surface, Any]] = []
    for job in gathered.jobs:
        if job.name in fresh_entries:
            fresh.append(UpToDate(job.name, job.object_name, fresh_entries[job.name].wav))
            continue
        length = TYPICAL_PATH_M if job.stroke is None else job.stroke.length_m
        slots = session.get_facts(find_object(session.scene, job.object_name)).materials
        shader = slots[job.slot] if job.slot is not None and job.slot < len(slots) else ", ".join(slots)
        why = "changed since the last run" if previous.has_name(job.name) else "not baked yet"
        parts = find_touched_parts(session, job)
        routes = add_mesh_relief(plan_slots(session, job), _find_mesh_waves(session, job, parts))
        work = estimate_stroke(session, job, parts, cache, counted)
        needed.append(PlannedBake(job.name, job.object_name, shader, estimate_max_patches(length), why, routes, work))
        shown += [(job.name, part.contacts, session.get_surface(part.obj), part.obj) for part in parts[:1]]
    folder, rerun_reason = session.request.out, RerunReason.NOTHING
    if fresh and folder is not None:
        pictured = fresh_entries.values() if session.request.pictures else ()
        rerun_reason = previous.get_rerun_reason(gathered.jobs, source, folder / get_blend_name(session), pictured)
    to_bake = [job for job in gathered.jobs if job.name not in fresh_entries]
    notes = (*gathered.notes, *describe_stated_heights(session, to_bake))
    # If the file is the same, only a picture without a key may be outdated.
    redrawn_pictures = sum(
        session.request.pictures and (previous.source != source or not entry.picture_key)
        for entry in fresh_entries.values()
    )
    return Plan(
        tuple(needed), tuple(fresh), tuple(gathered.skipped), tuple(gathered.failed), notes,
        redrawn_pictures=redrawn_pictures, again=rerun_reason, with_pictures=session.request.pictures,
        views=len(needed) - len(shown) + count_views(choose_cameras(session.scene, session.metres_per_unit, shown)),
        is_lit=is_lit(session.scene), slowness=measure_slowness(),
    )  # fmt: skip


def get_blend_name(session: Session) -> str:
    """Return the file name of the baked .blend."""
    source = get_scene_path(session.request)
    return f"{source.stem}_touched.blend"


def get_scene_path(request: TouchRequest) -> Path:
    """Return the path of the scene file to open."""
    import bpy

    return request.scene if request.scene is not None else Path(bpy.data.filepath)
