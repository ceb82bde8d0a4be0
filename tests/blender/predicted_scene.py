"""Surfaces with a photo and no relief, small networks of the right layout to look at them with, and bakes of them."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from builders import add_plane, float_image
from closeup_builders import principled

from hnf_blender.touch import bake_patches
from hnf_blender.touch.baked_stroke import BakedStroke
from hnf_blender.touch.report import Report
from hnf_blender.touch.session import StrokeJob, gather_jobs, make_scene_session
from hnf_blender.touch.synthesise import bake_strokes
from hnf_core.material.token import TOKEN_DIM
from hnf_core.tactile.unet import TOKEN_ERROR, MapConfig, save_map_weights

TEXEL = 0.1e-3
PHOTO_PLATE = "Board"


def photo(count: int = 256, seed: int = 0, contrast: float = 0.12) -> np.ndarray:
    """(count, count, 3) linear: blotches and grain, and it repeats."""
    random = np.random.default_rng(seed)
    wave = np.fft.fftfreq(count)
    slope = np.maximum(np.hypot(wave[:, None], wave[None, :]), 1.0 / count) ** -0.8
    grain = np.fft.ifft2(np.fft.fft2(random.standard_normal((count, count))) * slope).real
    level = 0.3 + contrast * grain / grain.std()
    return np.clip(level[..., None] * np.array([1.0, 0.8, 0.55]), 0.0, 1.0)


def photo_material(pixels: np.ndarray, name: str = PHOTO_PLATE, texel: float = TEXEL):
    """Base colour from an image that repeats, one texel every `texel` metres; one UV unit is a metre."""
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    tree = material.node_tree
    coordinates, mapping = tree.nodes.new("ShaderNodeUVMap"), tree.nodes.new("ShaderNodeMapping")
    repeats = 1.0 / (len(pixels) * texel)
    mapping.inputs["Scale"].default_value = (repeats, repeats, 1.0)
    texture = tree.nodes.new("ShaderNodeTexImage")
    texture.image = float_image(f"{name}.png", pixels)
    tree.links.new(coordinates.outputs["UV"], mapping.inputs["Vector"])
    tree.links.new(mapping.outputs["Vector"], texture.inputs["Vector"])
    tree.links.new(texture.outputs["Color"], principled(material).inputs["Base Color"])
    return material


def photo_plate(name: str = PHOTO_PLATE, size: float = 0.12, **look):
    plate = add_plane(name, size)
    plate.data.materials.append(photo_material(photo(), name, **look))
    return plate


def small_weights(path: Path, seed: int = 0, level: float = -1.5) -> Path:
    """D_φ in its smallest size with chance weights, whose maps have an RMS slope around 10^level."""
    config = MapConfig((8, 8, 8), up=1, deep=1, embedding=8, groups=2, level_mean=level, level_scale=0.01)
    random = np.random.default_rng(seed)
    parameters = {
        name: (random.standard_normal(shape) / np.sqrt(max(np.prod(shape[1:]), 1.0)) * 0.5).astype(np.float32)
        for name, shape in config.shapes().items()
    }
    note = {"note": "chance weights, for tests", TOKEN_ERROR: json.dumps([0.05] * TOKEN_DIM)}
    save_map_weights(path, config, parameters, note)
    return path


def use_weights(monkeypatch, path: Path) -> None:
    monkeypatch.setattr(bake_patches, "find_map_weights", lambda _: path)


@dataclass(frozen=True)
class Baked:
    """What bakes of the open scene's strokes gave, with none of a run's files."""

    strokes: tuple[BakedStroke, ...]
    jobs: tuple[StrokeJob, ...]
    report: Report

    @property
    def routes(self) -> list[str]:
        """Of the bands under the first stroke's main patch, longest first."""
        stroke = self.strokes[0]
        return [route.value for route in stroke.fused[stroke.main_patch].routes]


def bake_open_scene(cache: Path) -> Baked:
    session = make_scene_session(bpy.context.scene, bpy.context.view_layer, cache)
    found = gather_jobs(session)
    report = Report("", 1.0, "", failed=list(found.failed))
    strokes: list[BakedStroke] = []

    def keep(job: StrokeJob, baked: BakedStroke, start_stage: Callable[[str], None]) -> None:
        strokes.append(baked)

    bake_strokes(session, found.jobs, cache, report, keep)
    assert report.failed == []
    return Baked(tuple(strokes), tuple(found.jobs), report)
