"""Splats in a .blend: exact round trips, lookup by surface, and a hash that follows changes."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import bpy
import numpy as np
import pytest
from builders import add_plane
from hypothesis import given, settings
from hypothesis import strategies as st
from mathutils import Matrix
from splat_builders import read_point_tokens

from hnf_blender.bridge import splat_reconstruction
from hnf_blender.bridge.scene.stored_data import PointTokens
from hnf_blender.bridge.splat_cloud import (
    HARMONIC_ATTRIBUTE,
    CloudFrame,
    compute_cloud_frame,
    create_cloud,
    get_cloud,
    get_cloud_placement,
    get_reconstruction_notes,
    get_uniform_scale,
    hash_cloud,
    is_cloud,
    link_cloud,
    read_cloud,
    remove_point_tokens,
    write_point_tokens,
)
from hnf_blender.bridge.splat_reconstruction import GROUP_NAME, MAX_SHOWN_SPLATS, get_display_stride, show_ellipsoids
from hnf_core.errors import SceneError
from hnf_core.scene.camera import Patch
from hnf_core.scene.splats.gaussians import Splats


def some_splats(count: int = 7, degree: int = 0, seed: int = 0) -> Splats:
    rng = np.random.default_rng(seed)
    rotations = rng.normal(size=(count, 4))
    parts = (
        rng.normal(size=(count, 3)),
        10.0 ** rng.uniform(-6.0, 0.0, (count, 3)),
        rotations / np.linalg.norm(rotations, axis=1, keepdims=True),
        rng.uniform(size=count),
        rng.normal(size=(count, (degree + 1) ** 2, 3)),
    )
    return Splats(*(np.asarray(part, dtype=np.float32) for part in parts))


def same(first: Splats, second: Splats) -> bool:
    pairs = [(getattr(first, each.name), getattr(second, each.name)) for each in fields(Splats)]
    return all(a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes() for a, b in pairs)


def reconstructed(splats: Splats | None = None):
    """A plane whose splats are the ones given."""
    surface = add_plane("Pot", 1.0)
    cloud = create_cloud("Pot splats", splats or some_splats(), "pot.ply")
    bpy.context.scene.collection.objects.link(cloud)
    link_cloud(surface, cloud, ("one", "two"))
    bpy.context.view_layer.update()
    return surface, cloud


@settings(max_examples=20, deadline=None)
@given(st.integers(1, 40), st.integers(0, 3), st.integers(0, 1000))
def test_what_goes_in_comes_out_bit_for_bit(count: int, degree: int, seed: int) -> None:
    splats = some_splats(count, degree, seed)
    cloud = create_cloud("Cloud", splats, "a.ply")
    assert is_cloud(cloud)
    assert same(read_cloud(cloud), splats)
    assert (cloud.hide_render, cloud.hide_select) == (True, True)


def test_splats_survive_saving_appending_and_renaming(tmp_path: Path) -> None:
    splats = some_splats(degree=2)
    surface, cloud = reconstructed(splats)
    key = hash_cloud(surface, cloud)
    surface.name, cloud.name, cloud.data.name = "Jug", "its points", "data"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    jug = bpy.data.objects["Jug"]
    assert same(read_cloud(get_cloud(jug)), splats)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(str(tmp_path / "a.blend")) as (_, wanted):
        wanted.objects = ["Jug"]
    (jug,) = wanted.objects
    assert same(read_cloud(get_cloud(jug)), splats)
    assert hash_cloud(jug, get_cloud(jug)) == key
    assert get_reconstruction_notes(jug) == ("one", "two")
    bpy.data.objects.remove(get_cloud(jug))
    assert get_cloud(jug) is None
    assert get_reconstruction_notes(jug) == ()


def test_the_hash_depends_on_values_and_local_placement_only() -> None:
    surface, cloud = reconstructed(some_splats(degree=1))
    key = hash_cloud(surface, cloud)
    surface.location, surface.rotation_euler = (3.0, -2.0, 1.0), (0.3, 1.0, -2.0)
    cloud.name, surface.name = "other", "names"
    cloud.hide_viewport = True
    tokens = PointTokens(np.zeros(7, dtype=np.int32), np.ones(7, dtype=np.float32))
    write_point_tokens(cloud, tokens)
    bpy.context.view_layer.update()
    assert hash_cloud(surface, cloud) == key
    for name, values in (
        ("scale", "vector"),
        ("rotation", "value"),
        ("opacity", "value"),
        (HARMONIC_ATTRIBUTE.format(3), "vector"),
    ):
        entry = cloud.data.attributes[name].data[4]
        before = getattr(entry, values)
        before = before if name == "opacity" else tuple(before)
        setattr(entry, values, 0.75 if name == "opacity" else (*before[1:], before[0]))
        assert hash_cloud(surface, cloud) != key, name
        setattr(entry, values, before)
        assert hash_cloud(surface, cloud) == key
    cloud.data.vertices[2].co.x += 1e-3
    assert hash_cloud(surface, cloud) != key
    cloud.data.vertices[2].co.x -= 1e-3
    cloud.location.z = 0.01
    assert hash_cloud(surface, cloud) != key


def test_tokens_of_splats_are_written_read_and_removed() -> None:
    _, cloud = reconstructed()
    assert read_point_tokens(cloud) is None
    tokens = PointTokens(np.arange(-1, 6, dtype=np.int32), np.linspace(0.0, 1.0, 7, dtype=np.float32))
    write_point_tokens(cloud, tokens)
    found = read_point_tokens(cloud)
    assert found is not None
    assert found.index.tolist() == tokens.index.tolist()
    assert found.confidence.tolist() == tokens.confidence.tolist()
    with pytest.raises(SceneError, match="it has 7 splats, the bake has 3"):
        write_point_tokens(cloud, PointTokens(tokens.index[:3], tokens.confidence[:3]))
    assert remove_point_tokens(cloud) == 2 * 4 * 7
    assert read_point_tokens(cloud) is None


@pytest.mark.parametrize("damage", ["gone", "kind", "nan", "flat", "coefficient"])
def test_broken_attributes_are_named_and_not_guessed(damage: str) -> None:
    _, cloud = reconstructed(some_splats(degree=1))
    attributes = cloud.data.attributes
    if damage == "gone":
        attributes.remove(attributes["rotation"])
    elif damage == "kind":
        attributes.remove(attributes["opacity"])
        attributes.new("opacity", "INT", "POINT")
    elif damage == "nan":
        attributes["scale"].data[1].vector = (float("nan"), 1.0, 1.0)
    elif damage == "flat":
        attributes["scale"].data[1].vector = (0.0, 1.0, 1.0)
    else:
        attributes.remove(attributes[HARMONIC_ATTRIBUTE.format(2)])
    with pytest.raises(SceneError, match=r"object 'Pot splats'.*cannot be read.*import the file again"):
        read_cloud(cloud)


def rotation(seed: int) -> np.ndarray:
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 1000), st.floats(1e-3, 1e3))
def test_a_uniform_scale_is_found_and_any_other_is_refused(seed: int, k: float) -> None:
    turn = rotation(seed)
    assert get_uniform_scale(k * turn, "here") == pytest.approx(k, rel=1e-9)
    with pytest.raises(SceneError, match="three axes"):
        get_uniform_scale(k * turn @ np.diag([1.0, 1.0, 1.01]), "here")
    with pytest.raises(SceneError, match="mirrored"):
        get_uniform_scale(-k * turn, "here")


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 1000), st.floats(0.01, 10.0))
def test_a_camera_sees_the_same_in_the_clouds_frame(seed: int, metres: float) -> None:
    rng = np.random.default_rng(seed)
    frame = CloudFrame(metres, rotation(seed), rng.normal(size=3))
    turn = rotation(seed + 1)
    camera = Patch(rng.normal(size=3), turn[:, 0], turn[:, 2], 0).camera(64)
    points = rng.normal(size=(20, 3))
    uv, depth = camera.project(frame.to_surface(points))
    inside, deep = frame.to_cloud_camera(camera).project(points)
    assert inside == pytest.approx(uv, abs=1e-6 * max(1.0, np.abs(uv).max()))
    assert deep * metres == pytest.approx(depth, abs=1e-9 * max(1.0, np.abs(depth).max()))


def test_applying_the_surface_transform_keeps_splats_in_place() -> None:
    surface, cloud = reconstructed()
    surface.location, surface.scale = (1.0, 2.0, 3.0), (2.0, 2.0, 2.0)
    surface.rotation_euler = (0.4, 0.0, 0.0)
    bpy.context.view_layer.update()
    before = np.array(surface.matrix_world) @ get_cloud_placement(surface, cloud)
    surface.select_set(True)
    bpy.context.view_layer.objects.active = surface
    bpy.ops.object.transform_apply()
    bpy.context.view_layer.update()
    assert np.allclose(surface.matrix_world, np.eye(4))
    assert get_cloud_placement(surface, cloud) == pytest.approx(before, abs=1e-5)
    frame = compute_cloud_frame(surface, cloud, 0.5 * np.eye(3))
    assert frame.metres_per_unit == pytest.approx(1.0, rel=1e-5)
    cloud.parent = None
    cloud.matrix_world = Matrix(before.tolist())
    bpy.context.view_layer.update()
    assert get_cloud_placement(surface, cloud) == pytest.approx(before, abs=1e-5)


def test_ellipsoids_show_every_splat_with_one_set_of_nodes() -> None:
    surface, cloud = reconstructed(some_splats(50))
    other = create_cloud("Other", some_splats(20), "b.ply")
    bpy.context.scene.collection.objects.link(other)
    for each in (cloud, other):
        show_ellipsoids(each)
    assert [group.name for group in bpy.data.node_groups] == [GROUP_NAME]
    bpy.context.view_layer.update()
    owners = [
        each.parent.original.name for each in bpy.context.view_layer.depsgraph.object_instances if each.is_instance
    ]
    assert (owners.count("Pot splats"), owners.count("Other"), len(owners)) == (50, 20, 70)
    # Along a splat's own axes an ellipsoid is as long as its standard deviations.
    splats = read_cloud(cloud)
    matrix = next(
        np.array(each.matrix_world)
        for each in bpy.context.view_layer.depsgraph.object_instances
        if each.is_instance and each.parent.original == cloud
    )
    assert np.linalg.norm(matrix[:3, :3], axis=0) == pytest.approx(splats.scales[0], rel=1e-4)
    assert matrix[:3, 3] == pytest.approx(splats.means[0], abs=1e-6)
    assert surface.name in bpy.context.scene.objects


def test_a_large_cloud_is_thinned_for_the_viewport(monkeypatch: pytest.MonkeyPatch) -> None:
    assert get_display_stride(MAX_SHOWN_SPLATS) == 1
    assert get_display_stride(MAX_SHOWN_SPLATS + 1) == 2
    assert get_display_stride(10 * MAX_SHOWN_SPLATS) == 10
    _, cloud = reconstructed(some_splats(30))
    monkeypatch.setattr(splat_reconstruction, "MAX_SHOWN_SPLATS", 8)
    show_ellipsoids(cloud)
    bpy.context.view_layer.update()
    assert sum(each.is_instance for each in bpy.context.view_layer.depsgraph.object_instances) == 8
