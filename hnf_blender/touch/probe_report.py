"""What a probe found, as files and as an entry of report.json."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hnf_core.export.map_picture import map_picture
from hnf_core.files import write_bytes
from hnf_core.material.estimate import Estimate
from hnf_core.material.fuse import routes_by_band
from hnf_core.tactile.tactile_map import TactileMap
from hnf_core.units import m_to_mm

from .bake import resolved_wavelength_of
from .deliver import file_stem
from .probe import Near, Probed, map_source

NOT_SEEN = "estimated from the likely materials, not seen"


def write_probe(folder: Path, probed: Probed) -> dict[str, Any]:
    """The tactile map as PNG and as numbers (.npz), each atomically; returns the probe's entry for the report, as
    docs/probe.md says it. A picture of the same numbers and words is left as it is."""
    tactile = probed.tactile
    files: dict[str, Any] | None = None
    if tactile is not None:
        stem, said = file_stem(f"probe {probed.name}"), (f"Probe {probed.name}", *_said(probed, tactile))
        picture, numbers = folder / f"{stem}.png", folder / f"{stem}.npz"
        data = numbers_of(tactile, said)
        if not (picture.is_file() and numbers.is_file() and numbers.read_bytes() == data):
            map_picture(picture, tactile, said[0], said[1:])
            write_bytes(numbers, data)
        files = {"picture": f"{stem}.png", "numbers": f"{stem}.npz"}
    return entry_of(probed, files)


def entry_of(probed: Probed, files: dict[str, Any] | None) -> dict[str, Any]:
    """The probe as a JSON object. files: names of picture and numbers, None where there is no map."""
    routes = routes_by_band(probed.fused.routes)
    rms = probed.band_rms_m
    return {
        "name": probed.name,
        "object": probed.touched.surface.object_name,
        "material": probed.material.shader,
        "library_material": probed.material.library.name,
        "confidence": round(probed.fused.confidence, 4),
        "material_confidence": round(probed.material.confidence, 4),
        "reason": probed.material.reason,
        "place": _place(probed),
        "routes": routes,
        "roughness": {
            "bands_rms_m": {band: float(value) for band, value in zip(routes, rms, strict=True)},
            "seen_rms_m": probed.told_rms_m,
            "total_rms_m": float(np.sqrt(np.sum(rms**2))),
        },
        "friction": {"kinetic_mu": probed.friction.value, **_spread(probed.friction)},
        "stiffness": {"n_per_m": probed.stiffness.value, **_spread(probed.stiffness)},
        "nearest": [_near(each) for each in probed.nearest],
        "tactile_map": None if files is None or probed.tactile is None else {**files, **_map(probed, probed.tactile)},
        "source": map_source(probed),
        "notes": list(probed.notes),
    }


def numbers_of(tactile: TactileMap, said: Sequence[str]) -> bytes:
    """numpy's .npz: image (H, W, 3) linear, height (H, W) metres where it is known, mask, metres_per_pixel, and said:
    title and facts of the picture."""
    arrays = {
        "image": tactile.image,
        "mask": tactile.mask,
        "metres_per_pixel": np.array(tactile.metres_per_pixel),
        "said": np.array(said),
    }
    if tactile.height is not None:
        arrays["height_m"] = tactile.height
    packed = io.BytesIO()
    np.savez_compressed(packed, **arrays)
    return packed.getvalue()


def probe_line(entry: dict[str, Any]) -> str:
    """One line for a person."""
    roughness = entry["roughness"]["total_rms_m"] * 1e6
    like = entry["nearest"][0]["name"] if entry["nearest"] else ""
    return (
        f"{entry['name']}: {entry['library_material']} ({entry['material_confidence']:.0%}), roughness {roughness:.3g} "
        f"µm RMS, friction about {entry['friction']['kinetic_mu']:.2f} (×÷{entry['friction']['spread_factor']:.2f}), "
        f"nearest {like}"
    )


def _place(probed: Probed) -> dict[str, Any]:
    place, surface = probed.place, probed.touched.surface
    own_face = place.face if surface.source_face is None else int(surface.source_face[place.face])
    metres = probed.touched.metres_per_unit
    world_m = surface.rigid[:3, :3] @ place.point + surface.rigid[:3, 3]
    return {
        "local": _numbers(np.linalg.pinv(surface.stretch) @ place.point),
        "uv": None if place.uv is None else _numbers(place.uv),
        "world": _numbers(world_m / metres),
        "world_normal": _numbers(surface.rigid[:3, :3] @ place.normal),
        "surface_m": _numbers(place.point),
        "surface_normal": _numbers(place.normal),
        "surface_x_axis": _numbers(place.patch.x_axis),
        "face": own_face if own_face >= 0 else None,
        "slot": place.patch.slot,
        "directions": "UV" if place.tangent_known else "object axes",
    }


def _map(probed: Probed, tactile: TactileMap) -> dict[str, Any]:
    resolved = resolved_wavelength_of(probed.record)
    return {
        "sensor": tactile.sensor,
        "route": tactile.route.value,
        "metres_per_pixel": tactile.metres_per_pixel,
        "resolved_wavelength_m": resolved if math.isfinite(resolved) else None,
        "height_peak_to_peak_m": probed.record.height_peak_to_peak_m if tactile.height is not None else None,
    }


def _said(probed: Probed, tactile: TactileMap) -> tuple[str, ...]:
    """What the picture says below the map."""
    span = probed.record.height_peak_to_peak_m if tactile.height is not None else None
    tall = "" if span is None else f"; {m_to_mm(span):.3g} mm from top to bottom"
    roughness = float(np.sqrt(np.sum(probed.band_rms_m**2))) * 1e6
    return (
        f"Relief from: {map_source(probed)}{tall}.",
        f"{probed.material.shader or 'No material'} → {probed.material.library.name}, "
        f"{probed.material.confidence:.0%}; roughness {roughness:.3g} µm RMS.",
    )


def _near(near: Near) -> dict[str, Any]:
    return {
        "name": near.suggestion.name,
        "category": near.category,
        "distance": near.distance,
        "confidence": round(near.suggestion.confidence, 4),
        "reason": near.suggestion.reason,
    }


def _spread(told: Estimate) -> dict[str, Any]:
    return {"spread_factor": told.factor, "basis": NOT_SEEN}


def _numbers(values: Any) -> list[float]:
    return [round(float(value), 9) + 0.0 for value in values]
