"""What a probe found, as files and as an entry of report.json."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hnf_core.export.map_picture import write_tactile_map_figure
from hnf_core.files import write_bytes
from hnf_core.material.estimate import PropertyEstimate
from hnf_core.material.fuse import routes_by_band
from hnf_core.tactile.tactile_map import TactileMap
from hnf_core.units import m_to_mm

from .bake import get_resolved_wavelength
from .deliver import make_file_stem
from .probe import QueryResult, SimilarMaterial, describe_map_source

ESTIMATE_BASIS = "estimated from the likely materials, not seen"


def write_query(folder: Path, result: QueryResult) -> dict[str, Any]:
    """The tactile map as PNG and as numbers (.npz), each atomically; returns the probe's entry for the report, as
    docs/probe.md says it. A picture of the same numbers and words is left as it is."""
    tactile = result.tactile
    files: dict[str, Any] | None = None
    if tactile is not None:
        stem, said = make_file_stem(f"probe {result.name}"), (f"Probe {result.name}", *_make_captions(result, tactile))
        picture, numbers = folder / f"{stem}.png", folder / f"{stem}.npz"
        data = pack_map(tactile, said)
        if not (picture.is_file() and numbers.is_file() and numbers.read_bytes() == data):
            write_tactile_map_figure(picture, tactile, said[0], said[1:])
            write_bytes(numbers, data)
        files = {"picture": f"{stem}.png", "numbers": f"{stem}.npz"}
    return make_query_entry(result, files)


def make_query_entry(result: QueryResult, files: dict[str, Any] | None) -> dict[str, Any]:
    """The probe as a JSON object. files: names of picture and numbers, None where there is no map."""
    routes = routes_by_band(result.fused.routes)
    rms = result.band_rms_m
    return {
        "name": result.name,
        "object": result.touched.surface.object_name,
        "material": result.material.shader,
        "library_material": result.material.library.name,
        "confidence": round(result.fused.confidence, 4),
        "material_confidence": round(result.material.confidence, 4),
        "reason": result.material.reason,
        "place": _describe_place(result),
        "routes": routes,
        "roughness": {
            "bands_rms_m": {band: float(value) for band, value in zip(routes, rms, strict=True)},
            "seen_rms_m": result.observed_rms_m,
            "total_rms_m": float(np.sqrt(np.sum(rms**2))),
        },
        "friction": {"kinetic_mu": result.friction.value, **_describe_spread(result.friction)},
        "stiffness": {"n_per_m": result.stiffness.value, **_describe_spread(result.stiffness)},
        "nearest": [_describe_similar(each) for each in result.nearest],
        "tactile_map": None
        if files is None or result.tactile is None
        else {**files, **_describe_map(result, result.tactile)},
        "source": describe_map_source(result),
        "notes": list(result.notes),
    }


def pack_map(tactile: TactileMap, captions: Sequence[str]) -> bytes:
    """numpy's .npz: image (H, W, 3) linear, height (H, W) metres where it is known, mask, metres_per_pixel, and said:
    title and facts of the picture."""
    arrays = {
        "image": tactile.image,
        "mask": tactile.mask,
        "metres_per_pixel": np.array(tactile.metres_per_pixel),
        "said": np.array(captions),
    }
    if tactile.height is not None:
        arrays["height_m"] = tactile.height
    packed = io.BytesIO()
    np.savez_compressed(packed, **arrays)
    return packed.getvalue()


def format_query_line(entry: dict[str, Any]) -> str:
    """One line for a person."""
    roughness = entry["roughness"]["total_rms_m"] * 1e6
    like = entry["nearest"][0]["name"] if entry["nearest"] else ""
    return (
        f"{entry['name']}: {entry['library_material']} ({entry['material_confidence']:.0%}), roughness {roughness:.3g} "
        f"µm RMS, friction about {entry['friction']['kinetic_mu']:.2f} (×÷{entry['friction']['spread_factor']:.2f}), "
        f"nearest {like}"
    )


def _describe_place(result: QueryResult) -> dict[str, Any]:
    place, surface = result.point, result.touched.surface
    own_face = place.face if surface.source_face is None else int(surface.source_face[place.face])
    metres = result.touched.metres_per_unit
    world_m = surface.rigid[:3, :3] @ place.point + surface.rigid[:3, 3]
    return {
        "local": _round_values(np.linalg.pinv(surface.stretch) @ place.point),
        "uv": None if place.uv is None else _round_values(place.uv),
        "world": _round_values(world_m / metres),
        "world_normal": _round_values(surface.rigid[:3, :3] @ place.normal),
        "surface_m": _round_values(place.point),
        "surface_normal": _round_values(place.normal),
        "surface_x_axis": _round_values(place.patch.x_axis),
        "face": own_face if own_face >= 0 else None,
        "slot": place.patch.slot,
        "directions": "UV" if place.tangent_known else "object axes",
    }


def _describe_map(result: QueryResult, tactile: TactileMap) -> dict[str, Any]:
    resolved = get_resolved_wavelength(result.record)
    return {
        "sensor": tactile.sensor,
        "route": tactile.route.value,
        "metres_per_pixel": tactile.metres_per_pixel,
        "resolved_wavelength_m": resolved if math.isfinite(resolved) else None,
        "height_peak_to_peak_m": result.record.height_peak_to_peak_m if tactile.height is not None else None,
    }


def _make_captions(result: QueryResult, tactile: TactileMap) -> tuple[str, ...]:
    """What the picture says below the map."""
    span = result.record.height_peak_to_peak_m if tactile.height is not None else None
    tall = "" if span is None else f"; {m_to_mm(span):.3g} mm from top to bottom"
    roughness = float(np.sqrt(np.sum(result.band_rms_m**2))) * 1e6
    return (
        f"Relief from: {describe_map_source(result)}{tall}.",
        f"{result.material.shader or 'No material'} → {result.material.library.name}, "
        f"{result.material.confidence:.0%}; roughness {roughness:.3g} µm RMS.",
    )


def _describe_similar(similar: SimilarMaterial) -> dict[str, Any]:
    return {
        "name": similar.suggestion.name,
        "category": similar.category,
        "distance": similar.distance,
        "confidence": round(similar.suggestion.confidence, 4),
        "reason": similar.suggestion.reason,
    }


def _describe_spread(value: PropertyEstimate) -> dict[str, Any]:
    return {"spread_factor": value.factor, "basis": ESTIMATE_BASIS}


def _round_values(values: Any) -> list[float]:
    return [round(float(value), 9) + 0.0 for value in values]
