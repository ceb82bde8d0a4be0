"""How many samples a close-up needs until the token that is predicted from its look no longer moves."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any
from unittest.mock import patch as patched

import numpy as np
from numpy.typing import NDArray

from hnf_core.bench.frame import Options, Row, Spread
from hnf_core.errors import HnfError
from hnf_core.material.token import LEVELS, Token
from hnf_core.scene.patch import Patch

from .views_scene import DATA

SAMPLES, QUICK_SAMPLES = (1, 4, 16, 64, 256), (1, 4, 16)
"""The last is the reference."""
CHAIR = DATA / "SheenChairScene" / "MixedLightingExample.gltf"
PARTS = ("SheenChair_wood", "SheenChair_label")
TRIES = 20
TEXELS, PLATE_M = 256, 0.1


def look_rows(bench: str, options: Options) -> list[Row]:
    """For each material and number of samples: time of the close-up, and by how many dB its token's levels are off."""
    from ..bridge.importers import open_scene

    if options.quick or not CHAIR.is_file():
        return _of(bench, printed_plate(), "a printed plate", options)
    found: list[Row] = []
    for name in PARTS:
        options.watch(f"{bench}: the look of {name}")
        found += _of(bench, open_scene(CHAIR).objects[name], name, options)
    return found


def _of(bench: str, obj: Any, name: str, options: Options) -> list[Row]:
    close_up = _place(obj)
    tokens: dict[int, Token] = {}
    times: dict[int, tuple[float, float]] = {}
    counts = QUICK_SAMPLES if options.quick else SAMPLES
    for samples in counts:
        wall, cpu = time.perf_counter(), time.process_time()
        seen = close_up(samples)
        times[samples] = time.perf_counter() - wall, time.process_time() - cpu
        tokens[samples] = _token(seen)
    return [
        Row(
            bench, f"look, {samples}", Spread.of([times[samples][0]]), Spread.of([times[samples][1]]),
            error=off_db(tokens[samples], tokens[counts[-1]]), error_unit="dB of a band's level",
            note=f"{name}, unlit, against {counts[-1]} samples",
        )
        for samples in counts[:-1]
    ]  # fmt: skip


def off_db(token: Token, true: Token) -> float:
    """The largest difference of a band's level that both know, in dB."""
    known = token.known[LEVELS] & true.known[LEVELS]
    return float(20.0 * np.abs(token.values[LEVELS] - true.values[LEVELS])[known].max())


def _place(obj: Any) -> Callable[[int], Any]:
    """Samples → the close-up of a place of obj whose picture can be read. Raises HnfError where there is none."""
    import bpy

    from ..bridge import closeup
    from ..bridge.meshes import ray_caster, surface_mesh
    from ..bridge.render import prepare_cycles
    from ..touch.seeing import Seeing

    surface = surface_mesh(obj, bpy.context.evaluated_depsgraph_get(), 1.0)
    caster, seeing = ray_caster(surface.mesh), Seeing()

    def sampled(place: Patch, samples: int) -> Any:
        with patched.object(closeup, "prepare_cycles", lambda scene, **_: prepare_cycles(scene, samples)):
            return closeup.render_closeup(obj, place, surface=surface, caster=caster)

    corners = surface.mesh.corner_positions()
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    for chosen in np.random.default_rng(0).choice(len(area), TRIES, p=area / area.sum()):
        place = _patch(corners[chosen], normal[chosen] / area[chosen], int(surface.mesh.slot[chosen]))
        seen = sampled(place, 1)
        if seen.look is not None and seeing.views_of(seen.look, seen.mask, seen.metres_per_pixel):
            return partial(sampled, place)
    raise HnfError(f"no place of '{obj.name}' has a picture that can be read.", where="views")


def _patch(corners: NDArray[np.float64], normal: NDArray[np.float64], slot: int) -> Patch:
    along = corners[1] - corners[0]
    along = along - normal * (along @ normal)
    return Patch(corners.mean(axis=0), along / np.linalg.norm(along), normal, slot)


def _token(seen: Any) -> Token:
    from ..touch.seeing import Seeing

    seeing = Seeing()
    views = seeing.views_of(seen.look, seen.mask, seen.metres_per_pixel)
    return seeing.predict(seen.look, views, seed=1).token


def printed_plate() -> Any:
    """A plate of 100 mm under a picture of brown noise, 0.4 mm a texel."""
    import bpy

    from .. import compat
    from ..bridge.importers import empty_scene

    empty_scene()
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
