"""How near are splats to the true mesh? Depth, token and choice of material on patches that strokes touch.

Usage: python -m hnf_lab.experiments.splats [SCENE]… [--most N] [--spacing M] [--fine M] [--seed N] [--json FILE]
       [--markdown FILE]

Without a SCENE: the demo scene. Materials lose their relief first and keep their colour, as in a reconstruction; then
every patch is looked at on the mesh and on splats of it (tests/data_tools/splats_from_scene.py), by the same predicted
route.
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
from hnf_blender.bridge.render.closeup import CloseUp, iter_closeups
from hnf_blender.bridge.render.unlit_image import UnlitImage
from hnf_blender.bridge.scene.meshes import Surface
from hnf_blender.bridge.splats.splat_closeup import iter_splat_closeups
from hnf_blender.bridge.splats.splat_cloud import create_cloud, link_cloud
from hnf_blender.touch.bake_patches import ReliefPredictor
from hnf_blender.touch.session import Session
from hnf_core.errors import HnfError
from hnf_core.files import write_text
from hnf_core.material.fuse import merge_tokens
from hnf_core.material.library import Appearance, load_library
from hnf_core.material.ranking import INVARIANT_KINDS, WITHIN_CLASS_SPREAD, compute_invariants, rank
from hnf_core.material.token import BAND_WAVELENGTHS_M, LEVELS, SHAPE_FEATURES, Token
from hnf_core.scene.patch import PATCH_SIZE_M, Patch
from hnf_core.scene.splats.gaussians import Splats
from hnf_core.scene.splats.rasterize import render_splats
from hnf_core.tactile.tactile_map import Route

Float = NDArray[np.float64]

CLOSEUP_PIXELS = 512
PREDICTION_SEED = 0
BAND_COUNT = len(BAND_WAVELENGTHS_M)


@dataclass(frozen=True)
class PatchReading:
    """What one close-up tells. token: by the predicted route, None where the picture cannot be read. colour: linear
    mean. resolved_m: shortest wave that the picture shows."""

    token: Token | None
    colour: tuple[float, float, float] | None
    resolved_m: float


@dataclass(frozen=True)
class PatchPair:
    """One patch. expected_m, median_m: median absolute errors of the splats' two depths, metres; inf where
    they show none. covered: share of what the mesh shows at which the splats show a surface. mesh, splats: what each
    tells; alike: what the mesh tells of the waves alone that the splats show too."""

    object_name: str
    material: str
    expected_m: float
    median_m: float
    covered: float
    mesh: PatchReading
    splats: PatchReading
    alike: PatchReading


def remove_relief(scene: Any) -> None:
    """Leave of every material its colour alone, as a reconstruction does, so that it is read from pictures."""
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
    """A pair a patch. splats: of obj, in its surface frame."""
    cloud = create_cloud("Splats", splats, "the comparison")
    link_cloud(obj, cloud)
    # The cloud counts in metres of the surface frame, whatever the object's own scale.
    place = np.eye(4)
    place[:3, :3] = np.linalg.inv(surface.stretch)
    cloud.matrix_basis = _to_matrix(place)
    true = iter_closeups(obj, patches, surface=surface, pixels=CLOSEUP_PIXELS, metres_per_unit=metres_per_unit)
    seen = iter_splat_closeups(obj, cloud, patches, surface=surface, pixels=CLOSEUP_PIXELS)
    for patch, mesh, splat in zip(patches, true, seen, strict=True):
        expected, median, covered = compute_depth_errors(mesh, splats)
        name = surface.materials[patch.slot] if patch.slot < len(surface.materials) else ""
        look = read_patch(splat, predictor)
        own, alike = read_patch(mesh, predictor), read_patch(mesh, predictor, look.resolved_m)
        yield PatchPair(obj.name, name, expected, median, covered, own, look, alike)


def compute_depth_errors(mesh: CloseUp, splats: Splats) -> tuple[float, float, float]:
    """Median absolute errors of expected and of median depth (metres) where the patch's own surface is seen, and the
    share of that which splats cover. splats: in the patch's frame."""
    view = render_splats(splats, mesh.view.camera)
    own = mesh.mask & np.isfinite(mesh.view.depth)
    covered = own & (view.opacity >= 0.5)
    if not covered.any():
        return float("inf"), float("inf"), 0.0
    errors = [
        np.abs(depth[covered].astype(np.float64) - mesh.view.depth[covered]) for depth in (view.depth, view.median)
    ]
    return float(np.median(errors[0])), float(np.median(errors[1])), float(covered.sum() / own.sum())


def read_patch(closeup: CloseUp, predictor: ReliefPredictor, coarsest_m: float = 0.0) -> PatchReading:
    """coarsest_m: the picture is taken to show no shorter wave."""
    look: UnlitImage | None = closeup.unlit
    if look is not None and look.resolved_wavelength_m < coarsest_m:
        look = replace(look, resolved_wavelength_m=coarsest_m)
    token = None
    if look is not None:
        views = predictor.make_views(look, closeup.mask, closeup.metres_per_pixel)
        token = predictor.predict(look, views, PREDICTION_SEED).token if views else None
    resolved = float("inf") if look is None else look.resolved_wavelength_m
    return PatchReading(token, closeup.appearance.base_color, resolved)


def choose_library_material(reading: PatchReading, names: Sequence[str] = ()) -> str:
    """What the library takes a patch for, by its colour and its relief, and by names where they are given."""
    route = Route.PRIOR if reading.token is None else Route.PREDICTED
    return rank(load_library(), Appearance(reading.colour), names, token=reading.token, route=route)[0].name


@dataclass(frozen=True)
class PaletteEntry:
    """Of the palette that the true mesh gives: one a material."""

    name: str
    token: Token


def make_palette(pairs: Sequence[PatchPair]) -> tuple[PaletteEntry, ...]:
    """What the true mesh's patches of each material say together; without those that no picture tells of."""
    tokens: dict[str, list[Token]] = {}
    for pair in pairs:
        if pair.mesh.token is not None:
            tokens.setdefault(get_entry_name(pair), []).append(pair.mesh.token)
    return tuple(PaletteEntry(name, merge_tokens(own)) for name, own in tokens.items())


def get_entry_name(pair: PatchPair) -> str:
    return f"{pair.object_name}: {pair.material}"


def find_nearest_entry(token: Token, palette: Sequence[PaletteEntry], known: NDArray[np.bool_]) -> str:
    """The entry whose token is nearest over the features known: in standard deviations between pieces of one class,
    over what no turn of the surface changes."""
    own = compute_invariants(token.values[None])[0]
    within = np.array(
        [WITHIN_CLASS_SPREAD[kind] for kind in INVARIANT_KINDS for _ in range(BAND_COUNT)]
        + [WITHIN_CLASS_SPREAD[name] for name in SHAPE_FEATURES]
    )
    counted = np.concatenate([np.tile(known[LEVELS], len(INVARIANT_KINDS)), known[-len(SHAPE_FEATURES) :]])

    def distance(entry: PaletteEntry) -> float:
        off = (own - compute_invariants(entry.token.values[None])[0]) / within
        return float(np.sum(off[counted] ** 2))

    return min(palette, key=distance).name


def compute_level_difference_db(pair: PatchPair) -> float | None:
    """RMS over the bands that both know, of height in dB; None where they share none."""
    if pair.mesh.token is None or pair.splats.token is None:
        return None
    both = (pair.mesh.token.known & pair.splats.token.known)[LEVELS]
    if not both.any():
        return None
    off = (pair.mesh.token.values - pair.splats.token.values)[LEVELS][both]
    return float(20.0 * np.sqrt(np.mean(off.astype(np.float64) ** 2)))


def _to_matrix(values: Float) -> Any:
    from mathutils import Matrix

    return Matrix(values.tolist())


DEPTH_TARGET, PALETTE_TARGET = 0.01, 0.9
MAX_PATCHES = 6


@dataclass(frozen=True)
class PatchRow:
    """One patch. Depth errors are shares of the patch's size. level_db: None where a picture cannot be read on both.
    palette: None where it can be read on neither, False where on one alone. token: as palette, but where it can be read
    on neither, whether the prior, whose token is then the patch's, is the same library material on both. by_look,
    by_name: whether the library takes both for the same material, without and with the scene's names; alike: without,
    the mesh's picture being as soft."""

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
    """Up to most patches of every object that is touched, spread over its strokes."""
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
        in_own_frame = make_object_splats(
            obj, surface, spacing_m, seed, session.metres_per_unit, patches, fine_m, in_world=False
        )
        pairs += compare_patches(obj, surface, patches, in_own_frame, session.metres_per_unit, session.predictor)
    return make_rows(path.stem, pairs)


def make_rows(scene: str, pairs: Sequence[PatchPair]) -> list[PatchRow]:
    palette = make_palette(pairs)
    made = []
    for pair in pairs:
        read = (pair.mesh.token is not None, pair.splats.token is not None)
        same = None if not any(read) else False
        if pair.mesh.token is not None and pair.splats.token is not None:
            known = pair.mesh.token.known & pair.splats.token.known
            same = find_nearest_entry(pair.mesh.token, palette, known) == find_nearest_entry(
                pair.splats.token, palette, known
            )
        names = [pair.material, pair.object_name]
        by_name = choose_library_material(pair.mesh, names) == choose_library_material(pair.splats, names)
        made.append(
            PatchRow(
                scene=scene,
                entry=get_entry_name(pair),
                expected=pair.expected_m / PATCH_SIZE_M,
                median=pair.median_m / PATCH_SIZE_M,
                covered=pair.covered,
                resolved_mm=pair.splats.resolved_m * 1e3,
                level_db=compute_level_difference_db(pair),
                palette=same,
                token=by_name if same is None else same,
                alike=choose_library_material(pair.alike) == choose_library_material(pair.splats),
                by_look=choose_library_material(pair.mesh) == choose_library_material(pair.splats),
                by_name=by_name,
            )
        )
    return made


TABLE_HEADER = (
    "| scene | object: material | patches | depth, expected | depth, median | covered | finest wave | level apart | "
    "same palette entry | same token | same material by look | of equal detail | by name too |\n|" + " --- |" * 13
)


def format_rows(found: Sequence[PatchRow]) -> str:
    """A row a material, and one of all together."""
    groups: dict[tuple[str, str], list[PatchRow]] = {}
    for row in found:
        groups.setdefault((row.scene, row.entry), []).append(row)
    lines = [TABLE_HEADER, *(_format_line(scene, entry, own) for (scene, entry), own in groups.items())]
    return "\n".join([*lines, _format_line("**all**", "", found)]) + "\n"


def _format_line(scene: str, entry: str, group: Sequence[PatchRow]) -> str:
    def share(name: str) -> str:
        values = [getattr(row, name) for row in group if getattr(row, name) is not None]
        return f"{sum(values)} of {len(values)}" if values else "–"

    def middle(name: str, unit: float, digits: str) -> str:
        values = [getattr(row, name) for row in group if getattr(row, name) is not None]
        return f"{unit * float(np.median(values)):{digits}}" if values else "–"

    return (
        f"| {scene} | {entry} | {len(group)} | {middle('expected', 100, '.3f')} % | {middle('median', 100, '.3f')} % | "
        f"{middle('covered', 100, '.0f')} % | {middle('resolved_mm', 1, '.2f')} mm | "
        f"{middle('level_db', 1, '.1f')} dB | {share('palette')} | {share('token')} | {share('by_look')} | "
        f"{share('alike')} | {share('by_name')} |"
    )


def summarise(found: Sequence[PatchRow]) -> dict[str, Any]:
    """Figures against the targets. patches_within: share of patches whose expected depth is within DEPTH_TARGET."""
    told = [row.palette for row in found if row.palette is not None]
    return {
        "patches": len(found),
        "depth_expected": float(np.median([row.expected for row in found])),
        "depth_median": float(np.median([row.median for row in found])),
        "patches_within": float(np.mean([row.expected <= DEPTH_TARGET for row in found])),
        "same_palette_entry": float(np.mean(told)) if told else None,
        "patches_read": len(told),
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
    parser.add_argument("--spacing", type=float, default=SPACING_M, help="metres (default: %(default)s)")
    parser.add_argument("--fine", type=float, default=FINE_M, help="on patches, metres (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--markdown", type=Path, metavar="FILE")
    arguments = parser.parse_args()
    try:
        found: list[PatchRow] = []
        for path in arguments.scene or [build_demo_scene()]:
            found += compare_scene(path, arguments.most, arguments.spacing, arguments.fine, arguments.seed)
    except HnfError as error:
        print(error, file=sys.stderr)
        return 1
    figures = summarise(found)
    if arguments.json:
        patches = [vars(row) for row in found]
        write_text(arguments.json, json.dumps({"summary": figures, "patches": patches}, indent=1) + "\n")
    if arguments.markdown:
        write_text(arguments.markdown, format_rows(found))
    print(format_rows(found))
    print(json.dumps(figures, indent=1))
    return 0 if meets_targets(figures) else 1


if __name__ == "__main__":
    sys.exit(main())
