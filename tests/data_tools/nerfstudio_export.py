"""Export a Blender scene as nerfstudio does: images, cameras, depths, splats, points and a mesh.

    python tests/data_tools/nerfstudio_export.py SCENE --out DIR [--object NAME]… [--views N] [--width W] [--height H]
        [--samples N] [--spacing M] [--fine M] [--touched] [--without-mesh] [--seed N]

DIR gets transforms.json, images/, depths/ (millimetres in 16 bits, planar), splat.ply, point_cloud.ply, mesh.obj and
poisson_mesh.ply, all in world metres with z up. Nothing is trained: the splats are those of
tests/data_tools/splats_from_scene.py.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

sys.path[:0] = [str(Path(__file__).parents[2]), str(Path(__file__).parents[1])]

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from data_tools.mesh_sampling import subdivide_mesh
from data_tools.object_splats import (
    PIXELS_PER_SPACING,
    find_touched_patches,
    make_surrounding_cameras,
    render_unlit_colours,
)
from data_tools.splats_from_scene import (
    FINE_M,
    SPACING_M,
    list_visible_meshes,
    make_scene_splats,
    open_session,
    parse_metres,
)
from data_tools.write_splats import write_inria
from hnf_blender.bridge.lit_render import OverviewRenderer
from hnf_blender.touch.session import Session
from hnf_core.errors import HnfError, UsageError
from hnf_core.files import write_bytes, write_text
from hnf_core.scene.camera import Camera
from hnf_core.scene.nerfstudio import TRANSFORMS_FILE, NerfstudioFrame, write_transforms
from hnf_core.scene.splats.gaussians import C0, Splats
from hnf_core.units import linear_to_srgb

Float = NDArray[np.float64]
Codes = NDArray[np.uint8]

UP_AXIS = "Vertical Axis: z"


def write_points(path: Path, points: Float, normals: Float, colours: Codes) -> None:
    """Write points, normals and colours, each (n, 3), as a .ply without faces."""
    names = [*((name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")), *_RGB]
    table = _make_rows(names, points, normals, colours)
    write_bytes(path, _make_header({"vertex": (len(table), names)}) + table.tobytes())


def write_mesh(path: Path, points: Float, triangles: NDArray[np.int32], colours: Codes) -> None:
    """Write points and colours (V, 3) and triangles (T, 3) as a .ply."""
    names = [*((name, "<f4") for name in ("x", "y", "z")), *_RGB]
    faces = np.empty(len(triangles), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, triangles
    head = _make_header({"vertex": (len(points), names), "face": (len(faces), [])})
    write_bytes(path, head + _make_rows(names, points, colours).tobytes() + faces.tobytes())


def write_obj(path: Path, points: Float, triangles: NDArray[np.int32], colours: Codes) -> None:
    """Write points and colours (V, 3) and triangles (T, 3) as an .obj with vertex colours."""
    lines = [
        f"v {x:.6g} {y:.6g} {z:.6g} {r:.4f} {g:.4f} {b:.4f}"
        for (x, y, z), (r, g, b) in zip(points.tolist(), (colours / 255.0).tolist(), strict=True)
    ]
    lines += [f"f {a} {b} {c}" for a, b, c in (triangles + 1).tolist()]
    write_text(path, "\n".join(lines) + "\n")


_RGB = [("red", "u1"), ("green", "u1"), ("blue", "u1")]
_PLY_TYPES = {"<f4": "float", "u1": "uchar"}


def _make_rows(names: list[tuple[str, str]], *parts: NDArray[np.generic]) -> NDArray[np.void]:
    table = np.empty(len(parts[0]), dtype=names)
    columns = [column for part in parts for column in part.T]
    for (name, _), column in zip(names, columns, strict=True):
        table[name] = column
    return table


def _make_header(elements: dict[str, tuple[int, list[tuple[str, str]]]]) -> bytes:
    lines = ["ply", "format binary_little_endian 1.0", f"comment {UP_AXIS}"]
    for element, (count, names) in elements.items():
        lines.append(f"element {element} {count}")
        lines += [f"property {_PLY_TYPES[kind]} {name}" for name, kind in names]
        lines += ["property list uchar int vertex_indices"] if element == "face" else []
    return "\n".join([*lines, "end_header", ""]).encode()


FIELD_OF_VIEW, ELEVATION = np.radians(45.0), np.radians(35.0)
MILLIMETRES_PER_METRE = 1e3
MAX_DEPTH_CODE = 65535


def make_ring_cameras(points: Float, count: int, width: int, height: int) -> tuple[Camera, ...]:
    """Make perspective cameras on a ring above points (n, 3), each with all of them in its image."""
    low, high = points.min(axis=0), points.max(axis=0)
    middle, radius = (low + high) / 2.0, max(float(np.linalg.norm(high - low)) / 2.0, 1e-3)
    focal = min(width, height) / (2.0 * np.tan(FIELD_OF_VIEW / 2.0))
    distance = 1.05 * radius / np.sin(FIELD_OF_VIEW / 2.0)
    intrinsics = np.array([[focal, 0.0, width / 2.0], [0.0, focal, height / 2.0], [0.0, 0.0, 1.0]])
    cameras = []
    for turn in 2.0 * np.pi * np.arange(count) / count - np.pi / 2.0:
        flat, up = np.cos(ELEVATION), np.sin(ELEVATION)
        back = np.array([flat * np.cos(turn), flat * np.sin(turn), up])
        right = np.array([-np.sin(turn), np.cos(turn), 0.0])
        pose = np.eye(4)
        pose[:3, 0], pose[:3, 1], pose[:3, 2] = right, np.cross(-back, right), -back
        pose[:3, 3] = middle + distance * back
        cameras.append(Camera("perspective", width, height, intrinsics, pose, 0.01 * distance, 100.0 * distance))
    return tuple(cameras)


def export_images(
    session: Session, objects: Sequence[Any], cameras: Sequence[Camera], folder: Path, samples: int
) -> tuple[NerfstudioFrame, ...]:
    """Render lit images and planar depths into a folder; returns the frames."""
    frames = []
    with OverviewRenderer(session.scene, metres_per_unit=session.metres_per_unit, samples=samples) as overviews:
        for number, camera in enumerate(cameras, 1):
            view, _ = overviews.render_view(camera, objects)
            frame = NerfstudioFrame(f"images/frame_{number:05d}.png", camera, f"depths/frame_{number:05d}.png")
            codes = np.rint(255.0 * linear_to_srgb(view.rgb)).astype(np.uint8)
            depth = np.where(np.isfinite(view.depth), view.depth * MILLIMETRES_PER_METRE, 0.0)
            _save_image(folder / frame.file_path, codes)
            depth_codes = np.clip(np.rint(depth), 0, MAX_DEPTH_CODE).astype(np.uint16)
            _save_image(folder / frame.depth_file_path, depth_codes)
            frames.append(frame)
    return tuple(frames)


def _save_image(path: Path, codes: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(codes).save(path)


def make_coloured_mesh(
    session: Session, objects: Sequence[Any], longest_m: float
) -> tuple[Float, NDArray[np.int32], Float]:
    """Join all objects in one mesh in world metres: points (V, 3), triangles (T, 3), linear colours (V, 3)."""
    points, triangles, colours = [], [], []
    count = 0
    for obj in objects:
        surface = session.get_surface(obj)
        faces, samples = subdivide_mesh(surface.mesh, longest_m)
        cameras = make_surrounding_cameras(surface.mesh.vertices, longest_m / PIXELS_PER_SPACING)
        colours.append(render_unlit_colours(obj, surface, samples, cameras, session.metres_per_unit))
        points.append(samples.position @ surface.rigid[:3, :3].T + surface.rigid[:3, 3])
        triangles.append(faces + count)
        count += len(samples)
    return np.concatenate(points), np.concatenate(triangles), np.concatenate(colours)


def get_colour_codes(splats: Splats) -> NDArray[np.uint8]:
    rgb = np.clip(0.5 + C0 * splats.harmonics[:, 0], 0.0, 1.0)
    return np.rint(255.0 * rgb).astype(np.uint8)


def export_scene(arguments: argparse.Namespace) -> int:
    """Export the scene that the arguments name; returns the number of splats."""
    folder: Path = arguments.out
    session = open_session(arguments.scene)
    objects = list_visible_meshes(session, arguments.object)
    patches = find_touched_patches(session) if arguments.touched else {}
    splats = make_scene_splats(session, objects, arguments.spacing, arguments.fine, patches, arguments.seed)
    write_inria(folder / "splat.ply", splats, comments=("Generated in the manner of nerfstudio", UP_AXIS))
    write_points(folder / "point_cloud.ply", splats.means, np.zeros_like(splats.means), get_colour_codes(splats))
    if not arguments.without_mesh:
        points, triangles, linear = make_coloured_mesh(session, objects, arguments.spacing)
        codes = np.rint(255.0 * linear_to_srgb(linear)).astype(np.uint8)
        write_mesh(folder / "poisson_mesh.ply", points, triangles, codes)
        write_obj(folder / "mesh.obj", points, triangles, codes)
    cameras = make_ring_cameras(splats.means.astype(np.float64), arguments.views, arguments.width, arguments.height)
    frames = export_images(session, objects, cameras, folder, arguments.samples)
    identity = np.eye(4)[:3].tolist()
    write_transforms(folder / TRANSFORMS_FILE, frames, applied_transform=identity, ply_file_path="point_cloud.ply")
    return len(splats)


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Export a Blender scene in the manner of nerfstudio.")
    parser.add_argument("scene", type=Path)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument(
        "--object", action="append", default=[], metavar="NAME", help="only this object; may be repeated"
    )
    parser.add_argument("--views", type=int, default=8, help="pictures (default: %(default)s)")
    parser.add_argument("--width", type=int, default=480)
    parser.add_argument("--height", type=int, default=320)
    parser.add_argument("--samples", type=int, default=16, help="of a pixel (default: %(default)s)")
    parser.add_argument(
        "--spacing", type=parse_metres, default=SPACING_M, metavar="M", help="metres (default: %(default)s)"
    )
    parser.add_argument(
        "--fine", type=parse_metres, default=FINE_M, metavar="M", help="on patches (default: %(default)s)"
    )
    parser.add_argument("--touched", action="store_true", help="fine on what the scene's strokes touch")
    parser.add_argument("--without-mesh", action="store_true", help="splats and points alone")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args(words)
    try:
        count = export_scene(arguments)
    except HnfError as error:
        print(error, file=sys.stderr)
        return 2 if isinstance(error, UsageError) else 1
    print(f"{arguments.out / TRANSFORMS_FILE}: {arguments.views} pictures, {count} splats")
    return 0


if __name__ == "__main__":
    sys.exit(main())
