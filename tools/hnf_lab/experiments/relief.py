"""Measure the effect of relief on a(t): a scene's measured relief blurred, doubled, rotated and flattened.

  Usage: python -m hnf_lab.experiments.relief SCENE [--out DIR] [--picture PNG] [--material NAME] [--json FILE]

Touches SCENE as `hnf touch` does (default strokes, Blender as a module), then changes the height map of every patch and
continues with the same steps: tactile map, E, fusion with the library material, field, a(t) with the same seed. The map
alone is synthesised as well: bands it does not resolve count as smooth, without a library material to fill them.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from hnf_lab import ROOT

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")


import numpy as np
from numpy.typing import NDArray

from hnf_blender import cli
from hnf_blender.touch import run as touch_run
from hnf_blender.touch import synthesise as touch_synthesise
from hnf_blender.touch.bake_patches import CACHE_FOLDER_NAME
from hnf_blender.touch.baked_stroke import BakedStroke
from hnf_blender.touch.patch_cache import PatchRecord
from hnf_blender.touch.session import StrokeJob, gather_jobs
from hnf_blender.touch.synthesise import make_stroke_input
from hnf_core.errors import HnfError, SceneError
from hnf_core.export.figure import write_figure
from hnf_core.field.synthesis import synthesise
from hnf_core.field.weights import load_field
from hnf_core.files import write_text
from hnf_core.material.band_descriptor import describe, get_smooth_token_values
from hnf_core.material.fuse import fuse
from hnf_core.material.token import Token
from hnf_core.metrics.spectra import average_spectrum_distance_db, welch
from hnf_core.tactile.fourier_filters import apply_filters, frequencies, gaussian_mtf
from hnf_core.tactile.height import tactile_map_from_height
from hnf_core.tactile.tactile_map import Route
from hnf_core.touch_request import TouchRequest

from ..evaluation.report import format_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Float = NDArray[np.float64]
Height = NDArray[np.float32]

BLUR_M = 1e-3
"""Standard deviation of the blur [m]: halves a wave of 5.3 mm, leaves a tenth of one of 2.9 mm."""
UNCHANGED, SMOOTH_SURFACE = "as it is", "smooth surface"
PLOTTED_S = 0.25
COLOURS = {UNCHANGED: "#1c2430", "blurred, 1 mm": "#0072b2", "twice as high": "#d55e00", "turned by 90°": "#009e73",
           "flat": "#cc79a7"}  # fmt: skip


def blur(height: Height, metres_per_pixel: float) -> Height:
    def response(shape: tuple[int, int]) -> list[Float]:
        fx, fy = frequencies(shape, metres_per_pixel)
        return [gaussian_mtf(np.hypot(fx, fy), BLUR_M)]

    (blurred,), _ = apply_filters(height.astype(np.float64), metres_per_pixel, response, "even", 6.0 * BLUR_M)
    return blurred.astype(np.float32)


RELIEF_CHANGES: dict[str, Callable[[Height, float], Height]] = {
    UNCHANGED: lambda height, pitch: height,
    "blurred, 1 mm": blur,
    "twice as high": lambda height, pitch: 2.0 * height,
    "turned by 90°": lambda height, pitch: np.ascontiguousarray(np.rot90(height)),
    "flat": lambda height, pitch: np.zeros_like(height),
}


@dataclass(frozen=True)
class ReliefResult:
    """Result of one change on one stroke.

    Attributes
    ----------
    samples
        a(t) of the product's path, at `rate`.
    map_only
        a(t) of the map without a library material.
    profile_m
        RMS height under the path [m].
    """

    change: str
    samples: Float
    map_only: Float
    rate: float
    profile_m: float


def change_relief(baked: BakedStroke, change: str, *, map_only: bool) -> BakedStroke:
    """Return the stroke with every measured height changed, described and fused again."""
    records, fused = [], []
    for material, record in zip(baked.materials, baked.records, strict=True):
        changed, token = _change_record(record, change)
        prior = get_smooth_token_values() if map_only else material.library.token
        records.append(changed)
        fused.append(fuse(token, prior, material.confidence, Route.MEASURED if token is not None else record.route))
    return replace(baked, records=tuple(records), fused=tuple(fused))


def _change_record(record: PatchRecord, change: str) -> tuple[PatchRecord, Token | None]:
    if record.height is None:
        return record, None
    height = RELIEF_CHANGES[change](record.height, record.metres_per_pixel)
    mask = np.ascontiguousarray(np.rot90(record.mask)) if "turned" in change else record.mask
    tactile = tactile_map_from_height(
        height, mask, record.metres_per_pixel, record.resolved_wavelength_m, sensor="gelsight",
        height_source=record.height_source,
    )  # fmt: skip
    token = describe(tactile)
    return replace(record, height=height, mask=mask, token=token.values, known=token.known), token


def synthesise_changed(baked: BakedStroke, change: str, seed: int) -> ReliefResult:
    signals = []
    for map_only in (False, True):
        stroke_input = make_stroke_input(change_relief(baked, change, map_only=map_only))
        signals.append(synthesise(load_field(), stroke_input, seed=seed).signal)
    profile = 0.0 if stroke_input.profile is None else float(np.std(stroke_input.profile.height))
    return ReliefResult(change, signals[0].samples.astype(np.float64), signals[1].samples.astype(np.float64),
                 float(signals[0].sample_rate), profile)  # fmt: skip


def measure_smooth(baked: BakedStroke, seed: int) -> float:
    """Return the RMS of a(t) on the same path over a perfectly smooth surface."""
    flat = replace(
        baked,
        records=tuple(replace(record, height=None, token=None, known=None) for record in baked.records),
        fused=tuple(fuse(None, get_smooth_token_values(), each.confidence) for each in baked.fused),
    )
    return compute_rms(synthesise(load_field(), make_stroke_input(flat), seed=seed).signal.samples.astype(np.float64))


def compute_rms(samples: Float) -> float:
    """Return the RMS of the middle third, at full speed and force."""
    middle = samples[len(samples) // 3 : -len(samples) // 3]
    return float(np.sqrt(np.mean(middle**2)))


def bake_strokes(scene: Path, out: Path) -> Iterator[tuple[StrokeJob, BakedStroke]]:
    """Bake the default strokes of a scene by the product's own steps. Raises HnfError if nothing can be touched."""
    request = TouchRequest(scene=scene, out=out)
    cli._register_properties()
    session, _ = touch_run._make_session(touch_run.open_named_scene("touch", request.scene), request)
    gathered = gather_jobs(session)
    report = touch_run._new_report(session, gathered, [])
    baked_strokes: list[tuple[StrokeJob, BakedStroke]] = []

    def collect(job: StrokeJob, baked: BakedStroke, start_stage: Callable[[str], None]) -> None:
        baked_strokes.append((job, baked))

    touch_synthesise.bake_strokes(session, gathered.jobs, out / CACHE_FOLDER_NAME, report, collect)
    if not baked_strokes:
        raise SceneError("nothing could be touched.", where=str(scene), remedy="Run hnf touch on it to see why.")
    yield from baked_strokes


def plot_signals(path: Path, name: str, results: list[ReliefResult]) -> None:
    """Plot a(t) of the map alone, since the library material would hide the changes."""
    size = (1000, 118 * len(results) + 96)

    def draw(figure: Figure) -> None:
        figure.text(0.02, 1.0 - 28 / size[1], f"{name}: a(t) of the map alone, as its relief is changed", fontsize=14,
                    fontweight="bold")  # fmt: skip
        top = max(float(np.abs(result.map_only).max()) for result in results)
        for row, result in enumerate(results):
            bottom = (size[1] - 66 - 118 * (row + 1) + 30) / size[1]
            wave = figure.add_axes((0.075, bottom, 0.53, 74 / size[1]))
            start = len(result.map_only) // 2
            count = min(round(PLOTTED_S * result.rate), len(result.map_only) - start)
            wave.plot(1e3 * np.arange(count) / result.rate, result.map_only[start : start + count],
                      color=COLOURS[result.change], lw=0.9)  # fmt: skip
            wave.set_ylim(-top, top)
            wave.set_title(f"{result.change}: {compute_rms(result.map_only):.3f} m/s² RMS", fontsize=10, loc="left")
            spectrum = figure.add_axes((0.68, bottom, 0.29, 74 / size[1]))
            for shown, width in ((results[0], 2.4), (result, 1.2)):
                hertz, density = compute_spectrum(shown.map_only, shown.rate)
                spectrum.plot(hertz, 10 * np.log10(np.maximum(density, 1e-12)), color=COLOURS[shown.change], lw=width,
                              alpha=0.35 if width > 2 else 1.0)  # fmt: skip
            spectrum.set_xscale("log")
            spectrum.set_xlim(20, 1000)
            spectrum.set_xticks([20, 50, 100, 200, 500, 1000], labels=["20", "50", "100", "200", "500", "1000"])
            spectrum.set_xticks([], minor=True)
            spectrum.set_ylim(-95, 5)
            for axes in (wave, spectrum):
                axes.tick_params(labelbottom=result is results[-1])
            if row == 0:
                spectrum.set_title("dB re 1 (m/s²)²/Hz; pale: as it is", fontsize=10, loc="left")
                wave.set_ylabel("m/s²")
        wave.set_xlabel("ms")
        spectrum.set_xlabel("Hz")

    write_figure(path, size, draw)


def compute_spectrum(samples: Float, rate: float) -> tuple[Float, Float]:
    middle = samples[len(samples) // 4 : -len(samples) // 4]
    hertz, density = welch(middle, rate)
    return np.asarray(hertz), np.asarray(density)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "maps-matter", help="cache of close-ups")
    parser.add_argument("--picture", type=Path, help="a(t) of one material")
    parser.add_argument("--material", default="LeatherPartsMat", help="shader of that material")
    parser.add_argument("--json", type=Path, dest="record", help="figures")
    arguments = parser.parse_args()
    if not arguments.scene.is_file():
        print(f"maps_matter: {arguments.scene} is not there; nothing was measured.", file=sys.stderr)
        return 1
    try:
        rows, figures = make_report(arguments)
    except HnfError as error:
        print(error, file=sys.stderr)
        return 1
    header = ("material", "relief", "a(t) RMS [m/s²]", "spectrum [dB]", "map alone: RMS [m/s²]", "level [dB]",
              "spectrum [dB]", "height under the path [µm RMS]")  # fmt: skip
    print("\n".join(format_table(header, rows)))
    if arguments.record is not None:
        write_text(arguments.record, json.dumps(figures, indent=1) + "\n")
    return 0


def make_report(arguments: argparse.Namespace) -> tuple[list[tuple[str, ...]], list[dict[str, object]]]:
    rows: list[tuple[str, ...]] = []
    figures: list[dict[str, object]] = []
    for job, baked in bake_strokes(arguments.scene, arguments.out):
        if all(record.height is None for record in baked.records):
            continue
        shader = baked.main_material.shader
        results = [synthesise_changed(baked, change, job.seed) for change in RELIEF_CHANGES]
        for result in results:
            level = 20.0 * np.log10(compute_rms(result.map_only) / compute_rms(results[0].map_only))
            distance, map_distance = (
                average_spectrum_distance_db(
                    compute_spectrum(changed, result.rate)[1], *compute_spectrum(unchanged, result.rate)[::-1]
                )
                for changed, unchanged in ((result.samples, results[0].samples), (result.map_only, results[0].map_only))
            )
            rows.append((shader, result.change, f"{compute_rms(result.samples):.3f}", f"{distance:.1f}",
            f"{compute_rms(result.map_only):.4f}",
                         f"{level:+.1f}", f"{map_distance:.1f}", f"{1e6 * result.profile_m:.1f}"))  # fmt: skip
            figures.append({"material": shader, "relief": result.change, "rms_m_s2": compute_rms(result.samples),
                            "distance_db": distance, "alone_rms_m_s2": compute_rms(result.map_only),
                            "alone_level_db": level,
                            "alone_distance_db": map_distance, "profile_rms_m": result.profile_m})  # fmt: skip
        smooth_rms = measure_smooth(baked, job.seed)
        rows.append((shader, SMOOTH_SURFACE, "", "", f"{smooth_rms:.4f}", "", "", "0.0"))
        figures.append({"material": shader, "relief": SMOOTH_SURFACE, "alone_rms_m_s2": smooth_rms})
        if arguments.picture is not None and shader == arguments.material:
            plot_signals(arguments.picture, shader, results)
    return rows, figures


if __name__ == "__main__":
    sys.exit(main())
