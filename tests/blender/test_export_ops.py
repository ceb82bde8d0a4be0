"""The Export panel's buttons: every format of the table leaves a baked stroke, and what it cost is told."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import bpy
import numpy as np
import pytest
from job_scene import small_scene
from panel_recorder import drawn
from touch_scene import place_data

from hnf_blender.preview.export_stroke import describe_loss, export_stroke, get_current_signal
from hnf_blender.preview.preview_state import PREVIEW
from hnf_blender.props.scene_settings import FORMAT_CHOICES
from hnf_blender.touch.stroke_bake import load_bake
from hnf_core.action.action import read_action_csv
from hnf_core.export.convert import import_signal
from hnf_core.export.formats import FORMATS
from hnf_core.export.hjif import read_hjif
from hnf_core.export.options import ImportOptions
from hnf_core.export.wav import read_wav, write_wav
from hnf_core.signal import Signal

WORDS = [choice.format_name for choice in FORMAT_CHOICES]


@pytest.fixture(scope="module")
def baked_file(operators, rendered_plate, tmp_path_factory):
    """The small scene with its bake in it, saved; an export folder beside.

    The artist says that it is smooth plastic, whose last octave, in which one format ends, is too quiet to be told of.
    By its ridges it would be carbon fibre, the one plastic that has any so far apart, and that octave would be heard.
    """
    bpy.ops.wm.read_factory_settings(use_empty=True)
    folder = tmp_path_factory.mktemp("scene")
    plate, _ = small_scene()
    plate.data.materials[0].hnf_touch.library = "smooth-plastic"
    with pytest.MonkeyPatch.context() as patch:
        shutil.copytree(rendered_plate, place_data(patch, folder / "data"))
        assert bpy.ops.hnf.bake() == {"FINISHED"}
    path = folder / "scene.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


@pytest.fixture
def folder(baked_file, tmp_path):
    PREVIEW.clear()
    bpy.ops.wm.open_mainfile(filepath=str(baked_file))
    bpy.context.scene.hnf.export_folder = str(tmp_path / "out")
    yield tmp_path / "out"
    PREVIEW.clear()


def stroke():
    return bpy.data.objects["Along"]


def test_the_choices_are_those_of_the_table() -> None:
    assert set(WORDS) == set(FORMATS)
    assert [FORMATS[choice.format_name].scaled for choice in FORMAT_CHOICES] == [
        choice.scaled for choice in FORMAT_CHOICES
    ]
    files = [choice.stem + FORMATS[choice.format_name].suffix for choice in FORMAT_CHOICES]
    assert len(set(files)) == len(files)  # no format overwrites another's file


@pytest.mark.parametrize("word", WORDS)
def test_each_format_leaves_and_says_what_it_cost(word: str, folder) -> None:
    bpy.context.scene.hnf.export_format = word
    assert bpy.ops.hnf.export() == {"FINISHED"}
    choice = next(each for each in FORMAT_CHOICES if each.format_name == word)
    name = f"along{choice.stem}{FORMATS[word].suffix}"
    beside = {"along.hjif.glb"} if word == "hjif" else set()
    assert {path.name for path in folder.iterdir()} == {name, f"{name}.json"} | beside
    (sentence,) = PREVIEW.exported
    assert sentence.startswith(f"{name}: ")
    lossless = word in ("wav", "glb", "csv", "npz")
    assert ("nothing is lost" in sentence) == lossless
    assert ("no octave changed" in sentence) == (word in ("wav8k", "wav48k", "listen"))
    assert str(folder / name) in PREVIEW.losses
    if FORMATS[word].scaled:
        assert "1 = 30 m/s²" in PREVIEW.losses
    back = import_signal(folder / name, ImportOptions(), FORMATS[word])
    if lossless:
        assert back.samples.tobytes() == get_current_signal(stroke(), bpy.context).samples.tobytes()


def test_the_format_given_counts_more_than_the_panel_s(folder) -> None:
    bpy.context.scene.hnf.export_format = "csv"
    assert bpy.ops.hnf.export(format="wav") == {"FINISHED"}
    assert {path.name for path in folder.iterdir()} == {"along.wav", "along.wav.json"}


def test_the_action_of_a_stroke_is_a_table_that_is_read(folder) -> None:
    assert bpy.ops.hnf.export_action() == {"FINISHED"}
    assert {path.name for path in folder.iterdir()} == {"along-action.csv", "along-action.csv.json"}
    read, baked = read_action_csv(folder / "along-action.csv"), load_bake(stroke()).stroke.action
    np.testing.assert_allclose(read.speed, baked.speed, atol=1e-9)
    np.testing.assert_allclose(read.direction, baked.direction, atol=1e-9)
    np.testing.assert_allclose(read.position, baked.position, atol=1e-9)
    np.testing.assert_array_equal(read.contact, baked.contact)
    np.testing.assert_allclose(read.force, np.where(baked.contact, baked.force, 0.0), atol=1e-9)


def test_full_scale_is_the_largest_acceleration_of_the_actuator(folder) -> None:
    settings = bpy.context.scene.hnf
    settings.actuator, settings.own_peak_m_s2, settings.own_highest_hz = "own", 12.5, 400.0
    exported = export_stroke(stroke(), bpy.context, "haptic")
    assert exported.options.full_scale_m_s2 == 12.5
    assert exported.options.range_hz == (20.0, 400.0)
    record = json.loads((folder / "along.haptic.json").read_text(encoding="utf-8"))
    assert record["full_scale"] == 12.5


def test_what_is_clipped_is_warned_of(folder, capfd) -> None:
    settings = bpy.context.scene.hnf
    settings.actuator, settings.own_peak_m_s2 = "own", 1.0
    assert bpy.ops.hnf.export(format="wav8k") == {"FINISHED"}
    said = capfd.readouterr().out
    assert "Warning: along-8k.wav: Clipped" in said
    assert "Info: along-8k.wav: level" in said


def test_formats_on_surfaces_lie_on_the_plate(folder) -> None:
    assert [word for word, form in FORMATS.items() if form.surface] == ["hjif", "glb"]
    surface = export_stroke(stroke(), bpy.context, "glb").options.surface
    assert surface is not None
    assert surface.name == "Plate"
    assert surface.palette is not None
    assert surface.path is not None
    assert surface.path.length_m == pytest.approx(0.026, abs=1e-3)
    export_stroke(stroke(), bpy.context, "hjif")
    tree = json.loads((folder / "along.hjif").read_text(encoding="utf-8"))
    assert tree["perceptions"][0]["channels"][0]["vertices"]
    assert read_hjif(folder / "along.hjif", ImportOptions()).provenance["stroke"] == "Along"


def test_all_leaves_out_the_muted_and_refuses_the_stale(folder) -> None:
    for name in ("Muted", "Stale"):
        other = stroke().copy()
        other.name = name
        bpy.context.scene.collection.objects.link(other)
    bpy.data.objects["Muted"].hnf_stroke.mute = True
    bpy.data.objects["Stale"].location.y += 0.01
    bpy.context.view_layer.update()
    assert bpy.ops.hnf.export(all=True, format="npz") == {"FINISHED"}
    assert {path.name for path in folder.iterdir()} == {"along.npz", "along.npz.json"}
    assert len(PREVIEW.exported) == 1


def test_no_stroke_s_file_takes_the_place_of_another_s(folder, tmp_path) -> None:
    """Whose name makes the same file name, or who has the same name in another .blend; one's own is replaced."""
    twin = stroke().copy()
    twin.name, stroke().name = "along 1", "Along-1"  # in that order: stroke() goes by the name
    bpy.context.scene.collection.objects.link(twin)
    bpy.context.view_layer.update()
    for _ in range(2):
        assert bpy.ops.hnf.export(all=True, format="npz") == {"FINISHED"}
        assert {path.name for path in folder.glob("*.npz")} == {"along-1.npz", "along-1-2.npz"}
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "Kitchen.blend"))
    before = (folder / "along-1.npz").read_bytes()
    renamed = bpy.data.objects["Along-1"]
    bpy.context.view_layer.objects.active, renamed.hnf_stroke.seed = renamed, 12
    assert bpy.ops.hnf.export(format="npz") == {"FINISHED"}
    (sentence,) = PREVIEW.exported
    assert sentence.startswith("along-1-kitchen.npz: ")
    assert (folder / "along-1.npz").read_bytes() == before


def test_an_action_table_replaces_only_its_own(folder) -> None:
    twin = stroke().copy()
    twin.name, stroke().name = "along 1", "Along-1"
    bpy.context.scene.collection.objects.link(twin)
    bpy.context.view_layer.update()
    for _ in range(2):
        for name in ("Along-1", "along 1"):
            bpy.context.view_layer.objects.active = bpy.data.objects[name]
            assert bpy.ops.hnf.export_action() == {"FINISHED"}
        assert {path.name for path in folder.glob("*.csv")} == {"along-1-action.csv", "along-1-2-action.csv"}


def test_a_file_of_unknown_origin_is_not_overwritten(folder) -> None:
    """A recording of the artist's own, say; a WAV of `hnf touch` says itself whose it is."""
    signal = get_current_signal(stroke(), bpy.context)
    folder.mkdir()
    for name in ("along.csv", "along-action.csv"):
        (folder / name).write_bytes(b"mine")
    write_wav(folder / "along.wav", Signal(signal.samples, signal.sample_rate, seed=0))
    assert bpy.ops.hnf.export(format="csv") == {"FINISHED"}
    assert bpy.ops.hnf.export(format="wav") == {"FINISHED"}
    assert bpy.ops.hnf.export_action() == {"FINISHED"}
    assert {path.stem for path in folder.glob("*.csv")} == {"along", "along-2", "along-action", "along-2-action"}
    assert (folder / "along.csv").read_bytes() == (folder / "along-action.csv").read_bytes() == b"mine"
    assert read_wav(folder / "along.wav").provenance.get("stroke") is None
    (folder / "along-2.wav.json").unlink()
    assert bpy.ops.hnf.export(format="wav") == {"FINISHED"}
    assert {path.stem for path in folder.glob("*.wav")} == {"along", "along-2"}
    write_wav(folder / "along-2.wav", replace(signal, provenance={**signal.provenance, "stroke": "Another"}))
    assert bpy.ops.hnf.export(format="wav") == {"FINISHED"}
    assert {path.stem for path in folder.glob("*.wav")} == {"along", "along-2", "along-3"}


def test_nothing_is_told_of_another_file(folder) -> None:
    assert not bpy.ops.hnf.export_copy.poll()
    bpy.ops.hnf.export(format="haptic")
    assert bpy.ops.hnf.export_copy.poll()
    PREVIEW.clear()
    assert (PREVIEW.exported, PREVIEW.losses) == ((), "")
    assert not bpy.ops.hnf.export_copy.poll()


def test_the_sentence_names_what_changed_most(folder) -> None:
    sentence = describe_loss(export_stroke(stroke(), bpy.context, "haptic"))
    assert "level" in sentence
    assert " Hz " in sentence
    assert "dB" in sentence


def test_the_panel_says_full_scale_and_what_was_lost(folder) -> None:
    from hnf_blender.ui.preview_panel import HNF_PT_export

    settings = bpy.context.scene.hnf
    plain = drawn(HNF_PT_export)
    assert plain is not None
    assert "hnf.export_copy" not in plain.operators
    settings.export_format, settings.actuator, settings.own_peak_m_s2 = "ahap", "own", 12.5
    scaled = drawn(HNF_PT_export)
    assert scaled is not None
    assert "1 means 12.5 m/s² (My Actuator" in " ".join(scaled.words.split())
    settings.actuator = "generic-voice-coil"
    generic = drawn(HNF_PT_export)
    assert generic is not None
    assert "1 means 30 m/s², an assumption (Generic Voice Coil" in " ".join(generic.words.split())
    settings.actuator = "eai-c-mf"
    unstated = drawn(HNF_PT_export)
    assert unstated is not None
    assert "1 means 30 m/s², an assumption" in " ".join(unstated.words.split())
    settings.export_format = "wav"
    assert bpy.ops.hnf.export() == {"FINISHED"}
    told = drawn(HNF_PT_export)
    assert told is not None
    assert "1 means" not in told.words
    assert "along.wav: nothing is lost" in told.words
    assert "hnf.export_copy" in told.operators
