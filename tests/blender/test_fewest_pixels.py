"""A close-up has as many pixels as its shader's images have something for: a first look tells, a closer one follows
only where there is more to see."""

from __future__ import annotations

import bmesh
import bpy
import numpy as np
import pytest
from builders import add_mesh, bump_material, float_image
from closeup_builders import patch, principled
from hypothesis import given
from hypothesis import strategies as st

from hnf_blender.bridge.closeup import CloseUpRenderer
from hnf_blender.bridge.cycles import MAX_READABLE_WAVELENGTH_M
from hnf_blender.bridge.isolated_object import PIXELS_PER_TEXEL, PIXELS_PER_TRIANGLE, SlotReading, choose_resolution
from hnf_blender.bridge.shader.aov_taps import ImageTap, Tap
from hnf_blender.bridge.shader.closures import ColourSources, is_direct_image
from hnf_core.material.band_descriptor import describe
from hnf_core.material.token import LEVELS
from hnf_core.progress import count_work
from hnf_core.tactile.height import tactile_map_from_height

FIRST, MOST = 64, 256
SIDE_M = 0.04


def plate(texel_m: float, *, cuts: int = 0, procedural: bool = False, as_colour: bool = False, seed: int = 3):
    """4 cm wide, UV 0–1, with a random image whose texels are so wide, as its bump or its colour."""
    half, count = SIDE_M / 2.0, round(SIDE_M / texel_m)
    plane = add_mesh(
        "Plate",
        [(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)],
        [(0, 1, 2, 3)],
        uv=lambda co: (co.x / SIDE_M + 0.5, co.y / SIDE_M + 0.5),
    )
    if cuts:
        mesh = bmesh.new()
        mesh.from_mesh(plane.data)
        bmesh.ops.subdivide_edges(mesh, edges=mesh.edges[:], cuts=cuts, use_grid_fill=True)
        mesh.to_mesh(plane.data)
        mesh.free()
    material = bump_material(height=1e-5)
    tree, shader = material.node_tree, principled(material)
    bump = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeBump")
    texture = tree.nodes.new("ShaderNodeTexImage")
    texture.image = float_image("random", np.random.default_rng(seed).uniform(0.2, 0.8, (count, count, 3)))
    texture.image.colorspace_settings.name = "Non-Color"
    if as_colour:
        for link in list(shader.inputs["Normal"].links):
            tree.links.remove(link)
        tree.links.new(texture.outputs["Color"], shader.inputs["Base Color"])
    elif not procedural:
        bump.inputs["Distance"].default_value = 2e-5
        tree.links.new(texture.outputs["Color"], bump.inputs["Height"])
    plane.data.materials.append(material)
    bpy.context.view_layer.update()
    return plane


def looked(obj, first: int | None = FIRST):
    place = patch()
    with CloseUpRenderer(obj, [place], pixels=MOST, first_pass_pixels=first) as renderer:
        return renderer.render(place)


def token_of(closeup):
    return describe(
        tactile_map_from_height(
            closeup.height, closeup.mask, closeup.metres_per_pixel, closeup.resolved_wavelength_m, sensor="gelsight"
        )
    )


def test_wide_texels_are_seen_at_the_first_look() -> None:
    obj = plate(1e-3)
    few, many = looked(obj), looked(obj, None)
    assert (few.mask.shape, few.renders) == ((FIRST, FIRST), 1)
    assert few.rays == FIRST**2 + 1
    assert (many.mask.shape, many.renders) == ((MOST, MOST), 1)
    assert few.resolved_wavelength_m == pytest.approx(many.resolved_wavelength_m, rel=1e-3)
    assert np.array_equal(few.faces, many.faces)
    here, there = token_of(few), token_of(many)
    assert np.array_equal(here.known, there.known)
    assert here.known[LEVELS].sum() >= 2
    levels = 20.0 * np.abs(here.values[LEVELS] - there.values[LEVELS])[here.known[LEVELS]]
    assert levels.max() < 0.05  # dB
    np.testing.assert_allclose(here.values[here.known], there.values[here.known], atol=0.03)


@pytest.mark.parametrize("first", [8, 32])
def test_fewer_pixels_than_it_takes_would_be_told_apart(first: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The bound is no luxury: what it keeps from happening is seen by the same measure."""
    obj = plate(0.5e-3)
    right = token_of(looked(obj))
    monkeypatch.setattr("hnf_blender.bridge.isolated_object.PIXELS_PER_TEXEL", 1e-9)
    few = looked(obj, first)
    assert few.mask.shape == (first, first)
    wrong = token_of(few)
    both = (right.known & wrong.known)[LEVELS]
    levels = 20.0 * np.abs(right.values[LEVELS] - wrong.values[LEVELS])[both]
    assert not np.array_equal(right.known, wrong.known) or levels.max() > 0.1


def test_fine_texels_are_looked_at_again_as_if_nobody_had_looked() -> None:
    obj = plate(0.1e-3)
    twice, once = looked(obj), looked(obj, None)
    assert (twice.mask.shape, twice.renders, once.renders) == ((MOST, MOST), 2, 1)
    assert twice.rays == FIRST**2 + once.rays + 1
    assert twice.height.tobytes() == once.height.tobytes()
    assert twice.view.rgb.tobytes() == once.view.rgb.tobytes()


def test_between_them_it_takes_what_is_between() -> None:
    assert looked(plate(0.6e-3)).mask.shape == (128, 128)


def test_a_pattern_without_texels_gets_all_pixels_at_once() -> None:
    obj = plate(1e-3, procedural=True)
    assert not is_direct_image(obj.data.materials[0])
    close = looked(obj)
    assert (close.mask.shape, close.renders) == ((MOST, MOST), 2)  # a small view chooses its sampling


@pytest.mark.parametrize(
    ("texel_m", "procedural", "renders"), [(1e-3, False, 1), (0.1e-3, False, 2), (50e-6, False, 3), (1e-3, True, 2)]
)
def test_every_render_is_counted(texel_m: float, procedural: bool, renders: int) -> None:
    """The small view that chooses the sampling included, and for a slot's first patch alone."""
    places = [patch(), patch(0.002)]
    with (
        count_work() as work,
        CloseUpRenderer(
            plate(texel_m, procedural=procedural), places, pixels=MOST, first_pass_pixels=FIRST
        ) as renderer,
    ):
        told = [renderer.render(place).renders for place in places]
    assert sum(told) == work.total("images")
    assert told == [renders, min(renders, 2) - procedural]


def fine_image(tree, texels: int = 400):
    texture = tree.nodes.new("ShaderNodeTexImage")
    texture.image = float_image("mask", np.random.default_rng(9).uniform(0.0, 1.0, (texels, texels, 3)))
    return texture.outputs["Color"]


def weighed(tree) -> None:
    bump = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeBump")
    tree.links.new(fine_image(tree), bump.inputs["Strength"])


def mixed(tree) -> None:
    output = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeOutputMaterial")
    mix, plain = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeBsdfDiffuse")
    tree.links.new(fine_image(tree), mix.inputs[0])
    tree.links.new(output.inputs["Surface"].links[0].from_socket, mix.inputs[1])
    tree.links.new(plain.outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], output.inputs["Surface"])


def stepped(tree) -> None:
    bump = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeBump")
    ramp = tree.nodes.new("ShaderNodeValToRGB")
    ramp.color_ramp.interpolation = "CONSTANT"
    tree.links.new(bump.inputs["Height"].links[0].from_socket, ramp.inputs["Fac"])
    tree.links.new(ramp.outputs["Color"], bump.inputs["Height"])


def cut(tree) -> None:
    bump = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeBump")
    step = tree.nodes.new("ShaderNodeMath")
    step.operation = "GREATER_THAN"
    tree.links.new(bump.inputs["Height"].links[0].from_socket, step.inputs[0])
    tree.links.new(step.outputs[0], bump.inputs["Height"])


@pytest.mark.parametrize(("changed", "renders"), [(weighed, 2), (mixed, 1), (stepped, 2), (cut, 2)])
def test_what_else_has_detail_gets_all_pixels(changed, renders) -> None:
    obj = plate(1e-3)
    assert is_direct_image(obj.data.materials[0])
    changed(obj.data.materials[0].node_tree)
    assert not is_direct_image(obj.data.materials[0])
    close = looked(obj)
    assert (close.mask.shape, close.renders) == ((MOST, MOST), renders)


def test_small_faces_are_all_found() -> None:
    few, many = plate(1e-3), looked(plate(1e-3, cuts=99), None)
    close = looked(plate(1e-3, cuts=99))  # faces of 0.4 mm: 50 × 50 of them in two triangles each
    assert looked(few).mask.shape == (FIRST, FIRST)
    assert close.mask.shape == (MOST, MOST)
    assert np.array_equal(close.faces, many.faces)


@pytest.mark.parametrize(("texel_m", "side"), [(1e-3, FIRST), (0.25e-3, MOST)])
def test_a_colour_that_may_tell_of_relief_gets_all_pixels(texel_m: float, side: int) -> None:
    close = looked(plate(texel_m, as_colour=True))
    assert close.unlit is not None
    assert (close.unlit.resolved_wavelength_m <= MAX_READABLE_WAVELENGTH_M) == (side == MOST)
    assert close.mask.shape == (side, side)


def test_texels_that_cannot_be_told_get_all_pixels() -> None:
    obj = plate(1e-3)
    for loop in obj.data.uv_layers.active.data:
        loop.uv = (0.5, 0.5)
    assert looked(obj).mask.shape == (MOST, MOST)


COLOUR = ColourSources((ImageTap("image", Tap("place", "COLOR"), (1.0, 1.0)),), False, False, "image 'image'")


def test_where_nothing_is_seen_all_pixels_look_again() -> None:
    slot = SlotReading("Any", None, (), COLOUR)  # type: ignore[arg-type]
    nothing, triangle = np.zeros((FIRST, FIRST), dtype=bool), np.full((FIRST, FIRST), -1, dtype=np.int32)
    assert choose_resolution(slot, {}, nothing, triangle, 0.02, MOST) == MOST


@given(texel_m=st.floats(1.1e-3, 0.1), size_m=st.floats(1e-3, 0.2), faces=st.integers(1, 4000))
def test_as_many_as_texels_and_triangles_ask_for_and_no_more(texel_m: float, size_m: float, faces: int) -> None:
    slot = SlotReading("Any", None, (), COLOUR)  # type: ignore[arg-type]  # what a colour's slot is made of is not read
    column = (np.arange(FIRST) + 0.5) * size_m / FIRST / texel_m
    place = np.stack([*np.meshgrid(column, column), np.zeros((FIRST, FIRST))], axis=-1).astype(np.float32)
    triangle = (np.arange(FIRST**2) % faces).astype(np.int32).reshape(FIRST, FIRST)
    mask = np.ones((FIRST, FIRST), dtype=bool)
    side = choose_resolution(slot, {"place": place}, mask, triangle, size_m, 4096)
    seen = min(faces, FIRST**2)

    def enough(pixels: int) -> bool:
        fine = size_m / pixels <= texel_m / PIXELS_PER_TEXEL * (1.0 + 1e-3)
        return fine and pixels**2 >= PIXELS_PER_TRIANGLE * seen

    assert side == 4096 or enough(side)
    assert side == FIRST or not enough(side // 2) or size_m / (side // 2) > texel_m / PIXELS_PER_TEXEL * (1.0 - 1e-3)
    assert choose_resolution(slot, {"place": place}, mask, triangle, size_m, 128) <= 128
