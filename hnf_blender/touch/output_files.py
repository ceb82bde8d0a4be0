"""Write the files of a stroke, WAV and plot, and the baked .blend of a run."""

from __future__ import annotations

import itertools
import re
import unicodedata
from collections.abc import Container, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hnf_core.action.action import Action
from hnf_core.errors import FileError
from hnf_core.export.plots.stroke_figure import StrokeView, write_stroke_figure
from hnf_core.export.wav import encode_wav, read_wav
from hnf_core.files import content_hash, write_atomically, write_bytes
from hnf_core.material.fuse import routes_by_band
from hnf_core.signal import Signal

from ..bridge.scene.temp_scene import suppress_output
from .bake_patches import get_encoder_name, get_resolved_wavelength, get_widest_map
from .baked_stroke import BakedStroke
from .material_choice import SlotMaterial, format_certainty, round_likely
from .report import StrokeReport
from .session import StrokeJob
from .synthesise import (
    SynthesisedStroke,
    add_provenance,
    compute_known_shares,
    compute_mean_share,
    get_signal_facts,
    make_stroke_input,
)


def write_stroke_files(
    folder: Path,
    job: StrokeJob,
    baked: BakedStroke,
    synthesised: SynthesisedStroke,
    view: StrokeView,
    used_names: Container[str] = (),
    picture_key: str = "",
) -> StrokeReport:
    """Write a stroke's WAV and its plot, each atomically.

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
    view : StrokeView
        Rendered view with the path.
    used_names : container of str, optional
        WAV files of the run's other strokes.
    picture_key : str, optional
        Hash of the view, for the entry.

    Returns
    -------
    StrokeReport
        The stroke's entry of the report.
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
    confidence = round(synthesised.confidence, 4)
    _plot_stroke(folder / f"{stem}.png", job, baked, synthesised.action, signal, confidence, view)
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
        picture=f"{stem}.png",
        duration_s=round(signal.duration_s, 6),
        rms_m_s2=signal.rms,
        confidence=confidence,
        probe=baked.stroke.probe,
        seed=job.seed,
        fresh=False,
        key=job.key,
        wav_hash=content_hash(data),
        warnings=synthesised.warnings,
        encoder=get_encoder_name(record),
        tactile_map_weights="" if record.predicted is None else record.predicted.weights,
        picture_key=picture_key,
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


def redraw_stroke_plot(
    folder: Path, entry: StrokeReport, job: StrokeJob, baked: BakedStroke, view: StrokeView, picture_key: str
) -> StrokeReport:
    """Write a new plot of a stroke whose signal is still valid; return its report entry with the new `picture_key`."""
    signal = read_wav(folder / entry.wav)
    _plot_stroke(folder / entry.picture, job, baked, make_stroke_input(baked).action, signal, entry.confidence, view)
    return replace(entry, picture_key=picture_key)


def _plot_stroke(
    path: Path, job: StrokeJob, baked: BakedStroke, action: Action, signal: Signal, confidence: float, view: StrokeView
) -> None:
    """Draw the plot of a stroke: rendered view, signal over time, facts and tactile map."""
    record, facts = baked.records[baked.main_patch], get_signal_facts(baked)
    main_slot, main_object = baked.patches[baked.main_patch].slot, baked.objects[baked.get_owner(baked.main_patch)]
    lines = [format_material_line(part.stroke.object_name, part.touched_materials) for part in baked.split_by_object()]
    write_stroke_figure(
        path, title=job.name, action=action, signal=signal, view=view,
        facts={
            "Material": "; ".join(lines),
            "Routes": facts["routes"],
            "Height": _format_height_line(
                facts["height_source"], get_resolved_wavelength(record), main_object.has_relief_at(main_slot)
            ),
            "Confidence": f"{confidence:.0%} in the whole signal; probe: {baked.stroke.probe}",
        },
        tactile=get_widest_map(record),
    )  # fmt: skip


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
