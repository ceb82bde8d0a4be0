"""How many samples a close-up needs until the token that is predicted from its look no longer moves."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any
from unittest.mock import patch as patched

import numpy as np
from numpy.typing import NDArray

from hnf_core.bench.frame import BenchOptions, Row, Spread
from hnf_core.errors import HnfError
from hnf_core.material.token import LEVELS, Token
from hnf_core.scene.patch import Patch

from .views_scene import SCENE_DATA

SAMPLES, QUICK_SAMPLES = (1, 4, 16, 64, 256), (1, 4, 16)
"""The last is the reference."""
CHAIR = SCENE_DATA / "SheenChairScene" / "MixedLightingExample.gltf"
CHAIR_PARTS = ("SheenChair_wood", "SheenChair_label")
MAX_TRIES = 20
TEXELS, PLATE_M = 256, 0.1


def measure_appearance(bench: str, options: BenchOptions) -> list[Row]:
    """For each material and number of samples: time of the close-up, and by how many dB its token's levels are off."""
    from ..bridge.importers import open_scene

    if options.quick or not CHAIR.is_file():
        return _measure_object(bench, make_printed_plate(), "a printed plate", options)
    found: list[Row] = []
    for name in CHAIR_PARTS:
        options.watch(f"{bench}: the look of {name}")
        found += _measure_object(bench, open_scene(CHAIR).objects[name], name, options)
    return found


def _measure_object(bench: str, obj: Any, name: str, options: BenchOptions) -> list[Row]:
    close_up = _find_readable_patch(obj)
    tokens: dict[int, Token] = {}
    times: dict[int, tuple[float, float]] = {}
    counts = QUICK_SAMPLES if options.quick else SAMPLES
    for samples in counts:
        wall, cpu = time.perf_counter(), time.process_time()
        seen = close_up(samples)
        times[samples] = time.perf_counter() - wall, time.process_time() - cpu
        tokens[samples] = _predict_token(seen)
    return [
        Row(
            bench, f"look, {samples}", Spread.from_values([times[samples][0]]), Spread.from_values([times[samples][1]]),
            error=compute_level_error_db(tokens[samples], tokens[counts[-1]]), error_unit="dB of a band's level",
            note=f"{name}, unlit, against {counts[-1]} samples",
        )
        for samples in counts[:-1]
    ]  # fmt: skip


def compute_level_error_db(token: Token, true: Token) -> float:
    """The largest difference of a band's level that both know, in dB."""
    known = token.known[LEVELS] & true.known[LEVELS]
    return float(20.0 * np.abs(token.values[LEVELS] - true.values[LEVELS])[known].max())


def _find_readable_patch(obj: Any) -> Callable[[int], Any]:
    """Samples → the close-up of a place of obj whose picture can be read. Raises HnfError where there is none."""
    import bpy

    from ..bridge import closeup
    from ..bridge.meshes import make_ray_caster, read_surface
    from ..bridge.render import configure_cycles
    from ..touch.seeing import ReliefPredictor

    surface = read_surface(obj, bpy.context.evaluated_depsgraph_get(), 1.0)
    caster, seeing = make_ray_caster(surface.mesh), ReliefPredictor()

    def sampled(place: Patch, samples: int) -> Any:
        with patched.object(closeup, "configure_cycles", lambda scene, **_: configure_cycles(scene, samples)):
            return closeup.render_closeup(obj, place, surface=surface, caster=caster)

    corners = surface.mesh.corner_positions()
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    for chosen in np.random.default_rng(0).choice(len(area), MAX_TRIES, p=area / area.sum()):
        place = _make_patch(corners[chosen], normal[chosen] / area[chosen], int(surface.mesh.slot[chosen]))
        seen = sampled(place, 1)
        if seen.look is not None and seeing.make_views(seen.look, seen.mask, seen.metres_per_pixel):
            return partial(sampled, place)
    raise HnfError(f"no place of '{obj.name}' has a picture that can be read.", where="views")


def _make_patch(corners: NDArray[np.float64], normal: NDArray[np.float64], slot: int) -> Patch:
    along = corners[1] - corners[0]
    along = along - normal * (along @ normal)
    return Patch(corners.mean(axis=0), along / np.linalg.norm(along), normal, slot)


def _predict_token(closeup: Any) -> Token:
    from ..touch.seeing import ReliefPredictor

    seeing = ReliefPredictor()
    views = seeing.make_views(closeup.look, closeup.mask, closeup.metres_per_pixel)
    return seeing.predict(closeup.look, views, seed=1).token


def make_printed_plate() -> Any:
    """A plate of 100 mm under a picture of brown noise, 0.4 mm a texel."""
    import bpy

    from .. import compat
    from ..bridge.importers import open_empty_scene

    open_empty_scene()
    bpy.ops.mesh.primitive_plane_add(size=PLATE_M)
    plate, material = bpy.context.object, bpy.data.materials.new("printed")
    plate.data.materials.append(material)
    compat.switch_nodes_on(material)
    nodes = material.node_tree.nodes
    texture = nodes.new("ShaderNodeTexImage")
    texture.image = bpy.data.images.new("print", TEXELS, TEXELS, float_buffer=True)
    grey = 0.4 + 0.1 * np.random.default_rng(0).normal(size=(TEXELS, TEXELS, 1))
    pixels = np.concatenate([np.clip(grey * [1.0, 0.7, 0.5], 0.0, 1.0), np.ones_like(grey)], axis=-1)
    texture.image.pixels.foreach_set(pixels.astype(np.float32).ravel())
    shader = next(node for node in nodes if node.bl_idname == "ShaderNodeBsdfPrincipled")
    material.node_tree.links.new(texture.outputs["Color"], shader.inputs["Base Color"])
    bpy.context.view_layer.update()
    return plate
