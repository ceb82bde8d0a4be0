"""Write a Blender scene as 3-D Gaussians, to compare results on splats with those on the true mesh.

    python tests/data_tools/splats_from_scene.py SCENE --out F.ply [--object NAME]… [--spacing M] [--fine M]
        [--touched] [--patch X,Y,Z]… [--seed N]

SCENE is anything that `hnf touch` opens. Splats are flat discs of the material's unlit colour, degree 0, in world
metres, z up. Splats are --spacing apart, and --fine apart on the patches that the scene's strokes touch (--touched) and
around the --patch places (world metres).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

sys.path[:0] = [str(Path(__file__).parents[2]), str(Path(__file__).parents[1])]

import bpy
import numpy as np

from data_tools.object_splats import concatenate_splats, find_touched_patches, make_object_splats
from data_tools.write_splats import write_inria
from hnf_blender import props
from hnf_blender.bridge.importers import open_scene
from hnf_blender.bridge.scene.object_size import is_visible
from hnf_blender.touch.session import Session, make_scene_session
from hnf_core.errors import HnfError, UsageError
from hnf_core.scene.camera import Patch
from hnf_core.scene.splats.gaussians import Splats
from reference.geometry import ReferenceGeometry

UP_AXIS = "Vertical Axis: z"
SPACING_M, FINE_M = 2e-3, 0.15e-3


def open_session(path: Path) -> Session:
    """Open a scene as `hnf touch` does."""
    if not hasattr(bpy.types.Object, "hnf_stroke"):
        props.register()
    scene = open_scene(path)
    return make_scene_session(scene, scene.view_layers[0], Path(bpy.app.tempdir))


def list_visible_meshes(session: Session, names: Sequence[str]) -> list[Any]:
    """List the named mesh objects, or all visible ones. Raises UsageError for a name that is no mesh of the scene."""
    meshes = {obj.name: obj for obj in session.scene.objects if obj.type == "MESH"}
    unknown = [name for name in names if name not in meshes]
    if unknown:
        raise UsageError(f"there is no mesh object '{unknown[0]}'.", remedy=f"There are: {', '.join(sorted(meshes))}.")
    return [meshes[name] for name in names] or [
        obj for obj in meshes.values() if is_visible(obj, session.view_layer) and len(obj.data.polygons)
    ]


def find_patch_near(session: Session, objects: Sequence[Any], point: np.ndarray) -> tuple[str, Patch]:
    """Find the object whose surface is closest to a point (3,) [world metres], and the patch there."""
    best, nearest = np.inf, None
    for obj in objects:
        surface = session.get_surface(obj)
        local = (point - surface.rigid[:3, 3]) @ surface.rigid[:3, :3]
        found = ReferenceGeometry(surface.mesh).closest_points(local[None])
        if found.distance[0] < best:
            corners = surface.mesh.corner_positions()[found.triangle[0]]
            normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
            along = (corners[1] - corners[0]) / np.linalg.norm(corners[1] - corners[0])
            slot = int(surface.mesh.slot[found.triangle[0]])
            best = float(found.distance[0])
            nearest = (obj.name, Patch(found.position[0], along, normal / np.linalg.norm(normal), slot))
    if nearest is None:
        raise UsageError("the scene holds no mesh.", remedy="Give a scene with one.")
    return nearest


def make_scene_splats(
    session: Session, objects: Sequence[Any], spacing_m: float, fine_m: float, patches: dict[str, tuple[Patch, ...]],
    seed: int,
) -> Splats:  # fmt: skip
    """Make the splats of all objects; patches are by object name, in the object's surface frame."""
    return concatenate_splats([
        make_object_splats(
            obj, session.get_surface(obj), spacing_m, seed + number, session.metres_per_unit, patches.get(obj.name, ()),
            fine_m,
        )
        for number, obj in enumerate(objects)
    ])  # fmt: skip


def convert_scene(arguments: argparse.Namespace) -> Splats:
    session = open_session(arguments.scene)
    objects = list_visible_meshes(session, arguments.object)
    patches = find_touched_patches(session) if arguments.touched else {}
    for point in arguments.patch:
        name, patch = find_patch_near(session, objects, point)
        patches[name] = (*patches.get(name, ()), patch)
    return make_scene_splats(session, objects, arguments.spacing, arguments.fine, patches, arguments.seed)


def build_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description="Write a Blender scene as 3-D Gaussian splats.")
    parser.add_argument("scene", type=Path)
    parser.add_argument("--out", type=Path, required=True, help="the .ply to write (INRIA layout)")
    parser.add_argument(
        "--object", action="append", default=[], metavar="NAME", help="only this object; may be repeated"
    )
    parser.add_argument(
        "--spacing", type=parse_metres, default=SPACING_M, metavar="M", help="metres (default: %(default)s)"
    )
    parser.add_argument(
        "--fine", type=parse_metres, default=FINE_M, metavar="M", help="on patches (default: %(default)s)"
    )
    parser.add_argument("--touched", action="store_true", help="fine on what the scene's strokes touch")
    parser.add_argument(
        "--patch", type=_parse_point, action="append", default=[], metavar="X,Y,Z", help="fine around it too"
    )
    parser.add_argument("--seed", type=int, default=0)
    return parser


def parse_metres(text: str) -> float:
    value = float(text)
    if not 1e-6 <= value <= 1e3:
        raise argparse.ArgumentTypeError(f"{text} m is no spacing")
    return value


def _parse_point(text: str) -> np.ndarray:
    values = np.array([float(part) for part in text.split(",")])
    if values.shape != (3,) or not np.isfinite(values).all():
        raise argparse.ArgumentTypeError(f"'{text}' is not X,Y,Z")
    return values


def main(words: list[str] | None = None) -> int:
    arguments = build_parser().parse_args(words)
    try:
        splats = convert_scene(arguments)
        write_inria(arguments.out, splats, comments=(UP_AXIS,))
    except HnfError as error:
        print(error, file=sys.stderr)
        return 2 if isinstance(error, UsageError) else 1
    print(f"{arguments.out}: {len(splats)} splats")
    return 0


if __name__ == "__main__":
    sys.exit(main())
