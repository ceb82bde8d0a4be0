"""Differences between Blender versions, as handled by compat."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import bpy
import pytest
from builders import add_plane

from hnf_blender import compat


def test_f_curves_are_those_of_the_datablock_itself():
    plane = add_plane()
    assert compat.fcurves_of(plane) == []
    camera = bpy.data.cameras.new("Camera")
    holder = bpy.data.objects.new("Holder", camera)
    holder.keyframe_insert("location", frame=1)
    camera.keyframe_insert("lens", frame=1)  # from 4.4 on in the same action, in another slot
    assert sorted({curve.data_path for curve in compat.fcurves_of(holder)}) == ["location"]
    assert len(compat.fcurves_of(holder)) == 3
    assert [curve.data_path for curve in compat.fcurves_of(camera)] == ["lens"]


def test_only_an_unusual_working_space_has_a_name():
    assert compat.working_space() == ""
    if compat.version() >= (5, 0, 0):
        bpy.ops.wm.set_working_color_space(working_space="Linear Rec.2020", convert_colors=False)
        assert compat.working_space() == "Linear Rec.2020"
        bpy.ops.wm.set_working_color_space(working_space="Linear Rec.709", convert_colors=False)
    assert compat.working_space() == ""


def test_a_format_has_its_name_here():
    render = bpy.context.scene.render
    compat.use_multilayer_exr(render)
    assert render.image_settings.file_format == "OPEN_EXR_MULTILAYER"


@pytest.mark.parametrize("kind", ["materials", "worlds"])
def test_nodes_can_be_switched_on(kind):
    block = getattr(bpy.data, kind).new("x")
    compat.switch_nodes_on(block)
    assert compat.use_nodes(block)
    assert len(block.node_tree.nodes) > 0


def test_nobody_else_asks_whether_a_material_has_nodes():
    """use_nodes is always on from 5.0, and asking for it is deprecated."""
    asking = [
        path.name
        for path in Path(compat.__file__).parent.rglob("*.py")
        if path.name != "compat.py" and re.search(r"material\.use_nodes", path.read_text(encoding="utf-8"))
    ]
    assert asking == []


def test_a_relative_export_folder_gives_no_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        bpy.context.scene.hnf.export_folder = "//elsewhere"
    assert bpy.context.scene.hnf.export_folder == "//elsewhere"
