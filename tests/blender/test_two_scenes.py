"""One stroke in two scenes, each in a window of its own: how its bake stands is known of each."""

from __future__ import annotations

import bpy
import pytest
from job_scene import small_scene

from hnf_blender.jobs import bake_job, baked_data
from hnf_blender.jobs.baked_data import purge
from hnf_blender.state import status_tracker
from hnf_blender.state.session_state import STATE
from hnf_blender.touch.bake_status import Freshness
from hnf_blender.ui.scene_panel import format_counts


@pytest.fixture
def scenes(warm_bake):
    """The stroke was baked in the first; in the second frames are half as long, so that its force comes sooner."""
    status_tracker.clear_trackers()
    plate, stroke = small_scene()
    first, second = bpy.context.scene, bpy.data.scenes.new("Second")
    for each in (plate, stroke):
        second.collection.objects.link(each)
    second.render.fps = 2 * first.render.fps
    bake_job.bake_blocking(first, first.view_layers[0])
    yield first, second
    status_tracker.clear_trackers()


def look(*scenes) -> list[Freshness]:
    """What is known once the windows that show these scenes have been looked after."""
    for _ in range(20):
        status_tracker.process_changes([(scene, scene.view_layers[0]) for scene in scenes])
    stroke = bpy.data.objects["Along"]
    return [STATE.get_status(scene, stroke).freshness for scene in sorted(scenes, key=lambda scene: scene.name)]


def test_it_is_judged_in_each_whichever_is_looked_at_last(scenes) -> None:
    for order in (scenes, scenes[::-1]):
        STATE.dirty_names.add(status_tracker.EVERYTHING)
        assert look(*order) == [Freshness.FRESH, Freshness.FORCE]


def test_a_bake_in_one_is_news_in_the_other(scenes) -> None:
    second = scenes[1]
    look(*scenes)
    bake_job.bake_blocking(second, second.view_layers[0])
    assert look(*scenes) == [Freshness.STALE, Freshness.FRESH]  # it lasts longer here than was baked


def test_plan_and_purge_speak_of_their_scene(scenes) -> None:
    first, second = scenes
    look(*scenes)
    baked_data.make_plan(second, second.view_layers[0])
    assert look(*scenes) == [Freshness.FRESH, Freshness.FORCE]
    purge(first, first.view_layers[0], everything=True)
    assert [STATE.get_statuses(scene)["Along"].freshness for scene in scenes] == [Freshness.UNBAKED] * 2
    assert "1" in format_counts(STATE.get_statuses(first).values())


def test_a_scene_that_was_removed_is_forgotten(scenes) -> None:
    first, second = scenes
    look(*scenes)
    number = second.session_uid
    assert number in STATE.statuses
    bpy.data.scenes.remove(second)
    look(first)
    assert number not in STATE.statuses
    assert STATE.get_status(first, bpy.data.objects["Along"]).freshness is Freshness.FRESH
