"""A splat file → its splats and the surface to touch them on. Without bpy, so that a thread can do it; the surface is
made once and kept by the file's content."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hnf_core import __version__
from hnf_core.archive import NPZ_ERRORS
from hnf_core.files import content_hash, write_bytes
from hnf_core.scene.ply_header import read_ply_header
from hnf_core.scene.splats.cloud import Splats
from hnf_core.scene.splats.frame import detect_up_axis
from hnf_core.scene.splats.read import read_splats
from hnf_core.scene.splats.surface import DEFAULT_CELLS, DEFAULT_VIEWS, Progress, reconstruct_surface

CACHE_VERSION = 1
COMPRESSED_SUFFIX = ".compressed"
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
    was_cached: bool


def read_reconstruction(
    path: Path,
    cache: Path | None = None,
    *,
    write_cache: bool = True,
    cells: int | None = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """The splats of a file and their surface: from cache where it was made before, else made now and put there.

    cache: folder, None = nothing is kept. keep: False = read from it and write nothing. cells: along its longest axis,
    None = CELLS. progress: as reconstruct takes it. Raises FileError where the file cannot be read, SceneError where
    nothing solid is seen in it.
    """
    cells = DEFAULT_CELLS if cells is None else cells
    splats = read_splats(path)
    surface = None if cache is None else _load_cached(cache, path, cells)
    found = surface is not None
    if surface is None:
        made = reconstruct_surface(splats, cells=cells, progress=progress, where=str(path))
        surface = TouchSurface(made.vertices, made.triangles, made.colour, made.quality.warnings)
        if cache is not None and write_cache:
            _save_cached(cache, path, cells, surface)
    name = path.stem[: -len(COMPRESSED_SUFFIX)] if path.stem.lower().endswith(COMPRESSED_SUFFIX) else path.stem
    up = detect_up_axis(read_ply_header(path)).direction
    return Reconstruction(name or path.stem, path.name, up, splats, surface, found)


def _get_cache_path(cache: Path, path: Path, cells: int) -> Path:
    made_by = f"{__version__} {CACHE_VERSION} {cells} {DEFAULT_VIEWS}"
    return cache / f"{content_hash('reconstruction', made_by, path.read_bytes())}.npz"


def _load_cached(cache: Path, path: Path, cells: int) -> TouchSurface | None:
    """A damaged file counts as absent: it is made anew."""
    try:
        with np.load(_get_cache_path(cache, path, cells), allow_pickle=False) as data:
            warnings = tuple(str(line) for line in data["warnings"])
            surface = TouchSurface(data["vertices"], data["triangles"], data["colour"], warnings)
    except NPZ_ERRORS:
        return None
    count = len(surface.vertices)
    fits = surface.triangles.size and surface.triangles.min() >= 0 and surface.triangles.max() < count
    return surface if fits and surface.colour.shape == surface.vertices.shape == (count, 3) else None


def _save_cached(cache: Path, path: Path, cells: int, surface: TouchSurface) -> None:
    packed = io.BytesIO()
    np.savez(
        packed,
        vertices=surface.vertices,
        triangles=surface.triangles,
        colour=surface.colour,
        warnings=np.array(surface.warnings, dtype=np.str_),
    )
    write_bytes(_get_cache_path(cache, path, cells), packed.getvalue())
