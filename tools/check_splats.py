"""How near are splats to the true mesh? Depth, token and choice of material on patches that strokes touch.

    python tools/check_splats.py [SCENE]… [--most N] [--spacing M] [--fine M] [--seed N] [--json FILE] [--markdown FILE]

Without a SCENE: the demo scene. Materials lose their relief first and keep their colour, as in a reconstruction; then
every patch is looked at on the mesh and on splats of it (tools/splats_from_scene.py), by the same predicted route.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parent)]

# ruff: noqa: E402
import numpy as np
from scene_splats.compare import (
    PatchPair,
    choose_library_material,
    compare_patches,
    compute_level_difference_db,
    find_nearest_entry,
    get_entry_name,
    make_palette,
    remove_relief,
)
from scene_splats.convert import make_object_splats
from scene_splats.touched import find_touched_patches
from splats_from_scene import FINE_M, SPACING_M, open_session

from hnf_blender.touch.jobs import Session
from hnf_core.errors import HnfError
from hnf_core.files import write_text
from hnf_core.scene.patch import PATCH_SIZE_M, Patch

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
