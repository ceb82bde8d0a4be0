"""Objects in several scenes or view layers use the properties of the scene that is evaluated."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
import pytest
from changes import add_picture, node, plate, tree, write_picture
from closeup_builders import look
from touch_scene import line_stroke, place_data, ridge_plate

from hnf_blender.bridge.stroke.read_stroke import list_strokes
from hnf_blender.compat import version
from hnf_blender.jobs import bake_job
from hnf_blender.state.addon_settings import get_cache_folder
from hnf_blender.touch import bake_patches as patches
from hnf_blender.touch import session as jobs
from hnf_blender.touch.session import make_scene_session
from hnf_blender.touch.stroke_bake import BAKE_PROPERTY

worked_through = pytest.mark.skipif(
    version() < (5, 0, 0), reason="keys are compared on every Blender; that the work follows them, on one"
)


@pytest.fixture
def scene():
    """A stroke along a plate whose ridges are as high as `wear` of the view layer or the scene says."""
    line_stroke("Along", surface=ridge_plate(), length=0.008)
    reader, ridges = tree().nodes.new("ShaderNodeAttribute"), node("ShaderNodeBump")
    reader.attribute_type, reader.attribute_name = "VIEW_LAYER", "wear"
    scaled = tree().nodes.new("ShaderNodeMath")
    scaled.operation = "MULTIPLY"
    tree().links.new(ridges.inputs["Height"].links[0].from_socket, scaled.inputs[0])
    tree().links.new(reader.outputs["Fac"], scaled.inputs[1])
    tree().links.new(scaled.outputs[0], ridges.inputs["Height"])
    bpy.context.scene["wear"] = 1.0
    return bpy.context.scene


@pytest.fixture
def bake(tmp_path, monkeypatch):
    """Bakes a scene in one of its view layers. Returns the bytes of the stroke, and how many close-ups were made."""
    for module in (patches, jobs):
        monkeypatch.setattr(module, "PATCH_PIXELS", 64)
    place_data(monkeypatch, tmp_path)
    cache = get_cache_folder()

    def run(scene, layer) -> tuple[bytes, int]:
        before = set(cache.iterdir())
        layer.update()
        ended = bake_job.bake_blocking(scene, layer)
        assert ended.ok, ended
        return bytes(bpy.data.objects["Along"][BAKE_PROPERTY]), len({*cache.iterdir()} - before)

    return run


def other_scene(wear: float):
    """Before the open one by its name; the plate stands in it too."""
    made = bpy.data.scenes.new("A other")
    made.collection.objects.link(plate())
    made["wear"] = wear
    assert plate().users_scene[0] == made
    return made


def height_in(layer) -> float:
    """Of the plate's relief from top to bottom."""
    return float(np.ptp(look(plate(), view_layer=layer).height))


def key_in(layer) -> str:
    """Of the stroke's signal."""
    layer.update()
    session = make_scene_session(layer.id_data, layer, Path())
    return session.make_curve_job(*list_strokes(layer.id_data)).key


def test_an_object_in_two_scenes_uses_the_evaluated_scene(scene) -> None:
    layer = scene.view_layers[0]
    alone, other = height_in(layer), other_scene(0.25)
    before = key_in(layer)
    assert height_in(layer) == alone
    assert height_in(other.view_layers[0]) == pytest.approx(0.25 * alone, rel=0.02)
    other["wear"] = 0.5
    assert key_in(layer) == before
    scene["wear"] = 0.5
    assert key_in(layer) != before


def test_an_image_sequence_uses_the_frame_of_its_scene(scene, tmp_path) -> None:
    for number in (1, 2, 3):
        write_picture(tmp_path / f"worn_{number:04d}.bmp", 0.2 * number)
    add_picture(tmp_path / "worn_0001.bmp", "SEQUENCE", frame_duration=3, use_auto_refresh=True)
    scene.frame_set(2)
    alone, other = height_in(scene.view_layers[0]), other_scene(1.0)
    other.frame_set(3)
    assert height_in(scene.view_layers[0]) == alone
    assert height_in(other.view_layers[0]) != alone


@worked_through
def test_a_bake_does_not_ask_another_scene(scene, bake) -> None:
    layer = scene.view_layers[0]
    alone, made = bake(scene, layer)
    assert made == 1
    other = other_scene(0.9)
    assert bake(scene, layer) == (alone, 0)
    for stored in get_cache_folder().iterdir():
        stored.unlink()
    del bpy.data.objects["Along"][BAKE_PROPERTY]
    assert bake(scene, layer) == (alone, 1)
    other["wear"] = 0.1
    assert bake(scene, layer) == (alone, 0)


def test_what_a_view_layer_says_counts_in_that_layer(scene) -> None:
    """As an Attribute node finds it: of the layer, else of its scene."""
    first, second, plain = scene.view_layers[0], scene.view_layers.new("Worn"), scene.view_layers.new("Plain")
    scene["wear"], first["wear"], second["wear"] = 0.25, 1.0, 0.5
    layers = (first, second, plain)
    whole, half, quarter = map(height_in, layers)
    assert (half, quarter) == (pytest.approx(0.5 * whole, rel=0.02), pytest.approx(0.25 * whole, rel=0.02))
    before = [key_in(layer) for layer in layers]
    assert len(set(before)) == 3
    second["wear"] = 0.6
    assert [key_in(layer) == key for layer, key in zip(layers, before, strict=True)] == [True, False, True]


@worked_through
def test_a_bake_is_of_the_view_layer_it_is_asked_for(scene, bake) -> None:
    first, second = scene.view_layers[0], scene.view_layers.new("Worn")
    first["wear"], second["wear"] = 1.0, 0.5
    (whole, _), (half, made) = bake(scene, first), bake(scene, second)
    assert (half != whole, made) == (True, 1)
    second["wear"] = 1.0
    assert bake(scene, second) == (whole, 0)
