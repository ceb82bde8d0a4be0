"""Reliefs whose metres, steps, texels or normals are not to be believed, and what is taken instead."""

from __future__ import annotations

from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from builders import add_plane, bump_material, float_image, math_node
from closeup_builders import look
from panel_recorder import drawn
from touch_scene import line_stroke, save_scene, set_keys, signals
from touch_scene import touch_without_pictures as touch

from hnf_blender.bridge.shader.bump_displacement import judge_normal_colour
from hnf_blender.bridge.shader.images import get_rounding_step, parse_jpeg_step
from hnf_blender.cli import main
from hnf_blender.jobs import bake_job
from hnf_blender.preview.stroke_image import ImageStyle
from hnf_blender.preview.synthesis_thread import RenderCache, read_current_bake, synthesise_preview
from hnf_blender.state.session_state import STATE
from hnf_blender.state.status_tracker import refresh_status
from hnf_blender.touch.bake_status import Freshness
from hnf_blender.touch.stroke_bake import load_bake
from hnf_blender.ui.materials_panel import is_height_doubted
from hnf_core.progress import count_work

PLASTIC = ("--material", "Plate=smooth-plastic")


def plate(material, size: float = 0.1):
    """A plate whose material is at hand, one UV unit a metre."""
    obj = add_plane("Plate", size)
    obj.data.materials.append(material)
    return obj


def image_bump(image, distance: float, size: float = 0.1):
    """A plate with a bump of an image over the whole of it."""
    material = bpy.data.materials.new("Drawn")
    material.use_nodes = True
    tree = material.node_tree
    uv, mapping, texture, bump = (
        tree.nodes.new(f"ShaderNode{kind}") for kind in ("UVMap", "Mapping", "TexImage", "Bump")
    )
    mapping.inputs["Location"].default_value = (0.5, 0.5, 0.0)
    mapping.inputs["Scale"].default_value = (1.0 / size, 1.0 / size, 1.0)
    texture.image, bump.inputs["Distance"].default_value, bump.inputs["Strength"].default_value = image, distance, 1.0
    tree.links.new(uv.outputs[0], mapping.inputs["Vector"])
    tree.links.new(mapping.outputs[0], texture.inputs["Vector"])
    tree.links.new(texture.outputs["Color"], bump.inputs["Height"])
    tree.links.new(bump.outputs[0], tree.nodes["Principled BSDF"].inputs["Normal"])
    return plate(material, size)


def byte_image(name: str, grey: np.ndarray):
    """A Non-Color image of eight bits from (H, W) values."""
    image = bpy.data.images.new(name, grey.shape[1], grey.shape[0], is_data=True)
    rgba = np.repeat(np.round(grey * 255.0)[..., None] / 255.0, 4, axis=-1).astype(np.float32)
    rgba[..., 3] = 1.0
    image.pixels.foreach_set(rgba.ravel())
    image.update()
    image.pack()
    return image


def grey_float(name: str, grey: np.ndarray):
    return float_image(name, np.repeat(grey[..., None], 3, axis=-1))


def feel(tmp_path, *words: str) -> dict:
    """Level [m/s² RMS], report and warnings of the default stroke."""
    code, report = touch(save_scene(tmp_path / "scene.blend"), tmp_path / "out", *words)
    assert code == 0, report
    return {"level": report["strokes"][0]["rms_m_s2"], "notes": " ".join(report["warnings"]), **report["strokes"][0]}


@pytest.mark.parametrize("distance", [1e-2, 1.0, 1e3])
def test_metres_that_no_surface_has_give_the_shape_alone(tmp_path, distance):
    """Old files' bumps, displacements at their default scale, a relief of a kilometre: one line, and a usable feel."""
    plate(bump_material("Old", wavelength=2e-3, height=distance, distance=distance))
    felt = feel(tmp_path, *PLASTIC)
    assert 0.1 < felt["level"] < 10.0
    assert "material 'Old' on 'Plate': its relief is" in felt["notes"]
    assert "height of smooth-plastic" in felt["notes"]
    assert "tick Height as Authored" in felt["notes"]
    assert felt["height_source"].startswith("shape of bump")
    assert felt["height_source"].endswith("smooth-plastic")


def test_insisting_gives_the_authored_height(tmp_path):
    plate(bump_material("Old", wavelength=2e-3, height=1.0, distance=1.0))
    scene = save_scene(tmp_path / "scene.blend")
    _, doubted = touch(scene, tmp_path / "one", *PLASTIC)
    _, authored = touch(scene, tmp_path / "one", *PLASTIC, "--height-as-authored")
    assert doubted["strokes"][0]["key"] != authored["strokes"][0]["key"]
    assert authored["strokes"][0]["rms_m_s2"] > 100.0 > doubted["strokes"][0]["rms_m_s2"]
    bpy.data.materials["Old"].hnf_touch.height_as_authored = True
    _, ticked = touch(save_scene(scene), tmp_path / "two", *PLASTIC)
    assert ticked["strokes"][0]["rms_m_s2"] == authored["strokes"][0]["rms_m_s2"]


def test_a_deep_grating_is_felt_as_drawn(tmp_path):
    """1 mm high, 4 mm pitch."""
    plate(bump_material("Grating", wavelength=4e-3, height=1e-3))
    felt = feel(tmp_path, *PLASTIC)
    assert "its shape is felt" not in felt["notes"]
    assert felt["height_source"].startswith("bump")
    assert felt["level"] > 5.0


def test_what_shakes_the_pen_off_is_doubted_too(tmp_path):
    """0.4 mm of ridges 1 mm apart lie within the known heights, but not at this speed."""
    plate(bump_material("Ridges", wavelength=0.5e-3, height=0.25e-3))
    scene = save_scene(tmp_path / "scene.blend")
    _, authored = touch(scene, tmp_path / "one", *PLASTIC, "--height-as-authored")
    assert authored["strokes"][0]["rms_m_s2"] > 100.0
    _, report = touch(scene, tmp_path / "two", *PLASTIC)
    assert report["strokes"][0]["rms_m_s2"] < 10.0
    assert "no pen stays on it" in " ".join(report["warnings"])


def test_a_probe_s_answer_doubts_like_a_stroke(tmp_path):
    plate(bump_material("Old", wavelength=2e-3, height=1.0, distance=1.0))
    _, report = touch(save_scene(tmp_path / "scene.blend"), tmp_path / "out", *PLASTIC, "--at", "Plate:0,0")
    assert report["probes"][0]["roughness"]["total_rms_m"] < 100e-6
    assert any("height of smooth-plastic" in note for note in report["probes"][0]["notes"])


def test_the_panel_offers_to_insist_only_where_it_matters(tmp_path, monkeypatch):
    from hnf_blender.state.session_state import STATE
    from hnf_blender.touch.bake_status import Freshness
    from hnf_blender.touch.bake_storage import make_status

    material = bump_material("Old", wavelength=2e-3, height=1.0, distance=1.0)
    plate(material)
    assert not is_height_doubted(material)
    material.hnf_touch.height_as_authored = True
    assert is_height_doubted(material)
    material.hnf_touch.height_as_authored = False

    bake = SimpleNamespace(
        facts={"height_doubted": "Old\nOther"}, confidence=1.0, warnings=(), notes=(), doubts=(), alternative=None,
        stroke=SimpleNamespace(action=SimpleNamespace(duration_s=1.0)),
    )  # fmt: skip
    status = make_status(bake, Freshness.FRESH)
    monkeypatch.setitem(STATE.statuses, "scene", {"Scrape": status})
    assert is_height_doubted(material)


@pytest.mark.parametrize("tilt", [0.3, 1.0, 2.7])
def test_the_steps_of_an_eight_bit_ramp_are_not_felt(tmp_path, tilt):
    """Whatever its slope: the same as with floating-point pixels, within 1 dB."""
    ramp = np.tile((np.arange(512) + 0.5) / 512.0 * min(tilt, 1.0), (512, 1))
    image_bump(byte_image("ramp", ramp), 2e-3 * max(tilt, 1.0))
    rounded = feel(tmp_path, *PLASTIC)
    texture = next(
        node for node in bpy.data.materials["Drawn"].node_tree.nodes if node.bl_idname == "ShaderNodeTexImage"
    )
    texture.image = grey_float("even", ramp)
    even = feel(tmp_path, *PLASTIC)
    assert abs(20.0 * np.log10(rounded["level"] / even["level"])) < 1.0
    assert "rounding of 'ramp'" in rounded["notes"]
    assert "is kept" not in rounded["notes"]


def test_a_wave_of_a_few_steps_is_felt_as_with_floats():
    wave = 0.5 + 4.0 / 255.0 * np.sin(2.0 * np.pi * np.arange(400) / 8.0)[None, :].repeat(400, axis=0)
    rounded = look(image_bump(byte_image("wave", wave), 1e-3), pixels=256)
    exact = look(image_bump(grey_float("exact", wave), 1e-3), pixels=256)
    assert np.std(rounded.height) == pytest.approx(np.std(exact.height), rel=0.1)
    assert rounded.resolved_wavelength_m <= 1.001 * 2e-3 / np.sqrt(2.0)


@pytest.mark.parametrize(("quality", "least"), [(95, 0.0), (50, 3.0)])
def test_a_jpeg_s_step_is_read_from_its_table(tmp_path, quality, least):
    image = byte_image("photo", np.random.default_rng(0).uniform(0.0, 1.0, (64, 64)))
    scene = bpy.context.scene
    scene.render.image_settings.file_format, scene.render.image_settings.quality = "JPEG", quality
    path = tmp_path / "photo.jpg"
    image.save_render(str(path), scene=scene)
    assert least <= parse_jpeg_step(path.read_bytes()) < 16.0
    loaded = bpy.data.images.load(str(path))
    assert get_rounding_step(loaded) >= max(1.0, least) / 255.0


@pytest.mark.parametrize(
    "data", [b"", b"\xff\xd8", b"\xff\xd8\xff\xdb\x00", b"\xff\xd8\xff\xe0\xff\xff" + b"0" * 9, b"PNG"]
)
def test_no_jpeg_has_no_step(data):
    assert parse_jpeg_step(data) == 0.0


@pytest.mark.parametrize("texel_m", [12.5e-6, 25e-6, 50e-6, 100e-6])
def test_grain_at_the_texel_has_its_level(texel_m):
    """White grain: each octave between two texels and the patch has the power of its share of the plane of waves."""
    side = round(0.03 / texel_m)
    grain = 0.5 + 0.1 * np.random.default_rng(3).standard_normal((side, side))
    close = look(image_bump(grey_float("grain", grain), 1e-4, size=0.03), pixels=512, first_pass_pixels=128)
    from hnf_core.material.band_descriptor import measure_octave_heights
    from hnf_core.material.token import BAND_WAVELENGTHS_M

    octaves = measure_octave_heights(close.height, close.mask, close.metres_per_pixel)[1:]
    share = np.pi * (2.0 / BAND_WAVELENGTHS_M**2 - 0.5 / BAND_WAVELENGTHS_M**2) * texel_m**2
    wanted = 0.1e-4 * np.sqrt(share)
    bands = (BAND_WAVELENGTHS_M / np.sqrt(2.0) >= close.resolved_wavelength_m) & (BAND_WAVELENGTHS_M < 2e-3)
    bands[-1] = False  # it includes everything finer
    assert np.abs(20.0 * np.log10(octaves[bands] / wanted[bands])).max() < 1.0


@pytest.mark.parametrize("wavelength", [20.5e-6, 41e-6, 60e-6])
def test_waves_finer_than_the_pixels_are_not_felt(tmp_path, wavelength):
    plate(bump_material("Fine", wavelength=wavelength, height=50e-6))
    line_stroke("Along")  # of two patches; each is looked at again and again
    fine = feel(tmp_path, *PLASTIC)
    assert fine["level"] < 1.0
    assert fine["notes"].count("'Fine': its relief there is finer than 0.078 mm") == 1
    assert "is kept" not in fine["notes"]


def test_a_strip_is_felt_along_its_long_axis_as_a_square(tmp_path):
    place = (np.arange(1024) + 0.5) / 1024.0
    ridges = 0.5 + 0.5 * np.cos(2.0 * np.pi * 50.0 * place)
    image_bump(grey_float("strip", np.tile(ridges, (16, 1))), 50e-6)
    strip = feel(tmp_path, *PLASTIC)
    texture = next(
        node for node in bpy.data.materials["Drawn"].node_tree.nodes if node.bl_idname == "ShaderNodeTexImage"
    )
    texture.image = grey_float("square", np.tile(ridges, (1024, 1)))
    square = feel(tmp_path, *PLASTIC)
    assert strip["level"] > 2.0
    assert abs(20.0 * np.log10(strip["level"] / square["level"])) < 1.0


def normal_plate(pixels: np.ndarray):
    """A plate of 20 mm under a normal map (H, W, 3)."""
    material = bpy.data.materials.new("Mapped")
    material.use_nodes = True
    tree = material.node_tree
    uv, mapping, texture, normal = (
        tree.nodes.new(f"ShaderNode{kind}") for kind in ("UVMap", "Mapping", "TexImage", "NormalMap")
    )
    mapping.inputs["Location"].default_value, mapping.inputs["Scale"].default_value = (0.5, 0.5, 0.0), (25.0, 25.0, 1.0)
    texture.image = float_image("map", pixels)
    tree.links.new(uv.outputs[0], mapping.inputs["Vector"])
    tree.links.new(mapping.outputs[0], texture.inputs["Vector"])
    tree.links.new(texture.outputs["Color"], normal.inputs["Color"])
    tree.links.new(normal.outputs[0], tree.nodes["Principled BSDF"].inputs["Normal"])
    return plate(material, 0.04)


def normals(slope: float = 0.4) -> np.ndarray:
    """A normal map of smooth random slopes (128, 128, 3), 0 to 1."""
    wave = 2.0 * np.pi * np.arange(128) / 16.0
    x, y = np.broadcast_arrays(slope * np.sin(wave)[None, :], slope * np.cos(wave)[:, None])
    z = np.sqrt(1.0 - x**2 - y**2)
    return 0.5 + 0.5 * np.stack([x, y, z], axis=-1)


@pytest.mark.parametrize("blue", [0.0, 0.5, 0.6, 1.0])
def test_a_map_of_two_channels_gives_the_height_of_three(blue):
    full = normals()
    whole = look(normal_plate(full), pixels=256)
    two = full.copy()
    two[..., 2] = blue
    rebuilt = look(normal_plate(two), pixels=256)
    assert np.std(rebuilt.height) == pytest.approx(np.std(whole.height), rel=0.1)
    assert np.corrcoef(rebuilt.height.ravel(), whole.height.ravel())[0, 1] > 0.99
    assert not whole.notes
    if blue != 1.0:  # nearly what a unit normal has here
        assert "two channels" in " ".join(rebuilt.notes)


def test_a_grey_normal_map_is_named_with_its_remedy(tmp_path):
    grey = np.random.default_rng(1).uniform(0.2, 0.4, (64, 64, 1)).repeat(3, axis=-1)
    normal_plate(grey)
    felt = feel(tmp_path, *PLASTIC)
    assert "'map' is a gray picture" in felt["notes"]
    assert "is kept" not in felt["notes"]
    assert "Bump node" in felt["notes"]
    assert felt["level"] < 1.0


def test_judging_a_colour_needs_no_normals_to_be_there():
    mask = np.ones((8, 8), dtype=bool)
    for colour in (np.zeros((8, 8, 3)), np.full((8, 8, 3), 0.5), np.ones((8, 8, 3))):
        kind, factor = judge_normal_colour(colour, mask)
        assert kind == ""
        assert (factor == 1.0).all()
    assert judge_normal_colour(np.zeros((8, 8, 3)), ~mask)[0] == ""


def test_a_relief_too_high_for_anything_fails_alone(tmp_path):
    """Beyond a thousand kilometres one line names object and remedy; the other stroke is delivered."""
    plate(bump_material("Huge", wavelength=2e-3, height=1e8, distance=1e8))
    other = add_plane("Other", 0.1, z=0.3)
    other.data.materials.append(bump_material("Fine"))
    code, report = touch(save_scene(tmp_path / "scene.blend"), tmp_path / "out")
    assert code != 0
    assert [stroke["object"] for stroke in report["strokes"]] == ["Other"]
    (failure,) = report["failed"]
    assert "object 'Plate'" in failure["why"]
    assert "Distance or Scale" in failure["why"]


def test_a_math_node_between_counts_in_the_rounding():
    """Half the height makes half the steps: the ramp stays even."""
    ramp = np.tile((np.arange(512) + 0.5) / 512.0, (512, 1))
    obj = image_bump(byte_image("ramp", ramp), 2e-3)
    tree = obj.data.materials[0].node_tree
    bump = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeBump")
    half = math_node(obj.data.materials[0], "MULTIPLY", bump.inputs["Height"].links[0].from_socket, 0.5)
    tree.links.new(half, bump.inputs["Height"])
    assert look(obj, pixels=256).resolved_wavelength_m == np.inf


def preview(stroke):
    """What the window plays now: signal and warnings."""
    current = read_current_bake(stroke, bpy.context.scene)
    result = synthesise_preview(current, ImageStyle(), RenderCache())
    return result.signal, " ".join(result.warnings)


@pytest.mark.parametrize("forces", [(1.0, 2.5, 1.0), (2.5, 1.0, 2.5)])
def test_a_loud_relief_is_doubted_anew_under_another_force(lone_bake, tmp_path, forces):
    """Without a render, and as `hnf touch` does under that force."""
    ridges = plate(bump_material("Ridges", wavelength=0.5e-3, height=0.1e-3))
    ridges.data.materials[0].hnf_touch.library = "smooth-plastic"
    stroke = line_stroke("Along", force=forces[0], surface=ridges)
    assert bake_job.bake_blocking(bpy.context.scene, bpy.context.view_layer).ok
    for number, force in enumerate(forces):
        stroke = bpy.data.objects["Along"]
        press(stroke, force)
        with count_work() as work:
            signal, warnings = preview(stroke)
        assert work.total("renders") == 0
        _, report = touch(save_scene(tmp_path / "scene.blend"), tmp_path / str(number))
        expected = signals(tmp_path / str(number), report)["Along"]
        assert signal.samples.astype(np.float32).tobytes() == expected.samples.astype(np.float32).tobytes()
        assert signal.rms < 100.0
        assert ("no pen stays on it" in warnings) == ("no pen stays on it" in " ".join(report["warnings"]))
        assert ("no pen stays on it" in warnings) == (force > 2.0)
        refresh_status(bpy.context.scene)
        status = STATE.get_status(bpy.context.scene, bpy.data.objects["Along"])
        assert status.freshness is (Freshness.FRESH if force == forces[0] else Freshness.FORCE)
        assert is_height_doubted(bpy.data.materials["Ridges"]) or "no pen stays on it" not in warnings
        if status.freshness is Freshness.FORCE:
            assert "no pen stays on it" not in " ".join(status.warnings)


def test_an_ordinary_bake_keeps_one_choice_of_heights(lone_bake):
    stroke = line_stroke("Along", surface=plate(bump_material("Ridges", wavelength=2e-3, height=60e-6)))
    assert bake_job.bake_blocking(bpy.context.scene, bpy.context.view_layer).ok
    assert load_bake(stroke).alternative is None


def press(stroke, force: float) -> None:
    """Hold a line_stroke with another force."""
    last = 1.0 + 0.026 / 0.1 * 24
    set_keys(stroke, "force", (1.0, 0.0), (2.5, force), (last - 1.5, force), (last, 0.0))
    bpy.context.view_layer.update()


@pytest.mark.parametrize("noise_m", [3e-3, 6e-3])
def test_no_displaced_mesh_shakes_the_pen_off(tmp_path, noise_m):
    """Crags of a metre: their mean slope under a patch says little of the steepest."""
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=300, y_subdivisions=300, size=0.06)
    grid = bpy.context.object
    grid.data.materials.append(bpy.data.materials.new("Rock"))
    modifier = grid.modifiers.new("Crags", "DISPLACE")
    modifier.texture = bpy.data.textures.new("Crags", "CLOUDS")
    modifier.texture.noise_scale, modifier.strength = noise_m, 1.0
    line_stroke("Along", surface=grid)
    _, report = touch(save_scene(tmp_path / "scene.blend"), tmp_path / "out", "--material", "Grid=smooth-plastic")
    assert all(stroke["rms_m_s2"] <= 100.0 for stroke in report["strokes"])


@pytest.mark.parametrize(("distance", "offered"), [(1.0, True), (0.01, True), (0.005, False), (50e-6, False)])
def test_insisting_is_offered_before_any_bake(distance, offered):
    """By the number in the node alone: a noise between 0 and 1, so many metres high."""
    STATE.clear()
    material = noise_material(distance)
    stroke = line_stroke("Along", surface=plate(material))
    with count_work() as work:
        refresh_status(bpy.context.scene)
    assert work.total("renders") == 0
    status = STATE.get_status(bpy.context.scene, stroke)
    assert status.freshness is Freshness.UNBAKED
    assert (material.name in status.doubted_shaders) == is_height_doubted(material) == offered
    assert ("says 1 m of relief" in " ".join(status.warnings)) == (distance == 1.0)
    material.hnf_touch.height_as_authored = True
    assert is_height_doubted(material)


@pytest.mark.parametrize("scale", [1.0, 0.01])
def test_a_displacement_s_scale_is_stated_in_metres(scale):
    material = noise_material(0.0)
    tree = material.node_tree
    displace = tree.nodes.new("ShaderNodeDisplacement")
    displace.inputs["Scale"].default_value = 1.0
    tree.links.new(tree.nodes["Noise Texture"].outputs[0], displace.inputs["Height"])
    tree.links.new(displace.outputs[0], tree.nodes["Material Output"].inputs["Displacement"])
    bpy.context.scene.unit_settings.scale_length = scale
    STATE.clear()
    line_stroke("Along", surface=plate(material, 0.1 / scale), length=0.026 / scale)
    refresh_status(bpy.context.scene)
    assert is_height_doubted(material)


def test_a_plan_says_what_becomes_of_an_unlikely_height(tmp_path, capsys):
    line_stroke("Along", surface=plate(noise_material(1.0)))
    scene = save_scene(tmp_path / "scene.blend")
    capsys.readouterr()
    assert main(["touch", str(scene), "--plan"]) == 0
    told = capsys.readouterr().out
    assert "says 1 m" in told
    assert "--height-as-authored" in told
    assert main(["touch", str(scene), "--plan", "--height-as-authored"]) == 0
    assert "says 1 m" not in capsys.readouterr().out


def test_the_option_stands_where_the_doubt_does(operators):
    """In the stroke's panel, in its preview and under the place that was examined."""
    from hnf_blender import ui

    stroke = line_stroke("Along", surface=plate(noise_material(1.0)))
    bpy.context.view_layer.objects.active = stroke
    STATE.clear()
    ui.register()
    try:
        refresh_status(bpy.context.scene)
        assert "height_as_authored" in drawn(bpy.types.HNF_PT_preview).props
        shown = drawn(bpy.types.HNF_PT_details)
        assert "height_as_authored" in shown.props
        assert "says 1 m of relief" in shown.words.replace("\n", " ")
        assert "Height as Authored: Old" in shown.words
        bpy.data.materials["Old"].node_tree.nodes["Bump"].inputs["Distance"].default_value = 1e-5
        STATE.clear()
        refresh_status(bpy.context.scene)
        for panel in (bpy.types.HNF_PT_preview, bpy.types.HNF_PT_details):
            assert "height_as_authored" not in drawn(panel).props
    finally:
        ui.unregister()
        STATE.clear()


def noise_material(distance: float):
    """As old files have it: a noise in a Bump node, as high as its Distance."""
    material = bpy.data.materials.new("Old")
    material.use_nodes = True
    tree = material.node_tree
    noise, bump = tree.nodes.new("ShaderNodeTexNoise"), tree.nodes.new("ShaderNodeBump")
    noise.inputs["Scale"].default_value, bump.inputs["Distance"].default_value = 400.0, distance
    bump.inputs["Strength"].default_value = 1.0
    tree.links.new(noise.outputs[0], bump.inputs["Height"])
    tree.links.new(bump.outputs[0], tree.nodes["Principled BSDF"].inputs["Normal"])
    return material
