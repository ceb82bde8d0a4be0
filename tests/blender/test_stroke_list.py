"""Which objects the list of strokes shows, and in which order: as Blender's own sorting would, without sorting all."""

from __future__ import annotations

from types import SimpleNamespace

import bpy
from hypothesis import given
from hypothesis import strategies as st
from job_scene import line_stroke, small_scene

from hnf_blender.ui.strokes_panel import HNF_UL_strokes, compute_order


@given(st.lists(st.text("abC", max_size=3), max_size=12), st.data())
def test_the_named_stand_in_front_sorted_and_the_others_stay(names, data) -> None:
    count = len(names) + data.draw(st.integers(0, 12))
    places = sorted(data.draw(st.permutations(range(count)))[: len(names)])
    order = compute_order(names, places, count)
    assert sorted(order) == list(range(count))
    at = {new: old for old, new in enumerate(order)}
    plain = sorted(zip(names, places, strict=True))
    assert [at[rank] for rank in range(len(names))] == [place for _, place in plain]
    behind = [at[rank] for rank in range(len(names), count)]
    assert behind == [place for place in range(count) if place not in places]


def test_it_shows_strokes_alone_in_the_order_of_blenders_own(warm_bake) -> None:
    plate, _ = small_scene()
    for name in ("beside", "Zig", "above"):
        line_stroke(name, surface=plate)
    bpy.data.objects["Zig"].hnf_stroke.mute = True
    scene = bpy.context.scene
    shown, order = filtered(scene)
    named = [obj.name for obj, flag in zip(scene.objects, shown, strict=True) if flag]
    assert sorted(named) == ["Along", "Zig", "above", "beside"]
    own = bpy.types.UI_UL_list.sort_items_by_name(scene.objects, "name")
    by_own = sorted((rank, obj.name) for rank, obj in zip(own, scene.objects, strict=True) if obj.name in named)
    by_ours = sorted((rank, obj.name) for rank, obj in zip(order, scene.objects, strict=True) if obj.name in named)
    assert [name for _, name in by_ours] == [name for _, name in by_own] == ["above", "Along", "beside", "Zig"]
    shown, order = filtered(scene, "ZIG")
    assert [obj.name for obj, flag in zip(scene.objects, shown, strict=True) if flag] == ["Zig"]
    assert sorted(order) == list(range(len(scene.objects)))


def test_it_is_sorted_by_surface_or_start(warm_bake) -> None:
    plate, _ = small_scene()
    bpy.data.objects["Along"].hnf_stroke.start = 30.0
    for name, start in (("A on Plate", 20.0), ("B", 10.0)):
        line_stroke(name, surface=plate).hnf_stroke.start = start
    scene = bpy.context.scene
    assert listed(scene) == ["Along", "B", "A on Plate"]  # the last is listed as "Plate: A"
    assert listed(scene, order="START") == ["B", "A on Plate", "Along"]
    assert len(listed(scene, "plate")) == 3
    assert listed(scene, "no such") == []


def listed(scene, wanted: str = "", order: str = "SURFACE") -> list[str]:
    """Names of the strokes that are shown, from the top."""
    shown, places = filtered(scene, wanted, order)
    ranked = sorted(zip(places, shown, scene.objects, strict=True), key=lambda each: each[0])
    return [obj.name for _, flag, obj in ranked if flag]


def filtered(scene, wanted: str = "", order: str = "SURFACE"):
    asked = SimpleNamespace(filter_name=wanted, bitflag_filter_item=1 << 30, order=order)
    return HNF_UL_strokes.filter_items(asked, bpy.context, scene, "objects")
