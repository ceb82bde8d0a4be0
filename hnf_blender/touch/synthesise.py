"""A generator of steps, told otherwise.

One stroke: contacts → patches → materials → u(t) → field → signal.

Strokes one after the other, described and handed on: what the command line, a window's child process and its twin in
line have in common.
"""

from __future__ import annotations

import contextlib
import time
import traceback
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.action import Action
from hnf_core.action.contacts import Contacts, find_contacts, require_contact
from hnf_core.action.patches import action_from_contacts, plan_patches
from hnf_core.errors import HnfError
from hnf_core.field.field import Field
from hnf_core.field.height_profile import build_stroke_profile
from hnf_core.field.stroke import StrokeInput
from hnf_core.field.synthesis import synthesise_by_field
from hnf_core.material.fuse import BAND_COUNT, FusedToken, format_routes, fuse
from hnf_core.progress import Progress
from hnf_core.scene.patch import Patch
from hnf_core.signal import Signal
from hnf_core.threads import single_blas_thread

from ..bridge.render.unlit_image import UnlitImage
from ..bridge.scene.scene_names import find_object
from ..bridge.stroke.read_stroke import SceneStroke
from .bake_patches import (
    ReliefPredictor,
    TouchedObject,
    bake_patches,
    explain_skipped,
    get_encoder_name,
    get_map_source,
    get_token,
    is_too_coarse,
)
from .material_choice import MaterialRequest, SlotMaterial, decide_material, find_chosen_material, format_guess_note
from .patch_cache import PatchRecord
from .report import Counts, Failed, Report
from .session import Session, StrokeJob

Step = TypeVar("Step")
Mapped = TypeVar("Mapped")
Result = TypeVar("Result")


def map_steps(
    steps: Generator[Step, None, Result], convert: Callable[[Step], Mapped]
) -> Generator[Mapped, None, Result]:
    """tell() of each step; what steps returns in the end. Closes steps however it ends."""
    with contextlib.closing(steps):
        while True:
            try:
                step = next(steps)
            except StopIteration as finished:
                return finished.value  # type: ignore[no-any-return]  # what the generator declares
            yield convert(step)


USUAL_HEIGHT_RANGE_M = (0.5e-6, 2e-3)
"""Peak-to-peak heights outside this are most likely an artist's slip, or a bump made for looks."""
FACT_NAMES = ("object", "material", "library_material", "routes", "height_source")
"""What signal_facts tells, in the order in which every file tells it."""
MECHANICAL_PROPERTY_COUNT = 3
"""Stiffness, damping, friction."""


@dataclass(frozen=True)
class BakedStroke:
    """A stroke on its surface, described: everything the field needs, nothing heard yet.

    records, fused: per patch. patch_index: (n,) int32, −1 off the surface. materials: by slot. unread: why pictures
    that could tell of a relief were not read.
    """

    stroke: SceneStroke
    touched: TouchedObject
    contacts: Contacts
    patches: tuple[Patch, ...]
    patch_index: NDArray[np.int32]
    records: tuple[PatchRecord, ...]
    fused: tuple[FusedToken, ...]
    materials: Mapping[int, SlotMaterial]
    skip_reasons: tuple[str, ...] = ()

    @property
    def main_patch(self) -> int:
        """The patch that the most samples touch."""
        return int(np.bincount(self.patch_index[self.patch_index >= 0]).argmax())

    @property
    def main_material(self) -> SlotMaterial:
        return self.materials[self.patches[self.main_patch].slot]

    @property
    def notes(self) -> tuple[str, ...]:
        own = list(self.stroke.notes) + list(self.touched.surface.notes)
        for record in self.records:
            own += record.notes
        own += [*self._relief_notes(), *self._learned_notes(), *self._guess_notes(), *self.skip_reasons]
        off = float(np.mean(~self.contacts.on_surface))
        if off > 0.0:
            own.append(f"stroke '{self.stroke.name}': {off:.0%} of its time it is off the surface and silent.")
        if not self.contacts.uv_known[self.contacts.on_surface].all():
            own.append(
                f"object '{self.stroke.object_name}' has no usable UVs under stroke '{self.stroke.name}': directions "
                "are counted from the object's own axes."
            )
        return tuple(dict.fromkeys(own))

    def _guess_notes(self) -> list[str]:
        told = (format_guess_note(each, self.stroke.object_name) for each in self.materials.values())
        return [note for note in told if note]

    def _learned_notes(self) -> list[str]:
        return [
            f"material '{each.shader}' was learned ({each.field.metadata.get('licence', '')}): "
            "its shader's relief is not felt on top of it."
            for each in self.materials.values()
            if each.field is not None
        ]

    def _relief_notes(self) -> list[str]:
        """One line a material, of its tallest patch: each patch has its own figure, and ten lines say no more."""
        tallest: dict[str, float] = {}
        for patch, record in zip(self.patches, self.records, strict=True):
            shader = self.materials[patch.slot].shader
            tallest[shader] = max(tallest.get(shader, 0.0), record.height_peak_to_peak_m)
        return [
            f"material '{shader}': its relief is {height * 1e3:.3g} mm from top to bottom; "
            f"{USUAL_HEIGHT_RANGE_M[0] * 1e3:g}–{USUAL_HEIGHT_RANGE_M[1] * 1e3:g} mm is usual. Check the Distance, "
            f"Strength or "
            "Scale of its bump, and the scene's unit scale."
            for shader, height in tallest.items()
            if height > 0.0 and not USUAL_HEIGHT_RANGE_M[0] <= height <= USUAL_HEIGHT_RANGE_M[1]
        ]


@dataclass(frozen=True)
class SynthesisedStroke:
    """What a stroke gives. stroke: what synthesis was given. confidence: 0–1, of material and synthesis together.
    warnings: what lowered the synthesis's own."""

    stroke: StrokeInput
    signal: Signal
    confidence: float
    warnings: tuple[str, ...]

    @property
    def action(self) -> Action:
        return self.stroke.action


def bake_stroke_steps(
    stroke: SceneStroke,
    touched: TouchedObject,
    choices: Mapping[int | None, str],
    folder: Path,
    counts: Counts,
    predictor: ReliefPredictor,
) -> Generator[float, None, BakedStroke]:
    """Where and what a stroke touches. choices: slot (None = any) → library material named on the command line.

    Yields which share of its patches is done. Raises StrokeError where the stroke touches nothing, or never with
    force; MaterialError, before anything is rendered, where the artist names a material that does not exist.
    """
    where = f"stroke '{stroke.name}'"
    contacts = find_contacts(stroke.samples, stroke.get_surface(touched.surface.mesh), where=where)
    counts.rays += len(stroke.samples.time)
    require_contact(contacts, where=where, surface=stroke.object_name)
    patches, patch_index = plan_patches(contacts)
    slots = dict.fromkeys(patch.slot for patch in patches)
    asked = MaterialRequest(choices, stroke.material, where)
    chosen = {slot for slot in slots if find_chosen_material(touched, slot, asked) is not None}
    records = yield from bake_patches(touched, patches, folder, counts, predictor, chosen)
    materials = {}
    for slot in slots:
        own = [record for patch, record in zip(patches, records, strict=True) if patch.slot == slot]
        materials[slot] = decide_material(touched, slot, asked, own)
    fused = tuple(
        fuse(get_token(record), materials[patch.slot].library.token, materials[patch.slot].confidence, record.route)
        for patch, record in zip(patches, records, strict=True)
    )
    unread = {
        f"material '{materials[slot].shader}': {predictor.missing_reason or explain_skipped(look)}."
        for slot in materials.keys() - chosen
        for look in _select_skipped_images(
            record.unlit
            for patch, record in zip(patches, records, strict=True)
            if patch.slot == slot and record.unlit is not None and record.predicted is None
        )
    }
    return BakedStroke(
        stroke, touched, contacts, patches, patch_index, records, fused, materials, tuple(sorted(unread))
    )


def _select_skipped_images(unlit_images: Iterable[UnlitImage]) -> list[UnlitImage]:
    """Of the unread looks of a material, one for each reason and source: of those that are too coarse the finest, for
    patches of splats have a figure each, and ten lines say no more."""
    told: dict[tuple[bool, str], UnlitImage] = {}
    for look in unlit_images:
        kind = (is_too_coarse(look), look.source)
        if kind not in told or look.resolved_wavelength_m < told[kind].resolved_wavelength_m:
            told[kind] = look
    return list(told.values())


def drop_maps(baked: BakedStroke) -> BakedStroke:
    """What its faces' tokens follow from, and none of the maps and pictures that led there: a thousand strokes' would
    fill the memory."""
    none = np.zeros((0, 0), dtype=np.bool_)
    records = tuple(
        replace(record, height=None, mask=none, unlit=None, predicted=None, encoder=get_encoder_name(record))
        for record in baked.records
    )
    return replace(baked, records=records)


def synthesise_stroke(baked: BakedStroke, field: Field, seed: int, counts: Counts) -> SynthesisedStroke:
    """Synthesise a baked stroke. counts grows by one F_Θ call."""
    given = make_stroke_input(baked)
    counts.network_calls += 1
    made = synthesise_by_field(field, given, seed=seed)
    share = compute_mean_share(compute_known_shares(baked), baked.patch_index)
    return SynthesisedStroke(given, made.signal, share * made.confidence, made.warnings)


def make_stroke_input(baked: BakedStroke) -> StrokeInput:
    """What the field is asked about a baked stroke: one token and one mechanics per patch, and the field that its
    material brings. The height under the path is that of measured maps alone: a predicted one has the right texture,
    not the right place of every grain."""
    action = action_from_contacts(baked.contacts, baked.patches, baked.patch_index, baked.stroke.probe)
    profile = build_stroke_profile(
        action.position, baked.contacts.point, baked.patch_index, baked.patches, baked.records
    )
    if profile is not None:
        # Its maps are float32: more digits would say nothing, and a stored stroke would be twice as large.
        profile = replace(profile, height=profile.height.astype(np.float32).astype(np.float64))
    brought = tuple(baked.materials[patch.slot].field for patch in baked.patches)
    return StrokeInput(
        action=action,
        tokens=np.stack([fused.values for fused in baked.fused]).astype(np.float32),
        mechanics=tuple(baked.materials[patch.slot].library.mechanics for patch in baked.patches),
        token_index=_extend_patch_index(baked.patch_index),
        profile=profile,
        fields=() if all(each is None for each in brought) else brought,
    )


def compute_known_shares(baked: BakedStroke) -> NDArray[np.float64]:
    """(M,) how far the field's condition is known on each patch, 0–1: the seven bands of the texture by their routes,
    and the three mechanical properties, which no picture shows, by the confidence in the library material."""
    guess = [baked.materials[patch.slot].confidence for patch in baked.patches]
    return np.array([
        (BAND_COUNT * fused.confidence + MECHANICAL_PROPERTY_COUNT * sure) / (BAND_COUNT + MECHANICAL_PROPERTY_COUNT)
        for fused, sure in zip(baked.fused, guess, strict=True)
    ])  # fmt: skip


def compute_mean_share(shares: NDArray[np.float64], patch_index: NDArray[np.int32]) -> float:
    """Mean of known_shares (M,) over touch time. patch_index: (n,), −1 where nothing is touched."""
    touched = np.bincount(patch_index[patch_index >= 0], minlength=len(shares))
    return float(np.average(shares, weights=touched))


def get_signal_facts(baked: BakedStroke) -> dict[str, str]:
    """What a WAV says of where its signal comes from, apart from the stroke's own name and its confidence."""
    patch = baked.main_patch
    return {
        "object": baked.stroke.object_name,
        "material": baked.main_material.shader,
        "library_material": ", ".join(dict.fromkeys(entry.library.name for entry in baked.materials.values())),
        "routes": format_routes(baked.fused[patch].routes),
        "height_source": get_map_source(baked.records[patch]),
    }


def add_provenance(signal: Signal, name: str, facts: Mapping[str, str], confidence: float) -> Signal:
    """The signal with its origin written on it, as every WAV of a stroke has it. facts: of signal_facts."""
    told = {fact: facts[fact] for fact in FACT_NAMES if fact in facts}
    origin = {**signal.provenance, "stroke": name, **told, "confidence": f"{confidence:.3f}"}
    return replace(signal, provenance=origin)


def _extend_patch_index(index: NDArray[np.int32]) -> NDArray[np.int32]:
    """Off the surface the last touched patch goes on, before the first touch the first one."""
    good = np.flatnonzero(index >= 0)
    at = np.clip(np.searchsorted(good, np.arange(len(index)), side="right") - 1, 0, None)
    return np.asarray(index[good[at]], dtype=np.int32)


CACHE_FOLDER_NAME = "cache"
"""Of the folder of patches beside a run's results."""
OnStroke = Callable[[StrokeJob, BakedStroke], Iterable[str]]
"""What to do with a described stroke; gives the name of each stage before it begins."""


def bake_steps(
    session: Session, jobs: Sequence[StrokeJob], cache: Path, report: Report, on_stroke: OnStroke
) -> Generator[Progress, None, tuple[BakedStroke, ...]]:
    """Bake every job and hand it to each; one that fails is named in the report and does not cost the others.

    cache: folder of the patches' records. report: its failed, warnings, counts and timings grow. Yields before each
    stage; the last one, "saving", is the caller's, who gets all that could be described, without their maps.
    """
    baked: list[BakedStroke] = []
    total = len(jobs) + 1
    for done, job in enumerate(jobs):
        yield Progress(job.name, done, total)
        try:
            with record_time(report, "bake_s"), single_blas_thread():  # Cycles and rays have both cores to fill
                described = yield from map_steps(
                    _bake_job_steps(session, job, cache, report),
                    partial(_closeup_progress, job.name, done, total),
                )
            baked.append(drop_maps(described))
            for stage in on_stroke(job, described):
                yield Progress(f"{job.name}: {stage}", done, total, 0.9)
        except HnfError as error:
            report.failed.append(Failed(job.name, str(error)))
        except KeyboardInterrupt:
            report.failed += [Failed(left.name, "stopped before it was finished.") for left in jobs[done:]]
            raise
        except Exception as error:  # a fault of ours: the other strokes are still delivered
            traceback.print_exc()
            report.failed.append(Failed(job.name, f"{job.name}: internal error ({error!r}). Please report it."))
    yield Progress("saving", total - 1, total)
    return tuple(baked)


def _closeup_progress(name: str, done: int, total: int, share: float) -> Progress:
    """The share of one stroke's patches that is done, as a share of the whole."""
    return Progress(f"{name}: close-ups", done, total, 0.9 * share)


@contextlib.contextmanager
def record_time(report: Report, name: str) -> Iterator[None]:
    """Adds what the block takes to report.timings."""
    start = time.monotonic()
    try:
        yield
    finally:
        report.timings[name] = round(report.timings.get(name, 0.0) + time.monotonic() - start, 3)


def _bake_job_steps(
    session: Session, job: StrokeJob, cache: Path, report: Report
) -> Generator[float, None, BakedStroke]:
    stroke = job.stroke
    if stroke is None:
        with record_time(report, "place_s"):
            curve = session.place_stroke(find_object(session.scene, job.object_name), job, report.counts)
        stroke = session.read_stroke(curve)
    touched = session.get_touched_object(find_object(session.scene, stroke.object_name))
    choices = session.get_choices(stroke.object_name)
    described = yield from bake_stroke_steps(stroke, touched, choices, cache, report.counts, session.predictor)
    for note in described.notes:
        report.add_warning(note)
    return described
