"""Faces of PLY meshes: what Blender takes on trust is checked before it opens them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hnf_core.errors import FileError
from hnf_core.scene.ply import check_faces, read_ply_header


def mesh_ply(path: Path, faces: list[list[int]], *, order: str = "<", vertices: int = 6, count: int | None = None):
    """A binary mesh with `vertices` corners and faces of any number of them."""
    word = {"<": "little", ">": "big"}[order]
    head = f"ply\nformat binary_{word}_endian 1.0\nelement vertex {vertices}\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz")
    head += (
        f"element face {len(faces) if count is None else count}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    body = np.arange(3 * vertices, dtype=f"{order}f4").tobytes()
    body += b"".join(bytes([len(face)]) + np.array(face, f"{order}i4").tobytes() for face in faces)
    path.write_bytes(head.encode() + body)
    return path


MIXED = [[0, 1, 2], [2, 3, 4, 5], [1, 2, 3]] * 50 + [[0, 1, 2]] * 500 + [[]] + [[5, 4, 3, 2, 1]] * 3


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("faces", [[[0, 1, 2]], [[3, 4, 5]] * 1000, MIXED, []])
def test_whole_faces_are_taken(tmp_path, order, faces):
    path = mesh_ply(tmp_path / "mesh.ply", faces, order=order)
    check_faces(path, read_ply_header(path))


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(
    ("faces", "count", "said"),
    [
        ([*MIXED, [0, 1, 6]], None, "vertex that is not there"),
        ([[0, 1, 2], [0, -1, 2], *MIXED], None, "vertex that is not there"),
        (MIXED, 10**6, "cut short: 654 of its 1000000"),
        ([], 1, "cut short"),
    ],
)
def test_faces_that_blender_would_trust_are_refused(tmp_path, order, faces, count, said):
    path = mesh_ply(tmp_path / "mesh.ply", faces, order=order, count=count)
    with pytest.raises(FileError, match=said):
        check_faces(path, read_ply_header(path))


def test_faces_that_cannot_be_checked_are_left_to_blender(tmp_path):
    path = mesh_ply(tmp_path / "mesh.ply", [[0, 1, 99]])
    text = path.read_bytes().replace(b"uchar int vertex_indices\n", b"uchar int vertex_indices\nproperty uchar flags\n")
    path.write_bytes(text)
    check_faces(path, read_ply_header(path))


@pytest.mark.parametrize(("old", "new"), [(b"_little_", b"_littletle_"), (b"element vertex 6", b"elemend vertex 6")])
def test_headers_that_blender_would_trust_are_refused(tmp_path, old, new):
    path = mesh_ply(tmp_path / "mesh.ply", [[0, 1, 2]])
    path.write_bytes(path.read_bytes().replace(old, new))
    with pytest.raises(FileError, match=r"format is|no vertices"):
        check_faces(path, read_ply_header(path))
