"""Live touch: position on the surface, its axes, and the material in contact."""

from __future__ import annotations

import dataclasses
import time

import bpy
import numpy as np
import pytest
from builders import add_plane, add_sphere
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mathutils import Euler
from player_builders import chosen, tone, until
from sound_server import RATE_HZ, SoundServer, sound_server, why_not
from touch_scene import PLATE, ridge_plate

from hnf_blender.actuator.actuator_state import SPEAKERS, VIRTUAL, Phase
from hnf_blender.actuator.live_touch import LiveTouch, SurfaceUnroll, force_from_pressure
from hnf_blender.actuator.player_client import PlayerClient, get_phase
from hnf_blender.bridge.scene.material_definition import set_definition
from hnf_blender.bridge.viewport_pick import cast_on_surface, find_contact_point, find_touched_material
from hnf_blender.ops.actuator_ops import SYSTEM_SOUND, get_live_output, guess_first_material, update_live_touch
from hnf_blender.preview.controller import OutputRouter
from hnf_blender.preview.sound_device import apply_monitor_gain
from hnf_blender.state.session_state import STATE
from hnf_blender.state.status_tracker import TokenValidity
from hnf_blender.touch.stroke_bake import BAKE_PROPERTY
from hnf_core.actuators.profile import GENERIC
from hnf_core.errors import MaterialError, SceneError
from hnf_core.material.hnf_file import from_library
from hnf_core.material.library import get_material, load_library

ABOVE = (0.0, 0.0, -1.0)


class Told:
    """What a hand told, in its order."""

    def __init__(self) -> None:
        self.materials: list[str] = []
        self.moves: list[tuple[float, tuple[float, float], float]] = []

    def live_material(self, material) -> None:
        self.materials.append(material.name)

    def live_move(self, time_s, position_m, force_n) -> None:
        self.moves.append((time_s, position_m, force_n))


def cast(x: float, y: float, z: float = 1.0, direction=ABOVE):
    return cast_on_surface(bpy.context.scene, depsgraph(), None, (x, y, z), direction)


def depsgraph():
    return bpy.context.evaluated_depsgraph_get()


def hand(material: str = "denim") -> tuple[LiveTouch, Told]:
    told = Told()
    return LiveTouch(told, from_library(get_material(material))), told


def choose(obj, library: str) -> None:
    if not obj.data.materials:
        obj.data.materials.append(bpy.data.materials.new(obj.name))
    obj.data.materials[0].hnf_touch.library = library


def test_hand_positions_are_metres_along_the_surface_axes() -> None:
    choose(add_plane(), "denim")
    touch, told = hand()
    for k, x in enumerate((0.0, 0.01, 0.03)):
        update_live_touch(touch, bpy.context, cast(x, 0.005), 1.5, 0.01 * k, TokenValidity())
    update_live_touch(touch, bpy.context, None, 1.5, 0.03, TokenValidity())
    assert [time for time, _, _ in told.moves] == pytest.approx([0.0, 0.01, 0.02, 0.03])
    assert [place for _, place, _ in told.moves] == [pytest.approx((x, 0.0), abs=1e-7) for x in (0, 0.01, 0.03, 0.03)]
    assert [force for _, _, force in told.moves] == [1.5, 1.5, 1.5, 0.0]
    assert told.materials == []  # denim is what it was begun with


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    angles=st.tuples(*[st.floats(-3.0, 3.0)] * 3),
    scale=st.tuples(*[st.floats(0.2, 5.0)] * 3),
    mirror=st.booleans(),
    metres=st.sampled_from([1.0, 0.01]),
)
def test_axes_are_those_of_the_uvs_however_the_object_stands(angles, scale, mirror, metres) -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    plane = add_plane(size=1.0)
    plane.rotation_euler = Euler(angles)
    plane.scale = (-scale[0] if mirror else scale[0], scale[1], scale[2])
    bpy.context.view_layer.update()
    matrix = np.array(plane.matrix_world)
    normal = np.cross(matrix[:3, 0], matrix[:3, 1])
    normal /= np.linalg.norm(normal)
    places = []
    for x in (0.1, 0.2):
        start = matrix[:3, :3] @ (x, 0.1, 0.0) + normal
        hit = cast(*start, direction=tuple(-normal))
        assert hit is not None
        met = find_contact_point(hit, depsgraph(), metres)
        assert met.axes @ met.axes.T == pytest.approx(np.eye(2), abs=1e-6)
        places.append(met)
    way = places[0].axes @ (places[1].point - places[0].point)
    assert way == pytest.approx((0.1 * scale[0] * metres, 0.0), abs=1e-5 * metres * 5)


def test_an_unlisted_face_uses_the_axes_of_its_object() -> None:
    """As where a graphics card subdivides: rays meet faces that the mesh does not list."""
    add_plane()
    hit = cast(0.01, 0.0)
    met = find_contact_point(dataclasses.replace(hit, face=10**6), depsgraph(), 1.0)
    assert met.axes == pytest.approx(np.eye(3)[:2], abs=1e-6)
    assert (met.slot, met.token) == (0, -1)
    assert met.point == pytest.approx((0.01, 0.0, 0.0), abs=1e-6)


def test_the_way_over_a_ball_is_as_long_as_its_arc() -> None:
    choose(add_sphere(radius=0.05, segments=96, rings=48), "denim")
    walker, length, angles = SurfaceUnroll(), 0.0, np.linspace(0.2, 1.2, 200)
    last = (0.0, 0.0)
    for angle in angles:
        out = np.array([np.sin(angle), 0.0, np.cos(angle)])
        met = find_contact_point(cast(*(0.2 * out), direction=tuple(-out)), depsgraph(), 1.0)
        place = walker.touch("Ball", met.point, met.axes)
        length += float(np.hypot(place[0] - last[0], place[1] - last[1])) if angle > angles[0] else 0.0
        last = place
    assert length == pytest.approx(0.05 * 1.0, rel=0.01)


def test_set_down_elsewhere_it_has_travelled_nothing() -> None:
    walker, axes = SurfaceUnroll(), np.eye(3)[:2]
    assert walker.touch("A", np.array([0.0, 0.0, 0.0]), axes) == (0.0, 0.0)
    assert walker.touch("A", np.array([0.01, 0.0, 0.0]), axes) == (0.01, 0.0)
    assert walker.touch("B", np.array([5.0, 0.0, 0.0]), axes) == (0.01, 0.0)
    assert walker.lift() == (0.01, 0.0)
    assert walker.touch("B", np.array([9.0, 3.0, 0.0]), axes) == (0.01, 0.0)
    assert walker.touch("B", np.array([9.0, 3.5, 0.0]), axes) == (0.01, 0.5)


def test_pen_pressure_scales_the_force_and_a_mouse_force_is_set() -> None:
    assert force_from_pressure(0.5, True, 3.0, 1.0) == 1.5
    assert force_from_pressure(0.0, True, 3.0, 1.0) == 0.0
    assert force_from_pressure(0.3, False, 3.0, 1.0) == 1.0


def test_repeated_lifts_send_one_move_and_zero_pressure_lifts() -> None:
    choose(add_plane(), "denim")
    touch, told = hand()
    touch.lift(0.0)
    assert told.moves == []
    update_live_touch(touch, bpy.context, cast(0.0, 0.0), 1.0, 0.1, TokenValidity())
    update_live_touch(touch, bpy.context, cast(0.01, 0.0), 0.0, 0.2, TokenValidity())
    update_live_touch(touch, bpy.context, None, 1.0, 0.3, TokenValidity())
    assert [force for _, _, force in told.moves] == [1.0, 0.0]


def test_a_material_change_is_sent_before_the_next_contact() -> None:
    left, right = add_plane("Left", 0.04), add_plane("Right", 0.04)
    left.location.x, right.location.x = -0.03, 0.03
    choose(left, "oak-wood")
    choose(right, "denim")
    bpy.context.view_layer.update()
    touch, told = hand("oak-wood")
    for k, x in enumerate((-0.03, -0.02, 0.02, 0.03, -0.02)):
        update_live_touch(touch, bpy.context, cast(x, 0.0), 1.0, 0.1 * k, TokenValidity())
    assert told.materials == ["denim", "oak-wood"]
    assert touch.material == "oak-wood"
    assert len(told.moves) == 5


def test_material_priority_is_choice_then_definition_then_looks() -> None:
    plane = add_plane()
    felt = find_touched_material(plane, depsgraph(), 0, -1)
    assert felt.name in {material.name for material in load_library()}
    plane.data.materials.append(bpy.data.materials.new("Rusty steel sheet"))
    set_definition(plane.data.materials[0],
    from_library(get_material("cork") if any(m.name == "cork" for m in load_library()) else get_material(
        "denim")))  # fmt: skip
    bpy.context.view_layer.update()
    carried = find_touched_material(plane, depsgraph(), 0, -1)
    assert carried.name in {"cork", "denim"}
    choose(plane, "oak-wood")
    bpy.context.view_layer.update()
    assert find_touched_material(plane, depsgraph(), 0, -1).name == "oak-wood"
    plane.data.materials[0].hnf_touch.library = "no such thing"
    bpy.context.view_layer.update()
    with pytest.raises(MaterialError):
        find_touched_material(plane, depsgraph(), 0, -1)


def test_what_cannot_be_felt_lifts_the_hand() -> None:
    plane = add_plane()
    choose(plane, "denim")
    touch, told = hand()
    update_live_touch(touch, bpy.context, cast(0.0, 0.0), 1.0, 0.1, TokenValidity())
    other = add_plane("Other", 0.02, z=0.01)
    choose(other, "no such thing")
    with pytest.raises(MaterialError):
        update_live_touch(touch, bpy.context, cast(0.0, 0.0), 1.0, 0.2, TokenValidity())
    assert told.moves[-1][2] == 0.0


def test_a_baked_material_is_used_until_another_is_chosen(warm_bake) -> None:
    from job_scene import small_scene

    small_scene()
    assert bpy.ops.hnf.bake() == {"FINISHED"}
    plate = bpy.data.objects[PLATE]
    assert BAKE_PROPERTY in bpy.data.objects["Along"]
    bpy.context.view_layer.update()
    met = find_contact_point(cast(0.0, 0.0), depsgraph(), 1.0)
    assert met.token == 0
    baked = find_touched_material(plate, depsgraph(), met.slot, met.token)
    guessed = find_touched_material(plate, depsgraph(), met.slot, -1)
    assert baked.token.known.all()
    assert not np.array_equal(baked.token.values, guessed.token.values)  # the ridges were seen
    choose(plate, "denim" if baked.name != "denim" else "oak-wood")
    bpy.context.view_layer.update()
    assert find_touched_material(plate, depsgraph(), met.slot, met.token).name != baked.name
    choose(plate, baked.name)
    bpy.context.view_layer.update()
    assert find_touched_material(plate, depsgraph(), met.slot, met.token) == baked


def test_a_material_baked_on_a_changed_surface_is_not_used(warm_bake) -> None:
    from job_scene import small_scene

    small_scene()
    assert bpy.ops.hnf.bake() == {"FINISHED"}
    plate = bpy.data.objects[PLATE]
    bpy.context.view_layer.update()
    guessed = find_touched_material(plate, depsgraph(), 0, -1)
    told = Told()
    touch, truth = LiveTouch(told, guessed), TokenValidity()
    update_live_touch(touch, bpy.context, cast(0.0, 0.0), 1.0, 0.1, truth)
    baked = touch._material
    assert (baked != guessed, truth.outdated) == (True, {})
    plate.data.vertices[0].co.x += 0.001
    plate.data.update()
    update_live_touch(touch, bpy.context, cast(0.001, 0.0), 1.0, 0.2, truth)
    assert touch._material == baked  # nobody said that anything changed: nothing is hashed anew
    STATE.changes += 1
    update_live_touch(touch, bpy.context, cast(0.002, 0.0), 1.0, 0.3, truth)
    assert (touch._material, truth.outdated.keys()) == (guessed, {PLATE})
    plate.data.vertices[0].co.x -= 0.001
    plate.data.update()
    STATE.changes += 1
    update_live_touch(touch, bpy.context, cast(0.003, 0.0), 1.0, 0.4, truth)
    assert (touch._material, truth.outdated) == (baked, {})


def test_before_the_pen_comes_down_the_active_mesh_is_meant() -> None:
    with pytest.raises(SceneError, match="no mesh"):
        guess_first_material(bpy.context)
    plane, plate = add_plane(), ridge_plate()
    choose(plane, "denim")
    choose(plate, "oak-wood")
    bpy.context.view_layer.objects.active = plate
    bpy.context.view_layer.update()
    assert guess_first_material(bpy.context).name == "oak-wood"
    bpy.context.view_layer.objects.active = plane
    assert guess_first_material(bpy.context).name == "denim"


@pytest.fixture
def link():
    made = PlayerClient()
    with chosen(VIRTUAL):
        yield made
    made.release()


def stroke_by_hand(link: PlayerClient, touch: LiveTouch, seconds: float, at_m_s: float = 0.1, force_n: float = 1.5):
    """Back and forth over the plane as a hand would, 125 events a second; what was told meanwhile."""
    began, told = time.monotonic(), []
    while (now := time.monotonic() - began) < seconds:
        x = 0.03 * (2.0 * abs((now * at_m_s / 0.06) % 2.0 - 1.0) - 1.0)
        update_live_touch(touch, bpy.context, cast(x, 0.0), force_n, time.perf_counter(), TokenValidity())
        link.tick()
        if link.current_status is not None:
            told.append(link.current_status.status)
        time.sleep(0.008)
    return told


def test_a_hand_is_felt_while_it_moves_and_not_when_it_is_lifted(link) -> None:
    choose(add_plane(), "denim")
    denim = from_library(get_material("denim"))
    link.live_begin(VIRTUAL, GENERIC, "pen", denim)
    touch = LiveTouch(link, denim)
    assert get_phase(link) is Phase.OPENING
    assert until(link, lambda: link.current_status is not None)
    assert get_phase(link) is Phase.LIVE
    assert link.current_status.status.peak == 0.0  # nothing before the first touch
    assert max(status.level_m_s2 for status in stroke_by_hand(link, touch, 1.0)) > 0.01
    touch.lift(time.perf_counter())
    assert until(link, lambda: link.current_status.status.level_m_s2 < 1e-4)
    assert link.is_live
    link.live_end()
    assert until(link, lambda: get_phase(link) is Phase.READY)
    assert link.problem == ""


def test_over_another_material_the_hand_goes_on(link) -> None:
    left, right = add_plane("Left", 0.03), add_plane("Right", 0.03)
    left.location.x, right.location.x = -0.015, 0.015
    choose(left, "oak-wood")
    choose(right, "denim")
    bpy.context.view_layer.update()
    oak = from_library(get_material("oak-wood"))
    link.live_begin(VIRTUAL, GENERIC, "finger", oak)
    touch = LiveTouch(link, oak)
    assert until(link, lambda: link.current_status is not None)
    pid = link.pid
    told = stroke_by_hand(link, touch, 1.5)
    deadline = time.perf_counter() + 20.0  # a busy machine takes seconds to load the other material
    while len({status.play for status in told}) == 1 and time.perf_counter() < deadline:
        told += stroke_by_hand(link, touch, 0.5)
    assert max(status.level_m_s2 for status in told) > 0.01
    assert touch.material in ("oak-wood", "denim")
    assert len({status.play for status in told}) > 1
    played = [status.played_s for status in told]
    assert played == sorted(played)  # one stream throughout
    assert (link.pid, link.problem, link.is_live) == (pid, "", True)
    assert get_phase(link) is Phase.LIVE


def test_a_sound_takes_the_place_of_a_hand_and_ends_it(link) -> None:
    choose(add_plane(), "denim")
    denim = from_library(get_material("denim"))
    link.live_begin(VIRTUAL, GENERIC, "pen", denim)
    assert until(link, lambda: link.current_status is not None)
    link.play(tone(0.5))
    assert not link.is_live
    assert until(link, lambda: get_phase(link) is Phase.PLAYING)
    link.live_move(time.perf_counter(), (0.0, 0.0), 1.0)  # an event that came late
    assert until(link, lambda: not link.is_playing)
    assert link.problem == ""


def test_a_probe_that_is_none_ends_the_hand_with_one_sentence(link) -> None:
    link.live_begin(VIRTUAL, GENERIC, "elbow", from_library(get_material("denim")))
    assert until(link, lambda: link.problem)
    assert "elbow" in link.problem
    assert not link.is_live


@pytest.mark.parametrize("gain_db", [-20.0, 0.0, 17.0])
def test_on_the_speakers_it_is_as_loud_as_play(gain_db) -> None:
    bpy.context.scene.hnf.monitor_gain_db = gain_db
    with chosen(SPEAKERS):
        target, profile = get_live_output(bpy.context)
    assert target == SYSTEM_SOUND
    samples = np.linspace(-3.0, 3.0, 50, dtype=np.float32)
    counted = np.clip(samples / profile.limits.full_scale_m_s2, -1.0, 1.0)
    assert counted == pytest.approx(apply_monitor_gain(samples, gain_db)[:, 0], abs=1e-6)
    with chosen(VIRTUAL):
        assert get_live_output(bpy.context) == (VIRTUAL, GENERIC)


def test_play_on_the_speakers_ends_a_hand_and_its_problem(monkeypatch) -> None:
    """So that nothing is heard twice, and nothing is told of what is over."""
    from hnf_blender.actuator import player_client

    client, outputs, sounded = PlayerClient(), OutputRouter(), []
    monkeypatch.setattr(player_client, "PLAYER_CLIENT", client)
    monkeypatch.setattr(outputs._speakers, "start", lambda samples, rate, **_: sounded.append(len(samples)))
    outputs.follow_pen(client)
    client.live_begin(VIRTUAL, GENERIC, "pen", from_library(get_material("denim")))
    client.problem = "The device is gone."
    assert client.is_live
    outputs.play(tone(0.1))
    assert (client.is_live, client.problem, sounded) == (False, "", [1000])
    client.release()


@pytest.fixture
def server(tmp_path):
    if why_not():
        pytest.skip(why_not())
    with sound_server(tmp_path) as running:
        yield running


def test_a_hand_is_heard_on_headphones(server: SoundServer) -> None:
    choose(add_plane(), "denim")
    client, denim = PlayerClient(), from_library(get_material("denim"))
    with chosen(SPEAKERS):
        client.live_begin(*get_live_output(bpy.context), "pen", denim)
    touch = LiveTouch(client, denim)
    assert until(client, lambda: client.current_status is not None or client.problem)
    assert client.problem == ""
    with server.recording() as recorded:
        told = stroke_by_hand(client, touch, 1.0)
        touch.lift(time.perf_counter())
        assert until(client, lambda: client.current_status.status.level_m_s2 < 1e-4)
    client.release()
    heard = np.abs(recorded[0][:, 0] / 32767.0)
    assert np.count_nonzero(heard) > 0.05 * RATE_HZ  # a busy machine leaves gaps
    assert 0.3 < heard.max() / max(status.peak for status in told) < 1.05
    assert client.problem == ""


def test_without_a_sound_output_one_line_says_so(server: SoundServer) -> None:
    server.end()
    client = PlayerClient()
    with chosen(SPEAKERS):
        client.live_begin(*get_live_output(bpy.context), "pen", from_library(get_material("denim")))
    assert until(client, lambda: client.problem)
    assert "sound output" in client.problem
    assert "\n" not in client.problem
    assert not client.is_live
    client.release()
