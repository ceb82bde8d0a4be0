"""Synthesize strokes: contacts → patches → materials and tokens → action and height profile → field → signal.

Patches are squares of surface, tokens describe their micro-geometry, the action is direction, speed and force over
time, and the field is the network that gives the vibration. `bake_strokes` bakes the strokes of a session one after the
other; the command line and Blender's worker process share it. `synthesise_stroke` turns a baked stroke into a signal.
"""

from __future__ import annotations

import contextlib
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.action import Action
from hnf_core.action.contacts import Contacts, action_from_contacts, find_contacts, plan_patches, require_contact
from hnf_core.action.crossing import choose_objects, find_seams, join_contacts, move_contacts, move_patch
from hnf_core.errors import HnfError
from hnf_core.field.field import Field
from hnf_core.field.height_profile import add_seams, build_stroke_profile
from hnf_core.field.stroke import StrokeInput
from hnf_core.field.synthesis import synthesise_by_field
from hnf_core.material.fuse import BAND_COUNT, LOUD_ESTIMATE_M_S2, LOUDEST_M_S2, estimate_loudness, format_routes
from hnf_core.material.hnf_file import MaterialFile
from hnf_core.progress import Cancelled, Progress, ProgressCallback, ignore_progress, nest_progress
from hnf_core.scene.camera import Patch
from hnf_core.signal import Signal
from hnf_core.tactile.tactile_map import Route
from hnf_core.threads import single_blas_thread

from ..bridge.cycles import UnlitImage
from ..bridge.scene.scene_names import find_object
from ..bridge.stroke.read_stroke import SceneStroke
from .bake_patches import (
    CLOSEUP_STAGE,
    ReliefPredictor,
    TouchedObject,
    bake_patches,
    explain_skipped,
    get_encoder_name,
    get_map_source,
    get_shader_token,
    is_too_coarse,
)
from .baked_stroke import BakedStroke, find_tallest
from .material_choice import (
    TOO_LOUD_DOUBT,
    MaterialRequest,
    SlotMaterial,
    find_chosen_material,
    format_likely,
    format_own_relief_note,
    fuse_record,
    get_shader_name,
    settle_slot,
)
from .patch_cache import PatchRecord
from .report import Counts, Failed, Report
from .session import Session, StrokeJob

FACT_NAMES = ("object", "objects", "material", "library_material", "routes", "height_source")
"""Names of the facts that `get_signal_facts` returns, in the order in which files list them."""
DOUBTED_FACT = "height_doubted"
"""Name of the fact with the Blender materials, one a line, whose relief has the height of the library material."""
LIKELY_FACT = "likely"
"""Name of the fact with what the main material could be, where one alone is not felt."""
MECHANICAL_PROPERTY_COUNT = 3
"""Number of mechanical properties: stiffness, damping, friction."""


@dataclass(frozen=True)
class SynthesisedStroke:
    """Synthesized signal of a stroke.

    Attributes
    ----------
    stroke : StrokeInput
        Input of the synthesis.
    signal : Signal
    confidence : float
        Confidence of material and synthesis together, 0 to 1.
    warnings : tuple of str
        Reasons for a lower confidence of the synthesis.
    """

    stroke: StrokeInput
    signal: Signal
    confidence: float
    warnings: tuple[str, ...]

    @property
    def action(self) -> Action:
        """Direction, speed and force of the stroke over time."""
        return self.stroke.action


def bake_stroke(
    stroke: SceneStroke,
    touched: TouchedObject,
    choices: Mapping[int | None, str | MaterialFile],
    folder: Path,
    counts: Counts,
    predictor: ReliefPredictor,
    progress: ProgressCallback = ignore_progress,
    doubt: str = "",
    crossed: Sequence[tuple[TouchedObject, Mapping[int | None, str | MaterialFile]]] = (),
) -> BakedStroke:
    """Bake one stroke: find its contacts, render its patches, and choose materials and tokens.

    Parameters
    ----------
    stroke : SceneStroke
        Stroke.
    touched : TouchedObject
        Touched object.
    choices : Mapping[int or None, str or MaterialFile]
        Slot (None for any) → library material or content of a file, of the command line.
    folder : Path
        Folder of cached patches.
    counts : Counts
        Counters, which are incremented.
    predictor : ReliefPredictor
        Networks that predict relief.
    progress : ProgressCallback, optional
        Called after each patch.
    doubt : str, optional
        Reason to doubt the height of every relief.
    crossed : sequence of (TouchedObject, Mapping), optional
        The objects of `stroke.crossed`, each with its choices.

    Returns
    -------
    BakedStroke

    Raises
    ------
    StrokeError
        If the stroke touches nothing, or never with force.
    MaterialError
        If a chosen material does not exist; raised before anything is rendered.
    """
    where = f"stroke '{stroke.name}'"
    objects = [(touched, choices), *crossed]
    parts, contacts = _find_parts(stroke, [each for each, _ in objects], counts, where)
    requests = [MaterialRequest(each, stroke.material, where) for _, each in objects]
    chosen = [
        {
            slot
            for slot in dict.fromkeys(patch.slot for patch in patches)
            if find_chosen_material(each, slot, request) is not None
        }
        for (each, _), (patches, _), request in zip(objects, parts, requests, strict=True)
    ]
    baked = BakedStroke(
        stroke, touched, contacts, (), np.full(len(stroke.samples.time), -1, dtype=np.int32), (), (), (),
        others=tuple(each for each, _ in crossed),
    )  # fmt: skip
    for number, ((each, _), (patches, index)) in enumerate(zip(objects, parts, strict=True)):
        if patches:
            nested = nest_progress(progress, CLOSEUP_STAGE, number, len(objects)) if crossed else progress
            records = bake_patches(each, patches, folder, counts, predictor, chosen[number], nested)
            part = _settle_part(each, patches, records, requests[number], chosen[number], predictor, doubt)
            baked = _add_part(baked, part, index, number)
    return baked


def _find_parts(
    stroke: SceneStroke, objects: Sequence[TouchedObject], counts: Counts, where: str
) -> tuple[list[tuple[tuple[Patch, ...], NDArray[np.int32]]], Contacts]:
    """Return the patches of a stroke on each object with the patch of each sample, and the joined contacts.

    Patches are in the frame of their object, contacts in that of the first. Raises StrokeError if none is touched.
    """
    found = [find_contacts(stroke.samples, stroke.get_surface(objects[0].surface.mesh), where=where)]
    for crossed, each in zip(stroke.crossed, objects[1:], strict=True):
        found.append(find_contacts(crossed.move_samples(stroke.samples), each.surface.mesh, where=where))
    counts.add("rays", len(stroke.samples.time) * len(found))
    if len(found) == 1:
        require_contact(found[0], where=where, surface=stroke.object_name)
        return [plan_patches(found[0])], found[0]
    owner = choose_objects(np.stack([contacts.distance for contacts in found]))
    contacts = join_contacts(
        [
            found[0],
            *(move_contacts(each, crossed.frame) for crossed, each in zip(stroke.crossed, found[1:], strict=True)),
        ],
        owner,
    )
    require_contact(contacts, where=where, surface=stroke.object_name)
    parts = [
        plan_patches(replace(each, on_surface=each.on_surface & (owner == number))) for number, each in enumerate(found)
    ]
    return parts, contacts


@dataclass(frozen=True)
class _Part:
    """Results of a stroke's bake on one object, for each of its patches, and why no relief was predicted."""

    patches: tuple[Patch, ...]
    records: tuple[PatchRecord, ...]
    materials: tuple[SlotMaterial, ...]
    skip_reasons: set[str]
    authored: tuple[PatchRecord, ...]


def _settle_part(
    touched: TouchedObject,
    patches: tuple[Patch, ...],
    records: tuple[PatchRecord, ...],
    request: MaterialRequest,
    chosen_slots: set[int],
    predictor: ReliefPredictor,
    doubt: str,
) -> _Part:
    """Decide the materials of an object's patches and the heights of their relief."""
    material_by_patch: dict[int, SlotMaterial] = {}
    settled = list(records)
    for slot, indices in _group_patches(touched, patches):
        material, part_records = settle_slot(
            touched, slot, request, [records[index] for index in indices], predictor.measured_encoder, doubt
        )
        for index, record in zip(indices, part_records, strict=True):
            material_by_patch[index], settled[index] = material, record
    skip_reasons = {
        f"material '{get_shader_name(touched, slot)}': {predictor.missing_reason or explain_skipped(unlit)}."
        for slot in {patch.slot for patch in patches} - chosen_slots
        for unlit in _select_skipped_images(
            record.unlit
            for patch, record in zip(patches, settled, strict=True)
            if patch.slot == slot and record.unlit is not None and record.predicted is None
        )
    }
    materials = tuple(material_by_patch[index] for index in range(len(patches)))
    return _Part(patches, tuple(settled), materials, skip_reasons, records)


def _add_part(baked: BakedStroke, part: _Part, index: NDArray[np.int32], number: int) -> BakedStroke:
    """Return a baked stroke with its part on one more object, the `number`-th; `index` (n,) is that of its patches."""
    patches, crossed = part.patches, baked.stroke.crossed
    if number:
        patches = tuple(move_patch(patch, crossed[number - 1].frame) for patch in patches)
    heights = find_tallest([(number, patch.slot) for patch in patches], part.authored)
    return replace(
        baked,
        patches=baked.patches + patches,
        patch_index=np.where(index >= 0, index + np.int32(len(baked.patches)), baked.patch_index).astype(np.int32),
        records=baked.records + part.records,
        fused=baked.fused
        + tuple(fuse_record(record, each) for record, each in zip(part.records, part.materials, strict=True)),
        materials=baked.materials + part.materials,
        skip_reasons=tuple(sorted({*baked.skip_reasons, *part.skip_reasons})),
        authored_heights_m={**baked.authored_heights_m, **heights},
        owners=baked.owners + (number,) * len(patches) if crossed else (),
    )


def _group_patches(touched: TouchedObject, patches: Sequence[Patch]) -> list[tuple[int, list[int]]]:
    """Return (slot, patches' indices) of what is one material: the patches of a slot; each by itself if from splats.

    A slot of a shader is one material. A reconstruction has one slot for all that was photographed.
    """
    groups: dict[tuple[int, int], list[int]] = {}
    for index, patch in enumerate(patches):
        groups.setdefault((patch.slot, index if touched.uses_splats(patch.slot) else -1), []).append(index)
    return [(slot, indices) for (slot, _), indices in groups.items()]


def may_be_loud(baked: BakedStroke) -> bool:
    """Return True if a measured relief may shake the pen too much under some force; few surfaces are so high."""
    speed = float(np.linalg.norm(baked.contacts.velocity, axis=-1).max(initial=0.0))
    return any(
        record.height is not None and estimate_loudness(fused.values, speed) > LOUD_ESTIMATE_M_S2
        for record, fused in zip(baked.records, baked.fused, strict=True)
    )


def is_loud(baked: BakedStroke, field: Field, seed: int) -> bool:
    """Return True if a stroke shakes the pen more than any surface can (`LOUDEST_M_S2`)."""
    return synthesise_by_field(field, make_stroke_input(baked), seed=seed).signal.rms > LOUDEST_M_S2


def _select_skipped_images(unlit_images: Iterable[UnlitImage]) -> list[UnlitImage]:
    """Return one unlit image for each pair of reason and source for which a relief was not predicted.

    Of those that are too coarse it is the finest, since patches of splats all differ in resolution.
    """
    selected: dict[tuple[bool, str], UnlitImage] = {}
    for unlit in unlit_images:
        kind = (is_too_coarse(unlit), unlit.source)
        if kind not in selected or unlit.resolved_wavelength_m < selected[kind].resolved_wavelength_m:
            selected[kind] = unlit
    return list(selected.values())


def drop_maps(baked: BakedStroke) -> BakedStroke:
    """Return a baked stroke without height maps and images, which for a thousand strokes would fill the memory."""
    none = np.zeros((0, 0), dtype=np.bool_)
    records = tuple(
        replace(record, height=None, mask=none, unlit=None, predicted=None, encoder=get_encoder_name(record))
        for record in baked.records
    )
    return replace(baked, records=records, alternative=None)


def synthesise_stroke(baked: BakedStroke, field: Field, seed: int, counts: Counts) -> SynthesisedStroke:
    """Synthesize the signal of a baked stroke; increments `counts.network_calls`.

    `field` is used unless a learned material has a field of its own; `seed` is that of the noise.
    """
    stroke_input = make_stroke_input(baked)
    counts.add("network_calls")
    result = synthesise_by_field(field, stroke_input, seed=seed)
    known_fraction = compute_mean_share(compute_known_shares(baked), baked.patch_index)
    return SynthesisedStroke(stroke_input, result.signal, known_fraction * result.confidence, result.warnings)


def make_stroke_input(baked: BakedStroke) -> StrokeInput:
    """Make the input of the field: the action, and for each patch token, mechanics and the field of a learned material.

    The height profile under the path uses measured maps only: a predicted map has the right texture, but not the true
    position of each detail.
    """
    action = action_from_contacts(baked.contacts, baked.patches, baked.patch_index, baked.stroke.probe)
    profile = build_stroke_profile(
        action.position, baked.contacts.point, baked.patch_index, baked.patches, baked.records
    )
    if baked.owners:
        profile = add_seams(profile, find_seams(baked.contacts, baked.sample_owners), action.position)
    if profile is not None:
        # Its maps are float32: more digits are meaningless, and would double the size of a stored stroke.
        seam = None if profile.seam is None else _round_to_float32(profile.seam)
        profile = replace(profile, height=_round_to_float32(profile.height), seam=seam)
    fields = tuple(material.field for material in baked.materials)
    return StrokeInput(
        action=action,
        tokens=np.stack([fused.values for fused in baked.fused]).astype(np.float32),
        mechanics=tuple(material.library.mechanics for material in baked.materials),
        token_index=_extend_patch_index(baked.patch_index),
        profile=profile,
        fields=() if all(field is None for field in fields) else fields,
    )


def _round_to_float32(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return values.astype(np.float32).astype(np.float64)


def compute_known_shares(baked: BakedStroke) -> NDArray[np.float64]:
    """Return, for each patch, which fraction of what the field is given is known (M,), 0 to 1.

    The seven bands of the token count as measured, predicted or prior; the three mechanical properties, which no image
    shows, count with the confidence in the library material.
    """
    total = BAND_COUNT + MECHANICAL_PROPERTY_COUNT
    return np.array([
        (BAND_COUNT * fused.confidence + MECHANICAL_PROPERTY_COUNT * material.confidence) / total
        for fused, material in zip(baked.fused, baked.materials, strict=True)
    ])  # fmt: skip


def compute_mean_share(shares: NDArray[np.float64], patch_index: NDArray[np.int32]) -> float:
    """Return the mean known fraction over the time of contact, from that of each patch (M,).

    `patch_index` (n,) is the patch of each action sample, −1 without contact.
    """
    touched = np.bincount(patch_index[patch_index >= 0], minlength=len(shares))
    return float(np.average(shares, weights=touched))


def get_signal_facts(baked: BakedStroke) -> dict[str, str]:
    """Return the provenance of a signal, apart from the stroke's name and the confidence."""
    patch = baked.main_patch
    doubted = "\n".join(dict.fromkeys(entry.shader for entry in baked.materials if entry.doubt))
    touched = [baked.object_names[number] for number in dict.fromkeys(baked.sample_owners.tolist()) if number >= 0]
    return {
        "object": baked.stroke.object_name,
        **({"objects": ", ".join(touched)} if len(touched) > 1 else {}),
        "material": baked.main_material.shader,
        "library_material": ", ".join(dict.fromkeys(entry.library.name for entry in baked.materials)),
        "routes": format_routes(baked.main_routes, baked.records[patch].mesh_bands),
        "height_source": get_map_source(baked.records[patch]),
        **({DOUBTED_FACT: doubted} if doubted else {}),
        **({LIKELY_FACT: likely} if (likely := format_likely(baked.main_material)) else {}),
    }


def add_provenance(signal: Signal, name: str, facts: Mapping[str, str], confidence: float) -> Signal:
    """Return a signal with the provenance of a stroke; `facts` are those of `get_signal_facts`."""
    ordered_facts = {fact: facts[fact] for fact in FACT_NAMES if fact in facts}
    provenance = {**signal.provenance, "stroke": name, **ordered_facts, "confidence": f"{confidence:.3f}"}
    return replace(signal, provenance=provenance)


def _extend_patch_index(index: NDArray[np.int32]) -> NDArray[np.int32]:
    """Replace −1 in patch indices (n,) by the last touched patch, before the first contact by the first one."""
    touching = np.flatnonzero(index >= 0)
    last = np.clip(np.searchsorted(touching, np.arange(len(index)), side="right") - 1, 0, None)
    return np.asarray(index[touching[last]], dtype=np.int32)


OnStroke = Callable[[StrokeJob, BakedStroke, Callable[[str], None]], None]
"""Function that processes a baked stroke; it calls its third argument with the name of each stage before it begins."""
BAKE_SHARE = 0.9
"""Fraction of a stroke's time, in reports of progress, that its bake takes."""


def bake_strokes(
    session: Session,
    jobs: Sequence[StrokeJob],
    cache: Path,
    report: Report,
    on_stroke: OnStroke,
    progress: ProgressCallback = ignore_progress,
    *,
    with_alternatives: bool = False,
) -> tuple[BakedStroke, ...]:
    """Bake every job (stroke to compute) and pass it to `on_stroke`.

    A job that fails is listed in the report; the others are still baked. The last stage, "saving", is left to the
    caller.

    Parameters
    ----------
    session : Session
        Session of the scene.
    jobs : sequence of StrokeJob
        Strokes to bake.
    cache : Path
        Folder of cached patches.
    report : Report
        Its failures, warnings, counts and timings are extended.
    on_stroke : callable
        Processes a baked stroke.
    progress : ProgressCallback, optional
        Called before each stroke, patch and stage.
    with_alternatives : bool, optional
        Also bake the other heights where the force decides between them, so that another force needs no bake.

    Returns
    -------
    tuple of BakedStroke
        All strokes baked, without their maps.
    """
    baked_strokes: list[BakedStroke] = []
    total = len(jobs) + 1
    for done, job in enumerate(jobs):
        progress(Progress(job.name, done, total))
        closeup_progress = nest_progress(progress, f"{job.name}: {CLOSEUP_STAGE}", done, total, BAKE_SHARE)

        def start_stage(stage: str, name: str = job.name, done: int = done) -> None:
            progress(Progress(f"{name}: {stage}", done, total, BAKE_SHARE))

        try:
            with record_time(report, "bake_s"), single_blas_thread():  # leaves all cores to Cycles and ray casts
                baked = _bake_job(session, job, cache, report, closeup_progress, with_alternatives)
            baked_strokes.append(drop_maps(baked))
            on_stroke(job, baked, start_stage)
        except HnfError as error:
            report.failed.append(Failed(job.name, str(error)))
        except (KeyboardInterrupt, Cancelled):
            report.failed += [Failed(left.name, "stopped before it was finished.") for left in jobs[done:]]
            raise
        except Exception as error:  # a programming error: the other strokes are still baked
            traceback.print_exc()
            report.failed.append(Failed(job.name, f"{job.name}: internal error ({error!r}). Please report it."))
    progress(Progress("saving", total - 1, total))
    return tuple(baked_strokes)


@contextlib.contextmanager
def record_time(report: Report, name: str) -> Iterator[None]:
    """Add the duration of the with block [s] to report.timings[name]."""
    start = time.monotonic()
    try:
        yield
    finally:
        report.timings[name] = round(report.timings.get(name, 0.0) + time.monotonic() - start, 3)


def _bake_job(
    session: Session, job: StrokeJob, cache: Path, report: Report, progress: ProgressCallback, with_alternatives: bool
) -> BakedStroke:
    """Bake a job's stroke, which is read from the scene, or placed first if it is a primitive."""
    stroke = job.stroke
    if stroke is None:
        with record_time(report, "place_s"):
            curve = session.place_stroke(find_object(session.scene, job.object_name), job, report.counts)
        stroke = session.read_stroke(curve)
    touched = session.get_touched_object(find_object(session.scene, stroke.object_name))
    choices = session.get_choices(stroke.object_name)
    crossed = [
        (session.get_touched_object(find_object(session.scene, each.name)), session.get_choices(each.name))
        for each in stroke.crossed
    ]
    baked = bake_stroke(stroke, touched, choices, cache, report.counts, session.predictor, progress, crossed=crossed)
    authored = [insists for each in baked.objects for insists in each.heights_as_authored]
    if not all(authored) and may_be_loud(baked):
        loud = is_loud(baked, session.field, job.seed)
        if loud or with_alternatives:
            other = bake_stroke(
                stroke, touched, choices, cache, report.counts, session.predictor, progress, doubt=TOO_LOUD_DOUBT,
                crossed=crossed,
            )  # fmt: skip
            baked, other = (other, baked) if loud else (baked, other)
            baked = replace(baked, alternative=other if with_alternatives else None)
    all_choices = {name: session.get_choices(name) for name in baked.object_names}
    for note in (*_describe_own_reliefs(baked, all_choices), *baked.notes):
        report.add_warning(note)
    return baked


def _describe_own_reliefs(
    baked: BakedStroke, choices: Mapping[str, Mapping[int | None, str | MaterialFile]]
) -> list[str]:
    """Return a note on each slot where a material was given on the command line and the shader's relief is felt.

    `choices` are those of each object by its name.
    """
    notes = []
    for index, (patch, record, fused) in enumerate(zip(baked.patches, baked.records, baked.fused, strict=True)):
        owner = baked.get_owner(index)
        name = baked.object_names[owner]
        choice = choices[name].get(patch.slot) or choices[name].get(None)
        if get_shader_token(record) is None or Route.MEASURED not in fused.routes:
            continue
        if choice and not (isinstance(choice, MaterialFile) and choice.field):
            library = choice.name if isinstance(choice, MaterialFile) else choice
            notes.append(format_own_relief_note(get_shader_name(baked.objects[owner], patch.slot), name, library))
    return list(dict.fromkeys(notes))
