"""Fields trained on the command line, felt in a scene: `--material OBJECT[:SLOT]=FILE`."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path

import bpy
import numpy as np
import pytest
from builders import add_mesh, add_plane, bump_material
from touch_scene import PLATE, line_stroke, ridge_plate, save_scene
from touch_scene import touch_without_pictures as touch

from hnf_core.export.wav import read_wav
from hnf_core.field.adaptive_sampling import DEFAULT_TOLERANCE, PASSAGE_SAMPLES
from hnf_core.field.carriers import Carriers
from hnf_core.field.field import Field, FieldConfig, initial_parameters
from hnf_core.field.weights import read_material_file, save_field
from hnf_core.material.contact_model import UNKNOWN_MECHANICS
from hnf_core.material.hnf_file import from_library, write_hnf
from hnf_core.material.library import get_material
from hnf_core.material.token import TOKEN_DIM

TRAINED_ON = "9 s of own strokes"


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    """Small, and as `hnf train field` writes them."""
    config = FieldConfig(hidden=8, layers=1, states=1, carriers=Carriers(arc_octaves=0), physics=False)
    own = {"name": "Bark", "token": [0.0] * TOKEN_DIM, "mechanics": asdict(UNKNOWN_MECHANICS)}
    metadata = {"material": json.dumps(own), "licence": "mine", "training_data": TRAINED_ON}
    path = tmp_path / "bark.safetensors"
    save_field(path, Field(config, initial_parameters(config, 3), metadata=metadata))
    return path


def duo() -> None:
    """Two halves of one object, a bumpy one and a plain one, and a stroke over both."""
    corners = [(-0.1, -0.03, 0), (0, -0.03, 0), (0.1, -0.03, 0), (-0.1, 0.03, 0), (0, 0.03, 0), (0.1, 0.03, 0)]
    mesh = add_mesh("Duo", corners, [(0, 1, 4, 3), (1, 2, 5, 4)], uv=lambda co: (co.x, co.y))
    mesh.data.materials.append(bump_material("Left", wavelength=2e-3, height=4e-5))
    mesh.data.materials.append(bpy.data.materials.new("Oak right"))
    mesh.data.polygons[1].material_index = 1
    line_stroke("Both", length=0.16)


def test_a_seam_between_an_own_field_and_the_shared_one(tmp_path, weights, capsys) -> None:
    """Away from the seam, each half is exactly what it is where one field serves both; `none` lacks the field.

    In the seam's own passage the left half is so within the tolerance: where the trained field is evaluated follows
    from all of a passage, of which the right half has another token.
    """
    without = tmp_path / "without.hnf"
    write_hnf(without, replace(read_material_file(weights), field=b""))
    duo()
    scene = save_scene(tmp_path / "scene.blend")
    signals, entries = {}, {}
    for name, choice in (("none", f"Duo:Left={without}"), ("left", f"Duo:Left={weights}"), ("all", f"Duo={weights}")):
        code, report = touch(scene, tmp_path / name, "--material", choice)
        assert code == 0
        (entries[name],) = report["strokes"]
        signals[name] = read_wav(tmp_path / name / entries[name]["wav"]).samples
    middle, fade = len(signals["left"]) // 2, 100
    left, right = slice(0, middle - fade), slice(middle + fade, None)
    before = slice(0, middle // PASSAGE_SAMPLES * PASSAGE_SAMPLES - fade)
    assert before.stop > middle / 2
    np.testing.assert_allclose(signals["left"][before], signals["all"][before], atol=1e-6)
    off = signals["left"][left] - signals["all"][left]
    assert np.std(off) < DEFAULT_TOLERANCE * np.std(signals["all"][left])
    np.testing.assert_allclose(signals["left"][right], signals["none"][right], atol=1e-6)
    assert not np.allclose(signals["left"][left], signals["none"][left], atol=1e-3)
    assert entries["left"]["fields"] == {
        "Bark": TRAINED_ON,
        entries["none"]["library_material"].split(", ")[1]: "shared",
    }
    assert set(entries["all"]["routes"].values()) == {"learned"}
    assert "learned" not in entries["none"]["routes"].values()
    assert set(entries["none"]["fields"].values()) == {"shared"}
    provenance = read_wav(tmp_path / "all" / entries["all"]["wav"]).provenance
    assert (provenance["routes"], provenance["library_material"]) == ("8–0.125 mm learned", "Bark")
    assert "its shader's relief is not felt" in capsys.readouterr().err


def test_both_kinds_of_file_give_the_same(tmp_path, weights) -> None:
    ridge_plate()
    line_stroke("Along")
    scene = save_scene(tmp_path / "scene.blend")
    learned, slate = tmp_path / "bark.hnf", tmp_path / "slate.hnf"
    write_hnf(learned, read_material_file(weights))
    write_hnf(slate, from_library(get_material("slate")))
    waves = []
    for number, file in enumerate((weights, learned, slate)):
        _, report = touch(scene, tmp_path / str(number), "--material", f"{PLATE}={file}")
        waves.append(read_wav(tmp_path / str(number) / report["strokes"][0]["wav"]).samples.tobytes())
        assert report["strokes"][0]["library_material"] == ("slate" if file is slate else "Bark")
    assert waves[0] == waves[1] != waves[2]
    _, again = touch(scene, tmp_path / "0", "--material", f"{PLATE}={weights}")
    assert again["strokes"][0]["fresh"]
    _, other = touch(scene, tmp_path / "0", "--material", f"{PLATE}={slate}")
    assert not other["strokes"][0]["fresh"]


@pytest.mark.parametrize("content", [None, b"", b"no weights", b"shared"])
@pytest.mark.parametrize("name", ["bad.safetensors", "bad.hnf"])
def test_a_bad_file_costs_its_own_strokes_alone(tmp_path, capsys, name, content) -> None:
    from hnf_core.field.weights import DEFAULT_WEIGHTS

    bad = tmp_path / name
    if content is not None:
        bad.write_bytes(DEFAULT_WEIGHTS.read_bytes() if content == b"shared" else content)
    ridge_plate()
    line_stroke("Good")
    other = add_plane("Other", 0.1, z=0.5)
    for stroke in ("Bad", "Worse"):
        line_stroke(stroke, centre=(0, 0, 0.5), surface=other)
    code, report = touch(save_scene(tmp_path / "scene.blend"), tmp_path / "out", "--material", f"Other={bad}")
    assert code == 1
    assert [entry["name"] for entry in report["strokes"]] == ["Good"]
    assert sorted(entry["stroke"] for entry in report["failed"]) == ["Bad", "Worse"]
    errors = [line for line in capsys.readouterr().err.splitlines() if name in line]
    assert len(errors) == 1
    assert errors[0].startswith("hnf: ")


def test_a_bad_file_for_what_no_stroke_touches_is_a_note(tmp_path, capsys) -> None:
    ridge_plate()
    line_stroke("Good")
    add_plane("Other", 0.1, z=0.5)
    scene = save_scene(tmp_path / "scene.blend")
    code, report = touch(scene, tmp_path / "out", "--material", f"Other={tmp_path / 'none.hnf'}")
    assert code == 0
    assert [entry["name"] for entry in report["strokes"]] == ["Good"]
    assert "none.hnf" in capsys.readouterr().err


def test_the_panel_takes_weights_too(tmp_path, weights, operators) -> None:
    from hnf_blender.bridge.scene.material_definition import get_artist_choice

    plate = ridge_plate()
    bpy.context.view_layer.objects.active = plate
    assert bpy.ops.hnf.import_material(filepath=str(weights)) == {"FINISHED"}
    assert get_artist_choice(plate.active_material) == read_material_file(weights)
