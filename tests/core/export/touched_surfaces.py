"""Baked surfaces with a stroke on them, made by hand: for exports that bind touch to geometry."""

from __future__ import annotations

import numpy as np

from hnf_core.export.touched_surface import UNTOUCHED, StrokePath, TouchedSurface
from hnf_core.material.contact_model import Mechanics
from hnf_core.material.palette import Palette
from hnf_core.material.token import LEVELS, TOKEN_DIM
from hnf_core.scene.mesh import TriangleMesh
from hnf_core.signal import Signal

RATE = 10_000.0


def sheet(columns: int = 4, rows: int = 3, *, uv: bool = True) -> TriangleMesh:
    """A flat sheet of squares of 10 mm, two triangles each, in the xy plane, its last column of another slot."""
    across, along = np.meshgrid(np.arange(columns + 1), np.arange(rows + 1))
    flat = np.stack([across.ravel(), along.ravel()], axis=1).astype(np.float64)
    vertices = np.concatenate([flat * 0.01, np.zeros((len(flat), 1))], axis=1)
    triangles, face, slot = [], [], []
    for row in range(rows):
        for column in range(columns):
            a = row * (columns + 1) + column
            triangles += [(a, a + 1, a + columns + 2), (a, a + columns + 2, a + columns + 1)]
            face += [row * columns + column] * 2
            slot += [int(column == columns - 1)] * 2
    corners = np.array(triangles, dtype=np.int32)
    normals = np.broadcast_to([0.0, 0.0, 1.0], (len(corners), 3, 3)).copy()
    maps = flat[corners] / np.array([columns, rows]) if uv else None
    return TriangleMesh(vertices, corners, np.array(face, np.int32), np.array(slot, np.int32), normals, maps)


def palette(count: int = 2) -> Palette:
    """Materials that differ in all that a texture tells; of the last, mechanics are not known."""
    tokens = np.zeros((count, TOKEN_DIM), dtype=np.float32)
    tokens[:, LEVELS] = -5.0 - 0.5 * np.arange(count, dtype=np.float32)[:, None]
    known = [Mechanics(2000.0 / (i + 1), 0.2, 0.3 + 0.1 * i) for i in range(count - 1)]
    return Palette(tokens, (*known, Mechanics()), tuple(f"material {i}" for i in range(count)))


def path_across(mesh: TriangleMesh, seconds: float = 0.3, speed: float = 0.1) -> StrokePath:
    """Along the first row of squares at one speed."""
    time = np.linspace(0.0, seconds, round(200 * seconds) + 1)
    column = np.minimum(speed * time / 0.01, 3.0).astype(np.int32)
    return StrokePath(time, speed * time, 2 * column)


def touched_sheet(*, uv: bool = True, baked: bool = True, path: bool = True) -> TouchedSurface:
    """The sheet, half of it baked, with a stroke across it."""
    mesh = sheet(uv=uv)
    token = np.where(mesh.face % 4 < 2, mesh.face % 2, UNTOUCHED).astype(np.int32)
    if not baked:
        token[:] = UNTOUCHED
    seen = (token >= 0).astype(np.float32)
    return TouchedSurface(
        name="Sheet",
        mesh=mesh,
        materials=("denim", "steel"),
        token=token,
        roughness=seen * np.float32(1e-5) * (1 + token),
        confidence=seen * np.float32(0.75),
        palette=palette() if baked else None,
        path=path_across(mesh) if path else None,
    )


def rough_tone(seconds: float = 0.3, hertz: float = 150.0, peak: float = 12.0) -> Signal:
    time = np.arange(round(seconds * RATE)) / RATE
    samples = (peak * np.sin(2.0 * np.pi * hertz * time)).astype(np.float32)
    facts = {"stroke": "Scrape", "object": "Sheet", "material": "Grès ☕", "probe": "pen", "field": "ab" * 16}
    return Signal(samples, RATE, 7, facts)
