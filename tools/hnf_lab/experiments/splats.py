"""Compare splats with the true mesh: depth, token and choice of material on touched patches.

  Usage: python -m hnf_lab.experiments.splats [SCENE]… [--most N] [--spacing M] [--fine M] [--seed N] [--json FILE]
         [--markdown FILE]

Without a SCENE the demo scene is used. Materials lose their relief first and keep their colour, as in a reconstruction;
then every patch is viewed on the mesh and on splats of it (tests/data_tools/splats_from_scene.py), by the same
predicted route.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np
from numpy.typing import NDArray

from data_tools.object_splats import find_touched_patches, make_object_splats
from data_tools.splats_from_scene import FINE_M, SPACING_M, open_session
from hnf_blender.bridge.closeup import CloseUp, CloseUpRenderer
from hnf_blender.bridge.cycles import UnlitImage
from hnf_blender.bridge.scene.meshes import Surface
from hnf_blender.bridge.splat_closeup import SplatCloseUpRenderer
from hnf_blender.bridge.splat_cloud import create_cloud, link_cloud
from hnf_blender.touch.bake_patches import ReliefPredictor
from hnf_blender.touch.session import Session
from hnf_core.errors import HnfError
from hnf_core.files import write_text
from hnf_core.material.fuse import merge_tokens
from hnf_core.material.library import Appearance, load_library
from hnf_core.material.ranking import INVARIANT_KINDS, WITHIN_CLASS_SPREAD, compute_invariants, rank
from hnf_core.material.token import BAND_WAVELENGTHS_M, LEVELS, SHAPE_FEATURES, Token
from hnf_core.scene.camera import PATCH_SIZE_M, Patch
from hnf_core.scene.splats.gaussians import Splats
from hnf_core.scene.splats.rasterize import render_splats
from hnf_core.tactile.tactile_map import Route

Float = NDArray[np.float64]

CLOSEUP_PIXELS = 512
PREDICTION_SEED = 0
BAND_COUNT = len(BAND_WAVELENGTHS_M)


@dataclass(frozen=True)
class PatchReading:
    """Evaluation of one close-up.

    Attributes
    ----------
    token
        Token by the predicted route; None if the image is unusable.
    colour
        Mean linear colour.
    resolved_m
        Shortest resolved wavelength [m].
    """

    token: Token | None
    colour: tuple[float, float, float] | None
    resolved_m: float


@dataclass(frozen=True)
class PatchPair:
    """One patch on the mesh and on its splats.

    Attributes
    ----------
    expected_m, median_m
        Median absolute errors of the splats' expected and median depth [m]; inf without coverage.
    covered
        Fraction of the mesh's pixels on which the splats show a surface.
    alike
        Reading of the mesh limited to the wavelengths that the splats resolve.
    """

    object_name: str
    material: str
    expected_m: float
    median_m: float
    covered: float
    mesh: PatchReading
    splats: PatchReading
    alike: PatchReading


def remove_relief(scene: Any) -> None:
    """Remove bump and displacement from every material, as a reconstruction does, so images are used instead."""
    for obj in scene.objects:
        for slot in getattr(obj, "material_slots", ()):
            tree = slot.material.node_tree if slot.material is not None else None
            for link in list(tree.links) if tree is not None else ():
                bump = link.to_socket.name in {"Normal", "Coat Normal"} and link.to_node.bl_idname.startswith(BSDF)
                if bump or (link.to_node.bl_idname == OUTPUT and link.to_socket.name == "Displacement"):
                    tree.links.remove(link)


BSDF, OUTPUT = "ShaderNodeBsdf", "ShaderNodeOutputMaterial"


def compare_patches(
    obj: Any,
    surface: Surface,
    patches: Sequence[Patch],
    splats: Splats,
    metres_per_unit: float,
    predictor: ReliefPredictor,
) -> Iterator[PatchPair]:
    """Yield a pair per patch. splats: splats of obj, in its surface frame."""
    cloud = create_cloud("Splats", splats, "the comparison")
    link_cloud(obj, cloud)
    # The cloud is in metres of the surface frame, independent of the object's scale.
    frame = np.eye(4)
    frame[:3, :3] = np.linalg.inv(surface.stretch)
    cloud.matrix_basis = _to_matrix(frame)
    mesh_renderer = CloseUpRenderer(
        obj, patches, surface=surface, pixels=CLOSEUP_PIXELS, metres_per_unit=metres_per_unit
    )
    splat_renderer = SplatCloseUpRenderer(obj, cloud, patches, surface=surface, pixels=CLOSEUP_PIXELS)
    with mesh_renderer, splat_renderer:
        for patch in patches:
            mesh, splat = mesh_renderer.render(patch), splat_renderer.render(patch)
            expected, median, covered = compute_depth_errors(mesh, splats)
            name = surface.materials[patch.slot] if patch.slot < len(surface.materials) else ""
            splat_reading, mesh_reading = read_patch(splat, predictor), read_patch(mesh, predictor)
            limited_reading = read_patch(mesh, predictor, splat_reading.resolved_m)
            yield PatchPair(obj.name, name, expected, median, covered, mesh_reading, splat_reading, limited_reading)


def compute_depth_errors(mesh: CloseUp, splats: Splats) -> tuple[float, float, float]:
    """Return the median absolute errors of expected and median depth [m], and the covered fraction.

    Only pixels of the patch's own surface count. splats: in the patch's frame.
    """
    view = render_splats(splats, mesh.view.camera)
    visible = mesh.mask & np.isfinite(mesh.view.depth)
    covered = visible & (view.opacity >= 0.5)
    if not covered.any():
        return float("inf"), float("inf"), 0.0
    errors = [
        np.abs(depth[covered].astype(np.float64) - mesh.view.depth[covered]) for depth in (view.depth, view.median)
    ]
    return float(np.median(errors[0])), float(np.median(errors[1])), float(covered.sum() / visible.sum())


def read_patch(closeup: CloseUp, predictor: ReliefPredictor, coarsest_m: float = 0.0) -> PatchReading:
    """Evaluate a close-up; its resolved wavelength is at least `coarsest_m`."""
    image: UnlitImage | None = closeup.unlit
    if image is not None and image.resolved_wavelength_m < coarsest_m:
        image = replace(image, resolved_wavelength_m=coarsest_m)
    token = None
    if image is not None:
        views = predictor.make_views(image, closeup.mask, closeup.metres_per_pixel)
        token = predictor.predict(image, views, PREDICTION_SEED).token if views else None
    resolved = float("inf") if image is None else image.resolved_wavelength_m
    return PatchReading(token, closeup.appearance.base_color, resolved)


def choose_library_material(reading: PatchReading, names: Sequence[str] = ()) -> str:
    """Return the library material ranked first by colour, relief and, if given, names."""
    route = Route.PRIOR if reading.token is None else Route.PREDICTED
    return rank(load_library(), Appearance(reading.colour), names, token=reading.token, route=route)[0].name


@dataclass(frozen=True)
class PaletteEntry:
    """Token of one material, from the true mesh."""

    name: str
    token: Token


def make_palette(pairs: Sequence[PatchPair]) -> tuple[PaletteEntry, ...]:
    """Merge the tokens of each material's patches on the true mesh; materials without a token are omitted."""
    tokens: dict[str, list[Token]] = {}
    for pair in pairs:
        if pair.mesh.token is not None:
            tokens.setdefault(get_entry_name(pair), []).append(pair.mesh.token)
    return tuple(PaletteEntry(name, merge_tokens(entry_tokens)) for name, entry_tokens in tokens.items())


def get_entry_name(pair: PatchPair) -> str:
    return f"{pair.object_name}: {pair.material}"


def find_nearest_entry(token: Token, palette: Sequence[PaletteEntry], known: NDArray[np.bool_]) -> str:
    """Return the palette entry whose token is nearest over the known features.

    The distance is over rotation-invariant features, in standard deviations within one class.
    """
    invariants = compute_invariants(token.values[None])[0]
    spread = np.array(
        [WITHIN_CLASS_SPREAD[kind] for kind in INVARIANT_KINDS for _ in range(BAND_COUNT)]
        + [WITHIN_CLASS_SPREAD[name] for name in SHAPE_FEATURES]
    )
    is_counted = np.concatenate([np.tile(known[LEVELS], len(INVARIANT_KINDS)), known[-len(SHAPE_FEATURES) :]])

    def distance(entry: PaletteEntry) -> float:
        difference = (invariants - compute_invariants(entry.token.values[None])[0]) / spread
        return float(np.sum(difference[is_counted] ** 2))

    return min(palette, key=distance).name


def compute_level_difference_db(pair: PatchPair) -> float | None:
    """Return the RMS height difference [dB] over the bands known to both, or None."""
    if pair.mesh.token is None or pair.splats.token is None:
        return None
    both = (pair.mesh.token.known & pair.splats.token.known)[LEVELS]
    if not both.any():
        return None
    difference = (pair.mesh.token.values - pair.splats.token.values)[LEVELS][both]
    return float(20.0 * np.sqrt(np.mean(difference.astype(np.float64) ** 2)))


def _to_matrix(values: Float) -> Any:
    from mathutils import Matrix

    return Matrix(values.tolist())


DEPTH_TARGET, PALETTE_TARGET = 0.01, 0.9
MAX_PATCHES = 6


@dataclass(frozen=True)
class PatchRow:
    """Results of one patch.

    Attributes
    ----------
    expected, median
        Depth errors as fractions of the patch's size.
    level_db
        Level difference; None if one of the two images is unusable.
    palette
        True if both give the same palette entry; None if both images are unusable, False if one is.
    token
        As palette, but if both are unusable, whether the library materials chosen as prior agree.
    by_look, by_name
        True if the library ranks the same material first, without and with the scene's names.
    alike
        As by_look, with the mesh's image as coarse as that of the splats.
    """

    scene: str
    entry: str
    expected: float
    median: float
    covered: float
    resolved_mm: float
    level_db: float | None
    palette: bool | None
    token: bool
    by_look: bool
    alike: bool
    by_name: bool


def select_patches(session: Session, most: int) -> dict[str, tuple[Patch, ...]]:
    """Return up to `most` patches of every touched object, spread over its strokes."""
    return {name: _space_evenly(patches, most) for name, patches in find_touched_patches(session).items()}


def _space_evenly(patches: Sequence[Patch], most: int) -> tuple[Patch, ...]:
    chosen = np.unique(np.linspace(0, len(patches) - 1, min(most, len(patches))).round().astype(int))
    return tuple(patches[index] for index in chosen)


def compare_scene(path: Path, most: int, spacing_m: float, fine_m: float, seed: int) -> list[PatchRow]:
    session = open_session(path)
    remove_relief(session.scene)
    session = Session(session.scene, session.view_layer, session.metres_per_unit, session.request)
    pairs: list[PatchPair] = []
    for name, patches in select_patches(session, most).items():
        obj: Any = session.scene.objects[name]
        surface = session.get_surface(obj)
        splats = make_object_splats(
            obj, surface, spacing_m, seed, session.metres_per_unit, patches, fine_m, in_world=False
        )
        pairs += compare_patches(obj, surface, patches, splats, session.metres_per_unit, session.predictor)
    return make_rows(path.stem, pairs)


def make_rows(scene: str, pairs: Sequence[PatchPair]) -> list[PatchRow]:
    palette = make_palette(pairs)
    rows = []
    for pair in pairs:
        read = (pair.mesh.token is not None, pair.splats.token is not None)
        same_entry = None if not any(read) else False
        if pair.mesh.token is not None and pair.splats.token is not None:
            known = pair.mesh.token.known & pair.splats.token.known
            same_entry = find_nearest_entry(pair.mesh.token, palette, known) == find_nearest_entry(
                pair.splats.token, palette, known
            )
        names = [pair.material, pair.object_name]
        by_name = choose_library_material(pair.mesh, names) == choose_library_material(pair.splats, names)
        rows.append(
            PatchRow(
                scene=scene,
                entry=get_entry_name(pair),
                expected=pair.expected_m / PATCH_SIZE_M,
                median=pair.median_m / PATCH_SIZE_M,
                covered=pair.covered,
                resolved_mm=pair.splats.resolved_m * 1e3,
                level_db=compute_level_difference_db(pair),
                palette=same_entry,
                token=by_name if same_entry is None else same_entry,
                alike=choose_library_material(pair.alike) == choose_library_material(pair.splats),
                by_look=choose_library_material(pair.mesh) == choose_library_material(pair.splats),
                by_name=by_name,
            )
        )
    return rows


TABLE_HEADER = (
    "| scene | object: material | patches | depth, expected | depth, median | covered | finest wave | level apart | "
    "same palette entry | same token | same material by look | of equal detail | by name too |\n|" + " --- |" * 13
)


def format_rows(found: Sequence[PatchRow]) -> str:
    """Format a row per material, and one of all together."""
    groups: dict[tuple[str, str], list[PatchRow]] = {}
    for row in found:
        groups.setdefault((row.scene, row.entry), []).append(row)
    lines = [TABLE_HEADER, *(_format_line(scene, entry, group) for (scene, entry), group in groups.items())]
    return "\n".join([*lines, _format_line("**all**", "", found)]) + "\n"


def _format_line(scene: str, entry: str, group: Sequence[PatchRow]) -> str:
    def count(name: str) -> str:
        values = [getattr(row, name) for row in group if getattr(row, name) is not None]
        return f"{sum(values)} of {len(values)}" if values else "–"

    def median(name: str, unit: float, digits: str) -> str:
        values = [getattr(row, name) for row in group if getattr(row, name) is not None]
        return f"{unit * float(np.median(values)):{digits}}" if values else "–"

    return (
        f"| {scene} | {entry} | {len(group)} | {median('expected', 100, '.3f')} % | {median('median', 100, '.3f')} % | "
        f"{median('covered', 100, '.0f')} % | {median('resolved_mm', 1, '.2f')} mm | "
        f"{median('level_db', 1, '.1f')} dB | {count('palette')} | {count('token')} | {count('by_look')} | "
        f"{count('alike')} | {count('by_name')} |"
    )


def summarise(found: Sequence[PatchRow]) -> dict[str, Any]:
    """Return the figures for the targets. patches_within: fraction of patches within DEPTH_TARGET."""
    readable = [row.palette for row in found if row.palette is not None]
    return {
        "patches": len(found),
        "depth_expected": float(np.median([row.expected for row in found])),
        "depth_median": float(np.median([row.median for row in found])),
        "patches_within": float(np.mean([row.expected <= DEPTH_TARGET for row in found])),
        "same_palette_entry": float(np.mean(readable)) if readable else None,
        "patches_read": len(readable),
        "same_token": float(np.mean([row.token for row in found])),
        "same_material_by_look": float(np.mean([row.by_look for row in found])),
        "same_material_of_equal_detail": float(np.mean([row.alike for row in found])),
        "same_material_by_name": float(np.mean([row.by_name for row in found])),
        "level_db": float(np.median([row.level_db for row in found if row.level_db is not None] or [np.nan])),
    }


def meets_targets(figures: dict[str, Any]) -> bool:
    same = figures["same_palette_entry"]
    read_alike = same is None or same >= PALETTE_TARGET
    return figures["depth_expected"] <= DEPTH_TARGET and read_alike and figures["same_token"] >= PALETTE_TARGET


def build_demo_scene() -> Path:
    import bpy
    import make_demo_scene

    path = Path(bpy.app.tempdir) / "demo.blend"
    make_demo_scene.build_scene()
    make_demo_scene.save_scene(path)
    return path


def main() -> int:
    parser = argparse.ArgumentParser(description="Compare splats of scenes with their true meshes.")
    parser.add_argument("scene", type=Path, nargs="*")
    parser.add_argument("--most", type=int, default=MAX_PATCHES, help="patches an object (default: %(default)s)")
    parser.add_argument("--spacing", type=float, default=SPACING_M, help="meters (default: %(default)s)")
    parser.add_argument("--fine", type=float, default=FINE_M, help="on patches, meters (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--markdown", type=Path, metavar="FILE")
    arguments = parser.parse_args()
    try:
        rows: list[PatchRow] = []
        for path in arguments.scene or [build_demo_scene()]:
            rows += compare_scene(path, arguments.most, arguments.spacing, arguments.fine, arguments.seed)
    except HnfError as error:
        print(error, file=sys.stderr)
        return 1
    figures = summarise(rows)
    if arguments.json:
        patches = [vars(row) for row in rows]
        write_text(arguments.json, json.dumps({"summary": figures, "patches": patches}, indent=1) + "\n")
    if arguments.markdown:
        write_text(arguments.markdown, format_rows(rows))
    print(format_rows(rows))
    print(json.dumps(figures, indent=1))
    return 0 if meets_targets(figures) else 1


if __name__ == "__main__":
    sys.exit(main())
