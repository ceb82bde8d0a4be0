"""How sure a run is of a material, and of a signal: said by name, and a guess is called a guess."""

from __future__ import annotations

import bpy
import pytest
from builders import add_plane
from touch_scene import line_stroke, save_scene, touch

from hnf_blender.touch.material_choice import (
    CHOSEN_BY_ARTIST,
    GUESS_CONFIDENCE,
    SlotMaterial,
    format_certainty,
    format_guess_note,
)
from hnf_core.material.library import get_material


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
