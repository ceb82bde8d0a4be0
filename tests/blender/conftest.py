"""Every test here starts from an empty Blender file."""

from __future__ import annotations

import shutil
from collections.abc import Iterator

import pytest

bpy = pytest.importorskip("bpy", reason="needs the bpy wheel of the matching Python")


@pytest.fixture(autouse=True, scope="session")
def stroke_properties() -> None:
    """As with the add-on switched on. Registered classes outlive files and factory settings."""
    from hnf_blender import props

    if not hasattr(bpy.types.Object, "hnf_stroke"):
        props.register()


@pytest.fixture(scope="module")
def operators(stroke_properties: None) -> Iterator[None]:
    """The add-on's operators, for a module of tests that press its buttons; other modules switch on what they need."""
    from hnf_blender import ops

    ops.register()
    yield
    ops.unregister()


@pytest.fixture(autouse=True)
def empty_file() -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)


@pytest.fixture
def lone_bake(operators, tmp_path, monkeypatch):
    """Bakes with a cache of their own (its path); none runs before or after, nor does its process, and none leaves a
    folder."""
    from job_scene import my_folders
    from touch_scene import place_data

    from hnf_blender.jobs import manager
    from hnf_blender.jobs.child_job import PROCESS_FOLDER_PREFIX
    from hnf_blender.state.session_state import STATE

    cache = place_data(monkeypatch, tmp_path / "data")
    STATE.clear()
    yield cache
    manager.close()
    STATE.clear()
    assert my_folders() == []
    assert my_folders(PROCESS_FOLDER_PREFIX) == []


@pytest.fixture(scope="session")
def rendered_plate(stroke_properties, tmp_path_factory):
    """The close-ups of job_scene.small_scene."""
    from job_scene import small_scene
    from touch_scene import place_data

    from hnf_blender.jobs import bake_job

    bpy.ops.wm.read_factory_settings(use_empty=True)
    with pytest.MonkeyPatch.context() as patch:
        cache = place_data(patch, tmp_path_factory.mktemp("rendered"))
        small_scene()
        bake_job.bake_blocking(bpy.context.scene, bpy.context.view_layer)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return cache


@pytest.fixture
def warm_bake(rendered_plate, lone_bake):
    """A lone bake whose close-ups are there already: what is tested starts after them."""
    shutil.copytree(rendered_plate, lone_bake)
    return lone_bake
