"""Build hnf_blender/assets: materials that look and feel like what they are called, and the eight strokes as presets.

    .venv-4.2/bin/python tools/build_assets.py [--out hnf_blender/assets]

Run it with the oldest Blender supported: later ones read its files, it does not read theirs. Blender's files hold
memory addresses, so two builds differ in bytes and agree in `read_contents`.

Previews for the asset browser are drawn without rendering: a material's relief under a raking light, a stroke's path
coloured by force. They are (H, W, 4) float32, display values 0–1, rows from the bottom. They have few tones on purpose:
they are most of the asset files, and repeated values compress well.
"""

from __future__ import annotations

import argparse
import os
import sys
import uuid
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from hnf_blender import props
from hnf_blender.bridge.scene.material_definition import set_appearance
from hnf_blender.bridge.stroke.place_primitive import place_primitive
from hnf_core.action.primitive_path import PlanarPath, make_path_curve, make_primitive_path
from hnf_core.action.primitives import PRIMITIVES, Primitive
from hnf_core.files import write_text
from hnf_core.material.library import (
    LibraryMaterial,
    load_library,
)
from hnf_core.simulation.surface_recipe import TILE_PIXELS, TILE_SIZE_M, SurfaceRecipe, height_map

PreviewImage = NDArray[np.float32]

PREVIEW_PIXELS = 96
TONE_COUNT = 20
DISPLAYED_SLOPES, TRUE_SLOPES = (0.04, 0.5), (2e-4, 0.06)
"""RMS slopes as drawn and as they are, smoothest and roughest; in between, interpolated over the logarithm of the true
one. The grain of glass and the pile of a carpet must both be visible and differ."""
MOST_ROUGHNESS = 0.4
"""Largest RMS slope of roughness as drawn, as a fraction of that of ribs or weaves beside it."""
PITCH_M = 2.0 * TILE_SIZE_M / TILE_PIXELS
LIGHT_DIRECTION = np.array([-0.6, 0.55, 0.58])
PRESSED_COLOUR, LIFTED_COLOUR = np.array([0.98, 0.55, 0.16]), np.array([0.25, 0.45, 0.85])
BACKGROUND = np.array([0.14, 0.15, 0.17])
LINE_WIDTH_PX = 2.2


def draw_material_preview(material: LibraryMaterial) -> PreviewImage:
    """Draw a patch of 7.5 mm of a material under a raking light.

    A sphere would show only the colour; the patch shows the relief under a finger. What is regular in it, by which
    ribs, weaves and knurls are known at a glance, is not drowned in roughness.
    """
    recipe = SurfaceRecipe.from_dict(material.recipe)
    height = _render_patch(replace(recipe, lattices=()), material.seed)
    if recipe.lattices:
        regular = _render_patch(replace(recipe, noise=(), grains=()), material.seed)
        rough_slope, regular_slope = compute_slope(height), compute_slope(regular)
        height *= min(1.0, MOST_ROUGHNESS * regular_slope / max(rough_slope, 1e-12))
        height += regular
    rows, columns = np.gradient(height, PITCH_M)
    slope = max(compute_slope(height), 1e-9)
    displayed_slope = np.interp(np.log10(slope), np.log10(TRUE_SLOPES), DISPLAYED_SLOPES)
    normal = np.stack([-columns, rows, np.full_like(rows, slope / displayed_slope)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    light = LIGHT_DIRECTION / np.linalg.norm(LIGHT_DIRECTION)
    appearance = material.appearance
    diffuse = np.clip(normal @ light, 0.0, None)
    half = light + np.array([0.0, 0.0, 1.0])
    sharpness = 2.0 / max(appearance.roughness or 0.5, 0.15) ** 2
    specular = np.clip(normal @ half / np.linalg.norm(half), 0.0, None) ** sharpness
    tone = np.round(np.clip(0.18 + 0.85 * diffuse, 0.0, 1.0) * TONE_COUNT) / TONE_COUNT
    highlight = np.round(specular * (1.0 - (appearance.roughness or 0.5)) * 6.0) / 6.0 * 0.6
    colour = np.array(appearance.base_color or (0.8, 0.8, 0.8))
    tint = colour if (appearance.metallic or 0.0) > 0.5 else np.ones(3)
    linear = np.clip(tone[..., None] * colour + highlight[..., None] * tint, 0.0, 1.0)
    return _add_alpha(np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)[::-1])


def _render_patch(recipe: SurfaceRecipe, seed: int) -> NDArray[np.float64]:
    """Render the heights (PREVIEW_PIXELS, PREVIEW_PIXELS) [m] that a preview shows, means of two by two pixels."""
    crop = 2 * PREVIEW_PIXELS
    height = height_map(recipe, seed)[:crop, :crop].astype(np.float64)
    return np.asarray(height.reshape(PREVIEW_PIXELS, 2, PREVIEW_PIXELS, 2).mean(axis=(1, 3)))


def compute_slope(height: NDArray[np.float64]) -> float:
    """Compute the RMS slope of heights [m] that lie PITCH_M apart."""
    return float(np.sqrt(np.mean(np.square(np.gradient(height, PITCH_M)).sum(axis=0))))


def draw_stroke_preview(path: PlanarPath) -> PreviewImage:
    """Draw a path from above, light where it presses, with a dot at its start."""
    curve = make_path_curve(path)
    time = np.linspace(0.0, path.duration_s, 600)
    points = curve.point_at(np.clip(path.progress.sample(time)[0], 0.0, 1.0) * curve.length)
    force = np.clip(path.force.sample(time)[0] / max(float(path.force.value.max()), 1e-9), 0.0, 1.0)
    strength = float(path.force.value.max()) / 2.0  # 2 N is the hardest of the eight
    middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
    spread = float(np.abs(points - middle).max())
    pixel = (points - middle) / spread * 0.38 * PREVIEW_PIXELS + PREVIEW_PIXELS / 2.0
    grid = np.arange(PREVIEW_PIXELS) + 0.5
    distance = np.hypot(grid[None, :, None] - pixel[:, 0], grid[:, None, None] - pixel[:, 1])
    nearest = distance.argmin(axis=-1)
    width = LINE_WIDTH_PX * (0.6 + 0.8 * strength)
    cover = np.clip(width + 0.5 - distance.min(axis=-1), 0.0, 1.0)
    begin = np.clip(2.2 * width + 0.5 - distance[..., 0], 0.0, 1.0)
    pressed = np.round(force[nearest] * TONE_COUNT)[..., None] / TONE_COUNT
    line = pressed * PRESSED_COLOUR + (1.0 - pressed) * LIFTED_COLOUR
    picture = BACKGROUND + cover[..., None] * (line - BACKGROUND)
    return _add_alpha(picture + begin[..., None] * (1.0 - picture))


def _add_alpha(colour: NDArray[np.float64]) -> PreviewImage:
    return np.concatenate([colour, np.ones((*colour.shape[:2], 1))], axis=-1).astype(np.float32)


ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "tools")]


FOLDER = ROOT / "hnf_blender" / "assets"
MATERIALS, STROKES, CATALOGS = "touch_materials.blend", "touch_strokes.blend", "blender_assets.cats.txt"
NAMESPACE = uuid.UUID("5d0c4c7e-6c0e-4f6a-9a55-0f6b1f2a9c11")
AUTHOR, LICENCE = "The Haptic Neural Fields authors", "GPL-3.0-or-later"
PLATE_M = 0.1
STROKE_CATALOG = "Touch/Strokes"


def make_material_catalog(category: str) -> str:
    return f"Touch/Materials/{category.capitalize()}"


def compute_catalog_id(path: str) -> str:
    """Compute the catalog's UUID from its path; it must not change between builds, as asset browsers store it."""
    return str(uuid.uuid5(NAMESPACE, path))


def format_catalogs() -> str:
    """Format the content of blender_assets.cats.txt."""
    leaves = {make_material_catalog(material.category) for material in load_library()} | {STROKE_CATALOG}
    paths = leaves | {"Touch", "Touch/Materials"}
    lines = [f"{compute_catalog_id(path)}:{path}:{path.replace('/', '-')}" for path in sorted(paths)]
    return "\n".join(
        ["# Catalogs of the asset library. tools/build_assets.py writes it.", "", "VERSION 1", "", *lines, ""]
    )


def format_name(name: str) -> str:
    """Format a name for display: `oak-wood` → `Oak wood`."""
    return name.replace("-", " ").capitalize()


def build_material(material: LibraryMaterial) -> Any:
    """Build a Blender material with the appearance of a library material, which is also set as its feel."""
    datablock = bpy.data.materials.new(format_name(material.name))
    set_appearance(datablock, material.appearance)
    datablock.hnf_touch.library = material.name
    mechanics = material.mechanics
    friction = "" if mechanics.friction is None else f", friction {mechanics.friction:g}"
    mark_asset(
        datablock,
        make_material_catalog(material.category),
        f"Looks and feels like {format_name(material.name).lower()}{friction}",
    )
    for word in dict.fromkeys((material.category, *material.words)):
        datablock.asset_data.tags.new(word, skip_if_exists=True)
    set_preview(datablock, draw_material_preview(material))
    return datablock


def build_stroke(primitive: Primitive, plate: Any) -> Any:
    """Build a primitive as a stroke object around the origin, flat on z = 0, without a surface of its own."""
    scene = bpy.context.scene
    stroke = place_primitive(scene, plate, 0, primitive, 1.0, name=format_name(primitive.name)).curve
    stroke.parent = None
    stroke.hnf_stroke.surface = None
    points = stroke.data.splines[0].bezier_points
    knots = np.array([tuple(point.co) for point in points])
    middle = (knots.min(axis=0) + knots.max(axis=0)) / 2.0
    for point in points:
        for part in ("co", "handle_left", "handle_right"):
            setattr(point, part, np.asarray(getattr(point, part)) - middle)
    path = make_primitive_path(primitive)
    mark_asset(
        stroke, STROKE_CATALOG,
        f"{primitive.kind.capitalize()} at {primitive.speed * 1e3:g} mm/s and {primitive.force:g} N, "
        f"{path.duration_s:.1f} s. Drop it on a surface",
    )  # fmt: skip
    for word in dict.fromkeys(("stroke", primitive.kind, *primitive.name.split("-"))):
        stroke.asset_data.tags.new(word, skip_if_exists=True)
    set_preview(stroke, draw_stroke_preview(path))
    return stroke


def mark_asset(datablock: Any, catalog: str, text: str) -> None:
    datablock.asset_mark()
    metadata = datablock.asset_data
    metadata.catalog_id, metadata.description, metadata.author, metadata.license = (
        compute_catalog_id(catalog),
        text,
        AUTHOR,
        LICENCE,
    )


def set_preview(datablock: Any, image: Any) -> None:
    """Set the preview of a datablock to an image (H, W, 4), 0–1, rows from the bottom."""
    preview = datablock.preview_ensure()
    preview.image_size = (image.shape[1], image.shape[0])
    preview.image_pixels_float.foreach_set(np.ascontiguousarray(image, dtype=np.float32).ravel())


def write_assets(folder: Path) -> None:
    """Write both .blend files and the catalogs. Unsaved changes in this Blender are lost."""
    folder.mkdir(parents=True, exist_ok=True)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    _write(folder / MATERIALS, {build_material(material) for material in load_library()})
    bpy.ops.wm.read_factory_settings(use_empty=True)
    plate = _make_plate()
    _write(folder / STROKES, {build_stroke(primitive, plate) for primitive in PRIMITIVES.values()})
    write_text(folder / CATALOGS, format_catalogs())


def read_contents(folder: Path) -> dict[str, Any]:
    """Read all that must agree between two builds. Unsaved changes in this Blender are lost."""
    contents: dict[str, Any] = {"catalogs": (folder / CATALOGS).read_text(encoding="utf-8")}
    for name, kind in ((MATERIALS, "materials"), (STROKES, "objects")):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        with bpy.data.libraries.load(str(folder / name), assets_only=True) as (available, wanted):
            setattr(wanted, kind, getattr(available, kind))
        for asset in getattr(wanted, kind):
            metadata = asset.asset_data
            pixels = np.empty(len(asset.preview.image_pixels_float), dtype=np.float32)
            asset.preview.image_pixels_float.foreach_get(pixels)
            contents[asset.name] = {
                "catalog": metadata.catalog_id, "description": metadata.description, "author": metadata.author,
                "licence": metadata.license, "tags": sorted(tag.name for tag in metadata.tags),
                "picture": (*asset.preview.image_size, np.round(255.0 * pixels).astype(np.uint8).tobytes()),
                **(_read_material(asset) if kind == "materials" else _read_stroke(asset)),
            }  # fmt: skip
    return contents


def _read_material(material: Any) -> dict[str, Any]:
    shader = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    colour = np.round(shader.inputs["Base Color"].default_value[:3], 5).tolist()
    values = [round(shader.inputs[name].default_value, 5) for name in ("Roughness", "Metallic", "Sheen Weight")]
    return {"feels": material.hnf_touch.library, "looks": [*colour, *values]}


def _read_stroke(stroke: Any) -> dict[str, Any]:
    from hnf_blender.compat import fcurves_of

    group = stroke.hnf_stroke
    points = [np.round(tuple(point.co), 6).tolist() for point in stroke.data.splines[0].bezier_points]
    keys = {
        curve.data_path: [np.round(tuple(key.co), 4).tolist() for key in curve.keyframe_points]
        for curve in fcurves_of(stroke)
    }
    return {"stroke": (group.is_stroke, group.law, group.probe, group.surface), "points": points, "keys": keys}


def _make_plate() -> Any:
    half = PLATE_M / 2.0
    mesh = bpy.data.meshes.new("Plate")
    mesh.from_pydata([(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)], [], [(0, 1, 2, 3)])
    layer = mesh.uv_layers.new(name="UVMap")
    for loop in mesh.loops:
        layer.data[loop.index].uv = mesh.vertices[loop.vertex_index].co[:2]
    plate = bpy.data.objects.new("Plate", mesh)
    bpy.context.scene.collection.objects.link(plate)
    bpy.context.view_layer.update()
    return plate


def _write(path: Path, datablocks: set[Any]) -> None:
    path.unlink(missing_ok=True)
    bpy.data.libraries.write(str(path), datablocks, fake_user=True, compress=True)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Build the asset library.")
    parser.add_argument("--out", type=Path, default=FOLDER, metavar="DIR")
    chosen = parser.parse_args(arguments)
    if not hasattr(bpy.types.Object, "hnf_stroke"):
        props.register()
    write_assets(chosen.out)
    for path in sorted(chosen.out.iterdir()):
        print(f"{path} ({path.stat().st_size / 1e3:.0f} kB)")
    return 0


if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    os._exit(code)  # bpy 4.2 may crash and 4.5 hang in the interpreter's exit
