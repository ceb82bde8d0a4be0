"""Relief estimated from images: affected patches, the number of D_φ calls, and causes of staleness."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
import pytest
from builders import add_plane, bump_material, float_image
from closeup_builders import principled
from predicted_scene import PHOTO_PLATE, bake_open_scene, photo, photo_material, photo_plate, small_weights, use_weights
from touch_scene import line_stroke

from hnf_blender.bridge.cycles import UnlitImage
from hnf_blender.touch import bake_patches
from hnf_blender.touch.synthesise import synthesise_stroke
from hnf_core.field.weights import load_field
from hnf_core.tactile.tactile_map import Route
from hnf_core.tactile.views import cut_views

PRIOR = ["prior"] * 7


@pytest.fixture(autouse=True)
def quick(tmp_path, monkeypatch):
    """Small networks, and close-ups of a quarter of the pixels."""
    use_weights(monkeypatch, small_weights(tmp_path / "small.safetensors"))
    monkeypatch.setattr(bake_patches, "PATCH_PIXELS", 256)


def ridges_under_a_photo():
    plate = add_plane("Plate", 0.12)
    plate.data.materials.append(bump_material())
    material = plate.data.materials[0]
    texture = material.node_tree.nodes.new("ShaderNodeTexImage")
    texture.image = float_image("photo", photo())
    material.node_tree.links.new(texture.outputs["Color"], principled(material).inputs["Base Color"])


def changed(now, before) -> tuple[str, ...]:
    return now.jobs[0].inputs.describe_changes(before.jobs[0].inputs)


def test_a_photo_without_relief_is_predicted_once_a_patch(tmp_path) -> None:
    photo_plate()
    line_stroke("Along")
    line_stroke("Again", force=2.0)  # the same places
    first = bake_open_scene(tmp_path)
    assert first.routes == ["predicted"] * 5 + ["prior"] * 2
    patches = len(first.strokes[0].patches)
    counts = first.report.counts
    assert (counts.diffusion_calls, counts.tokens, counts.close_ups) == (patches, patches, patches)
    assert counts.renders == 2 * patches  # a photo as fine as this is looked at twice
    record = first.strokes[0].records[0]
    assert record.route is Route.PREDICTED
    assert record.predicted.images.shape[1:] == (64, 64, 3)
    assert len(record.predicted.images) == len(record.predicted.pitch_m) > 1
    second = bake_open_scene(tmp_path)
    assert (second.report.counts.diffusion_calls, second.report.counts.renders) == (0, 0)
    for one, other in zip(first.strokes, second.strokes, strict=True):
        for before, after in zip(one.fused, other.fused, strict=True):
            np.testing.assert_array_equal(before.values, after.values)


def test_no_network_looks_where_the_relief_is_known(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(bake_patches, "_load_weights", None)  # to read the weights would fail
    ridges_under_a_photo()
    line_stroke("Along")
    baked = bake_open_scene(tmp_path)
    assert baked.report.counts.diffusion_calls == 0
    assert "measured" in baked.routes
    assert "predicted" not in baked.routes


def test_one_colour_leaves_the_prior(tmp_path) -> None:
    plate = add_plane("Plate", 0.12)
    plate.data.materials.append(photo_material(np.full((32, 32, 3), 0.4)))
    line_stroke("Along")
    baked = bake_open_scene(tmp_path)
    assert baked.report.counts.diffusion_calls == 0
    assert baked.routes == PRIOR


def test_a_coarse_photo_is_said_to_be_too_coarse(tmp_path) -> None:
    photo_plate(texel=1e-3)
    line_stroke("Along")
    baked = bake_open_scene(tmp_path)
    assert baked.report.counts.diffusion_calls == 0
    assert baked.routes == PRIOR
    (said,) = [text for text in baked.report.warnings if "shows no wave below 2 mm" in text]
    assert f"material '{PHOTO_PLATE}'" in said
    assert "1 mm is needed" in said


def test_where_a_picture_is_of_one_colour_it_is_not_read() -> None:
    """A print on the left half of a patch: views of the plain half would be told a pattern that nobody drew."""
    rgb = np.full((512, 512, 3), 140, dtype=np.uint8)
    rgb[:, :256] = np.rint(255.0 * np.sqrt(photo(512)[:, :256]))
    pixel_m = 20e-3 / 512
    look = UnlitImage(rgb, np.zeros((512, 512), dtype=np.float32), 2.0 * pixel_m, "a print")
    mask = np.ones((512, 512), dtype=bool)
    every = cut_views(look.linear, look.depth_m, mask, pixel_m, look.resolved_wavelength_m)
    read = bake_patches.ReliefPredictor().make_views(look, mask, pixel_m)
    assert 1 < len(read) < len(every)
    assert read[0].pitch_m == every[0].pitch_m
    assert all(view.rgb.std(axis=(0, 1)).max() > 0.01 for view in read)
    plain = replace(look, rgb=np.full_like(rgb, 140))
    assert bake_patches.ReliefPredictor().make_views(plain, mask, pixel_m) == ()


def test_a_soft_photo_tells_no_more_than_it_shows(tmp_path) -> None:
    """Texels of 0.45 mm: waves down to 0.9 mm, all of a band down to 2 mm."""
    photo_plate(texel=0.45e-3)
    line_stroke("Along")
    baked = bake_open_scene(tmp_path)
    assert baked.routes == ["predicted"] * 3 + ["prior"] * 4
    assert baked.strokes[0].records[0].predicted.pitch_m.tolist() == [312.5e-6]


@pytest.mark.parametrize("where", ["stroke", "material"])
def test_what_the_artist_chose_is_not_overruled_by_a_picture(tmp_path, where) -> None:
    plate = photo_plate()
    stroke = line_stroke("Along")
    chosen = stroke.hnf_stroke if where == "stroke" else plate.data.materials[0].hnf_touch
    name = "material" if where == "stroke" else "library"
    setattr(chosen, name, "oak-wood")
    baked = bake_open_scene(tmp_path)
    assert baked.report.counts.diffusion_calls == 0
    assert baked.routes == PRIOR
    assert baked.report.warnings == []
    setattr(chosen, name, "")
    again = bake_open_scene(tmp_path)
    assert again.report.counts.renders == 0  # the close-ups are there
    assert again.report.counts.diffusion_calls == len(again.strokes[0].patches)
    assert "predicted" in again.routes


def test_new_weights_invalidate_predicted_reliefs_only(tmp_path, monkeypatch) -> None:
    photo_plate()
    line_stroke("Along")
    first = bake_open_scene(tmp_path)
    use_weights(monkeypatch, small_weights(tmp_path / "other.safetensors", seed=1))
    second = bake_open_scene(tmp_path)
    assert changed(second, first) == ("the networks that estimate relief from pictures",)
    assert second.report.counts.renders == 0  # close-ups are as they were
    assert second.report.counts.diffusion_calls == first.report.counts.diffusion_calls
    assert not np.array_equal(second.strokes[0].fused[0].values, first.strokes[0].fused[0].values)
    bpy.data.objects["Along"].hnf_stroke.material = "oak-wood"
    chosen = bake_open_scene(tmp_path)
    use_weights(monkeypatch, small_weights(tmp_path / "third.safetensors", seed=2))
    assert changed(bake_open_scene(tmp_path), chosen) == ()


def test_other_weights_leave_what_is_measured(tmp_path, monkeypatch) -> None:
    ridges_under_a_photo()
    line_stroke("Along")
    first = bake_open_scene(tmp_path)
    use_weights(monkeypatch, small_weights(tmp_path / "other.safetensors", seed=1))
    assert changed(bake_open_scene(tmp_path), first) == ()


def test_another_photo_is_another_surface(tmp_path) -> None:
    photo_plate()
    line_stroke("Along")
    first = bake_open_scene(tmp_path)
    image = bpy.data.images[f"{PHOTO_PLATE}.png"]
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    image.pixels.foreach_set(pixels.reshape(-1, 4)[::-1].ravel())
    image.update()
    image.pack()
    second = bake_open_scene(tmp_path)
    assert changed(second, first) == ("the materials of the surface",)
    assert second.report.counts.diffusion_calls == first.report.counts.diffusion_calls


def test_without_weights_it_says_so_and_takes_the_prior(tmp_path, monkeypatch) -> None:
    use_weights(monkeypatch, tmp_path / "gone.safetensors")
    photo_plate()
    line_stroke("Along")
    baked = bake_open_scene(tmp_path)
    assert baked.report.counts.diffusion_calls == 0
    assert baked.routes == PRIOR
    (said,) = baked.report.warnings
    assert f"material '{PHOTO_PLATE}'" in said
    assert "hnf train tactile-map --data simulated --out" in said


def test_where_the_scene_stands_changes_nothing(tmp_path) -> None:
    plate, stroke = photo_plate(), line_stroke("Along")
    here = bake_open_scene(tmp_path / "here").strokes[0]
    for obj in (plate, stroke):
        obj.location, obj.rotation_euler = (7.0, -7.0, 1.0), (0.4, 0.2, 1.1)
    there = bake_open_scene(tmp_path / "there").strokes[0]
    for one, other in zip(here.records, there.records, strict=True):
        np.testing.assert_allclose(other.predicted.token.values, one.predicted.token.values, atol=0.05)


def test_a_flat_map_gives_the_level_of_a_smooth_surface(tmp_path, monkeypatch) -> None:
    """What the picture shows to be smooth is not roughened by what the name promises."""
    monkeypatch.setattr(bake_patches, "PATCH_PIXELS", 512)
    use_weights(monkeypatch, small_weights(tmp_path / "flat.safetensors", level=-7.0))
    photo_plate(name="Rough sandstone", texel=20e-6)
    line_stroke("Along")
    baked = bake_open_scene(tmp_path)
    assert baked.routes == ["predicted"] * 7
    assert baked.strokes[0].main_material.library.name == "sandstone"
    # Friction's own noise belongs to the stuff and cannot be seen: without it nothing is left.
    stroke = baked.strokes[0]
    smooth = tuple(
        replace(each, library=replace(each.library, mechanics=replace(each.library.mechanics, friction_noise_n=0.0)))
        for each in stroke.materials
    )
    felt = synthesise_stroke(replace(stroke, materials=smooth), load_field(), 0, baked.report.counts)
    assert felt.signal.rms < 0.1


def test_a_damaged_prediction_is_made_anew(tmp_path) -> None:
    photo_plate()
    line_stroke("Along")
    first = bake_open_scene(tmp_path)
    small = sorted(tmp_path.glob("*.npz"), key=lambda path: path.stat().st_size)
    for path in small:
        path.write_bytes(path.read_bytes()[:200])
    again = bake_open_scene(tmp_path)
    assert again.report.counts.diffusion_calls == first.report.counts.diffusion_calls
    np.testing.assert_array_equal(again.strokes[0].fused[0].values, first.strokes[0].fused[0].values)
