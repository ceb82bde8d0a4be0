"""Splats of a scene beside its true mesh: what the comparison says, and that it can say no."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
import pytest
from builders import add_plane, bump_material
from closeup_builders import principled
from predicted_scene import photo_plate, small_weights, use_weights

from data_tools.object_splats import make_object_splats
from hnf_blender.bridge.scene.meshes import read_surface
from hnf_blender.touch.bake_patches import ReliefPredictor
from hnf_core.material.token import LEVELS, TOKEN_DIM, Token
from hnf_core.scene.camera import Patch
from hnf_lab.experiments import splats as compare
from hnf_lab.experiments.splats import (
    PatchPair,
    PatchReading,
    compare_patches,
    find_nearest_entry,
    make_palette,
    remove_relief,
)

PIXELS = 128
UP, ALONG = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
KNOWN = np.ones(TOKEN_DIM, dtype=bool)


@pytest.fixture(autouse=True)
def quick(tmp_path, monkeypatch):
    use_weights(monkeypatch, small_weights(tmp_path / "small.safetensors"))
    monkeypatch.setattr(compare, "CLOSEUP_PIXELS", PIXELS)


def pair_of(obj, lift_m: float = 0.0, fine_m: float = 0.25e-3) -> PatchPair:
    """One patch in the middle of obj, whose splats are moved up."""
    bpy.context.view_layer.update()
    surface = read_surface(obj, bpy.context.view_layer.depsgraph, 1.0)
    patch = Patch(np.zeros(3), ALONG, UP, 0)
    splats = make_object_splats(obj, surface, 4e-3, 0, 1.0, [patch], fine_m, in_world=False)
    lifted = replace(splats, means=splats.means + np.float32([0.0, 0.0, lift_m]))
    (found,) = compare_patches(obj, surface, [patch], lifted, 1.0, ReliefPredictor())
    return found


def test_splats_of_a_photo_are_where_and_what_the_plate_is() -> None:
    plate = photo_plate(size=0.04)
    plate.scale = (1.5, 1.25, 1.0)
    found = pair_of(plate)
    assert found.material == "Board"
    assert max(found.expected_m, found.median_m) < 1e-5
    assert found.covered > 0.99
    np.testing.assert_allclose(found.splats.colour, found.mesh.colour, rtol=0.03)
    assert found.splats.token is not None
    assert found.mesh.token is not None
    assert found.alike.token is not None
    known = found.splats.token.known
    assert known.sum() < found.mesh.token.known.sum()
    np.testing.assert_array_equal(found.alike.token.known, known)


def test_splats_that_lie_too_high_are_found_out() -> None:
    found = pair_of(photo_plate(size=0.04), lift_m=0.7e-3)
    assert found.expected_m == pytest.approx(0.7e-3, rel=0.02)
    assert found.median_m == pytest.approx(0.7e-3, rel=0.02)
    (row,) = compare.make_rows("scene", [found])
    figures = compare.summarise([row])
    assert row.expected == pytest.approx(0.035, rel=0.02)
    assert not compare.meets_targets(figures)


def told(level: float) -> PatchReading:
    values = np.zeros(TOKEN_DIM, dtype=np.float32)
    values[LEVELS] = level
    return PatchReading(Token(values, KNOWN), (0.5, 0.4, 0.3), 1e-3)


def pair(material: str, mesh: PatchReading, splats: PatchReading) -> PatchPair:
    return PatchPair("Thing", material, 1e-5, 1e-5, 1.0, mesh, splats, mesh)


def test_the_palette_entry_is_the_nearest_of_what_both_know() -> None:
    pairs = [pair("Rough", told(-4.0), told(-4.1)), pair("Smooth", told(-6.0), told(-5.8)),
             pair("Smooth", told(-6.0), told(-4.2))]  # fmt: skip
    assert [row.palette for row in compare.make_rows("scene", pairs)] == [True, True, False]
    palette = make_palette(pairs)
    assert [entry.name for entry in palette] == ["Thing: Rough", "Thing: Smooth"]
    assert find_nearest_entry(told(-4.9).token, palette, KNOWN) == "Thing: Rough"


def test_a_picture_read_on_one_side_alone_is_a_difference() -> None:
    unread = PatchReading(None, (0.5, 0.4, 0.3), float("inf"))
    first, second = compare.make_rows("scene", [pair("A", told(-5.0), unread), pair("A", unread, unread)])
    assert (first.palette, second.palette) == (False, None)
    assert (first.token, second.token) == (False, True)
    figures = compare.summarise([first, second])
    assert (figures["patches_read"], figures["same_token"]) == (1, 0.5)
    assert not compare.meets_targets(figures)
    black, red = (replace(unread, colour=colour) for colour in ((0.01, 0.01, 0.01), (0.5, 0.1, 0.05)))
    (other,) = compare.make_rows("scene", [pair("A", black, red)])
    assert (other.palette, other.token) == (None, False)  # the prior takes them for different materials
    assert "0 of 1" in compare.format_rows([first, second])


def test_materials_lose_their_relief_and_keep_their_colour() -> None:
    plate = add_plane("Plate", 0.1)
    plate.data.materials.append(bump_material())
    shader = principled(plate.data.materials[0])
    assert shader.inputs["Normal"].is_linked
    colour = tuple(shader.inputs["Base Color"].default_value)
    remove_relief(bpy.context.scene)
    assert not shader.inputs["Normal"].is_linked
    assert tuple(shader.inputs["Base Color"].default_value) == colour
