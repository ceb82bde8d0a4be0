"""Views: rays against Cycles, Blender cameras as records, supplied cameras and lights, and an unchanged file."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from builders import add_plane, add_sphere, datablock_names
from mathutils import Vector
from overview_builders import render_overview, to_surface_frame

from hnf_blender.bridge.cycles import (
    add_aovs,
    add_camera,
    configure_cycles,
    disable_lighting,
    get_planar_depth,
    make_overview_camera,
    read_camera,
    render_passes,
    set_camera,
)
from hnf_blender.bridge.scene.meshes import make_ray_caster, read_surface
from hnf_blender.bridge.scene.temp_scene import TemporaryScene
from hnf_blender.bridge.shader.aov_taps import Tap
from hnf_core.errors import SceneError
from hnf_core.scene.camera import Camera
from hnf_core.scene.raycast import cast_view

HELMET = Path(__file__).parents[3] / "shared" / "data" / "scenes" / "FlightHelmet" / "FlightHelmet.gltf"


def surface(obj, metres_per_unit=1.0):
    bpy.context.view_layer.update()
    return read_surface(obj, bpy.context.evaluated_depsgraph_get(), metres_per_unit)


def cycles_depth_and_faces(obj, camera, metres_per_unit):
    """Planar depth (metres) and evaluated polygon ids by Cycles, with a FACE attribute sent to an AOV."""
    tap = Tap("face", "VALUE")
    with TemporaryScene() as temporary:
        configure_cycles(temporary.scene, 1)
        disable_lighting(temporary.scene)
        baked = bpy.data.meshes.new_from_object(obj.evaluated_get(bpy.context.evaluated_depsgraph_get()))
        index = baked.attributes.new("polygon", "FLOAT", "FACE")
        index.data.foreach_set("value", np.arange(1, len(baked.polygons) + 1, dtype=np.float32))
        material = bpy.data.materials.new("ids")
        material.use_nodes = True
        tree = material.node_tree
        attribute, aov = tree.nodes.new("ShaderNodeAttribute"), tree.nodes.new("ShaderNodeOutputAOV")
        attribute.attribute_name, aov.aov_name = "polygon", tap.name
        tree.links.new(attribute.outputs["Fac"], aov.inputs["Value"])
        actor = temporary.new_object("actor", baked)
        temporary.set_world_matrix(actor, obj.matrix_world)
        temporary.view_layer.material_override = material
        temporary.view_layer.use_pass_z = True
        add_aovs(temporary.view_layer, [tap])
        set_camera(temporary.scene, add_camera(temporary), camera, np.eye(4), metres_per_unit)
        passes = render_passes(temporary)
    return get_planar_depth(passes, metres_per_unit), np.round(passes["face"]).astype(int) - 1


def near_an_edge(cast):
    """Pixels next to a change of triangle or to the outline."""
    change = np.zeros(cast.triangle.shape, dtype=bool)
    for axis in (0, 1):
        differs = np.diff(cast.triangle, axis=axis) != 0
        first, second = [slice(None)] * 2, [slice(None)] * 2
        first[axis], second[axis] = slice(None, -1), slice(1, None)
        change[tuple(first)] |= differs
        change[tuple(second)] |= differs
    return change


def assert_rays_agree_with_cycles(obj, camera, metres_per_unit=1.0):
    found = surface(obj, metres_per_unit)
    cast = cast_view(make_ray_caster(found.mesh), found.mesh, to_surface_frame(camera, found))
    depth, faces = cycles_depth_and_faces(obj, camera, metres_per_unit)
    both = np.isfinite(depth) & np.isfinite(cast.depth)
    assert both.sum() > 3000
    error = np.zeros(both.shape)
    error[both] = np.abs(depth[both] - cast.depth[both]) / cast.depth[both]
    assert (np.isfinite(depth) != np.isfinite(cast.depth)).mean() <= 1e-4
    assert np.median(error[both]) <= 1e-5
    assert np.quantile(error[both], 0.999) <= 1e-4
    assert error[~near_an_edge(cast)].max() <= 1e-4
    differ = faces != cast.face_id
    # Cycles' first sample lies about 1e-3 pixels off the centre: a mesh as fine as the pixels would differ more.
    assert differ.mean() <= 1e-4
    assert not (differ & ~near_an_edge(cast)).any()


def test_cast_depth_and_ids_match_cycles_on_a_transformed_sphere():
    ball = add_sphere(radius=0.5)
    ball.scale, ball.rotation_euler, ball.location = (1.0, -0.6, 1.4), (0.3, 0.5, 0.7), (2.0, 3.0, -1.0)
    bpy.context.view_layer.update()
    camera = make_overview_camera([[2.0, 3.0, -1.0]], [1.0, -1.0, 0.3], 0.9, 240, 180)
    assert_rays_agree_with_cycles(ball, camera)


@pytest.mark.parametrize("metres_per_unit", [1.0, 0.01])
def test_orthographic_cast_depth_and_ids_match_cycles(metres_per_unit):
    ball = add_sphere(radius=0.5 / metres_per_unit, segments=16, rings=8)
    ball.modifiers.new("fine", "SUBSURF").levels = 1
    bpy.context.view_layer.update()
    pose = np.eye(4) @ np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = 2.0
    # Off centre, so that no row of pixel centres runs along an edge.
    intrinsics = np.array([[200.0, 0.0, 120.3], [0.0, 200.0, 85.2], [0.0, 0.0, 1.0]])
    camera = Camera("orthographic", 240, 180, intrinsics, pose, 0.1, 10.0)
    assert_rays_agree_with_cycles(ball, camera, metres_per_unit)


@pytest.mark.skipif(not HELMET.exists(), reason="the FlightHelmet data is not here")
def test_cast_depth_and_ids_are_those_of_cycles_on_a_real_helmet():
    bpy.ops.import_scene.gltf(filepath=str(HELMET))
    leather = next(obj for obj in bpy.context.scene.objects if "Leather" in obj.name)
    corners = np.array([list(leather.matrix_world @ Vector(corner)) for corner in leather.bound_box])
    camera = make_overview_camera(corners, [0.2, -1.0, 0.1], 0.1, 480, 360)
    assert_rays_agree_with_cycles(leather, camera)


def new_camera(**settings):
    data = bpy.data.cameras.new("Camera")
    for name, value in settings.items():
        setattr(data, name, value)
    camera = bpy.data.objects.new("Camera", data)
    bpy.context.scene.collection.objects.link(camera)
    camera.location, camera.rotation_euler = (1.0, -4.0, 2.0), (1.1, 0.1, 0.2)
    bpy.context.view_layer.update()
    return camera


@pytest.mark.parametrize("settings", [
    {}, {"lens": 24.0, "sensor_width": 22.0, "shift_x": 0.2, "shift_y": -0.1},
    {"sensor_fit": "VERTICAL", "sensor_height": 30.0, "shift_y": 0.3}, {"sensor_fit": "HORIZONTAL"},
    {"type": "ORTHO", "ortho_scale": 5.0, "shift_x": 0.1},
])  # fmt: skip
@pytest.mark.parametrize(("size", "percentage", "aspect"), [((640, 480), 100, (1, 1)), ((300, 500), 50, (1.0, 2.0))])
def test_a_camera_record_projects_as_blender_does(settings, size, percentage, aspect):
    camera, scene = new_camera(**settings), bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.render.resolution_percentage = percentage
    scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = aspect
    scene.render.use_border, scene.render.border_max_x = True, 0.5  # not the whole picture: not counted
    record = read_camera(scene, camera, 0.01)
    assert (record.width, record.height) == tuple(side * percentage // 100 for side in size)
    for point in np.random.default_rng(0).uniform(-1, 1, (20, 3)):
        u, v, depth = world_to_camera_view(scene, camera, Vector(point))
        uv, z = record.project(0.01 * point)
        np.testing.assert_allclose(uv, [u * record.width, (1 - v) * record.height], atol=2e-3)
        assert z == pytest.approx(0.01 * depth, rel=1e-5)


def test_aiming_a_record_back_gives_the_same_camera():
    camera, scene = new_camera(lens=35.0, shift_x=0.1, shift_y=0.05), bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = 320, 200
    record = read_camera(scene, camera, 0.1)
    other = new_camera()
    set_camera(scene, other, record, np.eye(4), 0.1)
    bpy.context.view_layer.update()
    again = read_camera(scene, other, 0.1)
    np.testing.assert_allclose(again.intrinsics, record.intrinsics, rtol=1e-5)
    np.testing.assert_allclose(again.pose, record.pose, atol=1e-6)


def test_a_panoramic_camera_is_refused_by_name():
    with pytest.raises(SceneError, match="'Camera'"):
        read_camera(bpy.context.scene, new_camera(type="PANO"), 1.0)


@pytest.mark.parametrize("outward", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0.3, -1, 0.2), (0, 0, 0)])
def test_a_supplied_camera_sees_everything_from_outside(outward):
    points = np.random.default_rng(1).uniform(-0.05, 0.05, (50, 3)) + np.array([1.0, 2.0, 3.0])
    camera = make_overview_camera(points, outward, 0.2)
    uv, z = camera.project(points)
    assert (z > 0).all()
    assert ((uv >= 0) & (uv <= [camera.width, camera.height])).all()
    np.testing.assert_allclose(camera.pose[:3, :3].T @ camera.pose[:3, :3], np.eye(3), atol=1e-12)
    assert np.linalg.det(camera.pose[:3, :3]) == pytest.approx(1.0)
    assert -camera.pose[:3, 2] @ np.array(outward) >= 0.0
    assert camera.pose[2, 1] <= 1e-9  # upright: image down is never up


def scene_with_ball():
    ball, floor = add_sphere(radius=0.5), add_plane(size=4.0, z=-0.5)
    ball.data.materials.append(bpy.data.materials.new("Ball"))
    bpy.context.view_layer.update()
    return ball, floor


def test_an_overview_adds_light_and_leaves_the_file_unchanged():
    ball, floor = scene_with_ball()
    scene = bpy.context.scene
    before = datablock_names()
    settings = {name: getattr(scene.render, name) for name in ("engine", "resolution_x", "filepath", "use_compositing")}
    camera = make_overview_camera([[0, 0, 0]], [0, -1, 0], 0.7, 96, 54)
    found = surface(ball)
    view, notes = render_overview(scene, camera, samples=4, surface=found)
    assert any("no light" in note for note in notes)
    assert view.rgb.shape == (54, 96, 3)
    assert view.rgb.mean() > 0.2
    assert np.isinf(view.depth).any()
    cast = cast_view(make_ray_caster(found.mesh), found.mesh, to_surface_frame(camera, found))
    np.testing.assert_array_equal(view.face_id[~near_an_edge(cast)], cast.face_id[~near_an_edge(cast)])
    assert datablock_names() == before
    assert {name: getattr(scene.render, name) for name in settings} == settings
    assert floor.users_scene == (scene,)


def test_a_hidden_part_of_the_surface_has_no_face_ids():
    ball, floor = scene_with_ball()
    camera = make_overview_camera([[0, 0, 0]], [0, -1, 0], 0.7, 96, 54)
    wall = add_plane("Wall", size=0.5)
    wall.rotation_euler, wall.location = (np.pi / 2, 0, 0), (0.0, -1.0, 0.3)
    found = surface(ball)
    covered, _ = render_overview(bpy.context.scene, camera, samples=1, surface=found)
    alone, _ = render_overview(bpy.context.scene, camera, samples=1, surface=found, objects=[ball])
    assert 0 < (covered.face_id >= 0).sum() < (alone.face_id >= 0).sum()
    assert floor.name not in {obj.name for obj in bpy.data.scenes[0].objects if obj == ball}


def test_an_overview_uses_the_scenes_own_lights_and_camera():
    scene_with_ball()
    scene = bpy.context.scene
    scene.camera = new_camera()
    scene.camera.rotation_euler = (1.2, 0.0, 0.2)
    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "SUN"))
    scene.collection.objects.link(lamp)
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 160, 90, 50
    view, notes = render_overview(scene, None, samples=1)
    assert notes == ()
    assert view.rgb.shape == (45, 80, 3)
    np.testing.assert_allclose(view.camera.pose, read_camera(scene, scene.camera, 1.0).pose, atol=1e-6)
    for light in (0.0, 5.0):
        lamp.data.energy = light
        dark = render_overview(scene, None, samples=1, objects=list(scene.objects))[1]
        assert bool(dark) == (light == 0.0)


def test_a_temporary_scene_leaves_nothing_even_after_an_error():
    ball, _ = scene_with_ball()
    before = datablock_names()
    folders = []

    def interrupted():
        with TemporaryScene() as temporary:
            copy = temporary.copy_object(ball, with_data=True)
            temporary.set_world_matrix(temporary.new_object("x", None), np.eye(4))
            folders.append(temporary.folder)
            copy.data.materials[0].copy()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert datablock_names() == before
    assert not folders[0].exists()


def test_a_placed_object_has_its_exact_matrix_shear_included():
    matrix = np.array([[1.0, 0.5, 0.0, 1.0], [0.2, 2.0, 0.0, 2.0], [0.0, 0.3, -1.0, 3.0], [0.0, 0.0, 0.0, 1.0]])
    with TemporaryScene() as temporary:
        obj = temporary.new_object("sheared", None)
        temporary.set_world_matrix(obj, matrix)
        temporary.evaluate()
        np.testing.assert_allclose(np.array(obj.evaluated_get(temporary.view_layer.depsgraph).matrix_world), matrix)
