"""Primitives placed on planes, spheres, heads and helmets: slot, orientation and speed."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
import pytest
from builders import add_mesh, add_plane, add_sphere

from hnf_blender.bridge.scene.meshes import make_ray_caster, read_surface
from hnf_blender.bridge.stroke.place_primitive import choose_default_slots, place_primitive
from hnf_blender.bridge.stroke.read_stroke import list_strokes, read_stroke
from hnf_core.action.contacts import action_from_contacts, find_contacts, plan_patches
from hnf_core.action.parse_stroke import parse_stroke
from hnf_core.action.primitive_path import make_primitive_action
from hnf_core.action.primitives import PRIMITIVE_NAMES, PRIMITIVES
from hnf_core.errors import SceneError

HELMET = Path(__file__).resolve().parents[2].parent / "shared/data/scenes/FlightHelmet/FlightHelmet.gltf"


def graph():
    return bpy.context.evaluated_depsgraph_get()


def place(obj, primitive, slot=None, metres_per_unit=1.0, **keywords):
    placed = place_primitive(bpy.context.scene, obj, slot, primitive, metres_per_unit, **keywords)
    assert placed.rays > 0
    return placed.curve


def act(obj, metres_per_unit=1.0):
    stroke = read_stroke(obj, bpy.context.scene, graph(), metres_per_unit)
    mesh = read_surface(bpy.data.objects[stroke.object_name], graph(), metres_per_unit).mesh
    contacts = find_contacts(stroke.samples, stroke.get_surface(mesh))
    patches, index = plan_patches(contacts)
    return stroke, contacts, mesh, action_from_contacts(contacts, patches, index, stroke.probe)


def assert_well_placed(obj, slot, *, within=5e-4, outward=0.99):
    """On the slot all along, on the surface, and looking into the open."""
    stroke, contacts, mesh, action = act(obj)
    assert np.mean(contacts.slot == slot) >= 0.99
    assert contacts.distance.max() < within
    up = make_ray_caster(mesh).cast(contacts.point + 1e-3 * contacts.normal, contacts.normal)
    assert np.mean(up.triangle < 0) >= outward
    assert np.array_equal(action.contact, contacts.force > 0)
    return stroke, contacts, action


@pytest.mark.parametrize("name", PRIMITIVE_NAMES)
def test_a_plane_gives_the_primitive_itself(name):
    obj = place(add_plane(size=0.1), name, seed=3)
    stroke, contacts, action = assert_well_placed(obj, 0, within=1e-6)
    expected = make_primitive_action(name, seed=3)
    n = min(len(action.speed), len(expected.speed))
    # A rub is redrawn with closer knots, a scrape is straight either way.
    near = 5e-2 if name.startswith("rub") else 1e-2
    assert abs(len(action.speed) - len(expected.speed)) <= 1
    assert np.allclose(action.speed[:n], expected.speed[:n], atol=near * PRIMITIVES[name].speed)
    assert np.allclose(action.force[:n], expected.force[:n], atol=near * PRIMITIVES[name].force)
    moving = expected.speed[:n] > 0.01
    assert np.allclose(action.direction[:n][moving], expected.direction[:n][moving], atol=5 * near)
    assert stroke.motion_profile == "PROGRESS"
    assert stroke.seed == 3
    # In the middle: no closer to the border than need be.
    assert np.abs(contacts.point[:, :2]).max() < 0.035


def test_stroke_is_an_editable_child():
    plane = add_plane(size=0.1)
    obj = place(plane, "left-right-soft", start_frame=12)
    assert obj.parent == plane
    assert obj.hnf_stroke.surface == plane
    assert list_strokes(bpy.context.scene) == [obj]
    before = act(obj)[3]
    plane.location, plane.rotation_euler = (1, 2, 3), (0.3, 0.2, 2.0)
    bpy.context.view_layer.update()
    after = act(obj)[3]
    assert np.allclose(before.speed, after.speed, atol=1e-6)
    assert np.allclose(before.direction, after.direction, atol=1e-5)
    stroke = act(obj)[0]
    assert stroke.frames[0] == 12
    from hnf_blender import compat

    for fcurve in compat.fcurves_of(obj):
        for point in fcurve.keyframe_points:
            point.co[1] *= 2 if fcurve.data_path.endswith("force") else 1
            point.handle_left[1] *= 2 if fcurve.data_path.endswith("force") else 1
            point.handle_right[1] *= 2 if fcurve.data_path.endswith("force") else 1
    assert act(obj)[3].force.max() == pytest.approx(1.0, rel=1e-5)


def test_the_default_takes_the_longer_way():
    """On a narrow strip along the surface's y it runs from top to bottom."""
    strip = add_mesh(
        "Strip",
        [(-0.008, -0.1, 0), (0.008, -0.1, 0), (0.008, 0.1, 0), (-0.008, 0.1, 0)],
        [(0, 1, 2, 3)],
        uv=lambda co: co[:2],
    )
    placed = place_primitive(bpy.context.scene, strip, 0, "default", 1.0, name="Mine")
    assert placed.primitive == "default-down"
    assert placed.curve.name == "Mine"
    action = act(placed.curve)[3]
    assert np.allclose(action.direction, [0, -1], atol=1e-3)
    assert action.position[-1] == pytest.approx(0.06, rel=1e-3)


def test_a_placed_stroke_lies_on_a_transformed_object_at_once():
    plane = add_plane(size=0.1)
    plane.location, plane.rotation_euler = (1, 2, 3), (0.3, 0.2, 2.0)
    depsgraph = graph()
    placed = place_primitive(bpy.context.scene, plane, 0, "left-right-soft", 1.0, depsgraph)
    stroke = read_stroke(placed.curve, bpy.context.scene, depsgraph, 1.0)
    assert np.abs(stroke.samples.point[:, 2]).max() < 1e-6


def test_default_is_a_scrape_at_100_mm_s_and_1_newton():
    action = act(place(add_plane(size=0.1), "default"))[3]
    assert action.speed.max() == pytest.approx(0.1, rel=2e-3)
    assert action.force.max() == pytest.approx(1.0, rel=1e-5)


@pytest.mark.parametrize("name", ["left-right-hard", "diagonal-soft", "rub-fast"])
def test_small_surfaces_shorten_the_stroke_and_keep_its_speed(name):
    stroke, contacts, action = assert_well_placed(place(add_plane(size=0.02), name), 0, within=1e-6)
    assert np.abs(contacts.point[:, :2]).max() <= 0.01
    assert action.speed.max() == pytest.approx(PRIMITIVES[name].speed, rel=5e-3)
    assert action.force.max() == pytest.approx(PRIMITIVES[name].force, rel=1e-5)
    assert stroke.length_m < 0.0283 or name == "rub-fast"


@pytest.mark.parametrize("name", ["left-right-soft", "top-bottom-hard", "rub-slow"])
def test_sphere(name):
    _, contacts, action = assert_well_placed(place(add_sphere(radius=0.08), name), 0)
    assert action.speed.max() == pytest.approx(PRIMITIVES[name].speed, rel=1e-2)
    assert np.all(np.einsum("nx,nx->n", contacts.normal, contacts.point) > 0)


def test_inner_shell_is_left_alone():
    """A hollow ball with a larger inner material: the outside is touched all the same."""
    outer, inner = add_sphere("Outer", 0.1), add_sphere("Inner", 0.095)
    for loop in range(2):
        outer.data.materials.append(bpy.data.materials.new(f"M{loop}"))
    inner.data.flip_normals()
    for polygon in inner.data.polygons:
        polygon.material_index = 0
    bpy.context.view_layer.objects.active = outer
    outer.select_set(True)
    inner.select_set(True)
    bpy.ops.object.join()
    _, contacts, _ = assert_well_placed(place(outer, "left-right-soft"), 0)
    assert np.linalg.norm(contacts.point, axis=1).min() > 0.098


def test_suzanne():
    bpy.ops.mesh.primitive_monkey_add(size=0.3)
    for name in ("left-right-soft", "rub-fast"):
        assert_well_placed(place(bpy.context.object, name), 0, within=1.5e-3)


def striped():
    """Two materials side by side."""
    xs = np.linspace(-0.1, 0.1, 11)
    vertices = [(x, y, 0.0) for x in xs for y in (-0.05, 0.05)]
    obj = add_mesh(
        "Striped", vertices, [(2 * i, 2 * i + 2, 2 * i + 3, 2 * i + 1) for i in range(10)], uv=lambda co: co[:2]
    )
    for name in ("Oak", "Felt"):
        obj.data.materials.append(bpy.data.materials.new(name))
    for polygon in obj.data.polygons:
        polygon.material_index = int(polygon.index >= 4)
    bpy.context.view_layer.update()
    return obj


def test_slots_are_found_and_kept():
    obj = striped()
    add_plane("Hidden").hide_render = True
    add_plane("Bare", size=0.05)
    slots = choose_default_slots(bpy.context.scene)
    assert [(each.name, slot, material) for each, slot, material in slots] == [
        ("Bare", 0, ""),
        ("Striped", 0, "Oak"),
        ("Striped", 1, "Felt"),
    ]
    for slot, side in ((0, -1), (1, 1)):
        _, contacts, _ = assert_well_placed(place(obj, "left-right-soft", slot=slot), slot, within=1e-6)
        assert side * contacts.point[:, 0].mean() > -0.02
    _, contacts, _ = assert_well_placed(place(obj, "top-bottom-soft"), 1, within=1e-6)


def test_one_default_target_per_material():
    obj = striped()
    small = add_plane("Small", size=0.02)
    small.data.materials.append(bpy.data.materials["Oak"])
    add_plane("Bare A", size=0.05)
    add_plane("Bare B", size=0.05)
    assert choose_default_slots(bpy.context.scene) == [
        (bpy.data.objects["Bare A"], 0, ""),
        (bpy.data.objects["Bare B"], 0, ""),
        (obj, 0, "Oak"),
        (obj, 1, "Felt"),
    ]
    small.scale = (20, 20, 20)
    bpy.context.view_layer.update()
    assert (small, 0, "Oak") in choose_default_slots(bpy.context.scene)


def test_without_uvs_left_to_right_is_the_objects_x():
    plane = add_mesh("Bare", [(-0.05, -0.05, 0), (0.05, -0.05, 0), (0.05, 0.05, 0), (-0.05, 0.05, 0)], [(0, 1, 2, 3)])
    _, contacts, action = assert_well_placed(place(plane, "left-right-soft"), 0, within=1e-6)
    assert not contacts.uv_known.any()
    assert np.allclose(action.direction, [1, 0], atol=1e-4)
    assert contacts.point[-1, 0] - contacts.point[0, 0] == pytest.approx(0.06, rel=1e-3)


def test_scaled_mirrored_and_centimetre_scenes():
    plane = add_plane(size=10.0)
    plane.scale = (1.0, -2.0, 1.0)
    bpy.context.view_layer.update()
    obj = place(plane, "diagonal-soft", metres_per_unit=0.01)
    stroke, contacts, _, action = act(obj, metres_per_unit=0.01)
    assert stroke.length_m == pytest.approx(0.06, rel=1e-3)
    assert action.speed.max() == pytest.approx(0.1, rel=5e-3)
    assert contacts.distance.max() < 1e-6
    assert np.allclose(action.direction, np.array([1, -1]) / np.sqrt(2), atol=1e-3)


def test_a_lid_above_is_avoided():
    plane = add_plane("Table", size=0.3)
    lid = add_plane("Lid", size=0.18, z=0.02)
    lid.location.x = -0.06
    bpy.context.view_layer.update()
    _, contacts, _ = assert_well_placed(place(plane, "top-bottom-soft"), 0, within=1e-6)
    assert contacts.point[:, 0].min() > 0.03


def test_same_scene_same_stroke():
    sphere = add_sphere(radius=0.07)
    first, second = (place(sphere, "rub-fast", seed=5) for _ in range(2))
    a, b = act(first)[3], act(second)[3]
    assert np.array_equal(a.direction, b.direction)
    assert np.array_equal(a.speed, b.speed)
    assert first.name != second.name


def test_what_cannot_be_touched_is_named():
    hidden = add_plane("Hidden")
    hidden.hide_render = True
    with pytest.raises(SceneError, match="object 'Hidden': it is hidden"):
        place(hidden, "left-right-soft")
    spike = add_mesh("Thread", [(0, 0, 0), (0.1, 0, 0), (0.1, 1e-4, 0)], [(0, 1, 2)])
    with pytest.raises(SceneError, match=r"object 'Thread': no place on its material slot 0 \(no material\).*by hand"):
        place(spike, "rub-slow")


@pytest.mark.skipif(not HELMET.exists(), reason=f"needs {HELMET}")
def test_flight_helmet():
    bpy.ops.import_scene.gltf(filepath=str(HELMET))
    bpy.context.view_layer.update()
    targets = choose_default_slots(bpy.context.scene)
    assert len(targets) == 6
    for target in targets:
        obj = place(target[0], "default", slot=target[1])
        stroke, contacts, mesh, action = act(obj)
        assert np.mean(contacts.slot == target[1]) >= 0.99, target
        assert contacts.on_surface.mean() >= 0.99, target
        assert contacts.distance.max() < 1e-3, target
        assert action.speed.max() == pytest.approx(0.1, rel=0.02), target
        up = make_ray_caster(mesh).cast(contacts.point + 1e-3 * contacts.normal, contacts.normal)
        assert np.mean(up.distance > 0.02) >= 0.95, target
        assert stroke.length_m >= 0.024, target


SAID = (
    "rub slowly in circles", "back and forth three times", "zigzag, 1 N", "press hard for two seconds", "tap twice",
    "tap twice, then rub in circles", "stop and go to the left", "drum for 1 second", "square with sides of 2 cm",
    "spiral inwards", "figure eight", "stroke to the right, lift, stroke again", "slide right, stop for half a second, "
    "slide back", "stroke with increasing force", "wavy line, upwards", "tap along a line from left to right",
)  # fmt: skip


@pytest.mark.parametrize("words", SAID)
def test_a_plane_gives_the_words_themselves(words):
    expected = make_primitive_action(parse_stroke(words), seed=3)
    action = assert_well_placed(place(add_plane(size=0.2), parse_stroke(words), seed=3), 0, within=1e-6)[2]
    n = min(len(action.speed), len(expected.speed))
    assert abs(len(action.speed) - len(expected.speed)) <= 3
    # Knots on the surface are closer, and keyframes are rounded to float32: corners come a few milliseconds apart.
    late = 3
    for mine, other, size in (
        (action.speed, expected.speed, expected.speed.max()), (action.force, expected.force, expected.force.max())
    ):  # fmt: skip
        near = [np.abs(mine[late : n - late] - np.roll(other, k)[late : n - late]) for k in range(-late, late + 1)]
        assert np.min(near, axis=0).max() <= 0.1 * max(size, 1e-3)
    assert action.position[-1] == pytest.approx(expected.position[-1], rel=5e-3, abs=1e-6)
    assert action.force.max() == pytest.approx(expected.force.max(), rel=1e-4)
    assert np.sum(np.diff(action.contact.astype(int)) == 1) == np.sum(np.diff(expected.contact.astype(int)) == 1)


@pytest.mark.parametrize("words", SAID)
def test_words_stay_on_a_ball_across_its_seam(words):
    ball = add_sphere(radius=0.06)
    _, contacts, action = assert_well_placed(place(ball, parse_stroke(words), seed=1), 0)
    expected = make_primitive_action(parse_stroke(words), seed=1)
    moving = expected.speed.max() > 0.0
    assert action.force.max() == pytest.approx(expected.force.max(), rel=1e-4)
    assert np.all(np.einsum("nx,nx->n", contacts.normal, contacts.point) > 0)
    if moving:
        sliding = action.contact & (action.speed > 0.0)
        assert action.speed[sliding].max() <= expected.speed[expected.contact].max() * 1.05 + 1e-3


def test_a_size_that_was_said_is_kept_or_refused():
    small = add_plane(size=0.03)
    with pytest.raises(SceneError, match="large enough"):
        place(small, parse_stroke("drag 5 cm"))
    assert act(place(small, parse_stroke("drag 2 cm, 80 mm/s")))[3].position[-1] == pytest.approx(0.02, rel=1e-3)
    # What was not said shrinks; its speed and time do not.
    action = act(place(small, parse_stroke("circles for 3 seconds, 100 mm/s")))[3]
    assert action.speed.max() == pytest.approx(0.1, rel=1e-2)
    assert action.duration_s == pytest.approx(3.0, abs=0.02)


def test_a_long_stroke_in_words_has_a_name_that_fits():
    words = (
        "tap twice with 2 N, then press hard for two seconds, then rub in small circles clockwise for 3.5 s, 80 mm/s"
    )
    primitive = parse_stroke(words)
    assert len(primitive.name) > 63
    placed = place(add_plane(size=0.1), primitive)
    assert placed.name.endswith("-etc on Plane")
    assert len(placed.name.encode()) <= 63


@pytest.mark.parametrize(("pitch", "height"), [(1e-3, 0.5e-3), (2e-3, 0.5e-3), (2e-3, 1e-3), (4e-3, 2e-3)])
@pytest.mark.parametrize("primitive", ["default", "rub-slow", "diagonal-hard"])
def test_steep_ridges_leave_as_much_room_as_a_flat_strip(pitch, height, primitive):
    """Flanks of 38 to 58°: what counts is the shape that the hand follows."""
    from test_mesh_relief import add_ridges

    def place(height: float) -> float:
        obj = add_ridges(f"Strip {height}", pitch, height, 20, length=0.1)
        bpy.context.view_layer.update()
        placed = place_primitive(bpy.context.scene, obj, 0, primitive, 1.0)
        obj.hide_render = obj.hide_viewport = True
        return placed.size_m

    assert place(height) == place(0.0)


def test_a_tilted_smooth_shape_is_still_too_steep():
    """Ridges on a cylinder of 12 mm: no more room than on the cylinder itself."""
    from test_mesh_relief import add_ridges

    def place(height: float) -> float:
        obj = add_ridges(f"Bar {height}", 1e-3, height, 12, length=0.03)
        bend = obj.data
        for vertex in bend.vertices:
            x, y, z = vertex.co
            radius = 12e-3 + z
            vertex.co = (radius * np.sin(x / 12e-3), y, radius * np.cos(x / 12e-3))
        bend.update()
        bpy.context.view_layer.update()
        placed = place_primitive(bpy.context.scene, obj, 0, "left-right-soft", 1.0)
        obj.hide_render = obj.hide_viewport = True
        return placed.size_m

    assert place(0.0) <= place(0.5e-3) <= 0.014  # 33° to each side, and the next size is 45°
