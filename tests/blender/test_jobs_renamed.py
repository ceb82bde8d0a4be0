"""A scene or a view layer that gets another name while a bake runs is still the one that the bake belongs to."""

from __future__ import annotations

import bpy
import pytest
from job_scene import finish, kept, small_scene, start

from hnf_blender.jobs import manager


@pytest.fixture(autouse=True)
def lone(warm_bake):
    return warm_bake


def test_a_renamed_scene_keeps_its_bake():
    small_scene()
    bake = start()
    bpy.context.scene.name = "Renamed meanwhile"
    bpy.data.scenes.new("Scene")  # what took its name is not it
    ended = finish(bake)
    assert ended.ok, ended
    assert ended.scene == "Renamed meanwhile"
    assert list(kept()["bakes"]) == ["Along"]


def test_a_renamed_view_layer_is_the_one_that_shows_the_surface():
    plate, _ = small_scene()
    scene = bpy.context.scene
    working = scene.view_layers.new("Work")
    shown = bpy.data.collections.new("Only in Work")
    scene.collection.children.link(shown)
    for each in list(plate.users_collection):
        each.objects.unlink(plate)
    shown.objects.link(plate)
    scene.view_layers[0].layer_collection.children[shown.name].exclude = True
    working.update()
    bake = manager.start_bake(scene, working)
    working.name = "Renamed meanwhile"
    ended = finish(bake)
    assert ended.ok, ended
    assert list(kept()["bakes"]) == ["Along"]
