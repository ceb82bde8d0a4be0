"""How sure a run is of a material, and of a signal: said by name, and a guess is called a guess."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from builders import add_plane
from touch_scene import line_stroke, save_scene
from touch_scene import touch_without_pictures as touch

from hnf_blender.bridge.cycles import UnlitImage
from hnf_blender.touch.material_choice import (
    CHOSEN_BY_ARTIST,
    GUESS_CONFIDENCE,
    SlotMaterial,
    format_certainty,
    format_guess_note,
    split_colors,
)
from hnf_blender.touch.patch_cache import PatchRecord
from hnf_core.material.library import Appearance, get_material


@pytest.mark.parametrize(("name", "guessed"), [("Thing 7", True), ("Oak wood", False)])
def test_a_guess_is_called_one_with_what_to_do(tmp_path, capsys, name, guessed) -> None:
    add_plane("Sphere", 0.12).data.materials.append(bpy.data.materials.new(name))
    line_stroke("Along")
    code, report = touch(save_scene(tmp_path / "scene.blend"), tmp_path / "out")
    assert code == 0
    (entry,) = report["strokes"]
    notes = [note for note in report["warnings"] if "is a guess" in note]
    assert len(notes) == int(guessed)
    if guessed:
        assert notes[0].startswith(f"material '{name}' on 'Sphere': {entry['library_material']} is a guess (")
        assert "Here: --material OBJECT[:SLOT]=NAME." in capsys.readouterr().err
    _, chosen = touch(tmp_path / "scene.blend", tmp_path / "out", "--material", "Sphere=denim")
    assert not any("is a guess" in note for note in chosen["warnings"])


def test_the_words_name_what_they_are_sure_of() -> None:
    oak = SlotMaterial("Wood", get_material("oak-wood"), 0.87, "named by 'wood'")
    assert format_certainty(oak) == "87% sure of it (named by 'wood')"
    assert format_certainty(SlotMaterial("Wood", get_material("oak-wood"), 1.0, CHOSEN_BY_ARTIST)) == CHOSEN_BY_ARTIST
    assert format_guess_note(oak, "Cup") == ""
    bare = SlotMaterial("", get_material("oak-wood"), 0.5 * GUESS_CONFIDENCE, "nothing in the scene tells")
    assert format_guess_note(bare, "Cup").startswith("object 'Cup': oak-wood is a guess (15% sure).")


def seen(codes, mask) -> PatchRecord:
    """A patch of 20 mm of which only a picture, 255 times the square root of linear color, is known."""
    unlit = UnlitImage(codes.astype(np.uint8), np.zeros(mask.shape, dtype=np.float32), 4e-3, "splats of a.ply")
    size = 20e-3 / len(mask)
    return PatchRecord(None, mask, size, np.inf, "", 0.0, None, None, Appearance(), np.zeros(0, np.int32), (), unlit)


def test_a_patch_is_split_by_color_and_not_by_pattern() -> None:
    rng = np.random.default_rng(3)
    halves = np.where(np.arange(128)[None, :, None] < 64, [180, 60, 40], [230, 230, 220]) * np.ones((128, 1, 1))
    mask = rng.random((128, 128)) < 0.9
    parts = split_colors(seen(halves, mask))
    assert sorted(size for _, size in parts) == sorted([mask[:, :64].sum(), mask[:, 64:].sum()])
    for color, _ in parts:
        assert any(np.allclose(color, np.square(np.array(half) / 255.0)) for half in ([180, 60, 40], [230, 230, 220]))
    weave = np.where(np.add.outer(np.arange(128) // 8, np.arange(128) // 8)[..., None] % 2, halves[0, 0], halves[0, -1])
    ((color, size),) = split_colors(seen(weave, np.ones((128, 128), dtype=bool)))
    assert size == 128**2
    np.testing.assert_allclose(color, np.square(weave / 255.0).mean(axis=(0, 1)))
    assert split_colors(PatchRecord(None, mask, 1e-4, np.inf, "", 0.0, None, None, Appearance(), mask, ())) == ()
