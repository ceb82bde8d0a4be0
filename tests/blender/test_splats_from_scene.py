"""A scene as splats: where its surface is, of its colour, flat, and fine where it is touched."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from builders import add_plane, add_sphere
from closeup_builders import principled
from predicted_scene import photo, photo_material
from touch_scene import line_stroke

from data_tools import splats_from_scene
from data_tools.object_splats import compute_rotations_from_z, make_object_splats
from hnf_blender.bridge.scene.meshes import read_surface
from hnf_core.scene.camera import Patch
from hnf_core.scene.splats.gaussians import C0
from hnf_core.scene.splats.splat_file import read_splats

UP = np.array([0.0, 0.0, 1.0])


def splats_of(obj, spacing=2e-3, patches=(), fine=None, seed=0):
    bpy.context.view_layer.update()
    surface = read_surface(obj, bpy.context.view_layer.depsgraph, 1.0)
    return make_object_splats(obj, surface, spacing, seed, 1.0, patches, fine)


def shown(splats) -> np.ndarray:
    """(n, 3) sRGB."""
    return 0.5 + C0 * splats.harmonics[:, 0]


def srgb(linear) -> np.ndarray:
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)


def thin_axis(splats) -> np.ndarray:
    """(n, 3) of each splat's smallest axis: z, by R(q) z."""
    w, x, y, z = splats.rotations.T
    return np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=1)


def test_splats_of_a_photo_wear_its_colours() -> None:
    """A texel of 0.5 mm, splats 0.5 mm apart: each has the photo's colour at its own place."""
    pixels = photo(64)
    smooth = sum(np.roll(pixels, (i, j), (0, 1)) for i in range(-3, 4) for j in range(-3, 4)) / 49.0
    plate = add_plane("Board", 0.03)
    plate.data.materials.append(photo_material(smooth, texel=0.5e-3))
    splats = splats_of(plate, 0.5e-3)
    assert (splats.degree, len(splats)) == (0, 3600)
    texel = np.floor(splats.means[:, :2] / 0.5e-3 + 1e-6).astype(int) % 64
    expected = srgb(smooth[texel[:, 1], texel[:, 0]])
    assert np.abs(shown(splats) - expected).mean() < 0.01
    assert np.corrcoef(shown(splats)[:, 0], expected[:, 0])[0, 1] > 0.97


def test_splats_lie_flat_on_a_turned_and_stretched_ball() -> None:
    ball = add_sphere("Ball", radius=0.5, segments=24, rings=12)
    ball.scale, ball.rotation_euler, ball.location = (0.04, 0.06, 0.08), (0.3, 0.5, 0.7), (1.0, 2.0, 3.0)
    splats = splats_of(ball, 3e-3)
    matrix = np.array(ball.matrix_world)
    own = (splats.means - matrix[:3, 3]) @ np.linalg.inv(matrix[:3, :3]).T
    # Facets of a ball of 24 by 12 lie up to 4 % inside it.
    radius = np.linalg.norm(own, axis=1) / 0.5
    assert 0.95 < radius.min() <= radius.max() <= 1.0 + 1e-5
    outward = own @ np.linalg.inv(matrix[:3, :3])
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    assert np.einsum("nx,nx->n", thin_axis(splats), outward).min() > 0.94
    assert splats.scales[:, 2].max() < 0.2 * splats.scales[:, :2].min()
    np.testing.assert_allclose(np.linalg.norm(splats.rotations, axis=1), 1.0, atol=1e-6)


def test_what_no_camera_sees_has_the_colour_of_its_material() -> None:
    """A box in a box: nothing of the inner one is seen from outside."""
    import bmesh

    mesh = bpy.data.meshes.new("Boxes")
    made = bmesh.new()
    for size in (0.1, 0.05):
        bmesh.ops.create_cube(made, size=size)
    made.to_mesh(mesh)
    made.free()
    boxes = bpy.data.objects.new("Boxes", mesh)
    bpy.context.scene.collection.objects.link(boxes)
    for name, colour in (("Red", (0.5, 0.1, 0.1, 1.0)), ("Green", (0.1, 0.5, 0.1, 1.0))):
        material = bpy.data.materials.new(name)
        material.use_nodes = True
        principled(material).inputs["Base Color"].default_value = colour
        mesh.materials.append(material)
    for index, face in enumerate(mesh.polygons):
        face.material_index = index // 6
    splats = splats_of(boxes, 5e-3)
    inner = np.abs(splats.means).max(axis=1) < 0.03
    assert 0.1 < inner.mean() < 0.3
    outside = srgb(np.array([0.5, 0.1, 0.1]))
    np.testing.assert_allclose(shown(splats)[~inner] - outside, 0.0, atol=2e-3)
    # Nothing tells the colour of the hidden one: it has that of what has no material.
    np.testing.assert_allclose(shown(splats)[inner], srgb(np.array(0.8)), atol=1e-6)


def test_the_tool_writes_what_the_scene_touches_finely(tmp_path, capsys) -> None:
    plate = add_plane("Board", 0.12)
    plate.data.materials.append(photo_material(photo(64)))
    add_plane("Other", 0.1, z=-0.1)
    line_stroke("Along")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    words = [str(tmp_path / "scene.blend"), "--out", str(tmp_path / "board.ply"), "--object", "Board", "--touched"]
    words += ["--spacing", "4e-3", "--fine", "1e-3"]
    assert splats_from_scene.main(words) == 0
    head = (tmp_path / "board.ply").read_bytes()[:200]
    assert b"comment Vertical Axis: z" in head
    splats = read_splats(tmp_path / "board.ply")
    assert str(len(splats)) in capsys.readouterr().out
    assert np.abs(splats.means[:, 2]).max() < 1e-6  # nothing of the other plane
    fine = splats.scales[:, 0] < 1e-3
    assert 0.05 < fine.mean() < 0.95
    assert np.abs(splats.means[fine, 1]).max() < 0.02  # around the stroke along x
    assert fine[np.abs(splats.means).max(axis=1) < 5e-3].all()
    first = (tmp_path / "board.ply").read_bytes()
    assert splats_from_scene.main(words) == 0
    assert (tmp_path / "board.ply").read_bytes() == first


def test_an_unknown_object_is_named_and_nothing_is_written(tmp_path, capsys) -> None:
    add_plane("Board")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    words = [str(tmp_path / "scene.blend"), "--out", str(tmp_path / "x.ply"), "--object", "Bord"]
    assert splats_from_scene.main(words) == 2
    assert "'Bord'" in capsys.readouterr().err
    assert not (tmp_path / "x.ply").exists()


@pytest.mark.parametrize("normal", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0.6, 0.0, 0.8), (1e-9, 0.0, -1.0)])
def test_a_turn_brings_z_to_the_normal(normal) -> None:
    (w, x, y, z), n = compute_rotations_from_z(np.array([normal], dtype=float))[0], np.asarray(normal, dtype=float)
    turned = [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]
    np.testing.assert_allclose(turned, n, atol=1e-8)


def test_a_place_makes_its_surroundings_fine() -> None:
    plate = add_plane("Board", 0.1)
    plate.data.materials.append(photo_material(photo(64)))
    patch = Patch(np.array([0.02, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]), UP, 0)
    splats = splats_of(plate, 5e-3, [patch], 1e-3)
    near = np.linalg.norm(splats.means - patch.centre, axis=1) < 0.015
    assert splats.scales[near, 0].max() < splats.scales[~near, 0].max() / 4.0
