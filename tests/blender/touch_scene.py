"""A scene to run the main job on: a plate of ridges with strokes on it, and what came out of a run."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import bpy
import numpy as np
import pytest
from builders import add_plane, bump_material

from hnf_blender.cli import main
from hnf_blender.touch import overview
from hnf_core.export.wav import read_wav
from hnf_core.signal import Signal

PLATE = "Plate"
FPS = 24


def ridge_plate(height: float = 60e-6, name: str = PLATE, size: float = 0.12):
    """A plate of 2 mm ridges that vary along UV x, so along world x."""
    plate = add_plane(name, size)
    plate.data.materials.append(bump_material(f"{name} plastic", wavelength=2e-3, height=height))
    return plate


def line_stroke(
    name: str = "Scrape", *, along=(1.0, 0.0, 0.0), length=0.026, force=1.0, centre=(0.0, 0.0, 0.0), **settings
):
    """A straight stroke at 100 mm/s, its force keyed: down, held, up. Two patches long unless length says more."""
    direction = np.asarray(along) / np.linalg.norm(along)
    curve = bpy.data.curves.new(name, "CURVE")
    curve.dimensions = "3D"
    spline = curve.splines.new("POLY")
    spline.points.add(1)
    for point, side in zip(spline.points, (-0.5, 0.5), strict=True):
        point.co = (*(np.asarray(centre) + side * length * direction), 1.0)
    obj = bpy.data.objects.new(name, curve)
    bpy.context.scene.collection.objects.link(obj)
    stroke = obj.hnf_stroke
    stroke.is_stroke, stroke.start = True, 1.0
    for key, value in settings.items():
        setattr(stroke, key, value)
    last = 1.0 + length / 0.1 * FPS
    set_keys(obj, "force", (1.0, 0.0), (2.5, force), (last - 1.5, force), (last, 0.0))
    bpy.context.view_layer.update()
    return obj


def set_keys(obj, name: str, *keys: tuple[float, float]) -> None:
    for frame, value in keys:
        setattr(obj.hnf_stroke, name, value)
        obj.keyframe_insert(f"hnf_stroke.{name}", frame=frame)


def place_data(patch: pytest.MonkeyPatch, folder: Path) -> Path:
    """Let Blender keep the add-on's data in a folder, by its environment variable; return the cache's path."""
    folder.mkdir(exist_ok=True)
    patch.setenv("BLENDER_USER_DATAFILES", str(folder))
    return folder / "hnf" / "cache"


def save_scene(path: Path) -> Path:
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


def touch(scene: Path, out: Path, *words: str) -> tuple[int, dict]:
    """Run the command line, its view of each stroke a quarter as large. Exit code and report."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(overview, "WIDTH", overview.WIDTH // 2)
        patch.setattr(overview, "HEIGHT", overview.HEIGHT // 2)
        code = main(["touch", str(scene), "--out", str(out), *words])
    report = out / "report.json"
    return code, json.loads(report.read_text()) if report.is_file() else {}


def touch_without_pictures(scene: Path, out: Path, *words: str) -> tuple[int, dict]:
    """As `touch`, for tests of what is felt and said: to draw a stroke takes as long as to touch and synthesize it."""
    return touch(scene, out, "--no-pictures", *words)


def signals(out: Path, report: dict) -> dict[str, Signal]:
    return {stroke["name"]: read_wav(out / stroke["wav"]) for stroke in report["strokes"]}


def spectrum_db(signal: Signal, low: float = 20.0, high: float = 500.0) -> np.ndarray:
    """Welch spectrum in dB of the middle of a stroke, smoothed over 1/3 octave-ish bands."""
    samples = signal.samples[len(signal.samples) // 5 : -len(signal.samples) // 5].astype(np.float64)
    size = min(2048, len(samples))
    window = np.hanning(size)
    frames = [samples[i : i + size] * window for i in range(0, len(samples) - size + 1, size // 4)]
    power = np.mean([np.abs(np.fft.rfft(frame)) ** 2 for frame in frames], axis=0)
    frequency = np.fft.rfftfreq(size, 1.0 / signal.sample_rate)
    edges = np.geomspace(low, high, 13)
    return np.array([
        10.0 * np.log10(power[(frequency >= a) & (frequency < b)].mean() + 1e-30)
        for a, b in itertools.pairwise(edges)
    ])  # fmt: skip
