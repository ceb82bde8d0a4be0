"""Write the files of a stroke, its WAV and then its picture, and the baked .blend of a run."""

from __future__ import annotations

import itertools
import re
import unicodedata
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hnf_core.action.contacts import action_from_contacts
from hnf_core.errors import FileError
from hnf_core.export.figure import MapThumbnail, average_squares, choose_thumbnail_step, make_thumbnail
from hnf_core.export.stroke_figure import StrokeView, write_stroke_figure
from hnf_core.export.wav import encode_wav, read_wav
from hnf_core.files import content_hash, write_atomically, write_bytes
from hnf_core.material.fuse import routes_by_band

from ..bridge.scene.temp_scene import suppress_output
from .bake_patches import get_encoder_name, get_resolved_wavelength, get_widest_map
from .baked_stroke import BakedStroke
from .material_choice import SlotMaterial, format_certainty, round_likely
from .patch_cache import PatchRecord
from .report import StrokeReport
from .session import StrokeJob
from .synthesise import (
    SynthesisedStroke,
    add_provenance,
    compute_known_shares,
    compute_mean_share,
    drop_maps,
    get_signal_facts,
)


def write_stroke_wav(
    folder: Path, job: StrokeJob, baked: BakedStroke, synthesised: SynthesisedStroke, used_names: Container[str] = ()
) -> StrokeReport:
    """Write a stroke's WAV, atomically; return its report entry, which names no picture yet.

    Parameters
    ----------
    folder : Path
        Folder of the results.
    job : StrokeJob
        Job of the stroke.
    baked : BakedStroke
        Baked stroke.
    synthesised : SynthesisedStroke
        Its signal.
    used_names : container of str, optional
        WAV files of the run's other strokes.

    Returns
    -------
    StrokeReport
    """
    main, patch = baked.main_material, baked.main_patch
    record = baked.records[patch]
    routes = routes_by_band(baked.main_routes, record.mesh_bands)
    resolved = get_resolved_wavelength(record)
    facts = get_signal_facts(baked)
    library_names = facts["library_material"]
    signal = add_provenance(synthesised.signal, job.name, facts, synthesised.confidence)
    data = encode_wav(signal, where=f"stroke '{job.name}'")
    stem = next(
        candidate for candidate in iter_numbered_stems(make_file_stem(job.name)) if f"{candidate}.wav" not in used_names
    )
    write_bytes(folder / f"{stem}.wav", data)
    return StrokeReport(
        name=job.name,
        object=job.object_name,
        material=main.shader,
        library_material=library_names,
        fields={
            entry.library.name: "shared" if entry.field is None else entry.field.metadata.get("training_data", "own")
            for entry in baked.materials
        },
        routes=routes,
        resolved_wavelength_m=resolved if np.isfinite(resolved) else None,
        height_source=facts["height_source"],
        height_peak_to_peak_m=None if record.height is None else record.height_peak_to_peak_m,
        wav=f"{stem}.wav",
        picture="",
        duration_s=round(signal.duration_s, 6),
        rms_m_s2=signal.rms,
        confidence=round(synthesised.confidence, 4),
        probe=baked.stroke.probe,
        seed=job.seed,
        fresh=False,
        key=job.key,
        wav_hash=content_hash(data),
        warnings=synthesised.warnings,
        encoder=get_encoder_name(record),
        tactile_map_weights="" if record.predicted is None else record.predicted.weights,
        likely=round_likely(main),
        materials=_describe_patches(baked),
        off_surface=round(baked.off_surface, 4),
        objects=_describe_objects(baked, synthesised),
    )


def _describe_patches(baked: BakedStroke) -> list[dict[str, Any]]:
    """Describe what each patch was taken for, in the order in which the stroke touches them, for the report."""
    touched = baked.patch_index[baked.patch_index >= 0]
    return [
        {
            "object": baked.object_names[baked.get_owner(index)],
            "shader": material.shader,
            "library_material": material.library.name,
            "confidence": round(material.confidence, 4),
            "reason": material.reason,
            "likely": round_likely(material),
            "routes": routes_by_band(baked.fused[index].routes, baked.records[index].mesh_bands),
            "time_share": round(float(np.mean(touched == index)), 4),
        }
        for index in dict.fromkeys(touched.tolist())
        for material in [baked.materials[index]]
    ]


def _describe_objects(baked: BakedStroke, synthesised: SynthesisedStroke) -> list[dict[str, Any]]:
    """Describe what was felt of each object, in the order in which the stroke touches them, for the report."""
    owners, shares = baked.sample_owners, compute_known_shares(baked)
    known = compute_mean_share(shares, baked.patch_index)
    described = []
    for owner in dict.fromkeys(owners[owners >= 0].tolist()):
        index = np.where(owners == owner, baked.patch_index, -1).astype(np.int32)
        patch = int(np.bincount(index[index >= 0]).argmax())
        # The synthesis is as certain on one object as on the other; what is known of them differs.
        certainty = synthesised.confidence * compute_mean_share(shares, index) / known if known else 0.0
        described.append({
            "object": baked.object_names[owner],
            "material": baked.materials[patch].shader,
            "library_material": baked.materials[patch].library.name,
            "routes": routes_by_band(baked.get_routes(patch), baked.records[patch].mesh_bands),
            "confidence": round(certainty, 4),
            "tokens": len(np.unique(index[index >= 0])),
            "time_share": round(float(np.mean(owners[owners >= 0] == owner)), 4),
        })  # fmt: skip
    return described


@dataclass(frozen=True)
class PendingPicture:
    """A picture that is not drawn yet, with all of a stroke that it shows besides its view and its WAV.

    Attributes
    ----------
    job : StrokeJob
    baked : BakedStroke
        Baked stroke, which needs no maps any more.
    facts : Mapping[str, str]
        Labeled lines of text.
    tactile : MapThumbnail or None
        Small image of the tactile map; None without a map.
    """

    job: StrokeJob
    baked: BakedStroke
    facts: Mapping[str, str]
    tactile: MapThumbnail | None


def prepare_picture(job: StrokeJob, baked: BakedStroke, confidence: float) -> PendingPicture:
    """Collect what the picture of a stroke shows; `confidence` is that of its signal. Nothing is drawn."""
    record, facts = baked.records[baked.main_patch], get_signal_facts(baked)
    main_slot, main_object = baked.patches[baked.main_patch].slot, baked.objects[baked.get_owner(baked.main_patch)]
    materials = [
        format_material_line(each.stroke.object_name, each.touched_materials) for each in baked.split_by_object()
    ]
    lines = {
        "Material": "; ".join(materials),
        "Routes": facts["routes"],
        "Height": _format_height_line(
            facts["height_source"], get_resolved_wavelength(record), main_object.has_relief_at(main_slot)
        ),
        "Confidence": f"{confidence:.0%} in the whole signal; probe: {baked.stroke.probe}",
    }
    return PendingPicture(job, drop_maps(baked), lines, _make_record_thumbnail(record))


def _make_record_thumbnail(record: PatchRecord) -> MapThumbnail | None:
    """Make the thumbnail of a patch's tactile map; None without a map.

    A height is shrunk before a sensor's image of it is rendered, which takes longer than all else.
    """
    if record.height is None:
        tactile = get_widest_map(record)
        return None if tactile is None else make_thumbnail(tactile)
    side = choose_thumbnail_step(record.mask)
    covered = average_squares(record.mask, side)
    height = average_squares(np.where(record.mask, record.height, 0.0), side) / np.maximum(covered, 1e-9)
    small = replace(
        record, height=height.astype(np.float32), mask=covered > 0.5, metres_per_pixel=side * record.metres_per_pixel
    )
    tactile = get_widest_map(small)
    assert tactile is not None
    width_m = record.height.shape[1] * record.metres_per_pixel  # the thumbnail's lacks what did not fill a square
    return make_thumbnail(replace(tactile, metres_per_pixel=width_m / height.shape[1]))


def write_picture(
    folder: Path, entry: StrokeReport, picture: PendingPicture, view: StrokeView, picture_key: str
) -> StrokeReport:
    """Draw the picture of a stroke beside its WAV, atomically; return its report entry, which names the picture.

    Parameters
    ----------
    folder : Path
        Folder of the results, with the WAV.
    entry : StrokeReport
        Entry of the stroke.
    picture : PendingPicture
        What it shows.
    view : StrokeView
        Rendered view with the path.
    picture_key : str
        Hash of the view.

    Returns
    -------
    StrokeReport
    """
    baked, name = picture.baked, f"{Path(entry.wav).stem}.png"
    write_stroke_figure(
        folder / name,
        title=picture.job.name,
        action=action_from_contacts(baked.contacts, baked.patches, baked.patch_index, baked.stroke.probe),
        signal=read_wav(folder / entry.wav),
        view=view,
        facts=picture.facts,
        tactile=picture.tactile,
    )
    return replace(entry, picture=name, picture_key=picture_key)


def make_file_stem(name: str) -> str:
    """Return a stroke's name as a file name without suffix.

    If characters had to be replaced, four digits of a hash keep it unique.
    """
    ascii_name = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode()
    slug = re.sub(r"[^A-Za-z0-9]+", "-", ascii_name).strip("-").lower()[:60] or "stroke"
    return f"{slug}-{content_hash(name)[:4]}" if slug != name.lower().replace(" ", "-") else slug


def iter_numbered_stems(stem: str) -> Iterator[str]:
    """Yield the stem, then stem-2, stem-3, …, for use if the first is taken."""
    yield stem
    yield from (f"{stem}-{count}" for count in itertools.count(2))


def save_baked_blend(path: Path) -> None:
    """Save a copy of the current file; the user's file stays open. Raises FileError."""
    import bpy

    def write(temporary: Path) -> None:
        temporary.unlink()  # otherwise Blender keeps the empty file as a backup
        try:
            with suppress_output():
                bpy.ops.wm.save_as_mainfile(filepath=str(temporary), copy=True, compress=True, relative_remap=True)
        except RuntimeError as error:
            raise FileError(
                f"Blender could not save it ({str(error).strip()}).",
                where=str(path),
                remedy="Free some disk space or choose another output folder.",
            ) from error

    write_atomically(path, write)


def format_material_line(object_name: str, materials: Sequence[SlotMaterial]) -> str:
    """Describe each Blender material with its library material, in the order in which the stroke touches them."""
    parts = [
        f"{material.shader or 'no material'}{location} → {material.library.name}, {format_certainty(material)}"
        for material, location in zip(materials, [f" on {object_name}"] + [""] * len(materials), strict=False)
    ]
    return "; ".join(parts)


def _format_height_line(source: str, resolved: float, has_relief: bool) -> str:
    """Describe where a height comes from; `has_relief` is true if the shader has nodes for one, read or not."""
    if not np.isfinite(resolved):
        if has_relief and not source:
            return "the bump, normal or displacement in the shader shows no relief that can be read"
        nothing = "no bump, normal or displacement in the shader, no relief in the mesh that can be felt"
        return f"{source}: no wave that can be felt" if source else nothing
    return f"{source}; resolves waves from {resolved * 1e3:.2g} mm"
