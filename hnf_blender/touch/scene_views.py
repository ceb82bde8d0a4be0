"""Write what the cameras of a scene see (`hnf views`): color, depth, normals and ids, and cameras as nerfstudio's.

All files are written to a temporary folder beside the results' folder, which is renamed at the end, so that there is
never half a result.
"""

from __future__ import annotations

import json
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from hnf_core.cli.render_views import ViewsRequest
from hnf_core.errors import FileError, SceneError, UsageError, close_matches, format_choices, pluralize
from hnf_core.export.gltf import encode_png
from hnf_core.files import FOLDER_MODE, write_bytes, write_text
from hnf_core.progress import Progress, ProgressBar
from hnf_core.scene.camera import Camera
from hnf_core.scene.nerfstudio import TRANSFORMS_FILE, NerfstudioFrame, write_transforms
from hnf_core.scene.rgbd_view import write_exr
from hnf_core.units import linear_to_srgb

from ..bridge.lit_render import CameraView, CameraViewRenderer
from ..bridge.scene.object_size import get_metres_per_unit
from .output_files import iter_numbered_stems, make_file_stem
from .run import open_named_scene

IDS_FILE = "ids.json"
FLAT_TYPES = {"ORTHO": "an orthographic", "PANO": "a panoramic", "CUSTOM": "a custom"}
"""Types of cameras that are no pinhole, with article."""


def write_views(request: ViewsRequest) -> int:
    """Render a scene's cameras to the request's folder and print what was written; return the exit code.

    Raises HnfError if the scene cannot be opened, has no such camera or none that nerfstudio can describe, or the
    folder cannot be written or holds files.
    """
    with _stage_folder(request.out) as staging:
        scene = open_named_scene("views", request.scene)
        cameras, notes = _choose_cameras(scene, request.cameras)
        metres = get_metres_per_unit(scene, request.metres_per_unit)
        frames: dict[str, NerfstudioFrame] = {}
        bar = ProgressBar()
        try:
            with CameraViewRenderer(scene, metres_per_unit=metres, samples=request.samples) as renderer:
                for done, camera_object in enumerate(cameras):
                    bar.show(Progress(f"camera {camera_object.name}", done, len(cameras)))
                    camera = renderer.read_camera(camera_object, request.frame, request.size)
                    view = renderer.render_camera(camera, request.frame)
                    taken = {Path(frame.file_path).stem for frame in frames.values()}
                    stem = next(s for s in iter_numbered_stems(make_file_stem(camera_object.name)) if s not in taken)
                    frames[camera_object.name] = _write_view(staging, stem, camera_object.name, camera, view)
                    notes += view.notes
        finally:
            bar.close()
        ids = {"objects": renderer.objects, "materials": renderer.materials}
        write_text(staging / IDS_FILE, json.dumps(ids, indent=1, ensure_ascii=False) + "\n")
        write_transforms(staging / TRANSFORMS_FILE, list(frames.values()), depth_unit_scale_factor=1.0)
    if request.as_json:
        views = {name: {"file_path": frame.file_path, "depth_file_path": frame.depth_file_path, **frame.more}
                 for name, frame in frames.items()}  # fmt: skip
        written = {"folder": str(request.out), "transforms": TRANSFORMS_FILE, "metres_per_unit": metres, "views": views}
        print(json.dumps({**written, **ids, "notes": list(dict.fromkeys(notes))}, indent=1))
    else:
        print(f"{request.out / TRANSFORMS_FILE}: {pluralize(len(frames), 'camera')}, in meters")
    sys.stdout.flush()
    for note in dict.fromkeys(notes):
        print(f"note: {note}", file=sys.stderr)
    return 0


def _write_view(folder: Path, stem: str, name: str, camera: Camera, view: CameraView) -> NerfstudioFrame:
    """Write the files of one view; return its entry of transforms.json."""
    color, depth, normal, ids = (f"{kind}/{stem}.exr" for kind in ("color", "depth", "normal", "ids"))
    frame = NerfstudioFrame(
        f"images/{stem}.png",
        camera,
        depth,
        {"camera_name": name, "color_file_path": color, "normal_file_path": normal, "ids_file_path": ids},
    )
    rgb, normals = view.view.rgb, view.view.normal
    assert normals is not None
    write_bytes(folder / frame.file_path, encode_png(np.rint(255.0 * linear_to_srgb(rgb)).astype(np.uint8)))
    write_exr(folder / color, {"RGB": rgb})
    write_exr(folder / depth, {"Y": np.where(np.isfinite(view.view.depth), view.view.depth, np.float32(0.0))})
    write_exr(folder / normal, {f"N.{axis}": normals[..., index] for index, axis in enumerate("XYZ")})
    write_exr(folder / ids, {"object.Y": view.object_id, "material.Y": view.material_id})
    return frame


def _choose_cameras(scene: Any, names: tuple[str, ...]) -> tuple[list[Any], list[str]]:
    """Return the cameras of the given names, or all that nerfstudio can describe, and notes on those left out."""
    cameras = sorted((obj for obj in scene.objects if obj.type == "CAMERA"), key=lambda obj: str(obj.name))
    if not cameras:
        raise SceneError(
            f"scene '{scene.name}' has no camera.", remedy="Add one in Blender (Add > Camera) and save the file."
        )
    by_name = {obj.name: obj for obj in cameras}
    for name in names:
        if name not in by_name:
            guess = close_matches(name, by_name)
            raise UsageError(
                f"there is no camera '{name}'.",
                where="--camera",
                remedy=f"Did you mean '{guess[0]}'?" if guess else f"There are: {format_choices(by_name)}.",
            )
    chosen = [by_name[name] for name in names] or cameras
    flat = {obj.name: FLAT_TYPES[obj.data.type] for obj in chosen if obj.data.type in FLAT_TYPES}
    refusals = [f"camera '{name}' is {kind} one, which nerfstudio does not know" for name, kind in flat.items()]
    if (names and flat) or len(flat) == len(chosen):
        raise UsageError(f"{refusals[0]}.", remedy="Set its type to Perspective, or choose others by --camera NAME.")
    return [obj for obj in chosen if obj.name not in flat], [f"{refusal}: left out." for refusal in refusals]


@contextmanager
def _stage_folder(folder: Path) -> Iterator[Path]:
    """Provide a temporary folder that becomes `folder` at the end of the with block, and is removed on any failure.

    Raises FileError if `folder` is a file or not empty, or cannot be made.
    """
    try:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            state = "holds files already" if folder.is_dir() else "is a file"
            raise FileError(f"{state}.", where=str(folder), remedy="Give --out a new or empty folder.")
        target = folder.absolute()
        target.parent.mkdir(parents=True, exist_ok=True)
        staging = Path(tempfile.mkdtemp(dir=target.parent, prefix=f".{target.name}-"))
    except OSError as error:
        raise FileError(
            f"cannot be used as the output folder ({error.strerror}).",
            where=str(folder),
            remedy="Give --out a folder that you may write to.",
        ) from error
    try:
        yield staging
        staging.chmod(FOLDER_MODE)
        if target.is_dir():
            target.rmdir()
        staging.rename(target)
    except OSError as error:
        raise FileError(
            f"could not be written ({error.strerror}).", where=str(folder), remedy="Give another --out."
        ) from error
    finally:
        shutil.rmtree(staging, ignore_errors=True)
