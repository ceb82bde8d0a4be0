"""Linked duplicates (Alt D): two objects, one mesh. It has room for the tokens of both, and they are baked once."""

from __future__ import annotations

import bpy
import pytest
from job_scene import small_scene

from hnf_blender.bridge.scene.stored_data import read_tokens
from hnf_blender.jobs import bake_job, baked_data
from hnf_blender.jobs.baked_data import purge


@pytest.fixture
def twins(lone_bake):
    """A plate with a stroke, and 1 m beside it its linked duplicate, half as large again, with one of its own."""
    plate, stroke = small_scene()
    twin, other = plate.copy(), stroke.copy()
    twin.name, other.name, other.data = "Larger", "Beside", stroke.data.copy()
    for obj in (twin, other):
        obj.location.y += 1.0
        bpy.context.scene.collection.objects.link(obj)
    twin.scale = (1.5, 1.5, 1.5)
    other.location.x += 0.02
    other.hnf_stroke.surface = twin
    bpy.context.view_layer.update()
    assert twin.data == plate.data
    return plate, stroke, twin, other


def bake(*only):
    return bake_job.bake_blocking(bpy.context.scene, bpy.context.view_layer, only)


def kinds():
    plan = baked_data.make_plan(bpy.context.scene, bpy.context.view_layer)
    return [line.kind for line in plan.lines if line.kind in {"needed", "fresh"}]


def test_what_was_baked_is_done(twins) -> None:
    assert kinds() == ["needed", "needed"]
    assert bake().ok
    assert kinds() == ["fresh", "fresh"]
    assert bake().written == 0
    freed = purge(bpy.context.scene, bpy.context.view_layer, everything=False)
    assert freed.bytes == 0  # nothing is outgrown


@pytest.mark.parametrize("order", [("Along", "Beside"), ("Beside", "Along")])
def test_each_alone_adds_its_tokens(twins, order) -> None:
    plate = twins[0]
    for name in order:
        assert bake(name).ok
        assert read_tokens(plate.data) is not None
    assert kinds() == ["fresh", "fresh"]


def test_a_changed_mesh_is_baked_again(twins) -> None:
    plate = twins[0]
    assert bake().ok
    plate.data.vertices[0].co.z += 1e-4
    plate.data.update()
    bpy.context.view_layer.update()
    assert kinds() == ["needed", "needed"]
    assert bake().written == 3
    assert kinds() == ["fresh", "fresh"]
