"""The asset library: the committed files are what the tool builds, small, and work in a fresh file."""

from __future__ import annotations

import re
from pathlib import Path

import bpy
import build_assets
import numpy as np
import pytest
from builders import add_plane
from stroke_builders import act

from hnf_blender.ops.diagnose_ops import ASSET_FOLDER, ASSET_LIBRARY_NAME, find_asset_library
from hnf_core.action.primitive_path import make_primitive_path
from hnf_core.action.primitives import PRIMITIVES
from hnf_core.material.library import get_material, load_library

pytestmark = pytest.mark.usefixtures("operators")

MEGABYTE = 1_000_000


@pytest.fixture(scope="module")
def committed() -> dict:
    return build_assets.read_contents(ASSET_FOLDER)


def append(name: str, kind: str, file: str, *, link: bool = False):
    with bpy.data.libraries.load(str(ASSET_FOLDER / file), link=link, assets_only=True) as (_, wanted):
        setattr(wanted, kind, [name])
    return getattr(wanted, kind)[0]


def test_they_are_small() -> None:
    assert sum(path.stat().st_size for path in ASSET_FOLDER.iterdir()) < MEGABYTE
    assert {path.name for path in ASSET_FOLDER.iterdir()} == {
        build_assets.MATERIALS, build_assets.STROKES, build_assets.CATALOGS
    }  # fmt: skip


def test_the_files_are_what_the_tool_builds(committed: dict, tmp_path: Path) -> None:
    build_assets.write_assets(tmp_path)
    built = build_assets.read_contents(tmp_path)
    assert built.keys() == committed.keys()
    for name, facts in built.items():
        if name == "catalogs":
            assert facts == committed[name]
            continue
        (*size, pixels), (*old_size, old_pixels) = facts.pop("picture"), dict(committed[name]).pop("picture")
        assert size == old_size
        difference = np.frombuffer(pixels, np.uint8).astype(int) - np.frombuffer(old_pixels, np.uint8)
        assert np.mean(difference != 0) < 0.01  # one step of a tone where another numpy rounds differently
        assert facts == {key: value for key, value in committed[name].items() if key != "picture"}


def test_every_library_material_is_there_once(committed: dict) -> None:
    feels = [facts["feels"] for facts in committed.values() if "feels" in facts]
    assert sorted(feels) == sorted(material.name for material in load_library())
    for facts in committed.values():
        if "feels" in facts:
            material = get_material(facts["feels"])
            assert facts["looks"][:3] == pytest.approx(material.appearance.base_color, abs=1e-4)
            assert set(material.words) <= set(facts["tags"])


def test_all_eight_strokes_are_there(committed: dict) -> None:
    names = {build_assets.format_name(name) for name in PRIMITIVES}
    assert {name for name, facts in committed.items() if "stroke" in facts} == names


def test_each_asset_has_a_picture_a_place_and_an_owner(committed: dict) -> None:
    ids = dict(re.findall(r"^([0-9a-f-]{36}):([^:]+):", committed["catalogs"], re.MULTILINE))
    pictures = set()
    for name, facts in committed.items():
        if name == "catalogs":
            continue
        width, height, pixels = facts["picture"]
        assert (width, height) == (96, 96)
        pictures.add(pixels)
        assert ids[facts["catalog"]].startswith("Touch/")
        assert facts["description"]
        assert facts["licence"] == "GPL-3.0-or-later"
    assert len(pictures) == len(committed) - 1


def test_an_appended_material_brings_its_choice() -> None:
    plane = add_plane()
    material = append("Oak wood", "materials", build_assets.MATERIALS)
    plane.data.materials.append(material)
    assert plane.material_slots[0].material.hnf_touch.library == "oak-wood"
    assert material.library is None


@pytest.mark.parametrize("name", list(PRIMITIVES))
def test_an_appended_stroke_touches_what_it_lies_on(name: str) -> None:
    plane = add_plane()
    stroke = append(build_assets.format_name(name), "objects", build_assets.STROKES)
    bpy.context.scene.collection.objects.link(stroke)
    bpy.context.view_layer.update()
    _, contacts, _, action = act(stroke)
    primitive, path = PRIMITIVES[name], make_primitive_path(name)
    assert contacts.on_surface.all()
    assert len(action.time) / action.rate == pytest.approx(path.duration_s, abs=0.02)
    assert action.force.max() == pytest.approx(primitive.force, rel=1e-3)
    assert action.speed.max() == pytest.approx(primitive.speed, rel=0.02)
    assert plane.name == act(stroke)[0].object_name


def test_two_of_the_same_stroke_are_edited_apart() -> None:
    add_plane()
    first, second = (append("Rub fast", "objects", build_assets.STROKES) for _ in range(2))
    assert first != second
    first.hnf_stroke.seed = 7
    assert second.hnf_stroke.seed == 0
    assert first.animation_data.action != second.animation_data.action


def test_the_library_is_added_and_taken_away_by_hand_only() -> None:
    assert find_asset_library(bpy.context) is None
    with pytest.raises(RuntimeError, match="not in the preferences"):
        bpy.ops.hnf.assets_remove()
    assert bpy.ops.hnf.assets_add() == {"FINISHED"}
    library = find_asset_library(bpy.context)
    assert (library.name, Path(library.path)) == (ASSET_LIBRARY_NAME, ASSET_FOLDER)
    with pytest.raises(RuntimeError, match="already"):
        bpy.ops.hnf.assets_add()
    before = len(bpy.context.preferences.filepaths.asset_libraries)
    assert bpy.ops.hnf.assets_remove() == {"FINISHED"}
    assert find_asset_library(bpy.context) is None
    assert len(bpy.context.preferences.filepaths.asset_libraries) == before - 1
