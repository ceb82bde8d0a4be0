"""Parsing of OBJECT[:SLOT] and error messages for unknown names."""

from __future__ import annotations

import bpy
import pytest
from builders import add_mesh, add_plane

from hnf_blender.touch.session import Target, resolve_target
from hnf_core.errors import SceneError


@pytest.fixture
def scene():
    for name in ("Cushion", "Tin", "Lid: small"):
        add_plane(name, 0.1).data.materials.append(bpy.data.materials.new(f"{name} shader"))
    add_mesh("Points", [(0.0, 0.0, 0.0)], [])
    return bpy.context.scene


def test_case_counts_only_where_it_tells_two_apart(scene) -> None:
    assert resolve_target(scene, "cushion") == Target("Cushion", None)
    assert resolve_target(scene, "TIN:tin SHADER") == Target("Tin", 0)
    assert resolve_target(scene, "lid: small") == Target("Lid: small", None)
    add_plane("cushion", 0.1)
    assert resolve_target(scene, "cushion") == Target("cushion", None)
    with pytest.raises(SceneError, match="no such object"):
        resolve_target(scene, "CUSHION")


def test_an_unknown_object_error_lists_touchable_objects(scene) -> None:
    with pytest.raises(SceneError) as caught:
        resolve_target(scene, "Helmet:Leather")
    assert str(caught.value) == (
        "object 'Helmet': there is no such object in the scene. Objects here: 'Cushion', 'Lid: small', 'Tin'."
    )
    with pytest.raises(SceneError, match=r"Did you mean 'Cushion'\? Objects here: 'Cushion', "):
        resolve_target(scene, "Cusion")


def test_a_crowd_is_not_listed_whole(scene) -> None:
    for number in range(20):
        add_plane(f"Crowd {number:02d}", 0.1)
    with pytest.raises(SceneError, match=r"'Crowd 11' and 11 more\."):
        resolve_target(scene, "nobody")


def test_an_unknown_slot_is_answered_with_its_object_s(scene) -> None:
    with pytest.raises(SceneError, match=r"object 'Tin': it has no material slot 'Lid'. Its slots: 0 Tin shader\."):
        resolve_target(scene, "tin:Lid")
