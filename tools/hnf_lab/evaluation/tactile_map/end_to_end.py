"""Touch scenes and photographs by `hnf touch` with either network D_φ, and compare what is felt.

Each run is a process of the product's own command. A photograph lies on a plane, without a name. The two runs of a
surface differ in `--tactile-map` alone, noise included, so that any difference is the network's.
"""

from __future__ import annotations

import json
import os
import shutil
import tempfile
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.errors import FileError, SceneError
from hnf_core.export.wav import read_wav_with_units
from hnf_core.material.token import BAND_WAVELENGTHS_M, LEVELS
from hnf_core.metrics import welch
from hnf_core.progress import Progress, ProgressCallback, ignore_progress
from hnf_core.tactile.tactile_map import Route

from ..corpus import COMMAND, Runner, run_command
from ..photographs.measure import STROKE, save_planes
from ..recordings.spectra import DEPTH_DB
from ..report import format_table

Float = NDArray[np.float64]

PICTURE_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".exr", ".bmp")
"""Suffixes of files that are photographs, not scenes."""
EDGES_HZ = 1000.0 * 2.0 ** (np.arange(-6, 1) - 0.5)
"""Edges of the octaves of vibration that are compared, centers from 31 to 500 Hz [Hz]."""
LIMIT_S = 3600.0
"""Longest time of one run [s]."""


@dataclass(frozen=True)
class Touched:
    """Result of touching one surface with one network.

    Attributes
    ----------
    file, network : str
        Name of the surface's file, and the network.
    strokes : int
        Number of strokes.
    seconds, cpu_seconds : float
        Wall and processor time of the process [s].
    predicted_patches : int
        Patches whose relief was predicted from a picture.
    used_bands : int
        Bands of all strokes that hold anything of a prediction.
    rms_m_s2 : float
        Median RMS of a stroke [m/s²].
    confidence : float
        Median confidence of a stroke.
    vibration_db, map_db : float
        Difference from the first network: RMS over octaves of vibration, median over strokes, and RMS over bands of
        the predicted tokens' mean levels [dB]; NaN for the first network, and where nothing was predicted.
    """

    file: str
    network: str
    strokes: int
    seconds: float
    cpu_seconds: float
    predicted_patches: int
    used_bands: int
    rms_m_s2: float
    confidence: float
    vibration_db: float
    map_db: float


@dataclass(frozen=True)
class _Run:
    """Report of one run, octave levels of its strokes by name, and mean levels of the predicted tokens' bands [dB]."""

    report: Mapping[str, Any]
    vibration_db: Mapping[str, Float]
    map_db: Float
    seconds: float
    cpu_seconds: float


def compare_networks(
    paths: Sequence[Path],
    networks: Sequence[str],
    *,
    side_m: float,
    run: Runner = run_command,
    progress: ProgressCallback = ignore_progress,
) -> list[Touched]:
    """Touch scenes and photographs with every network.

    Parameters
    ----------
    paths
        Scene files, and photographs that are laid on a plane.
    networks
        Words or files of D_φ for `--tactile-map`; the others are compared with the first.
    side_m
        Width of the surface that a photograph shows [m].
    run
        Runs the command.
    progress
        Called before each run.

    Returns
    -------
    list of Touched
        One for each path and network, in this order.

    Raises
    ------
    FileError
        If a path is no file.
    SceneError
        If a surface could not be touched.
    """
    for path in paths:
        if not path.is_file():
            raise FileError("is no file.", where=str(path), remedy="Give scene files and photographs.")
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        for index, path in enumerate(paths):
            scene, words = _make_scene(path, Path(scratch) / f"{index}", side_m)
            first: _Run | None = None
            for number, network in enumerate(networks):
                progress(
                    Progress(f"{path.name}, {network}", index * len(networks) + number, len(paths) * len(networks))
                )
                out = Path(scratch) / f"{index}" / f"out-{number}"
                done = _touch(scene, out, [*words, "--tactile-map", network], run)
                first = first or done
                rows.append(_summarise(path.name, network, done, first))
                shutil.rmtree(out)
    return rows


def _make_scene(path: Path, folder: Path, side_m: float) -> tuple[Path, list[str]]:
    """Return the scene of a file, and options of `hnf touch` for it."""
    folder.mkdir()
    if path.suffix.lower() not in PICTURE_SUFFIXES:
        return path, []
    image = folder / f"image{path.suffix}"
    shutil.copyfile(path, image)
    save_planes(folder / "scene.blend", [("Material", image)], side_m)
    return folder / "scene.blend", ["--stroke", STROKE, "--on", "Plane"]


def _touch(scene: Path, out: Path, words: Sequence[str], run: Runner) -> _Run:
    begun, cpu_begun = time.monotonic(), _count_cpu_seconds()
    code, errors = run([*COMMAND, "touch", str(scene), "--out", str(out), *words], LIMIT_S)
    seconds, cpu_seconds = time.monotonic() - begun, _count_cpu_seconds() - cpu_begun
    path = out / "report.json"
    if code != 0 or not path.is_file():
        lines = errors.strip().splitlines() or [f"exit code {code}"]
        raise SceneError(f"could not be touched: {lines[-1]}", where=str(scene))
    report = json.loads(path.read_text())
    felt = {stroke["name"]: measure_octaves_db(out / stroke["wav"]) for stroke in report["strokes"]}
    return _Run(report, felt, _read_predictions(out), seconds, cpu_seconds)


def _count_cpu_seconds() -> float:
    times = os.times()
    return times.children_user + times.children_system


def measure_octaves_db(path: Path) -> Float:
    """Measure the power of a WAV's octaves of vibration [dB re (m/s²)²]."""
    frequency, density = welch(read_wav_with_units(path))
    inside = (frequency >= EDGES_HZ[:-1, None]) & (frequency < EDGES_HZ[1:, None])
    power = (inside * density).sum(axis=1) * (frequency[1] - frequency[0])
    return np.asarray(10.0 * np.log10(np.maximum(power, 1e-30)))


def compare_octaves(levels_db: Float, reference_db: Float) -> float:
    """Return the RMS difference of levels where the reference is within DEPTH_DB of its peak [dB]."""
    counts = reference_db >= reference_db.max() - DEPTH_DB
    return float(np.sqrt(np.mean(np.square(levels_db - reference_db)[counts])))


def _read_predictions(out: Path) -> Float:
    """Return the mean levels of the predicted tokens' bands over a run's patches [dB]; NaN if none was predicted."""
    from hnf_blender.touch.bake_patches import CACHE_FOLDER_NAME
    from hnf_blender.touch.patch_cache import load_prediction

    cache = out / CACHE_FOLDER_NAME
    found = [load_prediction(cache, path.stem) for path in sorted(cache.glob("*.npz"))]
    levels = [
        np.where(each.token.known, each.token.values, np.nan)[LEVELS].astype(np.float64) for each in found if each
    ]
    nothing = np.full(len(BAND_WAVELENGTHS_M), np.nan)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a band that is never known has no mean
        return np.asarray(20.0 * np.nanmean([*levels, nothing], axis=0))


def _summarise(file: str, network: str, done: _Run, first: _Run) -> Touched:
    strokes = done.report["strokes"]
    if not strokes:
        raise SceneError("has no stroke.", where=file)
    difference = done.map_db - first.map_db
    known = np.isfinite(difference)
    is_first = done is first
    return Touched(
        file=file,
        network=network,
        strokes=len(strokes),
        seconds=done.seconds,
        cpu_seconds=done.cpu_seconds,
        predicted_patches=done.report["counts"]["diffusion_calls"],
        used_bands=sum(route == Route.PREDICTED.value for stroke in strokes for route in stroke["routes"].values()),
        rms_m_s2=float(np.median([stroke["rms_m_s2"] for stroke in strokes])),
        confidence=float(np.median([stroke["confidence"] for stroke in strokes])),
        vibration_db=np.nan
        if is_first
        else float(
            np.median([compare_octaves(level, first.vibration_db[name]) for name, level in done.vibration_db.items()])
        ),
        map_db=np.nan if is_first or not known.any() else float(np.sqrt(np.mean(np.square(difference[known])))),
    )


def format_networks(rows: Sequence[Touched]) -> str:
    """Format the table as Markdown."""
    header = ("surface", "network", "strokes", "time [s]", "processor [s]", "patches predicted", "bands used",
              "RMS [m/s²]", "confidence", "vibration [dB]", "maps [dB]")  # fmt: skip
    lines = [
        (row.file, row.network, str(row.strokes), f"{row.seconds:.0f}", f"{row.cpu_seconds:.0f}",
         str(row.predicted_patches), str(row.used_bands), f"{row.rms_m_s2:.3g}", f"{row.confidence:.0%}",
         *("–" if np.isnan(value) else f"{value:.2f}" for value in (row.vibration_db, row.map_db)))
        for row in rows
    ]  # fmt: skip
    return "\n".join(format_table(header, lines))


def networks_to_json(rows: Sequence[Touched]) -> list[dict[str, Any]]:
    """Return the rows as JSON values, None for NaN."""
    return [{key: None if value != value else value for key, value in asdict(row).items()} for row in rows]
