"""Several views on one temporary scene: each equals a view rendered alone, and no data is left."""

from __future__ import annotations

from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from builders import add_plane, add_sphere, datablock_names
from overview_builders import render_overview

from hnf_blender.bridge import lit_render
from hnf_blender.bridge.cycles import configure_cycles, make_overview_camera
from hnf_blender.bridge.lit_render import OverviewRenderer
from hnf_blender.bridge.scene.meshes import read_surface
from hnf_blender.bridge.scene.temp_scene import TEMP_SCENE_NAME, TemporaryScene
from hnf_blender.touch import overview as touch_view
from hnf_blender.touch.overview import StrokeViews, is_path_visible
from hnf_blender.touch.report import Counts
from hnf_core.errors import SceneError
from hnf_core.progress import count_work
from hnf_core.scene.camera import Camera
from hnf_core.units import linear_to_srgb

LEFT = make_overview_camera([[0, 0, 0]], [-1, -1, 0.2], 0.7, 96, 54)
RIGHT = make_overview_camera([[0, 0, 0]], [1, -1, 0.2], 0.7, 80, 60)


def coloured(obj, colour):
    material = bpy.data.materials.new(obj.name)
    material.use_nodes = True
    material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (*colour, 1.0)
    obj.data.materials.append(material)
    return obj


@pytest.fixture
def things():
    ball, floor = coloured(add_sphere(radius=0.5), (0.8, 0.1, 0.1)), coloured(add_plane(size=4.0, z=-0.5), (0, 0, 1))
    bpy.context.view_layer.update()
    return ball, floor


def alone(camera, objects):
    return render_overview(bpy.context.scene, camera, samples=2, objects=objects)[0]


def assert_equal(view, other):
    np.testing.assert_array_equal(view.depth, other.depth)
    np.testing.assert_array_equal(view.rgb, other.rgb)


def test_each_view_equals_one_rendered_alone(things):
    ball, floor = things
    wanted = [(LEFT, [ball, floor]), (RIGHT, [ball]), (LEFT, [floor]), (LEFT, [ball, floor])]
    with OverviewRenderer(bpy.context.scene, samples=2) as overviews:
        found = [overviews.render_view(camera, objects)[0] for camera, objects in wanted]
    for view, (camera, objects) in zip(found, wanted, strict=True):
        assert_equal(view, alone(camera, objects))
    assert not np.array_equal(found[0].depth, found[2].depth)


@pytest.mark.parametrize("change", ["place", "shader", "shape", "light"])
def test_what_changed_between_two_views_is_seen(things, change):
    ball, floor = things
    with OverviewRenderer(bpy.context.scene, samples=2) as overviews:
        before, told = overviews.render_view(LEFT, [ball, floor])
        assert len(told) == 1
        if change == "place":
            ball.location.z = 0.2
        elif change == "shader":
            ball.data.materials[0].node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0, 1, 0, 1)
        elif change == "shape":
            ball.data.vertices[0].co.z += 0.4
            ball.data.update()
        else:
            lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "SUN"))
            bpy.context.scene.collection.objects.link(lamp)
        bpy.context.view_layer.update()
        after, told = overviews.render_view(LEFT, [ball, floor])
    assert not np.array_equal(before.rgb, after.rgb)
    assert (told == ()) == (change == "light")
    assert_equal(after, alone(LEFT, [ball, floor]))


def black_emission(ball):
    tree = ball.data.materials[0].node_tree
    picture = tree.nodes.new("ShaderNodeTexImage")
    picture.image = bpy.data.images.new("emission", 8, 8)
    tree.nodes["Principled BSDF"].inputs["Emission Strength"].default_value = 1.0
    tree.links.new(picture.outputs[0], tree.nodes["Principled BSDF"].inputs["Emission Color"])


def lamp_that_looks_away(ball):
    lamp = bpy.data.objects.new("Spot", bpy.data.lights.new("Spot", "SPOT"))
    lamp.location, lamp.rotation_euler = (0, 0, 3), (np.pi, 0, 0)
    bpy.context.scene.collection.objects.link(lamp)


def white_emission(ball):
    black_emission(ball)
    ball.data.materials[0].node_tree.nodes["Image Texture"].image.generated_color = (1, 1, 1, 1)


@pytest.mark.parametrize(
    ("light", "dark"), [(black_emission, True), (lamp_that_looks_away, True), (white_emission, False)]
)
def test_a_black_view_is_lit_by_the_dome_and_says_so(things, light, dark):
    ball, _ = things
    plain, (unlit_note,) = render_overview(bpy.context.scene, LEFT, samples=2, objects=[ball])
    light(ball)
    view, notes = render_overview(bpy.context.scene, LEFT, samples=2, objects=[ball])
    surface = np.isfinite(view.depth)
    assert ("neutral dome" in "".join(notes)) == dark
    assert unlit_note not in notes  # there is a light
    assert view.rgb[surface].mean() > 0.5 * plain.rgb[surface].mean()


def test_a_view_after_a_black_one_is_rendered_in_full_once(things):
    ball, floor = things
    lamp_that_looks_away(ball)
    single = [render_overview(bpy.context.scene, camera, samples=2, objects=[ball, floor]) for camera in (LEFT, RIGHT)]
    with count_work() as work, OverviewRenderer(bpy.context.scene, samples=2) as overviews:
        views = [overviews.render_view(camera, [ball, floor]) for camera in (LEFT, RIGHT)]
        lamp = bpy.context.scene.objects["Spot"]
        lamp.rotation_euler = (0, 0, 0)
        bpy.context.view_layer.update()
        _, told = overviews.render_view(LEFT, [ball, floor])
    sizes = work.items["images"]
    small = [camera.width * (100 // lit_render.PREVIEW_REDUCTION) // 100 for camera in (LEFT, RIGHT)]
    assert sizes[:2] == [LEFT.width] * 2  # black, then under the dome
    assert sizes[2:4] == [small[1], RIGHT.width]  # a look, then under the dome at once
    assert sizes[4:] == [small[0], LEFT.width]  # a look, which the turned lamp lights
    assert told == ()
    for (view, notes), (other, other_notes) in zip(views, single, strict=True):
        assert notes == other_notes == (lit_render.BLACK_NOTE,)
        assert_equal(view, other)


def test_a_black_thing_in_the_light_stays_black_without_a_word():
    thing = coloured(add_plane(size=9.0), (0, 0, 0))
    tree = thing.data.materials[0].node_tree
    diffuse = tree.nodes.new("ShaderNodeBsdfDiffuse")  # which reflects nothing at all
    diffuse.inputs["Color"].default_value = (0, 0, 0, 1)
    tree.links.new(diffuse.outputs[0], tree.get_output_node("CYCLES").inputs["Surface"])
    lamp = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    bpy.context.scene.collection.objects.link(lamp)
    above = make_overview_camera([[0, 0, 0]], [0, -0.1, 1], 0.3, 32, 32)
    view, notes = render_overview(bpy.context.scene, above, samples=2, objects=[thing])
    assert notes == ()
    assert view.rgb.max() < 0.01


def test_views_allow_other_edits_and_leave_no_data(things):
    ball, floor = things
    before = datablock_names()
    with OverviewRenderer(bpy.context.scene, samples=1) as overviews:
        first, _ = overviews.render_view(LEFT, [ball, floor])
        assert ball.users_scene == floor.users_scene == (bpy.context.scene,)
        with TemporaryScene() as temporary:
            configure_cycles(temporary.scene, 1)
            temporary.copy_object(ball, with_data=True)
        kept = bpy.data.objects.new("made meanwhile", None)
        again, _ = overviews.render_view(LEFT, [ball, floor])
    assert_equal(first, again)
    assert kept.name == "made meanwhile"
    bpy.data.objects.remove(kept)
    assert datablock_names() == before


def test_a_view_that_fails_leaves_no_object_behind(things):
    ball, floor = things
    before = datablock_names()
    intrinsics = np.array([[50.0, 0.0, 20.0], [0.0, 60.0, 20.0], [0.0, 0.0, 1.0]])
    oblong = Camera("perspective", 40, 40, intrinsics, LEFT.pose, 0.1, 10.0)
    with OverviewRenderer(bpy.context.scene, samples=1) as overviews:
        with pytest.raises(SceneError, match="not square"):
            overviews.render_view(oblong, [ball])
        assert ball.users_scene == (bpy.context.scene,)
        view, _ = overviews.render_view(LEFT, [ball, floor])
    assert np.isfinite(view.depth).any()
    assert datablock_names() == before
    assert TEMP_SCENE_NAME not in bpy.data.scenes


def test_a_rectangle_of_a_view_shows_what_the_whole_shows_there(things):
    with OverviewRenderer(bpy.context.scene, samples=1, entire_scene=True) as overviews:
        overviews.temporary.scene.cycles.use_denoising = False
        whole, _ = overviews.render_view(LEFT)
        part, _ = overviews.render_view(LEFT.crop(30, 20, 24, 16))
    there = whole.depth[20:36, 30:54]
    both = np.isfinite(there) & np.isfinite(part.depth)
    assert (np.isfinite(there) == np.isfinite(part.depth)).mean() > 0.99
    np.testing.assert_allclose(np.median(part.depth[both] / there[both]), 1.0, rtol=1e-6)
    assert np.quantile(np.abs(part.depth[both] / there[both] - 1.0), 0.95) < 1e-3


def test_denoising_lowers_the_error_of_a_view_with_few_samples(things):
    def srgb(samples, denoised):
        with OverviewRenderer(bpy.context.scene, samples=samples, entire_scene=True) as overviews:
            overviews.temporary.scene.cycles.use_denoising = denoised
            return linear_to_srgb(overviews.render_view(RIGHT)[0].rgb)

    true = srgb(256, False)
    raw, denoised = (np.sqrt(np.mean((srgb(4, each) - true) ** 2)) for each in (False, True))
    assert 0.0 < denoised < 0.7 * raw


def test_denoising_with_relief_passes_preserves_ridges():
    """A few pixels wide, faint, in a noisy light: 0.68 by colour alone."""
    cloth = coloured(add_plane(size=1.0), (0.1, 0.3, 0.3))
    nodes, links = (getattr(cloth.active_material.node_tree, name) for name in ("nodes", "links"))
    where, wave, bump, shade = (nodes.new(f"ShaderNode{name}") for name in ("TexCoord", "TexWave", "Bump", "ValToRGB"))
    wave.inputs["Scale"].default_value, bump.inputs["Distance"].default_value = 10.0, 0.001
    for stop, colour in zip(shade.color_ramp.elements, ((0.08, 0.25, 0.25, 1.0), (0.1, 0.33, 0.33, 1.0)), strict=True):
        stop.color = colour
    links.new(where.outputs["Object"], wave.inputs["Vector"])
    links.new(wave.outputs["Fac"], bump.inputs["Height"])
    links.new(wave.outputs["Fac"], shade.inputs["Fac"])
    for output, name in ((bump.outputs["Normal"], "Normal"), (shade.outputs["Color"], "Base Color")):
        links.new(output, nodes["Principled BSDF"].inputs[name])
    wide = lamp((0, 0, 2))
    wide.rotation_euler, wide.data.angle = (0.0, 1.0, 0.0), 3.0
    camera = make_overview_camera([[0, 0, 0]], [0, 0, 1], 0.3, 192, 108)

    def ridges(samples, denoised, relief=""):
        """What changes within seven pixels."""
        with OverviewRenderer(bpy.context.scene, samples=samples, entire_scene=True, relief=relief) as overviews:
            overviews.temporary.scene.cycles.use_denoising = denoised
            seen = linear_to_srgb(overviews.render_view(camera)[0].rgb)[..., 1]
        return seen - np.stack([np.roll(seen, shift, axis=1) for shift in range(-3, 4)]).mean(axis=0)

    true = ridges(128, False)
    by_colour, shown = (
        np.corrcoef(true.ravel(), ridges(touch_view.SAMPLES, True, relief).ravel())[0, 1] for relief in ("", "fast")
    )
    assert shown > max(0.8, by_colour + 0.05)


@pytest.fixture
def small(monkeypatch):
    monkeypatch.setattr(touch_view, "WIDTH", 96)
    monkeypatch.setattr(touch_view, "HEIGHT", 54)
    monkeypatch.setattr(lit_render, "configure_cycles", lambda scene, samples: configure_cycles(scene, 1))


def test_views_of_a_run_share_one_lazily_built_scene(things, small):
    _, floor = things
    depsgraph, counts = bpy.context.evaluated_depsgraph_get(), Counts()
    surface = read_surface(floor, depsgraph, 1.0)
    with count_work() as work, StrokeViews(bpy.context.scene, depsgraph, 1.0, counts) as views:
        assert (work.total("scenes"), counts.renders) == (0, 0)
        for x in (0.8, 1.2):
            point = np.stack([np.linspace(x, x + 0.1, 5), np.zeros(5), np.zeros(5)], axis=1)
            contacts = SimpleNamespace(point=point, normal=np.tile([0.0, 0.0, 1.0], (5, 1)), force=np.ones(5))
            shown, _ = draw(views, "Across", contacts, surface, floor)
            assert np.ptp(shown.path[:, 0]) > 15
            assert (
                bpy.data.scenes[TEMP_SCENE_NAME].cycles.denoising_input_passes == "RGB_ALBEDO_NORMAL"
            )  # the relief stays
    assert (work.total("scenes"), work.total("renders"), counts.renders) == (1, 2, 2)
    assert TEMP_SCENE_NAME not in bpy.data.scenes


def draw(views, *stroke):
    """The view of one stroke without others: its name, contacts, surface and object."""
    (cameras,) = views.choose_cameras([stroke])
    return views.render_stroke(cameras)


def seen_from_below(gap):
    """A stroke over the underside of a board that floats `gap` above a floor: the picture of it, and its notes."""
    board = coloured(add_plane("Board", size=0.4), (0.8, 0.1, 0.1))
    board.rotation_euler = (np.pi, 0.0, 0.0)
    if gap is not None:
        coloured(add_plane("Ground", size=4.0, z=-gap), (0.5, 0.5, 0.5))
    bpy.context.view_layer.update()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    surface = read_surface(board, depsgraph, 1.0)
    way = np.linspace(-0.03, 0.03, 9)
    point = np.stack([way, way, np.zeros(9)], axis=1) @ surface.rigid[:3, :3]
    down = np.array([0.0, 0.0, -1.0]) @ surface.rigid[:3, :3]
    contacts = SimpleNamespace(point=point, normal=np.tile(down, (9, 1)), force=np.ones(9))
    with StrokeViews(bpy.context.scene, depsgraph, 1.0, Counts()) as views:
        return draw(views, "Under the board", contacts, surface, board)


@pytest.mark.parametrize("gap", [None, 0.25, 0.05])
@pytest.mark.parametrize("look_width", [96, 12])
def test_what_stands_before_a_stroke_is_cut_away_and_said(small, monkeypatch, gap, look_width):
    monkeypatch.setattr(touch_view, "LOOK_WIDTH", look_width)  # a coarse look misses small gaps: the view tells
    shown, notes = seen_from_below(gap)
    assert shown.visible.all()
    row, column = shown.path.astype(int)[4][::-1]
    red, _, blue = shown.rgb[row, column]
    assert red > 2.0 * blue
    told = [note for note in notes if "Under the board" in note]
    assert told == (
        [] if gap is None else ["stroke 'Under the board': what stands before it is cut away in its picture."]
    )


def test_a_stroke_that_no_view_shows_is_told(small, monkeypatch):
    monkeypatch.setattr(touch_view, "clip_obstacles", lambda *_: None)
    shown, notes = seen_from_below(0.05)
    assert not shown.visible.any()
    assert "stroke 'Under the board': all of it is hidden in its picture." in notes


def test_an_occluded_scene_camera_is_not_used(small):
    board = coloured(add_plane("Board", size=0.4), (0.8, 0.1, 0.1))
    coloured(add_plane("Lid", size=0.4, z=0.5), (0, 0, 1))
    data = bpy.data.cameras.new("Above")
    data.angle = 0.2
    camera = bpy.data.objects.new("Above", data)
    camera.location = (0.0, 0.0, 1.0)
    bpy.context.scene.collection.objects.link(camera)
    bpy.context.scene.camera = camera
    bpy.context.view_layer.update()
    depsgraph, counts = bpy.context.evaluated_depsgraph_get(), Counts()
    surface = read_surface(board, depsgraph, 1.0)
    point = np.stack([np.linspace(-0.03, 0.03, 9), np.zeros(9), np.zeros(9)], axis=1)
    contacts = SimpleNamespace(point=point, normal=np.tile([0.0, 0.0, 1.0], (9, 1)), force=np.ones(9))
    with StrokeViews(bpy.context.scene, depsgraph, 1.0, counts) as views:
        for cameras in views.choose_cameras((name, contacts, surface, board) for name in ("One", "Two")):
            shown, _ = views.render_stroke(cameras)
            assert shown.visible.all()
    assert counts.renders == 3  # the scene's own view once


def strokes_on(board, places, length=0.04, downwards=()):
    """Strokes along x, each over a place of a board; those of `downwards` as if they touched its other side."""
    surface = read_surface(board, bpy.context.evaluated_depsgraph_get(), 1.0)
    along = np.linspace(-0.5, 0.5, 9)[:, None] * [length, 0.0, 0.0]
    strokes = []
    for number, place in enumerate(places):
        up = [0.0, 0.0, -1.0 if number in downwards else 1.0]
        contacts = SimpleNamespace(point=along + place, normal=np.tile(up, (9, 1)), force=np.ones(9))
        strokes.append((f"Stroke {number}", contacts, surface, board))
    return strokes


ROW = [(0.05 * number, 0.02, 0.0) for number in range(4)]


def stroke_views(counts):
    return StrokeViews(bpy.context.scene, bpy.context.evaluated_depsgraph_get(), 1.0, counts)


def test_strokes_beside_each_other_share_a_legible_view(small):
    board, counts = coloured(add_plane("Board", size=0.5), (0.8, 0.1, 0.1)), Counts()
    bpy.context.view_layer.update()
    with stroke_views(counts) as views:
        chosen = views.choose_cameras(strokes_on(board, ROW))
        shown = [views.render_stroke(cameras)[0] for cameras in chosen]
        assert counts.renders == 1
        again = [views.render_stroke(cameras)[0] for cameras in reversed(chosen)]
    for one, other in zip(shown, reversed(again), strict=True):
        assert one.visible.all()
        assert np.ptp(one.path[:, 0]) >= touch_view.MIN_SHARED_FRACTION * touch_view.WIDTH
        np.testing.assert_array_equal(one.rgb, other.rgb)
        np.testing.assert_array_equal(one.path, other.path)
    assert len({float(each.path[0, 0]) for each in shown}) == len(ROW)
    with stroke_views(Counts()) as views:  # the last alone, as where the others' pictures are drawn already
        alone, _ = views.render_stroke(views.choose_cameras(strokes_on(board, ROW))[-1])
    np.testing.assert_array_equal(alone.rgb, shown[-1].rgb)


def test_strokes_that_no_view_shows_well_share_none(small):
    board = coloured(add_plane("Board", size=0.5), (0.8, 0.1, 0.1))
    bpy.context.view_layer.update()
    with stroke_views(Counts()) as views:
        far_apart = views.choose_cameras(strokes_on(board, [(0.0, 0.0, 0.0), (0.4, 0.0, 0.0), (0.0, 0.4, 0.0)]))
        two_sides = views.choose_cameras(strokes_on(board, ROW, downwards=(1, 3)))
    assert [cameras.shared for cameras in far_apart] == [None] * 3
    above, below = ({id(two_sides[number].shared) for number in side} for side in ((0, 2), (1, 3)))
    assert (len(above), len(below), len(above | below)) == (1, 1, 2)


def test_a_stroke_hidden_in_the_shared_view_has_its_own(small):
    board, counts = coloured(add_plane("Board", size=0.5), (0.8, 0.1, 0.1)), Counts()
    lid = coloured(add_plane("Lid", size=0.05), (0.0, 0.0, 1.0))
    lid.location = np.add(ROW[2], 0.03 * np.array([0.45, -0.8, 1.0]))  # on the way to the camera
    bpy.context.view_layer.update()
    with stroke_views(counts) as views:
        chosen = views.choose_cameras(strokes_on(board, ROW))
        seen = [views.render_stroke(cameras) for cameras in chosen]
    assert all(shown.visible.mean() > 0.9 for shown, _ in seen)
    assert [any("cut away" in note for note in notes) for _, notes in seen] == [False, False, True, False]
    assert counts.renders == 1 + 1  # the shared one; the hidden stroke's own, behind the lid that a small look told of


def test_a_few_views_show_hundreds_of_strokes(small):
    board = coloured(add_plane("Board", size=0.5), (0.8, 0.1, 0.1))
    bpy.context.view_layer.update()
    places = [(0.05 * column, 0.05 * row, 0.0) for row in range(10) for column in range(30)]
    with stroke_views(Counts()) as views:
        chosen = views.choose_cameras(strokes_on(board, places, length=0.03))
        again = views.choose_cameras(strokes_on(board, places, length=0.03))
        assert [views.hash_view(each) for each in chosen] == [views.hash_view(each) for each in again]
    shared = [id(cameras.shared) for cameras in chosen]
    assert len(set(shared)) <= len(places) / 6
    for cameras in (each for each in chosen if each.shared is not None):
        assert is_path_visible(cameras.shared.camera, cameras.own.path, touch_view.MIN_SHARED_FRACTION)


def lamp(place, energy=2.0):
    found = bpy.data.objects.new("lamp", bpy.data.lights.new("lamp", "SUN"))
    bpy.context.scene.collection.objects.link(found)
    found.data.energy, found.location, found.rotation_euler = energy, place, (0.5, 0.3, 0.0)
    return found


def test_a_light_tree_is_used_only_with_several_lights(things, monkeypatch):
    ball, _ = things

    def seen(tree=None, seed=0):
        """Whether a tree was chosen, and the picture with `tree`, or with what was chosen."""
        with OverviewRenderer(bpy.context.scene, samples=4, entire_scene=True) as overviews:
            own = overviews.temporary.scene.cycles
            own.use_denoising, own.seed = False, seed
            if tree is not None:
                monkeypatch.setattr(lit_render, "_count_lamps", lambda scene: 2 * tree)
            rgb = linear_to_srgb(overviews.render_view(LEFT)[0].rgb)
            monkeypatch.undo()
            return own.use_light_tree, rgb

    def differ(one, other):
        return float(np.sqrt(np.mean((one - other) ** 2)))

    assert not seen()[0]
    first = lamp((0, 0, 2))
    (chosen, without), (forced, with_tree), (_, other_noise) = seen(), seen(tree=True), seen(seed=1)
    assert (chosen, forced) == (False, True)
    assert differ(without, with_tree) < 0.05 * differ(without, other_noise)  # 0.017: a few pixels
    second = lamp((1, 0, 2))
    assert seen()[0]
    second.data.energy = 0.0
    assert not seen()[0]
    second.data.energy, first.hide_render = 1.0, True
    assert not seen()[0]
    inputs = ball.active_material.node_tree.nodes["Principled BSDF"].inputs
    inputs["Emission Strength"].default_value, inputs["Emission Color"].default_value = 1.0, (1, 1, 1, 1)
    assert seen()[0]
