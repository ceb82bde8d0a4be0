"""A splat file → its splats and the surface to touch them on. Without bpy, so that a thread can do it; the surface is
made once and kept by the file's content."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hnf_core import __version__
from hnf_core.archive import DAMAGED
from hnf_core.files import content_hash, write_bytes
from hnf_core.scene.ply_header import read_ply_header
from hnf_core.scene.splats.cloud import Splats
from hnf_core.scene.splats.frame import up_axis
from hnf_core.scene.splats.read import read_splats
from hnf_core.scene.splats.surface import CELLS, VIEWS, Progress, reconstruct

KEPT_VERSION = 1
PACKED = ".compressed"
"""What PlayCanvas's tools put before .ply; no part of a scene's name."""


@dataclass(frozen=True)
class TouchSurface:
    """What is touched of splats, in their frame and unit. vertices: (V, 3) float32. triangles: (T, 3) int32. colour:
    (V, 3) float32 linear. warnings: what makes it poor to touch."""

    vertices: NDArray[np.float32]
    triangles: NDArray[np.int32]
    colour: NDArray[np.float32]
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class Reconstruction:
    """A splat file as a scene. name: of the object. source: of the file. up: (3,) unit, of the splats' frame.
    was_kept: nothing was reconstructed for it."""

    name: str
    source: str
    up: tuple[float, float, float]
    splats: Splats
    surface: TouchSurface
    was_kept: bool


def read_reconstruction(
    path: Path,
    cache: Path | None = None,
    *,
    keep: bool = True,
    cells: int | None = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """The splats of a file and their surface: from cache where it was made before, else made now and put there.

    cache: folder, None = nothing is kept. keep: False = read from it and write nothing. cells: along its longest axis,
    None = CELLS. progress: as reconstruct takes it. Raises FileError where the file cannot be read, SceneError where
    nothing solid is seen in it.
    """
    cells = CELLS if cells is None else cells
    splats = read_splats(path)
    surface = None if cache is None else _kept(cache, path, cells)
    found = surface is not None
    if surface is None:
        made = reconstruct(splats, cells=cells, progress=progress, where=str(path))
        surface = TouchSurface(made.vertices, made.triangles, made.colour, made.quality.warnings)
        if cache is not None and keep:
            _keep(cache, path, cells, surface)
    name = path.stem[: -len(PACKED)] if path.stem.lower().endswith(PACKED) else path.stem
    up = up_axis(read_ply_header(path)).direction
    return Reconstruction(name or path.stem, path.name, up, splats, surface, found)


def _kept_path(cache: Path, path: Path, cells: int) -> Path:
    made_by = f"{__version__} {KEPT_VERSION} {cells} {VIEWS}"
    return cache / f"{content_hash('reconstruction', made_by, path.read_bytes())}.npz"


def _kept(cache: Path, path: Path, cells: int) -> TouchSurface | None:
    """A damaged file counts as absent: it is made anew."""
    try:
        with np.load(_kept_path(cache, path, cells), allow_pickle=False) as data:
            warnings = tuple(str(line) for line in data["warnings"])
            surface = TouchSurface(data["vertices"], data["triangles"], data["colour"], warnings)
    except DAMAGED:
        return None
    count = len(surface.vertices)
    fits = surface.triangles.size and surface.triangles.min() >= 0 and surface.triangles.max() < count
    return surface if fits and surface.colour.shape == surface.vertices.shape == (count, 3) else None


def _keep(cache: Path, path: Path, cells: int, surface: TouchSurface) -> None:
    packed = io.BytesIO()
    np.savez(
        packed,
        vertices=surface.vertices,
        triangles=surface.triangles,
        colour=surface.colour,
        warnings=np.array(surface.warnings, dtype=np.str_),
    )
    write_bytes(_kept_path(cache, path, cells), packed.getvalue())
