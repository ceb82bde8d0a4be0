"""Material choices by priority: command line, stroke, material, then ranking."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from job_scene import PLATE, kept, small_scene
from touch_scene import save_scene, touch

from hnf_blender.state.session_state import STATE
from hnf_blender.touch.bake_status import Freshness
from hnf_blender.touch.material_choice import merge_relief
from hnf_blender.touch.patch_cache import PatchRecord
from hnf_blender.touch.stroke_bake import load_bake
from hnf_core.material.fuse import merge_tokens
from hnf_core.material.library import Appearance, load_library
from hnf_core.material.token import Token
from hnf_core.tactile.tactile_map import Route


@pytest.fixture(autouse=True)
def lone(warm_bake):
    return warm_bake


def felt_as() -> str:
    assert bpy.ops.hnf.bake() == {"FINISHED"}
    return load_bake(bpy.data.objects["Along"]).facts["library_material"]


def test_choices_rank_stroke_over_material_over_ranking() -> None:
    plate, stroke = small_scene()
    ranked = felt_as()
    assert ranked not in {"oak-wood", "cork"}
    plate.active_material.hnf_touch.library = "oak-wood"
    bpy.ops.hnf.plan()
    assert STATE.get_statuses(bpy.context.scene)["Along"].freshness is Freshness.STALE
    assert "material choice" in STATE.get_statuses(bpy.context.scene)["Along"].why
    assert felt_as() == "oak-wood"
    stroke.hnf_stroke.material = "cork"
    assert felt_as() == "cork"
    stroke.hnf_stroke.material = plate.active_material.hnf_touch.library = ""
    assert felt_as() == ranked


def test_the_command_line_goes_before_all(tmp_path) -> None:
    plate, _ = small_scene()
    plate.active_material.hnf_touch.library = "oak-wood"
    scene = save_scene(tmp_path / "scene.blend")
    _, report = touch(scene, tmp_path / "own")
    assert report["strokes"][0]["library_material"] == "oak-wood"
    first = report["strokes"][0]["key"]
    _, report = touch(scene, tmp_path / "named", "--material", f"{PLATE}=cork")
    assert report["strokes"][0]["library_material"] == "cork"
    assert report["strokes"][0]["key"] != first


@pytest.mark.parametrize(("where", "named"), [("stroke", "stroke 'Along'"), ("material", "material 'Plate plastic'")])
def test_an_unknown_material_fails_its_stroke_with_its_location(where, named) -> None:
    plate, stroke = small_scene()
    if where == "stroke":
        stroke.hnf_stroke.material = "oak-wod"
    else:
        plate.active_material.hnf_touch.library = "oak-wod"
    with pytest.raises(RuntimeError, match=rf"(?i:{named}).* no library material .*'oak-wod'.* oak-wood"):
        bpy.ops.hnf.bake()
    assert kept()["bakes"] == {}


def test_an_unknown_material_on_an_untouched_slot_is_ignored() -> None:
    plate, _ = small_scene()
    other = bpy.data.materials.new("Elsewhere")
    other.hnf_touch.library = "no-such-thing"
    plate.data.materials.append(other)
    assert bpy.ops.hnf.bake() == {"FINISHED"}
    assert list(kept()["bakes"]) == ["Along"]


def test_a_patch_speaks_for_its_slot_by_what_of_it_is_seen() -> None:
    first, second = (material.token for material in load_library()[:2])

    def record(token, seen: int) -> PatchRecord:
        mask = np.zeros((8, 8), dtype=bool)
        mask[:, :seen] = True
        flat, faces = np.zeros((8, 8), np.float32), np.zeros(0, np.int32)
        known = np.ones(len(token), dtype=bool)
        return PatchRecord(flat, mask, 1e-4, 2e-4, "", 0.0, token, known, Appearance(), faces, ())

    token, route = merge_relief([record(first, 8), record(second, 2)])
    tokens = [Token(each, np.ones(len(each), dtype=bool)) for each in (first, second)]
    assert route is Route.MEASURED
    assert np.array_equal(token.values, merge_tokens(tokens, [4.0, 1.0]).values)
    assert not np.array_equal(token.values, merge_tokens(tokens).values)
