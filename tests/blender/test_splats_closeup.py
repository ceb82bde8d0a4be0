"""Patches rendered from splats: colour, depth, mask and detail of a known slab, in any frame and unit."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from builders import add_plane
from hypothesis import given, settings
from hypothesis import strategies as st
from mathutils import Euler
from splat_builders import FINE_M, HALF_M, METRES, Y_00, slab

from hnf_blender.bridge.cycles import UnlitImage
from hnf_blender.bridge.scene.meshes import read_surface
from hnf_blender.bridge.splat_closeup import (
    HALF_PASS_SIGMAS,
    PIXELS_PER_WAVELENGTH,
    SplatCloseUpRenderer,
    choose_splat_resolution,
    compute_surface_distance,
    fill_pinholes,
)
from hnf_blender.bridge.splat_cloud import create_cloud, link_cloud
from hnf_core.errors import SceneError
from hnf_core.scene.camera import CAMERA_DISTANCE_M, Patch
from hnf_core.scene.splats.depth_views import compute_linear_colour
from hnf_core.scene.splats.gaussians import Splats
from hnf_core.scene.splats.rasterize import SplatView

PIXELS = 128
TOP = Patch(np.array([0.0, 0.0, HALF_M[2]]), np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]), 0)


def slab_object(splats: Splats, unit: float = METRES):
    """A plane on top of the slab, and the slab's splats under it; the scene has `unit` metres a unit."""
    plane = add_plane("Slab", 1.0)
    half = np.array(HALF_M) / METRES
    for vertex in plane.data.vertices:
        vertex.co = (np.sign(vertex.co.x) * half[0], np.sign(vertex.co.y) * half[1], half[2])
    cloud = create_cloud("Slab splats", splats, "slab.ply")
    bpy.context.scene.collection.objects.link(cloud)
    link_cloud(plane, cloud)
    bpy.context.view_layer.update()
    return plane, cloud


def look(plane, cloud, unit: float = METRES, patch: Patch = TOP, pixels: int = PIXELS):
    bpy.context.view_layer.update()
    surface = read_surface(plane, bpy.context.view_layer.depsgraph, unit)
    with SplatCloseUpRenderer(plane, cloud, [patch], surface=surface, pixels=pixels) as renderer:
        return renderer.render(patch)


@pytest.fixture(scope="module")
def splats() -> Splats:
    return slab()


def test_colour_depth_faces_and_detail_are_the_slabs(splats: Splats) -> None:
    closeup = look(*slab_object(splats), pixels=256)
    assert closeup.mask.mean() > 0.98
    assert np.abs(closeup.view.depth[closeup.mask] - CAMERA_DISTANCE_M).max() < 0.2e-3
    colour = closeup.view.rgb[closeup.mask]
    light = np.array([0.85, 0.15])  # of the stripes, as displayed
    linear = np.where(light <= 0.04045, light / 12.92, ((light + 0.055) / 1.055) ** 2.4)
    assert np.percentile(colour[:, 0], 90) == pytest.approx(linear[0], rel=0.02)
    assert np.percentile(colour[:, 0], 10) == pytest.approx(linear[1], rel=0.1)
    assert closeup.appearance.base_color == pytest.approx(tuple(colour.mean(axis=0)), rel=1e-6)
    assert (closeup.height, closeup.renders) == (
        None,
        2,
    )  # with 128 pixels first, then with as many as the detail takes
    assert closeup.faces.tolist() == [0]
    assert closeup.unlit is not None
    assert closeup.unlit.source == "splats of slab.ply"
    assert closeup.unlit.resolved_wavelength_m == pytest.approx(HALF_PASS_SIGMAS * FINE_M, rel=1e-3)
    assert closeup.unlit.linear == pytest.approx(closeup.view.rgb, abs=0.01)


@pytest.mark.parametrize("unit", [METRES, 1.0])
def test_moving_turning_and_scaling_the_whole_change_nothing(splats: Splats, unit: float) -> None:
    plane, cloud = slab_object(splats)
    plain = look(plane, cloud)
    plane.location, plane.rotation_euler = (5.0, -3.0, 2.0), Euler((0.3, -1.1, 2.0))
    plane.scale = (METRES / unit,) * 3
    moved = look(plane, cloud, unit)
    assert moved.unlit is not None
    assert plain.unlit is not None
    assert (moved.mask == plain.mask).mean() > 0.999
    assert np.abs(moved.view.rgb - plain.view.rgb).mean() < 1e-3
    assert np.abs(moved.view.depth - plain.view.depth)[plain.mask].max() < 2e-6
    assert moved.unlit.resolved_wavelength_m == pytest.approx(plain.unlit.resolved_wavelength_m, rel=1e-5)


def test_a_patch_turned_by_a_quarter_sees_the_picture_turned(splats: Splats) -> None:
    plane, cloud = slab_object(splats)
    plain = look(plane, cloud)
    turned = look(plane, cloud, patch=Patch(TOP.centre, TOP.y_axis, TOP.normal, 0))
    assert np.abs(np.rot90(plain.view.rgb, -1) - turned.view.rgb).max() < 1e-3


def test_the_unit_decides_what_is_resolved(splats: Splats) -> None:
    plane, cloud = slab_object(splats)
    twice = Patch(2.0 * TOP.centre, TOP.x_axis, TOP.normal, 0)
    closeup = look(plane, cloud, 2.0 * METRES, twice)
    assert closeup.unlit is not None
    assert closeup.unlit.resolved_wavelength_m == pytest.approx(2.0 * HALF_PASS_SIGMAS * FINE_M, rel=1e-3)


def test_resolution_follows_the_image_and_not_the_splat_size(splats: Splats) -> None:
    rng = np.random.default_rng(6)
    waves, phases = rng.uniform(3e-3, 9e-3, 20)[:, None], rng.uniform(0.0, 2.0 * np.pi, 20)[:, None]
    light = 0.05 * np.cos(2.0 * np.pi * splats.means[:, 0] * METRES / waves + phases).sum(axis=0)
    soft = splats.harmonics.copy()
    soft[:, 0] = light[:, None] / Y_00
    plane, cloud = slab_object(Splats(splats.means, splats.scales, splats.rotations, splats.opacities, soft))
    closeup = look(plane, cloud, pixels=256)
    assert closeup.unlit is not None
    assert 1.5e-3 < closeup.unlit.resolved_wavelength_m < 5e-3
    assert closeup.renders == 2  # the splats are as fine as ever


def test_no_detail_finer_than_two_pixels_is_claimed(splats: Splats) -> None:
    plane, cloud = slab_object(splats)
    closeup = look(plane, cloud, pixels=20)
    assert closeup.unlit is not None
    assert closeup.unlit.resolved_wavelength_m == pytest.approx(2.0 * TOP.size_m / 20)


def test_one_colour_is_no_picture(splats: Splats) -> None:
    grey = np.full_like(splats.harmonics, -0.1 / Y_00)
    closeup = look(*slab_object(Splats(splats.means, splats.scales, splats.rotations, splats.opacities, grey)))
    assert closeup.mask.mean() > 0.98
    assert closeup.unlit is None
    assert closeup.appearance.base_color == pytest.approx((0.133,) * 3, abs=0.002)


def test_splats_away_from_the_surface_are_said_to_show_none(splats: Splats) -> None:
    plane, cloud = slab_object(splats)
    cloud.location.z = -3.0
    closeup = look(plane, cloud)
    assert not closeup.mask.any()
    assert closeup.unlit is None
    assert "object 'Slab': its splats show no surface" in closeup.notes[0]
    assert closeup.faces.size == 0


def test_stretched_and_mirrored_splats_are_refused(splats: Splats) -> None:
    plane, cloud = slab_object(splats)
    plane.scale = (1.0, 1.0, 1.5)
    with pytest.raises(SceneError, match=r"object 'Slab'.*three axes.*one scale"):
        look(plane, cloud)
    plane.scale = (1.0, 1.0, -1.0)
    with pytest.raises(SceneError, match="mirrored"):
        look(plane, cloud)


@settings(max_examples=20, deadline=None)
@given(st.floats(-5e-3, 5e-3), st.integers(0, 100))
def test_surface_distance_ignores_a_constant_offset(off: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    true = 0.01 + 1e-3 * rng.normal(size=(16, 16))
    shown = rng.uniform(size=true.shape) < 0.9
    depth = true + off
    depth[0, 0] += 3e-3
    shown[0, 0], shown[8, 8] = True, True
    away = compute_surface_distance(depth, true, shown)
    assert np.isinf(away[~shown]).all()
    assert away[0, 0] == pytest.approx(3e-3)
    rest = shown.copy()
    rest[0, 0] = False
    assert away[rest] == pytest.approx(0.0, abs=1e-12)


def test_holes_between_splats_are_filled_and_outside_stays_empty() -> None:
    own = np.ones((40, 40), dtype=bool)
    own[:, 30:] = False
    opacity = np.where(own, 0.9, 0.0).astype(np.float32)
    opacity[10:12, 10:12] = 0.2
    opacity[:, 25:30] = 0.0
    shown = own & (opacity >= 0.5)
    linear, depth = np.full((40, 40, 3), 0.3, np.float32), np.full((40, 40), 0.01, np.float32)
    linear[10:12, 10:12] = depth[10:12, 10:12] = 0.0
    mask, colour, filled = fill_pinholes(shown, own, linear, depth, opacity, 12 * 0.1e-3, 0.1e-3)
    assert mask[:, :22].all()
    assert not mask[:, 29:].any()
    assert colour[10:12, 10:12] == pytest.approx(0.3, rel=1e-5)
    assert filled[10:12, 10:12] == pytest.approx(0.01, rel=1e-5)
    assert (linear[10:12, 10:12] == 0.0).all()  # the input is left alone
    assert fill_pinholes(shown, own, linear, depth, opacity, 0.1e-3, 0.1e-3)[0][10, 10] == shown[10, 10]


@settings(max_examples=30, deadline=None)
@given(st.floats(1e-5, 0.1))
def test_a_picture_has_as_many_pixels_as_its_detail_takes(wave: float) -> None:
    picture = UnlitImage(np.zeros((1, 1, 3), np.uint8), np.zeros((1, 1), np.float32), wave, "splats")
    side = choose_splat_resolution(picture, TOP, 128, 512)
    assert 128 <= side <= 512
    assert side == 512 or side * wave >= PIXELS_PER_WAVELENGTH * TOP.size_m * (1.0 - 1e-9)
    assert choose_splat_resolution(None, TOP, 128, 512) == 128


def test_a_faint_surface_keeps_its_colour_without_background() -> None:
    shape = (4, 4)
    opacity = np.full(shape, 0.25, dtype=np.float32)
    rgb = np.full((*shape, 3), 0.5 * 0.25, dtype=np.float32)
    seen = SplatView(TOP.camera(4), rgb, np.ones(shape), np.ones(shape), opacity, 1, 1)
    assert compute_linear_colour(seen) == pytest.approx(0.21404, abs=1e-4)  # sRGB 0.5
