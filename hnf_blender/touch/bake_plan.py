"""The files beside a scene's own that it was read with: pictures, libraries, the parts of an imported model.

What an earlier run left in a folder: the strokes that are still true, and the files that nothing owns any more.

What this run needs, what is fresh, what is left out, and why: made before anything is rendered or cast.

Which route each slot of a surface will take, told before anything is rendered.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

from hnf_core.files import content_hash
from hnf_core.tactile.tactile_map import Route
from hnf_core.text import pluralize
from hnf_core.touch_request import TouchRequest

from ..bridge.render.unlit_image import MAX_READABLE_WAVELENGTH_M
from ..bridge.scene.scene_names import find_object
from ..bridge.shader.closures import ReliefSource
from .material_choice import CHOSEN_BY_ARTIST
from .overview import MAX_STROKE_VIEWS
from .report import REPORT_NAME, SCHEMA, Failed, Skipped, StrokeReport, add_option_hint
from .session import GatheredJobs, Session, StrokeJob

COMPANION_SUFFIXES = {".gltf": (".bin",), ".obj": (".mtl",)}
"""What importers read beside the file and leave no path of: every file of that kind in the same folder is named."""
TILE_PLACEHOLDERS = ("<UDIM>", "<UVTILE>")


def list_external_files(scene: Path) -> list[str]:
    """Absolute paths of the files that the open scene refers to, those of pictures in tiles one by one; packed ones are
    in the scene's own. scene: the file it was opened or imported from. What is not there is left out."""
    import bpy

    named = [Path(path) for path in bpy.utils.blend_paths(absolute=True, packed=False, local=False)]
    found = {path for name in named for path in _expand_tiles(name)}
    for suffix in COMPANION_SUFFIXES.get(scene.suffix.lower(), ()):
        found |= {path for path in scene.absolute().parent.iterdir() if path.suffix.lower() == suffix}
    return sorted(str(path) for path in found if path.is_file())


def hash_source_files(scene: Path, external_files: Iterable[str]) -> str:
    """Of the scene's own file by its content, of those outside, which may be films, by their size and time of change;
    "" where one cannot be read any more."""
    try:
        with scene.open("rb") as stream:
            own = hashlib.file_digest(stream, lambda: hashlib.blake2b(digest_size=16)).hexdigest()
        facts = [(name, Path(name).stat()) for name in external_files]
    except OSError:
        return ""
    return content_hash(own, *(f"{name}\0{fact.st_size}\0{fact.st_mtime_ns}" for name, fact in facts))


def _expand_tiles(path: Path) -> list[Path]:
    for word in TILE_PLACEHOLDERS:
        if word in path.name:
            before, _, after = path.name.partition(word)
            if not path.parent.is_dir():
                return []
            return [
                each for each in path.parent.iterdir() if each.name.startswith(before) and each.name.endswith(after)
            ]
    return [path]


class RerunReason(StrEnum):
    """What is not as an earlier run left it: nothing, its .blend, which is not there or was never saved, the scene's
    file, or which strokes there are."""

    NOTHING = ""
    UNFINISHED = "unfinished"
    CHANGED = "changed"
    STROKES = "strokes"


@dataclass(frozen=True)
class PreviousRun:
    """An earlier run by its report. scene: name of its file. source: hash of what its .blend was made from, "" = it has
    none, or does not say. left_over: files that no stroke owned even then."""

    strokes: tuple[StrokeReport, ...] = ()
    scene: str = ""
    source: str = ""
    orphaned_files: tuple[str, ...] = ()

    def find_fresh(self, jobs: Iterable[StrokeJob], folder: Path | None) -> dict[str, StrokeReport]:
        """Name of a job → the entry of an equal stroke whose signal is there, byte for byte as it was written. A job
        gets that of its own name, else one that no other takes, as after a rename: each file is one stroke's alone, or
        the picture of one would be drawn over the other's. folder: None = there is none."""
        if folder is None:
            return {}
        jobs, there = list(jobs), [each for each in _separate_shared_wavs(self.strokes) if _is_intact(each, folder)]
        named = {(entry.key, entry.name): entry for entry in there}
        fresh = {job.name: named[job.key, job.name] for job in jobs if (job.key, job.name) in named}
        owned = {entry.name for entry in fresh.values()}
        free = [entry for entry in there if entry.name not in owned]
        for job in jobs:
            entry = next((each for each in free if each.key == job.key), None)
            if job.name not in fresh and entry is not None:
                fresh[job.name] = entry
                free.remove(entry)
        return fresh

    def has_name(self, name: str) -> bool:
        return any(stroke.name == name for stroke in self.strokes)

    def get_rerun_reason(self, jobs: Iterable[StrokeJob], source: str, blend: Path) -> RerunReason:
        """Why its .blend cannot stay: NOTHING where it was made from this source, with these strokes and no others."""
        if self.source == "" or not blend.is_file():
            return RerunReason.UNFINISHED
        if self.source != source:
            return RerunReason.CHANGED
        mine = {(stroke.key, stroke.name) for stroke in self.strokes}
        return RerunReason.NOTHING if mine == {(job.key, job.name) for job in jobs} else RerunReason.STROKES


def read_previous_run(folder: Path | None) -> PreviousRun:
    """Of the report in folder; nothing where there is none, or it cannot be read."""
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
    """Names of files in folder that an earlier run of this scene left and none of its strokes owns now. strokes: of
    this run. awaited: names of strokes that it has not made yet, or cannot: theirs are not given up."""
    if previous.scene != scene:
        return []
    owned = {name for stroke in strokes for name in _get_file_names(stroke)}
    gone = [each for each in previous.strokes if each.name not in pending]
    named = {*previous.orphaned_files, *(name for stroke in gone for name in _get_file_names(stroke))}
    kept = {name for stroke in previous.strokes if stroke.name in pending for name in _get_file_names(stroke)}
    return sorted(name for name in named - owned - kept if Path(name).name == name and (folder / name).is_file())


def _separate_shared_wavs(strokes: Iterable[StrokeReport]) -> list[StrokeReport]:
    """One entry for each WAV: older versions let equal strokes share one and draw their pictures over each other. The
    first keeps the files, and its picture is drawn anew."""
    entries = list(strokes)
    count = Counter(entry.wav for entry in entries)
    first = {entry.wav: entry for entry in reversed(entries)}
    return [
        replace(entry, picture_key="") if count[entry.wav] > 1 else entry
        for entry in entries
        if first[entry.wav] is entry
    ]


def _get_file_names(stroke: StrokeReport) -> tuple[str, str]:
    return stroke.wav, stroke.picture


def _is_intact(entry: StrokeReport, folder: Path) -> bool:
    if Path(entry.wav).name != entry.wav:
        return False
    try:
        return content_hash((folder / entry.wav).read_bytes()) == entry.wav_hash and (folder / entry.picture).is_file()
    except OSError:
        return False


RENDERS_PER_CLOSEUP = 2
"""Renders of a close-up at most: see closeup.iter_closeups."""
PROCEDURAL_CLOSEUP_SECONDS, IMAGE_CLOSEUP_SECONDS = 0.7, 0.2
"""Of a close-up with all pixels, and of one that a first look nearly suffices for."""
PREDICTION_SECONDS, PLOT_SECONDS, SYNTHESIS_SECONDS = 0.1, 1.8, 0.4
"""Rough cost on two cores, for the estimate only."""
TYPICAL_PATH_M, PATCH_PITCH_M = 60e-3, 10e-3

RERUN_MESSAGES = {
    RerunReason.UNFINISHED: "The baked .blend is not there, or the earlier run did not finish it",
    RerunReason.CHANGED: "The scene's file has changed since",
    RerunReason.STROKES: "The earlier run had other strokes",
}


def estimate_max_patches(length_m: float) -> int:
    """Upper bound of the close-ups that a stroke of this length takes."""
    return int(length_m / PATCH_PITCH_M) + 1


@dataclass(frozen=True)
class SlotPlan:
    """How the relief of a slot will come to be known. material: the Blender material's name. seconds: of one close-up,
    roughly. unless: what, seen in the close-up, makes it prior after all; "" = nothing."""

    material: str
    route: Route
    why: str
    seconds: float = PROCEDURAL_CLOSEUP_SECONDS
    unless: str = ""


def estimate_closeup_seconds(slots: Iterable[SlotPlan]) -> float:
    """Of one close-up on any of these slots."""
    return max((slot.seconds for slot in slots), default=PROCEDURAL_CLOSEUP_SECONDS)


@dataclass(frozen=True)
class PlannedBake:
    """One stroke to be made. patches: upper bound of the close-ups it takes. why: what is not fresh. slots: what it may
    touch."""

    stroke: str
    object: str
    material: str
    patches: int
    why: str
    slots: tuple[SlotPlan, ...] = ()

    @property
    def predictions(self) -> int:
        """Upper bound of the patches whose relief is estimated from their picture."""
        return self.patches if any(slot.route is Route.PREDICTED for slot in self.slots) else 0


@dataclass(frozen=True)
class UpToDate:
    """One stroke whose signal is there and still true."""

    stroke: str
    object: str
    wav: str


@dataclass(frozen=True)
class PlannedQuery:
    """One place to be looked at. close_ups: 1, or 0 where the store knows the place. slot: how its relief will come to
    be known, None where its object has no slots."""

    name: str
    object: str
    material: str
    close_ups: int
    slot: SlotPlan | None = None

    @property
    def predictions(self) -> int:
        """Upper bound, as of a stroke."""
        return int(self.slot is not None and self.slot.route is Route.PREDICTED)


@dataclass(frozen=True)
class Plan:
    """pictures: upper bound of those that fresh strokes get anew. again: why the .blend of an earlier run, which has
    fresh ones, is written anew."""

    needed: tuple[PlannedBake, ...]
    fresh: tuple[UpToDate, ...]
    skipped: tuple[Skipped, ...]
    failed: tuple[Failed, ...]
    notes: tuple[str, ...]
    probes: tuple[PlannedQuery, ...] = ()
    pictures: int = 0
    again: RerunReason = RerunReason.NOTHING

    @property
    def renders(self) -> int:
        """Upper bound: a close-up a patch, and one a probe, in two looks at most; for the pictures one view by the
        scene's camera, and each stroke's own past what stands before it."""
        drawn = len(self.needed) + self.pictures
        return RENDERS_PER_CLOSEUP * self.close_ups + MAX_STROKE_VIEWS * drawn + min(1, drawn)

    @property
    def close_ups(self) -> int:
        """Upper bound."""
        return sum(entry.patches for entry in self.needed) + sum(entry.close_ups for entry in self.probes)

    @property
    def predictions(self) -> int:
        """Upper bound: one a patch."""
        return sum(entry.predictions for entry in self.needed) + sum(entry.predictions for entry in self.probes)

    @property
    def seconds(self) -> float:
        stroke = PLOT_SECONDS + SYNTHESIS_SECONDS
        looks = sum(entry.patches * estimate_closeup_seconds(entry.slots) for entry in self.needed)
        looks += sum(
            each.close_ups * estimate_closeup_seconds(() if each.slot is None else (each.slot,)) for each in self.probes
        )
        strokes = len(self.needed) * stroke + self.pictures * PLOT_SECONDS
        return looks + self.predictions * PREDICTION_SECONDS + strokes

    def as_json(self) -> str:
        estimate = {
            "renders_at_most": self.renders,
            "predictions_at_most": self.predictions,
            "seconds": round(self.seconds, 1),
        }
        record = {**asdict(self), "estimate": estimate}
        return json.dumps(record, indent=1, ensure_ascii=False)

    def _format_cost(self) -> str:
        """Upper bounds, in what the lines above count."""
        parts = [pluralize(self.close_ups, "close-up"), pluralize(len(self.needed) + self.pictures, "picture")]
        if self.predictions:
            parts.append(f"{pluralize(self.predictions, 'relief')} estimated from pictures")
        return f"at most {', '.join(parts[:-1])} and {parts[-1]}, about {self.seconds:.0f} s"

    def _format_plot_count(self) -> str:
        if not self.pictures:
            return ""
        return f", and at most {pluralize(self.pictures, 'picture')}, where what it shows is not what it showed"

    def as_text(self) -> str:
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
                f"  {RERUN_MESSAGES[self.again]}: the baked .blend is written anew{self._format_plot_count()}."
            )
        lines += ["Skipped:", *_format_skipped(self.skipped)] if self.skipped else []
        lines += ["Problems:", *(f"  {entry.why}" for entry in self.failed)] if self.failed else []
        lines += ["Notes:", *(f"  {add_option_hint(note)}" for note in self.notes)] if self.notes else []
        return "\n".join(lines) or "Nothing to do."


def _format_route(slot: SlotPlan, predictions: int) -> str:
    said = ""
    if slot.route is Route.PREDICTED:
        said = f", at most {pluralize(predictions, 'close-up')}, {predictions * PREDICTION_SECONDS:.1f} s"
    unless = f"; prior if {slot.unless}" if slot.unless else ""
    return f"    {slot.material or 'no material'}: {slot.route.value} ({slot.why}{unless}){said}"


def _format_skipped(skipped: Sequence[Skipped]) -> list[str]:
    return [f"  {entry.what}: {entry.why}" for entry in skipped]


TOO_COARSE_NOTE = f"its picture shows no waves below {MAX_READABLE_WAVELENGTH_M * 1e3:g} mm, or one colour"


def plan_slots(session: Session, job: StrokeJob) -> tuple[SlotPlan, ...]:
    """Of the slots that the job may touch: all of its object's, or the one that it is to be placed on."""
    plans = plan_object_slots(
        session, find_object(session.scene, job.object_name), "" if job.stroke is None else job.stroke.material
    )
    return tuple(plan for slot, plan in enumerate(plans) if job.slot in (None, slot))


def plan_object_slots(session: Session, obj: Any, material: str = "") -> tuple[SlotPlan, ...]:
    """Of every slot of an object. material: that a stroke itself asks for.

    A slot with a picture may still come out prior, where the picture turns out to be too coarse or of one colour.
    """
    facts = session.get_facts(obj)
    why = (
        f"no relief, but splats of {facts.splat_source} show it"
        if facts.splat_source
        else "no relief, but its colour varies"
    )
    return tuple(
        _plan_slot(
            facts.materials[slot], shown, chosen, session.predictor.missing_reason, why, facts.direct_images[slot]
        )
        for slot, (shown, chosen) in enumerate(session.get_relief_outlook(obj, material))
    )


def _plan_slot(
    material: str, relief_source: ReliefSource, chosen: bool, missing: str, evidence: str, direct_image: bool
) -> SlotPlan:
    """seen: what there is to estimate a relief from. plainly: its relief is read off images as they are."""
    if relief_source is ReliefSource.RELIEF:
        seconds = IMAGE_CLOSEUP_SECONDS if direct_image else PROCEDURAL_CLOSEUP_SECONDS
        return SlotPlan(material, Route.MEASURED, "from the bump, normal or displacement in its shader", seconds)
    if relief_source is ReliefSource.VARYING_COLOUR and not chosen:
        if missing:
            return SlotPlan(material, Route.PRIOR, missing)
        return SlotPlan(material, Route.PREDICTED, evidence, unless=TOO_COARSE_NOTE)
    if chosen:
        skipped = "; its picture is skipped" if relief_source is ReliefSource.VARYING_COLOUR else ""
        return SlotPlan(material, Route.PRIOR, f"{CHOSEN_BY_ARTIST}{skipped}")
    return SlotPlan(material, Route.PRIOR, "its shader has neither relief nor picture")


def describe_shader_reliefs(session: Session, found: GatheredJobs) -> list[str]:
    """Of the materials named on the command line, what a shader's own relief leaves of them: one line a slot."""
    notes = []
    for name in dict.fromkeys(job.object_name for job in found.jobs):
        obj, choices = find_object(session.scene, name), session.get_choices(name)
        facts = session.get_facts(obj)
        for slot, (material, shown) in enumerate(zip(facts.materials, facts.relief_sources, strict=True)):
            library = choices.get(slot) or choices.get(None)
            if library and shown is ReliefSource.RELIEF:
                notes.append(
                    f"material '{material}' on '{name}': the relief of its shader is kept; {library} gives friction, "
                    "stiffness and the bands that this relief does not show."
                )
    return notes


def make_plan(session: Session, found: GatheredJobs, previous: PreviousRun, source: str) -> Plan:
    """Nothing is rendered and no ray is cast for it. source: hash of the scene's file."""
    needed, fresh = [], []
    known = previous.find_fresh(found.jobs, session.request.out)
    for job in found.jobs:
        if job.name in known:
            fresh.append(UpToDate(job.name, job.object_name, known[job.name].wav))
            continue
        length = TYPICAL_PATH_M if job.stroke is None else job.stroke.length_m
        slots = session.get_facts(find_object(session.scene, job.object_name)).materials
        shader = slots[job.slot] if job.slot is not None and job.slot < len(slots) else ", ".join(slots)
        why = "changed since the last run" if previous.has_name(job.name) else "not baked yet"
        routes = plan_slots(session, job)
        needed.append(PlannedBake(job.name, job.object_name, shader, estimate_max_patches(length), why, routes))
    folder, again = session.request.out, RerunReason.NOTHING
    if fresh and folder is not None:
        again = previous.get_rerun_reason(found.jobs, source, folder / get_blend_name(session))
    # Of the same file, only a picture of which nobody knows what it shows may be another.
    pictures = sum(previous.source != source or not entry.picture_key for entry in known.values())
    return Plan(
        tuple(needed), tuple(fresh), tuple(found.skipped), tuple(found.failed), tuple(found.notes), pictures=pictures,
        again=again,
    )  # fmt: skip


def get_blend_name(session: Session) -> str:
    source = get_scene_path(session.request)
    return f"{source.stem}_touched.blend"


def get_scene_path(request: TouchRequest) -> Path:
    import bpy

    return request.scene if request.scene is not None else Path(bpy.data.filepath)
