"""What Blender is to call: at events, in every file, and after a time; and no more."""

from __future__ import annotations

import bpy

from hnf_blender.registration import add_handlers, remove_handlers


def test_what_is_listened_to_outlives_a_file_and_ends_when_asked() -> None:
    heard = []

    def told(*_: object) -> None:
        heard.append("file")

    def tick() -> float:
        return 1.0

    handlers = (("load_post", told), ("undo_post", told))
    add_handlers(handlers, tick, 1000.0)
    try:
        assert bpy.app.timers.is_registered(tick)
        for count in (1, 2):
            bpy.ops.wm.read_factory_settings(use_empty=True)
            assert heard == ["file"] * count
        assert bpy.app.timers.is_registered(tick)
    finally:
        remove_handlers(handlers, tick)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert heard == ["file"] * 2
    assert not bpy.app.timers.is_registered(tick)
    remove_handlers(handlers, tick)  # twice does no harm


def test_without_a_timer_only_events_count() -> None:
    heard = []
    handlers = (("load_pre", lambda *_: heard.append("pre")),)
    add_handlers(handlers)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    remove_handlers(handlers)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert heard == ["pre"]
