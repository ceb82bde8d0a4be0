"""Contacts, patches and actions on surfaces whose answers are known."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.action.contacts import (
    DeformingMesh,
    StrokeSamples,
    action_from_contacts,
    covers,
    find_contacts,
    find_nearest_on_triangles,
    plan_patches,
    require_contact,
)
from hnf_core.action.curves import build_arc_curve, make_poly_curve, make_smooth_curve
from hnf_core.action.motion_profile import make_motion_at_speed, make_motion_from_progress
from hnf_core.errors import SceneError, StrokeError
from hnf_core.scene.mesh import TriangleMesh
from reference.geometry import ReferenceGeometry

RATE = 200.0


def grid_mesh(shape=lambda x, y: 0 * x, *, n=24, size=0.1, uv=True, turn=0.0, slots=lambda x, y: 0 * x):
    """A square height field of 2 n² triangles around 0; UVs are metres turned by `turn`."""
    line = np.linspace(-size / 2, size / 2, n + 1)
    x, y = (axis.ravel() for axis in np.meshgrid(line, line))
    vertices = np.stack([x, y, shape(x, y)], axis=1)
    i = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    triangles = np.concatenate([np.stack([i, i + 1, i + n + 2], 1), np.stack([i, i + n + 2, i + n + 1], 1)])
    return mesh_from(vertices, triangles, uv=uv, turn=turn, slots=slots)


def mesh_from(vertices, triangles, *, uv=True, turn=0.0, slots=lambda x, y: 0 * x):
    corners = vertices[triangles]
    facet = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    smooth = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(smooth, triangles[:, k], facet)
    smooth /= np.linalg.norm(smooth, axis=1, keepdims=True)
    c, s = np.cos(turn), np.sin(turn)
    flat = corners[..., :2] @ np.array([[c, s], [-s, c]]).T
    middle = corners.mean(axis=1)
    count = np.arange(len(triangles), dtype=np.int32)
    return TriangleMesh(
        vertices,
        triangles.astype(np.int32),
        count,
        slots(middle[:, 0], middle[:, 1]).astype(np.int32),
        smooth[triangles],
        flat if uv else None,
    )


def stroke(points, *, speed=0.1, force=1.0, progress=None, smooth=False):
    curve = build_arc_curve(make_smooth_curve(points) if smooth else make_poly_curve(points))
    if progress is None:
        time = np.arange(int(np.ceil((curve.length / speed + 0.1) * RATE)) + 1) / RATE
        motion = make_motion_at_speed(time, curve.length, speed)
    else:
        time = np.arange(len(progress)) / RATE
        motion = make_motion_from_progress(np.asarray(progress, float), curve.length, RATE)
    return StrokeSamples(
        time,
        curve.point_at(motion.position),
        curve.tangent_at(motion.position),
        motion.position,
        motion.velocity,
        np.broadcast_to(np.asarray(force, float), time.shape).copy(),
    )


def acted(samples, mesh, **keywords):
    contacts = find_contacts(samples, mesh, **keywords)
    patches, index = plan_patches(contacts)
    return contacts, patches, index, action_from_contacts(contacts, patches, index)


LINE = [[-0.03, 0.0, 0.0], [0.03, 0.0, 0.0]]


def test_plane_gives_back_the_stroke():
    samples = stroke(LINE)
    contacts, patches, index, action = acted(samples, grid_mesh())
    assert np.allclose(contacts.point, samples.point, atol=1e-15)
    assert np.allclose(contacts.normal, [0, 0, 1])
    assert np.allclose(contacts.uv_tangent, [1, 0, 0])
    assert contacts.uv_known.all()
    assert np.allclose(action.speed, np.abs(samples.velocity), rtol=1e-12)
    assert np.allclose(action.direction, [1, 0])
    assert action.rate == RATE
    assert action.contact.all()
    assert np.array_equal(action.position, samples.position)
    # 60 mm in patches that reach 7 mm either way.
    assert len(patches) == 5
    assert np.array_equal(np.unique(index), np.arange(5))


def test_every_touched_sample_lies_well_inside_its_patch():
    contacts, patches, index, _ = acted(stroke([[-0.04, -0.03, 0], [0.03, 0.01, 0], [0.0, 0.04, 0]]), grid_mesh())
    for k, patch in enumerate(patches):
        assert (index == k).any()
        assert np.abs(patch.to_plane(contacts.point[index == k])).max() <= 0.7 * patch.size_m / 2 + 1e-12
    assert (index >= 0).all()


def test_direction_turns_with_the_uvs():
    for turn in (np.pi / 2, 0.7, -2.0):
        *_, action = acted(stroke(LINE), grid_mesh(turn=turn))
        # ∂p/∂u stands `turn` to the left of +x, so the patch sees the stroke `turn` to the right.
        assert np.allclose(action.direction, [np.cos(turn), -np.sin(turn)], atol=1e-12)


def test_without_uvs_an_object_axis_is_used_and_said():
    contacts, patches, _, action = acted(stroke(LINE), grid_mesh(uv=False))
    assert not contacts.uv_known.any()
    assert np.allclose(action.direction, [1, 0])
    assert np.allclose(patches[0].x_axis, [1, 0, 0])
    mesh = grid_mesh()
    broken = dataclasses.replace(mesh, uv=np.zeros_like(mesh.uv))
    assert not find_contacts(stroke(LINE), broken).uv_known.any()
    # A wall that faces +x has no +x to lay on it: its +y takes over.
    wall = mesh_from(mesh.vertices[:, [2, 0, 1]], mesh.triangles, uv=False)
    contacts = find_contacts(stroke([[0, -0.03, 0], [0, 0.03, 0]]), wall)
    assert np.allclose(contacts.uv_tangent, [0, 1, 0])


def test_reversed_stroke():
    mesh = grid_mesh(lambda x, y: 0.2 * x * x)
    there = np.concatenate([np.linspace(0, 1, 100), np.linspace(1, 0, 100)])
    _, patches, index, action = acted(stroke(LINE, progress=there), mesh)
    assert np.allclose(action.direction[20:90], [1, 0], atol=1e-2)
    assert np.allclose(action.direction[110:190], [-1, 0], atol=1e-2)
    assert np.allclose(action.position, action.position[::-1])
    assert np.array_equal(index, index[::-1])
    assert len(patches) <= 5


def test_bend_keeps_the_curves_speed():
    """A circular arc over a faceted cylinder: speed is the curve's to 1e-6, whatever the facets' normals say."""
    radius, angles = 0.05, np.linspace(-0.5, 0.5, 60)
    mesh = grid_mesh(lambda x, y: np.sqrt(radius**2 - x**2) - radius, n=11, size=0.08)
    arc = np.stack([radius * np.sin(angles), 0 * angles, radius * np.cos(angles) - radius], 1)
    samples = stroke(arc, smooth=True)
    contacts, patches, index, action = acted(samples, mesh)
    assert contacts.on_surface.all()
    assert np.allclose(action.speed, np.abs(samples.velocity), rtol=1e-9)
    way = np.sum((action.speed[1:] + action.speed[:-1]) / 2) / RATE
    assert way == pytest.approx(samples.position[-1], rel=1e-5)
    assert np.allclose(np.einsum("nx,nx->n", contacts.uv_tangent, contacts.normal), 0, atol=1e-12)
    for k in range(len(patches)):
        assert np.all(contacts.normal[index == k] @ patches[k].normal >= np.cos(np.radians(25)) - 1e-12)


def test_knots_and_corners_make_no_spike():
    samples = stroke([[-0.03, 0, 0], [-0.01, 0.0, 0], [0, 0.02, 0], [0.0, 0.02, 0], [0.03, 0, 0]])
    *_, action = acted(samples, grid_mesh())
    assert action.speed.max() <= 0.1 * (1 + 1e-9)
    cruise = (samples.time > 0.11) & (samples.time < samples.time[-1] - 0.12)
    assert np.allclose(action.speed[cruise], 0.1)


def test_off_surface_and_lifted_stretches_are_masked():
    samples = stroke([[-0.09, 0, 0], [0.09, 0, 0]])
    contacts, _, index, action = acted(samples, grid_mesh())
    off = np.abs(samples.point[:, 0]) > 0.05 + 5e-3
    assert np.array_equal(contacts.on_surface, ~off)
    assert np.array_equal(action.contact, ~off)
    assert np.all(index[off] == -1)
    force = np.where(np.arange(len(samples.time)) % 40 < 20, 1.0, 0.0)
    *_, index, action = acted(dataclasses.replace(samples, force=force), grid_mesh())
    assert np.array_equal(action.contact, ~off & (force > 0))
    assert np.array_equal(index >= 0, action.contact)
    hover = dataclasses.replace(samples, point=samples.point + np.array([0, 0, 0.006]))
    _, patches, _, action = acted(hover, grid_mesh())
    assert patches == ()
    assert not action.contact.any()
    assert find_contacts(hover, grid_mesh(), tolerance_m=0.007).on_surface.any()


def test_pressing_in_place():
    samples = stroke([[0.01, 0.02, 0.0]], progress=np.linspace(0, 1, 60), force=np.hanning(60))
    _, patches, _, action = acted(samples, grid_mesh())
    assert np.all(action.speed == 0)
    assert np.array_equal(action.direction, np.tile([1.0, 0.0], (60, 1)))
    assert np.array_equal(action.contact, samples.force > 0)
    assert len(patches) == 1


def find_and_plan(samples, mesh):
    contacts = find_contacts(samples, mesh)
    return (contacts, *plan_patches(contacts))


def test_materials_split_patches():
    mesh = grid_mesh(slots=lambda x, y: (x > 0).astype(int))
    contacts, patches, index = find_and_plan(stroke(LINE), mesh)
    assert {patch.slot for patch in patches} == {0, 1}
    assert np.array_equal(np.array([p.slot for p in patches])[index], contacts.slot)


def test_steep_normals_split_patches():
    mesh = grid_mesh(lambda x, y: np.abs(x), n=20)
    contacts, patches, index = find_and_plan(stroke([[-0.005, 0, 0.005], [0, 0, 0], [0.005, 0, 0.005]]), mesh)
    assert len(patches) >= 2
    assert (index >= 0).all()
    assert all(covers(patches[k], contacts)[i] for i, k in enumerate(index))


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000))
def test_motion_of_surface_and_curve_leaves_the_action_alone(seed):
    """In one common frame here; the Blender tests move whole objects."""
    rng = np.random.default_rng(seed)
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    rotation *= np.sign(np.linalg.det(rotation))
    shift = rng.normal(size=3)
    mesh = grid_mesh(lambda x, y: 2.0 * x * y + x * x)
    points = np.column_stack([rng.uniform(-0.03, 0.03, (4, 2)), np.zeros(4)])
    points[:, 2] = 2 * points[:, 0] * points[:, 1] + points[:, 0] ** 2
    moved_mesh = dataclasses.replace(
        mesh, vertices=mesh.vertices @ rotation.T + shift, normals=mesh.normals @ rotation.T
    )
    _, patches, index, action = acted(stroke(points, smooth=True), mesh)
    _, moved_patches, moved_index, moved = acted(stroke(points @ rotation.T + shift, smooth=True), moved_mesh)
    assert len(patches) == len(moved_patches)
    assert np.array_equal(index, moved_index)
    for name in ("direction", "speed", "force", "position"):
        assert np.allclose(getattr(action, name), getattr(moved, name), atol=1e-6)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([1, 7, 40]))
def test_nearest_agrees_with_trying_every_triangle(seed, n):
    rng = np.random.default_rng(seed)
    mesh = grid_mesh(lambda x, y: 0.02 * np.sin(60 * x) * np.cos(50 * y), n=n)
    points = rng.normal(scale=0.04, size=(20, 3))
    fast = find_nearest_on_triangles(points, mesh.corner_positions())
    slow = ReferenceGeometry(mesh).closest_points(points)
    assert np.allclose(fast.distance, slow.distance, atol=2e-9)
    found = np.einsum("nc,ncx->nx", fast.barycentric, mesh.corner_positions()[fast.triangle])
    assert np.allclose(np.linalg.norm(found - points, axis=1), slow.distance, atol=2e-9)


def test_a_mesh_without_faces_is_refused():
    mesh = grid_mesh(n=1)
    empty = dataclasses.replace(mesh, triangles=mesh.triangles[:0], face=mesh.face[:0], slot=mesh.slot[:0])
    with pytest.raises(SceneError, match="Cup: the surface has no faces"):
        find_contacts(stroke(LINE), empty, where="Cup")


def sliding_mesh(speed, seconds=2.0, frames=25):
    mesh = grid_mesh(size=0.3, n=30)
    time = np.linspace(0.0, seconds, frames)
    shift = np.outer(time, speed)
    return DeformingMesh(mesh, time, mesh.vertices[None] + shift[:, None])


def test_speed_is_relative_to_a_sliding_surface():
    """Material that slides by at −50 mm/s under a hand at +100 mm/s is felt at 150 mm/s."""
    samples = stroke(LINE)
    contacts, _, _, action = acted(samples, sliding_mesh([-0.05, 0.0, 0.0]))
    assert np.allclose(action.speed, np.abs(samples.velocity) + 0.05, atol=1e-9)
    assert action.position[-1] == pytest.approx(0.06 + 0.05 * samples.time[-1], rel=1e-3)
    assert np.allclose(contacts.normal, [0, 0, 1])


def test_a_resting_hand_feels_a_moving_surface():
    samples = stroke([[0.0, 0.0, 0.0]], progress=np.zeros(100))
    *_, action = acted(samples, sliding_mesh([0.0, 0.03, 0.0]))
    assert np.allclose(action.speed, 0.03, atol=1e-9)
    assert np.allclose(action.direction, [0, -1], atol=1e-9)
    assert action.position[-1] == pytest.approx(0.03 * samples.time[-1], rel=1e-6)


def test_riding_along_is_rest():
    """Hand and surface move together: nothing is stroked."""
    samples = stroke([[0.0, 0.0, 0.0]], progress=np.zeros(100))
    riding = dataclasses.replace(samples, point=samples.point + np.outer(samples.time, [0.04, 0, 0]), moving=True)
    *_, action = acted(riding, sliding_mesh([0.04, 0.0, 0.0]))
    assert np.abs(action.speed).max() < 1e-9


def test_tilting_and_stretching_surface_is_felt_at_rest():
    """A sheet that leans over (z = a(t) x) under a hand that follows it: contacts stay with the material."""
    mesh = grid_mesh(n=4)
    time = np.linspace(0, 1, 30)
    vertices = np.repeat(mesh.vertices[None], 30, axis=0)
    vertices[:, :, 2] = time[:, None] * vertices[:, :, 0]
    samples = stroke([[0.02, 0.01, 0.0]], progress=np.zeros(201))
    following = samples.point + np.outer(samples.time, [0, 0, 0.02])
    contacts = find_contacts(
        dataclasses.replace(samples, point=following, moving=True), DeformingMesh(mesh, time, vertices)
    )
    assert np.allclose(contacts.normal, [0, 0, 1], atol=1e-12)
    assert np.allclose(contacts.point, samples.point, atol=1e-12)
    assert np.abs(contacts.velocity).max() < 1e-9
    # The same hand crosses a sheet stretched to twice its length at its own speed, in half as much material.
    wide = np.repeat((mesh.vertices * [2.0, 1.0, 1.0])[None], 2, axis=0)
    along = stroke(LINE)
    stretched = find_contacts(along, DeformingMesh(mesh, np.array([0.0, 9.0]), wide))
    assert np.allclose(np.linalg.norm(stretched.velocity, axis=1), np.abs(along.velocity), atol=1e-12)
    assert np.allclose(stretched.point, along.point * [0.5, 1, 1], atol=1e-12)


def test_touching_nothing_is_said():
    for height, said in ((0.02, "20 mm"), (49.0, "49 m")):
        samples = stroke([[0.0, 0.0, height], [0.01, 0.0, height]])
        with pytest.raises(StrokeError, match=f"Scrape: it touches nothing: 'Cup' stays {said} away"):
            require_contact(find_contacts(samples, grid_mesh()), where="Scrape", surface="Cup")
    weak = stroke(LINE, force=0.0)
    with pytest.raises(StrokeError, match="Scrape: it never presses"):
        require_contact(find_contacts(weak, grid_mesh()), where="Scrape", surface="Cup")
    require_contact(find_contacts(stroke(LINE), grid_mesh()), where="Scrape", surface="Cup")


def test_static_deforming_mesh_equals_the_mesh():
    mesh = grid_mesh(lambda x, y: x * y)
    samples = stroke([[-0.03, 0.01, -0.0003], [0.03, 0.01, 0.0003]])
    still = DeformingMesh(mesh, np.array([0.0, 0.5, 1.0]), np.repeat(mesh.vertices[None], 3, axis=0))
    a, b = find_contacts(samples, mesh), find_contacts(samples, still)
    for name in ("point", "normal", "uv_tangent", "velocity"):
        assert np.allclose(getattr(a, name), getattr(b, name), atol=1e-10), name
